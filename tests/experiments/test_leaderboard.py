"""The leaderboard: every row from arms that no two seeds share, made again from what is kept; a stranger's one file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.base import InputError, interquartile_estimate
from pickenv.cli import app
from pickenv.commands import check
from pickenv.experiments import PolicySettings, Rows, kept_rows, policy_tables, policy_tables as tables, run_policies

KEYS = {
    "task",
    "policy",
    "feedback",
    "compensation",
    "mean_mm",
    "iqm_mm",
    "attitude_deg",
    "success",
    "ci95_mm",
    "seeds",
}
STILL = """
import numpy as np

class Still:
    def reset(self): ...
    def act(self, observation):
        return np.zeros((len(observation), 6), dtype=np.float32)

def make_policy(env, seed):
    return Still()
"""


SMALL = replace(
    policy_tables.LEADERBOARD, policies=("scripted",), compensations=("raw", "ls"), plants=("qiao2026",), canopies=0
)
SMALL = replace(SMALL, arms=2, episodes=3)
"""Seconds: without residual models, whose calibrations take the time."""


def rows_of(policy, compensation, errors):
    """Rows of arms ``(N, fruit)``, two a seed: degrees are a tenth of the millimetres, grippers forgive 5 and 8 mm."""
    errors = np.asarray(errors)
    words = {"plant": "field", "compensation": compensation, "feedback": "encoders", "policy": policy}
    arm, fruit = (index.ravel() for index in np.indices(errors.shape))
    flat = errors.ravel()
    return {name: np.full(errors.size, word) for name, word in words.items()} | {
        "seed": arm // 2,
        "arm": arm,
        "episode": fruit,
        "error_mm": flat,
        "attitude_deg": 0.1 * flat,
        "chance_li_cup": np.where(flat < 5.0, 1.0, 0.0),
        "chance_compliant_hand": np.where(flat < 8.0, 1.0, 0.0),
    }


def test_rows_are_worked_out_over_the_arms_of_all_seeds():
    """Ten arms of one to ten millimetres; a quarter of ten is two and a half, of which trimming leaves out two."""
    parts = [
        rows_of("scripted", "raw", [[m - 0.5, m, m + 0.5] for m in np.arange(1.0, 11.0)]),
        rows_of("scripted", "ls", [[0.1 * (n // 2)] * 3 for n in range(10)]),
        rows_of("still", "raw", [[40.0] * 3, [50.0] * 3] * 5),
    ]
    ls, raw, still = table = policy_tables.reaching_rows(
        Rows({k: np.concatenate([part[k] for part in parts]) for k in parts[0]})
    )
    assert [(row["policy"], row["compensation"]) for row in table] == [
        ("scripted", "ls"),
        ("scripted", "raw"),
        ("still", "raw"),
    ]
    for row in table:
        assert (row["task"], row["feedback"], row["arms"], row["fruit_per_arm"]) == (
            "pickenv/Reach-v0, field",
            "encoders",
            10,
            3,
        )
        assert row["seeds"] == [0, 1, 2, 3, 4]
    assert raw["mean_mm"] == pytest.approx(5.5) and raw["attitude_deg"] == pytest.approx(0.55)
    assert raw["iqm_mm"] == pytest.approx(np.mean([3, 4, 5, 6, 7, 8]))
    shares = [13 / 30, 22 / 30]  # below 5 mm: three of each of 1 to 4 mm, one of 5 mm; below 8 mm likewise
    assert raw["success"] == pytest.approx(shares[0])
    assert raw["success_by_gripper"] == pytest.approx(
        dict(zip(policy_tables.LEADERBOARD.grippers, shares, strict=True))
    )
    expected = interquartile_estimate(np.arange(1.0, 11.0))
    assert raw["ci95_mm"] == list(expected.ci95)
    assert ls["mean_mm"] == pytest.approx(0.2) and still["mean_mm"] == pytest.approx(45.0)
    assert policy_tables.leaderboard_cells(raw) == [
        "scripted",
        "encoders",
        "raw",
        "5.500",
        f"5.500 ({expected.ci95[0]:.3f} to {expected.ci95[1]:.3f})",
        "0.550",
        "43 %",
        "73 %",
    ]
    page = policy_tables.leaderboard_tables([ls, raw, still]).splitlines()
    assert page[0] == "pickenv/Reach-v0, field: 10 arms over seeds 0, 1, 2, 3, 4, 3 fruit each" and page[1] == ""
    assert (
        page[2].startswith("| policy | feedback | compensation | mean (mm) |")
        and page[3] == f"| {'|'.join(['---'] * 8)} |"
    )
    assert page[5] == f"| {' | '.join(policy_tables.leaderboard_cells(raw))} |" and len(page) == 7
    alone = policy_tables.reaching_rows(Rows({name: values[:6] for name, values in parts[1].items()}))[0]
    assert alone["ci95_mm"] is None and policy_tables.leaderboard_cells(alone)[4] == "0.000 (no interval)"


def test_a_leaderboard_is_what_the_page_says():
    assert policy_tables.LEADERBOARD.seeds == policy_tables.QUICK.seeds == (0, 1, 2, 3, 4)
    assert (policy_tables.LEADERBOARD.arms, policy_tables.LEADERBOARD.episodes, policy_tables.LEADERBOARD.canopies) == (
        2,
        16,
        2,
    )
    assert (policy_tables.QUICK.arms, policy_tables.QUICK.episodes, policy_tables.QUICK.canopies) == (1, 4, 0)
    assert (policy_tables.LEADERBOARD.plan.epochs, policy_tables.QUICK.plan.epochs) == (100, 20)
    assert policy_tables.LEADERBOARD.compensations == ("raw", "ls", "ls_bpnn", "best")


def test_a_seed_has_its_own_arms_fruit_and_calibrations(tmp_path):
    """What a seed gives among others is what it gives alone."""
    both = run_policies(replace(SMALL, seeds=(6, 3)), cache=tmp_path)
    alone = run_policies(replace(SMALL, seeds=(3,)), cache=tmp_path)
    assert both.levels("seed", "arm") == [(6, 0), (6, 1), (3, 2), (3, 3)]
    np.testing.assert_array_equal(both.where(seed=3)["error_mm"], alone["error_mm"])
    assert not np.isin(both.where(seed=6)["fruit_position"], alone["fruit_position"]).any()
    assert len(list(tmp_path.glob("*.npz"))) == 4


@pytest.mark.slow
def test_rows_are_of_all_seeds_and_a_run_goes_on_where_it_was_cut(tmp_path):
    pytest.importorskip("joblib")
    rows = policy_tables.run_leaderboard(SMALL, tmp_path)
    assert {(row["policy"], row["compensation"]) for row in rows} == {("scripted", "raw"), ("scripted", "ls")}
    better, worse = rows
    assert better["compensation"] == "ls" and better["iqm_mm"] < worse["iqm_mm"]
    for row in rows:
        assert row.keys() >= KEYS and row["seeds"] == [0, 1, 2, 3, 4] and row["arms"] == 10
        low, high = row["ci95_mm"]
        assert low < row["iqm_mm"] < high
    raw = kept_rows(tmp_path / "reaching").where(compensation="raw")
    means = [raw.where(seed=seed)["error_mm"].mean() for seed in range(5)]
    assert len(set(means)) == 5 and np.mean(means) == pytest.approx(worse["mean_mm"])  # no two seeds share their arms

    kept = [*tmp_path.glob("reaching/*.parquet"), *tmp_path.glob("calibrations/*.npz")]
    times = {path: path.stat().st_mtime_ns for path in kept}
    victims = {kept[0], kept[-1]}
    for path in victims:
        path.unlink()
        assert any(finding.reason is not None for finding in check.findings_of(path.parent))
    assert policy_tables.run_leaderboard(SMALL, tmp_path, backend="loky", workers=2) == rows
    assert {path for path in kept if path.stat().st_mtime_ns != times[path]} == victims
    assert all(finding.reason is None for finding in check.findings_of(tmp_path))


@pytest.mark.slow
def test_a_stranger_enters_by_one_file_and_is_judged_on_the_same_arms(tmp_path, monkeypatch):
    file = tmp_path / "still.py"
    file.write_text(STILL)
    monkeypatch.setattr(tables, "QUICK", SMALL)
    out, rows = tmp_path / "out", tmp_path / "rows.json"
    done = CliRunner().invoke(
        app, ["bench", "policies", "--quick", "--policy", str(file), "--out", str(out), "--json", str(rows)]
    )
    assert done.exit_code == 0, done.output
    found = json.loads(rows.read_text())["rows"]
    assert {row["policy"] for row in found} == {"scripted", "still"}
    lazy = [row for row in found if row["policy"] == "still"]
    assert {row["feedback"] for row in lazy} == {"encoders", "camera"}
    assert min(row["mean_mm"] for row in lazy) > 100.0 > max(row["mean_mm"] for row in found if row not in lazy)
    page = (out / "leaderboard.md").read_text()
    assert page.count("| scripted |") == 2 and page.count("| still |") == 4

    file.write_text(STILL.replace("zeros", "ones"))
    pieces = set(out.glob("reaching/*still*"))
    assert len(pieces) == 20
    policy_tables.run_leaderboard(replace(SMALL, policies=(str(file), "scripted")), out)
    assert len(set(out.glob("reaching/*still*"))) == 40  # another policy by the same name is run anew
    assert len(list(out.glob("reaching/*scripted*"))) == 10  # and one that is kept is not
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "still.py"
    other.write_text(STILL)
    with pytest.raises(InputError, match="two policies are called 'still'; give one of them another name"):
        run_policies(replace(SMALL, policies=(str(file), str(other))))


def test_picks_per_hour_are_counted_per_arm_and_gripper():
    rng = np.random.default_rng(0)
    counts = {("raw", "li_cup"): [5] * 10, ("raw", "compliant_hand"): [1] * 10}
    counts |= {("ls", "li_cup"): [8] * 4 + [9] * 2 + [8] * 4, ("ls", "compliant_hand"): [4] * 4 + [5] * 2 + [4] * 4}
    rows = policy_tables.picking_rows(
        Rows.of(
            [
                {"plant": "field", "gripper": gripper, "policy": "scripted", "compensation": behind, "seed": arm // 2}
                | {"arm": arm, "attempted": 10, "collected": collected, "picks_per_hour": 100.0 * collected}
                | {"error_sum_mm": rng.uniform(1.0, 3.0, 10).sum(), "tilt_sum_deg": 10.0}
                for (behind, gripper), counted in counts.items()
                for arm, collected in enumerate(counted)
            ]
        )
    )
    best, worst = rows
    assert (best["compensation"], worst["compensation"]) == ("ls", "raw") and best.keys() >= KEYS
    assert best["picks_per_hour"] == pytest.approx({"li_cup": 820.0, "compliant_hand": 420.0})
    assert best["success_by_gripper"] == pytest.approx({"li_cup": 0.82, "compliant_hand": 0.42})
    assert best["attitude_deg"] == pytest.approx(1.0) and best["attempts"] == 200
    low, high = best["picks_per_hour_ci95"]["li_cup"]
    assert low < 820.0 < high and best["arms"] == 10 and 1.0 < best["iqm_mm"] < 3.0
    page = policy_tables.leaderboard_tables(rows)
    assert "picks per hour, li_cup | picks per hour, compliant_hand" in page and "| 820 (" in page


@pytest.mark.slow
def test_scripted_picking_is_counted_on_the_same_canopies():
    settings = PolicySettings(compensations=("raw",), arms=1, grippers=("li_cup",), seeds=(3,), canopies=1)
    rows = run_policies(settings, task="picking")
    gentle, hasty = rows.dicts()
    assert (gentle["policy"], hasty["policy"]) == ("scripted", "hasty")
    assert gentle["attempted"] == hasty["attempted"] > 0
    assert 0 <= gentle["collected"] <= gentle["attempted"]
    assert hasty["picks_per_hour"] / hasty["collected"] > gentle["picks_per_hour"] / gentle["collected"]  # it is faster
    again = run_policies(settings, task="picking")
    assert all(np.array_equal(again[name], values) for name, values in rows.columns.items())


def test_impossible_leaderboards_end_with_one_sentence(tmp_path):
    with pytest.raises(InputError, match=r"seeds are \[0, 1\]; give at least 5, each once"):
        policy_tables.run_leaderboard(replace(SMALL, seeds=(0, 1)), tmp_path)
    with pytest.raises(InputError, match="each once"):
        policy_tables.run_leaderboard(replace(SMALL, seeds=(0, 1, 2, 3, 3)), tmp_path)
    with pytest.raises(InputError, match="unknown policy 'nobody'"):
        policy_tables.run_leaderboard(replace(SMALL, policies=("nobody",)), tmp_path)
    picky = Path(tmp_path / "picky.py")
    picky.write_text(
        STILL.replace("return np.zeros", "from pickenv import InputError\n        raise InputError('no')\n        #")
    )
    with pytest.raises(InputError, match="no"):
        policy_tables.run_leaderboard(replace(SMALL, policies=(str(picky),)), tmp_path)


def test_the_published_table_has_the_numbers_of_the_published_file():
    """docs/leaderboard.md and docs/_static/leaderboard.json are of one run; the page leaves out the smooth arm."""
    docs = Path(__file__).parents[2] / "docs"
    rows = json.loads((docs / "_static/leaderboard.json").read_text(encoding="utf-8"))["rows"]
    page = (docs / "leaderboard.md").read_text(encoding="utf-8")
    printed = {}
    for part in page.split("### ")[1:]:
        for line in part.splitlines():
            policy, feedback, *numbers = [cell.strip() for cell in line.strip("|").split("|")] + [""] * 2
            if " to " in (numbers or [""])[0]:
                columns = zip(("raw", "ls", "ls_bpnn", "best"), numbers, strict=False)
                printed |= {(part.splitlines()[0], policy, feedback, name): number for name, number in columns}
    kept = {}
    for row in rows:
        low, high = row["ci95_mm"]
        key = row["task"], row["policy"], row["feedback"], row["compensation"]
        kept[key] = f"{row['iqm_mm']:.2f} ({low:.2f} to {high:.2f})"
    shown = {key: number for key, number in kept.items() if not key[0].endswith("qiao2026")}
    assert len(kept) > 90 and len(printed) > 40 and printed == shown
