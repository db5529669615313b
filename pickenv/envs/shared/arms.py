"""Which true arm an environment has: one for all, or one of a population, chosen by the environment's random stream.

A population is one plant whose numbers are arrays (`pickenv.arm.plant.tolerances.draw_plants`). Environments keep
their own rows of these arrays, so that arms can be exchanged one by one without building a new plant.
"""

from __future__ import annotations

from pickenv.envs.shared.backends import Executor, Scalar
from pickenv.envs.shared.streams import ARM, episode_key, stream_key, uniform
from pickenv.envs.shared.task import Task


def drawn_arm(x: Executor, task: Task, seed: Scalar, key: Scalar) -> Scalar:
    """Number of an episode's true arm, before its fraction is cut off.

    Args:
        x: The executor.
        task: The task, whose arms are a population.
        seed: Seed of the environment's stream; with one arm per environment it alone decides.
        key: Key of the episode.
    """
    if task.arms == "per_env":
        key = episode_key(x, seed, x.times(seed, 0))
    return uniform(x, stream_key(x, key, ARM), 0) * task.population
