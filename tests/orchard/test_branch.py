"""A pushed fruit swings as a damped pendulum, its neighbours less; 95 % of apples come off at 28.3 N or 0.257 N·m."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import norm

from pickenv.orchard import (
    Branch,
    coupling,
    load_branch,
    load_detachment,
    natural_frequencies,
    pushed,
    sample_strength,
    swing,
)

quick = settings(deadline=None, derandomize=True)

MASS = 0.185
REST = np.zeros(3)
vectors = st.tuples(*[st.floats(-0.1, 0.1)] * 3)
branches = st.builds(
    Branch,
    pendulum=st.floats(0.05, 1.0),
    stiffness_sideways=st.floats(0.0, 300.0),
    stiffness_upright=st.floats(10.0, 500.0),
    wood=st.floats(0.0, 1.0),
    damping_ratio=st.sampled_from([0.0, 0.05, 0.5, 1.0, 2.0]),
    coupling=st.floats(0.01, 1.0),
)


def test_without_stiffness_it_is_a_pendulum() -> None:
    branch = Branch(0.25, 0.0, 100.0, 0.0, 0.0, 0.1)
    period = 2 * np.pi * np.sqrt(0.25 / 9.80665)
    assert 2 * np.pi / natural_frequencies(branch, MASS)[0] == pytest.approx(period)
    there, speed = swing(branch, [0.05, 0, 0], REST, MASS, period)
    assert there == pytest.approx([0.05, 0, 0], abs=1e-12) and speed == pytest.approx(REST, abs=1e-12)
    half, _ = swing(branch, [0.05, 0, 0], REST, MASS, period / 2)
    assert half == pytest.approx([-0.05, 0, 0], abs=1e-12)


def test_an_apple_swings_at_two_hertz() -> None:
    assert natural_frequencies(load_branch("apple"), MASS) / (2 * np.pi) == pytest.approx([2.0, 2.0, 3.3], abs=0.05)


def test_damping_takes_the_logarithmic_decrement_per_period() -> None:
    branch = load_branch("apple")
    zeta, omega = branch.damping_ratio, natural_frequencies(branch, MASS)[0]
    period = 2 * np.pi / (omega * np.sqrt(1 - zeta**2))
    there, _ = swing(branch, [0.05, 0, 0], REST, MASS, period)
    assert np.log(0.05 / there[0]) == pytest.approx(2 * np.pi * zeta / np.sqrt(1 - zeta**2))


@quick
@given(branches, vectors, vectors, st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_two_steps_are_one_long_step(b: Branch, x: tuple, v: tuple, t1: float, t2: float) -> None:
    once = swing(b, x, v, MASS, t1 + t2)
    twice = swing(b, *swing(b, x, v, MASS, t1), MASS, t2)
    assert once[0] == pytest.approx(twice[0], abs=1e-9)
    assert once[1] == pytest.approx(twice[1], abs=1e-8)


@quick
@given(branches, vectors, vectors)
def test_a_small_step_obeys_the_equation_of_motion(b: Branch, x: tuple, v: tuple) -> None:
    dt, omega = 1e-6, natural_frequencies(b, MASS)
    _, speed = swing(b, x, v, MASS, dt)
    acceleration = -2 * b.damping_ratio * omega * v - omega**2 * x
    assert (speed - v) / dt == pytest.approx(acceleration, rel=1e-3, abs=1e-3)


def test_neighbours_are_pushed_less_the_farther_they_hang() -> None:
    branch = load_branch("apple")
    row = np.array([[0.0, 0, 0], [0.08, 0, 0], [0.15, 0, 0], [1.0, 0, 0]])
    moved = pushed(branch, row, contact=[0, 0, 0], push=[0, 0.03, 0])
    assert moved[:, 1] == pytest.approx(0.03 * np.exp(-row[:, 0] / 0.15))
    assert moved[2, 1] == pytest.approx(0.03 / np.e)
    assert (np.diff(coupling(branch, row[:, 0])) < 0).all()
    many = pushed(branch, row, contact=np.zeros((5, 2, 3)), push=[0, 0.03, 0])
    assert many.shape == (5, 2, 4, 3)


def test_batches_step_as_single_fruit_do() -> None:
    rng, branch = np.random.default_rng(0), load_branch("apple")
    x, v = rng.normal(size=(2, 4, 6, 3)) * 0.05
    mass, dt = rng.uniform(0.1, 0.3, (4, 6)), rng.uniform(0, 1, (4, 6))
    there, speed = swing(branch, x, v, mass, dt)
    one = swing(branch, x[2, 3], v[2, 3], mass[2, 3], dt[2, 3])
    np.testing.assert_array_equal(there[2, 3], one[0])
    np.testing.assert_array_equal(speed[2, 3], one[1])


def test_ninety_five_of_a_hundred_apples_come_off_at_28_newtons_or_a_quarter_newton_metre() -> None:
    limits = load_detachment("apple")
    pull_limit, twist_limit = sample_strength(limits, 50_000, np.random.default_rng(0))
    assert (pull_limit <= 28.3).mean() == pytest.approx(0.95, abs=0.005)
    assert (twist_limit <= 0.257).mean() == pytest.approx(0.95, abs=0.005)
    for share in (0.2, 0.5, 0.99):  # log-normal
        pull = 28.3 * np.exp(limits.spread * (norm.ppf(share) - norm.ppf(0.95)))
        assert (pull_limit <= pull).mean() == pytest.approx(share, abs=0.008)
    assert (pull_limit > 0).all() and (twist_limit > 0).all()
    np.testing.assert_allclose(twist_limit / pull_limit, limits.twist_95 / limits.pull_95)
