"""Radial basis function network: k-means centres, Gaussian basis functions of one width, ridge output weights.

The comparator "RBF" of Qiao 2026 (Table 4, refs [29], [30]). Width and ridge are chosen by generalised cross-validation
(Golub, Heath and Wahba 1979), which costs one singular value decomposition per width. Inputs are standardised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.residuals.regressor import SavedArrays, column_std
from pickenv.errors import InputError
from pickenv.threads import single_threaded


@dataclass(frozen=True, eq=False)
class Rbf(SavedArrays):
    """A fitted network in plain arrays; far from its centres it predicts the mean.

    Attributes:
        centres: Centres of the basis functions ``(C, F)``, in standardised inputs.
        width: Their common width, in standardised inputs.
        weights: Output weights ``(C, k)``, m and rad.
        offset: Output far from every centre ``(k,)``, m and rad.
    """

    centres: Array
    width: float
    weights: Array
    offset: Array

    def predict(self, inputs: ArrayLike) -> Array:
        """Outputs ``(..., k)`` (m, rad) at standardised inputs ``(..., F)``."""
        return np.asarray(
            _gaussians(np.asarray(inputs, dtype=float), self.centres, self.width) @ self.weights + self.offset
        )


def fit_rbf(
    inputs: Array,
    targets: Array,
    rng: np.random.Generator,
    *,
    centres: int = 200,
    widths: Sequence[float] = (0.25, 0.5, 1.0, 2.0),
    ridges: Sequence[float] = (1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2),
    rounds: int = 20,
) -> Rbf:
    """Fit the network.

    Args:
        inputs: Standardised inputs ``(N, F)``.
        targets: Residuals to learn ``(N, k)``, m and rad.
        rng: Draws the first centres of k-means.
        centres: Number of basis functions at most; a third of the rows where these are few.
        widths: Widths tried, in units of the median distance between rows and centres.
        ridges: Ridge coefficients tried, relative to the largest squared singular value.
        rounds: Rounds of k-means.

    Raises:
        InputError: If there are fewer than ten rows.
    """
    rows = len(inputs)
    if rows < 10:
        raise InputError(f"{rows} poses are too few for an RBF network; measure at least 10")
    middles = k_means(inputs, min(centres, rows // 3), rng, rounds)
    offset, scale = targets.mean(axis=0), column_std(targets, 1e-12)
    wanted = (targets - offset) / scale
    unit = float(np.sqrt(np.median(_squared_distances(inputs, middles))))
    best, chosen = np.inf, (1.0, np.zeros((len(middles), targets.shape[1])))
    for width in (factor * unit for factor in widths):
        with single_threaded():
            u, s, vt = np.linalg.svd(_gaussians(inputs, middles, width), full_matrices=False)
        seen = u.T @ wanted
        outside = np.sum(wanted**2) - np.sum(seen**2)
        for ridge in ridges:
            damping = ridge * s[0] ** 2
            kept = s**2 / (s**2 + damping)
            missed = outside + np.sum(((1.0 - kept)[:, None] * seen) ** 2)
            score = missed / (1.0 - kept.sum() / rows) ** 2
            if score < best:
                best, chosen = score, (width, vt.T @ ((s / (s**2 + damping))[:, None] * seen))
    return Rbf(middles, chosen[0], chosen[1] * scale, offset)


def k_means(points: Array, count: int, rng: np.random.Generator, rounds: int) -> Array:
    """Lloyd's k-means from ``count`` of the points: centres ``(count, F)``; an empty cluster keeps its centre."""
    centres = points[rng.choice(len(points), count, replace=False)]
    for _ in range(rounds):
        nearest = np.argmin(_squared_distances(points, centres), axis=1)
        members = np.bincount(nearest, minlength=count)
        sums = np.zeros_like(centres)
        np.add.at(sums, nearest, points)
        filled = members > 0
        centres = centres.copy()
        centres[filled] = sums[filled] / members[filled, None]
    return centres


def _squared_distances(points: Array, centres: Array) -> Array:
    squares = np.sum(points**2, axis=-1)[..., None] + np.sum(centres**2, axis=-1) - 2.0 * points @ centres.T
    return np.asarray(np.maximum(squares, 0.0))


def _gaussians(points: Array, centres: Array, width: float) -> Array:
    return np.asarray(np.exp(_squared_distances(points, centres) / (-2.0 * width**2)))
