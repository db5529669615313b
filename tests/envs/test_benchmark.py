"""The benchmark of the environments: what it promises in JSON, and one sentence where there is no such device."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "benchmark_envs.py"
pytest.importorskip("stable_baselines3")


def benchmark(*arguments):
    command = [sys.executable, "-W", "ignore", str(SCRIPT), "--no-peers", *arguments]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "NO_COLOR": "1", "TERM": "dumb"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)


def test_a_device_that_is_not_there_is_refused_in_one_sentence(monkeypatch, capsys):
    monkeypatch.syspath_prepend(SCRIPT.parent)
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), "--no-peers", "--device", "cuda:99"])
    with pytest.raises(SystemExit, match=r"^2$"):
        runpy.run_path(str(SCRIPT), run_name="__main__")
    assert "cannot be used" in capsys.readouterr().err


@pytest.mark.slow
def test_what_it_measures_is_written_down(tmp_path):
    ended = benchmark("--quick", "--json", str(tmp_path / "speed.json"))
    assert ended.returncode == 0, ended.stderr
    found = json.loads((tmp_path / "speed.json").read_text())
    for row in found["envs"].values():
        assert row["steps_per_s"] > 0 and row["num_envs"] >= 1 and row["backend"]
    assert {f"ppo_adapter_vs_dummy_{count}" for count in (16, 64, 256)} <= found["ratios"].keys()
    assert {"LS", "LS+BPNN", "LS+BPNN, one iteration in single precision"} == found["compensation"].keys()
    for cost in found["compensation"].values():
        assert cost["single_us"] > 0 and cost["vector_ratio"] > 1
    assert found["float32_um"] < 1
