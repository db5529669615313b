"""What all regressors of residuals share: what is asked of them, arrays by name for saving, and standardising."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.kinematics.geometry import Array

CONSTANT = 1e-9
"""A column that varies by less than this share of its largest value is constant; the rest is rounding."""


class Regressor(Protocol):
    """What the registry needs of a model: numbers in, numbers out, and all of it in plain arrays."""

    def predict(self, inputs: ArrayLike) -> Array:
        """Outputs ``(..., k)`` at standardised inputs ``(..., F)``."""

    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """All numbers by name, for saving without pickle; the class's ``from_arrays`` is the inverse."""


Fitter = Callable[[Array, Array, np.random.Generator], Regressor]
"""Fits standardised inputs ``(N, F)`` to targets ``(N, k)``."""


@dataclass(frozen=True, eq=False)
class SavedArrays:
    """A dataclass of arrays and numbers: by name for saving without pickle, and back."""

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All numbers by name, for saving."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_arrays(cls, named: Mapping[str, NDArray[Any]]) -> Self:
        """The inverse of `arrays`."""
        values = ((field.name, named[field.name]) for field in fields(cls))
        return cls(**{name: value if value.ndim else value.item() for name, value in values})


def column_std(values: Array, constant: float) -> Array:
    """Standard deviation of each column of ``values`` ``(N, F)``, or ``constant`` where a column does not vary.

    Give 1 for inputs, so that a later change stays in proportion, and something tiny for outputs, so that a model's
    error on a constant output stays tiny.
    """
    std = values.std(axis=0)
    return np.where(std <= CONSTANT * np.max(np.abs(values), axis=0, initial=0.0), constant, std)
