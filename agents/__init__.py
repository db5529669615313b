"""Policies and their evaluation."""

from agents.evaluation import Reaches, episode_seeds, run_reaches
from agents.policy import Policy
from agents.scripted import ScriptedReach

__all__ = ["Policy", "Reaches", "ScriptedReach", "episode_seeds", "run_reaches"]
