"""Rows of data sets of any kind: splitting them for judgement, so that each group of rows is trained on."""

from __future__ import annotations

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.splits import Rows, home_groups, random_split, same_poses
from pickenv.errors import InputError


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
