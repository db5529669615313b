"""What a camera makes of a point: a pinhole, and the radial and tangential distortion of its lens.

Brown 1971, with the coefficients as OpenCV and ROS ("plumb_bob") order them: k1, k2, p1, p2, k3. Points lie in the
camera's frame (x right, y down, z along the view), m; pictures are in pixels, the centre of the first pixel at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm.kinematics.geometry import Array

LENS_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""A lens' numbers: focal lengths and principal point in px, distortion without unit."""

SCALES = np.array([1.0, 1.0, 1.0, 1.0, 2e-3, 3e-3, 5e-4, 5e-4, 5e-3])
"""About what moves a corner at a picture's edge by a pixel."""

UNDISTORTING_STEPS = 30


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera's intrinsics.

    Attributes:
        values: In the order of `LENS_NAMES` ``(9,)``.
        size: Width and height of the pictures that they are for, px.
        name: How messages call the camera.
    """

    values: Array
    size: tuple[int, int]
    name: str = "camera"


def projected(values: Array, points: Array) -> Array:
    """Pixels ``(..., 2)`` of points ``(..., 3)`` in the camera's frame."""
    fx, fy, cx, cy = values[:4]
    x, y = np.moveaxis(distorted(values, points[..., :2] / points[..., 2:]), -1, 0)
    return np.stack([fx * x + cx, fy * y + cy], axis=-1)


def distorted(values: Array, ideal: Array) -> Array:
    """Where the lens puts rays ``(..., 2)``, given by their slopes x / z and y / z."""
    k1, k2, p1, p2, k3 = values[4:]
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )


def undistorted(values: Array, pixels: Array) -> Array:
    """Slopes of the rays ``(..., 2)`` that the lens puts at ``pixels`` ``(..., 2)``, by fixed-point iteration."""
    seen = (pixels - values[2:4]) / values[:2]
    found = seen
    for _ in range(UNDISTORTING_STEPS):
        found = found + seen - distorted(values, found)
    return np.asarray(found)


def by_point(values: Array, points: Array) -> Array:
    """Derivative of `projected` by the point ``(..., 2, 3)``."""
    z = points[..., 2]
    x, y = points[..., 0] / z, points[..., 1] / z
    k1, k2, p1, p2, k3 = values[4:]
    r2 = x * x + y * y
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    by_ray = np.empty((*x.shape, 2, 2))
    by_ray[..., 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    by_ray[..., 0, 1] = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    by_ray[..., 1, 0] = by_ray[..., 0, 1]
    by_ray[..., 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    ray = np.zeros((*x.shape, 2, 3))
    ray[..., 0, 0] = ray[..., 1, 1] = 1.0 / z
    ray[..., 0, 2], ray[..., 1, 2] = -x / z, -y / z
    return np.asarray(values[:2, None] * (by_ray @ ray))


def by_values(values: Array, points: Array) -> Array:
    """Derivative of `projected` by the lens' numbers ``(..., 2, 9)``."""
    fx, fy = values[:2]
    ideal = points[..., :2] / points[..., 2:]
    bent = distorted(values, ideal)
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    found = np.zeros((*x.shape, 2, len(LENS_NAMES)))
    found[..., 0, 0], found[..., 1, 1] = bent[..., 0], bent[..., 1]
    found[..., 0, 2] = found[..., 1, 3] = 1.0
    for column, power in ((4, r2), (5, r2**2), (8, r2**3)):
        found[..., 0, column], found[..., 1, column] = fx * x * power, fy * y * power
    found[..., 0, 6], found[..., 1, 6] = fx * 2.0 * x * y, fy * (r2 + 2.0 * y * y)
    found[..., 0, 7], found[..., 1, 7] = fx * (r2 + 2.0 * x * x), fy * 2.0 * x * y
    return found
