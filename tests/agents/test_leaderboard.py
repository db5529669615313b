"""The leaderboard: every row from arms that no two seeds share, made again from what is kept; a stranger's one file."""

import json
import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import trim_mean
from typer.testing import CliRunner

from pickenv.agents.evaluation import leaderboard, pick_board
from pickenv.agents.evaluation.grid import GridSettings
from pickenv.agents.evaluation.leaderboard import (
    LeaderboardSettings,
    leaderboard_cells,
    leaderboard_tables,
    run_leaderboard,
)
from pickenv.agents.evaluation.pick_board import PickTally, pick_rows, pick_tallies
from pickenv.cli import app
from pickenv.errors import InputError
from pickenv.intervals import interquartile_estimate
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


def test_the_interquartile_estimate_forgets_the_best_and_the_worst_quarter():
    values = np.concatenate([[1e6, -1e6], np.random.default_rng(0).normal(3.0, 0.5, 38)])
    found = interquartile_estimate(values, stream(0, "leaderboard"))
    assert found.value == pytest.approx(np.sort(values)[10:30].mean())
    low, high = found.ci95
    rng = np.random.default_rng(1)
    again = trim_mean(rng.choice(values, (2000, 40)), 0.25, axis=1)
    assert (low, high) == pytest.approx(np.quantile(again, (0.025, 0.975)), abs=0.03)
    assert interquartile_estimate(values[:9], stream(0, "leaderboard")).ci95 is None


class Arms:
    """A cell of a grid: errors of two arms, one training and three fruit in mm, and a tenth of them in degrees."""

    def __init__(self, compensation: str, errors: list[list[float]], policy: str = "scripted") -> None:
        self.plant, self.policy, self.feedback, self.compensation = "field", policy, "encoders", compensation
        self.errors_mm = np.array(errors)[:, None, :]

    def per_arm(self, number):
        return number(SimpleNamespace(reaches=SimpleNamespace(attitude_error_deg=0.1 * self.errors_mm)))

    def chances(self, gripper):
        return np.where(self.errors_mm < gripper, 1.0, 0.0)


def test_rows_are_worked_out_over_the_arms_of_all_seeds():
    """Ten arms of one to ten millimetres; a quarter of ten is two and a half, of which trimming leaves out two."""
    grippers = dict(zip(leaderboard.GRIPPERS, (5.0, 8.0), strict=True))
    grids = [
        SimpleNamespace(
            grippers=grippers,
            settings=SimpleNamespace(seed=seed),
            cells=[
                Arms("raw", [[m - 0.5, m, m + 0.5] for m in (2.0 * seed + 1.0, 2.0 * seed + 2.0)]),
                Arms("ls", [[0.1 * seed] * 3, [0.1 * seed] * 3]),
                Arms("raw", [[40.0] * 3, [50.0] * 3], policy="still"),
            ],
        )
        for seed in (4, 0, 3, 1, 2)
    ]
    ls, raw, still = leaderboard.leaderboard_rows(grids)
    assert [(row["policy"], row["compensation"]) for row in (ls, raw, still)] == [
        ("scripted", "ls"),
        ("scripted", "raw"),
        ("still", "raw"),
    ]
    for row in (ls, raw, still):
        assert (row["task"], row["feedback"], row["arms"], row["fruit_per_arm"]) == (
            "pickenv/Reach-v0, field",
            "encoders",
            10,
            3,
        )
        assert row["seeds"] == [0, 1, 2, 3, 4]
    assert raw["mean_mm"] == pytest.approx(5.5) and raw["attitude_deg"] == pytest.approx(0.55)
    assert raw["iqm_mm"] == pytest.approx(np.mean([3, 4, 5, 6, 7, 8]))
    held = [13 / 30, 22 / 30]  # below 5 mm: three of each of 1 to 4 mm, one of 5 mm; below 8 mm likewise
    assert raw["success"] == pytest.approx(held[0])
    assert raw["success_by_gripper"] == pytest.approx(dict(zip(grippers, held, strict=True)))
    expected = interquartile_estimate(np.array([9.0, 10, 1, 2, 7, 8, 3, 4, 5, 6]), stream(0, "leaderboard"))
    assert raw["ci95_mm"] == list(expected.ci95)
    assert ls["mean_mm"] == pytest.approx(0.2) and still["mean_mm"] == pytest.approx(45.0)
    assert leaderboard_cells(raw) == [
        "scripted",
        "encoders",
        "raw",
        "5.500",
        f"5.500 ({expected.ci95[0]:.3f} to {expected.ci95[1]:.3f})",
        "0.550",
        "43 %",
        "73 %",
    ]
    page = leaderboard_tables([ls, raw, still]).splitlines()
    assert page[0] == "pickenv/Reach-v0, field: 10 arms over seeds 0, 1, 2, 3, 4, 3 fruit each" and page[1] == ""
    assert (
        page[2].startswith("| policy | feedback | compensation | mean (mm) |")
        and page[3] == f"| {'|'.join(['---'] * 8)} |"
    )
    assert page[5] == f"| {' | '.join(leaderboard_cells(raw))} |" and len(page) == 7
    alone = leaderboard.leaderboard_rows(grids[:1])[0]
    assert alone["ci95_mm"] is None and leaderboard_cells(alone)[4] == "0.400 (no interval)"


def test_a_leaderboards_grid_has_its_seed_for_arms_and_calibrations():
    settings = LeaderboardSettings(("servo",), ("ideal",), seeds=(3, 4, 5, 6, 7), arms=2, episodes=5, epochs=9)
    grid = settings.grid("servo", ("camera",), 6)
    assert (grid.policies, grid.feedback, grid.plants, grid.arms, grid.episodes) == (
        ("servo",),
        ("camera",),
        ("ideal",),
        2,
        5,
    )
    assert (grid.seed, grid.protocol.seed, grid.protocol.epochs) == (6, 6, 9)
    assert (grid.compensations, grid.grippers) == (leaderboard.COMPENSATIONS, ("li_cup", "compliant_hand"))
    usual, quick = LeaderboardSettings(), LeaderboardSettings.quick()
    assert (usual.seeds, usual.arms, usual.episodes, usual.epochs) == ((0, 1, 2, 3, 4), 2, 16, 100)
    assert (usual.canopies, quick.canopies) == (2, 0)
    assert (quick.seeds, quick.arms, quick.episodes, quick.epochs) == ((0, 1, 2, 3, 4), 1, 4, 20)


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


def test_the_published_table_has_the_numbers_of_the_published_file():
    """docs/leaderboard.md and docs/_static/leaderboard.json are of one run, row for row."""
    docs = Path(__file__).parents[2] / "docs"
    names = {"raw": "raw", "ls": "LS", "ls_bpnn": "LS+BPNN", "best": "LS+GP"}
    rows = json.loads((docs / "_static/leaderboard.json").read_text(encoding="utf-8"))["rows"]
    page = (docs / "leaderboard.md").read_text(encoding="utf-8")
    printed = {}
    for part in page.split("### ")[1:]:
        for line in part.splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if len(cells) > 7 and cells[2] in names.values():
                printed[part.splitlines()[0], *cells[:3]] = cells[3:8]
    assert len(printed) == len(rows) > 90
    for row in rows:
        low, high = row["ci95_mm"]
        grippers = [f"{100 * row['success_by_gripper'][name]:.0f} %" for name in ("li_cup", "compliant_hand")]
        key = row["task"], row["policy"], row["feedback"], names[row["compensation"]]
        mean, middle, attitude = f"{row['mean_mm']:.3f}", f"{row['iqm_mm']:.3f}", f"{row['attitude_deg']:.3f}"
        assert printed[key] == [mean, f"{middle} ({low:.3f} to {high:.3f})", attitude, *grippers]
