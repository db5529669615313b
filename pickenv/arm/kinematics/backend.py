"""The few operations that `math`, `numpy` and `torch` spell differently, so that a formula is written once.

Numbers of a plant may be plain floats while the joints are arrays; a function of plain floats alone gives a float.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from pickenv.arm.kinematics.forward import Scalar

ONE: Any = SimpleNamespace(
    sin=lambda angle: float(np.sin(angle)),
    cos=lambda angle: float(np.cos(angle)),
    sqrt=math.sqrt,
    minimum=min,
    maximum=max,
    clip=lambda value, low, high: min(max(value, low), high),
)
"""The namespace for floats with NumPy's sine and cosine: a single pose gets the same bits as among many in arrays, but
without the cost of arrays."""


def namespace_of(m: ModuleType, value: Scalar) -> ModuleType:
    """The namespace that holds sin, cos, exp and sqrt for ``value``: `math` for plain floats, else ``m``."""
    return math if isinstance(value, float | int) else m


def exponential(m: ModuleType, value: Scalar) -> Scalar:
    """The exponential of ``value``."""
    return namespace_of(m, value).exp(value)


def clipped(m: ModuleType, value: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """``value`` clipped to ``low`` and ``high``, which are both plain floats or both of the kind of ``value``."""
    if m is math:
        return low if value < low else high if value > high else value
    if m is np:
        return m.minimum(m.maximum(value, low), high)
    return m.clip(value, low, high)


def chosen(m: ModuleType, condition: Scalar, yes: Scalar, no: Scalar) -> Scalar:
    """``yes`` where ``condition`` holds, else ``no``."""
    if m is math or isinstance(condition, bool):
        return yes if condition else no
    return m.where(condition, yes, no)


def possible(m: ModuleType, condition: Scalar) -> bool:
    """Whether ``condition`` may hold somewhere; always True with torch, so that nothing waits for the device."""
    return bool(condition) if m is math else bool(np.any(condition)) if m is np else True


def set_aside(m: ModuleType, condition: Scalar) -> bool:
    """Whether ``m`` notes a rare case and leaves it to whoever runs the formula, as a namespace for tracing does."""
    note = getattr(m, "set_aside", None)
    return note is not None and bool(note(condition))


def outside(m: ModuleType, function: Callable[..., None], values: Sequence[Scalar], rows: int) -> list[Scalar] | None:
    """The results of a function of whole arrays, where ``m`` is a namespace that traces formulas; else None.

    Args:
        m: The namespace.
        function: Gets an array ``(k, N)`` and fills one ``(rows, N)``, column by column.
        values: The k numbers that the function is given.
        rows: How many numbers the function makes of them.
    """
    note = getattr(m, "outside", None)
    return None if note is None else note(function, values, rows)


def nearest_whole(m: ModuleType, value: Scalar) -> Scalar:
    """The whole number nearest to ``value``; halves are rounded to the even neighbour, as in IEEE 754."""
    return float(round(value)) if m is math else m.round(value)
