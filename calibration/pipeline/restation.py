"""A calibrated arm seen from another station: base and tool found anew from a few rows, the arm left as it is.

An instrument that is set up again stands elsewhere and sees another target. What was found of the arm itself holds on;
the frames take six numbers each, and a few rows that tell them well. SI units.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pickenv.arm import Geometry, forward
from pickenv.arm.kinematics.geometry import Array, identity_pose
from pickenv.calibration.identification.alignment import align, apart, registered
from pickenv.calibration.identification.diagnosis import MANY_FAR, LeftOut
from pickenv.calibration.identification.least_squares import identify
from pickenv.calibration.identification.robust import OUTLIER_SIGMA, sizes_of
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import ErrorModel, frames_model
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Equations, origins_of
from pickenv.calibration.model.prior import Prior
from pickenv.calibration.model.splits import Rows, equally_spaced, same_poses
from pickenv.calibration.model.stacked import OWN
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.planning.exchange import exchange
from pickenv.errors import InputError

REFIT_ROWS = 6
"""Rows that base and tool are found from when nobody says how many."""

CHANGE_STD = (1.0, np.pi / 6)
"""Standard deviations of a frame's change before rows are seen, m and rad: what rows do not tell stays as it was."""

NO_RANK = 1e-12
"""Nothing is redundant where all is expected somewhere."""

TOLD = 0.1
"""A direction is told where its standard deviation is less than this share of `CHANGE_STD`."""

CANDIDATES = 1000
"""Rows are chosen among so many at most, taken evenly."""


@dataclass(frozen=True, eq=False)
class Restationed:
    """A calibration at another station.

    Attributes:
        calibration: The calibration, with the base and tool of this station.
        used: Rows that these were found from.
        rest: All rows of other poses.
        expected: Mean square that the errors there should have ``(R,)``, m^2: what the calibration leaves elsewhere,
            and what the frames are uncertain by.
        moved: How far base and tool lie from where they were, by name: m and rad.
        untold: How many of a frame's three directions of shift, and of turn, these rows do not tell, by name.
    """

    calibration: Calibration
    used: Rows
    rest: Rows
    expected: Array
    moved: dict[str, tuple[float, float]]
    untold: dict[str, tuple[int, int]]


def frames_and_rows(text: str | None, rows: int | None) -> tuple[tuple[str, ...], int]:
    """The frames that a list such as "base,tool" names, and how many rows they are found from.

    Raises:
        InputError: If it names others, or there are rows and no frames to find from them.
    """
    if text is None:
        if rows is not None:
            raise InputError(f"--refit-rows {rows} is for --refit; say which frames: --refit base,tool")
        return (), REFIT_ROWS
    named = tuple(part.strip() for part in text.split(","))
    if not set(named) <= set(OWN) or len(set(named)) != len(named):
        raise InputError(f"refit is '{text}'; give base, tool, or base,tool")
    return named, REFIT_ROWS if rows is None else rows


def restationed(
    calibration: Calibration,
    data: Measurements,
    own: Collection[str],
    count: int = REFIT_ROWS,
    used: Rows | None = None,
) -> Restationed:
    """Find base, tool or both of a calibrated arm anew from a few rows, chosen by their joints alone.

    The frames are expected where they were, within `CHANGE_STD`, which is as good as nothing where the rows tell them;
    where they do not, they stay.

    Args:
        calibration: The calibration.
        data: Poses or positions at the other station.
        own: Which of "base" and "tool" are found.
        count: Rows to find them from; they are chosen so that positions elsewhere are told best (I-optimal).
        used: These rows, where they were chosen already.

    Raises:
        InputError: If there are too few rows.
    """
    least = 3 * len(tuple(own))
    if count < least or len(data) < count + 3:
        raise InputError(
            f"{data.source}: {' and '.join(own)} are to be found from {count} of {len(data)} rows; give {least} rows "
            "or more, and measure at least 3 others to judge by"
        )
    data = weighed_by_reach(calibration, data)
    model = own_frames_model(calibration.identified, own)
    used = _telling(calibration.model, data, model, count) if used is None else used
    few = data.select(used)
    std = np.tile(np.repeat(CHANGE_STD, 3), len(model.names) // 6)
    before = Prior(calibration.model, model.columns, std)
    fits = [
        identify(model, start, [few, before], max_iterations=100, rank_tolerance=NO_RANK)
        for start in _starts(calibration.model, few, own)
    ]
    near = min(fits, key=lambda fit: fit.chi_square).arm_model
    # Expected where they were found, what rows tell is pulled by nothing, and what they do not tell still stays.
    settled: list[Equations] = [few, replace(before, reference=near)]
    there = identify(model, near, settled, max_iterations=100, rank_tolerance=NO_RANK).arm_model
    poses = same_poses(data.joints)
    rest = np.flatnonzero(~np.isin(poses, poses[used]))
    elsewhere = there.jacobian(data.joints[rest], data.conditions.select(rest))[:, :3][..., model.columns] * std
    told = few.jacobian(there, np.zeros(0))[0][:, model.columns] * std
    # In shares of the standard deviations before, with rows in standard uncertainties.
    covariance = np.linalg.inv(told.T @ told + np.eye(len(std)))
    expected = np.einsum("rip,pq,riq->r", elsewhere, covariance, elsewhere) + expected_square(data)
    parts = [covariance[first : first + 3, first : first + 3] for first in range(0, len(std), 3)]
    lost = [int(np.sum(np.linalg.eigvalsh(part) > TOLD**2)) for part in parts]
    untold = {name: (lost[2 * i], lost[2 * i + 1]) for i, name in enumerate(name for name in OWN if name in own)}
    geometry = calibration.identified
    moved = {name: apart(getattr(geometry, name), getattr(there.geometry, name)) for name in OWN if name in own}
    return Restationed(replace(calibration, model=there), used, rest, expected, moved, untold)


def own_frames_model(geometry: Geometry, own: Collection[str]) -> ErrorModel:
    """Base, tool or both."""
    frames = frames_model(geometry)
    chosen = [i for i, name in enumerate(frames.names) if name.startswith(tuple(own))]
    return ErrorModel(frames.columns[chosen], tuple(frames.names[i] for i in chosen), frames.tolerance[chosen])


def expected_square(data: Measurements) -> float:
    """Mean square of a position error that is scatter alone, m^2, of rows that say what one reach scatters by."""
    return 3.0 * data.position_std**2


def weighed_by_reach(calibration: Calibration, data: Measurements) -> Measurements:
    """The data with what one reach scatters by as their uncertainty, where the calibration knows it."""
    known = calibration.record.get("uncertainty") or {}
    position = max(float(known.get("position_repeat_m") or 0.0), data.position_std)
    attitude = max(float(known.get("attitude_repeat_rad") or 0.0), data.attitude_std)
    return replace(data, position_std=position, attitude_std=attitude)


def _telling(model: ArmModel, data: Measurements, frames: ErrorModel, count: int) -> Rows:
    """The rows that tell the frames best, for positions all over the data."""
    pool = equally_spaced(len(data), CANDIDATES)
    jacobian = model.jacobian(data.joints[pool], data.conditions.select(pool))[..., frames.columns] * frames.tolerance
    rows = jacobian[:, : data.rows_per_pose] * data.row_weights[:, None]
    weight = np.einsum("nip,niq->pq", jacobian[:, :3], jacobian[:, :3]) / len(pool)
    chosen, _ = exchange(rows, count, np.random.default_rng(0), weight)
    return np.sort(pool[chosen])


def _starts(model: ArmModel, few: Measurements, own: Collection[str]) -> Iterator[ArmModel]:
    """The model as it is, and near the new frames."""
    geometry = model.geometry
    yield model
    if set(own) == {"tool"}:
        return
    chain = forward(replace(geometry, base=identity_pose(), tool=identity_pose()), few.joints)
    yield replace(model, geometry=registered(geometry, geometry.tool, chain, few))
    if set(own) == set(OWN):
        yield replace(model, geometry=align(geometry, few, frames_model(geometry), judge=False).geometry)


def errors_there(at: Restationed, before: Calibration, data: Measurements) -> Array:
    """Measured minus predicted ``(R, 6)`` or ``(R, 3)`` on the rows that the frames were not found from, m and rad.

    What was learnt is turned with the base, in whose axes it was learnt.
    """
    turn = at.calibration.identified.base.rotation @ before.identified.base.rotation.T
    return at.calibration.errors(data.select(at.rest), turn)


def near_rows(
    calibration: Calibration, data: Measurements, refit: Collection[str], count: int
) -> tuple[Measurements, tuple[LeftOut, ...]]:
    """The rows but a few that are far off; where many are, the arm has moved, and they must judge.

    Args:
        calibration: The calibration.
        data: Rows, maybe of another station.
        refit: Which frames are that station's own; then rows far off are so wherever base and tool may be.
        count: Rows that these frames will be found from.
    """
    model = calibration.model
    if refit:
        model = restationed(calibration, data, refit, max(count, min(len(data) - 3, 4 * count))).calibration.model
    sigma = sizes_of(model, np.zeros(0), data).sigma
    far = np.flatnonzero(~(sigma <= OUTLIER_SIGMA))
    if len(far) > max(1.0, MANY_FAR * len(data)):
        return data, ()
    sizes = np.linalg.norm(data.difference(model)[:, :3], axis=1)
    left_out = [
        LeftOut(*origins_of(data).place(row), held_out=True, position=float(sizes[row]), sigma=float(sigma[row]))
        for row in far.tolist()
    ]
    return data.select(np.setdiff1d(np.arange(len(data)), far)), tuple(left_out)
