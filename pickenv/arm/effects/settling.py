"""Light arms swing after a move: each joint carries a lightly damped second-order mode that its acceleration excites.

e'' + 2 zeta omega e' + omega^2 e = -p x'', with x the joint's motion profile towards its command: the command through a
first-order lag. A held command is integrated exactly, whatever the time step. Units: s, Hz, rad or m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Annotated, NamedTuple

from pickenv.arm.files.joint_keys import PER_JOINT
from pickenv.arm.kinematics.backend import exponential, namespace_of
from pickenv.arm.kinematics.forward import Scalar
from pickenv.toml_tables import MILLISECONDS, NUMBER, Check, Unit, toml_table

BELOW_ONE = Check(
    lambda values: not isinstance(values, list) or all(not isinstance(v, int | float) or v < 1 for v in values),
    "damping ratios from 0 to below 1",
)


@toml_table
class Settling:
    """Vibration of the structure behind each joint.

    Attributes:
        frequency: Natural frequency of each joint's mode, Hz.
        damping: Its damping ratio zeta, below 1.
        participation: Share p of the joint's acceleration that reaches the mode.
        rise_time: Time constant of the motion profile, s: how smoothly commands are approached.
    """

    frequency: Annotated[tuple[Scalar, ...], Unit("Hz").positive, PER_JOINT]
    damping: Annotated[tuple[Scalar, ...], NUMBER.not_negative, BELOW_ONE, PER_JOINT]
    participation: Annotated[tuple[Scalar, ...], NUMBER.not_negative, PER_JOINT]
    rise_time: Annotated[Scalar, MILLISECONDS.positive]


class Swing(NamedTuple):
    """State of one joint's mode.

    Attributes:
        profile: Where the motion profile is, rad or m.
        vibration: Displacement e of the mode, to be added to the joint's.
        rate: e' + p x', rad/s or m/s: the velocity of what swings, which no sudden command changes.
    """

    profile: Scalar
    vibration: Scalar
    rate: Scalar


def at_rest(q: Sequence[Scalar]) -> list[Swing]:
    """Modes of an arm that has long been at ``q``."""
    return [Swing(value, value * 0.0, value * 0.0) for value in q]


def swung(m: ModuleType, settling: Settling, swings: Sequence[Swing], q: Sequence[Scalar], dt: Scalar) -> list[Swing]:
    """The modes after the command ``q`` has been held for ``dt`` seconds.

    Args:
        m: ``math``, ``numpy`` or ``torch``.
        settling: The modes' constants.
        swings: The modes before.
        q: The joint commands, rad or m.
        dt: s, at least 0; one number, or one per arm.
    """
    lag = settling.rise_time
    faded = exponential(m, -dt / lag)
    result = []
    for swing, command, frequency, zeta, share in zip(
        swings, q, settling.frequency, settling.damping, settling.participation, strict=True
    ):
        omega = math.tau * frequency
        decay = zeta * omega
        damped = omega * namespace_of(m, zeta).sqrt(1.0 - zeta * zeta)
        angle = damped * dt
        space = namespace_of(m, angle)
        envelope = exponential(m, -decay * dt)
        cosine, sine = envelope * space.cos(angle), envelope * space.sin(angle) / damped
        # The profile x = command + gap exp(-t / lag) forces the part `forced` exp(-t / lag); the rest swings freely.
        gap = swing.profile - command
        forced = -share * gap / (1.0 - 2.0 * decay * lag + (omega * lag) * (omega * lag))
        free = swing.vibration - forced
        free_rate = swing.rate + (share * gap + forced) / lag
        vibration = free * cosine + (free_rate + decay * free) * sine
        vibration_rate = free_rate * cosine - (decay * free_rate + omega * omega * free) * sine
        result.append(
            Swing(
                profile=command + gap * faded,
                vibration=vibration + forced * faded,
                rate=vibration_rate - (forced + share * gap) * faded / lag,
            )
        )
    return result
