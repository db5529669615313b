"""Minimum-norm solutions of J x = e with small singular values cut off, for thousands of small J at once.

Does what `pickenv.arm.kinematics.task_space.truncated_inverse` does, without one LAPACK call per pose: J^T J is
factorised in components, the direction that is to be cut off is found by inverse iteration and projected out. Poses
where more than one direction, or a doubtful one, would have to go are handed to the singular value decomposition.
The same lines run on NumPy arrays and torch tensors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import ModuleType

from pickenv.arm.kinematics.backend import possible
from pickenv.arm.kinematics.forward import Scalar
from pickenv.arm.kinematics.task_space import DIRECTION_TOLERANCE
from pickenv.arm.kinematics.tracing import Traced

RIDGE = 16.0
"""Added to the diagonal of J^T J so that it can be factorised where it is singular: roundings of its trace."""

SETTLED = 1e-4
"""How much the direction that may be cut off can still turn in the last iteration, as 1 - cosine."""

START = (0.9, -0.4, 1.0, 0.7, -1.1, 0.6, -0.3)
"""Where the search for it starts: close to no direction that symmetry makes likely."""

Columns = Sequence[Sequence[Scalar]]
"""n columns of J, each six components ``(...)``; plain zeros cost nothing."""


class TruncatedSolver:
    """Factorised Jacobians of N poses, to be solved for as many right-hand sides as wanted.

    Args:
        columns: The columns of J.
        m: ``numpy`` or ``torch``.
    """

    def __init__(self, columns: Columns, m: ModuleType) -> None:
        self.columns, self._m = columns, m
        n = len(columns)
        gram = [[_dot(columns[i], columns[j]) for j in range(i + 1)] for i in range(n)]
        trace = sum((gram[i][i] for i in range(1, n)), gram[0][0])
        ridge = RIDGE * float(m.finfo(trace.dtype).eps) * trace
        for i in range(n):
            gram[i][i] = gram[i][i] + ridge
        self._factors = _factorised(gram)
        before = self._solve([START[i % len(START)] for i in range(n)])
        smallest = self._solve(before)
        along, length = _dot(before, smallest), m.sqrt(_dot(smallest, smallest))
        settled = m.abs(along) > (1.0 - SETTLED) * length * m.sqrt(_dot(before, before))
        # Squares of singular values are eigenvalues of J^T J. Its trace is between the largest and n times the largest.
        least, cut = along / length / length, DIRECTION_TOLERANCE**2 * trace
        self.lost = settled & (least - ridge < 0.5 * cut / n)
        inverse_determinant = least
        for inverse in self._factors[1]:
            inverse_determinant = inverse_determinant * inverse
        # The other eigenvalues' product is known, and the geometric mean of those above the second below their mean.
        others = math.prod([trace / max(n - 2, 1)] * (n - 2))
        clear = self.lost & (inverse_determinant * cut * others < 1.0)
        if possible(m, ~clear):  # no eigenvalue is less than the inverse of the inverse's trace
            clear = clear | (_inverse_trace(*self._factors) * cut < 1.0)
        self.doubtful = m.where(~clear)
        self._direction = [m.where(self.lost, value / length, 0.0) for value in smallest]
        self._inverses: Scalar = None
        if not isinstance(clear, Traced) and len(self.doubtful[0]):  # whoever runs what was traced asks for the others
            self._zeros = m.zeros_like(trace)
            rows = m.stack([self._in_doubt(column) for column in columns], 2)
            inverse = m.linalg.pinv(rows, rtol=DIRECTION_TOLERANCE)
            self._inverses = inverse @ m.swapaxes(inverse, 1, 2)  # of J^T J

    def solve(self, right: Sequence[Scalar], columns: Columns | None = None) -> list[Scalar]:
        """Solutions, n components ``(...)``, for right-hand sides of six components ``(...)``.

        Args:
            right: The right-hand sides.
            columns: Of a J that has moved a little since it was factorised: iterations then end where J^T of this one
                sends nothing of what remains, though the factors are the old ones.
        """
        wanted = [_dot(column, right) for column in columns or self.columns]
        solution = _without(self._direction, self._solve(_without(self._direction, wanted)))
        if self._inverses is not None:
            exact = self._m.einsum("kij,kj->ik", self._inverses, self._in_doubt(wanted))
            for value, right_one in zip(solution, exact, strict=True):
                value[self.doubtful] = right_one
        return solution

    def _in_doubt(self, values: Sequence[Scalar]) -> Scalar:
        """The doubtful poses' values ``(k, len(values))``, plain numbers among them written out."""
        return self._m.stack([(self._zeros + value)[self.doubtful] for value in values], 1)

    def _solve(self, right: Sequence[Scalar]) -> list[Scalar]:
        """Solve with the factorised L D L^T."""
        lower, inverse_diagonal = self._factors
        values = list(right)
        n = len(values)
        for i in range(n):
            for j in range(i):
                values[i] = values[i] - lower[i][j] * values[j]
        values = [value * inverse for value, inverse in zip(values, inverse_diagonal, strict=True)]
        for i in reversed(range(n)):
            for j in range(i + 1, n):
                values[i] = values[i] - lower[j][i] * values[j]
        return values


def _dot(one: Sequence[Scalar], other: Sequence[Scalar]) -> Scalar:
    """Scalar product of components; products with plain zeros are left out."""
    terms = [a * b for a, b in zip(one, other, strict=True) if not (_is_zero(a) or _is_zero(b))]
    return sum(terms[1:], terms[0]) if terms else 0.0


def _is_zero(value: Scalar) -> bool:
    return isinstance(value, float) and value == 0.0


def _factorised(gram: list[list[Scalar]]) -> tuple[list[list[Scalar]], list[Scalar]]:
    """Unit lower triangle L and the inverse of the diagonal D of the lower triangle ``gram`` = L D L^T."""
    lower: list[list[Scalar]] = []
    inverse: list[Scalar] = []
    for i, row in enumerate(gram):
        scaled: list[Scalar] = []  # L times D
        for j in range(i):
            value = row[j]
            for k in range(j):
                value = value - scaled[k] * lower[j][k]
            scaled.append(value)
        lower.append([value * inverse[j] for j, value in enumerate(scaled)])
        diagonal = row[i]
        for value, factor in zip(scaled, lower[i], strict=True):
            diagonal = diagonal - value * factor
        inverse.append(1.0 / diagonal)
    return lower, inverse


def _inverse_trace(lower: list[list[Scalar]], inverse_diagonal: list[Scalar]) -> Scalar:
    """Trace of the inverse of L D L^T: the squares of L^-1, weighed by D^-1."""
    total: Scalar = 0.0
    inverse: list[list[Scalar]] = []  # of L, below its diagonal
    for i, row in enumerate(lower):
        inverse.append([-sum((row[k] * inverse[k][j] for k in range(j + 1, i)), row[j]) for j in range(i)])
        total = total + inverse_diagonal[i] * sum((value * value for value in inverse[i]), 1.0)
    return total


def _without(direction: Sequence[Scalar], vector: Sequence[Scalar]) -> list[Scalar]:
    """``vector`` without its part along the unit vector ``direction``."""
    along = _dot(direction, vector)
    return [value - along * part for value, part in zip(vector, direction, strict=True)]
