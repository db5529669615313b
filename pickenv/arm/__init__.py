"""Arms: geometry, kinematics, Jacobians, rank-aware inverse, and the plant (what the true arm does with a command)."""

from types import ModuleType as _ModuleType

from pickenv.arm.effects.effect import Effect as Effect
from pickenv.arm.effects.effect import Passage as Passage
from pickenv.arm.files.arm import Arm as Arm
from pickenv.arm.files.load import load_arm as load_arm
from pickenv.arm.files.load import shipped_arms as shipped_arms
from pickenv.arm.kinematics.forward import Frame as Frame
from pickenv.arm.kinematics.forward import forward as forward
from pickenv.arm.kinematics.forward import forward_torch as forward_torch
from pickenv.arm.kinematics.geometry import Array as Array
from pickenv.arm.kinematics.geometry import Geometry as Geometry
from pickenv.arm.kinematics.geometry import Pose as Pose
from pickenv.arm.kinematics.geometry import from_standard_dh as from_standard_dh
from pickenv.arm.kinematics.inverse import InverseSolution as InverseSolution
from pickenv.arm.kinematics.inverse import inverse as inverse
from pickenv.arm.kinematics.pose_error import displace_pose as displace_pose
from pickenv.arm.kinematics.pose_error import pose_error as pose_error
from pickenv.arm.kinematics.pose_error import rotation_matrix as rotation_matrix
from pickenv.arm.kinematics.pose_error import rotation_vector as rotation_vector
from pickenv.arm.kinematics.task_space import joint_jacobian as joint_jacobian
from pickenv.arm.kinematics.task_space import noncompensable_error as noncompensable_error
from pickenv.arm.kinematics.task_space import parameter_jacobian as parameter_jacobian
from pickenv.arm.kinematics.task_space import task_directions as task_directions
from pickenv.arm.plant.campaign import Instrument as Instrument
from pickenv.arm.plant.campaign import load_instrument as load_instrument
from pickenv.arm.plant.campaign import shipped_instruments as shipped_instruments
from pickenv.arm.plant.named_plants import load_plant as load_plant
from pickenv.arm.plant.plant import Plant as Plant
from pickenv.arm.plant.plant import PlantState as PlantState
from pickenv.arm.plant.plant_batch import plant_at as plant_at
from pickenv.arm.plant.plant_batch import plants_on as plants_on
from pickenv.arm.plant.plant_file import shipped_plants as shipped_plants
from pickenv.arm.plant.tolerances import Tolerances as Tolerances
from pickenv.arm.plant.tolerances import draw_plants as draw_plants
from pickenv.arm.plant.tolerances import load_tolerances as load_tolerances
from pickenv.arm.plant.tolerances import shipped_tolerances as shipped_tolerances
from pickenv.arm.plant.twin_file import read_twin as read_twin
from pickenv.arm.plant.twin_file import write_twin as write_twin

__all__ = sorted(name for name, value in globals().items() if name[0] != "_" and not isinstance(value, _ModuleType))
