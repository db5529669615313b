"""ISO 9283 of measured rows: figures of every pose that was visited again and again, and whether it drifts."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.arm import forward, load_arm, load_plant
from pickenv.base import InputError
from pickenv.calibration import Measurements, fit, measured_performance, random_joints, simulated_tracker
from pickenv.cli import app

UR5 = load_arm("ur5")
POSES, VISITS = 8, 30


def visits(rng, scatter, change=(0.0, 0.0, 0.0), offset=0.0, count=VISITS, full=True, jitter=0.0):
    """Rows of cycles over eight poses: normal scatter, a fixed error of each pose, a change from first to last, m."""
    joints = random_joints(UR5.nominal, POSES, rng)
    true = forward(UR5.nominal, joints)
    fixed = offset * rng.normal(size=(POSES, 3))
    time = np.linspace(0.0, 1.0, count)[:, None, None]
    position = true.position + fixed + scatter * rng.normal(size=(count, POSES, 3)) + time * np.array(change)
    rotation = np.broadcast_to(true.rotation, (count, POSES, 3, 3)).reshape(-1, 3, 3)
    rows = np.tile(joints, (count, 1)) + jitter * rng.uniform(-1.0, 1.0, (count * POSES, 6))
    return Measurements(rows, position.reshape(-1, 3), rotation if full else None, UR5.nominal.prismatic, source="rows")


def test_figures_are_those_of_the_standard():
    """AP and RP by the text of ISO 9283:1998, 7.2 and 7.3; joints may scatter as encoders do."""
    rng = np.random.default_rng(0)
    data = visits(rng, 5e-5, offset=3e-4, jitter=2e-4)
    figures = measured_performance(data, UR5.nominal)["raw"]
    assert [pose["visits"] for pose in figures["poses"]] == [VISITS] * POSES and figures["passed_over"] == 0
    for number, pose in enumerate(figures["poses"]):
        where = 1e3 * data.position[number::POSES]
        away = np.linalg.norm(where - where.mean(axis=0), axis=1)
        spread = np.sqrt(((away - away.mean()) ** 2).sum() / (VISITS - 1))
        # The arm's own model moves with the joints' scatter, by less than a tenth of a millimetre.
        assert pose["repeatability_mm"] == pytest.approx(away.mean() + 3.0 * spread, abs=0.35)
    still = measured_performance(visits(np.random.default_rng(0), 5e-5, offset=3e-4), UR5.nominal)["raw"]
    exact = visits(np.random.default_rng(0), 5e-5, offset=3e-4)
    for number, pose in enumerate(still["poses"]):
        where = 1e3 * exact.position[number::POSES]
        away = np.linalg.norm(where - where.mean(axis=0), axis=1)
        assert pose["repeatability_mm"] == pytest.approx(away.mean() + 3.0 * away.std(ddof=1), rel=1e-9)
        low, high = pose["repeatability_ci95_mm"]
        assert low < pose["repeatability_mm"] < high


def test_accuracy_is_what_base_and_tool_do_not_explain():
    """A moved base is no error of the arm; fixed errors of the poses are, all but what nine to twelve numbers take."""
    rng = np.random.default_rng(1)
    data = visits(rng, 0.0, offset=1e-3)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = Measurements(
        data.joints, data.position @ turn.T + 2.0, turn @ data.rotation, UR5.nominal.prismatic, source="rows"
    )
    here, there = (measured_performance(rows, UR5.nominal)["raw"] for rows in (data, moved))
    assert 0.3 < here["worst_accuracy_mm"] < 4.0
    assert there["worst_accuracy_mm"] == pytest.approx(here["worst_accuracy_mm"], rel=1e-6)
    perfect = measured_performance(visits(np.random.default_rng(1), 0.0), UR5.nominal)["raw"]
    assert perfect["worst_accuracy_mm"] < 1e-6 and perfect["worst_repeatability_mm"] < 1e-6


def test_a_drift_is_told_and_none_is_not():
    """Of 40 arms without drift, about one pose in twenty shows one; a drift of ten scatters is always told."""
    told = []
    for seed in range(40):
        poses = measured_performance(visits(np.random.default_rng(seed), 1e-4), UR5.nominal)["raw"]["poses"]
        told += [any(low > 0.0 or high < 0.0 for low, high in pose["drift_ci95_mm"]) for pose in poses]
    assert 0.02 < np.mean(told) < 0.09
    change = np.array([0.0, 0.6, -0.8])
    poses = measured_performance(visits(np.random.default_rng(9), 1e-4, 1e-3 * change), UR5.nominal)["raw"]["poses"]
    for pose in poses:
        np.testing.assert_allclose(pose["drift_mm"], change, atol=0.25)
        assert all(low < value < high for value, (low, high) in zip(change[:1], pose["drift_ci95_mm"][:1], strict=True))
        assert pose["drift_ci95_mm"][1][0] > 0.0 and pose["drift_ci95_mm"][2][1] < 0.0


def test_a_file_of_visits_is_judged_from_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    data = visits(rng, 3e-5, offset=2e-4, full=False)
    seldom = random_joints(UR5.nominal, 3, rng)
    with open("visits.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["a", "b", "c", "d", "e", "f", "x", "y", "z"])
        positions = np.vstack([data.position, forward(UR5.nominal, seldom).position])
        writer.writerows(np.hstack([np.vstack([data.joints, seldom]), 1e3 * positions]).tolist())
    (tmp_path / "visits.toml").write_text(
        'description = "visits"\n[joints]\ncolumns = ["a", "b", "c", "d", "e", "f"]\nunit = "rad"\n'
        '[position]\ncolumns = ["x", "y", "z"]\nunit = "mm"\n'
    )
    words = ["iso9283", "--rows", "visits.csv", "--columns", "visits.toml", "--arm", "ur5", "--json", "out.json"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert len(done.output.splitlines()) <= 25
    figures = json.loads((tmp_path / "out.json").read_text())
    assert figures["rows"] == len(positions) and figures["raw"]["passed_over"] == 3
    alone = measured_performance(data, UR5.nominal)["raw"]["poses"]
    for pose, same in zip(figures["raw"]["poses"], alone, strict=True):
        assert pose["repeatability_mm"] == pytest.approx(same["repeatability_mm"], rel=1e-9)
        assert pose["accuracy_deg"] is None and pose["name"] in done.output
    (tmp_path / "wire.toml").write_text(
        'description = "a wire"\n[joints]\ncolumns = ["a", "b", "c", "d", "e", "f"]\nunit = "rad"\n'
        '[wire]\ncolumns = ["x * x / 1000 + 500"]\nunit = "mm"\n'
    )
    for faulty, message in {
        (
            "iso9283",
            "--rows",
            "visits.csv",
            "--columns",
            "wire.toml",
            "--arm",
            "ur5",
        ): "ISO 9283 is of poses or positions",
        (*words[:5], "--json", "out.json"): "name that of the rows, or its file, as --arm",
        (*words, "--out", "run"): "--out is for the simulated arm",
    }.items():
        done = CliRunner().invoke(app, list(faulty))
        assert done.exit_code != 0 and message in " ".join(str(done.exception or done.output).split()), faulty


def test_a_calibration_that_knows_the_arm_leaves_its_scatter_alone():
    """Poses err by the arm's true geometry; behind it AP falls to what scatter leaves, and RP stays what it is."""
    rng = np.random.default_rng(5)
    plant = load_plant("geometry_only")
    arm = plant.arm.nominal
    learnt = random_joints(arm, 60, rng)
    calibration = fit(plant.arm, simulated_tracker(plant, learnt, rng), known_frames=True).calibration
    joints = np.tile(random_joints(arm, 5, rng), (VISITS, 1))
    data = simulated_tracker(plant, joints, rng)
    raw, calibrated = measured_performance(data, arm, calibration).values()
    assert calibrated["worst_accuracy_mm"] < 0.3 * raw["worst_accuracy_mm"]
    assert calibrated["worst_repeatability_mm"] == pytest.approx(raw["worst_repeatability_mm"], rel=1e-2)


def test_rows_that_never_visit_a_pose_again_are_refused():
    with pytest.raises(InputError, match="rows: the pose visited most has 4 of 32 rows; ISO 9283 asks for 30 visits"):
        measured_performance(visits(np.random.default_rng(4), 1e-4, count=4), UR5.nominal)
