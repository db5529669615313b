"""Many harvesters in one set of arrays are each what they are alone."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import pickenv  # noqa: F401
from pickenv.base import InputError
from pickenv.envs import HarvestEnv, HarvestVectorEnv
from pickenv.envs.harvesting.harvest_task import COLLECTED, attempts


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_vector_environment_equals_single_ones(mode):
    n, longest = 3, 12
    native = HarvestVectorEnv(n, max_episode_steps=longest, autoreset_mode=mode)
    singles = [gym.make("pickenv/Harvest-v0", max_episode_steps=longest) for _ in range(n)]
    observations, _ = native.reset(seed=5)
    wanted = np.stack([env.reset(seed=5 + i)[0] for i, env in enumerate(singles)])
    assert np.array_equal(observations, wanted)
    native.action_space.seed(1)
    over = np.zeros(n, dtype=bool)
    for _ in range(30):
        if mode is AutoresetMode.DISABLED and over.any():
            observations, _ = native.reset(options={"reset_mask": over.copy()})
            for i in np.flatnonzero(over):
                assert observations[i] == pytest.approx(singles[i].reset()[0], abs=1e-6)
            over[:] = False
        actions = native.action_space.sample()
        observations, rewards, terminated, truncated, info = native.step(actions)
        for i, env in enumerate(singles):
            if over[i] and mode is AutoresetMode.NEXT_STEP:
                seen, reward, end, late = env.reset()[0], 0.0, False, False
            else:
                seen, reward, end, late, _ = env.step(actions[i])
            if (end or late) and mode is AutoresetMode.SAME_STEP:
                assert info["final_obs"][i] == pytest.approx(seen, abs=1e-6)
                seen = env.reset()[0]
            assert observations[i] == pytest.approx(seen, abs=1e-6)
            assert rewards[i] == pytest.approx(reward, abs=1e-9)
            assert (terminated[i], truncated[i]) == (end, late)
        over = terminated | truncated


def test_make_vec_makes_the_native_vector_environment():
    envs = gym.make_vec("pickenv/Harvest-v0", num_envs=2, fruit=4)
    assert isinstance(envs.unwrapped, HarvestVectorEnv)
    assert envs.reset(seed=1)[0].shape == (2, 12 + 3 + 16)


def test_a_vector_takes_new_seeds_goes_on_without_and_leaves_alone_what_a_mask_leaves_out():
    envs, alone = HarvestVectorEnv(3, fruit=2), HarvestEnv(fruit=2)
    first, _ = envs.reset(seed=5)
    onward, _ = envs.reset()
    alone.reset(seed=7)
    assert np.array_equal(onward[2], alone.reset()[0])
    again, _ = envs.reset(seed=5)
    assert np.array_equal(again, first)
    some, _ = envs.reset(seed=[None, 9, None], options={"reset_mask": np.array([True, True, False])})
    assert np.array_equal(some[0], onward[0])  # its stream goes on
    assert np.array_equal(some[1], alone.reset(seed=9)[0])
    assert np.array_equal(some[2], first[2])


def test_an_ended_episode_gives_its_last_words_and_zeros_elsewhere():
    """Two of three harvesters are one period short of their end; the third has just begun."""
    envs = HarvestVectorEnv(3, max_episode_steps=5, autoreset_mode="SameStep", fruit=2)
    envs.reset(seed=1)
    envs._elapsed[:2], envs.state.periods[:2], envs.state.attempts[:] = 4, 4, [7, 8, 9]
    rest = np.zeros(envs.action_space.shape)
    *_, truncated, info = envs.step(rest)
    assert truncated.tolist() == info["_final_obs"].tolist() == info["_final_info"].tolist() == [True, True, False]
    assert info["final_info"]["attempts"].tolist() == [7, 8, 0]
    assert info["final_info"]["_attempts"].tolist() == [True, True, False] and info["_attempts"].all()
    assert info["attempts"].tolist() == [0, 0, 9]
    assert envs.state.periods.tolist() == [0, 0, 1]


def test_a_compensator_gets_the_joints_of_all_and_none_may_be_missing():
    envs = HarvestVectorEnv(2, fruit=2)
    with pytest.raises(InputError, match="reset first"):
        envs.step(np.zeros((2, 12)))
    with pytest.raises(InputError, match="at least 1"):
        HarvestVectorEnv(0)
    envs.reset(seed=0)
    asked = []
    envs.compensator = lambda joints: asked.append(joints) or joints
    envs.step(np.zeros((2, 12)))
    assert [joints.shape for joints in asked] == [(2, 12)]


def test_an_episode_that_ends_by_itself_begins_anew_in_the_next_step_without_a_reward():
    envs = HarvestVectorEnv(2, fruit=2)
    envs.reset(seed=0)
    rest = np.zeros(envs.action_space.shape)
    for _ in range(2):
        envs.state.status[0] = COLLECTED
        _, rewards, terminated, truncated, info = envs.step(rest)
        assert terminated.tolist() == [True, False] and not truncated.any() and info["collected"].tolist() == [2, 0]
        _, rewards, terminated, truncated, info = envs.step(rest)
        assert not terminated.any() and not truncated.any() and rewards == pytest.approx([0.0, -0.005])
        assert envs.state.periods[0] == 0 and info["collected"].tolist() == [0, 0]


def test_one_harvester_is_a_vector_too():
    assert HarvestVectorEnv().reset(seed=0)[0].shape == (1, 12 + 3 + 32)


@pytest.mark.parametrize("vision", ["rendered", "measured_errors", "ideal"])
def test_each_vision_is_the_same_alone_side_by_side_and_in_one_set_of_arrays_to_the_bit(vision):
    """Several resets: rendered pictures, recall and errors come from each harvester's own generator."""
    given = {"vision": vision, "fruit": 2}
    native = HarvestVectorEnv(2, **given)
    together = gym.make_vec("pickenv/Harvest-v0", num_envs=2, vectorization_mode="sync", **given)
    alone = [HarvestEnv(**given) for _ in range(2)]
    for seed in (3, None):  # the second goes on from the first
        seen, info = native.reset(seed=seed)
        assert np.array_equal(seen, together.reset(seed=seed)[0])
        singles = [env.reset(seed=None if seed is None else seed + i) for i, env in enumerate(alone)]
        assert np.array_equal(seen, [observation for observation, _ in singles])
        assert info["located"].tolist() == [told["located"] for _, told in singles]
        for name in ("believed", "located", "error", "fruit"):
            assert np.array_equal(getattr(native.state, name), [getattr(env.state, name)[0] for env in alone])


def test_an_empty_cup_looks_again_with_the_same_error():
    env = HarvestEnv(fruit=4)
    env.reset(seed=2)
    state, machine = env.state, env.task.machine
    state.shift[0, 1] = [0.01, 0.0, 0.0]
    tips = np.full((1, machine.arms, 3), 9.0)
    tips[0, 0] = state.fruit[0, 1] + state.shift[0, 1] + [0.03, 0.0, 0.0]  # too far beside it to take it
    error = state.believed[0, 1] - state.fruit[0, 1]
    assert np.linalg.norm(error) > 1e-6
    attempts(env.task, state, tips, [np.random.default_rng(0)])
    assert state.attempts[0] == 1
    assert state.believed[0, 1] - state.fruit[0, 1] - state.shift[0, 1] == pytest.approx(error, abs=1e-12)
