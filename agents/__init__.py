"""Policies, their training and their evaluation; only training loads torch and stable-baselines3."""

from pickenv.agents.evaluation.reaches import Reaches, episode_seeds, run_reaches
from pickenv.agents.evaluation.rollout import Rollout, roll_out
from pickenv.agents.policies.adaptive import AdaptiveReach, AdaptiveSettings
from pickenv.agents.policies.learned import LearnedPolicy, load_policy
from pickenv.agents.policies.oracle import OracleReach
from pickenv.agents.policies.policy import Policy
from pickenv.agents.policies.scripted import RandomReach, ScriptedReach
from pickenv.agents.policies.servo import ServoReach

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

if __name__ == "agents":  # in a checkout, by the folder's own name: the same things, and no second copy of a shelf
    __path__.clear()
