"""Pictures of a reach: the nominal arm as a ghost, the true arm, and the fruit; and the window that shows them.

matplotlib is loaded by drawings and nowhere else among the environments. Units: m in views of the arm, mm around the
fruit.
"""

from __future__ import annotations

import math
import os
import sys
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from pickenv.arm import Array, Plant
from pickenv.arm.kinematics.forward import chain_of, frames
from pickenv.envs.shared.simulation import View
from pickenv.errors import InputError

GHOST, TRUE, FRUIT = "#9aa5b1", "#1f4e79", "#c0392b"
SIZE = (9.0, 4.5)
DPI = 80
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def pixels(figure: Figure) -> NDArray[np.uint8]:
    """A figure as an RGB array ``(360, 720, 3)``."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3].copy()


def draw_reach(plant: Plant, target: Array, scene: View, tolerance_mm: float) -> Figure:
    """Draw the arm on the left and the surroundings of the fruit on the right.

    Args:
        plant: The true arm, on single numbers.
        target: Nominal joint target ``(n,)``, rad or m.
        scene: What is to be seen, on floats.
        tolerance_mm: Radius of the capture region.
    """
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    fruit = np.array(scene.fruit)[None]
    draw_arm(figure, plant, target, np.array(scene.command), np.array(scene.tool), fruit, [FRUIT])
    near = figure.add_subplot(1, 2, 2)
    miss = 1e3 * np.array(scene.error[:3])
    across = math.hypot(miss[0], miss[1])
    limit = 1.25 * max(2.0 * tolerance_mm, abs(miss[2]), across)
    near.add_patch(Circle((0.0, 0.0), tolerance_mm, facecolor="none", edgecolor=FRUIT, linestyle="--"))
    near.plot(0.0, 0.0, "o", color=FRUIT, label="fruit, and what the gripper forgives")
    near.plot(across, miss[2], "x", color=TRUE, markersize=9, label="true tool")
    near.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
    near.set(xlabel="horizontal miss (mm)", ylabel="vertical miss (mm)")
    near.set_title(f"{scene.distance_mm:.2f} mm, {scene.angle_deg:.2f} deg from the fruit")
    near.legend(loc="upper left", fontsize=8)  # the miss is never on the left
    return figure


def draw_arm(
    figure: Figure, plant: Plant, target: Array, command: Array, tool: Array, fruit: Array, colours: list[str]
) -> None:
    """Draw nominal and true arm and the fruit ``(k, 3)``, m, into the figure's left half."""
    view: Any = figure.add_subplot(1, 2, 1, projection="3d")
    ghost = joint_positions(plant, target, nominal=True)
    true = np.vstack([joint_positions(plant, command, nominal=False)[:-1], tool])
    view.plot(*ghost.T, color=GHOST, linewidth=6, alpha=0.5, label="nominal arm")
    view.plot(*true.T, color=TRUE, linewidth=2, marker="o", markersize=3, label="true arm")
    view.scatter(*fruit.T, color=colours, s=40)
    points = np.vstack([ghost, true, fruit])
    middle, half = (points.max(axis=0) + points.min(axis=0)) / 2, np.ptp(points, axis=0).max() / 2
    for set_limits, centre in zip((view.set_xlim, view.set_ylim, view.set_zlim), middle, strict=True):
        set_limits(centre - half, centre + half)
    view.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    view.legend(loc="upper left", fontsize=8)


def joint_positions(plant: Plant, joints: Array, *, nominal: bool) -> Array:
    """Origins of base and links ``(n + 1, 3)``, m, for joints ``(n,)``; bending is left to the tool's own position."""
    chain = chain_of(plant.arm.nominal) if nominal else plant.chain
    return np.array([frame[9:12] for frame in frames(math, chain, joints.tolist())], dtype=float)


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

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture for one frame's time."""
        if self.off_screen:
            return
        from matplotlib import pyplot

        if self._figure is None:
            self._figure = pyplot.figure("pickenv", figsize=SIZE)
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
