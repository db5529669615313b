"""Each rung of the ladder keeps the rules of Gymnasium and Stable-Baselines3; arms to learn on are not judged by."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

from pickenv.arm import arrays_of
from pickenv.base import InputError
from pickenv.envs import LADDER, SPLITS

IDS = ("pickenv/Reach-v0", "pickenv/ReachGoal-v0", "pickenv/Pick-v0")
SCALED = ("pickenv/ReachScaled-v0", "pickenv/ReachTool-v0")
rungs = pytest.mark.parametrize("difficulty", LADDER)


@rungs
@pytest.mark.parametrize("name", (*IDS, *SCALED))
def test_checkers_find_nothing_on_any_rung(name, difficulty):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(name, difficulty=difficulty, split="test").unwrapped
        check_env(env, skip_render_check=True)
        check_env_for_sb3(env, skip_render_check=True)


@rungs
@pytest.mark.parametrize("name", (*IDS, *SCALED))
def test_a_gaussian_policy_that_cuts_nothing_acts_on_any_rung(name, difficulty):
    """With Gymnasium's passive checker around it, whose warnings are errors."""
    rng = np.random.default_rng(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(name, difficulty=difficulty)
        env.reset(seed=0)
        for _ in range(3):
            action = rng.normal(scale=2.0, size=env.action_space.shape).astype(np.float32)
            assert np.abs(action).max() > 1.0
            seen, reward, *_ = env.step(action)
            assert env.observation_space.contains(seen) and np.isfinite(reward)


@rungs
def test_many_are_as_many_single_ones_on_every_rung(difficulty):
    def single():
        return gym.make("pickenv/Reach-v0", executor="numpy", difficulty=difficulty, disable_env_checker=True)

    sync = SyncVectorEnv([single] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    arguments = {"autoreset_mode": "SameStep", "difficulty": difficulty, "executor": "numpy"}
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=3, **arguments)
    np.testing.assert_array_equal(sync.reset(seed=4)[0], envs.reset(seed=4)[0])
    envs.action_space.seed(0)
    for _ in range(4):
        actions = envs.action_space.sample()
        one, other = sync.step(actions), envs.step(actions)
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[4]["pose_error"], other[4]["pose_error"])


@pytest.mark.parametrize("difficulty", [name for name, fixed in LADDER.items() if "arms" in fixed])
def test_no_arm_to_be_judged_on_is_one_to_learn_on(difficulty):
    tasks = {
        name: [gym.make(name, difficulty=difficulty, split=split).unwrapped.task for split in SPLITS]
        for name in (IDS[0], IDS[2])
    }
    for train, test in tasks.values():
        for one, other in zip(arrays_of(train.plant), arrays_of(test.plant), strict=True):
            for learnt, judged in zip(np.atleast_2d(one.T), np.atleast_2d(other.T), strict=True):
                drawn = np.unique(np.concatenate([learnt, judged]))
                assert len(drawn) == 1 or not np.isin(judged, learnt).any()
        assert train.population > test.population
    for one, other in zip(*(arrays_of(train.plant) for train, _ in tasks.values()), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_rung_is_one_thing_and_no_other():
    with pytest.raises(InputError, match="difficulty is 'easy'; give one of ideal, fine, coarse, orch"):
        gym.make("pickenv/Reach-v0", difficulty="easy")
    with pytest.raises(InputError, match="split is 'validation'; give one of train, test"):
        gym.make("pickenv/Reach-v0", difficulty="day", split="validation")
    with pytest.raises(InputError, match="split 'test' needs a difficulty"):
        gym.make("pickenv/Pick-v0", split="test")
    with pytest.raises(InputError, match="difficulty 'orchard' fixes arms, latency; leave them out"):
        gym.make_vec("pickenv/Reach-v0", num_envs=2, difficulty="orchard", latency=3, arms="fixed")
    with pytest.raises(InputError, match="'ideal' fixes plant; leave it out"):
        gym.make("pickenv/Pick-v0", difficulty="ideal", plant="orchard")
