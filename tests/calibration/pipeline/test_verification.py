"""An old calibration on new rows: still good, drifted since a row, of another arm, or seen from another station."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.arm import (
    Arm,
    Geometry,
    Plant,
    Pose,
    draw_plants,
    forward,
    inverse,
    load_arm,
    load_tolerances,
    rotation_matrix,
    rotation_vector,
)
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Choices,
    DistanceObservations,
    Measurements,
    Observations,
    Result,
    Stacked,
    TiltObservations,
    calibrate,
    error_statistics,
    frames_and_rows,
    given_rows,
    random_joints,
    read_observations,
    simulated_tracker,
    twin,
    verify,
)
from pickenv.calibration.assessment.screen import block_interval, figure
from pickenv.calibration.pipeline.calibration import MEASURED_REGION
from pickenv.calibration.pipeline.verification import Verification, _starts, restationed
from pickenv.cli import app

PLAIN = Choices(terms="none", residual="none")
FRAMES = ("base", "tool")
NOISE = 1e-4
HERE = Pose(np.array([2.0, 0.5, -0.3]), rotation_matrix(np.array([0.1, 0.2, -0.7])))
THERE = Pose(np.array([-1.0, 2.5, 0.4]), rotation_matrix(np.array([0.3, -0.1, 2.0])))
TARGET = Pose(np.array([0.02, -0.01, 0.1]), np.eye(3))
OTHER_TARGET = Pose(np.array([-0.03, 0.05, 0.15]), np.eye(3))


def bent(arm: Arm, seed: int, size: float = 1e-3) -> Geometry:
    rng, links = np.random.default_rng(seed), arm.nominal.links
    return arm.nominal.displaced(np.concatenate([rng.normal(size=4 * links) * size, np.zeros(links + 12)]))


def seen(
    geometry: Geometry, seed: int, base: Pose = HERE, tool: Pose = TARGET, rows: int = 120, poses: bool = False
) -> Measurements:
    rng = np.random.default_rng(seed)
    joints = random_joints(geometry, rows, rng)
    pose = forward(replace(geometry, base=base, tool=tool), joints)
    turned = rotation_matrix(rng.normal(size=(rows, 3)) * 2e-4) @ pose.rotation if poses else None
    position = pose.position + rng.normal(size=(rows, 3)) * NOISE
    return Measurements(joints, position, turned, geometry.prismatic, NOISE, source=f"day{seed}.csv", std_stated=True)


@pytest.fixture(scope="module")
def ur5() -> Arm:
    return load_arm("ur5")


@pytest.fixture(scope="module")
def true(ur5: Arm) -> Geometry:
    return bent(ur5, 0)


@pytest.fixture(scope="module")
def result(ur5: Arm, true: Geometry) -> Result:
    return calibrate(ur5, seen(true, 1, rows=150), choices=PLAIN)


@pytest.fixture(scope="module")
def of_poses(ur5: Arm, true: Geometry) -> Result:
    return calibrate(ur5, seen(true, 1, rows=150, poses=True), choices=PLAIN)


@pytest.mark.parametrize(
    "moved", [{}, {"base": (0.0123, 0.25, 0, 0), "tool": (4.5e-4, 0.01, 0, 0)}], ids=["as it was", "moved"]
)
def test_every_number_on_the_screen_is_in_mm_or_degrees_and_so_it_is_for_programs(moved: dict) -> None:
    """Lengths that frames moved by are kept in m and angles in rad; errors come in mm."""
    nominal, mine = (error_statistics(size * np.arange(1.0, 41.0), np.arange(40) // 4) for size in (0.5, 0.02))
    found = Verification(
        "drifted", "it grew", mine, nominal, 0.321, rows=40, refitted=12 * bool(moved), moved=moved, since=None,
        left_out=(),
    )  # fmt: skip
    text = " ".join(found.text().split())
    assert text.startswith("verdict: DRIFTED: it grew") and "Errors on 40 rows" in text
    for s in (nominal, mine):
        low, high = s.mean_ci95 or (np.nan, np.nan)
        assert " ".join([figure(s.rms), figure(s.mean), f"{figure(low)} to {figure(high)}", figure(s.p95)]) in text
    assert "expected of the calibrated arm: 0.3210 mm RMS" in text
    assert ("base and tool found from 12 other rows, of both arms" in text) == bool(moved)
    assert ("base and tool as they were" in text) != bool(moved)
    told = found.as_dict()["moved"]
    for name, mm, deg in (("base", 12.3, 14.3239), ("tool", 0.45, 0.572958)):
        assert (f"{name} {figure(mm)} {figure(deg)}" in text) == (name in moved)
        if name in moved:
            assert (told[name]["mm"], told[name]["deg"]) == pytest.approx((mm, deg), rel=1e-4)


def test_new_rows_of_the_same_set_up_find_it_still_good(result: Result, true: Geometry) -> None:
    found = verify(result.calibration, seen(true, 2))
    assert found.status == "still good" and found.rows == 120 and not found.moved and found.since is None
    assert found.calibrated.rms == pytest.approx(found.expected, rel=0.15)
    assert found.calibrated.rms == pytest.approx(NOISE * 1e3 * np.sqrt(3), rel=0.2)
    assert found.nominal.rms > 5 * found.calibrated.rms


@pytest.mark.parametrize("refit", [(), ("base", "tool")])
def test_terms_are_the_calibrated_arm_s_alone(dynamic: Plant, refit: tuple[str, ...]) -> None:
    """The nominal arm has none of the parameters that say how sure the calibrated one is."""
    rng = np.random.default_rng(6)
    train, new = (simulated_tracker(dynamic, random_joints(dynamic.geometry, n, rng), rng) for n in (150, 40))
    found = calibrate(dynamic.arm, train, choices=Choices(terms="gravity", residual="none")).calibration
    assert found.model.terms
    judged = verify(found, new, refit)
    assert judged.status == "still good" and judged.refitted == (6 if refit else 0)
    assert judged.rows == len(new) - judged.refitted and judged.nominal.rms > 5 * judged.calibrated.rms
    if not refit:
        missed = np.linalg.norm(found.errors(new)[:, :3], axis=1)
        assert judged.calibrated.rms == pytest.approx(1e3 * np.sqrt(np.mean(missed**2)), rel=1e-12)


@pytest.mark.parametrize("poses", [False, True], ids=["positions", "poses"])
@pytest.mark.parametrize("seed", range(3))
def test_at_another_station_the_frames_are_found_from_a_few_rows(
    request: pytest.FixtureRequest, true: Geometry, seed: int, poses: bool
) -> None:
    calibration = request.getfixturevalue("of_poses" if poses else "result").calibration
    data = seen(true, 10 + seed, THERE, OTHER_TARGET, poses=poses)
    raw = verify(calibration, data)
    assert raw.status == "another station" and "`refit='base,tool'`" in raw.reason
    found = verify(calibration, data, ("base", "tool"), 8)
    assert found.status == "still good" and found.rows == 112 and found.refitted == 8
    assert found.calibrated.rms == pytest.approx(found.expected, rel=0.4)
    turn = np.linalg.norm(rotation_vector(THERE.rotation @ HERE.rotation.T))
    assert found.moved["base"][0] == pytest.approx(np.linalg.norm(THERE.position - HERE.position), abs=0.01)
    assert found.moved["base"][1] == pytest.approx(turn, abs=0.01)
    assert found.moved["tool"][0] == pytest.approx(np.linalg.norm(OTHER_TARGET.position - TARGET.position), abs=0.01)


@pytest.mark.parametrize(("own", "base", "tool"), [("base", THERE, TARGET), ("tool", HERE, OTHER_TARGET)])
def test_one_frame_alone_is_found_and_the_other_stays(
    result: Result, true: Geometry, own: str, base: Pose, tool: Pose
) -> None:
    found = verify(result.calibration, seen(true, 3, base, tool), (own,), 6)
    assert found.status == "still good" and set(found.moved) == {own}
    wrong = "tool" if own == "base" else "base"
    assert verify(result.calibration, seen(true, 3, base, tool), (wrong,), 6).status != "still good"


@pytest.mark.parametrize("own", FRAMES)
@pytest.mark.parametrize("shift", [6e-4, 0.05], ids=["by little", "by much"])
def test_a_frame_that_was_not_found_anew_may_have_moved_too(
    result: Result, true: Geometry, own: str, shift: float
) -> None:
    base, tool = (Pose(frame.position + np.array([shift, 0.0, shift]), frame.rotation) for frame in (HERE, TARGET))
    base, tool = (THERE, tool) if own == "base" else (base, OTHER_TARGET)
    found = verify(result.calibration, seen(true, 12, base, tool), (own,))
    assert found.status == "another station" and "`refit='base,tool'`" in found.reason
    assert verify(result.calibration, seen(true, 12, base, tool), FRAMES).status == "still good"


@pytest.mark.slow
def test_expected_errors_are_those_found_whatever_the_rows(result: Result, true: Geometry) -> None:
    """Six rows, or ten: over stations the mean square found is the one expected, within a quarter."""
    ratio = []
    for seed in range(12):
        data = seen(true, 30 + seed, THERE, OTHER_TARGET)
        found = verify(result.calibration, data, ("base", "tool"), 6 + 4 * (seed % 2))
        ratio.append(found.calibrated.rms / found.expected)
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1.0, abs=0.25)


def drifted(geometry: Geometry, size: float) -> Geometry:
    """The arm after a collision: two joints read wrong."""
    off = np.zeros(5 * geometry.links + 12)
    off[2 * geometry.links + 1], off[2 * geometry.links + 2] = size, -size
    return geometry.displaced(off)


def test_a_drifted_arm_is_told_and_by_how_much(result: Result, true: Geometry) -> None:
    later = drifted(true, 1.2e-3)
    data = seen(later, 4)
    found = verify(result.calibration, data)
    apart = forward(replace(true, base=HERE, tool=TARGET), data.joints).position - (
        forward(replace(later, base=HERE, tool=TARGET), data.joints).position
    )
    size = float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) * 1e3
    assert found.status == "drifted" and found.since is None
    said = float(found.reason.partition("but ")[2].split()[0])
    assert said == pytest.approx(size, rel=0.15)


def test_the_row_from_which_on_it_drifted_is_named(result: Result, true: Geometry) -> None:
    good, bad = seen(true, 5, rows=60), seen(drifted(true, 1.2e-3), 6, rows=60)
    joints, position = (np.concatenate([a, b]) for a, b in ((good.joints, bad.joints), (good.position, bad.position)))
    found = verify(result.calibration, replace(good, joints=joints, position=position))
    assert found.status == "drifted" and found.since == "from day5.csv, row 61, on" and found.since in found.reason


@pytest.mark.parametrize("shift", [0.003, 0.05])
def test_an_instrument_that_was_moved_within_the_file_is_no_change_of_the_arm(
    result: Result, true: Geometry, shift: float, tmp_path: Path
) -> None:
    moved = Pose(HERE.position + np.array([shift, 0.0, 0.0]), HERE.rotation)
    good, bad = seen(true, 5, rows=60), seen(true, 6, moved, rows=60)
    joints, position = (np.concatenate([a, b]) for a, b in ((good.joints, bad.joints), (good.position, bad.position)))
    both = replace(good, joints=joints, position=position)
    found = verify(result.calibration, both)
    assert found.status == "another station" and found.since == "from day5.csv, row 61, on"
    assert found.since in found.reason and verify(result.calibration, bad, FRAMES).status == "still good"
    saved, file = result.save(tmp_path / "arm.npz"), both.write_csv(tmp_path / "day.csv")
    said = CliRunner().invoke(app, ["verify", str(saved), str(file)])
    assert said.exit_code == 3 and "THOSE_ROWS --refit base,tool" in " ".join(said.output.split())


@pytest.mark.parametrize("rows", [40, 39])
def test_forty_rows_are_ten_blocks_and_fewer_are_none(result: Result, true: Geometry, rows: int) -> None:
    """Four rows a block are the fewest of which it is said where they drifted, and how far blocks differ."""
    good, bad = seen(true, 5, rows=20), seen(drifted(true, 2.5e-3), 6, rows=rows - 20)
    joints, position = (np.concatenate([a, b]) for a, b in ((good.joints, bad.joints), (good.position, bad.position)))
    found = verify(result.calibration, replace(good, joints=joints, position=position))
    assert found.rows == rows
    assert found.since == ("from day5.csv, row 21, on" if rows == 40 else None)
    missed = 1e3 * np.linalg.norm(position - forward(result.calibration.nominal, joints).position, axis=1)
    between = block_interval(missed, np.repeat(np.arange(10), 4), rms=True) if rows == 40 else None
    assert found.nominal.rms_ci95 == (None if between is None else pytest.approx(between))


@pytest.mark.parametrize("own", [("base",), ("base", "tool")])
def test_the_search_for_new_frames_starts_near_them_wherever_the_old_ones_were(ur5: Arm, own: tuple[str, ...]) -> None:
    """Without noise: at the new base itself where the tool is the old one, else within millimetres."""
    old = replace(ur5.nominal, base=HERE, tool=TARGET)
    new = replace(old, base=THERE, tool=TARGET if own == ("base",) else OTHER_TARGET)
    joints = random_joints(old, 12, np.random.default_rng(0))
    few = Measurements(joints, forward(new, joints).position, None, old.prismatic)
    misses = [float(np.abs(few.difference(start)).max()) for start in _starts(ArmModel.of(old), few, own)]
    assert min(misses) < (1e-9 if own == ("base",) else 5e-3) and len(misses) == 1 + len(own)


def test_the_calibration_of_another_arm_is_told(ur5: Arm, result: Result) -> None:
    found = verify(result.calibration, seen(bent(ur5, 7), 8), ("base", "tool"))
    assert found.status == "another arm" and found.calibrated.rms >= found.nominal.rms


def test_rows_far_off_are_left_out_and_listed(result: Result, true: Geometry) -> None:
    for frames, base in (((), HERE), (("base", "tool"), THERE)):
        data = seen(true, 9, base)
        position = data.position.copy()
        position[[17, 80]] += 0.04
        found = verify(result.calibration, replace(data, position=position), frames)
        assert sorted(item.line for item in found.left_out) == [18, 81] and found.status == "still good"


def test_what_was_learnt_turns_with_the_base(ur5: Arm, true: Geometry) -> None:
    """A calibration with a learnt residual leaves the same errors wherever the instrument stands."""
    choices = Choices(terms="none", residual="rbf", force=True)
    train, test = seen(true, 1, rows=150), seen(true, 2)
    wavy = 1e-3 * np.sin(3 * train.joints[:, :3]) @ HERE.rotation.T
    calibration = calibrate(ur5, replace(train, position=train.position + wavy), choices=choices).calibration
    assert calibration.learnt is not None
    across = THERE.rotation @ HERE.rotation.T
    moved = replace(test, position=(test.position - HERE.position) @ across.T + THERE.position)
    left = [verify(calibration, data, ("base",), 8).calibrated for data in (test, moved)]
    assert left[0].rms == pytest.approx(left[1].rms, rel=1e-6)
    assert restationed(calibration, moved, ("base",), 8)[-1]["base"][1] == pytest.approx(
        np.linalg.norm(rotation_vector(across)), abs=0.01
    )


def test_zeros_that_drifted_are_told_where_a_residual_was_learnt_that_turns_the_tool(ur5: Arm, true: Geometry) -> None:
    """Three degrees that were learnt are no part of the drift, and zeros need not explain them."""

    def tilted(data: Measurements) -> Measurements:
        tilt = 0.06 * np.sin(data.joints[:, 1:4] + data.joints[:, [2, 3, 1]])
        return replace(data, rotation=rotation_matrix(tilt) @ data.rotation)

    choices = Choices(terms="none", residual="rbf", force=True)
    calibration = calibrate(ur5, tilted(seen(true, 1, rows=300, poses=True)), choices=choices).calibration
    said = verify(calibration, tilted(seen(drifted(true, 1.2e-3), 4, poses=True)))
    assert said.status == "drifted" and "the joints' zeros explain it" in said.reason


@pytest.mark.slow
def test_what_was_learnt_is_no_part_of_where_the_instrument_stands(ur5: Arm, true: Geometry) -> None:
    """Waves of two millimetres over the joints are the arm's own, and the frames do not take up their mean."""

    def wavy(data: Measurements) -> Measurements:
        return replace(data, position=data.position + 2e-3 * np.cos(2 * data.joints[:, :3]) @ HERE.rotation.T)

    choices, across = Choices(terms="none", residual="gp", force=True), THERE.rotation @ HERE.rotation.T
    calibration = calibrate(ur5, wavy(seen(true, 1, rows=200)), choices=choices).calibration
    here = wavy(seen(true, 2))
    there = replace(here, position=(here.position - HERE.position) @ across.T + THERE.position)
    stayed = verify(calibration, here)
    for rows in (6, 12, 30):
        moved = verify(calibration, there, FRAMES, rows)
        assert stayed.status == moved.status == "still good" and moved.refitted == rows
        assert moved.calibrated.rms < 1.2 * stayed.calibrated.rms


@pytest.mark.slow
def test_zeros_that_drifted_are_told_wherever_the_instrument_stands(ur5: Arm, true: Geometry) -> None:
    """The residual, two millimetres of waves, was learnt in the axes of the base, which another station turns."""

    def wavy(data: Measurements) -> Measurements:
        return replace(data, position=data.position + 2e-3 * np.cos(2 * data.joints[:, :3]) @ HERE.rotation.T)

    choices, across = Choices(terms="none", residual="gp", force=True), THERE.rotation @ HERE.rotation.T
    calibration = calibrate(ur5, wavy(seen(true, 1, rows=100)), choices=choices).calibration
    here = wavy(seen(drifted(true, 3e-3), 4, rows=100))
    there = replace(here, position=(here.position - HERE.position) @ across.T + THERE.position)
    said = verify(calibration, there, FRAMES, 12)
    assert said.status == "drifted" and "the joints' zeros explain it" in said.reason


def test_rows_of_another_station_do_not_judge_a_calibration(ur5: Arm, true: Geometry) -> None:
    train, test = seen(true, 1, rows=150), seen(true, 2, THERE, OTHER_TARGET)
    with pytest.raises(InputError, match="another set-up"):
        calibrate(ur5, train, test=test, choices=PLAIN)


@pytest.mark.parametrize("how", ["random", "blocked"])
def test_a_result_keeps_the_robots_number(ur5: Arm, true: Geometry, tmp_path: Path, how: str) -> None:
    file = (day := seen(true, 13, rows=60)).write_csv(tmp_path / day.source)
    assert calibrate(ur5, file, split=how, choices=PLAIN, unit="A7").unit == "A7"


def test_bad_wishes_are_refused(result: Result, true: Geometry) -> None:
    with pytest.raises(InputError, match="refit is 'basis'; give base, tool, or base,tool"):
        frames_and_rows("basis", 6)
    assert frames_and_rows("base, tool", 9) == (("base", "tool"), 9)
    assert frames_and_rows(None, None)[0] == ()
    assert frames_and_rows("tool", None) == (("tool",), 6)
    with pytest.raises(InputError, match="`refit_rows=8` is for `refit`; say which frames"):
        frames_and_rows(None, 8)
    with pytest.raises(InputError, match="found from 5 of 120 rows; give 6 rows or more"):
        verify(result.calibration, seen(true, 2), ("base", "tool"), 5)
    with pytest.raises(InputError, match="found from 6 of 8 rows"):
        verify(result.calibration, seen(true, 2, rows=8), ("base", "tool"))
    with pytest.raises(InputError, match="2 rows judge nothing"):
        verify(result.calibration, seen(true, 2, rows=2))
    joints = random_joints(true, 9, np.random.default_rng(0))
    with pytest.raises(InputError, match="holds distance; a calibration is verified on poses or positions"):
        verify(result.calibration, DistanceObservations(joints, np.ones(9), 1e-4))


def hung(geometry: Geometry, tip_std: float, rows: int = 150) -> DistanceObservations:
    """Lengths of a draw wire whose hook is at the tool's frame, or anywhere on the tool if ``tip_std`` is infinite."""
    rng = np.random.default_rng(1)
    joints = random_joints(geometry, rows, rng)
    point = forward(replace(geometry, tool=TARGET), joints).position
    length = np.linalg.norm(point - np.array([1.5, -2.0, 0.3]), axis=1) + NOISE * rng.normal(size=rows)
    return DistanceObservations(joints, length, NOISE, source="wire.csv", tip_std=tip_std)


def dipped(geometry: Geometry, rows: int = 150) -> TiltObservations:
    rng = np.random.default_rng(1)
    joints = random_joints(geometry, rows, rng)
    down = -forward(geometry, joints).rotation[:, 2] + NOISE * rng.normal(size=(rows, 3))
    return TiltObservations(joints, down, np.full((rows, 3), NOISE))


@pytest.mark.parametrize(
    ("data", "untold"),
    [
        (lambda arm: hung(arm, 0.0), "base"),
        (lambda arm: hung(arm, np.inf), "base and tool"),
        (dipped, "base and tool"),
    ],
    ids=["wire", "wire with an unknown hook", "tilt"],
)
def test_rows_that_never_told_base_and_tool_promise_no_positions(
    ur5: Arm, true: Geometry, data: Callable[[Geometry], Observations], untold: str
) -> None:
    """A wire and an inclinometer see the arm, and not where a tracker stands; twins keep their tool."""
    calibration = calibrate(ur5, data(true), choices=PLAIN).calibration
    with pytest.raises(InputError, match=rf"^day2.csv: the place of {untold} is not known .*`refit='base,tool'`$"):
        verify(calibration, seen(true, 2))
    with pytest.raises(InputError, match="the place of base is not known"):
        verify(calibration, seen(true, 2), ("tool",))
    assert verify(calibration, seen(true, 2), FRAMES).refitted == 6
    drawn = draw_plants(twin(calibration, ur5), load_tolerances("cobot"), 8, np.random.default_rng(0)).geometry
    assert np.ptp(np.atleast_2d(drawn.tool.position), axis=0).max() < 5e-3


def test_files_in_our_own_columns_are_one_set_up_or_stations_as_asked(ur5: Arm, true: Geometry, tmp_path: Path) -> None:
    days = [seen(true, seed, rows=30) for seed in (11, 12)]
    files = [day.write_csv(tmp_path / day.source) for day in days]
    joints = np.concatenate([day.joints for day in days])
    together = given_rows(ur5, files)
    assert isinstance(together, Measurements)
    np.testing.assert_allclose(together.joints, joints, atol=1e-9)
    for given, frames in ((files, ("base",)), (days, ("tool",)), (files, ("base", "tool"))):
        apart = given_rows(ur5, given, stations=",".join(frames))
        assert isinstance(apart, Stacked) and len(apart.stations) == 2
        assert [name.partition("_")[0] for name in apart.unknowns()] == [f"{f}2" for f in frames for _ in range(6)]
        np.testing.assert_allclose(apart.joints, joints, atol=1e-9)


def test_the_command_says_what_the_function_says(result: Result, true: Geometry, tmp_path: Path) -> None:
    saved = result.save(tmp_path / "arm.npz")
    correct, measure = f"correct targets: pickenv apply {saved} targets.csv", "measure more poses, or others: pickenv "
    again = f"find base and tool anew: pickenv verify {saved} "
    for data, refit, code, step in (
        (seen(true, 2), [], 0, correct),
        (seen(true, 2, THERE, OTHER_TARGET), ["--refit", "base,tool", "--refit-rows", "8"], 0, correct),
        (seen(true, 2, THERE, OTHER_TARGET), [], 3, again),
        (seen(drifted(true, 1.2e-3), 4), [], 3, measure),
    ):
        file, figures = data.write_csv(tmp_path / f"{data.source}"), tmp_path / "f.json"
        said = CliRunner().invoke(app, ["verify", str(saved), str(file), *refit, "--json", str(figures)])
        assert said.exit_code == code, said.output
        there = json.loads(figures.read_text(encoding="utf-8"))
        reason = there["reason"].replace("`refit='base,tool'`", "--refit base,tool")
        assert said.output.startswith(f"verdict: {there['status'].upper()}: {reason}")
        assert there["reservation"] is None and "reservation" not in said.output
        assert there["refit_rows"] == (8 if refit else 0)
        assert f"{there['calibrated_mm']['rms']:#.4g}".rstrip(".") in said.output
        assert said.output.splitlines()[-1].startswith(f"next: {step}")


def test_a_calibration_not_to_be_used_says_so_where_new_rows_find_it_good(
    ur5: Arm, true: Geometry, tmp_path: Path
) -> None:
    """One held-out row judges nothing, so `apply` refuses it; new rows may find it good, and the words are the same."""
    few = calibrate(ur5, seen(true, 1, rows=150), test=seen(true, 3, rows=1), choices=PLAIN)
    rows, figures = seen(true, 2).write_csv(tmp_path / "new.csv"), tmp_path / "f.json"
    said = CliRunner().invoke(app, ["verify", str(few.save(tmp_path / "a.npz")), str(rows), "--json", str(figures)])
    there, sentence = json.loads(figures.read_text(encoding="utf-8")), few.calibration.reservations()["do-not-use"]
    assert there["status"] == "still good" and there["reservation"] == sentence and said.exit_code == 3
    assert "do not use (only 1 row was held out" in sentence
    first, second = said.output.splitlines()[:2]
    assert first.startswith("verdict: STILL GOOD: ")
    assert second == "reservation: " + sentence.replace("`test`", "--test")
    assert said.output.splitlines()[-1].startswith("next: measure more poses")


@pytest.mark.parametrize("frames", [(), ("base", "tool")], ids=["as it was", "refitted"])
@pytest.mark.parametrize("share", [0.1, 0.3])
def test_a_drift_is_not_taken_for_rows_far_off(
    result: Result, true: Geometry, frames: tuple[str, ...], share: float
) -> None:
    """A collision near the end of the file moved the arm by fifty times its noise; those rows judge too."""
    bad = round(120 * share)
    good, moved = seen(true, 5, rows=120 - bad), seen(drifted(true, 8e-3), 6, rows=bad)
    joints, position = (np.concatenate(pair) for pair in ((good.joints, moved.joints), (good.position, moved.position)))
    found = verify(result.calibration, replace(good, joints=joints, position=position), frames, 12)
    assert found.status == "drifted" and len(found.left_out) <= 6  # one row in twenty
    assert found.calibrated.rms > 3 * found.expected


def along_a_line(geometry: Geometry, rows: int) -> np.ndarray:
    """Joints ``(rows, n)`` of poses along a straight line of 0.4 m, all of one attitude."""
    start = forward(geometry, np.array([0.3, -1.2, 1.4, -0.8, -1.3, 0.4]))
    places = start.position + np.linspace(0.0, 0.4, rows)[:, None] * np.array([0.3, 0.9, 0.1])
    goals = Pose(places, np.broadcast_to(start.rotation, (rows, 3, 3)))
    solution = inverse(geometry, goals)
    assert solution.reached.all()
    return solution.joints


@pytest.mark.slow
@pytest.mark.parametrize("poses", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["positions", "poses"])
def test_frames_that_a_line_at_one_attitude_does_not_tell_stay_where_they_were(
    request: pytest.FixtureRequest, true: Geometry, poses: bool
) -> None:
    """How base and tool share a shift no such rows tell; errors are as promised all the same."""
    calibration = request.getfixturevalue("of_poses" if poses else "result").calibration
    rng, joints = np.random.default_rng(3), along_a_line(true, 60)
    pose = forward(replace(true, base=HERE, tool=TARGET), joints)
    turned = rotation_matrix(2e-4 * rng.normal(size=(60, 3))) @ pose.rotation if poses else None
    position = pose.position + NOISE * rng.normal(size=(60, 3))
    data = Measurements(joints, position, turned, true.prismatic, NOISE, source="line.csv", std_stated=True)
    for count in (6, 12):
        found = verify(calibration, data, FRAMES, count)
        assert found.ratio < 1.5 and found.status in ("still good", "worse than nominal", "no better than nominal")
        (*_, base_shifts, base_turns), (*_, tool_shifts, tool_turns) = found.moved["base"], found.moved["tool"]
        assert base_shifts == tool_shifts == 3 and base_turns >= 1 and (tool_turns == 3) != poses
        assert "not told by these rows" in found.text() and found.as_dict()["moved"]["base"]["mm"] is None
        wide = verify(calibration, seen(true, 2, poses=poses), FRAMES, count)
        assert wide.status == "still good" and not any(wide.moved["base"][2:])
        assert wide.moved["tool"][2:] == (0, 0 if poses else 3)
        assert wide.moved["base"][0] < 2e-3 and wide.moved["tool"][0] < 2e-3


@pytest.mark.parametrize("case", ["here", "weak", "drifted"])
def test_verify_and_calibrate_say_the_same_of_the_same_rows(ur5: Arm, true: Geometry, case: str) -> None:
    """Twenty rows of an arm that is as drawn make a calibration worse than the drawing, and both say so."""
    arm = ur5.nominal if case == "weak" else true
    train = seen(arm, 1, rows=20 if case == "weak" else 150)
    test = seen(drifted(arm, 1.2e-3) if case == "drifted" else arm, 4)
    calibration = calibrate(ur5, train, test=seen(arm, 2), choices=PLAIN).calibration
    judged, found = calibrate(ur5, train, test=test, choices=PLAIN), verify(calibration, test)
    for name, mine in (("nominal", found.nominal), ("geometric", found.calibrated)):
        assert mine.rms == pytest.approx(judged.position[name].rms, rel=1e-9)
    assert (found.no_gain is not None) == (judged.quality.grade == "do not use") == (case == "weak")
    assert found.status == {"here": "still good", "weak": "worse than nominal", "drifted": "drifted"}[case]


def part_of_the_range(geometry: Geometry, rows: int, rng: np.random.Generator, far: bool) -> np.ndarray:
    lower, upper = np.maximum(geometry.lower, -2.6), np.minimum(geometry.upper, 2.6)
    middle = (lower + upper) / 2.0
    ends = (middle + 0.1 * (upper - lower), upper) if far else (lower, middle)
    return rng.uniform(*ends, (rows, geometry.joints))


def measured(
    geometry: Geometry, drives: np.ndarray, seed: int, rows: int = 60, far: bool = False, base: Pose = HERE
) -> Measurements:
    """Positions of an arm whose drives have errors of their own, which no geometry says."""
    rng = np.random.default_rng(seed)
    joints = part_of_the_range(geometry, rows, rng, far)
    moved = joints + drives[0] * np.sin(joints) + drives[1] * np.cos(2.0 * joints)
    position = forward(replace(geometry, base=base, tool=TARGET), moved).position
    position = position + 5e-5 * rng.normal(size=(rows, 3))
    return Measurements(joints, position, None, geometry.prismatic, 5e-5, source=f"day{seed}.csv", std_stated=True)


def words_of_a_pair(arm: Arm, seed: int) -> dict[str, str]:
    """What is said of a calibrated arm's calibration: of itself, elsewhere, after a crash, of another arm, moved."""
    rng = np.random.default_rng(seed)
    (one, drives), (other, others) = ((bent(arm, 1000 + seed + k), 1.5e-4 * rng.normal(size=(2, 6))) for k in (0, 500))
    crash = np.zeros(5 * one.links + 12)
    hit = rng.choice(np.arange(1, 5), 2, replace=False)
    crash[2 * one.links + hit] = rng.choice([-1.0, 1.0], 2) * rng.uniform(5e-4, 2e-3, 2)
    calibration = calibrate(arm, measured(one, drives, seed, 150), choices=PLAIN).calibration
    days = {
        "itself": measured(one, drives, 2000 + seed),
        "elsewhere": measured(one, drives, 3000 + seed, far=True),
        "crashed": measured(one.displaced(crash), drives, 4000 + seed),
        "other": measured(other, others, 5000 + seed),
        "moved": measured(one, drives, 6000 + seed, base=THERE),
    }
    return {name: verify(calibration, day).status for name, day in days.items()}


RIGHT = {
    "itself": ("still good",),
    "elsewhere": ("outside what was measured", "still good"),
    "crashed": ("drifted",),
    "other": ("another arm",),
    "moved": ("another station",),
}
"""Elsewhere a calibration may well be as good as promised; then it is said that it was not measured there."""


@pytest.mark.slow
def test_of_sixty_pairs_at_most_three_words_are_wrong(ur5: Arm) -> None:
    """Twelve calibrated arms, each with five days of rows; the seeds were fixed before anything was looked at."""
    said = {seed: words_of_a_pair(ur5, seed) for seed in range(12)}
    wrong = [(s, name, word) for s, words in said.items() for name, word in words.items() if word not in RIGHT[name]]
    assert len(wrong) <= 3, wrong


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        pytest.param("B", "D", "still good", marks=pytest.mark.slow),
        ("D", "B", "still good"),
        ("C", "D", "outside what was measured"),
    ],
)
def test_other_series_of_a_real_arm_are_never_taken_for_another_arm(
    data_folder: Path, old: str, new: str, word: str
) -> None:
    """A UR10 measured at other poses, from other places; a calibration of C was not made where D lies: that is said."""
    arm, series = load_arm("ur10"), {}
    files = {"B": "joint_configurations", "C": "random_poses", "D": "iso_cubes"}
    for name in (old, new):
        file = data_folder / f"ur10_ipa_landgraf2021/Series_{name}/measurements_{files[name]}.csv"
        whole = read_observations([file], arm.nominal, "ur10_landgraf2021_repeats")
        series[name] = whole.select(np.linspace(0, len(whole.joints) - 1, 300).astype(int))
    calibration = calibrate(arm, series[old], choices=PLAIN).calibration
    assert verify(calibration, series[new]).status == "another station"
    found = verify(calibration, series[new], FRAMES, 12)
    assert found.status == word and found.measured is not None and found.measured < 0.5
    assert ("it was not measured here before" in found.reason) == (word == "still good")
    assert found.no_gain is None  # priors keep what C does not tell near the drawing, so that D errs less even so


@pytest.mark.parametrize("far", [False, True], ids=["there", "elsewhere"])
def test_a_region_was_measured_where_rows_were_near(ur5: Arm, true: Geometry, far: bool) -> None:
    drives = np.zeros((2, 6))
    calibration = calibrate(ur5, measured(true, drives, 1, 150), choices=PLAIN).calibration
    share = verify(calibration, measured(true, drives, 2, far=far)).measured
    assert share is not None and (share < 0.1 if far else share > 0.9)
    unknown = replace(calibration, record={**calibration.record, MEASURED_REGION: None})
    found = verify(unknown, measured(true, drives, 2, far=far))
    assert found.measured is None and "not known" in found.text()


@pytest.mark.parametrize("longer", [0.0, 0.05])
def test_the_next_command_names_a_shipped_arm_only_if_it_is_this_one(tmp_path: Path, longer: float) -> None:
    """A robot's own file often names its robot as the shipped arm, "ur5", with another tool or another link."""
    shipped, rng = load_arm("ur5"), np.random.default_rng(0)
    arm = replace(shipped, nominal=replace(shipped.nominal, a=shipped.nominal.a + longer * np.eye(6)[2]))
    old, new = (random_joints(arm.nominal, n, rng) for n in (60, 30))
    old, new = (Measurements(q, *forward(arm.nominal, q), arm.nominal.prismatic, frames="known") for q in (old, new))
    saved = calibrate(arm, old, choices=Choices(terms="none", residual="none")).calibration.save(tmp_path / "a.npz")
    new.write_csv(file := tmp_path / "new.csv")
    said = CliRunner().invoke(app, ["verify", str(saved), str(file)]).output
    assert f"--arm {'ARM' if longer else 'ur5'} " in said
