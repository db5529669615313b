"""Where the eye stands: at one point for every picture of a comparison, on screen and on paper. Metres, radians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.geometry import Array
from pickenv.inspect.comparison import Comparison

EYE_TURN, EYE_LIFT = 0.6, 0.45
"""rad; how far the eye stands beside and above the line from the arm's base through the field."""


def shown_box(comparison: Comparison) -> tuple[Array, float]:
    """Centre ``(3,)`` and radius of the field's grid, m: what the eye looks at."""
    size = np.asarray(comparison.grid_shape) * comparison.grid_step
    return comparison.grid_origin - comparison.grid_step / 2.0 + size / 2.0, float(np.linalg.norm(size) / 2.0)


def eye_direction(comparison: Comparison) -> Array:
    """Unit vector ``(3,)`` from the field to the eye: from beyond the field, above it and to one side."""
    centre, _ = shown_box(comparison)
    outward = np.arctan2(*(centre - comparison.nominal.base.position)[1::-1]) + EYE_TURN
    return np.array([np.cos(outward) * np.cos(EYE_LIFT), np.sin(outward) * np.cos(EYE_LIFT), np.sin(EYE_LIFT)])


def cut_away(comparison: Comparison) -> NDArray[np.bool_]:
    """Which field points ``(F,)`` lie in the corner nearest to the eye, where voxels would hide all others."""
    offset = comparison.field_points - shown_box(comparison)[0]
    return np.asarray(np.all(offset * np.sign(eye_direction(comparison)) > 0.0, axis=-1))
