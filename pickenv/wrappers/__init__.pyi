from .compensation import (
    Compensate as Compensate,
    CompensationVectorWrapper as CompensationVectorWrapper,
    CompensationWrapper as CompensationWrapper,
)
from .gap import (
    GapScaling as GapScaling,
    GapScalingVector as GapScalingVector,
    Scaling as Scaling,
    joined_observation as joined_observation,
)
from .mujoco_arm import Miscalibrate as Miscalibrate
from .same_arm import (
    MOST_SEEN as MOST_SEEN,
    SEEN_MM as SEEN_MM,
    ManyCanopies as ManyCanopies,
    PickMemory as PickMemory,
    SameArm as SameArm,
    SameArmMixture as SameArmMixture,
    SameArmVector as SameArmVector,
)
from .sb3 import Sb3Vec as Sb3Vec, make_sb3_vec as make_sb3_vec
from .tool_steps import (
    ToolStepping as ToolStepping,
    ToolSteppingVector as ToolSteppingVector,
    ToolSteps as ToolSteps,
    tool_steps_of as tool_steps_of,
)
