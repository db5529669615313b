"""Joints that yield under the arm's own weight, of which only a calibration's moments are known: neither k nor masses.

A joint's torque is linear in the mass and first moments of every link behind it, so dq = c tau is linear in c g m and
c g m r: what `pickenv.calibration.model.arm_model.GravityTerm` identifies. Units: rad or m, rad/m or 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

from pickenv.arm.kinematics.forward import Chain, Frame, Scalar, frames

AXES = {"x": 0, "y": 3, "z": 6}
"""Where a link's axes begin among a frame's components."""


@dataclass(frozen=True)
class GravityYield:
    """How each joint yields.

    Attributes:
        moments: Joint that yields, link that weighs on it (both from 0), and what of it: "m" its mass at its origin,
            "x", "y", "z" a first moment along its axis.
        sizes: One number per moment: rad/m for a mass on a joint that turns, rad for a first moment.
        up: Direction against gravity in the axes of frame 0.
    """

    moments: tuple[tuple[int, int, str], ...]
    sizes: tuple[Scalar, ...]
    up: tuple[float, float, float]


def weighed_down(m: ModuleType, effect: GravityYield, chain: Chain, q: Sequence[Scalar]) -> list[Scalar]:
    """Joint displacements after the joints have yielded."""
    links = frames(m, chain, q)
    base = links[0]
    up = [sum(base[axis + i] * part for axis, part in zip((0, 3, 6), effect.up, strict=True)) for i in range(3)]
    moved = list(q)
    for (joint, link, moment), size in zip(effect.moments, effect.sizes, strict=True):
        own = links[joint + 1]
        if chain.links[joint].prismatic:
            moved[joint] = moved[joint] - size * _dot(own[6:9], up)
            continue
        lever = links[link + 1][AXES[moment] :][:3] if moment != "m" else _less(links[link + 1], own)
        moved[joint] = moved[joint] - size * _dot(own[6:9], _cross(lever, up))
    return moved


def _less(one: Frame, other: Frame) -> tuple[Scalar, ...]:
    return tuple(a - b for a, b in zip(one[9:], other[9:], strict=True))


def _dot(one: Sequence[Scalar], other: Sequence[Scalar]) -> Scalar:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _cross(one: Sequence[Scalar], other: Sequence[Scalar]) -> tuple[Scalar, ...]:
    (a, b, c), (x, y, z) = one, other
    return b * z - c * y, c * x - a * z, a * y - b * x
