"""A window on the screen that shows one picture after the other."""

from __future__ import annotations

import os
import sys
from typing import Any

from pickenv.errors import InputError
from pickenv.pictures.stage import Pixels

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
DPI = 80


class Window:
    """A matplotlib window that shows one picture after the other.

    With MPLBACKEND=agg in the environment nothing is shown and nothing is said: tests without a screen use that.

    Raises:
        InputError: If there is no display.
    """

    def __init__(self, frames_per_second: float) -> None:
        self.off_screen = os.environ.get("MPLBACKEND", "").lower() == "agg"
        needs_display = sys.platform not in ("win32", "darwin") and not any(map(os.environ.get, DISPLAYS))
        if needs_display and not self.off_screen:
            raise InputError("render_mode='human' needs a display, and there is none; use render_mode='rgb_array'")
        self.pause = 1.0 / frames_per_second
        self._figure: Any = None
        self._image: Any = None

    def show(self, picture: Pixels) -> None:
        """Show a picture for one frame's time."""
        if self.off_screen:
            return
        from matplotlib import pyplot

        if self._figure is None:
            height, width = picture.shape[:2]
            self._figure = pyplot.figure("pickenv", figsize=(width / DPI, height / DPI), dpi=DPI)
            axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.set_axis_off()
            self._image = axes.imshow(picture)
            pyplot.show(block=False)
        self._image.set_data(picture)
        self._figure.canvas.draw_idle()
        self._figure.canvas.start_event_loop(self.pause)

    def close(self) -> None:
        """Close the window."""
        if self._figure is not None:
            from matplotlib import pyplot

            pyplot.close(self._figure)
            self._figure = self._image = None
