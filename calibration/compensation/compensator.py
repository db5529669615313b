"""Correct joint targets for a calibrated arm by Qiao 2026, eqs (13)-(16) and Fig. 3, with a rank-aware inverse.

q_command = q + J+ (F_nominal(q) - F_identified(q) - residual(q)), repeated at the corrected joints. J+ is truncated to
the task's rank, since the paper's J^-1 does not exist for an arm of fewer than six joints. Joint limits are kept. An
arm of fewer than six joints cannot reach both position and attitude; the position has priority (`attitude_weight`).
Near joint limits and singular poses a correction can increase the error. The command is therefore the target or one of
its corrections, whichever has the smallest expected error. One pose is computed on Python floats, as in a control loop.
Many poses are computed on NumPy in blocks, as in vector environments. The residual's network is most of the cost, so it
is evaluated once, at joints that are corrected by geometry alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, reduce
from operator import or_
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Arm, Array, Geometry, Pose, displace_pose, forward
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.arm.kinematics import task_space
from pickenv.arm.kinematics.forward import (
    Chain,
    Scalar,
    attach,
    chain_of,
    clipped,
    frames,
    outside,
    possible,
    set_aside,
    split_joints,
    tool_frame,
)
from pickenv.base import InputError, require
from pickenv.calibration.identification.solve import FilterState, predict, random_walk, update

# Minimum-norm solutions of J x = e with small singular values cut off, for thousands of small J at once. Does what
# `pickenv.arm.kinematics.task_space.truncated_inverse` does, without one LAPACK call per pose: J^T J is factorised in
# components, the direction that is to be cut off is found by inverse iteration and projected out. Poses where more
# than one direction, or a doubtful one, would have to go are handed to the singular value decomposition. The same
# lines run on NumPy arrays and torch tensors.

RIDGE = 16.0
"""Value added to the diagonal of J^T J, so that a singular one can be factorised, in rounding errors of its trace."""

SETTLED = 1e-4
"""Largest turn of the singular direction in the last inverse iteration, as 1 - cosine, that counts as converged."""

START = (0.9, -0.4, 1.0, 0.7, -1.1, 0.6, -0.3)
"""Start of the inverse iteration, far from the directions that are likely to be singular in a symmetric arm."""

Columns = Sequence[Sequence[Scalar]]
"""The n columns of a Jacobian J, each with six components ``(...)``; components that are the float 0.0 cost nothing."""


class TruncatedSolver:
    """Minimum-norm solver of J x = e for the Jacobians of N poses; small singular values are cut off.

    The Jacobians are factorised once and can be solved for any number of right-hand sides.

    Args:
        columns: The n columns of J, each with six components ``(N,)``.
        m: ``numpy`` or ``torch``.
    """

    def __init__(self, columns: Columns, m: ModuleType) -> None:
        self.columns, self._m = columns, m
        n = len(columns)
        gram = [[_dot(columns[i], columns[j]) for j in range(i + 1)] for i in range(n)]
        trace = sum((gram[i][i] for i in range(1, n)), gram[0][0])
        ridge = RIDGE * float(m.finfo(trace.dtype).eps) * trace
        for i in range(n):
            gram[i][i] = gram[i][i] + ridge
        self._factors = _factorised(gram)
        before = self._solve([START[i % len(START)] for i in range(n)])
        smallest = self._solve(before)
        along, length = _dot(before, smallest), m.sqrt(_dot(smallest, smallest))
        settled = m.abs(along) > (1.0 - SETTLED) * length * m.sqrt(_dot(before, before))
        # Squares of singular values are eigenvalues of J^T J. Its trace is between the largest and n times the largest.
        least, cut = along / length / length, task_space.DIRECTION_TOLERANCE**2 * trace
        self.lost = settled & (least - ridge < 0.5 * cut / n)
        inverse_determinant = math.prod(self._factors[1], start=least)
        # The other eigenvalues' product is known, and the geometric mean of those above the second below their mean.
        others = math.prod([trace / max(n - 2, 1)] * (n - 2))
        clear = self.lost & (inverse_determinant * cut * others < 1.0)
        if possible(m, ~clear):  # no eigenvalue is less than the inverse of the inverse's trace
            clear = clear | (_inverse_trace(*self._factors) * cut < 1.0)
        self._direction = [m.where(self.lost, value / length, 0.0) for value in smallest]
        self._inverses: Scalar = None
        if set_aside(m, ~clear):
            return
        self.doubtful = m.where(~clear)
        if len(self.doubtful[0]):
            self._zeros = m.zeros_like(trace)
            rows = m.stack([self._in_doubt(column) for column in columns], 2)
            inverse = m.linalg.pinv(rows, rtol=task_space.DIRECTION_TOLERANCE)
            self._inverses = inverse @ m.swapaxes(inverse, 1, 2)  # of J^T J

    def solve(self, right: Sequence[Scalar], columns: Columns | None = None) -> list[Scalar]:
        """Solve J x = e for right-hand sides e, and return x as n components ``(...)``.

        Args:
            right: The right-hand sides, six components ``(...)``.
            columns: Columns of a J that has changed a little since it was factorised. Repeated solve steps with the old
                factors then converge to the point where the changed J^T maps the remaining error to zero.
        """
        projected = [_dot(column, right) for column in columns or self.columns]
        solution = _without(self._direction, self._solve(_without(self._direction, projected)))
        if self._inverses is not None:
            exact = self._m.einsum("kij,kj->ik", self._inverses, self._in_doubt(projected))
            for value, right_one in zip(solution, exact, strict=True):
                value[self.doubtful] = right_one
        return solution

    def _in_doubt(self, values: Sequence[Scalar]) -> Scalar:
        """Return the c components ``values`` at the k doubtful poses, as an array ``(k, c)``.

        At a doubtful pose it is unclear which singular values are to be cut off, so a singular value decomposition is
        used there. A component that is a plain number is repeated for each pose.
        """
        return self._m.stack([(self._zeros + value)[self.doubtful] for value in values], 1)

    def _solve(self, right: Sequence[Scalar]) -> list[Scalar]:
        """Return the solution x of L D L^T x = right, as n components, with the stored factors of J^T J."""
        lower, inverse_diagonal = self._factors
        values = [value * inverse for value, inverse in zip(_forward(lower, right), inverse_diagonal, strict=True)]
        for i in reversed(range(len(values))):
            for j in range(i + 1, len(values)):
                values[i] = values[i] - lower[j][i] * values[j]
        return values


def _dot(one: Sequence[Scalar], other: Sequence[Scalar]) -> Scalar:
    """Return the scalar product of two lists of components; products with the float 0.0 are not computed."""
    terms = [a * b for a, b in zip(one, other, strict=True) if not (_is_zero(a) or _is_zero(b))]
    return sum(terms[1:], terms[0]) if terms else 0.0


def _is_zero(value: Scalar) -> bool:
    """Return whether a component is the float 0.0, not an array."""
    return isinstance(value, float) and value == 0.0


def _factorised(gram: list[list[Scalar]]) -> tuple[list[list[Scalar]], list[Scalar]]:
    """Factorise the lower triangle ``gram`` as L D L^T; return L below its unit diagonal, and the inverse of D."""
    lower: list[list[Scalar]] = []
    inverse: list[Scalar] = []
    for *row, diagonal in gram:
        scaled = _forward(lower, row)  # L times D
        factors = [value * factor for value, factor in zip(scaled, inverse, strict=True)]
        for value, factor in zip(scaled, factors, strict=True):
            diagonal = diagonal - value * factor
        lower.append(factors)
        inverse.append(1.0 / diagonal)
    return lower, inverse


def _forward(lower: list[list[Scalar]], right: Sequence[Scalar]) -> list[Scalar]:
    """Solve L x = right; ``lower`` holds L below its diagonal, and the diagonal is 1."""
    solution: list[Scalar] = []
    for row, value in zip(lower, right, strict=True):
        for factor, known in zip(row, solution, strict=True):
            value = value - factor * known
        solution.append(value)
    return solution


def _inverse_trace(lower: list[list[Scalar]], inverse_diagonal: list[Scalar]) -> Scalar:
    """Compute the trace of the inverse of L D L^T: the sum of the squares in L^-1, weighted by D^-1."""
    total: Scalar = 0.0
    inverse: list[list[Scalar]] = []  # of L, below its diagonal
    for i, row in enumerate(lower):
        inverse.append([-sum((row[k] * inverse[k][j] for k in range(j + 1, i)), row[j]) for j in range(i)])
        total = total + inverse_diagonal[i] * sum((value * value for value in inverse[i]), 1.0)
    return total


def _without(direction: Sequence[Scalar], vector: Sequence[Scalar]) -> list[Scalar]:
    """Return ``vector`` without its part along the unit vector ``direction``."""
    along = _dot(direction, vector)
    return [value - along * part for value, part in zip(vector, direction, strict=True)]


# Arms that are followed by a Kalman filter each: where to aim, and what a look at the tool teaches.


def aimed(nominal: Geometry, filters: Sequence[FilterState], joints: Array) -> Array:
    """Compute the commands ``(N, n)`` that bring each of N arms to the pose of the nominal arm at a joint target.

    Each arm is modelled by the geometry that its Kalman filter estimates.

    Args:
        nominal: The nominal geometry.
        filters: Filter states, one per arm.
        joints: Joint targets ``(N, n)``, rad or m.
    """
    return np.stack([Compensator(nominal, state.geometry)(row) for state, row in zip(filters, joints, strict=True)])


def taught(
    filters: Sequence[FilterState], joints: Array, seen: Array, noise: MeasurementNoise, wander: float, seconds: float
) -> list[FilterState]:
    """Update the Kalman filter of each arm after a pause and one measurement of its tool position.

    Args:
        filters: Filter states before the pause, one per arm.
        joints: Commanded joints ``(N, n)``, rad or m.
        seen: Measured tool positions ``(N, 3)``, m.
        noise: Noise of the measurement, including errors that a geometry cannot explain.
        wander: Standard deviation of each parameter's random walk after one hour, as a multiple of the parameter's
            tolerance. It grows with the square root of time.
        seconds: Time since the previous measurement, s.
    """
    return [
        update(predict(state, random_walk(state, wander), seconds), q, at, noise)
        for state, q, at in zip(filters, joints, seen, strict=True)
    ]


BLOCK = 2048
"""Number of poses that are computed together; their arrays fit into the L1 and L2 caches of a core."""

NEGLIGIBLE = 1e-6
"""Increase of the expected error, m or rad, up to which a correction is still used; rounding causes as much."""


Residual = Callable[[Array], Array]
"""A residual model as a function: from joints ``(..., n)`` to pose errors ``(..., 6)``, m and rad, in world axes."""


@dataclass(frozen=True, eq=False)
class Compensator:
    """Map from joint targets to joint commands that bring the real arm to the poses of the nominal arm at the targets.

    Attributes:
        nominal: The geometry that the controller uses.
        identified: The calibrated geometry.
        residual: Terms and learnt residual of the calibration as one function, or None.
        iterations: Number of corrections. Each starts from the joints of the previous one, and all use the factors of
            one Jacobian. On the picking arm with the network of Qiao 2026, one correction leaves 1.4 um of the
            predicted error on average. Two corrections leave 0.9 um, because the correction of the joints changes the
            residual. Without a residual, one correction leaves 1 um and two leave nothing.
        single_precision: Whether corrections are computed in single precision if many poses are passed at once. This is
            faster and adds an error of 0.1 um.
        reservations: Reasons against using the compensator, by name (`pickenv.base.obey`).
        within95: Function of commands ``(..., n)`` that returns the bounds on 95 of 100 position errors, m, and
            attitude errors, rad, as counted on held-out rows; None if they are unknown.
        caution: The cautions of the calibration's verdict; None if there are none.
        arm: The arm's nominal geometry as its file gives it; None if it equals ``nominal``, except for base and tool.
    """

    nominal: Geometry
    identified: Geometry
    residual: Residual | None = None
    iterations: int = 2
    single_precision: bool = False
    reservations: Mapping[str, str] = field(default_factory=dict)
    within95: Callable[[Array], tuple[Array | None, Array | None]] | None = None
    caution: str | None = None
    arm: Geometry | None = None

    def refuse_another(self, arm: Arm) -> None:
        """Raise an `InputError` if an arm has another nominal geometry than the one that was calibrated."""
        design = self.arm or replace(self.nominal, base=arm.nominal.base, tool=arm.nominal.tool)
        arm.refuse_another(design, "the calibration is of an arm")

    def __call__(self, joints: ArrayLike) -> Array:
        """Compute joint commands ``(..., n)`` within the joint limits for joint targets ``(..., n)``, rad or m.

        Raises:
            InputError: If a target is not finite.
            ValueError: If targets have another number of joints.
        """
        joints = self.checked(joints)
        if joints.ndim == 1:
            return np.array(self._within_limits(math, self._corrected(math, joints.tolist())))
        rows = joints.reshape(-1, self.nominal.joints)
        blocks = [self._block(rows[a : a + BLOCK]) for a in range(0, len(rows), BLOCK)]
        return np.concatenate(blocks).reshape(joints.shape) if blocks else joints.copy()

    def checked(self, joints: ArrayLike) -> Array:
        """Return joint targets ``(..., n)`` as an array, after checking that they are finite and have n joints."""
        joints = np.asarray(joints, dtype=float)
        split_joints(self.nominal.joints, joints)  # checks the number of joints
        if not math.isfinite(joints.sum()):  # the cheapest question; no joints are so large that they overflow
            *row, joint = np.argwhere(~np.isfinite(joints))[0].tolist()
            place = f" of row {', '.join(map(str, row))}" if row else ""
            name, value = self.nominal.joint_names[joint], joints[(*row, joint)]
            raise InputError(f"the target of {name}{place} is {value}; give finite joint targets, rad or m")
        return joints

    def compiled(self, count: int) -> Callable[[ArrayLike], Array]:
        """Return this map compiled to machine code, for repeated calls with ``count`` targets ``(count, n)``.

        Compiled and plain map give equal commands up to rounding. There is no machine code for single precision: such a
        compensator is returned itself.

        Raises:
            MissingExtra: If llvmlite is not installed.
        """
        require("llvmlite")
        if self.single_precision:
            return self
        from pickenv.arm.kinematics.machine_code import FLAG, SYMBOLS, Compiled, Trace

        trace = Trace()
        corrections = self._corrected(SYMBOLS, trace.inputs("targets", self.nominal.joints))
        outputs = self._within_limits(SYMBOLS, corrections)
        doubt = reduce(or_, trace.exceptions, False)
        code = Compiled(trace, trace.outputs("commands", outputs) + trace.outputs("doubts", [doubt], FLAG), count)

        targets, commands = np.empty((2, self.nominal.joints, count))
        doubts = np.empty(count, dtype=np.bool_)
        go = code.bound({"targets": targets, "commands": commands, "doubts": doubts}, count)

        def run(joints: ArrayLike) -> Array:
            targets[:] = (joints := self.checked(joints)).T
            go()
            found = commands.T.copy()
            if doubts.any():  # the few poses that need more than operations
                found[doubts] = self(joints[doubts])
            return found

        return run

    def predict(self, joints: ArrayLike) -> Pose:
        """Predict the pose of the real tool at joint commands ``(..., n)``: identified pose plus residual."""
        pose = forward(self.identified, joints)
        return pose if self.residual is None else displace_pose(pose, self.residual(np.asarray(joints, dtype=float)))

    @cached_property
    def _chains(self) -> tuple[Chain, Chain]:
        """The nominal and the identified geometry as chains for the forward kinematics."""
        return chain_of(self.nominal), chain_of(self.identified)

    def _block(self, rows: Array) -> Array:
        """Compute commands for targets ``rows`` ``(N, n)``; single precision rounds only the corrections."""
        target = np.ascontiguousarray(rows.T, dtype=np.float32 if self.single_precision else np.float64)
        correction = np.stack(self._corrected(np, list(target)), axis=1) - target.T
        return np.asarray(np.clip(rows + correction, self.nominal.lower, self.nominal.upper))

    def _within_limits(self, m: ModuleType, joints: Sequence[Scalar]) -> list[Scalar]:
        """Return joints clipped to their limits, since a command can be an uncorrected target beyond the limits."""
        limits = zip(self.nominal.lower.tolist(), self.nominal.upper.tolist(), strict=True)
        return [clipped(m, q, *limit) for q, limit in zip(joints, limits, strict=True)]

    def _corrected(self, m: ModuleType, target: Sequence[Scalar]) -> Sequence[Scalar]:
        """Compute commands for a target, one item per joint: floats if ``m`` is math, arrays ``(N,)`` if numpy."""
        learnt = None if self.residual is None else partial(_learnt, m, self.residual)
        return corrected(m, self.nominal, self._chains, target, self.iterations, learnt)


def _learnt(m: ModuleType, residual: Residual, joints: Sequence[Scalar]) -> list[Scalar]:
    """Return the six components of the residual at joints: numbers, or arrays ``(N,)``.

    Args:
        m: ``math`` for numbers, ``numpy`` for arrays, or the module that records operations for machine code.
        residual: Terms and learnt residual as one function.
        joints: The joints: n components, rad or m.
    """
    if m is math:
        return list(residual(np.array(joints)).tolist())

    def fill(joints: Array, found: Array) -> None:
        """Write the residual ``(6, N)`` at joints ``(n, N)`` into ``found``."""
        found[:] = residual(joints.T).T

    noted = outside(m, fill, joints, 6)
    if noted is not None:
        return list(noted)
    rows = np.stack(joints)
    return list(np.ascontiguousarray(residual(rows.T).T, dtype=rows.dtype))


def corrected(
    m: ModuleType,
    nominal: Geometry,
    chains: tuple[Chain, Chain],
    target: Sequence[Scalar],
    iterations: int,
    residual: Callable[[Sequence[Scalar]], Sequence[Scalar]] | None = None,
) -> Sequence[Scalar]:
    """Compute commands for targets as `Compensator` does, for any array module and number of arms.

    Args:
        m: ``math``, ``numpy``, ``torch``, or the module that records operations for machine code.
        nominal: The geometry that the controller uses, for joint types and limits.
        chains: The nominal chain and the identified chain. The identified chain may hold many arms.
        target: Joint targets: n components ``(...)``, rad or m.
        iterations: Number of corrections, as in `Compensator`.
        residual: Function from joints, n components, to the residual, six components in m and rad; or None.

    Returns:
        The commands: n components ``(...)``, rad or m.
    """
    nominal_chain, identified = chains
    limits = list(zip(nominal.lower.tolist(), nominal.upper.tolist(), strict=True))
    weight = task_space.attitude_weight(nominal.joints)
    command, goal, learnt, solve, best = target, tool_frame(m, nominal_chain, target), None, None, None
    for _ in range(iterations):
        links = frames(m, identified, command)
        tool = attach(links[-1], identified.tool)
        columns = [_weighed(weight, column) for column in task_space.jacobian_columns(nominal, links, tool)]
        solve = solve or _solver(m, columns)
        error = _weighed(weight, task_space.frame_error(m, tool, goal, task_space.small_rotation))
        if residual is not None:
            if learnt is None:
                learnt = _weighed(weight, residual(_moved(m, command, solve(error, columns), limits)))
            error = _less(error, learnt)
        best = _nearer(m, best, _expected(m, command, error))
        command = _moved(m, command, solve(error, columns), limits)
    if best is None:
        return target
    tool = tool_frame(m, identified, command)
    error = _weighed(weight, task_space.frame_error(m, tool, goal, task_space.small_rotation))
    return _nearer(m, best, _expected(m, command, error if learnt is None else _less(error, learnt)))[0]


def _weighed(weight: float, parts: Sequence[Scalar]) -> Sequence[Scalar]:
    """Return the six components of an error or Jacobian column, the last three (attitude) multiplied by ``weight``."""
    return parts if weight == 1.0 else [*parts[:3], *(weight * part for part in parts[3:])]


Expected = tuple[Sequence[Scalar], Scalar]
"""Joints, and the norm of the pose error expected there; attitude errors are weighted as in the task."""


def _expected(m: ModuleType, joints: Sequence[Scalar], error: Sequence[Scalar]) -> Expected:
    """Return ``joints`` with the norm of the pose error that is expected there; ``error`` has its six components."""
    x, y, z, u, v, w = error
    return joints, m.sqrt(x * x + y * y + z * z + u * u + v * v + w * w)


def _nearer(m: ModuleType, one: Expected | None, other: Expected) -> Expected:
    """Return, for each pose, ``one`` if its error is smaller by at least `NEGLIGIBLE`, else ``other``.

    If ``one`` is None, the result is ``other``.
    """
    if one is None:
        return other
    nearer = other[1] < one[1] + NEGLIGIBLE
    if m is math:
        return other if nearer else one
    joints = [m.where(nearer, after, before) for after, before in zip(other[0], one[0], strict=True)]
    return joints, m.where(nearer, other[1], one[1])


def _less(error: Sequence[Scalar], learnt: Sequence[Scalar]) -> list[Scalar]:
    """Return a pose error ``error`` minus the residual ``learnt``, component by component."""
    return [part - expected for part, expected in zip(error, learnt, strict=True)]


def _moved(
    m: ModuleType, joints: Sequence[Scalar], step: Sequence[Scalar], limits: Sequence[tuple[float, float]]
) -> list[Scalar]:
    """Return ``joints`` plus ``step``, clipped to the joint limits."""
    return [clipped(m, q + dq, low, high) for q, dq, (low, high) in zip(joints, step, limits, strict=True)]


def _solver(m: ModuleType, columns: Columns) -> Callable[[Sequence[Scalar], Columns], list[Scalar]]:
    """Return a function that computes the joint steps which remove a pose error.

    The function has two arguments: the six components of the error, and the columns of this Jacobian or of one close
    to it. It returns the n components of the joint steps.
    """
    if m is not math:
        return TruncatedSolver(columns, m).solve
    root = task_space.truncated_inverse(np.array(columns).T)
    inverse = root @ root.T  # of J^T J
    return lambda error, columns: (inverse @ (np.array(columns) @ error)).tolist()
