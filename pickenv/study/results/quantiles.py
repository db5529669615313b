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
from pickenv.errors import InputError
from pickenv.intervals import quantile_levels, share_interval, statistic_interval
from pickenv.study.results.row_table import FIGURES, OK, SETTING, grouped

# Which share of a variance each of several independent causes makes: first-order and total indices (Saltelli 2010).
# Row by row the figure is computed with all causes drawn once (A), all drawn again (B), and for each cause with that
# one taken from B and the others from A. Anything else that a row's figures share is averaged over and makes no
# variance.


def variance_indices(first: Array, second: Array, mixed: Array, names: Sequence[str]) -> list[dict[str, Any]]:
    """The indices of causes, from R independent blocks of n rows.

    Args:
        first: The figure with all causes from A ``(R, n)``.
        second: With all from B ``(R, n)``.
        mixed: For each of G causes, with it alone from B ``(G, R, n)``.
        names: Of the causes.

    Returns:
        For each cause ``group``, ``first_order`` (its share alone), ``total`` (with all its interactions, never less),
        and their 95 % intervals ``first_order_low`` and so on; None where there are too few blocks for one.

    Raises:
        InputError: If nothing varies.
    """
    whole = 0.5 * np.mean((first - second) ** 2, axis=1)
    if not whole.any():
        raise InputError("the figure is the same whatever is drawn; there is no variance to divide")
    # Jansen 1999: differences within a row alone, so that what the row shares drops out
    alone, every = whole - 0.5 * np.mean((second - mixed) ** 2, axis=2), 0.5 * np.mean((first - mixed) ** 2, axis=2)
    found = []
    for name, one, all_ in zip(names, alone, every, strict=True):
        if one.mean() > all_.mean():  # by chance: both then estimate the share of a cause without interactions
            one = all_ = 0.5 * (one + all_)
        row: dict[str, Any] = {"group": name}
        for key, part in (("first_order", one), ("total", all_)):
            value = float(part.mean() / whole.mean())
            low, high = _ends(part, whole, value)
            row |= {key: value, f"{key}_low": low, f"{key}_high": high}
        found.append(row)
    return found


def _ends(part: Array, whole: Array, value: float) -> tuple[float | None, float | None]:
    """The interval of a ratio of means over blocks ``(R,)``: within 0 to 1, but holding the value that is shown."""
    if not part.any():
        return 0.0, 0.0  # the cause changes nothing
    ends = statistic_interval(np.stack([part, whole], axis=1), lambda rows: rows[:, 0].mean() / rows[:, 1].mean())
    return (None, None) if ends is None else (min(max(ends[0], 0.0), value), max(min(ends[1], 1.0), value))


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


# Yield: the share of arms that pick enough of their fruit, per setting, with Wilson's interval. An arm is within
# specification if the share of its fruit inside the specified radius reaches the required share. An arm whose
# calibration failed is not. Shares are numbers from 0 to 1.


def yields_of(rows: Dataset, required_share: float) -> pa.Table:
    """The yield of every setting.

    Args:
        rows: A study's rows, of any number; they are read in batches.
        required_share: Share of an arm's fruit that must lie within the specified radius.

    Returns:
        One row per setting: its columns, ``arms``, ``failed`` (arms without a result), ``within`` (arms within
        specification), ``yield`` and Wilson's 95 % interval ``yield_low``, ``yield_high``.
    """
    within = pc.if_else(pc.field("share_within") >= required_share, 1, 0)  # a failed arm's share is NaN: not within
    table = grouped(
        rows,
        {"within": within, "lost": pc.if_else(pc.field("status") == OK, 0, 1)},
        [
            ("within", "hash_count", None, "arms"),
            ("lost", "hash_sum", None, "failed"),
            ("within", "hash_sum", None, "within"),
        ],
    )
    counts = zip(table["within"].to_pylist(), table["arms"].to_pylist(), strict=True)
    found = [(k / n, *share_interval(k, n)) for k, n in counts]
    for name, values in zip(("yield", "yield_low", "yield_high"), zip(*found, strict=True), strict=True):
        table = table.append_column(name, pa.array(values, pa.float64()))
    return table
