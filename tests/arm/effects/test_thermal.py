"""Links grow with temperature, and temperature rises exponentially."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Geometry, Pose, forward, load_plant
from pickenv.arm.effects.drives import ThermalGrowth, warmed

BARE = load_plant("geometry_only")
ALUMINIUM = ThermalGrowth((23e-6,) * 6, initial_rise=-5.0, final_rise=20.0, time_constant=3600.0)
HOT = BARE.with_effect(ALUMINIUM)
Q = [0.1, 0.3, 0.4, 0.0, 0.1, 0.2]


def test_a_uniformly_warm_arm_is_the_same_arm_on_a_larger_scale(draw):
    """With one coefficient for all links every position scales by 1 + alpha dT, and no attitude changes."""
    q = draw(BARE.geometry, 50)
    cold, hot = BARE.tool_pose(q), HOT.tool_pose(q)
    np.testing.assert_allclose(hot.position, cold.position * (1 + 23e-6 * 20.0), rtol=1e-12)
    np.testing.assert_array_equal(hot.rotation, cold.rotation)


def test_aluminium_of_1500_mm_grows_by_0_7_mm_at_20_kelvin():
    still = Pose(np.zeros(3), np.eye(3))
    zero = np.zeros(1)
    bar = Geometry(("J1",), (False,), zero, np.array([1.5]), zero, zero, zero, -np.ones(1), np.ones(1), still, still)
    growth = ThermalGrowth((23e-6,), 0.0, 20.0, 3600.0)
    hot = replace(BARE, geometry=bar).with_effect(growth)
    assert 1e3 * (hot.tool_pose([0.3]).position[0] - 1.5) == pytest.approx(0.69)


def test_warm_up_is_exponential():
    for time in (0.0, 600.0, 3600.0, 4 * 3600.0):
        rise = warmed(math, ALUMINIUM, -5.0, time)
        assert rise == pytest.approx(20.0 - 25.0 * math.exp(-time / 3600.0), abs=1e-12)
    assert warmed(math, ALUMINIUM, warmed(math, ALUMINIUM, 3.0, 500.0), 700.0) == pytest.approx(
        warmed(math, ALUMINIUM, 3.0, 1200.0), abs=1e-12
    )


def test_the_arm_starts_cold_and_ends_at_its_settled_pose():
    state = HOT.initial_state(math, Q)
    assert state == ((-5.0,),)
    cold, true = HOT.advance(math, state, Q, 0.0)[1], forward(HOT.geometry, Q).position
    np.testing.assert_allclose(cold[9:], true * (1 - 5 * 23e-6), rtol=1e-12)
    warm = HOT.advance(math, state, Q, 1e6)[1]
    np.testing.assert_allclose(warm, HOT.tool_frame(math, Q), atol=1e-14)


def test_drift_over_hours_follows_the_time_constant():
    state = HOT.initial_state(math, Q)
    settled = np.array(HOT.tool_frame(math, Q)[9:])
    gaps = []
    for _ in range(4):
        state, frame = HOT.advance(math, state, Q, 3600.0)
        gaps.append(np.linalg.norm(np.array(frame[9:]) - settled))
    np.testing.assert_allclose(np.array(gaps[1:]) / gaps[:-1], math.exp(-1), rtol=1e-6)


def test_links_of_carbon_fibre_stay():
    mixed = replace(ALUMINIUM, expansion=(0.0,) * 6)
    assert BARE.with_effect(mixed).tool_frame(math, Q) == BARE.tool_frame(math, Q)
