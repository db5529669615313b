"""Runs of policies on seeded fruit, and the final distance between the tool's true position and the fruit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents.policies.policy import Policy
from pickenv.arm import Array
from pickenv.base import InputError, seed_words, stream
from pickenv.envs import PickVectorEnv
from pickenv.inspect.runs.recorded_episodes import Reaches as Reaches, believed_joints, reaches_of

FRUIT = ("collected", "damaged", "attempted", "reachable")
"""Names of the counts of fruit that `pick_canopies` returns for each canopy."""


def pick_canopies(
    policy: Any, envs: PickVectorEnv, seed: int | Sequence[int], options: dict[str, Any] | None = None
) -> dict[str, Array]:
    """Run a policy on one canopy in each of N environments, and sum up the outcomes.

    Args:
        policy: Policy that acts on observations ``(N, k)``.
        envs: The environments, which reset themselves after an episode.
        seed: Seed or seeds, passed to `reset`.
        options: Options, passed to `reset`.

    Returns:
        Arrays ``(N,)`` by name, one entry per canopy. The names in `FRUIT` hold numbers of fruit. "duration_s" and
        "steps" are duration and number of steps, and "reward" is the sum of the rewards. "error_sum_mm" sums the
        distance between the fruit and the tool's true position over all grasps. "tilt_sum_deg" sums the angle between
        the tool's true axis and the vertical over all grasps.
    """
    policy.reset()
    observation, _ = envs.reset(seed=seed, options=options)
    over, steps = np.zeros(envs.num_envs, dtype=np.bool_), 0
    sums = ("reward", "error_sum_mm", "tilt_sum_deg")
    totals = {name: np.zeros(envs.num_envs) for name in (*FRUIT, "duration_s", "steps", *sums)}
    grasps = np.zeros(envs.num_envs)
    while not over.all():
        fresh, rewards, terminated, truncated, infos = envs.step(policy.act(observation))
        steps += 1
        totals["reward"] += np.where(over, 0.0, rewards)
        grasped, grasps = ~over & (infos["attempted"] > grasps), np.where(over, grasps, infos["attempted"])
        totals["error_sum_mm"] += np.where(grasped, np.hypot(infos["grasp_lateral_mm"], infos["grasp_axial_mm"]), 0.0)
        totals["tilt_sum_deg"] += np.where(grasped, infos["tilt_deg"], 0.0)
        ended = (terminated | truncated) & ~over
        totals["steps"][ended] = steps
        for name in (*FRUIT, "duration_s"):
            totals[name][ended] = infos[name][ended]
        over |= ended
        observation = np.where(over[:, None], observation, fresh)  # canopies that are done ask for no thought
    return totals


LONGEST_EPISODE = 10_000
"""Number of steps after which an episode counts as having no time limit."""


def episode_seeds(seed: int, count: int) -> tuple[int, ...]:
    """Return seeds for ``count`` evaluation episodes; no other ``seed`` and no training uses them."""
    return tuple(seed_words(stream(seed, "fruit"), count))


class Moment(NamedTuple):
    """Reward and info of an episode after its reset or after one of its steps.

    Attributes:
        reward: Reward of the step; 0 after the reset.
        info: The environment's info.
        target: Joint values ``(n,)``, rad or m, to which the controller has sent the arm; it takes the arm to be there.
            None if the environment does not report them.
    """

    reward: float
    info: Mapping[str, Any]
    target: Array | None = None


def run_episodes(
    env: gym.Env[Any, Any], policy: Policy, seeds: Sequence[int], progress: Callable[[int], None] | None = None
) -> list[list[Moment]]:
    """Run one episode per seed, and return the moments of each episode as a list.

    Args:
        env: An environment with a time limit.
        policy: Policy to run.
        seeds: One seed per episode.
        progress: Called after each episode with the number of episodes done.

    Raises:
        InputError: If there are no seeds, or an episode does not end within `LONGEST_EPISODE` steps.
    """
    if not seeds:
        raise InputError("there are no episodes to run; give at least one seed")
    episodes = []
    for done, seed in enumerate(seeds, start=1):
        observation, info = env.reset(seed=seed)
        policy.reset()
        moments = [Moment(0.0, info, believed_joints(env))]
        for _ in range(LONGEST_EPISODE):
            observation, reward, terminated, truncated, info = env.step(policy.act(observation))
            moments.append(Moment(float(reward), info, believed_joints(env)))
            if terminated or truncated:
                break
        else:
            raise InputError(
                f"an episode did not end within {LONGEST_EPISODE} steps; give the environment a time limit"
            )
        episodes.append(moments)
        if progress is not None:
            progress(done)
    return episodes


def run_reaches(
    env: gym.Env[Any, Any], policy: Policy, seeds: Sequence[int], progress: Callable[[int], None] | None = None
) -> Reaches:
    """Run one episode per seed and return the last step of each.

    Args:
        env: A reach environment with a time limit.
        policy: Policy to run.
        seeds: One seed per episode; the same seeds give the same fruit to every policy.
        progress: Called after each episode with the number of episodes done.

    Raises:
        InputError: If there are no seeds, or an episode does not end.
    """
    infos = [episode[-1].info for episode in run_episodes(env, policy, seeds, progress)]
    inner: Any = env.unwrapped
    return reaches_of(inner.plant.geometry, seeds, {key: np.array([info[key] for info in infos]) for key in infos[0]})
