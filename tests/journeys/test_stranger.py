"""A package of somebody else's, written from docs/extending.md alone: its residual model, effect, policy and gripper
stand beside ours in help, schemas, calibrations, comparisons and files, which are refused where the package is absent.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Ended
from tests.journeys.pages import ENVIRONMENT, ROOT

PACKAGE = Path(__file__).parent / "stranger"
ABSENT = "comes from the package forest-for-pickenv 1.2, which is not installed: pip install forest-for-pickenv"
RAISED = """
import numpy as np, pickenv
from pickenv.calibration import random_joints, simulated_tracker
plant, rng = pickenv.load_plant("soft.toml"), np.random.default_rng(0)
rows = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
np.save("rows.npy", np.hstack([np.degrees(rows.joints), 1e3 * rows.position]))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder beside which the package is installed, as pip leaves it behind."""
    folder = tmp_path_factory.mktemp("stranger")
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    site = folder / "site"
    info = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir(parents=True)
    for module in PACKAGE.glob("*.py"):
        (site / module.name).write_text(module.read_text(encoding="utf-8"), encoding="utf-8")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = []
    for group, names in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {place}" for name, place in names.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    (folder / "soft.toml").write_text('arm = "ur5"\n[soft_ground]\nsink_mm = 2.0\n')
    return folder


def run(folder: Path, *words: str, installed: bool = True) -> tuple[int, str]:
    """Exit code and all words of a command, with the package installed or without it."""
    paths = [str(ROOT), *([str(folder / "site")] if installed else [])]
    environment = ENVIRONMENT | {"PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, *(words if words[0] == "-c" else ("-m", "pickenv.cli", *words))]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def made(folder: Path, *words: str) -> str:
    code, said = run(folder, *words)
    assert code == 0, said
    return said


def test_it_is_written_in_under_80_lines() -> None:
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in PACKAGE.iterdir() if path.is_file()) < 80


SEVERAL = """
import sys
from pickenv.cli import main
sys.stderr = sys.stdout
for line in sys.argv[1:]:
    sys.argv = ["pickenv", *line.split()]
    print("$", line)
    try:
        main()
    except SystemExit as error:
        print("exit", error.code)
"""
"""Several commands in one process, and the exit code of each."""


@pytest.mark.slow
def test_its_names_stand_in_help_and_schemas(folder: Path) -> None:
    """They stand in every list; without the package they do not, and a name that is none is refused with the others."""
    wanted = {
        "calibrate --help": ["bpnn, rbf, gp, forest"],
        "compare --help": ["adaptive, patient", "cup, hand, funnel"],
        "evaluate --help": ["adaptive, patient", "cup, hand, funnel"],
        "schema plant": ['"soft_ground"', '"sink_mm"'],
        "schema gripper": ['"mouth_mm"'],
        "compare impatient": ["adaptive, patient, a shipped baseline", "exit 2"],
    }
    said = made(folder, "-c", SEVERAL, *wanted).split("$ ")[1:]
    told = {line: " ".join(rest.split()) for line, _, rest in (part.partition("\n") for part in said)}
    assert list(told) == list(wanted)
    for line, names in wanted.items():
        assert [name for name in names if name not in told[line]] == [], line


def test_without_it_they_do_not(typed: Callable[..., Ended]) -> None:
    done = typed("compare", "patient")
    assert done.returncode == 2
    assert "random, scripted, oracle, servo, adaptive, a shipped baseline" in done.stdout + done.stderr


def written_rows(folder: Path) -> Path:
    """The simulated tracker's rows as our own CSV."""
    path = folder / "rows.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*(f"q{i + 1}_deg" for i in range(6)), "x_mm", "y_mm", "z_mm"])
        writer.writerows(np.load(folder / "rows.npy").tolist())
    return path


@pytest.mark.slow
def test_its_residual_model_is_learnt_saved_and_asked_for(folder: Path) -> None:
    made(folder, "-c", RAISED)
    rows = str(written_rows(folder))
    words = ("--arm", "ur5", "--terms", "none", "--residual", "forest", "--force", "--out", "soft.npz")
    code, said = run(folder, "calibrate", rows, "--arm", "ur5", "--residual", "woods")
    assert code == 2 and said == "error: there is no residual 'woods'; give one of bpnn, rbf, gp, forest\n"
    assert "geometry+forest" in made(folder, "calibrate", rows, *words)
    header = (
        "from pickenv.base.container import read_container as read; print(read('soft.npz', None, remake='').header"
        "['residual_from'])"
    )
    assert made(folder, "-c", header) == "{'package': 'forest-for-pickenv', 'version': '1.2', 'module': ''}\n"
    assert "sound" in made(folder, "check", "soft.npz")
    code, said = run(folder, "check", "soft.npz", installed=False)
    assert code != 0 and f"residual 'forest' {ABSENT}" in " ".join(said.split())
    code, said = run(folder, "verify", "soft.npz", rows, installed=False)
    assert code == 2 and f"residual 'forest' {ABSENT}" in " ".join(said.split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "needs"),
    [
        (("compare", "scripted", "patient", "--plant", "soft.toml", "--gripper", "funnel"), True),
        (
            ("evaluate", "--policy", "patient", "--plant", "soft.toml", "--gripper", "funnel"),
            False,
        ),
    ],
)
def test_its_policy_effect_and_gripper_stand_beside_ours(folder: Path, words: tuple[str, ...], needs: bool) -> None:
    few = {"compare": ("--episodes", "3"), "evaluate": ("--arms", "2", "--episodes", "2", "--workers", "1")}[words[0]]
    more = () if words[0] == "compare" else ("--compensation", "raw", "--feedback", "encoders")
    said = made(folder, *words, *few, *more, "--out", f"runs/{words[0]}")
    assert "patient" in said and "funnel" in said and "soft" in said
    record = json.loads((folder / "runs" / words[0] / "run.json").read_text(encoding="utf-8"))
    assert record["versions"]["forest-for-pickenv"] == "1.2"
    code, refused = run(folder, "figures", f"runs/{words[0]}", installed=False)
    assert code == (2 if needs else 0) and (f"effect 'soft_ground' {ABSENT}" in " ".join(refused.split())) == needs
    assert "soft ground" in made(folder, "effects", "--plant", "soft.toml")
    code, refused = run(folder, "effects", "--plant", "soft.toml", installed=False)
    assert code == 2 and "unknown key 'soft_ground'" in refused


STUDY = """
plant = "soft.toml"
arms = 2
chunk = 2
[picking]
fruit = 2
[specification]
radius_mm = 2.0
share = 0.9
[tolerances]
classes = ["medium"]
[calibration]
methods = ["raw", "ls+rbf", "ls+forest"]
residual_poses = 40
"""


@pytest.mark.slow
def test_its_residual_model_has_its_row_in_a_study(folder: Path) -> None:
    (folder / "study.toml").write_text(STUDY)
    made(folder, "study", "study.toml", "--out", "runs/study", "--executor", "serial")
    rows = json.loads((folder / "runs/study/summary.json").read_text(encoding="utf-8"))["yield"]
    assert [row["method"] for row in rows] == ["raw", "ls+rbf", "ls+forest"]
    code, said = run(folder, "study", "study.toml", "--out", "runs/other", installed=False)
    assert code == 2 and "'ls+forest'; give one of raw, ls, ls+bpnn, ls+rbf, ls+gp" in said
