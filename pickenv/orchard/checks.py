"""Checks of the orchard's numbers and arrays: finite, of the right shape, physically possible.

Each refusal is an `InputError` of one sentence. ``what`` is the name of the number or array in that sentence.
"""

from __future__ import annotations

import re
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import InputError, Unit, units_of

Array: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.bool_]
Integers: TypeAlias = NDArray[np.int64]

MM = Unit("mm", per=1000.0)
"""Millimetres of the orchard's files, where a camera may see any distance."""


def measuring_range(what: str, nearest: float, farthest: float) -> None:
    """Refuse a camera whose range of distances, m, has no end or ends before it begins."""
    if not nearest < farthest < np.inf:
        raise InputError(f"the range of {what} ends at {farthest} m; give more than its beginning, {nearest} m")


class Preset:
    """Base of preset classes: numbers stay within the bounds of their annotations, however an object is made."""

    def __post_init__(self) -> None:
        words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(self).__name__).lower()
        what = f"{words} '{name}'" if (name := getattr(self, "name", "")) else f"a {words}"
        for field, unit in units_of(cast(Any, type(self))).items():
            for value in np.ravel(getattr(self, field)).tolist():
                if not unit.holds(value):
                    raise InputError(f"{field} of {what} is {value}; give {unit.wanted}")


def numbers(what: str, values: ArrayLike, *, lowest: float = -np.inf, positive: bool = False) -> Array:
    """Array of finite numbers, none below ``lowest``, all above zero if ``positive``; other input is refused."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be an array of numbers: {error}") from error
    if not np.isfinite(array).all():
        raise InputError(f"{what} must be finite; at least one of its numbers is NaN or infinite")
    if lowest > -np.inf and (array < lowest).any():
        raise InputError(f"{what} must not be below {lowest:g}; the smallest is {array.min():g}")
    if positive and (array <= 0).any():
        raise InputError(f"{what} must be above zero; the smallest is {array.min():g}")
    return array


def points(what: str, values: ArrayLike) -> Array:
    """Array of finite points or vectors, shape (..., 3); other input is refused."""
    array = numbers(what, values)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError(f"{what} must have three coordinates each, not shape {array.shape}")
    return array


def directions(what: str, values: ArrayLike) -> Array:
    """Unit vectors, shape (..., 3), of vectors of any length above zero; other input is refused."""
    array = points(what, values)
    length = np.linalg.norm(array, axis=-1, keepdims=True)
    if (length == 0).any():
        raise InputError(f"{what} must not be zero vectors; they give directions")
    return np.asarray(array / length)


def fruit_arrays(positions: ArrayLike, diameters: ArrayLike) -> tuple[Array, Array]:
    """Fruit centres (n, 3) and diameters (n,) in m; one diameter serves all fruit. Other input is refused."""
    centres = points("fruit positions", positions)
    if centres.ndim != 2:
        raise InputError(f"fruit positions must have shape (n, 3), not {centres.shape}")
    sizes = numbers("fruit diameters (m)", diameters, positive=True)
    if sizes.shape not in ((), (len(centres),)):
        raise InputError(f"there are {len(centres)} fruit but {sizes.size} diameters; give one each")
    return centres, np.broadcast_to(sizes, (len(centres),)).astype(float)
