"""Draws a stage: with VTK where it is installed and can draw here, else plainly with Pillow.

VTK needs EGL, of which a bare computer has none; it then ends the whole program. So another process tries it first.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from pickenv.base import InputError, is_there, require
from pickenv.pictures.lettering import lettered
from pickenv.pictures.stage import Pixels, Stage

if TYPE_CHECKING:
    from pickenv.pictures.vtk_drawer import VtkDrawer

# A window on the screen that shows one picture after the other.


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


PLAIN = "PICKENV_PLAIN_PICTURES"
"""Set in the environment, it keeps to Pillow."""
TRIAL = "pickenv.pictures.vtk_drawer"
"""The program that tries it."""


def painted(stage: Stage) -> Pixels:
    """Draw a stage: red, green and blue ``(height, width, 3)``."""
    if drawer_name() == "vtk":
        pixels = _vtk(stage.size, os.getpid()).draw(stage)
    else:
        from pickenv.pictures.plain_drawer import draw_plainly

        pixels = draw_plainly(stage)
    return lettered(pixels, stage)


@lru_cache(maxsize=1)
def drawer_name() -> str:
    """Which drawer pictures are made by here: ``vtk`` or ``plain``; found out once."""
    return "vtk" if why_plain() is None else "plain"


def why_plain() -> str | None:
    """Why pictures are drawn plainly, as one sentence; None where VTK draws them."""
    require("matplotlib")
    if os.environ.get(PLAIN):
        return f"Pictures are drawn plainly, as {PLAIN} asks."
    if not is_there("vtkmodules"):
        return "Pictures are drawn plainly; for solid bodies install VTK: pip install 'pickenv[render]'"
    if subprocess.run([sys.executable, "-m", TRIAL], capture_output=True, check=False, timeout=120).returncode != 0:
        return "Pictures are drawn plainly: VTK cannot draw here without EGL; on Debian and Ubuntu: apt install libegl1"
    return None


@lru_cache(maxsize=4)
def _vtk(size: tuple[int, int], process: int) -> VtkDrawer:
    """One drawer for each size, in each process."""
    from pickenv.pictures.vtk_drawer import VtkDrawer

    return VtkDrawer(size)
