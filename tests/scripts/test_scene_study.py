"""The study of what an arm's error costs in contact: small, paired, the same again; and its page's curve."""

import importlib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pickenv.experiments import Rows, load_experiment, run

ROOT = Path(__file__).parents[2]
STUDY = ROOT / "scripts/studies/scene.toml"
PICKED = "Fruit picked (%)"


@pytest.fixture(scope="module")
def rows() -> Rows:
    """One UR5e, exact and off by 10 mm, one fruit."""
    pytest.importorskip("mujoco")
    small = {"arm": 1, "fruit": 1, "robot": ["ur5e"], "error_mm": [0.0, 10.0]}
    return run(load_experiment(STUDY, changes=small).experiment)


@pytest.mark.slow
def test_error_moves_the_cup_beside_the_fruit_and_a_calibration_or_eyes_bring_it_back(rows: Rows) -> None:
    assert len(rows) == 8 and rows.where(use="LS")["met"].all()

    def lateral(error: float, use: str) -> float:
        return float(rows.where(error_mm=error, use=use)["lateral_mm"].max())

    exact = lateral(0.0, "raw")
    assert lateral(10.0, "raw") > 5.0 > exact + 2.0
    assert lateral(10.0, "LS") == pytest.approx(exact, abs=0.5)
    assert lateral(10.0, "sees") < 5.0
    assert rows.where(error_mm=10.0, use="LS")["success"].sum() >= rows.where(error_mm=10.0, use="raw")["success"].sum()


@pytest.mark.slow
def test_the_same_arm_and_fruit_come_again(rows: Rows) -> None:
    changes = {"arm": 1, "fruit": 1, "robot": ["ur5e"], "error_mm": [10.0]}
    again, before = run(load_experiment(STUDY, changes=changes).experiment), rows.where(error_mm=10.0)
    for name in before.columns:
        np.testing.assert_array_equal(before[name], again[name])


def test_half_lies_where_the_falling_line_crosses_it() -> None:
    half = load_experiment(STUDY).functions["scene.py:half"]
    shares = [1.0, 0.9, 0.7, 0.3, 0.4, 0.0]
    assert half(np.array([[1.0] * 6 + shares])) == pytest.approx(5.0)
    untried = np.array([[1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.7, 0.0, 0.0, 0.1]])
    assert half(untried) == pytest.approx(6.0)
    assert half(np.array([[1.0] * 6 + [0.9] * 6])) == 10.0 and half(np.array([[1.0] * 6 + [0.2] * 6])) == 0.0


def test_the_curve_of_the_page_falls_raw_and_least_squares_hold_it_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "scripts")
    kept = importlib.import_module("claims").record()["rows"]
    found = {
        (row["levels"]["robot"], row["levels"]["use"], row["levels"]["error_mm"]): (row["value"], row["ci95"])
        for row in kept
        if (row["experiment"], row["title"]) == ("scene", PICKED)
    }
    file = load_experiment(STUDY)
    errors = list(file.experiment.factors["error_mm"])
    for robot in file.experiment.factors["robot"]:
        raw = [found[robot, "raw", error] for error in errors]
        for (_, (_, high)), (value, _) in pairwise(raw):
            assert value <= high
        assert raw[-1][1][1] < raw[0][1][0]
        assert found[robot, "LS", errors[-1]][1][0] > raw[-1][1][1]
