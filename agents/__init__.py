"""Policies, their training and their evaluation; torch and stable-baselines3 are loaded by `agents.training` alone."""

from agents.adaptive import AdaptiveReach, AdaptiveSettings
from agents.evaluation import Reaches, episode_seeds, run_reaches
from agents.learned import LearnedPolicy, load_policy
from agents.oracle import OracleReach
from agents.policy import Policy
from agents.rollout import Rollout, roll_out
from agents.scripted import RandomReach, ScriptedReach
from agents.servo import ServoReach

__all__ = [
    "AdaptiveReach",
    "AdaptiveSettings",
    "LearnedPolicy",
    "OracleReach",
    "Policy",
    "RandomReach",
    "Reaches",
    "Rollout",
    "ScriptedReach",
    "ServoReach",
    "episode_seeds",
    "load_policy",
    "roll_out",
    "run_reaches",
]
