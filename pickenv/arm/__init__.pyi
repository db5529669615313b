from .effects.effect import Effect as Effect, Passage as Passage
from .files.arm import Arm as Arm
from .files.arm_file import load_arm as load_arm, shipped_arms as shipped_arms
from .kinematics.forward import Frame as Frame, forward as forward, forward_torch as forward_torch
from .kinematics.geometry import (
    Array as Array,
    Geometry as Geometry,
    Pose as Pose,
    from_standard_dh as from_standard_dh,
    identity_pose as identity_pose,
)
from .kinematics.inverse import InverseSolution as InverseSolution, inverse as inverse
from .kinematics.pose_error import (
    displace_pose as displace_pose,
    pose_error as pose_error,
    rotation_matrix as rotation_matrix,
    rotation_vector as rotation_vector,
)
from .kinematics.task_space import (
    joint_jacobian as joint_jacobian,
    noncompensable_error as noncompensable_error,
    parameter_jacobian as parameter_jacobian,
    task_directions as task_directions,
)
from .plant.campaign import (
    Instrument as Instrument,
    load_instrument as load_instrument,
    shipped_instruments as shipped_instruments,
)
from .plant.plant import Plant as Plant, PlantState as PlantState
from .plant.plant_batch import plant_at as plant_at, plants_on as plants_on
from .plant.plant_file import load_plant as load_plant, shipped_plants as shipped_plants
from .plant.tolerances import (
    Tolerances as Tolerances,
    draw_plants as draw_plants,
    load_tolerances as load_tolerances,
    shipped_tolerances as shipped_tolerances,
)
from .plant.twin_file import read_twin as read_twin, write_twin as write_twin
