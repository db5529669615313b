"""Least squares on contiguous blocks of rows at once: normal equations of all columns that may take part, by block.

Near a fitted geometry everything that may be added is linear, so the equations of the rows without a block are those of
all rows less the block's own. Any choice of columns is then fitted, and judged on the block left out, by small matrices
alone. Rows are whitened; coefficients are in their tolerances, with their prior.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import ArmModel, Term
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.prior import expected_sizes

Places = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Linearised:
    """A fitted geometry with terms that may be added to it, as a linear model of what it leaves.

    Its parameters are the fit's own, geometry and unknowns of the measurements alike, then the terms' coefficients.

    Attributes:
        arm: The fitted geometry and the terms, all coefficients zero.
        unknowns: Fitted unknowns of the measurements, by name.
        names: Names of the parameters.
        scale: What their columns are multiplied by ``(P,)``: coefficients are in their tolerances.
        ridge: What the priors add to the normal equations' diagonal ``(P,)``.
        pull: What they add to the right-hand side ``(P,)``: parameters fitted have left where they are expected.
    """

    arm: ArmModel
    unknowns: dict[str, float]
    names: tuple[str, ...]
    scale: Array
    ridge: Array
    pull: Array

    @staticmethod
    def of(bare: Identification, terms: tuple[Term, ...]) -> Linearised:
        """Terms added to a geometry that was identified without them."""
        arm, fitted = ArmModel.of(bare.geometry, terms), bare.identifiability.kept_names
        names = fitted + arm.parameter_names[len(bare.geometry.parameter_names) :]
        scale = np.r_[np.ones(len(fitted)), arm.term_tolerances]
        of_fitted = (bare.scatter / bare.prior_std[bare.identifiability.kept]) ** 2
        ridge = np.r_[of_fitted, (bare.scatter / expected_sizes(arm)) ** 2]
        moved = np.zeros(len(fitted))
        if bare.prior is not None:
            change = dict(zip(bare.geometry.parameter_names, bare.prior.start.difference(bare.arm_model), strict=True))
            moved = np.array([change.get(name, 0.0) for name in fitted])
        return Linearised(
            arm, bare.unknowns, names, scale, ridge, np.r_[-of_fitted * moved, np.zeros(len(scale) - len(moved))]
        )

    @property
    def fitted(self) -> Places:
        """Places of the parameters that are no coefficients."""
        return np.arange(len(self.names) - len(self.arm.coefficients))

    def coefficients_of(self, term: int) -> Places:
        """Places of one term's coefficients."""
        counts = [len(each.names(self.arm.geometry)) for each in self.arm.terms]
        first = len(self.fitted) + sum(counts[:term])
        return np.arange(first, first + counts[term])

    def equations(self, data: Observations) -> tuple[Array, Array]:
        """Whitened columns ``(R, P)`` and what the geometry leaves ``(R,)``."""
        own = data.unknowns()
        values = np.array([self.unknowns[name] for name in own])
        by_arm, by_unknown = data.jacobian(self.arm, values)
        columns = np.zeros((len(by_arm), len(self.names)))
        first, count = len(self.fitted), len(self.arm.geometry.parameter_names)
        place = {name: i for i, name in enumerate(self.names[:first])}
        for names, part in ((own, by_unknown), (self.arm.geometry.parameter_names, by_arm)):
            here = [i for i, name in enumerate(names) if name in place]
            columns[:, [place[names[i]] for i in here]] = part[:, here]
        columns[:, first:] = by_arm[:, count:]
        return columns * self.scale, data.residual(self.arm, values)

    def misses(self, data: Observations, solution: Array) -> Array:
        """What remains of the data ``(R, 3)`` or ``(R, 1)``, m, with parameters changed by a solution ``(P,)``."""
        change = defaultdict(float, zip(self.names, solution * self.scale, strict=True))
        terms = tuple(term for i, term in enumerate(self.arm.terms) if solution[self.coefficients_of(i)].any())
        arm = ArmModel.of(self.arm.geometry, terms)
        arm = arm.displaced(np.array([change[name] for name in arm.parameter_names]))
        return data.misses(arm, np.array([self.unknowns[name] + change[name] for name in data.unknowns()]))


@dataclass(frozen=True, eq=False)
class BlockEquations:
    """Normal equations of a linearised model, by block.

    Attributes:
        model: The model.
        blocks: The data.
        matrix: A^T A of each block ``(B, P, P)``.
        right: A^T r of each ``(B, P)``.
        square: r^T r of each ``(B,)``.
    """

    model: Linearised
    blocks: tuple[Observations, ...]
    matrix: Array
    right: Array
    square: Array

    @staticmethod
    def of(model: Linearised, blocks: Sequence[Observations]) -> BlockEquations:
        """The equations of these blocks."""
        parts = [model.equations(block) for block in blocks]
        return BlockEquations(
            model,
            tuple(blocks),
            np.stack([columns.T @ columns for columns, _ in parts]),
            np.stack([left @ columns for columns, left in parts]),
            np.array([left @ left for _, left in parts]),
        )

    def without(self, block: int | None) -> tuple[Array, Array]:
        """Normal equations, with priors, of all blocks but one, or of all."""
        matrix, right = self.matrix.sum(axis=0), self.right.sum(axis=0)
        if block is not None:
            matrix, right = matrix - self.matrix[block], right - self.right[block]
        return matrix + np.diag(self.model.ridge), right + self.model.pull

    def left(self, block: int, solution: Array) -> float:
        """Sum of squares that a solution leaves of one block."""
        drawn = self.matrix[block] @ solution - 2.0 * self.right[block]
        return float(self.square[block] + solution @ drawn)


def solved(matrix: Array, right: Array, places: Places) -> Array:
    """Solution ``(P,)`` of normal equations with the parameters at ``places`` alone; the others stay zero."""
    scale = np.sqrt(np.diag(matrix)[places])
    small = matrix[np.ix_(places, places)] / np.outer(scale, scale) + 1e-12 * np.eye(len(places))
    found = np.zeros(len(right))
    found[places] = np.linalg.solve(small, right[places] / scale) / scale
    return found
