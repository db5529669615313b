"""Harvest-v0 for Gymnasium, as vector environment and for PettingZoo: one simulator, the same rules."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

import pickenv  # noqa: F401
from pickenv.agents import ScriptedHarvest
from pickenv.base import InputError
from pickenv.envs import HarvestEnv, HarvestVectorEnv
from pickenv.harvester import Controller
from pickenv.wrappers import CompensationWrapper


@pytest.fixture(autouse=True)
def strict():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def episode(env, policy, seed, longest=600):
    observation, info = env.reset(seed=seed)
    policy.reset()
    total = 0.0
    for _ in range(longest):
        observation, reward, over, _, info = env.step(policy.act(observation))
        total += reward
        if over:
            break
    return total, info


@pytest.mark.parametrize(
    "arguments",
    [
        {"vision": "ideal"},
        pytest.param({"slaves": 1, "fruit": 3, "vision": "rendered"}, marks=pytest.mark.slow),
        {"slaves": 5, "spacing_mm": 300.0},
    ],
)
def test_both_checkers_on_every_kind_of_harvest(arguments):
    env = gym.make("pickenv/Harvest-v0", **arguments).unwrapped
    check_env(env)
    check_env_for_sb3(env)


def test_the_scripted_policy_picks_everything_with_a_perfect_machine():
    env = HarvestEnv(ideal=True, vision="ideal")
    policy = ScriptedHarvest(env)
    for seed in range(4):
        total, info = episode(env, policy, seed)
        assert info["collected"] >= info["reachable"] - 1
        assert total > 0.8 * info["reachable"]
        assert info["closest_mm"] >= 100 - 1e-6


@pytest.mark.parametrize("slaves", [1, 2, 4])
def test_the_scripted_policy_works_for_other_numbers_of_arms(slaves):
    env = HarvestEnv(slaves=slaves, fruit=5, vision="ideal")
    total, info = episode(env, ScriptedHarvest(env), 1)
    assert info["collected"] >= info["reachable"] - 2 and total > 0


def test_calibration_through_the_compensation_wrapper_needs_fewer_attempts():
    class Truth:
        def __init__(self, plant):
            self.predict = plant.tool_pose

    attempts = {}
    for name in ("raw", "compensated"):
        env = HarvestEnv(vision="ideal")
        true = env.task.true
        belief = Controller(env.task.machine, Truth(true.master), tuple(Truth(p) for p in true.slaves))
        wrapped = env if name == "raw" else CompensationWrapper(env, belief)
        policy = ScriptedHarvest(wrapped)
        attempts[name] = sum(episode(wrapped, policy, seed, 300)[1]["attempts"] for seed in range(2))
    assert attempts["compensated"] < attempts["raw"]


def test_random_actions_never_bring_arms_too_near():
    env = HarvestVectorEnv(32)
    env.reset(seed=0)
    env.action_space.seed(0)
    least = np.inf
    for _ in range(120):
        *_, info = env.step(env.action_space.sample())
        least = min(least, info["closest_mm"].min())
    assert least >= 100 - 1e-6


@pytest.mark.parametrize("action", [np.zeros(5), np.full(12, np.nan)])
def test_impossible_actions_are_refused(action):
    env = HarvestEnv()
    with pytest.raises(InputError, match="reset first"):
        env.step(np.zeros(12))
    env.reset(seed=0)
    with pytest.raises(InputError, match="finite numbers"):
        env.step(action)


@pytest.mark.parametrize(
    "arguments",
    [{"fruit": 0}, {"slaves": 9}, {"spacing_mm": 100.0}, {"render_mode": "ansi"}, {"fruit": 2.5}, {"vision": "eagle"}],
)
def test_impossible_arguments_are_refused(arguments):
    with pytest.raises(InputError):
        HarvestEnv(**arguments)


def test_pettingzoos_checkers_and_registry():
    pettingzoo = pytest.importorskip("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from pickenv.envs.harvesting.harvest_parallel import HarvestParallelEnv

    parallel_api_test(HarvestParallelEnv(max_cycles=40), num_cycles=100)
    parallel_seed_test(lambda: HarvestParallelEnv(max_cycles=40), num_cycles=15)
    env = pettingzoo.make("parallel", "pickenv/Harvest-v0")
    observations, _ = env.reset(seed=0)
    assert set(observations) == {"master", "slave_0", "slave_1", "slave_2"}
    assert env.unwrapped.state().shape == (47,)


def test_agents_together_do_what_the_single_policy_does():
    pytest.importorskip("pettingzoo")
    from pickenv.envs.harvesting.harvest_parallel import HarvestParallelEnv

    env = HarvestParallelEnv(ideal=True, vision="ideal")
    policy = ScriptedHarvest(env)
    observations, _ = env.reset(seed=3)
    infos = {}
    while env.agents:
        observations, rewards, _, _, infos = env.step(policy.act_together(observations))
        assert len(set(rewards.values())) == 1
    assert infos["master"]["collected"] >= infos["master"]["reachable"] - 1


def test_agents_together_begin_as_asked_and_refuse_what_they_do_not_know():
    pytest.importorskip("pettingzoo")
    from pickenv.envs.harvesting.harvest_parallel import HarvestParallelEnv

    alone, env = HarvestEnv(fruit=2), HarvestParallelEnv(fruit=2)
    alone.reset(seed=3)
    options = {"fruit": alone.state.fruit[0] + 0.01, "start_joints": alone.state.joints[0]}
    seen, _ = alone.reset(seed=4, options=options)
    observations, _ = env.reset(seed=4, options=options | {"options": 1})  # as PettingZoo's own tests give
    assert np.array_equal(observations["master"][: len(seen)], seen)
    with pytest.raises(InputError, match="unknown reset option 'fruits'; give fruit, start_joints"):
        env.reset(options={"fruits": options["fruit"]})
    with pytest.raises(InputError, match="agent of an action is 'slave_3'; give one of master, slave_0"):
        env.step({"slave_3": np.zeros(3)})
    with pytest.raises(InputError, match="max_cycles is 0; give a whole number of at least 1"):
        HarvestParallelEnv(max_cycles=0)
