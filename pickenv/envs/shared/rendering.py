"""What `render` of a single environment does with its pictures: give them back, or show them in a window."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pickenv.errors import InputError

RENDER_MODES = ("human", "rgb_array")


class Screen:
    """A window that opens with the first picture for "human"."""

    def __init__(self, frames_per_second: float) -> None:
        self.frames_per_second = frames_per_second
        self._window: Any = None

    def show(self, mode: str | None, begun: bool, draw: Callable[[], NDArray[np.uint8]]) -> NDArray[np.uint8] | None:
        """The picture for "rgb_array"; nothing for "human", which shows it.

        Args:
            mode: One of `RENDER_MODES`; with None there is a warning and no picture.
            begun: Whether there is something to draw.
            draw: Draws the picture.

        Raises:
            InputError: If nothing has begun yet.
        """
        if mode is None:
            gym.logger.warn(
                "render does nothing without a render_mode; make the environment with 'rgb_array' or 'human'"
            )
            return None
        from pickenv.envs.shared.drawing import Window

        if not begun:
            raise InputError("render was called before reset; call reset first")
        picture = draw()
        if mode == "rgb_array":
            return picture
        self._window = self._window or Window(self.frames_per_second)
        self._window.show(picture)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None
