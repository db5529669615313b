"""Where a flat board stands in a camera's frame, view by view: a homography, then its two rotations' common pose.

A first pose to start from (Zhang 2000, section 3.1), not a result: the fit of the arm takes the corners themselves.
"""

from __future__ import annotations

import numpy as np

from pickenv.arm import Pose
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.lens import undistorted
from pickenv.calibration.model.observations import nearest_rotation
from pickenv.calibration.model.pixels import PixelObservations

LEAST_CORNERS = 4


def board_poses(data: PixelObservations) -> Pose:
    """The board in the camera's frame in each view ``(V,)``.

    Args:
        data: Views with at least four corners each, not all in one line; the board's corners lie in its plane z = 0.
    """
    poses = [
        _pose(data.board[seen, :2], undistorted(data.camera.values, corners[seen]))
        for corners, seen in zip(data.corners, data.seen, strict=True)
    ]
    return Pose(np.array([p.position for p in poses]), np.array([p.rotation for p in poses]))


def _pose(flat: Array, rays: Array) -> Pose:
    """The pose whose first two columns and position are the homography from the board to the rays."""
    homography = _homography(flat, rays)
    scale = np.linalg.norm(homography[:, :2], axis=0).mean()
    first, second, position = (homography / scale).T
    if position[2] < 0.0:  # the board is in front of the camera
        first, second, position = -first, -second, -position
    rotation = nearest_rotation(np.stack([first, second, np.cross(first, second)], axis=1))
    return Pose(position, rotation)


def _homography(flat: Array, rays: Array) -> Array:
    """H of (ray, 1) ~ H (point, 1), by the normalised direct linear transform (Hartley 1997)."""
    middle, size = flat.mean(axis=0), float(np.sqrt(2.0) / np.linalg.norm(flat - flat.mean(axis=0), axis=1).mean())
    points = np.column_stack([(flat - middle) * size, np.ones(len(flat))])
    blank = np.zeros_like(points)
    rows = np.concatenate(
        [np.hstack([points, blank, -rays[:, :1] * points]), np.hstack([blank, points, -rays[:, 1:] * points])]
    )
    found = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    return np.asarray(
        found @ np.array([[size, 0.0, -size * middle[0]], [0.0, size, -size * middle[1]], [0.0, 0.0, 1.0]])
    )
