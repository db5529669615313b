"""Gymnasium environments; `import pickenv` registers them."""

from types import ModuleType as _ModuleType

from pickenv.envs.harvesting.harvest_env import HarvestEnv as HarvestEnv
from pickenv.envs.harvesting.harvest_vector import HarvestVectorEnv as HarvestVectorEnv
from pickenv.envs.picking.pick import PickEnv as PickEnv
from pickenv.envs.picking.pick_vector import PickVectorEnv as PickVectorEnv
from pickenv.envs.reaching.reach import ReachEnv as ReachEnv
from pickenv.envs.reaching.reach_goal import ReachGoalEnv as ReachGoalEnv
from pickenv.envs.reaching.reach_goal import ReachIdealEnv as ReachIdealEnv
from pickenv.envs.reaching.vector import ReachGoalVectorEnv as ReachGoalVectorEnv
from pickenv.envs.reaching.vector import ReachIdealVectorEnv as ReachIdealVectorEnv
from pickenv.envs.reaching.vector import ReachVectorEnv as ReachVectorEnv

__all__ = sorted(name for name, value in globals().items() if name[0] != "_" and not isinstance(value, _ModuleType))
