"""Compute error statistics with confidence intervals.

The statistics are mean, RMS of the norm, per-axis RMS, standard deviation, 95th percentile, maximum and held-out R^2.
Both mean and RMS are printed, because an "RMSE" in a paper need not be the RMS of the norm: an "RMSE" that is smaller
than the mean is not.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.base import LEAST, Ends, mean_interval, statistic_interval

LEAST_ROWS = 20
"""Smallest number of single errors for a 95 % interval of their mean; with ten, it covers the mean in only 92 %."""

MOST_APART = 0.4
"""Largest spread between blocks for which an interval of the root mean square is given.

The spread is the standard deviation of the logarithm of the blocks' root mean squares. Above this value one block
outweighs the others, and an interval from ten blocks covers the root mean square in less than 93 %. For the errors that
calibrations of measured robots leave, the spread is 0.03 to 0.23.
"""


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of the norms of N error vectors, in the unit of the errors.

    Attributes:
        mean: Mean norm.
        mean_ci95: 95 % interval of the mean, from single errors or from blocks of them, and not below 0; None if these
            are too few.
        rms: Root mean square of the norm.
        rms_ci95: 95 % interval of the root mean square, from blocks; None without blocks, with too few blocks, or if
            blocks differ by more than `MOST_APART`.
        std: Standard deviation of the norm.
        p95: 95th percentile of the norm.
        max: Largest norm.
        axis_rms: Root mean square of each component.
        count: Number of errors N.
    """

    mean: float
    mean_ci95: Ends | None
    rms: float
    rms_ci95: Ends | None
    std: float
    p95: float
    max: float
    axis_rms: tuple[float, ...]
    count: int

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics by name, as values for JSON."""
        return asdict(self)


def error_statistics(errors: ArrayLike, blocks: ArrayLike | None = None) -> ErrorStatistics:
    """Compute statistics of error vectors, or of their norms.

    Args:
        errors: Error vectors ``(N, k)``, or norms ``(N,)``; for norms, ``axis_rms`` is empty.
        blocks: For each error, an integer that is the same for all errors of one block of rows ``(N,)``; None if errors
            are independent. Errors of one block are correlated, so intervals come from differences between blocks.

    Raises:
        ValueError: If there are no errors or some are not finite.
    """
    errors = np.asarray(errors, dtype=float)
    if errors.size == 0 or not np.isfinite(errors).all():
        raise ValueError("error statistics need at least one error, all finite")
    norms = np.abs(errors) if errors.ndim == 1 else np.linalg.norm(errors, axis=1)
    axis = () if errors.ndim == 1 else tuple(float(v) for v in np.sqrt(np.mean(errors**2, axis=0)))
    ends = mean_interval(norms, LEAST_ROWS) if blocks is None else block_interval(norms, blocks)
    return ErrorStatistics(
        mean=float(norms.mean()),
        mean_ci95=None if ends is None else (max(ends[0], 0.0), ends[1]),  # no mean norm is below 0
        rms=float(np.sqrt(np.mean(norms**2))),
        rms_ci95=None if blocks is None else block_interval(norms, blocks, rms=True),
        std=float(norms.std()),
        p95=float(np.percentile(norms, 95)),
        max=float(norms.max()),
        axis_rms=axis,
        count=len(norms),
    )


def block_interval(values: ArrayLike, blocks: ArrayLike, *, rms: bool = False) -> Ends | None:
    """Compute the 95 % interval of the mean of values from the differences between blocks.

    The result is None with fewer than ten blocks. Neighbouring blocks may be correlated. For blocks of equal size the
    interval is the `ordered_interval` of the blocks' means.

    Args:
        values: The values ``(N,)``.
        blocks: For each value, an integer that is the same for all values of one block ``(N,)``.
        rms: Whether to compute the interval of the root mean square. It is then computed from logarithms, which are
            less skewed. The result is None if blocks differ by more than `MOST_APART`.
    """
    which = np.unique(np.asarray(blocks), return_inverse=True)[1]
    summed = np.asarray(values, dtype=float) ** (2 if rms else 1)
    sums = np.stack([np.bincount(which, summed), np.bincount(which)], axis=1)
    if len(sums) < LEAST:
        return None
    if not rms:
        return statistic_interval(sums, lambda rows: rows[:, 0].sum() / rows[:, 1].sum(), ordered=True)
    if not (sums[:, 0] > 0.0).all() or np.std(0.5 * np.log(sums[:, 0] / sums[:, 1]), ddof=1) > MOST_APART:
        return None
    ends = statistic_interval(sums, lambda rows: 0.5 * np.log(rows[:, 0].sum() / rows[:, 1].sum()), ordered=True)
    return None if ends is None else (float(np.exp(ends[0])), float(np.exp(ends[1])))


def held_out_r2(truth: ArrayLike, predicted: ArrayLike) -> Array:
    """Compute the coefficient of determination R^2 ``(k,)`` of each column of held-out rows.

    1 is a perfect prediction. 0 is as good as the mean of the true values.

    Args:
        truth: True values ``(N, k)``.
        predicted: Predicted values ``(N, k)``.
    """
    truth, predicted = np.asarray(truth, dtype=float), np.asarray(predicted, dtype=float)
    unexplained = np.sum((truth - predicted) ** 2, axis=0)
    return np.asarray(1.0 - unexplained / np.sum((truth - truth.mean(axis=0)) ** 2, axis=0))
