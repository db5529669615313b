"""The one solve: maximum a posteriori of all parameters, with noise and prior widths found from the rows.

Gauss-Newton on rows and priors together; between passes the rows say what they scatter by (`RowNoise`), and how wide
the priors of joint zeros and of parts are: the scales that maximise the marginal likelihood of the linearised model
(empirical Bayes; MacKay 1992). Priors of no information make it the rank-aware least squares of the papers. SI units.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification, identify, identify_converged
from pickenv.calibration.model.noise import RowNoise, noise_of, stated_noise
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.prior import MADE, PriorModel
from pickenv.threads import single_threaded

PASSES = 4
"""Solves at most; each weighs rows and priors by what the one before left."""

SETTLED = 0.1
"""Passes end where no scale changes by more than this share."""

SPREAD = 3.0
"""A tolerance class is about right: the scale of its widths is within this factor of 1, two times in three."""

WIDEST = 100.0
"""A scale is within this factor of 1."""

UNKNOWN_STD = 10.0
"""Standard deviation of the measurements' own unknowns, in SI units: no information."""


@single_threaded()
def solve(
    model: PriorModel, data: Observations, noise: RowNoise | None = None, *, near: Identification | None = None
) -> Identification:
    """Fit a model to rows.

    Args:
        model: The parameters with their priors; scales that it does not state are found from the rows.
        data: The rows.
        noise: What they scatter by; found from them when left out.
        near: A solution of the same rows with fewer parameters, to start from.

    Returns:
        The identification. Where every parameter has a prior all are kept, and the covariance is the posterior's.

    Raises:
        InputError: If there are too few rows for parameters without priors, or it does not converge.
    """
    if not model.proper:
        return _without_priors(model, data)
    if not data.framed:
        model = model.without_base()
    weights, start = noise or stated_noise(data), model.start
    if near is not None and near.noise is not None and near.noise.scatter.shape == weights.scatter.shape:
        weights, start = noise or near.noise, replace(start, geometry=near.geometry)
    scales = dict(model.scales)
    wanted = [name for name in MADE if name not in scales and name in model.group]
    for _ in range(PASSES):
        weighed = replace(model, scales=scales)
        solution = identify(
            model.parameters, start, [data, weighed.prior()], max_iterations=60, whiten=weights.whiten, every=True
        )
        solution = replace(solution, prior=weighed, noise=weights)
        solution = replace(solution, degrees_of_freedom=len(weights.scatter) - round(solution.spent))
        start, before = solution.arm_model, (weights, scales)
        unknowns = np.array([solution.unknowns[name] for name in data.unknowns()])
        by_arm, by_own = data.jacobian(solution.arm_model, unknowns)
        stated = np.hstack([by_own, by_arm[:, model.parameters.columns]])
        if noise is None:
            width = np.r_[np.full(len(unknowns), UNKNOWN_STD), weighed.width]
            leverage = leverages(weights.whiten(stated) * width)
            weights = noise_of(data, solution.arm_model, unknowns, leverage)
        if wanted:
            left = weights.whiten(data.residual(solution.arm_model, unknowns))
            scales = {**scales, **prior_scales(weighed, solution, weights.whiten(stated), left, wanted)}
        if _settled(before, (weights, scales)):
            break
    return replace(solution, covariance=_widened(solution, weights.common))


def _widened(solution: Identification, common: float) -> Array:
    """The posterior's covariance S where rows are not as independent as they were weighed: c S - (c - 1) S P S.

    P is the priors' precision, and S (c D + P) S, with what the rows say D = 1 / S - P, the sandwich.
    """
    inverse = solution.prior_std[solution.identifiability.kept] ** -2.0
    covariance = solution.covariance
    return np.asarray(common * covariance - (common - 1.0) * (covariance * inverse) @ covariance)


def leverages(columns: Array) -> Array:
    """How much of each row a fit uses up, where every parameter is a standard normal number beforehand ``(E,)``."""
    both = np.vstack([columns, np.eye(columns.shape[1])])
    return np.asarray(np.sum(np.linalg.qr(both)[0][: len(columns)] ** 2, axis=1))


def _settled(before: tuple[RowNoise, dict[str, float]], after: tuple[RowNoise, dict[str, float]]) -> bool:
    """Whether neither noise nor scales have changed by more than `SETTLED`."""
    (old, old_scales), (new, new_scales) = before, after
    values = [np.log(new.scatter / old.scatter), np.log(new.channels / old.channels)]
    values += [np.log([new_scales[name] / old_scales.get(name, 1.0) for name in new_scales] or [1.0])]
    values += [np.log(np.maximum(new.pose_std, 1e-12)) - np.log(np.maximum(old.pose_std, 1e-12))]
    return bool(max(np.max(np.abs(part)) for part in values) <= SETTLED)


def _without_priors(model: PriorModel, data: Observations) -> Identification:
    """Rank-aware least squares; coefficients of terms have priors all the same, against what the rows are worth."""
    if not np.isfinite(model.std).any():
        return replace(identify_converged(model.parameters, model.start, [data]), prior=model)
    free = ~np.isfinite(model.std)
    scatter = identify_converged(model.parameters.some(free), model.start, [data]).scatter
    weighed = model.prior(max(scatter, 1e-9))
    return replace(identify(model.parameters, model.start, [data, weighed], max_iterations=60), prior=model)


def prior_scales(
    model: PriorModel, solution: Identification, columns: Array, left: Array, names: list[str]
) -> dict[str, float]:
    """Scales of the widths of these groups that maximise the marginal likelihood, each expected near 1.

    Args:
        model: The model, with the scales of the solution.
        solution: Where the model is linearised.
        columns: Whitened derivatives of the rows there ``(E, own + P)``, by their own unknowns first.
        left: Whitened residuals there ``(E,)``.
        names: Groups whose scales are wanted.
    """
    count = columns.shape[1] - len(model.std)
    width = np.r_[np.full(count, UNKNOWN_STD), model.std]
    moved = model.start.difference(solution.arm_model)[model.parameters.columns]
    system = np.column_stack([columns * width, left + columns[:, count:] @ moved])
    triangle = np.asarray(np.linalg.qr(system, mode="r"))[: len(width)]
    rows, target = triangle[:, :-1], triangle[:, -1]
    groups = np.r_[np.full(count, ""), model.group]
    fixed = {name: scale for name, scale in model.scales.items() if name not in names}

    def cost(logs: Array) -> float:
        scales = {**fixed, **dict(zip(names, np.exp(logs), strict=True))}
        scaled = rows * np.array([scales.get(group, 1.0) for group in groups])
        factor = np.linalg.cholesky(np.eye(len(scaled)) + scaled @ scaled.T)
        left = np.linalg.solve(factor, target)
        return float(np.log(np.diag(factor)).sum() + 0.5 * left @ left + 0.5 * np.sum((logs / np.log(SPREAD)) ** 2))

    bound = np.log(WIDEST)
    begin = np.log([model.scales.get(name, 1.0) for name in names])
    best = minimize(
        cost,
        begin,
        method="Nelder-Mead",
        bounds=[(-bound, bound)] * len(names),
        options={
            "initial_simplex": begin + np.vstack([np.zeros(len(names)), np.eye(len(names))]),
            "xatol": 0.02,
            "fatol": 0.01,
        },
    )
    return dict(zip(names, np.exp(best.x).tolist(), strict=True))
