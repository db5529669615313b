"""Stations of one arm in one fit: derivatives, frames of their own, and what one instrument adds to another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Arm, Geometry, Pose, forward, load_arm, move_pose, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Choices,
    DistanceObservations,
    InstrumentStation,
    Measurements,
    Observations,
    Stacked,
    align,
    calibrate,
    frames_model,
    given_rows,
    prior_model,
    random_joints,
)
from pickenv.calibration.identification.robust import rough_start, stations_of
from pickenv.calibration.model.arm_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE
from pickenv.calibration.pipeline.fitting import fit_frames, fit_geometry
from tests.calibration.simulated_instruments import touches

PLAIN = Choices(terms="none", residual="none")
ANCHOR = np.array([1.5, -2.0, 0.3])
FAR = Pose(np.array([3.0, -1.0, 0.5]), rotation_matrix(np.array([0.3, -0.2, 1.4])))
TARGET = Pose(np.array([0.03, -0.05, 0.08]), np.eye(3))


def bent(arm: Arm, seed: int = 0) -> Geometry:
    """An arm a millimetre and a milliradian off."""
    rng, nominal = np.random.default_rng(seed), arm.nominal
    off = rng.normal(size=5 * nominal.links + 12) * 1e-3
    off[-12:] = 0.0
    off[4 * nominal.links : 5 * nominal.links] = 0.0
    return nominal.displaced(off)


def tracked(
    geometry: Geometry, count: int, rng: np.random.Generator, base: Pose = FAR, tool: Pose = TARGET, noise: float = 5e-5
) -> Measurements:
    """Positions of a target on the tool, from a tracker anywhere."""
    joints = random_joints(geometry, count, rng)
    position = forward(replace(geometry, base=base, tool=tool), joints).position
    source = f"tracker {count}"
    moved = position + noise * rng.normal(size=position.shape)
    return Measurements(joints, moved, None, geometry.prismatic, position_std=noise, source=source)


def wired(geometry: Geometry, count: int, rng: np.random.Generator, noise: float = 1e-4) -> DistanceObservations:
    joints = random_joints(geometry, count, rng)
    length = np.linalg.norm(forward(geometry, joints).position - ANCHOR, axis=1)
    return DistanceObservations(joints, length + noise * rng.normal(size=count), noise, source="wire")


def touched(geometry: Geometry, count: int, rng: np.random.Generator) -> Observations:
    return touches(geometry, count, rng, 2.0)  # 0.1 mm


@pytest.fixture(scope="module")
def ur5() -> Arm:
    return load_arm("ur5")


@pytest.mark.parametrize("own", [(), ("base",), ("tool",), ("base", "tool")], ids="+".join)
def test_derivatives_are_the_residuals_differences(ur5: Arm, own: tuple[str, ...]) -> None:
    rng = np.random.default_rng(2)
    true = bent(ur5)
    frames = {name: {"base": FAR, "tool": TARGET}[name] for name in own}
    data = Stacked(
        (InstrumentStation(tracked(true, 5, rng)), InstrumentStation(wired(true, 4, rng), 2, **frames, scale=2.0))
    )
    model = ArmModel.of(true)
    unknowns = data.start(model)
    by_arm, by_own = data.jacobian(model, unknowns)
    step = 1e-6
    for column in range(by_arm.shape[1]):
        delta = np.zeros(by_arm.shape[1])
        delta[column] = step
        ahead, behind = (data.residual(model.displaced(sign * delta), unknowns) for sign in (1.0, -1.0))
        np.testing.assert_allclose(by_arm[:, column], (behind - ahead) / (2 * step), rtol=1e-5, atol=1e-2)
    for column, delta in enumerate(np.eye(len(unknowns)) * step):
        ahead, behind = data.residual(model, unknowns + delta), data.residual(model, unknowns - delta)
        np.testing.assert_allclose(by_own[:, column], (behind - ahead) / (2 * step), rtol=1e-5, atol=1e-2)
    assert len(data.unknowns()) == len(unknowns) == by_own.shape[1] == 3 + 6 * len(own)


def test_rows_of_stations_keep_their_places(ur5: Arm) -> None:
    rng = np.random.default_rng(0)
    first, second = tracked(ur5.nominal, 6, rng), wired(ur5.nominal, 5, rng)
    data = Stacked((InstrumentStation(first), InstrumentStation(second, 2)))
    np.testing.assert_array_equal(data.joints, np.concatenate([first.joints, second.joints]))
    assert (
        data.origins.place(7) == ("wire", 2)
        and data.kind == "position+distance"
        and data.source == "tracker 6 and 1 more"
    )
    rows, channels = data.equations()
    np.testing.assert_array_equal(rows, np.concatenate([np.repeat(np.arange(6), 3), np.arange(6, 11)]))
    np.testing.assert_array_equal(channels, np.repeat([0, 1], [18, 5]))
    np.testing.assert_array_equal(data.groups, np.repeat([0, 1], [6, 5]))
    some = data.select(np.array([1, 4, 8]))
    np.testing.assert_array_equal(some.joints, data.joints[[1, 4, 8]])
    np.testing.assert_array_equal(data.select(np.isin(np.arange(11), [1, 4, 8])).joints, some.joints)
    assert len(data.select(np.array([9, 10])).stations) == 1 and data.select(np.array([9])).unknowns() == (
        "anchor_x_2",
        "anchor_y_2",
        "anchor_z_2",
    )
    assert len(data.select(np.arange(0)).joints) == 0
    model = ArmModel.of(ur5.nominal)
    missed = data.misses(model, data.start(model))
    assert missed.shape == (11, 3) and not missed[6:, 1:].any()
    assert data.fingerprint() != some.fingerprint()


def calibrated(arm: Arm, data: Observations | list[Observations], judge: Measurements) -> float:
    """Error of the calibrated arm (mm RMS) as a far tracker sees it, that was not there for the fit.

    All rows are fitted as `calibrate` fits them, and none is held out, which would take as many fits as there are rows.
    """
    rows = given_rows(arm, data)
    aligned = fit_frames(arm, rows, known=False)
    assert aligned is not None
    model = prior_model(arm.name, aligned.geometry, known=False, tolerances=arm.tolerance_class)
    found = fit_geometry(arm, rows, aligned, model).calibration.identified
    seen = align(found, judge, frames_model(found)).arm_model
    return float(1e3 * np.sqrt(np.mean(np.sum(judge.misses(seen, np.zeros(0)) ** 2, axis=1))))


def test_a_second_station_has_a_base_and_a_tool_of_its_own(ur5: Arm) -> None:
    """Half of the rows are of another day, when tracker and target stood elsewhere."""
    rng = np.random.default_rng(4)
    true = bent(ur5)
    other = Pose(np.array([-1.0, 2.0, 0.1]), rotation_matrix(np.array([0.0, 0.1, -2.0])))
    tool = Pose(np.array([-0.02, 0.04, 0.12]), np.eye(3))
    days: list[Observations] = [tracked(true, 60, rng), tracked(true, 60, rng, other, tool)]
    found = calibrate(ur5, days, choices=PLAIN)
    assert found.position["geometric"].rms < 0.13 < 0.5 < found.position["nominal"].rms
    names = [row["name"] for row in found.parameters()]
    assert {"base_x", "base2_x", "tool2_z"} <= set(names)
    units = {row["name"]: row["unit"] for row in found.parameters()}
    assert units["base2_rz"] == "deg" and units["tool2_x"] == "mm"
    with pytest.raises(InputError, match="stations is 'both'; give none, base, tool, base,tool"):
        calibrate(ur5, days, stations="both", choices=PLAIN)


def test_tool_and_base_are_shared_where_asked(ur5: Arm) -> None:
    rng = np.random.default_rng(4)
    true = bent(ur5)
    data = stations_of(ur5, [tracked(true, 40, rng), tracked(true, 40, rng)], ())
    assert data.unknowns() == ()
    assert stations_of(ur5, [wired(true, 40, rng), tracked(true, 40, rng)], ("tool",)).unknowns()[:3] == (
        "anchor_x_2",
        "anchor_y_2",
        "anchor_z_2",
    )


@pytest.mark.parametrize("other", [wired, pytest.param(touched, marks=pytest.mark.slow)], ids=["wire", "touches"])
def test_two_instruments_are_better_than_either_alone(ur5: Arm, other: Callable[..., Observations]) -> None:
    """Few tracker positions, and a wire or touches of one point: mean and worst of three arms are nearer than alone.

    Sixty lengths, where it was 120, and by a tenth, where it was a fifth: with priors 120 lengths alone tell the arm to
    0.09 mm, and the positions, five times as coarse, have nothing to add.
    """
    alone, second, both = [], [], []
    for seed in range(3):
        rng = np.random.default_rng(10 + seed)
        true = bent(ur5, seed)
        judge = tracked(true, 300, rng, noise=1e-6)
        few, more = tracked(true, 16, rng, noise=2e-4), other(true, 60, rng)
        alone.append(calibrated(ur5, few, judge))
        second.append(calibrated(ur5, more, judge))
        both.append(calibrated(ur5, [few, more], judge))
    assert np.mean(both) < 0.9 * min(np.mean(alone), np.mean(second)) and max(both) < min(max(alone), max(second))


def three_stations(arm: Arm) -> Stacked:
    """Six positions, five lengths of a wire whose zero is nearly known, four positions: the last with frames."""
    rng = np.random.default_rng(1)
    wires = replace(wired(arm.nominal, 5, rng), zero_std=1e-3, scale_std=1e-3)
    sets = (tracked(arm.nominal, 6, rng), wires, tracked(arm.nominal, 4, rng))
    stations = (InstrumentStation(sets[0]), InstrumentStation(sets[1], 2, scale=1.5))
    return Stacked((*stations, InstrumentStation(sets[2], 3, FAR, TARGET)))


def test_equations_that_belong_to_no_row_stay_so_and_channels_are_each_stations_own(ur5: Arm) -> None:
    data = three_stations(ur5)
    rows, channels = data.equations()
    first, second, third = np.repeat(np.arange(6), 3), [*range(6, 11), -1, -1], np.repeat(np.arange(11, 15), 3)
    np.testing.assert_array_equal(rows, np.concatenate([first, second, third]))
    wire_channels = data.parts[1].equations()[1]
    np.testing.assert_array_equal(channels, np.concatenate([np.zeros(18), 1 + wire_channels, np.full(12, 2)]))
    assert data.channels_of(data.select([6, 7])).tolist() == [1] and data.channels_of(data).tolist() == [0, 1, 2]
    np.testing.assert_array_equal(data.groups, np.repeat([0, 1, 2], [6, 5, 4]))
    np.testing.assert_array_equal(data.rows_of_misses, np.arange(15))
    one = Stacked((InstrumentStation(data.parts[0].select(np.arange(0))), data.stations[1]))
    assert one.channels_of(one).tolist() == [0] and one.groups.tolist() == [0] * 5


def test_unknowns_of_each_station_are_told_apart(ur5: Arm) -> None:
    data, model = three_stations(ur5), ArmModel.of(ur5.nominal)
    wires = data.parts[1]
    own = [f"{name}_2" for name in wires.unknowns()]
    frames = [f"{frame}3_{name}" for frame in ("base", "tool") for name in ("x", "y", "z", "rx", "ry", "rz")]
    assert list(data.unknowns()) == own + frames and InstrumentStation(wires).unknowns() == wires.unknowns()
    frame = [LENGTH_TOLERANCE] * 3 + [ANGLE_TOLERANCE] * 3
    np.testing.assert_array_equal(data.tolerances(), [*wires.tolerances(), *frame, *frame])
    np.testing.assert_array_equal(data.start(model), [*wires.start(model), *np.zeros(12)])
    values = data.start(model) + 1e-3 * np.arange(1.0, len(own) + 13.0)
    left = data.residual(model, values)
    np.testing.assert_array_equal(left[:18], data.parts[0].residual(model, np.zeros(0)))
    np.testing.assert_allclose(left[18:25], wires.residual(model, values[: len(own)]) / 1.5)
    base, tool = (FAR, TARGET)
    there = replace(
        ur5.nominal,
        base=move_pose(base, values[len(own) : len(own) + 6]),
        tool=move_pose(tool, values[len(own) + 6 :]),
    )
    np.testing.assert_allclose(left[25:], data.parts[2].residual(ArmModel.of(there), np.zeros(0)))


def test_rows_at_the_ends_of_stations_are_selected_from_their_own(ur5: Arm) -> None:
    data = three_stations(ur5)
    for rows in ([0, 5], [5, 6], [6, 10], [10, 11], [0, 11, 14], list(range(15))):
        some = data.select(np.array(rows))
        np.testing.assert_array_equal(some.joints, data.joints[rows])
        assert [station.number for station in some.stations] == sorted({1 + (row > 5) + (row > 10) for row in rows})


def test_stations_are_weighed_relative_to_the_first_over_what_they_weighed(ur5: Arm) -> None:
    data = three_stations(ur5).weighed(np.array([2.0, 3.0, 5.0]))
    assert [station.scale for station in data.stations] == [1.0, 2.25, 2.5]
    model = ArmModel.of(ur5.nominal)
    by_arm, by_own = InstrumentStation(data.parts[1], 2, scale=2.0).jacobian(model, data.parts[1].start(model))
    whole = data.parts[1].jacobian(model, data.parts[1].start(model))
    np.testing.assert_allclose(by_arm, whole[0] / 2.0)
    np.testing.assert_allclose(by_own, whole[1] / 2.0)


@pytest.mark.parametrize("own", [(), ("base",), ("tool",), ("base", "tool")], ids="+".join)
def test_only_what_has_a_frame_sees_another_base_and_the_tool_starts_where_it_is_seen(
    ur5: Arm, own: tuple[str, ...]
) -> None:
    """Exact rows of an exact arm; a wire has no frame, so that its tool starts as the arm's own."""
    rng = np.random.default_rng(3)
    there = tracked(ur5.nominal, 30, rng, noise=0.0)
    there = replace(there, position_std=1e-5)
    data = stations_of(ur5, [wired(ur5.nominal, 9, rng), tracked(ur5.nominal, 9, rng), there], own)
    assert [station.number for station in data.stations] == [1, 2, 3]
    assert [type(part) for part in data.parts] == [Measurements, Measurements, DistanceObservations]
    second, third = data.stations[1:]
    assert (second.base is not None) == ("base" in own) and (second.tool is not None) == ("tool" in own)
    if second.base is not None:
        np.testing.assert_allclose(second.base.position, FAR.position, atol=1e-6)
        np.testing.assert_allclose(second.base.rotation, FAR.rotation, atol=1e-6)
    if second.tool is not None:
        np.testing.assert_allclose(second.tool.position, TARGET.position, atol=1e-6)
    assert third.base is None and third.tool is (ur5.nominal.tool if "tool" in own else None)


@pytest.mark.slow
def test_a_rough_start_is_one_however_badly_the_arm_fits(ur5: Arm) -> None:
    """Whether it fits is judged later, by rows that agree; stations start where their first one is."""
    rng = np.random.default_rng(3)
    worse = ur5.nominal.displaced(0.3 * rng.normal(size=5 * ur5.nominal.links + 12))
    data = tracked(worse, 30, rng)
    with pytest.raises(InputError, match="after fitting base and tool"):
        align(ur5.nominal, data, frames_model(ur5.nominal))
    found = rough_start(ur5.nominal, data)
    near = tracked(ur5.nominal, 30, rng)
    both = Stacked((InstrumentStation(near), InstrumentStation(data, 2)))
    start, alone = rough_start(ur5.nominal, both), rough_start(ur5.nominal, near)
    np.testing.assert_array_equal(start.base.position, alone.base.position)
    assert np.abs(start.base.position - found.base.position).max() > 1e-3
    np.testing.assert_allclose(start.base.position, FAR.position, atol=1e-3)
