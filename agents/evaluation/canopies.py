"""What becomes of a canopy's fruit under a policy, in many environments `pickenv/Pick-v0` side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pickenv.arm import Array
from pickenv.envs.picking.pick_vector import PickVectorEnv

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
