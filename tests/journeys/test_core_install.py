"""From an empty environment: the core alone calibrates a robot, and each extra brings what it is for.

Every step is typed as its user would, before the extra is there and after it.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import load_plant
from pickenv.calibration import random_joints, simulated_tracker

ROOT = Path(__file__).parents[2]
CORE_MB = 300
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"MPLBACKEND": "Agg"}
"""Without what hides the installed package."""

CALIBRATE = ("calibrate", "rows.csv", "--arm", "qiao2026", "--terms", "none")
STUDY = ("study", str(ROOT / "scripts/tolerance_study.toml"), "--quick", "--executor", "batched")
STEPS: dict[str, tuple[str, ...]] = {
    "inspect": (*CALIBRATE, "--residual", "none", "--report", "a.html"),
    "learn": (*CALIBRATE, "--residual", "bpnn", "--force", "--out", "n.npz"),
    "camera": ("board", "charuco_a4", "--out", "board.svg"),
    "study": (*STUDY, "--no-report", "--out", "study"),
    "rl": ("train", "--steps", "512", "--out", "policy"),
    "export": ("export", "n.npz", "--out", "n.onnx"),
}
"""What is typed for the sake of each extra, in the order in which they are installed."""


def say(*words: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """What a command says and how it ends."""
    texts = [str(word) for word in words]
    return subprocess.run(texts, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, check=False)


def megabytes(folder: Path) -> float:
    """What a folder takes on the disk."""
    return sum(path.lstat().st_blocks * 512 for path in folder.rglob("*")) / 1e6


@pytest.mark.slow
def test_the_core_calibrates_and_one_extra_after_the_other_brings_the_rest(tmp_path: Path) -> None:
    environment = tmp_path / "environment"
    made = say(sys.executable, "-m", "venv", environment, cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    python, pickenv = environment / "bin/python", environment / "bin/pickenv"

    def install(what: str) -> None:
        pip = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
        done = say(*pip, "-c", ROOT / "constraints.txt", what, cwd=tmp_path)
        if "No matching distribution" in done.stderr or "Connection" in done.stderr:
            pytest.skip(f"no package index to install {what} from: {done.stderr.strip().splitlines()[-1]}")
        assert done.returncode == 0, done.stderr

    install(str(ROOT))
    size = megabytes(environment)
    assert size <= CORE_MB, f"{size:.0f} MB"
    qiao, rng = load_plant("qiao2026"), np.random.default_rng(0)
    simulated_tracker(qiao, random_joints(qiao.arm.nominal, 100, rng), rng).write_csv(tmp_path / "rows.csv")
    core = say(pickenv, "calibrate", "rows.csv", "--arm", "qiao2026", "--out", "core.npz", cwd=tmp_path)
    assert core.returncode == 0, core.stderr
    assert "verdict: GOOD" in core.stdout
    assert "bpnn" in core.stdout and "pip install 'pickenv[learn]'" in core.stdout
    shown = say(pickenv, "demo", "--quick", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert "pip install 'pickenv[learn,inspect]'" in shown.stdout and "LS+BPNN" not in shown.stdout
    for extra, words in STEPS.items():
        missed = say(pickenv, *words, cwd=tmp_path)
        assert missed.returncode == 2
        if extra not in ("export", "camera"):  # the network is not there yet, and a board's drawing comes with inspect
            assert re.fullmatch(rf"error: .*pip install 'pickenv\[{extra}\]'\n", missed.stderr), (extra, missed.stderr)
    for extra, words in STEPS.items():
        if extra == "export":
            missed = say(pickenv, *words, cwd=tmp_path)
            assert missed.stderr.endswith("pip install 'pickenv[export]'\n"), missed.stderr
        install(f"pickenv[{extra}]")  # as the sentence says: it adds to what is installed, and asks no index for us
        done = say(pickenv, *words, cwd=tmp_path)
        assert done.returncode == 0, (extra, done.stderr)
    for written in ("a.html", "n.npz", "n.onnx", "board.svg", "study", "policy"):
        assert (tmp_path / written).exists(), written
