"""Arms: geometry, kinematics, Jacobians, rank-aware inverse, and the plant (what the true arm does with a command)."""

from pickenv.arm.arm_file import Arm, load_arm, shipped_arms
from pickenv.arm.geometry import Geometry, Pose, from_standard_dh
from pickenv.arm.inverse import InverseSolution, inverse
from pickenv.arm.jacobians import joint_jacobian, parameter_jacobian
from pickenv.arm.kinematics import forward, forward_torch
from pickenv.arm.plant import Plant
from pickenv.arm.plant_file import load_plant, shipped_plants
from pickenv.arm.pose_error import displace_pose, pose_error, rotation_matrix, rotation_vector
from pickenv.arm.task import noncompensable_error, task_directions

__all__ = [
    "Arm",
    "Geometry",
    "InverseSolution",
    "Plant",
    "Pose",
    "displace_pose",
    "forward",
    "forward_torch",
    "from_standard_dh",
    "inverse",
    "joint_jacobian",
    "load_arm",
    "load_plant",
    "noncompensable_error",
    "parameter_jacobian",
    "pose_error",
    "rotation_matrix",
    "rotation_vector",
    "shipped_arms",
    "shipped_plants",
    "task_directions",
]
