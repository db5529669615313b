"""Joint and parameter Jacobians of the tool pose, analytic, for batches of poses.

Rows are position (m) and rotation vector (rad) in world axes. The parameter Jacobian is Qiao 2026 eq (8) read as the
horizontal concatenation [J_1^6 V_1 ... J_6^6 V_6] (the paper prints a sum), turned from tool into world axes, and
extended by Hayati's beta, the base and the tool.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.forward import attach, chain_of, frames, split_joints
from pickenv.arm.kinematics.geometry import Array, Geometry


def _all_frames(geometry: Geometry, q: ArrayLike) -> tuple[Array, Array]:
    """Components of base and link frames ``(12, L + 1, ...)`` and of the tool's origin ``(3, ...)``.

    Poses come last, here and in `_cross`, so that every operation runs over contiguous numbers.
    """
    joints = split_joints(geometry.joints, q)
    chain = chain_of(geometry, math if geometry.alpha.ndim == 1 else np)
    found = frames(np, chain, joints)
    shape = np.broadcast_shapes(joints[0].shape, geometry.alpha.shape[:-1])
    links, tool = np.empty((12, len(found), *shape)), np.empty((3, *shape))
    for k, frame in enumerate(found):
        for component, value in enumerate(frame):
            links[component, k] = value
    for component, value in enumerate(attach(found[-1], chain.tool)[9:]):
        tool[component] = value
    return links, tool


def _cross(out: Array, axis: Array, lever: Array) -> None:
    """Write the cross product of ``axis`` and ``lever``, components first, into ``out`` (`numpy.cross` is slow)."""
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(axis[j], lever[k], out=out[i])
        out[i] -= axis[k] * lever[j]


def _per_link(values: Array, shape: tuple[int, ...]) -> Array:
    """Link parameters ``(..., n)`` as ``(n, ...)``, for poses of this shape."""
    return np.moveaxis(np.broadcast_to(values, (*shape, values.shape[-1])), -1, 0)


def joint_jacobian(geometry: Geometry, q: ArrayLike) -> Array:
    """Derivative of the tool pose by the joints.

    Args:
        geometry: The arm.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Array ``(..., 6, n)``: rows position (m) and rotation vector (rad) in world axes, per rad or m (eq (13)).
    """
    links, tool = _all_frames(geometry, q)
    z = links[6:9, 1:]
    columns = np.empty((6, *z.shape[1:]))
    _cross(columns[:3], z, tool[:, None] - links[9:, 1:])
    columns[3:] = z
    slides = np.array(geometry.slides)
    if slides.any():
        columns[:3, slides] = z[:, slides]
        columns[3:, slides] = 0.0
    found = np.moveaxis(columns, (0, 1), (-2, -1))
    return found if geometry.coupling is None else geometry.coupling.gathered(found, geometry.joints)


def parameter_jacobian(geometry: Geometry, q: ArrayLike) -> Array:
    """Derivative of the tool pose by every parameter of the geometry.

    Args:
        geometry: The arm.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Array ``(..., 6, 5L + 12)``, columns in the order of ``geometry.parameter_names``; rows as in `joint_jacobian`.
        In memory the poses lie next to each other.
    """
    n = geometry.links
    links, tool = _all_frames(geometry, q)
    shape = tool.shape[1:]
    before, after = links[:, :-1], links[:, 1:]
    x, z, tool_from_before = before[:3], after[6:9], tool[:, None] - before[9:]
    columns = np.zeros((6, 5 * n + 12, *shape))
    position, turn = columns[:3], columns[3:]
    alpha, a, theta, d, beta = (slice(k * n, (k + 1) * n) for k in range(5))
    _cross(position[:, alpha], x, tool_from_before)
    turn[:, alpha] = x
    position[:, a] = x
    _cross(position[:, theta], z, tool[:, None] - after[9:])
    turn[:, theta] = z
    position[:, d] = z
    # Hayati's beta turns about y after Rot(x, alpha) and Trans(x, a).
    cos, sin = np.cos(geometry.alpha), np.sin(geometry.alpha)
    y = _per_link(cos, shape) * before[3:6] + _per_link(sin, shape) * before[6:9]
    _cross(position[:, beta], y, tool_from_before - _per_link(geometry.a, shape) * x)
    turn[:, beta] = y
    base, hand = 5 * n, 5 * n + 6
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        position[k, base + k] = 1.0
        turn[k, base + 3 + k] = 1.0
        position[i, base + 3 + k] = geometry.base.position[j] - tool[j]  # axis k crossed with the lever
        position[j, base + 3 + k] = tool[i] - geometry.base.position[i]
        position[:, hand + k] = turn[:, hand + 3 + k] = links[3 * k : 3 * k + 3, n]
    return np.moveaxis(columns, (0, 1), (-2, -1))
