"""How results are put on screens: four significant digits, units, and tables of text that terminal and page share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from textwrap import wrap

import numpy as np

from pickenv.calibration.identification.least_squares import is_angle
from pickenv.calibration.model.lens import LENS_NAMES
from pickenv.texts import folded, screen_width, side_by_side

UNBOUNDED = 100_000
"""Characters of a line that goes elsewhere than to a terminal."""
NARROW = 10
"""Characters that a column of words has at least."""

LENGTHS_OF_KINDS = ("reflector", "anchor", "socket", "point", "tip", "edge", "plane_offset", "zero")
NUMBERS_OF_KINDS = ("scale", "normal", "along", "axis", "down")
"""Beginnings of the names of measurements' own unknowns: lengths, and numbers without a unit (directions, scales)."""


def figure(value: float | None) -> str:
    """A number as screens show it: four significant digits."""
    if value is None or np.isnan(value):
        return "unknown"
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:#.4g}".rstrip(".")
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e9 else f"{value:.3e}"


def is_number(cell: str) -> bool:
    """Whether a table's cell is a number, which stands to the right."""
    return cell[:1] in tuple("+-0123456789")


@dataclass(frozen=True)
class Block:
    """A titled table of text, as terminal and page show it.

    Attributes:
        title: What it is about.
        header: Column titles with units; empty for plain lines.
        rows: Cells.
        note: What a reader must know of it, or empty.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def text(self) -> str:
        """For the terminal, whose lines it fits: heads and words are broken, and what is still too wide is parted."""
        width = screen_width(UNBOUNDED)
        return "\n".join(folded(self.title + (f": {self.note}" if self.note else ""), width) + self._lines(width))

    def _lines(self, width: int) -> list[str]:
        columns = list(zip(*self.rows, strict=True))
        heads = self.header or ("",) * len(columns)
        numeric = [bool(self.header) and is_number(cells[0]) for cells in columns]
        sizes = [max(map(len, (head, *cells))) for head, cells in zip(heads, columns, strict=True)]
        if over(sizes, width) > 0:
            sizes = [max(map(len, (*head.split(), *cells))) for head, cells in zip(heads, columns, strict=True)]
            for i in reversed([i for i, number in enumerate(numeric) if not number]):
                sizes[i] = max(min(sizes[i], NARROW), sizes[i] - max(over(sizes, width), 0))
        lines = []
        for table in side_by_side([size + 2 for size in sizes], 1, width):
            for row in ([self.header] if self.header else []) + list(self.rows):
                cells = [wrap(row[i], sizes[i], break_on_hyphens=False) or [""] for i in table]
                for parts in zip_longest(*cells, fillvalue=""):
                    set_out = zip(parts, table, strict=True)
                    padded = [f"{part:{'>' if numeric[i] else '<'}{sizes[i]}}" for part, i in set_out]
                    lines.append("  " + "  ".join(padded).rstrip())
        return lines


def over(sizes: Sequence[int], width: int) -> int:
    """By how many characters columns of these sizes, each with two before it, are wider than a line."""
    return sum(sizes) + 2 * len(sizes) - width


def unit_of(name: str, geometric: tuple[str, ...]) -> tuple[str, float]:
    """Unit of a parameter on screens, and the factor from SI; coefficients of effects stay in SI."""
    if name in geometric or name.startswith(("base", "tool")):
        return ("deg", float(np.degrees(1.0))) if is_angle(name) else ("mm", 1e3)
    if name.startswith(LENGTHS_OF_KINDS):
        return "mm", 1e3
    if name.startswith(NUMBERS_OF_KINDS):
        return "1", 1.0
    if name in LENS_NAMES:
        return ("px", 1.0) if name in LENS_NAMES[:4] else ("1", 1.0)
    return "SI", 1.0


def unknowns_in(unit: str, unknowns: Mapping[str, float]) -> dict[str, float]:
    """Those of the measurements' own unknowns that have this unit on screens, in it; no numbers of a lens."""
    units = {name: unit_of(name, ()) for name in unknowns if name not in LENS_NAMES}
    return {name: unknowns[name] * scale for name, (own, scale) in units.items() if own == unit}
