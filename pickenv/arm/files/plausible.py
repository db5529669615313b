"""Sizes that no number in a file about an arm exceeds: beyond them stands a slip of the pen or a wrong unit.

A key says its unit by its ending, as everywhere in our files; URDF has metres and radians.
"""

from __future__ import annotations

import math
import re

LARGEST = {
    "um": 1e8, "mm": 1e5, "m": 100.0, "m_per_s": 100.0, "mm_per_s": 1e5,
    "arcsec": 1.296e7, "arcmin": 2.16e5, "deg": 3600.0, "deg_per_s": 36000.0,
    "rad": 20.0 * math.pi, "rad_per_s": 200.0 * math.pi,
    "kg": 1e4, "kg_per_m": 1e4, "K": 1e3, "N": 1e7, "N_m": 1e7,
}  # fmt: skip
"""By unit: 100 m, ten turns, 100 m/s, 100 turns/s, ten tonnes; forces and torques a hundred times their weight."""


def largest(key: str) -> float:
    """The largest size of what ``key`` (``a_mm``, ``position_mm[0]``) names; infinite where it has no unit."""
    words = re.sub(r"\[\d+\]$", "", key).split("_")
    if "per" in words:
        return LARGEST.get("_".join(words[words.index("per") - 1 :]), math.inf)
    return LARGEST.get("_".join(words[-2:]), LARGEST.get(words[-1], math.inf) if len(words) > 1 else math.inf)
