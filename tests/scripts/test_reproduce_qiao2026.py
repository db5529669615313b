"""The reproduction of Qiao 2026 runs, and says what the digest of the paper says."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t as student_t

SCRIPTS = Path(__file__).parents[2] / "scripts"
sys.path.insert(0, str(SCRIPTS))

from reproduce_qiao2026 import paired  # noqa: E402


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    out = tmp_path_factory.mktemp("qiao2026")
    command = [sys.executable, SCRIPTS / "reproduce_qiao2026.py", "--quick", "--out", out, "--json", out / "copy.json"]
    subprocess.run(command, check=True, capture_output=True, cwd=SCRIPTS)
    page = (out / "reproduction.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 5 == len(list(out.glob("fig*.png"))) and "http" not in page
    return json.loads((out / "copy.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_table_4_has_its_eight_rows_and_the_papers_order_of_reductions(result):
    table = result["table4"]
    assert list(table) == ["raw", "EKF", "LS", "RBF", "BPNN", "EKF+RBF", "EKF+BPNN", "LS+BPNN"]
    mean = {name: row["ours"][0] for name, row in table.items()}
    for combined, single in (("LS+BPNN", "LS"), ("LS+BPNN", "BPNN"), ("EKF+BPNN", "EKF"), ("EKF+RBF", "RBF")):
        assert mean[combined] < mean[single] < mean["raw"]
    assert {row["ci95"] for row in table.values()} == {test["ci95_mm"] for test in result["paired"]} == {None}
    assert result["no_interval"] == "none: 1 of at least 5 runs"
    assert all(len(row["paper"]) == 4 for row in table.values())


def test_a_run_counts_once_however_many_poses_it_has():
    """Five runs, each with networks of its own: their poses do not narrow the interval."""
    rng = np.random.default_rng(0)
    off = rng.normal(size=(2, 5))  # mm, of each method's network in each run

    def runs(poses):
        return [
            {name: np.full((poses, 6), 1e-3 * (5 + off[k, i]) / np.sqrt(3)) for k, name in enumerate(("A", "B"))}
            for i in range(5)
        ]

    difference = off[0] - off[1]
    half = student_t.ppf(0.975, 4) * difference.std(ddof=1) / np.sqrt(5)
    for poses in (1, 100):
        found = paired(runs(poses), "A", "B")
        assert found["mean_difference_mm"] == pytest.approx(difference.mean())
        low, high = found["ci95_mm"]
        assert high - low == pytest.approx(2 * half, rel=0.1)  # beside what the skewness moves
        assert "significant" not in found
    assert paired(runs(100)[:4], "A", "B")["ci95_mm"] is None


@pytest.mark.slow
def test_a_redundant_model_is_no_worse_when_solved_by_rank(result):
    rows = result["table23"]["geometry_only"]["rows"]
    for exact in ("24, rank-aware", "base 16, rank-aware"):
        assert rows[exact]["position_mm"]["mean"] < 1e-4
    assert 0.1 < rows["17 of the paper, rank-aware (rank 15)"]["position_mm"]["mean"] < 0.2
    naive = rows["17 of the paper, normal equations"]
    assert naive is None or naive["largest_change_mm"] > 100.0
    assert rows["24, normal equations"] is None or rows["24, normal equations"]["largest_change_mm"] > 100.0
