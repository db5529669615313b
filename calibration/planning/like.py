"""Further poses for an instrument that has already measured a few: wires, touches, reflectors, tilts, pictures.

The first rows determine the instrument's own unknowns, such as the anchor of a wire, a touched point, or a camera's
place and lens. The unknowns determine the instrument's readings at other joints, and whether it can read anything
there. The exchange of poses starts from the information that the first rows give. SI units.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Array, Geometry
from pickenv.base import InputError, check_limit, single_threaded
from pickenv.calibration.identification.diagnosis import without_blind_views
from pickenv.calibration.identification.least_squares import identifiable_parameters, unknowns_of
from pickenv.calibration.identification.robust import align, robust_identify, rough_start
from pickenv.calibration.identification.solve import UNKNOWN_STD
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel, complete_model, frames_model
from pickenv.calibration.model.kinds import DistanceObservations, SocketObservations
from pickenv.calibration.model.noise_and_priors import FRAMES, PriorModel
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.planning import plan

ROUNDS = 60
"""Largest number of rounds of the search for candidates."""

STEPS, NEAR = 20, 1e-6
"""Number of Newton steps that bring a tool point to a place where it can be read, and largest remaining distance, m."""

STEP = 0.5
"""Largest change of a joint in one Newton step, rad or m."""

LEAST_SEEN = 0.5
"""Least share of a board's corners that must be in the picture at a candidate."""

WARY = 3.0
"""Margin of the picture, in RMS pixel errors of the first views, in which no predicted corner counts as seen."""

FOCUS = 1.5
"""Largest factor by which a board may be farther off, or nearer, than in any of the first views."""


First = tuple[Observations, ArmModel, Array]
"""The instrument as determined by its first rows: these rows, the nominal arm with base and tool fitted to them, and
the instrument's own unknowns."""


def first_rows(arm: Arm, data: Observations) -> First:
    """Determine base, tool and the instrument's own unknowns from a few rows, some of which may have gross errors.

    Returns:
        The rows, the nominal arm with fitted base and tool, and values of the instrument's own unknowns.

    Raises:
        InputError: If the rows are of several kinds, too few, or do not fit the arm.
    """
    data, _ = without_blind_views(data)
    if data.stations:
        raise InputError(f"{data.source} holds {data.kind}; plan for one instrument, from a file of its rows alone")
    frames = frames_model(arm.nominal)
    if data.poses is not None:
        return data, ArmModel.of(align(arm.nominal, data.poses, frames).geometry), np.zeros(0)
    solution, _ = robust_identify(frames, rough_start(arm.nominal, data), data)
    return data, solution.arm_model, unknowns_of(solution, data)


def measurable_joints(geometry: Geometry, first: First, count: int, rng: np.random.Generator) -> Array:
    """Draw joints within their limits at which the instrument can read something.

    Half of the trials are drawn from the joint ranges. The other half are drawn near joints at which the instrument is
    known to read something, because a board is seen from few poses. At first these are the joints of the measured rows.
    Every round adds the joints that it finds.

    Args:
        geometry: The nominal arm.
        first: The rows measured so far, and what they determine of arm and instrument, from `first_rows`.
        count: Number of joint vectors wanted.
        rng: Draws the joint vectors.

    Returns:
        Joints ``(count or fewer, n)``, rad or m.
    """
    room = geometry.upper - geometry.lower
    lower, upper = geometry.lower + plan.MARGIN * room, geometry.upper - plan.MARGIN * room
    readable, seeds = np.zeros((0, geometry.joints)), np.clip(first[0].joints, lower, upper)
    for _ in range(ROUNDS):
        near = seeds[rng.integers(0, len(seeds), count)]
        sizes = 10.0 ** rng.uniform(-2.0, -0.5, (count, 1)) * room
        drawn = plan.candidate_joints(geometry, count, rng)
        trials = np.concatenate([drawn, near + sizes * rng.normal(size=near.shape)])
        trials, good = measurable(first, np.clip(trials, lower, upper), geometry)
        good &= ((trials >= lower) & (trials <= upper)).all(axis=1)
        readable, seeds = (np.concatenate([poses, trials[good]]) for poses in (readable, seeds))
        if len(readable) >= count:
            break
    return readable[rng.permutation(len(readable))[:count]]


def measurable(
    first: First, joints: Array, geometry: Geometry, *, move: bool = True
) -> tuple[Array, NDArray[np.bool_]]:
    """Move joints to values at which the instrument can read something, and mark the joints for which this succeeds.

    Args:
        first: The instrument, from `first_rows`.
        joints: Joints to start from ``(N, n)``, rad or m.
        geometry: The nominal arm.
        move: Whether the joints may be moved; otherwise they are judged unmoved, with a tolerance of 1 mm.

    Returns:
        The joints ``(N, n)``, rad or m, and a mask ``(N,)`` of joints at which the instrument can read something.
    """
    data, _, _ = first
    if data.views is not None:
        return joints, _shown(first, joints)
    if not isinstance(data, SocketObservations | DistanceObservations):
        return joints, np.ones(len(joints), dtype=bool)
    if not move:
        return joints, np.linalg.norm(_short_of(first, joints), axis=1) <= 1e-3
    for _ in range(STEPS):
        gap = _short_of(first, joints)
        if np.abs(gap).max() <= NEAR:
            break
        steps = 1e-6 * np.eye(geometry.joints)
        misses = _misses(first, joints)
        slope = -np.stack([(_misses(first, joints + step) - misses) / 1e-6 for step in steps], axis=-1)
        square = slope @ np.swapaxes(slope, 1, 2)
        square += 1e-6 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(gap.shape[1]) + 1e-12
        change = np.einsum("nij,ni->nj", slope, np.linalg.solve(square, gap[..., None])[..., 0])
        joints = joints + np.clip(change, -STEP, STEP)
    return joints, np.abs(_short_of(first, joints)).max(axis=1) <= NEAR


def _misses(first: First, joints: Array) -> Array:
    """Return placeholder readings minus predicted readings ``(N, k)``, m, of the instrument at joints ``(N, n)``."""
    return readings_at(first, joints).misses(*first[1:])


def _short_of(first: First, joints: Array) -> Array:
    """Return the amounts ``(N, k)``, m, by which the instrument misses a possible reading at joints ``(N, n)``.

    For sockets it is the vector from the tool point to its socket. For a length, such as a wire's, it is the amount by
    which the predicted reading lies outside the range of the first readings.
    """
    data, misses = first[0], _misses(first, joints)
    if not isinstance(data, DistanceObservations):
        return misses
    read = data.length
    predicted = np.resize(read, len(joints))[:, None] - misses
    return np.asarray(np.clip(predicted, read.min(), read.max()) - predicted)


def _shown(first: First, joints: Array) -> NDArray[np.bool_]:
    """Return a mask ``(N,)`` of joints ``(N, n)`` at which a view would show enough of the board.

    The board must also be about as far from the camera as in the first views (`FOCUS`).
    """
    data, model, _ = first
    views = readings_at(first, joints).views
    depth, first_depth = (part.in_camera(model)[..., 2].mean(axis=1) for part in (views, data.views))
    good = (depth > first_depth.min() / FOCUS) & (depth < first_depth.max() * FOCUS)
    return np.asarray(good & (views.seen.mean(axis=1) >= LEAST_SEEN))


def readings_at(first: First, joints: Array) -> Observations:
    """Return rows of the instrument at other joints ``(N, n)``, rad or m, with placeholders as readings.

    For a board, the corners that would be in the picture count as seen.
    """
    data, *found = first
    rows = data.imagined(joints)  # not stations, which `first_rows` refuses
    if rows.views is None:
        return rows
    margin = WARY * float(np.sqrt(np.mean(data.views.pixel_errors(*found) ** 2)))
    visible: Observations = replace(rows.views, seen=rows.views.visible(*found, margin))
    return visible


LEAST_CANDIDATES = 3
"""Least number of candidates for each planned pose; with fewer there is hardly a choice."""

CHUNK = 500
"""Number of candidates whose equations are computed at once."""


@single_threaded()
def plan_like(
    arm: Arm,
    data: Observations,
    count: int,
    rng: np.random.Generator,
    *,
    candidates: Array | int = 2000,
    lines: NDArray[np.int64] | None = None,
    criterion: str | None = None,
    test_joints: Array | None = None,
    curve: bool = False,
    prior: PriorModel | None = None,
) -> plan.PosePlan:
    """Choose ``count`` further poses for an instrument that has measured a few, and order them for short travel.

    The poses are chosen to determine base, tool, the arm's own parameters and the instrument's own unknowns.

    Args:
        arm: The arm, with joint limits and speeds.
        data: The first rows, of one kind.
        count: Number of poses to measure.
        rng: Draws candidates, the order of exchanges, and the random sets of poses that the plan is compared with.
        candidates: Joints to choose from ``(N, n)``, rad or m; joints at which nothing can be read are left out. Or
            the number of candidates to draw.
        lines: Line, from 1, of each given candidate in its file ``(N,)``; None if the candidates come from no file.
        criterion: "d-optimal", or "test-poses" to minimise the predicted position error at ``test_joints``. If left
            out, "test-poses" if ``test_joints`` are given, else "d-optimal".
        test_joints: Joints at which accuracy matters ``(M, n)``, rad or m; the candidates if left out.
        curve: Whether to predict the error also for half, twice, four and eight times as many poses.
        prior: The arm's parameters with their priors; poses are then chosen by the information that they add to the
            priors and to the first rows.

    Raises:
        InputError: If the first rows are of several kinds, too few, or do not fit the arm. Also if there are too few
            candidates or poses, or the criterion is unknown.
    """
    criterion = plan.criterion_of(criterion, test_joints)
    begin = time.perf_counter()
    first = first_rows(arm, data)
    rows, model, _ = first
    if isinstance(candidates, int):
        check_limit("candidates", candidates, "candidates")
        joints = measurable_joints(arm.nominal, first, candidates, rng)
    else:
        joints, good = measurable(first, np.asarray(candidates, dtype=float), arm.nominal, move=False)
        joints, lines = joints[good], None if lines is None else lines[good]
    if len(joints) < LEAST_CANDIDATES * count:
        raise InputError(
            f"{data.source}: {data.kind} can be measured at {len(joints)} candidates only, too few to choose {count} "
            f"from; give a first measurement of more varied poses, or plan {len(joints) // LEAST_CANDIDATES} poses"
        )
    design = _design(arm.nominal, first, joints, prior)
    least = 1
    if prior is None:  # fewer equations than parameters, and one more, are left
        parameters = len(design.names) + len(design.model.names)
        missing = parameters + 1 - int((rows.equations()[0] >= 0).sum())
        least = max(1, -(-missing // min(design.rows.shape[1], 6)))
        plan.refuse_too_few(count, parameters, least, f"besides the {len(rows.joints)} of {rows.source} ")
    pose_plan = plan.finished_plan(
        arm,
        design,
        count,
        rng,
        random_rows=lambda size: (design.rows[rng.choice(len(joints), size, False)] for _ in range(plan.DRAWS)),
        criterion=criterion,
        goal=plan.error_weight(model.geometry, design, joints if test_joints is None else test_joints),
        where="at the candidates" if test_joints is None else "at the test poses",
        sizes=plan.plan_sizes(count, least, len(joints)) if curve else (),
    )
    return replace(
        pose_plan,
        first=len(rows.joints),
        lines=None if lines is None else lines[pose_plan.chosen],
        seconds=time.perf_counter() - begin,
    )


def _design(geometry: Geometry, first: First, joints: Array, prior: PriorModel | None) -> plan.Design:
    """Return the design of the candidates, with the information of the first rows and of the priors as known.

    The design covers all parameters if they have priors, else a largest subset of identifiable ones.

    Args:
        geometry: The nominal arm.
        first: The instrument, from `first_rows`.
        joints: The candidates ``(N, n)``, rad or m.
        prior: The arm's parameters with their priors, or None.
    """
    data, there, unknowns = first
    count = len(unknowns)
    if prior is not None and not data.framed:
        prior = prior.without_base()
    model = complete_model(geometry) if prior is None else prior.parameters
    scale = np.concatenate([data.tolerances(), model.tolerance])
    parts = [readings_at(first, joints[i : i + CHUNK]) for i in range(0, len(joints), CHUNK)]
    measured = _scaled(first, data, model, scale)
    if prior is None:
        names = (*data.unknowns(), *model.names)
        matrix, sets = np.concatenate([measured, _scaled(first, parts[0], model, scale)]), [data, parts[0]]
        columns = identifiable_parameters(model, sets, there, [unknowns] * 2, matrix, names, scale).kept
        information = np.zeros((len(columns), len(columns)))
    else:
        columns = np.arange(len(scale))
        information = np.diag((scale / np.r_[np.full(count, UNKNOWN_STD), prior.width]) ** 2)
    return plan.Design(
        joints,
        np.concatenate([_by_pose(first, part, model, scale)[..., columns] for part in parts]),
        model.some(np.isin(np.arange(count, len(scale)), columns)),
        np.zeros(0),
        data.kind,
        information + measured[:, columns].T @ measured[:, columns],
        names=tuple(data.unknowns()[column] for column in columns[columns < count]),
        framed=prior is not None and bool((prior.group == FRAMES).any()),
    )


def _scaled(first: First, data: Observations, model: ErrorModel, scale: Array) -> Array:
    """Return the whitened, scaled Jacobian ``(E, own + P)``: the instrument's own unknowns, then P arm parameters.

    Args:
        first: The instrument, from `first_rows`; the Jacobian is taken at its arm and unknowns.
        data: Rows of the instrument.
        model: The arm's P parameters.
        scale: Typical deviation of each unknown and parameter ``(own + P,)``, by which its column is multiplied.
    """
    by_arm, by_own = data.jacobian(*first[1:])
    return np.asarray(np.hstack([by_own, by_arm[:, model.columns]]) * scale)


def _by_pose(first: First, data: Observations, model: ErrorModel, scale: Array) -> Array:
    """Return the whitened, scaled Jacobian of each pose ``(N, r, own + P)``, without equations that belong to no row.

    r is at most 6 + own, since a pose has six components and the instrument has ``own`` unknowns. If there are more
    equations, as for a board's corners, they are replaced by 6 + own equations with the same information.
    """
    matrix, (row, _) = _scaled(first, data, model, scale), data.equations()
    matrix, row = matrix[row >= 0], row[row >= 0]
    counts = np.bincount(row, minlength=len(data.joints))
    place = np.arange(len(row)) - (np.cumsum(counts) - counts)[row]
    blocks = np.zeros((len(data.joints), int(counts.max()), matrix.shape[1]))
    blocks[row, place] = matrix
    most = 6 + len(first[2])
    if blocks.shape[1] <= most:
        return blocks
    values, vectors = np.linalg.eigh(np.swapaxes(blocks, 1, 2) @ blocks)
    few = np.sqrt(np.maximum(values[:, None, -most:], 0.0)) * vectors[..., -most:]
    return np.asarray(np.swapaxes(few, 1, 2))
