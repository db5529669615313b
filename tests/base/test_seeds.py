"""Streams: no two seeds, purposes, arms or environments share one."""

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, strategies as st

from pickenv.agents import HELD_OUT, Training, episode_seeds, make_model
from pickenv.base import InputError, run_seed, seed_words, stream
from pickenv.base.reproducibility import RUN
from pickenv.experiments.policies import population_seed
from pickenv.wrappers import make_sb3_vec

SEEDS = range(21)


def test_evaluations_with_seeds_0_to_20_share_nothing():
    """Fruit of 64 arms, populations, policies' draws, calibrations and what the training environments begin with."""
    words: list[int] = []
    for seed in SEEDS:
        words += [*episode_seeds(seed, 64 * 32), population_seed(seed)]
        words += [seed_words(stream(seed, "policy", first), 1)[0] for first in range(32)]
        words += [seed_words(part, 1)[0] for arm in range(64) for part in stream(seed, "calibration", arm).spawn(2)]
        words += seed_words(stream(seed, "training"), 256)
    assert len(set(words)) == len(words)
    assert max(words) < HELD_OUT


def test_environments_of_trainings_with_neighbouring_seeds_share_no_fruit():
    fruit = []
    for seed in (0, 1):
        _, env = make_model(Training("ppo", seed=seed, arguments={"plant": "geometry_only"}, parameters={"n_envs": 64}))
        env.reset()
        fruit += [tuple(row) for row in env.envs.unwrapped._seeds[:, None]]
        env.close()
    assert len(set(fruit)) == 128


@given(st.integers(0, 2**128), st.integers(1, 50), st.integers(0, 50))
def test_a_longer_list_begins_with_the_shorter(seed, count, more):
    sequence = stream(seed, "fruit")
    assert seed_words(sequence, count + more)[:count] == seed_words(sequence, count)


@given(st.integers(0, 2**64), st.integers(0, 2**64))
def test_equal_seeds_give_equal_streams_and_others_do_not(one, other):
    found = [np.random.default_rng(stream(seed, "camera")).integers(2**62) for seed in (one, one, other)]
    assert found[0] == found[1]
    assert (found[0] == found[2]) == (one == other)


def fruit_of(envs, seed):
    return {tuple(row) for row in envs.reset(seed=seed)[1]["fruit_position"].round(9).tolist()}


def test_neighbouring_runs_share_all_fruit_but_one_unless_their_seeds_are_far_apart():
    """What Gymnasium's counting does to clients that take one number, and what `run_seed` does about it."""
    envs = gym.make_vec("pickenv/ReachScaled-v0", num_envs=64)
    assert len(fruit_of(envs, 0) & fruit_of(envs, 1)) == 63
    runs = [fruit_of(envs, run_seed(run)) for run in range(3)]
    assert len(set.union(*runs)) == 3 * 64
    single = gym.make("pickenv/ReachScaled-v0")
    found = single.reset(seed=run_seed(2) + 5)[1]["fruit_position"].round(9)
    assert tuple(found.tolist()) in runs[2]


def test_runs_through_the_adapter_share_no_fruit():
    envs = make_sb3_vec("pickenv/ReachScaled-v0", 64)
    seen = []
    for seed in (0, 1):
        envs.seed(seed)
        seen += [tuple(row) for row in envs.reset().tolist()]
    assert len(set(seen)) == 128


def test_runs_have_blocks_of_seeds_to_themselves():
    assert [run_seed(run) for run in (0, 1, RUN - 1)] == [0, RUN, 2**32 - RUN]
    for wrong in (-1, RUN, 1.0, True):
        with pytest.raises(InputError, match="give a whole number from 0 to 65535"):
            run_seed(wrong)
