"""The rows of a study: one per setting and arm, sorted by arm and setting, in sealed Parquet files of one chunk each.

A chunk's file carries the hash of its study, its number and how it was computed, and is read only as what it is: one
that was damaged, edited, renamed or brought from another study is refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.acero as acero
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow.dataset import Dataset

from pickenv.arm.plant.tolerances import draw_plants
from pickenv.errors import InputError
from pickenv.files import write_whole
from pickenv.sealed import check_sealed_parquet, sealed_parquet
from pickenv.study.design.config import RAW, Setting, StudyConfig, deviations

# Which of a study's settings stand for the rest: those in which all that is not shown has its middle value.


Row = Mapping[str, Any]

VARIED = ("it_grade", "poses", "noise_mm", "payload_kg")
"""What a study may vary, beside tolerance class and method."""


def held(rows: Sequence[Row], shown: Sequence[str]) -> list[Row]:
    """The rows in which everything that is not shown stands at its middle value; raw arms have no poses and noise."""
    calibrated = [row for row in rows if row["method"] != RAW] or rows
    middle = {}
    for name in ("tolerances", *VARIED):
        values = list(dict.fromkeys(row[name] for row in calibrated))
        middle[name] = values[(len(values) - 1) // 2]

    def fits(row: Row) -> bool:
        free = ("poses", "noise_mm") if row["method"] == RAW else ()
        return all(row[name] == value for name, value in middle.items() if name not in (*shown, *free))

    return [row for row in rows if fits(row)]


# Aggregates over a study's rows that pass through memory in batches, one group per setting. The rows are a Parquet
# data set of any size; pyarrow's engine reads it once, in one thread and in order, so that equal rows give equal
# bits.


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


SCHEMA = 1
"""Version of a chunk's file."""

OK = "ok"
"""Status of an arm that was calibrated and judged; any other is a sentence that says why it was not."""

FIGURES = ("error_mean_mm", "error_rms_mm", "error_p50_mm", "error_p95_mm", "error_max_mm", "attitude_mean_deg")
"""Columns of errors over an arm's fruit, NaN where the status is not `OK`; so is ``share_within``."""

COLUMNS: Mapping[str, Any] = {
    "setting": pa.int32(),
    "arm": pa.int64(),
    "tolerances": pa.string(),
    "it_grade": pa.int32(),
    "poses": pa.int32(),
    "noise_mm": pa.float64(),
    "noise_deg": pa.float64(),
    "payload_kg": pa.float64(),
    "method": pa.string(),
    "status": pa.string(),
    "iterations": pa.int32(),
    **dict.fromkeys((*FIGURES, "share_within"), pa.float64()),
}
"""Type of each column; the deviations of the arm (`pickenv.study.design.config`) follow, as float64."""

AGAIN = "run `pickenv study` again, which computes it anew"
ASIDE = "take it out of the folder and run `pickenv study` again, which computes what is missing"

ROUNDING = 1e-9
"""Relative error that sums and roots may make in the order of an arm's figures."""


@dataclass(frozen=True)
class Study:
    """What the rows of a study must be.

    Attributes:
        config: The configuration.
        arithmetic: How the rows are computed; those of two ways differ in their last digits and are not mixed.
    """

    config: StudyConfig
    arithmetic: str

    @cached_property
    def sha256(self) -> str:
        """Hash of everything that the rows depend on."""
        return self.config.sha256()

    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """Its cells."""
        return self.config.settings()

    @cached_property
    def schema(self) -> pa.Schema:
        """Names and types of the columns."""
        design, tolerances = self.config.load_plant(), next(iter(self.config.load_tolerances().values()))
        drawn = deviations(design, draw_plants(design, tolerances, 1, np.random.default_rng(0)))
        return pa.schema({**COLUMNS, **dict.fromkeys(drawn, pa.float64())})


def setting_columns(setting: Setting) -> dict[str, Any]:
    """The columns that name a setting."""
    return {
        "setting": setting.number,
        "tolerances": setting.tolerances,
        "it_grade": setting.it_grade,
        "poses": setting.poses,
        "noise_mm": setting.noise.position_mm,
        "noise_deg": setting.noise.attitude_deg,
        "payload_kg": setting.payload_kg,
        "method": setting.method,
    }


def make_table(columns: Mapping[str, Any]) -> pa.Table:
    """A table of columns by name, in the order of `COLUMNS` and then as given; sorted by arm and setting."""
    arrays = {name: pa.array(columns[name], type=kind) for name, kind in COLUMNS.items()}
    arrays |= {name: pa.array(columns[name], type=pa.float64()) for name in columns if name not in COLUMNS}
    order = np.lexsort((np.asarray(columns["setting"]), np.asarray(columns["arm"])))
    return pa.table(arrays).take(pa.array(order))


def chunk_path(folder: Path, chunk: int) -> Path:
    """File of a chunk."""
    return folder / "rows" / f"chunk-{chunk:05d}.parquet"


def write_chunk(folder: Path, chunk: int, table: pa.Table, study: Study) -> Path:
    """Write a chunk's rows with what they are, sealed, whole or not at all."""
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata(_origin(study, chunk)), sink, compression="zstd")
    content = sealed_parquet(sink.getvalue().to_pybytes())
    return write_whole(chunk_path(folder, chunk), lambda path: path.write_bytes(content))


def read_chunk(folder: Path, chunk: int, study: Study) -> pa.Table:
    """A chunk's rows.

    Raises:
        InputError: If its file is missing or damaged, is not that chunk of that study, or holds what cannot be.
    """
    path = chunk_path(folder, chunk)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); {AGAIN}") from error
    check_sealed_parquet(content, path, AGAIN)
    try:
        table = pq.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} has a sound seal around what is no table; {ASIDE}") from error
    fault = _foreign(table.schema.metadata or {}, study, chunk) or _misshapen(table.schema, study)
    fault = fault or _impossible(table, study, chunk)
    if fault is not None:
        raise InputError(f"{path} {fault}; {ASIDE}")
    return table


def _origin(study: Study, chunk: int) -> dict[bytes, bytes]:
    said = {"schema": SCHEMA, "study": study.sha256, "chunk": chunk, "arithmetic": study.arithmetic}
    return {f"pickenv.{key}".encode(): f"{value}".encode() for key, value in said.items()}


def _foreign(metadata: Mapping[bytes, bytes], study: Study, chunk: int) -> str | None:
    """Why a file is not the chunk that its name says."""
    found = {key.decode().removeprefix("pickenv."): value.decode(errors="replace") for key, value in metadata.items()}
    wanted = {key.decode().removeprefix("pickenv."): value.decode() for key, value in _origin(study, chunk).items()}
    if found.get("schema") != wanted["schema"]:
        return f"is of version {found.get('schema', 'unknown')} of a study's files, this program reads {SCHEMA}"
    if found.get("study") != wanted["study"]:
        return f"belongs to another study (hash {found.get('study', '')[:12]}, this one has {wanted['study'][:12]})"
    if found.get("chunk") != wanted["chunk"]:
        return f"holds chunk {found.get('chunk')} under the name of chunk {chunk}"
    if found.get("arithmetic") != wanted["arithmetic"]:
        return f"was computed {found.get('arithmetic')}, this study is computed {study.arithmetic}"
    return None


def _misshapen(found: pa.Schema, study: Study) -> str | None:
    """Which column is missing, unknown, of another type or in another place."""
    for name in study.schema.names:
        if name not in found.names:
            return f"has no column {name}"
    for name in found.names:
        if name not in study.schema.names:
            return f"has a column {name} that no study writes"
    if not found.equals(study.schema):
        return "has columns of other types or in another order than a study writes"
    return None


def _impossible(table: pa.Table, study: Study, chunk: int) -> str | None:
    """What in a chunk's rows no study could have computed."""
    arms, settings = study.config.arms_of(chunk), study.settings
    if table.num_rows != len(arms) * len(settings):
        return f"has {table.num_rows} rows, this chunk has {len(arms) * len(settings)}"
    if any(column.null_count for column in table.columns):
        return "has empty cells"
    named = [setting_columns(setting) for setting in settings]
    wanted: dict[str, Any] = {name: np.tile([row[name] for row in named], len(arms)) for name in named[0]}
    wanted["arm"] = np.repeat(np.arange(arms.start, arms.stop), len(settings))
    for name, values in wanted.items():
        if not table[name].combine_chunks().equals(pa.array(values, type=COLUMNS[name])):
            return f"has other values of {name} than its arms and settings"
    drawn = [name for name in table.column_names if name not in COLUMNS]
    if not all(np.isfinite(table[name].to_numpy()).all() for name in drawn):
        return "has deviations that are no finite numbers"
    judged = pc.equal(table["status"], OK).to_numpy()
    mean, rms, p50, p95, most, turn, share = errors = np.array([table[name] for name in (*FIGURES, "share_within")])
    if not np.isnan(errors[:, ~judged]).all():
        return "has errors of arms that were not judged"
    more = 1.0 + ROUNDING
    ordered = (most <= mean * more * study.config.fruit) & (mean <= rms * more) & (rms <= most * more)
    ordered &= (p50 >= 0.0) & (p50 <= p95) & (p95 <= most) & (turn >= 0.0) & (share >= 0.0) & (share <= 1.0)
    ordered &= np.isfinite(errors).all(axis=0) & ((share == 1.0) == (most <= study.config.radius_mm))
    if not ordered[judged].all():
        row = int(np.flatnonzero(judged & ~ordered)[0])
        return f"has errors that no arm can have (arm {wanted['arm'][row]}, setting {wanted['setting'][row]})"
    return None


def column_bytes(column: pa.ChunkedArray) -> bytes:
    """A column as it is hashed: numbers as little-endian bytes, texts as UTF-8 lines."""
    if pa.types.is_string(column.type):
        return "".join(f"{text}\n" for text in column.to_pylist()).encode()
    values: NDArray[Any] = column.to_numpy()
    return values.astype(values.dtype.newbyteorder("<")).tobytes()
