"""Rows of data sets of any kind: splitting them for judgement, so that each group of rows is trained on."""

from __future__ import annotations

from functools import partial

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.splits import Rows, blocked_split, random_split
from pickenv.errors import InputError


def unknowns_of(found: Identification, observations: Observations) -> Array:
    """The identified values of a data set's own unknowns."""
    return np.array([found.unknowns[name] for name in observations.unknowns()])


def choose(
    observations: Observations, split: str, test_rows: int | None, rng: np.random.Generator
) -> tuple[Rows, Rows]:
    """Training and held-out rows of one data set; sockets are split one by one, so that each is trained on.

    Args:
        observations: The data.
        split: "random" or "blocked".
        test_rows: Rows to hold out; a fifth when left out.
        rng: Draws the random split.

    Raises:
        InputError: If the split is unknown or impossible.
    """
    if split not in ("random", "blocked"):
        raise InputError(f"split is '{split}'; give random or blocked")
    count = len(observations.joints)
    wanted = max(1, count // 5) if test_rows is None else test_rows
    divide = partial(random_split, rng=rng) if split == "random" else blocked_split
    groups = observations.groups
    if not groups.any():
        return divide(count, wanted)
    train, test = [], []
    for number in np.unique(groups):
        rows = np.flatnonzero(groups == number)
        share = max(1, round(wanted * len(rows) / count))
        if len(rows) - share < 2:
            raise InputError(
                f"{observations.source}: socket {number + 1} has {len(rows)} rows, too few to hold {share} of them out"
            )
        here, there = divide(len(rows), share)
        train.append(rows[here])
        test.append(rows[there])
    return np.concatenate(train), np.concatenate(test)
