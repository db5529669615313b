"""Ctrl-C ends a long command with one sentence and leaves no half-written file."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DEMO = """
import signal
import pickenv
import torch  # interrupted while it loads, its C++ may abort the process before Python hears of it
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts what runs behind it deaf to Ctrl-C
calibrate = pickenv.calibrate

def told(*arguments, **options):
    print("fitting", flush=True)
    return calibrate(*arguments, **options)

pickenv.calibrate = told
from pickenv.cli import main
main()
"""


@pytest.mark.slow
def test_an_interrupted_demo_leaves_nothing_half_written(tmp_path):
    out = tmp_path / "run"
    command = [sys.executable, "-c", DEMO, "demo", "--out", str(out)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment) as demo:
        assert any("fitting" in line for line in demo.stdout), demo.stderr.read()
        time.sleep(1.0)  # in the middle of it; nothing of it is timed
        demo.send_signal(signal.SIGINT)
        _, said = demo.communicate(timeout=600)
    assert demo.returncode == 130, said
    assert said.rstrip().endswith("nothing is left half-written") and "Traceback" not in said
    assert not out.exists() or not [path for path in out.iterdir() if path.name.startswith(".")]
    assert not (out / "summary.json").exists()
