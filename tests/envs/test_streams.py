"""Random numbers that are looked up: equal on all executors, even, independent of each other."""

import numpy as np
import pytest
from scipy import stats

from pickenv.envs.shared.backends import (
    FLOATS,
    GOAL,
    NUMPY,
    episode_key,
    normal,
    seed_word,
    stream_key,
    torch_executor,
    uniform,
)

SEEDS = np.arange(2000, dtype=np.uint64)


def numbers(count=2000, episode=0, draw=0):
    key = episode_key(NUMPY, np.arange(count, dtype=np.uint64), np.full(count, episode, dtype=np.uint64))
    return uniform(NUMPY, stream_key(NUMPY, key, GOAL), draw)


@pytest.mark.parametrize("seed", [0, 1, 2**63 + 5, 2**64 - 1])
def test_uniform_numbers_are_equal_to_the_bit_on_all_executors(seed):
    torch = pytest.importorskip("torch")
    x = torch_executor()
    plain = uniform(FLOATS, episode_key(FLOATS, seed, 3), 7)
    key = episode_key(NUMPY, np.array([seed], np.uint64), np.array([3], np.uint64))
    signed = torch.as_tensor(np.array([seed], np.uint64).view(np.int64))
    other = uniform(x, episode_key(x, signed, torch.tensor([3])), 7)
    assert plain == uniform(NUMPY, key, 7)[0] == other.item()
    assert plain == uniform(NUMPY, key, np.array([7], np.uint64))[0]


def test_normal_numbers_agree_closely():
    key = episode_key(NUMPY, SEEDS, np.zeros_like(SEEDS))
    many = normal(NUMPY, key, 2)
    one = [normal(FLOATS, episode_key(FLOATS, int(seed), 0), 2) for seed in SEEDS[:50]]
    np.testing.assert_allclose(many[:50], one, rtol=0, atol=1e-12)
    assert stats.kstest(many, "norm").pvalue > 1e-3


def test_numbers_are_even_over_seeds_episodes_and_draws():
    columns = [numbers(), numbers(episode=1), numbers(draw=1), numbers(draw=1000)]
    for column in columns:
        assert column.min() >= 0 and column.max() < 1
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    correlation = np.corrcoef(columns)
    assert np.abs(correlation - np.eye(4)).max() < 0.08


def test_seeds_of_any_size_are_taken():
    assert seed_word(5) == 5
    assert 0 <= seed_word(2**200 + 1) < 2**64
    assert seed_word(2**64 + 1) != seed_word(2**65 + 1)


def test_normal_numbers_that_follow_one_another_share_nothing():
    """Neither they nor their squares go together: each is made of two even numbers of its own."""
    key = episode_key(NUMPY, np.arange(100_000, dtype=np.uint64), np.zeros(100_000, np.uint64))
    drawn = np.array([normal(NUMPY, key, draw) for draw in range(4)])
    found = np.corrcoef(np.concatenate([drawn, drawn**2, np.abs(drawn) * drawn]))
    apart = np.tile(np.eye(4), (3, 3)) == 0.0
    assert np.abs(found[apart]).max() < 5.0 / np.sqrt(100_000)
