"""Any client's policy, judged raw and behind calibrations of the same arm, on the same fruit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
from numpy.typing import ArrayLike

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents.evaluation.calibrated import COMPENSATIONS, CalibrationPlan, calibrate_arm, check_compensation
from pickenv.agents.evaluation.reaches import episode_seeds
from pickenv.envs.shared.task import check_count
from pickenv.errors import InputError
from pickenv.inspect.runs.episode_ends import Reaches, reaches_of
from pickenv.wrappers.compensation import CompensationVectorWrapper


def reaches_behind(
    act: Callable[[Any], ArrayLike],
    compensations: Sequence[str] = COMPENSATIONS[:3],
    *,
    id: str = "pickenv/ReachScaled-v0",
    plant: str = "qiao2026",
    episodes: int = 100,
    seed: int = 0,
    **arguments: Any,
) -> dict[str, Reaches]:
    """Let a policy reach for the same fruit raw and calibrated.

    Args:
        act: Takes observations of all episodes at once, ``(N, ...)`` or a dict of them, and gives actions ``(N, n)``.
        compensations: Of "raw", "ls", "ls_bpnn" and "best"; each calibrates the arm anew with a simulated tracker.
        id: A reach environment with a native vector.
        plant: The arm as it is.
        episodes: N, one fruit each.
        seed: Seed of fruit and calibrations; no two seeds share any.
        arguments: Further arguments of the environment.

    Returns:
        The ends of the episodes for each compensation.

    Raises:
        InputError: If a compensation or an argument is unknown, or the environment has no native vector.
    """
    check_count("episodes", episodes)
    for name in compensations:
        check_compensation(name)
    if id not in gym.registry or gym.spec(id).vector_entry_point is None:
        raise InputError(f"'{id}' is no environment with a native vector; give one such as pickenv/ReachScaled-v0")
    seeds = episode_seeds(seed, episodes)
    found = {}
    for name in compensations:
        envs: Any = gym.make_vec(id, num_envs=episodes, autoreset_mode="Disabled", plant=plant, **arguments)
        inner = envs.unwrapped
        if name != "raw":
            calibration = calibrate_arm(inner.task.plant, name, CalibrationPlan(seed=seed))
            envs = CompensationVectorWrapper(envs, calibration.compensator())
        seen, infos = envs.reset(seed=list(seeds))
        for _ in range(inner.max_episode_steps):
            seen, _, _, _, infos = envs.step(act(seen))
        found[name] = reaches_of(inner.plant.geometry, seeds, infos)
    return found
