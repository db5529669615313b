"""A reach as a stage to draw. Units: m; mm and degrees in words."""

from __future__ import annotations

import numpy as np

from pickenv.arm import Array, Geometry, forward
from pickenv.envs.shared.drawing import GHOST_WORDS, arm_at_work, ground_below, staged, standing, tool_dial
from pickenv.envs.shared.simulation import View
from pickenv.pictures.arm_shapes import CUP_RADIUS, arm_look, cup_solids, joined_solids
from pickenv.pictures.stage import SIZE, Eye, Stage, Words, fitted_eye
from pickenv.pictures.tree_shapes import fruit_colours, fruit_solids, sprig

FRUIT = 0.06
"""Diameter that is drawn; a reach knows of a place alone."""


def draw_reach(nominal: Geometry, scene: View, tolerance_mm: float, dark: bool) -> Stage:
    """The arm, its ghost and the fruit.

    Args:
        nominal: The arm as its controller believes it to be.
        scene: What is to be seen, on floats.
        tolerance_mm: Radius of the capture region.
        dark: Whether the background is dark.
    """
    look = arm_look(nominal)
    command, tool, fruit = np.array(scene.command), np.array(scene.tool), np.array(scene.fruit)
    axis = forward(nominal, command).rotation[:, 2]
    solids = joined_solids(
        arm_at_work(nominal, command, tool, axis, np.array(scene.believed)),
        cup_solids(tool, axis, CUP_RADIUS),
        fruit_solids(fruit[None], FRUIT, fruit_colours(1)),
        sprig(fruit, FRUIT),
    )
    words = (
        Words(f"{scene.distance_mm:.2f} mm, {scene.angle_deg:.2f}° from the fruit", large=True),
        Words(f"green ring: {tolerance_mm:g} mm", "bottom left"),
        Words(GHOST_WORDS, "bottom left"),
    )
    still = standing(nominal, ground_below(look, nominal), dark)
    return staged(solids, still, reach_eye(nominal), words, tool_dial(axis, tool - fruit, tolerance_mm), dark)


def reach_eye(geometry: Geometry) -> Eye:
    """Where an arm's whole room is seen from."""
    look = arm_look(geometry)
    low, high = np.minimum(look.low, geometry.base.position), np.maximum(look.high, geometry.base.position)
    corners = np.array(np.meshgrid(*np.stack([low, high], -1))).reshape(3, -1).T
    return fitted_eye(corners, VIEW, SIZE)


VIEW: Array = np.array([0.8, 1.0, 0.45])
"""From the arm to the eye."""
