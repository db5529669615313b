"""Effects of the ground under the machine (tilt, creep, settlement), and vibration of the arm after a move.

The machine tilts at once under the arm's gravity moment: tilt = moment / stiffness. The tilt then creeps to a multiple
of this value, and the whole machine settles, both with one time constant (a Kelvin-Voigt body). Gravity points along
-z of the world. Units: m, rad, N*m, s, kg.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from pickenv.arm.effects.effect import BASE, JOINT, Components, Draws, Effect, Passage
from pickenv.arm.effects.structure import turn_horizontally
from pickenv.arm.files.arm import PER_JOINT
from pickenv.arm.kinematics.forward import Scalar, exponential, namespace_of
from pickenv.base import GRAVITY, HOURS, MILLISECONDS, MM, NUMBER, Unit, afterwards, register, toml_table

GIVING_WAY = {"stiffness": "ground_stiffness", "creep": "sinkage", "settlement": "sinkage"}


@register("effect", "base_tilt")
@toml_table
class BaseTilt(Effect, place=BASE, spreads=GIVING_WAY, needs_load=True):
    """Tilt and sinkage of the machine that carries the arm.

    Attributes:
        stiffness: Tilt stiffness of the ground contact about the world's x and y axes, N*m/rad.
        pivot: Point in the world about which the machine tilts, m.
        creep: Additional tilt under a moment held for ever, as a multiple of the immediate tilt.
        settlement: Final settlement of the machine under its own weight, m.
        time_constant: Time constant of creep and settlement, s.
    """

    stiffness: Annotated[tuple[Scalar, Scalar], Unit("N_m_per_rad").positive]
    pivot: Annotated[tuple[float, float, float], MM]
    creep: Annotated[Scalar, NUMBER.not_negative]
    settlement: Annotated[Scalar, MM.not_negative]
    time_constant: Annotated[Scalar, HOURS.positive]

    def act(self, at: Passage, memory: Components) -> None:
        """Move the tool of the passage ``at``, in place, by the machine's tilt, creep and settlement.

        ``memory`` has the creep and the settlement, as `begin` describes them.
        """
        (tilt_x, tilt_y), (creep_x, creep_y, settlement) = self._tilt(at), memory
        x0, y0, z0 = self.pivot
        *axes, px, py, pz = at.frame
        vectors = (*axes, px - x0, py - y0, pz - z0)
        turned = turn_horizontally(vectors, tilt_x + creep_x, tilt_y + creep_y, starts=(0, 3, 6, 9))
        at.frame = (*turned[:9], turned[9] + x0, turned[10] + y0, turned[11] + z0 - settlement)

    def begin(self, at: Passage) -> Components:
        """Return the memory when the arm is switched on: creep about x and y, rad, and settlement, m, all zero."""
        zero = at.command[0] * 0.0
        return zero, zero, zero

    def rest(self, at: Passage) -> Components:
        """Return the memory after a long time: final creep about x and y, rad, and final settlement, m."""
        x, y = self._tilt(at)
        return self.creep * x, self.creep * y, self.settlement

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """Return creep about x and y, rad, and settlement, m, after ``dt`` seconds, in which the command is held.

        ``memory`` has the creep and the settlement before.
        """
        faded, pairs = exponential(at.m, -dt / self.time_constant), zip(self.rest(at), memory, strict=True)
        return tuple([final + (part - final) * faded for final, part in pairs])

    def _tilt(self, at: Passage) -> tuple[Scalar, Scalar]:
        """Return the tilt that the arm's gravity moment causes at once: a rotation vector (x, y), world axes, rad."""
        x0, y0, _ = self.pivot
        mass, moment_x, moment_y = at.pull[0][0]
        about_x, about_y = self.stiffness
        return -GRAVITY * (moment_y - mass * y0) / about_x, GRAVITY * (moment_x - mass * x0) / about_y


# Light arms swing after a move: each joint carries a lightly damped second-order mode that its acceleration excites.
# e'' + 2 zeta omega e' + omega^2 e = -p x'', with x the joint's motion profile towards its command: the command
# through a first-order lag. A held command is integrated exactly, whatever the time step. Units: s, Hz, rad or m.


BELOW_ONE = afterwards(lambda zetas: all(zeta < 1.0 for zeta in zetas), "damping ratios from 0 to below 1")


@register("effect", "settling")
@toml_table
class Settling(Effect, place=JOINT + 0.4, spreads={"frequency": "frequency", "damping": "damping"}):
    """Vibration of the structure between each joint and the tool: one damped mode, excited by the joint's acceleration.

    Attributes:
        frequency: Natural frequency of each joint's vibration mode (n,), Hz.
        damping: Damping ratio zeta of each mode (n,), below 1.
        participation: Share p of the joint's acceleration that excites each mode (n,).
        rise_time: Time constant of the motion profile, s: the command passes a first-order lag.
    """

    frequency: Annotated[tuple[Scalar, ...], Unit("Hz").positive, PER_JOINT]
    damping: Annotated[tuple[Scalar, ...], NUMBER.not_negative, BELOW_ONE, PER_JOINT]
    participation: Annotated[tuple[Scalar, ...], NUMBER.not_negative, PER_JOINT]
    rise_time: Annotated[Scalar, MILLISECONDS.positive]

    def act(self, at: Passage, memory: Components) -> None:
        """Add the vibrations in ``memory`` to the joint positions of the passage ``at``, in place.

        An empty memory adds nothing.
        """
        if memory:
            n = len(at.joints)
            at.joints = [value + swing for value, swing in zip(at.joints, memory[n : 2 * n], strict=True)]

    def begin(self, at: Passage) -> Components:
        """Return 3 n components: motion profiles x of the n joints, then vibrations e, then sums e' + p x'.

        The prime is the derivative by time, p the participation. Profiles and vibrations are in rad or m, sums in rad/s
        or m/s. The sums are continuous even if the command jumps.
        """
        still = [value * 0.0 for value in at.command]
        return *at.command, *still, *still

    def rest(self, at: Passage) -> Components:
        """Return an empty memory: all vibrations have decayed."""
        return ()

    def carry(self, at: Passage, memory: Components, dt: Scalar) -> Components:
        """Return the 3 n components that `begin` describes, after ``dt`` s; ``memory`` has the components before."""
        m, lag, n = at.m, self.rise_time, len(at.command)
        faded = exponential(m, -dt / lag)
        profiles, vibrations, rates = [], [], []
        for profile, vibration, rate, command, frequency, zeta, share in zip(
            *(memory[:n], memory[n : 2 * n], memory[2 * n :]),
            *(at.command, self.frequency, self.damping, self.participation),
            strict=True,
        ):
            omega = math.tau * frequency
            decay, damped = zeta * omega, omega * namespace_of(m, zeta).sqrt(1.0 - zeta * zeta)
            angle = damped * dt
            space = namespace_of(m, angle)
            envelope = exponential(m, -decay * dt)
            cosine, sine = envelope * space.cos(angle), envelope * space.sin(angle) / damped
            # The profile command + gap exp(-t / lag) forces the part `forced` exp(-t / lag); the rest swings freely.
            gap = profile - command
            forced = -share * gap / (1.0 - 2.0 * decay * lag + (omega * lag) * (omega * lag))
            free, free_rate = vibration - forced, rate + (share * gap + forced) / lag
            swung = free * cosine + (free_rate + decay * free) * sine
            swung_rate = free_rate * cosine - (decay * free_rate + omega * omega * free) * sine
            profiles.append(command + gap * faded)
            vibrations.append(swung + forced * faded)
            rates.append(swung_rate - (forced + share * gap) * faded / lag)
        return *profiles, *vibrations, *rates

    def drawn(self, draws: Draws) -> Settling:
        """Return the vibration of many arms, drawn as in `Effect.drawn`.

        Damping ratios are clipped to 0.5, the largest damping ratio of a structure.
        """
        modes = super().drawn(draws)
        damping: Any = tuple(np.minimum(zeta, 0.5) for zeta in modes.damping)
        return replace(modes, damping=damping)
