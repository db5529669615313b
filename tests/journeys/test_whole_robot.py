"""An owner of a robot with two arms on one torso: one fit, and the robot's own URDF corrected."""

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.calibration.whole_robots import built, drawn_robot, matrix, track

ROOT = Path(__file__).parents[2]
FORMATS = (ROOT / "docs/column-descriptions.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.slow


def test_both_arms_of_a_robot_are_calibrated_at_once(tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    robot = drawn_robot(rng)
    truth = replace(built(robot, rng), yields=(0.0, 4e-5, 0.0))
    (tmp_path / "robot.urdf").write_text(robot.urdf(), encoding="utf-8")
    section = re.search(r"^## \[scene\](.*?)^## ", FORMATS, re.MULTILINE | re.DOTALL)
    assert section is not None
    blocks = dict(re.findall(r"^```(\S[^\n]*)\n(.*?)^```$", section[1], re.MULTILINE | re.DOTALL))
    described, by_row = blocks["toml left.toml"], blocks["toml rows.toml"]
    joints = [name for name in robot.moving if not name.startswith("head")]
    for side in ("left", "right"):
        track(truth, joints, f"{side}_tip", tmp_path, rng, matrix((1.0, -0.5, 0.2)))
        (tmp_path / f"{side}_tip.csv").rename(tmp_path / f"{side}.csv")
        text = described.replace('"left ball"', f'"{side} ball"').replace('"left_tip"', f'"{side}_tip"')
        (tmp_path / f"{side}.toml").write_text(text, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    calibrate, export, verify = (shlex.split(line)[1:] for line in blocks["sh"].splitlines())
    screens = []
    track(truth, joints, "left_tip", tmp_path, rng, matrix((2.0, 0.4, 0.0)))  # another day, another station
    (tmp_path / "left_tip.csv").rename(tmp_path / "later.csv")
    tables = {side: (tmp_path / f"{side}.csv").read_text(encoding="utf-8").split() for side in ("left", "right")}
    rows = [f"tracker,{side},{row}" for side, (_, *some) in tables.items() for row in some]
    (tmp_path / "all.csv").write_text("\n".join([f"sensor,ball,{tables['left'][0]}", *rows]), encoding="utf-8")
    (tmp_path / "rows.toml").write_text(described.partition("[position]")[0] + by_row, encoding="utf-8")
    at_once = ["calibrate", "all.csv", "--columns", "rows.toml", *calibrate[-4:-1], "all.npz", "--json", "all.json"]
    for words in ([*calibrate, "--json", "robot.json"], ["check", "robot.npz"], export, at_once, verify):
        command = [sys.executable, "-m", "pickenv.cli", *words]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        screens.append(" ".join(done.stdout.split()))
    assert "1 checked, 0 refused" in screens[1]
    found, same = (json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8")) for name in ("robot", "all"))
    assert same["held_out"] == found["held_out"]
    nominal, left = (found["held_out"][f"{name}_rms_mm"] for name in ("nominal", "best"))
    assert screens[0].startswith("verdict: GOOD") and "geometry+compliance" in screens[0]
    assert nominal > 0.5 and left < 0.065  # of which the tracker's own noise is 0.052
    assert re.search(r"\d+ of 14 joint origins corrected: by up to", screens[2]), screens[2]
    assert "rigid links cannot hold it: compliance" in screens[2]
    assert (tmp_path / "robot_calibrated.urdf").is_file()
    assert screens[4].startswith("verdict: STILL GOOD"), screens[4]
