"""A Gaussian process as a sum of cosines with normal weights, so that whole functions can be drawn from its posterior.

Random Fourier features (Rahimi and Recht 2007) with quasi-random frequencies; the weights' posterior is that of a
linear regression (Rasmussen and Williams 2006, eqs (2.7)-(2.8)) on the process' own rows and targets, which its dual
weights hold: y = (K + noise^2 I) weights. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.stats import norm, qmc

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.residuals.gaussian_process import GaussianProcess


@dataclass(frozen=True, eq=False)
class FeatureProcess:
    """A process' posterior over functions.

    Attributes:
        frequency: Of each output's waves by the standardised inputs ``(O, F, K)``.
        mean: Mean weights of their cosines, then their sines ``(O, 2 K)``, m and rad.
        factor: Weights per standard normal number ``(O, 2 K, 2 K)``.
        offset: Constant part of each output ``(O,)``.
        noise: Standard deviation of what is no function of the inputs ``(O,)``, m and rad.
    """

    frequency: Array
    mean: Array
    factor: Array
    offset: Array
    noise: Array


def feature_process(process: GaussianProcess, count: int, rng: np.random.Generator) -> FeatureProcess:
    """The posterior of a fitted process in ``count`` waves per output, each a cosine and a sine; a power of two."""
    drawn = qmc.Sobol(process.rows.shape[1], rng=rng).random(count)
    normal = norm.ppf(np.clip(drawn, 1e-9, 1.0 - 1e-9))
    parts = [_of_output(process, output, normal) for output in range(len(process.noise))]
    frequency, mean, factor = (np.stack(each) for each in zip(*parts, strict=True))
    return FeatureProcess(frequency, mean, factor, process.output_mean, process.noise * process.output_std)


def _of_output(process: GaussianProcess, output: int, normal: Array) -> tuple[Array, Array, Array]:
    """Frequencies ``(F, K)``, mean weights and their factor of one output."""
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
