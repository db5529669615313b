"""Choice of the poses to measure, out of many candidates, and of an order with short travel.

The chosen set is D-optimal (largest determinant of the information matrix, and thus the largest observability index
O1). Or it has the least predicted error at given test poses (Klimchik, Wu et al. 2012-2014: accuracy where the arm will
pick). If parameters have priors, poses are chosen by the information that they add to the priors. The predicted error
is then the error that a calibration will state. SI units.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from pickenv.arm import Arm, Array, Geometry, parameter_jacobian
from pickenv.base import InputError, check_limit, single_threaded
from pickenv.calibration.identification.least_squares import REDUNDANCY_TOLERANCE, observability
from pickenv.calibration.model.arm_model import ErrorModel, frames_model, link_model
from pickenv.calibration.model.measurements import ATTITUDE_STD, POSITION_STD, random_joints, write_joints
from pickenv.calibration.model.noise_and_priors import FRAMES, PriorModel

# Choosing poses by exchange: Fedorov 1972 in the one-after-the-other form of Cook and Nachtsheim 1980. A pose brings
# a block of r rows, so the determinant lemma and Woodbury's identity are used with r x r blocks, for all candidates
# at once.

RIDGE = 1e-9
"""Information added in every direction so that inverses exist, as a share of a candidate's mean information."""


def exchange(
    rows: Array,
    count: int,
    rng: np.random.Generator,
    weight: Array | None = None,
    most_passes: int = 20,
    *,
    known: Array | None = None,
) -> tuple[NDArray[np.int64], int]:
    """Choose candidates by greedy addition, then exchange them one by one until no exchange improves the set.

    Args:
        rows: Weighted, scaled Jacobians of the candidates ``(N, r, p)``.
        count: Number of candidates to choose.
        rng: Draws the order of exchanges.
        weight: Matrix W ``(p, p)``, to minimise trace(W M^-1) for the information matrix M; None for D-optimality.
        most_passes: Largest number of rounds of exchange; three to six are usual. With 0 the candidates come in the
            order of their addition.
        known: Information ``(p, p)`` that exists already, from priors or from rows measured before.

    Returns:
        Indices, from 0, of the chosen candidates, and the number of rounds of exchange.
    """
    p = rows.shape[-1]
    ridge = RIDGE * float(np.sum(rows**2)) / len(rows) / p
    information = ridge * np.eye(p) + (0.0 if known is None else known)
    taken = np.zeros(len(rows), dtype=bool)
    places: list[int] = []
    for _ in range(count):
        best = int(np.argmax(np.where(taken, -np.inf, gains(rows, information, weight))))
        taken[best] = True
        places.append(best)
        information = information + rows[best].T @ rows[best]
    passes, changing = 0, True
    while changing and passes < most_passes:
        passes, changing = passes + 1, False
        for place in rng.permutation(count):
            old = places[place]
            taken[old] = False
            without = information - rows[old].T @ rows[old]
            value = np.where(taken, -np.inf, gains(rows, without, weight))
            best = int(np.argmax(value))
            if value[best] > value[old] + 1e-9 * abs(value[old]):
                places[place], changing = best, True
                information = without + rows[best].T @ rows[best]
            taken[places[place]] = True
    return np.array(places), passes


def gains(rows: Array, information: Array, weight: Array | None) -> Array:
    """Return the gain of adding each candidate to the information M ``(N,)``.

    Without a weight it is log det(I + J M^-1 J^T). With W it is the decrease of trace(W M^-1), which by Woodbury's
    identity is trace((I + J M^-1 J^T)^-1 J M^-1 W M^-1 J^T).

    Args:
        rows: Jacobians J of the candidates ``(N, r, p)``.
        information: M ``(p, p)``.
        weight: W ``(p, p)``, or None.
    """
    values, vectors = np.linalg.eigh(information)
    root = vectors / np.sqrt(np.maximum(values, values[-1] * 1e-15))
    half = rows @ root
    inner = half @ np.swapaxes(half, -1, -2)
    inner[..., np.arange(rows.shape[1]), np.arange(rows.shape[1])] += 1.0
    if weight is None:
        return np.asarray(2.0 * np.log(np.linalg.cholesky(inner).diagonal(axis1=-2, axis2=-1)).sum(axis=-1))
    outer = (half @ (root.T @ weight @ root)) @ np.swapaxes(half, -1, -2)
    return np.asarray(np.trace(np.linalg.solve(inner, outer), axis1=-2, axis2=-1))


# The order in which poses are measured: nearest neighbour, then 2-opt (Croes 1958), in the time the joints need. All
# joints move together, each at its largest speed, so the slowest one sets the time of a move. A speed of zero is
# refused. Units: rad, m, s.


def move_seconds(joints: Array, speed: Array) -> Array:
    """Compute the times ``(N, N)``, s, of the moves between each two poses.

    Args:
        joints: Joints of the poses ``(N, n)``, rad or m.
        speed: Joint speeds ``(n,)``, rad/s or m/s.

    Raises:
        InputError: If a speed is not finite and above zero.
    """
    moving = np.isfinite(speed) & (speed > 0)
    if not moving.all():
        worst = int(np.argmin(moving))
        raise InputError(f"the speed of joint {worst + 1} is {speed[worst]:g}; give a finite speed above zero")
    return np.asarray(np.max(np.abs(joints[:, None] - joints[None]) / speed, axis=-1))


def travel_seconds(joints: Array, speed: Array) -> float:
    """Compute the time, s, to visit poses in their order, from the first to the last.

    The arguments are those of `move_seconds`.
    """
    return float(move_seconds(joints, speed).diagonal(1).sum())


def short_tour(joints: Array, speed: Array) -> NDArray[np.int64]:
    """Return a short tour of the poses as their indices, from 0, in the order of visits ``(N,)``.

    The tour is the best of several nearest-neighbour tours after 2-opt. The arguments are those of `move_seconds`.
    """
    cost = move_seconds(joints, speed)
    ways = [_two_opt(_nearest_neighbours(cost, start), cost) for start in range(min(len(joints), 10))]
    return min(ways, key=lambda way: float(cost[way[:-1], way[1:]].sum()))


def _nearest_neighbours(cost: Array, start: int) -> NDArray[np.int64]:
    """Return the tour ``(N,)`` from pose ``start`` that always continues to the nearest pose not visited yet.

    Poses are indices from 0; ``cost`` holds the times between each two poses ``(N, N)``, s.
    """
    cost, way = cost.copy(), [start]
    for _ in range(1, len(cost)):
        cost[:, way[-1]] = np.inf
        way.append(int(np.argmin(cost[way[-1]])))
    return np.array(way)


def _two_opt(way: NDArray[np.int64], cost: Array) -> NDArray[np.int64]:
    """Return a shorter tour: while a reversal saves time, the stretch whose reversal saves the most is reversed.

    The first and the last pose may change.

    Args:
        way: The tour as indices of poses, from 0, in the order of visits ``(N,)``.
        cost: Times of the moves between each two poses ``(N, N)``, s.
    """
    count = len(way)
    if count < 3:
        return way
    while True:
        # The stretch i..j is reversed: edges (i - 1, i) and (j, j + 1) are replaced; an edge beyond an end costs 0.
        padded = np.zeros((count + 2, count + 2))
        padded[1:-1, 1:-1] = cost[np.ix_(way, way)]
        steps = padded.diagonal(1)  # steps[k] is the edge from place k - 1 to place k
        before, after = padded[:-2, 1:-1], padded[1:-1, 2:]  # [i, j]: (i - 1, j) and (i, j + 1)
        saved = np.triu(steps[:-1, None] + steps[None, 1:] - before - after, 1)
        i, j = np.unravel_index(int(np.argmax(saved)), saved.shape)
        if not saved[i, j] > 1e-9:  # nor where a cost is no number
            return way
        way = np.concatenate([way[:i], way[i : j + 1][::-1], way[j + 1 :]])


KINDS = ("pose", "position")
CRITERIA = ("d-optimal", "test-poses")

MARGIN = 0.02
"""Least distance of a candidate joint from its limits, as a share of its range."""

AT_LIMIT = 2.0 / 3.0
"""Probability that a joint is at a limit, in the half of the candidates on the border of the joint ranges."""

FIELD = 300
"""Number of poses drawn from the joint ranges to predict errors at, if no test poses are given."""

DRAWS = 20
"""Number of random sets of poses that a plan is compared with."""


@dataclass(frozen=True, eq=False)
class Design:
    """Candidate poses, with the information that each gives on the parameters.

    Attributes:
        joints: Candidates ``(N, n)``, rad or m.
        rows: Weighted, scaled Jacobians of the candidates with respect to the parameters ``(N, r, p)``, an instrument's
            own unknowns first.
        model: The arm's parameters, which come last among the columns.
        weight: One over the standard uncertainty of each component of a pose ``(r,)``; empty if the plan builds on rows
            that an instrument measured before.
        kind: "pose" (r = 6), "position" (r = 3), or the kind of an instrument's rows.
        known: Information ``(p, p)`` that exists already, from priors and from rows measured before.
        names: Names of an instrument's own unknowns.
        framed: Whether base and tool are fitted, with priors. The part of an error that base and tool can absorb then
            does not count.
    """

    joints: Array
    rows: Array
    model: ErrorModel
    weight: Array
    kind: str
    known: Array
    names: tuple[str, ...] = ()
    framed: bool = False


@dataclass(frozen=True, eq=False)
class PosePlan:
    """A plan: poses to measure, in order, with the errors to expect.

    Attributes:
        joints: Joints of the poses ``(n_poses, n)``, rad or m, in measuring order.
        chosen: Indices, from 0, of these poses among the candidates.
        design: The candidates.
        criterion: "d-optimal" or "test-poses".
        travel_seconds: Time of the moves in measuring order, s. All joints move together, at the arm's speeds.
        random_travel_seconds: Time of the moves in random order, mean of 20 orders, s.
        predicted_error: RMS position error to expect from the parameters' uncertainty, m; None if there are neither
            test poses nor priors nor rows measured before the plan.
        random_predicted_error: The same error for as many poses drawn at random, median of 20 sets, m; or None.
        where: The poses at which these errors are predicted, in words.
        passes: Number of rounds of exchange.
        model: Observability of the parameters that the plan is to determine, with the planned poses and with as many
            random poses, for JSON. None if the plan builds on rows that an instrument measured before.
        arm: Observability of the arm's own parameters with base and tool known, as papers state it. None if ``model``
            is None, or if the poses are too few to determine all these parameters without priors.
        first: Number of rows measured before the plan.
        seconds: Time that the planning took, s.
        lines: Lines, from 1, of the poses in the file of candidates; None if the candidates were drawn.
        curve: Three values for each of several numbers of poses: the number; the error to expect with this many planned
            poses, m; and the error to expect with this many random poses, m.
    """

    joints: Array
    chosen: NDArray[np.int64]
    design: Design
    criterion: str
    travel_seconds: float
    random_travel_seconds: float
    predicted_error: float | None
    random_predicted_error: float | None
    where: str
    passes: int
    model: dict[str, Any] | None = None
    arm: dict[str, Any] | None = None
    first: int = 0
    seconds: float = 0.0
    lines: NDArray[np.int64] | None = None
    curve: tuple[tuple[int, float, float], ...] = ()

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that the plan is to determine: the instrument's own unknowns, then the arm's."""
        return (*self.design.names, *self.design.model.names)

    def as_dict(self) -> dict[str, Any]:
        """Return the plan as values for JSON.

        The entries "condition", "random_condition" and "o1_ratio" are copied from "arm", for the arm's own parameters.
        """
        figures: dict[str, Any] = {
            "poses": len(self.joints),
            "first_rows": self.first,
            "candidates": len(self.design.joints),
            "kind": self.design.kind,
            "parameters": list(self.parameters),
        }
        plain = ("criterion", "where", "travel_seconds", "random_travel_seconds", "passes", "seconds")
        figures |= {name: getattr(self, name) for name in plain}
        if self.model is not None:
            copied = ("condition", "random_condition", "o1_ratio")
            figures |= {"arm": self.arm, "model": self.model} | {key: self.arm and self.arm[key] for key in copied}
        errors = {name: getattr(self, name) for name in ("predicted_error", "random_predicted_error")}
        figures |= {f"{name}_mm": value * 1e3 for name, value in errors.items() if value is not None}
        if self.lines is not None:
            figures["lines"] = self.lines.tolist()
        if self.curve:
            figures["curve"] = [
                {"poses": n, "error_mm": error * 1e3, "random_error_mm": chance * 1e3}
                for n, error, chance in self.curve
            ]
        return figures

    def report(self) -> str:
        """Return a short report of the plan in words, for people."""
        lines = [
            f"{len(self.joints)} of {len(self.design.joints)} candidates, {self.criterion}, {self.design.kind} "
            f"measurements, {len(self.parameters)} parameters, in {self.seconds:.2f} s"
        ]
        if self.first:
            lines.append(f"  besides the {self.first} measured already, at poses where such rows can be measured")
        parts = {"parameters planned for": self.model, "arm alone, base and tool known": self.arm}
        for label, part in parts.items():
            if part is not None:
                lines.append(
                    f"  {label} ({len(part['parameters'])}): condition {part['condition']:.1f} (poses drawn at "
                    f"random: {part['random_condition']:.1f}), O1 {part['o1_ratio']:.2f} times theirs"
                )
        lines.append(
            f"  moves take {self.travel_seconds:.0f} s in this order, {self.random_travel_seconds:.0f} s in another"
        )
        if self.predicted_error is not None and self.random_predicted_error is not None:
            lines.append(
                f"  error to expect {self.where} {self.predicted_error * 1e3:.4f} mm RMS "
                f"(poses drawn at random: {self.random_predicted_error * 1e3:.4f} mm)"
            )
        if self.lines is not None:
            lines.append(f"  lines of the file, in measuring order: {', '.join(map(str, self.lines))}")
        if self.curve:
            lines.append("  how many poses? RMS position error from the parameters' uncertainty, and drawn at random:")
            lines += [
                f"    {n:5d} poses: {error * 1e3:.4f} mm ({chance * 1e3:.4f} mm)" for n, error, chance in self.curve
            ]
        return "\n".join(lines)

    def write_csv(self, path: str | Path, prismatic: tuple[bool, ...]) -> Path:
        """Write the joints in measuring order as a CSV file with columns such as q1_deg and q2_mm.

        Args:
            path: The file.
            prismatic: Whether each joint is prismatic.
        """
        return write_joints(path, self.joints, prismatic)


def candidate_joints(geometry: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Draw candidate joints ``(count, n)``, rad or m: half uniformly from the joint ranges, half on their border.

    The best poses of an optimal design are often on the border, but uniform draws hardly ever are.
    """
    room = MARGIN * (geometry.upper - geometry.lower)
    lower, upper = geometry.lower + room, geometry.upper - room
    joints = rng.uniform(lower, upper, (count, geometry.joints))
    side = rng.random(joints.shape)
    at_border = (np.arange(count) >= count // 2)[:, None]
    ends = [at_border & (side < AT_LIMIT / 2), at_border & (side > 1 - AT_LIMIT / 2)]
    return np.select(ends, [lower, upper], joints)


def design_of(
    geometry: Geometry, model: ErrorModel | PriorModel, joints: Array, kind: str, position_std: float = POSITION_STD
) -> Design:
    """Return the design of the candidates, for all parameters if these have priors, else for an identifiable base set.

    The base set is chosen by pivoted QR: if parameters have the same effects, the parameter of the largest effect is
    kept. The D-optimal poses do not depend on this choice. Their condition number does.

    Args:
        geometry: The nominal arm.
        model: The parameters, with or without priors.
        joints: Candidates ``(N, n)``, rad or m.
        kind: What will be measured, "pose" or "position".
        position_std: Standard uncertainty of a position coordinate, m; for an attitude it is `ATTITUDE_STD`.
    """
    parameters = model.parameters if isinstance(model, PriorModel) else model
    weight = 1.0 / np.repeat([position_std, ATTITUDE_STD], 3)[: 6 if kind == "pose" else 3]
    rows = _rows(geometry, parameters, weight, joints)
    if isinstance(model, PriorModel):
        information = np.diag((parameters.tolerance / model.width) ** 2)
        return Design(joints, rows, parameters, weight, kind, information, framed=bool((model.group == FRAMES).any()))
    r, order = qr(np.linalg.qr(rows.reshape(-1, rows.shape[-1]), mode="r"), mode="r", pivoting=True)
    diagonal = np.abs(np.diag(r))
    columns = np.sort(order[: int(np.sum(diagonal > REDUNDANCY_TOLERANCE * diagonal[0]))])
    base = parameters.some(np.isin(np.arange(len(order)), columns))
    return Design(joints, rows[..., columns], base, weight, kind, np.zeros((len(columns), len(columns))))


def _rows(geometry: Geometry, model: ErrorModel, weight: Array, joints: Array) -> Array:
    """Return the weighted, scaled Jacobians of poses ``(N, r, p)``.

    Args:
        geometry: The nominal arm.
        model: The p parameters, whose tolerances scale the columns.
        weight: Weights of a pose's first r components ``(r,)``: 3 for positions, 6 for full poses.
        joints: Joints of the poses ``(N, n)``, rad or m.
    """
    jacobian = parameter_jacobian(geometry, joints)[:, : len(weight), model.columns]
    return np.asarray(jacobian * model.tolerance * weight[:, None])


def criterion_of(criterion: str | None, test_joints: Array | None) -> str:
    """Return the criterion, one of `CRITERIA`; None becomes "test-poses" or "d-optimal".

    Args:
        criterion: The criterion, or None.
        test_joints: The test poses; if None, the default is "d-optimal", otherwise "test-poses".

    Raises:
        InputError: If the criterion is unknown.
    """
    criterion = criterion or ("d-optimal" if test_joints is None else "test-poses")
    if criterion not in CRITERIA:
        raise InputError(f"criterion is '{criterion}'; give {' or '.join(CRITERIA)}")
    return criterion


@single_threaded()
def plan_poses(
    arm: Arm,
    model: ErrorModel | PriorModel,
    count: int,
    rng: np.random.Generator,
    *,
    candidates: Array | int = 2000,
    kind: str = "pose",
    criterion: str | None = None,
    test_joints: Array | None = None,
    position_std: float = POSITION_STD,
    curve: bool = False,
) -> PosePlan:
    """Choose ``count`` poses to measure, and order them for short travel.

    If parameters have priors, the predicted error is the error of the posterior, as `pickenv.calibrate` states it. If
    base and tool are fitted, the part of the error that base and tool can absorb is left out.

    Args:
        arm: The arm, with joint limits and speeds.
        model: The parameters to identify. If they have priors
            (`pickenv.calibration.model.noise_and_priors.prior_model`), poses are chosen by the information that they
            add to the priors, and there may be fewer poses than parameters. Scales of prior widths that are not stated
            count as 1.
        count: Number of poses to measure.
        rng: Draws candidates, the order of exchanges, and the random sets of poses that the plan is compared with.
        candidates: Joints to choose from ``(N, n)``, rad or m; random sets are drawn from them, too. Or the number of
            candidates to draw (see `candidate_joints`).
        kind: What will be measured, "pose" or "position".
        criterion: "d-optimal", or "test-poses" to minimise the predicted position error at ``test_joints``. If left
            out, "test-poses" if ``test_joints`` are given, else "d-optimal".
        test_joints: Joints at which accuracy matters ``(M, n)``, rad or m; with "d-optimal" they serve only to predict
            the error.
        position_std: Standard uncertainty of a position coordinate, m; for an attitude it is `ATTITUDE_STD`.
        curve: Whether to predict the error also for half, twice, four and eight times as many poses. It is predicted at
            ``test_joints`` or, without them, at poses drawn uniformly from the joint ranges.

    Raises:
        InputError: If there are too few poses for parameters without priors, too few candidates, no test poses where
            needed, or an unknown kind or criterion.
    """
    if kind not in KINDS:
        raise InputError(f"kind is '{kind}'; give {' or '.join(KINDS)}")
    criterion = criterion_of(criterion, test_joints)
    begin = time.perf_counter()
    geometry = arm.nominal
    if isinstance(candidates, int):
        check_limit("candidates", candidates, "candidates")
        joints = candidate_joints(geometry, candidates, rng)
    else:
        joints = np.asarray(candidates, dtype=float)
    if criterion == "test-poses" and test_joints is None:
        raise InputError("the test-poses criterion needs test poses; name a file of them or use d-optimal")
    design = design_of(geometry, model, joints, kind, position_std)
    refuse_too_few(count, len(design.model.names), _least(design))
    if count > len(joints):
        raise InputError(f"{count} poses cannot be chosen from {len(joints)} candidates; give more candidates")

    @cache
    def drawn(size: int) -> Array:
        """Draw random sets ``(DRAWS, size, n)`` of poses to compare the plan with."""
        if isinstance(candidates, int):
            return random_joints(geometry, DRAWS * size, rng).reshape(DRAWS, size, -1)
        return np.stack([joints[rng.choice(len(joints), size, replace=False)] for _ in range(DRAWS)])

    field = random_joints(geometry, FIELD, np.random.default_rng(0)) if test_joints is None else test_joints
    plan = finished_plan(
        arm,
        design,
        count,
        rng,
        random_rows=lambda size: (_rows(geometry, design.model, design.weight, joints) for joints in drawn(size)),
        criterion=criterion,
        goal=error_weight(geometry, design, field),
        where="over the joint ranges" if test_joints is None else "at the test poses",
        sizes=plan_sizes(count, _least(design), len(joints)) if curve else (),
    )
    if test_joints is None and not design.known.any():
        plan = replace(plan, predicted_error=None, random_predicted_error=None)
    links, sets = design_of(geometry, link_model(geometry), joints, kind, position_std), drawn(count)
    return replace(
        plan,
        model=_against_chance(geometry, design, plan.chosen, sets),
        arm=None if count < _least(links) else _against_chance(geometry, links, plan.chosen, sets),
        seconds=time.perf_counter() - begin,
    )


def finished_plan(
    arm: Arm,
    design: Design,
    count: int,
    rng: np.random.Generator,
    *,
    random_rows: Callable[[int], Iterable[Array]],
    criterion: str,
    goal: Array,
    where: str,
    sizes: Sequence[int],
) -> PosePlan:
    """Choose the best poses of a design, order them for short travel, and compare them with random sets.

    If parameters have priors, the poses of most information can have a larger predicted error than random poses. In
    this case the poses of least predicted error are chosen instead.

    Args:
        arm: The arm, with joint speeds.
        design: The candidates.
        count: Number of poses to measure.
        rng: Draws the order of exchanges, and the random orders that the travel time is compared with.
        random_rows: Function that draws `DRAWS` random sets of a given number of poses, and returns the Jacobians
            ``(size, r, p)`` of each set.
        criterion: See `plan_poses`.
        goal: The matrix W ``(p, p)`` of `error_weight`.
        where: The poses at which the error is predicted, in words.
        sizes: Numbers of poses for `PosePlan.curve`.
    """
    joints, aim = design.joints, goal if criterion == "test-poses" else None
    places, passes = exchange(design.rows, count, rng, aim, known=design.known)

    error = partial(predicted_error, weight=goal, known=design.known)

    @cache
    def chance(size: int) -> float:
        return float(np.median([error(rows) for rows in random_rows(size)]))

    by_chance = chance(count)
    if design.known.any() and error(design.rows[places]) > by_chance:  # much information, but not about the workspace
        places, passes = exchange(design.rows, count, rng, goal, known=design.known)
    places = places[short_tour(joints[places], arm.speed)]
    shuffled = [travel_seconds(joints[rng.permutation(places)], arm.speed) for _ in range(DRAWS)]
    # Poses added one after the other: the first of a larger set are a smaller one.
    added = exchange(design.rows, sizes[-1], rng, aim, most_passes=0, known=design.known)[0] if sizes else places
    planned = {size: design.rows[places if size == count else added[:size]] for size in sizes}
    return PosePlan(
        joints=joints[places],
        chosen=places,
        design=design,
        criterion=criterion,
        travel_seconds=travel_seconds(joints[places], arm.speed),
        random_travel_seconds=float(np.mean(shuffled)),
        predicted_error=error(design.rows[places]),
        random_predicted_error=by_chance,
        where=where,
        passes=passes,
        curve=tuple((size, error(rows), chance(size)) for size, rows in planned.items()),
    )


def _observed(design: Design, rows: Array) -> dict[str, float]:
    """Return the observability figures, such as "condition" and "o1", of a set of M poses.

    Args:
        design: The design, whose ``known`` information is added.
        rows: Weighted, scaled Jacobians of the poses ``(M, r, p)``.
    """
    stacked = np.vstack([rows.reshape(-1, rows.shape[-1]), np.sqrt(design.known)])
    return observability(np.linalg.svd(stacked, compute_uv=False), len(rows))


def _against_chance(geometry: Geometry, design: Design, chosen: NDArray[np.int64], sets: Array) -> dict[str, Any]:
    """Compare the observability of the planned poses with the observability of random sets, as values for JSON.

    The random set with the median condition number represents all random sets. The O1 ratio is relative to the mean O1
    of all random sets.

    Args:
        geometry: The nominal arm.
        design: The candidates.
        chosen: Indices, from 0, of the planned poses among the candidates.
        sets: Joints of the random sets ``(DRAWS, count, n)``, rad or m.
    """
    rows = (_rows(geometry, design.model, design.weight, joints) for joints in sets)
    random_sets = sorted((_observed(design, part) for part in rows), key=itemgetter("condition"))
    planned, by_chance = _observed(design, design.rows[chosen]), random_sets[len(random_sets) // 2]
    return {
        "parameters": list(design.model.names),
        "condition": planned["condition"],
        "random_condition": by_chance["condition"],
        "o1_ratio": planned["o1"] / float(np.mean([part["o1"] for part in random_sets])),
        "observability": planned,
        "random_observability": by_chance,
    }


def _least(design: Design) -> int:
    """Return the least number of poses of a plan: 1 if the design has ``known`` information.

    Otherwise it is one more than the number of poses that give as many equations as there are parameters.
    """
    return 1 if design.known.any() else -(-len(design.model.names) // int(design.rows.shape[1])) + 1


def plan_sizes(count: int, least: int, most: int) -> list[int]:
    """Return the numbers of poses for a plan's curve: half, one, two, four and eight times the planned number.

    Args:
        count: The planned number.
        least: Least number of poses, which replaces half of the planned number if that is smaller.
        most: Largest number of poses; larger numbers are left out.
    """
    sizes = {max(least, count // 2), *(count * times for times in (1, 2, 4, 8))}
    return sorted(size for size in sizes if size <= most)


def refuse_too_few(count: int, parameters: int, least: int, besides: str = "") -> None:
    """Refuse a plan with too few poses to determine all parameters.

    Args:
        count: Number of poses.
        parameters: Number of parameters.
        least: Least number of poses.
        besides: Words for the message on rows that were measured before; may be empty.

    Raises:
        InputError: If there are fewer than ``least`` poses.
    """
    if count < least:
        raise InputError(
            f"{count} poses {besides}are too few for {parameters} parameters; plan at least {least}, better {2 * least}"
        )


def error_weight(geometry: Geometry, design: Design, test_joints: Array) -> Array:
    """Return the matrix W ``(p, p)`` for which trace(W M^-1) is the predicted mean squared position error, m^2.

    M is the information matrix of the parameters. The error is predicted at the test poses.

    Args:
        geometry: The nominal arm.
        design: The candidates.
        test_joints: Test poses ``(M, n)``, rad or m.

    Raises:
        InputError: If base and tool are fitted, and the test poses give less than twice as many equations as base and
            tool have parameters.
    """
    place = partial(_rows, geometry, weight=np.ones(3), joints=test_joints)
    stacked = place(design.model).reshape(-1, len(design.model.names))
    if design.framed:
        frames = frames_model(geometry)
        if 3 * len(test_joints) < 2 * len(frames.names):
            raise InputError(
                f"{len(test_joints)} test poses tell no error where base and tool are fitted, for these explain it; "
                f"give {-(-2 * len(frames.names) // 3)} poses or more around the place (`at`), or `frames='known'`"
            )
        basis = np.linalg.qr(place(frames).reshape(-1, len(frames.names)))[0]
        stacked = stacked - basis @ (basis.T @ stacked)
    return np.pad(stacked.T @ stacked / len(test_joints), (len(design.names), 0))


def predicted_error(rows: Array, weight: Array, known: Array | float = 0.0) -> float:
    """Return the RMS position error, m, to expect from the parameters' uncertainty after measuring.

    Args:
        rows: Jacobians of the measured poses ``(M, r, p)``.
        weight: The matrix W ``(p, p)`` from `error_weight`, for the poses at which the error is predicted.
        known: Information ``(p, p)`` that exists already.
    """
    stacked = rows.reshape(-1, rows.shape[-1])
    return float(np.sqrt(np.trace(np.linalg.solve(stacked.T @ stacked + known, weight))))
