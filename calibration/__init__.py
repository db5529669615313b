"""Calibration: identify an arm from measurements, learn what remains, and correct its commands.

Usable without Gymnasium; imports only `pickenv.arm`. torch is loaded when a network is trained, not before.
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
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.model.error_model import complete_model, frames_model, link_model
from pickenv.calibration.model.identifiability import Identifiability, identifiability
from pickenv.calibration.model.measurements import Measurements, random_joints, simulated_tracker
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.fitting import Fit, fit
from pickenv.calibration.reading.read import read_measurements
from pickenv.calibration.residuals.bpnn import Bpnn, BpnnSettings, train_bpnn

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

if __name__ == "calibration":  # in a checkout, by the folder's own name: the same things, and no second copy of a shelf
    __path__: list[str] = []
