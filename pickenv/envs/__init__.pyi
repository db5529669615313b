from .harvesting.harvest_env import HarvestEnv as HarvestEnv, HarvestVectorEnv as HarvestVectorEnv
from .picking.pick import PickEnv as PickEnv
from .picking.pick_vector import PickVectorEnv as PickVectorEnv
from .reaching.reach import ReachEnv as ReachEnv, ReachGoalEnv as ReachGoalEnv, ReachIdealEnv as ReachIdealEnv
from .reaching.vector import (
    ReachGoalVectorEnv as ReachGoalVectorEnv,
    ReachIdealVectorEnv as ReachIdealVectorEnv,
    ReachVectorEnv as ReachVectorEnv,
)
