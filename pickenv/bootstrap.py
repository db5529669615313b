"""How far a number would wander on other data like these: the percentile bootstrap (Davison and Hinkley 1997)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 2000


def resampled(
    values: NDArray[Any],
    statistic: Callable[[NDArray[Any]], Any],
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
    *,
    clusters_too: bool = True,
) -> NDArray[np.float64]:
    """Replicates ``(resamples, ...)`` of a statistic of values ``(clusters, n)``.

    Args:
        values: One row per cluster; entries of one cluster are alike. Row numbers, where the statistic takes several
            columns of a table.
        statistic: What is computed of all values of a replicate ``(clusters * n,)``.
        rng: Draws the replicates.
        resamples: How many.
        clusters_too: Whether clusters are drawn first, for what would happen on others; else only entries within each.
    """
    clusters, entries = values.shape
    rows, found = np.arange(clusters)[:, None], []
    for _ in range(resamples):
        chosen = rng.integers(0, clusters, (clusters, 1)) if clusters_too and clusters > 1 else rows
        found.append(statistic(values[chosen, rng.integers(0, entries, (clusters, entries))].ravel()))
    return np.array(found)


def interval95(replicates: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower and upper ends ``(2, ...)`` of the 95 % interval of replicates ``(R, ...)``."""
    return np.asarray(np.percentile(replicates, [2.5, 97.5], axis=0))
