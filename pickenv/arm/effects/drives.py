"""What the motor side does with a command: it rests on whole encoder counts and follows with a lag; rad, m, s."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Annotated

from pickenv.arm.files.joint_keys import PER_JOINT
from pickenv.arm.kinematics.backend import exponential, nearest_whole
from pickenv.arm.kinematics.forward import Scalar
from pickenv.toml_tables import MILLISECONDS, toml_table


@dataclass(frozen=True)
class Encoder:
    """Motor encoders of finite resolution: a drive can hold, and report, whole counts only.

    Attributes:
        resolution: One count of each joint, seen at the joint, rad or m.
    """

    resolution: tuple[Scalar, ...]


@toml_table
class Servo:
    """Position loops that follow with an error proportional to speed: x' = (command - x) / time constant.

    Attributes:
        time_constant: Of each joint's loop, s (one over the position gain).
    """

    time_constant: Annotated[tuple[Scalar, ...], MILLISECONDS.positive, PER_JOINT]


def quantised(m: ModuleType, encoder: Encoder, q: Sequence[Scalar]) -> list[Scalar]:
    """Displacements in whole counts."""
    return [nearest_whole(m, value / count) * count for value, count in zip(q, encoder.resolution, strict=True)]


def followed(m: ModuleType, servo: Servo, motor: Sequence[Scalar], q: Sequence[Scalar], dt: Scalar) -> list[Scalar]:
    """Motor positions after the command ``q`` has been held for ``dt`` seconds."""
    numbers = zip(motor, q, servo.time_constant, strict=True)
    return [target + (value - target) * exponential(m, -dt / constant) for value, target, constant in numbers]
