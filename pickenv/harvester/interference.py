"""Where arms may meet: distances between capsules, and which picks must not happen at the same time.

Slaves are level, so two of them are as far apart as their plan distance and their height difference say. At rest an arm
points straight ahead and is short; there it is safe from every neighbour (`machine.refuse_touching_arms`), and there
alone it moves up and down. So only excursions, from rest out to a fruit and back, can meet. Units: m, rad.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.harvester.machine import Machine

Flags = NDArray[np.bool_]


def segment_distance(p: ArrayLike, q: ArrayLike, r: ArrayLike, s: ArrayLike) -> Array:
    """Distance between the segments p-q and r-s in the plane; all (..., 2), broadcast."""
    ends = np.stack(np.broadcast_arrays(p, q, r, s)).astype(float)
    start, end = ends[[2, 2, 0, 0]], ends[[3, 3, 1, 1]]  # of the other segment
    gaps, sides = _point_segment(ends, start, end).min(axis=0), _side(start, end, ends)
    crossing = (sides[0] * sides[1] < 0) & (sides[2] * sides[3] < 0)
    return np.asarray(np.where(crossing, 0.0, gaps))


def _point_segment(point: Array, a: Array, b: Array) -> Array:
    along = b - a
    square = (along * along).sum(axis=-1)
    share = ((point - a) * along).sum(axis=-1) / np.maximum(square, 1e-18)
    gap = point - a - np.minimum(np.maximum(share, 0.0), 1.0)[..., None] * along
    return np.asarray(np.hypot(gap[..., 0], gap[..., 1]))


def _side(a: Array, b: Array, c: Array) -> Array:
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    )


def plan(machine: Machine, slaves: ArrayLike) -> tuple[Array, Array]:
    """Pivot and cup of every slave in plan, seen in the master's frame: x right, y ahead; (..., arms, 2) each."""
    swing, d6 = np.asarray(slaves, dtype=float)[..., 1], np.asarray(slaves, dtype=float)[..., 2]
    pivot, cup = np.zeros((2, *swing.shape, 2))
    pivot[..., 0] = machine.offsets
    cup[..., 0], cup[..., 1] = machine.offsets - d6 * np.sin(swing), d6 * np.cos(swing)
    return pivot, cup


@lru_cache(maxsize=8)
def pairs_of(arms: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and second arm of each pair."""
    first, second = np.triu_indices(arms, 1)
    return first, second


def arm_distances(machine: Machine, slaves: ArrayLike) -> Array:
    """Distance between the centre lines of each pair of slaves at joints (..., arms, 3): (..., pairs).

    Pairs in the order of ``numpy.triu_indices(arms, 1)``.
    """
    slaves = np.asarray(slaves, dtype=float)
    pivot, cup = plan(machine, slaves)
    i, j = pairs_of(machine.arms)
    level = segment_distance(pivot[..., i, :], cup[..., i, :], pivot[..., j, :], cup[..., j, :])
    return np.asarray(np.hypot(level, slaves[..., i, 0] - slaves[..., j, 0]))


def excursion_distances(machine: Machine, joints: Array, approach: Array) -> Array:
    """Least distance between two excursions, whenever each happens.

    An excursion sweeps the fan between the arm at rest and the arm at the fruit; its height runs from ``approach``
    below the fruit up to it.

    Args:
        machine: The machine.
        joints: Slave joints at each fruit, (arms, n, 3).
        approach: How far below each fruit the cup starts to rise, (n,).

    Returns:
        Distances (arms, n, arms, n), m; infinite for one and the same arm.
    """
    arms, n = joints.shape[:2]
    share = np.array([0.0, 0.34, 0.67, 1.0])[:, None, None]
    swing = joints[None, ..., 1] * share
    length = machine.slave_home[2] + (joints[None, ..., 2] - machine.slave_home[2]) * share
    pivot = np.zeros((arms, n, 2))
    pivot[..., 0] = machine.offsets[:, None]
    tips = pivot + np.stack(
        [-length * np.sin(swing), length * np.cos(swing)], axis=-1
    )  # along the way, (4, arms, n, 2)
    starts = np.stack([pivot, pivot, tips[0], tips[1], tips[2]])
    ends = np.stack([tips[0], tips[3], tips[1], tips[2], tips[3]])
    top = joints[..., 0]
    bottom = top - approach
    found = np.full((arms, n, arms, n), np.inf)
    for a in range(arms):
        for b in range(a + 1, arms):
            edge = starts[:, None, a, :, None], ends[:, None, a, :, None]
            other = starts[None, :, b, None, :], ends[None, :, b, None, :]
            level = segment_distance(*edge, *other).min(axis=(0, 1))
            gap = np.maximum(bottom[a][:, None] - top[b][None], bottom[b][None] - top[a][:, None])
            found[a, :, b, :] = np.hypot(level, np.maximum(gap, 0.0))
            found[b, :, a, :] = found[a, :, b, :].T
    return found
