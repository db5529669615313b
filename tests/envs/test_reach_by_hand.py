"""Parts of the reach task written out: the bounds of a move, the turn no joint makes, goals as seen, their rewards."""

import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401  (registers the environments)
from pickenv.envs.shared import simulation
from pickenv.envs.shared.backends import FLOATS
from pickenv.envs.shared.task import make_task
from pickenv.errors import InputError


def test_a_move_is_a_share_of_the_largest_increment_of_at_most_one_and_ends_at_the_limits():
    task = make_task()
    lower, upper, most = (np.array(part) for part in (task.lower, task.upper, task.increment))
    rng = np.random.default_rng(0)
    for _ in range(200):
        target, action = rng.uniform(lower, upper), rng.uniform(-2.5, 2.5, 6)
        expected = np.clip(target + np.clip(action, -1.0, 1.0) * most, lower, upper)
        np.testing.assert_allclose(simulation.move(FLOATS, task, target.tolist(), action.tolist()), expected)


def test_the_turn_that_no_joint_makes_is_along_the_normal_of_both_axes():
    """Whichever way the axes point; those of the picking arm have zeros."""
    task, rng = replace(make_task(), lost_axes=(1, 3)), np.random.default_rng(0)
    for _ in range(50):
        frames = [tuple(rng.normal(size=12).tolist()) for _ in range(6)]
        turn = rng.normal(size=3)
        normal = np.cross(frames[2][6:9], frames[4][6:9])
        expected = abs(turn @ normal) / np.linalg.norm(normal)
        assert simulation._lost_angle(FLOATS, task, frames, turn.tolist()) == pytest.approx(expected)


def test_an_arm_that_turns_its_tool_any_way_loses_nothing():
    env = gym.make("pickenv/Reach-v0", plant="ideal:ur5")
    env.reset(seed=0)
    info = env.step(env.action_space.sample())[-1]
    env.close()
    assert info["attitude_error_deg"] > 1.0 and info["noncompensable_deg"] == 0.0
    assert info["compensable_deg"] == pytest.approx(info["attitude_error_deg"])


@pytest.mark.parametrize(("feedback", "near"), [("camera", 1e-6), ("encoders", None)])
def test_the_goal_that_counts_as_achieved_is_the_tool_as_it_is_measured(feedback, near):
    """By a camera without noise that is the true tool, by encoders the one that the controller believes in."""
    env = gym.make("pickenv/ReachGoal-v0", feedback=feedback, reward="dense")
    env.reset(seed=3)
    rng = np.random.default_rng(3)
    for _ in range(5):
        observation, reward, *_, info = env.step(rng.uniform(-1, 1, 6))
        apart = np.linalg.norm(observation["achieved_goal"] - info["tool_position"])
        assert apart < near if near else 1e-4 < apart < 2e-2
        np.testing.assert_allclose(observation["desired_goal"], info["fruit_position"], atol=1e-6)
        distance_mm = 1e3 * np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"])
        assert reward == pytest.approx(-math.log10(1.0 + distance_mm), abs=1e-4)
    env.close()


@pytest.mark.parametrize("sparse", [True, False])
def test_rewards_of_goals_count_millimetres(sparse):
    env = gym.make("pickenv/ReachGoal-v0", reward="sparse" if sparse else "dense", tolerance_mm=5.0)
    rng = np.random.default_rng(0)
    achieved = rng.uniform(-1, 1, (40, 3))
    size_mm = np.geomspace(1e-2, 2e3, 40)
    directions = rng.normal(size=(40, 3))
    desired = achieved + 1e-3 * size_mm[:, None] * directions / np.linalg.norm(directions, axis=1)[:, None]
    found = env.unwrapped.compute_reward(achieved, desired, {})
    env.close()
    expected = np.where(size_mm <= 5.0, 0.0, -1.0) if sparse else -np.log10(1.0 + size_mm)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_one_environment_asks_for_one_row_of_joints_and_several_for_one_or_as_many():
    task = make_task()
    with pytest.raises(InputError, match=r"goal_joints must be \(6,\) joints"):
        task.given_joints("goal_joints", np.zeros((2, 6)))
    with pytest.raises(InputError, match=r"goal_joints must be \(6,\) or \(3, 6\) joints"):
        task.given_joints("goal_joints", np.zeros((2, 6)), 3)
    middle = np.array(task.middle)
    np.testing.assert_array_equal(task.given_joints("goal_joints", middle, 3), np.tile(middle, (3, 1)))
    np.testing.assert_array_equal(task.given_joints("goal_joints", np.tile(middle, (3, 1)), 3), np.tile(middle, (3, 1)))
