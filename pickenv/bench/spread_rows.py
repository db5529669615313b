"""Rows of measured robots, each with its spread: over random splits, between blocks, or over other poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pickenv.arm import Arm
from pickenv.bench.real_sets import SETS, RealSet
from pickenv.calibration import Choices, Observations, Result, calibrate
from pickenv.calibration.pipeline.fitting import GEOMETRIC, NOMINAL

NOTE = (
    "Random fifths: mean over ten splits (lowest to highest). Blocks: each tenth of the file judged without itself, "
    "with the 95 % interval between blocks. Other poses: 95 % interval over poses. None where one "
    "block outweighs the others."
)
HEADS = ("robot and rows judged", "nominal (mm)", "geometry (mm)", "best model (mm)", "published (mm)")
JUDGED = {"random": "random fifths", "blocks": "blocks", "poses": "its 20 random poses"}
NOTHING = "nothing added"
SEEN = "the rule was settled with these poses in sight"

Figures = Mapping[str, Any]
"""Of one row: value and ends of each model in mm, models used, and number of rows."""


How = Literal["random", "blocks", "poses"]


@dataclass(frozen=True)
class SpreadRow:
    """One row of the table.

    Attributes:
        name: Of the set.
        how: Which rows judge: "random", "blocks", or "poses" of files of their own.
        terms: As `Choices` has it.
        residual: As `Choices` has it.
        statistic: "rms" or "mean".
        remark: Beside the best model.
    """

    name: str
    how: How
    terms: str = "none"
    residual: str = "none"
    statistic: Literal["rms", "mean"] = "rms"
    remark: str = ""

    @property
    def real(self) -> RealSet:
        """Its set."""
        return SETS[self.name]

    @property
    def published(self) -> float | None:
        """What others published of these rows, mean in mm: of the other poses, where there are such."""
        return self.real.published if self.how == ("poses" if self.real.poses else "random") else None


PLAIN_AND_BEST: tuple[tuple[How, str], ...] = (("random", "none"), ("blocks", "auto"))

SPREAD = {
    "ur5_random": SpreadRow("ur5", "random"),
    "ur5_blocks": SpreadRow("ur5", "blocks", "auto", "auto"),
    "ur5_poses": SpreadRow("ur5", "poses", "auto", "auto", "mean"),
    "wam_blocks": SpreadRow("wam", "blocks", "auto"),
    "wam_poses": SpreadRow("wam", "poses", "auto", "none", "mean", SEEN),
    **{
        f"ur10_{letter}_{how}": SpreadRow(f"ur10_{letter}", how, terms)
        for letter in "abcd"
        for how, terms in PLAIN_AND_BEST
    },
    "panda_random": SpreadRow("panda", "random", "auto", "none", "mean"),
    "panda_blocks": SpreadRow("panda", "blocks", "auto", "none", "mean"),
    "positioner_random": SpreadRow("positioner", "random", "none", "none", "mean"),
    "positioner_blocks": SpreadRow("positioner", "blocks", "auto", "none", "mean"),
}  # type: dict[str, SpreadRow]
"""The rows by name, in the order of the table."""


def spread_figures(row: SpreadRow, data: Path, splits: int, seed: int) -> dict[str, Any]:
    """Judge one row: what is left by nominal, geometric and best model, each with its spread, mm.

    Args:
        row: The row.
        data: Folder of the data sets.
        splits: Random splits, drawn with so many seeds of one SeedSequence.
        seed: Of that sequence.
    """
    arm, rows, poses = row.real.load(data)
    if row.how != "random":
        choices = Choices(terms=row.terms, residual=row.residual)
        judges = poses if row.how == "poses" else None
        result = calibrate(arm, rows, test=judges, split="blocked", choices=choices)
        return {"models": stated(row, result), "used": result.held_out.used, "rows": len(rows.joints)}
    results = [judged_split(arm, rows, row, int(word)) for word in np.random.SeedSequence(seed).generate_state(splits)]
    every = [{name: ends[0] for name, ends in stated(row, result).items()} for result in results]
    models = {
        name: [float(f(np.array([each[name] for each in every]))) for f in (np.mean, np.min, np.max)]
        for name in every[0]
    }
    return {"models": models, "used": [result.best_model for result in results], "rows": len(rows.joints)}


def judged_split(arm: Arm, rows: Observations, row: SpreadRow, seed: int) -> Result:
    """One random split."""
    return calibrate(arm, rows, choices=Choices(terms=row.terms, residual=row.residual, seed=seed))


def stated(row: SpreadRow, result: Result) -> dict[str, list[float | None]]:
    """Value and 95 % interval of each model that the table names, mm."""
    found = {}
    last = list(result.position)[-1]
    for label, name in {"nominal": NOMINAL, "geometry": GEOMETRIC, "best": last}.items():
        statistics = result.position[name]
        ends = getattr(statistics, f"{row.statistic}_ci95")
        found[label] = [getattr(statistics, row.statistic), *(ends or (None, None))]
    return found


def used_words(figures: Figures) -> str:
    """The models that were best, in words."""
    used = list(dict.fromkeys(figures["used"]))
    return "; ".join(text.removeprefix("geometry").replace("+", ", ").strip(", ") or NOTHING for text in used)


def spread_table(found: Mapping[str, Figures]) -> str:
    """The Markdown table of the rows that were judged."""
    lines = [f"| {' | '.join(HEADS)} |", "|" + "---|" * len(HEADS)]
    for name, figures in found.items():
        row, models = SPREAD[name], figures["models"]
        best = ""
        if row.terms != "none":
            remark = f"; {row.remark}" if row.remark else ""
            best = f"{cell(models['best'])}: {used_words(figures)}{remark}"
        what = f"{row.real.robot}, {JUDGED[row.how]}, {'RMS' if row.statistic == 'rms' else 'mean'}"
        published = "" if row.published is None else f"{row.published:g}"
        cells = (what, cell(models["nominal"]), cell(models["geometry"]), best, published)
        lines.append("".join(f"| {text} " if text else "| " for text in cells) + "|")
    return "\n".join(lines) + "\n"


def cell(values: Sequence[float | None]) -> str:
    """A value with its spread in brackets, three digits after the point below 1 mm."""
    value, low, high = values
    assert value is not None
    digits = 3 if value < 1.0 else 2
    return f"{value:.{digits}f}" + ("" if low is None else f" ({low:.{digits}f} to {high:.{digits}f})")
