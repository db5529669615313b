"""The posterior of all parameters, with noise and prior widths estimated from the measurements.

Gauss-Newton steps minimise the errors of rows and priors together. Between passes the scatter of the rows (`RowNoise`)
and the widths of the priors of joint zeros and parts are estimated from the rows. A scale is the factor on such a
width. The scales are not certain, so the posterior of the linearised model is averaged over them, by its marginal
likelihood on a grid (MacKay 1992). Without priors the solution is the rank-aware least squares of the papers. SI units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from pickenv.arm import Array
from pickenv.base import single_threaded
from pickenv.calibration.identification import least_squares
from pickenv.calibration.identification.least_squares import Identification, identify, identify_converged
from pickenv.calibration.model.noise import RowNoise, noise_of, stated_noise
from pickenv.calibration.model.observations import Observations, equally_spaced
from pickenv.calibration.model.prior import LENGTHS, MADE, PriorModel

PASSES = 4
"""Largest number of solutions; each weighs rows and priors by the residuals of the previous one."""

MANY, FEW = 4000, 1500
"""With more than `MANY` rows, noise and prior widths are first estimated on `FEW` of them, equally spaced."""

SETTLED = 0.1
"""Passes end when neither noise nor scales change by more than this share."""

SPREAD = 3.0
"""Factor about 1 within which a scale of prior widths lies, before measuring, with a probability of two thirds."""

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
        model: The parameters with their priors. The solution is averaged over the scales, that is factors on the prior
            widths of a group of parameters, which the model does not state.
        data: The rows. If they involve no known length, priors of lengths are not rescaled, because the smallest arm
            would fit best.
        noise: The scatter of the rows; estimated from them when left out.
        near: A solution of the same rows with fewer parameters, to start from.

    Returns:
        The identification. If every parameter has a prior, all are kept, and the covariance is the posterior's.

    Raises:
        InputError: If there are too few rows for parameters without priors, or the fit does not converge.
    """
    if not model.proper:
        return _without_priors(model, data)
    if not data.framed:
        model = model.without_base()
    weights, start = noise or stated_noise(data), model.start
    if near is not None and near.noise is not None and near.noise.scatter.shape == weights.scatter.shape:
        weights, start = noise or near.noise, replace(start, geometry=near.geometry)
    scales = dict(model.scales)
    if noise is None and len(data.joints) > MANY and not data.unknowns():
        few = solve(model, data.select(equally_spaced(len(data.joints), FEW)), near=near)
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
        columns = weights.whiten(stated)
        means, averaged = averaged_over_scales(weighed, solution, columns, residual, free)
        scales = {**scales, **means}
        if _settled(before, (weights, scales)):
            break
    return averaged(weights.common)


def averaged_over_scales(
    model: PriorModel, solution: Identification, columns: Array, residual: Array, free: list[str]
) -> tuple[dict[str, float], Callable[[float], Identification]]:
    """Average the posterior of the linearised model over the scales of prior widths.

    A scale is the factor on the prior widths of a group of parameters, such as all lengths of parts. Scales are weighed
    by their marginal likelihood and by a prior near 1. With fixed scales the uncertainties would be too small, because
    few rows hardly show how accurately an arm was made.

    Args:
        model: The model, with the scales of the solution.
        solution: The solution at which the model is linearised.
        columns: Whitened derivatives of the rows at the solution ``(E, own + P)``: those with respect to the
            measurements' own unknowns come first, those with respect to the P parameters last.
        residual: Whitened residuals at the solution ``(E,)``.
        free: Names of the groups, some of `MADE`, whose scales are averaged over.

    Returns:
        The geometric mean of the scales by group, and a function. The function returns the solution at the averaged
        posterior's mean, with its covariance. Its argument is the factor on variances of rows that carry less
        information than independent ones (`pickenv.calibration.model.noise.RowNoise.common`).
    """
    count, base = columns.shape[1] - len(model.std), solution.identifiability.kept
    scale = np.array([1.0 if name in free else model.scales.get(name, 1.0) for name in model.group])
    width = np.r_[np.full(count, UNKNOWN_STD), model.std * scale][base]
    group = np.r_[np.full(count, ""), model.group][base]
    offset = np.zeros(columns.shape[1])
    offset[count:] = model.start.difference(solution.arm_model)[model.parameters.columns]
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
        """Return the solution at the posterior's mean over all scales, with its covariance.

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
        delta = np.zeros(len(solution.arm_model.parameter_names))
        delta[model.parameters.columns] = change[count:]
        unknowns = np.array([*solution.unknowns.values()]) + change[:count]
        return replace(
            solution,
            arm_model=solution.arm_model.displaced(delta),
            unknowns=dict(zip(solution.unknowns, unknowns.tolist(), strict=True)),
            delta=solution.delta + change,
            covariance=np.asarray(covariance * np.outer(width, width)),
        )

    return dict(zip(free, np.exp(mean).tolist(), strict=True)), averaged


def covariance_at(found: Identification, data: Observations, share: float) -> Array:
    """Compute the covariance of the kept parameters if the rows scattered less than they do about the fitted arm.

    It is the covariance beside a learnt residual, which removes what errors have in common. The errors that remain are
    smaller, and rows then count as independent.

    Args:
        found: The identification.
        data: The rows that it was fitted to.
        share: Share of the rows' variance that remains.
    """
    by_arm, by_own = data.jacobian(found.arm_model, least_squares.unknowns_of(found, data))
    names, arm_names = found.identifiability.names, found.arm_model.parameter_names
    columns = np.hstack([by_own, by_arm[:, [arm_names.index(name) for name in names[by_own.shape[1] :]]]])
    rows = columns / found.scatter if found.noise is None else found.noise.whiten(columns)
    rows, kept = rows[:, found.identifiability.kept], found.identifiability.kept
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
    free = ~np.isfinite(model.std)
    scatter = identify_converged(model.parameters.some(free), model.start, [data]).scatter
    weighed = model.prior(max(scatter, 1e-9))
    return replace(identify(model.parameters, model.start, [data, weighed], max_iterations=60), prior=model)
