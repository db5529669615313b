"""The figures of the demonstration's run folder, by file name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from calibration import Bpnn
from calibration.error_model import residual
from pickenv.inspect import figures
from pickenv.inspect.field_figure import error_fields

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pickenv.demo import DemoResult


def demo_figures(result: DemoResult) -> dict[str, Callable[[], Figure]]:
    """For each file name (without suffix), the function that draws it."""
    from pickenv.demo import LABELS

    found = result.fit.identification
    spectrum = found.identifiability
    learnt = result.fit.calibration.learnt
    assert learnt is not None and isinstance(learnt.model, Bpnn)
    loss = learnt.model.loss
    sets = {
        "identification": result.identification.joints,
        "network": result.network.joints,
        "test": result.test.joints,
    }
    test_mm = {LABELS[key]: np.linalg.norm(e[:, :3], axis=1) * 1e3 for key, e in result.test_errors.items()}
    reach_mm = {LABELS[key]: run.position_error_mm for key, run in result.reaches.items()}
    reach_deg = {LABELS[key]: run.attitude_error_deg for key, run in result.reaches.items()}
    left = [residual(model.geometry, result.identification) for model in found.iterates]
    position = [_rms(error[:, :3]) * 1e3 for error in left]
    attitude = [np.degrees(_rms(error[:, 3:])) for error in left]
    kept = np.isin(np.arange(len(spectrum.names)), spectrum.kept)
    return {
        "error_fields": lambda: error_fields(result.comparison),
        "error_per_test_pose": lambda: figures.error_per_pose(test_mm),
        "position_error_by_policy": lambda: figures.error_by_method(reach_mm),
        "attitude_error_by_policy": lambda: figures.error_by_method(reach_deg, quantity="attitude error", unit="deg"),
        "least_squares_convergence": lambda: figures.least_squares_convergence(position, attitude),
        "network_convergence": lambda: figures.network_convergence(loss),
        "parameter_spectrum": lambda: figures.parameter_spectrum(spectrum.r_diagonal, kept, names=spectrum.names),
        "joint_coverage": lambda: figures.joint_coverage(result.plant.arm.nominal, sets),
    }


def _rms(errors: np.ndarray) -> float:
    """RMS of the norms of error vectors ``(N, 3)``."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
