"""The table of predicted and measured gains is whole, adds up, and bears out what the page says of it."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from pickenv.experiments import SETS, gains, measured_gains, robot_tables, robots

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/twin.md").read_text(encoding="utf-8")
TABLE = f"_static/{robot_tables.GAINS_FILE}"
POINTS, SIGNS = 8.0, 0.8
"""What is asked: the median difference in percentage points at most, and how often the sign is right at least."""


def rows() -> list[list[str]]:
    """The file's rows, as `pickenv bench calibration` writes them."""
    assert f":file: {TABLE}\n" in PAGE and f"({TABLE})" in PAGE
    with (ROOT / "docs" / TABLE).open(newline="", encoding="utf-8") as file:
        heads, *found = csv.reader(file)
    assert tuple(heads) == robot_tables.GAIN_HEADS
    return found


def share(cell: str) -> tuple[float, float, float]:
    found = re.fullmatch(r"(-?[\d.]+) % \((-?[\d.]+) to (-?[\d.]+)\)", cell)
    assert found is not None, cell
    return float(found[1]), float(found[2]), float(found[3])


def test_every_model_stands_for_every_robot_and_split_that_is_shown() -> None:
    known = {(SETS[name].robot, robot_tables.HELD[split]) for name, split in robots.GAINS.values()}
    shown = [(robot, held) for robot, held, *_ in rows()]
    assert set(shown) <= known
    assert [model for _, _, model, *_ in rows()] == list(robots.BEFORE) * (len(shown) // len(robots.BEFORE))
    assert len({robot for robot, held in shown if held == robot_tables.HELD["blocks"]}) >= 5


def test_differences_and_shares_are_those_of_the_figures_beside_them() -> None:
    for *_, before, left, predicted, measured, apart in rows():
        (said, *ends), (seen, *seen_ends) = share(predicted), share(measured)
        assert ends[0] < said < ends[1] and seen_ends[0] < seen < seen_ends[1]
        assert abs(float(apart) - (said - seen)) < 0.11
        assert abs(seen - 100.0 * (1.0 - float(left) / float(before))) < 0.7


def test_the_page_says_of_its_table_what_the_command_says() -> None:
    """Model by model beside the mean of the other robots; of terms a twin promises nothing."""
    splits = {held: split for split, held in robot_tables.HELD.items()}
    found = robot_tables.agreement(
        [
            {"robot": row[0], "split": splits[row[1]], "model": row[2]}
            | {"predicted_reduction": share(row[5])[0] / 100, "measured_reduction": share(row[6])[0] / 100}
            for row in rows()
        ]
    )
    for row in found["models"]:
        twin, null = (
            f"{row[f'{whose}median_points']:.1f} (at most {row[f'{whose}worst_points']:.1f})" for whose in ("", "null_")
        )
        assert f"| {row['model']} | {twin} | {null} |" in PAGE
    assert f"{found['gains']} gains on contiguous blocks" in PAGE
    assert f"learnt residual does is right in {100.0 * found['sign_right']:.0f} %." in PAGE
    assert np.median([abs(float(row[-1])) for row in rows()]) <= POINTS
    by_model = {row["model"]: row for row in found["models"]}
    assert all(model["worst_points"] < model["null_worst_points"] for model in found["models"])
    for model in ("terms", "GP", "BPNN"):
        row = by_model[f"{gains.LS} + {model}"]
        assert row["median_points"] < row["null_median_points"]
    assert by_model[gains.LS]["median_points"] < POINTS
    assert found["learnt_on_blocks"] >= 10 and found["sign_right"] >= SIGNS


@pytest.mark.parametrize("model", [f"{gains.LS} + terms", f"{gains.LS} + BPNN", f"{gains.LS} + GP"])
def test_the_demonstrations_measured_arms_are_those_of_the_page(model: str) -> None:
    blocks = [row for row in rows() if row[1] == robot_tables.HELD["blocks"] and row[2] == model]
    assert [(arm.arm, f"{arm.ls_mm:.3f}") for arm in measured_gains(model)] == [(row[0], row[3]) for row in blocks]
    for arm, row in zip(measured_gains(model), blocks, strict=True):
        assert [100 * arm.removed, 100 * arm.lowest, 100 * arm.highest] == pytest.approx(share(row[6]))
    content = json.loads(gains.MEASURED.read_text(encoding="utf-8"))
    assert all(f"| {arm['arm']} | {arm['rows']} | {arm['rows_in_file']} |" in PAGE for arm in content["arms"])
    assert f"{content['folds']} folds" in PAGE and f"`{content['made_by']}`" in PAGE


def test_the_results_measured_arms_are_those_of_the_page() -> None:
    """Their shares are the ledger's, which are those of the demonstration."""
    results = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    shown = [row.split(" | ") for row in re.findall(r"^\| (.*, measured \|.*) \|$", results, re.M)]
    models = [f"{gains.LS} + {name}" for name in ("BPNN", "GP", "terms")]
    by_model = [measured_gains(model) for model in models]
    assert [row[:2] for row in shown] == [[f"{arm.arm}, measured", f"{arm.ls_mm:.2f}"] for arm in by_model[0]]
    ledger = json.loads((ROOT / "docs/_static/claims.json").read_text(encoding="utf-8"))["rows"]
    told = {
        (row["levels"]["robot"], row["levels"]["model"]): (row["levels"]["row"], [row["value"], *row["ci95"]])
        for row in ledger
        if row["experiment"] == "measured_gains"
    }
    for row, arms in zip(shown, zip(*by_model, strict=True), strict=True):
        for cell, model, arm in zip(row[2:], models, arms, strict=True):
            name, figures = told[arm.arm, model]
            assert f'"of":"measured_gains","title":"Removed","row":"{name}","model":"{model}"' in cell
            assert [round(figure, 3) for figure in figures] == [arm.removed, arm.lowest, arm.highest]
