"""Distances between slave arms, taken as capsules, and the pairs of picks that must not overlap in time.

Slave arms are horizontal. The distance between two slave arms follows from their distance in plan and their difference
in height. An arm at rest points straight ahead and has its shortest length. No neighbour can touch an arm at rest
(`machine.refuse_touching_arms`). Between picks an arm moves up and down at rest only. An excursion is an arm's way from
rest out to a fruit and back. Arms can meet only during excursions. Units: m, rad, s.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Scalar, Scalars
from pickenv.arm.kinematics.backend import ONE, chosen
from pickenv.harvester.machine import Machine

Point = tuple[Scalar, Scalar]

FEW = 4
"""Largest number of joint configurations for which plain floats are faster than NumPy; both give the same bits."""


def segment_distance(p: ArrayLike, q: ArrayLike, r: ArrayLike, s: ArrayLike) -> Array:
    """Return the distances (...) between segments from p to q and from r to s in a plane; end points (..., 2), m."""
    ends = [(point[..., 0], point[..., 1]) for point in (np.asarray(end, dtype=float) for end in (p, q, r, s))]
    return np.asarray(np.sqrt(_square_between(np, *ends)))


def _square_between(m: Any, p: Point, q: Point, r: Point, s: Point) -> Scalar:
    """Return the squared distance between the segments from p to q and from r to s in a plane.

    ``m`` is NumPy, or `ONE` for single numbers.
    """
    near = m.minimum(_square_from(m, p, r, s), _square_from(m, q, r, s))
    near = m.minimum(near, m.minimum(_square_from(m, r, p, q), _square_from(m, s, p, q)))
    crossing = (_side(r, s, p) * _side(r, s, q) < 0) & (_side(p, q, r) * _side(p, q, s) < 0)
    return chosen(m, crossing, 0.0, near)


def _square_from(m: Any, point: Point, a: Point, b: Point) -> Scalar:
    """Return the squared distance in a plane between a point and the segment from a to b.

    ``m`` is NumPy, or `ONE` for single numbers.
    """
    along, across = b[0] - a[0], b[1] - a[1]
    x, y = point[0] - a[0], point[1] - a[1]
    share = (x * along + y * across) / m.maximum(along * along + across * across, 1e-18)
    share = m.minimum(m.maximum(share, 0.0), 1.0)
    x, y = x - share * along, y - share * across
    return x * x + y * y


def _side(a: Point, b: Point, c: Point) -> Scalar:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def cup_in_plan(m: Any, offset: Scalar, swing: Scalar, d6: Scalar) -> Point:
    """Return a cup's position in plan, m: distance to the right of, and ahead of, the middle between all pivots.

    Right and ahead are as seen along the master's heading.

    Args:
        m: NumPy, or `ONE` for floats.
        offset: Offset of the slave's pivot to the right of that middle, m.
        swing: Swing of the slave from straight ahead, rad, positive to the left.
        d6: Length of the slave from pivot to cup, m.
    """
    return offset - d6 * m.sin(swing), d6 * m.cos(swing)


@lru_cache(maxsize=8)
def pairs_of(arms: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return two arrays: the index, from 0, of the first and of the second arm of each pair of ``arms`` arms.

    The order of the pairs is that of ``numpy.triu_indices(arms, 1)``.
    """
    first, second = np.triu_indices(arms, 1)
    return first, second


def arm_distances(machine: Machine, slaves: ArrayLike) -> Array:
    """Return the distances between the centre lines of each pair of slaves, m, (..., pairs), in `pairs_of`'s order.

    Args:
        machine: The machine.
        slaves: Joints of all slaves, (..., arms, 3), m and rad.
    """
    slaves = np.asarray(slaves, dtype=float)
    i, j = pairs_of(machine.arms)
    if slaves.size <= FEW * machine.arms * 3:
        distances = [pair_distances(ONE, machine, row) for row in slaves.reshape(-1, machine.arms, 3).tolist()]
        return np.array(distances).reshape(*slaves.shape[:-2], len(i))
    parts = _ends(np, machine.offsets, *(slaves[..., k] for k in range(3)))
    all_ends = [np.broadcast_to(part, slaves.shape[:-1]) for part in parts]
    first, second = (tuple(part[..., arms] for part in all_ends) for arms in (i, j))
    return np.asarray(_between(np, first, second))


def pair_distances(m: Any, machine: Machine, slaves: Sequence[Scalars]) -> list[Scalar]:
    """List the distances between the centre lines of each pair of slaves for one joint configuration, m.

    `pairs_of` gives the order of the list.

    Args:
        m: NumPy, or `ONE` for single numbers.
        machine: The machine.
        slaves: The three joints of each slave, m and rad.
    """
    ends = [_ends(m, offset, *joints) for offset, joints in zip(machine.offsets.tolist(), slaves, strict=True)]
    return [_between(m, ends[a], ends[b]) for a, b in zip(*pairs_of(machine.arms), strict=True)]


def _ends(m: Any, offset: Scalar, d4: Scalar, swing: Scalar, d6: Scalar) -> tuple[Scalar, ...]:
    """Return four numbers of a slave, m: x of the pivot, x and y of the cup in plan, and the arm's height d4.

    x is to the right and y ahead, as in `cup_in_plan`, which explains ``m``, ``offset``, ``swing`` and ``d6``.
    """
    return offset, *cup_in_plan(m, offset, swing, d6), d4


def _between(m: Any, first: tuple[Scalar, ...], second: tuple[Scalar, ...]) -> Scalar:
    """Return the distance between the centre lines of two slaves, m, each given as `_ends` returns it.

    ``m`` is NumPy, or `ONE` for single numbers.
    """
    (a, x, y, height), (b, u, v, level) = first, second
    return m.sqrt(_square_between(m, (a, 0.0), (x, y), (b, 0.0), (u, v)) + (height - level) * (height - level))


def excursion_distances(machine: Machine, joints: Array, approach: Array) -> Array:
    """Compute the least distance between every two excursions, over all times at which they could happen.

    An excursion is an arm's way from rest out to a fruit and back. In plan it sweeps a fan, from the arm at rest to the
    arm at the fruit. Its height runs from ``approach`` below the fruit up to the fruit.

    Args:
        machine: The machine.
        joints: Slave joints at each fruit, (arms, n, 3), m and rad.
        approach: Distance below each fruit at which the cup starts to rise, m, (n,).

    Returns:
        Distances between the centre lines of the two arms, m, (arms, n, arms, n): by arm and fruit of the first
        excursion, then of the second. They are infinite between excursions of one arm.
    """
    arms, n = joints.shape[:2]
    share = np.array([0.0, 0.34, 0.67, 1.0])[:, None, None]
    swing = joints[None, ..., 1] * share
    length = machine.slave_home[2] + (joints[None, ..., 2] - machine.slave_home[2]) * share
    pivot = np.zeros((arms, n, 2))
    pivot[..., 0] = machine.offsets[:, None]
    tips = np.stack(cup_in_plan(np, pivot[..., 0], swing, length), axis=-1)  # along the way, (4, arms, n, 2)
    starts = np.stack([pivot, pivot, tips[0], tips[1], tips[2]])
    ends = np.stack([tips[0], tips[3], tips[1], tips[2], tips[3]])
    top = joints[..., 0]
    bottom = top - approach
    distances = np.full((arms, n, arms, n), np.inf)
    for a in range(arms):
        for b in range(a + 1, arms):
            edge = starts[:, None, a, :, None], ends[:, None, a, :, None]
            other_edge = starts[None, :, b, None, :], ends[None, :, b, None, :]
            level = segment_distance(*edge, *other_edge).min(axis=(0, 1))
            gap = np.maximum(bottom[a][:, None] - top[b][None], bottom[b][None] - top[a][:, None])
            distances[a, :, b, :] = np.hypot(level, np.maximum(gap, 0.0))
            distances[b, :, a, :] = distances[a, :, b, :].T
    return distances
