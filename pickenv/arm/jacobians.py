"""Joint and parameter Jacobians of the tool pose, analytic, for batches of poses.

Rows are position (m) and rotation vector (rad) in world axes. The parameter Jacobian is Qiao 2026 eq (8) read as the
horizontal concatenation [J_1^6 V_1 ... J_6^6 V_6] (the paper prints a sum), turned from tool into world axes, and
extended by Hayati's beta, the base and the tool.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.geometry import Array, Geometry
from pickenv.arm.kinematics import Frame, attach, chain_of, frames, split_joints


def _stacked(frame: Frame, shape: tuple[int, ...]) -> Array:
    """A frame's components as one array ``(..., 4, 3)``: axes x, y, z and the origin."""
    components = np.stack(np.broadcast_arrays(*frame, np.empty(shape))[:12], axis=-1)
    return components.reshape(*shape, 4, 3)


def _turn(axis: Array, lever: Array) -> Array:
    """Column ``(..., 6)`` of a small turn about ``axis`` for a point that lies ``lever`` from it."""
    return np.concatenate([np.cross(axis, lever), axis], axis=-1)


def _shift(axis: Array) -> Array:
    """Column ``(..., 6)`` of a small shift along ``axis``."""
    return np.concatenate([axis, np.zeros_like(axis)], axis=-1)


def _all_frames(geometry: Geometry, q: ArrayLike) -> tuple[Array, Array]:
    """Link frames ``(..., n + 1, 4, 3)`` and the tool's origin ``(..., 3)``."""
    joints = split_joints(geometry.joints, q)
    chain = chain_of(geometry, math if geometry.alpha.ndim == 1 else np)
    found = frames(np, chain, joints)
    shape = np.broadcast_shapes(joints[0].shape, geometry.alpha.shape[:-1])
    links = np.stack([_stacked(frame, shape) for frame in found], axis=-3)
    return links, _stacked(attach(found[-1], chain.tool), shape)[..., 3, :]


def joint_jacobian(geometry: Geometry, q: ArrayLike) -> Array:
    """Derivative of the tool pose by the joints.

    Args:
        geometry: The arm.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Array ``(..., 6, n)``: rows position (m) and rotation vector (rad) in world axes, per rad or m (eq (13)).
    """
    links, tool = _all_frames(geometry, q)
    z, origin = links[..., 1:, 2, :], links[..., 1:, 3, :]
    turns = _turn(z, tool[..., None, :] - origin)
    slides = _shift(z)
    columns = np.where(np.array(geometry.prismatic)[:, None], slides, turns)
    return np.swapaxes(columns, -1, -2)


def parameter_jacobian(geometry: Geometry, q: ArrayLike) -> Array:
    """Derivative of the tool pose by every parameter of the geometry.

    Args:
        geometry: The arm.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Array ``(..., 6, 5n + 12)``, columns in the order of ``geometry.parameter_names``; rows as in `joint_jacobian`.
    """
    n = geometry.joints
    links, tool = _all_frames(geometry, q)
    before, after = links[..., :-1, :, :], links[..., 1:, :, :]
    tool = tool[..., None, :]
    x, z = before[..., 0, :], after[..., 2, :]
    cos, sin = np.cos(geometry.alpha)[..., None], np.sin(geometry.alpha)[..., None]
    y = cos * before[..., 1, :] + sin * before[..., 2, :]  # axis of Rot(y, beta), after Rot(x, alpha)
    knee = before[..., 3, :] + geometry.a[..., None] * x
    world = np.broadcast_to(np.eye(3), (*tool.shape[:-2], 3, 3))
    last = links[..., n, :3, :]
    columns = [
        _turn(x, tool - before[..., 3, :]),
        _shift(x),
        _turn(z, tool - after[..., 3, :]),
        _shift(z),
        _turn(y, tool - knee),
        _shift(world),
        _turn(world, tool - geometry.base.position),
        _shift(last),
        _turn(last, np.zeros_like(last)),
    ]
    return np.swapaxes(np.concatenate(columns, axis=-2), -1, -2)
