"""Evaluations: rows with the keys that are promised, pairs on the same fruit, honest intervals, files."""

import csv
import json
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from scipy.stats import t
from typer import Typer
from typer.testing import CliRunner

from pickenv.agents import Rollout, load_policy
from pickenv.agents.evaluation.contenders import kind_of
from pickenv.arm import load_plant, plant_at
from pickenv.base import (
    Estimate,
    InputError,
    clustered_share_interval,
    crossed_interval,
    mean_interval,
    quantile_interval,
)
from pickenv.commands import learning as commands
from pickenv.envs import CONTROL_PERIOD
from pickenv.experiments import (
    CalibrationPlan,
    PolicySettings,
    Rows,
    calibrate_arm,
    compensations_compared,
    compensators,
    evaluation_rows,
    run_policies,
    write_rows,
)
from pickenv.experiments.methods import METHODS
from pickenv.experiments.policies import reaches_in
from pickenv.experiments.policy_tables import (
    cells_of,
    drawings,
    evaluation_content,
    page,
    read_episodes,
    write_evaluation,
)
from pickenv.inspect import read_run, write_drawings
from tests.experiments.synthetic import SETTINGS, rows_of

KEYS = {"policy", "compensation", "feedback", "plant", "gripper", "mean_mm", "success_rate", "ci95", "success_ci95"}
SMALL = PolicySettings(
    policies=("scripted", "oracle", "servo"),
    compensations=("raw", "ls"),
    plants=("qiao2026",),
    arms=10,
    episodes=4,
    plan=CalibrationPlan(60, 100, 10),
)
SLOWEST = ("servo", "ls")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("calibrations")


@pytest.fixture(scope="module")
def episodes(folder):
    return run_policies(SMALL, cache=folder)


@pytest.fixture(scope="module")
def table(episodes):
    return evaluation_rows(SMALL, episodes)


def cell_of(episodes, **levels):
    """Rows of a cell, and its final errors by other lines: ``(arms, fruit)``."""
    cell = episodes.where(**levels)
    errors = 1e3 * np.sqrt((cell["pose_error"][:, :3] ** 2).sum(axis=1))
    return cell, errors.reshape(-1, len(set(cell["arm"].tolist()))).T


def test_there_is_one_row_per_combination(table):
    rows = table
    combinations = {
        tuple(row[key] for key in ("policy", "compensation", "feedback", "plant", "gripper")) for row in rows
    }
    # scripted and servo with two compensations, the oracle raw alone; two grippers
    assert len(rows) == len(combinations) == (2 + 2 + 1) * 2
    for row in rows:
        assert set(row) >= KEYS | {"episodes", "seeds"}
        assert row["episodes"] == 40 and row["seeds"] == [0]
        assert row["ci95"][0] <= row["mean_mm"] <= row["ci95"][1]
        assert 0 <= row["success_rate"] <= 1
    json.dumps(rows)


def test_all_cells_meet_the_same_arms_and_fruit(episodes):
    keys = episodes.levels("policy", "compensation")
    cells = [episodes.where(policy=policy, compensation=behind) for policy, behind in keys]
    assert len(cells) == 5
    for cell in cells:
        assert np.array_equal(cell["fruit_position"], cells[0]["fruit_position"])
        assert np.array_equal(cell["arm"], cells[0]["arm"]) and np.array_equal(cell["episode"], cells[0]["episode"])
    assert len(np.unique(cells[0]["fruit_position"][:, 0])) == 40


def test_calibration_helps_open_loop_and_the_comparison_says_so(episodes):
    found = {(row["policy"], row["from"], row["to"]): row for row in compensations_compared(episodes)}
    assert found["scripted", "raw", "ls"]["significant"]
    assert found["scripted", "raw", "ls"]["difference_mm"] < -0.5


@pytest.mark.slow
def test_residual_models_help_beyond_least_squares_and_several_processes_find_the_same(folder):
    pytest.importorskip("joblib")
    settings = replace(SMALL, policies=("scripted",), compensations=METHODS, arms=2, plan=CalibrationPlan(60, 100, 50))
    alone = run_policies(settings, cache=folder)
    means = {behind: alone.where(compensation=behind)["error_mm"].mean() for behind in METHODS}
    assert means["best"] < means["ls_bpnn"] < means["ls"] < means["raw"]
    several = run_policies(settings, backend="loky", workers=2)
    for name, values in alone.columns.items():
        np.testing.assert_array_equal(several[name], values)


def test_an_evaluation_is_reproducible_and_its_calibrations_are_kept(episodes, folder):
    before = sorted(path.name for path in folder.glob("*.npz"))
    assert len(before) == 10
    again = run_policies(SMALL, cache=folder, fits=lambda policy, compensation, **_: (policy, compensation) != SLOWEST)
    cells = again.levels("policy", "compensation")
    assert len(cells) == 4
    for policy, behind in cells:
        for name, values in episodes.where(policy=policy, compensation=behind).columns.items():
            np.testing.assert_array_equal(again.where(policy=policy, compensation=behind)[name], values)
    assert sorted(path.name for path in folder.glob("*.npz")) == before


@pytest.mark.slow
def test_any_registered_residual_model_is_a_method_of_the_table(tmp_path):
    """ "ls+gp" is what "best" is short for; another's name fits that model."""
    settings = replace(SMALL, policies=("scripted",), compensations=("raw", "ls+gp", "best", "ls+rbf"))
    settings = replace(settings, arms=1, episodes=2)
    rows = run_policies(settings, cache=tmp_path)
    errors = {behind: rows.where(compensation=behind)["error_mm"] for behind in settings.compensations}
    np.testing.assert_array_equal(errors["ls+gp"], errors["best"])
    assert not np.array_equal(errors["ls+rbf"], errors["best"])
    assert {row["compensation"] for row in evaluation_rows(settings, rows)} == set(settings.compensations)
    assert calibrate_arm(load_plant("qiao2026"), "ls+rbf", SMALL.plan).learnt.kind == "rbf"
    write_evaluation(settings, rows, tmp_path / "run")
    shown = page(read_run(tmp_path / "run"))
    for model in ("Gaussian process", "radial basis functions"):
        assert f"least squares + {model}</td>" in shown and f"ls + {model}" not in shown


def test_what_calibrates_nothing_is_refused():
    with pytest.raises(InputError, match="raw calibrates nothing; give ls"):
        calibrate_arm(load_plant("qiao2026"), "raw")


def test_arms_with_different_numbers_of_joints_stand_in_one_table(tmp_path):
    settings = replace(SMALL, policies=("scripted",), compensations=("raw",), plants=("qiao2026", "so101"), arms=2)
    rows = run_policies(settings)
    assert [reaches_in(rows.where(plant=plant)).joint_command.shape for plant in settings.plants] == [(8, 6), (8, 5)]


def test_plants_with_compensations_of_their_own_are_one_evaluation():
    settings = replace(SMALL, policies=("scripted",), plants=("qiao2026", "orchard"), arms=2, episodes=2)
    rows = run_policies(settings, fits=lambda plant, compensation, **_: plant == "qiao2026" or compensation == "raw")
    assert rows.levels("plant", "compensation") == [("qiao2026", "raw"), ("qiao2026", "ls"), ("orchard", "raw")]
    assert [line["plant"] for line in compensations_compared(rows)] == ["qiao2026"]


def test_a_kept_calibration_is_of_its_own_arm_and_protocol(tmp_path):
    """Two arms' files swapped, or one of another protocol under this one's name, are refused by name."""
    settings = replace(SMALL, policies=("scripted",), compensations=("ls",), arms=2, episodes=2)
    run_policies(settings, cache=tmp_path)
    first, second = sorted(tmp_path.glob("*.npz"))
    before = {path: path.read_bytes() for path in (first, second)}
    first.write_bytes(before[second])
    second.write_bytes(before[first])
    with pytest.raises(InputError, match=r"ls-\w+\.npz is the calibration of another arm or protocol") as caught:
        run_policies(settings, cache=tmp_path)
    assert any(str(path) in str(caught.value) for path in before)
    first.write_bytes(before[first])
    second.write_bytes(before[second])
    run_policies(replace(settings, plan=CalibrationPlan(40, 100, 10)), cache=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 4
    for path in before:
        path.write_bytes(next(p for p in tmp_path.glob("*.npz") if p not in before).read_bytes())
    with pytest.raises(InputError, match="of another arm or protocol than its name says; delete it"):
        run_policies(settings, cache=tmp_path)


@pytest.mark.parametrize("changed", ["code", "plant"])
def test_a_kept_calibration_is_left_alone_when_code_or_plant_have_changed(tmp_path, monkeypatch, changed):
    plant = load_plant("qiao2026")
    protocol = CalibrationPlan(30)
    compensators(plant, "ls", protocol, tmp_path)
    if changed == "code":
        monkeypatch.setattr("pickenv.experiments.engine.code_fingerprint", lambda: "another")
    else:
        geometry = replace(plant.geometry, a=plant.geometry.a + 1e-12)
        plant = replace(plant, geometry=geometry)
    compensators(plant, "ls", protocol, tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_plant_of_any_name_keeps_to_the_folder(tmp_path):
    plant = replace(load_plant("qiao2026"), name="../../x/y")
    compensators(plant, "ls", CalibrationPlan(30), tmp_path / "cache")
    assert [path.parent for path in tmp_path.rglob("*.npz")] == [tmp_path / "cache"]


def test_the_steps_of_a_cycle_are_counted_to_where_the_tool_stays(episodes):
    servo = episodes.where(policy="servo", compensation="raw")
    rollout = Rollout(reaches_in(servo), servo["arm"], np.empty(0), servo["way_mm"].T)
    steps = rollout.cycle_steps(5.0)
    assert np.isfinite(steps).any()
    for i in np.flatnonzero(np.isfinite(steps)):
        assert (rollout.error_mm[int(steps[i]) - 1 :, i] <= 5.0).all()


def test_rows_are_what_their_episodes_say(table, episodes):
    """Every number of every row, from the raw arrays by other lines."""
    for row in table:
        cell, errors = cell_of(episodes, policy=row["policy"], compensation=row["compensation"])
        chance = cell[f"chance_{row['gripper']}"]
        arms = errors.mean(axis=1)
        assert len(arms) == row["arms"] == 10 and row["interval_over"] == "arms" and row["trainings"] is None
        assert row["mean_mm"] == pytest.approx(errors.mean())
        assert row["ci95"] == pytest.approx(mean_interval(arms))
        assert row["median_arm_mm"] == pytest.approx(np.median(arms))
        assert row["median_arm_ci95"] == pytest.approx(quantile_interval(arms, 0.5))
        assert row["p95_arm_mm"] == pytest.approx(max(arms))  # of ten, Hazen's 95th percentile is the largest
        assert row["p95_arm_ci95"][1] is None  # ten arms bound it from below alone
        assert row["success_rate"] == pytest.approx(chance.mean())
        taken = pd.DataFrame({"arm": cell["arm"], "chance": chance}).groupby("arm").chance.sum()
        assert row["success_ci95"] == pytest.approx(clustered_share_interval(taken, 4))
        steps = [1 + np.flatnonzero(way > 2.0).max(initial=-1) + 1 for way in cell["way_mm"]]
        stayed = [step for step in steps if step <= cell["way_mm"].shape[1]]
        assert row["cycle_s"] == pytest.approx(np.median(stayed) * CONTROL_PERIOD if stayed else None)
        assert row["within_tolerance"] == len(stayed) / 40


def test_the_printed_95_percent_are_95_percent(table, episodes):
    """Hall's skewed t: both ends solve its equation at Student's 2.5 and 97.5 %."""
    row = table[0]
    _, errors = cell_of(episodes, policy=row["policy"], compensation=row["compensation"])
    arms = errors.mean(axis=1)
    spread = arms.std(ddof=1)
    skewness = np.mean((arms - arms.mean()) ** 3) / spread**3
    for end, level in zip(row["ci95"], (0.975, 0.025), strict=True):
        z = (arms.mean() - end) / spread
        left = z + skewness * z**2 / 3 + skewness**2 * z**3 / 27 + skewness / 60
        assert left == pytest.approx(t.ppf(level, 9) / np.sqrt(10))


def test_a_difference_is_of_arms_in_pairs(episodes):
    for line in compensations_compared(episodes):
        change = [cell_of(episodes, policy=line["policy"], compensation=line[key])[1] for key in ("from", "to")]
        arms = (change[1] - change[0]).mean(axis=1)
        assert line["difference_mm"] == pytest.approx(arms.mean())
        assert line["ci95"] == pytest.approx(mean_interval(arms))
        assert line["significant"] == (not line["ci95"][0] <= 0.0 <= line["ci95"][1])


def test_few_arms_and_few_trainings_have_numbers_but_no_interval(tmp_path):
    rng = np.random.default_rng(0)
    nine, four = rng.gamma(2.0, size=(9, 1, 8)), rng.gamma(2.0, size=(64, 4, 8))
    for errors, reason in ((nine, "needs 10 arms"), (four, "needs 5 trainings"), (np.ones((64, 1, 8)), "all arms are")):
        found = rows_of(errors, errors, learned=errors is four)
        row, line = evaluation_rows(SETTINGS, found)[0], compensations_compared(found)[0]
        assert row["mean_mm"] == pytest.approx(errors.mean()) and row["ci95"] is None
        assert row["no_interval"].startswith(reason)
        assert line["ci95"] is None and line["significant"] is None
        assert f"none: {row['no_interval']}" in cells_of(row)
        assert json.loads(json.dumps(row))["ci95"] is None


def test_a_row_says_of_how_many_trainings_it_is():
    errors = np.random.default_rng(0).gamma(2.0, size=(64, 5, 8))
    one, five = (evaluation_rows(SETTINGS, rows_of(errors[:, :n], learned=True))[0] for n in (1, 5))
    assert one["interval_over"] == "arms, of this one training" and cells_of(one)[0] == "some (one training)"
    assert five["interval_over"] == "arms and 5 trainings" and cells_of(five)[0] == "some (5 trainings)"
    assert five["ci95"] == pytest.approx(crossed_interval(errors.mean(axis=2)))
    assert five["mean_mm"] == pytest.approx(errors.mean())
    assert five["median_arm_mm"] == pytest.approx(np.median(errors.mean(axis=(1, 2))))
    assert five["median_arm_ci95"] is None


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ((-0.04, 0.049), "carries over"),
        ((0.01, 0.02), "carries over"),
        ((0.01, 0.06), "differs"),
        ((-0.3, -0.1), "differs"),
        ((-0.01, 0.06), "not settled"),
        (None, "not settled"),
        ((0.01, None), "differs"),
        ((-0.01, None), "not settled"),
    ],
)
def test_no_difference_is_only_what_lies_within_the_margin(ends, said):
    assert Estimate(0.0, ends).verdict(0.05) == said


def test_the_command_says_every_setting(tmp_path):
    """What a run folder says makes the same comparison again."""
    settings = PolicySettings(
        policies=("scripted", "servo"), compensations=("raw", "ls"), feedback=("camera",), plants=("field",),
        grippers=("compliant_hand",), arms=3, episodes=5, tolerances="fine", camera_noise_mm=1.5, fruit_noise_mm=2.0,
        seeds=(7,), plan=CalibrationPlan(epochs=9),
    )  # fmt: skip
    write_evaluation(settings, rows_of(np.ones((3, 1, 5))), tmp_path)
    assert read_run(tmp_path).command == (
        "pickenv evaluate --policy scripted --policy servo --compensation raw --compensation ls --feedback camera "
        "--plant field --gripper compliant_hand --arms 3 --episodes 5 --tolerances fine --camera-noise 1.5 "
        "--fruit-noise 2 --epochs 9 --seed 7"
    )


def test_a_plant_that_names_its_class_has_arms_of_it_and_says_so():
    settings = PolicySettings(plants=("fine:ur5e",), tolerances="coarse", grippers=("compliant_hand",), arms=1)
    rows = rows_of(np.ones((1, 1, 2)))
    (row,) = evaluation_rows(settings, Rows(dict(rows.columns) | {"plant": np.full(2, "fine:ur5e")}))
    assert row["tolerances"] == settings.world("fine:ur5e", 0)["tolerances"] == "fine"
    assert settings.world("orchard", 0)["tolerances"] == "coarse"


def test_rows_are_written_and_read(episodes, tmp_path):
    with write_rows(tmp_path / "rows.csv", episodes).open(encoding="utf-8") as file:
        read = list(csv.DictReader(file))
    assert [float(row["error_mm"]) for row in read] == episodes["error_mm"].tolist()
    parquet = pytest.importorskip("pyarrow.parquet")
    written = parquet.read_table(write_rows(tmp_path / "rows.parquet", episodes))
    assert written.column("error_mm").to_pylist() == episodes["error_mm"].tolist()
    with pytest.raises(InputError, match=r"ends in \.csv or \.parquet"):
        write_rows(tmp_path / "rows.xls", episodes)


def test_figures_are_drawn_from_the_run_folder_to_the_bit(episodes, tmp_path):
    assert {path.name for path in write_evaluation(SMALL, episodes, tmp_path)} == {"episodes.parquet", "rows.json"}
    run = read_run(tmp_path)
    assert run.kind == "evaluation"
    again = read_episodes(run)
    for name, values in episodes.columns.items():
        np.testing.assert_array_equal(again[name], values)
    assert len(pd.read_parquet(tmp_path / "episodes.parquet")) == len(episodes)
    assert evaluation_content(SMALL, again) == json.loads((tmp_path / "rows.json").read_text())
    written = write_drawings(drawings(run)[:3], tmp_path / "figures", ["svg"])
    assert [path.stat().st_size > 10_000 for path in written] == [True] * 3
    (tmp_path / "episodes.parquet").write_bytes(b"of another run")
    with pytest.raises(InputError, match=r"episodes\.parquet is not what the run wrote"):
        read_episodes(run)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"policies": ("nobody",)}, "unknown policy 'nobody'; give random, scripted"),
        ({"policies": ("missing.npz",)}, "unknown policy 'missing.npz'"),
        (
            {"compensations": ("magic",)},
            r"unknown compensation 'magic'; give one of raw, ls, ls_bpnn, best, or ls\+ and",
        ),
        ({"compensations": ("ls+magic",)}, r"unknown compensation 'ls\+magic'; give one of raw"),
        ({"feedback": ("sonar",)}, "feedback is 'sonar'"),
        ({"grippers": ("tongs",)}, "unknown gripper 'tongs'"),
        ({"plants": ("nowhere",)}, "nowhere"),
        ({"arms": 0}, "arms is 0; give 1 to 10 000"),
        ({"split": "train"}, "chooses among a rung's arms; name a rung"),
        ({"split": "test"}, "`split='test'` chooses among a rung's arms; name a rung"),
    ],
)
def test_bad_settings_end_with_one_sentence(changes, message):
    with pytest.raises(InputError, match=message):
        run_policies(PolicySettings(**({"arms": 1, "episodes": 1, "policies": ("scripted",)} | changes)))


def test_the_commands_run(tmp_path):
    app = Typer()
    app.command()(commands.train)
    app.command()(commands.evaluate)
    runner = CliRunner()
    out = tmp_path / "run"
    result = runner.invoke(app, ["train", "--steps", "3840", "--plant", "ideal", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "mm mean" in result.output
    refused = runner.invoke(app, ["train", "--out", str(out)])
    assert isinstance(refused.exception, InputError) and "--resume" in str(refused.exception)
    assert runner.invoke(app, ["train", "--resume", "--out", str(out)]).exit_code == 0
    options = ["--policy", "scripted", "--policy", str(out / "policy.npz"), "--compensation", "raw", "--arms", "2"]
    options += ["--episodes", "4", "--plant", "qiao2026", "--json", str(tmp_path / "rows.json")]
    result = runner.invoke(app, ["evaluate", *options])
    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert {row["policy"].split("/")[-1] for row in rows} == {"scripted", "policy"} and set(rows[0]) >= KEYS
    assert {row["interval_over"] for row in rows} == {"arms", "arms, of this one training"}
    assert "no intervals: needs" in result.output


def test_trainings_of_several_seeds_are_one_policy(tmp_path):
    """The mean over arms and trainings; a folder of anything else is refused."""
    with pytest.raises(InputError, match="holds no trainings"):
        kind_of(str(tmp_path))
    policy = load_policy("ppo_encoders")
    training = policy.record["training"]
    for seed in range(2):
        record = {**policy.record, "training": training | {"seed": seed}}
        weights = tuple((1.0 + 0.2 * seed) * weight for weight in policy.weights)
        replace(policy, record=record, weights=weights).save(tmp_path / "several" / str(seed) / "policy.npz")
    files = tuple(str(tmp_path / "several" / str(seed) / "policy.npz") for seed in range(2))
    assert kind_of(str(tmp_path / "several" / "0")) == kind_of(files[0]), "its folder stands for a training"
    settings = replace(SMALL, compensations=("raw",), feedback=("encoders",), arms=3)
    apart = run_policies(replace(settings, policies=files))
    settings = replace(settings, policies=(str(tmp_path / "several"),))
    together = run_policies(settings)
    assert together.levels("policy", "training") == [("several", 0), ("several", 1)]
    np.testing.assert_array_equal(together["error_mm"], apart["error_mm"])
    assert not np.array_equal(together.where(training=0)["error_mm"], together.where(training=1)["error_mm"])
    row = evaluation_rows(settings, together)[0]
    assert (row["arms"], row["trainings"], row["episodes"]) == (3, 2, 24)
    assert row["mean_mm"] == pytest.approx(apart["error_mm"].mean())
    other = {**policy.record, "training": training | {"seed": 2, "steps": 7}}
    replace(policy, record=other).save(tmp_path / "several" / "2" / "policy.npz")
    with pytest.raises(InputError, match="differ in more than their seeds"):
        kind_of(str(tmp_path / "several"))


RUNGS = replace(
    SMALL,
    policies=("scripted",),
    compensations=("raw",),
    plants=("rung:orchard", "rung:own_eyes"),
    arms=5,
    seeds=(0, 1),
)


def test_on_a_rung_every_seed_takes_other_arms_and_what_the_rung_fixes_is_fixed() -> None:
    rows = run_policies(RUNGS)
    assert sorted(set(rows["arm"])) == list(range(2 * RUNGS.arms)), "no two seeds share an arm"
    eyes = {kind: RUNGS.world("rung:own_eyes", 0, kind) for kind in ("encoders", "camera")}
    assert [eyes[kind]["fruit_noise_mm"] for kind in eyes] == [6.3, 6.3], "the rung has its own eyes"
    assert [eyes[kind]["camera_noise_mm"] for kind in eyes] == [0.0, 1.6]
    blind = rows.where(policy="scripted", plant="rung:own_eyes")["error_mm"]
    assert blind.mean() > rows.where(policy="scripted", plant="rung:orchard")["error_mm"].mean() + 2.0
    env = gym.make("pickenv/Reach-v0", difficulty="orchard", split="test")
    for seed in RUNGS.seeds:
        env.reset(seed=5, options={"arm": RUNGS.first_arm("rung:orchard", seed) + 3})
        own, drawn = env.unwrapped.plant, plant_at(RUNGS.population("rung:orchard", seed), 3)
        np.testing.assert_allclose(own.geometry.d, drawn.geometry.d, rtol=1e-6)
    one, other = (
        settings.population("rung:orchard", 0).geometry.d for settings in (RUNGS, replace(RUNGS, split="train"))
    )
    assert (one != other).any(axis=-1).all(), "no arm to train on is one to be judged on"


def test_on_a_rung_every_seed_s_arms_are_behind_their_own_calibrations() -> None:
    settings = replace(RUNGS, plants=("rung:coarse",), compensations=("raw", "ls"), arms=2)
    rows = run_policies(settings)
    for seed in settings.seeds:
        raw, ls = (rows.where(seed=seed, policy="scripted", compensation=name)["error_mm"] for name in ("raw", "ls"))
        assert ls.mean() < 0.7 * raw.mean(), "another arm's calibration would only add to the error"


def test_a_rung_without_error_or_with_fewer_arms_is_refused() -> None:
    with pytest.raises(InputError, match="rung:ideal has 1 arm to be judged on; 10 were asked for"):
        run_policies(replace(RUNGS, plants=("rung:ideal",)))
    with pytest.raises(InputError, match="difficulty is 'hard'; give one of ideal, fine"):
        run_policies(replace(RUNGS, plants=("rung:hard",)))


def test_arms_to_tune_on_are_other_arms() -> None:
    few = {"policies": ("scripted",), "compensations": ("raw",), "feedback": ("encoders",), "arms": 2, "episodes": 1}
    found = [run_policies(PolicySettings(plants=("rung:orchard",), split=split, **few)) for split in ("train", "test")]
    assert not np.isclose(*(rows["error_mm"] for rows in found)).any()


def test_a_rungs_rows_say_the_arms_and_noise_of_the_rung() -> None:
    settings = PolicySettings(plants=("rung:own_eyes",), grippers=("compliant_hand",), arms=1)
    rows = rows_of(np.ones((1, 1, 2)))
    rows = Rows(dict(rows.columns) | {"plant": np.full(2, "rung:own_eyes"), "feedback": np.full(2, "camera")})
    (row,) = evaluation_rows(settings, rows)
    world = settings.world("rung:own_eyes", 0, "camera")
    for name in ("tolerances", "camera_noise_mm", "fruit_noise_mm", "population_seed"):
        assert row[name] == world[name], name
