"""The links of an arm as capsules (rods with round ends), as the viewer wants them. Metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.link_points import drawn_parts as drawn_parts
from pickenv.arm.kinematics.link_points import nominal_points as nominal_points
from pickenv.arm.kinematics.link_points import true_points as true_points


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
