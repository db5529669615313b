"""Quantiles of the arms' errors per setting, each with a band from order statistics; mm and degrees.

Up to `EXACT_ROWS` rows they are exact; beyond, t-digests (Dunning and Ertl 2019) keep memory flat. The i-th of N values
stands at probability (i - 1/2) / N, in both (Hazen's definition). The 95 % band needs no assumption about the
distribution. Its ends are open where so few arms cannot bound the quantile: below 5 % and above 95 % of fewer than 72.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow.dataset import Dataset

from pickenv.arm.kinematics.geometry import Array
from pickenv.intervals import quantile_levels
from pickenv.study.results.row_table import FIGURES
from pickenv.study.results.streaming import SETTING, grouped

PROBABILITIES = (0.05, 0.25, 0.5, 0.75, 0.95)
EXACT_ROWS = 2_000_000
"""Rows whose values of one column are held at once, 16 MB."""
CENTROIDS = 5_000
"""Of each digest: a quantile's rank is then right to about one part in ten thousand."""


def quantiles_of(
    rows: Dataset,
    columns: Sequence[str] = FIGURES,
    probabilities: Sequence[float] = PROBABILITIES,
    exact_rows: int = EXACT_ROWS,
) -> pa.Table:
    """Quantiles of arms' errors in every setting, failed arms left out.

    Args:
        rows: A study's rows, of any number; they are read in batches, one column at a time.
        columns: The error columns.
        probabilities: Which quantiles.
        exact_rows: Rows up to which they are exact.

    Returns:
        One row per setting, column and probability: the setting's columns, ``quantity``, ``arms``, ``probability``,
        ``value`` and the 95 % band ``low``, ``high``; null for an end that is open, and where no arm has a result.
    """
    exact = rows.count_rows() <= exact_rows
    found: list[dict[str, Any]] = []
    for column in columns:
        value = {"value": pc.if_else(pc.is_nan(pc.field(column)), None, pc.field(column))}
        counted = grouped(rows, value, [("value", "hash_count", pc.CountOptions("only_valid"), "arms")])
        levels = {n: _levels(n, probabilities) for n in sorted(set(counted["arms"].to_pylist()))}
        wanted = np.unique([level for rows in levels.values() for row in rows for level in row if level is not None])
        if exact:
            table = grouped(rows, value, [("value", "hash_list", None, "values")])
            values = [_exact(listed.values.to_numpy(zero_copy_only=False), wanted) for listed in table["values"]]
        else:
            digest = pc.TDigestOptions(q=wanted.tolist(), delta=CENTROIDS)
            table = grouped(rows, value, [("value", "hash_tdigest", digest, "values")])
            values = [np.array(listed, dtype=float) for listed in table["values"].to_pylist()]
        for setting, arms, quantiles in zip(
            table.select(SETTING).to_pylist(), counted["arms"].to_pylist(), values, strict=True
        ):
            at = dict(zip(wanted.tolist(), quantiles.tolist(), strict=True)) if arms else {}
            for probability, level in zip(probabilities, levels[arms], strict=True):
                numbers = {name: at.get(place) for name, place in zip(("value", "low", "high"), level, strict=True)}
                found.append(setting | {"quantity": column, "arms": arms, "probability": probability, **numbers})
    return pa.Table.from_pylist(found)


def _levels(count: int, probabilities: Sequence[float]) -> list[tuple[float | None, ...]]:
    """Levels of each quantile of ``count`` values, of the lower and the upper end of its band."""
    return [(float(p), *quantile_levels(count, p)) for p in probabilities]


def _exact(values: Array, wanted: Array) -> Array:
    numbers = values[~np.isnan(values)]
    if not numbers.size:
        return np.full(len(wanted), np.nan)
    return np.asarray(np.quantile(numbers, wanted, method="hazen"))
