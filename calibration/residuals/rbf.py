"""Radial basis function network: k-means centres, Gaussian bells of one width, ridge output weights.

The comparator "RBF" of Qiao 2026 (Table 4, refs [29], [30]). Width and ridge are chosen by generalised cross-validation
(Golub, Heath and Wahba 1979), which costs one singular value decomposition per width. Inputs are standardised.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.residuals.standardising import spread
from pickenv.errors import InputError
from pickenv.threads import single_threaded


@dataclass(frozen=True)
class RbfSettings:
    """How the network is fitted.

    Attributes:
        centres: Number of bells at most; a third of the rows where these are few.
        widths: Widths tried, in units of the median distance between rows and centres.
        ridges: Ridge coefficients tried, relative to the largest squared singular value.
        rounds: Rounds of k-means.
    """

    centres: int = 200
    widths: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0)
    ridges: tuple[float, ...] = (1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
    rounds: int = 20


@dataclass(frozen=True, eq=False)
class Rbf:
    """A fitted network in plain arrays; far from its centres it predicts the mean.

    Attributes:
        centres: Centres of the bells ``(C, F)``, in standardised inputs.
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
            _bells(np.asarray(inputs, dtype=float), self.centres, self.width) @ self.weights + self.offset
        )

    def arrays(self) -> dict[str, Array]:
        """All numbers by name, for saving."""
        return {"centres": self.centres, "width": np.array(self.width), "weights": self.weights, "offset": self.offset}

    @staticmethod
    def from_arrays(named: Mapping[str, NDArray[Any]]) -> Rbf:
        """The inverse of `arrays`."""
        return Rbf(named["centres"], float(named["width"]), named["weights"], named["offset"])


def fit_rbf(inputs: Array, targets: Array, rng: np.random.Generator, settings: RbfSettings | None = None) -> Rbf:
    """Fit the network.

    Args:
        inputs: Standardised inputs ``(N, F)``.
        targets: Residuals to learn ``(N, k)``, m and rad.
        rng: Draws the first centres of k-means.
        settings: How; the defaults when left out.

    Raises:
        InputError: If there are fewer than ten rows.
    """
    settings = settings or RbfSettings()
    rows = len(inputs)
    if rows < 10:
        raise InputError(f"{rows} poses are too few for an RBF network; measure at least 10")
    centres = k_means(inputs, min(settings.centres, rows // 3), rng, settings.rounds)
    offset, scale = targets.mean(axis=0), spread(targets, 1e-12)
    wanted = (targets - offset) / scale
    unit = float(np.sqrt(np.median(_squared_distances(inputs, centres))))
    best, chosen = np.inf, (1.0, np.zeros((len(centres), targets.shape[1])))
    for width in (share * unit for share in settings.widths):
        with single_threaded():
            u, s, vt = np.linalg.svd(_bells(inputs, centres, width), full_matrices=False)
        seen = u.T @ wanted
        outside = np.sum(wanted**2) - np.sum(seen**2)
        for ridge in settings.ridges:
            damping = ridge * s[0] ** 2
            kept = s**2 / (s**2 + damping)
            missed = outside + np.sum(((1.0 - kept)[:, None] * seen) ** 2)
            score = missed / (1.0 - kept.sum() / rows) ** 2
            if score < best:
                best, chosen = score, (width, vt.T @ ((s / (s**2 + damping))[:, None] * seen))
    return Rbf(centres, chosen[0], chosen[1] * scale, offset)


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


def _bells(points: Array, centres: Array, width: float) -> Array:
    return np.asarray(np.exp(_squared_distances(points, centres) / (-2.0 * width**2)))
