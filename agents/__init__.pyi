from .demonstrations.cloning import Clone as Clone, ClonedScene as ClonedScene, clone as clone
from .demonstrations.data_sets import (
    SIGHT as SIGHT,
    arms_of as arms_of,
    datasets as datasets,
    recorded_episode as recorded_episode,
)
from .evaluation.compare import PolicyComparison as PolicyComparison, compare as compare
from .evaluation.contenders import (
    Reaches as Reaches,
    Rollout as Rollout,
    episode_seeds as episode_seeds,
    maker_of as maker_of,
    pick_canopies as pick_canopies,
    roll_out as roll_out,
    run_reaches as run_reaches,
)
from .policies.adaptive import (
    AdaptiveReach as AdaptiveReach,
    FeelingPick as FeelingPick,
    RememberingPolicy as RememberingPolicy,
    RememberingReach as RememberingReach,
    load_remembering as load_remembering,
)
from .policies.foreign import foreign_policy as foreign_policy
from .policies.learned import (
    BASELINES as BASELINES,
    LearnedPolicy as LearnedPolicy,
    load_policy as load_policy,
    shipped_baselines as shipped_baselines,
)
from .policies.policy import Policy as Policy, read_observation as read_observation
from .policies.scripted import (
    HASTY as HASTY,
    OraclePick as OraclePick,
    OracleReach as OracleReach,
    RandomReach as RandomReach,
    ScriptedHarvest as ScriptedHarvest,
    ScriptedPick as ScriptedPick,
    ScriptedReach as ScriptedReach,
    ScriptedScene as ScriptedScene,
    SeeingScene as SeeingScene,
    ServoReach as ServoReach,
    ServoScene as ServoScene,
)
from .training.training import (
    Trained as Trained,
    read_checkpoint as read_checkpoint,
    resumed as resumed,
    train as train,
)
from .training.training_setup import (
    HELD_OUT as HELD_OUT,
    Training as Training,
    actor_of as actor_of,
    make_model as make_model,
    tuned as tuned,
    words_of as words_of,
)
