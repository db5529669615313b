from .harvesting.harvest_env import HarvestEnv as HarvestEnv, HarvestVectorEnv as HarvestVectorEnv
from .picking.pick import PickEnv as PickEnv
from .picking.pick_vector import PickVectorEnv as PickVectorEnv
from .reaching.reach import ReachEnv as ReachEnv, ReachGoalEnv as ReachGoalEnv, ReachIdealEnv as ReachIdealEnv
from .reaching.scaled import (
    ReachScaledEnv as ReachScaledEnv,
    ReachScaledVectorEnv as ReachScaledVectorEnv,
    ReachToolEnv as ReachToolEnv,
    ReachToolVectorEnv as ReachToolVectorEnv,
)
from .reaching.vector import (
    ReachGoalVectorEnv as ReachGoalVectorEnv,
    ReachIdealVectorEnv as ReachIdealVectorEnv,
    ReachVectorEnv as ReachVectorEnv,
)
from .scene.pick_scene_env import PickSceneEnv as PickSceneEnv
from .shared.difficulty import EYES as EYES, LADDER as LADDER, LADDER_VERSION as LADDER_VERSION, SPLITS as SPLITS
from .shared.situation import CONTROL_PERIOD as CONTROL_PERIOD
from .shared.task import (
    FEEDBACK as FEEDBACK,
    GOAL_MARGIN as GOAL_MARGIN,
    check_choice as check_choice,
    check_count as check_count,
    check_number as check_number,
    make_task as make_task,
)
