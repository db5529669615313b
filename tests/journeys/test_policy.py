"""The way of a policy: the documentation's lines train one, and print what it misses by raw and calibrated."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Ended

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "learning.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
LINES = BLOCKS[0]


def printed(lines: str, folder: Path, *words: str) -> str:
    """What lines of Python print in a folder of their own, given words as a command is."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", lines, *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0])
def test_a_policy_is_as_accurate_as_the_calibration_behind_it(seed: int, tmp_path: Path) -> None:
    """Simulated; the bounds are those that the page promises for seeds 0 to 4."""
    lines = LINES.replace("seed, plant = 0,", f"seed, plant = {seed},")
    assert f"seed, plant = {seed}," in lines
    said = printed(lines, tmp_path)
    left = {name: float(mm) for name, mm in re.findall(r"^(\w+): ([\d.]+) mm$", said, re.MULTILINE)}
    assert list(left) == ["raw", "ls", "ls_bpnn"]
    assert left["raw"] >= 1.5 and 0.45 <= left["ls"] <= 0.75 and left["ls_bpnn"] <= 0.35


@pytest.mark.slow
def test_a_policy_that_feels_its_fruit_picks_through_the_day_what_the_page_says(tmp_path: Path) -> None:
    """Simulated; a grasp or two may fall otherwise on another processor."""
    (lines,) = (block for block in BLOCKS if "ManyCanopies" in block)
    blind = lines.replace("FeelingPick(env, AdaptiveReach(env, camera_std=2e-3, prior=2.0))", "ScriptedPick(env)")
    blind = blind.replace("import AdaptiveReach, FeelingPick", "import ScriptedPick")
    promised = [int(number) for number in re.findall(r"It prints `(\d+) of (\d+) fruit`.*? comes to (\d+)\.", PAGE)[0]]
    picked = []
    for block in (lines, blind):
        picked += [int(number) for number in re.findall(r"(\d+) of (\d+) fruit", printed(block, tmp_path))[-1]]
    collected, tried, by_script, _ = picked
    assert abs(tried - promised[1]) <= 2
    assert abs(collected - promised[0]) <= 2 and abs(by_script - promised[2]) <= 2


def test_on_the_ladder_the_reference_controllers_are_worth_comparing_with(
    tmp_path: Path, typed: Callable[..., Ended]
) -> None:
    """From one command; simulated, five arms that nothing is learnt on, where readings and actions are late."""
    report = tmp_path / "found.json"
    command = ["evaluate", "--policy", "scripted", "--policy", "servo", "--compensation", "raw", "--arms", "5"]
    rungs = ["--plant", "rung:orchard", "--plant", "rung:own_eyes", "--episodes", "2", "--json", report]
    done = typed(*command, *rungs)
    assert done.returncode == 0, done.stderr
    rows = json.loads(report.read_text(encoding="utf-8"))["rows"]
    left = {(row["plant"], row["policy"]): row["mean_mm"] for row in rows}
    assert set(left) == {(plant, policy) for plant in rungs[1:4:2] for policy in ("scripted", "servo")}
    assert left["rung:orchard", "scripted"] < 6.0, "it swung at 71 mm"
    assert left["rung:orchard", "servo"] < left["rung:own_eyes", "servo"] < 1.0 < left["rung:own_eyes", "scripted"]
