"""Numbers of an instrument as far as they are known: exactly, within a standard uncertainty, or not at all.

Where a wire's reading begins, how long a ball bar is, where the tool point sits: what is not exact is an unknown of the
least squares, and what is known of it stands there as one more equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.splits import Rows


@dataclass(frozen=True, eq=False)
class Stated:
    """K numbers, each with what is known of it.

    Attributes:
        names: Of the numbers.
        values: As they are stated ``(K,)``; of unknown ones where to begin.
        std: Standard uncertainty of each ``(K,)``: 0 where it is exact, infinite where it is unknown.
        scales: Scale of each one's deviation ``(K,)``.
    """

    names: tuple[str, ...]
    values: Array
    std: Array
    scales: Array

    @property
    def free(self) -> Rows:
        """Which numbers are fitted."""
        return np.flatnonzero(self.std > 0.0)

    @property
    def _known(self) -> Rows:
        """Which of the fitted ones something is known of."""
        return np.flatnonzero(np.isfinite(self.std[self.free]))

    def unknowns(self) -> tuple[str, ...]:
        """Names of the fitted ones."""
        return tuple(self.names[i] for i in self.free)

    def tolerances(self) -> Array:
        """Their scales."""
        return self.scales[self.free]

    def start(self) -> Array:
        """Their values as stated."""
        return self.values[self.free]

    def whole(self, unknowns: Array) -> Array:
        """All numbers ``(K,)``, the fitted ones as given."""
        values = self.values.copy()
        values[self.free] = unknowns
        return values

    def residual(self, unknowns: Array) -> Array:
        """Stated minus present values of those that something is known of, in standard uncertainties."""
        return np.asarray(((self.start() - unknowns) / self.std[self.free])[self._known])

    def jacobian(self) -> Array:
        """Derivatives of these equations by the fitted numbers."""
        return np.asarray(np.diag(1.0 / self.std[self.free])[self._known])
