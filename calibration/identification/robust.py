"""Identification that outliers cannot pull: iteratively re-weighted least squares, and a list of the outliers.

Each row of a data set of any kind gets one weight from a Huber or Cauchy loss of its size in robust standard deviations
(median based, so that nearly half of the rows may be wrong; Holland and Welsch 1977). What one instrument reads in one
unit is a channel, and channels are scaled apart: metres and radians, a wire and a tracker. SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy.spatial import KDTree
from scipy.special import gammaincinv
from scipy.stats import binom

from pickenv.arm import Geometry, Pose, forward, rotation_matrix, rotation_vector
from pickenv.arm.kinematics.geometry import Array, identity_pose
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.noise import counted
from pickenv.calibration.model.observations import (
    SAME_POSE,
    Observations,
    Rows,
    home_groups,
    named,
    nearest_rotation,
    origins_of,
    random_split,
    same_poses,
)
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.stacked import Stacked
from pickenv.errors import InputError
from pickenv.threads import single_threaded

# Rows of data sets of any kind: split for judgement, so that each group is trained on and none judges that was.

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


# Base and tool pose from anywhere: closed-form starts, then least squares, and the refusal of what is no such arm.
# Positions p = t + R (o + Q u), with the chain's own o and Q, are linear in R^T, R^T t and the tool offset u once
# read backwards; full poses give R and the tool's attitude T as the null vector of A T^T = R Q (AX = YB; Dornaika and
# Horaud 1998). Where the motion leaves these undetermined, the nominal tool and a few others are tried. SI units.


MISFIT = 0.2
"""Errors above this share of the positions' spread, or this many rad, are no arm's: the data mean something else."""

SPAN = 0.1
"""Positions that spread less than this, m, are judged as if they did: few and close ones are still of the arm."""

GOOD = 0.05
"""A fit that misses by less than this share of the spread needs no further starts."""

STARTS = 24
"""Tools tried where neither the closed form nor the nominal tool leads anywhere."""


@single_threaded()
def align(geometry: Geometry, measurements: Measurements, frames: ErrorModel, *, judge: bool = True) -> Identification:
    """Fit base and tool pose, from anywhere.

    Args:
        geometry: The arm; its base and tool are one of the starts.
        measurements: Poses or positions.
        frames: Base and tool parameters (`frames_model`).
        judge: Whether to refuse data that do not fit the arm.

    Raises:
        InputError: If the data do not fit the arm at all, which means wrong units, joint signs or conventions.
    """
    best: Identification | None = None
    for start in _starts(geometry, measurements):
        found = identify(frames, start, measurements, max_iterations=100)
        if best is None or found.chi_square < best.chi_square:
            best = found
        if max(misfit(best.geometry, measurements)) < GOOD:
            break
    assert best is not None
    if judge:
        refuse_another_arm(best.geometry, measurements, "after fitting base and tool", geometry)
    return best


def misfit(geometry: Geometry, measurements: Measurements) -> tuple[float, float]:
    """RMS position error as a share of the measured positions' spread, and RMS attitude error in rad (0 without)."""
    left = measurements.difference(geometry)
    spread = max(float(np.linalg.norm(measurements.position.std(axis=0))), 1e-12)
    turn = np.sqrt(np.mean(np.sum(left[:, 3:] ** 2, axis=1)))
    return float(np.sqrt(np.mean(np.sum(left[:, :3] ** 2, axis=1)))) / spread, float(turn)


def _starts(geometry: Geometry, measurements: Measurements) -> Iterator[Geometry]:
    """Starting geometries, the best first: closed form and nominal tool, then other tools (the same every time)."""
    chain = forward(replace(geometry, base=identity_pose(), tool=identity_pose()), measurements.joints)
    tools = [geometry.tool, _closed_form_tool(chain, measurements, geometry.tool)]
    first = [registered(geometry, tool, chain, measurements) for tool in tools]
    yield from sorted(first, key=lambda start: _cost(start, measurements))
    rng = np.random.default_rng(0)
    reach = max(float(np.linalg.norm(measurements.position.std(axis=0))), 1e-3)
    others = []
    for _ in range(STARTS * 8):
        tool = Pose(rng.normal(size=3) * reach, rotation_matrix(rng.normal(size=3) * 2.0))
        others.append(registered(geometry, tool, chain, measurements))
    yield from sorted(others, key=lambda start: _cost(start, measurements))[: STARTS // 4]


def _cost(geometry: Geometry, measurements: Measurements) -> float:
    position, turn = misfit(geometry, measurements)
    return position + turn


def registered(geometry: Geometry, tool: Pose, chain: Pose, measurements: Measurements) -> Geometry:
    """The geometry with this tool, and with the base that lays its poses best onto the measured ones.

    Rotations by the attitudes where measured, else by the positions (Kabsch 1976).
    """
    nominal = chain.position + chain.rotation @ tool.position
    measured = measurements.position
    if measurements.rotation is None:
        turn = nearest_rotation((measured - measured.mean(0)).T @ (nominal - nominal.mean(0)))
    else:
        turn = nearest_rotation(np.einsum("nij,nkj->ik", measurements.rotation, chain.rotation @ tool.rotation))
    base = Pose(measured.mean(0) - turn @ nominal.mean(0), turn)
    return replace(geometry, base=base, tool=tool)


def _closed_form_tool(chain: Pose, measurements: Measurements, nominal: Pose) -> Pose:
    """The tool's pose in the last link, linearly."""
    if measurements.rotation is None:
        return Pose(_offset_from_positions(chain, measurements.position), nominal.rotation)
    turn, tool_turn = _turns_from_attitudes(chain.rotation, measurements.rotation)
    # p = t + R o + R Q u is linear in t and u.
    count = len(measurements)
    matrix = np.concatenate([np.broadcast_to(np.eye(3), (count, 3, 3)), turn @ chain.rotation], axis=2)
    right = measurements.position - chain.position @ turn.T
    solution = np.linalg.lstsq(matrix.reshape(-1, 6), right.ravel(), rcond=1e-9)[0]
    return Pose(solution[3:], tool_turn)


def _offset_from_positions(chain: Pose, position: Array) -> Array:
    """The offset u of M p - s - Q u = o, linear in M = R^T, s = R^T t and u."""
    count, middle = len(position), position.mean(axis=0)
    by_rotation = np.einsum("ik,nj->nikj", np.eye(3), position - middle).reshape(count, 3, 9)
    by_shift = np.broadcast_to(-np.eye(3), (count, 3, 3))
    matrix = np.concatenate([by_rotation, by_shift, -chain.rotation], axis=2)
    solution = np.linalg.lstsq(matrix.reshape(-1, 15), chain.position.ravel(), rcond=1e-6)[0]
    return np.asarray(solution[12:])


def _turns_from_attitudes(chain: Array, measured: Array) -> tuple[Array, Array]:
    """Base and tool rotation of measured = R chain T: the null vector of measured T^T - R chain = 0."""
    rows = []
    for mine, theirs in zip(chain, measured, strict=True):
        # Row-major vec: vec(A X) = (A kron 1) vec X, vec(Y B) = (1 kron B^T) vec Y.
        rows.append(np.concatenate([np.kron(theirs, np.eye(3)), -np.kron(np.eye(3), mine.T)], axis=1))
    gram = sum(row.T @ row for row in rows)
    vector = np.linalg.eigh(gram)[1][:, 0]
    first, second = vector[:9].reshape(3, 3), vector[9:].reshape(3, 3)
    sign = np.sign(np.linalg.det(second)) or 1.0
    turn = nearest_rotation(second * sign)
    tool = nearest_rotation(first * sign).T
    return turn, tool


def apart(one: Pose, other: Pose) -> tuple[float, float]:
    """How far two poses lie apart, m, and the angle between them, rad."""
    turn = rotation_vector(one.rotation.T @ other.rotation)
    return float(np.linalg.norm(one.position - other.position)), float(np.linalg.norm(turn))


def refuse_another_arm(
    geometry: Geometry, measurements: Measurements, state: str, nominal: Geometry | None = None
) -> None:
    """Refuse measurements that lie so far from ``geometry`` that units, joint signs or conventions must be wrong.

    Args:
        geometry: The arm, with base and tool as they are known or fitted.
        measurements: The data.
        state: What was done about base and tool, as the message says it.
        nominal: The arm with its own tool, where ``geometry`` has a fitted one.

    Raises:
        InputError: If positions miss by more than `MISFIT` of their spread, which counts as `SPAN` at least, or
            attitudes by more than `MISFIT` rad.
    """
    if len(measurements) < 3:
        return  # no spread to speak of; `identify` says how many poses are needed
    position, turn = misfit(geometry, measurements)
    spread = float(np.linalg.norm(measurements.position.std(axis=0)))
    if position * spread > MISFIT * max(spread, SPAN):
        own = float(np.linalg.norm(forward(nominal or geometry, measurements.joints).position.std(axis=0)))
        ratio = spread / max(own, 1e-12)
        if not 0.05 < ratio < 20:
            raise InputError(
                f"{measurements.source}: positions spread {ratio:.3g} times as far as the "
                "arm's own; positions are probably in another length unit, or joints in another angle unit"
            )
        raise InputError(
            f"{measurements.source}: {state} the arm still misses by {position * spread * 1e3:.0f} mm RMS, of a spread "
            f"of {spread * 1e3:.0f} mm; check the arm, the units, joint order and signs, and the attitude convention"
        )
    if turn > MISFIT:
        raise InputError(
            f"{measurements.source}: {state} attitudes still miss by {np.degrees(turn):.0f} deg RMS; "
            "check the attitude convention and its unit, and the joint signs"
        )


OUTLIER_SIGMA = 10.0
"""A row off by more robust standard deviations than this is an outlier; what a model leaves out stays below it."""

WEIGHTINGS, SELECTIONS, FOURS = 30, 10, 500
"""Least squares at most, alignments at most, and fours of poses that are tried."""

LOSSES: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {
        "huber": lambda size: np.minimum(1.0, 1.345 / np.maximum(size, 1e-12)),
        "cauchy": lambda size: 1.0 / (1.0 + (size / 2.385) ** 2),
    }
)
"""Weight of a row by its size in standard deviations per coordinate; constants for 95 % efficiency on normal noise."""


@dataclass(frozen=True, eq=False)
class RobustIdentification:
    """An identification with the weights it ended at.

    Attributes:
        identification: The last weighted least squares.
        weights: Weight of each row ``(N,)`` in it, 0 to 1.
        sizes: Sizes of the errors that it leaves.
        settled: Whether the weights stopped changing.
    """

    identification: Identification
    weights: Array
    sizes: Sizes
    settled: bool

    @property
    def geometry(self) -> Geometry:
        """The identified geometry."""
        return self.identification.geometry

    def sizes_of(self, data: Observations) -> Sizes:
        """Sizes of the errors of any rows by this arm's identified model, in the standard deviations found here."""
        return sizes_of(self.identification.arm_model, unknowns_of(self.identification, data), data, self.sizes)

    def misses_of(self, data: Observations) -> Array:
        """The largest miss of each row ``(N,)``, m."""
        left = data.misses(self.identification.arm_model, unknowns_of(self.identification, data))
        largest = np.zeros(len(data.joints))
        np.maximum.at(largest, data.rows_of_misses, np.linalg.norm(left, axis=1))
        return largest


def robust_identify(
    model: ErrorModel, start: Geometry | ArmModel, data: Observations, *, loss: str = "cauchy"
) -> RobustIdentification:
    """Identify with iteratively re-weighted least squares; the first weights come from the starting geometry.

    Args:
        model: The parameters.
        start: Geometry, or geometry with terms; near the data (see `robust_align`).
        data: Rows of any kind.
        loss: "huber" (an outlier keeps a bounded pull) or "cauchy" (a gross one loses all of it).

    Raises:
        InputError: If the loss is unknown, or as `identify`.
    """
    if loss not in LOSSES:
        raise InputError(f"unknown loss '{loss}'; give one of {', '.join(LOSSES)}")
    arm, apart = ArmModel.of(start), counted(data.joints)
    weights = sizes_of(arm, data.start(arm), data, apart=apart).weights(loss)
    rows, _ = data.equations()
    for _ in range(WEIGHTINGS):
        factors = np.where(rows >= 0, np.sqrt(weights * apart)[rows], 1.0)
        found = identify(model, start, [data], whiten=lambda stated, by=factors: (stated.T * by).T)  # type: ignore[misc]
        sizes = sizes_of(found.arm_model, unknowns_of(found, data), data, apart=apart)
        used, weights = weights, sizes.weights(loss)
        settled = bool(np.max(np.abs(weights - used)) < 1e-3)
        if settled:
            break
    return RobustIdentification(found, used, sizes, settled)


def robust_align(
    geometry: Geometry,
    measurements: Measurements,
    frames: ErrorModel,
    rng: np.random.Generator,
) -> RobustIdentification:
    """`align` for data with gross errors: base and tool from the poses that agree with each other.

    Base poses are tried from random fours of positions; the one with the smallest median error shows the gross errors
    (random sample consensus with the least median of squares, Rousseeuw 1984). Then `align` on the rest, repeated.

    Args:
        geometry: The arm.
        measurements: Poses or positions, from anywhere.
        frames: Base and tool parameters (`frames_model`).
        rng: Draws the fours.

    Raises:
        InputError: As `align`.
    """
    count = len(measurements)
    if count < 8:
        raise InputError(f"{measurements.source}: {count} poses are too few to tell outliers; measure at least 8")
    nominal, measured = forward(geometry, measurements.joints).position, measurements.position
    rows = np.argsort(rng.random((FOURS, count)), axis=1)[:, :4]
    missed = _registered_misses(nominal, measured, rows)
    best = missed[np.argmin(np.median(missed, axis=1))]
    kept = best <= 5.0 * np.median(best)
    for _ in range(SELECTIONS):
        found = align(geometry, measurements.select(kept), frames)
        sizes = sizes_of(found.arm_model, np.zeros(0), measurements)
        used, kept = kept, sizes.sigma <= OUTLIER_SIGMA
        settled = bool(np.array_equal(used, kept))
        if settled:
            break
    return RobustIdentification(found, used.astype(float), sizes, settled)


@dataclass(frozen=True, eq=False)
class Sizes:
    """Sizes of the errors of N rows, channel by channel.

    Attributes:
        errors: Sizes ``(C, N)``, in stated standard uncertainties of one coordinate: norms of up to three equations,
            and of more (a picture's corners) that of three like them; NaN where a row does not use a channel.
        coordinates: How many equations each stands for ``(C, N)``, three at most.
        scales: Robust standard deviation of one coordinate by channel ``(C,)``, in stated ones.
    """

    errors: Array
    coordinates: Array
    scales: Array

    @property
    def sigma(self) -> Array:
        """The largest of each row ``(N,)``, in robust standard deviations of one coordinate."""
        return np.asarray(np.nanmax(np.vstack([self.errors / self.scales[:, None], self._none]), axis=0))

    @property
    def outliers(self) -> Rows:
        """Rows beyond `OUTLIER_SIGMA`, the largest first."""
        order = np.argsort(-self.sigma, kind="stable")
        return order[self.sigma[order] > OUTLIER_SIGMA]

    def weights(self, loss: str) -> Array:
        """Weights ``(N,)`` by the size per coordinate."""
        squares = np.nansum((self.errors / self.scales[:, None]) ** 2, axis=0)
        return LOSSES[loss](np.sqrt(squares / np.maximum(self.coordinates.sum(axis=0), 1)))

    @property
    def _none(self) -> Array:
        return np.zeros((1, self.errors.shape[1]))


def sizes_of(
    arm: ArmModel, unknowns: Array, data: Observations, like: Sizes | None = None, *, apart: Array | None = None
) -> Sizes:
    """Sizes in the standard deviations of others, or in robust ones, never below the instrument's own uncertainty.

    Args:
        arm: The arm.
        unknowns: The data's own unknowns.
        data: The rows.
        like: Sizes with the standard deviations to use.
        apart: What each row counts in the median ``(N,)``, less where others stand near it: rows of a cluster miss by
            the same, and are few facts. All alike when left out.
    """
    rows, channels = data.equations()
    squares, count = np.zeros((2, int(channels.max()) + 1, len(data.joints)))
    own = rows >= 0
    np.add.at(squares, (channels[own], rows[own]), data.residual(arm, unknowns)[own] ** 2)
    np.add.at(count, (channels[own], rows[own]), 1.0)
    shown = np.minimum(count, 3.0)
    errors = np.sqrt(np.where(count > 0, squares * shown / np.maximum(count, 1.0), np.nan))
    if like is not None:
        return Sizes(errors, shown, like.scales)
    usual = np.sqrt(2.0 * gammaincinv(np.maximum(count, 1.0) / 2.0, 0.5) * shown / np.maximum(count, 1.0))
    apart = np.ones(len(data.joints)) if apart is None else apart
    scales = [_median(size / median, apart) for size, median in zip(errors, usual, strict=True)]
    return Sizes(errors, shown, np.maximum(scales, 1.0))


def _median(values: Array, counts: Array) -> float:
    """The median of values ``(N,)`` that count differently; NaN is none."""
    order = np.argsort(values, kind="stable")[: np.count_nonzero(values == values)]
    below = np.cumsum(counts[order])
    first, last = np.searchsorted(below, below[-1] * np.array([0.5 - 1e-12, 0.5 + 1e-12]))
    return float(values[order[[first, min(last, len(order) - 1)]]].mean())


def _registered_misses(nominal: Array, measured: Array, rows: Rows) -> Array:
    """Distances ``(T, N)`` of measured points from nominal ones after T rigid registrations of few rows (Kabsch)."""
    here, there = nominal[rows], measured[rows]
    from_, to = here.mean(axis=1, keepdims=True), there.mean(axis=1, keepdims=True)
    turn = nearest_rotation(np.swapaxes(here - from_, 1, 2) @ (there - to))  # row vectors: point @ turn
    return np.asarray(np.linalg.norm((nominal - from_) @ turn + to - measured, axis=2))
