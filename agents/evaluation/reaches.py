"""Running policies on seeded fruit and collecting how far the true tool ends from each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents.policies.policy import Policy
from pickenv.arm import Array
from pickenv.base import InputError, seed_words, stream
from pickenv.envs import PickVectorEnv
from pickenv.inspect.runs.episode_summary import Reaches as Reaches, reaches_of

# What becomes of a canopy's fruit under a policy, in many environments `pickenv/Pick-v0` side by side.


FRUIT = ("collected", "damaged", "attempted", "reachable")
"""What is counted of each canopy."""


def pick_canopies(policy: Any, envs: PickVectorEnv, seed: int | Sequence[int]) -> dict[str, Array]:
    """Let a policy pick one canopy in each environment.

    Args:
        policy: Acts on observations ``(N, k)``.
        envs: The environments, which begin anew by themselves.
        seed: As `reset` takes it.

    Returns:
        Arrays ``(N,)``: `FRUIT`, "steps" that the canopy took, and "reward", their sum.
    """
    policy.reset()
    seen, _ = envs.reset(seed=seed)
    over, steps = np.zeros(envs.num_envs, dtype=np.bool_), 0
    found = {name: np.zeros(envs.num_envs) for name in (*FRUIT, "steps", "reward")}
    while not over.all():
        fresh, rewards, terminated, truncated, infos = envs.step(policy.act(seen))
        steps += 1
        found["reward"] += np.where(over, 0.0, rewards)
        ended = (terminated | truncated) & ~over
        found["steps"][ended] = steps
        for name in FRUIT:
            found[name][ended] = infos[name][ended]
        over |= ended
        seen = np.where(over[:, None], seen, fresh)  # canopies that are done ask for no thought
    return found


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
        for moment in moments_of(env, policy, seed):
            info = moment.info
        last.append(info)
        if progress is not None:
            progress(done)
    inner: Any = env.unwrapped
    stacked = {key: np.array([info[key] for info in last]) for key in last[0]}
    return reaches_of(inner.plant.geometry, seeds, stacked)


class Moment(NamedTuple):
    """What is known after a reset or a step.

    Attributes:
        reward: Of the step; 0 after the reset.
        info: The environment's.
    """

    reward: float
    info: Mapping[str, Any]


def moments_of(
    env: gym.Env[Any, Any],
    policy: Policy,
    seed: int,
    options: dict[str, Any] | None = None,
    steps: int | None = None,
) -> Iterator[Moment]:
    """Run one episode, moment by moment from the reset on.

    Args:
        env: An environment; with its time limit, where ``steps`` is None.
        policy: The policy.
        seed: Of the episode.
        options: Of the reset.
        steps: After which the episode is left.

    Raises:
        InputError: If the episode does not end.
    """
    observation, info = env.reset(seed=seed, options=options)
    policy.reset()
    yield Moment(0.0, info)
    for _ in range(LONGEST_EPISODE if steps is None else steps):
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        yield Moment(float(reward), info)
        if terminated or truncated:
            return
    if steps is not None:
        return
    raise InputError(f"an episode did not end within {LONGEST_EPISODE} steps; give the environment a time limit")
