"""The script that measures frames per second."""

import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

import pickenv  # noqa: F401

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_every_environment_is_measured_and_written_down(tmp_path: Path) -> None:
    command = [sys.executable, ROOT / "scripts/benchmark_pictures.py", "--no-peers", "--seconds", "0.1"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([*command, "--json", tmp_path / "rates.json"], check=True, env=environment, capture_output=True)
    found = json.loads((tmp_path / "rates.json").read_text())["frames_per_s"]
    assert set(found) == {name for name in gym.registry if name.startswith("pickenv/")}
    for rates in found.values():
        assert all(rate > 0.0 for rate in rates["plain"]) and len(rates["plain"]) == 2
