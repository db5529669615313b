"""Where an arm's remaining errors are large: what held-out errors say of their size, pose by pose.

Two views of the squared errors are combined, each blind where the other sees: a trend over the joints (log-linear in
their sines and cosines) and a mean of the nearest poses. Their geometric mean is scaled to the mean square found. The
radius that holds 95 of 100 errors follows from errors that took no part in either: split conformal, block by block
(Vovk 2015; Barber, Candes, Ramdas and Tibshirani 2021, CV+).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree
from scipy.stats import spearmanr

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.observations import BLOCKS, Rows, equally_spaced, same_poses

ANCHORS = 400
"""Poses that a calibration keeps at most; each stands for the held-out poses nearest to it."""

NEIGHBOURS, PRIOR = 20, 5.0
"""Anchors that a local mean is of, and how many errors of average size it starts from."""

RIDGE = 30.0
"""Penalty of the trend's coefficients, in errors."""

FLOOR = 0.05
"""Squares are lifted by this share of their median before their logarithm is taken."""

LEAST_LOCAL = 5 * BLOCKS
"""With fewer errors than this their size is taken as the same everywhere."""

SHARE = 0.95


@dataclass(frozen=True, eq=False)
class LocalScatter:
    """Mean square of an error, as a function of the joints.

    Attributes:
        joints: Anchors ``(M, n)``, rad or m.
        squares: Mean square of the errors nearest to each ``(M,)``, m^2 or rad^2.
        counts: How many those are ``(M,)``.
        slides: Which joints slide ``(n,)``.
    """

    joints: Array
    squares: Array
    counts: Array
    slides: tuple[bool, ...]

    def at(self, joints: ArrayLike) -> Array:
        """Mean square expected at joints ``(..., n)``."""
        joints = np.asarray(joints, dtype=float)
        found = self._shape(joint_features(joints.reshape(-1, joints.shape[-1]), self.slides))
        return np.asarray((self._level * found).reshape(joints.shape[:-1]))

    @cached_property
    def _level(self) -> float:
        """Scales the shape to the mean square of all errors."""
        mean = np.average(self.squares, weights=self.counts)
        return float(mean / np.average(self._shape(self._features), weights=self.counts))

    @cached_property
    def _features(self) -> Array:
        return joint_features(self.joints, self.slides)

    @cached_property
    def _scale(self) -> tuple[Array, Array]:
        return self._features.mean(axis=0), self._features.std(axis=0) + 1e-9

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self._features / self._scale[1])

    @cached_property
    def _trend(self) -> tuple[float, Array]:
        """Mean and slopes of the logarithm, by ridge regression."""
        middle, spread = self._scale
        x = (self._features - middle) / spread
        y = np.log(self.squares + FLOOR * np.median(self.squares) + 1e-300)
        mean = float(np.average(y, weights=self.counts))
        weighted = x * self.counts[:, None]
        slopes = np.linalg.solve(weighted.T @ x + RIDGE * np.eye(x.shape[1]), weighted.T @ (y - mean))
        return mean, np.asarray(slopes)

    def _shape(self, features: Array) -> Array:
        middle, spread = self._scale
        mean, slopes = self._trend
        # Beyond the errors seen a trend is no trend: it ends where theirs does.
        known = ((self._features - middle) / spread) @ slopes
        trend = np.exp(mean + np.clip(((features - middle) / spread) @ slopes, known.min(), known.max()))
        count = np.arange(1, min(NEIGHBOURS, len(self.joints)) + 1)
        distance, near = (np.asarray(part) for part in self._tree.query(features / spread, k=count))
        weight = self.counts[near] / (1.0 + (distance / max(float(np.median(self._spacing)), 1e-9)) ** 2)
        average = np.average(self.squares, weights=self.counts)
        local = (np.sum(weight * self.squares[near], axis=1) + PRIOR * average) / (weight.sum(axis=1) + PRIOR)
        return np.asarray(np.sqrt(trend * local))

    @cached_property
    def _spacing(self) -> Array:
        """Distance of the anchors from their neighbours."""
        count = min(NEIGHBOURS, len(self.joints))
        return np.asarray(self._tree.query(self._features / self._scale[1], k=count)[0])

    def as_record(self) -> dict[str, Any]:
        """For a calibration's record (JSON)."""
        return {
            "joints": np.round(self.joints, 5).tolist(),
            "squares": [float(f"{value:.5g}") for value in self.squares],
            "counts": self.counts.astype(int).tolist(),
            "slides": list(self.slides),
        }

    @staticmethod
    def from_record(record: Mapping[str, Any]) -> LocalScatter:
        """What `as_record` gave."""
        joints, squares, counts = (np.array(record[name], dtype=float) for name in ("joints", "squares", "counts"))
        return LocalScatter(joints, squares, counts, tuple(record["slides"]))


@dataclass(frozen=True)
class Within95:
    """How far errors go beyond their expected size.

    Attributes:
        factor: 95 of 100 errors are smaller than this many times their expected root mean square.
        covered: Share of the held-out errors within it, each judged by a factor and a size found without its block.
        rank_correlation: Of error and expected size, likewise: 0 if the size told nothing, 1 if it told the order.
    """

    factor: float
    covered: float
    rank_correlation: float


def local_scatter(joints: Array, squares: Array, slides: Sequence[bool]) -> LocalScatter | None:
    """The expected size of errors, from squared ones ``(R,)`` at joints ``(R, n)``; None where they are few."""
    if len(squares) < LEAST_LOCAL:
        return None
    features = joint_features(joints, tuple(slides))
    scaled = features / (features.std(axis=0) + 1e-9)
    chosen = equally_spaced(len(joints), ANCHORS)
    _, nearest = KDTree(scaled[chosen]).query(scaled)
    counts = np.bincount(nearest, minlength=len(chosen)).astype(float)
    sums = np.bincount(nearest, squares, minlength=len(chosen))
    kept = counts > 0
    return LocalScatter(joints[chosen][kept], sums[kept] / counts[kept], counts[kept], tuple(slides))


def within95(
    joints: Array, squares: Array, variance: Array, slides: Sequence[bool], blocks: Rows | None
) -> Within95 | None:
    """The factor that covers 95 of 100, and what it covers of errors that it was found without.

    Args:
        joints: Of each error ``(R, n)``.
        squares: Squared errors ``(R,)``.
        variance: What the parameters' uncertainty adds to each expected square ``(R,)``.
        slides: Which joints slide.
        blocks: The block of each error; contiguous tenths of the poses where there are none.
    """
    count = len(squares)
    if count < 2 * BLOCKS:
        return None
    if blocks is None:
        poses = same_poses(joints)
        blocks = poses * BLOCKS // (int(poses.max()) + 1)
    blocks = np.unique(blocks, return_inverse=True)[1]
    if not blocks.any():
        return None
    ratio, expected = np.zeros(count), np.zeros(count)
    for block in range(int(blocks.max()) + 1):
        here = blocks == block
        known = local_scatter(joints[~here], squares[~here], slides)
        size = np.full(int(here.sum()), squares[~here].mean()) if known is None else known.at(joints[here])
        expected[here] = np.sqrt(size + variance[here])
        ratio[here] = np.sqrt(squares[here]) / expected[here]
    inside = [ratio[blocks == block] <= _quantile(ratio[blocks != block]) for block in range(int(blocks.max()) + 1)]
    told = 0.0 if np.ptp(expected) == 0 else float(spearmanr(expected, np.sqrt(squares)).statistic)
    return Within95(_quantile(ratio), float(np.concatenate(inside).mean()), told)


def _quantile(ratio: Array) -> float:
    """The smallest of them that holds 95 of 100 of these and one more."""
    rank = int(np.ceil(SHARE * (len(ratio) + 1)))
    return float(np.sort(ratio)[min(rank, len(ratio)) - 1])


def joint_features(joints: Array, slides: tuple[bool, ...]) -> Array:
    """Sines and cosines of joints that turn, and joints that slide as they are."""
    straight = np.array(slides)
    turning = joints[:, ~straight]
    return np.concatenate([np.sin(turning), np.cos(turning), joints[:, straight]], axis=1)
