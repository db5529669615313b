"""Many arms in one plant: every number of it may be an array with one entry per arm. Pick one arm, or move the numbers.

Link parameters of the geometry are then ``(N, n)``, other numbers ``(N,)``; what all arms share stays a plain number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from pickenv.arm.kinematics.forward import Scalar
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array
from pickenv.arm.plant.plant import EFFECTS, Plant


def plant_count(plants: Plant) -> int | None:
    """Number of arms in a batch, or None for a single arm."""
    return None if plants.geometry.alpha.ndim == 1 else len(plants.geometry.alpha)


def plant_at(plants: Plant, i: int) -> Plant:
    """Arm ``i`` of a batch, on plain numbers.

    Raises:
        IndexError: If there is no such arm.
    """
    count = plant_count(plants)
    if count is None or not -count <= i < count:
        raise IndexError(f"there is no arm {i} in this plant of {count or 1} arms")
    geometry = replace(plants.geometry, **{name: getattr(plants.geometry, name)[i] for name in LINK_PARAMETERS})
    parts = {name: _mapped(getattr(plants, name), lambda values: float(values[i])) for name in ("load", *EFFECTS)}
    return replace(plants, geometry=geometry, place=None, **parts)


def plants_on(plants: Plant, place: Callable[[Array], Scalar]) -> Plant:
    """The same arms with their arrays of numbers where another executor wants them.

    Args:
        plants: A batch of arms.
        place: Turns an array into what the executor takes, for example
            ``lambda values: torch.as_tensor(values, dtype=torch.float32, device="cuda")``.
    """
    parts = {name: _mapped(getattr(plants, name), place) for name in ("load", *EFFECTS)}
    return replace(plants, place=place, **parts)


def _mapped(value: Any, change: Callable[[Array], Scalar]) -> Any:
    """An effect with every array in it changed."""
    if isinstance(value, np.ndarray):
        return change(value)
    if isinstance(value, tuple):
        return tuple(_mapped(entry, change) for entry in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: _mapped(getattr(value, field.name), change) for field in fields(value)})
    return value
