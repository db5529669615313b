"""Reaches of many arms at once in pickenv's vector environment: one environment for each pair of arm and fruit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.evaluation.reaches import episode_seeds
from pickenv.agents.policies.policy import Policy, attitude_after, read_observation
from pickenv.arm import Array, Pose, displace_pose, forward
from pickenv.base import InputError, seed_words, stream
from pickenv.envs import ReachVectorEnv
from pickenv.inspect.runs.recorded_episodes import Reaches, reaches_of
from pickenv.orchard import Gripper, capture_probability, misalignment
from pickenv.wrappers import Compensate

MOST_ROWS = 2048
"""Largest number of environments whose joints a compensator gets in one call (`pickenv.envs.reaching.batch.BLOCK`)."""

PolicyMaker = Callable[[Any, int], Policy]
"""Function ``(env, seed)`` that makes a policy for an environment."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """Final steps of R episodes on many arms, and the position error after each step.

    Attributes:
        reaches: Last step of each episode.
        arm: Index of each episode's arm ``(R,)``.
        wanted_rotation: Tool attitude that each episode wants ``(R, 3, 3)``, as a rotation matrix.
        error_mm: Distance between the tool's true position and the fruit after each step ``(steps, R)``.
    """

    reaches: Reaches
    arm: NDArray[np.int64]
    wanted_rotation: Array
    error_mm: Array

    def capture(self, gripper: Gripper) -> Array:
        """Probability ``(R,)`` that the gripper captures the fruit at the end of each episode."""
        target = Pose(np.zeros((len(self.arm), 3)), self.wanted_rotation)
        axis = displace_pose(target, self.reaches.pose_error).rotation[..., 2]
        offset = self.reaches.fruit_position - self.reaches.tool_position
        return capture_probability(gripper, *misalignment(offset, axis, self.wanted_rotation[..., 2]))

    def cycle_steps(self, tolerance_mm: float) -> Array:
        """Number of steps ``(R,)`` until the error stays within ``tolerance_mm`` to the end; NaN if it never does."""
        inside = np.flip(np.logical_and.accumulate(np.flip(self.error_mm <= tolerance_mm, axis=0), axis=0), axis=0)
        return np.where(inside.any(axis=0), inside.argmax(axis=0) + 1.0, np.nan)


def roll_out(
    make: PolicyMaker,
    arms: int,
    episodes: int,
    seed: int,
    *,
    compensators: Sequence[Compensate] | None = None,
    sequential: bool = False,
    steps: int = 60,
    first: int = 0,
    **arguments: Any,
) -> Rollout:
    """Run a policy on ``episodes`` fruit with each of ``arms`` arms.

    Args:
        make: Function ``(env, seed)`` that makes the policy; its attribute ``envs``, if it has one, makes the
            environments.
        arms: Number of arms to run; the population has ``first`` arms more.
        episodes: Number of fruit per arm. Fruit, arms and camera noise depend on ``seed`` alone, so that runs can be
            paired.
        seed: Seed of the episodes and of the policy's own random draws.
        compensators: One compensator per arm, or None for raw arms.
        sequential: Whether each arm reaches for its fruit one after the other, for policies that learn from episode to
            episode.
        steps: Number of steps in an episode.
        first: Index in the population of the first arm; the arms after it have the next indices.
        arguments: Further keyword arguments of `pickenv/Reach-v0`.

    Raises:
        InputError: If there are no arms or no episodes.
    """
    if arms < 1 or episodes < 1:
        raise InputError(f"there are {arms} arms and {episodes} episodes; give at least one of each")
    arguments |= {"arms": "per_episode", "population": first + arms}
    numbers = np.arange(arms)
    seeds = np.array(episode_seeds(seed, arms * episodes)).reshape(episodes, arms)
    # One round holds every arm once; rows of several rounds run side by side where nothing is learnt in between.
    rounds = 1 if sequential else max(1, min(episodes, MOST_ROWS // arms))
    parts: list[Rollout] = []
    policy: Policy | None = None
    env: ReachVectorEnv | None = None
    for begin in range(0, episodes, rounds):
        block = seeds[begin : begin + rounds]
        rows = np.tile(numbers, len(block))
        if env is None or env.num_envs != len(rows):
            envs: Callable[..., ReachVectorEnv] = getattr(make, "envs", ReachVectorEnv)
            env = envs(len(rows), max_episode_steps=None, autoreset_mode="Disabled", **arguments)
            if compensators is not None:
                env.compensator = [compensators[row] for row in rows.tolist()]
            policy = make(env, seed_words(stream(seed, "policy", begin), 1)[0])
        assert policy is not None
        parts.append(_run(env, policy, rows, block.ravel(), steps, first))
    return _joined(parts)


def _run(
    env: ReachVectorEnv, policy: Policy, rows: NDArray[np.int64], seeds: NDArray[np.int64], steps: int, first: int
) -> Rollout:
    observation, infos = env.reset(seed=seeds.tolist(), options={"arm": first + rows})
    geometry = env.task.plant.arm.nominal
    reading = read_observation(geometry, getattr(env, "raw", observation))
    target = attitude_after(forward(geometry, reading.joints), reading.turn)
    policy.reset()
    errors = []
    for _ in range(steps):
        observation, _, _, _, infos = env.step(policy.act(observation))
        errors.append(infos["position_error_mm"].copy())
    reaches = reaches_of(env.plant.geometry, seeds.tolist(), infos)
    return Rollout(reaches, rows.astype(np.int64), target, np.array(errors))


def _joined(parts: Sequence[Rollout]) -> Rollout:
    arrays = [field.name for field in fields(Reaches) if field.name != "seeds"]
    reaches = Reaches(
        seeds=tuple(seed for part in parts for seed in part.reaches.seeds),
        **{name: np.concatenate([getattr(part.reaches, name) for part in parts]) for name in arrays},
    )
    arm, target = (np.concatenate([getattr(part, name) for part in parts]) for name in ("arm", "wanted_rotation"))
    return Rollout(reaches, arm, target, np.concatenate([part.error_mm for part in parts], axis=1))
