"""Around environments: a calibration between policy and arm, and Stable-Baselines3's way of asking for many at once.

env = CompensationWrapper(gymnasium.make("pickenv/Reach-v0"), calibration.compensator())
model = PPO("MlpPolicy", make_sb3_vec("pickenv/Reach-v0", 16))
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from pickenv.wrappers.compensation import Compensate, CompensationVectorWrapper, CompensationWrapper

if _TYPE_CHECKING:
    from pickenv.wrappers.sb3 import Sb3Vec, make_sb3_vec

__all__ = ["Compensate", "CompensationVectorWrapper", "CompensationWrapper", "Sb3Vec", "make_sb3_vec"]


def __getattr__(name: str) -> _Any:
    """What loads stable-baselines3, when it is first asked for."""
    if name in ("Sb3Vec", "make_sb3_vec"):
        return getattr(_import_module("pickenv.wrappers.sb3"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
