"""Where the eye stands: at one point for every picture of a comparison, on screen and on paper. Metres, radians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.inspect.runs.comparison import Comparison

EYE_TURN, EYE_LIFT = 0.5, 0.45
"""rad; how far the eye stands beside and above the normal of the field's widest upright face."""


def shown_box(comparison: Comparison) -> tuple[Array, float]:
    """Centre ``(3,)`` and radius of the field's grid, m: what the eye looks at."""
    size = np.asarray(comparison.grid_shape) * comparison.grid_step
    return comparison.grid_origin - comparison.grid_step / 2.0 + size / 2.0, float(np.linalg.norm(size) / 2.0)


def eye_direction(comparison: Comparison) -> Array:
    """Unit vector ``(3,)`` from the field to the eye, which looks from outside at the widest upright face, obliquely.

    Outside is where the arm's base is not; oblique, so that cells behind each other do not hide each other.
    """
    width_x, width_y, _ = comparison.grid_shape
    x, y, _ = shown_box(comparison)[0] - comparison.nominal.base.position
    outward = float(np.arctan2(y, x))
    along_x = width_y > width_x or (width_y == width_x and abs(x) > abs(y))
    normal = float(np.arctan2(0.0, x) if along_x else np.arctan2(y, 0.0))
    side = 1.0 if np.sin(outward - normal) >= 0.0 else -1.0
    turn = normal + side * EYE_TURN
    return np.array([np.cos(turn) * np.cos(EYE_LIFT), np.sin(turn) * np.cos(EYE_LIFT), np.sin(EYE_LIFT)])


def cut_away(comparison: Comparison) -> NDArray[np.bool_]:
    """Which field points ``(F,)`` lie in the corner nearest to the eye, where voxels would hide all others."""
    offset = comparison.field_points - shown_box(comparison)[0]
    return np.asarray(np.all(offset * np.sign(eye_direction(comparison)) > 0.0, axis=-1))
