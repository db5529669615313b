"""The arms at any time of a timetable, their least distances, and the echoes of a side arm's ultrasonic ranger.

The ranger sits on both flanks of the side arm's cup and looks sideways, level, at the neighbour: it measures the
surface that is nearest in its cone, as far as its echo carries. It knows no timetable. Units: m, rad, s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.harvester.interference import arm_distances, plan
from pickenv.harvester.machine import Machine, profile, travel_time
from pickenv.harvester.work import Hold, Timetable, Work

ALONG = np.linspace(0.0, 1.0, 25)
"""Points of a neighbour's centre line that may send an echo."""


def echoes(machine: Machine, slaves: ArrayLike, arm: int) -> Array:
    """Distance from slave ``arm``'s cup to the middle arms' nearest surface in its rangers' cones, (...), m.

    Infinite where nothing stands in a cone, or nothing within range. ``slaves``: joints of all arms, (..., arms, 3).
    """
    slaves, ranger = np.asarray(slaves, dtype=float), machine.ranger
    pivot, cup = plan(machine, slaves)
    eye, height = cup[..., arm, :], slaves[..., arm, 0]
    nearest = np.full(height.shape, np.inf)
    for neighbour in range(1, machine.arms, 2):
        if neighbour == arm:
            continue
        line = pivot[..., neighbour, None, :] + ALONG[:, None] * (cup - pivot)[..., neighbour, None, :]
        away = line - eye[..., None, :]
        side = away[..., 0] * np.sign(neighbour - arm)  # how far beside, on the flank that faces this neighbour
        off = np.hypot(away[..., 1], (slaves[..., neighbour, 0] - height)[..., None])
        heard = (side > 0) & (np.maximum(off - machine.body.radius, 0.0) <= side * np.tan(ranger.beam))
        gap = np.maximum(np.hypot(side, off) - 2 * machine.body.radius, 0.0)
        nearest = np.minimum(nearest, np.where(heard & (gap <= ranger.farthest), gap, np.inf).min(axis=-1))
    return nearest


def ultrasonic_hold(machine: Machine, work: Work, rng: np.random.Generator) -> Hold:
    """Li's rule for `timetable`: a side arm (even, from 0) stays at rest while it hears a middle arm (odd) too near.

    It listens once a period, with the ranger's noise. What it hears is where the neighbour is, late or not; what no
    echo comes from, it does not know of.
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
    """Nominal slave joints (times, arms, 3) at times ``at`` of a timetable: trapezoidal moves, phase by phase."""
    joints = np.broadcast_to(machine.slave_home, (len(at), machine.arms, 3)).copy()
    speed, acceleration = machine.slaves[0].speed, machine.slave_acceleration
    fixed = machine.cycle.sense + machine.cycle.cut
    for a in range(machine.arms):
        mine = np.flatnonzero(times.arm == a)
        height, free = float(machine.slave_home[0]), 0.0
        for pick in mine[np.argsort(times.start[mine], kind="stable")].tolist():
            goal = work.joints[a, times.fruit[pick]]
            below = float(goal[0] - work.approach[times.fruit[pick]])
            on = at >= free
            joints[on, a, 0] = height + profile(at[on] - free, below - height, speed[0], acceleration[0])
            moves = goal[1:] - machine.slave_home[1:]
            stretch = float(travel_time(moves, speed[1:], acceleration[1:]).max())
            begin, end = float(times.start[pick]), float(times.end[pick])
            on = at >= begin
            share = _share(at[on] - begin, moves, speed[1:], acceleration[1:], stretch)
            joints[on, a, 1:] = machine.slave_home[1:] + share[:, None] * moves
            on = at >= begin + stretch
            joints[on, a, 0] = below + profile(at[on] - begin - stretch, goal[0] - below, speed[0], acceleration[0])
            back = end - stretch
            assert back >= begin + stretch + fixed - 1e-9
            on = at >= back
            share = _share(at[on] - back, moves, speed[1:], acceleration[1:], stretch)
            joints[on, a, 1:] = machine.slave_home[1:] + (1 - share[:, None]) * moves
            height, free = float(goal[0]), end
    return joints


def _share(time: Array, moves: Array, speed: Array, acceleration: Array, total: float) -> Array:
    """Share of a joint move done after ``time``: the joint that takes longest leads, the other keeps step."""
    if total <= 0:
        return np.ones_like(time)
    lead = int(np.argmax(travel_time(moves, speed, acceleration)))
    return np.asarray(profile(time, 1.0, speed[lead] / abs(moves[lead]), acceleration[lead] / abs(moves[lead])))


def closest_approach(machine: Machine, work: Work, times: Timetable, step: float = 0.1) -> float:
    """Least distance between the centre lines of two arms over a timetable, sampled every ``step`` seconds, m."""
    if machine.arms < 2 or not len(times.arm):
        return float("inf")
    at = np.arange(0.0, times.makespan + step, step)
    return float(arm_distances(machine, slave_joints_at(machine, work, times, at)).min())
