"""Gaussian process regression with one length scale per input (automatic relevance determination).

Kernel s^2 exp(-sum_f (x_f - x'_f)^2 / 2 l_f^2) + noise; hyper-parameters maximise the marginal likelihood with its
analytic gradient (Rasmussen and Williams 2006, algorithm 2.1, eqs (5.8)-(5.9)). One process per output; NumPy alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotri

from calibration.scaling import spread
from calibration.threads import single_threaded
from pickenv.arm.geometry import Array
from pickenv.errors import InputError

CHUNK = 2048
"""Rows predicted at once, which bounds the memory of the kernel matrix."""


LIKELIHOOD_PRECISION = 1e-5
"""The search ends when a step gains a smaller share of the log likelihood."""


@dataclass(frozen=True)
class GaussianProcessSettings:
    """How the process is fitted.

    Attributes:
        rows: Training rows kept at most, drawn evenly; the cost grows with their cube.
        likelihood_rows: Rows at most that the marginal likelihood is taken over.
        iterations: Iterations of L-BFGS at most, per output.
        length_scales: Bounds of a length scale, in standardised inputs.
        noise: Bounds of the noise's standard deviation, in units of the output's spread.
    """

    rows: int = 2000
    likelihood_rows: int = 600
    iterations: int = 60
    length_scales: tuple[float, float] = (0.1, 1e3)
    noise: tuple[float, float] = (1e-3, 2.0)


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A fitted process in plain arrays; far from its rows it predicts the mean.

    Attributes:
        rows: Training inputs ``(M, F)``, standardised.
        length_scales: Of each output and input ``(k, F)``, in standardised inputs.
        amplitude: Prior standard deviation s of each output ``(k,)``, in units of its spread.
        noise: Standard deviation of the noise of each output ``(k,)``, in units of its spread.
        weights: Dual weights ``(k, M)``.
        output_mean: Mean of the training outputs ``(k,)``, m and rad.
        output_std: Their spread.
    """

    rows: Array
    length_scales: Array
    amplitude: Array
    noise: Array
    weights: Array
    output_mean: Array
    output_std: Array

    def predict(self, inputs: ArrayLike) -> Array:
        """Mean outputs ``(..., k)`` (m, rad) at standardised inputs ``(..., F)``."""
        inputs = np.asarray(inputs, dtype=float)
        flat = inputs.reshape(-1, inputs.shape[-1])
        values = np.empty((len(flat), len(self.amplitude)))
        for start in range(0, len(flat), CHUNK):
            part = slice(start, start + CHUNK)
            for j in range(values.shape[1]):
                values[part, j] = self._kernel(j, flat[part]) @ self.weights[j]
        return (values * self.output_std + self.output_mean).reshape(*inputs.shape[:-1], -1)

    def predict_std(self, inputs: ArrayLike) -> Array:
        """Standard deviation ``(..., k)`` (m, rad) of the noise-free outputs at standardised inputs ``(..., F)``."""
        inputs = np.asarray(inputs, dtype=float)
        flat = inputs.reshape(-1, inputs.shape[-1])
        values = np.empty((len(flat), len(self.amplitude)))
        for start in range(0, len(flat), CHUNK):
            part = slice(start, start + CHUNK)
            for j, factor in enumerate(self._factors):
                known = np.sum(solve_triangular(factor, self._kernel(j, flat[part]).T, lower=True) ** 2, axis=0)
                values[part, j] = np.sqrt(np.maximum(self.amplitude[j] ** 2 - known, 0.0))
        return (values * self.output_std).reshape(*inputs.shape[:-1], -1)

    @cached_property
    def _factors(self) -> tuple[Array, ...]:
        """Cholesky factors of the kernel matrices: computed when first wanted, never saved."""
        return tuple(_factor(self._kernel(j, self.rows), noise) for j, noise in enumerate(self.noise))

    def _kernel(self, output: int, inputs: Array) -> Array:
        return _kernel(inputs, self.rows, self.length_scales[output], float(self.amplitude[output]))

    def arrays(self) -> dict[str, Array]:
        """All numbers by name, for saving."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @staticmethod
    def from_arrays(named: Mapping[str, NDArray[Any]]) -> GaussianProcess:
        """The inverse of `arrays`."""
        return GaussianProcess(**{name: named[name] for name in GaussianProcess.__dataclass_fields__})


def fit_gaussian_process(
    inputs: Array, targets: Array, rng: np.random.Generator, settings: GaussianProcessSettings | None = None
) -> GaussianProcess:
    """Fit one process per output.

    Args:
        inputs: Standardised inputs ``(N, F)``.
        targets: Residuals to learn ``(N, k)``, m and rad.
        rng: Draws the rows that are kept where there are too many.
        settings: How; the defaults when left out.

    Raises:
        InputError: If there are fewer than ten rows.
    """
    settings = settings or GaussianProcessSettings()
    if len(inputs) < 10:
        raise InputError(f"{len(inputs)} poses are too few for a Gaussian process; measure at least 10")
    order = rng.permutation(len(inputs))
    kept = np.sort(order[: settings.rows])
    seen = np.sort(order[: settings.likelihood_rows])
    mean, std = targets.mean(axis=0), spread(targets, 1e-12)
    scaled = (targets - mean) / std
    lengths, amplitudes, noises, weights = [], [], [], []
    with single_threaded():
        for j in range(targets.shape[1]):
            amplitude, length, noise = _most_likely(inputs[seen], scaled[seen, j], settings)
            factor = _factor(_kernel(inputs[kept], inputs[kept], length, amplitude), noise)
            lengths.append(length)
            amplitudes.append(amplitude)
            noises.append(noise)
            weights.append(cho_solve((factor, True), scaled[kept, j]))
    return GaussianProcess(
        rows=inputs[kept],
        length_scales=np.array(lengths),
        amplitude=np.array(amplitudes),
        noise=np.array(noises),
        weights=np.array(weights),
        output_mean=mean,
        output_std=std,
    )


def _most_likely(inputs: Array, target: Array, settings: GaussianProcessSettings) -> tuple[float, Array, float]:
    """Amplitude, length scales and noise that maximise the marginal likelihood, from one start of middling scales."""
    from scipy.optimize import fmin_l_bfgs_b

    features = inputs.shape[1]
    best = np.log(np.concatenate([[1.0], np.full(features, 1.0), [0.5]]))
    bounds = [(0.03, 30.0)] + [settings.length_scales] * features + [settings.noise]
    for every in (3, 1):  # a third of the rows costs a 27th and comes near
        best = fmin_l_bfgs_b(
            negative_log_likelihood,
            best,
            args=(inputs[::every], target[::every]),
            bounds=[(float(np.log(low)), float(np.log(high))) for low, high in bounds],
            factr=LIKELIHOOD_PRECISION / np.finfo(float).eps,
            maxiter=settings.iterations,
        )[0]
    best = np.exp(best)
    return float(best[0]), np.asarray(best[1:-1]), float(best[-1])


def negative_log_likelihood(theta: Array, inputs: Array, target: Array) -> tuple[float, Array]:
    """Negative log marginal likelihood and its gradient (Rasmussen and Williams eqs (2.30), (5.9)).

    Args:
        theta: Logarithms of amplitude, F length scales and noise, ``(F + 2,)``.
        inputs: Inputs ``(M, F)``.
        target: One output ``(M,)``.
    """
    amplitude, length, noise = np.exp(theta[0]), np.exp(theta[1:-1]), np.exp(theta[-1])
    smooth = _kernel(inputs, inputs, length, amplitude)
    factor = _factor(smooth, noise)
    dual = cho_solve((factor, True), target)
    lower = np.tril(dpotri(factor, lower=1)[0])  # the inverse; LAPACK fills one triangle
    weight = np.outer(dual, dual) - (lower + np.tril(lower, -1).T)
    weighted = weight * smooth
    scaled = inputs / length
    by_length = weighted.sum(axis=1) @ scaled**2 - np.sum(scaled * (weighted @ scaled), axis=0)
    slope = np.concatenate([[weighted.sum()], by_length, [noise**2 * np.trace(weight)]])
    value = 0.5 * target @ dual + np.log(np.diag(factor)).sum() + 0.5 * len(target) * np.log(2.0 * np.pi)
    return float(value), -slope


def _factor(smooth: Array, noise: float) -> Array:
    """Lower Cholesky factor of the kernel matrix with noise and a whisper of jitter on its diagonal."""
    matrix = smooth.copy()
    matrix[np.diag_indices_from(matrix)] += noise**2 + 1e-10
    return np.asarray(cholesky(matrix, lower=True, overwrite_a=True, check_finite=False))


def _kernel(left: Array, right: Array, length: Array, amplitude: float) -> Array:
    a, b = left / length, right / length
    squares = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * a @ b.T
    return np.asarray(amplitude**2 * np.exp(-0.5 * np.maximum(squares, 0.0)))
