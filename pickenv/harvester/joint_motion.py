"""Times and curves of joint motion under limits of speed and acceleration (trapezoidal profiles); Li 2016, Fig. 9.

Units: m, rad, s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.base import read_toml
from pickenv.harvester.machine import SHIPPED, Machine, MachineFile


def travel_time(distance: ArrayLike, speed: ArrayLike, acceleration: ArrayLike) -> Array:
    """Time of a move from rest to rest: 2 sqrt(s/a) while the speed is not reached, else s/v + v/a."""
    s, v, a = (np.asarray(value, dtype=float) for value in (np.abs(distance), speed, acceleration))
    return np.asarray(np.where(s * a < v * v, 2 * np.sqrt(s / a), s / v + v / a))


def profile(time: ArrayLike, distance: ArrayLike, speed: ArrayLike, acceleration: ArrayLike) -> Array:
    """Displacement at ``time`` after the start of such a move, signed as ``distance``. Shapes broadcast."""
    t, s, v, a = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (time, distance, speed, acceleration)))
    sign, s = np.sign(s), np.abs(s)
    peak = np.minimum(v, np.sqrt(s * a))  # speed reached
    ramp = peak / a
    total = np.where(s > 0, s / np.maximum(peak, 1e-12) + ramp, 0.0)
    t = np.clip(t, 0.0, total)
    up = a * np.minimum(t, ramp) ** 2 / 2
    flat = peak * np.clip(t - ramp, 0.0, np.maximum(total - 2 * ramp, 0.0))
    late = np.clip(t - (total - ramp), 0.0, ramp)
    return np.asarray(sign * np.minimum(up + flat + peak * late - a * late**2 / 2, s))


def master_time(machine: Machine, start: ArrayLike, end: ArrayLike) -> Array:
    """Time of a move of the master, its joints starting together, (...)."""
    distance = np.asarray(end, dtype=float) - np.asarray(start, dtype=float)
    return np.asarray(travel_time(distance, machine.master.speed, machine.master_acceleration).max(axis=-1))


def dense_workspace() -> tuple[tuple[float, ...], ...]:
    """Where Li 2016, Fig. 8, finds the cloud of reached points dense: ranges of x, y and z in the base frame, m."""
    workspace = read_toml(MachineFile, SHIPPED).workspace
    assert workspace is not None, SHIPPED
    return workspace.dense_x, workspace.dense_y, workspace.dense_z
