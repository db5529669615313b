"""What a page of the documentation prints, as commands that can be run from an empty folder."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "COLUMNS": "200"}


def commands(page: str) -> list[list[str]]:
    """Programs and commands of a page of docs in their order; a viewer is not opened."""
    found = []
    for language, text in BLOCK.findall((ROOT / "docs" / page).read_text(encoding="utf-8")):
        if language == "python":
            found.append([sys.executable, "-c", text])
        elif language == "sh":
            lines = [shlex.split(line) for line in text.splitlines()]
            found += [[sys.executable, "-m", "pickenv.cli", *line[1:]] for line in lines if line[1] != "inspect"]
    return found


def walked(page: str, folder: Path) -> list[str]:
    """What each of them prints, run in a folder one after the other."""
    return [ran(command, folder) for command in commands(page)]


def ran(command: list[str], folder: Path) -> str:
    """What a command prints, run in a folder; the test is skipped where MuJoCo has nothing to draw with."""
    done = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    if "MuJoCo cannot draw here" in done.stderr:
        pytest.skip("MuJoCo cannot draw here")
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout
