"""Draws a stage: with VTK where it is installed and can draw here, else plainly with Pillow.

VTK needs EGL, of which a bare computer has none; it then ends the whole program. So another process tries it first.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import lru_cache
from typing import TYPE_CHECKING

from pickenv.extras import is_there, require
from pickenv.pictures.lettering import lettered
from pickenv.pictures.stage import Pixels, Stage

if TYPE_CHECKING:
    from pickenv.pictures.vtk_drawer import VtkDrawer

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
