"""The work of one zone as a scheduling problem: which arm can pick which fruit, in what time, and which picks conflict.

A pick begins with travel: the arm moves up or down, straight ahead and at its shortest. Its excursion follows: the arm
swings and stretches below the fruit, rises, senses, cuts, swings back and draws in. The same moves give each arm's
joints at each time of a timetable, and the distances that its rangers then measure.

Slave arms are capsules, and horizontal. The distance between two of them follows from their distance in plan and their
difference in height. No neighbour can touch an arm at rest (`machine.refuse_touching_arms`). Between excursions an
arm only moves up and down, and stays straight ahead and at its shortest. So arms can meet only during excursions.
Units: m, rad, s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Scalar, Scalars
from pickenv.arm.kinematics.forward import ONE, chosen
from pickenv.harvester.machine import Machine, profile, travel_time

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
    """Return a cup's position in plan, m: its distances to the right and ahead from the middle between all pivots.

    Ahead is the master's heading.

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

    The pairs have the order of ``numpy.triu_indices(arms, 1)``.
    """
    return np.triu_indices(arms, 1)


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

    x is to the right and y ahead. ``d4`` is returned unchanged; all other arguments are as for `cup_in_plan`.
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


Plan = tuple[tuple[int, ...], ...]
"""For each arm, the indices of the fruit that it picks, in picking order."""

Row = tuple[int, int, float, float, float]


@dataclass(frozen=True, eq=False)
class Work:
    """The picks that a zone offers, as a scheduling problem.

    An excursion is an arm's way from rest (straight ahead, shortest) out to a fruit and back. Travel is the vertical
    move that the arm makes before an excursion.

    Attributes:
        joints: Nominal slave joints at each fruit, m and rad, not clipped to the limits, (arms, n, 3).
        reached: Whether each arm (from left to right) reaches each fruit, (arms, n).
        out: Time from the start of an excursion to the end of its rise, s, (arms, n).
        duration: Time of a whole excursion, s, (arms, n).
        first: Time of the travel from the home position to below each fruit, s, (n,).
        travel: Time of the travel from one fruit's height to below another, s, (n, n).
        conflict: Whether the excursions of one arm to one fruit and of another arm to another fruit must not overlap in
            time, (arms, n, arms, n).
        approach: Distance below each fruit at which the cup starts to rise, m, (n,).
    """

    joints: Array
    reached: NDArray[np.bool_]
    out: Array
    duration: Array
    first: Array
    travel: Array
    conflict: NDArray[np.bool_]
    approach: Array

    @property
    def arms(self) -> int:
        """Number of arms."""
        return int(self.reached.shape[0])

    @property
    def count(self) -> int:
        """Number of fruit, reachable or not."""
        return int(self.reached.shape[1])

    @cached_property
    def lists(self) -> tuple[list[list[float]], list[float], list[list[float]], list[list[list[list[bool]]]]]:
        """`duration`, `first`, `travel` and `conflict` as plain lists, which a search over plans reads fastest."""
        return self.duration.tolist(), self.first.tolist(), self.travel.tolist(), self.conflict.tolist()

    @property
    def reachable(self) -> NDArray[np.bool_]:
        """Flags (n,): whether some arm reaches each fruit."""
        return np.asarray(self.reached.any(axis=0))


def zone_work(machine: Machine, master: ArrayLike, fruit: ArrayLike) -> Work:
    """Return the scheduling problem of a zone.

    Args:
        machine: The machine.
        master: Nominal joints at which the master stands, (3,).
        fruit: Measured positions of the fruit in the base frame, m, (n, 3).
    """
    fruit = np.asarray(fruit, dtype=float).reshape(-1, 3)
    joints = machine.slave_inverse(master, fruit)
    clipped = np.clip(joints, machine.slave.lower, machine.slave.upper)
    height = clipped[0, :, 0]
    approach = np.minimum(machine.cycle.approach, height - machine.slave.lower[0])
    speed, acceleration = machine.slaves[0].speed, machine.slave_acceleration
    stretch = travel_time((clipped - machine.slave_home)[..., 1:], speed[1:], acceleration[1:]).max(axis=-1)
    rise = travel_time(approach, speed[0], acceleration[0])
    start = height - approach
    return Work(
        joints=joints,
        reached=machine.within_limits(joints),
        out=stretch + rise,
        duration=2 * stretch + rise + (machine.cycle.sense + machine.cycle.cut),
        first=travel_time(start - machine.slave_home[0], speed[0], acceleration[0]),
        travel=travel_time(height[:, None] - start[None, :], speed[0], acceleration[0]),
        conflict=excursion_distances(machine, clipped, approach) < machine.body.clearance,
        approach=approach,
    )


@dataclass(frozen=True, eq=False)
class Timetable:
    """The times of picks, in the order of their starts.

    An excursion is an arm's way from rest out to a fruit and back.

    Attributes:
        arm: Index of the arm of each pick, from 0 on the left, (picks,).
        fruit: Index of the fruit of each pick, from 0, (picks,).
        start: Start of each excursion, s, (picks,).
        end: End of each excursion, s, (picks,).
        held: Time that the arm waited for other arms before each excursion, s, (picks,).
        makespan: End of the last excursion, s; 0 without picks.
    """

    arm: NDArray[np.int64]
    fruit: NDArray[np.int64]
    start: Array
    end: Array
    held: Array
    makespan: float


Hold = Callable[[int, int, float, Timetable], float]
"""Rule of waiting: a function that gives the time at which an arm starts its excursion, s. Its arguments are the arm,
its fruit, the time at which it is ready (s), and the timetable of earlier picks."""


def timetable(work: Work, plan: Plan, *, hold: Hold | None = None) -> Timetable:
    """Return the times of a plan's picks.

    An excursion, the way from rest out to a fruit and back, starts once its arm is ready and no conflicting excursion
    is under way.

    Args:
        work: Scheduling problem of the zone.
        plan: For each arm, the indices of its fruit, from 0, in picking order.
        hold: Rule by which an arm waits longer, such as `pickenv.harvester.ultrasonic_hold`. With a rule, a middle arm
            (odd index, counted from 0) goes first if two arms could start at the same time.
    """
    return _table(_schedule(work, plan, hold))


def _table(rows: list[Row]) -> Timetable:
    arm, fruit, start, end, held = np.array(rows, dtype=float).reshape(-1, 5).T
    return Timetable(arm.astype(np.int64), fruit.astype(np.int64), start, end, held, float(end.max(initial=0.0)))


def _schedule(work: Work, plan: Sequence[Sequence[int]], hold: Hold | None = None) -> list[Row]:
    """Return the picks in the order of their starts, each with its arm, fruit, start, end and waiting time, s.

    `timetable` explains ``plan`` and ``hold``. Arms and fruit are indices from 0.
    """
    (duration, first, travel, barred), arms = work.lists, range(len(plan))
    done: list[Row] = []
    at = [0] * len(plan)
    ready = [first[plan[a][0]] if len(plan[a]) else np.inf for a in arms]
    while True:
        best: tuple[float, int, int] | None = None
        for a in arms:
            if at[a] == len(plan[a]):
                continue
            fruit, start = plan[a][at[a]], ready[a]
            delayed = True
            while delayed:  # until no excursion already fixed is in the way; all of these have begun before ``start``
                delayed = False
                for b, picked, _, end, _ in done:
                    if b != a and start < end and barred[a][fruit][b][picked]:
                        start, delayed = end, True
                if hold is not None and not delayed:
                    later = hold(a, fruit, start, _table(done))
                    start, delayed = later, later > start
            key = (start, 0 if hold is not None and a % 2 else 1, a)
            if best is None or key < best:
                best = key
        if best is None:
            return done
        start, _, a = best
        fruit = plan[a][at[a]]
        end = start + duration[a][fruit]
        done.append((a, fruit, start, end, start - ready[a]))
        at[a] += 1
        if at[a] < len(plan[a]):
            ready[a] = end + travel[fruit][plan[a][at[a]]]


def last_arm(work: Work, plan: Sequence[Sequence[int]]) -> tuple[float, int]:
    """Return a plan's makespan, s, and the index (from 0) of the arm that finishes last; (0, 0) without picks.

    The makespan is the time at which the last excursion ends. A plan lists, for each arm, the indices of its fruit in
    the order of picking.
    """
    row = max(_schedule(work, plan), key=lambda row: row[3], default=(0, 0, 0.0, 0.0, 0.0))
    return row[3], row[0]


# Paths of the slave arms over time, their least distance, and the echoes that a side arm's ultrasonic rangers receive.
# Arms are numbered from 0, left to right. Arms with odd numbers are middle arms, arms with even numbers side arms. A
# side arm has a ranger on each flank of its cup. The ranger points sideways in the horizontal plane at a middle arm,
# and measures the nearest surface in its cone. The ranger does not use the timetable.


ALONG = np.linspace(0.0, 1.0, 25)
"""Points of a middle arm's centre line that can return an echo, as shares of the way from pivot to cup."""


def echoes(machine: Machine, slaves: ArrayLike, arm: int) -> Array:
    """Return the distance that a side arm's rangers measure to the nearest surface of a middle arm in their cones.

    Args:
        machine: The machine.
        slaves: Nominal joints of all slave arms, (..., arms, 3), m and rad.
        arm: Index, from 0 on the left, of the side arm that measures; side arms have even indices.

    Returns:
        Distances from surface to surface, m, (...); infinite where no surface is in a cone and within range.
    """
    slaves, ranger = np.asarray(slaves, dtype=float), machine.ranger
    pivot = np.stack([machine.offsets, np.zeros(machine.arms)], axis=-1)
    cup = np.stack(cup_in_plan(np, machine.offsets, slaves[..., 1], slaves[..., 2]), axis=-1)
    eye, height = cup[..., arm, :], slaves[..., arm, 0]
    nearest = np.full(height.shape, np.inf)
    for neighbour in range(1, machine.arms, 2):
        if neighbour == arm:
            continue
        away = pivot[neighbour] + ALONG[:, None] * (cup - pivot)[..., neighbour, None, :] - eye[..., None, :]
        side = away[..., 0] * np.sign(neighbour - arm)  # how far beside, on the flank that faces this neighbour
        off = np.hypot(away[..., 1], (slaves[..., neighbour, 0] - height)[..., None])
        heard = (side > 0) & (np.maximum(off - machine.body.radius, 0.0) <= side * np.tan(ranger.beam))
        gap = np.maximum(np.hypot(side, off) - 2 * machine.body.radius, 0.0)
        nearest = np.minimum(nearest, np.where(heard & (gap <= ranger.farthest), gap, np.inf).min(axis=-1))
    return nearest


def ultrasonic_hold(machine: Machine, work: Work, rng: np.random.Generator) -> Hold:
    """Return Li's waiting rule for `timetable`: a side arm stays at rest while it measures a middle arm too near.

    Side arms have even indices, middle arms odd indices, from 0 on the left. The side arm measures once in each period
    of its ranger, with the ranger's noise. It starts at the first measurement that is not below `Body.guard`. It
    starts at the latest when the middle arms' present picks are over. A middle arm without an echo does not stop it.

    Args:
        machine: The machine.
        work: Scheduling problem of the zone.
        rng: Random generator of the ranger's noise.

    Returns:
        The rule as a function for `timetable`; see `Hold`.
    """

    def hold(arm: int, fruit: int, start: float, begun: Timetable) -> float:
        until = float(begun.end[begun.arm % 2 == 1].max(initial=0.0))  # afterwards all middle arms are at rest
        if arm % 2 or until <= start:
            return start
        count = int((until - start) / machine.ranger.period) + 2
        at = start + machine.ranger.period * np.arange(count, dtype=np.float64)
        slaves = slave_joints_at(machine, work, begun, at)
        slaves[:, arm] = machine.slave_home
        slaves[:, arm, 0] = work.joints[arm, fruit, 0] - work.approach[fruit]
        heard = echoes(machine, slaves, arm) + machine.ranger.noise * rng.normal(size=len(at))
        clear = np.flatnonzero(heard >= machine.body.guard)
        return float(at[clear[0]] if clear.size else at[-1])

    return hold


def slave_joints_at(machine: Machine, work: Work, times: Timetable, at: Array) -> Array:
    """Compute the nominal joints of all slave arms at times ``at`` of a timetable.

    Each phase of a pick is a move with a trapezoidal speed profile.

    Args:
        machine: The machine.
        work: Scheduling problem of the zone.
        times: The timetable.
        at: Times since the start of the timetable, s, (times,).

    Returns:
        Joints (times, arms, 3), m and rad.
    """
    joints = np.broadcast_to(machine.slave_home, (len(at), machine.arms, 3)).copy()
    speed, acceleration = machine.slaves[0].speed, machine.slave_acceleration
    height, free = np.full(machine.arms, machine.slave_home[0]), np.zeros(machine.arms)
    for pick in np.argsort(times.start, kind="stable").tolist():
        a, fruit, begin, end = times.arm[pick], times.fruit[pick], times.start[pick], times.end[pick]
        goal, below = work.joints[a, fruit], work.joints[a, fruit, 0] - work.approach[fruit]
        moves = goal[1:] - machine.slave_home[1:]
        stretch = float(travel_time(moves, speed[1:], acceleration[1:]).max())
        on = at >= free[a]
        joints[on, a, 0] = height[a] + profile(at[on] - free[a], below - height[a], speed[0], acceleration[0])
        on = at >= begin + stretch
        joints[on, a, 0] = below + profile(at[on] - begin - stretch, goal[0] - below, speed[0], acceleration[0])
        for start, back in ((begin, False), (end - stretch, True)):
            on = at >= start
            share = _share(at[on] - start, moves, speed[1:], acceleration[1:], stretch)[:, None]
            joints[on, a, 1:] = machine.slave_home[1:] + (1 - share if back else share) * moves
        height[a], free[a] = goal[0], end
    return joints


def _share(time: Array, moves: Array, speed: Array, acceleration: Array, total: float) -> Array:
    """Return the share of a move of two joints that is done ``time`` seconds after its start.

    The slower joint sets the pace.

    Args:
        time: Times since the start, s.
        moves: Displacements of the two joints, m or rad, (2,).
        speed: Largest speeds of the joints, m/s or rad/s, (2,).
        acceleration: Largest accelerations of the joints, m/s² or rad/s², (2,).
        total: Duration of the move, s; if it is 0, the share is 1.
    """
    if total <= 0:
        return np.ones_like(time)
    lead = int(np.argmax(travel_time(moves, speed, acceleration)))
    return np.asarray(profile(time, 1.0, speed[lead] / abs(moves[lead]), acceleration[lead] / abs(moves[lead])))


def closest_approach(machine: Machine, work: Work, times: Timetable) -> float:
    """Return the least distance between centre lines of two arms in a timetable, m; inf with one arm or no picks.

    Args:
        machine: The machine.
        work: Scheduling problem of the zone.
        times: The timetable, which is sampled every 0.1 s.
    """
    if machine.arms < 2 or not len(times.arm):
        return float("inf")
    at = np.arange(0.0, times.makespan + 0.1, 0.1)
    return float(arm_distances(machine, slave_joints_at(machine, work, times, at)).min())
