from .assessment.screen import (
    ErrorStatistics as ErrorStatistics,
    error_statistics as error_statistics,
    held_out_r2 as held_out_r2,
)
from .camera.boards import (
    Board as Board,
    board_picture as board_picture,
    load_board as load_board,
    read_lens as read_lens,
    write_board as write_board,
    write_lens as write_lens,
)
from .compensation.compensator import Compensator as Compensator, aimed as aimed, taught as taught
from .delivery.document import Document as Document, Order as Order, provenance as provenance
from .delivery.export import export as export
from .delivery.joint_offsets import joint_offsets as joint_offsets
from .identification.diagnosis import checked_rows as checked_rows
from .identification.least_squares import (
    Identifiability as Identifiability,
    Identification as Identification,
    identifiability as identifiability,
    identify as identify,
    identify_converged as identify_converged,
)
from .identification.robust import align as align
from .identification.solve import (
    random_walk as random_walk,
    start_filter as start_filter,
)
from .identification.term_choice import (
    harmonics_of as harmonics_of,
    identify_terms as identify_terms,
    plain_term as plain_term,
)
from .model.arm_model import (
    ArmModel as ArmModel,
    Conditions as Conditions,
    ErrorModel as ErrorModel,
    complete_model as complete_model,
    frames_model as frames_model,
    link_model as link_model,
    pose_carrier as pose_carrier,
    with_terms as with_terms,
)
from .model.kinds import (
    DistanceObservations as DistanceObservations,
    ReflectorObservations as ReflectorObservations,
    SocketObservations as SocketObservations,
    TiltObservations as TiltObservations,
)
from .model.measurements import (
    InstrumentStation as InstrumentStation,
    Measurements as Measurements,
    Stacked as Stacked,
    random_joints as random_joints,
    simulated_tracker as simulated_tracker,
)
from .model.noise_and_priors import prior_model as prior_model
from .model.observations import (
    Clocks as Clocks,
    Observations as Observations,
    blocked_split as blocked_split,
    contiguous_folds as contiguous_folds,
    same_poses as same_poses,
)
from .model.pixels import Lens as Lens, PixelObservations as PixelObservations, projected as projected
from .model.terms import (
    BendingTerm as BendingTerm,
    ComplianceTerm as ComplianceTerm,
    GravityTerm as GravityTerm,
    PeriodicTerm as PeriodicTerm,
    ThermalTerm as ThermalTerm,
    bending_of as bending_of,
    weight_of as weight_of,
)
from .pipeline.apply import apply_calibration as apply_calibration
from .pipeline.calibration import Calibration as Calibration, uncertainty_from as uncertainty_from
from .pipeline.fitting import (
    GEOMETRIC as GEOMETRIC,
    NOMINAL as NOMINAL,
    Fit as Fit,
    fit as fit,
    fit_remainder as fit_remainder,
    lens_of as lens_of,
    missed_by as missed_by,
)
from .pipeline.measured_cycles import measured_iso9283 as measured_iso9283
from .pipeline.result import Result as Result, assess as assess, workspace_joints as workspace_joints
from .pipeline.stages import (
    Choices as Choices,
    calibrate as calibrate,
    given_arm as given_arm,
    given_rows as given_rows,
    pool_of as pool_of,
)
from .pipeline.twin import twin as twin
from .pipeline.verification import frames_and_rows as frames_and_rows, verify as verify
from .planning.like import plan_like as plan_like
from .planning.plan import plan_poses as plan_poses
from .reading.description import load_description as load_description
from .reading.read import (
    Targets as Targets,
    joints_of as joints_of,
    read_measurements as read_measurements,
    read_observations as read_observations,
    read_targets as read_targets,
)
from .residuals.bpnn import Bpnn as Bpnn, BpnnSettings as BpnnSettings, train_bpnn as train_bpnn
from .residuals.gaussian_process import Fitter as Fitter
from .residuals.residual_models import (
    GateVerdict as GateVerdict,
    LearntResidual as LearntResidual,
    fit_residual as fit_residual,
    gate_residuals as gate_residuals,
)
