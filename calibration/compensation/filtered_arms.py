"""Arms that are followed by a Kalman filter each: where to aim, and what a look at the tool teaches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pickenv.arm import Geometry
from pickenv.arm.effects.measurement_noise import MeasurementNoise
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.compensation.compensator import Compensator
from pickenv.calibration.identification.extended_kalman_filter import FilterState, predict, random_walk, update


def aimed(nominal: Geometry, filters: Sequence[FilterState], joints: Array) -> Array:
    """Joints ``(N, n)`` that bring each arm, as its filter knows it, to the nominal arm's place at ``joints``."""
    rows = (Compensator(nominal, state.geometry)(row) for state, row in zip(filters, joints, strict=True))
    return np.stack(list(rows))


def taught(
    filters: Sequence[FilterState],
    joints: Array,
    seen: Array,
    noise: MeasurementNoise,
    wander: float,
    seconds: float,
) -> list[FilterState]:
    """Filters after a pause and a look.

    Args:
        filters: One per arm.
        joints: Joints ``(N, n)`` that the arms were sent to.
        seen: Where their tools were seen ``(N, 3)``, m.
        noise: Of the look, with what a geometry cannot explain.
        wander: Tolerances per root hour by which every parameter may have wandered.
        seconds: Time since the look before.
    """
    return [
        update(predict(state, random_walk(state, wander), seconds), q, at, noise)
        for state, q, at in zip(filters, joints, seen, strict=True)
    ]
