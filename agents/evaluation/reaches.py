"""Running policies on seeded fruit and collecting how far the true tool ends from each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from pickenv.agents.policies.policy import Policy
from pickenv.errors import InputError
from pickenv.inspect.runs.episode_ends import Reaches, reaches_of
from pickenv.seeds import seed_words, stream

LONGEST_EPISODE = 10_000
"""Steps after which an episode counts as one without a time limit."""


def episode_seeds(seed: int, count: int) -> tuple[int, ...]:
    """Seeds of ``count`` evaluation episodes; no two seeds share one, nor any with a training."""
    return tuple(seed_words(stream(seed, "fruit"), count))


def run_reaches(
    env: gym.Env[Any, Any], policy: Policy, seeds: Sequence[int], progress: Callable[[int], None] | None = None
) -> Reaches:
    """Run one episode per seed and keep the last step of each.

    Args:
        env: A reach environment with its time limit.
        policy: The policy.
        seeds: One per episode; the same seeds give the same fruit to every policy.
        progress: Called after each episode with the number done.

    Raises:
        InputError: If there are no seeds, or an episode does not end.
    """
    if not seeds:
        raise InputError("there are no episodes to run; give at least one seed")
    last = []
    for done, seed in enumerate(seeds, start=1):
        observation, info = env.reset(seed=seed)
        policy.reset()
        for _ in range(LONGEST_EPISODE):
            observation, _, terminated, truncated, info = env.step(policy.act(observation))
            if terminated or truncated:
                break
        else:
            raise InputError(
                f"an episode did not end within {LONGEST_EPISODE} steps; give the environment a time limit"
            )
        last.append(info)
        if progress is not None:
            progress(done)
    inner: Any = env.unwrapped
    stacked = {key: np.array([info[key] for info in last]) for key in last[0]}
    return reaches_of(inner.plant.geometry, seeds, stacked)
