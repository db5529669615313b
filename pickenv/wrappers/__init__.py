"""Around environments: a calibration, a scaling to learn by, a real arm's error, and many at once for SB3.

    env = CompensationWrapper(gymnasium.make("pickenv/Reach-v0"), calibration.compensator())
    model = PPO("MlpPolicy", make_sb3_vec("pickenv/ReachScaled-v0", 64))

stable-baselines3 is loaded when `make_sb3_vec` or `Sb3Vec` is first asked for.
"""

from pickenv.base.faces import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.wrappers", __file__)
