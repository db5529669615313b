"""Which share of a variance each of several independent causes makes: first-order and total indices (Saltelli 2010).

Row by row the figure is computed with all causes drawn once (A), all drawn again (B), and for each cause with that one
taken from B and the others from A. Anything else that a row's figures share is averaged over and makes no variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError
from pickenv.intervals import statistic_interval


def variance_indices(first: Array, second: Array, mixed: Array, names: Sequence[str]) -> list[dict[str, Any]]:
    """The indices of causes, from R independent blocks of n rows.

    Args:
        first: The figure with all causes from A ``(R, n)``.
        second: With all from B ``(R, n)``.
        mixed: For each of G causes, with it alone from B ``(G, R, n)``.
        names: Of the causes.

    Returns:
        For each cause ``group``, ``first_order`` (its share alone), ``total`` (with all its interactions, never less),
        and their 95 % intervals ``first_order_low`` and so on; None where there are too few blocks for one.

    Raises:
        InputError: If nothing varies.
    """
    whole = 0.5 * np.mean((first - second) ** 2, axis=1)
    if not whole.any():
        raise InputError("the figure is the same whatever is drawn; there is no variance to divide")
    # Jansen 1999: differences within a row alone, so that what the row shares drops out
    alone, every = whole - 0.5 * np.mean((second - mixed) ** 2, axis=2), 0.5 * np.mean((first - mixed) ** 2, axis=2)
    found = []
    for name, one, all_ in zip(names, alone, every, strict=True):
        if one.mean() > all_.mean():  # by chance: both then estimate the share of a cause without interactions
            one = all_ = 0.5 * (one + all_)
        row: dict[str, Any] = {"group": name}
        for key, part in (("first_order", one), ("total", all_)):
            value = float(part.mean() / whole.mean())
            low, high = _ends(part, whole, value)
            row |= {key: value, f"{key}_low": low, f"{key}_high": high}
        found.append(row)
    return found


def _ends(part: Array, whole: Array, value: float) -> tuple[float | None, float | None]:
    """The interval of a ratio of means over blocks ``(R,)``: within 0 to 1, but holding the value that is shown."""
    if not part.any():
        return 0.0, 0.0  # the cause changes nothing
    ends = statistic_interval(np.stack([part, whole], axis=1), lambda rows: rows[:, 0].mean() / rows[:, 1].mean())
    return (None, None) if ends is None else (min(max(ends[0], 0.0), value), max(min(ends[1], 1.0), value))
