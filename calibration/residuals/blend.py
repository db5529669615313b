"""The mean of a Gaussian process and a forest: their mistakes differ, so the mean is surer than either.

A process extrapolates smoothly but may settle on length scales that suit only its training rows; trees never leave the
range of what they saw. Which of the two is better changes from one data set, and from one block, to the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.residuals.extra_trees import ExtraTrees, fit_extra_trees
from pickenv.calibration.residuals.gaussian_process import GaussianProcess, fit_gaussian_process
from pickenv.calibration.residuals.saved_arrays import named_part, part_of


@dataclass(frozen=True, eq=False)
class Blend:
    """Mean of a process and a forest.

    Attributes:
        process: The Gaussian process.
        trees: The forest.
    """

    process: GaussianProcess
    trees: ExtraTrees

    def predict(self, inputs: ArrayLike) -> Array:
        """Outputs ``(..., k)`` at standardised inputs ``(..., F)``."""
        return np.asarray(0.5 * (self.process.predict(inputs) + self.trees.predict(inputs)))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All numbers by name, for saving without pickle."""
        return named_part("process_", self.process.arrays()) | named_part("trees_", self.trees.arrays())

    @staticmethod
    def from_arrays(named: Mapping[str, NDArray[Any]]) -> Blend:
        """The inverse of `arrays`."""
        process, trees = part_of(named, "process_"), part_of(named, "trees_")
        return Blend(GaussianProcess.from_arrays(process), ExtraTrees.from_arrays(trees))


def fit_blend(inputs: Array, targets: Array, rng: np.random.Generator) -> Blend:
    """Fit both to inputs ``(N, F)`` and targets ``(N, k)``."""
    return Blend(fit_gaussian_process(inputs, targets, rng), fit_extra_trees(inputs, targets, rng))
