"""Point-to-point motion of the true arm: joint commands in steps of a control period, no joint above its speed.

All joints of a move start and arrive together; the arm then waits. The command is a staircase of held values, as a
controller gives it. Runs on floats (one arm), arrays and tensors (many moves side by side). Units: s, rad or m.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import ModuleType
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.effects.hysteresis import one_stop
from pickenv.arm.kinematics.forward import Frame, Scalar
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.dynamics import PlantState
from pickenv.arm.plant.plant import Plant

Place: TypeAlias = Callable[[Array], Scalar]
"""Makes a component of an array, for example a tensor on a GPU."""


@dataclass(frozen=True)
class Pace:
    """How the arm is moved.

    Attributes:
        speed: Share of the joints' largest speeds, above 0.
        period: Control period, s.
        dwell: Waiting time between arrival and measurement, s.
    """

    speed: float = 1.0
    period: float = 0.05
    dwell: float = 0.5

    def __post_init__(self) -> None:
        if not (0 < self.speed < math.inf and 0 < self.period < math.inf and 0 <= self.dwell < math.inf):
            raise ValueError(f"{self} is impossible; speed and period must be above zero, and dwell not below it")


def move_time(plant: Plant, start: ArrayLike, target: ArrayLike, pace: Pace) -> Array:
    """Duration of moves between joints ``(..., n)``, s, as the slowest joint asks for it."""
    way = np.abs(np.asarray(target, dtype=float) - np.asarray(start, dtype=float))
    return np.asarray(np.max(way / (plant.arm.speed * pace.speed), axis=-1))


def commands(plant: Plant, start: ArrayLike, target: ArrayLike, pace: Pace) -> Iterator[tuple[Array, Array | float]]:
    """Joint commands ``(..., n)`` of moves, each with the time it is held, s; the last one is held while waiting.

    Several moves begin together, and each takes its own time: one that has arrived earlier holds its target for no
    time at all until the longest arrives, so that it ends as it does alone.
    """
    start, target = np.asarray(start, dtype=float), np.asarray(target, dtype=float)
    duration = move_time(plant, start, target, pace)
    steps = np.ceil(duration / pace.period - 1e-9)
    for step in range(1, int(steps.max(initial=0.0)) + 1):
        left = np.clip((steps - step) * pace.period / np.maximum(duration, pace.period), 0.0, 1.0)
        time = np.where(step <= steps, pace.period, 0.0)
        yield target + (start - target) * left[..., None], time if time.ndim else pace.period
    if pace.dwell or not steps.any():
        yield np.broadcast_to(target, np.broadcast_shapes(start.shape, target.shape)), pace.dwell


def in_components(m: ModuleType, joints: Array, place: Place | None = None) -> list[Scalar]:
    """Joints ``(..., n)`` as n components: floats for ``math``, else arrays, or what ``place`` makes of them."""
    if m is math:
        return list(joints.tolist())
    columns = np.ascontiguousarray(np.moveaxis(joints, -1, 0))
    return [column if place is None else place(column) for column in columns]


def moved(
    plant: Plant,
    m: ModuleType,
    state: PlantState,
    start: ArrayLike,
    target: ArrayLike,
    pace: Pace,
    place: Place | None = None,
) -> tuple[PlantState, Frame]:
    """Move from the command ``start`` to ``target`` and wait: the state, and the true tool frame then.

    Args:
        plant: The arm, or many.
        m: ``math`` for one arm on floats, ``numpy`` or ``torch`` for many.
        state: Its state at ``start``.
        start: Joints ``(..., n)``, rad or m.
        target: Joints ``(..., n)``.
        pace: Speed, control period and waiting time.
        place: Makes components of arrays where ``m`` wants others.
    """
    *before, last = (
        (in_components(m, command, place), time if place is None or isinstance(time, float) else place(time))
        for command, time in commands(plant, start, target, pace)
    )
    for q, time in before:
        state = plant.carried(m, state, q, time)
    return plant.advance(m, state, *last)


def stopped(
    plant: Plant,
    m: ModuleType,
    state: PlantState,
    start: ArrayLike,
    target: ArrayLike,
    pace: Pace,
    normal: Array,
    place: Place | None = None,
) -> tuple[PlantState, Frame]:
    """A move whose friction is that of this one stop: without its scatter, an arm would repeat exactly.

    Args:
        plant: As for `moved`, and so are the others.
        m: The namespace.
        state: The state.
        start: Joints before.
        target: Joints after.
        pace: How it moves.
        normal: Standard normal numbers of this stop ``(2, n, ...)``: forward and backward of each joint.
        place: Makes components of arrays.
    """
    band = plant.stick_band
    if band is not None and band.scatter:
        rows = [in_components(m, np.moveaxis(row, 0, -1), place) for row in normal]
        plant = replace(plant, stick_band=one_stop(m, band, rows))
    return moved(plant, m, state, start, target, pace, place)
