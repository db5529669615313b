"""Calibrating from reflectors, wires and sockets: align, fit the frames, then everything with the data's unknowns."""

from __future__ import annotations

import numpy as np

from pickenv.arm import Arm, Geometry, forward
from pickenv.calibration.identification.alignment import MISFIT, align, refuse_another_arm
from pickenv.calibration.identification.least_squares import Identification, identify, identify_surely
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import complete_model, frames_model
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, ReflectorObservations, SocketObservations
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.fitting import Fit
from pickenv.errors import InputError


def fit_kind(arm: Arm, observations: Observations) -> Fit:
    """Base and tool, then the whole geometry, with the data's own unknowns in both.

    Raises:
        InputError: If there are too few rows, the data do not fit the arm, or the identification does not converge.
    """
    start = ArmModel.of(starting_geometry(arm, observations))
    framed = identify(frames_model(arm.nominal), start, [observations], max_iterations=100)
    _refuse_misfit(framed, observations)
    found = identify_surely(complete_model(arm.nominal), framed.arm_model, [observations])
    record = {
        "source": observations.source,
        "poses": len(observations.joints),
        "kind": observations.kind,
        "frames": "fitted",
        "rank": found.identifiability.rank,
        "dropped": {item.name: item.absorbed_by for item in found.identifiability.dropped},
        "unknowns": found.unknowns,
        "residual": None,
    }
    calibration = Calibration(arm.name, arm.nominal, framed.geometry, found.arm_model, None, record)
    return Fit(calibration, found, framed)


def starting_geometry(arm: Arm, observations: Observations) -> Geometry:
    """Where to start: the reflector seen most often gives the base; wires and sockets need none."""
    if not isinstance(observations, ReflectorObservations):
        return arm.nominal
    which = int(np.argmax(observations.seen.sum(axis=0)))
    rows = observations.seen[:, which]
    one = Measurements(
        observations.joints[rows],
        observations.points[rows, which],
        None,
        arm.nominal.prismatic,
        source=observations.source,
    )
    aligned = align(arm.nominal, one, frames_model(arm.nominal), judge=False).geometry
    refuse_another_arm(aligned, one, f"after fitting base and reflector {which + 1}", arm.nominal)
    return aligned


def _refuse_misfit(framed: Identification, observations: Observations) -> None:
    """Refuse wires and sockets that even after the frames' fit miss by a large share of what they span."""
    left = observations.misses(framed.arm_model, unknowns_of(framed, observations))
    rms = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    tool = forward(framed.geometry, observations.joints).position
    span = float(np.linalg.norm(tool.std(axis=0)))
    if isinstance(observations, SocketObservations):
        span = float(np.linalg.norm(tool - tool.mean(axis=0), axis=1).max())
    if rms > MISFIT * max(span, 0.1):
        raise InputError(
            f"{observations.source}: after fitting the frames the arm still misses by {rms * 1e3:.0f} mm RMS; check "
            "the arm, the units, the joint order and signs, and which row belongs to what"
        )
