"""Aggregates over a study's rows that pass through memory in batches, one group per setting.

The rows are a Parquet data set of any size; pyarrow's engine reads it once, in one thread and in order, so that equal
rows give equal bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.acero as acero
import pyarrow.compute as pc
from pyarrow.dataset import Dataset

SETTING = ("setting", "tolerances", "it_grade", "poses", "noise_mm", "noise_deg", "payload_kg", "method")
"""Columns that name a setting."""
Aggregate = tuple[str, str, Any, str]
"""Column, pyarrow's name of the aggregate, its options, name of the result."""


def grouped(
    rows: Dataset,
    columns: Mapping[str, pc.Expression],
    aggregates: Sequence[Aggregate],
    only: pc.Expression | None = None,
) -> pa.Table:
    """Aggregate computed columns per setting, in one pass and with memory that does not grow with the rows.

    Args:
        rows: A study's rows.
        columns: What is computed of each row, by name.
        aggregates: What is computed of those columns in each setting.
        only: Which rows count; all when left out.

    Returns:
        A table with `SETTING` and the aggregates, one row per setting, by number.
    """
    every = {name: pc.field(name) for name in SETTING} | dict(columns)
    steps = [
        acero.Declaration("scan", acero.ScanNodeOptions(rows, filter=only, use_threads=False)),
        *([] if only is None else [acero.Declaration("filter", acero.FilterNodeOptions(only))]),
        acero.Declaration("project", acero.ProjectNodeOptions(list(every.values()), list(every))),
        acero.Declaration("aggregate", acero.AggregateNodeOptions(list(aggregates), keys=list(SETTING))),
    ]
    table: pa.Table = acero.Declaration.from_sequence(steps).to_table(use_threads=False)
    return table.sort_by("setting")
