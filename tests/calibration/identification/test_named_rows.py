"""Whatever is wrong with a row, held out or not: the message, the JSON and the page name its file and line."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from typer.testing import CliRunner

from pickenv.arm import load_arm, load_plant
from pickenv.base import InputError
from pickenv.calibration import random_joints, simulated_tracker
from pickenv.cli import app

ROWS = 90
JOINTS = ("q1_deg", "q2_mm", "q3_mm", "q4_deg", "q5_mm", "q6_deg")
POSITION, ATTITUDE = ("x_mm", "y_mm", "z_mm"), ("rx_deg", "ry_deg", "rz_deg")
UNITS = {"mm": 1e-3, "deg": np.pi / 180}
"""What a number becomes when its row was written in m or rad."""


@pytest.fixture(scope="module")
def tracker(tmp_path_factory, unwritten):
    """Header and rows of a file, and the folder for the spoilt ones; pages have no figures meanwhile."""
    plant = load_plant("qiao2026")
    rng = np.random.default_rng(11)
    folder = tmp_path_factory.mktemp("rows")
    data = simulated_tracker(plant, random_joints(plant.arm.nominal, ROWS, rng), rng)
    with data.write_csv(folder / "good.csv").open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    with unwritten():
        yield folder, header, rows


def calibrate(file: Path, *options: str):
    words = ["calibrate", str(file), "--arm", "qiao2026", "--terms", "none", "--residual", "none", *options]
    return CliRunner().invoke(app, words)


def spoilt(header, row, fault, column):
    """A row with a fault in a column, and how far it is off: mm, or degrees for an attitude."""
    cells = list(row)
    place = header.index(column)
    value = float(cells[place])
    if fault == "unit":
        changed = value * UNITS[column.rpartition("_")[2]]
    else:
        changed = value + {"mm": 25.0, "deg": 5.0}[column.rpartition("_")[2]]
    cells[place] = repr(changed)
    return cells, abs(changed - value)


def check(tracker, row, fault, column, page=True):
    folder, header, rows = tracker
    cells, off = spoilt(header, rows[row], fault, column)
    if off < {"mm": 25.0, "deg": 5.0}[column.rpartition("_")[2]] - 1e-9:
        return None  # the row is nearly as good as before
    file = folder / "tracker.csv"
    with file.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([header, *rows[:row], cells, *rows[row + 1 :]])
    report = ["--report", str(folder / "f.html")] if page else []
    found = calibrate(file, "--json", str(folder / "f.json"), *report)
    assert found.exit_code == 0, found.output
    (listed,) = json.loads((folder / "f.json").read_text(encoding="utf-8"))["left_out_rows"]
    assert (listed["file"], listed["line"]) == (str(file), row + 2)
    assert not page or f"tracker.csv: row {row + 2} " in (folder / "f.html").read_text(encoding="utf-8")
    assert f"tracker.csv: row {row + 2} " in found.output
    return listed["held_out"]


FAULTS = {
    "row": st.integers(0, ROWS - 1),
    "fault": st.sampled_from(["unit", "outlier"]),
    "column": st.sampled_from(JOINTS + POSITION + ATTITUDE),
}


@settings(max_examples=2, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(**FAULTS)
def test_any_row_with_any_fault_is_named(tracker, row, fault, column):
    """In message and JSON; that the page names them too is asked of one row below, and of many at length."""
    assume(check(tracker, row, fault, column, page=False) is not None)


@pytest.mark.thorough
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(**FAULTS)
def test_any_row_with_any_fault_is_named_at_length(tracker, row, fault, column):
    assume(check(tracker, row, fault, column) is not None)


@pytest.mark.slow
def test_held_out_rows_are_named_as_the_others_are(tracker):
    held_out = next(row for row in range(12) if check(tracker, row, "outlier", "y_mm", page=False))
    assert check(tracker, held_out, "outlier", "y_mm")


@pytest.mark.parametrize("text", ["", "abc", "nan", "1e300", "1_000"])
@pytest.mark.parametrize("column", ["q3_mm", "y_mm", "rz_deg"])
def test_cells_that_are_no_measurements_are_named(tracker, column, text):
    folder, header, rows = tracker
    cells = list(rows[40])
    cells[header.index(column)] = text
    file = folder / "cells.csv"
    with file.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([header, *rows[:40], cells, *rows[41:]])
    refused = calibrate(file)
    assert isinstance(refused.exception, InputError)
    assert f"cells.csv: row 42, column '{column}'" in str(refused.exception)


def test_mixed_frames_are_named(tracker):
    folder, header, rows = tracker
    changed = [list(row) for row in rows]
    changed[7][header.index("frames")] = "fitted"
    file = folder / "frames.csv"
    with file.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([header, *changed])
    assert "frames.csv: row 9 says fitted" in str(calibrate(file).exception)
    changed[7][header.index("frames")] = "unsure"
    with file.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([header, *changed])
    assert "frames.csv: row 9, column 'frames' holds 'unsure'; give known or fitted" in str(calibrate(file).exception)


def test_one_column_under_two_joints_is_named(tracker):
    folder, header, rows = tracker
    file = folder / "twice.csv"
    with file.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([header, *([row[0], row[1], row[1], *row[3:]] for row in rows)])
    joints = load_arm("qiao2026").nominal.joint_names
    assert f"joint 2 ({joints[1]}, column 'q2_mm') and joint 3 ({joints[2]}, column 'q3_mm') hold the same" in str(
        calibrate(file).exception
    )
