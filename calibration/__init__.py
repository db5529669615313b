"""Calibration: identify an arm from measurements, learn what remains, judge it, and correct its commands.

`calibrate` is the whole way, from files or arrays to a `Result`. Usable without Gymnasium; imports only `pickenv.arm`.
torch is loaded when a network is trained, not before.
"""

from types import ModuleType as _ModuleType

from pickenv.calibration.assessment.metrics import ErrorStatistics as ErrorStatistics
from pickenv.calibration.assessment.metrics import error_statistics as error_statistics
from pickenv.calibration.assessment.metrics import held_out_r2 as held_out_r2
from pickenv.calibration.assessment.metrics import paper_eta as paper_eta
from pickenv.calibration.compensation.compensator import Compensator as Compensator
from pickenv.calibration.delivery.export import Delivery as Delivery
from pickenv.calibration.delivery.export import Order as Order
from pickenv.calibration.delivery.export import export as export
from pickenv.calibration.delivery.export import write_onnx as write_onnx
from pickenv.calibration.delivery.joint_offsets import joint_offsets as joint_offsets
from pickenv.calibration.delivery.joint_offsets import read_lerobot as read_lerobot
from pickenv.calibration.delivery.joint_offsets import read_ros2_offsets as read_ros2_offsets
from pickenv.calibration.delivery.onto_files import write_arm_toml as write_arm_toml
from pickenv.calibration.delivery.onto_files import write_arm_urdf as write_arm_urdf
from pickenv.calibration.identification.extended_kalman_filter import continue_filter as continue_filter
from pickenv.calibration.identification.extended_kalman_filter import filter_measurements as filter_measurements
from pickenv.calibration.identification.extended_kalman_filter import offset_walk as offset_walk
from pickenv.calibration.identification.extended_kalman_filter import random_walk as random_walk
from pickenv.calibration.identification.extended_kalman_filter import start_filter as start_filter
from pickenv.calibration.identification.extended_kalman_filter import thermal_walk as thermal_walk
from pickenv.calibration.identification.least_squares import Identifiability as Identifiability
from pickenv.calibration.identification.least_squares import Identification as Identification
from pickenv.calibration.identification.least_squares import identifiability as identifiability
from pickenv.calibration.identification.least_squares import identify as identify
from pickenv.calibration.identification.robust import align as align
from pickenv.calibration.model.arm_model import complete_model as complete_model
from pickenv.calibration.model.arm_model import frames_model as frames_model
from pickenv.calibration.model.arm_model import link_model as link_model
from pickenv.calibration.model.kinds import DistanceObservations as DistanceObservations
from pickenv.calibration.model.kinds import ReflectorObservations as ReflectorObservations
from pickenv.calibration.model.kinds import SocketObservations as SocketObservations
from pickenv.calibration.model.kinds import TiltObservations as TiltObservations
from pickenv.calibration.model.kinds import tracker_covariance as tracker_covariance
from pickenv.calibration.model.measurements import Measurements as Measurements
from pickenv.calibration.model.measurements import random_joints as random_joints
from pickenv.calibration.model.measurements import simulated_tracker as simulated_tracker
from pickenv.calibration.model.observations import Observations as Observations
from pickenv.calibration.pipeline.apply import apply_calibration as apply_calibration
from pickenv.calibration.pipeline.calibration import Calibration as Calibration
from pickenv.calibration.pipeline.fitting import Fit as Fit
from pickenv.calibration.pipeline.fitting import fit as fit
from pickenv.calibration.pipeline.given import Choices as Choices
from pickenv.calibration.pipeline.result import Result as Result
from pickenv.calibration.pipeline.result import assess as assess
from pickenv.calibration.pipeline.stages import calibrate as calibrate
from pickenv.calibration.pipeline.twin import twin as twin
from pickenv.calibration.planning.plan import plan_poses as plan_poses
from pickenv.calibration.reading.description import load_description as load_description
from pickenv.calibration.reading.read import read_measurements as read_measurements
from pickenv.calibration.reading.read import read_observations as read_observations
from pickenv.calibration.reading.read import read_targets as read_targets
from pickenv.calibration.residuals.bpnn import Bpnn as Bpnn
from pickenv.calibration.residuals.bpnn import BpnnSettings as BpnnSettings
from pickenv.calibration.residuals.bpnn import train_bpnn as train_bpnn

__all__ = sorted(name for name, value in globals().items() if name[0] != "_" and not isinstance(value, _ModuleType))

if __name__ == "calibration":  # in a checkout, by the folder's own name: the same things, and no second copy of a shelf
    __path__.clear()
