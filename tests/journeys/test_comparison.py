"""Two policies → `pickenv compare` → who is better, where and by how much, as docs/comparing-policies.md prints it."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/comparing-policies.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ENVIRONMENT = os.environ | {
    "PYTHONPATH": str(ROOT),
    "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    "MPLBACKEND": "Agg",
    "COLUMNS": "200",
}


def commands() -> list[list[str]]:
    """Programs and commands of the page in their order; a viewer is not opened."""
    found = []
    for language, text in BLOCK.findall(PAGE):
        if language == "python":
            found.append([sys.executable, "-c", text])
        else:
            lines = [shlex.split(line) for line in text.splitlines()]
            found += [[sys.executable, "-m", "pickenv.cli", *line[1:]] for line in lines if line[1] != "inspect"]
    return found


@pytest.mark.slow
def test_the_page_told_from_an_empty_folder_ends_with_a_calibrated_policy_far_nearer(tmp_path: Path) -> None:
    said = []
    for command in commands():
        done = subprocess.run(command, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        said.append(done.stdout)
    compared = json.loads((tmp_path / "compared.json").read_text(encoding="utf-8"))
    raw, calibrated = compared["rows"]
    assert [raw["policy"], calibrated["policy"]] == ["raw", "LS"]
    assert 1.5 < raw["mean_mm"] < 2.6 and calibrated["mean_mm"] < 0.4 * raw["mean_mm"]
    (line,) = compared["differences"]
    assert line["ci95_mm"][1] < 0.0 and line["significant"]
    table, tables = said[1], re.compile(r"raw +│ +([\d.]+) ")
    assert float(tables.search(table)[1]) == round(raw["mean_mm"], 3)
    assert compared["explanation"] in " ".join(table.split())
    ppo = json.loads((tmp_path / "ppo.json").read_text(encoding="utf-8"))
    beginner, trained = ppo["rows"]
    assert beginner["mean_mm"] > 10.0 > trained["median_mm"]  # his error is far beyond what plots to 25 mm show
    assert trained["picked"] > beginner["picked"]
    still = dict(re.findall(r"^(\w+) ([\d.]+) mm$", said[-1], re.MULTILINE))
    assert float(still["Still"]) > 100.0 > float(still["scripted"])
    for name in ("comparison.rrd", "report.html", "figures/difference_map.png", "episodes.npz"):
        assert (tmp_path / "runs/ppo" / name).stat().st_size > 1000


def test_every_command_of_the_page_is_told() -> None:
    assert sum(command[3] == "compare" for command in commands() if command[1] == "-m") == 2
    assert np.all([len(command) > 2 for command in commands()])
