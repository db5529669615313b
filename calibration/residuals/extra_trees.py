"""Extremely randomised trees (Geurts, Ernst and Wehenkel 2006): grown by scikit-learn, kept and run as flat arrays.

A prediction walks all trees at once in NumPy: no pickle, no scikit-learn at run time. Piecewise constant, so outside
the measured region it holds the nearest value instead of running away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.residuals.saved_arrays import SavedArrays
from pickenv.calibration.residuals.standardising import column_std
from pickenv.errors import InputError
from pickenv.extras import require

CHUNK = 4096
"""Rows predicted at once."""


@dataclass(frozen=True, eq=False)
class ExtraTrees(SavedArrays):
    """A forest of T trees with B nodes in all, in flat arrays; node numbers count through all trees.

    Attributes:
        roots: First node of each tree ``(T,)``.
        left: Node to go to where the input does not exceed the threshold ``(B,)``; a leaf names itself.
        right: Node to go to otherwise ``(B,)``.
        feature: Input that is compared ``(B,)``; 0 in leaves.
        threshold: What it is compared with ``(B,)``, in standardised inputs.
        value: Output of each node ``(B, k)``, m and rad.
        depth: Levels of the deepest tree.
    """

    roots: NDArray[np.int32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    feature: NDArray[np.int32]
    threshold: Array
    value: NDArray[np.float32]
    depth: int

    def predict(self, inputs: ArrayLike) -> Array:
        """Mean output of the trees ``(..., k)`` (m, rad) at standardised inputs ``(..., F)``."""
        inputs = np.asarray(inputs, dtype=float)
        flat = inputs.reshape(-1, inputs.shape[-1]).astype(np.float32)  # thresholds were found in single precision
        values = np.empty((len(flat), self.value.shape[1]))
        for start in range(0, len(flat), CHUNK):
            values[start : start + CHUNK] = self._mean(flat[start : start + CHUNK])
        return values.reshape(*inputs.shape[:-1], values.shape[1])

    def _mean(self, inputs: NDArray[np.float32]) -> Array:
        rows = np.arange(len(inputs))[:, None]
        node = np.broadcast_to(self.roots, (len(inputs), len(self.roots)))
        for _ in range(self.depth):
            low = inputs[rows, self.feature[node]] <= self.threshold[node]
            node = np.where(low, self.left[node], self.right[node])
        return np.asarray(self.value[node].mean(axis=1, dtype=float))


def fit_extra_trees(
    inputs: Array,
    targets: Array,
    rng: np.random.Generator,
    *,
    trees: int = 100,
    min_samples_leaf: int = 2,
    max_features: float = 1.0,
) -> ExtraTrees:
    """Grow the forest.

    Args:
        inputs: Standardised inputs ``(N, F)``.
        targets: Residuals to learn ``(N, k)``, m and rad; a split serves all outputs, each standardised.
        rng: Seeds the trees.
        trees: Number of trees.
        min_samples_leaf: Rows in a leaf at least.
        max_features: Fraction of the inputs tried at each split.

    Raises:
        InputError: If there are fewer than ten rows.
    """
    require("sklearn")
    from sklearn.ensemble import ExtraTreesRegressor  # type: ignore[import-untyped]

    if len(inputs) < 10:
        raise InputError(f"{len(inputs)} poses are too few for a tree ensemble; measure at least 10")
    mean, scale = targets.mean(axis=0), column_std(targets, 1e-12)
    forest = ExtraTreesRegressor(
        n_estimators=trees,
        min_samples_leaf=min_samples_leaf,
        max_features=max_features,
        random_state=int(rng.integers(2**31)),
    )
    forest.fit(inputs, (targets - mean) / scale)
    return flat_forest([one.tree_ for one in forest.estimators_], scale, mean)


def flat_forest(grown: Sequence[Any], scale: Array, offset: Array) -> ExtraTrees:
    """scikit-learn's trees as flat arrays, their outputs ``(k,)`` multiplied by ``scale``, then ``offset`` added."""
    roots = np.cumsum([0] + [tree.node_count for tree in grown])
    left, right, feature = [], [], []
    for root, tree in zip(roots, grown, strict=False):
        leaf = tree.children_left < 0
        own = np.arange(tree.node_count)
        left.append(root + np.where(leaf, own, tree.children_left))
        right.append(root + np.where(leaf, own, tree.children_right))
        feature.append(np.where(leaf, 0, tree.feature))
    return ExtraTrees(
        roots=roots[:-1].astype(np.int32),
        left=np.concatenate(left).astype(np.int32),
        right=np.concatenate(right).astype(np.int32),
        feature=np.concatenate(feature).astype(np.int32),
        threshold=np.concatenate([tree.threshold for tree in grown]),
        value=(np.concatenate([tree.value[:, :, 0] for tree in grown]) * scale + offset).astype(np.float32),
        depth=max(tree.max_depth for tree in grown),
    )
