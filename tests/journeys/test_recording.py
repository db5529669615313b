"""An owner's logs of a moving arm → calibrated arm: the planted offset of the clocks is on the screen."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pickenv.arm import forward, load_plant

ROOT = Path(__file__).parents[2]
FORMATS = (ROOT / "docs/column-descriptions.md").read_text(encoding="utf-8")
OFFSET, NOISE = 0.083, 3e-5

pytestmark = pytest.mark.slow


def test_two_logs_calibrate_an_arm(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    plant = load_plant("cobot:ur5e")
    places = rng.uniform(-0.8, 0.8, (72, 6)) + np.array([0.0, -1.2, 1.2, 0.0, 0.9, 0.0])
    way = CubicSpline(np.arange(72) - 5.0, places)
    log, seen = np.arange(0.0, 60.0, 0.008), np.arange(0.5, 59.5, 0.031)
    header = "stamp,j1,j2,j3,j4,j5,j6"
    np.savetxt(tmp_path / "joints.csv", np.c_[log * 1e3, np.degrees(way(log))], "%.7f", ",", header=header, comments="")
    # Not `simulated_tracker`: its arm stops for each reading, not quite arrived, which looks like a later clock.
    position = forward(plant.geometry, way(seen)).position + NOISE * rng.normal(size=(len(seen), 3))
    values = np.c_[seen + OFFSET, position * 1e3]
    np.savetxt(tmp_path / "tracker.csv", values, "%.7f", ",", header="t,x,y,z", comments="")
    described = re.search(r"^```toml recording.toml\n(.*?)^```$", FORMATS, re.MULTILINE | re.DOTALL)
    assert described is not None
    joints = '[joints]\ncolumns = ["j1", "j2", "j3", "j4", "j5", "j6"]\nunit = "deg"\n'
    (tmp_path / "recording.toml").write_text(described[1] + joints, encoding="utf-8")
    words = "calibrate --arm ur5e --columns recording.toml tracker.csv --out my_arm.npz --json my_arm.json"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    command = [sys.executable, "-m", "pickenv.cli", *words.split()]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith(("verdict: GOOD", "verdict: WITH CARE"))
    screen = " ".join(done.stdout.split())
    said = re.search(r"from \d+ rows of motion; its clock is ([\d.]+) ± ([\d.]+) ms ahead", screen)
    assert said is not None, done.stdout
    offset, std = map(float, said.groups())
    (recorded,) = json.loads((tmp_path / "my_arm.json").read_text(encoding="utf-8"))["recordings"]
    assert recorded["offset_ms"] == pytest.approx(offset, abs=std)
    assert recorded["rows_from"] == "motion"
    assert abs(recorded["offset_ms"] - 1e3 * OFFSET) < 3.0 * recorded["offset_std_ms"]
    assert recorded["offset_std_ms"] < 2.0
