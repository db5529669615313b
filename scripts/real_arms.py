"""Every row of README's table of measured robots, with its spread: over ten random splits, and between ten blocks.

Needs the measured data sets (PICKENV_DATA). Prints the Markdown table and writes it with all figures as JSON. A row
that is done is kept in the folder by a hash of its data and settings, so a run that was cut off goes on where it was;
after a change of the code start with an empty folder.

Run: python scripts/real_arms.py [--out runs/real_arms] [--only ur5_blocks]
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Console

from pickenv.arm import Arm, load_arm
from pickenv.calibration import Choices, Observations, Result, calibrate
from pickenv.calibration.pipeline.held_out import GEOMETRIC, NOMINAL
from pickenv.calibration.reading.read import read_observations
from pickenv.errors import InputError
from pickenv.files import write_json, write_text

ROOT = Path(__file__).parents[1]
SEED, SPLITS = 0, 10
"""Random splits are drawn with so many seeds from one SeedSequence."""

HEADS = ("robot and rows judged", "nominal (mm)", "geometry (mm)", "best model (mm)", "published (mm)")
NOTE = (
    "Random fifths: mean over ten splits (lowest to highest). Blocks: each tenth of the file judged without itself, "
    "with the 95 % interval between blocks. Other poses: 95 % interval over poses. None where one "
    "block outweighs the others."
)


@dataclass(frozen=True)
class Row:
    """One row of the table.

    Attributes:
        robot: As README names it.
        how: Which rows judge: "random", "blocks", or "poses" of files of their own.
        arm: Arm name or file; {} is the folder of the data sets.
        columns: Column description.
        files: Rows to fit.
        others: Rows to judge by, for "poses".
        statistic: "rms" or "mean".
        terms: As `Choices` has it.
        residual: As `Choices` has it.
        published: What was published for the same robot, mm.
        remark: Beside the best model.
    """

    robot: str
    how: Literal["random", "blocks", "poses"]
    arm: str
    columns: str
    files: str
    others: str = ""
    statistic: Literal["rms", "mean"] = "rms"
    terms: str = "none"
    residual: str = "none"
    published: str = ""
    remark: str = ""


JACOBI, LANDGRAF = "ur5_wam_jacobi2025/{}/*{}*cleaned.csv", "ur10_ipa_landgraf2021/Series_{}"
UR5, UR5_POSES = JACOBI.format("UR5", "grid"), JACOBI.format("UR5", "random")
WAM, WAM_POSES = JACOBI.format("WAM", "grid"), JACOBI.format("WAM", "random")
SERIES = {
    "a": ("ur10_landgraf2021", f"{LANDGRAF.format('A')}/measurements_grid.csv"),
    "b": ("ur10_landgraf2021_repeats", f"{LANDGRAF.format('B')}/measurements_joint_configurations.csv"),
    "c": ("ur10_landgraf2021_repeats", f"{LANDGRAF.format('C')}/measurements_random_poses.csv"),
    "d": ("ur10_landgraf2021_repeats", f"{LANDGRAF.format('D')}/measurements_iso_cubes.csv"),
}
PANDA = ("{}/mukca_sockets/urdf/panda.urdf#ball_link", "mukca_sockets", "mukca_sockets/data/panda_1/*/hole_*.csv")
POSITIONER = ("positioner", "positioner_rct", "positioner_rct/*.yaml")
NOTHING = "nothing added"
SEEN = "the rule was settled with these poses in sight"

ROWS = {
    "ur5_random": Row("UR5", "random", "ur5", "ur5_jacobi2025", UR5),
    "ur5_blocks": Row("UR5", "blocks", "ur5", "ur5_jacobi2025", UR5, terms="auto", residual="auto"),
    "ur5_poses": Row(
        "UR5", "poses", "ur5", "ur5_jacobi2025", UR5, UR5_POSES, "mean", "auto", "auto", published="0.1549"
    ),
    "wam_blocks": Row("WAM", "blocks", "wam", "wam_jacobi2025", WAM, terms="auto"),
    "wam_poses": Row(
        "WAM", "poses", "wam", "wam_jacobi2025", WAM, WAM_POSES, "mean", "auto", published="2.92", remark=SEEN
    ),
    **{
        f"ur10_{name}_{how}": Row(f"UR10, series {name.upper()}", how, "ur10", *where, terms=terms)
        for name, where in SERIES.items()
        for how, terms in (("random", "none"), ("blocks", "auto"))
    },
    "panda_random": Row("Panda, balls in sockets", "random", *PANDA, "", "mean", "auto", published="0.347"),
    "panda_blocks": Row("Panda, balls in sockets", "blocks", *PANDA, "", "mean", "auto"),
    "positioner_random": Row("two-axis positioner, camera", "random", *POSITIONER, "", "mean", published="1.74"),
    "positioner_blocks": Row("two-axis positioner, camera", "blocks", *POSITIONER, "", "mean", "auto"),
}  # type: dict[str, Row]


def files_of(row: Row, data: Path) -> tuple[list[Path], list[Path]]:
    """Files to fit and files to judge by.

    Raises:
        InputError: If there are none.
    """
    found = [sorted(data.glob(pattern)) if pattern else [] for pattern in (row.files, row.others)]
    for pattern, files in zip((row.files, row.others), found, strict=True):
        if pattern and not files:
            raise InputError(f"no {pattern} in {data}; name the folder of the data sets in PICKENV_DATA")
    return found[0], found[1]


def key_of(row: Row, files: Sequence[Path]) -> str:
    """What a row's figures depend on: settings, seeds, and the bytes of its files."""
    seen = hashlib.sha256(json.dumps([asdict(row), SEED, SPLITS]).encode())
    for path in files:
        seen.update(path.read_bytes())
    return seen.hexdigest()[:16]


def figures_of(row: Row, data: Path) -> dict[str, Any]:
    """Judge one row: what is left by nominal, geometric and best model, each with its spread, mm."""
    files, others = files_of(row, data)
    arm = load_arm(row.arm.format(data))
    rows, judges = (
        read_observations(part, arm.nominal, row.columns).observations if part else None for part in (files, others)
    )
    assert rows is not None
    if row.how != "random":
        choices = Choices(terms=row.terms, residual=row.residual)
        result = calibrate(arm, rows, test=judges, split="blocked", choices=choices)
        return {"models": stated(row, result), "used": result.held_out.used, "rows": len(rows.joints)}
    results = [judged(arm, rows, row, int(seed)) for seed in np.random.SeedSequence(SEED).generate_state(SPLITS)]
    every = [{name: ends[0] for name, ends in stated(row, result).items()} for result in results]
    models = {
        name: [float(f(np.array([each[name] for each in every]))) for f in (np.mean, np.min, np.max)]
        for name in every[0]
    }
    return {"models": models, "used": [result.best_model for result in results], "rows": len(rows.joints)}


def judged(arm: Arm, rows: Observations, row: Row, seed: int) -> Result:
    """One random split."""
    return calibrate(arm, rows, choices=Choices(terms=row.terms, residual=row.residual, seed=seed))


def stated(row: Row, result: Result) -> dict[str, list[float | None]]:
    """Value and 95 % interval of each model that the table names, mm."""
    found = {}
    last = list(result.position)[-1]
    for label, name in {"nominal": NOMINAL, "geometry": GEOMETRIC, "best": last}.items():
        statistics = result.position[name]
        ends = getattr(statistics, f"{row.statistic}_ci95")
        found[label] = [getattr(statistics, row.statistic), *(ends or (None, None))]
    return found


def table_of(found: Mapping[str, Mapping[str, Any]]) -> str:
    """The Markdown table of the rows that were judged."""
    lines = [f"| {' | '.join(HEADS)} |", "|" + "---|" * len(HEADS)]
    for name, figures in found.items():
        row, models = ROWS[name], figures["models"]
        what = {"random": "random fifths", "blocks": "blocks", "poses": "its 20 random poses"}[row.how]
        judged_by = "RMS" if row.statistic == "rms" else "mean"
        best = ""
        if row.terms != "none":
            used = list(dict.fromkeys(figures["used"]))
            words = "; ".join(text.removeprefix("geometry").replace("+", ", ").strip(", ") or NOTHING for text in used)
            remark = f"; {row.remark}" if row.remark else ""
            best = f"{cell(models['best'])}: {words}{remark}"
        what = f"{row.robot}, {what}, {judged_by}"
        cells = (what, cell(models["nominal"]), cell(models["geometry"]), best, row.published)
        lines.append("".join(f"| {text} " if text else "| " for text in cells) + "|")
    return "\n".join(lines) + "\n"


def cell(values: Sequence[float | None]) -> str:
    """A value with its spread in brackets, three digits after the point below 1 mm."""
    value, low, high = values
    assert value is not None
    digits = 3 if value < 1.0 else 2
    return f"{value:.{digits}f}" + ("" if low is None else f" ({low:.{digits}f} to {high:.{digits}f})")


def main(
    out: Annotated[Path, typer.Option(help="Folder for table, figures and rows that are done.")] = ROOT
    / "runs/real_arms",
    data: Annotated[Path, typer.Option(envvar="PICKENV_DATA", help="Folder of the measured data sets.")] = ROOT
    / "../shared/data",
    only: Annotated[list[str] | None, typer.Option(help=f"Only these rows: {', '.join(ROWS)}.")] = None,
) -> None:
    """Judge every row and print the table."""
    log, found = Console(stderr=True), {}
    for name in only or ROWS:
        row = ROWS[name]
        files, others = files_of(row, data)
        kept = out / f"{name}_{key_of(row, [*files, *others])}.json"
        if not kept.is_file():
            log.print(f"{name} …", highlight=False)
            write_json(kept, figures_of(row, data))
        found[name] = json.loads(kept.read_text(encoding="utf-8"))
    table = table_of(found)
    print(table)
    print(NOTE)
    write_json(out / "real_arms.json", {"seed": SEED, "splits": SPLITS, "rows": found})
    write_text(out / "real_arms.md", table)


if __name__ == "__main__":
    typer.run(main)
