"""The reproduction of Qiao 2026 runs, and says what the digest of the paper says."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import rankdata
from scipy.stats import t as student_t

from pickenv.arm import forward, load_plant, pose_error
from pickenv.calibration import random_joints

SCRIPTS = Path(__file__).parents[2] / "scripts"
sys.path.insert(0, str(SCRIPTS))

from papers import qiao2026_verdicts as verdicts  # noqa: E402
from reproduce_qiao2026 import PAPER, paired, paper_phi  # noqa: E402

VERDICTS = {"reproduced", "not reproduced", "fitted"}
PAPER_MM = {name: PAPER["table4"][name][0] for name in ("EKF", "LS", "RBF", "BPNN", "EKF+RBF", "EKF+BPNN", "LS+BPNN")}
"""What each method leaves in the paper."""


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    out = tmp_path_factory.mktemp("qiao2026")
    command = [sys.executable, SCRIPTS / "reproduce_qiao2026.py", "--quick", "--out", out, "--json", out / "copy.json"]
    subprocess.run(command, check=True, capture_output=True, cwd=SCRIPTS)
    page = (out / "reproduction.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 7 == len(list(out.glob("fig*.png"))) and "http" not in page
    return json.loads((out / "copy.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_every_table_of_the_paper_has_rows_and_a_verdict_with_its_reason(result):
    assert list(result["tables"]) == ["2", "3", "4", "5", "6"] and list(result["figures"]) == ["5", "6", "7", "8"]
    for kind in ("tables", "equations"):
        for part in result[kind].values():
            assert part["verdict"] in VERDICTS and len(part["reason"]) > 40 and part["rows"]
    assert {part["verdict"] for part in result["figures"].values()} <= VERDICTS
    assert [len(result["tables"][number]["rows"]) for number in "23456"] == [24, 2, 8, 24, 3]


@pytest.mark.slow
def test_table_4_has_its_eight_rows_and_combined_methods_leave_less_than_single_ones(result):
    table = {row["method"]: row for row in result["tables"]["4"]["rows"]}
    assert list(table) == ["raw", "EKF", "LS", "RBF", "BPNN", "EKF+RBF", "EKF+BPNN", "LS+BPNN"]
    mean = {name: row["ours"][0] for name, row in table.items()}
    for combined, single in (("LS+BPNN", "LS"), ("LS+BPNN", "BPNN"), ("EKF+BPNN", "EKF"), ("EKF+RBF", "RBF")):
        assert mean[combined] < mean[single] < mean["raw"]
    pairs = {test["ci95_mm"] for test in result["tables"]["4"]["paired"]}
    assert {row["ci95"] for row in table.values()} == pairs == {None}
    assert result["no_interval"] == "none: 1 of at least 5 runs"
    assert all(len(row["paper"]) == 4 for row in table.values())
    theirs = rankdata([row["paper"][0] for name, row in table.items() if name != "raw"])
    ours = rankdata([row["ours"][0] for name, row in table.items() if name != "raw"])
    assert result["tables"]["4"]["rank_correlation"] == pytest.approx(np.corrcoef(theirs, ours)[0, 1])
    assert result["tables"]["4"]["best"] == min(set(mean) - {"raw"}, key=mean.get)


def rows_of(order: list[str]) -> dict[str, dict[str, list[float]]]:
    """Table 4 in which the paper's methods leave what they leave, and ours leave more the later they are named."""
    theirs = {"raw": 6.3, **PAPER_MM}
    return {name: {"paper": [theirs[name]], "ours": [0.1 + 0.1 * ([*order, "raw"].index(name))]} for name in theirs}


@pytest.mark.parametrize(
    ("order", "verdict", "words"),
    [
        (sorted(PAPER_MM, key=PAPER_MM.get), "reproduced", "is 1.00; least is left by LS+BPNN"),
        (
            ["EKF+BPNN", *(n for n in sorted(PAPER_MM, key=PAPER_MM.get) if n != "EKF+BPNN")],
            "not reproduced",
            "EKF+BPNN",
        ),
        (["LS+BPNN", "EKF+BPNN", "BPNN", "LS", "EKF+RBF", "EKF", "RBF"], "not reproduced", "BPNN, which knows no kin"),
        (sorted(PAPER_MM, key=PAPER_MM.get, reverse=True), "not reproduced", "is -1.00; least is left by RBF"),
    ],
)
def test_the_verdict_on_table_4_follows_its_numbers(order, verdict, words):
    table = verdicts.table_4(rows_of(order), {})
    assert table["verdict"] == verdict and words in table["reason"]
    assert [row["verdict"] for row in table["rows"]] == ["", "", "fitted", "", "", "", "", ""]


def test_the_verdict_on_24_against_17_parameters_follows_its_numbers():
    for fewer, verdict in ((0.4, "reproduced"), (0.6, "not reproduced")):
        each = {"eta_percent": 1.0, "attitude_deg": {"mean": 0.1}}
        rows = {
            "24, rank-aware": each | {"position_mm": {"mean": 0.5}},
            "17 of the paper, rank-aware (rank 15)": each | {"position_mm": {"mean": fewer}},
        }
        table = verdicts.table_3(PAPER, {"rows": rows})
        assert table["verdict"] == verdict and f"{fewer:.3f}" in table["reason"]


def test_table_2_is_the_papers_where_most_parameters_are():
    names = [f"p{i}" for i in range(24)]
    for off, verdict in ((0.0, "reproduced"), (0.05, "not reproduced")):
        printed = {count: verdicts.column(PAPER["table2"][f"identified_{count}"]) for count in (24, 17)}
        solved = {"24, rank-aware": printed[24] + off, "17 of the paper, rank-aware (rank 15)": printed[17] + off}
        rows = {name: {"parameters": dict(zip(names, values, strict=True))} for name, values in solved.items()}
        assert verdicts.table_2(PAPER, {"rows": rows})["verdict"] == verdict


def test_phi_is_reproduced_only_where_it_marks_what_the_paper_removes():
    names = ["a", "b", "c"]
    for marked, verdict in ((["b"], "reproduced"), (["c"], "not reproduced"), (["b", "c"], "not reproduced")):
        phi = {"m and rad": {name: 0.01 if name in marked else 1.0 for name in names}}
        table = verdicts.equation_10(["b"], phi, 2)
        assert table["verdict"] == verdict and table["marked"] == {"m and rad": marked}


def test_the_literal_inverse_is_usable_only_if_it_commands_little_and_leaves_little():
    for step, left, verdict in ((0.01, 0.1, "reproduced"), (1.0, 0.1, "not reproduced"), (0.01, 9.0, "not reproduced")):
        found = {"condition": 10.0, "largest_step_m": step, "mean_mm": left}
        assert verdicts.equation_15(found, 0.1)["verdict"] == verdict


def test_phi_to_the_letter_is_the_diagonal_of_r_of_the_printed_jacobian():
    """Of differences of forward kinematics, which know nothing of Jacobians.

    Behind a redundant column the diagonal is what rounding makes of it; up to the first of them it is comparable.
    """
    geometry = load_plant("geometry_only").arm.nominal
    phi = paper_phi(geometry, 4, np.random.default_rng(3))["m and rad"]
    joints = random_joints(geometry, 4, np.random.default_rng(3))
    start, columns, step = forward(geometry, joints), [], 1e-6
    for name in phi:
        moved = np.zeros(len(geometry.parameter_names))
        moved[geometry.parameter_names.index(name)] = step
        columns.append(pose_error(start, forward(geometry.displaced(moved), joints)).ravel() / step)
    diagonal = np.abs(np.diag(np.linalg.qr(np.column_stack(columns), mode="r")))
    found = np.array(list(phi.values()))
    first = int(np.argmax(diagonal < 1e-6 * diagonal.max()))
    assert first >= 8
    np.testing.assert_allclose(found[:first] / found[0], diagonal[:first] / diagonal[0], rtol=1e-5)
    np.testing.assert_array_equal(found < 1e-6, diagonal < 1e-6 * diagonal.mean())
    assert found.mean() == pytest.approx(1.0)


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
    rows = result["solvers"]["geometry_only"]["rows"]
    for exact in ("24, rank-aware", "base 16, rank-aware"):
        assert rows[exact]["position_mm"]["mean"] < 1e-4
    assert 0.1 < rows["17 of the paper, rank-aware (rank 15)"]["position_mm"]["mean"] < 0.2
    naive = rows["17 of the paper, normal equations"]
    assert naive is None or naive["largest_change_mm"] > 100.0
    assert rows["24, normal equations"] is None or rows["24, normal equations"]["largest_change_mm"] > 100.0
