"""Identification that outliers cannot pull: iteratively re-weighted least squares, and a list of the outliers.

Each row of a data set of any kind gets one weight from a Huber or Cauchy loss of its size in robust standard deviations
(median based, so that nearly half of the rows may be wrong; Holland and Welsch 1977). What one instrument reads in one
unit is a channel, and channels are scaled apart: metres and radians, a wire and a tracker. SI units.
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
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import ErrorModel
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.noise import counted
from pickenv.calibration.model.observations import Observations, nearest_rotation
from pickenv.calibration.model.splits import Rows
from pickenv.errors import InputError

OUTLIER_SIGMA = 10.0
"""A row off by more robust standard deviations than this is an outlier; what a model leaves out stays below it."""

WEIGHTINGS, SELECTIONS, FOURS = 30, 10, 500
"""Least squares at most, alignments at most, and fours of poses that are tried."""

LOSSES: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {
        "huber": lambda size: np.minimum(1.0, 1.345 / np.maximum(size, 1e-12)),
        "cauchy": lambda size: 1.0 / (1.0 + (size / 2.385) ** 2),
    }
)
"""Weight of a row by its size in standard deviations per coordinate; constants for 95 % efficiency on normal noise."""


@dataclass(frozen=True, eq=False)
class RobustIdentification:
    """An identification with the weights it ended at.

    Attributes:
        identification: The last weighted least squares.
        weights: Weight of each row ``(N,)`` in it, 0 to 1.
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

    def sizes_of(self, data: Observations) -> Sizes:
        """Sizes of the errors of any rows by this arm's identified model, in the standard deviations found here."""
        return sizes_of(self.identification.arm_model, unknowns_of(self.identification, data), data, self.sizes)

    def misses_of(self, data: Observations) -> Array:
        """The largest miss of each row ``(N,)``, m."""
        left = data.misses(self.identification.arm_model, unknowns_of(self.identification, data))
        largest = np.zeros(len(data.joints))
        np.maximum.at(largest, data.rows_of_misses, np.linalg.norm(left, axis=1))
        return largest


def robust_identify(
    model: ErrorModel, start: Geometry | ArmModel, data: Observations, *, loss: str = "cauchy"
) -> RobustIdentification:
    """Identify with iteratively re-weighted least squares; the first weights come from the starting geometry.

    Args:
        model: The parameters.
        start: Geometry, or geometry with terms; near the data (see `robust_align`).
        data: Rows of any kind.
        loss: "huber" (an outlier keeps a bounded pull) or "cauchy" (a gross one loses all of it).

    Raises:
        InputError: If the loss is unknown, or as `identify`.
    """
    if loss not in LOSSES:
        raise InputError(f"unknown loss '{loss}'; give one of {', '.join(LOSSES)}")
    arm, apart = ArmModel.of(start), counted(data.joints)
    weights = sizes_of(arm, data.start(arm), data, apart=apart).weights(loss)
    rows, _ = data.equations()
    for _ in range(WEIGHTINGS):
        factors = np.where(rows >= 0, np.sqrt(weights * apart)[rows], 1.0)
        found = identify(model, start, [data], whiten=lambda stated, by=factors: (stated.T * by).T)  # type: ignore[misc]
        sizes = sizes_of(found.arm_model, unknowns_of(found, data), data, apart=apart)
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
        sizes = sizes_of(found.arm_model, np.zeros(0), measurements)
        used, kept = kept, sizes.sigma <= OUTLIER_SIGMA
        settled = bool(np.array_equal(used, kept))
        if settled:
            break
    return RobustIdentification(found, used.astype(float), sizes, settled)


@dataclass(frozen=True, eq=False)
class Sizes:
    """Sizes of the errors of N rows, channel by channel.

    Attributes:
        errors: Sizes ``(C, N)``, in stated standard uncertainties of one coordinate: norms of up to three equations,
            and of more (a picture's corners) that of three like them; NaN where a row does not use a channel.
        coordinates: How many equations each stands for ``(C, N)``, three at most.
        scales: Robust standard deviation of one coordinate by channel ``(C,)``, in stated ones.
    """

    errors: Array
    coordinates: Array
    scales: Array

    @property
    def sigma(self) -> Array:
        """The largest of each row ``(N,)``, in robust standard deviations of one coordinate."""
        return np.asarray(np.nanmax(np.vstack([self.errors / self.scales[:, None], self._none]), axis=0))

    @property
    def outliers(self) -> Rows:
        """Rows beyond `OUTLIER_SIGMA`, the largest first."""
        order = np.argsort(-self.sigma, kind="stable")
        return order[self.sigma[order] > OUTLIER_SIGMA]

    def weights(self, loss: str) -> Array:
        """Weights ``(N,)`` by the size per coordinate."""
        squares = np.nansum((self.errors / self.scales[:, None]) ** 2, axis=0)
        return LOSSES[loss](np.sqrt(squares / np.maximum(self.coordinates.sum(axis=0), 1)))

    @property
    def _none(self) -> Array:
        return np.zeros((1, self.errors.shape[1]))


def sizes_of(
    arm: ArmModel, unknowns: Array, data: Observations, like: Sizes | None = None, *, apart: Array | None = None
) -> Sizes:
    """Sizes in the standard deviations of others, or in robust ones, never below the instrument's own uncertainty.

    Args:
        arm: The arm.
        unknowns: The data's own unknowns.
        data: The rows.
        like: Sizes with the standard deviations to use.
        apart: What each row counts in the median ``(N,)``, less where others stand near it: rows of a cluster miss by
            the same, and are few facts. All alike when left out.
    """
    rows, channels = data.equations()
    squares, count = np.zeros((2, int(channels.max()) + 1, len(data.joints)))
    own = rows >= 0
    np.add.at(squares, (channels[own], rows[own]), data.residual(arm, unknowns)[own] ** 2)
    np.add.at(count, (channels[own], rows[own]), 1.0)
    shown = np.minimum(count, 3.0)
    errors = np.sqrt(np.where(count > 0, squares * shown / np.maximum(count, 1.0), np.nan))
    if like is not None:
        return Sizes(errors, shown, like.scales)
    usual = np.sqrt(2.0 * gammaincinv(np.maximum(count, 1.0) / 2.0, 0.5) * shown / np.maximum(count, 1.0))
    apart = np.ones(len(data.joints)) if apart is None else apart
    scales = [_median(size / median, apart) for size, median in zip(errors, usual, strict=True)]
    return Sizes(errors, shown, np.maximum(scales, 1.0))


def _median(values: Array, counts: Array) -> float:
    """The median of values ``(N,)`` that count differently; NaN is none."""
    order = np.argsort(values, kind="stable")[: np.count_nonzero(values == values)]
    below = np.cumsum(counts[order])
    first, last = np.searchsorted(below, below[-1] * np.array([0.5 - 1e-12, 0.5 + 1e-12]))
    return float(values[order[[first, min(last, len(order) - 1)]]].mean())


def _registered_misses(nominal: Array, measured: Array, rows: Rows) -> Array:
    """Distances ``(T, N)`` of measured points from nominal ones after T rigid registrations of few rows (Kabsch)."""
    here, there = nominal[rows], measured[rows]
    from_, to = here.mean(axis=1, keepdims=True), there.mean(axis=1, keepdims=True)
    turn = nearest_rotation(np.swapaxes(here - from_, 1, 2) @ (there - to))  # row vectors: point @ turn
    return np.asarray(np.linalg.norm((nominal - from_) @ turn + to - measured, axis=2))
