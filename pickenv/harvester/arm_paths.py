"""Paths of the slave arms over time, their least distance, and the echoes that a side arm's ultrasonic rangers receive.

Arms are numbered from 0, left to right. Arms with odd numbers are middle arms, arms with even numbers side arms. A side
arm has a ranger on each flank of its cup. The ranger points sideways in the horizontal plane at a middle arm, and
measures the nearest surface in its cone. The ranger does not use the timetable. Units: m, rad, s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.harvester.interference import arm_distances, cup_in_plan
from pickenv.harvester.machine import Machine, profile, travel_time
from pickenv.harvester.work import Hold, Timetable, Work

ALONG = np.linspace(0.0, 1.0, 25)
"""Points of a middle arm's centre line, as shares of its length from pivot to cup, that can return an echo."""


def echoes(machine: Machine, slaves: ArrayLike, arm: int) -> Array:
    """Return the distances that a side arm's rangers measure to the nearest surface of a middle arm in their cones.

    Args:
        machine: The machine.
        slaves: Nominal joints of all slave arms, (..., arms, 3), m and rad.
        arm: Number of the side arm that measures.

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

    The arm measures once in each period of its ranger, with the ranger's noise. It starts at the first measurement that
    is not below `Body.guard`. It waits at most until the picks that middle arms have begun are over. A middle arm that
    returns no echo does not stop it.

    Args:
        machine: The machine.
        work: Scheduling problem of the zone.
        rng: Random generator of the ranger's noise.

    Returns:
        The rule as a function for `timetable`; see `pickenv.harvester.work.Hold`.
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
    """Return the share of a move of two joints that is done after ``time``; the slower joint sets the pace."""
    if total <= 0:
        return np.ones_like(time)
    lead = int(np.argmax(travel_time(moves, speed, acceleration)))
    return np.asarray(profile(time, 1.0, speed[lead] / abs(moves[lead]), acceleration[lead] / abs(moves[lead])))


def closest_approach(machine: Machine, work: Work, times: Timetable, step: float = 0.1) -> float:
    """Least distance between the centre lines of two arms over a timetable, m; infinite with one arm or without picks.

    Args:
        machine: The machine.
        work: Scheduling problem of the zone.
        times: The timetable.
        step: Time between two samples, s.
    """
    if machine.arms < 2 or not len(times.arm):
        return float("inf")
    at = np.arange(0.0, times.makespan + step, step)
    return float(arm_distances(machine, slave_joints_at(machine, work, times, at)).min())
