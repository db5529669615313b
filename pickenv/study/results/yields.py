"""Yield: the share of arms that pick enough of their fruit, per setting, with Wilson's interval.

An arm is within specification if the share of its fruit inside the specified radius reaches the required share. An arm
whose calibration failed is not. Shares are numbers from 0 to 1.
"""

from __future__ import annotations

import pyarrow as pa
import pyarrow.compute as pc
from pyarrow.dataset import Dataset

from pickenv.intervals import share_interval
from pickenv.study.results.row_table import OK
from pickenv.study.results.streaming import grouped


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
