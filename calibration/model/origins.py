"""Where each row of a data set stands, file and line, carried through every selection: a message names what is wrong.

Lines are counted from 1 with the header, as an editor shows them; rows that come from no file are counted from 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

NAMED = 6
"""Rows that a message names at most."""


@dataclass(frozen=True, eq=False)
class Origins:
    """File and line of N rows.

    Attributes:
        files: The files.
        file: Index into ``files`` of each row ``(N,)``.
        line: Line of each row in its file ``(N,)``, from 1.
    """

    files: tuple[str, ...]
    file: NDArray[np.int64]
    line: NDArray[np.int64]

    def select(self, rows: ArrayLike) -> Origins:
        """The origins of the given rows (indices or a mask)."""
        rows = np.asarray(rows)
        return Origins(self.files, self.file[rows], self.line[rows])

    def place(self, row: int) -> tuple[str, int]:
        """File and line of one row."""
        return self.files[int(self.file[row])], int(self.line[row])

    def name(self, rows: Sequence[int]) -> str:
        """Rows as a message names them, file by file: "tracker.csv: rows 9, 92 and 3 more"."""
        return named([self.place(row) for row in rows])


def named(places: Sequence[tuple[str, int]]) -> str:
    """Files and lines as a message names them."""
    texts = []
    for file in dict.fromkeys(file for file, _ in places):
        lines = [str(line) for line in sorted(line for other, line in places if other == file)]
        shown = ", ".join(lines[:NAMED]) + (f" and {len(lines) - NAMED} more" if len(lines) > NAMED else "")
        texts.append(f"{file}: {'row' if len(lines) == 1 else 'rows'} {shown}")
    return "; ".join(texts)
