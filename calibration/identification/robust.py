"""Identification that outliers cannot pull: iteratively re-weighted least squares, and a list of the outliers.

Each pose gets one weight from a Huber or Cauchy loss of its size in robust standard deviations (median based, so that
nearly half of the poses may be wrong; Holland and Welsch 1977). Metres and radians are scaled apart. SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.special import gammaincinv

from pickenv.arm import Geometry, forward
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.alignment import align
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import ErrorModel
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.splits import Rows
from pickenv.errors import InputError

OUTLIER_SIGMA = 10.0
"""A pose off by more robust standard deviations than this is an outlier; what a model leaves out stays below it."""

MEDIAN_NORM = float(np.sqrt(2.0 * gammaincinv(1.5, 0.5)))
"""Median norm of three independent standard normal numbers, 1.538."""

LOSSES: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {
        "huber": lambda size: np.minimum(1.0, 1.345 / np.maximum(size, 1e-12)),
        "cauchy": lambda size: 1.0 / (1.0 + (size / 2.385) ** 2),
    }
)
"""Weight of a pose by its size in standard deviations per coordinate; constants for 95 % efficiency on normal noise."""


@dataclass(frozen=True)
class Outlier:
    """A pose that does not fit.

    Attributes:
        row: Row of the data set, counted from 0.
        position: Size of its position error, m.
        attitude: Size of its attitude error, rad; None where only positions were measured.
        sigma: The larger of both in robust standard deviations of one coordinate.
        weight: Weight that it was left with.
    """

    row: int
    position: float
    attitude: float | None
    sigma: float
    weight: float


@dataclass(frozen=True, eq=False)
class RobustIdentification:
    """An identification with the weights it ended at.

    Attributes:
        identification: The last weighted least squares.
        weights: Weight of each pose ``(N,)``, 0 to 1.
        outliers: Poses that do not fit, largest first.
        position_scale: Robust standard deviation of one position coordinate, m.
        attitude_scale: Robust standard deviation of one attitude coordinate, rad; None for positions.
        rounds: Least squares solved.
        settled: Whether the weights stopped changing.
    """

    identification: Identification
    weights: Array
    outliers: tuple[Outlier, ...]
    position_scale: float
    attitude_scale: float | None
    rounds: int
    settled: bool

    @property
    def geometry(self) -> Geometry:
        """The identified geometry."""
        return self.identification.geometry

    @property
    def inliers(self) -> Array:
        """Rows that are no outliers, in order."""
        return np.setdiff1d(np.arange(len(self.weights)), [outlier.row for outlier in self.outliers])

    def sizes(self, measurements: Measurements) -> Sizes:
        """Sizes of the errors of any rows by this arm's identified model, in the standard deviations found here."""
        return _sizes(self.identification.arm_model, measurements, (self.position_scale, self.attitude_scale))


def robust_identify(
    model: ErrorModel,
    start: Geometry | ArmModel,
    measurements: Measurements,
    *,
    loss: str = "cauchy",
    sigma: float = OUTLIER_SIGMA,
    max_rounds: int = 30,
) -> RobustIdentification:
    """Identify with iteratively re-weighted least squares; the first weights come from the starting geometry.

    Args:
        model: The parameters.
        start: Geometry, or geometry with terms; near the data (see `robust_align`).
        measurements: Poses or positions.
        loss: "huber" (an outlier keeps a bounded pull) or "cauchy" (a gross one loses all of it).
        sigma: Poses beyond this many robust standard deviations are listed as outliers.
        max_rounds: Least squares at most.

    Raises:
        InputError: If the loss is unknown, or as `identify`.
    """
    if loss not in LOSSES:
        raise InputError(f"unknown loss '{loss}'; give one of {', '.join(LOSSES)}")
    arm = ArmModel.of(start)
    weights = _judged(arm, measurements).weights(loss)
    settled, rounds = False, 0
    while True:
        rounds += 1
        found = identify(model, arm, measurements, row_factors=_row_factors(weights, measurements))
        judged = _judged(found.arm_model, measurements)
        previous, weights = weights, judged.weights(loss)
        settled = bool(np.max(np.abs(weights - previous)) < 1e-3)
        if settled or rounds == max_rounds:
            break
    return _result(found, judged, previous, sigma, rounds, settled)


def robust_align(
    geometry: Geometry,
    measurements: Measurements,
    frames: ErrorModel,
    rng: np.random.Generator,
    *,
    trials: int = 500,
    sigma: float = OUTLIER_SIGMA,
    max_rounds: int = 10,
) -> RobustIdentification:
    """`align` for data with gross errors: base and tool from the poses that agree with each other.

    Base poses are tried from random fours of positions; the one with the smallest median error shows the gross errors
    (random sample consensus with the least median of squares, Rousseeuw 1984). Then `align` on the rest, repeated.

    Args:
        geometry: The arm.
        measurements: Poses or positions, from anywhere.
        frames: Base and tool parameters (`frames_model`).
        rng: Draws the fours.
        trials: Fours tried.
        sigma: Poses beyond this many robust standard deviations take no part.
        max_rounds: Repetitions at most.

    Raises:
        InputError: As `align`.
    """
    count = len(measurements)
    if count < 8:
        raise InputError(f"{measurements.source}: {count} poses are too few to tell outliers; measure at least 8")
    nominal, measured = forward(geometry, measurements.joints).position, measurements.position
    rows = np.argsort(rng.random((trials, count)), axis=1)[:, :4]
    missed = _registered_misses(nominal, measured, rows)
    best = missed[np.argmin(np.median(missed, axis=1))]
    kept = best <= 5.0 * np.median(best)
    settled, rounds = False, 0
    while True:
        rounds += 1
        found = align(geometry, measurements.select(kept), frames)
        judged = _judged(found.arm_model, measurements)
        used, kept = kept, judged.sigma <= sigma
        settled = bool(np.array_equal(used, kept))
        if settled or rounds == max_rounds:
            break
    return _result(found, judged, used.astype(float), sigma, rounds, settled)


@dataclass(frozen=True, eq=False)
class Sizes:
    """Sizes of the errors of N poses.

    Attributes:
        position: Of the positions ``(N,)``, m.
        attitude: Of the attitudes ``(N,)``, rad; None where only positions were measured.
        position_scale: Standard deviation of one position coordinate, m.
        attitude_scale: Of one attitude coordinate, rad.
    """

    position: Array
    attitude: Array | None
    position_scale: float
    attitude_scale: float | None

    @property
    def _parts(self) -> list[Array]:
        parts = [self.position / self.position_scale]
        if self.attitude is not None and self.attitude_scale is not None:
            parts.append(self.attitude / self.attitude_scale)
        return parts

    @property
    def sigma(self) -> Array:
        """The larger of position and attitude error, in standard deviations of one coordinate ``(N,)``."""
        return np.asarray(np.max(self._parts, axis=0))

    def weights(self, loss: str) -> Array:
        """Weights ``(N,)`` by the size per coordinate."""
        squares = np.sum(np.square(self._parts), axis=0) / (3 * len(self._parts))
        return LOSSES[loss](np.sqrt(squares))


def _judged(arm: ArmModel, measurements: Measurements) -> Sizes:
    """Sizes of the residuals in their own robust standard deviations."""
    return _sizes(arm, measurements, None)


def _sizes(arm: ArmModel, measurements: Measurements, scales: tuple[float, float | None] | None) -> Sizes:
    """Sizes in given standard deviations, or robust ones that never fall below the instrument's own uncertainty."""
    left = measurements.difference(arm)
    position = np.linalg.norm(left[:, :3], axis=1)
    attitude = None if measurements.rotation is None else np.linalg.norm(left[:, 3:], axis=1)
    if scales is None:
        position_scale = max(float(np.median(position)) / MEDIAN_NORM, measurements.position_std)
        attitude_scale = (
            None if attitude is None else max(float(np.median(attitude)) / MEDIAN_NORM, measurements.attitude_std)
        )
        scales = (position_scale, attitude_scale)
    return Sizes(position, attitude if scales[1] is not None else None, *scales)


def _row_factors(weights: Array, measurements: Measurements) -> Array:
    return np.asarray(np.repeat(np.sqrt(weights), measurements.rows_per_pose))


def _result(
    found: Identification, judged: Sizes, weights: Array, sigma: float, rounds: int, settled: bool
) -> RobustIdentification:
    sizes = judged.sigma
    rows = [int(row) for row in np.argsort(-sizes, kind="stable") if sizes[row] > sigma]
    outliers = tuple(
        Outlier(
            row=row,
            position=float(judged.position[row]),
            attitude=None if judged.attitude is None else float(judged.attitude[row]),
            sigma=float(sizes[row]),
            weight=float(weights[row]),
        )
        for row in rows
    )
    return RobustIdentification(found, weights, outliers, judged.position_scale, judged.attitude_scale, rounds, settled)


def _registered_misses(nominal: Array, measured: Array, rows: Rows) -> Array:
    """Distances ``(T, N)`` of measured points from nominal ones after T rigid registrations of few rows (Kabsch)."""
    here, there = nominal[rows], measured[rows]
    from_, to = here.mean(axis=1, keepdims=True), there.mean(axis=1, keepdims=True)
    u, _, vt = np.linalg.svd(np.swapaxes(here - from_, 1, 2) @ (there - to))
    mirror = np.ones((len(rows), 3))
    mirror[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    turn = (u * mirror[:, None, :]) @ vt  # row vectors: point @ turn
    return np.asarray(np.linalg.norm((nominal - from_) @ turn + to - measured, axis=2))
