"""Which parameters the data can tell apart: scaled QR redundancy, Qiao 2026 eqs (9)-(10), made independent of units.

Columns are taken in the model's order; a column that the kept ones before it already explain is dropped, and the
combination that absorbs it is named. The count does not depend on the order, the choice within a tied group does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from pickenv.arm.kinematics.geometry import Array

REDUNDANCY_TOLERANCE = 1e-3
"""A parameter is redundant when what it adds, for a deviation of one tolerance, is below this share of the largest."""


@dataclass(frozen=True)
class Dropped:
    """A parameter that the data cannot tell from others.

    Attributes:
        name: The parameter.
        absorbed_by: What a deviation of 1 (m or rad) of it looks like in the kept parameters (m or rad); empty if the
            parameter has no effect on the measurements at all.
    """

    name: str
    absorbed_by: dict[str, float]


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Result of `identifiability`.

    Attributes:
        names: All parameters, in order.
        kept: Indices of the identifiable base set.
        dropped: The others, each with what absorbs it.
        r_diagonal: |R_kk| of the scaled stacked Jacobian per parameter, ~0 for dropped ones (eq (9)).
        phi: |R_kk| / mean |R_kk|, the paper's ratio (eq (10)).
        singular_values: Of the scaled stacked Jacobian of the kept parameters, per pose (divided by sqrt(N)).
    """

    names: tuple[str, ...]
    kept: NDArray[np.int64]
    dropped: tuple[Dropped, ...]
    r_diagonal: Array
    phi: Array
    singular_values: Array

    @property
    def rank(self) -> int:
        """Number of identifiable parameters."""
        return len(self.kept)

    @property
    def condition(self) -> float:
        """Condition number of the kept, scaled parameters."""
        return float(self.singular_values[0] / self.singular_values[-1])

    def of_all(self, kept: Array) -> Array:
        """One value per parameter ``(P,)`` from one per kept one; NaN for dropped ones."""
        values = np.full(len(self.names), np.nan)
        values[self.kept] = kept
        return values

    @property
    def kept_names(self) -> tuple[str, ...]:
        """Names of the identifiable base set."""
        return tuple(self.names[k] for k in self.kept)


def identifiability(
    matrix: Array, names: tuple[str, ...], tolerance: Array, poses: int, rank_tolerance: float = REDUNDANCY_TOLERANCE
) -> Identifiability:
    """Find a largest identifiable subset of parameters.

    Args:
        matrix: Stacked Jacobian ``(rows, P)``, rows weighted, columns scaled by ``tolerance``.
        names: Parameter names.
        tolerance: The columns' scale, m or rad.
        poses: Number of poses that the rows come from.
        rank_tolerance: See `REDUNDANCY_TOLERANCE`.
    """
    r = np.asarray(np.linalg.qr(matrix, mode="r"))  # columns of the same lengths and angles, in fewer rows
    least = rank_tolerance * np.max(np.linalg.norm(r, axis=0))
    basis = np.zeros((len(r), 0))
    diagonal = np.zeros(len(names))
    for k in range(len(names)):
        rest = r[:, k]
        for _ in range(2):  # twice is enough for orthogonality to the last digit (Kahan, Parlett)
            rest = rest - basis @ (basis.T @ rest)
        diagonal[k] = np.linalg.norm(rest)
        if diagonal[k] > least:
            basis = np.column_stack([basis, rest / diagonal[k]])
    adds = diagonal > least
    kept = np.flatnonzero(adds)
    triangle = basis.T @ r[:, kept]
    dropped = []
    for k in np.flatnonzero(~adds).tolist():
        share = solve_triangular(triangle, basis.T @ r[:, k]) * tolerance[kept] / tolerance[k]
        scaled = np.abs(share) * tolerance[k] / tolerance[kept]
        absorbed = {names[j]: float(c) for j, c, s in zip(kept, share, scaled, strict=True) if s > 1e-3}
        dropped.append(Dropped(names[k], absorbed))
    return Identifiability(
        names=names,
        kept=kept,
        dropped=tuple(dropped),
        r_diagonal=diagonal,
        phi=diagonal / diagonal.mean(),
        singular_values=np.linalg.svd(r[:, kept], compute_uv=False) / np.sqrt(poses),
    )
