"""Arms: geometry, kinematics, Jacobians, rank-aware inverse, and the plant (what the true arm does with a command)."""

from pickenv.arm.files.arm import Arm
from pickenv.arm.files.load import load_arm, shipped_arms
from pickenv.arm.kinematics.forward import forward, forward_torch
from pickenv.arm.kinematics.geometry import Geometry, Pose, from_standard_dh
from pickenv.arm.kinematics.inverse import InverseSolution, inverse
from pickenv.arm.kinematics.jacobians import joint_jacobian, parameter_jacobian
from pickenv.arm.kinematics.pose_error import displace_pose, pose_error, rotation_matrix, rotation_vector
from pickenv.arm.kinematics.task_space import noncompensable_error, task_directions
from pickenv.arm.plant.dynamics import PlantState
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_batch import plant_at, plants_on
from pickenv.arm.plant.plant_file import load_plant, shipped_plants
from pickenv.arm.plant.tolerances import Tolerances, draw_plants, load_tolerances, shipped_tolerances

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
