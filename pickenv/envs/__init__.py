"""Gymnasium environments; `import pickenv` registers them."""

from pickenv.envs.reaching.reach import ReachEnv
from pickenv.envs.reaching.reach_goal import ReachGoalEnv
from pickenv.envs.reaching.reach_ideal import ReachIdealEnv

__all__ = ["ReachEnv", "ReachGoalEnv", "ReachIdealEnv"]
