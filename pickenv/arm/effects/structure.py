"""What bends, yields and turns unevenly in a real arm: one small function per effect, in components.

Every function runs on Python floats, NumPy arrays or torch tensors, like `pickenv.arm.kinematics.forward`; the
numbers of an effect may be arrays too, one entry per arm. Gravity points along -z of the world. Units: m, rad, N, kg.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Annotated, Any

from pickenv.arm.files.joint_keys import BOOM, PER_JOINT, ByJoint
from pickenv.arm.kinematics.forward import Chain, Flexure, Frame, Scalar, attach
from pickenv.toml_tables import ARCMIN, DEG, GRAVITY, KG, KG_PER_M, MM, NUMBER, WHOLE, Then, Unit, toml_table


@toml_table
class Load:
    """Masses that gravity pulls at.

    Attributes:
        mass: Mass of each link, kg.
        centre: Centre of mass of each link in the link's frame, m.
        payload: Mass held at the tool's origin, kg.
    """

    mass: Annotated[tuple[Scalar, ...], KG.not_negative, PER_JOINT]
    centre: Annotated[tuple[tuple[float, float, float], ...], MM, PER_JOINT]
    payload: Annotated[Scalar, KG.not_negative] = 0.0


@toml_table
class JointCompliance:
    """Each joint yields under its gravity torque or force: dq = tau / k.

    Attributes:
        stiffness: N*m/rad for revolute joints, N/m for prismatic ones.
    """

    stiffness: Annotated[tuple[Scalar, ...], NUMBER.positive, PER_JOINT]


@toml_table
class BoomBending:
    """A telescopic boom bends as a cantilever: delta = F L^3 / 3EI + w L^4 / 8EI, slope = F L^2 / 2EI + w L^3 / 6EI.

    Attributes:
        joint: Index (from 0) of the prismatic joint whose link is the boom; the boom lies along its z axis.
        length: Free length at zero displacement, m; the displacement adds to it.
        flexural_rigidity: EI, N*m^2.
        end_mass: Mass carried at the tip without payload, kg.
        mass_per_length: Mass of the boom, kg/m.
    """

    joint: Annotated[int, WHOLE, BOOM]
    length: Annotated[Scalar, MM.not_negative]
    flexural_rigidity: Annotated[Scalar, Unit("N_m2").positive]
    end_mass: Annotated[Scalar, KG.not_negative]
    mass_per_length: Annotated[Scalar, KG_PER_M.not_negative]


@toml_table
class RollerPlay:
    """A telescopic boom tips in its rollers: angle = clearance / overlap, and the overlap shrinks as the boom runs out.

    Attributes:
        joint: Index (from 0) of the prismatic joint whose link is the boom; the boom lies along its z axis.
        length: Free length at zero displacement, m; the displacement adds to it.
        clearance: Clearance between boom and rollers, m.
        overlap: Length inside the rollers at zero displacement, m; the displacement is taken off it.
    """

    joint: Annotated[int, WHOLE, BOOM]
    length: Annotated[Scalar, MM.not_negative]
    clearance: Annotated[Scalar, MM.not_negative]
    overlap: Annotated[Scalar, MM.positive]


Weight = tuple[Scalar, Scalar, Scalar]
"""What hangs on a link: its mass in kg, and mass times horizontal position (x, y) in the world, kg*m."""


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


@toml_table
class TransmissionError:
    """Drives that do not deliver what the motor side shows: a lead error and periodic terms.

    Attributes:
        lead: Relative lead error of each joint (m/m or rad/rad).
        harmonics: The periodic terms.
    """

    lead: Annotated[tuple[Scalar, ...], NUMBER, PER_JOINT]
    harmonics: Annotated[tuple[Harmonic, ...], Then(_harmonics, Annotated[tuple[Any, ...], HARMONICS])] = ()


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
    found = list(driven)
    for term in harmonics:
        angle = q[term.joint] * (math.tau / term.period) + term.phase
        found[term.joint] = found[term.joint] + term.amplitude * m.sin(angle)
    return found


def weights_behind(chain: Chain, frames: Sequence[Frame], load: Load) -> list[Weight]:
    """What hangs on each link: itself and all behind it; last what the tool holds.

    Args:
        chain: The chain.
        frames: Its frames from `pickenv.arm.kinematics.forward.frames`.
        load: The masses.
    """
    mass: Scalar = load.payload
    tool = attach(frames[-1], chain.tool)
    moment_x, moment_y = mass * tool[9], mass * tool[10]
    weights: list[Weight] = [(mass, moment_x, moment_y)]
    for i in reversed(range(len(chain.links))):
        xx, xy, _, yx, yy, _, zx, zy, _, px, py, _ = frames[i + 1]
        own, (cx, cy, cz) = load.mass[i], load.centre[i]
        mass = mass + own
        moment_x = moment_x + own * (px + cx * xx + cy * yx + cz * zx)
        moment_y = moment_y + own * (py + cx * xy + cy * yy + cz * zy)
        weights.append((mass, moment_x, moment_y))
    return weights[::-1]


def gravity_torques(chain: Chain, frames: Sequence[Frame], load: Load) -> list[Scalar]:
    """Generalised gravity forces on the joints: N*m for revolute, N for prismatic ones, positive along the joint.

    Args:
        chain: The chain.
        frames: Its frames from `pickenv.arm.kinematics.forward.frames`.
        load: The masses.
    """
    return weights_torques(chain, frames, weights_behind(chain, frames, load))


def weights_torques(chain: Chain, frames: Sequence[Frame], weights: Sequence[Weight]) -> list[Scalar]:
    """`gravity_torques` of what hangs on each link."""
    torques: list[Scalar] = []
    for link, frame, (mass, moment_x, moment_y) in zip(chain.links, frames[1:], weights, strict=False):
        zx, zy, zz, px, py, _ = frame[6:]
        if link.prismatic:
            torques.append(-GRAVITY * mass * zz)
        else:
            torques.append(GRAVITY * (zy * (moment_x - mass * px) - zx * (moment_y - mass * py)))
    return torques


def yielded_joints(compliance: JointCompliance, torques: Sequence[Scalar], q: Sequence[Scalar]) -> list[Scalar]:
    """Joint displacements after the joints have yielded under ``torques``."""
    return [value + torque / k for value, torque, k in zip(q, torques, compliance.stiffness, strict=True)]


def boom_flexure(boom: BoomBending, payload: Scalar, q: Sequence[Scalar]) -> Flexure:
    """A `Flexure` that lowers and tilts the boom's tip under gravity; only the part across the boom bends it."""
    length = q[boom.joint] + boom.length
    end, own, stiffness = boom.end_mass + payload, boom.mass_per_length, boom.flexural_rigidity / GRAVITY
    sag = length * length * length * (end / (3.0 * stiffness) + length * (own / (8.0 * stiffness)))
    slope = length * length * (end / (2.0 * stiffness) + length * (own / (6.0 * stiffness)))
    return lowered_tip(boom.joint, sag, slope)


def roller_flexure(play: RollerPlay, q: Sequence[Scalar]) -> Flexure:
    """A `Flexure` that lets the boom tip down in its rollers: fully when level, less as it is raised."""
    angle = play.clearance / (play.overlap - q[play.joint])
    return lowered_tip(play.joint, angle * (q[play.joint] + play.length), angle)


def lowered_tip(joint: int, sag: Scalar, slope: Scalar) -> Flexure:
    """A `Flexure` that lowers the tip of a level link ``joint`` by ``sag`` (m) and tilts it down by ``slope`` (rad)."""

    def bend(i: int, frame: Frame) -> Frame:
        if i != joint:
            return frame
        *axes, zx, zy, zz, px, py, pz = frame
        # Gravity across the boom is (zx zz, zy zz, zz^2 - 1); the slope turns z towards it, about z x (0, 0, -1).
        turned = turn_horizontally((*axes, zx, zy, zz), -slope * zy, slope * zx)
        return (*turned, px + sag * zx * zz, py + sag * zy * zz, pz + sag * (zz * zz - 1.0))

    return bend


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
