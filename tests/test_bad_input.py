"""`pickenv calibrate` answers bad input with one sentence and a non-zero exit, and leaves nothing behind."""

import csv
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.arm import ARMS, load_plant
from pickenv.calibration import random_joints, simulated_tracker

Table = list[list[str]]

QIAO = ["tracker.csv", "--arm", "qiao2026"]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    """Sixty good poses of the hybrid arm, as our own CSV format holds them: a header and rows."""
    plant = load_plant("geometry_only")
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("good") / "tracker.csv"
    simulated_tracker(plant, random_joints(plant.geometry, 60, rng), rng).write_csv(path)
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def column(table: Table, name: str) -> int:
    return table[0].index(name)


def without_column(table: Table) -> Table:
    return [[cell for i, cell in enumerate(row) if i != column(table, "y_mm")] for row in table]


def renamed(table: Table) -> Table:
    return [[name.replace("q1_deg", "q1_gon") for name in table[0]], *table[1:]]


def with_nan(table: Table) -> Table:
    bad = [list(row) for row in table]
    bad[8][column(table, "x_mm")] = "nan"
    return bad


def degrees_called_radians(table: Table) -> Table:
    return [[name.replace("_deg", "_rad") for name in table[0]], *table[1:]]


def few(table: Table) -> Table:
    return table[:4]


def nothing(table: Table) -> Table:
    return []


# case: what happens to the good table, the arguments, and what the sentence must name
CASES: dict[str, tuple[Callable[[Table], Table] | None, list[str], str]] = {
    "missing file": (None, ["nowhere.csv", "--arm", "qiao2026"], r"nowhere\.csv does not exist"),
    "empty file": (nothing, QIAO, r"tracker\.csv is empty"),
    "missing column": (without_column, QIAO, r"y_mm"),
    "unknown unit": (renamed, QIAO, r"unit 'gon'"),
    "NaN row": (with_nan, QIAO, r"row 9, column 'x_mm'"),
    "degrees given as radians": (degrees_called_radians, QIAO, r"probably deg"),
    "too few poses for the rank": (
        few,
        [*QIAO, "--fit", "full", "--test-rows", "1"],
        r"too few .* measure at least \d+ poses",
    ),
    "unknown arm": (None, ["tracker.csv", "--arm", "ur55"], r"unknown arm 'ur55'.*ur5"),
    "arm file with a missing joint": (None, ["tracker.csv", "--arm", "short.toml"], r"short\.toml: joint 6 is missing"),
    "unknown columns": (None, [*QIAO, "--columns", "my_tracker"], r"unknown column description 'my_tracker'"),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_gets_one_sentence(
    case: str, table: Table, tmp_path: Path, typed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    spoil, arguments, said = CASES[case]
    with (tmp_path / "tracker.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(spoil(table) if spoil else table)
    arm = (ARMS / "qiao2026.toml").read_text(encoding="utf-8")
    (tmp_path / "short.toml").write_text(arm[: arm.rindex("[[joints]]")], encoding="utf-8")
    before = sorted(tmp_path.iterdir())

    monkeypatch.chdir(tmp_path)
    done = typed("calibrate", *arguments, "--json", "out.json")

    message = " ".join(done.stderr.split())
    assert done.returncode not in (0, None)
    assert "Traceback" not in done.stderr
    assert re.search(said, message), message
    assert len(done.stderr.strip().splitlines()) <= 5, done.stderr
    assert sorted(tmp_path.iterdir()) == before
