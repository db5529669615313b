"""`Observations`, the interface of a data set of any kind; kinds beyond `Measurements` are in `kinds` and `pixels`.

Each kind has unknowns of its own, such as the places of reflectors, sockets or a wire's anchor. They are
identified together with the arm. Equations are divided by their standard uncertainties (whitened), so data sets of any
kinds can be stacked in one fit. SI units.
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
"""Largest number of rows of one file that a message names."""


@dataclass(frozen=True)
class Clocks:
    """Offset and rate between the clocks of instrument and joint log in one recording, as estimated from the recording.

    Attributes:
        file: The instrument's file.
        moment: Time on the instrument's clock, within the recording, at which the clocks differ by ``offset``, s.
        offset: Reading of the instrument's clock at ``moment`` minus the reading of the joint log's clock, s.
        offset_std: Standard uncertainty of ``offset``, s.
        rate: Share by which the instrument's clock runs faster than the joint log's clock; 1e-6 is one in a million.
        rate_std: Standard uncertainty of ``rate``.
        expected_rate_std: Prior standard uncertainty of ``rate``, before the recording is used.
        still: True if each row is a mean over a time of rest, False if each row is one sample of the arm's motion.
        rows: Number of rows that the recording gave.
    """

    file: str
    moment: float
    offset: float
    offset_std: float
    rate: float
    rate_std: float
    expected_rate_std: float
    still: bool
    rows: int

    @property
    def rate_told(self) -> bool:
        """Whether the recording is long enough to estimate the rate."""
        return self.rate_std < self.expected_rate_std / 2

    def text(self) -> str:
        """Return a sentence on the clocks and the rows, for people."""
        rows = f"from {self.rows} {'still phases' if self.still else 'rows of motion'}"
        clock = f"its clock is {uncertain(self.offset * 1e3, self.offset_std * 1e3)} ms ahead of the joint log's"
        if self.rate_told:
            clock += f", and {uncertain(self.rate * 1e6, self.rate_std * 1e6)} parts in a million faster"
        return f"{self.file}: {rows}; {clock}"

    def as_dict(self) -> dict[str, Any]:
        """Return the clocks and the rows for JSON; the rate is None if the recording is too short to estimate it."""
        return {
            "file": self.file,
            "moment_s": self.moment,
            "offset_ms": self.offset * 1e3,
            "offset_std_ms": self.offset_std * 1e3,
            "rate_ppm": self.rate * 1e6 if self.rate_told else None,
            "rate_std_ppm": self.rate_std * 1e6 if self.rate_told else None,
            "rows_from": "still phases" if self.still else "motion",
            "rows": self.rows,
        }


def uncertain(value: float, std: float) -> str:
    """Return a value and its standard uncertainty as text, with two significant digits of the uncertainty."""
    digits = max(1 - int(np.floor(np.log10(max(std, 1e-12)))), 0)
    return f"{value:.{digits}f} ± {std:.{digits}f}"


@dataclass(frozen=True, eq=False)
class Origins:
    """File and line of N rows.

    Attributes:
        files: The files.
        file: Index, from 0, of each row's file in ``files`` ``(N,)``.
        line: Line of each row in its file ``(N,)``, from 1.
        clocks: The clocks of the recordings among the files.
        scene: Names of the sensor and of the target with which the rows were measured; empty if the files name none.
        repeat: RMS scatter of a position between repeated measurements, m, as stated in the files; None if it is not
            stated.
    """

    files: tuple[str, ...]
    file: NDArray[np.int64]
    line: NDArray[np.int64]
    clocks: tuple[Clocks, ...] = ()
    scene: tuple[str, str] = ("", "")
    repeat: float | None = None

    def select(self, rows: NDArray[Any]) -> Origins:
        """Return the origins of the given rows (indices or a mask)."""
        return replace(self, file=self.file[rows], line=self.line[rows])

    def place(self, row: int) -> tuple[str, int]:
        """Return the file and line (from 1) of the row with index ``row`` (from 0)."""
        return self.files[int(self.file[row])], int(self.line[row])


def named(places: Sequence[tuple[str, int]]) -> str:
    """Return the files and lines as text for a message, with at most `NAMED` lines of each file.

    Args:
        places: File and line of each row.
    """
    texts = []
    for file in dict.fromkeys(file for file, _ in places):
        lines = [str(line) for line in sorted(line for name, line in places if name == file)]
        numbers = ", ".join(lines[:NAMED]) + (f" and {len(lines) - NAMED} more" if len(lines) > NAMED else "")
        texts.append(f"{file}: {'row' if len(lines) == 1 else 'rows'} {numbers}")
    return "; ".join(texts)


MISS_UNITS = {"mm": 1e3, "deg": float(np.degrees(1.0))}
"""Units of misses (measured minus predicted) on screens, and the factors from m or rad."""

NONE_KNOWN = Conditions()
"""Conditions without payload, temperature or torques."""


Kind = TypeVar("Kind", bound="Observations")
Answer = TypeVar("Answer")


@dataclass(frozen=True, eq=False)
class Stated:
    """K numbers of an instrument, each known exactly, within a standard uncertainty, or not at all.

    Examples are a wire's zero, a ball bar's length and a socket's place. A number that is not exact is an unknown of
    the least squares. If its uncertainty is finite, its stated value gives one more equation.

    Attributes:
        names: Names of the numbers.
        values: Stated values ``(K,)``; starting values of unknown numbers.
        std: Standard uncertainty of each number ``(K,)``: 0 if it is exact, infinite if it is unknown.
        scales: Typical deviation of each number ``(K,)``, in the number's unit, by which its Jacobian column is scaled.
    """

    names: tuple[str, ...]
    values: Array
    std: Array
    scales: Array

    @property
    def free(self) -> Rows:
        """Indices, from 0, of the u numbers that are fitted ``(u,)``."""
        return np.flatnonzero(self.std > 0.0)

    @property
    def _known(self) -> Rows:
        """Indices of the fitted numbers with a finite uncertainty, counted from 0 among the fitted numbers."""
        return np.flatnonzero(np.isfinite(self.std[self.free]))

    def unknowns(self) -> tuple[str, ...]:
        """Return the names of the fitted numbers."""
        return tuple(self.names[i] for i in self.free)

    def start(self) -> Array:
        """Return the stated values of the fitted numbers ``(u,)``."""
        return self.values[self.free]

    def whole(self, unknowns: Array) -> Array:
        """Return all numbers ``(K,)``, with ``unknowns`` ``(u,)`` as the values of the fitted numbers."""
        values = self.values.copy()
        values[self.free] = unknowns
        return values

    def residual(self, unknowns: Array) -> Array:
        """Return stated minus current values in standard uncertainties, for the fitted numbers of finite uncertainty.

        Args:
            unknowns: Current values of all fitted numbers.
        """
        return np.asarray(((self.start() - unknowns) / self.std[self.free])[self._known])

    def jacobian(self) -> Array:
        """Return the whitened derivatives of the numbers in `residual` with respect to all fitted numbers."""
        return np.asarray(np.diag(1.0 / self.std[self.free])[self._known])


def worked_out(question: Callable[[Any], Answer]) -> Answer:
    """Return the method ``question`` as a cached property, for an attribute that the base class declares.

    To type checkers the property is a plain attribute.
    """
    return cast(Answer, cached_property(question))


class Observations:
    """A data set of any kind of measurement: rows that can be selected, grouped, and compared with a model.

    A row is what was measured at one joint vector. The defaults here suit most kinds: a split may fall anywhere, and
    each row gives one miss (measured minus predicted readings). A kind defines its misses, and their derivatives with
    respect to the arm and to the numbers of its instrument. The equations of the misses come first, then the equations
    of the numbers' stated values, then further equations among the numbers (`bonds`).

    Attributes:
        joints: Joints ``(N, n)``, rad or m.
        conditions: Payload, temperature and torques, where known.
        source: Origin of the data, for messages.
        kind: Name of the kind.
        origins: File and line of each row; None if the rows come from no file.
        framed: Whether the instrument has a frame; without one the arm's base pose cannot be determined.
        sized: Whether the data involve a known length; without one the arm's size cannot be determined.
        per_row: Names of the arrays that hold one entry per row, beside the joints.
        width: Number of equations of each miss.
        miss_unit: Unit of `misses` on screens: "mm" for metres, "deg" for radians.
        rounding: Largest change of a reading, in m, rad or px, by rounding it to 0.01 mm or 0.001 deg. An instrument
            that rounds in this way is taken to scatter by three times this change. A pose that is measured again then
            gives the same reading with a probability of 0.2.
        stations: The `InstrumentStation` of each data set, if several are stacked for one fit (`Stacked`); else empty.
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
        """The rows as `Measurements` (tool poses or positions in one instrument's frame); None for other kinds."""

    @property
    def views(self) -> Any:
        """The rows as `PixelObservations` (pictures of one camera); None for other kinds."""

    @property
    def parts(self) -> tuple[Observations, ...]:
        """The data sets of the stations; without stations, this data set alone."""
        return (self,)

    @cached_property
    def numbers(self) -> Stated:
        """The K numbers that describe the instrument, such as a wire's zero; by default there are none."""
        return Stated((), np.zeros(0), np.zeros(0), np.zeros(0))

    def missed(self, model: ArmModel, numbers: Array) -> Array:
        """Return measured minus predicted readings ``(R, m)``: R misses of m components each.

        Args:
            model: The arm.
            numbers: All of the instrument's numbers ``(K,)``, exact and fitted ones.
        """
        raise NotImplementedError

    def whitened(self, model: ArmModel, numbers: Array) -> Array:
        """Return measured minus predicted readings, in standard uncertainties ``(R, m)``.

        The arguments are those of `missed`.
        """
        return np.asarray(self.missed(model, numbers) / self.std)  # type: ignore[attr-defined]

    def derivatives(self, model: ArmModel, numbers: Array) -> tuple[Array, Array]:
        """Return the derivatives of the predicted readings, in standard uncertainties.

        Args:
            model: The arm.
            numbers: All of the instrument's numbers ``(K,)``.

        Returns:
            Derivatives with respect to the arm's P parameters ``(..., P)`` and to the numbers ``(..., K)``. The leading
            axes run over the readings.
        """
        raise NotImplementedError

    def bonds(self, numbers: Array) -> tuple[Array, Array]:
        """Return G further equations among the instrument's numbers; by default there are none.

        Args:
            numbers: All of the instrument's numbers ``(K,)``.

        Returns:
            Whitened residual ``(G,)`` and derivatives ``(G, K)``.
        """
        return np.zeros(0), np.zeros((0, len(numbers)))

    def readings(self) -> Array:
        """Return readings ``(N, k)`` in the kind's unit; rows with equal readings and equal joints are repetitions."""
        raise NotImplementedError

    def from_the_first(self, model: ArmModel, unknowns: Array) -> Any:
        """Return the rows as `Measurements`, or None if they are of another kind.

        Rows of several stations are returned as the first station would have measured them.

        Args:
            model: The arm.
            unknowns: Values of the data's own unknowns, in the order of `unknowns`.
        """
        return self.poses

    def rough_poses(self, prismatic: tuple[bool, ...]) -> Any:
        """Return poses or positions (`Measurements`) that start a fit, computed from the rows without a fit of the arm.

        The result is None if the kind gives no such poses.

        Args:
            prismatic: Whether each joint is prismatic.
        """
        return self.poses

    def span(self, tool: Array) -> float:
        """Return a size to compare `misses` with: the spread of the tool positions, m, or 1 rad for directions.

        Args:
            tool: Tool positions ``(N, 3)``, m.
        """
        return 1.0 if self.miss_unit == "deg" else float(np.linalg.norm(tool.std(axis=0)))

    def fingerprint(self) -> str:
        """Return one hash over joints and readings together, which a calibration records."""
        return hash_of(self.joints, self.readings())

    def by_tool(self, model: ArmModel, unknowns: Array) -> Array:
        """Return the whitened derivatives of the equations with respect to the tool's pose ``(E, 6)``.

        The pose is in the last link's frame. Its changes are in the last link's axes, m and rad.
        """
        return self.jacobian(model, unknowns)[0][:, [name.startswith("tool_") for name in model.parameter_names]]

    def channels_of(self, other: Observations) -> Rows:
        """Return the indices, from 0, of this data set's channels that ``other`` has too; by default all.

        A channel holds readings of one unit and one uncertainty.

        Args:
            other: Other rows of the same instruments.
        """
        return np.arange(int(self.equations()[1].max(initial=-1)) + 1)

    def weighed(self, scales: Array) -> Self:
        """Return the data set with its stations weighed by their scatter; a data set of one station is unchanged.

        Args:
            scales: Scatter of each of the C channels ``(C,)``, in stated standard uncertainties. A channel holds
                readings of one unit and one uncertainty.
        """
        return self

    def unknowns(self) -> tuple[str, ...]:
        """Return the names of the kind's own unknowns: the numbers that are not known exactly."""
        return self.numbers.unknowns()

    def tolerances(self) -> Array:
        """Return the scale of each unknown's deviation, in the unknown's unit (lengths: m)."""
        return self.numbers.scales[self.numbers.free]

    def start(self, model: ArmModel) -> Array:
        """Return starting values of the unknowns, in closed form for this arm; by default the stated values."""
        return self.numbers.start()

    @property
    def groups(self) -> Rows:
        """Number, from 0, of each row's group ``(N,)``, such as its socket; by default all rows are group 0.

        A split holds out a share of every group.
        """
        return np.zeros(len(self.joints), dtype=np.int64)

    @property
    def rows_of_misses(self) -> Rows:
        """Index, from 0, of the row that each of the R `misses` belongs to ``(R,)``; by default a row has one miss."""
        return np.arange(len(self.joints))

    def equations(self) -> tuple[Rows, Rows]:
        """Return the row and the channel of each equation of `residual`, both as indices from 0 ``(E,)``.

        The row is -1 if an equation belongs to no row. A channel holds readings of one unit and one uncertainty;
        positions and attitudes of poses are two channels. By default all equations are in channel 0. The equations of
        the misses come first. The equations of the instrument's numbers follow; they belong to no row.
        """
        extra = len(self.numbers.jacobian()) + len(self.bonds(self.numbers.values)[0])
        rows = np.concatenate([np.repeat(self.rows_of_misses, self.width), np.full(extra, -1)])
        return rows, np.zeros(len(rows), dtype=np.int64)

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Return the R misses of the data, that is measured minus predicted readings.

        Misses are positions ``(R, 3)`` or lengths ``(R, 1)``, m, or directions ``(R, k)``, rad.

        Args:
            model: The arm.
            unknowns: Values of the data's own unknowns, in the order of `unknowns`.
        """
        return self.missed(model, self.numbers.whole(unknowns))

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Return whitened residuals ``(E,)``: misses, the numbers' stated values, and further equations (`bonds`)."""
        numbers = self.numbers.whole(unknowns)
        statements = self.numbers.residual(unknowns)
        return np.concatenate([self.whitened(model, numbers).ravel(), statements, self.bonds(numbers)[0]])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Return minus the derivatives of `residual`, by arm parameters ``(E, 5n + 12 + k)`` and unknowns ``(E, u)``.

        The arm has 5n + 12 geometric parameters and k coefficients of terms.
        """
        numbers, free = self.numbers.whole(unknowns), self.numbers.free
        by_arm, by_numbers = self.derivatives(model, numbers)
        by_arm = by_arm.reshape(-1, by_arm.shape[-1])
        by_numbers = by_numbers.reshape(len(by_arm), -1)
        extra = np.concatenate([self.numbers.jacobian(), self.bonds(numbers)[1][:, free]])
        by_arm = np.concatenate([by_arm, np.zeros((len(extra), by_arm.shape[1]))])
        return by_arm, np.ascontiguousarray(np.concatenate([by_numbers[:, free], extra]))

    def select(self, rows: ArrayLike) -> Self:
        """Return the data set of only the given rows (indices or a mask)."""
        rows = np.asarray(rows)
        changed = {"conditions": self.conditions.select(rows), "origins": origins_of(self).select(rows)}
        return replace(self, joints=self.joints[rows], **changed, **self._arrays(rows))  # type: ignore[type-var]

    def at_most(self, rows: int) -> Self:
        """Return the data set of at most this number of rows, equally spaced."""
        return self.select(equally_spaced(len(self.joints), rows))

    def imagined(self, joints: Array) -> Self:
        """Return a data set of the same instrument at other joints ``(M, n)``, rad or m.

        Its readings are placeholders, repeated from this data set.
        """
        rows = np.resize(np.arange(len(self.joints)), len(joints))
        alike = replace(self.conditions.select(rows), payload=None, temperature=None, torque=None)
        return replace(self, joints=joints, conditions=alike, origins=None, **self._arrays(rows))  # type: ignore[type-var]

    def _arrays(self, rows: NDArray[Any]) -> dict[str, Any]:
        """Return the given rows of every array that holds one entry per row, by name."""
        values = {name: getattr(self, name) for name in self.per_row}
        return {name: None if value is None else value[rows] for name, value in values.items()}


def hash_of(*parts: Array) -> str:
    """Return one hash over all arrays, rounded to 1e-9 m or rad; a copy read from a CSV file has the same hash."""
    integers = [np.rint(part * 1e9).astype(np.int64) for part in parts]
    return hashlib.sha256(b"".join(part.tobytes() for part in integers)).hexdigest()[:16]


def origins_of(data: Observations) -> Origins:
    """Return the file and line of each row; rows that come from no file are counted from 1."""
    count = len(data.joints)
    return data.origins or Origins((data.source,), np.zeros(count, dtype=np.int64), np.arange(1, count + 1))


def point_jacobian(pose_jacobian: Array, lever: Array) -> Array:
    """Return the jacobian ``(..., 3, P)`` of a point that is fixed to the tool.

    Args:
        pose_jacobian: Jacobian of the tool's pose ``(..., 6, P)``.
        lever: Vector from the tool's origin to the point ``(..., 3)``, m, world axes.
    """
    turn = pose_jacobian[..., 3:, :]
    return np.asarray(pose_jacobian[..., :3, :] + np.cross(turn, lever[..., :, None], axis=-2))


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotations nearest to matrices ``(..., 3, 3)`` (orthogonal Procrustes with positive determinant)."""
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
"""Number of contiguous blocks of rows; each block is held out once when errors are judged by blocks."""


SAME_POSE = 2e-4
"""Largest difference of joints that count as one pose, rad or m. Arms resolve 0.01 deg. Joints of a pose that is
reached again, or written with two decimals, differ by less."""

PATH = 10 * SAME_POSE
"""Extent of a chain of near rows, rad or m, above which the chain is a slowly followed path and not a pose."""


def equally_spaced(rows: int, most: int) -> Rows:
    """Return the indices, from 0, of at most ``most`` of ``rows`` rows, equally spaced."""
    return np.unique(np.linspace(0, rows - 1, most).astype(int))


def same_poses(joints: Array) -> Rows:
    """Return the number of each row's pose ``(N,)``; poses are numbered from 0 in the order of their first rows.

    Rows whose joints all differ by `SAME_POSE` or less are of one pose. A chain of such rows is one pose, too. A chain
    that extends over more than `PATH` is a slow path rather than a pose; it is cut into cells of `SAME_POSE`.

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
    """Return the number of different poses among rows with joints ``(N, n)``, rad or m."""
    return len(np.unique(same_poses(joints)))


def random_split(poses: Rows, test_rows: int, rng: np.random.Generator) -> tuple[Rows, Rows]:
    """Shuffle the poses and hold out the last ones, with about ``test_rows`` rows.

    Args:
        poses: The pose of each row ``(N,)``, as `same_poses` numbers them.
        test_rows: Number of rows to hold out; it is met exactly if no pose is repeated.
        rng: Shuffles the poses.

    Returns:
        Indices, from 0, of the training rows and of the held-out rows.

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
    """Draw the training rows and the held-out rows of one data set.

    Every socket and every station has held-out rows and training rows. Either all rows of a pose are held out or all
    are trained on, also if several stations measured this pose.

    Args:
        observations: The data.
        test_rows: Number of rows to hold out; None for a fifth of the rows.
        rng: Draws the split.

    Returns:
        Indices, from 0, of the training rows and of the held-out rows.

    Raises:
        InputError: If ``test_rows`` leaves nothing to train on, or nothing to test. Also if a socket or station would
            keep fewer than two training rows.
    """
    count = len(observations.joints)
    most = max(1, count // 5) if test_rows is None else test_rows
    poses = same_poses(observations.joints)
    _check(poses, most)
    if not observations.groups.any():
        return random_split(poses, most, rng)
    home = home_groups(observations.groups, poses)
    splits = []
    for number in np.unique(home):
        rows = np.flatnonzero(home == number)
        share = max(1, round(most * len(rows) / count))
        if len(rows) - share < 2:
            raise InputError(
                f"{observations.source}: socket or station {number + 1} has {len(rows)} rows, too few to hold "
                f"{share} of them out"
            )
        split = random_split(np.unique(poses[rows], return_inverse=True)[1], share, rng)
        splits.append([rows[part] for part in split])
    train, test = map(np.concatenate, zip(*splits, strict=True))
    return train, test


def blocked_split(poses: Rows, test_rows: int | None = None) -> tuple[Rows, Rows]:
    """Hold out two contiguous runs of poses, centred at 35 % and 75 % of all poses.

    By default a fifth of the rows is held out, and the runs are blocks 3 and 7 of ten, counted from 0.

    Args:
        poses: The pose of each row ``(N,)``, as `same_poses` numbers them.
        test_rows: Number of rows to hold out in all, met exactly if no pose is repeated; None for a fifth of the rows.

    Returns:
        Indices, from 0, of the training rows and of the held-out rows, both ascending.

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
    held_out = np.isin(poses, [*range(begin[0], begin[0] + first), *range(begin[1], begin[1] + second)])
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def contiguous_folds(groups: Rows, poses: Rows, folds: int) -> list[tuple[Rows, Rows]]:
    """Cut the poses of each group into as many contiguous parts as there are folds; fold i holds out part i of each.

    Args:
        groups: Group of each row ``(N,)``, such as its socket or station.
        poses: The pose of each row ``(N,)``, as `same_poses` numbers them.
        folds: Number of folds. If the largest group has fewer poses, there are only as many folds as it has poses, so
            that no fold is empty. If every group has one pose, all count as one group.

    Returns:
        Indices, from 0, of the training rows and of the held-out rows, for each fold.

    Raises:
        InputError: If there are fewer than two folds, or fewer poses than folds.
    """
    count = int(poses.max(initial=-1)) + 1
    if not 2 <= folds <= count:
        raise InputError(
            f"{len(poses)} rows of {count} poses cannot be cut into {folds} folds; measure at least {max(folds, 2)}"
        )
    home, fold_of = home_groups(groups, poses), np.zeros(count, dtype=int)
    members = [np.unique(poses[home == number]) for number in np.unique(home)]
    if max(map(len, members)) < 2:
        members = [np.arange(count)]
    folds = min(folds, max(map(len, members)))
    for group in members:
        for i, part in enumerate(np.array_split(group, folds)):
            fold_of[part] = i
    fold = fold_of[poses]
    return [(np.flatnonzero(fold != i), np.flatnonzero(fold == i)) for i in range(folds)]


def home_groups(groups: Rows, poses: Rows) -> Rows:
    """Return, for each row, the group of the first row of the same pose ``(N,)``.

    All rows of a pose then have one group, so a split by groups keeps poses whole.

    Args:
        groups: Group of each row ``(N,)``.
        poses: The pose of each row ``(N,)``, as `same_poses` numbers them.
    """
    return np.asarray(groups[np.unique(poses, return_index=True)[1]][poses])


def _check(poses: Rows, test_rows: int) -> None:
    """Raise an `InputError` unless there are two poses or more and ``test_rows`` leaves rows to train on and to test.

    Args:
        poses: The pose of each row ``(N,)``, as `same_poses` numbers them.
        test_rows: Number of rows to hold out.
    """
    rows, count = len(poses), len(np.unique(poses))
    if count < 2:
        rows_in_words = "is 1 row" if rows == 1 else f"are {rows} rows of one pose" if rows else "is 0 row"
        raise InputError(f"there {rows_in_words}, and none can be both trained on and held out; measure more poses")
    if not 0 < test_rows < rows:
        raise InputError(f"{test_rows} test rows of {rows} leave nothing to train on or to test; give 1 to {rows - 1}")
