"""Poses that a controller reports, where its joint angles are not known: the joints of an arm that is nothing but them.

A gantry with a wrist can stand in any pose. Its joints are the pose in other words, and none of its own parameters is
ever fitted; base and tool are, as of any arm.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Pose, forward
from pickenv.arm.files.arm import Arm
from pickenv.arm.kinematics.geometry import Array, Geometry, identity_pose

REACH = 100.0
"""m; how far such an arm goes, which no robot does."""

_QUARTER = np.pi / 2.0


CARRIER = "finished_poses"
"""Name of that arm."""


def pose_carrier() -> Arm:
    """The arm whose six joints are a pose: x, y, z, and the angles of a wrist (z, y, z)."""
    # z, then x, then y: each link's axis is turned from the one before by quarter turns.
    return Arm(
        name=CARRIER,
        source="poses as a controller reports them",
        nominal=Geometry(
            joint_names=("z", "x", "y", "wrist1", "wrist2", "wrist3"),
            prismatic=(True, True, True, False, False, False),
            alpha=np.array([0.0, _QUARTER, _QUARTER, 0.0, _QUARTER, -_QUARTER]),
            a=np.zeros(6),
            theta=np.array([_QUARTER, _QUARTER, 0.0, 0.0, 0.0, 0.0]),
            d=np.zeros(6),
            beta=np.zeros(6),
            lower=np.array([-REACH] * 3 + [-np.pi] * 3),
            upper=np.array([REACH] * 3 + [np.pi] * 3),
            base=identity_pose(),
            tool=identity_pose(),
        ),
        true=None,
        speed=np.ones(6),
    )


def joints_of_finished_poses(poses: Pose) -> Array:
    """The joints ``(N, 6)`` that hold poses ``(N,)``."""
    geometry = pose_carrier().nominal
    rest = forward(geometry, np.zeros(6))
    along = np.stack([forward(geometry, row).position for row in np.eye(6)[:3]], axis=1)
    slides = np.linalg.solve(along, poses.position.T).T
    angles = Rotation.from_matrix(rest.rotation.T @ poses.rotation).as_euler("ZYZ")
    return np.concatenate([slides, angles * (1.0, -1.0, 1.0)], axis=1)
