"""What single environments of one arm have in common: the task, the true arm, its compensator and its arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pickenv.arm import Array, Plant, plant_at, plants_on
from pickenv.envs.shared.backends import FLOATS, NUMPY, Executor, Scalar
from pickenv.envs.shared.drawn_env import DrawnEnv
from pickenv.envs.shared.exact import exact_plant
from pickenv.envs.shared.task import Compensate, Task, check_choice

Information = dict[str, Any]
EXECUTORS = {"floats": FLOATS, "numpy": NUMPY}


class ArmEnv(DrawnEnv):
    """An environment of one arm.

    Attributes:
        task: What it simulates.
        plant: The true arm.
        compensator: Turns joint targets into joint commands, or None.
    """

    def __init__(self, task: Task, render_mode: str | None, executor: str) -> None:
        check_choice("executor", executor, tuple(EXECUTORS))
        super().__init__(render_mode)
        self.task: Task = task
        self.metadata = {**type(self).metadata, "render_fps": task.situation.frames_per_second}
        self._x: Executor = EXECUTORS[executor]
        self.plant: Plant = task.plant if task.arms == "fixed" else plant_at(task.plant, 0)
        if self._x is NUMPY:
            self.plant = exact_plant(self.plant)
        self.compensator: Compensate | None = None

    @property
    def increment(self) -> Array:
        """Largest increment of each joint in one action, rad or m."""
        return np.array(self.task.increment)

    def _use_arm(self, number: int) -> None:
        """Make one arm of the population the true one."""
        if self._x is FLOATS:
            self.plant = plant_at(self.task.plant, number)
        else:
            self.plant = exact_plant(plants_on(self.task.plant, lambda values: values[number : number + 1]))

    def _command(self, target: Sequence[Scalar]) -> Sequence[Scalar]:
        """What the drives get for a joint target."""
        if self.compensator is None:
            return target
        wanted = np.array(self._plain(target))
        # As one of many, which is corrected in another order of operations than one alone.
        command = self.compensator(wanted) if self._x is FLOATS else self.compensator(wanted[None])[0]
        return self._numbers(command.tolist())

    def _numbers(self, values: Sequence[float]) -> Sequence[Scalar]:
        """Floats as the executor wants them."""
        return values if self._x is FLOATS else [np.array([value]) for value in values]

    def _plain(self, values: Sequence[Scalar]) -> list[float]:
        """The executor's numbers as floats."""
        if self._x is FLOATS:
            return list(values)
        return [float(value[0]) if isinstance(value, np.ndarray) else float(value) for value in values]

    def _word(self, number: int) -> Scalar:
        return number if self._x is FLOATS else np.array([number], dtype=np.uint64)
