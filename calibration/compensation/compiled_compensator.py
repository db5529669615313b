"""A compensator as machine code, for a control loop over many arms: the commands of the plain one, to the bit."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.forward import Scalar
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.machine_code import Compiled
from pickenv.arm.kinematics.tracing import FLAG, Outputs, Trace


class Notable(Protocol):
    """What is compiled: see `pickenv.calibration.compensation.compensator.Compensator`."""

    def __call__(self, joints: ArrayLike) -> Array:
        """Commands for targets."""

    def checked(self, joints: ArrayLike) -> Array:
        """Targets, checked."""

    def noted(self, trace: Trace) -> list[Scalar]:
        """The commands, written down."""


class CompiledCompensator:
    """Maps joint targets ``(N, n)`` to joint commands; the few poses that need more than operations go the plain way.

    Args:
        plain: The compensator.
        count: For how many targets at once.
    """

    def __init__(self, plain: Notable, count: int) -> None:
        self._plain = plain
        trace = Trace()
        commands = plain.noted(trace)
        doubt = trace.exceptions[0] if trace.exceptions else False
        for other in trace.exceptions[1:]:
            doubt = doubt | other
        self._code = Compiled(trace, [Outputs("commands", commands), Outputs("doubt", [doubt], FLAG)], count)

    def __call__(self, joints: ArrayLike) -> Array:
        """Joint commands ``(N, n)`` for joint targets ``(N, n)``, rad or m."""
        joints = self._plain.checked(joints)
        targets = np.ascontiguousarray(joints.T)
        commands, doubt = np.empty_like(targets), np.empty(len(joints), dtype=np.bool_)
        self._code.run({"targets": targets, "commands": commands, "doubt": doubt}, len(joints))
        if doubt.any():
            commands[:, doubt] = self._plain(joints[doubt]).T
        return commands.T
