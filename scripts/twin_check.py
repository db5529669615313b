"""Does a calibrated arm's twin predict what a correction gains? UR5's measured set, each row judged without its fold.

For each fold a twin is made of the other rows, and arms are drawn from it. Each drawn arm is measured at the same poses
with the instrument's scatter, calibrated by LS, LS with terms and LS with a Gaussian process, and judged on the fold's
poses: the gain predicted. Beside it stands the gain that the same calibrations have on the fold's measured rows, which
the twin never saw. Gains are shares of what LS leaves (of LS: of what base and tool leave), RMS over all folds.

Run: python scripts/twin_check.py [--split blocked] [--draws 8] [--out runs/twin_check]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from scipy.stats import t as student

from pickenv.arm import Array, Plant, draw_plants, load_arm, load_tolerances, plant_at
from pickenv.calibration import Choices, Measurements, Result, calibrate, simulated_tracker
from pickenv.calibration.model.splits import Rows, contiguous_folds
from pickenv.calibration.pipeline.fitting import fit_remainder
from pickenv.calibration.reading.read import read_measurements
from pickenv.errors import InputError
from pickenv.files import write_json

ROOT = Path(__file__).parents[1]
UR5 = "ur5_wam_jacobi2025/UR5/*grid*cleaned.csv"
SEED, FOLDS = 0, 5
STEPS = {"LS": "nominal", "LS + terms": "LS", "LS + GP": "LS"}
"""The calibrations, and what each one's gain is a share of."""

Squares = dict[str, Array]
"""Squared position errors of the rows held out, by calibration, m^2."""


def calibrated(train: Measurements, test: Measurements, rng: np.random.Generator) -> tuple[Squares, Result]:
    """Squared errors of the rows held out, and the calibration with terms."""
    result = calibrate(load_arm("ur5"), train, test=test, choices=Choices(residual="none", robust=False))
    process = fit_remainder(result.geometric, "gp", train, rng).calibration
    errors = {"nominal": result.errors["nominal"], "LS": result.errors["geometric"]}
    errors |= {"LS + terms": result.fit.calibration.errors(test), "LS + GP": process.errors(test)}
    return {name: np.sum(left[:, :3] ** 2, axis=1) for name, left in errors.items()}, result


def simulated(plant: Plant, rows: Measurements, rng: np.random.Generator) -> Measurements:
    """What the instrument sees of an arm at the joints of these rows."""
    seen = simulated_tracker(plant, rows.joints, rng)
    return replace(rows, position=seen.position, rotation=None if rows.rotation is None else seen.rotation)


def folds_of(count: int, split: str) -> list[tuple[Rows, Rows]]:
    """Rows to fit and rows held out: of a shuffled file, or contiguous blocks of it."""
    order = np.random.default_rng(SEED).permutation(count) if split == "random" else np.arange(count)
    return [
        (np.sort(order[fitted]), np.sort(order[held]))
        for fitted, held in contiguous_folds(np.zeros(count, dtype=np.int64), FOLDS)
    ]


def gains(squares: Mapping[str, Array]) -> dict[str, float]:
    """Share of the error that each calibration removes."""
    rms = {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}
    return {name: 1.0 - rms[name] / rms[before] for name, before in STEPS.items()}


def joined(parts: Sequence[Squares]) -> Squares:
    """The rows of all folds."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def measured_interval(parts: Sequence[Squares], split: str, rng: np.random.Generator) -> dict[str, list[float]]:
    """95 % intervals of measured gains: over rows of random folds, over blocks where neighbours are alike."""
    tables = []
    rows = joined(parts)
    count = len(rows["LS"])
    blocks = np.array_split(np.arange(count), count if split == "random" else 10)
    for _ in range(2000):
        chosen = np.concatenate([blocks[i] for i in rng.integers(len(blocks), size=len(blocks))])
        tables.append(list(gains({name: values[chosen] for name, values in rows.items()}).values()))
    return dict(zip(STEPS, np.quantile(tables, [0.025, 0.975], axis=0).T.tolist(), strict=True))


def checked(data: Path, split: str, draws: int) -> dict[str, Any]:
    """Gains predicted and measured, each with its 95 % interval."""
    files = sorted(data.glob(UR5))
    if not files:
        raise InputError(f"no {UR5} in {data}; name the folder of the data sets in PICKENV_DATA")
    rows = read_measurements(files[0], load_arm("ur5").nominal, "ur5_jacobi2025")
    seeds = np.random.SeedSequence(SEED).spawn(FOLDS)
    parts: list[Squares] = []
    predicted: list[list[Squares]] = [[] for _ in range(draws)]
    for seed, (fitted, held) in zip(seeds, folds_of(len(rows), split), strict=True):
        first, drawing, *others = seed.spawn(2 + draws)
        squares, result = calibrated(rows.select(fitted), rows.select(held), np.random.default_rng(first))
        parts.append(squares)
        plant = result.plant()
        arms = draw_plants(plant, load_tolerances("medium"), draws, np.random.default_rng(drawing))
        for number, other in enumerate(others):
            arm, rng = plant_at(arms, number), np.random.default_rng(other)
            train, test = (simulated(arm, rows.select(part), rng) for part in (fitted, held))
            predicted[number].append(calibrated(train, test, rng)[0])
    every = [gains(joined(each)) for each in predicted]
    seen, intervals = gains(joined(parts)), measured_interval(parts, split, np.random.default_rng(SEED))
    found: dict[str, Any] = {"split": split, "folds": FOLDS, "draws": draws, "rows": len(rows), "gains": {}}
    for name in STEPS:
        values = np.array([each[name] for each in every])
        spread = float(student.ppf(0.975, draws - 1) * values.std(ddof=1) * np.sqrt(1.0 + 1.0 / draws))
        found["gains"][name] = {
            "predicted": float(values.mean()),
            "predicted_95": [float(values.mean()) - spread, float(values.mean()) + spread],
            "measured": seen[name],
            "measured_95": intervals[name],
            "ratio": float(values.mean()) / seen[name],
        }
    scale = {"measured": joined(parts), "predicted": joined([part for each in predicted for part in each])}
    found["rms_mm"] = {
        which: {name: float(1e3 * np.sqrt(np.mean(values))) for name, values in squares.items()}
        for which, squares in scale.items()
    }
    return found


def table_of(found: Mapping[str, Any]) -> str:
    """The table in Markdown."""
    lines = ["| calibration | gain predicted by the twin | gain measured | ratio |", "|---|---|---|---|"]
    for name, row in found["gains"].items():
        cells = [
            f"{row[key]:.1%} ({row[f'{key}_95'][0]:.1%} to {row[f'{key}_95'][1]:.1%})"
            for key in ("predicted", "measured")
        ]
        lines.append(f"| {name} | {cells[0]} | {cells[1]} | {row['ratio']:.2f} |")
    return "\n".join(lines)


def main(
    split: Annotated[Literal["random", "blocked"], typer.Option(help="How rows are held out.")] = "random",
    draws: Annotated[int, typer.Option(help="Arms drawn for each fold.", min=2)] = 8,
    out: Annotated[Path, typer.Option(help="Folder for the figures.")] = ROOT / "runs/twin_check",
    data: Annotated[Path, typer.Option(envvar="PICKENV_DATA", help="Folder of the measured data sets.")] = ROOT
    / "../shared/data",
) -> None:
    """Compare and print the table."""
    found = checked(data, split, draws)
    print(table_of(found))
    print(found["rms_mm"])
    write_json(out / f"{split}.json", found)


if __name__ == "__main__":
    typer.run(main)
