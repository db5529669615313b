"""The arm as something to draw: a polyline along its links, and the capsules (rods with round ends) between its points.

A link runs from the previous frame's origin along a to the elbow, then along d to its own origin. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Plant
from pickenv.arm.effects import boom_flexure, driven_joints, gravity_torques, yielded_joints
from pickenv.arm.geometry import Array, Geometry
from pickenv.arm.kinematics import Chain, Frame, attach, chain_of, frames, split_joints

SHORTEST_LINK = 0.02
"""m; a link part that is longer than this in some pose is drawn, a shorter one is skipped."""


@dataclass(frozen=True, eq=False)
class Capsules:
    """Rods with round ends.

    Attributes:
        start: Centre of the first end ``(..., 3)``, m.
        length: Distance between the ends' centres ``(...)``, m.
        quaternion: Turns the z axis into the rod's direction ``(..., 4)``, order x, y, z, w.
    """

    start: Array
    length: Array
    quaternion: Array


def nominal_points(geometry: Geometry, q: ArrayLike) -> Array:
    """Points ``(..., 2n + 2, 3)`` along the arm as ``geometry`` describes it, base first and tool last, in m.

    Args:
        geometry: The arm.
        q: Joints ``(..., n)``, rad or m.
    """
    joints = split_joints(geometry.joints, q)
    chain = chain_of(geometry)
    return _points(chain, frames(np, chain, joints), joints)


def true_points(plant: Plant, q: ArrayLike) -> Array:
    """Points ``(..., 2n + 2, 3)`` in m along the true arm, with all its effects, for joint commands ``(..., n)``."""
    joints = split_joints(plant.geometry.joints, q)
    chain = chain_of(plant.geometry)
    if plant.transmission_error is not None:
        joints = driven_joints(np, plant.transmission_error, joints)
    if plant.joint_compliance is not None and plant.load is not None:
        torques = gravity_torques(chain, frames(np, chain, joints), plant.load)
        joints = yielded_joints(plant.joint_compliance, torques, joints)
    flexure = None
    if plant.boom_bending is not None:
        flexure = boom_flexure(plant.boom_bending, plant.load.payload if plant.load else 0.0, joints)
    return _points(chain, frames(np, chain, joints, flexure), joints)


def _points(chain: Chain, frame_list: Sequence[Frame], joints: Sequence[Array]) -> Array:
    points = [frame_list[0][9:]]
    for link, frame, q in zip(chain.links, frame_list[1:], joints, strict=True):
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


def capsules(points: Array, parts: list[int]) -> Capsules:
    """Capsules ``(..., P)`` along the ``parts`` of the polyline ``points`` ``(..., K, 3)``, from `drawn_parts`."""
    start, end = points[..., parts, :], points[..., [i + 1 for i in parts], :]
    along = end - start
    length = np.linalg.norm(along, axis=-1)
    safe = np.where(length > 1e-9, length, 1.0)[..., None]
    direction = np.where(length[..., None] > 1e-9, along / safe, [0.0, 0.0, 1.0])
    # Half-way quaternion from z to the direction; straight down is turned about x.
    w = 1.0 + direction[..., 2]
    down = w < 1e-9
    quaternion = np.stack([-direction[..., 1], direction[..., 0], np.zeros_like(w), w], axis=-1)
    quaternion[down] = [1.0, 0.0, 0.0, 0.0]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return Capsules(start, length, quaternion)
