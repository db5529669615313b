"""The work of one zone as a scheduling problem: which arm can pick which fruit, in what time, and which picks conflict.

A pick begins with travel: the arm moves up or down, straight ahead and at its shortest. Its excursion follows: the arm
swings and stretches below the fruit, rises, senses, cuts, swings back and draws in. Travel is safe. Only excursions of
different arms can meet. Units: m, rad, s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.harvester.interference import excursion_distances
from pickenv.harvester.machine import Machine, travel_time

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
        reached: Whether each arm reaches each fruit, (arms, n).
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
        arm: Index of the arm of each pick, (picks,).
        fruit: Index of the fruit of each pick, (picks,).
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
"""Rule of waiting: a function that gives the time at which an arm starts its excursion, s.

Its arguments are the arm, its fruit, the time at which it is ready (s), and the timetable of earlier picks.
"""


def timetable(work: Work, plan: Plan, *, hold: Hold | None = None) -> Timetable:
    """Return the times of a plan's picks.

    An excursion, the way from rest out to a fruit and back, starts once its arm is ready and no conflicting excursion
    is under way.

    Args:
        work: Scheduling problem of the zone.
        plan: For each arm, the indices of its fruit in picking order.
        hold: Rule by which an arm waits longer, such as `pickenv.harvester.ultrasonic_hold`. With a rule, the
            middle arm (odd number) goes first if two arms could start at the same time.
    """
    return _table(_schedule(work, plan, hold))


def _table(rows: list[Row]) -> Timetable:
    arm, fruit, start, end, held = np.array(rows, dtype=float).reshape(-1, 5).T
    return Timetable(arm.astype(np.int64), fruit.astype(np.int64), start, end, held, float(end.max(initial=0.0)))


def _schedule(work: Work, plan: Sequence[Sequence[int]], hold: Hold | None = None) -> list[Row]:
    """Return the picks in the order of their starts, each with its arm, fruit, start, end and waiting time."""
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
    """Return a plan's makespan, s, and the index of the arm that finishes last; (0, 0) for a plan without picks."""
    row = max(_schedule(work, plan), key=lambda row: row[3], default=(0, 0, 0.0, 0.0, 0.0))
    return row[3], row[0]
