"""One arm at work as a stage to draw: the true arm, the ghost of where its controller believes it to be, its base.

What the environments of one arm add to it stands beside them. Units: m; mm in words and on the dial.
"""

from __future__ import annotations

import numpy as np

from pickenv.arm import Array, Geometry
from pickenv.arm.kinematics.link_points import true_points
from pickenv.pictures.arm_shapes import (
    GAIN,
    ArmLook,
    Solids,
    arm_look,
    arm_solids,
    ghost_points,
    ghost_solids,
    joined_solids,
)
from pickenv.pictures.stage import Dial, Eye, Mesh, Rgb, Stage, Words
from pickenv.pictures.tree_shapes import ground_around, pedestal

MARK: Rgb = (0, 114, 178)
GHOST_WORDS = f"ghost: the arm as believed, deviation × {GAIN}"


def arm_at_work(geometry: Geometry, command: Array, tool: Array, axis: Array, believed: Array) -> Solids:
    """The true arm and its ghost.

    Args:
        geometry: The nominal arm.
        command: What the drives got ``(n,)``, rad or m.
        tool: True tool position ``(3,)``, m.
        axis: Direction in which it points ``(3,)``.
        believed: Where the controller believes it ``(3,)``, m.
    """
    look = arm_look(geometry)
    true = arm_solids(look, true_points(geometry, command, tool), axis)
    return joined_solids(true, ghost_solids(look, ghost_points(geometry, command, tool, believed)))


def standing(geometry: Geometry, ground: float, dark: bool) -> tuple[Mesh, ...]:
    """Ground, and what the arm's base stands on."""
    x, y, z = (float(value) for value in geometry.base.position)
    return ground_around(x, y, ground, dark), pedestal(x, y, ground, z, float(arm_look(geometry).radius[0]))


def ground_below(look: ArmLook, geometry: Geometry) -> float:
    """Height of a ground that an arm does not reach, m."""
    return float(min(look.low[2] - 0.1, geometry.base.position[2] - 0.35))


def across(axis: Array, offset: Array) -> Array:
    """The part of an offset (m) across the tool's axis, to the right and up as the eye sees it ``(2,)``, mm."""
    right = np.cross([0.0, 1.0, 0.0], axis)
    right /= max(float(np.linalg.norm(right)), 1e-9)
    return 1e3 * np.array([offset @ -right, offset @ -np.cross(axis, right)])


def tool_dial(axis: Array, offset: Array, tolerance_mm: float) -> Dial:
    """Where the true tool is, seen from the fruit along the tool's axis."""
    return Dial(across(axis, offset)[None], tolerance_mm, MARK)


def staged(
    solids: Solids, still: tuple[Mesh, ...], eye: Eye, words: tuple[Words, ...], dial: Dial | None, dark: bool
) -> Stage:
    """A stage of these solids."""
    return Stage(eye, *solids, still=still, words=words, dial=dial, dark=dark)
