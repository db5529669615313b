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
from pickenv.calibration.model.observations import nearest_rotation
from pickenv.calibration.model.splits import Rows
from pickenv.errors import InputError

OUTLIER_SIGMA = 10.0
"""A pose off by more robust standard deviations than this is an outlier; what a model leaves out stays below it."""

WEIGHTINGS, SELECTIONS, FOURS = 30, 10, 500
"""Least squares at most, alignments at most, and fours of poses that are tried."""

MEDIAN_NORM = float(np.sqrt(2.0 * gammaincinv(1.5, 0.5)))
"""Median norm of three independent standard normal numbers, 1.538."""

LOSSES: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {
        "huber": lambda size: np.minimum(1.0, 1.345 / np.maximum(size, 1e-12)),
        "cauchy": lambda size: 1.0 / (1.0 + (size / 2.385) ** 2),
    }
)
"""Weight of a pose by its size in standard deviations per coordinate; constants for 95 % efficiency on normal noise."""


@dataclass(frozen=True, eq=False)
class RobustIdentification:
    """An identification with the weights it ended at.

    Attributes:
        identification: The last weighted least squares.
        weights: Weight of each pose ``(N,)`` in it, 0 to 1.
        sizes: Sizes of the errors that it leaves.
        settled: Whether the weights stopped changing.
    """

    identification: Identification
    weights: Array
    sizes: Sizes
    settled: bool

    @property
    def geometry(self) -> Geometry:
        """The identified geometry."""
        return self.identification.geometry

    def sizes_of(self, measurements: Measurements) -> Sizes:
        """Sizes of the errors of any rows by this arm's identified model, in the standard deviations found here."""
        return sizes_of(self.identification.arm_model, measurements, self.sizes)


def robust_identify(
    model: ErrorModel,
    start: Geometry | ArmModel,
    measurements: Measurements,
    *,
    loss: str = "cauchy",
) -> RobustIdentification:
    """Identify with iteratively re-weighted least squares; the first weights come from the starting geometry.

    Args:
        model: The parameters.
        start: Geometry, or geometry with terms; near the data (see `robust_align`).
        measurements: Poses or positions.
        loss: "huber" (an outlier keeps a bounded pull) or "cauchy" (a gross one loses all of it).

    Raises:
        InputError: If the loss is unknown, or as `identify`.
    """
    if loss not in LOSSES:
        raise InputError(f"unknown loss '{loss}'; give one of {', '.join(LOSSES)}")
    weights = sizes_of(ArmModel.of(start), measurements).weights(loss)
    for _ in range(WEIGHTINGS):
        factors = np.repeat(np.sqrt(weights), measurements.rows_per_pose)
        found = identify(model, start, measurements, row_factors=factors)
        sizes = sizes_of(found.arm_model, measurements)
        used, weights = weights, sizes.weights(loss)
        settled = bool(np.max(np.abs(weights - used)) < 1e-3)
        if settled:
            break
    return RobustIdentification(found, used, sizes, settled)


def robust_align(
    geometry: Geometry,
    measurements: Measurements,
    frames: ErrorModel,
    rng: np.random.Generator,
) -> RobustIdentification:
    """`align` for data with gross errors: base and tool from the poses that agree with each other.

    Base poses are tried from random fours of positions; the one with the smallest median error shows the gross errors
    (random sample consensus with the least median of squares, Rousseeuw 1984). Then `align` on the rest, repeated.

    Args:
        geometry: The arm.
        measurements: Poses or positions, from anywhere.
        frames: Base and tool parameters (`frames_model`).
        rng: Draws the fours.

    Raises:
        InputError: As `align`.
    """
    count = len(measurements)
    if count < 8:
        raise InputError(f"{measurements.source}: {count} poses are too few to tell outliers; measure at least 8")
    nominal, measured = forward(geometry, measurements.joints).position, measurements.position
    rows = np.argsort(rng.random((FOURS, count)), axis=1)[:, :4]
    missed = _registered_misses(nominal, measured, rows)
    best = missed[np.argmin(np.median(missed, axis=1))]
    kept = best <= 5.0 * np.median(best)
    for _ in range(SELECTIONS):
        found = align(geometry, measurements.select(kept), frames)
        sizes = sizes_of(found.arm_model, measurements)
        used, kept = kept, sizes.sigma <= OUTLIER_SIGMA
        settled = bool(np.array_equal(used, kept))
        if settled:
            break
    return RobustIdentification(found, used.astype(float), sizes, settled)


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

    @property
    def outliers(self) -> Rows:
        """Rows beyond `OUTLIER_SIGMA`, the largest first."""
        order = np.argsort(-self.sigma, kind="stable")
        return order[self.sigma[order] > OUTLIER_SIGMA]

    def weights(self, loss: str) -> Array:
        """Weights ``(N,)`` by the size per coordinate."""
        squares = np.sum(np.square(self._parts), axis=0) / (3 * len(self._parts))
        return LOSSES[loss](np.sqrt(squares))


def sizes_of(arm: ArmModel, measurements: Measurements, like: Sizes | None = None) -> Sizes:
    """Sizes in the standard deviations of others, or in robust ones, never below the instrument's own uncertainty."""
    left = measurements.difference(arm)
    sizes = [np.linalg.norm(part, axis=1) for part in np.split(left, [3], axis=1)]
    position, attitude = (0.0, None) if like is None else (like.position_scale, like.attitude_scale)
    if like is None:
        stated = (measurements.position_std, measurements.attitude_std)
        scales = [max(float(np.median(size)) / MEDIAN_NORM, std) for size, std in zip(sizes, stated, strict=True)]
        position, attitude = scales[0], scales[1]
    if measurements.rotation is None or attitude is None:
        return Sizes(sizes[0], None, position, None)
    return Sizes(sizes[0], sizes[1], position, attitude)


def _registered_misses(nominal: Array, measured: Array, rows: Rows) -> Array:
    """Distances ``(T, N)`` of measured points from nominal ones after T rigid registrations of few rows (Kabsch)."""
    here, there = nominal[rows], measured[rows]
    from_, to = here.mean(axis=1, keepdims=True), there.mean(axis=1, keepdims=True)
    turn = nearest_rotation(np.swapaxes(here - from_, 1, 2) @ (there - to))  # row vectors: point @ turn
    return np.asarray(np.linalg.norm((nominal - from_) @ turn + to - measured, axis=2))
