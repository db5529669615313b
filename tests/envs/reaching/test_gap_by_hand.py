"""The gap by direction and logarithm: what the networks see, and what becomes of their actions, by other lines."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pickenv  # noqa: F401, registers the environments
from pickenv.base import InputError
from pickenv.wrappers import GapScaling, GapScalingVector, Scaling, joined_observation

GAPS = (([0.3, -0.4, 1.2], [0.0, 0.0, 0.1]), ([3e-3, 0.0, 4e-3], [0.0, 0.06, 0.08]), ([0.0] * 3, [0.0] * 3))
SIZES = (13.0, 0.5, 1e-6)
"""Of these gaps: 1.3 m of 0.1; 0.1 rad of 0.2, more than 5 mm of 0.1 m; the least there is."""


def flat(joints: int, gap: list[float], turn: list[float], camera: bool) -> np.ndarray:
    """An observation whose other numbers are all 7."""
    values = np.full(joints + (15 if camera else 12), 7.0)
    values[joints + 9 : joints + 12] = turn
    values[joints + 12 if camera else joints + 6 :][:3] = gap
    values[:joints] = np.linspace(-0.5, 0.5, joints)
    return values


@pytest.mark.parametrize("camera", [False, True])
@pytest.mark.parametrize("joints", [3, 6])
def test_the_gap_enters_as_direction_and_half_its_decimal_logarithm(joints, camera):
    scaling = Scaling(joints, camera)
    values = np.array([flat(joints, *gap, camera) for gap in GAPS])
    assert scaling.inputs == values.shape[1] and scaling.features == joints + 7
    seen = scaling.observe(values, np)
    for (gap, turn), size, row in zip(GAPS, SIZES, seen, strict=True):
        assert row[:joints] == pytest.approx(np.linspace(-0.5, 0.5, joints))
        assert row[joints : joints + 3] == pytest.approx([each / 0.1 / size for each in gap])
        assert row[joints + 3 : joints + 6] == pytest.approx([each / 0.2 / size for each in turn])
        assert row[joints + 6 :] == pytest.approx([math.log(size, 100.0)])
    assert scaling.shown(values).dtype == np.float32
    np.testing.assert_allclose(scaling.shown(values), seen, rtol=1e-6)
    for wrong in (scaling.inputs - 1, scaling.inputs + 1):
        with pytest.raises(InputError, match=f"of {scaling.inputs} numbers, but the environment gives {wrong}"):
            scaling.check(wrong)
    scaling.check(scaling.inputs)


def test_actions_are_cut_and_are_shares_of_the_size_below_one():
    values = np.array([flat(3, *gap, False) for gap in GAPS])
    actions = np.array([[0.5, -2.0, 1.0]] * 3)
    cut, limit = np.array([0.5, -1.0, 1.0]), 5.0
    scaled = Scaling(3).act(values, actions, limit)
    np.testing.assert_allclose(scaled, [cut, 0.5 * cut, 1e-6 * cut], rtol=1e-6)
    np.testing.assert_allclose(Scaling(3, actions=False).act(values, actions, limit), [cut] * 3)
    assert scaled.dtype == np.float32
    assert Scaling(3).act(values[1], [limit, 0.0, 0.0], limit).tolist() == [0.5, 0.0, 0.0]
    assert Scaling(3).act(values[1], [limit + 1.0, -6.0, 0.0], limit).tolist() == [6.0, -6.0, 0.0]
    assert Scaling(3).act(values[1], [1.0, 1.0], limit).tolist() == [1.0, 1.0]


def test_the_gap_of_a_goal_observation_is_that_of_its_two_goals():
    rng = np.random.default_rng(0)
    here, there = (Rotation.random(random_state=seed).as_matrix() for seed in (1, 2))
    p, q = rng.normal(size=3), rng.normal(size=3)
    achieved, desired = (np.concatenate([at, r[:, 2], r[:, 0]]) for at, r in ((p, here), (q, there)))
    assert len(achieved) == 9
    observation = {"desired_goal": desired, "observation": rng.normal(size=7), "achieved_goal": achieved}
    values = joined_observation(observation)
    np.testing.assert_array_equal(values, np.concatenate([observation["observation"], achieved, desired]))
    assert joined_observation(values) is values
    scaling = Scaling(4, goal=True)
    assert scaling.inputs == len(values) == 25
    gap, turn = scaling.gap(values, np)
    np.testing.assert_allclose(gap, q - p, atol=1e-12)
    np.testing.assert_allclose(turn, Rotation.from_matrix(there @ here.T).as_rotvec(), atol=1e-9)


@pytest.mark.parametrize("arguments", [{}, {"feedback": "camera"}], ids=["encoders", "camera"])
def test_wrapped_environments_show_and_bound_these_numbers(arguments):
    bare = gym.make("pickenv/Reach-v0", **arguments)
    env = GapScaling(gym.make("pickenv/Reach-v0", **arguments))
    several = GapScalingVector(gym.make_vec("pickenv/Reach-v0", num_envs=2, **arguments))
    scaling = Scaling(6, camera=bool(arguments))
    most = np.array([1.0] * 6 + [1.001] * 6 + [3.0], dtype=np.float32)
    for space in (env.observation_space, several.single_observation_space):
        np.testing.assert_array_equal(space.high, most)
        np.testing.assert_array_equal(space.low, -most)
    assert several.observation_space.shape == (2, 13)
    assert env.raw.shape == (scaling.inputs,) and several.raw.shape == (2, scaling.inputs)
    raw = bare.reset(seed=1)[0]
    np.testing.assert_array_equal(env.reset(seed=1)[0], scaling.shown(raw))
    np.testing.assert_array_equal(several.reset(seed=1)[0][0], scaling.shown(raw))
    asked = {"goal_joints": np.array(bare.unwrapped.task.middle) + 0.1}
    raw = bare.reset(seed=2, options=asked)[0]
    np.testing.assert_array_equal(env.reset(seed=2, options=asked)[0], scaling.shown(raw))
    np.testing.assert_array_equal(several.reset(seed=2, options=asked)[0][0], scaling.shown(raw))
    assert not np.array_equal(env.reset(seed=2)[0], scaling.shown(raw))
    env.reset(seed=1)
    plain = GapScaling(gym.make("pickenv/Reach-v0", **arguments), actions=False)
    plain.reset(seed=1)
    for wrapped in (env, plain):
        bare.reset(seed=1)
        for action in (np.full(6, 0.3), np.full(6, -0.8)):
            raw = bare.step(wrapped.scaling.act(raw, action))[0]
            np.testing.assert_array_equal(wrapped.step(action)[0], wrapped.scaling.shown(raw))
            np.testing.assert_array_equal(wrapped.raw, raw)
    assert (env.scaling.actions, plain.scaling.actions) == (True, False)
