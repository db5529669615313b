"""The comparison on screens and in files: tables, CSV, Parquet, JSON, run folders."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid
from pickenv.errors import InputError
from pickenv.files import write_json, write_whole
from pickenv.inspect.runs.run_folder import Run, recorded_run, unedited
from pickenv.inspect.runs.saved import load_numbers, save_numbers
from pickenv.provenance import command_line

GRID = "grid.npz"
"""A comparison's file in its run folder."""

ROWS = "rows.json"
"""Its rows there, for people and other programs."""

KEYS = ("policy", "compensation", "feedback", "plant", "gripper")


def cells_of(row: Mapping[str, Any]) -> list[str]:
    """What people are shown of a row: `KEYS`, mean and its interval, 95th percentile, success, cycle time."""
    return [
        *(row[key] for key in KEYS),
        f"{row['mean_mm']:.3f}",
        f"{row['ci95'][0]:.3f} to {row['ci95'][1]:.3f}",
        f"{row['p95_mm']:.3f}",
        f"{100 * row['success_rate']:.1f} %",
        "never" if row["cycle_s"] is None else f"{row['cycle_s']:.1f}",
    ]


def flat_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows with intervals and seeds in columns of their own."""
    found = []
    for row in rows:
        flat: dict[str, Any] = {}
        for key, value in row.items():
            if key == "seeds":
                flat[key] = " ".join(map(str, value))
            elif isinstance(value, list):
                flat[f"{key}_low"], flat[f"{key}_high"] = value
            else:
                flat[key] = value
        found.append(flat)
    return found


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> Path:
    """Write the rows as .csv or .parquet, whole or not at all.

    Raises:
        InputError: If the suffix is another.
    """
    flat = flat_rows(rows)
    if path.suffix == ".csv":

        def write(temporary: Path) -> None:
            with temporary.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, list(flat[0]) if flat else [])
                writer.writeheader()
                writer.writerows(flat)

        return write_whole(path, write)
    if path.suffix != ".parquet":
        raise InputError(f"cannot write {path}: give a file name that ends in .csv or .parquet")
    return write_whole(path, lambda temporary: pq.write_table(pa.Table.from_pylist(flat), temporary))


def command_of(settings: GridSettings) -> str:
    """The command line that makes the same comparison."""
    return command_line(
        "pickenv",
        "evaluate",
        policy=settings.policies,
        compensation=settings.compensations,
        feedback=settings.feedback,
        plant=settings.plants,
        gripper=settings.grippers,
        arms=settings.arms,
        episodes=settings.episodes,
        tolerances=settings.tolerances,
        camera_noise=f"{settings.camera_noise_mm:g}",
        fruit_noise=f"{settings.fruit_noise_mm:g}",
        epochs=settings.protocol.epochs,
        seed=settings.seed,
    )


def write_grid(grid: PolicyGrid, folder: Path) -> list[Path]:
    """Write a comparison's run folder: every episode, for `read_grid`, and the rows as JSON."""
    with recorded_run(folder, "evaluation", command_of(grid.settings), grid.settings.seed) as run:
        written = save_numbers(run.folder / GRID, grid, seed=grid.settings.seed)
        return [written, write_json(folder / ROWS, content_of(grid))]


def read_grid(run: Run) -> PolicyGrid:
    """The comparison of a run folder, to the bit; raises `InputError` as `load_numbers`, or if it was exchanged."""
    return load_numbers(unedited(run, GRID), PolicyGrid, run.made_by)


def content_of(grid: PolicyGrid) -> dict[str, Any]:
    """The rows and what each compensation is worth, for JSON."""
    return {"rows": grid.rows(), "comparisons": grid.comparisons()}
