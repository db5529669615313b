"""Policies, their training and their evaluation.

    reaches = run_reaches(env, ScriptedReach(env), episode_seeds(0, 100))                 # one arm, one policy
    trained = train(Training("ppo", compensate="arm.npz"), "runs/train")                  # a policy of one's own
    policy = load_policy("runs/train/policy.npz")

torch and stable-baselines3 are imported only when a name that needs them is first used.
"""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.agents", __file__)

if __name__ == "agents":  # in a checkout, by the folder's own name: the same things, and no second copy of a shelf
    __path__.clear()
