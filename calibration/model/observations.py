"""The questions to a data set of any kind; kinds beyond `Measurements` stand in `kinds` and `pixels` beside it.

Each kind brings unknowns of its own (where the reflectors sit, the wire is anchored, the sockets are), which are
identified together with the arm. Rows are whitened by their covariance, so any mix may be stacked. SI units.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.calibration.model.arm_model import ArmModel, Conditions

# Where each row of a data set stands, file and line, carried through every selection: a message names what is wrong.
# Lines are counted from 1 with the header, as an editor shows them; rows that come from no file are counted from 1.

NAMED = 6
"""Rows that a message names at most."""


@dataclass(frozen=True, eq=False)
class Origins:
    """File and line of N rows.

    Attributes:
        files: The files.
        file: Index into ``files`` of each row ``(N,)``.
        line: Line of each row in its file ``(N,)``, from 1.
    """

    files: tuple[str, ...]
    file: NDArray[np.int64]
    line: NDArray[np.int64]

    def select(self, rows: ArrayLike) -> Origins:
        """The origins of the given rows (indices or a mask)."""
        rows = np.asarray(rows)
        return Origins(self.files, self.file[rows], self.line[rows])

    def place(self, row: int) -> tuple[str, int]:
        """File and line of one row."""
        return self.files[int(self.file[row])], int(self.line[row])


def named(places: Sequence[tuple[str, int]]) -> str:
    """Files and lines as a message names them."""
    texts = []
    for file in dict.fromkeys(file for file, _ in places):
        lines = [str(line) for line in sorted(line for name, line in places if name == file)]
        numbers = ", ".join(lines[:NAMED]) + (f" and {len(lines) - NAMED} more" if len(lines) > NAMED else "")
        texts.append(f"{file}: {'row' if len(lines) == 1 else 'rows'} {numbers}")
    return "; ".join(texts)


MISS_UNITS = {"mm": 1e3, "deg": float(np.degrees(1.0))}
"""Units of misses on screens, and the factor from SI."""

NONE_KNOWN = Conditions()
"""Neither payload nor temperature nor torques were recorded."""


Kind = TypeVar("Kind", bound="Observations")
Answer = TypeVar("Answer")


@dataclass(frozen=True, eq=False)
class Stated:
    """K numbers of an instrument, each with what is known of it: exactly, within a standard uncertainty, or not at all.

    Where a wire's reading begins, how long a ball bar is, where a socket stands: what is not exact is an unknown of the
    least squares, and what is known of it stands there as one more equation.

    Attributes:
        names: Of the numbers.
        values: As they are stated ``(K,)``; of unknown ones where to begin.
        std: Standard uncertainty of each ``(K,)``: 0 where it is exact, infinite where it is unknown.
        scales: Scale of each one's deviation ``(K,)``.
    """

    names: tuple[str, ...]
    values: Array
    std: Array
    scales: Array

    @property
    def free(self) -> Rows:
        """Indices of the numbers that are fitted."""
        return np.flatnonzero(self.std > 0.0)

    @property
    def _known(self) -> Rows:
        """Indices, among the fitted ones, of those of which something is known."""
        return np.flatnonzero(np.isfinite(self.std[self.free]))

    def unknowns(self) -> tuple[str, ...]:
        """Names of the fitted ones."""
        return tuple(self.names[i] for i in self.free)

    def start(self) -> Array:
        """Their values as stated."""
        return self.values[self.free]

    def whole(self, unknowns: Array) -> Array:
        """All numbers ``(K,)``, the fitted ones as given."""
        values = self.values.copy()
        values[self.free] = unknowns
        return values

    def residual(self, unknowns: Array) -> Array:
        """Stated minus present values of those that something is known of, in standard uncertainties."""
        return np.asarray(((self.start() - unknowns) / self.std[self.free])[self._known])

    def jacobian(self) -> Array:
        """Derivatives of these equations by the fitted numbers."""
        return np.asarray(np.diag(1.0 / self.std[self.free])[self._known])


def worked_out(question: Callable[[Any], Answer]) -> Answer:
    """An attribute that is worked out when it is first asked for, where other kinds simply have one."""
    return cast(Answer, cached_property(question))


class Observations:
    """A data set of any kind: rows that can be chosen, told apart, and compared with a model.

    What most kinds answer alike is answered here: rows that a split may part anywhere, each of which misses once. A
    kind says what it misses by and how that changes with the arm and with the numbers of its instrument; these
    equations are followed by what is known of the numbers, and by what else holds among them.

    Attributes:
        joints: Joints ``(N, n)``, rad or m.
        conditions: Payload, temperature and torques, where known.
        source: Origin of the data, for messages.
        kind: Name of the kind.
        origins: File and line of each row; None where they come from no file.
        framed: Whether the instrument has a frame, so that the arm's base pose can be seen at all.
        sized: Whether a known length takes part, without which nobody can say how large the arm is.
        per_row: Names of the arrays that hold one entry per row, beside the joints.
        width: Equations of each miss.
        miss_unit: Unit of `misses` on screens: "mm" of metres, "deg" of radians.
        rounding: Change of a reading that is written down more roughly, to 0.01 mm or 0.001 deg, in m, rad or px. A
            third of what such instruments scatter by, so that a pose measured anew reads alike once in five times.
        stations: Each with its `InstrumentStation`, where these are several data sets in one fit (`Stacked`).
    """

    joints: Array
    conditions: Conditions
    source: str
    kind: str
    origins: Origins | None
    framed: bool
    sized: bool = True
    per_row: tuple[str, ...]
    width: int = 1
    miss_unit: str = "mm"
    rounding: float = 5e-6
    stations: tuple[Any, ...] = ()

    @property
    def poses(self) -> Any:
        """The same rows as `Measurements`: poses or positions of the tool in one instrument's frame; else None."""

    @property
    def views(self) -> Any:
        """The same rows as `PixelObservations`: pictures of one camera; else None."""

    @property
    def parts(self) -> tuple[Observations, ...]:
        """The data sets of the stations, or this one alone."""
        return (self,)

    @cached_property
    def numbers(self) -> Stated:
        """The instrument's own numbers: none."""
        return Stated((), np.zeros(0), np.zeros(0), np.zeros(0))

    def missed(self, model: ArmModel, numbers: Array) -> Array:
        """Measured minus predicted readings ``(R, m)`` with all of the instrument's numbers ``(K,)``."""
        raise NotImplementedError

    def whitened(self, model: ArmModel, numbers: Array) -> Array:
        """Errors as from `missed`, in standard uncertainties."""
        return np.asarray(self.missed(model, numbers) / self.std)  # type: ignore[attr-defined]

    def derivatives(self, model: ArmModel, numbers: Array) -> tuple[Array, Array]:
        """Derivatives of the whitened prediction by the model ``(..., P)`` and by the numbers ``(..., K)``."""
        raise NotImplementedError

    def bonds(self, numbers: Array) -> tuple[Array, Array]:
        """Further equations among the numbers: whitened residual ``(G,)`` and derivatives ``(G, K)``."""
        return np.zeros(0), np.zeros((0, len(numbers)))

    def readings(self) -> Array:
        """The readings of each row ``(N, k)``, m: rows equal in them and in the joints repeat one another."""
        raise NotImplementedError

    def from_the_first(self, model: ArmModel, unknowns: Array) -> Any:
        """`poses`, of several stations as the first one would have measured them; None of other kinds."""
        return self.poses

    def rough_poses(self, prismatic: tuple[bool, ...]) -> Any:
        """Poses or positions (`Measurements`) that the rows are worth by themselves, to start from; None where none."""
        return self.poses

    def span(self, tool: Array) -> float:
        """What `misses` are small against: how far the tool's positions ``(N, 3)`` spread, m; of directions 1 rad."""
        return 1.0 if self.miss_unit == "deg" else float(np.linalg.norm(tool.std(axis=0)))

    def fingerprint(self) -> str:
        """Hash of joints and readings, which a calibration records."""
        return hash_of(self.joints, self.readings())

    def by_tool(self, model: ArmModel, unknowns: Array) -> Array:
        """Derivatives of the equations by the tool's pose, in its own axes ``(E, 6)``."""
        return self.jacobian(model, unknowns)[0][:, [name.startswith("tool_") for name in model.parameter_names]]

    def channels_of(self, other: Observations) -> Rows:
        """The channels of these rows that those of other rows of the same instruments are: all of them."""
        return np.arange(int(self.equations()[1].max(initial=-1)) + 1)

    def weighed(self, scales: Array) -> Self:
        """The rows of several stations weighed by their scatter, given by channel ``(C,)``; one station as it is."""
        return self

    def unknowns(self) -> tuple[str, ...]:
        """Names of the kind's own unknowns: the numbers that are not known exactly."""
        return self.numbers.unknowns()

    def tolerances(self) -> Array:
        """Scale of each unknown's deviation, in the unknown's unit (lengths: m)."""
        return self.numbers.scales[self.numbers.free]

    def start(self, model: ArmModel) -> Array:
        """Closed-form values of the unknowns for a model: as they are stated."""
        return self.numbers.start()

    @property
    def groups(self) -> Rows:
        """Rows of one number belong together ``(N,)``, and a split takes its share of each: all are of one group."""
        return np.zeros(len(self.joints), dtype=np.int64)

    @property
    def rows_of_misses(self) -> Rows:
        """The row that each of `misses` belongs to ``(R,)``: one miss per row."""
        return np.arange(len(self.joints))

    def equations(self) -> tuple[Rows, Rows]:
        """Row and channel of each equation of `residual` ``(E,)``; the row is -1 where it belongs to none.

        A channel is what is read in one unit with one uncertainty: of poses positions and attitudes are two. Here those
        of each miss come first, then of no row what is known of the numbers; all are of one channel.
        """
        extra = len(self.numbers.jacobian()) + len(self.bonds(self.numbers.values)[0])
        rows = np.concatenate([np.repeat(self.rows_of_misses, self.width), np.full(extra, -1)])
        return rows, np.zeros(len(rows), dtype=np.int64)

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted positions ``(R, 3)``, or lengths ``(R, 1)``, m; of directions ``(R, k)``, rad."""
        return self.missed(model, self.numbers.whole(unknowns))

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted, whitened, ``(rows,)``: misses, what is known of the numbers, what else holds."""
        numbers = self.numbers.whole(unknowns)
        statements = self.numbers.residual(unknowns)
        return np.concatenate([self.whitened(model, numbers).ravel(), statements, self.bonds(numbers)[0]])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Whitened derivatives by the model ``(rows, 5n + 12 + k)`` and by the unknowns ``(rows, own)``."""
        numbers, free = self.numbers.whole(unknowns), self.numbers.free
        by_arm, by_numbers = self.derivatives(model, numbers)
        by_arm = by_arm.reshape(-1, by_arm.shape[-1])
        by_numbers = by_numbers.reshape(len(by_arm), -1)
        extra = np.concatenate([self.numbers.jacobian(), self.bonds(numbers)[1][:, free]])
        by_arm = np.concatenate([by_arm, np.zeros((len(extra), by_arm.shape[1]))])
        return by_arm, np.ascontiguousarray(np.concatenate([by_numbers[:, free], extra]))

    def select(self, rows: ArrayLike) -> Self:
        """The data set that holds only the given rows (indices or a mask)."""
        rows = np.asarray(rows)
        origins = origins_of(self).select(rows)
        changed = {"joints": self.joints[rows], "conditions": self.conditions.select(rows), "origins": origins}
        return replace(self, **changed, **self._arrays(rows))  # type: ignore[type-var]

    def imagined(self, joints: Array) -> Self:
        """Such an instrument at other joints ``(M, n)``: its readings, over and over."""
        rows = np.resize(np.arange(len(self.joints)), len(joints))
        return replace(self, joints=joints, conditions=Conditions(), origins=None, **self._arrays(rows))  # type: ignore[type-var]

    def _arrays(self, rows: NDArray[Any]) -> dict[str, Any]:
        """Some rows of the arrays that hold one entry per row."""
        values = {name: getattr(self, name) for name in self.per_row}
        return {name: None if value is None else value[rows] for name, value in values.items()}


def hash_of(*parts: Array) -> str:
    """Hash of numbers to 1e-9 m and rad; a trip through a CSV file keeps it."""
    integers = [np.rint(part * 1e9).astype(np.int64) for part in parts]
    return hashlib.sha256(b"".join(part.tobytes() for part in integers)).hexdigest()[:16]


def origins_of(data: Observations) -> Origins:
    """File and line of each row; rows that come from no file are counted from 1."""
    count = len(data.joints)
    return data.origins or Origins((data.source,), np.zeros(count, dtype=np.int64), np.arange(1, count + 1))


def point_jacobian(pose_jacobian: Array, lever: Array) -> Array:
    """Jacobian ``(..., 3, P)`` of a point that lies ``lever`` ``(..., 3)`` (world axes) from the tool's origin."""
    turn = pose_jacobian[..., 3:, :]
    return np.asarray(pose_jacobian[..., :3, :] + np.cross(turn, lever[..., :, None], axis=-2))


def nearest_rotation(matrix: Array) -> Array:
    """The rotations nearest to matrices ``(..., 3, 3)`` (orthogonal Procrustes with positive determinant)."""
    u, _, vt = np.linalg.svd(matrix)
    signs = np.ones(matrix.shape[:-1])
    signs[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * signs[..., None, :]) @ vt)


# Splits of a data set into training and held-out rows. A random split flatters models that interpolate between
# neighbouring poses; a blocked one holds out contiguous runs of rows, which a measuring plan usually makes contiguous
# regions of the workspace. Judge residual models on the latter, and state errors of all blocks, held out in turn: one
# pair of blocks says little of another. Rows of one pose stand on one side of every split: measured again, rounded or
# in another order they are still the rows that were trained on. So poses are split, and rows go with theirs.


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
    a, b = KDTree(cells).query_pairs(1.5, p=np.inf, output_type="ndarray").T
    near = np.maximum(low[a] - high[b], low[b] - high[a]).max(axis=1, initial=-np.inf) <= SAME_POSE
    links = coo_array((near[near], (a[near], b[near])), shape=(len(cells), len(cells)))
    count, pose = connected_components(links, directed=False)
    least, most = np.full((count, joints.shape[1]), np.inf), np.full((count, joints.shape[1]), -np.inf)
    np.minimum.at(least, pose, low)
    np.maximum.at(most, pose, high)
    path = ((most - least).max(axis=1) > PATH)[pose]
    pose = np.where(path, count + np.arange(len(cells)), pose)[cell]
    _, first, number = np.unique(pose, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number]


def pose_count(joints: Array) -> int:
    """Number of poses that rows of these joints ``(N, n)`` are of, however often each was measured."""
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
    most = max(1, count // 5) if test_rows is None else test_rows
    poses = same_poses(observations.joints)
    if not observations.groups.any():
        return random_split(poses, most, rng)
    home = home_groups(observations.groups, poses)
    train, test = [], []
    for number in np.unique(home):
        rows = np.flatnonzero(home == number)
        share = max(1, round(most * len(rows) / count))
        if len(rows) - share < 2:
            raise InputError(
                f"{observations.source}: socket or station {number + 1} has {len(rows)} rows, too few to hold "
                f"{share} of them out"
            )
        training, held_out = random_split(np.unique(poses[rows], return_inverse=True)[1], share, rng)
        train.append(rows[training])
        test.append(rows[held_out])
    return np.concatenate(train), np.concatenate(test)


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
    held_out = np.zeros(count, dtype=bool)
    for start, length in zip(begin, (first, second), strict=True):
        held_out[start : start + length] = True
    return np.flatnonzero(~held_out[poses]), np.flatnonzero(held_out[poses])


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
        rows_in_words = "is 1 row" if rows == 1 else f"are {rows} rows of one pose" if rows else "is 0 row"
        raise InputError(f"there {rows_in_words}, and none can be both trained on and held out; measure more poses")
    if not 0 < test_rows < rows:
        raise InputError(f"{test_rows} test rows of {rows} leave nothing to train on or to test; give 1 to {rows - 1}")
