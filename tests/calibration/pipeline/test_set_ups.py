"""Set-ups found out: which files share base and tool is told by their rows, printed with their names, and judged."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.arm import Arm, Array, Geometry, Pose, forward, load_arm, load_plant, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Choices,
    InstrumentStation,
    Measurements,
    Result,
    Stacked,
    calibrate,
    random_joints,
    read_observations,
    simulated_tracker,
)
from pickenv.calibration.identification.robust import set_ups
from pickenv.cli import app
from pickenv.inspect import calibration_page

PLAIN = Choices(terms="none", residual="none")
NOISE = 1e-4
HERE = Pose(np.array([2.0, 0.5, -0.3]), rotation_matrix(np.array([0.1, 0.2, -0.7])))
THERE = Pose(np.array([-1.0, 2.5, 0.4]), rotation_matrix(np.array([0.3, -0.1, 2.0])))
TARGET = Pose(np.array([0.02, -0.01, 0.1]), np.eye(3))
OTHER_TARGET = Pose(np.array([-0.03, 0.05, 0.15]), rotation_matrix(np.array([0.4, -0.3, 0.2])))
SERIES = "ur10_ipa_landgraf2021/Series_"


@pytest.fixture(scope="module")
def ur5() -> Arm:
    return load_arm("ur5")


@pytest.fixture(scope="module")
def true(ur5: Arm) -> Geometry:
    rng, links = np.random.default_rng(0), ur5.nominal.links
    return ur5.nominal.displaced(np.concatenate([rng.normal(size=4 * links) * 1e-3, np.zeros(links + 12)]))


def day(
    geometry: Geometry, seed: int, base: Pose = HERE, tool: Pose = TARGET, rows: int = 60, poses: bool = True
) -> Measurements:
    rng = np.random.default_rng(seed)
    joints = random_joints(geometry, rows, rng)
    pose = forward(replace(geometry, base=base, tool=tool), joints)
    turned = rotation_matrix(2e-4 * rng.normal(size=(rows, 3))) @ pose.rotation if poses else None
    position = pose.position + NOISE * rng.normal(size=(rows, 3))
    return Measurements(joints, position, turned, geometry.prismatic, NOISE, source=f"day{seed}.csv", std_stated=True)


def said(arm: Arm, days: Sequence[Measurements]) -> list[tuple[tuple[int, ...], tuple[str, ...]]]:
    return list(set_ups(arm, days))


@pytest.mark.parametrize("poses", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["positions", "poses"])
@pytest.mark.parametrize(
    ("base", "tool", "own"),
    [
        (THERE, TARGET, ("base",)),
        (HERE, OTHER_TARGET, ("tool",)),
        (THERE, OTHER_TARGET, ("base", "tool")),
        (Pose(HERE.position + 1e-3, HERE.rotation), TARGET, ("base",)),
    ],
    ids=["base", "tool", "both", "base by a millimetre"],
)
def test_frames_that_differ_are_found_out(
    ur5: Arm, true: Geometry, base: Pose, tool: Pose, own: tuple[str, ...], poses: bool
) -> None:
    """In whatever order the days come, two of the one set-up and two of the other, 60 rows each."""
    frames = {1: (HERE, TARGET), 2: (base, tool), 3: (HERE, TARGET), 4: (base, tool)}
    days = {seed: day(true, seed, *there, poses=poses) for seed, there in frames.items()}
    assert said(ur5, [days[1], days[2]]) == [((0,), ()), ((1,), own)]
    assert said(ur5, [days[2], days[4], days[1], days[3]]) == [((0, 1), ()), ((2, 3), own)]
    assert said(ur5, [days[1], days[3]]) == [((0, 1), ())]


def halves(data: Measurements, key: Array) -> list[Measurements]:
    return [data.select(np.sort(part)) for part in np.array_split(np.argsort(key, kind="stable"), 2)]


@pytest.mark.parametrize(
    ("name", "columns", "file"),
    [
        ("ur5", "ur5_jacobi2025", "ur5_wam_jacobi2025/UR5/3D_UR5_uncalibrated_grid_cleaned.csv"),
        ("wam", "wam_jacobi2025", "ur5_wam_jacobi2025/WAM/3D_WAM_uncalibrated_grid_cleaned.csv"),
        ("ur10", "ur10_landgraf2021_repeats", SERIES + "B/measurements_joint_configurations.csv"),
        ("ur10", "ur10_landgraf2021_repeats", SERIES + "C/measurements_random_poses.csv"),
    ],
    ids=["UR5", "WAM", "UR10 B", "UR10 C"],
)
def test_rows_of_one_set_up_stay_one_however_they_are_parted(
    data_folder: Path, name: str, columns: str, file: str
) -> None:
    """Real arms, whose unmodelled errors differ from region to region: parted by time, by a joint, and by height."""
    arm = load_arm(name)
    data = read_observations([data_folder / file], arm.nominal, columns)
    assert isinstance(data, Measurements)
    for key in (np.arange(len(data)), data.joints[:, 1], data.position[:, 2]):
        assert said(arm, halves(data, key)) == [((0, 1), ())]


@pytest.mark.slow
def test_two_series_of_a_real_arm_are_two_stations_and_equal_to_the_flagged_run(data_folder: Path) -> None:
    """A UR10 before and after the tracker was moved by three metres; the target stayed."""
    arm, days = load_arm("ur10"), []
    for file, columns, step in (
        ("A/measurements_grid.csv", "ur10_landgraf2021", 80),
        ("B/measurements_joint_configurations.csv", "ur10_landgraf2021_repeats", 10),
    ):
        whole = read_observations([data_folder / (SERIES + file)], arm.nominal, columns)
        days.append(whole.select(np.arange(0, len(whole.joints), step)))
    alone, flagged = (calibrate(arm, days, stations=asked, choices=PLAIN) for asked in (None, "base"))
    assert alone.best == flagged.best and alone.best.rms < 0.6
    first, second = alone.set_ups
    assert first["own"] == {} and second["own"]["base"]["mm"] == pytest.approx(2974, abs=5)
    with pytest.raises(InputError, match="after fitting the frames the arm still misses by"):
        calibrate(arm, days, stations="none", choices=PLAIN)


@pytest.mark.parametrize("moved", [pytest.param(False, marks=pytest.mark.slow), True], ids=["one set-up", "base moved"])
def test_of_a_simulated_plant_days_are_one_set_up_or_as_many_as_there_were(moved: bool) -> None:
    """The hybrid arm with all its effects, seen by a tracker on two days; one set-up gives the numbers of one file."""
    plant, rng = load_plant("qiao2026"), np.random.default_rng(8)
    nominal = plant.arm.nominal
    days = []
    for number in range(2):
        seen = simulated_tracker(plant, random_joints(nominal, 100, rng), rng)
        if moved and number:
            there = Pose(seen.position @ THERE.rotation.T + THERE.position, THERE.rotation @ seen.rotation)
            seen = replace(seen, position=there.position, rotation=there.rotation)
        days.append(replace(seen, frames="fitted", source=f"day{number}.csv"))
    result = calibrate(plant.arm, days, choices=PLAIN)
    if moved:
        flagged = calibrate(plant.arm, days, stations="base", choices=PLAIN)
        assert list(result.set_ups[1]["own"]) == ["base"] and result.best == flagged.best
    else:
        arrays = {
            name: np.concatenate([getattr(each, name) for each in days]) for name in ("joints", "position", "rotation")
        }
        whole = calibrate(plant.arm, replace(days[0], **arrays), choices=PLAIN)
        assert isinstance(result.train, Measurements) and result.best == whole.best
        assert [each["files"] for each in result.set_ups] == [["day0.csv", "day1.csv"]]


@pytest.mark.slow
def test_the_command_prints_set_ups_with_their_files_and_keeps_them(ur5: Arm, true: Geometry, tmp_path: Path) -> None:
    """Without a word of it, and equal to the run that says so; a file to judge by finds its set-up by itself."""
    days = [day(true, 1), day(true, 2, THERE), day(true, 3)]
    files = [str(each.write_csv(tmp_path / each.source)) for each in days]
    runs = {}
    for name, more in (("alone", files), ("flagged", [*files[:2], "--stations", "base"])):
        saved, figures = tmp_path / f"{name}.npz", tmp_path / f"{name}.json"
        command = ["calibrate", *more, "--arm", "ur5", "--terms", "none", "--residual", "none", "--out", str(saved)]
        output = CliRunner().invoke(app, [*command, "--details", "--json", str(figures)])
        assert output.exit_code == 0, output.output
        runs[name] = json.loads(figures.read_text(encoding="utf-8"))
        assert ("as the rows tell" in output.output) == (name == "alone") and files[1] in output.output
    assert [each["files"] for each in runs["alone"]["stations"]] == [[files[0], files[2]], [files[1]]]
    assert runs["alone"]["held_out"]["best_rms_mm"] == pytest.approx(
        runs["flagged"]["held_out"]["best_rms_mm"], rel=0.2
    )
    judged = calibrate(ur5, files, test=day(true, 4, THERE), choices=PLAIN)
    assert isinstance(judged.test, Stacked) and judged.test.stations[0].number == 2 and judged.best.rms < 0.3
    assert judged.calibration.record["stations"] == judged.set_ups
    both = calibrate(ur5, files, test=[day(true, 4, THERE), day(true, 5)], choices=PLAIN)
    assert isinstance(both.test, Stacked) and [each.number for each in both.test.stations] == [1, 2]


@pytest.mark.slow
def test_a_page_names_all_files_and_has_no_change_from_an_arbitrary_start(ur5: Arm, true: Geometry) -> None:
    """Where the second set-up stands is told from the first one; its frames have no nominal to differ from."""
    result = calibrate(ur5, [day(true, 1), day(true, 3), day(true, 2, THERE)], choices=PLAIN)
    page = calibration_page(result)
    assert "pose measurements from day1.csv and 2 more;" in page
    assert "day1.csv, day3.csv" in page and f"{result.set_ups[1]['own']['base']['mm']:.0f} mm" in page
    names = {row["name"] for row in result.plain_parameters()}
    assert {"base_x", "tool_z"} <= names and not any(name.startswith("base2") for name in names)
    assert ">base2_x<" not in page


@pytest.mark.slow
def test_series_of_one_table_are_read_as_files(ur5: Arm, true: Geometry, tmp_path: Path) -> None:
    """Three days, row by row in turns, end where three files end; each may also be read alone."""
    days = [day(true, 1), day(true, 2, THERE), day(true, 3)]
    files = [each.write_csv(tmp_path / each.source) for each in days]
    table, by_day, plain = (tmp_path / name for name in ("all.csv", "by_day.toml", "plain.toml"))
    (header, *_), *_ = tables = [path.read_text(encoding="utf-8").splitlines() for path in files]
    turns = zip(*(rows for _, *rows in tables), strict=True)
    rows = [f"{name},{row}" for turn in turns for name, row in zip("abc", turn, strict=True)]
    table.write_text("\n".join([f"day,{header}", *rows]), encoding="utf-8")
    text = '[joints]\ncolumns = ["q1_deg", "q2_deg", "q3_deg", "q4_deg", "q5_deg", "q6_deg"]\nunit = "deg"\n'
    text += '[position]\ncolumns = ["x_mm", "y_mm", "z_mm"]\nunit = "mm"\n'
    text += '[rotation]\ncolumns = ["rx_deg", "ry_deg", "rz_deg"]\nunit = "deg"\nconvention = "rotation_vector"\n'
    plain.write_text(text, encoding="utf-8")
    by_day.write_text(f'{text}[scene]\nseries_column = "day"\n', encoding="utf-8")
    a, b, c = (f"{table}, series {name}" for name in "abc")
    for stations, parts in ((None, [[a, c], [b]]), ("base", [[a], [b], [c]])):
        by_file = calibrate(ur5, files, columns=plain, stations=stations, choices=PLAIN)
        by_row = calibrate(ur5, table, columns=by_day, stations=stations, choices=PLAIN)
        assert by_row.best == by_file.best
        assert [set_up["own"] for set_up in by_row.set_ups] == [set_up["own"] for set_up in by_file.set_ups]
        assert [set_up["files"] for set_up in by_row.set_ups] == parts
    with pytest.raises(InputError, match="left series"):
        by_day.write_text(f'{text}[scene]\nseries_column = "day"\nseries = "left series"\n', encoding="utf-8")
        read_observations([table], ur5.nominal, by_day)
    by_day.write_text(f'{text}[scene]\nseries_column = "day"\nseries = "b"\n', encoding="utf-8")
    alone, second = (
        read_observations([path], ur5.nominal, layout) for path, layout in ((table, by_day), (files[1], plain))
    )
    np.testing.assert_array_equal(alone.readings(), second.readings())
    for scene, message in (
        ('series = "b"', "series_column, which is missing; give both"),
        ('series_column = "day"\ntarget = "ball"', "is for a sensor and target without names"),
        ('series_column = "date"', "column 'date' is missing; the file has day"),
    ):
        by_day.write_text(f"{text}[scene]\n{scene}\n", encoding="utf-8")
        with pytest.raises(InputError, match=message):
            calibrate(ur5, table, columns=by_day, choices=PLAIN)


def findings(result: Result) -> str:
    return " ".join(": ".join(finding) for finding in result.quality.findings)


def test_a_file_is_never_left_out_whole_in_silence(ur5: Arm, true: Geometry) -> None:
    """Six rows of another day tell no set-up; all six are far off, and the file is named."""
    few = day(true, 2, THERE, rows=6)
    result = calibrate(ur5, [day(true, 1, rows=150), few], choices=PLAIN)
    assert "caution: day2.csv: all 6 rows are far off from the other files'" in findings(result)
    assert result.quality.grade == "with care"
    known = calibrate(ur5, [day(true, 1, rows=150), day(true, 3, rows=6)], choices=PLAIN)
    assert known.quality.grade == "good" and not known.left_out


def test_a_station_of_another_arm_is_named(ur5: Arm, true: Geometry) -> None:
    bent = true.displaced(np.concatenate([5e-3 * np.random.default_rng(5).normal(size=24), np.zeros(18)]))
    result = calibrate(ur5, [day(true, 1), day(true, 2), day(bent, 3, THERE)], choices=PLAIN)
    assert "caution: day3.csv: wherever base and tool may be, its rows miss by" in findings(result)
    fine = calibrate(ur5, [day(true, 1), day(true, 2), day(true, 3, THERE)], choices=PLAIN)
    assert fine.quality.grade == "good" and "wherever base" not in findings(fine)


def test_nothing_is_good_at_more_than_twenty_times_the_stated_noise(ur5: Arm, true: Geometry) -> None:
    """Two stations said to be one, 6 mm apart in height; where nobody stated the noise nothing is said of it."""
    aside = Pose(HERE.position + np.array([0.0, 0.0, 6e-3]), HERE.rotation)
    days = [replace(each, position_std=1e-5, attitude_std=2e-5) for each in (day(true, 1), day(true, 2, aside))]
    forced = calibrate(ur5, days, stations="none", choices=PLAIN)
    assert forced.quality.completeness.reduced > 400.0
    assert "something else than noise is at work" in findings(forced) and forced.quality.grade != "good"
    unsaid = calibrate(ur5, [replace(each, std_stated=False) for each in days], stations="none", choices=PLAIN)
    assert "something else than noise is at work" not in findings(unsaid)


@pytest.mark.parametrize("poses", [False, True], ids=["positions", "poses"])
def test_rows_of_all_stations_are_seen_from_the_first(ur5: Arm, true: Geometry, poses: bool) -> None:
    """What remains of a row is the same size from either station; of poses the tools' distance is taken off."""
    days = [day(true, 1, poses=poses), day(true, 2, THERE, OTHER_TARGET, poses=poses)]
    data = Stacked((InstrumentStation(days[0]), InstrumentStation(days[1], 2, THERE, OTHER_TARGET)))
    model = ArmModel.of(replace(true, base=HERE, tool=TARGET))
    seen = data.from_the_first(model, np.zeros(12))
    assert seen is not None and seen.kind == days[0].kind and len(seen) == 120 and seen.joinable(days[0])
    np.testing.assert_allclose(seen.position[:60], days[0].position, atol=1e-12)
    left, own = seen.difference(model), days[1].difference(replace(true, base=THERE, tool=OTHER_TARGET))
    if poses:
        np.testing.assert_allclose(np.linalg.norm(left[60:, 3:], axis=1), np.linalg.norm(own[:, 3:], axis=1), rtol=1e-6)
        at_second = forward(replace(true, base=HERE, tool=OTHER_TARGET), days[1].joints).position
        lever = at_second - forward(model.geometry, days[1].joints).position
        moved = left[60:, :3] + np.cross(left[60:, 3:], lever)
        np.testing.assert_allclose(np.linalg.norm(moved, axis=1), np.linalg.norm(own[:, :3], axis=1), rtol=1e-6)
    else:
        np.testing.assert_allclose(np.linalg.norm(left[60:], axis=1), np.linalg.norm(own, axis=1), rtol=1e-6)


@pytest.mark.slow
def test_residuals_and_the_counted_share_run_over_all_stations(ur5: Arm, true: Geometry) -> None:
    """A wave over the first joints, in the robot's own axes, is learnt from two stations as from one."""
    runs = {}
    for other in (HERE, THERE):
        days = []
        for seed, base in ((1, HERE), (2, other)):
            seen = day(true, seed, base, rows=150, poses=False)
            wave = 1e-3 * np.sin(2.0 * seen.joints[:, :3])
            days.append(replace(seen, position=seen.position + wave @ base.rotation.T))
        runs[other is THERE] = days
    choices = replace(PLAIN, residual="rbf", force=True)
    plain, learnt = (
        calibrate(ur5, runs[True], split="blocked", choices=PLAIN),
        calibrate(ur5, runs[True], choices=choices),
    )
    alone = calibrate(ur5, runs[False], stations="base", choices=choices)
    assert learnt.best.rms == pytest.approx(alone.best.rms, rel=0.05)
    assert isinstance(learnt.train, Stacked) and learnt.calibration.learnt is not None
    assert learnt.best.rms < 0.8 * learnt.position["geometric"].rms
    for result in (plain, learnt):
        share = result.uncertainty.factors["position"]
        assert share is not None and 0.88 <= share["covered"] <= 1.0
        assert {len(errors) for errors in result.errors.values()} == {len(result.test.joints)}
    blocks = plain.held_out.blocks
    assert blocks is not None and np.all(np.diff(blocks[:150]) >= 0) and np.all(np.diff(blocks[150:]) >= 0)
