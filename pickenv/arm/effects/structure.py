"""Effects of mechanical parts: compliance, bending, play, drive errors, backlash, friction. Units: m, rad, N, kg."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Annotated, Any

from pickenv.arm.effects.effect import (
    BEND,
    BOOM,
    DRIVE,
    GEAR,
    JOINT,
    LENGTH,
    TRAVEL,
    ByJoint,
    Components,
    Draws,
    Effect,
    Passage,
    Weight,
    joint_table,
)
from pickenv.arm.files.arm import PER_JOINT, Arm
from pickenv.arm.kinematics.forward import Flexure, Frame, Scalar, Scalars, chosen, clipped
from pickenv.arm.kinematics.task_space import displaced_frame
from pickenv.base import GRAVITY, register, toml_tables


@register("effect", "joint_compliance")
@toml_tables.toml_table
class JointCompliance(Effect, place=JOINT, spreads={"stiffness": "joint_stiffness"}, needs_load=True):
    """Deflection of each joint under its gravity torque or force: dq = tau / k.

    Attributes:
        stiffness: Stiffness k of each joint (n,), N*m/rad for revolute joints, N/m for prismatic joints.
    """

    stiffness: Annotated[tuple[Scalar, ...], toml_tables.NUMBER.positive, PER_JOINT]

    def act(self, at: Passage, memory: Components) -> None:
        """Add the deflections to the joint positions of the passage ``at``, in place; ``memory`` is not used."""
        at.joints = [value + torque / k for value, torque, k in zip(at.joints, at.pull[1], self.stiffness, strict=True)]


@toml_tables.toml_table
class Boom(Effect, place=BEND):
    """Base class of effects that move the tip of a telescopic boom; each subclass defines `bent`.

    Attributes:
        joint: Index (from 0) of the prismatic joint whose link is the boom; the boom lies along the link's z axis.
        length: Free length at zero displacement, m; the joint's displacement adds to it.
    """

    joint: Annotated[int, toml_tables.WHOLE, BOOM]
    length: Annotated[Scalar, toml_tables.MM.not_negative]

    def flexure(self, at: Passage) -> Flexure:
        """Return a function that bends the frame of the boom's link and leaves other links unchanged."""
        length = at.joints[self.joint] + self.length
        return lambda i, frame: self.bent(at, frame, length) if i == self.joint else frame

    def fault(self, arm: Arm) -> str:
        """Return an error message if the boom of ``arm`` can have a free length below zero, else an empty string."""
        short = -arm.nominal.lower[self.joint]
        if self.length >= short - 1e-9:
            return ""
        length = f"length_mm of [{self.name}] is {self.length * 1e3:g}"
        return f"{length}; give at least the {short * 1e3:g} mm that joint {self.joint + 1} runs in"

    def bent(self, at: Passage, frame: Frame, length: Scalar) -> Frame:
        """Return the frame of the boom's tip after bending.

        Args:
            at: The command's passage.
            frame: Frame of the tip before bending, world axes.
            length: Free length of the boom, m.
        """
        raise NotImplementedError


@register("effect", "boom_bending")
@toml_tables.toml_table
class BoomBending(Boom, place=BEND + 0.2, spreads={"flexural_rigidity": "flexural_rigidity"}):
    """Bending of a telescopic boom as a cantilever.

    The deflection is delta = F L^3 / 3EI + w L^4 / 8EI, the slope F L^2 / 2EI + w L^3 / 6EI. F is the weight at the
    tip, w the boom's weight per length, and L its free length.

    Attributes:
        flexural_rigidity: Flexural rigidity EI, N*m^2.
        end_mass: Mass at the tip without payload, kg.
        mass_per_length: Mass of the boom, kg/m.
    """

    flexural_rigidity: Annotated[Scalar, toml_tables.Unit("N_m2").positive]
    end_mass: Annotated[Scalar, toml_tables.KG.not_negative]
    mass_per_length: Annotated[Scalar, toml_tables.KG_PER_M.not_negative]

    def bent(self, at: Passage, frame: Frame, length: Scalar) -> Frame:
        """Return the frame of the boom's tip, lowered and tilted by the component of gravity across the boom.

        Arguments as in `Boom.bent`.
        """
        end, boom = self.end_mass + (at.load.payload if at.load else 0.0), self.mass_per_length
        stiffness = self.flexural_rigidity / GRAVITY
        sag = length * length * length * (end / (3.0 * stiffness) + length * (boom / (8.0 * stiffness)))
        slope = length * length * (end / (2.0 * stiffness) + length * (boom / (6.0 * stiffness)))
        return lowered_tip(frame, sag, slope)


@register("effect", "roller_play")
@toml_tables.toml_table
class RollerPlay(Boom, place=BEND + 0.8, spreads={"clearance": "roller_clearance"}):
    """Tilt of a telescopic boom in its rollers: angle = clearance / overlap; the overlap shrinks as the boom extends.

    Attributes:
        clearance: Clearance between boom and rollers, m.
        overlap: Length of the boom inside the rollers at zero displacement, m; the joint's displacement shortens it.
    """

    clearance: Annotated[Scalar, toml_tables.MM.not_negative]
    overlap: Annotated[Scalar, toml_tables.MM.positive]

    def bent(self, at: Passage, frame: Frame, length: Scalar) -> Frame:
        """Return the frame of the boom's tip after the boom has tilted down in its rollers.

        A level boom tilts by the full angle, an inclined one by less. Arguments as in `Boom.bent`.
        """
        angle = self.clearance / (self.overlap - at.joints[self.joint])
        return lowered_tip(frame, angle * length, angle)

    def fault(self, arm: Arm) -> str:
        """Return an error message if ``arm``'s boom can extend beyond its overlap, else `Boom.fault`'s result."""
        limit = arm.nominal.upper[self.joint]
        if self.overlap > limit:
            return super().fault(arm)
        overlap = f"overlap_mm of [roller_play] is {self.overlap * 1e3:g}"
        return f"{overlap}; give more than the {limit * 1e3:g} mm that joint {self.joint + 1} runs out"


@dataclass(frozen=True)
class Harmonic:
    """One periodic term of a drive's error: A sin(2 pi q / period + phase), with q the position of the motor.

    Attributes:
        joint: Index of the joint (from 0).
        amplitude: Amplitude A, rad or m.
        period: Period in q, rad or m.
        phase: Phase, rad.
    """

    joint: int
    amplitude: Scalar
    period: Scalar
    phase: Scalar


HARMONICS = toml_tables.Then(
    lambda entries, _: tuple(Harmonic(**vars(entry)) for entry in entries),
    Annotated[tuple[Any, ...], ByJoint(amplitude=TRAVEL, period=LENGTH, phase=(toml_tables.DEG,) * 2)],
)


@register("effect", "transmission_error")
@toml_tables.toml_table
class TransmissionError(Effect, place=DRIVE):
    """Position errors of the drives: for each joint a lead error (proportional to position) and periodic terms.

    Attributes:
        lead: Relative lead error of each joint (n,), m/m or rad/rad.
        harmonics: The periodic terms.
    """

    lead: Annotated[tuple[Scalar, ...], toml_tables.NUMBER, PER_JOINT]
    harmonics: Annotated[tuple[Harmonic, ...], HARMONICS] = ()

    def act(self, at: Passage, memory: Components) -> None:
        """Add lead errors and periodic errors to the driven positions of the passage ``at``, in place.

        ``memory`` is not used.
        """
        pairs = zip(at.driven, self.lead, strict=True)
        driven = [value if isinstance(lead, float) and not lead else value * (1.0 + lead) for value, lead in pairs]
        at.drive(with_waves(at.m, self.harmonics, at.driven, driven))

    def drawn(self, draws: Draws) -> TransmissionError:
        """Return the drives of many arms: lead errors and amplitudes are drawn log-normally, phases uniformly.

        Phases are uniform over a whole turn, because no two gears are alike.
        """
        amplitudes = draws.scaled([term.amplitude for term in self.harmonics], self.name)
        terms = zip(self.harmonics, amplitudes, 2.0 * math.pi * draws.even["phase"].T, strict=True)
        return TransmissionError(
            draws.scaled(self.lead, "lead", spread=self.name),
            tuple(replace(term, amplitude=amplitude, phase=phase) for term, amplitude, phase in terms),
        )


def with_waves(m: ModuleType, harmonics: Sequence[Harmonic], q: Scalars, driven: Scalars) -> list[Scalar]:
    """Return ``driven`` plus the periodic errors at the motor positions ``q``.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        harmonics: The periodic errors.
        q: Positions of the motors, n components, rad or m.
        driven: Joint positions to add to, n components, rad or m.
    """
    joints = list(driven)
    for term in harmonics:
        angle = q[term.joint] * (math.tau / term.period) + term.phase
        joints[term.joint] = joints[term.joint] + term.amplitude * m.sin(angle)
    return joints


def lowered_tip(frame: Frame, sag: Scalar, slope: Scalar) -> Frame:
    """Return the frame of a link's tip after bending under gravity.

    Args:
        frame: Frame of the tip before bending, world axes; the link lies along its z axis.
        sag: Lowering of the tip of a level link, m.
        slope: Tilt of the tip of a level link, rad.
    """
    *axes, zx, zy, zz, px, py, pz = frame
    # Gravity across the boom is (zx zz, zy zz, zz^2 - 1); the slope turns z towards it, about z x (0, 0, -1).
    turned = turn_horizontally((*axes, zx, zy, zz), -slope * zy, slope * zx)
    return (*turned, px + sag * zx * zz, py + sag * zy * zz, pz + sag * (zz * zz - 1.0))


def turn_horizontally(axes: Scalars, wx: Scalar, wy: Scalar, starts: Sequence[int] = (0, 3, 6)) -> list[Scalar]:
    """Rotate vectors by the small horizontal rotation vector (wx, wy, 0), by Rodrigues' formula.

    The formula's two coefficients are computed as series, so that there is no division by zero. Below 0.03 rad they
    are exact to double precision.

    Args:
        axes: Components of all vectors, one vector after another.
        wx: First component of the rotation vector, rad.
        wy: Second component of the rotation vector, rad.
        starts: Index in ``axes`` of the first component of each vector to rotate.

    Returns:
        The components of the rotated vectors.
    """
    square = wx * wx + wy * wy
    first, second = 1.0 - square * (1.0 / 6.0 - square / 120.0), 0.5 - square * (1.0 / 24.0 - square / 720.0)
    turned: list[Scalar] = []
    for j in starts:
        x, y, z = axes[j : j + 3]
        along = wx * x + wy * y
        turned.append(x + first * wy * z + second * (wx * along - square * x))
        turned.append(y - first * wx * z + second * (wy * along - square * y))
        turned.append(z + first * (wx * y - wy * x) - second * square * z)
    return turned


# Joints that remember where they came from: backlash and friction, both by the play operator, whose output rests until
# its input has crossed the gap, then follows at the gap's edge (Krasnosel'skii and Pokrovskii 1989). Backlash is a gap
# that gravity can hold closed; Coulomb friction before an elastic drive is a gap that it cannot. Units: rad or m on the
# joint side, N*m or N.


SCATTER = toml_tables.NUMBER.not_negative
PRELOAD = (toml_tables.NEWTON_METRE.not_negative, toml_tables.NEWTON.not_negative)


@register("effect", "backlash")
@dataclass(frozen=True)
class Backlash(Effect, place=GEAR + 0.5, spreads={"width": "backlash"}):
    """Backlash (lost motion) in each joint's gear.

    Attributes:
        width: Full width of each joint's backlash (n,), rad or m.
        preload: Gravity torque or force above which a joint always rests on the same side of its backlash (n,), N*m or
            N. Below it, friction holds the joint, and each reversal of the motor crosses the whole backlash.
    """

    table = joint_table(lambda *sizes: Backlash(*sizes), width=TRAVEL, preload=PRELOAD)

    width: tuple[Scalar, ...]
    preload: tuple[Scalar, ...]

    def act(self, at: Passage, memory: Components) -> None:
        """Set the joints of the passage ``at``, in place, to the positions in ``memory``."""
        at.joints = memory

    def begin(self, at: Passage) -> Components:
        """Return the joint positions at rest: in the middle of the backlash, or on gravity's side above the preload."""
        return self.carry(at, tuple(at.joints), 0.0)

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """Return the joint positions after the motors have moved to the positions of the passage ``at``, by `play`.

        ``memory`` has the joint positions before the motors moved; ``dt`` is not used.
        """
        behind, torques = [], at.pull[1] if at.load else None
        numbers = zip(at.joints, memory, self.width, self.preload, strict=True)
        for i, (entry, output, width, preload) in enumerate(numbers):
            half = 0.5 * width
            low, high = entry - half, entry + half
            free = clipped(at.m, output, low, high)
            if torques is not None:
                free = chosen(at.m, torques[i] > preload, high, chosen(at.m, torques[i] < -preload, low, free))
            behind.append(free)
        return tuple(behind)


@register("effect", "stick_band")
@dataclass(frozen=True)
class StickBand(Effect, place=GEAR, spreads={"forward": "friction", "backward": "friction"}):
    """Coulomb friction of joints with elastic drives: a joint stops short of its command, on the side it came from.

    Attributes:
        forward: Lag of each joint that moves in the positive direction (n,), rad or m: friction / stiffness.
        backward: Lag of each joint that moves in the negative direction (n,), rad or m.
        scatter: Standard deviation of the friction over stops, as a share of the friction. `Plant.advance` uses the
            mean friction; simulated measuring campaigns and repeatability tests draw the scatter (`one_stop`).
    """

    table = joint_table(lambda *sizes: StickBand(*sizes), forward=TRAVEL, backward=TRAVEL, scatter=SCATTER)

    forward: tuple[Scalar, ...]
    backward: tuple[Scalar, ...]
    scatter: Scalar = 0.0

    def act(self, at: Passage, memory: Components) -> None:
        """Set the joints of the passage ``at``, in place, to the positions in ``memory``."""
        at.joints = memory

    def begin(self, at: Passage) -> Components:
        """Return the joint positions at rest: in the middle of their friction bands."""
        numbers = zip(at.joints, self.forward, self.backward, strict=True)
        return tuple([entry + 0.5 * (backward - forward) for entry, forward, backward in numbers])

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """Return the joint positions after the motors have moved to the positions of the passage ``at``, by `play`.

        ``memory`` has the joint positions before the motors moved; ``dt`` is not used.
        """
        numbers = zip(at.joints, memory, self.forward, self.backward, strict=True)
        return tuple([play(at.m, entry, output, forward, backward) for entry, output, forward, backward in numbers])


def one_stop(m: ModuleType, band: StickBand, normal: Sequence[Scalars]) -> StickBand:
    """Return the friction of a single stop: each joint's lags, with normal scatter, clipped at zero.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        band: The mean friction.
        normal: Standard normal numbers: n components for the forward lags, then n for the backward lags.
    """
    forward, backward = (
        tuple(width * clipped(m, 1.0 + band.scatter * z, 0.0, math.inf) for width, z in zip(widths, row, strict=True))
        for widths, row in zip((band.forward, band.backward), normal, strict=True)
    )
    return replace(band, forward=forward, backward=backward)


def play(m: ModuleType, entry: Scalar, output: Scalar, lag: Scalar, lead: Scalar) -> Scalar:
    """Return the new output of a play operator (friction, backlash): the old output, clipped to a band about the input.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        entry: New input.
        output: Old output.
        lag: Largest amount by which the output may be below the input.
        lead: Largest amount by which the output may be above the input.
    """
    return clipped(m, output, entry - lag, entry + lead)


# What yields where an arm slides: the boom under a couple beside its tip, its twist, carriages in their guides. All
# three follow the masses that hang behind a link, wherever they are: gravity's force and moment there come from
# `pickenv.arm.effects.effect.weights_behind`, of the straight arm, and deflections are taken to first order.
# Units: m, rad, N, kg.


@register("effect", "boom_couple")
@toml_tables.toml_table
class BoomCouple(Boom, place=BEND + 0.4, spreads={"flexural_rigidity": "flexural_rigidity"}, needs_load=True):
    """Bending of a boom by the moment of masses beside its tip: delta = M L^2 / 2EI, slope = M L / EI.

    M is the moment, and L the boom's free length.

    Attributes:
        flexural_rigidity: Flexural rigidity EI, N*m^2.
    """

    flexural_rigidity: Annotated[Scalar, toml_tables.Unit("N_m2").positive]

    def bent(self, at: Passage, frame: Frame, length: Scalar) -> Frame:
        """Return the frame of the boom's tip after bending by gravity's moment about the tip.

        Only the moment's component across the boom's axis bends the boom. Arguments as in `Boom.bent`.
        """
        zx, zy, zz, px, py, _ = frame[6:]
        mx, my = moment_about(at.pull[0][self.joint + 1], px, py)
        along, turn = mx * zx + my * zy, length / self.flexural_rigidity
        wx, wy, wz = turn * (mx - along * zx), turn * (my - along * zy), -turn * along * zz
        return displaced_frame(at.m, frame, _swung(wx, wy, wz, 0.5 * length, (zx, zy, zz), (0.0, 0.0, 0.0)))


@register("effect", "boom_torsion")
@toml_tables.toml_table
class BoomTorsion(Boom, place=BEND + 0.6, spreads={"torsional_rigidity": "flexural_rigidity"}, needs_load=True):
    """Twist of a boom by the moment of masses beside its axis: angle = M L / GJ.

    M is the moment about the boom's axis, and L the boom's free length.

    Attributes:
        torsional_rigidity: Torsional rigidity GJ, N*m^2.
    """

    torsional_rigidity: Annotated[Scalar, toml_tables.Unit("N_m2").positive]

    def bent(self, at: Passage, frame: Frame, length: Scalar) -> Frame:
        """Return the frame of the boom's tip after a twist by gravity's moment about the tip.

        Only the moment's component along the boom's axis twists the boom. Arguments as in `Boom.bent`.
        """
        zx, zy, zz, px, py, _ = frame[6:]
        mx, my = moment_about(at.pull[0][self.joint + 1], px, py)
        angle = length / self.torsional_rigidity * (mx * zx + my * zy)
        return displaced_frame(at.m, frame, (0.0, 0.0, 0.0, angle * zx, angle * zy, angle * zz))


@toml_tables.toml_table
class Bearing:
    """The guide of a slide: two bearings along the axis, each with two pads that are springs across the axis.

    A bearing has the stiffness k. The bearings are a distance s apart, and the pads of a bearing a distance b. Against
    a force across the axis, the two bearings together have the stiffness 2k. Against a moment across the axis it is
    k s^2 / 2. Against a moment about the axis it is k b^2 / 2, which comes from the distance of the pads alone.

    Attributes:
        joint: Index (from 0) of the prismatic joint.
        stiffness: Stiffness k of one bearing, N/m.
        span: Distance s between the two bearings at zero displacement, m.
        width: Distance b between the pads of a bearing, across the axis, m.
        overhang: Distance along the axis from the guide's outlet to the link's origin at zero displacement, m. The
            joint's displacement is added to the overhang and subtracted from the span. None if the bearings move with
            the link, centred on its origin.
    """

    joint: Annotated[int, toml_tables.WHOLE, BOOM]
    stiffness: Annotated[Scalar, toml_tables.Unit("N_per_um", 1e6).positive]
    span: Annotated[Scalar, toml_tables.MM.positive]
    width: Annotated[Scalar, toml_tables.MM.positive]
    overhang: Annotated[Scalar | None, toml_tables.MM.not_negative] = None


EACH_ONCE = toml_tables.afterwards(lambda slides: len({s.joint for s in slides}) == len(slides), "each joint once")


@register("effect", "slide_compliance")
@toml_tables.toml_table
class SlideCompliance(Effect, place=BEND, needs_load=True):
    """Deflection of slides in their bearings: displacement across the axis, and rotation.

    Attributes:
        bearings: The guide of each slide that yields.
    """

    bearings: Annotated[tuple[Bearing, ...], EACH_ONCE]

    def flexure(self, at: Passage) -> Flexure:
        """Return a function that moves and turns the frame of each slide in ``bearings``.

        The function applies the slide's deflection under the masses that the slide carries.
        """
        weights, by_joint = at.pull[0], {bearing.joint: bearing for bearing in self.bearings}

        def give(i: int, frame: Frame) -> Frame:
            if (bearing := by_joint.get(i)) is None:
                return frame
            zx, zy, zz, px, py, _ = frame[6:]
            span, arm = bearing.span, 0.0
            if bearing.overhang is not None:
                span = span - at.joints[i]
                arm = bearing.overhang + at.joints[i] + 0.5 * span
            mx, my = moment_about(weights[i], px - arm * zx, py - arm * zy)
            turn = 2.0 / (bearing.stiffness * span * span)
            # The part of the moment along z turns the link by the width.
            roll = (2.0 / (bearing.stiffness * bearing.width * bearing.width) - turn) * (mx * zx + my * zy)
            wx, wy, wz = turn * mx + roll * zx, turn * my + roll * zy, roll * zz
            sunk = GRAVITY * weights[i][0] / (2.0 * bearing.stiffness)
            # Gravity across z is (zx zz, zy zz, zz^2 - 1).
            sag = (sunk * zx * zz, sunk * zy * zz, sunk * (zz * zz - 1.0))
            return displaced_frame(at.m, frame, _swung(wx, wy, wz, arm, (zx, zy, zz), sag))

        return give

    def fault(self, arm: Arm) -> str:
        """Return an error message if a slide of ``arm`` can extend beyond its bearings' span, else an empty string."""
        for bearing in self.bearings:
            limit = arm.nominal.upper[bearing.joint]
            if bearing.overhang is not None and bearing.span <= limit:
                span = f"span_mm of joint {bearing.joint + 1} in [slide_compliance] is {bearing.span * 1e3:g}"
                return f"{span}; give more than the {limit * 1e3:g} mm that it runs out"
        return ""

    def drawn(self, draws: Draws) -> SlideCompliance:
        """Return the slides of many arms, with the stiffness of their bearings drawn about this effect's values."""
        stiffness = [bearing.stiffness for bearing in self.bearings]
        pairs = zip(self.bearings, draws.scaled(stiffness, "bearing_stiffness", spread="joint_stiffness"), strict=True)
        return SlideCompliance(tuple(replace(bearing, stiffness=size) for bearing, size in pairs))


def moment_about(weight: Weight, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    """Return gravity's moment about the point (x, y), N*m: its components about the world's x and y axes.

    Args:
        weight: Three numbers (`Weight`): the mass, kg, the mass times the world's x of its centre, kg*m, and the mass
            times the world's y of its centre, kg*m.
        x: World x of the point, m. Its height does not matter.
        y: World y of the point, m.
    """
    mass, moment_x, moment_y = weight
    return -GRAVITY * (moment_y - mass * y), GRAVITY * (moment_x - mass * x)


def _swung(wx: Scalar, wy: Scalar, wz: Scalar, arm: Scalar, z: Scalars, moved: Scalars) -> tuple[Scalar, ...]:
    """Return a frame's displacement by a small turn and a shift: three components of position, three of rotation.

    All are in world axes, m and rad.

    Args:
        wx: First component of the turn's rotation vector, rad.
        wy: Second component of the turn's rotation vector, rad.
        wz: Third component of the turn's rotation vector, rad.
        arm: Distance, m, from the point about which the frame turns to the frame's origin, along ``z``.
        z: The frame's z axis, three components.
        moved: The shift, three components, m.
    """
    zx, zy, zz = z
    across = (wy * zz - wz * zy, wz * zx - wx * zz, wx * zy - wy * zx)
    return (*(part + arm * way for part, way in zip(moved, across, strict=True)), wx, wy, wz)
