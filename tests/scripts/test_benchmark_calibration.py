"""The benchmark of calibration: its JSON, its figures on the real arm, and what it says when a peer is missing."""

import json
import os
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.arm import Pose, rotation_matrix
from pickenv.base import InputError

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
    ended = run("--no-peers", "--runs", 1, "--data", data_folder, "--json", file)
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


def test_without_data_it_says_what_to_give(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(SCRIPT.parent)
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), "--no-peers", "--data", str(tmp_path)])
    with pytest.raises(SystemExit, match=r"^2$"):
        runpy.run_path(str(SCRIPT), run_name="__main__")
    assert "name the folder of the data sets in PICKENV_DATA" in capsys.readouterr().err


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


def test_a_peer_is_given_poses_as_homogeneous_matrices(script):
    pose = Pose(np.array([0.1, -0.2, 0.3]), rotation_matrix([0.4, 0.5, -0.6]))
    found = np.array(script.homogeneous(pose))
    point = np.array([0.7, -0.8, 0.9])
    np.testing.assert_allclose(found @ [*point, 1.0], [*(pose.position + pose.rotation @ point), 1.0])
    np.testing.assert_array_equal(found[3], [0.0, 0.0, 0.0, 1.0])


def test_a_peer_that_cannot_be_installed_is_named(script, tmp_path, monkeypatch):
    """No installer is run: the environment's Python is replaced by one that fails."""
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    (tmp_path / "python").write_text("#!/bin/sh\necho 'ERROR: no such release' >&2\nexit 1\n")
    (tmp_path / "python").chmod(0o755)
    with pytest.raises(InputError, match=r"cannot be installed: ERROR: no such release"):
        script.python_with(tmp_path / "peers", "figaroh")
    (tmp_path / "peers").mkdir()
    (tmp_path / "peers/installed").write_text("figaroh==1.0.1")
    assert script.python_with(tmp_path / "peers", "figaroh==1.0.1").parent.parent == (tmp_path / "peers").resolve()
    with pytest.raises(InputError, match=r"cannot be installed: ERROR: no such release"):
        script.python_with(tmp_path / "peers", "figaroh==1.0.2")
    assert script.last_words("one\nan Error of it\nlast\n") == "an Error of it"


def test_a_peer_is_given_the_rows_and_answers_for_those_held_out(script, data_folder, tmp_path, monkeypatch):
    """A peer of ours that predicts the nominal tool: its errors are those of the base and tool fit alone."""
    if not (data_folder / "ur5_wam_jacobi2025").is_dir():
        pytest.skip(f"no data set ur5_wam_jacobi2025 in {data_folder}")
    workers = tmp_path / "workers"
    workers.mkdir()
    (workers / "run_none.py").write_text(
        "import json, os, sys\n"
        "content = json.load(open(sys.argv[1]))\n"
        "n = {name: len(content[name]) for name in ('joints', 'held_out_joints', 'random_joints')}\n"
        "answer = {'held_out_rms_mm': 0.5, 'random_poses_mean_mm': 0.4, 'remark': 'nor more', 'n': n}\n"
        "answer['at_home'] = os.path.samefile('.', os.path.dirname(sys.argv[1]))\n"
        "answer['ours'] = [name for name in os.environ if name.startswith('PYTHON')]\n"
        "json.dump(answer, open(sys.argv[2], 'w'))\n"
    )
    monkeypatch.setattr(script, "WORKERS", workers)
    monkeypatch.setattr(script, "python_with", lambda home, *packages: Path(sys.executable))
    task = script.read_peer_task(data_folder, 0).first(50)
    found = script.run_peer(script.Peer("none", "1", "it does nothing", poses=50), task, task.nominal, tmp_path)
    assert found["n"] == {"joints": 50, "held_out_joints": 200, "random_joints": 20}
    assert found["at_home"] and found["ours"] == [] and found["note"] == "it does nothing; nor more"


def test_a_peers_errors_are_the_rms_on_rows_held_out_and_the_mean_on_other_poses(script):
    rows = [SimpleNamespace(difference=lambda geometry, e=e: 1e-3 * np.array(e)) for e in
            ([[3.0, 0.0, 4.0], [0.0, 0.0, 1.0]], [[0.0, 2.0, 0.0], [6.0, 0.0, 8.0]])]  # fmt: skip
    found = script.accuracy_on("geometry", script.PeerTask("nominal", "train", *rows))
    assert found == pytest.approx({"held_out_rms_mm": np.sqrt((25 + 1) / 2), "random_poses_mean_mm": 6.0})
