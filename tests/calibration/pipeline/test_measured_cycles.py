"""ISO 9283 on measured rows: the standard's own formulas, the simulated test's numbers, drift, and a tracker's file."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.arm import (
    Iso9283Settings,
    Pace,
    Pose,
    forward,
    inverse,
    iso9283,
    largest_cube,
    load_arm,
    load_plant,
    pose_drift,
    pose_performance,
    rotation_matrix,
    rotation_vector,
)
from pickenv.base import InputError
from pickenv.calibration import (
    Measurements,
    measured_iso9283,
    random_joints,
    read_measurements,
    read_observations,
    same_poses,
)
from pickenv.cli import app

ARM = load_arm("ur5e")
NOMINAL = ARM.nominal
FIVE = random_joints(NOMINAL, 5, np.random.default_rng(3))
MILLIMETRE = 1e-3


def visits(joints, cycles, rng, *, offset=0.5, scatter=0.05, drift=0.0, turn=1e-4, frames="known"):
    """Rows of a registered tracker: each pose in turn, cycle by cycle; lengths in mm, drift along x from end to end."""
    pose = forward(NOMINAL, np.tile(joints, (cycles, 1)))
    rows = len(pose.position)
    away = np.tile(rng.normal(size=(len(joints), 3)), (cycles, 1)) * offset
    noise = rng.normal(size=(rows, 3)) * scatter * [1.0, 0.5, 0.3]
    along = np.linspace(0.0, drift, rows)[:, None] * [1.0, 0.0, 0.0]
    position = pose.position + MILLIMETRE * (away + noise + along)
    rotation = rotation_matrix(rng.normal(size=(rows, 3)) * turn) @ pose.rotation
    return Measurements(np.tile(joints, (cycles, 1)), position, rotation, NOMINAL.prismatic, frames=frames)


def by_the_standard(commanded, attained):
    """AP and RP of positions ``(3,)`` and ``(n, 3)``, from the text of ISO 9283:1998, 7.2 and 7.3, axis by axis."""
    n = len(attained)
    barycentre = [sum(row[axis] for row in attained) / n for axis in range(3)]
    accuracy = sum((barycentre[axis] - commanded[axis]) ** 2 for axis in range(3)) ** 0.5
    distances = [sum((row[axis] - barycentre[axis]) ** 2 for axis in range(3)) ** 0.5 for row in attained]
    mean = sum(distances) / n
    deviation = (sum((distance - mean) ** 2 for distance in distances) / (n - 1)) ** 0.5
    return accuracy, mean + 3 * deviation


@pytest.mark.parametrize("seed", range(3))
def test_figures_are_those_of_the_standards_text(seed):
    rows = visits(FIVE, 12, np.random.default_rng(seed))
    poses = measured_iso9283(ARM, rows)["poses"]
    for i, pose in enumerate(poses):
        goal, cycles = forward(NOMINAL, FIVE[i]), np.arange(i, 60, 5)
        accuracy, repeatability = by_the_standard(goal.position, rows.position[cycles])
        assert (pose["name"], pose["cycles"]) == (f"P{i + 1}", 12)
        assert pose["accuracy_mm"] == pytest.approx(1e3 * accuracy, abs=1e-9)
        assert pose["repeatability_mm"] == pytest.approx(1e3 * repeatability, abs=1e-9)
        turns = np.degrees([rotation_vector(rotation @ goal.rotation.T) for rotation in rows.rotation[cycles]])
        assert pose["mean_error_deg"] == pytest.approx(turns.sum(axis=0) / 12, abs=1e-9)
        spread = 3 * np.sqrt(((turns - turns.mean(axis=0)) ** 2).sum(axis=0) / 11)
        assert pose["repeatability_deg"] == pytest.approx(spread, abs=1e-9)
        assert list(pose["joints"].values()) == pytest.approx(np.degrees(FIVE[i]))
        assert pose["accuracy_ci95_mm"][0] < pose["accuracy_mm"] < pose["accuracy_ci95_mm"][1]
        assert pose["repeatability_ci95_mm"] is None  # of twelve cycles


def test_rows_of_the_simulated_arm_give_the_figures_of_the_simulated_test(tmp_path, monkeypatch):
    plant, errors = load_plant("qiao2026"), {}
    cube = largest_cube(plant.arm.nominal, steps=12)

    def noting(name, values):
        errors[name] = values
        return pose_performance(name, values)

    monkeypatch.setattr("pickenv.arm.plant.iso9283.pose_performance", noting)
    settings = Iso9283Settings(cycles=30, pace=Pace(period=0.1, dwell=2.0), drift_cycles=2, drift_interval=1e5)
    expected = iso9283(plant, rng=np.random.default_rng(0), settings=settings, cube=cube).raw["poses"]
    joints = np.tile(inverse(plant.arm.nominal, cube.inclined_plane()).joints, (30, 1))
    goals = forward(plant.arm.nominal, joints)
    missed = np.stack([errors[f"P{i + 1}"] for i in range(5)], axis=1).reshape(-1, 6)
    seen = Pose(goals.position + missed[:, :3], rotation_matrix(missed[:, 3:]) @ goals.rotation)
    rows = Measurements(joints, seen.position, seen.rotation, plant.arm.nominal.prismatic, frames="known")
    file = rows.write_csv(tmp_path / "cycles.csv")
    poses = measured_iso9283(plant.arm, read_measurements(file, plant.arm.nominal))["poses"]
    for pose, other in zip(poses, expected, strict=True):
        for key, value in other.items():
            if key != "name":
                np.testing.assert_allclose(np.array(pose[key]), np.array(value), rtol=0, atol=1e-9)


def test_a_planted_drift_is_told_and_its_size_is_right():
    rows = visits(FIVE, 30, np.random.default_rng(0), offset=0.0, drift=0.3)
    for pose in measured_iso9283(ARM, rows)["poses"]:
        low, high = pose["drift"]["wander_ci95_mm"]
        assert 0 < low < 0.2 < high  # two thirds of the way lie between the middles of the first and the last third
        low, high = pose["drift"]["accuracy_change_ci95_mm"]
        assert 0 < low < 0.2 < high + 0.06  # near the command AP is larger than the drift so far, by its scatter
    rows = visits(FIVE, 30, np.random.default_rng(0), scatter=0.0)
    cycle = np.repeat(np.arange(30), 5)[:, None]
    noise = np.random.default_rng(1).normal(size=(150, 3)) * (0.02 + 0.01 * cycle)
    wider = replace(rows, position=rows.position + MILLIMETRE * noise)
    for number, pose in enumerate(measured_iso9283(ARM, wider)["poses"]):
        thirds = [wider.position[number::5][part] / MILLIMETRE for part in (slice(10), slice(-10, None))]
        away = [np.linalg.norm(third - third.mean(axis=0), axis=1) for third in thirds]
        first, last = (part.mean() + 3.0 * part.std(ddof=1) for part in away)
        assert pose["drift"]["repeatability_change_mm"] == pytest.approx(last - first, rel=1e-6) and last > first


def test_without_drift_its_intervals_hold_zero():
    """Nineteen in twenty of them, within what chance allows of 300."""
    inside = {"wander": 0, "accuracy_change": 0}
    rng = np.random.default_rng(0)
    for _ in range(300):
        drift = pose_drift(MILLIMETRE * ([0.5, 0.2, 0.1] + rng.normal(size=(30, 3)) * [0.05, 0.025, 0.015]))
        for figure in inside:
            low, high = drift[f"{figure}_ci95_mm"]
            inside[figure] += low <= 0 <= high
    assert 274 <= inside["wander"] <= 296 and 274 <= inside["accuracy_change"] <= 296


def test_five_poses_of_one_attitude_from_anywhere_have_their_base_fitted():
    cube = largest_cube(NOMINAL, steps=12)
    joints = inverse(NOMINAL, cube.inclined_plane()).joints
    rows = visits(joints, 10, np.random.default_rng(0), frames="known").positions_only()
    moved = rotation_matrix(np.array([0.3, -0.2, 2.0]))
    foreign = replace(rows, position=rows.position @ moved.T + [3.0, -1.0, 0.5], frames="fitted")
    known, fitted = measured_iso9283(ARM, rows), measured_iso9283(ARM, foreign)
    assert (known["fitted"], fitted["fitted"]) == ([], ["base"])
    assert (fitted["fitted_numbers"], fitted["of_numbers"]) == (6, 15)
    accuracy, repeatability = (
        np.array([[pose[figure] for pose in result["poses"]] for result in (known, fitted)])
        for figure in ("accuracy_mm", "repeatability_mm")
    )
    np.testing.assert_allclose(repeatability[1], repeatability[0], atol=1e-9)
    assert np.sum(accuracy[1] ** 2) < 0.8 * np.sum(accuracy[0] ** 2)  # AP is what no base takes away


def test_with_enough_poses_the_tool_is_fitted_too():
    joints = random_joints(NOMINAL, 12, np.random.default_rng(1))
    rows = visits(joints, 5, np.random.default_rng(0), offset=0.2)
    lever = rows.rotation @ [0.05, -0.02, 0.1]
    result = measured_iso9283(ARM, replace(rows, position=rows.position + lever, frames="fitted"))
    assert (result["fitted"], result["fitted_numbers"], result["of_numbers"]) == (["base", "tool"], 12, 72)
    assert max(pose["accuracy_mm"] for pose in result["poses"]) < 1.0


def test_too_few_poses_for_a_base_tell_repeatability_alone():
    rows = visits(FIVE[:1], 30, np.random.default_rng(0), drift=0.3)
    (known,) = measured_iso9283(ARM, rows)["poses"]
    (pose,) = measured_iso9283(ARM, replace(rows, frames="fitted"))["poses"]
    assert pose["repeatability_mm"] == pytest.approx(known["repeatability_mm"], abs=1e-9)
    assert pose["drift"]["wander_mm"] == pytest.approx(known["drift"]["wander_mm"], abs=1e-9)
    unknown = {key for key, value in pose.items() if value is None}
    assert unknown == {f"{figure}{part}" for figure in ("accuracy", "mean_error") for part in PARTS}
    assert pose["drift"]["accuracy_change_mm"] is None


PARTS = ("_mm", "_ci95_mm", "_deg", "_ci95_deg")


def test_rows_that_are_alike_to_the_last_digit_are_cycles(tmp_path):
    """A tracker that prints tenths of a millimetre, and an arm that repeats better than that."""
    rows = visits(FIVE, 30, np.random.default_rng(0), scatter=0.02).positions_only()
    file = replace(rows, position=np.round(rows.position, 4)).write_csv(tmp_path / "rows.csv")
    with pytest.raises(InputError, match="repeats row"):
        read_measurements(file, NOMINAL)
    again = read_observations([file], NOMINAL, repeats=True)
    assert len(again.joints) == 150
    for pose in measured_iso9283(ARM, again)["poses"]:
        assert pose["repeatability_mm"] < 0.3
    flat = replace(rows, position=np.tile(rows.position[:5], (30, 1)))
    for pose in measured_iso9283(ARM, flat)["poses"]:
        assert pose["repeatability_mm"] < 1e-9
        assert pose["repeatability_ci95_mm"] is None and pose["accuracy_ci95_mm"] is None


def test_a_pose_with_too_few_cycles_is_named():
    rows = visits(FIVE, 4, np.random.default_rng(0))
    with pytest.raises(InputError, match=r"P2, the pose of row 2, has 2 cycles, and .* needs 3 .* \(1 of 5\)$"):
        measured_iso9283(ARM, rows.select(np.delete(np.arange(20), [6, 11])))


def test_a_measured_arm_that_came_back_repeats_as_its_maker_says(data_folder):
    """A UR10 on cubes of ISO 9283 (Landgraf et al. 2021, series D): 19 poses three to five times; maker: 0.1 mm."""
    path = data_folder / "ur10_ipa_landgraf2021" / "Series_D" / "measurements_iso_cubes.csv"
    arm = load_arm("ur10")
    rows = read_measurements(path, arm.nominal, "ur10_landgraf2021_repeats")
    with pytest.raises(InputError, match=r"P5, the pose of row 6, has 2 cycles, .* \(562 of 581\)$"):
        measured_iso9283(arm, rows)
    number = same_poses(rows.joints)
    often = rows.select(np.flatnonzero(np.bincount(number)[number] >= 3))
    result = measured_iso9283(arm, often)
    assert [pose["cycles"] for pose in result["poses"]] == [5] + [3] * 18
    assert 0.05 < np.median([pose["repeatability_mm"] for pose in result["poses"]]) < 0.15
    assert 0.3 < np.median([pose["accuracy_mm"] for pose in result["poses"]]) < 1.0
    for i, pose in enumerate(result["poses"]):
        cycles = often.position[same_poses(often.joints) == i]
        assert pose["repeatability_mm"] == pytest.approx(1e3 * by_the_standard(cycles[0], cycles)[1], abs=1e-6)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(*words, code=0):
    done = CliRunner().invoke(app, [str(word) for word in ("iso9283", *words)], env={"COLUMNS": "100"})
    if code:
        assert isinstance(done.exception, InputError), done.output
        return str(done.exception)
    assert done.exit_code == 0, done.output
    return done.output


FOREIGN = """
separator = ";"
decimal = ","

[joints]
columns = ["A1", "A2", "A3", "A4", "A5", "A6"]
unit = "rad"

[position]
columns = ["X", "Y", "Z"]
unit = "mm"
"""


def foreign(rows):
    """A tracker's own file with a decimal comma."""
    table = np.concatenate([rows.joints, 1e3 * rows.position], axis=1)
    lines = [";".join(f"{value:.6f}".replace(".", ",") for value in row) for row in table]
    return "\n".join(["A1;A2;A3;A4;A5;A6;X;Y;Z", *lines]) + "\n"


def test_an_owner_of_a_trackers_file_reads_ap_and_rp(folder):
    rows = visits(FIVE, 30, np.random.default_rng(0), drift=0.2)
    (folder / "tracker.csv").write_text(foreign(rows), encoding="utf-8")
    (folder / "tracker.toml").write_text(FOREIGN, encoding="utf-8")
    words = ("--rows", "tracker.csv", "--columns", "tracker.toml", "--arm", "ur5e", "--json", "iso.json")
    said = call(*words, "--frames", "known")
    result = json.loads((folder / "iso.json").read_text())
    lines = said.splitlines()
    assert len(lines) <= 25 and max(len(line) for line in lines if not line.startswith("next: ")) <= 100
    worst = max(result["poses"], key=lambda pose: pose["accuracy_mm"])
    assert re.match(rf"Measured AP up to {worst['accuracy_mm']:.3f} \(.*\) mm at {worst['name']}; RP up to ", lines[0])
    for pose in result["poses"]:
        for figure in ("accuracy", "repeatability"):
            low, high = pose[f"{figure}_ci95_mm"]
            assert f"{pose[f'{figure}_mm']:.3f} ({low:.3f} to {high:.3f})" in said
    assert "beyond chance at 5 of 5 poses" in said and "--details" in said and "dRP" not in said
    assert "fitted" not in said and "the standard has" not in said and "AP (deg)" not in said
    assert "dRP (mm)" in call(*words, "--frames", "known", "--details")
    assert "base fitted to these poses, 6 of their 15 numbers" in call(*words)


def test_the_screen_says_what_the_rows_cannot_tell(folder):
    visits(FIVE, 9, np.random.default_rng(0)).write_csv("few.csv")
    said = call("--rows", "few.csv", "--arm", "ur5e")
    assert "the standard has 30 cycles; with fewer RP has no interval" in said and "AP (deg)" in said
    assert "which needs 30 cycles to tell" in said
    rows = visits(FIVE[:2], 9, np.random.default_rng(0), frames="fitted").positions_only()
    rows.select(np.argsort(np.tile([0, 1], 9), kind="stable")).write_csv("standing.csv")
    said = call("--rows", "standing.csv", "--arm", "ur5e")
    assert "AP unknown" in said and "too few poses to fit the base" in said
    assert "16 rows follow one of the same pose" in said
    visits(random_joints(NOMINAL, 40, np.random.default_rng(1)), 4, np.random.default_rng(0)).write_csv("many.csv")
    lines = call("--rows", "many.csv", "--arm", "ur5e").splitlines()
    assert len(lines) <= 25 and any("and 32 rows more" in line for line in lines)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--rows", "rows.csv"), "no arm is named for these --rows; give its name, or its file, as --arm"),
        (("--arm", "ur5e"), "--arm goes with --rows only; leave it out"),
        (("--details",), "--details goes with --rows only; leave it out"),
        (("--rows", "rows.csv", "--arm", "ur5e", "--seed", 1), "--seed goes with a simulated arm only; .* or --rows"),
        (("--rows", "rows.csv", "--arm", "ur5e", "--out", "run"), "--out goes with a simulated arm only"),
        (("--rows", "none.csv", "--arm", "ur5e"), "none.csv"),
        (("--rows", "rows.csv", "--arm", "ur5e", "--json", "rows.csv"), "--json"),
        (("--rows", "bad.csv", "--arm", "ur5e"), r"bad.csv: row 3, column 'x_mm'"),
        (("--rows", "rows.csv", "--arm", "ur10"), "misses by"),
        (
            ("--rows", "touches.csv", "--arm", "ur5e", "--columns", "touches.toml"),
            "holds touches, not poses or positions",
        ),
    ],
)
def test_wrong_input_is_one_sentence(folder, words, sentence):
    rows = visits(FIVE, 4, np.random.default_rng(0))
    lines = rows.write_csv("rows.csv").read_text().splitlines()
    cells = lines[2].split(",")
    (folder / "bad.csv").write_text("\n".join([*lines[:2], ",".join([*cells[:6], "none", *cells[7:]]), *lines[3:]]))
    columns = ", ".join(f'"q{i}_deg"' for i in range(1, 7))
    (folder / "touches.toml").write_text(f'[joints]\ncolumns = [{columns}]\nunit = "deg"\n[touches]\nstd_mm = 0.2\n')
    (folder / "touches.csv").write_text("\n".join(lines))
    assert re.search(sentence, call(*words, code=2))
