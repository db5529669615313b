"""Joints that remember: the play operator and what backlash, friction and drives do with it."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from pickenv.arm import Load, Passage, forward, load_plant
from pickenv.arm.effects.drives import Encoder, Servo
from pickenv.arm.effects.structure import Backlash, StickBand, one_stop, play

WAYS = st.lists(st.floats(-1, 1), min_size=1, max_size=30)
GAPS = st.floats(0, 0.3)
NONE = (0.0,) * 6
BARE = load_plant("geometry_only")
START = [0.1, 0.3, 0.4, 0.0, 0.1, 0.2]


def behind(gap, torques, entries, outputs):
    """Joints behind their gaps, of motors and joints before."""
    at = SimpleNamespace(m=math, load=torques is not None, pull=([], torques), joints=entries)
    return list(gap.carry(at, outputs, 0.1))


def resting(m, encoder, q):
    """Motors in whole counts."""
    at = Passage(m, BARE.chain, None, q)
    encoder.act(at, ())
    return at.motor


def follow(way, lag, lead, output=0.0):
    outputs = []
    for entry in way:
        output = play(math, entry, output, lag, lead)
        outputs.append(output)
    return outputs


@given(way=WAYS, lag=GAPS, lead=GAPS)
def test_the_output_stays_within_the_gap(way, lag, lead):
    for entry, output in zip(way, follow(way, lag, lead), strict=True):
        assert entry - lag <= output <= entry + lead


@given(way=WAYS, lag=GAPS, lead=GAPS)
def test_the_output_moves_no_more_than_it_must(way, lag, lead):
    before = 0.0
    for entry, output in zip(way, follow(way, lag, lead), strict=True):
        if entry - lag <= before <= entry + lead:
            assert output == before
        before = output


@given(way=WAYS, lag=GAPS, lead=GAPS)
def test_only_where_the_input_turned_counts_not_how_fast_it_went(way, lag, lead):
    halfway = [middle for a, b in zip([0.0, *way], way, strict=False) for middle in (0.5 * (a + b), b)]
    assert follow(way, lag, lead)[-1] == pytest.approx(follow(halfway, lag, lead)[-1], abs=1e-15)


@given(way=WAYS, lag=GAPS, lead=GAPS, first=st.floats(-1, 1), second=st.floats(-1, 1))
def test_two_histories_never_drift_apart_and_a_long_way_wipes_them_out(way, lag, lead, first, second):
    apart = [abs(a - b) for a, b in zip(follow(way, lag, lead, first), follow(way, lag, lead, second), strict=True)]
    assert all(later <= earlier + 1e-15 for earlier, later in zip([abs(first - second), *apart], apart, strict=False))
    far = [*way, 3.0]
    assert follow(far, lag, lead, first)[-1] == follow(far, lag, lead, second)[-1] == 3.0 - lag


@given(way=WAYS, lag=GAPS, lead=GAPS)
def test_executors_agree_on_play(way, lag, lead):
    floats = follow(way, lag, lead)
    arrays, tensors = np.zeros(3), torch.zeros(3, dtype=torch.float64)
    for entry, output in zip(way, floats, strict=True):
        arrays = play(np, np.full(3, entry), arrays, lag, lead)
        tensors = play(torch, torch.full((3,), entry, dtype=torch.float64), tensors, lag, lead)
        assert arrays.tolist() == tensors.tolist() == [output] * 3


def test_a_gap_that_gravity_holds_closed_does_not_flip():
    gap = Backlash((0.02,), (5.0,))
    output = [0.0]
    for entry in (0.1, 0.3, -0.2, 0.1):
        output = behind(gap, [7.0], [entry], output)
        assert output == [entry + 0.01]
        assert behind(gap, [-7.0], [entry], output) == [entry - 0.01]


def test_a_gap_without_preload_flips_on_reversal():
    gap = Backlash((0.02,), (5.0,))
    up = behind(gap, [4.0], [0.3], [0.0])
    assert up == pytest.approx([0.29])
    assert behind(gap, [-4.0], [0.28], up) == up
    assert behind(gap, None, [0.1], up) == pytest.approx([0.11])


def test_what_loses_its_preload_stays_on_its_side_until_pushed():
    gap = Backlash((0.02,), (5.0,))
    held = behind(gap, [7.0], [0.3], [0.0])
    assert behind(gap, [1.0], [0.3], held) == held


def approached(plant, target, start):
    state = plant.initial_state(math, start)
    state, _ = plant.advance(math, state, start, 0.1)
    return np.array(plant.advance(math, state, target, 0.1)[1][9:])


def test_an_arm_with_backlash_ends_elsewhere_when_it_comes_from_the_other_side():
    plant = BARE.with_effect(Backlash((0.0, 1e-4, 0.0, 0.0, 0.0, 0.0), NONE))
    below, above = ([*START[:1], START[1] + way, *START[2:]] for way in (-0.05, 0.05))
    apart = approached(plant, START, above) - approached(plant, START, below)
    assert np.linalg.norm(apart) == pytest.approx(1e-4, rel=1e-9)


def test_gravity_holds_the_pitch_joint_to_one_side_whichever_way_it_comes():
    """The arm hangs in front of J1, whose gap of 2 mrad then opens to the side that the torque pushes to."""
    load = Load((0.0,) * 5 + (2.0,), ((0.0, 0.0, 0.0),) * 6, 0.0)
    plant = replace(BARE, load=load).with_effect(Backlash((2e-3, *NONE[1:]), (5.0, *NONE[1:])))
    start = [0.1, 0.3, 0.7, 0.0, 0.1, 0.2]
    ends = [approached(plant, start, [start[0] + way, *start[1:]]) for way in (-0.1, 0.1)]
    np.testing.assert_array_equal(*ends)
    shifted = [forward(plant.geometry, [start[0] + half, *start[1:]]).position for half in (-1e-3, 1e-3)]
    lower = min(shifted, key=lambda position: position[2])
    np.testing.assert_allclose(ends[0], lower, atol=1e-12)
    np.testing.assert_allclose(plant.tool_pose(start).position, lower, atol=1e-12)


def test_friction_stops_a_joint_short_by_another_distance_in_each_direction():
    plant = BARE.with_effect(StickBand((0.0, 3e-4, *NONE[2:]), (0.0, 1e-4, *NONE[2:])))
    below, above = ([START[0], START[1] + way, *START[2:]] for way in (-0.05, 0.05))
    settled = plant.tool_pose(START).position
    near, far = (forward(plant.geometry, [START[0], out, *START[2:]]).position for out in (0.0, 1.0))
    rail = far - near
    true = forward(plant.geometry, START).position
    np.testing.assert_allclose((approached(plant, START, below) - true) @ rail, -3e-4, atol=1e-12)
    np.testing.assert_allclose((approached(plant, START, above) - true) @ rail, 1e-4, atol=1e-12)
    np.testing.assert_allclose((settled - true) @ rail, -1e-4, atol=1e-12)


def test_friction_scatters_from_stop_to_stop_by_its_share_and_never_pulls():
    band = StickBand((3e-4, 0.0), (1e-4, 2e-4), scatter=0.2)
    rng = np.random.default_rng(0)

    def stop(band):
        return one_stop(math, band, rng.normal(size=(2, 2)).tolist())

    stops = np.array([[some.forward, some.backward] for some in (stop(band) for _ in range(4000))])
    mean = np.array([band.forward, band.backward])
    np.testing.assert_allclose(stops.mean(axis=0), mean, rtol=0.02)
    np.testing.assert_allclose(stops.std(axis=0), 0.2 * mean, rtol=0.05)
    assert min(min(stop(replace(band, scatter=3.0)).forward) for _ in range(100)) == 0.0
    assert stop(replace(band, scatter=0.0)) == replace(band, scatter=0.0)


@given(st.lists(st.floats(-3, 3), min_size=2, max_size=2))
def test_a_drive_rests_on_the_nearest_count(q):
    counts = Encoder((1e-3, 2.5e-4))
    held = resting(math, counts, q)
    for value, rest, count in zip(q, held, counts.resolution, strict=True):
        assert abs(value - rest) <= count / 2 + 1e-15
        assert rest / count == pytest.approx(round(rest / count), abs=1e-9)
    assert resting(np, counts, [np.array([v]) for v in q]) == [np.array([v]) for v in held]


@pytest.mark.parametrize("dt", [0.0, 0.01, 0.02, 0.5])
def test_the_servo_closes_its_gap_exponentially(dt):
    lagging = Servo((0.02,)).carry(SimpleNamespace(m=math, motor=[1.0]), [0.0], dt)
    assert list(lagging) == pytest.approx([1 - math.exp(-dt / 0.02)])


def test_at_constant_speed_the_following_error_is_speed_times_time_constant():
    plant = BARE.with_effect(Servo((0.02,) * 6))
    state = plant.initial_state(math, START)
    for step in range(1, 2001):
        q = [START[0], START[1] + 1e-4 * step, *START[2:]]
        state, _ = plant.advance(math, state, q, 1e-3)
    lag = q[1] - plant.readings(math, state, q)[1]
    assert lag == pytest.approx(0.1 * 0.02, rel=0.03)  # a staircase of 1 ms leads a ramp by half a step


def test_encoders_see_the_motor_and_nothing_behind_it():
    plant = load_plant("orchard")
    blind = plant.without(["encoder"])
    state = blind.initial_state(math, START)
    moving = [0.2, 0.35, 0.5, -0.1, 0.05, 0.3]
    state, _ = blind.advance(math, state, moving, 0.05)
    motor = [b + (a - b) * math.exp(-0.05 / 0.02) for a, b in zip(START, moving, strict=True)]
    assert blind.readings(math, state, moving) == pytest.approx(motor, abs=1e-12)
    counts = plant.effect("encoder").resolution
    state, _ = plant.advance(math, plant.initial_state(math, START), moving, 0.05)
    for reading, value, count in zip(plant.readings(math, state, moving), motor, counts, strict=True):
        assert abs(reading - value) <= count + 1e-12
        assert reading / count == pytest.approx(round(reading / count), abs=1e-6)  # in whole counts, on the way too
    assert BARE.readings(math, BARE.initial_state(math, START), START) == START
