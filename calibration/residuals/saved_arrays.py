"""Models whose fields are arrays and numbers: by name for saving without pickle, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class SavedArrays:
    """A dataclass of arrays and numbers."""

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All numbers by name, for saving."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_arrays(cls, named: Mapping[str, NDArray[Any]]) -> Self:
        """The inverse of `arrays`."""
        values = ((field.name, named[field.name]) for field in fields(cls))
        return cls(**{name: value if value.ndim else value.item() for name, value in values})


def named_part(prefix: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays with a prefix before their names, as a part of something larger."""
    return {f"{prefix}{name}": np.asarray(value) for name, value in arrays.items()}


def part_of(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    """The inverse of `named_part`."""
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
