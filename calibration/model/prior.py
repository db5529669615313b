"""What is expected of parameters before anything was measured, as one more data set in the least squares.

A term's coefficients are expected to be zero within a few tolerances. Without that, terms that the poses hardly show
(most of a gravity model's moments) fit the noise; with it they stay at zero unless the data insist.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.terms import ComplianceTerm

EXPECTED = 1.0
"""Standard deviation of a term's coefficient before measuring, in its tolerances (1 mm or 1 mrad at the tool)."""

ANY_STIFFNESS = 100.0
"""The same for compliances, one per joint of known torque: stiffnesses from 100 N*m/rad or 1 kN/m are as good."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Parameters expected near those of a reference model; fits among `Equations`.

    Attributes:
        reference: The model expected.
        columns: Indices of the parameters concerned ``(k,)``.
        std: Standard deviations ``(k,)``, in the parameters' units.
    """

    reference: ArmModel
    columns: NDArray[np.int64]
    std: Array
    source: str = "prior"
    kind: str = "prior"
    framed: bool = False
    sized: bool = False

    @property
    def joints(self) -> Array:
        """No poses."""
        return np.zeros((0, self.reference.geometry.joints))

    def unknowns(self) -> tuple[str, ...]:
        """None."""
        return ()

    def tolerances(self) -> Array:
        """Of none."""
        return np.zeros(0)

    def start(self, model: ArmModel) -> Array:
        """Nothing to start."""
        return np.zeros(0)

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Expected minus present values, in standard deviations."""
        return model.difference(self.reference)[self.columns] / self.std

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """One parameter per row."""
        rows = np.zeros((len(self.columns), len(model.parameter_names)))
        rows[np.arange(len(self.columns)), self.columns] = 1.0 / self.std
        return rows, np.zeros((len(rows), 0))


def expected_sizes(model: ArmModel) -> Array:
    """Standard deviations of the terms' coefficients before measuring ``(k,)``, in their tolerances."""
    counts = [len(term.names(model.geometry)) for term in model.terms]
    return np.repeat([ANY_STIFFNESS if isinstance(term, ComplianceTerm) else EXPECTED for term in model.terms], counts)


def coefficients_prior(start: ArmModel, scatter: float) -> Prior:
    """A prior on all coefficients of the model's terms.

    Args:
        start: The model; its coefficients are expected.
        scatter: What remains without the terms, in claimed standard uncertainties: the prior is weighed against what
            the data are really worth.
    """
    first = len(start.geometry.parameter_names)
    columns = np.arange(first, first + len(start.coefficients))
    return Prior(start, columns, start.term_tolerances * expected_sizes(start) / max(scatter, 1e-9))
