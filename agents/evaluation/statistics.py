"""Intervals and comparisons that respect how the data came about: fruit within arms, the same for every policy.

Episodes on one arm are alike, so arms are resampled first and episodes within them after (cluster bootstrap; Davison
and Hinkley 1997). Aggregates follow rliable (Agarwal et al. 2021): interquartile mean, stratified bootstrap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.bootstrap import interval95, resampled

Statistic = Callable[[Array], Array]
"""From values ``(..., n)`` to one number each ``(...)``."""


def mean(values: Array) -> Array:
    """Mean over the last axis."""
    return np.asarray(values.mean(axis=-1))


def interquartile_mean(values: Array) -> Array:
    """Mean of the middle half over the last axis."""
    ordered = np.sort(values, axis=-1)
    quarter = ordered.shape[-1] // 4
    return mean(ordered[..., quarter : ordered.shape[-1] - quarter])


def interval(
    values: Array, rng: np.random.Generator, statistic: Statistic = mean, *, arms_too: bool = True
) -> tuple[float, float]:
    """Bootstrap 95 % interval of a statistic of values ``(arms, episodes)``; see `pickenv.bootstrap.resampled`."""
    low, high = interval95(resampled(values, statistic, rng, clusters_too=arms_too))
    return float(low), float(high)


@dataclass(frozen=True)
class Paired:
    """One policy against another on the same arms and fruit.

    Attributes:
        difference: Mean of the second minus the first.
        ci95: Its 95 % interval.
    """

    difference: float
    ci95: tuple[float, float]

    @property
    def significant(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.ci95[0] > 0.0 or self.ci95[1] < 0.0


def paired(first: Array, second: Array, rng: np.random.Generator) -> Paired:
    """Compare values ``(arms, episodes)`` that were won on the same arms and fruit."""
    difference = second - first
    return Paired(float(difference.mean()), interval(difference, rng))
