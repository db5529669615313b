"""What bends, yields and turns unevenly in a real arm. Units: m, rad, N, kg."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Annotated, Any

from pickenv.arm.effects.effect import BEND, DRIVE, JOINT, Components, Draws, Effect, Passage
from pickenv.arm.files.arm import Arm
from pickenv.arm.files.joint_keys import BOOM, PER_JOINT, ByJoint
from pickenv.arm.kinematics.forward import Flexure, Frame, Scalar
from pickenv.base import ARCMIN, DEG, GRAVITY, KG, KG_PER_M, MM, NUMBER, WHOLE, Then, Unit, register, toml_table


@register("effect", "joint_compliance")
@toml_table
class JointCompliance(Effect, place=JOINT, spreads={"stiffness": "joint_stiffness"}, needs_load=True):
    """Each joint yields under its gravity torque or force: dq = tau / k.

    Attributes:
        stiffness: N*m/rad for revolute joints, N/m for prismatic ones.
    """

    stiffness: Annotated[tuple[Scalar, ...], NUMBER.positive, PER_JOINT]

    def act(self, at: Passage, memory: Components) -> None:
        """Let the joints yield."""
        numbers = zip(at.joints, at.loads.torques, self.stiffness, strict=True)
        at.joints = [value + torque / k for value, torque, k in numbers]


@toml_table
class Boom(Effect, place=BEND):
    """What a telescopic boom does to its tip: base of effects that say how in ``bent``.

    Attributes:
        joint: Index (from 0) of the prismatic joint whose link is the boom; the boom lies along its z axis.
        length: Free length at zero displacement, m; the displacement adds to it.
    """

    joint: Annotated[int, WHOLE, BOOM]
    length: Annotated[Scalar, MM.not_negative]

    def flexure(self, at: Passage) -> Flexure:
        """Bend the boom, and no other link."""
        length = at.joints[self.joint] + self.length
        return lambda i, frame: self.bent(at, frame, length) if i == self.joint else frame

    def bent(self, at: Passage, frame: Frame, length: Scalar) -> Frame:
        """The frame of the tip, of a boom that is ``length`` metres long, once bent."""
        raise NotImplementedError


@register("effect", "boom_bending")
@toml_table
class BoomBending(Boom, place=BEND + 0.2, spreads={"flexural_rigidity": "flexural_rigidity"}):
    """A telescopic boom bends as a cantilever: delta = F L^3 / 3EI + w L^4 / 8EI, slope = F L^2 / 2EI + w L^3 / 6EI.

    Attributes:
        flexural_rigidity: EI, N*m^2.
        end_mass: Mass carried at the tip without payload, kg.
        mass_per_length: Mass of the boom, kg/m.
    """

    flexural_rigidity: Annotated[Scalar, Unit("N_m2").positive]
    end_mass: Annotated[Scalar, KG.not_negative]
    mass_per_length: Annotated[Scalar, KG_PER_M.not_negative]

    def bent(self, at: Passage, frame: Frame, length: Scalar) -> Frame:
        """Lower and tilt the boom's tip under gravity; only the part across the boom bends it."""
        end, boom = self.end_mass + (at.load.payload if at.load else 0.0), self.mass_per_length
        stiffness = self.flexural_rigidity / GRAVITY
        sag = length * length * length * (end / (3.0 * stiffness) + length * (boom / (8.0 * stiffness)))
        slope = length * length * (end / (2.0 * stiffness) + length * (boom / (6.0 * stiffness)))
        return lowered_tip(frame, sag, slope)


@register("effect", "roller_play")
@toml_table
class RollerPlay(Boom, place=BEND + 0.8, spreads={"clearance": "roller_clearance"}):
    """A telescopic boom tips in its rollers: angle = clearance / overlap, and the overlap shrinks as the boom runs out.

    Attributes:
        clearance: Clearance between boom and rollers, m.
        overlap: Length inside the rollers at zero displacement, m; the displacement is taken off it.
    """

    clearance: Annotated[Scalar, MM.not_negative]
    overlap: Annotated[Scalar, MM.positive]

    def bent(self, at: Passage, frame: Frame, length: Scalar) -> Frame:
        """Let the boom tip down in its rollers: fully when level, less as it is raised."""
        angle = self.clearance / (self.overlap - at.joints[self.joint])
        return lowered_tip(frame, angle * length, angle)

    def fault(self, arm: Arm) -> str:
        """An overlap that the boom runs out of."""
        limit = arm.nominal.upper[self.joint]
        if self.overlap > limit:
            return ""
        return (
            f"overlap_mm of [roller_play] is {self.overlap * 1e3:g}; give more than the {limit * 1e3:g} mm that joint "
            f"{self.joint + 1} runs out"
        )


@dataclass(frozen=True)
class Harmonic:
    """One periodic term of a drive's error, A sin(2 pi q / period + phase).

    Attributes:
        joint: Index of the joint (from 0).
        amplitude: rad or m.
        period: rad or m.
        phase: rad.
    """

    joint: int
    amplitude: Scalar
    period: Scalar
    phase: Scalar


HARMONICS = ByJoint(
    amplitude=(ARCMIN.not_negative, MM.not_negative), period=(DEG.positive, MM.positive), phase=(DEG, DEG)
)


@register("effect", "transmission_error")
@toml_table
class TransmissionError(Effect, place=DRIVE):
    """Drives that do not deliver what the motor side shows: a lead error and periodic terms.

    Attributes:
        lead: Relative lead error of each joint (m/m or rad/rad).
        harmonics: The periodic terms.
    """

    lead: Annotated[tuple[Scalar, ...], NUMBER, PER_JOINT]
    harmonics: Annotated[tuple[Harmonic, ...], Then(_harmonics, Annotated[tuple[Any, ...], HARMONICS])] = ()

    def act(self, at: Passage, memory: Components) -> None:
        """Drive the joints unevenly."""
        at.drive(driven_joints(at.m, self, at.driven))

    def drawn(self, draws: Draws) -> TransmissionError:
        """Drives whose leads and amplitudes spread; phases are anything: no two gears are alike."""
        amplitudes = draws.scaled([term.amplitude for term in self.harmonics], self.name)
        phases = 2.0 * math.pi * draws.even["phase"]
        terms = zip(self.harmonics, amplitudes, phases.T, strict=True)
        return TransmissionError(
            draws.scaled(self.lead, "lead", spread=self.name),
            tuple(replace(term, amplitude=amplitude, phase=phase) for term, amplitude, phase in terms),
        )


def _harmonics(entries: Any, _context: Any) -> tuple[Harmonic, ...]:
    return tuple(Harmonic(entry.joint, entry.amplitude, entry.period, entry.phase) for entry in entries)


def driven_joints(m: ModuleType, error: TransmissionError, q: Sequence[Scalar]) -> list[Scalar]:
    """Joint displacements behind the drives for commanded displacements ``q``."""
    driven = [
        value if isinstance(lead, float) and not lead else value * (1.0 + lead)
        for value, lead in zip(q, error.lead, strict=True)
    ]
    return with_waves(m, error.harmonics, q, driven)


def with_waves(
    m: ModuleType, harmonics: Sequence[Harmonic], q: Sequence[Scalar], driven: Sequence[Scalar]
) -> list[Scalar]:
    """Joint displacements ``driven`` with the periodic errors at the motor positions ``q`` on top."""
    joints = list(driven)
    for term in harmonics:
        angle = q[term.joint] * (math.tau / term.period) + term.phase
        joints[term.joint] = joints[term.joint] + term.amplitude * m.sin(angle)
    return joints


def lowered_tip(frame: Frame, sag: Scalar, slope: Scalar) -> Frame:
    """The frame of a link's tip, lowered where the link is level by ``sag`` (m) and tilted down by ``slope`` (rad)."""
    *axes, zx, zy, zz, px, py, pz = frame
    # Gravity across the boom is (zx zz, zy zz, zz^2 - 1); the slope turns z towards it, about z x (0, 0, -1).
    turned = turn_horizontally((*axes, zx, zy, zz), -slope * zy, slope * zx)
    return (*turned, px + sag * zx * zz, py + sag * zy * zz, pz + sag * (zz * zz - 1.0))


def turn_horizontally(
    axes: Sequence[Scalar], wx: Scalar, wy: Scalar, starts: Sequence[int] = (0, 3, 6)
) -> list[Scalar]:
    """Turn vectors, at ``starts`` in ``axes``, by the small horizontal rotation vector (wx, wy, 0): Rodrigues' formula.

    Its two coefficients are taken as series, so that no division is needed at zero; below 0.03 rad they are exact to
    double precision.
    """
    square = wx * wx + wy * wy
    first = 1.0 - square * (1.0 / 6.0 - square / 120.0)
    second = 0.5 - square * (1.0 / 24.0 - square / 720.0)
    turned: list[Scalar] = []
    for j in starts:
        x, y, z = axes[j : j + 3]
        along = wx * x + wy * y
        turned.append(x + first * wy * z + second * (wx * along - square * x))
        turned.append(y - first * wx * z + second * (wy * along - square * y))
        turned.append(z + first * (wx * y - wy * x) - second * square * z)
    return turned
