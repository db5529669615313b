"""Around environments: a calibration, a scaling to learn by, a real arm's error, and many at once for SB3.

    env = CompensationWrapper(gymnasium.make("pickenv/Reach-v0"), calibration.compensator())
    model = PPO("MlpPolicy", make_sb3_vec("pickenv/ReachScaled-v0", 64))

stable-baselines3 is loaded when `make_sb3_vec` or `Sb3Vec` is first asked for.
"""

from typing import TYPE_CHECKING as _TYPE_CHECKING

from pickenv.faces import offered as _offered

if _TYPE_CHECKING:
    from pickenv.wrappers.compensation import Compensate, CompensationVectorWrapper, CompensationWrapper
    from pickenv.wrappers.gap import GapScaling, GapScalingVector, scaled_reach, scaled_reach_vector
    from pickenv.wrappers.mujoco_arm import Miscalibrate, geometry_in_mujoco
    from pickenv.wrappers.same_arm import PickMemory, SameArm, SameArmVector
    from pickenv.wrappers.sb3 import Sb3Vec, make_sb3_vec
    from pickenv.wrappers.tool_steps import ToolStepping, ToolSteppingVector

__all__ = ["Compensate", "CompensationVectorWrapper", "CompensationWrapper", "GapScaling", "GapScalingVector"]
__all__ += [
    "Miscalibrate",
    "PickMemory",
    "SameArm",
    "SameArmVector",
    "Sb3Vec",
    "ToolStepping",
    "ToolSteppingVector",
    "geometry_in_mujoco",
    "make_sb3_vec",
    "scaled_reach",
    "scaled_reach_vector",
]

__getattr__, __dir__ = _offered(__name__)
