"""Rank-aware iterated least squares, Qiao 2026 eqs (11)-(12): identify a geometry from measurements.

Redundant parameters are detected at the start and left out. The normal equations of eq (11) are replaced by a QR
solution. A redundant model therefore gives the same geometry as its identifiable subset. The normal equations would
give a geometry that is wrong by metres.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from pickenv.arm import FRAME_PARAMETERS, Array, Geometry
from pickenv.base import InputError, single_threaded
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel
from pickenv.calibration.model.measurements import FRAME_TOLERANCES, Measurements, frame_columns, random_joints
from pickenv.calibration.model.noise_and_priors import PriorModel, RowNoise
from pickenv.calibration.model.observations import Observations

PROBES = 60
"""Number of random poses at which the rank of a kind of measurements is computed."""

OFFSET = 1e-3
"""Parameters have converged when a further step would move them by less than this share of their uncertainty."""


NEAR = 5.0
"""The Jacobian is reused after a step below this many uncertainties, if steps also shrink tenfold each time."""

REDUNDANCY_TOLERANCE = 1e-3
"""Share of the largest column norm. A parameter is redundant if earlier columns explain all of its scaled column but a
part whose norm is below this share."""

BLOCK = 1600
"""Number of equations that `triangle` reduces at a time; so many fit into the processor's cache."""

NOTHING = 1e-7
"""Redundancy tolerance if every parameter has a prior; a parameter below it keeps its starting value."""


@dataclass(frozen=True, eq=False)
class Identification:
    """An arm identified from measurements, with the statistics of the fit.

    Attributes:
        arm_model: The identified geometry, with the coefficients of its terms.
        unknowns: Identified values, by name, of the measurements' own unknowns, such as places of reflectors, anchors
            and sockets, in SI units (a lens' numbers in px).
        identifiability: Which parameters were identified and which were dropped as redundant, and the kept parameters
            that have the same effects as the dropped ones.
        delta: Identified minus starting values, in the order of ``identifiability.names`` (0 for dropped parameters).
        covariance: Covariance of the kept parameters, in the order of ``identifiability.kept_names``. With priors it is
            the posterior covariance. Without priors it comes from the residual's scatter, and is NaN without spare
            equations.
        chi_square: Sum of squared whitened residuals.
        degrees_of_freedom: Equations minus identified parameters.
        converged: Whether the last step was negligible.
        residual_rms: Weighted residual RMS before each iteration and after the last.
        iterates: The arm, and the measurements' own unknowns ``(u,)``, before each iteration and after the last.
        solve_seconds: Time of the solution alone, s.
        poses: Number of poses used.
        kind: Kinds of the measurements, such as "pose" or "position".
        prior: The parameters' priors; None if there were none.
        noise: The estimated scatter of the rows; None if it was not estimated.
    """

    arm_model: ArmModel
    unknowns: dict[str, float]
    identifiability: Identifiability
    delta: Array
    covariance: Array
    chi_square: float
    degrees_of_freedom: int
    converged: bool
    residual_rms: tuple[float, ...]
    iterates: tuple[tuple[ArmModel, Array], ...]
    solve_seconds: float
    poses: int
    kind: str
    prior: PriorModel | None = None
    noise: RowNoise | None = None

    @property
    def geometry(self) -> Geometry:
        """The identified geometry."""
        return self.arm_model.geometry

    @property
    def scatter(self) -> float:
        """Square root of chi-square per degree of freedom: the residual's scatter, in stated standard uncertainties."""
        return float(np.sqrt(self.chi_square / max(self.degrees_of_freedom, 1)))

    @property
    def standard_deviation(self) -> Array:
        """Standard deviation of every parameter, in the order of ``identifiability.names``; NaN for dropped ones."""
        std = np.full(len(self.identifiability.names), np.nan)
        std[self.identifiability.kept] = np.sqrt(np.diag(self.covariance))
        return std

    @property
    def prior_std(self) -> Array:
        """Prior standard deviation of every parameter, in the order of ``identifiability.names``; infinite if none."""
        width = {} if self.prior is None else dict(zip(self.prior.parameters.names, self.prior.width, strict=True))
        return np.array([width.get(name, np.inf) for name in self.identifiability.names])

    @property
    def narrowed(self) -> Array:
        """Share by which measuring reduced the standard deviation of every parameter, 0 to 1; 0 for dropped ones."""
        with np.errstate(invalid="ignore"):
            return np.nan_to_num(np.clip(1.0 - self.standard_deviation / self.prior_std, 0.0, 1.0))

    @property
    def spent(self) -> float:
        """Effective number of parameters that the measurements, and not the priors, determine."""
        width = self.prior_std[self.identifiability.kept]
        return float(np.sum(1.0 - np.clip(np.diag(self.covariance) / width**2, 0.0, 1.0)))


def unknowns_of(found: Identification, observations: Observations) -> Array:
    """Return the identified values of a data set's own unknowns ``(u,)``.

    Raises:
        InputError: If the data set has an unknown that did not occur in the fitted rows.
    """
    names = observations.unknowns()
    for name in (name for name in names if name not in found.unknowns):
        raise InputError(
            f"{observations.source}: {name.removesuffix('_x')} occurs in no row that was fitted; give rows of it to "
            "fit, or leave it out"
        )
    return np.array([found.unknowns[name] for name in names])


def is_angle(name: str) -> bool:
    """Return whether a parameter is an angle, by its name."""
    return name.startswith(("alpha", "theta", "beta")) or name.partition("_")[2].startswith("r")


@single_threaded()
def identify(
    model: ErrorModel,
    start: Geometry | ArmModel,
    data: Measurements | Sequence[Observations],
    *,
    max_iterations: int = 20,
    whiten: Callable[[Array], Array] | None = None,
    rank_tolerance: float = REDUNDANCY_TOLERANCE,
    every: bool = False,
) -> Identification:
    """Identify the model's parameters by rank-aware, weighted Gauss-Newton.

    Args:
        model: The parameters.
        start: Geometry, or geometry with parametric terms, to start from, near the data (see
            `pickenv.calibration.identification.robust`).
        data: Poses or positions, or any mix of kinds; the kinds' own unknowns are identified too.
        max_iterations: Largest number of steps; three or four are usual. It is doubled if the rank is judged a second
            time, that is if the data have unknowns of their own and ``every`` is False.
        whiten: Function that weighs equations ``(E, ...)`` again, by robust weights or by estimated noise
            (`pickenv.calibration.model.noise_and_priors.RowNoise.whiten`). The equations are in the order of the data,
            in stated standard uncertainties.
        rank_tolerance: Threshold below which a parameter is redundant, see `REDUNDANCY_TOLERANCE`.
        every: Whether every parameter has a prior among the data. Then all are kept. The covariance is the
            posterior's, for equations whitened to unit variance.

    Returns:
        The identification; ``converged`` is False if the last step was not negligible.

    Raises:
        InputError: If there are too few poses for the model's rank.
    """
    begin = time.perf_counter()
    sets = tuple(data) if isinstance(data, Sequence) else (data,)
    arm = ArmModel.of(start)
    unknowns = [part.start(arm) for part in sets]
    own_names = tuple(name for part in sets for name in part.unknowns())
    names = own_names + model.names
    tolerance = np.concatenate([*(part.tolerances() for part in sets), model.tolerance])
    whiten = whiten or np.asarray
    poses = sum(len(part.joints) for part in sets)

    def residual() -> Array:
        return whiten(np.concatenate([part.residual(arm, values) for part, values in zip(sets, unknowns, strict=True)]))

    def linearised() -> tuple[Array, Array, Array]:
        columns = whiten(_jacobian(model, sets, arm, unknowns, tolerance))
        return columns, *triangle(columns, weighted)

    def rank(arm: ArmModel, matrix: Array) -> Identifiability:
        return identifiable_parameters(model, sets, arm, unknowns, matrix, names, tolerance, rank_tolerance)

    weighted = residual()
    columns, matrix, right = linearised()
    if every:
        base = identifiability(matrix, names, tolerance, poses, NOTHING)
    else:
        base = rank(arm, matrix if any(part.framed for part in sets) else columns)
        _enough_poses(model, arm, sets, unknowns, base.rank, len(weighted))
    first, iterates, history = arm, [(arm, np.concatenate(unknowns))], [rms_of(weighted)]
    converged, near, damping, offset, rank_is_final = False, False, 0.0, np.inf, every or not own_names
    for _ in range(max_iterations if rank_is_final else 2 * max_iterations):
        full_step = _solve(matrix[:, base.kept], right, 0.0)
        step = _solve(matrix[:, base.kept], right, damping) if damping else full_step
        change = np.zeros(len(names))
        change[base.kept] = step * tolerance[base.kept]
        before = arm, unknowns, weighted
        *steps, of_arm = np.split(change, np.cumsum([len(values) for values in unknowns]))
        arm = arm.moved(model.columns, of_arm)
        unknowns = [values + step for values, step in zip(unknowns, steps, strict=True)]
        weighted = residual()
        rms = rms_of(weighted)
        # A shortened step proves nothing: what counts is what the whole one would still explain.
        explained = matrix[:, base.kept] @ full_step
        still, negligible, better, finished = judged_step(full_step, explained, before[2], history[-1], rms)
        if not better:
            arm, unknowns, weighted = before
            # Worse by rounding alone is the minimum. Terms move with the geometry, which the Jacobian leaves out, so
            # that near it even short steps may make it worse: then what is left counts.
            if negligible or (damping and still < (30 * OFFSET) ** 2):
                converged = True
                break
            if near:  # the derivatives are those of an earlier step
                near, (columns, matrix, right) = False, linearised()
            elif damping * 10.0 > 1e9:
                break
            else:  # Levenberg: a step that makes it worse is shortened until it helps
                damping = max(damping * 10.0, 1e-3)
            continue
        history.append(rms)
        iterates.append((arm, np.concatenate(unknowns)))
        settled = negligible or (damping == 0.0 and finished)
        if settled and rank_is_final:
            converged = True
            break
        near = every and damping == 0.0 and not settled and bool(still < min(NEAR**2, offset / 100.0))
        offset = still
        if near:
            q, r = np.linalg.qr(matrix[:, base.kept])
            right = q @ solve_triangular(r, (columns.T @ weighted)[base.kept], trans=1)
        else:
            columns, matrix, right = linearised()
        if settled:
            # Where a kind's unknowns start, a parameter may have no effect that has one where they end: a tip that
            # starts in the flange's middle hides how the flange turns. So the rank is judged once more with them, of
            # the arm as it started: axes that were parallel are told apart by their errors alone, which is too weak.
            rank_is_final = True
            larger = rank(first, whiten(_jacobian(model, sets, first, unknowns, tolerance)))
            if larger.rank <= base.rank:
                converged = True
                break
            base = larger
        damping = damping / 10.0 if damping > 1e-6 else 0.0
    rows = weighted
    if every:  # of the rows alone, as stated
        measured = [(part, values) for part, values in zip(sets, unknowns, strict=True) if len(part.joints)]
        rows = np.concatenate([part.residual(arm, values) for part, values in measured])
    chi_square, freedom = float(rows @ rows), len(rows) - base.rank
    variance = 1.0 if every else chi_square / freedom if freedom > 0 else np.nan  # of residuals: GUM, type A
    end, (_, begun) = np.concatenate(unknowns), iterates[0]
    return Identification(
        arm_model=arm,
        unknowns=dict(zip(own_names, end.tolist(), strict=True)),
        identifiability=base,
        delta=np.concatenate([end - begun, first.difference(arm)[model.columns]]),
        covariance=_covariance(matrix[:, base.kept], tolerance[base.kept], variance),
        chi_square=chi_square,
        degrees_of_freedom=freedom,
        converged=converged,
        residual_rms=tuple(history),
        iterates=tuple(iterates),
        solve_seconds=time.perf_counter() - begin,
        poses=poses,
        kind="+".join(dict.fromkeys(part.kind for part in sets if len(part.joints))),
    )


def identify_converged(
    model: ErrorModel, start: Geometry | ArmModel, data: Measurements | Sequence[Observations]
) -> Identification:
    """Run `identify`; if it does not converge, run it again without parameters that the data hardly determine.

    The arguments are those of `identify`.

    Raises:
        InputError: If there are too few poses for the model's rank, or none of the runs converges.
    """
    for factor in (1.0, 3.0, 10.0):
        solution = identify(model, start, data, max_iterations=60, rank_tolerance=factor * REDUNDANCY_TOLERANCE)
        if solution.converged:
            return solution
    first = data[0] if isinstance(data, Sequence) else data
    raise InputError(
        f"{first.source}: the identification did not converge (residual {solution.residual_rms[-1]:.3g} standard "
        "uncertainties); check units, joint signs and outliers, or measure more varied poses"
    )


def judged_step(step: Any, explained: Any, weighted: Any, before: Any, after: Any) -> tuple[Any, Any, Any, Any]:
    """Apply the stop rule of Gauss-Newton steps, to NumPy arrays or torch tensors.

    Args:
        step: The undamped step, in tolerances ``(..., K)``.
        explained: The Jacobian times the step ``(..., R)``.
        weighted: Whitened residuals before the step ``(..., R)``.
        before: Root mean square of the residuals before the step ``(...)``.
        after: Root mean square of the residuals after the step ``(...)``.

    Returns:
        Four values for one arm or many ``(...)``. The first is the squared relative offset (Bates and Watts 1981). It
        is the part of the residual that the whole step would still explain, per parameter and relative to the scatter.
        Steps in directions that the data hardly determine do not count in it. The second says whether a further step
        would be negligible. The third says whether the residual did not grow, except by rounding (False for NaN). The
        fourth says whether the step, if it was undamped and the residual did not grow, led to the minimum.
    """
    rows, parameters = weighted.shape[-1], step.shape[-1]
    scatter = (weighted**2).sum(-1) / max(rows - parameters, 1)
    offset = (explained**2).sum(-1) / (max(parameters, 1) * (scatter + 1e-300))
    negligible = (abs(step) < 1e-5).all(-1) | (offset < OFFSET**2)
    return offset, negligible, after <= before * (1 + 1e-9), negligible | (before - after <= 1e-7 * after)


def _jacobian(
    model: ErrorModel, sets: Sequence[Observations], arm: ArmModel, unknowns: Sequence[Array], tolerance: Array
) -> Array:
    """Return the stacked, whitened Jacobian ``(E, own + P)`` of several data sets.

    The columns of the data sets' own unknowns come first, then the columns of the P parameters.

    Args:
        model: The parameters.
        sets: The data sets.
        arm: The arm at which the Jacobian is taken.
        unknowns: Values of each data set's own unknowns at which the Jacobian is taken.
        tolerance: Factor on each column ``(own + P,)``.
    """
    parts = [part.jacobian(arm, values) for part, values in zip(sets, unknowns, strict=True)]
    jacobian = np.zeros((len(tolerance), sum(len(by_arm) for by_arm, _ in parts))).T
    row, column, first = 0, 0, len(tolerance) - len(model.columns)
    for by_arm, by_own in parts:
        rows, places = slice(row, row + len(by_arm)), slice(column, column + by_own.shape[1])
        jacobian[rows, places] = by_own * tolerance[places]
        np.multiply(by_arm.T[model.columns], tolerance[first:, None], out=jacobian.T[first:, rows])
        row, column = rows.stop, places.stop
    return jacobian


def _solve(matrix: Array, right: Array, damping: float) -> Array:
    """Compute the damped least-squares solution ``(K,)`` of linear equations by QR.

    Args:
        matrix: Matrix of the equations ``(rows, K)``.
        right: Right-hand side ``(rows,)``.
        damping: Levenberg's damping, 0 for none. Each unknown gets one more equation, which pulls it towards zero with
            the weight sqrt(damping) times the RMS norm of the columns.
    """
    if damping:
        ridge = np.sqrt(damping) * np.linalg.norm(matrix) / np.sqrt(matrix.shape[1])
        matrix = np.vstack([matrix, ridge * np.eye(matrix.shape[1])])
        right = np.concatenate([right, np.zeros(matrix.shape[1])])
    count = matrix.shape[1]
    # The last column of r is q.T @ right, so that q itself is not needed.
    r = np.asarray(np.linalg.qr(np.column_stack([matrix, right]), mode="r"))
    return np.asarray(np.linalg.solve(r[:count, :count], r[:count, count]))


def triangle(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Reduce least-squares equations to a triangular system with the same solution.

    Each block of about `BLOCK` equations is reduced by QR, then the triangles of all blocks together.

    Args:
        matrix: Matrix of the equations ``(rows, P)``.
        right: Right-hand side ``(rows,)``.

    Returns:
        Matrix and right-hand side of at most P + 1 equations.
    """
    ends = np.linspace(0, len(right), max(len(right) // BLOCK, 1) + 1).astype(int).tolist()
    parts = [np.asarray(np.linalg.qr(np.column_stack([matrix[i:j], right[i:j]]), "r")) for i, j in pairwise(ends)]
    r = parts[0] if len(parts) == 1 else np.asarray(np.linalg.qr(np.vstack(parts), mode="r"))
    return r[:, :-1], r[:, -1]


def rms_of(values: Array) -> float:
    """Return the root mean square of an array."""
    return float(np.sqrt(np.mean(values**2)))


def _covariance(matrix: Array, scale: Array, variance: float) -> Array:
    """Compute the parameters' covariance ``(P, P)`` from least-squares equations.

    Args:
        matrix: Matrix of the equations ``(rows, P)``.
        scale: Factor on each column ``(P,)``.
        variance: Variance of each equation's error.
    """
    inverse_r = np.linalg.inv(np.linalg.qr(matrix, mode="r"))
    return np.asarray(variance * (inverse_r @ inverse_r.T * np.outer(scale, scale)))


def _enough_poses(
    model: ErrorModel, arm: ArmModel, sets: Sequence[Observations], unknowns: Sequence[Array], rank: int, rows: int
) -> None:
    """Refuse data sets with too few equations for the parameters that such data identify at random poses.

    Args:
        model: The parameters.
        arm: The arm before the fit.
        sets: The data sets.
        unknowns: Values of each data set's own unknowns.
        rank: Number of parameters that the data identify at their own poses.
        rows: Number of equations.

    Raises:
        InputError: If there are too few equations.
    """
    if rows >= 2 * (len(model.names) + sum(len(values) for values in unknowns)):
        return  # whatever the rank elsewhere, there are enough
    part, full = sets[0], rank
    if len(sets) == 1 and not part.stations:  # stations cannot be asked at other poses
        probe = part.imagined(random_joints(arm.geometry, PROBES, np.random.default_rng(0)))
        links = model.some(model.columns < len(arm.geometry.parameter_names))
        tolerance, bare = np.concatenate([part.tolerances(), links.tolerance]), ArmModel.of(arm.geometry)
        matrix, names = _jacobian(links, [probe], bare, unknowns, tolerance), (*part.unknowns(), *links.names)
        full = max(full, identifiable_parameters(links, [probe], bare, unknowns, matrix, names, tolerance).rank)
    if rows <= full or (part.kind in ("pose", "position") and rank < full and rows < 2 * full):
        poses = sum(len(part.joints) for part in sets)
        needed = -int(-2 * full // (rows / poses))
        raise InputError(
            f"{part.source}: {poses} poses give {rows} equations, too few for the {full} parameters that {part.kind} "
            f"measurements identify; measure at least {needed} poses"
        )


# Which parameters the data can tell apart: scaled QR redundancy, Qiao 2026 eqs (9)-(10), made independent of units.
# Columns are taken in the model's order; a column that the kept ones before it already explain is dropped, and the
# combination that absorbs it is named. The count does not depend on the order, the choice within a tied group does.


@dataclass(frozen=True, eq=False)
class Identifiability:
    """The result of `identifiability`: which parameters are identifiable, and which are not.

    Attributes:
        names: All parameters, in order.
        kept: Indices, from 0, of the kept parameters, a largest identifiable subset (the base set).
        dropped: The dropped parameters by name. Each has a dictionary of deviations of kept parameters, by name, m or
            rad. Together they have the same effect as a deviation of 1 m or 1 rad of the dropped parameter. The
            dictionary is empty if the dropped parameter has no effect on the measurements.
        r_diagonal: Absolute diagonal ``(P,)`` of R in the QR decomposition of the Jacobian (Qiao 2026 eq (9)), one
            number for each parameter. The Jacobian is of all rows, with scaled columns. The number is about 0 for
            a dropped parameter. Divided by the mean, it is the paper's ratio phi (eq (10)).
        singular_values: Singular values ``(K,)`` of the same Jacobian with the columns of the kept parameters alone,
            divided by the square root of the number of poses.
    """

    names: tuple[str, ...]
    kept: NDArray[np.int64]
    dropped: dict[str, dict[str, float]]
    r_diagonal: Array
    singular_values: Array

    @property
    def rank(self) -> int:
        """Number of identifiable parameters."""
        return len(self.kept)

    @property
    def condition(self) -> float:
        """Condition number of the Jacobian with the scaled columns of the kept parameters."""
        return float(self.singular_values[0] / self.singular_values[-1])

    @property
    def kept_names(self) -> tuple[str, ...]:
        """Names of the kept parameters, a largest identifiable subset (the base set)."""
        return tuple(self.names[k] for k in self.kept)


def identifiability(
    matrix: Array, names: tuple[str, ...], tolerance: Array, poses: int, rank_tolerance: float = REDUNDANCY_TOLERANCE
) -> Identifiability:
    """Find a largest identifiable subset of parameters.

    Args:
        matrix: Stacked Jacobian ``(rows, P)``, rows weighted, columns scaled by ``tolerance``.
        names: Names of the parameters. If parameters are redundant, the earlier parameters are kept.
        tolerance: Scale of each parameter ``(P,)``, m or rad.
        poses: Number of poses that the rows come from.
        rank_tolerance: See `REDUNDANCY_TOLERANCE`.
    """
    r = np.asarray(np.linalg.qr(matrix, mode="r"))  # columns of the same lengths and angles, in fewer rows
    least = rank_tolerance * np.max(np.linalg.norm(r, axis=0))
    basis = np.zeros((len(r), 0))
    diagonal = np.zeros(len(names))
    for k in range(len(names)):
        added = r[:, k]
        for _ in range(2):  # twice is enough for orthogonality to the last digit (Kahan, Parlett)
            added = added - basis @ (basis.T @ added)
        diagonal[k] = np.linalg.norm(added)
        if diagonal[k] > least:
            basis = np.column_stack([basis, added / diagonal[k]])
    adds = diagonal > least
    base = np.flatnonzero(adds)
    triangle = basis.T @ r[:, base]
    dropped = {}
    for k in np.flatnonzero(~adds).tolist():
        share = solve_triangular(triangle, basis.T @ r[:, k]) * tolerance[base] / tolerance[k]
        scaled = np.abs(share) * tolerance[k] / tolerance[base]
        dropped[names[k]] = {names[j]: float(c) for j, c, s in zip(base, share, scaled, strict=True) if s > 1e-3}
    singular_values = np.linalg.svd(r[:, base], compute_uv=False) / np.sqrt(poses)
    return Identifiability(names, base, dropped, diagonal, singular_values)


# Measurements without a frame (wires, sockets) cannot see where arm and anchors stand together: hold the base still.
# Left free, that common motion is seen through the residuals alone: enough to pass for an identifiable parameter at
# the start, and nothing at all at the minimum. What the base could do as well (alpha0, a0, theta1, d1) is held with
# it. Where no length is known either (one point touched, a plane), an arm that shrinks to nothing explains all: hold
# its longest link, and so its size.


def identifiable_parameters(
    model: ErrorModel,
    sets: Sequence[Observations],
    arm: ArmModel,
    unknowns: Sequence[Array],
    matrix: Array,
    names: tuple[str, ...],
    tolerance: Array,
    rank_tolerance: float = REDUNDANCY_TOLERANCE,
) -> Identifiability:
    """Determine the `identifiability` of parameters and unknowns from several data sets together.

    If no instrument has a frame, the base counts as fixed. If none knows a length, the longest link counts as fixed.

    Args:
        model: The parameters.
        sets: The data.
        arm: The arm at which the Jacobian was computed.
        unknowns: Values of the data's own unknowns at which the Jacobian was computed.
        matrix: Stacked, scaled Jacobian ``(rows, own + P)``, the data's own unknowns first.
        names: Names of the Jacobian's columns.
        tolerance: Scale of each column, m or rad.
        rank_tolerance: See `REDUNDANCY_TOLERANCE`.
    """
    poses, geometry = sum(len(part.joints) for part in sets), arm.geometry
    fixed: dict[str, dict[str, float]] = {}
    if not any(part.framed for part in sets):
        by_arm = np.concatenate([part.jacobian(arm, values)[0] for part, values in zip(sets, unknowns, strict=True)])
        base = [f"base_{name}" for name in FRAME_PARAMETERS]
        further = np.array([name not in base for name in model.names])
        others, by_model = model.some(further), matrix[:, len(names) - len(model.names) :]
        columns = np.hstack([by_arm[:, frame_columns(geometry, "base")] * FRAME_TOLERANCES, by_model[:, further]])
        scales = np.r_[FRAME_TOLERANCES, others.tolerance]
        chain = identifiability(columns, (*base, *others.names), scales, poses, rank_tolerance)
        fixed = chain.dropped | {name: {} for name in base}
    free = np.where([name in fixed for name in names], 0.0, matrix)
    result = identifiability(free, names, tolerance, poses, rank_tolerance)
    if not any(part.sized for part in sets):
        size = _longest_link(geometry, result)
        free = np.where([name in size for name in names], 0.0, free)
        result, fixed = identifiability(free, names, tolerance, poses, rank_tolerance), fixed | size
    return replace(result, dropped={name: fixed.get(name, absorbed) for name, absorbed in result.dropped.items()})


def _longest_link(geometry: Geometry, visible: Identifiability) -> dict[str, dict[str, float]]:
    """Return the longest length that ``visible`` keeps, and a change of the other kept lengths with the same effect.

    The dictionary is like `Identifiability.dropped`: the change is per metre of the longest length. It is empty if
    ``visible`` keeps no length.
    """
    names = [f"a{i}" for i in range(geometry.links)] + [f"d{i + 1}" for i in range(geometry.links)]
    values = dict(zip(names, [*geometry.a, *geometry.d], strict=True))
    lengths = {name: float(values[name]) for name in visible.kept_names if values.get(name, 0.0) != 0.0}
    if not lengths:
        return {}
    longest = max(lengths, key=lambda name: abs(lengths[name]))
    return {longest: {name: -value / lengths[longest] for name, value in lengths.items() if name != longest}}


# How well a data set tells the parameters: observability indices O1-O5 from the Jacobian's singular values. O1 Borm
# and Menq 1991, O2 Driels and Pathre 1990, O3 Nahvi, Hollerbach and Hayward 1994, O4 Nahvi and Hollerbach 1996, O5
# Sun and Hollerbach 2008. Rows in standard uncertainties, columns in tolerances, so the indices have no unit.


def observability(singular_values: Array, poses: int) -> dict[str, float]:
    """Return the observability indices of m parameters from n poses; larger is better, except for "condition".

    Args:
        singular_values: Singular values ``(m,)`` of the scaled stacked Jacobian of the identifiable parameters.
        poses: Number of poses stacked.

    Returns:
        The indices by name, with singular values s1 (largest) to sm. Index "o1" is (s1 … sm)^(1/m) / sqrt(n), with the
        geometric mean that a D-optimal set maximises. Index "o2" is sm / s1, the inverse condition number. Index "o3"
        is sm, which shows how well the worst combination is determined. Index "o4" is sm^2 / s1, noise amplification.
        Index "o5" is 1 / sum(1 / si), related to A-optimality. Entry "condition" is s1 / sm, and entry "poses" is n.

    Raises:
        ValueError: If a singular value is not above zero: such parameters are not identifiable and must be left out.
    """
    s = np.sort(np.asarray(singular_values, dtype=float))[::-1]
    if not len(s) or s[-1] <= 0:
        raise ValueError("observability is defined for identifiable parameters, whose singular values are above zero")
    return {
        "o1": float(np.exp(np.mean(np.log(s))) / np.sqrt(poses)),
        "o2": float(s[-1] / s[0]),
        "o3": float(s[-1]),
        "o4": float(s[-1] ** 2 / s[0]),
        "o5": float(1.0 / np.sum(1.0 / s)),
        "condition": float(s[0] / s[-1]),
        "poses": poses,
    }
