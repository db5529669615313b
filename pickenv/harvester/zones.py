"""Zones of a tree's side: a grid of overlapping parts, each seen in one picture (Li 2016, section 2.2).

Positions are in the machine's base frame: x along the row, the tree at negative y, z up. Units: m.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import MM, WHOLE, InputError, read_toml, toml_table
from pickenv.orchard import Viewpoint

SHIPPED = Path(__file__).parent / "strategy.toml"
AHEAD = np.array([0.0, -1.0, 0.0])
"""Direction from the machine to the trees, base frame, (3,)."""


@dataclass(frozen=True)
class Zone:
    """One part of a tree's side, including the overlap with its neighbours; base frame, m.

    Attributes:
        name: Row and column, for reports.
        left: Smallest x.
        right: Largest x.
        bottom: Smallest z.
        top: Largest z.
    """

    name: str
    left: float
    right: float
    bottom: float
    top: float

    def holds(self, positions: ArrayLike) -> NDArray[np.bool_]:
        """Flags (...): whether positions (..., 3) are inside the zone in x and z."""
        points = np.asarray(positions, dtype=float)
        x, z = points[..., 0], points[..., 2]
        return np.asarray((x >= self.left) & (x <= self.right) & (z >= self.bottom) & (z <= self.top))

    @property
    def view(self) -> Viewpoint:
        """Viewpoint of the zone's picture: at y = 0 before the zone's middle, looking at the tree."""
        return np.array([(self.left + self.right) / 2, 0.0, (self.bottom + self.top) / 2]), AHEAD


@toml_table
class Grid:
    """Division of a tree's side into zones.

    Attributes:
        columns: Number of zones side by side.
        rows: Number of zones above one another.
        overlap: Overlap of neighbouring zones, m.
    """

    columns: Annotated[int, WHOLE.positive]
    rows: Annotated[int, WHOLE.positive]
    overlap: Annotated[float, MM.not_negative]


def load_grid(path: str | Path = SHIPPED) -> Grid:
    """Read the table [zones] of a strategy file."""
    return read_toml(Grid, path, section="zones")


def cut(grid: Grid, left: float, right: float, bottom: float, top: float) -> list[Zone]:
    """Return the zones that cover a tree's side, in the order in which they are harvested.

    The order goes from column to column by rising x, up the first column, down the second, and so on.

    Args:
        grid: Numbers of columns and rows, and their overlap.
        left: Smallest x of the side, m.
        right: Largest x, m.
        bottom: Smallest z, m.
        top: Largest z, m.

    Raises:
        InputError: If the side is empty or a zone would not be larger than its overlap.
    """
    if not (right > left and top > bottom):
        raise InputError(f"the tree's side from x {left} to {right} m and z {bottom} to {top} m is empty")
    wide, high = (right - left) / grid.columns, (top - bottom) / grid.rows
    if min(wide, high) <= grid.overlap:
        raise InputError(
            f"zones of {wide * 1e3:.0f} x {high * 1e3:.0f} mm cannot overlap by {grid.overlap * 1e3:.0f} mm; "
            "give fewer zones or less overlap"
        )
    half = grid.overlap / 2
    zones = []
    for column in range(grid.columns):
        for row in range(grid.rows) if column % 2 == 0 else reversed(range(grid.rows)):
            name, x, z = f"row {row + 1}, column {column + 1}", left + column * wide, bottom + row * high
            zones.append(Zone(name, x - half, x + wide + half, z - half, z + high + half))
    return zones
