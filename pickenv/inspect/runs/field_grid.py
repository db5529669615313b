"""The regular grid of upright tool poses on which error fields are computed; metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, Pose, forward, inverse
from pickenv.calibration import random_joints

UPRIGHT = np.radians(30.0)
"""Tool poses this near to the vertical tell how large the grid is, rad."""
PROBES = 4000


@dataclass(frozen=True, eq=False)
class FieldGrid:
    """A grid, and its cells that the nominal arm reaches.

    Attributes:
        shape: Number of cells (nx, ny, nz).
        origin: Centre of the first cell, m, ``(3,)``.
        step: Cell size, m.
        index: Integer index of each reached cell ``(F, 3)``.
        points: Their centres ``(F, 3)``, m.
        joints: Joints that bring the nominal arm's tool there, upright ``(F, n)``, rad or m.
    """

    shape: tuple[int, int, int]
    origin: Array
    step: float
    index: NDArray[np.int64]
    points: Array
    joints: Array


def field_grid(nominal: Geometry, step: float, seed: int) -> FieldGrid:
    """A grid over the workspace of an arm.

    Args:
        nominal: The arm as its controller believes it to be.
        step: Cell size, m.
        seed: Seed of the joints that find the workspace's extent.
    """
    probe = forward(nominal, random_joints(nominal, PROBES, np.random.default_rng(seed)))
    upright = probe.rotation[:, 2, 2] > np.cos(UPRIGHT)
    low, high = np.percentile(probe.position[upright], [1, 99], axis=0)
    shape = np.maximum(((high - low) / step).astype(int), 1)
    index = np.stack(np.meshgrid(*(np.arange(count) for count in shape), indexing="ij"), -1).reshape(-1, 3)
    origin = (low + high) / 2 - (shape - 1) / 2 * step
    points = origin + index * step
    solution = inverse(nominal, Pose(points, np.eye(3)), restarts=1)
    inside = solution.reached
    return FieldGrid(
        shape=(int(shape[0]), int(shape[1]), int(shape[2])),
        origin=origin,
        step=step,
        index=index[inside],
        points=points[inside],
        joints=solution.joints[inside],
    )
