"""Every registered environment keeps the rules of Gymnasium and Stable-Baselines3; any warning is an error."""

import copy
import doctest
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_match import check_environments_match
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import pickenv.envs.reach
import pickenv.wrappers.compensation

IDS = sorted(name for name in gym.registry if name.startswith("pickenv/"))
VARIANTS = [
    {},
    {"plant": "geometry_only"},
    {"feedback": "camera", "camera_noise_mm": 3.0},
    {"reward": "sparse", "tolerance_mm": 1.0, "without": ["boom_bending"]},
]

every_id = pytest.mark.parametrize("name", IDS)
every_variant = pytest.mark.parametrize("arguments", VARIANTS, ids=str)


@pytest.fixture(autouse=True)
def strict(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")  # windows without a screen
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def rollout(env, seed, steps=30):
    env.action_space.seed(seed)
    taken = [env.reset(seed=seed)]
    for _ in range(steps):
        taken.append(env.step(env.action_space.sample()))
    return taken


def alike(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(alike, one, other))
    return type(one) is type(other) and np.array_equal(one, other)


def arrays_in(value):
    if isinstance(value, np.ndarray):
        return [value]
    values = value.values() if isinstance(value, dict) else value if isinstance(value, tuple | list) else ()
    return [array for item in values for array in arrays_in(item)]


def test_reach_is_registered():
    assert "pickenv/Reach-v0" in IDS


@every_id
def test_gymnasiums_checker(name):
    check_env(gym.make(name).unwrapped)


@every_id
def test_stable_baselines3s_checker(name):
    check_env_for_sb3(gym.make(name).unwrapped)


@every_variant
def test_checkers_on_every_kind_of_reach(arguments):
    env = gym.make("pickenv/Reach-v0", **arguments).unwrapped
    check_env(env)
    check_env_for_sb3(env)


@every_id
def test_two_copies_agree_to_the_bit(name):
    assert alike(rollout(gym.make(name), 7), rollout(gym.make(name), 7))
    check_environments_match(gym.make(name), gym.make(name), num_steps=70, seed=3)


@every_id
def test_resets_chain_after_one_seed(name):
    one, other = gym.make(name), gym.make(name)
    first = [one.reset(seed=5), *(one.reset() for _ in range(4))]
    again = [other.reset(seed=5), *(other.reset() for _ in range(4))]
    assert alike(first, again)
    observations = [observation for observation, _ in first]
    assert not any(alike(a, b) for i, a in enumerate(observations) for b in observations[:i])


@every_id
def test_information_has_the_same_keys_after_reset_and_step(name):
    env = gym.make(name)
    _, after_reset = env.reset(seed=0)
    *_, after_step = env.step(env.action_space.sample())
    assert after_reset.keys() == after_step.keys()
    assert {k: type(v) for k, v in after_reset.items()} == {k: type(v) for k, v in after_step.items()}


@every_id
def test_nothing_returned_shares_memory(name):
    returned = [arrays_in(step) for step in rollout(gym.make(name), 1, 5)]
    flat = [array for arrays in returned for array in arrays]
    assert flat
    assert not any(np.shares_memory(a, b) for i, a in enumerate(flat) for b in flat[:i])


@every_id
def test_observations_stay_in_the_space_and_rewards_are_floats(name):
    env = gym.make(name)
    for step in rollout(env, 2, 59)[1:]:
        observation, reward, terminated, truncated, _ = step
        assert env.observation_space.contains(observation)
        assert type(reward) is float and type(terminated) is bool and type(truncated) is bool


@every_id
def test_the_specification_survives_json_pickle_and_copy(name):
    env = gym.make(name)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert alike(rollout(env, 4), rollout(again, 4))
    env.reset(seed=9)
    env.step(env.action_space.sample())
    for twin in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
        assert twin is not env
        action = env.action_space.sample()
        assert alike(copy.deepcopy(env).step(action), twin.step(action))


@every_variant
def test_arguments_survive_json(arguments):
    env = gym.make("pickenv/Reach-v0", **arguments)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec.kwargs == arguments
    assert alike(rollout(env, 4), rollout(again, 4))


@pytest.mark.parametrize("module", [pickenv.envs.reach, pickenv.wrappers.compensation])
def test_examples_in_docstrings_run(module):
    result = doctest.testmod(module)
    assert result.attempted > 0 and result.failed == 0
