"""The comparison: rows with the keys that are promised, pairs on the same fruit, honest intervals, files."""

import csv
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t
from typer import Typer
from typer.testing import CliRunner

from pickenv.agents.evaluation.calibrated import CalibrationPlan, compensators
from pickenv.agents.evaluation.compared_policies import kind_of
from pickenv.agents.evaluation.grid import GridSettings, run_grid
from pickenv.agents.evaluation.grid_figures import grid_drawings
from pickenv.agents.evaluation.grid_tables import cells_of, command_of, flat_rows, read_grid, write_grid, write_rows
from pickenv.agents.policies.learned import load_policy
from pickenv.arm import load_plant
from pickenv.commands import learning as commands
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.errors import InputError
from pickenv.inspect.figures.run_drawings import write_drawings
from pickenv.inspect.runs.run_folder import read_run
from pickenv.intervals import Estimate, clustered_share_interval, crossed_interval, mean_interval, quantile_interval
from tests.agents.synthetic import grid_of

KEYS = {"policy", "compensation", "feedback", "plant", "gripper", "mean_mm", "success_rate", "ci95", "success_ci95"}
SMALL = GridSettings(
    policies=("scripted", "oracle", "servo"),
    compensations=("raw", "ls"),
    plants=("qiao2026",),
    arms=10,
    episodes=4,
    protocol=CalibrationPlan(60, 100, 10),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("calibrations")


@pytest.fixture(scope="module")
def grid(folder):
    return run_grid(SMALL, folder)


def test_there_is_one_row_per_combination(grid):
    rows = grid.rows()
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


def test_all_cells_meet_the_same_arms_and_fruit(grid):
    fruit = grid.cells[0].rollout.reaches.fruit_position
    assert all(np.array_equal(cell.rollout.reaches.fruit_position, fruit) for cell in grid.cells)
    assert all(np.array_equal(cell.rollout.arm, grid.cells[0].rollout.arm) for cell in grid.cells)
    assert len(np.unique(fruit[:, 0])) == 40


def test_calibration_helps_open_loop_and_the_comparison_says_so(grid):
    found = {(row["policy"], row["from"], row["to"]): row for row in grid.comparisons()}
    assert found["scripted", "raw", "ls"]["significant"]
    assert found["scripted", "raw", "ls"]["difference_mm"] < -0.5


@pytest.mark.slow
def test_residual_models_help_beyond_least_squares_and_several_processes_find_the_same(folder):
    settings = replace(SMALL, policies=("scripted",), compensations=("raw", "ls", "ls_bpnn", "best"), arms=2)
    settings = replace(settings, protocol=CalibrationPlan(60, 100, 50))
    grid, parallel = run_grid(settings, folder), run_grid(settings, workers=2)
    means = {key: grid.cell("scripted", key, "encoders", "qiao2026").errors_mm.mean() for key in settings.compensations}
    assert means["best"] < means["ls_bpnn"] < means["ls"] < means["raw"]
    assert parallel.rows() == grid.rows()


def test_a_grid_is_reproducible_and_its_calibrations_are_kept(grid, folder):
    before = sorted(path.name for path in folder.glob("*.npz"))
    assert len(before) == 10
    again = run_grid(SMALL, folder)
    assert again.rows() == grid.rows()
    assert sorted(path.name for path in folder.glob("*.npz")) == before


def test_a_kept_calibration_is_of_its_own_arm_and_protocol(tmp_path):
    """Two arms' files swapped, or one of another protocol under this one's name, are refused by name."""
    settings = replace(SMALL, policies=("scripted",), compensations=("ls",), arms=2, episodes=2)
    run_grid(settings, tmp_path)
    first, second = sorted(tmp_path.glob("*.npz"))
    before = {path: path.read_bytes() for path in (first, second)}
    first.write_bytes(before[second])
    second.write_bytes(before[first])
    with pytest.raises(InputError, match=r"ls-\w+\.npz is the calibration of another arm or protocol") as caught:
        run_grid(settings, tmp_path)
    assert any(str(path) in str(caught.value) for path in before)
    first.write_bytes(before[first])
    second.write_bytes(before[second])
    run_grid(replace(settings, protocol=CalibrationPlan(40, 100, 10)), tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 4
    for path in before:
        path.write_bytes(next(p for p in tmp_path.glob("*.npz") if p not in before).read_bytes())
    with pytest.raises(InputError, match="of another arm or protocol than its name says; delete it"):
        run_grid(settings, tmp_path)


@pytest.mark.parametrize("changed", ["code", "plant"])
def test_a_kept_calibration_is_left_alone_when_code_or_plant_have_changed(tmp_path, monkeypatch, changed):
    plant = load_plant("qiao2026")
    protocol = CalibrationPlan(30)
    compensators(plant, "ls", protocol, tmp_path)
    if changed == "code":
        monkeypatch.setattr("pickenv.agents.evaluation.calibrated.code_fingerprint", lambda: "another")
    else:
        geometry = replace(plant.geometry, a=plant.geometry.a + 1e-12)
        plant = replace(plant, geometry=geometry)
    compensators(plant, "ls", protocol, tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_plant_of_any_name_keeps_to_the_folder(tmp_path):
    plant = replace(load_plant("qiao2026"), name="../../x/y")
    compensators(plant, "ls", CalibrationPlan(30), tmp_path / "cache")
    assert [path.parent for path in tmp_path.rglob("*.npz")] == [tmp_path / "cache"]


def test_the_steps_of_a_cycle_are_counted_to_where_the_tool_stays(grid):
    rollout = grid.cell("servo", "raw", "camera", "qiao2026").rollout
    steps = rollout.cycle_steps(5.0)
    for i in np.flatnonzero(np.isfinite(steps)):
        assert (rollout.error_mm[int(steps[i]) - 1 :, i] <= 5.0).all()


def test_rows_are_what_their_episodes_say(grid):
    """Every number of every row, from the raw arrays by other lines."""
    for row, (cell, name) in zip(grid.rows(), [(c, n) for c in grid.cells for n in grid.grippers], strict=True):
        rollout = cell.rollout
        error = 1e3 * np.sqrt((rollout.reaches.pose_error[:, :3] ** 2).sum(axis=1))
        chance = rollout.capture(grid.grippers[name])
        frame = pd.DataFrame({"arm": rollout.arm, "error": error, "chance": chance}).groupby("arm")
        arms = frame.error.mean().to_numpy()
        assert len(arms) == row["arms"] == 10 and row["interval_over"] == "arms" and row["trainings"] is None
        assert row["mean_mm"] == pytest.approx(error.mean())
        assert row["ci95"] == pytest.approx(mean_interval(arms))
        assert row["median_arm_mm"] == pytest.approx(np.median(arms))
        assert row["median_arm_ci95"] == pytest.approx(quantile_interval(arms, 0.5))
        assert row["p95_arm_mm"] == pytest.approx(max(arms))  # of ten, Hazen's 95th percentile is the largest
        assert row["p95_arm_ci95"][1] is None  # ten arms bound it from below alone
        assert row["success_rate"] == pytest.approx(chance.mean())
        assert row["success_ci95"] == pytest.approx(clustered_share_interval(frame.chance.sum(), 4))
        steps = [1 + np.flatnonzero(way > 2.0).max(initial=-1) + 1 for way in rollout.error_mm.T]
        stayed = [step for step in steps if step <= len(rollout.error_mm)]
        assert row["cycle_s"] == pytest.approx(np.median(stayed) * CONTROL_PERIOD if stayed else None)
        assert row["within_tolerance"] == len(stayed) / 40


def test_the_printed_95_percent_are_95_percent(grid):
    """Hall's skewed t: both ends solve its equation at Student's 2.5 and 97.5 %."""
    row = grid.rows()[0]
    arms = 1e3 * np.linalg.norm(grid.cells[0].rollout.reaches.pose_error[:, :3], axis=1).reshape(4, 10).mean(axis=0)
    spread = arms.std(ddof=1)
    skewness = np.mean((arms - arms.mean()) ** 3) / spread**3
    for end, level in zip(row["ci95"], (0.975, 0.025), strict=True):
        z = (arms.mean() - end) / spread
        left = z + skewness * z**2 / 3 + skewness**2 * z**3 / 27 + skewness / 60
        assert left == pytest.approx(t.ppf(level, 9) / np.sqrt(10))


def test_a_difference_is_of_arms_in_pairs(grid):
    for line in grid.comparisons():
        one, other = (grid.cell(line["policy"], line[key], line["feedback"], line["plant"]) for key in ("from", "to"))
        change = [
            1e3 * np.linalg.norm(cell.rollout.reaches.pose_error[:, :3], axis=1).reshape(4, 10).mean(axis=0)
            for cell in (one, other)
        ]
        arms = change[1] - change[0]
        assert line["difference_mm"] == pytest.approx(arms.mean())
        assert line["ci95"] == pytest.approx(mean_interval(arms))
        assert line["significant"] == (not line["ci95"][0] <= 0.0 <= line["ci95"][1])


def test_few_arms_and_few_trainings_have_numbers_but_no_interval():
    rng = np.random.default_rng(0)
    nine, four = rng.gamma(2.0, size=(9, 1, 8)), rng.gamma(2.0, size=(64, 4, 8))
    for errors, reason in ((nine, "needs 10 arms"), (four, "needs 5 trainings"), (np.ones((64, 1, 8)), "all arms are")):
        found = grid_of(errors, errors, learned=errors is four)
        row, line = found.rows()[0], found.comparisons()[0]
        assert row["mean_mm"] == pytest.approx(errors.mean()) and row["ci95"] is None
        assert row["no_interval"].startswith(reason)
        assert line["ci95"] is None and line["significant"] is None
        assert f"none: {row['no_interval']}" in cells_of(row)
        flat = flat_rows([row])[0]
        assert flat["ci95_low"] is None and flat["ci95_high"] is None
        assert json.loads(json.dumps(row))["ci95"] is None


def test_a_row_says_of_how_many_trainings_it_is():
    errors = np.random.default_rng(0).gamma(2.0, size=(64, 5, 8))
    one, five = (grid_of(errors[:, :n], learned=True).rows()[0] for n in (1, 5))
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


def test_the_command_says_every_setting():
    """What a run folder says makes the same comparison again."""
    settings = GridSettings(
        policies=("scripted", "servo"), compensations=("raw", "ls"), feedback=("camera",), plants=("field",),
        grippers=("li_cup",), arms=3, episodes=5, tolerances="fine", camera_noise_mm=1.5, fruit_noise_mm=2.0, seed=7,
        protocol=CalibrationPlan(epochs=9),
    )  # fmt: skip
    assert command_of(settings) == (
        "pickenv evaluate --policy scripted --policy servo --compensation raw --compensation ls --feedback camera "
        "--plant field --gripper li_cup --arms 3 --episodes 5 --tolerances fine --camera-noise 1.5 --fruit-noise 2 "
        "--epochs 9 --seed 7"
    )


def test_rows_are_written_and_read(grid, tmp_path):
    rows = grid.rows()
    with write_rows(tmp_path / "rows.csv", rows).open(encoding="utf-8") as file:
        read = list(csv.DictReader(file))
    assert [float(row["mean_mm"]) for row in read] == [row["mean_mm"] for row in rows]
    assert [float(row["ci95_high"]) for row in read] == [row["ci95"][1] for row in rows]
    assert {row["p95_arm_ci95_high"] for row in read} == {""}  # an open end
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(write_rows(tmp_path / "rows.parquet", rows))
    assert table.column("mean_mm").to_pylist() == [row["mean_mm"] for row in rows]
    with pytest.raises(InputError, match=r"ends in \.csv or \.parquet"):
        write_rows(tmp_path / "rows.xls", rows)


def test_figures_are_drawn_from_the_run_folder_to_the_bit(grid, tmp_path):
    assert {path.name for path in write_grid(grid, tmp_path)} == {"grid.npz", "rows.json"}
    run = read_run(tmp_path)
    assert run.kind == "evaluation"
    again = read_grid(run)
    assert again.rows() == grid.rows() == json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert command_of(again.settings) == run.command
    drawings = grid_drawings(again)
    written = write_drawings(drawings[:3], tmp_path / "figures", ["svg"])
    assert [path.stat().st_size > 10_000 for path in written] == [True] * 3
    (tmp_path / "grid.npz").write_bytes(b"of another run")
    with pytest.raises(InputError, match=r"grid\.npz is not what the run wrote"):
        read_grid(run)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"policies": ("nobody",)}, "unknown policy 'nobody'; give random, scripted"),
        ({"policies": ("missing.npz",)}, "unknown policy 'missing.npz'"),
        ({"compensations": ("magic",)}, "unknown compensation 'magic'; give one of raw, ls, ls_bpnn, best"),
        ({"feedback": ("sonar",)}, "feedback is 'sonar'"),
        ({"grippers": ("tongs",)}, "unknown gripper 'tongs'"),
        ({"plants": ("nowhere",)}, "nowhere"),
        ({"arms": 0}, "arms is 0; give 1 to 10 000"),
    ],
)
def test_bad_settings_end_with_one_sentence(changes, message):
    with pytest.raises(InputError, match=message):
        run_grid(GridSettings(**({"arms": 1, "episodes": 1, "policies": ("scripted",)} | changes)))


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
    assert "none: needs" in result.output


def test_trainings_of_several_seeds_are_one_policy(trained, tmp_path):
    """The mean over arms and trainings; a folder of anything else is refused."""
    with pytest.raises(InputError, match="holds no trainings"):
        kind_of(str(tmp_path))
    policy = load_policy(trained / "policy.npz")
    training = policy.record["training"]
    for seed in range(2):
        record = {**policy.record, "training": training | {"seed": seed}}
        weights = tuple((1.0 + 0.2 * seed) * weight for weight in policy.weights)
        replace(policy, record=record, weights=weights).save(tmp_path / "several" / str(seed) / "policy.npz")
    files = tuple(str(tmp_path / "several" / str(seed) / "policy.npz") for seed in range(2))
    settings = replace(SMALL, compensations=("raw",), feedback=("encoders",), arms=3)
    apart = run_grid(replace(settings, policies=files))
    together = run_grid(replace(settings, policies=(str(tmp_path / "several"),)))
    (cell,) = together.cells
    assert cell.policy == "several" and cell.errors_mm.shape == (3, 2, 4)
    np.testing.assert_array_equal(cell.errors_mm, np.concatenate([c.errors_mm for c in apart.cells], axis=1))
    assert not np.array_equal(cell.errors_mm[:, 0], cell.errors_mm[:, 1])
    other = {**policy.record, "training": training | {"seed": 2, "steps": 7}}
    replace(policy, record=other).save(tmp_path / "several" / "2" / "policy.npz")
    with pytest.raises(InputError, match="differ in more than their seeds"):
        kind_of(str(tmp_path / "several"))
