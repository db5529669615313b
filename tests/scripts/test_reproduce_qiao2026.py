"""The reproduction of Qiao 2026 runs, and says what the digest of the paper says."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


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
    for row in table.values():
        low, high = row["ci95"]
        assert low < row["ours"][0] < high and len(row["paper"]) == 4


@pytest.mark.slow
def test_a_redundant_model_is_no_worse_when_solved_by_rank(result):
    rows = result["table23"]["geometry_only"]["rows"]
    for exact in ("24, rank-aware", "base 16, rank-aware"):
        assert rows[exact]["position_mm"]["mean"] < 1e-4
    assert 0.1 < rows["17 of the paper, rank-aware (rank 15)"]["position_mm"]["mean"] < 0.2
    naive = rows["17 of the paper, normal equations"]
    assert naive is None or naive["largest_change_mm"] > 100.0
    assert rows["24, normal equations"] is None or rows["24, normal equations"]["largest_change_mm"] > 100.0
