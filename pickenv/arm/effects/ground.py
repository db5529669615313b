"""The ground under the machine gives way: it tilts at once with the reach moment, and goes on sinking for hours.

Tilt = moment / stiffness, at once; then creep towards a multiple of it and a settlement of the whole machine, both with
one time constant (a Kelvin-Voigt body). Gravity points along -z of the world. Units: m, rad, N*m, s, kg.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Annotated

from pickenv.arm.effects.structure import Weight, turn_horizontally
from pickenv.arm.kinematics.backend import exponential
from pickenv.arm.kinematics.forward import Frame, Scalar
from pickenv.toml_tables import GRAVITY, HOURS, MM, NUMBER, Unit, toml_table


@toml_table
class BaseTilt:
    """Tilt and sinkage of the machine that carries the arm.

    Attributes:
        stiffness: Tilt stiffness of the ground contact about the world's x and y axes, N*m/rad.
        pivot: Point in the world about which the machine tilts, m.
        creep: Tilt that a held moment adds in the long run, as a multiple of the immediate tilt.
        settlement: How far the machine sinks in the long run under its own weight, m.
        time_constant: Time constant of creep and settlement, s.
    """

    stiffness: Annotated[tuple[Scalar, Scalar], Unit("N_m_per_rad").positive]
    pivot: Annotated[tuple[float, float, float], MM]
    creep: Annotated[Scalar, NUMBER.not_negative]
    settlement: Annotated[Scalar, MM.not_negative]
    time_constant: Annotated[Scalar, HOURS.positive]


def immediate_tilt(tilt: BaseTilt, weights: Sequence[Weight]) -> tuple[Scalar, Scalar]:
    """Rotation vector (x, y) in rad by which the reach moment tilts the machine at once.

    Args:
        tilt: The ground.
        weights: What hangs on each link, from `pickenv.arm.effects.structure.weights_behind`.
    """
    x0, y0, _ = tilt.pivot
    mass, moment_x, moment_y = weights[0]
    about_x, about_y = tilt.stiffness
    return -GRAVITY * (moment_y - mass * y0) / about_x, GRAVITY * (moment_x - mass * x0) / about_y


def sunk(
    m: ModuleType, tilt: BaseTilt, sinkage: Sequence[Scalar], immediate: tuple[Scalar, Scalar], dt: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Creep (x, y) in rad and settlement in m after the immediate tilt has lasted for ``dt`` seconds."""
    creep_x, creep_y, settlement = sinkage
    faded = exponential(m, -dt / tilt.time_constant)
    final_x, final_y, final = long_run(tilt, immediate)
    return (
        final_x + (creep_x - final_x) * faded,
        final_y + (creep_y - final_y) * faded,
        final + (settlement - final) * faded,
    )


def long_run(tilt: BaseTilt, immediate: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar, Scalar]:
    """Creep (x, y) in rad and settlement in m after a very long time."""
    return tilt.creep * immediate[0], tilt.creep * immediate[1], tilt.settlement


def tilted_frame(tilt: BaseTilt, immediate: tuple[Scalar, Scalar], sinkage: Sequence[Scalar], frame: Frame) -> Frame:
    """A frame of the world carried along by tilt, creep and settlement of the machine."""
    creep_x, creep_y, settlement = sinkage
    x0, y0, z0 = tilt.pivot
    *axes, px, py, pz = frame
    vectors = (*axes, px - x0, py - y0, pz - z0)
    turned = turn_horizontally(vectors, immediate[0] + creep_x, immediate[1] + creep_y, starts=(0, 3, 6, 9))
    return (*turned[:9], turned[9] + x0, turned[10] + y0, turned[11] + z0 - settlement)
