"""The comparison on screens and in files: tables, CSV, Parquet, JSON, run folders."""

from __future__ import annotations

import csv
import importlib
import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid
from pickenv.errors import InputError
from pickenv.files import write_text, write_whole
from pickenv.inspect.runs.run_folder import Run, recorded_run
from pickenv.inspect.runs.saved import load_numbers, save_numbers

GRID = "grid.npz"
"""A comparison's file in its run folder."""

ROWS = "rows.json"
"""Its rows there, for people and other programs."""

SHOWN = ("policy", "compensation", "feedback", "plant", "gripper")


def print_grid(rows: Sequence[dict[str, Any]], comparisons: Sequence[dict[str, Any]]) -> None:
    """Print the rows, and what each compensation is worth."""
    from rich.console import Console
    from rich.table import Table

    if not rows:
        print("no policy can use any of the feedback asked for; nothing was run")
        return
    table = Table(title=f"{rows[0]['episodes']} reaches per cell on {rows[0]['arms']} arms, seed {rows[0]['seeds'][0]}")
    for head in (*SHOWN, "mean [mm]", "95 %", "p95 [mm]", "success", "cycle [s]"):
        table.add_column(head, justify="left" if head in SHOWN else "right")
    for row in rows:
        table.add_row(
            *(row[key] for key in SHOWN),
            f"{row['mean_mm']:.3f}",
            f"{row['ci95'][0]:.3f} to {row['ci95'][1]:.3f}",
            f"{row['p95_mm']:.3f}",
            f"{100 * row['success_rate']:.1f} %",
            "never" if row["cycle_s"] is None else f"{row['cycle_s']:.1f}",
        )
    console = Console(width=150)
    console.print(table)
    for line in comparisons:
        console.print(
            f"{line['policy']}, {line['feedback']}, {line['plant']}: {line['from']} to {line['to']} "
            f"{line['difference_mm']:+.3f} mm ({line['ci95'][0]:+.3f} to {line['ci95'][1]:+.3f}), "
            f"{'significant' if line['significant'] else 'not significant'}",
            highlight=False,
        )


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
        InputError: If the suffix is another, or pyarrow is not there for Parquet.
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
    try:
        pyarrow: Any = importlib.import_module("pyarrow")
        parquet: Any = importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise InputError("Parquet files need pyarrow; install it with pip install pyarrow, or write .csv") from error
    return write_whole(path, lambda temporary: parquet.write_table(pyarrow.Table.from_pylist(flat), temporary))


def command_of(settings: GridSettings) -> str:
    """The command line that makes the same comparison."""
    words = ["pickenv", "evaluate"]
    for option, values in (
        ("policy", settings.policies),
        ("compensation", settings.compensations),
        ("feedback", settings.feedback),
        ("plant", settings.plants),
        ("gripper", settings.grippers),
    ):
        for value in values:
            words += [f"--{option}", value]
    for option, number in (
        ("arms", settings.arms),
        ("episodes", settings.episodes),
        ("tolerances", settings.tolerances),
        ("camera-noise", f"{settings.camera_noise_mm:g}"),
        ("fruit-noise", f"{settings.fruit_noise_mm:g}"),
        ("epochs", settings.protocol.epochs),
        ("seed", settings.seed),
    ):
        words += [f"--{option}", str(number)]
    return shlex.join(words)


def write_grid(grid: PolicyGrid, folder: Path) -> list[Path]:
    """Write a comparison's run folder: every episode, for `read_grid`, and the rows as JSON."""
    with recorded_run(folder, "evaluation", command_of(grid.settings), grid.settings.seed) as run:
        return [save_numbers(run.folder / GRID, grid, seed=grid.settings.seed), write_json(folder / ROWS, grid)]


def read_grid(run: Run) -> PolicyGrid:
    """The comparison of a run folder, to the bit; raises `InputError` as `pickenv.inspect.runs.saved.load_numbers`."""
    return load_numbers(run.folder / GRID, PolicyGrid, run.made_by)


def write_json(path: Path, grid: PolicyGrid) -> Path:
    """Write the rows and what each compensation is worth as JSON."""
    content = {"rows": grid.rows(), "comparisons": grid.comparisons()}
    return write_text(path, json.dumps(content, indent=2) + "\n")
