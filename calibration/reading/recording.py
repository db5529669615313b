"""Recordings: a joint log and an instrument's log, each with its own clock, become rows like those of an arm at rest.

The clocks are compared twice. First the speeds of the nominal tool and of the readings are correlated over all lags
(Furrer et al. 2017). Then offset and rate are unknowns of the same least squares as the arm's parameters, with the
joints' velocities in their derivatives: an arm that errs does not pull them. SI units; times in seconds.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from pickenv.arm import Array, Geometry, forward
from pickenv.base import TO_SI, InputError, listed
from pickenv.calibration.identification.least_squares import Identification, identify, unknowns_of
from pickenv.calibration.identification.robust import MISFIT, OUTLIER_SIGMA, SPAN, rough_start, sigma_of
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.arm_model import ArmModel, complete_model, frames_model
from pickenv.calibration.model.observations import Clocks, Observations, Rows, equally_spaced, worked_out
from pickenv.calibration.model.prior import prior_model
from pickenv.calibration.reading import csv_table, description, kind_readers
from pickenv.calibration.reading.bag_table import read_log
from pickenv.calibration.reading.csv_table import Table

STEM = "{file}"
"""Placeholder in the joint log's name: the instrument file's name without its ending, or a bag folder's whole name."""

LEAST_SAMPLES = 50
"""Fewest samples of an instrument, within the joint log, that tell the clocks."""

CHORD = 0.1
"""Speeds are taken over this time, s: short beside a motion, long beside the noise of two samples."""

LEAST_OVERLAP, LEAST_CORRELATION = 0.3, 0.4
"""Least share of the shorter log that must overlap, and least correlation of speeds, at an offset worth a trial."""

PEAKS, CLEAR = 5, 0.7
"""Offsets tried by fits; and the best one's median misfit must lie below this share of any other's."""

TRIED, FITTED = 300, 1500
"""Most samples with which an offset is tried, and with which the clocks are fitted."""

RATE_STD = 2e-4
"""Expected relative difference of two clocks' rates; crystals keep 100 parts in a million."""

STEP = 1e-3
"""Time over which readings are differentiated, s."""

REST, SETTLING = 0.4, 0.3
"""Shortest rest that gives a row, and the time before it in which the arm may still swing, s."""

SPREADS, FINEST, COARSEST = 8.0, 2e-5, 3e-3
"""Resting joints stay within so many standard deviations of the log's noise, and between these bounds, rad or m."""

PATH, MOST_ROWS = 0.02, 2000
"""Way of the joints between two rows of motion, rad or m together, and the most rows of motion."""

Read = Callable[[Table, description.DescriptionFile], Observations]
"""Reads a table of joints and readings by its description, as if an arm at rest had been measured."""


@dataclass(frozen=True, eq=False)
class Timed(Observations):
    """Rows whose joints depend on two further unknowns: the offset and the rate of the instrument's clock.

    Attributes:
        rows: The rows at the first guess of the clocks.
        times: Time of each row on the instrument's clock ``(N,)``, s, from the middle of the recording.
        joints_at: Joints ``(N, n)`` at times on the joint log's clock ``(N,)``, from the same middle.
    """

    rows: Observations
    times: Array
    joints_at: Callable[[Array], Array]

    # What the rows say at the first guess of the clocks.
    conditions = worked_out(attrgetter("rows.conditions"))
    framed = worked_out(attrgetter("rows.framed"))
    joints = worked_out(attrgetter("rows.joints"))
    kind = worked_out(attrgetter("rows.kind"))
    origins = worked_out(attrgetter("rows.origins"))
    sized = worked_out(attrgetter("rows.sized"))
    source = worked_out(attrgetter("rows.source"))

    def at(self, clock: Array) -> Observations:
        """The rows with the joints that belong to a clock's offset, s, and relative rate ``(2,)``."""
        return replace(self.rows, joints=self.joints_at(self.times / (1.0 + clock[1]) - clock[0]))  # type: ignore[type-var]

    def unknowns(self) -> tuple[str, ...]:
        """Names of the rows' own unknowns, then of the clock's two."""
        return (*self.rows.unknowns(), "clock_offset", "clock_rate")

    def tolerances(self) -> Array:
        """Scales of the unknowns."""
        return np.concatenate([self.rows.tolerances(), [1e-3, 1e-5]])

    def start(self, model: ArmModel) -> Array:
        """Starting values of the rows' own unknowns, and zero for the clock's."""
        return np.concatenate([self.rows.start(model), np.zeros(2)])

    def equations(self) -> tuple[Rows, Rows]:
        """Row and channel of each equation; the last one, of the rate, belongs to no row."""
        rows, channels = self.rows.equations()
        return np.r_[rows, -1], np.r_[channels, 0]

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Whitened residual of the rows, then of the expected rate."""
        own, clock = np.split(unknowns, [-2])
        return np.concatenate([self.at(clock).residual(model, own), -clock[1:] / RATE_STD])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Whitened derivatives by the arm, and by the unknowns; the clock's come from the joints' velocities."""
        own, clock = np.split(unknowns, [-2])
        rows = self.at(clock)
        by_arm, by_own = rows.jacobian(model, own)
        by_offset = -self.drift(model, unknowns)
        times = np.where(rows.equations()[0] >= 0, self.times[rows.equations()[0]], 0.0)
        by_clock = np.stack([by_offset, by_offset * times / (1.0 + clock[1]) ** 2], -1)
        by_unknowns = np.vstack([np.hstack([by_own, by_clock]), np.zeros(by_own.shape[1] + 2)])
        by_unknowns[-1, -1] = 1.0 / RATE_STD
        return np.vstack([by_arm, np.zeros(by_arm.shape[1])]), by_unknowns

    def drift(self, model: ArmModel, unknowns: Array) -> Array:
        """Change of the rows' whitened residual ``(E,)`` per second of the clock's offset."""
        own, clock = np.split(unknowns, [-2])
        late, early = (self.at(clock + np.array([step, 0.0])).residual(model, own) for step in (STEP, -STEP))
        return np.asarray((late - early) / (2.0 * STEP))

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Misses of the rows with the clock's unknowns."""
        own, clock = np.split(unknowns, [-2])
        return self.at(clock).misses(model, own)

    def select(self, rows: Any) -> Self:
        """The given rows (indices or a mask) alone."""
        return replace(self, rows=self.rows.select(rows), times=self.times[np.asarray(rows)])


@dataclass(frozen=True, eq=False)
class Logs:
    """An instrument's samples and a joint log.

    Attributes:
        table: The instrument's file, without samples that were lost.
        layout: Its description.
        geometry: The arm's nominal geometry.
        times: Time of each sample on the instrument's clock ``(T,)``, s, from the first one.
        values: Columns of the instrument's file that are read, and their numbers ``(T, k)``, in the file's units.
        log: Time of each entry of the joint log ``(M,)``, s, from the first one.
        joints: Joints of each entry ``(M, n)``, rad or m.
        entries: Columns of the joint log that are read, and their numbers ``(M, j)``, in the file's units.
        first: First time of the instrument's clock, s.
        began: First time of the instrument's clock minus that of the joint log's, s.
    """

    table: Table
    layout: description.DescriptionFile
    geometry: Geometry
    times: Array
    values: tuple[tuple[str, ...], Array]
    log: Array
    joints: Array
    entries: tuple[tuple[str, ...], Array]
    first: float
    began: float

    @cached_property
    def spline(self) -> CubicSpline:
        """The joint log's numbers over time, in the file's units."""
        return CubicSpline(self.log, self.entries[1])

    @cached_property
    def joint_spline(self) -> CubicSpline:
        """The joints over time, rad or m."""
        return CubicSpline(self.log, self.joints)

    def covered(self, times: Array) -> NDArray[np.bool_]:
        """Which times on the joint log's clock ``(T,)`` lie within it, and in none of its gaps."""
        steps = np.diff(self.log)
        place = np.clip(np.searchsorted(self.log, times) - 1, 0, len(steps) - 1)
        inside = (times >= self.log[0]) & (times <= self.log[-1])
        return np.asarray(inside & (steps[place] <= np.maximum(5.0 * np.median(steps), STEP)))

    def rows(self, times: Array, groups: Sequence[Rows]) -> Table:
        """A table with one row per group of samples: the means of their readings, and of the joints at their times."""
        names, values = self.values
        rotation = self.layout.rotation
        turned = np.isin(names, () if rotation is None else rotation.columns)
        means, joints, lines = [], [], []
        for group in groups:
            part, middle = values[group], group[len(group) // 2]
            # Angles that jump by a turn would average to nonsense: only those like the middle one are averaged.
            alike = np.abs(part - values[middle])[:, turned] <= 0.5 * np.ptp(values[:, turned], axis=0)
            means.append(np.where(turned, part[alike.all(axis=1)].mean(axis=0), part.mean(axis=0)))
            joints.append(self.spline(times[group]).mean(axis=0))
            lines.append(self.table.lines[middle])
        return _table(self.table.where, (*self.entries[0], *names), np.c_[np.stack(joints), np.stack(means)], lines)


def _table(where: str, names: tuple[str, ...], numbers: Array, lines: list[int]) -> Table:
    table = Table(where, list(names), [[] for _ in lines], lines, ".")
    table.cache = dict(zip(names, numbers.T, strict=True))
    return table


def read_recording(
    table: Table, path: Path, layout: description.DescriptionFile, where: str, geometry: Geometry, read: Read
) -> tuple[Table, description.DescriptionFile, Clocks]:
    """Turn an instrument's log and its joint log into rows of an arm at rest, or, if it hardly rested, of its motion.

    Args:
        table: The instrument's log.
        path: Its file.
        layout: Its description, with [recording].
        where: Name of the description, for messages.
        geometry: The arm's nominal geometry.
        read: Reads rows as if the arm had been at rest.

    Returns:
        The rows, the description with the uncertainty that they have, and what was found of the clocks.

    Raises:
        InputError: If a time is out of order, the logs do not belong together, or nothing tells their offset.
    """
    logs = _logs(table, path, layout, where, geometry)
    timed, found, first, middle = _first_guess(logs, read)
    sure = sigma_of(found, timed) <= OUTLIER_SIGMA
    model = prior_model("recording", found.geometry, known=False)
    timed = timed.select(sure)
    solution = solve(model, timed)
    std = dict(zip(solution.identifiability.names, solution.standard_deviation, strict=True))
    offset, rate = (solution.unknowns[name] for name in ("clock_offset", "clock_rate"))
    times = middle - first + (logs.times - middle) / (1.0 + rate) - offset
    usable = np.flatnonzero(logs.covered(times))
    rests = _rests(logs, times, usable)
    equations = len(timed.rows.equations()[0]) / len(timed.joints)
    unknowns = len(complete_model(geometry).names) + len(timed.rows.unknowns())
    still = len(rests) * equations >= 2 * unknowns
    groups = rests if still else _thinned(logs, times, usable)
    error = float(std["clock_offset"])
    clocks = Clocks(
        table.where,
        logs.first + middle,
        logs.began + first + offset,
        error,
        rate,
        float(std["clock_rate"]),
        RATE_STD,
        still,
        len(groups),
    )
    if not still:
        drift = timed.drift(solution.arm_model, unknowns_of(solution, timed)) * error
        channels = timed.rows.equations()[1]
        layout = _with_std(
            logs.layout, [np.sqrt(1.0 + np.mean(drift[channels == i] ** 2)) for i in np.unique(channels)]
        )
    return logs.rows(times, groups), logs.layout if still else layout, clocks


def _with_std(layout: description.DescriptionFile, factors: list[float]) -> description.DescriptionFile:
    """The description with stated uncertainties times the factor of their channel: readings, then attitudes."""
    measured = layout.measured
    if measured.std is not None:
        layout = replace(layout, **{layout.kind: replace(measured, std=measured.std * factors[0])})
    if layout.rotation is not None and len(factors) > 1:
        layout = replace(layout, rotation=replace(layout.rotation, std=layout.rotation.std * factors[1]))
    return layout


def _logs(table: Table, path: Path, layout: description.DescriptionFile, where: str, geometry: Geometry) -> Logs:
    """Both logs, with times checked and lost samples left out."""
    told = layout.recording
    assert told is not None
    home = path.parent / told.joints.replace(STEM, path.name if path.is_dir() else path.stem)
    log = read_log(home, told.joints_topic, layout.separator, layout.decimal)
    torques = () if layout.conditions.torques is None else layout.conditions.torques.columns
    columns = (*layout.joint_columns, *torques)
    if told.joints_topic is not None:
        log = _complete(log, columns)
    recorded = layout.conditions.recorded(layout.joint_units)
    further = [name for key, (columns, *_) in recorded.items() if key != "torque" for name in columns]
    rotation = () if layout.rotation is None else layout.rotation.columns
    names = (*layout.columns, *rotation, *further)
    table = _seen(table, layout, names)
    if layout.reflectors is not None:
        layout = replace(layout, reflectors=replace(layout.reflectors, lost=()))
    stamps, entries = _times(table, told.time, told.unit), _times(log, told.joints_time, told.joints_unit)
    joints = kind_readers.read_joints(log, layout, where, geometry)
    jumps = np.abs(np.diff(joints, axis=0)) > np.pi
    if jumps[:, ~np.array(geometry.prismatic)].any():
        row, joint = np.argwhere(jumps)[0]
        place = log.cell(row + 1, layout.joint_columns[joint])
        raise InputError(f"{place} jumps by more than half a turn; write the joints without jumps of 360 deg")
    return Logs(
        table,
        layout,
        geometry,
        stamps - stamps[0],
        (names, table.values(names)),
        entries - entries[0],
        joints,
        (columns, log.values(columns)),
        float(stamps[0]),
        float(stamps[0] - entries[0]),
    )


def _seen(table: Table, layout: description.DescriptionFile, names: tuple[str, ...]) -> Table:
    """The table without samples that have an empty cell or lie at 0, 0, 0: those that the instrument lost."""
    lost = np.zeros(len(table.lines), dtype=bool)
    for name in {part for text in names for part in _plain(text, table.header)}:
        lost |= table.fill_blanks(name)
    if layout.kind in ("position", "reflectors"):
        places = table.values(layout.columns).reshape(len(lost), -1, 3)
        lost |= (places == 0.0).all(axis=2).any(axis=1)
    rows = np.flatnonzero(~lost).tolist()
    if len(rows) < LEAST_SAMPLES:
        raise InputError(f"{table.where} has {len(rows)} samples; a recording needs at least {LEAST_SAMPLES}")
    return table.select(rows)


def _complete(log: Table, names: tuple[str, ...]) -> Table:
    """The messages of a joint log that have all these columns, without those of a gripper alone."""
    lacking = np.zeros(len(log.lines), dtype=bool)
    for name in {part for text in names for part in _plain(text, log.header)}:
        lacking |= np.array([not cell for cell in log.texts(name)])
    if lacking.all():
        raise InputError(f"no message of {log.where} has all of {listed(names)}; record a topic where one has them all")
    return log.select(np.flatnonzero(~lacking).tolist())


def _plain(text: str, header: list[str]) -> Iterator[str]:
    """The columns of a file that an expression is computed from."""
    tree, quoted = csv_table.expression_tree(text)
    words = [] if tree is None else [node.id for node in ast.walk(tree) if isinstance(node, ast.Name)]
    yield from (name for name in (text, *words, *quoted) if name in header)


def _times(table: Table, name: str, unit: str) -> Array:
    """The times of a log ``(T,)``, s, in strictly rising order."""
    times = table.value(name) * description.SECONDS[unit]
    steps = np.diff(times)
    if len(times) < 4:
        raise InputError(f"{table.where} has {len(times)} rows; a log needs at least 4")
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        fault = "repeats the time before it" if steps[row - 1] == 0 else "lies before the time above it"
        raise InputError(f"{table.cell(row, name)} {fault}; give a log in the order of its clock, each time once")
    return np.asarray(times)


# The clocks, roughly: at which lag do the speeds of tool and readings agree?


def _speeds(logs: Logs) -> tuple[Array, Array, float]:
    """Speeds of the nominal tool and of the readings, each over its own log, and the time between two of them, s.

    With attitudes they are angular, else linear; both are the same from any base, and nearly so for any tool.
    """
    step = max(float(np.median(np.diff(logs.times))), float(np.median(np.diff(logs.log))), 2e-3)
    width = max(round(CHORD / step), 2)
    ends = [np.arange(0.0, times[-1], step) for times in (logs.log, logs.times)]
    tool = forward(logs.geometry, logs.joint_spline(ends[0]))
    names, values = logs.values
    layout = logs.layout
    if layout.rotation is not None and layout.rotation.convention is not None:
        first = names.index(layout.rotation.columns[0])
        columns = values[:, first : first + len(layout.rotation.columns)] * TO_SI[layout.rotation.checked_unit()]
        seen = Slerp(logs.times, Rotation.from_matrix(csv_table.rotations(layout.rotation.convention, columns)))
        turns = [Rotation.from_matrix(tool.rotation), seen(ends[1])]
        pair = [np.asarray((turn[:-width].inv() * turn[width:]).magnitude()) for turn in turns]
    else:
        readings = values[:, : len(layout.columns)]
        read = np.stack([np.interp(ends[1], logs.times, column) for column in readings.T], -1)
        pair = [np.asarray(np.linalg.norm(part[width:] - part[:-width], axis=1)) for part in (tool.position, read)]
    if min(map(len, pair)) < 10:
        raise InputError(f"{logs.table.where}: the recording is too short to compare its clocks; record for a minute")
    return pair[0], pair[1], step


def _lags(one: Array, other: Array) -> tuple[Array, Array]:
    """The correlation of two signals at every lag, and the number of samples that overlap there.

    Entry k is of ``one[i]`` with ``other[i - k + len(other) - 1]``.
    """
    size = next_fast_len(len(one) + len(other) - 1, real=True)
    one, other = (part - part.mean() for part in (one, other))

    def summed(left: Array, right: Array) -> Array:
        product = irfft(rfft(left, size) * rfft(right[::-1], size), size)
        return np.asarray(product[: len(one) + len(other) - 1])

    here, there = np.ones(len(one)), np.ones(len(other))
    count = np.maximum(np.rint(summed(here, there)), 1.0)
    left, right = summed(one, there), summed(here, other)
    varied = (summed(one**2, there) - left**2 / count) * (summed(here, other**2) - right**2 / count)
    floor = 1e-9 * (one @ one) * (other @ other)
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = (summed(one, other) - left * right / count) / np.sqrt(np.maximum(varied, 0.0))
    return np.where(varied > floor, np.clip(alike, -0.999999, 0.999999), 0.0), count


def _peaks(logs: Logs) -> list[float]:
    """Time of the instrument's first sample on the joint log, s from its first entry, at the lags worth a trial."""
    one, other, step = _speeds(logs)
    where = logs.table.where
    if np.ptp(one) < 1e-6 or np.ptp(other) == 0.0:
        raise InputError(f"{where}: nothing moves, so that nothing tells the clocks' offset; record a motion")
    alike, count = _lags(one, other)
    alike = np.where(count >= LEAST_OVERLAP * min(len(one), len(other)), alike, 0.0)
    weight = np.arctanh(alike) * np.sqrt(count)
    apart, peaks = round(2.0 * CHORD / step) + 1, []
    for _ in range(PEAKS):
        best = int(np.argmax(weight))
        if alike[best] < LEAST_CORRELATION:
            break
        peaks.append((best - len(other) + 1) * step)
        weight[max(best - apart, 0) : best + apart + 1] = -np.inf
    if not peaks:
        raise InputError(
            f"{where}: at no offset of the clocks do its speeds follow those of the joint log; check that both record "
            "the same motion, and the units of time and joints"
        )
    return peaks


def _timed(logs: Logs, start: float, most: int, read: Read) -> tuple[Timed, float, float] | None:
    """Up to ``most`` samples with the joints of a guess of the clocks, that guess, and the middle of the times."""
    times = logs.times + start
    usable = np.flatnonzero(logs.covered(times))
    if len(usable) < LEAST_SAMPLES:
        return None
    some = usable[equally_spaced(len(usable), most)]
    rows = read(logs.rows(times, [np.array([sample]) for sample in some]), logs.layout)
    middle = float(logs.times[usable].mean())

    def joints_at(moments: Array) -> Array:
        return np.asarray(logs.joint_spline(np.clip(moments + middle + start, 0.0, logs.log[-1])))

    return Timed(rows, logs.times[some] - middle, joints_at), -start, middle


def _first_guess(logs: Logs, read: Read) -> tuple[Timed, Identification, float, float]:
    """Samples, the fit of frames and clocks, the first guess of the offset, and the middle of the samples' times.

    Raises:
        InputError: If no offset fits, or another one fits nearly as well.
    """
    tried: list[tuple[float, float, Identification]] = []
    for start in _peaks(logs):
        if (some := _timed(logs, start, TRIED, read)) is None:
            continue
        found = _fitted(logs.geometry, some[0], None)
        misses = some[0].misses(found.arm_model, unknowns_of(found, some[0]))
        tried.append((float(np.median(np.linalg.norm(misses, axis=1))), start, found))
    where = logs.table.where
    if not tried:
        raise InputError(f"{where}: hardly any sample lies within the joint log; record both at the same time")
    tried.sort(key=lambda item: item[0])
    (miss, start, found), *others = tried
    offset = [begun - found.unknowns["clock_offset"] for _, begun, found in tried]
    timed = _timed(logs, offset[0], FITTED, read)
    assert timed is not None
    span = timed[0].rows.span(forward(found.geometry, timed[0].joints).position)
    if miss > MISFIT * max(span, SPAN):
        raise InputError(
            f"{where}: at the best offset of the clocks the arm still misses by {100 * miss / span:.0f} % of its "
            "motion; check the arm, the units, joint order and signs, and that both logs are of one motion"
        )
    for (other, *_), place in zip(others, offset[1:], strict=True):
        if miss > CLEAR * other and abs(place - offset[0]) > CHORD:
            raise InputError(
                f"{where}: two offsets of the clocks, {abs(place - offset[0]):.3g} s apart, fit as well; record a "
                "motion that does not repeat itself"
            )
    return timed[0], _fitted(logs.geometry, timed[0], found.geometry), timed[1], timed[2]


def _fitted(nominal: Geometry, timed: Timed, start: Geometry | None) -> Identification:
    """Base, tool and clocks fitted to samples."""
    start = start or rough_start(nominal, timed.rows)
    return identify(frames_model(nominal), start, [timed], max_iterations=60)


# Which samples make a row: those of a rest together, or single ones on the way.


def _rests(logs: Logs, times: Array, usable: Rows) -> list[Rows]:
    """The samples of each rest of the arm, without the time in which it settles."""
    step = np.median(np.diff(logs.log))
    width = max(round(REST / step), 3)
    if len(logs.log) <= width:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(logs.joints, width, axis=0)
    jerks = np.abs(np.diff(logs.joints, 3, axis=0))
    noise = np.minimum(np.median(jerks, axis=0) / (0.6745 * np.sqrt(20.0)), np.percentile(windows.std(axis=2), 10, 0))
    digit = np.array([np.min(part[part > 0], initial=0.0) if (part > 0).any() else 0.0 for part in jerks.T])
    within = np.clip(np.maximum(SPREADS * noise, 1.5 * np.minimum(digit, noise)), FINEST, COARSEST)
    starts = np.flatnonzero((np.ptp(windows, axis=2) <= within).all(axis=1))
    resting = np.zeros(len(logs.log), dtype=bool)
    for start in starts:
        resting[start : start + width] = True
    edges = np.flatnonzero(np.diff(np.r_[0, resting.astype(int), 0]))
    groups = []
    for first, last in edges.reshape(-1, 2):
        begin, end = logs.log[first] + SETTLING, logs.log[last - 1] - 2.0 * step
        group = usable[(times[usable] >= begin) & (times[usable] <= end)]
        if len(group) >= 3 and end - begin >= REST / 2:
            groups.append(group)
    return groups


def _thinned(logs: Logs, times: Array, usable: Rows) -> list[Rows]:
    """Single samples, each a way of the joints apart from the one before."""
    joints = logs.joint_spline(times[usable])
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(joints, axis=0), axis=1))]
    _, first = np.unique(np.floor(way / max(PATH, way[-1] / MOST_ROWS)), return_index=True)
    return [usable[[i]] for i in first]
