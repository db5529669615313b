"""The scripted policy: what a perfect controller of the nominal arm does."""

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401
from pickenv.agents import ScriptedReach, read_observation
from pickenv.arm import forward, pose_error, shipped_arms
from pickenv.base import InputError


@pytest.fixture
def env():
    with gym.make("pickenv/Reach-v0", plant="geometry_only") as env:
        yield env


@pytest.mark.parametrize("seed", range(12))
def test_it_believes_to_be_at_the_fruit(env, seed):
    policy = ScriptedReach(env)
    observation, _ = env.reset(seed=seed)
    for step in range(60):
        observation, *_ = env.step(policy.act(observation))
        if step == 19:
            early = observation
    assert np.linalg.norm(observation[12:15]) < 1e-5
    assert np.linalg.norm(observation[15:18]) < 1e-4  # every goal is a pose of the nominal arm
    assert np.linalg.norm(early[12:15]) < 1e-5  # it drives straight: the longest way is 11 increments


def test_it_sees_the_observation_alone(env):
    """Nothing of the environment's inside is used after construction."""
    policy, other = ScriptedReach(env), ScriptedReach(env)
    observation, _ = env.reset(seed=1)
    first = policy.act(observation)
    env.reset(seed=2)
    assert np.array_equal(other.act(observation), first)


def test_actions_are_in_the_action_space(env):
    policy = ScriptedReach(env)
    observation, _ = env.reset(seed=4)
    for _ in range(20):
        action = policy.act(observation)
        assert env.action_space.contains(action)
        observation, *_ = env.step(action)


def test_it_forgets_the_last_fruit(env):
    policy, fresh = ScriptedReach(env), ScriptedReach(env)
    policy.act(env.reset(seed=1)[0])
    observation, _ = env.reset(seed=2)
    policy.reset()
    assert np.array_equal(policy.act(observation), fresh.act(observation))


def test_a_fruit_out_of_reach_is_said_so(env):
    policy = ScriptedReach(env)
    observation, _ = env.reset(seed=1)
    observation[9:12] += 2.0
    with pytest.raises(InputError, match=r"fruit at .* mm cannot be reached: .* mm and .* deg remain"):
        policy.act(observation)


def missed(arm: str, count: int, seed: int) -> int:
    """How many of an environment's goals the policy's joints leave by 0.1 mm or 0.05 deg."""
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=count, plant=f"ideal:{arm}")
    observation, _ = envs.reset(seed=seed)
    policy = ScriptedReach(envs)
    reading = read_observation(policy.geometry, observation)
    error = pose_error(policy.wanted_pose(reading), forward(policy.geometry, policy.wanted_joints(reading)))
    envs.close()
    return int(np.sum(np.any(np.abs(error) > [1e-4] * 3 + [np.radians(0.05)] * 3, axis=-1)))


@pytest.mark.parametrize("arm", shipped_arms())
def test_it_finds_joints_for_every_goal_that_an_environment_draws(arm):
    assert missed(arm, 100, seed=0) == 0


@pytest.mark.slow
@pytest.mark.parametrize("arm", shipped_arms())
def test_it_finds_joints_for_thousands_of_goals(arm):
    assert missed(arm, 4000, seed=1) == 0
