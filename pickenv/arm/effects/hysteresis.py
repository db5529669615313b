"""Joints that remember where they came from: backlash and friction, both by the play operator.

A play operator's output rests until its input has crossed the gap, then follows at the gap's edge (Krasnosel'skii and
Pokrovskii 1989). Backlash is a gap that gravity can hold closed; Coulomb friction before an elastic drive is a gap that
it cannot. Units: rad or m on the joint side, N*m or N.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType

from pickenv.arm.kinematics.backend import chosen, clipped
from pickenv.arm.kinematics.forward import Scalar


@dataclass(frozen=True)
class Backlash:
    """Lost motion in each joint's gear.

    Attributes:
        width: Whole width of each joint's gap, rad or m.
        preload: Gravity torque or force above which a joint lies against one side of its gap whichever way the motor
            turns, N*m or N; below it, friction holds the joint and the gap is crossed on every reversal.
    """

    width: tuple[Scalar, ...]
    preload: tuple[Scalar, ...]


@dataclass(frozen=True)
class StickBand:
    """Coulomb friction winds up the drive: a joint stops short of its command, on the side that it came from.

    Attributes:
        forward: How far each joint lags when it moves in the positive direction, rad or m (friction / stiffness).
        backward: The same for the negative direction.
        scatter: Standard deviation of the friction from one stop to the next, as a share of it. Time steps do not draw
            it: whoever asks how well the arm repeats does (`one_stop`).
    """

    forward: tuple[Scalar, ...]
    backward: tuple[Scalar, ...]
    scatter: Scalar = 0.0


def one_stop(m: ModuleType, band: StickBand, normal: Sequence[Sequence[Scalar]]) -> StickBand:
    """The friction of a single stop: each joint's bands, normally scattered and never below zero.

    Args:
        m: ``math``, ``numpy`` or ``torch``.
        band: The usual friction.
        normal: Standard normal numbers of the joints, forward and backward.
    """
    forward, backward = (
        tuple(width * clipped(m, 1.0 + band.scatter * z, 0.0, math.inf) for width, z in zip(widths, row, strict=True))
        for widths, row in zip((band.forward, band.backward), normal, strict=True)
    )
    return replace(band, forward=forward, backward=backward)


def play(m: ModuleType, entry: Scalar, output: Scalar, lag: Scalar, lead: Scalar) -> Scalar:
    """New output of a play operator.

    Args:
        m: ``math``, ``numpy`` or ``torch``.
        entry: New input.
        output: Output so far.
        lag: How far the output may stay behind the input.
        lead: How far it may stay ahead.
    """
    return clipped(m, output, entry - lag, entry + lead)


def joints_behind_friction(
    m: ModuleType, band: StickBand, entries: Sequence[Scalar], outputs: Sequence[Scalar]
) -> list[Scalar]:
    """Joint displacements behind the friction, given the driven displacements and where the joints were."""
    numbers = zip(entries, outputs, band.forward, band.backward, strict=True)
    return [play(m, entry, output, forward, backward) for entry, output, forward, backward in numbers]


def joints_amid_friction(band: StickBand, entries: Sequence[Scalar]) -> list[Scalar]:
    """The history-free displacement: the middle of the band."""
    numbers = zip(entries, band.forward, band.backward, strict=True)
    return [entry + 0.5 * (backward - forward) for entry, forward, backward in numbers]


def joints_behind_backlash(
    m: ModuleType,
    backlash: Backlash,
    torques: Sequence[Scalar] | None,
    entries: Sequence[Scalar],
    outputs: Sequence[Scalar],
) -> list[Scalar]:
    """Joint displacements behind the gaps, given the displacements before them and where the joints were.

    Args:
        m: ``math``, ``numpy`` or ``torch``.
        backlash: The gaps.
        torques: Gravity torques on the joints, or None where nothing has mass.
        entries: Displacements on the motor's side of the gap.
        outputs: Displacements behind the gap so far. History-free ones are got by passing ``entries``.
    """
    behind = []
    for i, (entry, output, width, preload) in enumerate(
        zip(entries, outputs, backlash.width, backlash.preload, strict=True)
    ):
        half = 0.5 * width
        low, high = entry - half, entry + half
        free = clipped(m, output, low, high)
        if torques is not None:
            free = chosen(m, torques[i] > preload, high, chosen(m, torques[i] < -preload, low, free))
        behind.append(free)
    return behind
