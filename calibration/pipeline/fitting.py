"""Calibrating an arm: align base and tool, identify the geometry and its terms, learn what remains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pickenv.arm import Arm
from pickenv.calibration.identification.alignment import align, refuse_another_arm
from pickenv.calibration.identification.least_squares import Identification, identify_surely
from pickenv.calibration.model.arm_model import ArmModel, Term
from pickenv.calibration.model.error_model import frames_model, geometric_model, with_terms
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.residuals.bpnn import BpnnSettings, train_bpnn
from pickenv.calibration.residuals.residual_models import PERIODIC_SPAN, LearntResidual, fit_residual
from pickenv.provenance import versions


@dataclass(frozen=True, eq=False)
class Fit:
    """A calibration together with how it was found.

    Attributes:
        calibration: The result.
        identification: Evidence of the least-squares stage.
        aligned: Evidence of the base and tool fit, where they were unknown.
    """

    calibration: Calibration
    identification: Identification
    aligned: Identification | None


def fit(
    arm: Arm,
    measurements: Measurements,
    residual_measurements: Measurements | None = None,
    *,
    known_frames: bool = False,
    terms: tuple[Term, ...] = (),
    residual: str = "bpnn",
    rng: np.random.Generator | None = None,
    settings: BpnnSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Calibrate an arm: least squares on geometry and terms, then, if data are given, a residual model on what remains.

    Args:
        arm: The arm.
        measurements: Poses for the identification (the paper: 100).
        residual_measurements: Poses for the network (the paper: 200), or None for geometry alone.
        known_frames: True if the instrument measures the arm's own tool in the arm's own base frame (registered, or
            simulated); then the paper's 24 parameters are identified. Else base, tool and Hayati's beta are fitted too,
            and what the arm does in its own base frame stays unknown.
        terms: Parametric non-geometric effects to identify with the geometry.
        residual: Residual model by name: "bpnn", "rbf", "gp" or "trees".
        rng: Seeds the residual model; needed with ``residual_measurements``.
        settings: Settings of the network "bpnn"; the paper's when left out.
        progress: Called with (epochs done, epochs in all).

    Raises:
        InputError: If there are too few poses, the data do not fit the arm, or the identification does not converge.
    """
    aligned = None
    nominal = arm.nominal
    model = geometric_model(nominal, known_frames)
    if not known_frames:
        aligned = align(nominal, measurements, frames_model(nominal))
        nominal = aligned.geometry
    else:
        refuse_another_arm(nominal, measurements, "with base and tool taken as known")
    start = ArmModel.of(nominal, terms)
    found = identify_surely(with_terms(model, start), start, measurements)
    learnt: LearntResidual | None = None
    trained: dict[str, Any] | None = None
    if residual_measurements is not None:
        if rng is None:
            raise ValueError("give rng, which seeds the residual model")
        trained = {
            "kind": residual,
            "data_fingerprint": residual_measurements.fingerprint(),
            "poses": len(residual_measurements),
            "settings": asdict(settings or BpnnSettings()) if residual == "bpnn" else None,
            "generator": _generator_state(rng),
        }
        learnt = _learn(residual, found, residual_measurements, rng, settings, progress)
    record = {
        "source": measurements.source,
        "data_fingerprint": measurements.fingerprint(),
        "poses": len(measurements),
        "kind": measurements.kind,
        "frames": "known" if known_frames else "fitted",
        "rank": found.identifiability.rank,
        "dropped": {item.name: item.absorbed_by for item in found.identifiability.dropped},
        "residual": trained,
        "versions": versions("scipy", *(("torch", "scikit-learn") if trained else ())),
    }
    calibration = Calibration(arm.name, arm.nominal, nominal, found.arm_model, learnt, record)
    return Fit(calibration, found, aligned)


def _learn(
    kind: str,
    found: Identification,
    measurements: Measurements,
    rng: np.random.Generator,
    settings: BpnnSettings | None,
    progress: Callable[[int, int], None] | None,
) -> LearntResidual:
    """A model of what the identified arm leaves (eq (17)); recorded conditions are inputs beside the joints."""
    targets = measurements.difference(found.arm_model)
    fitter = None
    if kind == "bpnn":
        chosen = settings or BpnnSettings()
        fitter = lambda inputs, values, generator: train_bpnn(inputs, values, generator, chosen, progress)  # noqa: E731
    return fit_residual(
        kind,
        measurements.joints,
        targets,
        measurements.prismatic,
        rng,
        conditions=measurements.conditions.inputs(),
        fitter=fitter,
        periodic_span=np.inf if kind == "bpnn" else PERIODIC_SPAN,  # the paper's network takes the joints as they are
    )


def _generator_state(rng: np.random.Generator) -> Any:
    """The generator's state as it stands, in plain numbers: what reproduces the network to the bit."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

    return plain(rng.bit_generator.state)
