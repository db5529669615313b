"""Which part of a pose error the joints can remove, and how: the truncated pseudo-inverse of the joint Jacobian.

The hybrid picking arm has six joints but task rank 5 everywhere (J1, J2 and J4 are parallel, J5 and J6 too), so J^-1 of
Qiao 2026 eq (15) does not exist: singular values below `DIRECTION_TOLERANCE` of the largest are cut off, and the
attitude error along the missing direction is reported apart. One radian is weighed as one metre.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dgelss

from pickenv.arm.kinematics.geometry import Array, Geometry
from pickenv.arm.kinematics.jacobians import joint_jacobian

DIRECTION_TOLERANCE = 5e-3
"""Below this share of the largest singular value a direction counts as impossible.

On the picking arm the fifth singular value stays above 0.11 of the first, and a real arm's sixth below 0.001.
"""


POSITION_FIRST = 0.05
"""What a radian counts, in m, where fewer than six joints have to choose between position and attitude; else 1."""


def attitude_weight(joints: int) -> float:
    """What a radian counts against a metre in the task of an arm with so many joints."""
    return 1.0 if joints >= 6 else POSITION_FIRST


def truncated_inverse(jacobian: Array, tolerance: float = DIRECTION_TOLERANCE) -> Array:
    """Pseudo-inverse ``(..., n, 6)`` of ``jacobian`` ``(..., 6, n)`` with small singular values cut off."""
    if jacobian.ndim > 2:
        return np.asarray(np.linalg.pinv(jacobian, rcond=tolerance))
    rows, n = jacobian.shape  # one matrix: LAPACK itself, without NumPy's overhead
    return np.asarray(dgelss(jacobian, np.eye(max(n, rows), rows), cond=tolerance)[1][:n])


def task_directions(
    geometry: Geometry, q: ArrayLike, tolerance: float = DIRECTION_TOLERANCE, weight: float = 1.0
) -> tuple[Array, Array]:
    """Directions of tool motion, ordered from the easiest to the impossible, and how many of them are possible.

    Args:
        geometry: The arm.
        q: Joints ``(..., n)``.
        tolerance: Relative singular value below which a direction counts as impossible.
        weight: What a radian counts, in m.

    Returns:
        Orthonormal columns ``(..., 6, 6)`` (position in m, rotation vector in rad, world axes) and the task rank
        ``(...)``.
    """
    u, s, _ = np.linalg.svd(joint_jacobian(geometry, q) * np.repeat([1.0, weight], 3)[:, None])
    return u, np.sum(s > tolerance * s[..., :1], axis=-1)


def noncompensable_error(
    geometry: Geometry,
    q: ArrayLike,
    error: ArrayLike,
    tolerance: float = DIRECTION_TOLERANCE,
    weight: float = 1.0,
) -> Array:
    """The part ``(..., 6)`` of a pose error ``(..., 6)`` that no small joint motion removes.

    For the picking arm it is a rotation about z1 x z5 (Qiao 2026 digest, fact 4). With a ``weight`` of radians against
    metres it is what is left where the weighed error is smallest.
    """
    weights = np.repeat([1.0, weight], 3)
    u, rank = task_directions(geometry, q, tolerance, weight)
    impossible = np.arange(6) >= rank[..., None]
    along = np.einsum("...ij,...i->...j", u, np.asarray(error, dtype=float) * weights) * impossible
    return np.asarray(np.einsum("...ij,...j->...i", u, along) / weights)
