"""Gaussian process regression with one length scale per input (automatic relevance determination).

The kernel is s^2 exp(-sum_f (x_f - x'_f)^2 / 2 l_f^2) + noise. Its hyper-parameters maximise the marginal likelihood
with its analytic gradient (Rasmussen and Williams 2006, algorithm 2.1, eqs (5.8)-(5.9)). That likelihood has several
optima, and some of them explain everything as noise. The search therefore has several starts. Each output has its own
process. SI units.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from operator import itemgetter
from typing import Any, Protocol, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.linalg.lapack import dpotri

from pickenv.arm import Array
from pickenv.base import InputError, register, single_threaded

# What all regressors of residuals share: what is asked of them, arrays by name for saving, and standardising.

CONSTANT = 1e-9
"""A column that varies by less than this share of its largest absolute value is constant but for rounding."""


class Regressor(Protocol):
    """A regressor of residuals, which is fitted to arrays, predicts arrays, and is stored in plain arrays.

    A further method ``faster()`` is optional; it returns a faster version of the model for control loops.
    """

    @staticmethod
    def fit(inputs: Array, targets: Array, rng: np.random.Generator) -> Regressor:
        """Fit the regressor; every random draw comes from ``rng``.

        Args:
            inputs: Standardised inputs ``(N, F)``.
            targets: Residuals ``(N, k)``, m and rad.
            rng: The random generator.
        """

    def predict(self, inputs: ArrayLike) -> Array:
        """Predict outputs ``(..., k)`` at standardised inputs ``(..., F)``."""

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Return all arrays by name, for saving without pickle."""

    @staticmethod
    def from_arrays(named: Mapping[str, NDArray[Any]]) -> Regressor:
        """Rebuild the regressor from the arrays that `arrays` returns."""


Fitter = Callable[[Array, Array, np.random.Generator], Regressor]
"""Function that fits a regressor to standardised inputs ``(N, F)`` and targets ``(N, k)``, with a random generator."""


class SavedArrays:
    """Base class of dataclasses whose fields are arrays and numbers, saved by name without pickle and restored."""

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all fields as arrays by name, for saving."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(cast(Any, self))}

    @classmethod
    def from_arrays(cls, named: Mapping[str, NDArray[Any]]) -> Self:
        """Rebuild the object from the arrays that `arrays` returns."""
        values = ((field.name, named[field.name]) for field in fields(cast(Any, cls)))
        return cls(**{name: value if value.ndim else value.item() for name, value in values})


def column_std(values: Array, constant: float) -> Array:
    """Compute the standard deviation of each column of ``values`` ``(N, F)``; ``constant`` if a column does not vary.

    Set ``constant`` to 1 for inputs, so that changes of a constant input after training keep their size. Set it to a
    tiny number for outputs, so that a model's error on a constant output stays tiny.
    """
    std = values.std(axis=0)
    return np.where(std <= CONSTANT * np.max(np.abs(values), axis=0, initial=0.0), constant, std)


# Radial basis function network: k-means centres, Gaussian basis functions of one width, ridge output weights. The
# comparator "RBF" of Qiao 2026 (Table 4, refs [29], [30]). Width and ridge are chosen by generalised cross-validation
# (Golub, Heath and Wahba 1979), which costs one singular value decomposition per width. Inputs are standardised.


CENTRES, ROUNDS = 200, 20
"""Largest number of basis functions, and number of rounds of k-means that place them."""

WIDTHS = (0.25, 0.5, 1.0, 2.0)
"""Candidate widths, in units of the median distance between rows and centres."""

RIDGES = (1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
"""Candidate ridge coefficients, relative to the largest squared singular value."""


@register("residual", "rbf")
@dataclass(frozen=True, eq=False)
class Rbf(SavedArrays):
    """A fitted radial basis function network in plain arrays; far from its centres it predicts the mean.

    Attributes:
        centres: Centres of the basis functions ``(C, F)``, in standardised inputs.
        width: Common width of the basis functions, in standardised inputs.
        weights: Output weights ``(C, k)``, m and rad.
        offset: Output far from every centre ``(k,)``, m and rad.
    """

    centres: Array
    width: float
    weights: Array
    offset: Array

    @staticmethod
    def fit(inputs: Array, targets: Array, rng: np.random.Generator) -> Rbf:
        """Fit the network, with one centre for every three rows, but at most `CENTRES`.

        Args:
            inputs: Standardised inputs ``(N, F)``.
            targets: Residuals to learn ``(N, k)``, m and rad.
            rng: Draws the first centres of k-means.

        Raises:
            InputError: If there are fewer than ten rows.
        """
        rows = len(inputs)
        if rows < 10:
            raise InputError(f"{rows} poses are too few for an RBF network; measure at least 10")
        middles = k_means(inputs, min(CENTRES, rows // 3), rng, ROUNDS)
        offset, scale = targets.mean(axis=0), column_std(targets, 1e-12)
        scaled = (targets - offset) / scale
        unit = float(np.sqrt(np.median(_squared_distances(inputs, middles))))
        best, solution = np.inf, (1.0, np.zeros((len(middles), targets.shape[1])))
        for width in (factor * unit for factor in WIDTHS):
            with single_threaded():
                u, s, vt = np.linalg.svd(_gaussians(inputs, middles, width), full_matrices=False)
            coordinates = u.T @ scaled
            outside = np.sum(scaled**2) - np.sum(coordinates**2)
            for ridge in RIDGES:
                damping = ridge * s[0] ** 2
                shares = s**2 / (s**2 + damping)
                missed = outside + np.sum(((1.0 - shares)[:, None] * coordinates) ** 2)
                score = missed / (1.0 - shares.sum() / rows) ** 2
                if score < best:
                    best, solution = score, (width, vt.T @ ((s / (s**2 + damping))[:, None] * coordinates))
        return Rbf(middles, solution[0], solution[1] * scale, offset)

    def predict(self, inputs: ArrayLike) -> Array:
        """Predict outputs ``(..., k)`` (m, rad) at standardised inputs ``(..., F)``."""
        basis = _gaussians(np.asarray(inputs, dtype=float), self.centres, self.width)
        return np.asarray(basis @ self.weights + self.offset)


def k_means(points: Array, count: int, rng: np.random.Generator, rounds: int) -> Array:
    """Return centres ``(count, F)`` by Lloyd's k-means, started from randomly drawn points.

    Args:
        points: Points ``(N, F)``.
        count: Number of centres; a centre without points keeps its place.
        rng: Draws the starting points.
        rounds: Number of iterations.
    """
    from scipy.cluster.vq import kmeans2

    centres = points[rng.choice(len(points), count, replace=False)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # which says that a cluster is empty
        return np.asarray(kmeans2(points, centres, rounds, minit="matrix")[0])


def _squared_distances(points: Array, centres: Array) -> Array:
    """Compute the squared distances ``(..., C)`` between points ``(..., F)`` and centres ``(C, F)``."""
    squares = np.sum(points**2, axis=-1)[..., None] + np.sum(centres**2, axis=-1) - 2.0 * points @ centres.T
    return np.asarray(np.maximum(squares, 0.0))


def _gaussians(points: Array, centres: Array, width: float) -> Array:
    """Compute Gaussian basis functions ``(..., C)`` of this width at points ``(..., F)``, for centres ``(C, F)``."""
    return np.asarray(np.exp(_squared_distances(points, centres) / (-2.0 * width**2)))


CHUNK = 2048
"""Number of rows predicted at once, which bounds the memory of the kernel matrix."""


AMPLITUDES = (0.03, 30.0)
"""Bounds of the prior standard deviation, in units of the output's standard deviation."""

PLAIN_STARTS = ((1.0, 1.0, 0.5), (1.0, 2.0, 0.05))
"""Two starts of the search: amplitude, length scale of all inputs, and noise. In the first, the noise is half of the
amplitude; in the second, a twentieth."""

DRAWN_STARTS = ((1.0, 1.0), (0.7, 5.0), (0.1, 0.7))
"""Bounds of amplitude, each input's length scale and noise for drawn starts of the search. From shorter length scales,
a search ends with noise alone; from longer ones, with ignored inputs."""

JITTER = 1e-10
"""Variance added to the noise's variance, so that a kernel matrix can be factorised."""

COARSE, FINE = 1e-5, 1e-7
"""Least share by which a step must improve the log likelihood to go on, in the first and in the final searches."""


START_ROWS, ITERATIONS = 200, 100
"""Largest number of rows on which starts are compared, and largest number of L-BFGS iterations. The search on all rows
continues from the best two starts."""

LENGTH_SCALES, NOISES = (0.1, 1e3), (1e-3, 2.0)
"""Bounds of a length scale, in standardised inputs, and bounds of the noise, in the output's standard deviations."""


@register("residual", "gp")
@dataclass(frozen=True, eq=False)
class GaussianProcess(SavedArrays):
    """A fitted Gaussian process in plain arrays; far from its training rows it predicts the mean.

    Attributes:
        rows: Training inputs ``(M, F)``, standardised.
        length_scales: Length scale of each output and input ``(k, F)``, in standardised inputs.
        amplitude: Prior standard deviation s of each output ``(k,)``, in units of ``output_std``.
        noise: Standard deviation of each output's noise ``(k,)``, in units of ``output_std``.
        weights: Dual weights ``(k, M)``.
        output_mean: Mean of the training outputs ``(k,)``, m and rad.
        output_std: Standard deviation of the training outputs ``(k,)``, m and rad.
    """

    rows: Array
    length_scales: Array
    amplitude: Array
    noise: Array
    weights: Array
    output_mean: Array
    output_std: Array

    @staticmethod
    def fit(
        inputs: Array,
        targets: Array,
        rng: np.random.Generator,
        *,
        rows: int = 2000,
        likelihood_rows: int = 600,
        starts: int = 8,
    ) -> GaussianProcess:
        """Fit one process per output.

        Args:
            inputs: Standardised inputs ``(N, F)``.
            targets: Residuals to learn ``(N, k)``, m and rad.
            rng: Draws the starts of the search, and the rows to keep if there are too many.
            rows: Largest number of training rows kept, drawn at random without replacement; the cost grows with the
                cube of this number.
            likelihood_rows: Largest number of rows on which the marginal likelihood is maximised.
            starts: Number of random starts of the search, beside the two fixed ones.

        Raises:
            InputError: If there are fewer than ten rows.
        """
        if len(inputs) < 10:
            raise InputError(f"{len(inputs)} poses are too few for a Gaussian process; measure at least 10")
        order = rng.permutation(len(inputs))
        learnt_rows, some = np.sort(order[:rows]), np.sort(order[:likelihood_rows])
        mean, std = targets.mean(axis=0), column_std(targets, 1e-12)
        parts, learnt = [], inputs[learnt_rows]
        with single_threaded():
            for output in ((targets - mean) / std).T:
                amplitude, length, noise = _most_likely(inputs[some], output[some], rng, starts)
                factor = _factor(_kernel(learnt, learnt, length, amplitude), noise)
                parts.append((length, amplitude, noise, cho_solve((factor, True), output[learnt_rows])))
        lengths, amplitudes, noises, weights = map(np.array, zip(*parts, strict=True))
        return GaussianProcess(learnt, lengths, amplitudes, noises, weights, mean, std)

    def predict(self, inputs: ArrayLike) -> Array:
        """Predict mean outputs ``(..., k)`` (m, rad) at standardised inputs ``(..., F)``."""
        inputs = np.asarray(inputs, dtype=float)
        flat = inputs.reshape(-1, inputs.shape[-1])
        mean = np.empty((len(flat), len(self.amplitude)))
        for part in (slice(start, start + CHUNK) for start in range(0, len(flat), CHUNK)):
            for j, weights in enumerate(self.weights):
                mean[part, j] = self._kernel(j, flat[part]) @ weights
        return np.reshape(mean * self.output_std + self.output_mean, (*inputs.shape[:-1], mean.shape[1]))

    def targets(self, output: int) -> Array:
        """Return the training targets of the output with index ``output`` (from 0), standardised ``(M,)``."""
        smooth = self._kernel(output, self.rows) @ self.weights[output]
        return np.asarray(smooth + (self.noise[output] ** 2 + JITTER) * self.weights[output])

    def _kernel(self, output: int, inputs: Array) -> Array:
        """Compute the kernel ``(N, M)`` of one output (index from 0) between inputs ``(N, F)`` and training rows."""
        return _kernel(inputs, self.rows, self.length_scales[output], float(self.amplitude[output]))


def _most_likely(inputs: Array, target: Array, rng: np.random.Generator, drawn: int) -> tuple[float, Array, float]:
    """Return amplitude, length scales ``(F,)`` and noise at the best optimum of the likelihood over all starts.

    Args:
        inputs: Standardised inputs ``(M, F)``.
        target: One output ``(M,)``, standardised.
        rng: Draws the random starts.
        drawn: Number of random starts, beside the two fixed ones.
    """
    count = np.array([1, inputs.shape[1], 1])
    plain = [np.log(np.repeat(start, count)) for start in PLAIN_STARTS]
    low, high = np.log(np.repeat(DRAWN_STARTS, count, axis=0)).T
    starts = [*plain, *rng.uniform(low, high, (drawn, len(low)))]
    some = np.linspace(0, len(inputs) - 1, min(len(inputs), START_ROWS)).astype(int)
    optima = sorted((_search(start, inputs[some], target[some], COARSE) for start in starts), key=itemgetter(1))
    finalists = [optimum for optimum, _ in optima[:2]]
    if len(some) < len(inputs):
        finalists.append(plain[0])  # where some rows show noise alone, all may show more
    best, _ = min((_search(start, inputs, target, FINE) for start in finalists), key=itemgetter(1))
    amplitude, *length, noise = np.exp(best).tolist()
    return amplitude, np.array(length), noise


def _search(start: Array, inputs: Array, target: Array, precision: float) -> tuple[Array, float]:
    """Return the optimum ``(F + 2,)`` that one start leads to, and the negative log marginal likelihood there.

    Args:
        start: Logarithms of amplitude, F length scales and noise, ``(F + 2,)``.
        inputs: Standardised inputs ``(M, F)``.
        target: One output ``(M,)``, standardised.
        precision: Share by which a step must improve the value for the search to go on.
    """
    from scipy.optimize import fmin_l_bfgs_b

    bounds = np.log([AMPLITUDES, *[LENGTH_SCALES] * inputs.shape[1], NOISES]).tolist()
    factr = precision / np.finfo(float).eps
    optimum, value, _ = fmin_l_bfgs_b(
        negative_log_likelihood, start, args=(inputs, target), bounds=bounds, factr=factr, maxiter=ITERATIONS
    )
    return optimum, float(value)


def negative_log_likelihood(theta: Array, inputs: Array, target: Array) -> tuple[float, Array]:
    """Return the negative log marginal likelihood and its gradient (Rasmussen and Williams eqs (2.30), (5.9)).

    Args:
        theta: Logarithms of amplitude, F length scales and noise, ``(F + 2,)``.
        inputs: Standardised inputs ``(M, F)``.
        target: One output ``(M,)``, standardised.
    """
    amplitude, length, noise = np.exp(theta[0]), np.exp(theta[1:-1]), np.exp(theta[-1])
    smooth = _kernel(inputs, inputs, length, amplitude)
    factor = _factor(smooth, noise)
    dual = cho_solve((factor, True), target)
    value = 0.5 * target @ dual + np.log(np.diag(factor)).sum() + 0.5 * len(target) * np.log(2.0 * np.pi)
    half = dpotri(factor, lower=1, overwrite_c=1)[0].T  # with its diagonal halved, half + half.T is the inverse
    half[np.diag_indices_from(half)] *= 0.5
    trace = dual @ dual - 2.0 * np.trace(half)
    half *= smooth
    scaled = inputs / length
    columns = np.column_stack([np.ones(len(inputs)), scaled])
    # (dual dual^T - inverse), times the kernel element by element, times columns
    weighted = dual[:, None] * (smooth @ (dual[:, None] * columns)) - half @ columns - half.T @ columns
    by_length = weighted[:, 0] @ scaled**2 - np.sum(scaled * weighted[:, 1:], axis=0)
    return float(value), -np.concatenate([[weighted[:, 0].sum()], by_length, [noise**2 * trace]])


def _factor(smooth: Array, noise: float) -> Array:
    """Return the lower Cholesky factor of a kernel matrix, with the noise's variance and `JITTER` on its diagonal.

    Args:
        smooth: The kernel matrix without noise ``(M, M)``.
        noise: Standard deviation of the noise.
    """
    matrix = smooth.copy()
    matrix[np.diag_indices_from(matrix)] += noise**2 + JITTER
    return np.asarray(cholesky(matrix.T, lower=True, overwrite_a=True, check_finite=False))


def _kernel(left: Array, right: Array, length: Array, amplitude: float) -> Array:
    """Compute the kernel without noise ``(N, M)`` between two sets of rows.

    Args:
        left: Rows ``(N, F)``.
        right: Rows ``(M, F)``.
        length: Length scale of each input ``(F,)``.
        amplitude: Prior standard deviation s.
    """
    a, b = left / length, right / length
    kernel = a @ b.T
    kernel -= 0.5 * np.sum(a**2, axis=1)[:, None]
    kernel -= 0.5 * np.sum(b**2, axis=1)
    np.exp(np.minimum(kernel, 0.0, out=kernel), out=kernel)
    kernel *= amplitude**2
    return np.asarray(kernel)


def feature_process(process: GaussianProcess, count: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Approximate a fitted process' posterior by a sum of waves with normal weights, to draw whole functions from it.

    The waves are random Fourier features (Rahimi and Recht 2007) with quasi-random frequencies. The posterior of their
    weights is the posterior of a linear regression (Rasmussen and Williams 2006, eqs (2.7)-(2.8)) on the rows and
    targets of the process.

    Args:
        process: The process, with O outputs and F inputs.
        count: Number K of waves per output, each a cosine and a sine; a power of two.
        rng: Draws the frequencies.

    Returns:
        Three arrays. The first has the frequencies of each output's waves over the standardised inputs ``(O, F, K)``.
        The second has the mean weights of the cosines, then of the sines, ``(O, 2 K)``, m and rad. The waves add to the
        process' mean. The third is a factor ``(O, 2 K, 2 K)`` that turns standard normal numbers into deviations of the
        weights.
    """
    from scipy.stats import norm, qmc

    normal = norm.ppf(np.clip(qmc.Sobol(process.rows.shape[1], rng=rng).random(count), 1e-9, 1.0 - 1e-9))
    parts = [_of_output(process, output, normal) for output in range(len(process.noise))]
    frequency, mean, factor = map(np.stack, zip(*parts, strict=True))
    return frequency, mean, factor


def _of_output(process: GaussianProcess, output: int, normal: Array) -> tuple[Array, Array, Array]:
    """Return frequencies ``(F, K)``, mean weights, and the weights' factor for one output of `feature_process`.

    Args:
        process: The process, with F inputs.
        output: Index of the output, from 0.
        normal: Standard normal numbers ``(K, F)``, which set the frequencies.
    """
    frequency = normal.T / process.length_scales[output][:, None]
    scale = float(process.amplitude[output]) / np.sqrt(len(normal))
    angle = process.rows @ frequency
    waves = scale * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
    noise = float(process.noise[output])
    precision = waves.T @ waves / noise**2
    precision[np.diag_indices_from(precision)] += 1.0
    factor = cho_factor(precision, lower=True)
    mean = cho_solve(factor, waves.T @ process.targets(output)) / noise**2
    root = solve_triangular(factor[0], np.eye(len(mean)), lower=True).T
    size = scale * process.output_std[output]
    return frequency, mean * size, root * size
