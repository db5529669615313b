"""Vibration after a move: the exact step against the textbook's oscillator and against a numerical integration."""

import math
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pickenv.arm import Pace, load_plant, moved
from pickenv.arm.effects.ground import Settling
from pickenv.arm.plant.campaign import commands, move_time

FREQUENCY, ZETA, SHARE, RISE = 6.0, 0.03, 0.4, 0.05
MODE = Settling((FREQUENCY,), (ZETA,), (SHARE,), RISE)
OMEGA = 2 * math.pi * FREQUENCY


class Swing(NamedTuple):
    """Profile, vibration and velocity of one joint's mode."""

    profile: float
    vibration: float
    rate: float


def at_rest(q):
    return Swing(*MODE.begin(SimpleNamespace(command=[q])))


def step(swing, q, dt, mode=MODE):
    return Swing(*mode.carry(SimpleNamespace(m=math, command=[q]), tuple(swing), dt))


def test_at_rest_it_stays_at_rest():
    assert step(at_rest(0.7), 0.7, 3.0) == Swing(0.7, 0.0, 0.0)


@pytest.mark.parametrize("time", [0.01, 0.05, 0.3, 1.0, 4.0])
def test_a_free_swing_is_the_damped_oscillator_of_the_textbook(time):
    swing = step(Swing(0.0, 1e-3, 0.0), 0.0, time)
    damped = OMEGA * math.sqrt(1 - ZETA**2)
    decay = math.exp(-ZETA * OMEGA * time)
    expected = 1e-3 * decay * (math.cos(damped * time) + ZETA * OMEGA / damped * math.sin(damped * time))
    assert swing.vibration == pytest.approx(expected, abs=1e-15)
    assert swing.rate == pytest.approx(-1e-3 * decay * OMEGA**2 / damped * math.sin(damped * time), abs=1e-13)


def test_peaks_shrink_by_the_logarithmic_decrement():
    period = 2 * math.pi / (OMEGA * math.sqrt(1 - ZETA**2))
    peaks = [step(Swing(0.0, 1e-3, 0.0), 0.0, k * period).vibration for k in range(5)]
    decrement = 2 * math.pi * ZETA / math.sqrt(1 - ZETA**2)
    assert [math.log(a / b) for a, b in pairwise(peaks)] == pytest.approx([decrement] * 4)


@pytest.mark.parametrize("time", [0.02, 0.1, 0.6])
def test_a_commanded_step_agrees_with_numerical_integration(time):
    """In z = e + p x, which no command makes jump: z'' = -2 zeta omega (z' - p x') - omega^2 (z - p x)."""

    def slope(_, y):
        x, z, rate = y
        speed = (1.0 - x) / RISE
        return [speed, rate, -2 * ZETA * OMEGA * (rate - SHARE * speed) - OMEGA**2 * (z - SHARE * x)]

    x, z, rate = solve_ivp(slope, (0, time), [0.0, 0.0, 0.0], rtol=1e-11, atol=1e-13).y[:, -1]
    swing = step(at_rest(0.0), 1.0, time)
    assert swing == pytest.approx((x, z - SHARE * x, rate), abs=1e-8)


def test_a_held_command_may_be_cut_into_any_steps():
    whole = step(at_rest(0.0), 1.0, 0.7)
    for parts in (2, 7, 100):
        swing = at_rest(0.0)
        for _ in range(parts):
            swing = step(swing, 1.0, 0.7 / parts)
        assert swing == pytest.approx(whole, abs=1e-12)


def test_it_dies_out_however_it_was_driven():
    swing = at_rest(0.0)
    for q in np.random.default_rng(0).uniform(-1, 1, 50).tolist():
        swing = step(swing, q, 0.1)
    assert abs(swing.vibration) > 1e-3
    assert step(swing, q, 60.0) == pytest.approx((q, 0.0, 0.0), abs=1e-12)


def vibration(plant, speed, dwell):
    bare = plant.without(["settling"])
    start, target = [0.0, 0.1, 0.2, 0.0, 0.1, 0.0], [0.3, 0.5, 0.6, -0.3, 0.05, 0.5]
    pace = Pace(speed=speed, dwell=dwell)
    ends = [np.array(moved(p, math, p.initial_state(math, start), start, target, pace)[1][9:]) for p in (plant, bare)]
    return 1e3 * np.linalg.norm(ends[0] - ends[1])


def test_speed_costs_accuracy_and_waiting_pays_it_back():
    plant = load_plant("orchard")
    fast = [max(vibration(plant, 1.0, wait + 0.02 * k) for k in range(12)) for wait in (0.0, 0.5, 1.0, 2.0)]
    slow = max(vibration(plant, 0.1, 0.02 * k) for k in range(12))
    assert all(later < earlier for earlier, later in pairwise(fast))
    assert 0.3 < fast[0] < 4.0
    assert slow < fast[0] / 3


def test_moves_keep_to_the_speeds_and_each_takes_its_own_time():
    plant = load_plant("orchard")
    rng = np.random.default_rng(3)
    lower, upper = plant.arm.nominal.lower, plant.arm.nominal.upper
    start, target = rng.uniform(lower, upper, (2, 20, 6))
    pace = Pace(speed=0.5, period=0.05, dwell=0.3)
    given = list(commands(plant, start, target, pace))
    way = [start, *(q for q, _ in given)]
    for before, after in pairwise(way):
        assert np.all(np.abs(after - before) <= 0.5 * plant.arm.speed * 0.05 * (1 + 1e-9))
    np.testing.assert_array_equal(given[-2][0], target)
    assert given[-1][1] == 0.3
    late = sum(time for _, time in given[:-1]) - move_time(plant, start, target, pace)
    assert np.all((late >= 0) & (late < 0.05))
    for i in range(20):  # one of many is told what it is told alone
        alone = list(commands(plant, start[i], target[i], pace))
        mine = [(q[i], time[i]) for q, time in given[:-1] if time[i] > 0]
        np.testing.assert_array_equal([q for q, _ in mine], [q for q, _ in alone[:-1]])
        assert [time for _, time in mine] == [time for _, time in alone[:-1]]


def test_a_move_to_where_the_arm_is_only_waits():
    plant = load_plant("orchard").without(["thermal_growth", "base_tilt"])
    q = [0.1, 0.3, 0.4, 0.0, 0.1, 0.2]
    state = plant.initial_state(math, q)
    for dwell in (0.0, 0.5):
        _, frame = moved(plant, math, state, q, q, Pace(dwell=dwell))
        assert frame == pytest.approx(plant.tool_frame(math, q), abs=1e-14)


@pytest.mark.parametrize("wrong", [{"speed": 0.0}, {"period": -1.0}, {"dwell": -0.1}, {"speed": math.nan}])
def test_an_impossible_pace_is_refused(wrong):
    with pytest.raises(ValueError, match="impossible"):
        Pace(**wrong)


def test_without_participation_nothing_swings():
    plant = load_plant("orchard")
    still = plant.with_effect(replace(plant.effect("settling"), participation=(0.0,) * 6))
    assert vibration(still, 1.0, 0.1) == 0.0
