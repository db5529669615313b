"""Choosing poses by exchange: Fedorov 1972 in the one-after-the-other form of Cook and Nachtsheim 1980.

A pose brings a block of r rows, so the determinant lemma and Woodbury's identity are used with r x r blocks, for all
candidates at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array

RIDGE = 1e-9
"""Information given to every direction from the start, as a share of one candidate's mean, so that inverses exist."""

MAX_PASSES = 20
"""Rounds through the chosen poses at most; three to six are usual."""


def exchange(
    rows: Array,
    count: int,
    rng: np.random.Generator,
    weight: Array | None = None,
    most_passes: int = MAX_PASSES,
    *,
    known: Array | None = None,
) -> tuple[NDArray[np.int64], int]:
    """Choose candidates by greedy addition, then by exchanging one after the other until none can be bettered.

    Args:
        rows: What the candidates tell: weighted, scaled Jacobians ``(N, r, p)``.
        count: How many to choose.
        rng: Draws the order of exchanges.
        weight: W ``(p, p)``, to minimise trace(W M^-1) of the information M; None for D-optimality.
        most_passes: Rounds of exchange at most; without any the candidates come in the order in which they were added.
        known: Information ``(p, p)`` that there is already, of rows measured before.

    Returns:
        Their rows, and the number of passes.
    """
    p = rows.shape[-1]
    ridge = RIDGE * float(np.sum(rows**2)) / len(rows) / p
    information = ridge * np.eye(p) + (0.0 if known is None else known)
    taken = np.zeros(len(rows), dtype=bool)
    chosen: list[int] = []
    for _ in range(count):
        best = int(np.argmax(np.where(taken, -np.inf, gains(rows, information, weight))))
        taken[best] = True
        chosen.append(best)
        information = information + rows[best].T @ rows[best]
    passes, moved = 0, True
    while moved and passes < most_passes:
        passes, moved = passes + 1, False
        for place in rng.permutation(count):
            old = chosen[place]
            without = information - rows[old].T @ rows[old]
            value = np.where(taken, -np.inf, gains(rows, without, weight))
            value[old] = gains(rows[[old]], without, weight)[0]
            best = int(np.argmax(value))
            if value[best] > value[old] + 1e-9 * abs(value[old]):
                chosen[place], moved = best, True
                taken[old], taken[best] = False, True
                information = without + rows[best].T @ rows[best]
    return np.array(chosen), passes


def gains(rows: Array, information: Array, weight: Array | None) -> Array:
    """What each candidate ``(N, r, p)`` would add: log det(I + J M^-1 J^T), or the fall of trace(W M^-1).

    The second is trace((I + J M^-1 J^T)^-1 J M^-1 W M^-1 J^T), by Woodbury's identity.
    """
    values, vectors = np.linalg.eigh(information)
    root = vectors / np.sqrt(np.maximum(values, values[-1] * 1e-15))
    half = rows @ root
    inner = half @ np.swapaxes(half, -1, -2)
    inner[..., np.arange(rows.shape[1]), np.arange(rows.shape[1])] += 1.0
    if weight is None:
        return np.asarray(2.0 * np.log(np.linalg.cholesky(inner).diagonal(axis1=-2, axis2=-1)).sum(axis=-1))
    aimed = half @ (root.T @ weight @ root)
    outer = aimed @ np.swapaxes(half, -1, -2)
    return np.asarray(np.trace(np.linalg.solve(inner, outer), axis1=-2, axis2=-1))
