"""Splits of a data set into training and held-out rows.

A random split flatters models that interpolate between neighbouring poses; a blocked one holds out contiguous runs of
rows, which a measuring plan usually makes contiguous regions of the workspace. Judge residual models on the latter, and
state errors of all blocks, held out in turn: one pair of blocks says little of another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pickenv.errors import InputError

Rows = NDArray[np.int64]

BLOCKS = 10
"""Contiguous blocks that a blocked judgement holds out in turn."""


def equally_spaced(rows: int, most: int) -> Rows:
    """Indices of so many of the rows at most, at equal distances."""
    return np.unique(np.linspace(0, rows - 1, most).astype(int))


def random_split(rows: int, test_rows: int, rng: np.random.Generator) -> tuple[Rows, Rows]:
    """A seeded shuffle: the last ``test_rows`` of it are held out.

    Returns:
        Indices of the training rows and of the held-out rows.

    Raises:
        InputError: If ``test_rows`` leaves nothing to train on, or nothing to test.
    """
    _check(rows, test_rows)
    order = rng.permutation(rows)
    return order[: rows - test_rows], order[rows - test_rows :]


def blocked_split(rows: int, test_rows: int | None = None) -> tuple[Rows, Rows]:
    """Hold out two contiguous runs of rows, centred at 35 % and 75 % of the file.

    With the default of a fifth of the rows these are blocks 3 and 7 of ten, counted from 0.

    Args:
        rows: Number of rows.
        test_rows: Rows to hold out in all; a fifth when left out.

    Returns:
        Indices of the training rows and of the held-out rows, in file order.

    Raises:
        InputError: If ``test_rows`` leaves nothing to train on, or the two runs would meet.
    """
    test_rows = rows // 5 if test_rows is None else test_rows
    _check(rows, test_rows)
    first, second = test_rows - test_rows // 2, test_rows // 2
    begin = round(0.35 * rows - first / 2), round(0.75 * rows - second / 2)
    if begin[0] < 0 or begin[0] + first > begin[1] or begin[1] + second > rows:
        raise InputError(f"{test_rows} of {rows} rows cannot be held out as two separate blocks; hold out fewer")
    held = np.zeros(rows, dtype=bool)
    for start, length in zip(begin, (first, second), strict=True):
        held[start : start + length] = True
    return np.flatnonzero(~held), np.flatnonzero(held)


def contiguous_folds(groups: Rows, folds: int) -> list[tuple[Rows, Rows]]:
    """Contiguous folds of rows, each group's by itself: for each, the training and the held-out rows.

    Args:
        groups: The group of each row ``(N,)``.
        folds: How many.

    Raises:
        InputError: If there are fewer than two folds, or fewer rows than folds.
    """
    if not 2 <= folds <= len(groups):
        raise InputError(f"{len(groups)} rows cannot be cut into {folds} folds; give 2 to {len(groups)}")
    fold = np.zeros(len(groups), dtype=int)
    for number in np.unique(groups):
        for i, part in enumerate(np.array_split(np.flatnonzero(groups == number), folds)):
            fold[part] = i
    return [(np.flatnonzero(fold != i), np.flatnonzero(fold == i)) for i in range(folds)]


def _check(rows: int, test_rows: int) -> None:
    if rows < 2:
        raise InputError(f"there is {rows} row, and none can be both trained on and held out; measure more poses")
    if not 0 < test_rows < rows:
        raise InputError(f"{test_rows} test rows of {rows} leave nothing to train on or to test; give 1 to {rows - 1}")
