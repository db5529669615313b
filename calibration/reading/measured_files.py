"""Files of one layout as columns of numbers, with their descriptions: what the readers of all kinds begin with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.reading.csv_table import Table
from pickenv.calibration.reading.description import ColumnDescription
from pickenv.toml_tables import TO_SI


@dataclass(frozen=True, eq=False)
class Files:
    """Files of one layout, and what all kinds have in common.

    Attributes:
        tables: Their columns.
        given: Their descriptions, one each.
        geometry: The arm's nominal geometry.
        joints: Joints of all rows ``(N, n)``, rad or m.
        source: How messages name them.
    """

    tables: list[Table]
    given: list[ColumnDescription]
    geometry: Geometry
    joints: Array
    source: str

    @property
    def first(self) -> ColumnDescription:
        """The description that they share, but for units."""
        return self.given[0]

    def values(self) -> Array:
        """What was measured in all rows, as described under the kind ``(N, k)``, m."""
        return np.concatenate([table.values(each.position) * TO_SI[each.position_unit] for table, each in self.pairs()])

    def place(self, row: int) -> str:
        """File and line of a row, as messages name it."""
        for table in self.tables:
            if row < len(table.lines):
                return f"{table.where}: row {table.lines[row]}"
            row -= len(table.lines)
        raise IndexError(row)

    def pairs(self) -> Iterator[tuple[Table, ColumnDescription]]:
        """Each file and its description."""
        return zip(self.tables, self.given, strict=True)
