"""The canopy: a slab of foliage beside the aisle, upright or leaning, in which the fruit hangs.

Orchard frame: x along the row, y from the aisle into the trees, z up from the ground; y = 0 is the canopy's face at
its lowest height. Foliage dims a line of sight as Beer and Lambert have it: exp(−projection × leaf area per volume ×
path). Units: m, rad, m²/m³.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.errors import InputError
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Flags
from pickenv.toml_tables import DEG, NUMBER, SHARE, toml_table

ROUNDING = 1e-9  # m


@toml_table
class Canopy:
    """The slab of foliage that one machine stop sees; foliage goes on along the row, fruit is wanted in ``width``.

    Attributes:
        name: Name of the preset.
        source: Where its numbers come from.
        bottom: Height of the lowest fruit, m.
        top: Height of the highest fruit, m.
        depth: Horizontal thickness of the slab, m.
        width: Length of row that one stop serves, m; x runs from −width/2 to width/2.
        standoff: Distance from the machine's column to the face, m; the column stands at y = −standoff.
        lean: Angle of the face from upright, rad; positive leans away from the aisle, negative hangs over it.
        leaf_area_per_volume: One-sided leaf area, m²/m³.
        leaf_projection: Mean share of a leaf's area that a line of sight meets.
        approach_elevation: How steeply the tool comes from below, rad above the horizontal; π/2 is straight up.
    """

    name: str
    source: str
    bottom: Annotated[float, MM.not_negative]
    top: Annotated[float, MM]
    depth: Annotated[float, MM.positive]
    width: Annotated[float, MM.positive]
    standoff: Annotated[float, MM.not_negative]
    lean: Annotated[float, DEG]
    leaf_area_per_volume: Annotated[float, NUMBER.not_negative]
    leaf_projection: Annotated[float, SHARE]
    approach_elevation: Annotated[float, DEG.within(0.0, 90.0, "from below")]

    def __post_init__(self) -> None:
        checks.bounded(f"canopy '{self.name}'", self)
        if self.top <= self.bottom:
            raise InputError(
                f"canopy '{self.name}' is empty: its top {self.top} m is not above its bottom {self.bottom} m"
            )
        if not abs(self.lean) < np.pi / 3:
            raise InputError(f"canopy '{self.name}' leans by {self.lean} rad; give less than 60 degrees (1.05 rad)")


def load_canopy(name: str | Path) -> Canopy:
    """Read a canopy by name (`shipped("canopy")`) or from a path to a TOML file."""
    return preset_files.load("canopy", name, Canopy)


def face(canopy: Canopy, height: ArrayLike) -> Array:
    """Where the canopy's face stands at a height: y in m, for heights in m of any shape."""
    return np.asarray((np.asarray(height, dtype=float) - canopy.bottom) * np.tan(canopy.lean))


def depth_behind_face(canopy: Canopy, positions: ArrayLike) -> Array:
    """Horizontal distance behind the face, m, for positions (..., 3); negative is in the aisle."""
    positions = checks.points("positions", positions)
    return np.asarray(positions[..., 1] - face(canopy, positions[..., 2]))


def in_canopy(canopy: Canopy, positions: ArrayLike) -> Flags:
    """Whether positions (..., 3) lie in the volume that one stop serves."""
    positions = checks.points("positions", positions)
    behind = depth_behind_face(canopy, positions)
    middle = np.array([0.0, canopy.depth / 2, (canopy.bottom + canopy.top) / 2])
    half = np.array([canopy.width, canopy.depth, canopy.top - canopy.bottom]) / 2 + ROUNDING
    upright = np.stack([positions[..., 0], behind, positions[..., 2]], axis=-1)
    return np.asarray((np.abs(upright - middle) <= half).all(axis=-1))


def foliage_path(canopy: Canopy, start: ArrayLike, end: ArrayLike) -> Array:
    """Length of the straight way from ``start`` to ``end`` (..., 3) that runs through foliage, m."""
    start, end = checks.points("start points", start), checks.points("end points", end)
    start, end = np.broadcast_arrays(start, end)
    slabs = (
        (start[..., 2], end[..., 2], canopy.bottom, canopy.top),
        (depth_behind_face(canopy, start), depth_behind_face(canopy, end), 0.0, canopy.depth),
    )
    enter, leave = np.zeros(start.shape[:-1]), np.ones(start.shape[:-1])
    for a, b, low, high in slabs:
        run = b - a
        still = np.abs(run) < ROUNDING
        outside = np.abs((a + b) / 2 - (low + high) / 2) > (high - low) / 2 + ROUNDING  # asked of ways along the slab
        run = np.where(still, 1.0, run)
        first, second = (low - a) / run, (high - a) / run
        enter = np.maximum(enter, np.where(still, outside, np.minimum(first, second)))
        leave = np.minimum(leave, np.where(still, ~outside, np.maximum(first, second)))
    return np.asarray(np.maximum(leave - enter, 0.0) * np.linalg.norm(end - start, axis=-1))


def foliage_transmission(canopy: Canopy, start: ArrayLike, end: ArrayLike) -> Array:
    """Expected share of a small target at ``end`` (..., 3) that leaves do not hide from ``start``."""
    extinction = canopy.leaf_projection * canopy.leaf_area_per_volume
    return np.asarray(np.exp(-extinction * foliage_path(canopy, start, end)))


def approach_direction(canopy: Canopy, positions: ArrayLike) -> Array:
    """Unit vectors along which the tool comes up to fruit, (..., 3): from the aisle and below."""
    positions = checks.points("positions", positions)
    along = np.array([0.0, np.cos(canopy.approach_elevation), np.sin(canopy.approach_elevation)])
    return np.broadcast_to(along, positions.shape).copy()
