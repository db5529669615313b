"""A tracker's file → calibrate → wrapper → environment, as docs/commands.md prints it: the promise holds.

From an empty folder. The last number on the screen is the mean error in Reach-v0, mm (simulated arm qiao2026).
"""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
CALIBRATE = next(text.strip() for kind, text in BLOCKS if kind == "sh" and text.startswith("pickenv calibrate"))
REACH = next(text for kind, text in BLOCKS if kind == "python" and "run_reaches" in text)
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}

pytestmark = pytest.mark.slow


def run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)


def pickenv(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return run([sys.executable, "-m", "pickenv.cli", *shlex.split(line)[1:]], folder)


def reach(folder: Path) -> subprocess.CompletedProcess[str]:
    return run([sys.executable, "-c", REACH], folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder in which the demonstration was run."""
    folder = tmp_path_factory.mktemp("home")
    done = pickenv("pickenv demo --quick --out runs/demo", folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize(
    ("options", "low", "high"),
    [("", 0.0, 0.25), (" --frames known --terms none --residual none", 0.44, 0.56)],
    ids=["default model", "LS"],
)
def test_the_environment_shows_what_the_report_promises(folder: Path, options: str, low: float, high: float) -> None:
    done = pickenv(CALIBRATE + options, folder)
    assert done.returncode == 0, done.stderr
    grade = done.stdout.splitlines()[0]
    assert grade.startswith(("verdict: GOOD: ", "verdict: WITH CARE: "))
    told = json.loads((folder / "my_arm.json").read_text(encoding="utf-8"))
    assert told["frames"] == "known"  # the demonstration's own file says so
    shown = reach(folder)
    assert shown.returncode == 0, shown.stderr
    mean = float(re.fullmatch(r"(\d\.\d+) mm", shown.stdout.strip().splitlines()[-1])[1])
    assert low <= mean <= high
    promised = told["held_out"]["own_mean_ci95_mm"]
    assert promised[0] <= mean <= promised[1]


def test_fitted_frames_are_refused_until_named(folder: Path) -> None:
    done = pickenv(CALIBRATE + " --frames fitted --terms none --residual none", folder)
    assert done.returncode == 0, done.stderr
    told = json.loads((folder / "my_arm.json").read_text(encoding="utf-8"))
    low, high = told["base_frame"]["mean_ci95_mm"]
    assert f"in the robot's own base frame the mean error is {low:#.3g} to {high:#.3g} mm" in done.stdout
    refused = reach(folder)
    assert refused.returncode != 0
    said = refused.stderr.strip().splitlines()[-1]
    assert "base and tool of this calibration were fitted" in said and "`frames='known'`" in said
    trained = pickenv("pickenv train --compensate my_arm.npz --steps 1 --out runs/train", folder)
    assert trained.returncode == 2 and trained.stderr.startswith("error: base and tool of this calibration were fitted")
    assert "calibrate with --frames known" in trained.stderr
    accepted = REACH.replace("calibration.compensator())", 'calibration.compensator(), allow=["fitted-frames"])')
    assert accepted != REACH
    shown = run([sys.executable, "-c", accepted], folder)
    assert low <= float(shown.stdout.split()[-2]) <= high  # what the report says of the robot's own base frame holds
