"""Wrappers for environments: compensation, scaling for learning, a real arm's errors, and an adapter for SB3.

SB3 is Stable-Baselines3. For example:

    env = CompensationWrapper(gymnasium.make("pickenv/Reach-v0"), calibration.compensator())
    model = PPO("MlpPolicy", make_sb3_vec("pickenv/ReachScaled-v0", 64))

stable-baselines3 is imported only when `make_sb3_vec` or `Sb3Vec` is first used.
"""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.wrappers", __file__)
