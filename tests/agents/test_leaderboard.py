"""The leaderboard: every row from arms that no two seeds share, made again from what is kept; a stranger's one file."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import trim_mean
from typer.testing import CliRunner

from pickenv.agents.evaluation import leaderboard, pick_board
from pickenv.agents.evaluation.grid import GridSettings
from pickenv.agents.evaluation.leaderboard import LeaderboardSettings, leaderboard_tables, run_leaderboard
from pickenv.agents.evaluation.pick_board import PickTally, pick_rows, pick_tallies
from pickenv.agents.evaluation.statistics import interquartile_mean
from pickenv.cli import app
from pickenv.errors import InputError
from pickenv.seeds import stream

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


def backwards(numbers, work):
    """As far away as another machine: the work is sent, the last comes first, and what was found is sent back."""
    sent = pickle.loads(pickle.dumps(work))
    for number in reversed(numbers):
        yield number, pickle.loads(pickle.dumps(sent(number)))


@pytest.fixture
def small(monkeypatch) -> LeaderboardSettings:
    """Seconds: without residual models, whose calibrations take the time."""
    monkeypatch.setattr(leaderboard, "COMPENSATIONS", ("raw", "ls"))
    return LeaderboardSettings(("scripted",), ("qiao2026",), arms=2, episodes=3, canopies=0)


def test_the_interquartile_mean_forgets_the_best_and_the_worst_quarter():
    values = np.concatenate([[1e6, -1e6], np.random.default_rng(0).normal(3.0, 0.5, 38)])
    found = interquartile_mean(values, stream(0, "leaderboard"))
    assert found.value == pytest.approx(np.sort(values)[10:30].mean())
    low, high = found.ci95
    rng = np.random.default_rng(1)
    again = [trim_mean(rng.choice(values, 40), 0.25) for _ in range(2000)]
    assert (low, high) == pytest.approx(np.quantile(again, (0.025, 0.975)), abs=0.03)
    assert interquartile_mean(values[:9], stream(0, "leaderboard")).ci95 is None


@pytest.mark.slow
def test_rows_are_of_all_seeds_and_a_run_goes_on_where_it_was_cut(small, tmp_path):
    rows = run_leaderboard(small, tmp_path)
    assert {(row["policy"], row["compensation"]) for row in rows} == {("scripted", "raw"), ("scripted", "ls")}
    better, worse = rows
    assert better["compensation"] == "ls" and better["iqm_mm"] < worse["iqm_mm"]
    for row in rows:
        assert row.keys() >= KEYS and row["seeds"] == [0, 1, 2, 3, 4] and row["arms"] == 10
        low, high = row["ci95_mm"]
        assert low < row["iqm_mm"] < high
    kept = sorted(tmp_path.glob("scripted-*/rows.json"))
    each = [json.loads(path.read_text())["rows"] for path in kept]
    raw = [
        row["mean_mm"] for found in each for row in found if row["compensation"] == "raw" and row["gripper"] == "li_cup"
    ]
    assert len(set(raw)) == 5 and np.mean(raw) == pytest.approx(worse["mean_mm"])  # no two seeds share their arms

    times = {path: path.stat().st_mtime_ns for path in kept}
    victim = kept[0].parent
    for path in victim.iterdir():
        path.unlink()
    assert run_leaderboard(small, tmp_path, runner=backwards) == rows
    remade = {path for path in kept if path.stat().st_mtime_ns != times[path]}
    assert remade == {kept[0]}


@pytest.mark.slow
def test_a_stranger_enters_by_one_file_and_is_judged_on_the_same_arms(small, tmp_path, monkeypatch):
    file = tmp_path / "still.py"
    file.write_text(STILL)
    monkeypatch.setattr(LeaderboardSettings, "quick", staticmethod(lambda: small))
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
    run_leaderboard(replace(small, policies=(str(file),)), out)
    assert len(list(out.glob("still-*"))) == 10  # another policy by the same name is run anew


def test_picks_per_hour_are_counted_per_arm_and_gripper():
    rng = np.random.default_rng(0)

    def tallies(collected: int) -> dict[str, list[PickTally]]:
        errors = tuple(rng.uniform(1.0, 3.0, 10).tolist())
        tally = PickTally(10, collected, 36.0, errors, (1.0,) * 10)
        worse = PickTally(10, collected - 4, 36.0, errors, (1.0,) * 10)
        return {"scripted/ls/li_cup": [tally] * 2, "scripted/ls/compliant_hand": [worse] * 2}

    slow = [{key.replace("ls", "raw"): some for key, some in tallies(5).items()} for _ in range(5)]
    rows = pick_rows(range(5), [a | b for a, b in zip(slow, [tallies(n) for n in (8, 8, 9, 8, 8)], strict=True)])
    best, worst = rows
    assert (best["compensation"], worst["compensation"]) == ("ls", "raw") and best.keys() >= KEYS
    assert best["picks_per_hour"] == pytest.approx({"li_cup": 820.0, "compliant_hand": 420.0})
    assert best["success_by_gripper"] == pytest.approx({"li_cup": 0.82, "compliant_hand": 0.42})
    low, high = best["picks_per_hour_ci95"]["li_cup"]
    assert low < 820.0 < high and best["arms"] == 10 and 1.0 < best["iqm_mm"] < 3.0
    page = leaderboard_tables(rows)
    assert "picks per hour, li_cup | picks per hour, compliant_hand" in page and "| 820 (" in page


@pytest.mark.slow
def test_scripted_picking_is_tallied_on_the_same_canopies(monkeypatch):
    monkeypatch.setattr(pick_board, "COMPENSATIONS", ("raw",))
    settings = GridSettings(arms=1, grippers=("li_cup",), seed=3)
    found = pick_tallies(settings, 1, None)
    gentle, hasty = found["scripted/raw/li_cup"][0], found["hasty/raw/li_cup"][0]
    assert gentle.attempted == hasty.attempted == len(gentle.errors_mm) > 0
    assert 0 <= gentle.collected <= gentle.attempted and hasty.seconds < gentle.seconds
    assert pick_tallies(settings, 1, None) == found


def test_impossible_leaderboards_end_with_one_sentence(tmp_path):
    with pytest.raises(InputError, match=r"seeds are \[0, 1\]; give at least 5, each once"):
        LeaderboardSettings(seeds=(0, 1))
    with pytest.raises(InputError, match="each once"):
        LeaderboardSettings(seeds=(0, 1, 2, 3, 3))
    with pytest.raises(InputError, match="unknown policy 'nobody'"):
        run_leaderboard(LeaderboardSettings(("nobody",)), tmp_path)
    picky = Path(tmp_path / "picky.py")
    picky.write_text(
        STILL.replace("return np.zeros", "from pickenv import InputError\n        raise InputError('no')\n        #")
    )
    with pytest.raises(InputError, match="no"):
        run_leaderboard(LeaderboardSettings((str(picky),)), tmp_path)
