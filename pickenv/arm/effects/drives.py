"""Effects of the motors, of temperature and of instruments: encoder counts, lag, thermal growth, noise; rad, m, s."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Annotated, Any

from pickenv.arm.effects.effect import BESIDE, JOINT, MOTOR, Components, Draws, Effect, Passage
from pickenv.arm.files.joint_keys import PER_JOINT, joint_table
from pickenv.arm.kinematics.backend import exponential, nearest_whole
from pickenv.arm.kinematics.forward import Frame, Scalar, frames
from pickenv.arm.kinematics.pose_error import displaced_frame
from pickenv.base import ARCSEC, DEG, HOURS, KELVIN, MILLISECONDS, MM, UM, InputError, Unit, register, toml_table


def _encoder(resolution: tuple[float, ...]) -> Encoder:
    if 0.0 in resolution:
        raise InputError(f"joints of [encoder] does not name joint {resolution.index(0.0) + 1}; give each joint")
    return Encoder(resolution)


@register("effect", "encoder")
@dataclass(frozen=True)
class Encoder(Effect, place=MOTOR):
    """Motor encoders of finite resolution: a drive can hold, and report, whole counts only.

    Attributes:
        resolution: Size of one encoder count of each joint, measured at the joint, rad or m.
    """

    table = joint_table(_encoder, resolution=(ARCSEC.positive, UM.positive))

    resolution: tuple[Scalar, ...]

    def act(self, at: Passage, memory: Components) -> None:
        """Round the motor positions to whole encoder counts."""
        pairs = zip(at.motor, self.resolution, strict=True)
        at.turn([nearest_whole(at.m, value / count) * count for value, count in pairs])


@register("effect", "servo")
@toml_table
class Servo(Effect, place=MOTOR + 0.5):
    """Position loops that follow with an error proportional to speed: x' = (command - x) / time constant.

    Attributes:
        time_constant: Time constant of each joint's position loop, s (one over the position gain).
    """

    time_constant: Annotated[tuple[Scalar, ...], MILLISECONDS.positive, PER_JOINT]

    def act(self, at: Passage, memory: Components) -> None:
        """Put the motors at the memory's positions, which they have reached by now."""
        at.turn(memory)

    def begin(self, at: Passage) -> Components:
        """The motor positions at rest: the motors have arrived at the command."""
        return tuple(at.motor)

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """The motor positions after ``dt`` seconds on the way to the command."""
        numbers = zip(memory, at.motor, self.time_constant, strict=True)
        return tuple([target + (value - target) * exponential(at.m, -dt / slow) for value, target, slow in numbers])


# Links grow with temperature, L (1 + alpha dT), and the arm warms up over the first hours: dT' = (final - dT) / tau.
# dT is the rise above the temperature at which the true geometry holds. Units: K, s.


@register("effect", "thermal_growth")
@toml_table
class ThermalGrowth(Effect, place=JOINT + 0.6, spreads={"time_constant": "warm_up_time"}):
    """Growth of each link with the arm's temperature.

    Attributes:
        expansion: Coefficient of linear expansion alpha of each link, 1/K.
        initial_rise: Temperature rise when the arm is switched on, K.
        final_rise: Temperature rise of the warm arm, K.
        time_constant: Time constant of the warm-up, s.
    """

    expansion: Annotated[tuple[Scalar, ...], Unit("um_per_m_K", 1e-6).not_negative, PER_JOINT]
    initial_rise: Annotated[Scalar, KELVIN]
    final_rise: Annotated[Scalar, KELVIN]
    time_constant: Annotated[Scalar, HOURS.positive]

    def act(self, at: Passage, memory: Components) -> None:
        """Let a and d of every link grow, and the displacement of every slide, as its rack grows too; angles stay."""
        factors = [1.0 + alpha * memory[0] for alpha in self.expansion]
        pairs = zip(at.chain.links, factors, strict=True)
        links = [link._replace(a=link.a * factor, d=link.d * factor) for link, factor in pairs]
        at.chain = at.chain._replace(links=tuple(links))
        numbers = zip(links, at.joints, factors, strict=True)
        at.joints = [value * factor if link.prismatic else value for link, value, factor in numbers]

    def begin(self, at: Passage) -> Components:
        """The temperature rise when the arm is switched on, K."""
        return (at.command[0] * 0.0 + self.initial_rise,)

    def rest(self, at: Passage) -> Components:
        """The temperature rise of the warm arm, K."""
        return (self.final_rise,)

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """The temperature rise after ``dt`` seconds, K."""
        return (warmed(at.m, self, memory[0], dt),)

    def drawn(self, draws: Draws) -> ThermalGrowth:
        """The effect of many arms; each final temperature rise is drawn from the tolerance class's range."""
        low, high = draws.temperature_rise
        return replace(super().drawn(draws), final_rise=low + (high - low) * draws.even["temperature_rise"][:, 0])


def warmed(m: ModuleType, thermal: ThermalGrowth, rise: Scalar, dt: Scalar) -> Scalar:
    """Temperature rise in K, ``dt`` seconds after it was ``rise``."""
    return thermal.final_rise + (rise - thermal.final_rise) * exponential(m, -dt / thermal.time_constant)


# Joints that yield under the arm's own weight, of which only a calibration's moments are known: neither k nor masses.
# A joint's torque is linear in the mass and first moments of every link behind it, so dq = c tau is linear in c g m
# and c g m r: what `pickenv.calibration.model.arm_model.GravityTerm` identifies. Units: rad or m, rad/m or 1.


START = {"x": 0, "y": 3, "z": 6, "m": 9}
"""Where each of a link's axes, and its origin, begins among the twelve components of its frame."""


@register("effect", "gravity_yield")
@dataclass(frozen=True)
class GravityYield(Effect, place=JOINT + 0.2):
    """Joints that yield under gravity moments whose sizes a calibration found.

    Attributes:
        moments: For each moment: the joint that yields, the link that weighs on it (both from 0), and what of the link
            weighs: "m" its mass, at its origin; "x", "y" or "z" its first moment along that axis of its own.
        sizes: One number per moment: rad/m for a mass on a joint that turns, rad for a first moment.
        up: Direction against gravity in the axes of frame 0.
    """

    moments: tuple[tuple[int, int, str], ...]
    sizes: tuple[Scalar, ...]
    up: tuple[float, float, float]

    def act(self, at: Passage, memory: Components) -> None:
        """Let the joints yield."""
        links = frames(at.m, at.cold, at.joints)
        base, joints = links[0], list(at.joints)
        up = [sum(base[axis + i] * part for axis, part in zip((0, 3, 6), self.up, strict=True)) for i in range(3)]
        for (joint, link, moment), size in zip(self.moments, self.sizes, strict=True):
            x, y, z = up
            if not at.cold.links[joint].prismatic:
                a, b, c = links[link + 1][START[moment] :][:3]
                if moment == "m":
                    a, b, c = (end - start for end, start in zip((a, b, c), links[joint + 1][9:], strict=True))
                x, y, z = b * z - c * y, c * x - a * z, a * y - b * x  # the lever crossed with what is upwards
            zx, zy, zz = links[joint + 1][6:9]
            joints[joint] = joints[joint] - size * (zx * x + zy * y + zz * z)
        at.joints = joints


# How an instrument that looks at a target on the tool errs: reading by reading, with the range, and by its mounting.
# Every number is used as a standard deviation, makers' limits too. Runs on floats, arrays and tensors. Units: m, rad.


@register("effect", "measurement_noise")
@toml_table
class MeasurementNoise(Effect, place=BESIDE):
    """Normally distributed errors of a measuring instrument, per axis.

    Attributes:
        position_std: Standard deviation of a position at zero range, m.
        attitude_std: Standard deviation of an attitude, rad.
        range_std: What each metre of range adds to the standard deviation of a position, m/m.
        centring_std: How far the target's centre lies beside the point that is meant, m; it stays as long as the
            target is mounted.
    """

    position_std: Annotated[float, MM.not_negative]
    attitude_std: Annotated[float, DEG.not_negative]
    range_std: Annotated[float, Unit("um_per_m", 1e-6, most=1e6).not_negative] = 0.0
    centring_std: Annotated[float, MM.not_negative] = 0.0

    def position_std_at(self, distance: Any) -> Any:
        """Standard deviation per axis of a position seen from ``distance`` metres, m."""
        return self.position_std + self.range_std * distance


def read_frame(
    m: ModuleType,
    noise: MeasurementNoise,
    stand: tuple[float, float, float],
    frame: Frame,
    reading: Sequence[Scalar],
    mounting: Sequence[Scalar],
) -> Frame:
    """The tool frame that an instrument reports.

    Args:
        m: ``math``, ``numpy`` or ``torch``.
        noise: The instrument's errors.
        stand: Where the instrument stands, in the frame's world, m.
        frame: The true tool frame.
        reading: Six standard normal numbers for each reading.
        mounting: Three standard normal numbers for the mounting of the target.
    """
    if noise.centring_std:
        aside = [noise.centring_std * value for value in mounting]
        axes = zip(frame[0:3], frame[3:6], frame[6:9], frame[9:], strict=True)
        frame = (*frame[:9], *(aside[0] * x + aside[1] * y + aside[2] * z + p for x, y, z, p in axes))
    std: Any = noise.position_std
    if noise.range_std:
        x, y, z = (a - b for a, b in zip(frame[9:], stand, strict=True))
        std = noise.position_std_at(m.sqrt(x * x + y * y + z * z))
    scales = (std,) * 3 + (noise.attitude_std,) * 3
    return displaced_frame(m, frame, [scale * value for scale, value in zip(scales, reading, strict=True)])
