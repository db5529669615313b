"""Which points an arm reaches from below with its tool upright: where fruit can be picked. Base frame, m."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import qmc

from pickenv.arm import Array, Geometry, Pose, forward, inverse
from pickenv.errors import InputError

ITERATIONS = 8
"""Steps of the inverse that tells whether a point is in reach; 15 answer no other of 4000 points differently."""

UP = np.array([0.0, 0.0, 1.0])
"""The way that the tool takes to a fruit, and how it stands there."""

Flags = NDArray[np.bool_]


class Reach:
    """Which points the nominal arm reaches with its tool upright, from ``approach`` m below up to the point."""

    def __init__(self, geometry: Geometry, approach: float) -> None:
        """Sample the arm's upright poses once; each question then starts from the nearest one."""
        self.geometry, self.approach = geometry, approach
        spread = qmc.Halton(geometry.joints, scramble=False).random(2**14)
        joints = geometry.lower + (geometry.upper - geometry.lower) * spread
        poses = forward(geometry, joints)
        upright = poses.rotation[:, 2, 2] > np.cos(np.radians(30.0))
        if not upright.any():
            raise InputError("this arm cannot hold its tool upright, so it cannot pick from below; take qiao2026")
        self.joints = joints[upright]
        self.rotations = np.array([_upright(rotation) for rotation in poses.rotation[upright]])
        self.tree = cKDTree(poses.position[upright])

    def __call__(self, positions: Array) -> Flags:
        """One flag per position (n, 3), m."""
        if not len(positions):
            return np.zeros(0, dtype=np.bool_)
        points = np.concatenate([positions, positions - self.approach * UP])
        _, nearest = self.tree.query(points)
        solution = inverse(
            self.geometry,
            Pose(points, self.rotations[nearest]),
            self.joints[nearest],
            position_tolerance=5e-4,
            attitude_tolerance=0.02,
            max_iterations=ITERATIONS,
            restarts=0,
        )
        at, below = solution.reached.reshape(2, -1)
        return np.asarray(at & below)


@lru_cache(maxsize=4)
def reach_of(geometry: Geometry, approach: float) -> Reach:
    """`Reach`, sampled once per arm."""
    return Reach(geometry, approach)


def _upright(rotation: Array) -> Array:
    """The attitude (3, 3) with the tool axis straight up that is nearest in yaw."""
    x = rotation[:, 0] - rotation[2, 0] * UP
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(UP, x), UP], axis=-1)
