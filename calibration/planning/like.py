"""More poses like those of a first small measurement, of any kind: wires, touches, reflectors, tilts, pictures.

Where the wire is anchored, the touched point lies, the camera sits and what its lens is, the first rows tell. From then
on it is known what such an instrument would read at other joints, and whether it could read anything there at all. The
exchange starts from what the first rows tell already. SI units.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Geometry, parameter_jacobian
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.diagnosis import without_blind_views
from pickenv.calibration.identification.least_squares import identifiable_parameters, unknowns_of
from pickenv.calibration.identification.robust import align, robust_identify, rough_start
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel, complete_model, frames_model
from pickenv.calibration.model.kinds import DistanceObservations, SocketObservations
from pickenv.calibration.model.measurements import Measurements, Stacked, write_joints
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.planning.plan import (
    CRITERIA,
    DRAWS,
    MARGIN,
    CurvePoint,
    candidate_joints,
    exchange,
    short_tour,
    travel_seconds,
)
from pickenv.errors import InputError
from pickenv.limits import check_limit
from pickenv.threads import single_threaded

# Where an instrument can measure at all, as its first rows tell: of wires, touches, contacts, boards in pictures. A
# candidate keeps the touched point touched, the wire and the dial within the readings they gave, and the board in the
# picture, about as far off as it was. All else can be measured anywhere. SI units.

ROUNDS = 60
"""Rounds in which candidates are looked for at most."""

STEPS, NEAR = 20, 1e-6
"""Newton steps that bring a tool point to where it must be, and how near they must end, m."""

STEP = 0.5
"""Largest step of a joint in them, rad or m."""

LEAST_SEEN = 0.5
"""Share of a board's corners that a candidate must see."""

WARY = 3.0
"""Corners must be predicted so many times farther inside the picture than those of the first views were off."""

FOCUS = 1.5
"""A board may stand so many times farther off than in the first views, or nearer."""


@dataclass(frozen=True, eq=False)
class FirstRows:
    """What a first measurement tells about the instrument.

    Attributes:
        data: Its rows.
        model: The nominal arm with base and tool as these rows have them.
        unknowns: The instrument's own unknowns, likewise.
    """

    data: Observations
    model: ArmModel
    unknowns: Array


def first_rows(arm: Arm, data: Observations) -> FirstRows:
    """Base, tool and the instrument's own unknowns from a few rows, of which some may be gross.

    Raises:
        InputError: If the rows are of several kinds, too few, or do not fit the arm.
    """
    data, _ = without_blind_views(data)
    if isinstance(data, Stacked):
        raise InputError(f"{data.source} holds {data.kind}; plan for one instrument, from a file of its rows alone")
    frames = frames_model(arm.nominal)
    if isinstance(data, Measurements):
        return FirstRows(data, ArmModel.of(align(arm.nominal, data, frames).geometry), np.zeros(0))
    found = robust_identify(frames, rough_start(arm.nominal, data), data).identification
    return FirstRows(data, found.arm_model, unknowns_of(found, data))


def measurable_joints(geometry: Geometry, first: FirstRows, count: int, rng: np.random.Generator) -> Array:
    """Joints ``(count or fewer, n)`` at which the instrument reads something, within their limits.

    Half of what is tried is drawn from the joint ranges, half near what was found, from the first rows on: few poses
    of all show a board.
    """
    room = geometry.upper - geometry.lower
    lower, upper = geometry.lower + MARGIN * room, geometry.upper - MARGIN * room
    found, seeds = np.zeros((0, geometry.joints)), np.clip(first.data.joints, lower, upper)
    for _ in range(ROUNDS):
        near = seeds[rng.integers(0, len(seeds), count)]
        sizes = 10.0 ** rng.uniform(-2.0, -0.5, (count, 1)) * room
        tried = np.concatenate([candidate_joints(geometry, count, rng), near + sizes * rng.normal(size=near.shape)])
        moved, good = measurable(first, np.clip(tried, lower, upper), geometry)
        good &= ((moved >= lower) & (moved <= upper)).all(axis=1)
        found = np.concatenate([found, moved[good]])
        seeds = np.concatenate([seeds, moved[good]])
        if len(found) >= count:
            break
    return found[rng.permutation(len(found))[:count]]


def measurable(
    first: FirstRows, joints: Array, geometry: Geometry, *, move: bool = True
) -> tuple[Array, NDArray[np.bool_]]:
    """Joints ``(N, n)`` moved to where the instrument reads something, and which of them ended there ``(N,)``.

    Args:
        first: The instrument.
        joints: Where to look.
        geometry: The nominal arm.
        move: Whether they may be moved; else they are judged where they are, to a millimetre.
    """
    data = first.data
    if isinstance(data, PixelObservations):
        return joints, _shown(first, joints)
    if not isinstance(data, SocketObservations | DistanceObservations):
        return joints, np.ones(len(joints), dtype=bool)
    if not move:
        return joints, np.linalg.norm(_short_of(first, joints), axis=1) <= 1e-3
    for _ in range(STEPS):
        left = _short_of(first, joints)
        if np.abs(left).max() <= NEAR:
            break
        steps = 1e-6 * np.eye(geometry.joints)
        misses = _misses(first, joints)
        slope = -np.stack([(_misses(first, joints + step) - misses) / 1e-6 for step in steps], axis=-1)
        square = slope @ np.swapaxes(slope, 1, 2)
        square += 1e-6 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(left.shape[1]) + 1e-12
        change = np.einsum("nij,ni->nj", slope, np.linalg.solve(square, left[..., None])[..., 0])
        joints = joints + np.clip(change, -STEP, STEP)
    return joints, np.abs(_short_of(first, joints)).max(axis=1) <= NEAR


def _misses(first: FirstRows, joints: Array) -> Array:
    return asked_at(first, joints).misses(first.model, first.unknowns)


def _short_of(first: FirstRows, joints: Array) -> Array:
    """How far the tool point is from where it could be read ``(N, k)``, m: a place, or a range of readings."""
    misses = _misses(first, joints)
    if not isinstance(first.data, DistanceObservations):
        return misses
    read = first.data.length
    predicted = np.resize(read, len(joints))[:, None] - misses
    return np.asarray(np.clip(predicted, read.min(), read.max()) - predicted)


def _shown(first: FirstRows, joints: Array) -> NDArray[np.bool_]:
    """Which views ``(N,)`` would show enough of the board, about as far off as in the first ones."""
    asked, taken = asked_at(first, joints), first.data
    assert isinstance(asked, PixelObservations) and isinstance(taken, PixelObservations)
    depths = taken.in_camera(first.model)[..., 2].mean(axis=1)
    depth = asked.in_camera(first.model)[..., 2].mean(axis=1)
    good = (depth > depths.min() / FOCUS) & (depth < depths.max() * FOCUS)
    return np.asarray(good & (asked.seen.mean(axis=1) >= LEAST_SEEN))


def asked_at(first: FirstRows, joints: Array) -> Observations:
    """What the instrument would be asked at other joints; of a board the corners that are seen there."""
    data: Any = first.data  # all kinds but stations can be imagined, which `first_rows` refuses
    asked: Observations = data.imagined(joints)
    if isinstance(asked, PixelObservations):
        off = data.pixel_errors(first.model, first.unknowns)
        margin = WARY * float(np.sqrt(np.mean(off**2)))
        return replace(asked, seen=asked.visible(first.model, first.unknowns, margin))
    return asked


LEAST_CANDIDATES = 3
"""Candidates for each pose planned, below which there is nothing to choose."""

CHUNK = 500
"""Candidates whose equations are held at once."""


@dataclass(frozen=True, eq=False)
class PlanLike:
    """Poses to measure besides those of a first measurement, in order.

    Attributes:
        joints: ``(n_poses, n)``, rad or m, in measuring order.
        chosen: Their rows among the candidates.
        candidates: Poses at which such an instrument can measure ``(N, n)``.
        kind: Of the measurements.
        first: Rows that there are already.
        parameters: What is planned for: the instrument's own unknowns, then the arm's.
        criterion: "d-optimal" or "test-poses".
        predicted_error: RMS position error from the parameters' uncertainty, of first rows and planned poses, m.
        random_predicted_error: The same with random candidates in place of the planned ones, median of 20 sets, m.
        where: Where that error is taken, in words.
        travel_seconds: Time of the moves in measuring order, s.
        random_travel_seconds: The same in random order, mean of 20, s.
        seconds: Time of the planning.
        lines: Lines of the poses in the file that they were chosen from; None where they were looked for.
        curve: What other numbers of poses would bring.
    """

    joints: Array
    chosen: NDArray[np.int64]
    candidates: Array
    kind: str
    first: int
    parameters: tuple[str, ...]
    criterion: str
    predicted_error: float
    random_predicted_error: float
    where: str
    travel_seconds: float
    random_travel_seconds: float
    seconds: float
    lines: NDArray[np.int64] | None = None
    curve: tuple[CurvePoint, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        names = ("kind", "criterion", "where", "travel_seconds", "random_travel_seconds", "seconds")
        found = {name: getattr(self, name) for name in names}
        return found | {
            "poses": len(self.joints),
            "first_rows": self.first,
            "candidates": len(self.candidates),
            "parameters": list(self.parameters),
            "predicted_error_mm": self.predicted_error * 1e3,
            "random_predicted_error_mm": self.random_predicted_error * 1e3,
            **({} if self.lines is None else {"lines": self.lines.tolist()}),
            **({"curve": [point.as_dict() for point in self.curve]} if self.curve else {}),
        }

    def report(self) -> str:
        """A short report for people."""
        lines = [
            f"{len(self.joints)} of {len(self.candidates)} poses at which {self.kind} can be measured, besides the "
            f"{self.first} measured already; {self.criterion}, {len(self.parameters)} parameters, in "
            f"{self.seconds:.2f} s",
            f"  error to expect {self.where} {self.predicted_error * 1e3:.4f} mm RMS from the parameters' uncertainty "
            f"(poses drawn from the same: {self.random_predicted_error * 1e3:.4f} mm)",
            f"  moves take {self.travel_seconds:.0f} s in this order, {self.random_travel_seconds:.0f} s in another",
        ]
        if self.lines is not None:
            lines.append(f"  lines of the file, in measuring order: {', '.join(map(str, self.lines))}")
        if self.curve:
            lines += ["  how many poses? The same error, and drawn at random:", *(p.text() for p in self.curve)]
        return "\n".join(lines)

    def write_csv(self, path: str | Path, prismatic: tuple[bool, ...]) -> Path:
        """Write the joints in measuring order as our own CSV columns."""
        return write_joints(path, self.joints, prismatic)


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
) -> PlanLike:
    """Choose ``count`` further poses for an instrument that has measured a few, and order them for short travel.

    Base, tool and the arm's own parameters are planned for, with the instrument's unknowns.

    Args:
        arm: The arm, with joint limits and speeds.
        data: The first rows, of one kind.
        count: Poses to measure.
        rng: Draws candidates, the order of exchanges and the random sets to compare with.
        candidates: Poses to choose from ``(N, n)``, of which those are left out where nothing could be read; or how
            many to look for.
        lines: Where given candidates stand in their file ``(N,)``.
        criterion: "d-optimal", or "test-poses" to minimise the predicted position error at ``test_joints``; when left
            out the latter where these are given.
        test_joints: Where accuracy matters ``(M, n)``, rad or m; the candidates when left out.
        curve: Whether to say what half, twice, four and eight times as many poses would bring.

    Raises:
        InputError: If the first rows are of several kinds, too few or do not fit the arm, there are too few candidates
            or poses, or the criterion is unknown.
    """
    criterion = criterion or ("d-optimal" if test_joints is None else "test-poses")
    if criterion not in CRITERIA:
        raise InputError(f"criterion is '{criterion}'; give {' or '.join(CRITERIA)}")
    begin = time.perf_counter()
    first = first_rows(arm, data)
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
    rows, known, model, names = _told(arm.nominal, first, joints)
    _refuse_too_few(first, rows, count, names)
    at = joints if test_joints is None else test_joints
    weight = _error_weight(first, model, at, len(names))
    aim = weight if criterion == "test-poses" else None
    chosen, _ = exchange(rows, count, rng, aim, known=known)
    chosen = chosen[short_tour(joints[chosen], arm.speed)]

    def error(which: NDArray[np.int64]) -> float:
        seen = rows[which].reshape(-1, rows.shape[-1])
        return float(np.sqrt(np.trace(np.linalg.solve(known + seen.T @ seen, weight))))

    def chance(size: int) -> float:
        return float(np.median([error(rng.choice(len(joints), size, replace=False)) for _ in range(DRAWS)]))

    by_chance, points = chance(count), []
    if curve:
        sizes = [size for size in (max(1, count // 2), *(count * k for k in (1, 2, 4, 8))) if size <= len(joints)]
        added, _ = exchange(rows, sizes[-1], rng, aim, most_passes=0, known=known)
        for size in sizes:
            points.append(
                CurvePoint(size, error(chosen), by_chance)
                if size == count
                else CurvePoint(size, error(added[:size]), chance(size))
            )
    shuffled = [travel_seconds(joints[rng.permutation(chosen)], arm.speed) for _ in range(DRAWS)]
    return PlanLike(
        joints=joints[chosen],
        chosen=chosen,
        candidates=joints,
        kind=data.kind,
        first=len(first.data.joints),
        parameters=names,
        criterion=criterion,
        predicted_error=error(chosen),
        random_predicted_error=by_chance,
        where="at the candidates" if test_joints is None else "at the test poses",
        travel_seconds=travel_seconds(joints[chosen], arm.speed),
        random_travel_seconds=float(np.mean(shuffled)),
        seconds=time.perf_counter() - begin,
        lines=None if lines is None else lines[chosen],
        curve=tuple(points),
    )


def _told(geometry: Geometry, first: FirstRows, joints: Array) -> tuple[Array, Array, ErrorModel, tuple[str, ...]]:
    """What each candidate tells ``(N, r, p)``, what the first rows tell ``(p, p)``, and of which parameters.

    The last are the arm's own among them, and the names of all.
    """
    model, data = complete_model(geometry), first.data
    own, scale = len(data.unknowns()), np.concatenate([data.tolerances(), model.tolerance])
    asked = [asked_at(first, joints[i : i + CHUNK]) for i in range(0, len(joints), CHUNK)]
    sets = [data, asked[0]]
    here, there = (_scaled(first, part, model, scale) for part in sets)
    found = identifiable_parameters(
        model,
        sets,
        first.model,
        [first.unknowns] * len(sets),
        np.concatenate([here, there]),
        (*data.unknowns(), *model.names),
        scale,
    )
    kept, here = found.kept, here[:, found.kept]
    arms = kept[kept >= own] - own
    arm_model = ErrorModel(model.columns[arms], tuple(model.names[k] for k in arms), model.tolerance[arms])
    told = np.concatenate([_by_pose(first, part, model, scale)[..., kept] for part in asked])
    return told, here.T @ here, arm_model, found.kept_names


def _scaled(first: FirstRows, data: Observations, model: ErrorModel, scale: Array) -> Array:
    """Whitened, scaled Jacobian ``(equations, own + P)``."""
    by_arm, by_own = data.jacobian(first.model, first.unknowns)
    return np.asarray(np.hstack([by_own, by_arm[:, model.columns]]) * scale)


def _by_pose(first: FirstRows, asked: Observations, model: ErrorModel, scale: Array) -> Array:
    """The same of each pose by itself ``(N, r, own + P)``, without what is known beforehand; at most r = 6 + own.

    A pose has six components and the instrument so many unknowns: more equations (a board's corners) tell of no more
    directions, and are replaced by as few that tell the same.
    """
    matrix, (row, _) = _scaled(first, asked, model, scale), asked.equations()
    matrix, row = matrix[row >= 0], row[row >= 0]
    counts = np.bincount(row, minlength=len(asked.joints))
    place = np.arange(len(row)) - (np.cumsum(counts) - counts)[row]
    whole = np.zeros((len(asked.joints), int(counts.max()), matrix.shape[1]))
    whole[row, place] = matrix
    most = 6 + len(first.unknowns)
    if whole.shape[1] <= most:
        return whole
    values, vectors = np.linalg.eigh(np.swapaxes(whole, 1, 2) @ whole)
    few = np.sqrt(np.maximum(values[:, None, -most:], 0.0)) * vectors[..., -most:]
    return np.asarray(np.swapaxes(few, 1, 2))


def _error_weight(first: FirstRows, model: ErrorModel, test_joints: Array, count: int) -> Array:
    """W ``(p, p)`` such that trace(W M^-1) is the mean squared predicted position error at the test poses, m^2."""
    by_arm = parameter_jacobian(first.model.geometry, test_joints)[:, :3, model.columns] * model.tolerance
    stacked = by_arm.reshape(-1, len(model.names))
    weight = np.zeros((count, count))
    own = count - len(model.names)
    weight[own:, own:] = stacked.T @ stacked / len(test_joints)
    return weight


def _refuse_too_few(first: FirstRows, rows: Array, count: int, names: tuple[str, ...]) -> None:
    """Refuse a plan that leaves fewer equations than parameters, and one more."""
    equations = int((first.data.equations()[0] >= 0).sum())
    each = min(rows.shape[1], 6)
    least = max(1, -(-(len(names) + 1 - equations) // each))
    if count < least:
        raise InputError(
            f"{count} poses besides the {len(first.data.joints)} of {first.data.source} are too few for {len(names)} "
            f"parameters; plan at least {least}, better {2 * least}"
        )
