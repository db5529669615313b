"""The posterior of all parameters, with noise and prior widths estimated from the rows; and the extended Kalman filter.

Gauss-Newton steps minimise the errors of rows and priors together. Between passes the scatter of the rows (`RowNoise`)
and the widths of the priors of joint zeros and parts are estimated from the rows. A scale is the factor on such a
width. The scales are not certain, so the posterior of the linearised model is averaged over them, by its marginal
likelihood on a grid (MacKay 1992). Without priors the solution is the rank-aware least squares of the papers.

The filter identifies the same parameters recursively, pose by pose (Qiao 2026, "EKF"). Its covariances are updated in
Joseph's form (Bucy and Joseph 1968), which stays symmetric and positive. Drift enters as process noise. SI units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from pickenv.arm import Array, Geometry, MeasurementNoise, Pose, pose_error
from pickenv.base import InputError, single_threaded
from pickenv.calibration.identification import least_squares
from pickenv.calibration.identification.least_squares import Identification, identify, identify_converged
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel
from pickenv.calibration.model.noise_and_priors import LENGTHS, MADE, PriorModel, RowNoise, noise_of, stated_noise
from pickenv.calibration.model.observations import Observations

PASSES = 4
"""Largest number of successive solutions; each weighs rows and priors by the residuals of the previous solution."""

MANY, FEW = 4000, 1500
"""If there are more than `MANY` rows, noise and prior widths are first estimated on `FEW` equally spaced rows."""

SETTLED = 0.1
"""Passes end when neither noise nor scales change by more than this share."""

SPREAD = 3.0
"""Factor F: before measuring, a scale of prior widths lies between 1 / F and F with a probability of two thirds."""

NODES = (-2.4, -1.2, 0.0, 1.2, 2.4)
"""Nodes of the grid over the logarithm of each scale, in standard deviations from its mean."""

STAGES, NARROWEST = 3, 0.4
"""Number of grids, each centred by the previous one, and least width of a grid relative to the previous one."""

LIGHT = 1e-3
"""Nodes whose weight is below this share of the largest weight are left out."""

UNKNOWN_STD = 10.0
"""Prior standard deviation of the measurements' own unknowns, in SI units: it carries no information."""


@single_threaded()
def solve(
    model: PriorModel, data: Observations, noise: RowNoise | None = None, *, near: Identification | None = None
) -> Identification:
    """Fit a model's parameters to rows and priors.

    Args:
        model: The parameters with their priors. A scale is the factor on the prior widths of a group of parameters.
            The solution is averaged over the scales that the model does not state.
        data: The rows. If they involve no known length, priors of lengths are not rescaled, because the smallest arm
            would fit best.
        noise: The scatter of the rows; estimated from them when left out.
        near: A solution of the same rows with fewer parameters, to start from.

    Returns:
        The identification. If every parameter has a prior, all are kept, and the covariance is of the posterior.

    Raises:
        InputError: If there are too few rows for parameters without priors, or the fit does not converge.
    """
    if not model.proper:
        return _without_priors(model, data)
    if not data.framed:
        model = model.without_base()
    weights, start, scales = noise or stated_noise(data), model.start, dict(model.scales)
    if near is not None and near.noise is not None and near.noise.scatter.shape == weights.scatter.shape:
        weights, start = noise or near.noise, replace(start, geometry=near.geometry)
    if noise is None and len(data.joints) > MANY and not data.unknowns():
        few = solve(model, data.at_most(FEW), near=near)
        assert few.prior is not None
        start, scales = few.arm_model, dict(few.prior.scales)
        weights = noise_of(data, start, np.zeros(0), np.zeros(len(data.equations()[0])))
    free = [
        name for name in MADE if name not in model.scales and name in model.group and (data.sized or name != LENGTHS)
    ]
    for _ in range(PASSES):
        weighed = replace(model, scales=scales)
        solution = identify(
            model.parameters, start, [data, weighed.prior()], max_iterations=60, whiten=weights.whiten, every=True
        )
        solution = replace(solution, prior=weighed, noise=weights)
        solution = replace(solution, degrees_of_freedom=len(weights.scatter) - round(solution.spent))
        start, before = solution.arm_model, (weights, scales)
        unknowns = least_squares.unknowns_of(solution, data)
        by_arm, by_own = data.jacobian(start, unknowns)
        stated = np.hstack([by_own, by_arm[:, model.parameters.columns]])
        if noise is None:
            leverage = np.full(len(stated), solution.spent / len(stated))
            if len(data.joints) <= MANY:
                leverage = leverages(weights.whiten(stated) * np.r_[np.full(len(unknowns), UNKNOWN_STD), weighed.width])
            weights = noise_of(data, start, unknowns, leverage)
        residual = weights.whiten(data.residual(start, unknowns))
        means, averaged = averaged_over_scales(weighed, solution, weights.whiten(stated), residual, free)
        scales = {**scales, **means}
        if _settled(before, (weights, scales)):
            break
    return averaged(weights.common)


def averaged_over_scales(
    model: PriorModel, solution: Identification, columns: Array, residual: Array, free: list[str]
) -> tuple[dict[str, float], Callable[[float], Identification]]:
    """Average the posterior of the linearised model over the scales of prior widths.

    A scale is the factor on the prior widths of a group of parameters, such as all lengths of parts. Scales are weighed
    by their marginal likelihood and by a prior about 1. With fixed scales the uncertainties would be too small, because
    few rows hardly show how accurately an arm was made.

    Args:
        model: The model, with the scales of the solution.
        solution: The solution at which the model is linearised.
        columns: Whitened derivatives of the rows at the solution ``(E, own + P)``. The columns of the measurements' own
            unknowns come first, then the columns of the P parameters.
        residual: Whitened residuals at the solution ``(E,)``.
        free: Names of the groups, some of `MADE`, whose scales are averaged over.

    Returns:
        The geometric mean of the scales by group, and a function. The function returns the solution at the averaged
        posterior's mean, with the posterior's covariance. The function's argument is the factor on variances of rows
        that carry less information than independent ones
        (`pickenv.calibration.model.noise_and_priors.RowNoise.common`).
    """
    count, base = columns.shape[1] - len(model.std), solution.identifiability.kept
    scale = np.array([1.0 if name in free else model.scales.get(name, 1.0) for name in model.group])
    width = np.r_[np.full(count, UNKNOWN_STD), model.std * scale][base]
    group = np.r_[np.full(count, ""), model.group][base]
    offset = np.r_[np.zeros(count), model.start.difference(solution.arm_model)[model.parameters.columns]]
    upper, right = least_squares.triangle(columns, residual)
    upper, right = upper[:, base] * width, right + upper @ offset
    gram, right = upper.T @ upper, upper.T @ right
    member = np.array([group == name for name in free]).reshape(len(free), len(group))
    mean, std = np.zeros(len(free)), np.full(len(free), np.log(SPREAD))
    nodes = np.array(list(product(NODES, repeat=len(free))))
    for _ in range(STAGES if free else 1):
        logs = mean + std * nodes
        factor = np.exp(logs @ member)
        precision = np.eye(len(width)) + factor[:, :, None] * gram * factor[:, None, :]
        lower = np.linalg.cholesky(precision)
        half = np.linalg.solve(lower, (factor * right)[..., None])[..., 0]
        cost = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1) - 0.5 * np.sum(half**2, axis=1)
        cost += 0.5 * np.sum((logs / np.log(SPREAD)) ** 2, axis=1)
        weight = np.exp(cost.min() - cost)
        weight /= weight.sum()
        mean = weight @ logs
        std = np.maximum(np.sqrt(weight @ (logs - mean) ** 2), NARROWEST * std)

    def averaged(common: float) -> Identification:
        """Return the solution at the posterior's mean over all scales, with the posterior's covariance.

        ``common`` is the factor on variances of rows that carry less information than independent ones.
        """
        some = weight > LIGHT * weight.max()
        share, scaled, root = weight[some] / weight[some].sum(), factor[some], np.linalg.inv(lower[some])
        inverse = root.transpose(0, 2, 1) @ root
        means = scaled * (inverse @ (scaled * right)[..., None])[..., 0]
        # Rows and priors apart, each as a square: where no row tells, rounding must not leave less than nothing.
        rows = upper * scaled[:, None, :] @ root.transpose(0, 2, 1) @ root
        spread = common * rows.transpose(0, 2, 1) @ rows + inverse @ inverse
        centre = share @ means
        covariance = np.einsum("n,ni,nij,nj->ij", share, scaled, spread, scaled)
        covariance += np.einsum("n,ni,nj->ij", share, means - centre, means - centre)
        change = -offset
        change[base] += centre * width
        unknowns = np.array([*solution.unknowns.values()]) + change[:count]
        return replace(
            solution,
            arm_model=solution.arm_model.moved(model.parameters.columns, change[count:]),
            unknowns=dict(zip(solution.unknowns, unknowns.tolist(), strict=True)),
            delta=solution.delta + change,
            covariance=np.asarray(covariance * np.outer(width, width)),
        )

    return dict(zip(free, np.exp(mean).tolist(), strict=True)), averaged


def covariance_at(found: Identification, data: Observations, share: float) -> Array:
    """Compute the covariance of the kept parameters for rows with a smaller scatter about the arm than in the fit.

    This is the covariance if a learnt residual is added to the arm. The residual removes the part of the errors that
    neighbouring rows have in common. The remaining errors are smaller, and rows then count as independent.

    Args:
        found: The identification.
        data: The rows that it was fitted to.
        share: Share of the rows' variance that remains.
    """
    by_arm, by_own = data.jacobian(found.arm_model, least_squares.unknowns_of(found, data))
    names, arm_names = found.identifiability.names, found.arm_model.parameter_names
    columns = np.hstack([by_own, by_arm[:, [arm_names.index(name) for name in names[by_own.shape[1] :]]]])
    kept = found.identifiability.kept
    rows = (columns / found.scatter if found.noise is None else found.noise.whiten(columns))[:, kept]
    precision = rows.T @ rows / share + np.diag(found.prior_std[kept] ** -2.0)
    size = np.diag(precision) ** -0.5
    return np.asarray(np.linalg.inv(precision * np.outer(size, size)) * np.outer(size, size))


def leverages(columns: Array) -> Array:
    """Compute the leverage of each equation ``(E,)``, if every parameter has a standard normal prior.

    The leverage, 0 to 1, is the share of an equation that the fit uses to determine parameters.

    Args:
        columns: Whitened derivatives ``(E, P)``, in units of the priors' standard deviations.
    """
    lower = np.linalg.cholesky(np.eye(columns.shape[1]) + columns.T @ columns)
    return np.asarray(np.sum(solve_triangular(lower, columns.T, lower=True) ** 2, axis=0))


def _settled(before: tuple[RowNoise, dict[str, float]], after: tuple[RowNoise, dict[str, float]]) -> bool:
    """Return whether noise and scales (by group) changed by no more than `SETTLED` from ``before`` to ``after``."""
    (old, old_scales), (new, new_scales) = before, after
    values = [np.log(new.scatter / old.scatter), np.log(new.channels / old.channels)]
    values += [np.log([new_scales[name] / old_scales.get(name, 1.0) for name in new_scales] or [1.0])]
    values += [np.log(np.maximum(new.pose_std, 1e-12)) - np.log(np.maximum(old.pose_std, 1e-12))]
    return bool(max(np.max(np.abs(part)) for part in values) <= SETTLED)


def _without_priors(model: PriorModel, data: Observations) -> Identification:
    """Solve by rank-aware least squares; only terms' coefficients have priors, weighed by the rows' scatter."""
    if not np.isfinite(model.std).any():
        return replace(identify_converged(model.parameters, model.start, [data]), prior=model)
    scatter = identify_converged(model.parameters.some(~np.isfinite(model.std)), model.start, [data]).scatter
    weighed = model.prior(max(scatter, 1e-9))
    return replace(identify(model.parameters, model.start, [data, weighed], max_iterations=60), prior=model)


@dataclass(frozen=True, eq=False)
class FilterState:
    """The filter's estimate and its covariance, after the poses measured so far.

    Attributes:
        arm_model: Current estimate: geometry and coefficients of terms.
        columns: Indices ``(p,)`` of the estimated parameters in ``arm_model.parameter_names``.
        tolerance: Typical deviation of each estimated parameter ``(p,)``, m or rad.
        covariance: Covariance of the parameters' errors ``(p, p)``, m and rad.
    """

    arm_model: ArmModel
    columns: NDArray[np.int64]
    tolerance: Array
    covariance: Array

    @property
    def geometry(self) -> Geometry:
        """Current geometry."""
        return self.arm_model.geometry


def start_filter(
    model: ErrorModel, start: Geometry | ArmModel, joints: Array, *, full_pose: bool = True, prior: float = 10.0
) -> FilterState:
    """Return the first state of a filter that knows only the nominal arm.

    Args:
        model: Candidate parameters. Parameters that the poses do not identify are left out.
        start: Geometry, or geometry with terms, to start from.
        joints: Joints ``(N, n)``, rad or m, of poses like the poses to be measured. They decide which parameters are
            identifiable.
        full_pose: False if only positions will be measured.
        prior: Prior standard deviation of each parameter, as a multiple of its tolerance; 10 is 10 mm and 0.6 deg for
            geometry.

    Raises:
        InputError: If the poses give fewer equations than there are candidate parameters.
    """
    arm, joints, rows = ArmModel.of(start), np.asarray(joints, dtype=float), 6 if full_pose else 3
    if len(joints) * rows < len(model.columns):
        raise InputError(
            f"{len(joints)} poses cannot decide which of {len(model.columns)} parameters are identifiable; give the "
            f"joints of at least {-(-len(model.columns) // rows)} poses, measured or planned"
        )
    jacobian = (arm.jacobian(joints)[:, :rows, model.columns] * model.tolerance).reshape(-1, len(model.columns))
    base = least_squares.identifiability(jacobian, model.names, model.tolerance, len(joints))
    tolerance = model.tolerance[base.kept]
    return FilterState(arm, model.columns[base.kept], tolerance, np.diag((prior * tolerance) ** 2))


def predict(state: FilterState, process_noise: ArrayLike, seconds: float) -> FilterState:
    """Return the state after some time, in which the parameters may have drifted.

    Args:
        state: The state before.
        process_noise: Covariance that the parameters gain per second ``(p, p)``; see `random_walk`.
        seconds: Time since the last update.
    """
    return replace(state, covariance=state.covariance + np.asarray(process_noise) * seconds)


def random_walk(state: FilterState, tolerances: float) -> Array:
    """Return the process noise ``(p, p)`` per second of a random walk, which represents drifts of unknown cause.

    Args:
        state: The filter's state.
        tolerances: Standard deviation of each parameter's drift after one hour, as a multiple of its tolerance. The
            drift grows with the square root of time.
    """
    return np.asarray(np.diag((tolerances * state.tolerance) ** 2) / 3600.0)


def update(state: FilterState, joints: ArrayLike, observed: Pose | ArrayLike, noise: MeasurementNoise) -> FilterState:
    """Return the state after one measured pose.

    Args:
        state: The state before.
        joints: Commanded joints ``(n,)``, rad or m.
        observed: Measured pose of the tool, or its position ``(3,)``, m.
        noise: Standard deviations of one coordinate, m and rad, including errors that the model cannot explain.

    Raises:
        InputError: If joints or the observation are not finite.
    """
    joints = np.asarray(joints, dtype=float)[None]
    predicted = state.arm_model.pose(joints)
    if isinstance(observed, Pose):
        innovation = pose_error(predicted, Pose(observed.position[None], observed.rotation[None]))[0]
    else:
        innovation = np.asarray(observed, dtype=float) - predicted.position[0]
    if not np.isfinite(innovation).all():
        raise InputError("the observed pose or its joints are not finite; leave the pose out")
    jacobian = state.arm_model.jacobian(joints)[0, : len(innovation)][:, state.columns]
    variance = np.repeat([noise.position_std, noise.attitude_std], 3)[: len(innovation)] ** 2
    crossed = jacobian @ state.covariance
    gain = np.linalg.solve(crossed @ jacobian.T + np.diag(variance), crossed).T
    shrink = np.eye(len(gain)) - gain @ jacobian
    covariance = shrink @ state.covariance @ shrink.T + (gain * variance) @ gain.T
    arm_model = state.arm_model.moved(state.columns, gain @ innovation)
    return replace(state, arm_model=arm_model, covariance=(covariance + covariance.T) / 2.0)
