"""The scripted policy: what a perfect controller of the nominal arm does."""

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401
from pickenv.agents import AdaptiveReach, ScriptedReach, ServoReach, episode_seeds, read_observation
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
    assert missed(arm, 50, seed=0) == 0


@pytest.mark.thorough
@pytest.mark.parametrize("arm", shipped_arms())
def test_it_finds_joints_for_thousands_of_goals(arm):
    assert missed(arm, 4000, seed=1) == 0


LATE = [
    {"latency": 4, "action_delay": 3},
    {"latency": [0, 5], "action_delay": [0, 5]},
    {"latency": [0, 2], "action_delay": 1, "control_period_s": [0.05, 0.2]},
]


@pytest.mark.parametrize("late", LATE, ids=str)
@pytest.mark.parametrize("maker", [ScriptedReach, ServoReach, AdaptiveReach])
def test_who_counts_what_it_sent_ends_where_it_wants_to_however_late_readings_and_actions_are(maker, late):
    given = {"plant": "ideal", "feedback": "camera", "max_episode_steps": 200, "start_spread": 0.5} | late
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=40, **given)
    policy = maker(envs)
    observation, info = envs.reset(seed=3)
    for _ in range(199):
        observation, *_, info = envs.step(policy.act(observation))
    assert info["position_error_mm"].max() < 0.3


def test_alone_and_in_a_vector_it_counts_alike():
    given = {"plant": "orchard", "latency": 2, "action_delay": 1}
    env, envs = gym.make("pickenv/Reach-v0", **given), gym.make_vec("pickenv/Reach-v0", num_envs=1, **given)
    alone, many = ScriptedReach(env), ScriptedReach(envs)
    one, both = env.reset(seed=5)[0], envs.reset(seed=5)[0]
    for _ in range(40):
        action, actions = alone.act(one), many.act(both)
        np.testing.assert_allclose(action, actions[0], atol=1e-6)
        one, both = env.step(action)[0], envs.step(actions)[0]


def test_noisy_late_readings_cost_less_than_swinging_about_the_goal():
    """The ladder's rung with every effect: the script is as good there as its first reading and the arm allow."""

    def misses_mm(maker, **sight):
        envs = gym.make_vec("pickenv/Reach-v0", num_envs=30, difficulty="orchard", split="test", **sight)
        policy, (observation, _) = maker(envs), envs.reset(seed=list(episode_seeds(0, 30)))
        for _ in range(envs.unwrapped.max_episode_steps):
            observation, *_, info = envs.step(policy.act(observation))
        return info["position_error_mm"]

    assert np.median(misses_mm(ScriptedReach)) < 5.0
    assert misses_mm(ServoReach, feedback="camera", camera_noise_mm=1.0).max() < 1.5
