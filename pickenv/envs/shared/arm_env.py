"""What single environments of one arm have in common: the task, the true arm and its compensator."""

from __future__ import annotations

from typing import Any

import numpy as np

from pickenv.arm import Array, Plant, plant_at
from pickenv.envs.shared.drawn_env import DrawnEnv
from pickenv.envs.shared.task import Compensate, Task

Information = dict[str, Any]


class ArmEnv(DrawnEnv):
    """An environment of one arm.

    Attributes:
        task: What it simulates.
        plant: The true arm.
        compensator: Turns joint targets into joint commands, or None.
    """

    def __init__(self, task: Task, render_mode: str | None) -> None:
        super().__init__(render_mode)
        self.task: Task = task
        self.metadata = {**type(self).metadata, "render_fps": task.situation.frames_per_second}
        self.plant: Plant = task.plant if task.arms == "fixed" else plant_at(task.plant, 0)
        self.compensator: Compensate | None = None

    @property
    def increment(self) -> Array:
        """Largest increment of each joint in one action, rad or m."""
        return np.array(self.task.increment)
