"""The quickstart, typed as it is printed in an empty folder; its last numbers are those of the calibrated arm."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs/quickstart.md"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks() -> list[tuple[str, str]]:
    return BLOCK.findall(PAGE.read_text(encoding="utf-8"))


def test_every_block_is_shell_or_python() -> None:
    assert {language for language, _ in blocks()} == {"sh", "python"}


@pytest.mark.slow
def test_the_quickstart_ends_with_the_calibrated_arm_far_nearer_than_the_raw_one(tmp_path: Path) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "MPLBACKEND": "Agg"}
    shown = []
    for language, text in blocks():
        if "pip install" in text:
            continue  # what runs this has it
        command = ["sh", "-ec", text] if language == "sh" else [sys.executable, "-c", text]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        shown.append(done.stdout)
    assert float(re.fullmatch(r"([\d.]+) mm from the fruit\n", shown[1])[1]) > 10.0
    raw, calibrated = (float(value) for value in re.findall(r": ([\d.]+) mm", shown[2]))
    assert 1.5 < raw < 2.5
    assert calibrated < 0.2 * raw
