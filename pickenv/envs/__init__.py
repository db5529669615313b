"""Gymnasium environments; `import pickenv` registers them."""

from pickenv.envs.reach import ReachEnv
from pickenv.envs.reach_goal import ReachGoalEnv
from pickenv.envs.reach_ideal import ReachIdealEnv

__all__ = ["ReachEnv", "ReachGoalEnv", "ReachIdealEnv"]
