"""The arm as something to draw: a polyline along its links.

A link runs from the previous frame's origin along a to the elbow, then along d to its own origin. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.forward import Chain, Frame, attach, chain_of, frames, split_joints
from pickenv.arm.kinematics.geometry import Array, Geometry

SHORTEST_LINK = 0.02
"""m; a link part that is longer than this in some pose is drawn, a shorter one is skipped."""


def nominal_points(geometry: Geometry, q: ArrayLike) -> Array:
    """Points ``(..., 2n + 2, 3)`` along the arm as ``geometry`` describes it, base first and tool last, in m.

    Args:
        geometry: The arm.
        q: Joints ``(..., n)``, rad or m.
    """
    joints = split_joints(geometry.joints, q)
    chain = chain_of(geometry)
    return _points(chain, frames(np, chain, joints), joints)


def true_points(geometry: Geometry, q: ArrayLike, tool: ArrayLike) -> Array:
    """Points ``(..., 2n + 2, 3)`` along the true arm, in m: its true geometry, drawn to where the tool really stood.

    Where along the arm compliance, drives or the ground displace it is not asked: what they add at the tool is spread
    evenly along the links. Base and tool are exact.

    Args:
        geometry: True geometry.
        q: Joint commands ``(..., n)``, rad or m.
        tool: True tool positions ``(..., 3)``, m.
    """
    points = nominal_points(geometry, q)
    lengths = np.linalg.norm(np.diff(points, axis=-2), axis=-1)
    along = np.concatenate([np.zeros_like(lengths[..., :1]), np.cumsum(lengths, axis=-1)], axis=-1)
    rest = np.asarray(tool, dtype=float) - points[..., -1, :]
    return np.asarray(points + (along / along[..., -1:])[..., None] * rest[..., None, :])


def _points(chain: Chain, frame_list: Sequence[Frame], joints: Sequence[Array]) -> Array:
    points = [frame_list[0][9:]]
    moved = joints if chain.coupling is None else chain.coupling.displacements(joints)
    for link, frame, q in zip(chain.links, frame_list[1:], moved, strict=True):
        zx, zy, zz, px, py, pz = frame[6:]
        d = link.d + q if link.prismatic else link.d
        points += [(px - d * zx, py - d * zy, pz - d * zz), (px, py, pz)]
    points.append(attach(frame_list[-1], chain.tool)[9:])
    shape = np.broadcast_shapes(*(np.shape(value) for point in points for value in point))
    return np.stack([np.stack([np.broadcast_to(value, shape) for value in point], -1) for point in points], -2)


def drawn_parts(points: Array) -> list[int]:
    """Which link parts of the polyline ``(..., K, 3)`` are long enough to be drawn: indices of their first points."""
    lengths = np.linalg.norm(np.diff(points, axis=-2), axis=-1).reshape(-1, points.shape[-2] - 1)
    return [int(i) for i in np.flatnonzero(lengths.max(axis=0) > SHORTEST_LINK)]
