"""Forward kinematics, written once in components and run by Python floats, NumPy arrays or torch tensors.

A frame is twelve scalars (axes x, y, z and the origin, in world axes); ``m`` is the namespace that supplies sin, cos
and stack: `math`, `numpy` or `torch`. Qiao 2026 eqs (1)-(2); modified DH with Hayati's beta. Metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Coupling, Geometry, Pose
from pickenv.extras import require

Scalar = Any
"""A Python float, a NumPy array or a torch tensor: the executors' common ground."""

Frame = tuple[Scalar, ...]
"""(xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz): components of the axes x, y, z and of the origin p."""

Flexure = Callable[[int, Frame], Frame]
"""Bends the frame of link i (counted from 0) before the next link is attached."""


class Link(NamedTuple):
    """Constants of one link, with the sines and cosines that do not depend on the joints."""

    prismatic: bool
    cos_alpha: Scalar
    sin_alpha: Scalar
    a: Scalar
    theta: Scalar
    d: Scalar
    cos_theta: Scalar
    sin_theta: Scalar
    beta: tuple[Scalar, Scalar] | None


class Chain(NamedTuple):
    """A geometry made ready for `frames`: base, links, tool (None where it is the identity), what moves together."""

    base: Frame
    links: tuple[Link, ...]
    tool: Frame | None
    coupling: Coupling | None = None


def chain_of(geometry: Geometry, m: ModuleType = math) -> Chain:
    """Prepare ``geometry`` for an executor.

    Args:
        geometry: A single geometry; with ``m`` = numpy its link parameters may carry batch dimensions (one arm each).
        m: ``math`` for constants that are Python floats (they mix with any executor's joints), else ``numpy``.
    """
    convert = float if m is math else np.asarray
    links = []
    for i, prismatic in enumerate(geometry.slides):
        alpha, a, theta, d, beta = (convert(getattr(geometry, name)[..., i]) for name in LINK_PARAMETERS)
        bent = (m.cos(beta), m.sin(beta)) if np.any(beta) else None
        links.append(Link(prismatic, m.cos(alpha), m.sin(alpha), a, theta, d, m.cos(theta), m.sin(theta), bent))
    still = not geometry.tool.position.any() and np.array_equal(geometry.tool.rotation, np.eye(3))
    tool = None if still else frame_of(geometry.tool)
    return Chain(frame_of(geometry.base), tuple(links), tool, geometry.coupling)


def frame_of(pose: Pose) -> Frame:
    """The twelve components: Python floats of a single pose, arrays of poses ``(...)``."""
    if pose.position.ndim > 1:
        axes = np.ascontiguousarray(np.moveaxis(pose.rotation, (-1, -2), (0, 1)))
        return (*axes.reshape(9, *axes.shape[2:]), *np.moveaxis(pose.position, -1, 0))
    return (*(float(v) for v in pose.rotation.T.ravel()), *(float(v) for v in pose.position))


def pose_of(frame: Frame, m: ModuleType = np) -> Pose:
    """Stack a frame's components into a `Pose` of NumPy arrays or torch tensors."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = _same_shape(frame, m)
    rows = [m.stack([xx, yx, zx], -1), m.stack([xy, yy, zy], -1), m.stack([xz, yz, zz], -1)]
    return Pose(m.stack([px, py, pz], -1), m.stack(rows, -2))


def _same_shape(values: Sequence[Scalar], m: ModuleType) -> list[Scalar]:
    """Broadcast components against each other (constants of a chain may still be plain floats)."""
    if m is np:
        return list(np.broadcast_arrays(*values))
    shaped = [v for v in values if not isinstance(v, float)]
    template = sum(shaped[1:], shaped[0]) * 0
    return [template + v for v in values]


def frames(m: ModuleType, chain: Chain, q: Sequence[Scalar], flexure: Flexure | None = None) -> list[Frame]:
    """Frames of base and links, L + 1 of them, in world axes.

    Args:
        m: ``math``, ``numpy`` or ``torch``.
        chain: From `chain_of`.
        q: The n joint displacements, rad or m: floats, or arrays of one shape.
        flexure: Bends a link's frame before the next link is attached (boom bending), or None.
    """
    sin, cos = m.sin, m.cos
    if chain.coupling is not None:
        q = chain.coupling.displacements(q)
    xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = frame = chain.base
    result = [frame]
    for i, (prismatic, ca, sa, a, theta, d, ct, st, beta) in enumerate(chain.links):
        # Rot(x, alpha) turns y and z; Trans(x, a) is taken along the axis x before any further turn.
        yx, zx = ca * yx + sa * zx, ca * zx - sa * yx
        yy, zy = ca * yy + sa * zy, ca * zy - sa * yy
        yz, zz = ca * yz + sa * zz, ca * zz - sa * yz
        px, py, pz = px + a * xx, py + a * xy, pz + a * xz
        if beta is not None:
            cb, sb = beta
            xx, zx = cb * xx - sb * zx, cb * zx + sb * xx
            xy, zy = cb * xy - sb * zy, cb * zy + sb * xy
            xz, zz = cb * xz - sb * zz, cb * zz + sb * xz
        if prismatic:
            d = d + q[i]
        else:
            angle = theta + q[i]
            ct, st = cos(angle), sin(angle)
        xx, yx = ct * xx + st * yx, ct * yx - st * xx
        xy, yy = ct * xy + st * yy, ct * yy - st * xy
        xz, yz = ct * xz + st * yz, ct * yz - st * xz
        px, py, pz = px + d * zx, py + d * zy, pz + d * zz
        frame = (xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz)
        if flexure is not None:
            frame = flexure(i, frame)
            xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = frame
        result.append(frame)
    return result


def attach(frame: Frame, tool: Frame | None) -> Frame:
    """The tool's frame in the world, given the last link's frame and the tool's pose in it."""
    if tool is None:
        return frame
    xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = frame
    turned = []
    for i in (0, 3, 6, 9):
        u, v, w = tool[i : i + 3]
        turned += [u * xx + v * yx + w * zx, u * xy + v * yy + w * zy, u * xz + v * yz + w * zz]
    return (*turned[:9], px + turned[9], py + turned[10], pz + turned[11])


def tool_frame(m: ModuleType, chain: Chain, q: Sequence[Scalar], flexure: Flexure | None = None) -> Frame:
    """Frame of the tool in world axes; arguments as in `frames`."""
    return attach(frames(m, chain, q, flexure)[-1], chain.tool)


def split_joints(geometry_joints: int, q: ArrayLike) -> list[Array]:
    """Check joints ``(..., n)`` and return them as n arrays ``(...,)``.

    Raises:
        ValueError: If the last dimension is not n.
    """
    q = np.asarray(q, dtype=float)
    if q.ndim == 0 or q.shape[-1] != geometry_joints:
        raise ValueError(f"joints have shape {q.shape}, but this arm has {geometry_joints} joints (last axis)")
    return [q[..., i] for i in range(geometry_joints)]


def forward(geometry: Geometry, q: ArrayLike) -> Pose:
    """Tool pose for joints ``q``.

    Args:
        geometry: The arm; its link parameters may carry batch dimensions that broadcast with those of ``q``.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Position ``(..., 3)`` in m and rotation ``(..., 3, 3)`` in the world frame (Qiao 2026 eq (2)).

    Raises:
        ValueError: If ``q`` does not have n joints.
    """
    single = geometry.alpha.ndim == 1
    chain = chain_of(geometry, math if single else np)
    joints = split_joints(geometry.joints, q)
    return pose_of(tool_frame(np, chain, joints))


def forward_torch(geometry: Geometry, q: Any) -> Pose:
    """`forward` on a torch tensor ``(..., n)``; the pose's fields are tensors and carry gradients."""
    require("torch")
    import torch

    if q.ndim == 0 or q.shape[-1] != geometry.joints:
        raise ValueError(f"joints have shape {tuple(q.shape)}, but this arm has {geometry.joints} joints (last axis)")
    return pose_of(tool_frame(torch, chain_of(geometry), q.unbind(-1)), torch)
