from .effects.drives import MeasurementNoise as MeasurementNoise
from .effects.effect import (
    BASE as BASE,
    BEND as BEND,
    BESIDE as BESIDE,
    DRIVE as DRIVE,
    GEAR as GEAR,
    JOINT as JOINT,
    MOTOR as MOTOR,
    TOOL as TOOL,
    Components as Components,
    Effect as Effect,
    Passage as Passage,
    gravity_torques as gravity_torques,
)
from .files.arm import PER_JOINT as PER_JOINT, Arm as Arm, Load as Load, content_sha256 as content_sha256
from .files.arm_file import ARMS as ARMS, load_arm as load_arm, shipped_arms as shipped_arms
from .files.mjcf import mjcf_text as mjcf_text
from .files.model_arm import (
    ModelArm as ModelArm,
    arm_in_mujoco as arm_in_mujoco,
    geometry_in_mujoco as geometry_in_mujoco,
    joints_in_mujoco as joints_in_mujoco,
    quaternion as quaternion,
)
from .files.urdf import load_urdf as load_urdf, urdf_text as urdf_text, write_urdf as write_urdf
from .kinematics.forward import (
    Chain as Chain,
    Frame as Frame,
    Scalar as Scalar,
    Scalars as Scalars,
    attach as attach,
    chain_of as chain_of,
    chosen as chosen,
    clipped as clipped,
    drawn_parts as drawn_parts,
    forward as forward,
    frame_of as frame_of,
    frame_within as frame_within,
    frames as frames,
    geometry_from_axes as geometry_from_axes,
    nominal_points as nominal_points,
    pose_of as pose_of,
    split_joints as split_joints,
    tool_frame as tool_frame,
    true_points as true_points,
)
from .kinematics.geometry import (
    FRAME_PARAMETERS as FRAME_PARAMETERS,
    LINK_PARAMETERS as LINK_PARAMETERS,
    Array as Array,
    Coupling as Coupling,
    Geometry as Geometry,
    Pose as Pose,
    behind as behind,
    from_standard_dh as from_standard_dh,
    identity_pose as identity_pose,
    inverse_pose as inverse_pose,
    move_pose as move_pose,
)
from .kinematics.inverse import (
    Cube as Cube,
    InverseSolution as InverseSolution,
    farthest as farthest,
    inverse as inverse,
    largest_cube as largest_cube,
)
from .kinematics.task_space import (
    damped_step as damped_step,
    displace_pose as displace_pose,
    frame_error as frame_error,
    joint_jacobian as joint_jacobian,
    noncompensable_error as noncompensable_error,
    parameter_jacobian as parameter_jacobian,
    pose_error as pose_error,
    rotation_between as rotation_between,
    rotation_matrix as rotation_matrix,
    rotation_vector as rotation_vector,
    task_directions as task_directions,
    truncated_inverse as truncated_inverse,
)
from .plant.campaign import (
    TRACKER as TRACKER,
    Instrument as Instrument,
    NormalDraws as NormalDraws,
    Pace as Pace,
    causes_of as causes_of,
    effect_shares as effect_shares,
    load_instrument as load_instrument,
    measured_poses as measured_poses,
    moved as moved,
    normal_draws as normal_draws,
    shares_report as shares_report,
    switched_on as switched_on,
)
from .plant.iso9283 import (
    Iso9283Settings as Iso9283Settings,
    iso9283 as iso9283,
    pose_drift as pose_drift,
    pose_performance as pose_performance,
)
from .plant.plant import (
    Plant as Plant,
    PlantState as PlantState,
    arrays_of as arrays_of,
    leaves as leaves,
    plant_at as plant_at,
    plant_count as plant_count,
    plants_on as plants_on,
    tree_map as tree_map,
    with_links as with_links,
)
from .plant.plant_file import (
    IDEAL as IDEAL,
    PLANTS as PLANTS,
    class_of as class_of,
    draw_arms as draw_arms,
    load_plant as load_plant,
    shipped_effects as shipped_effects,
    shipped_plants as shipped_plants,
)
from .plant.populations import (
    TOLERANCES as TOLERANCES,
    Tolerances as Tolerances,
    draw_plants as draw_plants,
    erring_by as erring_by,
    it_tolerance as it_tolerance,
    load_tolerances as load_tolerances,
    read_twin as read_twin,
    shipped_tolerances as shipped_tolerances,
    standard_deviations as standard_deviations,
    write_twin as write_twin,
)
