"""A measuring campaign in time: what the arm's stops, the hour and the instrument each put into the rows."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from pickenv.arm import (
    Instrument,
    Iso9283Settings,
    MeasurementNoise,
    Pace,
    Pose,
    draw_plants,
    forward,
    inverse,
    iso9283,
    largest_cube,
    load_instrument,
    load_plant,
    load_tolerances,
    normal_draws,
    plant_at,
    plants_on,
    pose_error,
    pose_of,
    rotation_matrix,
    shipped_effects,
)
from pickenv.arm.effects.drives import read_frame
from pickenv.arm.plant import campaign
from pickenv.arm.plant.campaign import visited
from pickenv.base import InputError
from pickenv.calibration import random_joints, simulated_tracker

EFFECTS = shipped_effects()

ORCHARD = load_plant("orchard")
NOMINAL = ORCHARD.arm.nominal
TRACKER = load_instrument("laser_tracker")
EXACT = replace(TRACKER, noise=MeasurementNoise(0.0, 0.0))


def only(*effects, plant=ORCHARD):
    return plant.without([name for name in EFFECTS if name not in effects])


def seen(plant, joints, instrument, seed=0):
    return simulated_tracker(plant, joints, np.random.default_rng(seed), instrument)


def anywhere(count, seed=1):
    return random_joints(NOMINAL, count, np.random.default_rng(seed))


def between(poses, home):
    """Visits to one pose, each from another of the poses."""
    visits = np.repeat(poses, 2, axis=0)
    visits[1::2] = home
    return visits


def scatter_mm(position):
    return 1e3 * np.sqrt(((position - position.mean(axis=0)) ** 2).sum(axis=1).mean())


def test_fifty_visits_to_a_pose_scatter_as_the_arm_does():
    """And not as the instrument, 0.03 mm, which sees an arm at rest for ever; at one pose in eight by up to 0.4 mm."""
    real, ideal = [], []
    for seed in range(8):
        poses = anywhere(51, seed)
        visits = between(poses[1:], poses[0])
        real.append(scatter_mm(seen(ORCHARD, visits, "laser_tracker").position[1::2]))
        ideal.append(scatter_mm(seen(ORCHARD, visits, "ideal").position[1::2]))
    assert 0.1 < np.median(real) < 0.25
    assert 0.1 < min(real) < max(real) < 0.5
    assert max(ideal) < 0.04


def test_iso9283_and_calibration_data_agree_on_repeatability():
    cube, pace = largest_cube(NOMINAL, steps=12), Pace(period=0.1, dwell=2.0)
    settings = Iso9283Settings(pace=pace, drift_cycles=2, drift_interval=3600.0)
    found = iso9283(ORCHARD, rng=np.random.default_rng(0), settings=settings, cube=cube).raw
    targets = inverse(NOMINAL, cube.inclined_plane()).joints
    same = replace(TRACKER, dwell=pace.dwell, period=pace.period, warm_up=settings.warm_up)
    rows = seen(ORCHARD, np.tile(targets[::-1], (31, 1)), same, seed=5).position.reshape(31, 5, 3)[1:, ::-1]
    away = np.linalg.norm(rows - rows.mean(axis=0), axis=-1)
    own = 1e3 * (away.mean(axis=0) + 3.0 * away.std(axis=0, ddof=1))
    by_standard = [pose["repeatability_mm"] for pose in found["poses"]]
    assert np.mean(own) == pytest.approx(np.mean(by_standard), rel=0.15)
    np.testing.assert_allclose(own, by_standard, rtol=0.5)


def test_friction_stops_each_joint_short_on_the_side_that_it_came_from():
    plant = only("stick_band")
    plant = plant.with_effect(replace(plant.effect("stick_band"), scatter=0.0))
    joints = anywhere(40)
    before = np.vstack([(NOMINAL.lower + NOMINAL.upper) / 2, joints[:-1]])
    band = plant.effect("stick_band")
    stops = np.where(joints > before, joints - band.forward, joints + np.array(band.backward))
    rows = seen(plant, joints, EXACT)
    np.testing.assert_allclose(rows.position, forward(plant.geometry, stops).position, rtol=0, atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_first_stop_is_come_to_from_the_middle_of_the_joints_ranges(sign):
    plant = only("stick_band")
    plant = plant.with_effect(replace(plant.effect("stick_band"), scatter=0.0))
    middle = (NOMINAL.lower + NOMINAL.upper) / 2
    assert np.abs(middle).max() > 0.1
    band = plant.effect("stick_band")
    short = np.array(band.forward) if sign > 0 else -np.array(band.backward)
    joints = middle + 5e-3 * sign
    frame = visited(plant, np, joints[None], EXACT, np.zeros((1, 2, 6)))
    np.testing.assert_allclose(
        np.stack(frame, axis=-1)[0, 9:], forward(plant.geometry, joints - short).position, rtol=0, atol=1e-12
    )


def test_the_pace_is_the_instruments_and_one_arm_runs_on_floats(monkeypatch):
    paces, kinds, move = [], [], campaign.moved

    def noted(plant, m, state, here, target, pace, *more):
        paces.append(pace)
        kinds.append(m)
        return move(plant, m, state, here, target, pace, *more)

    monkeypatch.setattr(campaign, "moved", noted)
    slow = replace(EXACT, period=0.25, dwell=7.0)
    visited(ORCHARD, np, anywhere(2), slow, np.zeros((2, 2, 6)))
    many = draw_plants(ORCHARD, load_tolerances("medium"), 2, np.random.default_rng(0))
    visited(many, np, np.stack([anywhere(1)] * 2, axis=1), slow, np.zeros((1, 2, 6, 2)))
    assert [(pace.period, pace.dwell) for pace in paces] == [(0.25, 7.0)] * 3
    assert kinds == [math, math, np]


def test_no_poses_are_no_frames_and_an_instrument_has_no_time_but_its_own():
    for plant in (ORCHARD, load_plant("geometry_only")):
        frame = visited(plant, np, np.zeros((0, 6)), EXACT, np.zeros((0, 2, 6)))
        assert len(frame) == 12 and all(np.shape(part) == (0,) for part in frame)
    bare = Instrument("bare", stand=(0.0, 0.0, 0.0))
    assert (bare.dwell, bare.warm_up, bare.period, bare.noise) == (None, 0.0, Pace.period, None)
    assert MeasurementNoise(1e-4, 1e-3) == MeasurementNoise(1e-4, 1e-3, range_std=0.0, centring_std=0.0)
    assert bare.noise_on(ORCHARD) is ORCHARD.effect("measurement_noise")
    assert EXACT.noise_on(ORCHARD) is EXACT.noise


def test_the_other_order_of_visits_has_another_history():
    joints = anywhere(40)
    for plant, differ in ((only("stick_band", "backlash"), True), (load_plant("qiao2026"), False)):
        there, back = (seen(plant, order, EXACT).position for order in (joints, joints[::-1]))
        apart = np.linalg.norm(there - back[::-1], axis=1)
        assert np.median(apart) > 3e-5 if differ else apart.max() == 0.0


def test_the_ideal_instrument_sees_the_settled_pose():
    joints = anywhere(30)
    rows = seen(ORCHARD, joints, replace(load_instrument("ideal"), noise=EXACT.noise))
    settled = ORCHARD.tool_pose(joints)
    np.testing.assert_allclose(rows.position, settled.position, rtol=0, atol=1e-15)
    np.testing.assert_allclose(rows.rotation, settled.rotation, rtol=0, atol=1e-15)


def test_a_cold_machine_is_measured_elsewhere_than_a_warm_one():
    plant, joints = only("thermal_growth"), anywhere(20)
    warm, thermal = plant.tool_pose(joints).position, plant.effect("thermal_growth")

    def away(hours):
        rows = seen(plant, joints, replace(EXACT, warm_up=3600.0 * hours))
        return 1e3 * np.linalg.norm(rows.position - warm, axis=1)

    cold, hour, day = away(0.0), away(1.0), away(24.0)
    assert 0.3 < cold.mean() < 2.0
    np.testing.assert_allclose(hour / cold, np.exp(-3600.0 / thermal.time_constant), rtol=1e-3)
    assert day.max() < 1e-3


@pytest.mark.parametrize("effect", ["thermal_growth", "base_tilt"])
def test_the_arm_warms_up_and_sinks_while_it_is_measured(effect):
    """What is left of the way to where it ends in the long run fades with the effect's own time constant."""
    plant, joints = only(effect), np.tile(anywhere(1), (200, 1))
    left = np.linalg.norm(seen(plant, joints, EXACT).position - plant.tool_pose(joints[0]).position, axis=1)
    faded = np.exp(-EXACT.dwell * np.arange(200) / plant.effect(effect).time_constant)
    np.testing.assert_allclose(left / left[0], faded, rtol=1e-3)


@pytest.mark.parametrize("distance", [1.0, 40.0, 100.0])
def test_noise_grows_with_the_range(distance):
    pose = NOMINAL.lower * 0.5 + NOMINAL.upper * 0.5
    plant = load_plant("geometry_only")
    true = plant.tool_pose(pose)
    noise = MeasurementNoise(15e-6, 2e-4, range_std=0.7e-6)
    instrument = Instrument("far", stand=tuple(true.position + np.array([0.0, distance, 0.0])), noise=noise)
    rows = seen(plant, np.tile(pose, (20_000, 1)), instrument)
    error = pose_error(true, Pose(rows.position, rows.rotation))
    expected = [15e-6 + 0.7e-6 * distance] * 3 + [2e-4] * 3
    np.testing.assert_allclose(error.std(axis=0), expected, rtol=0.03)
    np.testing.assert_allclose(error.mean(axis=0) / error.std(axis=0), 0, rtol=0, atol=0.03)
    assert rows.position_std == pytest.approx(expected[0], rel=1e-3) and rows.attitude_std == 2e-4


def test_a_target_mounted_once_errs_alike_in_all_its_readings_in_the_tools_axes():
    plant, joints = load_plant("geometry_only"), anywhere(60)
    true = plant.tool_pose(joints)
    instrument = Instrument("ball", stand=(0.0, 0.0, 0.0), noise=MeasurementNoise(0.0, 0.0, centring_std=12.7e-6))
    offsets = []
    for seed in range(300):
        rows = seen(plant, joints, instrument, seed)
        aside = np.einsum("pij,pi->pj", true.rotation, rows.position - true.position)
        np.testing.assert_allclose(aside, np.tile(aside[0], (60, 1)), rtol=0, atol=1e-15)
        offsets.append(aside[0])
    np.testing.assert_allclose(np.std(offsets, axis=0), 12.7e-6, rtol=0.15)


def test_a_reading_is_the_target_beside_its_point_and_displaced_by_as_much_as_its_range_says():
    """Of one reading, by hand: along the tool's axes by the mounting, then by normal numbers times deviations."""
    rng = np.random.default_rng(3)
    rotation, position, stand = rotation_matrix(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3)
    reading, mounting = rng.normal(size=6), rng.normal(size=3)
    noise = MeasurementNoise(1e-4, 2e-3, range_std=3e-5, centring_std=4e-2)
    frame = (*rotation.T.ravel(), *position)
    seen = pose_of(read_frame(np, noise, tuple(stand), frame, reading, mounting))
    target = position + rotation @ (4e-2 * mounting)
    deviation = 1e-4 + 3e-5 * np.linalg.norm(target - stand)
    np.testing.assert_allclose(seen.position, target + deviation * reading[:3], rtol=0, atol=1e-14)
    turned = rotation_matrix(2e-3 * reading[3:]) @ rotation
    np.testing.assert_allclose(seen.rotation, turned, rtol=0, atol=1e-6)


def test_an_instruments_own_noise_stands_in_place_of_the_plants():
    plant, joints = load_plant("qiao2026"), np.tile(anywhere(1), (5000, 1))
    coarse = replace(TRACKER, noise=MeasurementNoise(1e-4, 1e-3))
    np.testing.assert_allclose(seen(plant, joints, coarse).position.std(axis=0), 1e-4, rtol=0.05)
    assert seen(plant, joints, coarse).position_std == 1e-4
    own = seen(plant, joints, TRACKER)
    stated = plant.effect("measurement_noise")
    distance = np.linalg.norm(plant.tool_pose(joints[0]).position - TRACKER.stand)
    np.testing.assert_allclose(own.position.std(axis=0), stated.position_std + stated.range_std * distance, rtol=0.05)


def test_one_seed_gives_one_campaign_and_its_readings_do_not_hang_on_the_arm():
    joints = anywhere(8)
    first, again, other = (seen(ORCHARD, joints, "laser_tracker", seed) for seed in (3, 3, 4))
    assert first.fingerprint() == again.fingerprint() != other.fingerprint()
    rng, alone = np.random.default_rng(3), np.random.default_rng(3)
    drawn = normal_draws(ORCHARD, 8, rng)
    np.testing.assert_array_equal(drawn.reading, alone.normal(size=(8, 6)))
    assert rng.random() == alone.random()  # what the arm draws takes nothing from who goes on drawing


def test_stops_are_drawn_only_where_friction_scatters():
    calm = ORCHARD.with_effect(replace(ORCHARD.effect("stick_band"), scatter=0.0))
    for plant, drawn in ((ORCHARD, True), (calm, False), (ORCHARD.without(["stick_band"]), False)):
        stops = normal_draws(plant, 7, np.random.default_rng(0)).stops
        assert stops.shape == (7, 2, 6) and (len(np.unique(stops)) == 84 if drawn else not stops.any())


@pytest.mark.parametrize("backend", ["numpy", "torch"])
def test_many_arms_at_once_stop_where_each_stops_alone(backend):
    arms, poses = 4, 6
    plants = draw_plants(ORCHARD, load_tolerances("medium"), arms, np.random.default_rng(0))
    joints = np.stack([anywhere(poses, seed) for seed in range(arms)], axis=1)
    stops = np.random.default_rng(9).normal(size=(poses, 2, 6, arms))
    if backend == "torch":
        there = plants_on(plants, torch.as_tensor)
        frame = visited(there, torch, joints, TRACKER, stops, torch.as_tensor)
    else:
        frame = visited(plants, np, joints, TRACKER, stops)
    together = np.stack([np.asarray(value) for value in frame], axis=-1)
    for i in range(arms):
        alone = visited(plant_at(plants, i), np, joints[:, i], TRACKER, stops[..., i])
        np.testing.assert_allclose(together[:, i], np.stack(alone, axis=-1), rtol=0, atol=1e-12)


def test_a_campaign_of_fewer_poses_is_the_beginning_of_a_longer_one():
    joints, draws = anywhere(9), normal_draws(ORCHARD, 9, np.random.default_rng(0))
    whole = pose_of(visited(ORCHARD, np, joints, TRACKER, draws.stops))
    part = pose_of(visited(ORCHARD, np, joints[:4], TRACKER, draws.first(4).stops))
    np.testing.assert_array_equal(part.position, whole.position[:4])


def test_shipped_instruments_load_under_their_own_names_and_others_are_refused(tmp_path):
    assert [load_instrument(name).name for name in ("ideal", "laser_tracker")] == ["ideal", "laser_tracker"]
    assert load_instrument("ideal").dwell is None
    with pytest.raises(InputError, match=r"unknown instrument 'ruler'.*ideal.*laser_tracker"):
        load_instrument("ruler")
    own = tmp_path / "camera.toml"
    own.write_text(
        "stand_mm = [0.0, 0.0, 0.0]\ndwell_s = 1.0\n[noise]\nposition_std_mm = 0.5\nattitude_std_deg = 0.1\n",
        encoding="utf-8",
    )
    camera = load_instrument(own)
    assert (camera.name, camera.dwell, camera.noise.position_std) == ("camera", 1.0, 5e-4)
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("stand_mm = [0.0, 0.0, 0.0]\ndwell_s = -1.0\n", encoding="utf-8")
    with pytest.raises(InputError, match="dwell_s"):
        load_instrument(wrong)
