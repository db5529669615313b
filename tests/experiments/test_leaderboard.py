"""The leaderboard: every row from arms that no two seeds share, made again from what is kept; a stranger's one file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.base import InputError, mean_interval
from pickenv.cli import app
from pickenv.commands import check
from pickenv.experiments import (
    PolicySettings,
    Rows,
    kept_rows,
    policies,
    policy_tables,
    policy_tables as tables,
    run_policies,
)

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
    policy_tables.LEADERBOARD,
    policies=("scripted",),
    compensations=("raw", "ls"),
    plants=("qiao2026",),
    arms=2,
    episodes=3,
    canopies=0,
)
"""Seconds: without residual models, whose calibrations take the time."""


def test_half_and_nine_of_ten_are_counted_on_every_arm_by_itself():
    """Ten arms whose eleven fruit end 0 to 10 mm away, times the arm's own factor."""
    factor = np.linspace(0.5, 1.5, 10)
    arm, fruit = (index.ravel() for index in np.indices((10, 11)))
    cell = Rows({"arm": arm, "training": 0 * arm, "error_mm": factor[arm] * fruit[::-1]})
    assert policy_tables.distance_within(cell, 0.5).value == pytest.approx(5.0)
    most = policy_tables.distance_within(cell, 0.9)
    assert most.value == pytest.approx(9.0) and most.ci95 == pytest.approx(mean_interval(9.0 * factor))


def test_every_training_has_its_own_mean_and_a_table_of_them(tmp_path, monkeypatch):
    """Two trainings of eight steps; a run that finds them trains no more."""
    short = {
        "ppo": replace(policy_tables.RECIPES["ppo"], steps=8, parameters={"n_envs": 2, "n_steps": 4, "batch_size": 8})
    }
    monkeypatch.setattr(policy_tables, "RECIPES", short)
    settings = replace(SMALL, policies=(), compensations=("raw",), plants=("rung:fine",), episodes=1)
    board = policy_tables.run_leaderboard(settings, tmp_path, trainings=2)
    rows = [row for row in board["reach"] if row["policy"] == "ppo"]
    assert len(rows) == len(settings.grippers) and rows[0]["trainings"] == 2
    first, second = rows[0]["training_mm"]
    assert first != second and np.mean([first, second]) == pytest.approx(rows[0]["mean_mm"])
    heads, cells = policy_tables.leaderboard_tables(board)["Mean error of each training on raw arms (mm)"]
    assert (heads, cells) == (["policy", "rung:fine"], [["ppo", f"{first:.2f} {second:.2f}"]])
    policies = sorted(tmp_path.glob("trainings/ppo/*/policy.npz"))
    times = [path.stat().st_mtime_ns for path in policies]
    assert len(times) == 2 and policy_tables.run_leaderboard(settings, tmp_path, trainings=2) == board
    assert [path.stat().st_mtime_ns for path in policies] == times


def test_trainings_that_nobody_asked_for_are_not_judged(tmp_path, monkeypatch):
    monkeypatch.setattr(policy_tables, "_train", lambda folder, **levels: {"file": np.array([""])})
    for number in range(3):
        (tmp_path / f"ppo/{number}").mkdir(parents=True)
        (tmp_path / f"ppo/{number}/policy.npz").touch()
    for seeds, others in ((range(2), "2"), (range(1, 4), "0"), (range(7, 9), "0, 1, 2")):
        with pytest.raises(InputError, match=rf"ppo holds trainings of the seeds {others}, which were not asked for"):
            policy_tables.trained(tmp_path, seeds, list(policy_tables.RECIPES))
    assert len(policy_tables.trained(tmp_path, range(3), list(policy_tables.RECIPES))) == len(policy_tables.RECIPES)


@pytest.mark.parametrize(("first", "learned"), [(0, ["ppo"]), (7, ["her_camera", "ppo"]), (7, [])])
def test_what_is_learnt_is_chosen_by_name_and_its_seeds_begin_at_the_first(tmp_path, monkeypatch, first, learned):
    """Without canopies no policy learns to pick."""
    trained = set()

    def untrained(folder, **levels):
        trained.add((levels["policy"], levels["training"]))
        return {"file": np.array([""])}

    monkeypatch.setattr(policy_tables, "_train", untrained)
    monkeypatch.setattr(policy_tables, "run_policies", lambda settings, *_, **__: settings.policies)
    monkeypatch.setattr(policy_tables, "kind_of", lambda _: policies.Kind())
    monkeypatch.setattr(policy_tables, "evaluation_rows", lambda settings, reached: [])
    settings = replace(SMALL, seeds=tuple(range(first, first + 5)))
    policy_tables.run_leaderboard(settings, tmp_path, 3, learned)
    recipes = learned or [name for name in policy_tables.RECIPES if name != "ppo_pick"]
    assert trained == {(name, first + number) for name in recipes for number in range(3)}


@pytest.mark.parametrize(
    ("words", "policies"), [("", policy_tables.LEADERBOARD.policies), ("--learned ppo", ("oracle",))]
)
def test_one_learned_policy_is_judged_beside_the_oracle_alone(tmp_path, monkeypatch, words, policies):
    """The oracle runs on raw arms, so that no arm is calibrated for a policy with a camera."""
    asked = []

    def board(settings, out, count, learned, **how):
        asked.append((settings.policies, list(learned)))
        raise InputError("enough")

    monkeypatch.setattr(policy_tables, "run_leaderboard", board)
    monkeypatch.chdir(tmp_path)
    CliRunner().invoke(app, ["bench", "policies", *words.split()])
    assert asked == [(policies, words.split()[1:])] and policy_tables.kind_of("oracle").raw_only


def test_workers_of_one_process_are_refused(tmp_path):
    words = ["bench", "policies", "--quick", "--workers", "4", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code and "give --executor joblib with it" in str(done.exception) + done.output


def test_a_leaderboard_is_every_rung_with_arms_that_no_two_seeds_share():
    board = policy_tables.LEADERBOARD
    assert (
        board.plants == policy_tables.rungs(["all"]) == tuple(f"rung:{name}" for name in list(policy_tables.LADDER)[1:])
    )
    numbers = [board.first_arm(board.plants[0], seed) + np.arange(board.arms) for seed in board.seeds]
    assert len(set(np.concatenate(numbers))) == board.arms * len(board.seeds) <= 64
    with pytest.raises(InputError, match="rung:orchard has 64 arms to be judged on; 65 were asked for"):
        replace(board, arms=13).world("rung:orchard", 0)


def test_a_seed_has_its_own_arms_fruit_and_calibrations(tmp_path):
    """What a seed gives among others is what it gives alone."""
    settings = replace(SMALL, compensations=("ls",))
    both = run_policies(replace(settings, seeds=(6, 3)), cache=tmp_path)
    alone = run_policies(replace(settings, seeds=(3,)), cache=tmp_path)
    assert both.levels("seed", "arm") == [(6, 0), (6, 1), (3, 2), (3, 3)]
    np.testing.assert_array_equal(both.where(seed=3)["error_mm"], alone["error_mm"])
    assert not np.isin(both.where(seed=6)["fruit_position"], alone["fruit_position"]).any()
    assert len(list(tmp_path.glob("*.npz"))) == 4


@pytest.mark.slow
def test_rows_are_of_all_seeds_and_a_run_goes_on_where_it_was_cut(tmp_path):
    pytest.importorskip("joblib")
    board = policy_tables.run_leaderboard(SMALL, tmp_path)
    assert not board["pick"]
    worse, better = (row for row in board["reach"] if row["gripper"] == "li_cup")
    assert (worse["compensation"], better["compensation"]) == ("raw", "ls") and better["mean_mm"] < worse["mean_mm"]
    for row in (worse, better):
        assert row["seeds"] == [0, 1, 2, 3, 4] and row["arms"] == 10 and row["trainings"] is None
        low, high = row["ci95"]
        assert low < row["mean_mm"] < high and row["half_mm"] < row["nine_of_ten_mm"]
    raw = kept_rows(tmp_path / "reaching").where(compensation="raw")
    means = [raw.where(seed=seed)["error_mm"].mean() for seed in range(5)]
    assert len(set(means)) == 5 and np.mean(means) == pytest.approx(worse["mean_mm"])  # no two seeds share their arms

    kept = [*tmp_path.glob("reaching/*.parquet"), *tmp_path.glob("calibrations/*.npz")]
    times = {path: path.stat().st_mtime_ns for path in kept}
    victims = {kept[0], kept[-1]}
    for path in victims:
        path.unlink()
        assert any(finding.reason is not None for finding in check.findings_of(path.parent))
    assert policy_tables.run_leaderboard(SMALL, tmp_path, backend="loky", workers=2) == board
    assert {path for path in kept if path.stat().st_mtime_ns != times[path]} == victims
    assert all(finding.reason is None for finding in check.findings_of(tmp_path))


@pytest.mark.slow
def test_a_stranger_enters_by_one_file_and_is_judged_on_the_same_arms(tmp_path, monkeypatch):
    file = tmp_path / "still|x.py"
    file.write_text(STILL)
    monkeypatch.setattr(tables, "QUICK", SMALL)
    out, rows = tmp_path / "out", tmp_path / "rows.json"
    done = CliRunner().invoke(
        app, ["bench", "policies", "--quick", "--policy", str(file), "--out", str(out), "--json", str(rows)]
    )
    assert done.exit_code == 0, done.output
    found = json.loads(rows.read_text())["reach"]
    assert {row["policy"] for row in found} == {"scripted", "still|x"}
    lazy = [row for row in found if row["policy"] == "still|x"]
    assert {row["feedback"] for row in lazy} == {"encoders", "camera"}
    assert min(row["mean_mm"] for row in lazy) > 100.0 > max(row["mean_mm"] for row in found if row not in lazy)
    page = (out / "leaderboard.md").read_text()
    assert page.count("| scripted |") == 1 and page.count(r"| still\|x |") == 2

    file.write_text(STILL.replace("zeros", "ones"))
    pieces = set(out.glob("reaching/*still*"))
    assert len(pieces) == 15
    policy_tables.run_leaderboard(replace(SMALL, policies=(str(file), "scripted")), out)
    assert len(set(out.glob("reaching/*still*"))) == 30  # another policy by the same name is run anew
    assert len(list(out.glob("reaching/*scripted*"))) == 10  # and one that is kept is not
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "still|x.py"
    other.write_text(STILL)
    with pytest.raises(InputError, match=r"two policies are called 'still\|x'; give one of them another name"):
        run_policies(replace(SMALL, policies=(str(file), str(other))))


def test_rates_and_shares_of_picks_are_of_all_grasps_together():
    rng = np.random.default_rng(0)
    collected, attempted = rng.integers(3, 7, 12), np.full(12, 8)
    seconds = rng.uniform(40.0, 60.0, 12)
    key = {"plant": "rung:day", "gripper": "li_cup", "policy": "scripted", "compensation": "raw"}
    columns = {name: np.full(12, word) for name, word in key.items()} | {"arm": np.arange(12), "training": np.zeros(12)}
    columns |= {"collected": collected, "attempted": attempted, "duration_s": seconds}
    (row,) = policy_tables.picking_rows(Rows(columns | {"error_sum_mm": 3.0 * attempted}))
    assert (row["attempted"], row["collected"], row["arms"]) == (96, collected.sum(), 12)
    assert row["success"] == pytest.approx(collected.sum() / 96) and row["error_mm"] == pytest.approx(3.0)
    rate = 3600.0 * collected.sum() / seconds.sum()
    low, high = row["picks_per_hour_ci95"]
    assert row["picks_per_hour"] == pytest.approx(rate) and 0.5 * rate < low < rate < high < 1.5 * rate
    board = {"reach": [], "pick": [row]}
    assert "| scripted | raw | 96 | 3.00 |" in policy_tables.leaderboard_page(board)


@pytest.mark.slow
def test_pickers_are_counted_on_the_same_canopies():
    """Whoever knows the arm, or feels it from canopy to canopy, grasps nearer; who remembers picks too."""
    settings = PolicySettings(
        policies=("scripted", "recurrent_camera"), compensations=("raw", "ls"), arms=2, grippers=("li_cup",),
        plants=("field",), seeds=(3,), canopies=3,
    )  # fmt: skip
    rows = run_policies(settings, task="picking")
    behind = {(row["policy"], row["compensation"]): row for row in policy_tables.picking_rows(rows)}
    both = {name for name, compensation in behind if compensation == "ls"}
    assert both == {"scripted", "hasty"} and {name for name, _ in behind} == {
        *both, "oracle", "adaptive", "recurrent_camera"
    }  # fmt: skip
    gentle, hasty = behind["scripted", "raw"], behind["hasty", "raw"]
    assert gentle["attempted"] > 0 and 0 <= gentle["collected"] <= gentle["attempted"]
    assert hasty["picks_per_hour"] * hasty["attempted"] / hasty["collected"] > (
        gentle["picks_per_hour"] * gentle["attempted"] / gentle["collected"]
    )
    for key in (("oracle", "raw"), ("adaptive", "raw"), ("scripted", "ls")):
        assert behind[key]["error_mm"] < gentle["error_mm"], key
    alone = run_policies(replace(settings, policies=("scripted",), compensations=("raw",)), task="picking")
    some = rows.where(policy=("scripted", "hasty"), compensation="raw")
    for name in ("attempted", "collected", "duration_s", "error_sum_mm"):
        np.testing.assert_array_equal(alone.where(policy=("scripted", "hasty"))[name], some[name])


@pytest.mark.slow
def test_an_arm_picks_alike_beside_others_and_behind_nothing(monkeypatch):
    """Raw arms stand side by side, compensated ones in turn; a compensator that changes nothing is no difference."""
    settings = PolicySettings(
        policies=(), compensations=("raw", "ls"), arms=2, grippers=("li_cup",), plants=("rung:orchard",), canopies=2
    )
    same = policies.methods.compensators

    def idle(population, compensation, *rest):
        return None if same(population, "raw", *rest) is compensation == "raw" else [lambda joints: joints] * 2

    monkeypatch.setattr(policies.methods, "compensators", idle)
    rows = run_policies(settings, task="picking").where(policy="scripted")
    for name in ("attempted", "collected", "duration_s", "error_sum_mm", "tilt_sum_deg"):
        np.testing.assert_array_equal(rows.where(compensation="raw")[name], rows.where(compensation="ls")[name])


@pytest.mark.slow
def test_a_policy_that_picks_enters_the_picking_alone(tmp_path, monkeypatch):
    short = replace(policy_tables.RECIPES["ppo_pick"], steps=8, parameters={"n_envs": 2, "n_steps": 4, "batch_size": 8})
    monkeypatch.setattr(policy_tables, "RECIPES", {"ppo_pick": short})
    settings = replace(SMALL, compensations=("raw",), plants=("rung:fine",), arms=1, episodes=1, canopies=1)
    board = policy_tables.run_leaderboard(settings, tmp_path, trainings=2)
    assert {row["policy"] for row in board["reach"]} == {"scripted"}
    (row,) = (row for row in board["pick"] if row["policy"] == "ppo_pick")
    assert len(row["training_success"]) == 2 and row["arms"] == 5
    title = "Grasps of each training that succeed on raw arms (%)"
    assert policy_tables.leaderboard_tables(board)[title][1][0][0] == "ppo_pick"
    with pytest.raises(InputError, match="ppo_pick picks, but no canopy is picked; give at least one"):
        policy_tables.run_leaderboard(
            replace(settings, canopies=0, policies=(str(tmp_path / "trainings/ppo_pick"),)), tmp_path
        )
    with pytest.raises(InputError, match=r"'ppo_pick' is not trained for this leaderboard.*needs at least one of `can"):
        policy_tables.run_leaderboard(replace(settings, canopies=0), tmp_path / "none", 2, ["ppo_pick"])
    unpicked = policy_tables.run_leaderboard(replace(settings, canopies=0), tmp_path / "none", 2)
    assert {row["policy"] for row in unpicked["reach"]} == {"scripted"}
    with pytest.raises(InputError, match="ppo_pick picks, and cannot be compared on reaches; judge it in pickenv/Pick"):
        run_policies(replace(settings, policies=(str(tmp_path / "trainings/ppo_pick"),)))


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


def test_the_published_tables_are_those_of_the_published_file():
    docs = Path(__file__).parents[2] / "docs"
    board = json.loads((docs / "_static/leaderboard.json").read_text(encoding="utf-8"))
    page = (docs / "leaderboard.md").read_text(encoding="utf-8")
    assert {row["plant"] for row in board["reach"]} == set(policy_tables.LEADERBOARD.plants)
    parts = policy_tables.leaderboard_page(board).split("### ")[1:]
    assert len(parts) == 2 * len(policy_tables.LEADERBOARD.plants) + 2
    for part in parts:
        assert part.strip() in page, part.splitlines()[0]
