"""The benchmark of calibration: its JSON, its figures on the real arm, and what it says when a peer is missing."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_calibration.py"


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    wide = {**os.environ, "COLUMNS": "200"}
    return subprocess.run([sys.executable, SCRIPT, *map(str, arguments)], capture_output=True, text=True, env=wide)


@pytest.fixture(scope="module")
def benchmark_run(data_folder, tmp_path_factory):
    """What the script printed, and the JSON that it wrote."""
    if not (data_folder / "ur5_wam_jacobi2025").is_dir():
        pytest.skip(f"no data set ur5_wam_jacobi2025 in {data_folder}")
    file = tmp_path_factory.mktemp("benchmark") / "benchmark.json"
    ended = run("--no-peers", "--runs", 3, "--data", data_folder, "--json", file)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout, json.loads(file.read_text(encoding="utf-8"))


def test_the_json_has_systems_ratios_and_the_machine(benchmark_run):
    _, result = benchmark_run
    assert list(result["systems"]) == ["pickenv", "pickenv_100", "scipy_2point"]
    for row in result["systems"].values():
        assert row.keys() >= {"seconds", "cpu_seconds", "solve_seconds", "held_out_rms_mm", "version", "note"}
        assert 0.0 < row["best_seconds"] <= row["seconds"]
    assert result["ratios"].keys() >= {"scipy_2point_vs_pickenv", "scipy_2point_vs_pickenv_cpu"}
    assert result["machine"].keys() >= {"cores", "cpu", "python", "numpy"}
    assert result["data"] == {"set": "ur5_wam_jacobi2025", "train": 800, "held_out": 200, "split_seed": 0}


def test_general_solvers_reach_the_same_rigid_floor(benchmark_run):
    _, result = benchmark_run
    ours, scipy = (result["systems"][name] for name in ("pickenv", "scipy_2point"))
    assert ours["held_out_rms_mm"] <= 0.1128
    assert ours["random_poses_mean_mm"] <= 0.102
    assert scipy["held_out_rms_mm"] == pytest.approx(ours["held_out_rms_mm"], rel=1e-4)
    assert ours["best_seconds"] > 0.0 and result["ratios"]["scipy_2point_vs_pickenv_cpu"] > 0.0


def test_few_poses_cost_accuracy(benchmark_run):
    _, result = benchmark_run
    few, whole = result["systems"]["pickenv_100"], result["systems"]["pickenv"]
    assert whole["held_out_rms_mm"] < few["held_out_rms_mm"] < 0.13


def test_the_table_names_units(benchmark_run):
    printed, _ = benchmark_run
    for word in ("pickenv", "scipy_2point", "RMS mm", "solver", "CPU", "NumPy", "load"):
        assert word in printed


def test_without_data_it_says_what_to_give(tmp_path):
    ended = run("--no-peers", "--data", tmp_path)
    assert ended.returncode == 2
    assert "name the folder of the data sets in PICKENV_DATA" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.fixture
def script(monkeypatch):
    """The script as a module."""
    monkeypatch.syspath_prepend(SCRIPT.parent)
    import benchmark_calibration

    return benchmark_calibration


def test_a_failed_peer_has_no_ratio(script):
    ours = {"seconds": 0.02, "cpu_seconds": 0.02, "poses": 800}
    peer = {"seconds": 2.0, "cpu_seconds": 1.0, "solve_seconds": 1.5, "poses": 800}
    failed = {"seconds": None, "held_out_rms_mm": None}
    found = script.ratios_of({"pickenv": ours, "quick": peer, "absent": failed})
    assert found == pytest.approx(
        {"quick_vs_pickenv": 100.0, "quick_vs_pickenv_cpu": 50.0, "quick_solve_vs_pickenv": 75.0}
    )
