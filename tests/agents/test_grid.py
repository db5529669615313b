"""The comparison: rows with the keys that are promised, pairs on the same fruit, honest intervals, files."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from pickenv.agents.evaluation.calibrated import CalibrationPlan, compensators
from pickenv.agents.evaluation.grid import GridSettings, run_grid
from pickenv.agents.evaluation.grid_figures import grid_drawings
from pickenv.agents.evaluation.grid_tables import command_of, read_grid, write_grid, write_rows
from pickenv.agents.evaluation.statistics import interquartile_mean, interval, paired
from pickenv.arm import load_plant
from pickenv.commands import learning as commands
from pickenv.errors import InputError
from pickenv.inspect.figures.run_drawings import write_drawings
from pickenv.inspect.runs.run_folder import read_run

KEYS = {"policy", "compensation", "feedback", "plant", "gripper", "mean_mm", "p95_mm", "success_rate", "ci95"}
SMALL = GridSettings(
    policies=("scripted", "oracle", "servo"),
    compensations=("raw", "ls", "best"),
    plants=("qiao2026",),
    arms=3,
    episodes=8,
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
    # scripted and servo with three compensations, the oracle raw alone; two grippers
    assert len(rows) == len(combinations) == (3 + 3 + 1) * 2
    for row in rows:
        assert set(row) >= KEYS | {"episodes", "seeds"}
        assert row["episodes"] == 24 and row["seeds"] == [0]
        assert row["ci95"][0] <= row["mean_mm"] <= row["ci95"][1]
        assert 0 <= row["success_rate"] <= 1
    json.dumps(rows)


def test_all_cells_meet_the_same_arms_and_fruit(grid):
    fruit = grid.cells[0].rollout.reaches.fruit_position
    assert all(np.array_equal(cell.rollout.reaches.fruit_position, fruit) for cell in grid.cells)
    assert all(np.array_equal(cell.rollout.arm, grid.cells[0].rollout.arm) for cell in grid.cells)
    assert len(np.unique(fruit[:, 0])) == 24


def test_calibration_helps_open_loop_and_the_comparison_says_so(grid):
    found = {(row["policy"], row["from"], row["to"]): row for row in grid.comparisons()}
    assert found["scripted", "raw", "best"]["significant"]
    assert found["scripted", "raw", "best"]["difference_mm"] < -0.5
    means = {key: grid.cell("scripted", key, "encoders", "qiao2026").errors_mm.mean() for key in SMALL.compensations}
    assert means["best"] < means["ls"] < means["raw"]


def test_a_grid_is_reproducible_and_its_calibrations_are_kept(grid, folder):
    before = sorted(path.name for path in folder.glob("*.npz"))
    assert len(before) == 6
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


def test_intervals_count_arms_not_only_episodes():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(6, 1)) + 0.01 * rng.normal(size=(6, 100))
    wide = np.ptp(interval(values, np.random.default_rng(1)))
    narrow = np.ptp(interval(values, np.random.default_rng(1), arms_too=False))
    assert wide > 10 * narrow


def test_no_difference_is_not_significant():
    rng = np.random.default_rng(0)
    first = rng.normal(size=(8, 32))
    assert not paired(first, first + 0.0 * first, rng).significant
    assert paired(first, first - 0.5, rng).significant


def test_the_interquartile_mean_forgets_outliers():
    assert interquartile_mean(np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1e9])) == 1.0


def test_rows_are_written_and_read(grid, tmp_path):
    rows = grid.rows()
    with write_rows(tmp_path / "rows.csv", rows).open(encoding="utf-8") as file:
        read = list(csv.DictReader(file))
    assert [float(row["mean_mm"]) for row in read] == [row["mean_mm"] for row in rows]
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
