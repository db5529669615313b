from .evaluation.compare import PolicyComparison as PolicyComparison, compare as compare
from .evaluation.reaches import Reaches as Reaches, episode_seeds as episode_seeds, run_reaches as run_reaches
from .evaluation.rollout import Rollout as Rollout, roll_out as roll_out
from .policies.adaptive import AdaptiveReach as AdaptiveReach, AdaptiveSettings as AdaptiveSettings
from .policies.harvest_policy import ScriptedHarvest as ScriptedHarvest
from .policies.learned import (
    LearnedPolicy as LearnedPolicy,
    load_policy as load_policy,
    shipped_baselines as shipped_baselines,
)
from .policies.pick_policy import ScriptedPick as ScriptedPick
from .policies.policy import Policy as Policy
from .policies.remembering import (
    RememberingPolicy as RememberingPolicy,
    RememberingReach as RememberingReach,
    load_remembering as load_remembering,
)
from .policies.scripted import (
    OracleReach as OracleReach,
    RandomReach as RandomReach,
    ScriptedReach as ScriptedReach,
    ServoReach as ServoReach,
)
from .training.data_sets import datasets as datasets
from .training.training import Trained as Trained, train as train
from .training.training_setup import Training as Training
