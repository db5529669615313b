"""Policies and their evaluation."""

from agents.evaluation import Policy, Reaches, episode_seeds, run_reaches
from agents.scripted import ScriptedReach

__all__ = ["Policy", "Reaches", "ScriptedReach", "episode_seeds", "run_reaches"]
