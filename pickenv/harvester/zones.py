"""Zones: the tree's side is cut into a grid of overlapping parts, one image each (Li 2016, section 2.2).

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
"""Where the trees are."""


@dataclass(frozen=True)
class Zone:
    """One part of the tree's side, overlap included: m in the base frame.

    Attributes:
        name: Row and column, as reports print it.
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
        """Whether positions (..., 3) lie in the zone's image."""
        points = np.asarray(positions, dtype=float)
        x, z = points[..., 0], points[..., 2]
        return np.asarray((x >= self.left) & (x <= self.right) & (z >= self.bottom) & (z <= self.top))

    @property
    def view(self) -> Viewpoint:
        """The viewpoint of its picture: before its middle, at the machine's column."""
        return np.array([(self.left + self.right) / 2, 0.0, (self.bottom + self.top) / 2]), AHEAD


@toml_table
class Grid:
    """The cut of a tree's side into zones.

    Attributes:
        columns: Zones side by side.
        rows: Zones above one another.
        overlap: How far neighbouring zones overlap, m.
    """

    columns: Annotated[int, WHOLE.positive]
    rows: Annotated[int, WHOLE.positive]
    overlap: Annotated[float, MM.not_negative]


def load_grid(path: str | Path = SHIPPED) -> Grid:
    """Read the grid from a strategy file."""
    return read_toml(Grid, path, section="zones")


def cut(grid: Grid, left: float, right: float, bottom: float, top: float) -> list[Zone]:
    """Zones that cover a side, in the order of work: columns from left to right, up one and down the next.

    Args:
        grid: How to cut.
        left: Smallest x of the side, m.
        right: Largest x.
        bottom: Smallest z.
        top: Largest z.

    Raises:
        InputError: If the side is empty or a zone would be narrower than its overlap.
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
        order = range(grid.rows) if column % 2 == 0 else reversed(range(grid.rows))
        for row in order:
            x, z = left + column * wide, bottom + row * high
            zones.append(
                Zone(f"row {row + 1}, column {column + 1}", x - half, x + wide + half, z - half, z + high + half)
            )
    return zones
