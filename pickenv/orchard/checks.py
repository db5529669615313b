"""Checks of the orchard's numbers and arrays: they must be finite, of the right shape and physically possible.

Other input raises an `InputError`. The argument ``what`` is the name of the number or array in the error message.
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
"""Millimetres in the orchard's files, without an upper limit, because a camera may see any distance."""


def measuring_range(what: str, nearest: float, farthest: float) -> None:
    """Check that a camera's range of distances, m, is finite and that ``nearest`` is below ``farthest``.

    ``what`` is the camera's name in error messages.

    Raises:
        InputError: If one of the two conditions does not hold.
    """
    if not nearest < farthest < np.inf:
        raise InputError(f"the range of {what} ends at {farthest} m; give more than its beginning, {nearest} m")


class Preset:
    """Base of preset classes; raises an `InputError` if a field's number is outside the limits of the field's type."""

    def __post_init__(self) -> None:
        words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(self).__name__).lower()
        what = f"{words} '{name}'" if (name := getattr(self, "name", "")) else f"a {words}"
        for field, unit in units_of(cast(Any, type(self))).items():
            for value in np.ravel(getattr(self, field)).tolist():
                if not unit.holds(value):
                    raise InputError(f"{field} of {what} is {value}; give {unit.wanted}")


def numbers(what: str, values: ArrayLike, *, lowest: float = -np.inf, positive: bool = False) -> Array:
    """Return ``values`` as an array of float64 after checking them.

    Args:
        what: Name of the array in error messages.
        values: Numbers of any shape.
        lowest: Least value allowed.
        positive: Whether all numbers must be above zero.

    Raises:
        InputError: If a value is no number, not finite or too small.
    """
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
    """Return ``values`` as an array of points or vectors (..., 3) after checking them.

    ``what`` is the array's name in error messages.

    Raises:
        InputError: If the last dimension is not 3, or a number is not finite.
    """
    array = numbers(what, values)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError(f"{what} must have three coordinates each, not shape {array.shape}")
    return array


def directions(what: str, values: ArrayLike) -> Array:
    """Return the unit vectors (..., 3) in the directions of the vectors ``values`` (..., 3).

    ``what`` is the array's name in error messages.

    Raises:
        InputError: If a vector is zero or not finite, or the last dimension is not 3.
    """
    array = points(what, values)
    length = np.linalg.norm(array, axis=-1, keepdims=True)
    if (length == 0).any():
        raise InputError(f"{what} must not be zero vectors; they give directions")
    return np.asarray(array / length)


def fruit_arrays(positions: ArrayLike, diameters: ArrayLike) -> tuple[Array, Array]:
    """Return fruit centres (n, 3), m, and diameters (n,), m, as arrays after checking them.

    Args:
        positions: Fruit centres, m, (n, 3).
        diameters: Fruit diameters, m, (n,), or one number for all fruit.

    Raises:
        InputError: If a shape is wrong, a number is not finite, or a diameter is not above zero.
    """
    centres = points("fruit positions", positions)
    if centres.ndim != 2:
        raise InputError(f"fruit positions must have shape (n, 3), not {centres.shape}")
    sizes = numbers("fruit diameters (m)", diameters, positive=True)
    if sizes.shape not in ((), (len(centres),)):
        raise InputError(f"there are {len(centres)} fruit but {sizes.size} diameters; give one each")
    return centres, np.broadcast_to(sizes, (len(centres),)).astype(float)
