"""Rows of data sets of any kind: choosing some, splitting them for judgement, and what a model misses them by."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.observations import (
    DistanceObservations,
    Observations,
    PoseObservations,
    ReflectorObservations,
    SocketObservations,
)
from pickenv.calibration.model.origins import origins_of
from pickenv.calibration.model.splits import Rows, blocked_split, random_split
from pickenv.errors import InputError


def select(observations: Observations, rows: NDArray[np.int64]) -> Observations:
    """Some rows of a data set of any kind."""
    if isinstance(observations, PoseObservations):
        return PoseObservations(observations.measurements.select(rows))
    if not isinstance(observations, ReflectorObservations | DistanceObservations | SocketObservations):
        raise TypeError(f"rows of {type(observations).__name__} cannot be selected")
    common: dict[str, Any] = {
        "joints": observations.joints[rows],
        "conditions": observations.conditions.select(rows),
        "origins": origins_of(observations).select(rows),
    }
    if isinstance(observations, ReflectorObservations):
        covariance = observations.covariance
        covariance = covariance[rows] if covariance.ndim > 2 else covariance
        points, seen = observations.points[rows], observations.seen[rows]
        return replace(observations, points=points, seen=seen, covariance=covariance, **common)
    if isinstance(observations, DistanceObservations):
        return replace(observations, length=observations.length[rows], **common)
    return replace(observations, socket=observations.socket[rows], **common)


def misses(observations: Observations, model: ArmModel, unknowns: Array) -> Array:
    """Measured minus predicted positions ``(R, 3)``, or lengths ``(R, 1)``, m.

    One per pose; one per reflector seen; ball to its socket's centre.
    """
    if isinstance(observations, PoseObservations):
        return observations.difference(model)[:, :3]
    if isinstance(observations, ReflectorObservations):
        return np.asarray((observations.points - observations.predict(model, unknowns))[observations.seen])
    if isinstance(observations, DistanceObservations):
        return np.asarray(observations.residual(model, unknowns)[:, None] * observations.std)
    if isinstance(observations, SocketObservations):
        rest = observations.residual(model, unknowns)[: 3 * len(observations.joints)]
        return np.asarray(rest.reshape(-1, 3) * observations.std)
    raise TypeError(f"{type(observations).__name__} has no position errors")


def rows_of_misses(observations: Observations) -> Rows:
    """The row that each of `misses` belongs to ``(R,)``."""
    if isinstance(observations, ReflectorObservations):
        return np.nonzero(observations.seen)[0]
    return np.arange(len(observations.joints))


def unknowns_of(found: Identification, observations: Observations) -> Array:
    """The identified values of a data set's own unknowns."""
    return np.array([found.unknowns[name] for name in observations.unknowns()])


def blocks(observations: Observations, folds: int) -> list[tuple[Rows, Rows]]:
    """Contiguous folds of the rows, each socket's by itself: for each, the training and the held-out rows."""
    socket = observations.socket if isinstance(observations, SocketObservations) else np.zeros(len(observations.joints))
    fold = np.zeros(len(socket), dtype=int)
    for number in np.unique(socket):
        rows = np.flatnonzero(socket == number)
        for i, part in enumerate(np.array_split(rows, folds)):
            fold[part] = i
    return [(np.flatnonzero(fold != i), np.flatnonzero(fold == i)) for i in range(folds)]


def choose(
    observations: Observations, split: str, test_rows: int | None, rng: np.random.Generator
) -> tuple[Rows, Rows]:
    """Training and held-out rows of one data set; sockets are split one by one, so that each is trained on.

    Args:
        observations: The data.
        split: "random" or "blocked".
        test_rows: Rows to hold out; a fifth when left out.
        rng: Draws the random split.

    Raises:
        InputError: If the split is unknown or impossible.
    """
    if split not in ("random", "blocked"):
        raise InputError(f"split is '{split}'; give random or blocked")
    count = len(observations.joints)
    wanted = max(1, count // 5) if test_rows is None else test_rows
    if not isinstance(observations, SocketObservations):
        return random_split(count, wanted, rng) if split == "random" else blocked_split(count, wanted)
    train, test = [], []
    for socket in range(int(observations.socket.max()) + 1):
        rows = np.flatnonzero(observations.socket == socket)
        share = max(1, round(wanted * len(rows) / count))
        if len(rows) - share < 2:
            raise InputError(
                f"{observations.source}: socket {socket + 1} has {len(rows)} rows, too few to hold {share} of them out"
            )
        here, there = random_split(len(rows), share, rng) if split == "random" else blocked_split(len(rows), share)
        train.append(rows[here])
        test.append(rows[there])
    return np.concatenate(train), np.concatenate(test)
