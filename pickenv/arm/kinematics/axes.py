"""Modified DH parameters of any serial chain, from its joint axes at the zero position.

Frame i has z on joint axis i and x on the common normal to axis i + 1 (Craig 2005, section 3.4). Frame 0 coincides with
frame 1 at zero, so alpha0, a0, theta1 and d1 are zero and the base pose carries the rest. Metres and radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import Array, Geometry, Pose
from pickenv.errors import InputError

PARALLEL = 1e-9
"""Axes whose directions have a cross product shorter than this count as parallel."""


def geometry_from_axes(
    joint_names: tuple[str, ...],
    prismatic: tuple[bool, ...],
    points: ArrayLike,
    directions: ArrayLike,
    tool: Pose,
    lower: ArrayLike,
    upper: ArrayLike,
) -> Geometry:
    """Turn joint axes into a `Geometry`.

    Args:
        joint_names: Names of the joints.
        prismatic: Joint types.
        points: A point on each axis at zero joints ``(n, 3)``, m, world frame.
        directions: Axis directions ``(n, 3)``, world frame.
        tool: Tool pose at zero joints, world frame.
        lower: Lower joint limits.
        upper: Upper joint limits.

    Raises:
        InputError: If an axis has no direction.
    """
    points, directions = np.asarray(points, dtype=float), np.asarray(directions, dtype=float)
    lengths = np.linalg.norm(directions, axis=1)
    if np.any(lengths < PARALLEL):
        raise InputError(f"axis {int(np.argmin(lengths)) + 1} has no direction; give a unit vector")
    z = directions / lengths[:, None]
    n = len(z)
    origins, x = np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(n):
        before = points[0] if i == 0 else origins[i - 1]
        near = points[i] + z[i] * (z[i] @ (before - points[i]))  # foot of the frame before on this axis
        if i == n - 1:
            origins[i], x[i] = near, _perpendicular(z[i], x[i - 1] if i else np.array([1.0, 0.0, 0.0]))
        else:
            previous = x[i - 1] if i else np.array([1.0, 0.0, 0.0])
            origins[i], x[i] = _common_normal(near, z[i], points[i + 1], z[i + 1], previous)
    table = np.zeros((4, n))
    for i in range(1, n):
        step = origins[i] - origins[i - 1]
        twist, turn = _angle(z[i - 1], z[i], x[i - 1]), _angle(x[i - 1], x[i], z[i])
        table[:, i] = twist, step @ x[i - 1], turn, step @ z[i]
    last = np.column_stack([x[-1], np.cross(z[-1], x[-1]), z[-1]])
    first = np.column_stack([x[0], np.cross(z[0], x[0]), z[0]])
    alpha, a, theta, d = table
    base = Pose(origins[0], first)
    hand = Pose(last.T @ (tool.position - origins[-1]), last.T @ tool.rotation)
    low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    return Geometry(joint_names, prismatic, alpha, a, theta, d, np.zeros(n), low, high, base, hand)


def _common_normal(near: Array, z: Array, point: Array, next_z: Array, previous: Array) -> tuple[Array, Array]:
    """Foot on axis (near, z) of the common normal to axis (point, next_z), and its direction."""
    cross = np.cross(z, next_z)
    sine = float(np.linalg.norm(cross))
    if sine < PARALLEL:  # any normal will do: take the one at ``near``
        across = point - near - z * (z @ (point - near))
        distance = float(np.linalg.norm(across))
        return near, across / distance if distance > PARALLEL else _perpendicular(z, previous)
    # Distance along z from ``near`` to the foot: volume of (point - near, next_z, cross) over sine squared.
    along = float(np.cross(point - near, next_z) @ cross) / sine**2
    return near + along * z, cross / sine


def _perpendicular(z: Array, wish: Array) -> Array:
    """The unit vector across ``z`` that is nearest to ``wish``."""
    across = wish - z * (z @ wish)
    if np.linalg.norm(across) < 1e-6:
        across = np.eye(3)[int(np.argmin(np.abs(z)))]
        across = across - z * (z @ across)
    return np.asarray(across / np.linalg.norm(across))


def _angle(start: Array, end: Array, axis: Array) -> float:
    """Angle from ``start`` to ``end`` about ``axis``, rad."""
    return float(np.arctan2(np.cross(start, end) @ axis, start @ end))
