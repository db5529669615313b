"""Calibration: identify an arm from measurements, learn what remains, and correct its commands.

Usable without Gymnasium; imports only `pickenv.arm`. torch is loaded when a network is trained, not before.
"""

from calibration.alignment import align
from calibration.bpnn import Bpnn, BpnnSettings, train_bpnn
from calibration.calibration import Calibration
from calibration.columns import read_measurements
from calibration.compensation import Compensator
from calibration.error_model import complete_model, frames_model, link_model
from calibration.fitting import Fit, fit
from calibration.identifiability import Identifiability, identifiability
from calibration.least_squares import Identification, identify
from calibration.measurements import Measurements, random_joints, simulated_tracker
from calibration.metrics import ErrorStatistics, bootstrap_interval, error_statistics, held_out_r2, paper_eta

__all__ = [
    "Bpnn",
    "BpnnSettings",
    "Calibration",
    "Compensator",
    "ErrorStatistics",
    "Fit",
    "Identifiability",
    "Identification",
    "Measurements",
    "align",
    "bootstrap_interval",
    "complete_model",
    "error_statistics",
    "fit",
    "frames_model",
    "held_out_r2",
    "identifiability",
    "identify",
    "link_model",
    "paper_eta",
    "random_joints",
    "read_measurements",
    "simulated_tracker",
    "train_bpnn",
]
