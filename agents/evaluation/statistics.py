"""Numbers over arms with their 95 % intervals (`pickenv.intervals`), for policies on the same arms and fruit.

Fruit of one arm are alike, so an arm counts once, with its own mean. Where a policy was trained several times, arms and
training seeds are two crossed factors: another arm and another training would both give another number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.intervals import (
    LEAST,
    LEAST_RUNS,
    Ends,
    clustered_share_interval,
    crossed_interval,
    mean_interval,
    quantile_interval,
)

RESAMPLES = 4000
"""Samples of a bootstrap."""

MANY = 30
"""Arms from which the skewed shares of arms have a mean that is covered: of 10 it holds 92 to 96 %."""

MARGIN_MM = 0.05
"""Mean errors that differ by less are the same to a picker: a twentieth of what the best gripper forgives."""


@dataclass(frozen=True)
class Estimate:
    """A number and its 95 % interval over arms, and over training seeds where there are several.

    Attributes:
        value: The number.
        ci95: Both ends, an open one as None; or None where there is no interval.
        missing: Why there is none.
    """

    value: float
    ci95: tuple[float | None, float | None] | None
    missing: str = ""

    @property
    def significant(self) -> bool | None:
        """Whether the interval leaves out zero; None without one."""
        if self.ci95 is None:
            return None
        low, high = self.ci95
        return (low is not None and low > 0.0) or (high is not None and high < 0.0)

    def verdict(self, margin: float = MARGIN_MM) -> str:
        """What a difference says: "carries over" inside the margin, "differs" beyond zero, else "not settled"."""
        if self.ci95 is not None and None not in self.ci95:
            low, high = self.ci95
            if low is not None and high is not None and -margin <= low and high <= margin:
                return "carries over"
        return "differs" if self.significant else "not settled"


def mean_over_arms(values: Array) -> Estimate:
    """Mean of values ``(arms, trainings, fruit)``."""
    each = values.mean(axis=2)
    return _estimate(float(each.mean()), _interval(each), each)


def quantile_over_arms(values: Array, probability: float) -> Estimate:
    """Quantile over arms of their means, of values ``(arms, trainings, fruit)``; of several trainings their mean."""
    each = values.mean(axis=2)
    found = float(np.quantile(each.mean(axis=1), probability, method="hazen"))
    if each.shape[1] > 1:
        return Estimate(found, None, "no interval of a quantile counts trainings")
    ends = quantile_interval(each[:, 0], probability)
    return Estimate(found, None, "needs more arms") if ends == (None, None) else Estimate(found, ends)


def share_over_arms(chances: Array) -> Estimate:
    """Share of successes, of chances ``(arms, trainings, fruit)`` of success.

    Chances vary less than successes that are drawn with them. Where no arm always or never succeeds, and arms are many,
    the share is a mean like any other; elsewhere as many tries bound it as there were, which is on the safe side.
    """
    arms, trainings, fruit = chances.shape
    each = chances.mean(axis=2)
    if trainings == 1 and arms >= MANY and each.min() > 0.0 and each.max() < 1.0:
        ends = mean_interval(each[:, 0])
    elif trainings == 1:
        ends = clustered_share_interval(chances.sum(axis=(1, 2)), fruit)
    else:
        ends = crossed_interval(each)
    if ends is not None:
        ends = max(ends[0], 0.0), min(ends[1], 1.0)
    return _estimate(float(each.mean()), ends, each)


def interquartile_mean(values: Array, sequence: np.random.SeedSequence) -> Estimate:
    """Mean of the middle half of independent values ``(n,)``, one per arm; its interval is a bootstrap's over them.

    Args:
        values: The values; the lowest and the highest quarter do not count.
        sequence: Seeds the bootstrap.
    """
    from scipy.stats import trim_mean  # late: half of SciPy comes along

    found = float(trim_mean(values, 0.25))
    if len(values) < LEAST:
        return Estimate(found, None, f"needs {LEAST} arms")
    drawn = np.random.default_rng(sequence).integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.quantile(trim_mean(values[drawn], 0.25, axis=1), (0.025, 0.975))
    return Estimate(found, (float(low), float(high)))


def _interval(each: Array) -> Ends | None:
    return mean_interval(each[:, 0]) if each.shape[1] == 1 else crossed_interval(each)


def _estimate(value: float, ends: Ends | None, each: Array) -> Estimate:
    arms, trainings = each.shape
    if ends is not None:
        return Estimate(value, ends)
    if arms < LEAST:
        return Estimate(value, None, f"needs {LEAST} arms")
    if 1 < trainings < LEAST_RUNS:
        return Estimate(value, None, f"needs {LEAST_RUNS} trainings")
    return Estimate(value, None, "all arms are equal")
