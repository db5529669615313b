"""Calibration: identify an arm from measurements, learn what remains, judge it, and correct its commands.

`calibrate` is the whole way, from files or arrays to a `Result`. Usable without Gymnasium; imports only `pickenv.arm`.
torch is loaded when a network is trained, not before.
"""

from pickenv.calibration.assessment.metrics import (
    ErrorStatistics,
    bootstrap_interval,
    error_statistics,
    held_out_r2,
    paper_eta,
)
from pickenv.calibration.compensation.compensator import Compensator
from pickenv.calibration.identification.alignment import align
from pickenv.calibration.identification.extended_kalman_filter import (
    continue_filter,
    filter_measurements,
    offset_walk,
    random_walk,
    start_filter,
    thermal_walk,
)
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.model.error_model import complete_model, frames_model, link_model
from pickenv.calibration.model.identifiability import Identifiability, identifiability
from pickenv.calibration.model.measurements import Measurements, random_joints, simulated_tracker
from pickenv.calibration.model.observations import (
    DistanceObservations,
    Observations,
    ReflectorObservations,
    SocketObservations,
    poses_from_reflectors,
    tracker_covariance,
)
from pickenv.calibration.pipeline.apply import apply_calibration
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.export import export, write_arm_toml, write_arm_urdf, write_onnx
from pickenv.calibration.pipeline.fitting import Fit, fit
from pickenv.calibration.pipeline.result import Result, assess
from pickenv.calibration.pipeline.stages import Choices, calibrate
from pickenv.calibration.planning.plan import plan_poses
from pickenv.calibration.reading.description import load_description
from pickenv.calibration.reading.read import read_measurements, read_observations
from pickenv.calibration.reading.targets import read_targets
from pickenv.calibration.residuals.bpnn import Bpnn, BpnnSettings, train_bpnn

__all__ = [
    "Bpnn",
    "BpnnSettings",
    "Calibration",
    "Choices",
    "Compensator",
    "DistanceObservations",
    "ErrorStatistics",
    "Fit",
    "Identifiability",
    "Identification",
    "Measurements",
    "Observations",
    "ReflectorObservations",
    "Result",
    "SocketObservations",
    "align",
    "apply_calibration",
    "assess",
    "bootstrap_interval",
    "calibrate",
    "complete_model",
    "continue_filter",
    "error_statistics",
    "export",
    "filter_measurements",
    "fit",
    "frames_model",
    "held_out_r2",
    "identifiability",
    "identify",
    "link_model",
    "load_description",
    "offset_walk",
    "paper_eta",
    "plan_poses",
    "poses_from_reflectors",
    "random_joints",
    "random_walk",
    "read_measurements",
    "read_observations",
    "read_targets",
    "simulated_tracker",
    "start_filter",
    "thermal_walk",
    "tracker_covariance",
    "train_bpnn",
    "write_arm_toml",
    "write_arm_urdf",
    "write_onnx",
]

if __name__ == "calibration":  # in a checkout, by the folder's own name: the same things, and no second copy of a shelf
    __path__.clear()
