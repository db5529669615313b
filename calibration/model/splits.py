"""Splits of a data set into training and held-out rows.

A random split flatters models that interpolate between neighbouring poses; a blocked one holds out contiguous runs of
rows, which a measuring plan usually makes contiguous regions of the workspace. Judge residual models on the latter, and
state errors of all blocks, held out in turn: one pair of blocks says little of another.

Rows of one pose stand on one side of every split: measured again, rounded or in another order they are still the rows
that were trained on. So poses are split, and rows go with theirs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError

Rows = NDArray[np.int64]

BLOCKS = 10
"""Contiguous blocks that a blocked judgement holds out in turn."""


SAME_POSE = 2e-4
"""Joints that differ by no more are of one pose, rad or m: 0.01 deg is what arms resolve, and what comes back of a pose
that is reached again or written down with two decimals."""

PATH = 10 * SAME_POSE
"""Rows that hang together over more than this, rad or m, are a path that was followed slowly."""


def equally_spaced(rows: int, most: int) -> Rows:
    """Indices of so many of the rows at most, at equal distances."""
    return np.unique(np.linspace(0, rows - 1, most).astype(int))


def same_poses(joints: Array) -> Rows:
    """The pose of each row ``(N,)``, numbered in the order in which they first come.

    Rows whose joints all differ by `SAME_POSE` or less are of one pose, and so is what hangs together by such rows.
    What hangs together over more than `PATH` is a slow path and no pose; it is cut into cells of `SAME_POSE`.

    Args:
        joints: Joints ``(N, n)``, rad or m.
    """
    cells, cell = np.unique(np.floor(joints / SAME_POSE), axis=0, return_inverse=True)
    cell = cell.ravel()  # rows of one cell are near each other, so that only cells are left to compare
    low, high = np.full(cells.shape, np.inf), np.full(cells.shape, -np.inf)
    np.minimum.at(low, cell, joints)
    np.maximum.at(high, cell, joints)
    one, other = KDTree(cells).query_pairs(1.5, p=np.inf, output_type="ndarray").T
    near = np.maximum(low[one] - high[other], low[other] - high[one]).max(axis=1, initial=-np.inf) <= SAME_POSE
    links = coo_array((near[near], (one[near], other[near])), shape=(len(cells), len(cells)))
    count, pose = connected_components(links, directed=False)
    least, most = np.full((count, joints.shape[1]), np.inf), np.full((count, joints.shape[1]), -np.inf)
    np.minimum.at(least, pose, low)
    np.maximum.at(most, pose, high)
    path = ((most - least).max(axis=1) > PATH)[pose]
    pose = np.where(path, count + np.arange(len(cells)), pose)[cell]
    _, first, number = np.unique(pose, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number]


def pose_count(joints: Array) -> int:
    """How many poses rows of these joints ``(N, n)`` are of, however often each was measured."""
    return len(np.unique(same_poses(joints)))


def random_split(poses: Rows, test_rows: int, rng: np.random.Generator) -> tuple[Rows, Rows]:
    """A seeded shuffle of the poses: the last ones, of about ``test_rows`` rows, are held out.

    Args:
        poses: The pose of each row ``(N,)``, as `same_poses` numbers them.
        test_rows: Rows to hold out: exactly so many where no pose is repeated.
        rng: Shuffles.

    Returns:
        Indices of the training rows and of the held-out rows.

    Raises:
        InputError: If ``test_rows`` leaves nothing to train on, or nothing to test.
    """
    _check(poses, test_rows)
    order = rng.permutation(int(poses.max()) + 1)
    rows = np.argsort(np.argsort(order)[poses], kind="stable")
    ends = np.cumsum(np.bincount(poses)[order])[:-1]
    cut = ends[np.argmin(np.abs(ends - (len(poses) - test_rows)))]
    return rows[:cut], rows[cut:]


def blocked_split(poses: Rows, test_rows: int | None = None) -> tuple[Rows, Rows]:
    """Hold out two contiguous runs of poses, centred at 35 % and 75 % of the file.

    With the default of a fifth of the rows these are blocks 3 and 7 of ten, counted from 0.

    Args:
        poses: The pose of each row ``(N,)``, as `same_poses` numbers them.
        test_rows: Rows to hold out in all, where no pose is repeated; a fifth when left out.

    Returns:
        Indices of the training rows and of the held-out rows, in file order.

    Raises:
        InputError: If ``test_rows`` leaves nothing to train on, or the two runs would meet.
    """
    rows = len(poses)
    test_rows = rows // 5 if test_rows is None else test_rows
    _check(poses, test_rows)
    count = int(poses.max()) + 1
    test = max(1, round(test_rows * count / rows))
    first, second = test - test // 2, test // 2
    begin = round(0.35 * count - first / 2), round(0.75 * count - second / 2)
    if begin[0] < 0 or begin[0] + first > begin[1] or begin[1] + second > count:
        raise InputError(f"{test_rows} of {rows} rows cannot be held out as two separate blocks; hold out fewer")
    held = np.zeros(count, dtype=bool)
    for start, length in zip(begin, (first, second), strict=True):
        held[start : start + length] = True
    return np.flatnonzero(~held[poses]), np.flatnonzero(held[poses])


def contiguous_folds(groups: Rows, poses: Rows, folds: int) -> list[tuple[Rows, Rows]]:
    """Contiguous folds of poses, each group's by itself: for each, the training and the held-out rows.

    Args:
        groups: The group of each row ``(N,)``.
        poses: The pose of each row ``(N,)``, as `same_poses` numbers them.
        folds: How many.

    Raises:
        InputError: If there are fewer than two folds, or fewer poses than folds.
    """
    count = int(poses.max(initial=-1)) + 1
    if not 2 <= folds <= count:
        raise InputError(
            f"{len(poses)} rows of {count} poses cannot be cut into {folds} folds; measure at least {max(folds, 2)}"
        )
    home, fold_of = home_groups(groups, poses), np.zeros(count, dtype=int)
    for number in np.unique(home):
        for i, part in enumerate(np.array_split(np.unique(poses[home == number]), folds)):
            fold_of[part] = i
    fold = fold_of[poses]
    return [(np.flatnonzero(fold != i), np.flatnonzero(fold == i)) for i in range(folds)]


def home_groups(groups: Rows, poses: Rows) -> Rows:
    """The group that each row is split with ``(N,)``: its pose's first one, so that stations share out alike poses."""
    return np.asarray(groups[np.unique(poses, return_index=True)[1]][poses])


def _check(poses: Rows, test_rows: int) -> None:
    rows, count = len(poses), len(np.unique(poses))
    if count < 2:
        there = "is 1 row" if rows == 1 else f"are {rows} rows of one pose" if rows else "is 0 row"
        raise InputError(f"there {there}, and none can be both trained on and held out; measure more poses")
    if not 0 < test_rows < rows:
        raise InputError(f"{test_rows} test rows of {rows} leave nothing to train on or to test; give 1 to {rows - 1}")
