"""Running policies on seeded fruit and collecting how far the true tool ends from each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import Policy
from pickenv.arm import noncompensable_error
from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError

LONGEST_EPISODE = 10_000
"""Steps after which an episode counts as one without a time limit."""


@dataclass(frozen=True, eq=False)
class Reaches:
    """The ends of R episodes.

    Attributes:
        seeds: Seed of each episode.
        pose_error: True tool against fruit ``(R, 6)``, m and rad.
        noncompensable: The part of it that no joint motion removes ``(R, 6)``.
        success: Whether the fruit was inside the capture region.
        joint_command: What the drives got at the end ``(R, n)``.
        tool_position: True tool positions ``(R, 3)``, m.
        fruit_position: Fruit ``(R, 3)``, m.
    """

    seeds: tuple[int, ...]
    pose_error: Array
    noncompensable: Array
    success: NDArray[np.bool_]
    joint_command: Array
    tool_position: Array
    fruit_position: Array

    @property
    def position_error_mm(self) -> Array:
        """Final distances ``(R,)``."""
        return np.asarray(np.linalg.norm(self.pose_error[:, :3], axis=1) * 1e3)

    @property
    def attitude_error_deg(self) -> Array:
        """Final attitude errors ``(R,)``."""
        return np.asarray(np.degrees(np.linalg.norm(self.pose_error[:, 3:], axis=1)))

    @property
    def noncompensable_deg(self) -> Array:
        """Their part that no joint motion removes ``(R,)``."""
        return np.asarray(np.degrees(np.linalg.norm(self.noncompensable[:, 3:], axis=1)))


def episode_seeds(seed: int, count: int) -> tuple[int, ...]:
    """Seeds of ``count`` evaluation episodes, spawned so that runs with neighbouring seeds share none."""
    children = np.random.SeedSequence(seed).spawn(count)
    return tuple(int(child.generate_state(1)[0]) for child in children)


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
    error, command = stacked["pose_error"], stacked["joint_command"]
    return Reaches(
        seeds=tuple(seeds),
        pose_error=error,
        noncompensable=noncompensable_error(inner.plant.geometry, command, error),
        success=stacked["is_success"],
        joint_command=command,
        tool_position=stacked["tool_position"],
        fruit_position=stacked["fruit_position"],
    )
