"""How far an arm reaches, and the largest cube that it reaches with one tool attitude.

The cube's edges are parallel to the world axes (ISO 9283, 6.8.3). The workspace is sampled on a grid, so the cube is
the largest to within one grid step. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.stats import qmc

from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose
from pickenv.arm.kinematics.inverse import inverse
from pickenv.base import InputError

SAMPLES = 2**14
"""Evenly spread joints that show roughly where the tool can be."""

ITERATIONS = 10
"""Steps of the inverse from the nearest sample; it converges quadratically."""


@dataclass(frozen=True, eq=False)
class Cube:
    """A cube in the workspace.

    Attributes:
        centre: Its centre (3,), m.
        edge: Its edge, m; parallel to the world axes.
        rotation: Tool attitude with which it is reached (3, 3).
        free: Whether it is reached with any attitude.
    """

    centre: Array
    edge: float
    rotation: Array
    free: bool = False

    def inclined_plane(self) -> Pose:
        """The five test poses of ISO 9283: P1 in the centre, P2 to P5 a tenth of the diagonals from the corners.

        The plane holds the upper edge at -x and the lower edge at +x: corners C1, C2, C7, C8 of the standard's figure.
        """
        signs = np.array([[0, 0], [-1, -1], [-1, 1], [1, 1], [1, -1]])
        offsets = np.stack([signs[:, 0], signs[:, 1], -signs[:, 0]], axis=-1) * 0.8 * self.edge / 2.0
        return Pose(self.centre + offsets, np.broadcast_to(self.rotation, (5, 3, 3)))


def largest_cube(geometry: Geometry, rotation: Array | None = None, *, steps: int = 20, free: bool = False) -> Cube:
    """The largest cube within reach.

    Args:
        geometry: The arm.
        rotation: Tool attitude (3, 3); that of the middle of all joint ranges when left out. Only the part of it that
            the joints can turn counts.
        steps: Grid steps along the longest side of the workspace.
        free: Whether any attitude will do, as for an arm that cannot hold one and go everywhere.

    Raises:
        InputError: If not even the smallest cube of the grid is within reach.
    """
    if rotation is None:
        rotation = forward(geometry, (geometry.lower + geometry.upper) / 2.0).rotation
    joints = _samples(geometry)
    points = forward(geometry, joints).position
    low, high = points.min(axis=0), points.max(axis=0)
    step = float((high - low).max()) / steps
    axes = [np.arange(a, b + 1e-9, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    targets = grid.reshape(-1, 3)
    distance, nearest = cKDTree(points).query(targets)
    near = np.flatnonzero(distance < step)
    goals = Pose(targets[near], np.broadcast_to(rotation, (near.size, 3, 3)))
    options = {"position_only": True} if free else {}
    start = joints[np.asarray(nearest)[near]]
    solution = inverse(geometry, goals, start, max_iterations=ITERATIONS, restarts=0, **options)
    within = np.zeros(len(targets), dtype=bool)
    within[near] = solution.reached
    corner, size = _largest_filled(within.reshape(grid.shape[:-1]))
    if size == 0:
        raise InputError(
            f"this arm reaches no cube of {1e3 * step:.0f} mm with one tool attitude; give another attitude"
        )
    edge = size * step
    return Cube(grid[corner] + edge / 2.0, edge, np.asarray(rotation, dtype=float), free)


def farthest(geometry: Geometry) -> float:
    """Largest distance of the tool from the arm's base, frame 0, within the joint limits, m.

    The best of the samples is driven on to a maximum.
    """
    joints = _samples(geometry)
    foot = geometry.base.position

    def nearness(q: Array) -> float:
        return -float(np.linalg.norm(forward(geometry, q).position - foot))

    first = joints[np.argmax(np.linalg.norm(forward(geometry, joints).position - foot, axis=-1))]
    limits = list(zip(geometry.lower, geometry.upper, strict=True))
    return -float(minimize(nearness, first, bounds=limits).fun)


def _samples(geometry: Geometry) -> Array:
    """Evenly spread joints within the limits."""
    spread = qmc.Halton(geometry.joints, scramble=False).random(SAMPLES)
    return np.asarray(geometry.lower + (geometry.upper - geometry.lower) * spread)


def _largest_filled(filled: NDArray[np.bool_]) -> tuple[tuple[int, ...], int]:
    """Lower corner and size, in grid steps, of the largest cube of grid points that are all filled."""
    corner: tuple[int, ...] = (0, 0, 0)
    size, here = 0, filled  # here: which points are the lower corner of a filled cube of this size
    while here.any():
        choices = np.argwhere(here)
        corner = tuple(choices[len(choices) // 2].tolist())
        shape = np.array(here.shape) - 1
        if (shape < 1).any():
            break
        grown = np.ones(shape, dtype=bool)
        for shift in np.ndindex(2, 2, 2):
            grown &= here[tuple(slice(s, s + n) for s, n in zip(shift, shape, strict=True))]
        if not grown.any():
            break
        size, here = size + 1, grown
    return corner, size
