"""Arms: geometry, kinematics, Jacobians, rank-aware inverse, and the plant (what the true arm does with a command)."""

from pickenv.arm.arm_file import Arm, load_arm, shipped_arms
from pickenv.arm.batch import plant_at, plants_on
from pickenv.arm.dynamics import PlantState
from pickenv.arm.geometry import Geometry, Pose, from_standard_dh
from pickenv.arm.inverse import InverseSolution, inverse
from pickenv.arm.jacobians import joint_jacobian, parameter_jacobian
from pickenv.arm.kinematics import forward, forward_torch
from pickenv.arm.plant import Plant
from pickenv.arm.plant_file import load_plant, shipped_plants
from pickenv.arm.pose_error import displace_pose, pose_error, rotation_matrix, rotation_vector
from pickenv.arm.task import noncompensable_error, task_directions
from pickenv.arm.tolerances import Tolerances, draw_plants, load_tolerances, shipped_tolerances

__all__ = [
    "Arm",
    "Geometry",
    "InverseSolution",
    "Plant",
    "PlantState",
    "Pose",
    "Tolerances",
    "displace_pose",
    "draw_plants",
    "forward",
    "forward_torch",
    "from_standard_dh",
    "inverse",
    "joint_jacobian",
    "load_arm",
    "load_plant",
    "load_tolerances",
    "noncompensable_error",
    "parameter_jacobian",
    "plant_at",
    "plants_on",
    "pose_error",
    "rotation_matrix",
    "rotation_vector",
    "shipped_arms",
    "shipped_plants",
    "shipped_tolerances",
    "task_directions",
]
