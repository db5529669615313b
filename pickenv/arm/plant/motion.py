"""Point-to-point motion of the true arm: joint commands in steps of a control period, no joint above its speed.

All joints of a move start and arrive together; the arm then waits. The command is a staircase of held values, as a
controller gives it. Runs on floats (one arm) and arrays (many moves side by side). Units: s, rad or m.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.forward import Frame, Scalar
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.dynamics import PlantState
from pickenv.arm.plant.plant import Plant


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


def commands(plant: Plant, start: ArrayLike, target: ArrayLike, pace: Pace) -> Iterator[tuple[Array, float]]:
    """Joint commands ``(..., n)`` of moves, each with the time it is held, s; the last one is held while waiting.

    Of several moves the shorter ones begin later, so that all arrive, and are waited for, together.
    """
    start, target = np.asarray(start, dtype=float), np.asarray(target, dtype=float)
    duration = move_time(plant, start, target, pace)
    steps = math.ceil(float(duration.max(initial=0.0)) / pace.period - 1e-9)
    for step in range(steps - 1, 0, -1):
        left = np.clip(step * pace.period / np.maximum(duration, pace.period), 0.0, 1.0)
        yield target + (start - target) * left[..., None], pace.period
    if steps:
        yield np.broadcast_to(target, np.broadcast_shapes(start.shape, target.shape)), pace.period
    if pace.dwell:
        yield np.broadcast_to(target, np.broadcast_shapes(start.shape, target.shape)), pace.dwell


def moved(
    plant: Plant, m: ModuleType, state: PlantState, start: Sequence[Scalar], target: Sequence[Scalar], pace: Pace
) -> tuple[PlantState, Frame]:
    """Move from the command ``start`` to ``target`` and wait: the state, and the true tool frame then.

    Args:
        plant: The arm.
        m: ``math`` for one arm on floats, ``numpy`` for arrays.
        state: Its state at ``start``.
        start: n components, rad or m.
        target: n components.
        pace: Speed, control period and waiting time.
    """
    last = list(target)
    frame: Frame | None = None
    one = m is math
    for command, time in commands(plant, np.stack(np.broadcast_arrays(*start), -1), np.stack(last, -1), pace):
        q = command.tolist() if one else [command[..., i] for i in range(command.shape[-1])]
        state, frame = plant.advance(m, state, q, time)
    if frame is None:
        state, frame = plant.advance(m, state, last, 0.0)
    return state, frame
