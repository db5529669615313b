"""Robust identification from any start: alignment, re-weighted least squares, and grouping of files by set-up.

Each row gets one weight from a Cauchy loss of its error in robust standard deviations. The deviations come from
medians, so that nearly half of the rows may be wrong (Holland and Welsch 1977). Readings of one instrument in one unit
are a channel. Every channel has a separate scale, because units and instruments differ. A set-up is one place of the
instrument, and one place of its target on the tool. SI units.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.special import gammaincinv

from pickenv.arm import Arm, Array, Geometry, Pose, identity_pose, rotation_matrix, rotation_vector
from pickenv.base import InputError, single_threaded
from pickenv.calibration.identification.least_squares import Identification, identify, unknowns_of
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel, fitted_model, frames_model, with_terms
from pickenv.calibration.model.kinds import ReflectorObservations
from pickenv.calibration.model.measurements import OWN, InstrumentStation, Measurements, Stacked, rows_together
from pickenv.calibration.model.noise_and_priors import counted
from pickenv.calibration.model.observations import Observations, nearest_rotation, origins_of
from pickenv.calibration.model.terms import weight_of

# Base and tool pose from anywhere: closed-form starts, then least squares, and the refusal of what is no such arm.
# Positions p = t + R (o + Q u), with the chain's own o and Q, are linear in R^T, R^T t and the tool offset u once
# read backwards; full poses give R and the tool's attitude T as the null vector of A T^T = R Q (AX = YB; Dornaika and
# Horaud 1998). Where the motion leaves these undetermined, the nominal tool and a few others are tried. SI units.


MISFIT = 0.2
"""Largest RMS error of data that fit the arm: as a share of the positions' spread, or in rad for attitudes."""

SPAN = 0.1
"""Least spread of positions, m, of which `MISFIT` is a share, so that few and close positions are not refused."""

SUSPECT, BETTER = 0.02, 5.0
"""Misfit, as in `MISFIT`, above which other readings of the data are tried. Data are refused if another reading's
misfit is below this number and smaller by the factor `BETTER`."""

GOOD = 0.05
"""A fit whose error is below this share of the spread needs no further starts."""

STARTS = 24
"""If closed form and nominal tool fit badly, the best ``STARTS / 4`` of ``8 * STARTS`` random tools are tried."""


@single_threaded()
def align(geometry: Geometry, measurements: Measurements, frames: ErrorModel, *, judge: bool = True) -> Identification:
    """Fit base and tool pose to measured poses or positions, without need of a good start.

    Args:
        geometry: The arm; its base and tool are one of the starts.
        measurements: Poses or positions.
        frames: Base and tool parameters (`frames_model`).
        judge: Whether to refuse data that do not fit the arm.

    Raises:
        InputError: If the data do not fit the arm at all, which means wrong units, joint signs or conventions.
    """
    tried: list[Identification] = []
    for start in _starts(geometry, measurements):
        tried.append(identify(frames, start, measurements, max_iterations=100))
        best = min(tried, key=lambda solution: solution.chi_square)
        if max(misfit(best.geometry, measurements)) < GOOD:
            break
    if judge:
        refuse_another_arm(best.geometry, measurements, "after fitting base and tool", geometry)
    return best


def misfit(geometry: Geometry, measurements: Measurements) -> tuple[float, float]:
    """Return the RMS position error, as a share of the positions' spread, and the RMS attitude error, rad.

    The attitude error is 0 if no attitudes were measured.
    """
    spread = max(float(np.linalg.norm(measurements.position.std(axis=0))), 1e-12)
    squares = measurements.difference(geometry) ** 2
    position, attitude = (float(np.sqrt(np.mean(np.sum(part, axis=1)))) for part in (squares[:, :3], squares[:, 3:]))
    return position / spread, attitude


def _starts(geometry: Geometry, measurements: Measurements) -> Iterator[Geometry]:
    """Yield starting geometries with different tools, each with the base that fits best.

    The nominal tool and the closed-form tool come first, then random tools, drawn with a fixed seed. Each of these two
    groups is in order of increasing error.
    """
    bare = ArmModel.of(replace(geometry, base=identity_pose(), tool=identity_pose()))
    chain = bare.pose(measurements.joints, measurements.conditions)

    def ranked(tools: Iterable[Pose]) -> list[Geometry]:
        starts = [registered(geometry, tool, chain, measurements) for tool in tools]
        return sorted(starts, key=lambda start: sum(misfit(start, measurements)))

    yield from ranked([geometry.tool, _closed_form_tool(chain, measurements, geometry.tool)])
    reach = max(float(np.linalg.norm(measurements.position.std(axis=0))), 1e-3)
    draws = np.random.default_rng(0).normal(size=(STARTS * 8, 2, 3))
    yield from ranked(Pose(place * reach, rotation_matrix(turn * 2.0)) for place, turn in draws)[: STARTS // 4]


def laid_onto(points: Array, targets: Array) -> tuple[Array, Array]:
    """Return the rotations and shifts that best map points onto targets (Kabsch).

    Args:
        points: Points ``(..., N, 3)``, m.
        targets: The same points' targets ``(..., N, 3)``, m.

    Returns:
        Rotations ``(..., 3, 3)`` and shifts ``(..., 3)``, m.
    """
    middle, centre = points.mean(axis=-2, keepdims=True), targets.mean(axis=-2, keepdims=True)
    turn = nearest_rotation(np.swapaxes(targets - centre, -1, -2) @ (points - middle))
    return turn, (centre - middle @ np.swapaxes(turn, -1, -2))[..., 0, :]


def registered(geometry: Geometry, tool: Pose, chain: Pose, measurements: Measurements) -> Geometry:
    """Return the geometry with this tool, and with the base that best maps the arm's tool poses onto the measured ones.

    The base's rotation follows from the attitudes if they were measured, else from the positions (Kabsch 1976).

    Args:
        geometry: The arm.
        tool: Pose of the tool in the last link's frame.
        chain: Poses of the last link in frame 0 at the measured joints ``(N,)``.
        measurements: The measured poses or positions.
    """
    nominal = chain.position + chain.rotation @ tool.position
    measured = measurements.position
    if measurements.rotation is None:
        turn, _ = laid_onto(nominal, measured)
    else:
        turn = nearest_rotation(np.einsum("nij,nkj->ik", measurements.rotation, chain.rotation @ tool.rotation))
    return replace(geometry, base=Pose(measured.mean(0) - turn @ nominal.mean(0), turn), tool=tool)


def _closed_form_tool(chain: Pose, measurements: Measurements, nominal: Pose) -> Pose:
    """Compute the tool's pose in the last link's frame from linear equations.

    Args:
        chain: Poses of the last link in frame 0 at the measured joints ``(N,)``.
        measurements: The measured poses or positions.
        nominal: The nominal tool, whose attitude is kept if only positions were measured.
    """
    if measurements.rotation is None:
        return Pose(_offset_from_positions(chain, measurements.position), nominal.rotation)
    turn, tool_turn = _turns_from_attitudes(chain.rotation, measurements.rotation)
    # p = t + R o + R Q u is linear in t and u.
    matrix = np.concatenate([np.broadcast_to(np.eye(3), (len(measurements), 3, 3)), turn @ chain.rotation], axis=2)
    right = measurements.position - chain.position @ turn.T
    solution = np.linalg.lstsq(matrix.reshape(-1, 6), right.ravel(), rcond=1e-9)[0]
    return Pose(solution[3:], tool_turn)


def _offset_from_positions(chain: Pose, position: Array) -> Array:
    """Compute the tool offset u ``(3,)``, m, from M p - s - Q u = o, which is linear in M = R^T, s = R^T t and u.

    R and t are the base's rotation and position.

    Args:
        chain: Rotations Q and positions o of the last link in frame 0 at the measured joints ``(N,)``.
        position: Measured positions p ``(N, 3)``, m.
    """
    count, middle = len(position), position.mean(axis=0)
    by_rotation = np.einsum("ik,nj->nikj", np.eye(3), position - middle).reshape(count, 3, 9)
    matrix = np.concatenate([by_rotation, np.broadcast_to(-np.eye(3), (count, 3, 3)), -chain.rotation], axis=2)
    solution = np.linalg.lstsq(matrix.reshape(-1, 15), chain.position.ravel(), rcond=1e-6)[0]
    return np.asarray(solution[12:])


def _turns_from_attitudes(chain: Array, measured: Array) -> tuple[Array, Array]:
    """Compute base rotation R and tool rotation T of measured = R chain T, as null vector of measured T^T - R chain.

    Args:
        chain: Rotations of the last link in frame 0 ``(N, 3, 3)``.
        measured: Measured rotations of the tool ``(N, 3, 3)``.
    """
    # Row-major vec: vec(A X) = (A kron 1) vec X, vec(Y B) = (1 kron B^T) vec Y. Of rotations the normal equations are
    # [[N, -S], [-S^T, N]] with the sum S of A^T kron B^T, so that the null vector is S's first pair of singular ones.
    u, _, vt = np.linalg.svd(np.einsum("nji,nlk->ikjl", measured, chain).reshape(9, 9))
    first, second = u[:, 0].reshape(3, 3), vt[0].reshape(3, 3)
    sign = np.sign(np.linalg.det(second)) or 1.0
    return nearest_rotation(second * sign), nearest_rotation(first * sign).T


def apart(one: Pose, other: Pose) -> tuple[float, float]:
    """Return the distance between two poses, m, and the angle between them, rad."""
    turn = rotation_vector(one.rotation.T @ other.rotation)
    return float(np.linalg.norm(one.position - other.position)), float(np.linalg.norm(turn))


def refuse_another_arm(
    geometry: Geometry, measurements: Measurements, state: str, nominal: Geometry | None = None
) -> None:
    """Refuse measurements that lie so far from ``geometry`` that units, joint signs or conventions must be wrong.

    Args:
        geometry: The arm, with base and tool as they are known or fitted.
        measurements: The data.
        state: Words for the message that say how base and tool were determined.
        nominal: The arm with its own tool, if ``geometry`` has a fitted tool. Its spread of positions shows whether
            the unit is wrong.

    Raises:
        InputError: If positions miss by more than `MISFIT` of their spread (at least `SPAN`), or attitudes by more than
            `MISFIT` rad. Also if the rows fit far better with other joints or positions (`_other_reading`).
    """
    if len(measurements) < 3:
        return  # no spread to speak of; `identify` says how many poses are needed
    position, turn = misfit(geometry, measurements)
    spread = float(np.linalg.norm(measurements.position.std(axis=0)))
    if max(position * spread / max(spread, SPAN), turn) > SUSPECT:
        better, reading = _other_reading(nominal or geometry, measurements, nominal is None)
        if better < min(SUSPECT, (position + turn) / BETTER):
            times = f"{(position + turn) / max(better, 1e-3):.0f} times"
            raise InputError(f"{measurements.source}: {state} the arm fits {times} better with {reading}")
    if position * spread > MISFIT * max(spread, SPAN):
        whole = ArmModel.of(nominal or geometry).pose(measurements.joints, measurements.conditions)
        ratio = spread / max(float(np.linalg.norm(whole.position.std(axis=0))), 1e-12)
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


def _other_reading(arm: Geometry, data: Measurements, known: bool) -> tuple[float, str]:
    """Return the least misfit (`misfit`, sum of both parts) of another reading of the data, and that reading in words.

    A reading counts a joint backwards, exchanges two joints, or mirrors the positions. If ``known`` is False, each
    reading is judged with a rough base and tool that are computed for it.
    """
    data, names = data.at_most(FILE_ROWS), arm.joint_names
    readings = {f"{name} counted backwards": data.joints * (1.0 - 2.0 * (np.array(names) == name)) for name in names}
    for i, k in combinations(range(arm.joints), 2):
        if arm.prismatic[i] == arm.prismatic[k]:
            joints = data.joints.copy()
            joints[:, [i, k]] = joints[:, [k, i]]
            readings[f"{names[i]} and {names[k]} exchanged"] = joints
    axes, turn, remedy = np.eye(3), data.rotation, "; correct the columns of the "
    rows = [(words + remedy + "joints", replace(data, joints=joints)) for words, joints in readings.items()]
    words = "positions mirrored (one axis turned round, or two exchanged)" + remedy + "positions"
    for mirror in (*(axes - 2.0 * np.diag(axis) for axis in axes), *axes[[[1, 0, 2], [0, 2, 1], [2, 1, 0]]]):
        for attitude in (turn,) if turn is None else (turn, mirror @ turn @ mirror):  # in its own axes, or mirrored too
            rows.append((words, replace(data, position=data.position @ mirror, rotation=attitude)))
    return min((sum(misfit(arm if known else next(_starts(arm, row)), row)), words) for words, row in rows)


OUTLIER_SIGMA = 10.0
"""Rows whose error exceeds this many robust standard deviations are outliers; errors of the arm model stay below it."""

WEIGHTINGS, SELECTIONS, FOURS = 30, 10, 500
"""Largest numbers of re-weighted fits and of repeated alignments, and number of random sets of four poses."""

CAUCHY = 2.385
"""Error, in standard deviations per coordinate, at which a row weighs 0.5; for normal noise the efficiency is 95 %."""


Sizes = tuple[Array, Array, Array]
"""Sizes of the errors of N rows, as three arrays; a channel is the readings of one instrument in one unit.

The first is the error of each row in its worst channel ``(N,)``, in robust standard deviations. The second is the
Cauchy weight of each row ``(N,)``. The third is each channel's robust standard deviation ``(C,)``, in stated standard
uncertainties.
"""


def robust_identify(model: ErrorModel, start: Geometry | ArmModel, data: Observations) -> tuple[Identification, Sizes]:
    """Identify by iteratively re-weighted least squares; the first weights come from the starting geometry.

    Args:
        model: The parameters.
        start: Geometry, or geometry with terms, with base and tool near the data (see `robust_align`).
        data: Rows of any kind.

    Returns:
        The identification by the last weighted least squares, and the sizes of the rows' errors (`Sizes`).

    Raises:
        InputError: If there are too few poses for the model's rank.
    """
    arm, apart = ArmModel.of(start), counted(data.joints)
    _, weights, _ = sizes_of(arm, data.start(arm), data, apart=apart)
    rows, _ = data.equations()
    for _ in range(WEIGHTINGS):
        factors = np.where(rows >= 0, np.sqrt(weights * apart)[rows], 1.0)
        solution = identify(model, start, [data], whiten=lambda stated, by=factors: (stated.T * by).T)  # type: ignore[misc]
        sizes = sizes_of(solution.arm_model, unknowns_of(solution, data), data, apart=apart)
        before, (_, weights, _) = weights, sizes
        if np.max(np.abs(weights - before)) < 1e-3:
            break
    return solution, sizes


def robust_align(
    geometry: Geometry, measurements: Measurements, frames: ErrorModel, rng: np.random.Generator
) -> Identification:
    """Fit base and tool pose to data with gross errors, from the poses that agree with each other.

    Base poses are computed from random sets of four positions. The base pose of least median error identifies the
    gross errors (random sample consensus with the least median of squares, Rousseeuw 1984). `align` is then applied to
    the other poses, repeatedly.

    Args:
        geometry: The arm.
        measurements: Poses or positions, from an instrument at any place.
        frames: Base and tool parameters (`frames_model`).
        rng: Draws the sets of four positions.

    Raises:
        InputError: If there are fewer than eight poses, or the data do not fit the arm at all.
    """
    count = len(measurements)
    if count < 8:
        raise InputError(f"{measurements.source}: {count} poses are too few to tell outliers; measure at least 8")
    nominal = ArmModel.of(geometry).pose(measurements.joints, measurements.conditions).position
    measured = measurements.position
    rows = np.argsort(rng.random((FOURS, count)), axis=1)[:, :4]
    turn, shift = laid_onto(nominal[rows], measured[rows])
    missed = np.linalg.norm(nominal @ np.swapaxes(turn, 1, 2) + shift[:, None] - measured, axis=2)
    best = missed[np.argmin(np.median(missed, axis=1))]
    near = best <= 5.0 * np.median(best)
    for _ in range(SELECTIONS):
        solution = align(geometry, measurements.select(near), frames)
        before, near = near, sigma_of(solution, measurements) <= OUTLIER_SIGMA
        if np.array_equal(before, near):
            break
    return solution


def sizes_of(
    arm: ArmModel, unknowns: Array, data: Observations, scales: Array | None = None, *, apart: Array | None = None
) -> Sizes:
    """Return the sizes of the rows' errors (`Sizes`), in standard deviations of the channels.

    A channel is the readings of one instrument in one unit. Without ``scales`` the standard deviations are robust ones,
    computed from the rows. They are never below the instrument's own uncertainty.

    Args:
        arm: The arm.
        unknowns: Values of the data's own unknowns.
        data: The rows.
        scales: The standard deviations to use, by channel ``(C,)``, in stated standard uncertainties.
        apart: Weight of each row in the median ``(N,)``. It is smaller for rows with near neighbours, because errors
            within a cluster are alike. All weights are equal if it is None.
    """
    rows, channels = data.equations()
    squares, count = np.zeros((2, int(channels.max()) + 1, len(data.joints)))
    read = rows >= 0
    np.add.at(squares, (channels[read], rows[read]), data.residual(arm, unknowns)[read] ** 2)
    np.add.at(count, (channels[read], rows[read]), 1.0)
    coordinates = np.minimum(count, 3.0)
    # Norms of up to three equations, and of more (a picture's corners) that of three like them; NaN of unused channels.
    errors = np.sqrt(np.where(count > 0, squares * coordinates / np.maximum(count, 1.0), np.nan))
    if scales is None:
        usual = np.sqrt(2.0 * gammaincinv(np.maximum(count, 1.0) / 2.0, 0.5) * coordinates / np.maximum(count, 1.0))
        apart = np.ones(len(data.joints)) if apart is None else apart
        medians = [_median(size / median, apart) for size, median in zip(errors, usual, strict=True)]
        scales = np.maximum(medians, 1.0)
    errors = errors / scales[:, None]
    size = np.sqrt(np.nansum(errors**2, axis=0) / np.maximum(coordinates.sum(axis=0), 1))
    return np.fmax.reduce(errors, axis=0, initial=0.0), 1.0 / (1.0 + (size / CAUCHY) ** 2), scales


def sigma_of(found: Identification, data: Observations, scales: Array | None = None) -> Array:
    """Return the largest error of each row ``(N,)`` under an identified arm, in standard deviations of the channels.

    A channel is the readings of one instrument in one unit.

    Args:
        found: The identification.
        data: The rows.
        scales: Standard deviations by channel ``(C,)``, in stated standard uncertainties; robust ones from the rows if
            left out.
    """
    return sizes_of(found.arm_model, unknowns_of(found, data), data, scales)[0]


def misses_of(found: Identification, data: Observations) -> Array:
    """Return the size of the largest miss (measured minus predicted) of each row ``(N,)``, m, or rad for directions."""
    misses = data.misses(found.arm_model, unknowns_of(found, data))
    largest = np.zeros(len(data.joints))
    np.maximum.at(largest, data.rows_of_misses, np.linalg.norm(misses, axis=1))
    return largest


def _median(values: Array, counts: Array) -> float:
    """Return the median of values ``(N,)``, weighted by ``counts`` ``(N,)``; NaN values are ignored."""
    order = np.argsort(values, kind="stable")[: np.count_nonzero(values == values)]
    below = np.cumsum(counts[order])
    first, last = np.searchsorted(below, below[-1] * np.array([0.5 - 1e-12, 0.5 + 1e-12]))
    return float(values[order[[first, min(last, len(order) - 1)]]].mean())


# Where the identification starts, and which files are of one set-up.

FILE_ROWS, SET_UP_ROWS = 150, 450
"""Largest numbers of rows of a file, and of a set-up, that are used to determine set-ups."""

COUNTED_ROWS = 30
"""Largest number of a file's rows that count as independent, because neighbouring rows share the model's errors."""

LEAST_ROWS = 8
"""Least number of rows with which a file's set-up can be determined."""

TRIES, PLAUSIBLE = 12, 10.0
"""Largest number of iterations of the fit that judges a grouping, and largest plausible ratio of misses within one
set-up. The fit of a right grouping needs half as many iterations."""

ROBUST_ROWS = 2000
"""Largest number of rows of the robust fit, equally spaced; all rows are judged by this fit."""

SPARE = 3
"""Least ratio of equations to parameters to fit geometry beside frames, or compliance beside geometry."""


def rough_start(nominal: Geometry, data: Observations) -> Geometry:
    """Return the geometry with rough base and tool, from which a fit can start.

    Poses, positions and views of a board give base and tool. The positions of the reflector that is seen most often
    give the base, and with at least three known reflectors also the tool. Other kinds give the nominal geometry.

    Args:
        nominal: The nominal geometry.
        data: The rows. If there are several stations, the rows of the first station count.

    Raises:
        InputError: If the reflector's positions do not fit the arm.
    """
    data = data.parts[0]
    rough = data.rough_poses(nominal.prismatic)
    if rough is None:
        return nominal
    aligned = align(nominal, rough, frames_model(nominal), judge=False).geometry
    if not isinstance(data, ReflectorObservations):
        return aligned
    refuse_another_arm(aligned, rough, f"after fitting base and reflector {data.clearest + 1}", nominal)
    if data.places is None or len(data.places) < 3:
        return aligned
    # Known places turn and shift the tool to where they are seen.
    (turn, shift), tool = laid_onto(data.places, data.seen_from(ArmModel.of(aligned))), aligned.tool
    return replace(aligned, tool=Pose(tool.position + tool.rotation @ shift, tool.rotation @ turn))


def robust_frames(arm: Arm, data: Observations) -> Geometry:
    """Return the arm with base and tool fitted to rows that agree with each other; the result is deterministic.

    Raises:
        InputError: If there are too few rows, or they do not fit the arm.
    """
    frames = frames_model(arm.nominal)
    if data.poses is not None:
        return robust_align(arm.nominal, data.poses, frames, np.random.default_rng(0)).geometry
    return robust_identify(frames, rough_start(arm.nominal, data), data)[0].geometry


def robust_fit(arm: Arm, data: Observations, known: bool = False) -> tuple[Identification, Sizes]:
    """Identify the geometry from the rows that agree with each other; the result is deterministic.

    If the arm's masses are known and the rows are enough, the fitted joints yield under the links' weight. With stiff
    joints, the rows with the largest torques would seem to be outliers.

    Args:
        arm: The arm.
        data: The rows.
        known: Whether base and tool are known; otherwise they are fitted, too.

    Raises:
        InputError: If there are too few rows, or no majority agrees.
    """
    data = data.at_most(ROBUST_ROWS)
    start = ArmModel.of(arm.nominal if known else robust_frames(arm, data))
    model = fitted_model(arm.name, arm.nominal, known)
    if arm.load is not None:
        yielding = ArmModel.of(start.geometry, (weight_of(arm.nominal).with_masses(arm.nominal, arm.load),))
        wider = with_terms(model, yielding)
        if len(data.equations()[0]) >= SPARE * (len(wider.names) + len(data.unknowns())):
            model, start = wider, yielding
    return robust_identify(model, start, data)


def stations_of(arm: Arm, data: Sequence[Observations], own: Collection[str]) -> Stacked:
    """Return data sets as stations of one arm; data sets whose instrument has a frame come first.

    Args:
        arm: The arm.
        data: The data sets.
        own: Names of the frames ("base", "tool") that each station after the first does not share with the arm. A data
            set whose instrument has no frame always shares the base.

    Raises:
        InputError: If a set does not fit the arm.
    """
    parts = sorted(data, key=lambda part: not part.framed)
    return _stations(arm, parts, [dict.fromkeys(own, number) for number in range(2, len(parts) + 1)])


def scene_of(arm: Arm, data: Sequence[Observations]) -> Stacked:
    """Return data sets as stations of one arm, which share frames if their sensors or targets have the same name.

    Stations that name the same sensor share the base. Stations that name the same target share the tool.

    Args:
        arm: The arm.
        data: The data sets, whose origins name sensor and target. A frame whose sensor or target has no name is not
            shared.

    Raises:
        InputError: If a set does not fit the arm.
    """
    parts = sorted(data, key=lambda part: not part.framed)
    scenes = [origins_of(part).scene for part in parts]
    names_of = dict(zip(OWN, zip(*scenes, strict=True), strict=True))  # sensors by "base", targets by "tool"
    owners = [
        {frame: 1 + (names.index(names[i]) if names[i] else i) for frame, names in names_of.items()}
        for i in range(1, len(parts))
    ]
    return _stations(arm, parts, owners)


def _stations(arm: Arm, parts: Sequence[Observations], owners: Sequence[Mapping[str, int]]) -> Stacked:
    """Return data sets as stations, with starting values of the frames that they do not share with the arm.

    Args:
        arm: The arm.
        parts: The data sets; the first has the arm's own frames.
        owners: For each set after the first, the number, from 1, of the station that each frame belongs to, by the
            frame's name. Frames that are left out are shared with the arm.
    """
    starts = [robust_frames(arm, part) if part.framed else arm.nominal for part in parts[1:]]
    stations = [InstrumentStation(parts[0])]
    for number, (part, firsts) in enumerate(zip(parts[1:], owners, strict=True), start=2):
        own = {frame: i for frame, i in firsts.items() if i > 1 and (frame == "tool" or part.framed)}
        frames = {frame: getattr(starts[i - 2], frame) for frame, i in own.items()}
        stations.append(InstrumentStation(part, number, **frames, owners=own))
    return Stacked(tuple(stations))


SetUp = tuple[tuple[int, ...], tuple[str, ...]]
"""Numbers, from 0, of the data sets of one set-up, and names of the frames that differ from the first set-up's."""


def by_set_up(arm: Arm, parts: Sequence[Measurements]) -> Measurements | Stacked:
    """Join the poses or positions of several files.

    Files that share one set-up become one data set. If there are several set-ups, each becomes a station.

    Args:
        arm: The arm.
        parts: The rows of each file.

    Raises:
        InputError: If the rows of a set-up do not fit the arm.
    """
    groups = set_ups(arm, parts)
    rows = [rows_together([parts[i] for i in numbers]) for numbers, _ in groups]
    owners = [dict.fromkeys(own, number) for number, (_, own) in enumerate(groups[1:], start=2)]
    return rows[0] if len(rows) == 1 else _stations(arm, rows, owners)


def set_ups(arm: Arm, parts: Sequence[Measurements]) -> tuple[SetUp, ...]:
    """Group files that share base and tool, one file after the other, by the Bayesian information criterion.

    Errors of the rows of one file are similar, so at most `COUNTED_ROWS` of each file count. A file therefore gets new
    frames only if these remove a large part of the remaining error. A file with too few rows, or whose rows do not fit
    the arm, is put into the first set-up. If the file cannot be joined with that set-up as one data set, it shares the
    set-up's frames.

    Args:
        arm: The arm.
        parts: The rows of each file.
    """
    near = {i: rows for i, part in enumerate(parts) if (rows := _near_rows(arm, part)) is not None}
    first, *others = near or [0]
    groups: tuple[SetUp, ...] = (((first,), ()),)
    for i in others:
        candidates = [candidate for candidate in _with_file(groups, parts, i) if _plausible(near, candidate, i)]
        groups = min(candidates, key=lambda candidate: _criterion(arm, near, candidate))
    for i in set(range(len(parts))) - {first, *others}:
        groups = next(_with_file(groups, parts, i))
    return tuple((tuple(sorted(numbers)), own) for numbers, own in groups)


def _near_rows(arm: Arm, part: Measurements) -> tuple[Measurements, Geometry] | None:
    """Return some rows that agree with each other, and the arm with frames fitted to them.

    The result is None if there are too few rows, or if they do not fit the arm.
    """
    part = part.at_most(FILE_ROWS)
    if len(part) < LEAST_ROWS:
        return None
    try:
        aligned = robust_frames(arm, part)
    except InputError:
        return None
    return part.select(sizes_of(ArmModel.of(aligned), np.zeros(0), part)[0] <= OUTLIER_SIGMA), aligned


def _with_file(groups: tuple[SetUp, ...], parts: Sequence[Measurements], i: int) -> Iterator[tuple[SetUp, ...]]:
    """Yield all ways to add file ``i`` of ``parts`` to the set-ups: to each that it can join, or as a new set-up."""
    for number, (members, own) in enumerate(groups):
        if parts[members[0]].joinable(parts[i]):
            yield (*groups[:number], ((*members, i), own), *groups[number + 1 :])
        elif number == 0:
            yield (*groups, ((i,), ()))
    for frames in (("base",), ("tool",), OWN):
        yield (*groups, ((i,), frames))


def _plausible(near: Mapping[int, tuple[Measurements, Geometry]], groups: Sequence[SetUp], i: int) -> bool:
    """Return whether a file can belong to the set-up that it joins; a file that starts a set-up always can.

    One of two files, this file or the set-up's first file, must fit the frames of the other. A file fits if its misses
    are at most `PLAUSIBLE` times its misses under its own frames. One is enough, since a file may hardly determine its
    frames. The links are nominal.

    Args:
        near: Rows and arm of each file, from `_near_rows`, by the file's index from 0.
        groups: The set-ups with the file.
        i: Index of the file.
    """

    def ratio(rows: int, arm: int) -> float:
        return _missed(near[rows][0], near[arm][1]) / _missed(*near[rows])

    firsts = [members[0] for members, _ in groups if i in members and members[0] != i]
    return all(min(ratio(i, first), ratio(first, i)) <= PLAUSIBLE for first in firsts)


def _missed(rows: Measurements, by: Geometry) -> float:
    """Return the median position error, m, of the rows under the arm ``by``, plus a micrometre."""
    return 1e-6 + float(np.median(np.linalg.norm(rows.difference(by)[:, :3], axis=1)))


def _criterion(arm: Arm, near: Mapping[int, tuple[Measurements, Geometry]], groups: Sequence[SetUp]) -> float:
    """Compute Schwarz's (Bayesian) information criterion of set-ups, which is smaller for better ones.

    Each file has a separate scatter. The result is infinite if the fit fails.

    Args:
        arm: The arm.
        near: Rows and arm of each file, from `_near_rows`, by the file's index from 0.
        groups: The set-ups.
    """
    stations = []
    for number, (members, own) in enumerate(groups, start=1):
        rows = rows_together([near[i][0] for i in members])
        frames = {name: getattr(near[members[0]][1], name) for name in own}
        stations.append(InstrumentStation(rows.at_most(SET_UP_ROWS), number, **frames))
    data = Stacked(tuple(stations))
    row_of_each, _ = data.equations()
    model = fitted_model(arm.name, arm.nominal, False)
    if len(row_of_each) < SPARE * (len(model.names) + len(data.unknowns())):
        model = frames_model(arm.nominal)
    try:
        fit = identify(model, ArmModel.of(near[groups[0][0][0]][1]), [data], max_iterations=TRIES)
    except InputError:
        return np.inf
    squares = data.residual(fit.arm_model, unknowns_of(fit, data)) ** 2
    files, spare = data.origins.file, len(row_of_each) / max(fit.degrees_of_freedom, 1)
    counts = {file: 3 * min(int(np.sum(files == file)), COUNTED_ROWS) for file in np.unique(files).tolist()}
    means = {file: np.mean(squares[files[row_of_each] == file]) * spare for file in counts}
    total = sum(count * float(np.log(means[file])) for file, count in counts.items())
    return total + float(np.log(sum(counts.values()))) * 6 * sum(len(own) for _, own in groups)


def placed(arm: Arm, stations: Stacked, parts: Sequence[Measurements]) -> Stacked:
    """Assign the rows of further files to stations, each file to the station whose frames it fits best.

    Args:
        arm: The arm.
        stations: Stations whose rows determine their frames.
        parts: The rows of each further file.
    """
    references = [replace(station, data=station.data.at_most(FILE_ROWS)) for station in stations.stations]
    data = Stacked(tuple(references))
    model = fitted_model(arm.name, arm.nominal, False)
    fit = identify(model, ArmModel.of(robust_frames(arm, references[0].data)), [data], max_iterations=60)
    seats: dict[int, list[Measurements]] = {}
    for part in parts:
        rows = [Stacked((replace(station, data=part),)) for station in references]
        missed = [np.linalg.norm(row.misses(fit.arm_model, unknowns_of(fit, row)), axis=1) for row in rows]
        seats.setdefault(int(np.argmin(np.median(missed, axis=1))), []).append(part)
    return Stacked(tuple(replace(references[i], data=rows_together(seats[i])) for i in sorted(seats)))
