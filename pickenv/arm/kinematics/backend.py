"""The few operations that `math`, `numpy` and `torch` spell differently, so that a formula is written once.

Numbers of a plant may be plain floats while the joints are arrays; functions of such numbers alone stay on floats.
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
"""Floats with NumPy's sine and cosine: one pose gets the bits that it has among many in arrays, without their cost."""


def namespace_of(m: ModuleType, value: Scalar) -> ModuleType:
    """The namespace that holds sin, cos, exp and sqrt for ``value``: `math` for plain floats, else ``m``."""
    return math if isinstance(value, float | int) else m


def exponential(m: ModuleType, value: Scalar) -> Scalar:
    """The exponential of ``value``."""
    return namespace_of(m, value).exp(value)


def clipped(m: ModuleType, value: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """``value`` held between ``low`` and ``high``, both plain floats or both of its kind."""
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
    """Whether a rare case may be present; torch always says yes, so that nothing waits for the device."""
    return bool(condition) if m is math else bool(np.any(condition)) if m is np else True


def set_aside(m: ModuleType, condition: Scalar) -> bool:
    """Whether a rare case is noted and left to whoever runs the formula, as a namespace that writes it down does."""
    note = getattr(m, "set_aside", None)
    return note is not None and bool(note(condition))


def outside(m: ModuleType, function: Callable[..., None], values: Sequence[Scalar], rows: int) -> list[Scalar] | None:
    """The numbers that a function of whole arrays makes of others, where a namespace writes formulas down; else None.

    Args:
        m: The namespace.
        function: Gets an array ``(k, N)`` and fills one ``(rows, N)``, column by column.
        values: What it is given, k.
        rows: How many numbers it makes of them.
    """
    note = getattr(m, "outside", None)
    return None if note is None else note(function, values, rows)


def nearest_whole(m: ModuleType, value: Scalar) -> Scalar:
    """The nearest whole number; halves go to the even one, as in IEEE 754."""
    return float(round(value)) if m is math else m.round(value)
