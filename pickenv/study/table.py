"""The results of a study on disk: one row per setting and arm, in Parquet files of one chunk of arms each.

A folder holds `study.toml` (the configuration, with its hash), `rows/chunk-00000.parquet`, … (each written whole or not
at all) and, when the study is complete, `summary.json`. Rows are sorted by arm and setting.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pickenv.arm.arm_file import read_toml
from pickenv.errors import InputError
from pickenv.files import write_text, write_whole
from pickenv.study.config import StudyConfig, load_study

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
"""Type of each column; the deviations of the arm (`pickenv.study.deviations`) follow, as float64."""


def make_table(columns: Mapping[str, Any]) -> pa.Table:
    """A table of columns by name, in the order of `COLUMNS` and then as given; sorted by arm and setting."""
    arrays = {name: pa.array(columns[name], type=kind) for name, kind in COLUMNS.items()}
    arrays |= {name: pa.array(columns[name], type=pa.float64()) for name in columns if name not in COLUMNS}
    order = np.lexsort((np.asarray(columns["setting"]), np.asarray(columns["arm"])))
    return pa.table(arrays).take(pa.array(order))


def chunk_path(folder: Path, chunk: int) -> Path:
    """File of a chunk."""
    return folder / "rows" / f"chunk-{chunk:05d}.parquet"


def write_chunk(folder: Path, chunk: int, table: pa.Table) -> Path:
    """Write a chunk's rows, whole or not at all."""
    return write_whole(
        chunk_path(folder, chunk),
        lambda path: pq.write_table(table, path, compression="zstd", write_page_checksum=True),
    )


def open_folder(folder: Path, config: StudyConfig, arithmetic: str) -> None:
    """Claim a folder for a study: write its configuration, or check that it holds the same one.

    Args:
        folder: The folder; made if need be.
        config: The study.
        arithmetic: How the rows are computed; those of two ways differ in their last digits and are not mixed.

    Raises:
        InputError: If the folder holds the results of another configuration, or rows of an unknown one.
    """
    described = folder / "study.toml"
    if not described.is_file():
        if (folder / "rows").exists():
            raise InputError(f"{folder} holds rows but no study.toml that says of what; give another --out")
        write_text(described, f'sha256 = "{config.sha256()}"\narithmetic = "{arithmetic}"\n{config.toml()}')
        return
    content = read_toml(described)
    found, computed = str(content.get("sha256", "")), content.get("arithmetic")
    if not found:
        raise InputError(f"{described} is not the record of a results folder; give another --out")
    if found != config.sha256():
        raise InputError(
            f"{folder} holds the results of another configuration (hash {found[:12]}, this one has "
            f"{config.sha256()[:12]}); give another --out, or that configuration to go on"
        )
    if computed != arithmetic:
        raise InputError(
            f"{folder} holds rows computed {computed}, and rows computed {arithmetic} differ from them in the last "
            "digits; go on with the executor that began it, or give another --out"
        )


def study_of(folder: str | Path) -> StudyConfig:
    """The configuration of a results folder.

    Raises:
        InputError: If the folder holds no study.
    """
    return load_study(Path(folder) / "study.toml")


def missing_chunks(folder: Path, config: StudyConfig) -> tuple[list[int], list[Path]]:
    """Which chunks are still to be computed, and which of their files are there but damaged.

    Every file is read to its end, with the checksums of its pages; a damaged one counts as missing.
    """
    settings = len(config.settings())
    missing, damaged = [], []
    for chunk in config.chunks():
        path = chunk_path(folder, chunk)
        if not path.is_file():
            missing.append(chunk)
            continue
        try:
            rows = pq.read_table(path, page_checksum_verification=True).num_rows
        except (pa.ArrowException, OSError):
            rows = -1
        if rows != settings * len(config.arms_of(chunk)):
            missing.append(chunk)
            damaged.append(path)
    return missing, damaged


def read_rows(folder: str | Path) -> ds.Dataset:
    """All rows of a folder, to be streamed in batches.

    Raises:
        InputError: If the folder holds no rows.
    """
    rows = Path(folder) / "rows"
    paths = sorted(rows.glob("chunk-*.parquet"))
    if not paths:
        raise InputError(f"{rows} holds no results; run `pickenv study` first")
    return ds.dataset([str(path) for path in paths], format="parquet")


def batches(folder: str | Path, columns: list[str] | None = None) -> Iterator[pa.Table]:
    """The rows in order, a chunk at a time: memory does not grow with the number of arms."""
    for path in sorted((Path(folder) / "rows").glob("chunk-*.parquet")):
        yield pq.read_table(path, columns=columns)


def table_sha256(folder: str | Path) -> str:
    """Hash of all rows, sorted by arm and setting; it does not depend on how they are cut into files.

    Each column is hashed on its own, numbers as little-endian bytes and texts as UTF-8 lines, then names and hashes
    together.
    """
    hashes: dict[str, Any] = {}
    for table in batches(folder):
        for name in table.column_names:
            hashes.setdefault(name, hashlib.sha256()).update(_bytes(table.column(name)))
    lines = "".join(f"{name} {digest.hexdigest()}\n" for name, digest in hashes.items())
    return hashlib.sha256(lines.encode()).hexdigest()


def _bytes(column: pa.ChunkedArray) -> bytes:
    if pa.types.is_string(column.type):
        return "".join(f"{text}\n" for text in column.to_pylist()).encode()
    values: NDArray[Any] = column.to_numpy()
    return values.astype(values.dtype.newbyteorder("<")).tobytes()
