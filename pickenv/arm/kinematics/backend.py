"""Operations whose names differ between `math`, `numpy` and `torch`, so that one formula works with each of them.

The numbers of a plant (a simulated true arm) may be plain floats while the joints are arrays. A function of plain
floats alone returns a float.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from pickenv.arm.kinematics.forward import Scalar, Scalars

ONE: Any = SimpleNamespace(
    sin=lambda angle: float(np.sin(angle)),
    cos=lambda angle: float(np.cos(angle)),
    sqrt=math.sqrt,
    minimum=min,
    maximum=max,
    clip=lambda value, low, high: min(max(value, low), high),
)
"""A namespace for floats with NumPy's sine and cosine. A single pose thus gets the same bits as in an array of poses,
without the cost of arrays."""


def namespace_of(m: ModuleType, value: Scalar) -> ModuleType:
    """Return the namespace with sin, cos, exp and sqrt for ``value``: `math` for plain numbers, else ``m``."""
    return math if isinstance(value, float | int) else m


def exponential(m: ModuleType, value: Scalar) -> Scalar:
    """Return the exponential of ``value``; ``m`` is ``numpy`` or ``torch`` if ``value`` is no plain number."""
    return namespace_of(m, value).exp(value)


def clipped(m: ModuleType, value: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """Return ``value`` clipped to ``low`` and ``high``; ``m`` is the namespace: ``math``, ``numpy`` or ``torch``.

    The two limits are plain floats, or both of the type of ``value``.
    """
    if m is math:
        return low if value < low else high if value > high else value
    if m is np:
        return m.minimum(m.maximum(value, low), high)
    return m.clip(value, low, high)


def chosen(m: ModuleType, condition: Scalar, yes: Scalar, no: Scalar) -> Scalar:
    """Return ``yes`` where ``condition`` is true, else ``no``.

    ``m`` is the namespace: ``math``, ``numpy`` or ``torch``.
    """
    if m is math or isinstance(condition, bool):
        return yes if condition else no
    return m.where(condition, yes, no)


def possible(m: ModuleType, condition: Scalar) -> bool:
    """Return whether ``condition`` may be true in some entry; always True with torch, to avoid waiting for the GPU.

    ``m`` is the namespace: ``math``, ``numpy`` or ``torch``.
    """
    return bool(condition) if m is math else bool(np.any(condition)) if m is np else True


def set_aside(m: ModuleType, condition: Scalar) -> bool:
    """Return whether the formula may skip a rare case, because a tracing namespace ``m`` has recorded the condition.

    Whoever runs the traced formula computes that case separately. Always False for `math`, `numpy` and `torch`.

    Args:
        m: The namespace of the formula: ``math``, ``numpy``, ``torch`` or one that traces.
        condition: Number or array that is true where the rare case occurs.
    """
    note = getattr(m, "set_aside", None)
    return note is not None and bool(note(condition))


def outside(m: ModuleType, function: Callable[..., None], values: Scalars, rows: int) -> list[Scalar] | None:
    """Record the call of a function of whole arrays, if ``m`` is a namespace that traces formulas.

    Args:
        m: The namespace of the formula: ``math``, ``numpy``, ``torch`` or one that traces.
        function: Function that takes an input array ``(k, N)`` and an output array ``(rows, N)`` and fills the output.
            Columns are independent of one another.
        values: The k inputs.
        rows: Number of outputs.

    Returns:
        The outputs; None if ``m`` does not trace.
    """
    note = getattr(m, "outside", None)
    return None if note is None else note(function, values, rows)


def nearest_whole(m: ModuleType, value: Scalar) -> Scalar:
    """Return the integer nearest to ``value``; halves are rounded to the even neighbour, as in IEEE 754.

    ``m`` is the namespace: ``math``, ``numpy`` or ``torch``.
    """
    return float(round(value)) if m is math else m.round(value)
