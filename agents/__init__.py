"""Policies, their training and their evaluation.

    reaches = run_reaches(env, ScriptedReach(env), episode_seeds(0, 100))                 # one arm, one policy
    trained = train(Training("ppo", compensate="arm.npz"), "runs/train")                  # a policy of one's own
    policy = load_policy("runs/train/policy.npz")

torch and stable-baselines3 are loaded when training is first asked for.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from pickenv.faces import offered as _offered

if _TYPE_CHECKING:
    from pickenv.agents.evaluation.compare import PolicyComparison, compare
    from pickenv.agents.evaluation.reaches import episode_seeds, run_reaches
    from pickenv.agents.evaluation.rollout import Rollout, roll_out
    from pickenv.agents.policies.adaptive import AdaptiveReach, AdaptiveSettings
    from pickenv.agents.policies.harvest_policy import ScriptedHarvest
    from pickenv.agents.policies.learned import LearnedPolicy, load_policy, shipped_baselines
    from pickenv.agents.policies.pick_policy import ScriptedPick
    from pickenv.agents.policies.policy import Policy
    from pickenv.agents.policies.remembering import RememberingPolicy, RememberingReach, load_remembering
    from pickenv.agents.policies.scripted import OracleReach, RandomReach, ScriptedReach, ServoReach
    from pickenv.agents.training.data_sets import datasets
    from pickenv.agents.training.training import Trained, train
    from pickenv.agents.training.training_setup import Training
    from pickenv.inspect.runs.episode_summary import Reaches

__all__ = ["AdaptiveReach", "AdaptiveSettings", "LearnedPolicy", "OracleReach"]
__all__ += ["Policy", "PolicyComparison", "RandomReach", "Reaches", "Rollout", "ScriptedHarvest"]
__all__ += ["RememberingPolicy", "RememberingReach", "ScriptedPick", "ScriptedReach", "ServoReach", "Trained"]
__all__ += ["Training", "compare", "datasets", "episode_seeds", "load_policy", "load_remembering"]
__all__ += ["roll_out", "run_reaches", "shipped_baselines", "train"]

__getattr__, __dir__ = _offered(__name__)

if __name__ == "agents":  # in a checkout, by the folder's own name: the same things, and no second copy of a shelf
    __path__.clear()
