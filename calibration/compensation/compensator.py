"""From a wanted nominal pose to corrected joints: Qiao 2026 eqs (13)-(16) and Fig. 3 through the rank-aware inverse.

q_command = q + J+ (F_nominal(q) - F_identified(q) - residual(q)), repeated at the corrected joints, J+ truncated to the
task's rank (the paper's J^-1 does not exist for this arm), joint limits kept. An arm of fewer than six joints cannot
have both position and attitude: it is brought to the position first (`attitude_weight`). Near joint limits and singular
poses such steps can lead away: of the target and its corrections the one that the model expects nearest is commanded.
One pose runs on Python floats, many on NumPy in blocks: a compensator stands in a control loop and in vector
environments. The residual's network is most of the cost, so it is evaluated once, at the joints that geometry alone
corrects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from types import ModuleType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Geometry, displace_pose, forward
from pickenv.arm.kinematics.backend import clipped
from pickenv.arm.kinematics.forward import Chain, Scalar, attach, chain_of, frames, split_joints, tool_frame
from pickenv.arm.kinematics.geometry import Array, Pose
from pickenv.arm.kinematics.jacobians import jacobian_columns
from pickenv.arm.kinematics.pose_error import frame_error, small_rotation
from pickenv.arm.kinematics.series import Series
from pickenv.arm.kinematics.task_space import attitude_weight, truncated_inverse
from pickenv.arm.kinematics.tracing import SYMBOLS, Trace, outside
from pickenv.calibration.compensation.truncated_solve import TruncatedSolver
from pickenv.errors import InputError
from pickenv.extras import require

BLOCK = 2048
"""Poses worked on together: what a core's first caches hold."""

NEGLIGIBLE = 1e-6
"""What a correction may be expected to lose, m or rad: what single precision rounds where nothing is to be gained."""


class ResidualModel(Protocol):
    """What a learnt residual must offer."""

    def predict(self, joints: ArrayLike) -> Array:
        """Pose residual ``(..., 6)`` (m, rad, world axes) at joints ``(..., n)``."""


@dataclass(frozen=True, eq=False)
class Compensator:
    """Maps joint targets, meant for the nominal arm, to joint commands for the real one.

    Attributes:
        nominal: What the controller believes.
        identified: The calibrated geometry.
        residual: Learnt residual, or None.
        iterations: Corrections applied, each from the joints of the one before, with the factors of one Jacobian. On
            the picking arm with the paper's network one leaves 1.8 um of the predicted error on average, two 1.4 um:
            the residual changes by its own correction, and a fast network predicts in steps. Without a residual one
            leaves 1 um, two nothing.
        single_precision: Whether many poses at once are corrected in single precision: faster, and another 0.1 um.
        reservations: What stands against using it, by name (`pickenv.reservations`).
        within95: What holds 95 of 100 errors of position, m, and attitude, rad, at commands ``(..., n)``, as counted on
            held-out rows; None where nobody knows.
        caution: What its rows do not tell of the workspace, in a sentence; None where they tell it.
    """

    nominal: Geometry
    identified: Geometry
    residual: ResidualModel | None = None
    iterations: int = 2
    single_precision: bool = False
    reservations: Mapping[str, str] = field(default_factory=dict)
    within95: Callable[[Array], tuple[Array | None, Array | None]] | None = None
    caution: str | None = None

    def __call__(self, joints: ArrayLike) -> Array:
        """Joint commands ``(..., n)`` for joint targets ``(..., n)``, rad or m, within the joint limits.

        Raises:
            InputError: If a target is not finite.
            ValueError: If targets have another number of joints.
        """
        joints = self.checked(joints)
        if joints.ndim == 1:
            return np.array(self._corrected(math, joints.tolist()))
        rows = joints.reshape(-1, self.nominal.joints)
        blocks = [self._block(rows[a : a + BLOCK]) for a in range(0, len(rows), BLOCK)]
        return np.concatenate(blocks).reshape(joints.shape) if blocks else joints.copy()

    def checked(self, joints: ArrayLike) -> Array:
        """Joint targets ``(..., n)`` as an array, checked as `__call__` says."""
        joints = np.asarray(joints, dtype=float)
        split_joints(self.nominal.joints, joints)  # checks the number of joints
        if not math.isfinite(joints.sum()):  # the cheapest question; no joints are so large that they overflow
            *row, joint = np.argwhere(~np.isfinite(joints))[0].tolist()
            where = f" of row {', '.join(map(str, row))}" if row else ""
            name, value = self.nominal.joint_names[joint], joints[(*row, joint)]
            raise InputError(f"the target of {name}{where} is {value}; give finite joint targets, rad or m")
        return joints

    def compiled(self, count: int) -> Callable[[ArrayLike], Array]:
        """The same for some ``count`` targets ``(count, n)`` again and again: machine code, with the same bits.

        In single precision there is none, and it is this compensator itself.

        Raises:
            MissingExtra: If llvmlite is not installed.
        """
        require("llvmlite")
        from pickenv.calibration.compensation.compiled_compensator import CompiledCompensator

        return self if self.single_precision else CompiledCompensator(self, count)

    def noted(self, trace: Trace) -> list[Scalar]:
        """Commands for the rows of the input "targets" of a trace: what is done with many targets, written down."""
        target = trace.inputs("targets", self.nominal.joints)
        limits = zip(self.nominal.lower.tolist(), self.nominal.upper.tolist(), strict=True)
        found = zip(target, self._corrected(SYMBOLS, target), limits, strict=True)
        return [clipped(SYMBOLS, q + (command - q), low, high) for q, command, (low, high) in found]

    def predict(self, joints: ArrayLike) -> Pose:
        """Where the real tool is expected at joint commands ``(..., n)``: identified pose plus residual."""
        pose = forward(self.identified, joints)
        return pose if self.residual is None else displace_pose(pose, self.residual.predict(joints))

    @cached_property
    def _chains(self) -> tuple[Chain, Chain]:
        return chain_of(self.nominal), chain_of(self.identified)

    def _block(self, rows: Array) -> Array:
        """Commands for targets ``(N, n)``; only the corrections, which are small, are ever in single precision."""
        target = np.ascontiguousarray(rows.T, dtype=np.float32 if self.single_precision else np.float64)
        correction = np.stack(self._corrected(np, list(target)), axis=1) - target.T
        return np.asarray(np.clip(rows + correction, self.nominal.lower, self.nominal.upper))

    def _corrected(self, m: ModuleType, target: Sequence[Scalar]) -> Sequence[Scalar]:
        """Commands for targets, joint by joint: floats with ``m`` = math, arrays ``(N,)`` with ``m`` = numpy."""
        learnt = None if self.residual is None else partial(self._learnt, m)
        return corrected(m, self.nominal, self._chains, target, self.iterations, learnt)

    def _learnt(self, m: ModuleType, joints: Sequence[Scalar]) -> list[Scalar]:
        """The residual at joints, component by component."""
        assert self.residual is not None
        if m is math:
            return list(self.residual.predict(np.array(joints)).tolist())
        noted = outside(self._fill, joints, 6)
        if noted is not None:
            return list(noted)
        rows = np.stack(joints)
        return list(np.ascontiguousarray(self.residual.predict(rows.T).T, dtype=rows.dtype))

    def _fill(self, joints: Array, found: Array, _: slice) -> None:
        """The residual ``(6, N)`` at joints ``(n, N)``."""
        assert self.residual is not None
        found[:] = self.residual.predict(joints.T).T


def corrected(
    m: ModuleType,
    nominal: Geometry,
    chains: tuple[Chain, Chain],
    target: Sequence[Scalar],
    iterations: int,
    residual: Callable[[Sequence[Scalar]], Sequence[Scalar]] | None = None,
) -> Sequence[Scalar]:
    """Commands for targets, joint by joint: what `Compensator` does, on any executor and for any number of arms.

    Args:
        m: ``math``, ``numpy`` or ``torch``.
        nominal: What the controller believes, for joint types and limits.
        chains: The nominal chain and the identified one, which may be that of many arms.
        target: Joint targets, n components, rad or m.
        iterations: See `Compensator`.
        residual: Learnt residual of joints, six components (m, rad), or None.
    """
    believed, identified = chains
    turning: Any = Series(m) if getattr(target[0], "dtype", None) == np.float64 else m
    limits = list(zip(nominal.lower.tolist(), nominal.upper.tolist(), strict=True))
    command, wanted, learnt, solve, best = target, tool_frame(turning, believed, target), None, None, None
    for _ in range(iterations):
        links = frames(turning, identified, command)
        tool = attach(links[-1], identified.tool)
        columns = [_weighed(nominal, column) for column in jacobian_columns(nominal, links, tool)]
        solve = solve or _solver(m, columns)
        error = _weighed(nominal, frame_error(m, tool, wanted, small_rotation))
        if residual is not None:
            if learnt is None:
                learnt = _weighed(nominal, residual(_moved(m, command, solve(error, columns), limits)))
            error = _less(error, learnt)
        best = _nearer(m, best, _expected(m, command, error))
        command = _moved(m, command, solve(error, columns), limits)
    if best is None:
        return target
    tool = tool_frame(turning, identified, command)
    error = _weighed(nominal, frame_error(m, tool, wanted, small_rotation))
    return _nearer(m, best, _expected(m, command, error if learnt is None else _less(error, learnt))).joints


def _weighed(nominal: Geometry, parts: Sequence[Scalar]) -> Sequence[Scalar]:
    """The six components of an error, or of a column of the Jacobian, as the task weighs them."""
    weight = attitude_weight(nominal.joints)
    return parts if weight == 1.0 else [*parts[:3], *(weight * part for part in parts[3:])]


class _Expected(NamedTuple):
    """Joints, and the size of the pose error expected there, as the task weighs it."""

    joints: Sequence[Scalar]
    error: Scalar


def _expected(m: ModuleType, joints: Sequence[Scalar], error: Sequence[Scalar]) -> _Expected:
    """What the model expects at joints, from the six components of its pose error there."""
    return _Expected(joints, m.sqrt(sum((part * part for part in error[1:]), error[0] * error[0])))


def _nearer(m: ModuleType, one: _Expected | None, other: _Expected) -> _Expected:
    """The other, but for poses where it is expected farther off than the one."""
    if one is None:
        return other
    nearer = other.error < one.error + NEGLIGIBLE
    if m is math:
        return other if nearer else one
    joints = [m.where(nearer, after, before) for after, before in zip(other.joints, one.joints, strict=True)]
    return _Expected(joints, m.where(nearer, other.error, one.error))


def _less(error: Sequence[Scalar], learnt: Sequence[Scalar]) -> list[Scalar]:
    """What is left of a pose error when the residual is expected beside it."""
    return [left - expected for left, expected in zip(error, learnt, strict=True)]


def _moved(
    m: ModuleType, joints: Sequence[Scalar], step: Sequence[Scalar], limits: Sequence[tuple[float, float]]
) -> list[Scalar]:
    """Joints after a step, within their limits."""
    return [clipped(m, q + dq, low, high) for q, dq, (low, high) in zip(joints, step, limits, strict=True)]


Solve = Callable[[Sequence[Scalar], Sequence[Sequence[Scalar]]], list[Scalar]]


def _solver(m: ModuleType, columns: Sequence[Sequence[Scalar]]) -> Solve:
    """What turns pose errors into the joint steps that remove them, for a Jacobian with these columns or like it."""
    if m is not math:
        return TruncatedSolver(columns, m).solve
    inverse = truncated_inverse(np.array(columns).T)
    return partial(_truncated_step, inverse @ inverse.T)


def _truncated_step(inverse: Array, error: Sequence[float], columns: Sequence[Sequence[float]]) -> list[float]:
    """`TruncatedSolver.solve` for one pose, given the truncated inverse of J^T J."""
    step: list[float] = (inverse @ (np.array(columns) @ error)).tolist()
    return step
