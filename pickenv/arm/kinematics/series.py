"""Sines and cosines of many angles by their Taylor series: operations alone, which can be compiled among others.

They differ from NumPy's by roundings. What is to keep NumPy's bits leaves them to NumPy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pickenv.arm.kinematics.forward import Scalar

PI, PI_REST = float.fromhex("0x1.921fb544p+1"), float.fromhex("0x1.0b4611a626331p-33")
"""Half a turn, rad: its first 33 bits, of which many times are exact, and what is missing."""

TERMS = 11
"""Of each series: at a quarter turn the first one left out is less than half a rounding of the largest."""


class Series:
    """What `numpy` is to the angles of arms, for arrays and for what is traced.

    Args:
        m: ``numpy``, or `pickenv.arm.kinematics.tracing.SYMBOLS`.
    """

    def __init__(self, m: Any) -> None:
        self._round: Callable[[Scalar], Scalar] = m.round

    def sin(self, angle: Scalar) -> Scalar:
        """The sine of an angle, rad."""
        sign, rest = self._reduced(angle)
        return sign * (rest * _summed(rest * rest, 1))

    def cos(self, angle: Scalar) -> Scalar:
        """The cosine of an angle, rad."""
        sign, rest = self._reduced(angle)
        return sign * _summed(rest * rest, 0)

    def _reduced(self, angle: Scalar) -> tuple[Scalar, Scalar]:
        """What is left of an angle after whole half turns, and the sign that these give to its sine and cosine."""
        halves = self._round(angle * (1.0 / math.pi))
        odd = halves - 2.0 * self._round(0.5 * halves)
        return 1.0 - 2.0 * (odd * odd), (angle - PI * halves) - PI_REST * halves


def _summed(square: Scalar, first: int) -> Scalar:
    """The sum of (-square)^k / (2 k + first)! over `TERMS` k."""
    total = square * (1.0 / math.factorial(2 * TERMS - 2 + first))
    for k in reversed(range(TERMS - 1)):
        total = 1.0 / math.factorial(2 * k + first) - total
        total = total if k == 0 else square * total
    return total
