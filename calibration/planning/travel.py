"""The order in which poses are measured: nearest neighbour, then 2-opt (Croes 1958), in the time the joints need.

All joints move together, each at its largest speed, so the slowest one sets the time of a move. A speed of zero is
refused. Units: rad, m, s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError


def move_seconds(joints: Array, speed: Array) -> Array:
    """Times ``(N, N)`` of the moves between poses ``(N, n)``, at joint speeds ``(n,)``."""
    return np.asarray(np.max(np.abs(joints[:, None] - joints[None]) / _moving(speed), axis=-1))


def travel_seconds(joints: Array, speed: Array) -> float:
    """Time to visit the poses ``(N, n)`` in their order, from the first to the last."""
    return float(np.max(np.abs(np.diff(joints, axis=0)) / _moving(speed), axis=-1).sum())


def _moving(speed: Array) -> Array:
    """The speeds, all of which must be above zero: a joint that stands still never arrives."""
    if not (np.isfinite(speed) & (speed > 0)).all():
        worst = int(np.argmin(np.isfinite(speed) & (speed > 0)))
        raise InputError(f"the speed of joint {worst + 1} is {speed[worst]:g}; give a finite speed above zero")
    return speed


def short_tour(joints: Array, speed: Array) -> NDArray[np.int64]:
    """An order of the poses ``(N, n)`` with short travel: the best nearest-neighbour way, bettered by 2-opt."""
    cost = move_seconds(joints, speed)
    ways = [_two_opt(_nearest_neighbours(cost, start), cost) for start in range(min(len(joints), 10))]
    return min(ways, key=lambda way: float(cost[way[:-1], way[1:]].sum()))


def _nearest_neighbours(cost: Array, start: int) -> NDArray[np.int64]:
    left = np.ones(len(cost), dtype=bool)
    way = [start]
    left[start] = False
    while left.any():
        way.append(int(np.argmin(np.where(left, cost[way[-1]], np.inf))))
        left[way[-1]] = False
    return np.array(way)


def _two_opt(way: NDArray[np.int64], cost: Array) -> NDArray[np.int64]:
    """Reverse the stretch that saves the most time, until none does; the ends of the way are free."""
    count = len(way)
    if count < 3:
        return way
    while True:
        # The stretch i..j is reversed: edges (i - 1, i) and (j, j + 1) are replaced; an edge beyond an end costs 0.
        padded = np.zeros((count + 2, count + 2))
        padded[1:-1, 1:-1] = cost[np.ix_(way, way)]
        steps = padded.diagonal(1)  # steps[k] is the edge from place k - 1 to place k
        before, after = padded[:-2, 1:-1], padded[1:-1, 2:]  # [i, j]: (i - 1, j) and (i, j + 1)
        saved = np.triu(steps[:-1, None] + steps[None, 1:] - before - after, 1)
        i, j = np.unravel_index(int(np.argmax(saved)), saved.shape)
        if not saved[i, j] > 1e-9:  # nor where a cost is no number
            return way
        way = np.concatenate([way[:i], way[i : j + 1][::-1], way[j + 1 :]])
