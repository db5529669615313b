"""Effects of motors, temperature, gravity and instruments: counts, lag, growth, deflection, noise. Units: rad, m, s."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import ModuleType
from typing import Annotated, Any

from pickenv.arm.effects.effect import BESIDE, JOINT, MOTOR, Components, Draws, Effect, Passage, joint_table
from pickenv.arm.files.arm import PER_JOINT
from pickenv.arm.kinematics.forward import Frame, Scalar, Scalars, exponential, frames, nearest_whole
from pickenv.arm.kinematics.task_space import displaced_frame
from pickenv.base import ARCSEC, DEG, HOURS, KELVIN, MILLISECONDS, MM, UM, InputError, Unit, register, toml_table


def _encoder(resolution: tuple[float, ...]) -> Encoder:
    if 0.0 in resolution:
        raise InputError(f"joints of [encoder] does not name joint {resolution.index(0.0) + 1}; give each joint")
    return Encoder(resolution)


@register("effect", "encoder")
@dataclass(frozen=True)
class Encoder(Effect, place=MOTOR):
    """Motor encoders of finite resolution: motor positions are multiples of one encoder count.

    Attributes:
        resolution: Motion of each joint per encoder count (n,), rad or m.
    """

    table = joint_table(_encoder, resolution=(ARCSEC.positive, UM.positive))

    resolution: tuple[Scalar, ...]

    def act(self, at: Passage, memory: Components) -> None:
        """Round the motor positions of the passage ``at``, in place, to encoder counts; ``memory`` is not used."""
        pairs = zip(at.motor, self.resolution, strict=True)
        at.turn([nearest_whole(at.m, value / count) * count for value, count in pairs])


@register("effect", "servo")
@toml_table
class Servo(Effect, place=MOTOR + 0.5):
    """Position loops with a following error proportional to speed: x' = (command - x) / time constant.

    Attributes:
        time_constant: Time constant of each joint's position loop (n,), s: one over the position gain.
    """

    time_constant: Annotated[tuple[Scalar, ...], MILLISECONDS.positive, PER_JOINT]

    def act(self, at: Passage, memory: Components) -> None:
        """Set the motors of the passage ``at``, in place, to the positions in ``memory``."""
        at.turn(memory)

    def begin(self, at: Passage) -> Components:
        """Return the memory at rest: the motor positions, rad or m, which equal the joint command."""
        return tuple(at.motor)

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """Return the motor positions after ``dt`` seconds, in which the command of ``at`` is held.

        ``memory`` has the motor positions before.
        """
        numbers = zip(memory, at.motor, self.time_constant, strict=True)
        return tuple([target + (value - target) * exponential(at.m, -dt / slow) for value, target, slow in numbers])


# Links grow with temperature, L (1 + alpha dT), and the arm warms up over the first hours: dT' = (final - dT) / tau.
# dT is the rise above the temperature at which the true geometry holds. Units: K, s.


@register("effect", "thermal_growth")
@toml_table
class ThermalGrowth(Effect, place=JOINT + 0.6, spreads={"time_constant": "warm_up_time"}):
    """Growth of each link with the arm's temperature.

    Attributes:
        expansion: Coefficient of linear expansion alpha of each link (n,), 1/K.
        initial_rise: Temperature rise of the arm when it is switched on, K. A rise is counted from the temperature at
            which the geometry was measured.
        final_rise: Temperature rise of the warm arm, K.
        time_constant: Time constant of the warm-up, s.
    """

    expansion: Annotated[tuple[Scalar, ...], Unit("um_per_m_K", 1e-6).not_negative, PER_JOINT]
    initial_rise: Annotated[Scalar, KELVIN]
    final_rise: Annotated[Scalar, KELVIN]
    time_constant: Annotated[Scalar, HOURS.positive]

    def act(self, at: Passage, memory: Components) -> None:
        """Apply the temperature rise dT in ``memory`` to the links of the passage ``at``, in place.

        The lengths a and d of every link are multiplied by 1 + alpha dT. So is the displacement of every slide, because
        its rack grows too. Angles do not change.
        """
        factors = [1.0 + alpha * memory[0] for alpha in self.expansion]
        pairs = zip(at.chain.links, factors, strict=True)
        links = [link._replace(a=link.a * factor, d=link.d * factor) for link, factor in pairs]
        at.chain = at.chain._replace(links=tuple(links))
        numbers = zip(links, at.joints, factors, strict=True)
        at.joints = [value * factor if link.prismatic else value for link, value, factor in numbers]

    def begin(self, at: Passage) -> Components:
        """Return the memory when the arm is switched on: the temperature rise, K."""
        return (at.command[0] * 0.0 + self.initial_rise,)

    def rest(self, at: Passage) -> Components:
        """Return the memory of the warm arm: the temperature rise, K."""
        return (self.final_rise,)

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """Return the temperature rise, K, after a time ``dt``, s; ``memory`` has the temperature rise before."""
        return (warmed(at.m, self, memory[0], dt),)

    def drawn(self, draws: Draws) -> ThermalGrowth:
        """Return the effect of many arms, with final temperature rises uniform in the tolerance class's range."""
        low, high = draws.temperature_rise
        return replace(super().drawn(draws), final_rise=low + (high - low) * draws.even["temperature_rise"][:, 0])


def warmed(m: ModuleType, thermal: ThermalGrowth, rise: Scalar, dt: Scalar) -> Scalar:
    """Return the temperature rise, K, after the arm has warmed up for a further time ``dt``.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        thermal: The effect, which has the final temperature rise and the time constant.
        rise: Temperature rise before, K.
        dt: Time, s.
    """
    return thermal.final_rise + (rise - thermal.final_rise) * exponential(m, -dt / thermal.time_constant)


# Joints that yield under the arm's own weight, of which only a calibration's moments are known: neither k nor masses.
# A joint's torque is linear in the mass and first moments of every link behind it, so dq = c tau is linear in c g m
# and c g m r: what `pickenv.calibration.model.arm_model.GravityTerm` identifies. Units: rad or m, rad/m or 1.


START = {"x": 0, "y": 3, "z": 6, "m": 9}
"""Index of the first component of each axis ("x", "y", "z") and of the origin ("m") in a link's `Frame`."""


@register("effect", "gravity_yield")
@dataclass(frozen=True)
class GravityYield(Effect, place=JOINT + 0.2):
    """Deflection of joints under gravity, with coefficients that a calibration identified.

    Attributes:
        moments: Three entries for each term. The first is the index (from 0) of the joint that yields. The second is
            the index (from 0) of the link whose weight loads the joint. The third is a mass parameter of this link. "m"
            is the link's mass, placed at its origin. "x", "y" and "z" are the link's first moments of mass along the
            axes of its frame.
        sizes: Coefficient of each term. Its unit on a revolute joint is rad/m for a mass, rad for a first moment. Its
            unit on a prismatic joint is m.
        up: Direction against gravity in the axes of frame 0.
    """

    moments: tuple[tuple[int, int, str], ...]
    sizes: tuple[Scalar, ...]
    up: tuple[float, float, float]

    def act(self, at: Passage, memory: Components) -> None:
        """Subtract the deflections from the joint positions of the passage ``at``, in place; ``memory`` is not used."""
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
    """Normally distributed errors of a measuring instrument.

    Attributes:
        position_std: Standard deviation of a measured position at zero range, m, per axis. The range is the distance
            from the instrument.
        attitude_std: Standard deviation of a measured attitude, rad, per axis.
        range_std: Increase of the position's standard deviation per metre of range, m/m, per axis.
        centring_std: Standard deviation of the offset of the target's centre from the tool point, m, per axis. The
            offset is constant as long as the target is mounted.
    """

    position_std: Annotated[float, MM.not_negative]
    attitude_std: Annotated[float, DEG.not_negative]
    range_std: Annotated[float, Unit("um_per_m", 1e-6, most=1e6).not_negative] = 0.0
    centring_std: Annotated[float, MM.not_negative] = 0.0

    def position_std_at(self, distance: Any) -> Any:
        """Return the standard deviation per axis, m, of a position measured at ``distance``, m, from the instrument."""
        return self.position_std + self.range_std * distance


def read_frame(
    m: ModuleType,
    noise: MeasurementNoise,
    stand: tuple[float, float, float],
    frame: Frame,
    reading: Scalars,
    mounting: Scalars,
) -> Frame:
    """Compute the tool frame that an instrument reports.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        noise: The instrument's errors.
        stand: Position of the instrument in the arm's world frame, m.
        frame: The true tool frame in the arm's world frame, twelve components.
        reading: Standard normal numbers of this reading, six components: three for position, three for attitude.
        mounting: Standard normal numbers of the target's mounting, three components.
    """
    aside = [noise.centring_std * value for value in mounting]
    axes = zip(frame[0:3], frame[3:6], frame[6:9], frame[9:], strict=True)
    frame = (*frame[:9], *(aside[0] * x + aside[1] * y + aside[2] * z + p for x, y, z, p in axes))
    x, y, z = (a - b for a, b in zip(frame[9:], stand, strict=True))
    std = noise.position_std_at(m.sqrt(x * x + y * y + z * z))
    scales = (std,) * 3 + (noise.attitude_std,) * 3
    return displaced_frame(m, frame, [scale * value for scale, value in zip(scales, reading, strict=True)])
