from .assessment.metrics import (
    ErrorStatistics as ErrorStatistics,
    error_statistics as error_statistics,
    held_out_r2 as held_out_r2,
    paper_eta as paper_eta,
)
from .compensation.compensator import Compensator as Compensator
from .delivery.document import Document as Document, Order as Order, provenance as provenance
from .delivery.export import Delivery as Delivery, export as export
from .delivery.joint_offsets import (
    joint_offsets as joint_offsets,
    read_lerobot as read_lerobot,
)
from .identification.extended_kalman_filter import (
    continue_filter as continue_filter,
    filter_measurements as filter_measurements,
    offset_walk as offset_walk,
    random_walk as random_walk,
    start_filter as start_filter,
    thermal_walk as thermal_walk,
)
from .identification.least_squares import (
    Identifiability as Identifiability,
    Identification as Identification,
    identifiability as identifiability,
    identify as identify,
)
from .identification.robust import align as align
from .model.arm_model import complete_model as complete_model, frames_model as frames_model, link_model as link_model
from .model.kinds import (
    DistanceObservations as DistanceObservations,
    ReflectorObservations as ReflectorObservations,
    SocketObservations as SocketObservations,
    TiltObservations as TiltObservations,
    tracker_covariance as tracker_covariance,
)
from .model.measurements import (
    Measurements as Measurements,
    random_joints as random_joints,
    simulated_tracker as simulated_tracker,
)
from .model.observations import Observations as Observations
from .pipeline.apply import apply_calibration as apply_calibration
from .pipeline.calibration import Calibration as Calibration
from .pipeline.fitting import Fit as Fit, fit as fit
from .pipeline.given import Choices as Choices
from .pipeline.result import Result as Result, assess as assess
from .pipeline.stages import calibrate as calibrate
from .pipeline.twin import twin as twin
from .planning.plan import plan_poses as plan_poses
from .reading.description import load_description as load_description
from .reading.read import (
    read_measurements as read_measurements,
    read_observations as read_observations,
    read_targets as read_targets,
)
from .residuals.bpnn import Bpnn as Bpnn, BpnnSettings as BpnnSettings, train_bpnn as train_bpnn
