"""What single environments of one arm have in common: the task, the true arm, its compensator, and pictures."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Plant, plant_at
from pickenv.envs.shared.task import Compensate, Task, check_choice
from pickenv.errors import InputError
from pickenv.extras import require

RENDER_MODES = ("human", "rgb_array")
Information = dict[str, Any]


class ArmEnv(gym.Env[Any, NDArray[np.float32]]):
    """An environment of one arm; `_picture` draws it, once an episode has begun.

    Attributes:
        task: What it simulates.
        plant: The true arm.
        compensator: Turns joint targets into joint commands, or None.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012

    def __init__(self, task: Task, render_mode: str | None) -> None:
        if render_mode is not None:
            check_choice("render_mode", render_mode, RENDER_MODES)
            require("matplotlib")
        self.task: Task = task
        self.plant: Plant = task.plant if task.arms == "fixed" else plant_at(task.plant, 0)
        self.render_mode = render_mode
        self.compensator: Compensate | None = None
        self._window: Any = None

    @property
    def increment(self) -> Array:
        """Largest increment of each joint in one action, rad or m."""
        return np.array(self.task.increment)

    def render(self) -> Any:
        """Draw the nominal ghost, the true arm and the fruit: an RGB array, or a window for "human"."""
        if self.render_mode is None:
            gym.logger.warn(
                "render does nothing without a render_mode; make the environment with 'rgb_array' or 'human'"
            )
            return None
        from pickenv.envs.shared.drawing import Window

        picture = self._picture()
        if picture is None:
            raise InputError("render was called before reset; call reset first")
        if self.render_mode == "rgb_array":
            return picture
        self._window = self._window or Window(self.metadata["render_fps"])
        self._window.show(picture)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def _picture(self) -> NDArray[np.uint8] | None:
        """The picture as an RGB array; None before the first reset."""
        raise NotImplementedError
