"""The comparison on screens and in files: tables, CSV, Parquet, JSON, run folders."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid
from pickenv.agents.evaluation.grid_figures import grid_drawings
from pickenv.errors import InputError
from pickenv.extras import require
from pickenv.files import write_json, write_whole
from pickenv.inspect.colours import policy_label
from pickenv.inspect.figures.run_drawings import Drawings
from pickenv.inspect.reports.plain_report import plain_report
from pickenv.inspect.reports.report_page import PageTable, PageVerdict
from pickenv.inspect.runs.run_folder import Run, TakePicture, recorded_run, unedited
from pickenv.inspect.runs.saved import load_numbers, save_numbers
from pickenv.provenance import command_line

GRID = "grid.npz"
"""A comparison's file in its run folder."""

ROWS = "rows.json"
"""Its rows there, for people and other programs."""

KEYS = ("policy", "compensation", "feedback", "plant", "gripper")

HEADS = ("mean (mm)", "95 % interval (mm)", "median arm (mm)", "95th arm (mm)", "success (%)", "cycle (s)")
"""What stands beside `KEYS`; an interval where the number has none of its own column follows in brackets."""


def cells_of(row: Mapping[str, Any]) -> list[str]:
    """What people are shown of a row: `KEYS` and `HEADS`."""
    trained = {None: "", 1: " (one training)"}.get(row["trainings"], f" ({row['trainings']} trainings)")
    return [
        f"{row['policy']}{trained}",
        *(row[key] for key in KEYS[1:]),
        f"{row['mean_mm']:.3f}",
        interval_words(row["ci95"], 3) or f"none: {row['no_interval']}",
        with_interval(row["median_arm_mm"], row["median_arm_ci95"], 3),
        with_interval(row["p95_arm_mm"], row["p95_arm_ci95"], 3),
        with_interval(row["success_rate"], row["success_ci95"], 1, 100.0),
        "never" if row["cycle_s"] is None else f"{row['cycle_s']:.1f}",
    ]


def gain_words(line: Mapping[str, Any]) -> tuple[str, str, str]:
    """A comparison's difference, its interval, and whether it is significant."""
    ends = interval_words(line["ci95"], 3, sign="+") or f"none: {line['no_interval']}"
    return f"{line['difference_mm']:+.3f}", ends, {True: "yes", False: "no", None: "not known"}[line["significant"]]


def interval_words(ends: Sequence[float | None] | None, digits: int, scale: float = 1.0, sign: str = "") -> str:
    """An interval: 0.12 to 0.34; an end that the arms cannot bound is open; empty where there is no interval."""
    if ends is None:
        return ""
    return " to ".join("open" if end is None else f"{scale * end:{sign}.{digits}f}" for end in ends)


def with_interval(
    value: float, ends: Sequence[float | None] | None, digits: int, scale: float = 1.0, unit: str = ""
) -> str:
    """A number with its interval in brackets, if it has one: 0.23 (0.12 to 0.34)."""
    said = interval_words(ends, digits, scale)
    return f"{scale * value:.{digits}f}{unit}" + (f" ({said})" if said else "")


def flat_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows with intervals and seeds in columns of their own."""
    found = []
    for row in rows:
        flat: dict[str, Any] = {}
        for key, value in row.items():
            if key == "seeds":
                flat[key] = " ".join(map(str, value))
            elif key.endswith("ci95"):
                flat[f"{key}_low"], flat[f"{key}_high"] = value or (None, None)
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
    require("pyarrow")
    import pyarrow as pa
    import pyarrow.parquet as pq

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


# The report of a comparison of policies: what each compensation is worth, every cell with its interval, figures.


CELLS = ("policy", "calibration", "feedback", "plant", "gripper", *HEADS)
GAINS = ("policy", "feedback", "plant", "from", "to", "difference (mm)", "95 % (mm)", "significant")


def drawings(run: Run) -> Drawings:
    """The figures of a comparison's run folder."""
    return grid_drawings(read_grid(run))


def page(run: Run, picture: TakePicture | None = None) -> str:
    """The page of a comparison's run folder."""
    grid = read_grid(run)
    rows, worth = grid.rows(), grid.comparisons()
    first, best = rows[0], min(rows, key=lambda row: row["mean_mm"])
    raw = [line for line in worth if line["from"] == "raw"]
    helped = [line for line in raw if line["significant"] and line["difference_mm"] < 0.0]
    verdict = PageVerdict(
        "note",
        f"Best: {best['policy']} with {policy_label(best['compensation'])}, {best['mean_mm']:.2f} mm",
        f"{best['policy']} with {best['feedback']} and {policy_label(best['compensation'])} on {best['plant']} ends "
        f"{best['mean_mm']:.3f} mm from the fruit in the mean ({_evidence(best)}). "
        f"Of {len(raw)} comparisons of a calibration with the raw arm, {len(helped)} show a gain that is significant.",
    )
    cells = [cells_of(row | {"compensation": policy_label(row["compensation"])}) for row in rows]
    gains = [
        (
            *(line["policy"], line["feedback"], line["plant"], policy_label(line["from"]), policy_label(line["to"])),
            *gain_words(line),
        )
        for line in worth
    ]
    tables = (
        PageTable(
            f"Final position errors; {first['episodes'] // (first['trainings'] or 1)} reaches on {first['arms']} arms, "
            "the same for all. Mean, median and 95th percentile are over arms, in brackets and beside the mean 95 % "
            "intervals; those of one training say nothing of another one",
            CELLS,
            cells,
        ),
        PageTable(
            "What each calibration changes on the same arms and fruit, pair by pair; 95 % intervals over arms, and "
            "over trainings where there are several",
            GAINS,
            gains,
        ),
    )
    subtitle = (
        f"Simulated; arms of tolerance class {grid.settings.tolerances} that no policy was trained on, seed "
        f"{grid.settings.seed}"
    )
    return plain_report(run, "Comparison of policies", subtitle, verdict, tables, grid_drawings(grid))


def _evidence(row: Mapping[str, Any]) -> str:
    said = interval_words(row["ci95"], 3)
    return f"95 % interval over {row['interval_over']}: {said}" if said else f"no interval: {row['no_interval']}"
