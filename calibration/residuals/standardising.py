"""Standardising data whose columns may not vary: a joint that never moved, a residual that is the same everywhere."""

from __future__ import annotations

import numpy as np

from pickenv.arm.kinematics.geometry import Array

CONSTANT = 1e-9
"""A column that varies by less than this share of its largest value is constant; the rest is rounding."""


def column_std(values: Array, constant: float) -> Array:
    """Standard deviation of each column of ``values`` ``(N, F)``, or ``constant`` where a column does not vary.

    Give 1 for inputs, so that a later change stays in proportion, and something tiny for outputs, so that a model's
    error on a constant output stays tiny.
    """
    std = values.std(axis=0)
    return np.where(std <= CONSTANT * np.max(np.abs(values), axis=0, initial=0.0), constant, std)
