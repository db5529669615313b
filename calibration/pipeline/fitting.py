"""Fitting an arm to data of any kind: base and tool, then geometry and terms, then what remains.

The middle of the one way from rows to a result (`calibrate`), for whoever holds rows that need no check and no verdict.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pickenv.arm import Arm, forward
from pickenv.calibration.identification.alignment import MISFIT, SPAN, align, refuse_another_arm
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.identification.starts import rough_start
from pickenv.calibration.model.arm_model import ArmModel, Term
from pickenv.calibration.model.error_model import frames_model
from pickenv.calibration.model.kinds.sockets import SocketObservations
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import MISS_UNITS, Observations
from pickenv.calibration.model.prior import PriorModel, prior_model
from pickenv.calibration.model.terms import kind_of_term
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.residuals.bpnn import BpnnSettings, train_bpnn
from pickenv.calibration.residuals.residual_models import PERIODIC_SPAN, fit_residual
from pickenv.errors import InputError
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
    data: Observations,
    residual_measurements: Measurements | None = None,
    *,
    known_frames: bool = False,
    terms: tuple[Term, ...] = (),
    residual: str = "bpnn",
    rng: np.random.Generator | None = None,
    settings: BpnnSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Fit an arm as the papers do: least squares without priors, then a residual model on what remains.

    Args:
        arm: The arm.
        data: Rows for the identification (the paper: 100), of any kind.
        residual_measurements: Poses for the network (the paper: 200), or None for geometry alone.
        known_frames: True if the instrument measures the arm's own tool in the arm's own base frame (registered, or
            simulated); then the paper's 24 parameters are identified. Else base, tool and Hayati's beta are fitted too,
            and what the arm does in its own base frame stays unknown.
        terms: Parametric non-geometric effects to identify with the geometry.
        residual: Residual model by name: "bpnn", "rbf" or "gp".
        rng: Seeds the residual model; needed with ``residual_measurements``.
        settings: Settings of the network "bpnn"; the paper's when left out.
        progress: Called with (epochs done, epochs in all).

    Raises:
        InputError: If there are too few rows, the data do not fit the arm, or the identification does not converge.
    """
    aligned = fit_frames(arm, data, known_frames)
    start = arm.nominal if aligned is None else aligned.geometry
    model = prior_model(arm.name, start, known=known_frames, fit="full").with_terms(terms)
    model = replace(model, std=np.full(len(model.std), np.inf))  # coefficients of terms among them
    found = fit_geometry(arm, data, aligned, model)
    if residual_measurements is None:
        return found
    if rng is None:
        raise ValueError("give rng, which seeds the residual model")
    settings = (settings or BpnnSettings()) if residual == "bpnn" else None
    return fit_remainder(found, residual, residual_measurements, rng, settings, progress)


def fit_frames(arm: Arm, data: Observations, known: bool) -> Identification | None:
    """Base and tool, fitted from anywhere with the data's own unknowns; None where they are known.

    Raises:
        InputError: If the data do not fit the arm.
    """
    nominal = arm.nominal
    if isinstance(data, Measurements):
        if not known:
            return align(nominal, data, frames_model(nominal))
        refuse_another_arm(nominal, data, "with base and tool taken as known")
        return None
    found = identify(frames_model(nominal), ArmModel.of(rough_start(nominal, data)), [data], max_iterations=100)
    _refuse_misfit(found, data)
    return found


def fit_geometry(arm: Arm, data: Observations, aligned: Identification | None, model: PriorModel) -> Fit:
    """Geometry and terms, from where `fit_frames` left base and tool.

    Args:
        arm: The arm.
        data: The rows.
        aligned: Evidence of the base and tool fit; None where they are known.
        model: What is fitted, with its priors (`pickenv.calibration.model.prior.prior_model`).

    Raises:
        InputError: If there are too few rows for parameters without priors, or it does not converge.
    """
    found = solve(model, data)
    if not found.converged:
        raise InputError(f"{data.source}: the identification did not converge; measure more varied poses")
    record = {
        "source": data.source,
        "poses": len(data.joints),
        "data_fingerprint": data.fingerprint(),
        "kind": data.kind,
        "joint_ranges": [data.joints.min(axis=0).tolist(), data.joints.max(axis=0).tolist()],
        "frames": "known" if aligned is None else "fitted",
        "rank": found.identifiability.rank,
        "dropped": {item.name: item.absorbed_by for item in found.identifiability.dropped},
        "prior": model.source,
        "terms": sorted(kind_of_term(term) for term in model.start.terms),
        "residual": None,
        "versions": versions("scipy"),
    }
    if found.unknowns:
        record["unknowns"] = found.unknowns
    nominal = arm.nominal if aligned is None else aligned.geometry
    return Fit(Calibration(arm.name, arm.nominal, nominal, found.arm_model, None, record), found, aligned)


def fit_remainder(
    found: Fit,
    kind: str,
    data: Measurements,
    rng: np.random.Generator,
    settings: BpnnSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """The fit with a model of what it leaves (eq (17)); recorded conditions are inputs beside the joints.

    Args:
        found: The fit.
        kind: Residual model by name.
        data: Poses to learn from.
        rng: Seeds the model.
        settings: The paper's network with these settings, which takes the joints as they are; else, as the other models
            do, it takes sine and cosine of joints that turn far, and thins rows where there are very many.
        progress: Called with (epochs done, epochs in all).
    """
    record = {
        "kind": kind,
        "data_fingerprint": data.fingerprint(),
        "poses": len(data),
        "settings": None if settings is None else asdict(settings),
        "generator": _generator_state(rng),
    }
    paper = None if settings is None else partial(train_bpnn, settings=settings, progress=progress)
    model = fit_residual(
        kind,
        data.joints,
        data.difference(found.calibration.model),
        data.prismatic,
        rng,
        conditions=data.conditions.inputs(),
        fitter=paper,
        periodic_span=PERIODIC_SPAN if paper is None else np.inf,
    )
    whole = {**found.calibration.record, "residual": record, "versions": versions("scipy", "torch")}
    return replace(found, calibration=replace(found.calibration, learnt=model, record=whole))


def _refuse_misfit(found: Identification, data: Observations) -> None:
    """Refuse wires and sockets that even after the frames' fit miss by a large share of what they span."""
    left = data.misses(found.arm_model, unknowns_of(found, data))
    rms = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    tool = forward(found.geometry, data.joints).position
    span = float(np.linalg.norm(tool.std(axis=0)))
    if isinstance(data, SocketObservations):
        span = float(np.linalg.norm(tool - tool.mean(axis=0), axis=1).max())
    if data.miss_unit == "deg":
        span = 1.0
    if rms > MISFIT * max(span, SPAN):
        missed = f"{rms * MISS_UNITS[data.miss_unit]:.0f} {data.miss_unit}"
        raise InputError(
            f"{data.source}: after fitting the frames the arm still misses by {missed} RMS; check the arm, the units, "
            "the joint order and signs, and which row belongs to what"
        )


def _generator_state(rng: np.random.Generator) -> Any:
    """The generator's state as it stands, in plain numbers: what reproduces the network to the bit."""
    numbers: Any = json.loads(json.dumps(rng.bit_generator.state, default=lambda value: value.tolist()))
    return numbers
