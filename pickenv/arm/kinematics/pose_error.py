"""Differences of poses: position in metres and attitude as a rotation vector, both in world axes.

Euler angles are never used: they inflate attitude errors (Qiao 2026 digest, fact 10).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pickenv.arm.kinematics.geometry import Array, Pose


def rotation_vector(rotation: ArrayLike) -> Array:
    """Rotation vectors ``(..., 3)`` in rad of rotation matrices ``(..., 3, 3)``."""
    rotation = np.asarray(rotation, dtype=float)
    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec()
    return flat.reshape(*rotation.shape[:-2], 3)


def rotation_matrix(vector: ArrayLike) -> Array:
    """Rotation matrices ``(..., 3, 3)`` of rotation vectors ``(..., 3)`` in rad."""
    vector = np.asarray(vector, dtype=float)
    flat = Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix()
    return flat.reshape(*vector.shape[:-1], 3, 3)


def pose_error(reference: Pose, actual: Pose) -> Array:
    """Error of ``actual`` against ``reference``.

    Returns:
        Array ``(..., 6)``: position difference in m, then the rotation vector of R_actual R_reference^T in rad, both
        in world axes.
    """
    turn = actual.rotation @ np.swapaxes(reference.rotation, -1, -2)
    return np.concatenate([actual.position - reference.position, rotation_vector(turn)], axis=-1)


def displace_pose(pose: Pose, error: ArrayLike) -> Pose:
    """The pose that differs from ``pose`` by ``error`` ``(..., 6)`` in the sense of `pose_error`."""
    error = np.asarray(error, dtype=float)
    return Pose(pose.position + error[..., :3], rotation_matrix(error[..., 3:]) @ pose.rotation)
