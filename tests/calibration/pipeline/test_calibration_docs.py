"""What docs/calibrating-a-robot.md says works: its blocks run in order, in an empty folder."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import load_plant
from pickenv.base.registry import names
from pickenv.calibration import load_description, random_joints, read_measurements, simulated_tracker
from pickenv.calibration.reading.table_files import CONVENTIONS

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs/calibrating-a-robot.md").read_text(encoding="utf-8")
FORMATS = (ROOT / "docs/column-descriptions.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w+)(?: +(\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s#]+)\)")


def run(command: list[str], folder: Path, expected: int = 0) -> str:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == expected, f"{shlex.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_every_block_is_run_or_written_to_a_named_file():
    kinds = {(kind, bool(name)) for kind, name, _ in BLOCK.findall(PAGE)}
    assert kinds == {("sh", False), ("python", False), ("toml", True), ("csv", True)}
    lines = [line for kind, _, text in BLOCK.findall(PAGE) if kind == "sh" for line in text.splitlines()]
    assert {shlex.split(line)[0] for line in lines} == {"pickenv"}
    assert {shlex.split(line)[1] for line in lines} == {"demo", "plan-poses", "calibrate", "verify", "apply", "export"}


def test_files_linked_exist():
    for page in (PAGE, FORMATS):
        assert [link for link in LINK.findall(page) if "://" not in link and not (ROOT / "docs" / link).exists()] == []


@pytest.mark.slow
def test_every_block_runs_in_order(tmp_path):
    said = ""
    for kind, name, text in BLOCK.findall(PAGE):
        if name:
            (tmp_path / name).write_text(text, encoding="utf-8")
        elif kind == "python":
            said += run([sys.executable, "-c", text], tmp_path)
        else:
            for line in text.splitlines():
                unreached = 3 if "targets.csv" in line else 0  # the page says so: its third target cannot be reached
                said += run([sys.executable, "-m", "pickenv.cli", *shlex.split(line)[1:]], tmp_path, unreached)
    assert "base and tool of this calibration were fitted" in said
    assert (tmp_path / "registered.npz").is_file()
    assert "2 of 3 targets can be reached" in said and "row 4: no joints" in said
    assert (tmp_path / "my_arm.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


JOINTS = '[joints]\ncolumns = ["j1", "j2", "j3", "j4", "j5", "j6"]\nunit = "deg"\n'
"""What every file needs, and the page writes but once."""
DESCRIBED = {
    given: f"\n{text}" + JOINTS * ("[joints]" not in text)
    for kind, given, text in BLOCK.findall(FORMATS)
    if kind == "toml"
}


@pytest.mark.parametrize("name", DESCRIBED)
def test_described_formats_are_read(tmp_path, name):
    path = tmp_path / name
    path.write_text(DESCRIBED[name], encoding="utf-8")
    assert load_description(path).joint_units


def test_every_kind_is_described_with_an_example():
    kinds = (*names("instrument"), "pixels")
    shown = {kind for kind in kinds if any(f"\n[{kind}]\n" in text for text in DESCRIBED.values())}
    assert shown == set(kinds)


def test_every_convention_is_documented():
    assert set(CONVENTIONS) == set(re.findall(r"`(\w+)`", FORMATS)) & set(CONVENTIONS)


def test_the_pages_ten_lines_describe_the_demos_file(tmp_path):
    (text,) = (text for kind, _, text in BLOCK.findall(PAGE) if kind == "toml")
    path = tmp_path / "my_tracker.toml"
    path.write_text(text, encoding="utf-8")
    plant = load_plant("qiao2026")
    rng = np.random.default_rng(0)
    data = simulated_tracker(plant, random_joints(plant.arm.nominal, 5, rng), rng)
    again = read_measurements(data.write_csv(tmp_path / "measurements.csv"), plant.arm.nominal, path)
    np.testing.assert_allclose(again.joints, data.joints, atol=1e-12)
    np.testing.assert_allclose(again.rotation, data.rotation, atol=1e-12)
    assert again.position_std == pytest.approx(data.position_std, abs=5e-7)
    assert again.attitude_std == pytest.approx(np.radians(0.012))
