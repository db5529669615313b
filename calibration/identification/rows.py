"""Rows of data sets of any kind: split for judgement, so that each group is trained on and none judges that was."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import binom

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.observations import Observations, origins_of
from pickenv.calibration.model.origins import named
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.splits import SAME_POSE, Rows, home_groups, random_split, same_poses
from pickenv.calibration.model.stacked import Stacked
from pickenv.errors import InputError

ROUNDED = {"mm": 5e-6, "deg": 1e-5, "px": 0.03}
"""What a reading changes by when it is written down more roughly, to 0.01 mm or 0.001 deg, in m, rad and px: a third of
what such instruments scatter by, so that a pose measured anew reads alike once in five times (`CHANCE`)."""

CHANCE, ROUGH = 0.2, 0.9
UNLIKELY = 1e-3
"""So many equal readings among poses measured anew would come by chance that rarely; where both files are written more
roughly than `ROUNDED`, a reading is taken to be equal by chance nine times in ten (`ROUGH`)."""

IDENTICAL = 1e-8
"""Joints that agree so well are one number, rad or m."""


def unknowns_of(found: Identification, observations: Observations) -> Array:
    """The identified values of a data set's own unknowns.

    Raises:
        InputError: If it has one that the rows fitted had not.
    """
    new = [name for name in observations.unknowns() if name not in found.unknowns]
    if new:
        what = new[0].removesuffix("_x")
        raise InputError(
            f"{observations.source}: {what} occurs in no row that was fitted; give rows of it to fit, or leave it out"
        )
    return np.array([found.unknowns[name] for name in observations.unknowns()])


def choose(observations: Observations, test_rows: int | None, rng: np.random.Generator) -> tuple[Rows, Rows]:
    """Training and held-out rows of one data set, drawn; sockets and stations are split one by one, to train on each.

    Rows of one pose stay on one side, also where several stations measured it.

    Args:
        observations: The data.
        test_rows: Rows to hold out; a fifth when left out.
        rng: Draws the split.

    Raises:
        InputError: If the split is impossible.
    """
    count = len(observations.joints)
    wanted = max(1, count // 5) if test_rows is None else test_rows
    poses = same_poses(observations.joints)
    if not observations.groups.any():
        return random_split(poses, wanted, rng)
    home = home_groups(observations.groups, poses)
    train, test = [], []
    for number in np.unique(home):
        rows = np.flatnonzero(home == number)
        share = max(1, round(wanted * len(rows) / count))
        if len(rows) - share < 2:
            raise InputError(
                f"{observations.source}: socket or station {number + 1} has {len(rows)} rows, too few to hold "
                f"{share} of them out"
            )
        here, there = random_split(np.unique(poses[rows], return_inverse=True)[1], share, rng)
        train.append(rows[here])
        test.append(rows[there])
    return np.concatenate(train), np.concatenate(test)


def refuse_trained(train: Observations, test: Observations) -> None:
    """Refuse rows to judge by that are training rows, as they stand, rounded, or in another order.

    A pose may be measured again to judge by: then its reading differs by what instrument and arm scatter. A row is a
    training row if it is of the same pose (`SAME_POSE`) and also reads alike, within `ROUNDED` or within the last digit
    written. Such rows are refused where they are more than poses measured anew would give by chance (binomial,
    `UNLIKELY`). Where readings are labels, such as a socket's number, the joints are what was read.

    Raises:
        InputError: Names file and lines of these rows, and of the training rows that they are.
    """
    there, here = [], []
    for other in _parts(test):
        for known in _parts(train):
            rows, copied = _copies(known, other)
            there += [origins_of(other).place(row) for row in rows.tolist()]
            here += [origins_of(known).place(row) for row in copied.tolist()]
    if there:
        raise InputError(
            f"{named(there)} of the rows to judge by: trained on too ({named(here)}), with the same joints and, but "
            "for rounding, the same reading; give rows that were measured by themselves"
        )


def said_of_repeats(train: Observations, test: Observations) -> Iterator[tuple[Literal["caution", "note"], str]]:
    """What a verdict says where rows to judge by stand at poses that were trained on: a caution where most do."""
    rows = len(test.joints)
    count = int(np.count_nonzero(_nearest(train.joints, test.joints, SAME_POSE) >= 0)) if rows else 0
    if count:
        said = f"{count} of {rows} held-out rows are at poses that were trained on, and say nothing of others"
        yield "caution" if 2 * count > rows else "note", said


def _parts(data: Observations) -> tuple[Observations, ...]:
    return data.parts if isinstance(data, Stacked) else (data,)


def _copies(known: Observations, other: Observations) -> tuple[Rows, Rows]:
    """Rows of ``other`` that are rows of ``known``, and which; none where they are few enough to be chance."""
    none = np.zeros(0, dtype=np.int64)
    mine, theirs = known.readings(), other.readings()
    if type(known) is not type(other) or mine.shape[1] != theirs.shape[1] or not len(mine) or not len(theirs):
        return none, none
    rounded, near = ROUNDED["px" if isinstance(known, PixelObservations) else known.miss_unit], SAME_POSE
    if 2 * len(np.unique(mine, axis=0)) <= len(mine):  # labels
        mine, theirs, rounded, near = known.joints, other.joints, IDENTICAL, IDENTICAL
    poses = int(np.count_nonzero(_nearest(known.joints, other.joints, near) >= 0))
    digits = sorted((_digit(mine), _digit(theirs)))
    for size in (min(rounded, digits[1] / 2), rounded):
        chance = ROUGH if digits[0] > 2 * rounded else CHANCE * size / rounded
        size = size * (1.0 + 1e-6) + 1e-10  # but for the last bits
        copied = _nearest(
            np.hstack([known.joints / near, mine / size]), np.hstack([other.joints / near, theirs / size]), 1.0
        )
        rows = np.flatnonzero(copied >= 0)
        if len(rows) and binom.sf(len(rows) - 1, poses, chance ** mine.shape[1]) < UNLIKELY:
            return rows, copied[rows]
    return none, none


def _nearest(known: Array, other: Array, within: float) -> Rows:
    """The nearest of ``known`` to each of ``other``, no coordinate being farther off than this; -1 where none is."""
    _, nearest = KDTree(known).query(other, p=np.inf, distance_upper_bound=within * (1.0 + 1e-6) + 1e-12)
    return np.where(nearest < len(known), nearest, -1)


def _digit(values: Array) -> float:
    """The last decimal that is written in any of these numbers."""
    return next((10.0**-n for n in range(9) if np.allclose(values, np.round(values, n), rtol=0.0, atol=1e-10)), 1e-9)
