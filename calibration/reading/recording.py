"""Turn recordings into measured rows: a recording is a joint log and an instrument's log, each with its own clock.

The clocks are compared twice. First the speeds of the nominal tool and of the readings are correlated over all lags
(Furrer et al. 2017). Then one least-squares fit identifies the arm's parameters together with offset and rate of the
clocks. The derivatives with respect to offset and rate come from the joint velocities. The arm's errors therefore do
not bias the clocks. SI units; times in seconds.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from pickenv.arm import Array, Geometry, forward
from pickenv.base import TO_SI, InputError, listed
from pickenv.calibration.identification.least_squares import Identification, identify, unknowns_of
from pickenv.calibration.identification.robust import MISFIT, OUTLIER_SIGMA, SPAN, rough_start, sigma_of
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.arm_model import ArmModel, complete_model, frames_model
from pickenv.calibration.model.noise_and_priors import prior_model
from pickenv.calibration.model.observations import Clocks, Observations, Rows, equally_spaced, worked_out
from pickenv.calibration.reading import description, kind_readers, table_files
from pickenv.calibration.reading.table_files import Table, read_log

LEAST_SAMPLES = 50
"""Smallest number of an instrument's samples within the joint log from which the clocks can be identified."""

CHORD = 0.1
"""Time over which speeds are computed, s: shorter than a motion, and long enough to suppress noise."""

LEAST_OVERLAP, LEAST_CORRELATION = 0.3, 0.4
"""Conditions for trying a clock offset: least overlap of the logs, as a share of the shorter log, and least correlation
of the speeds."""

PEAKS, CLEAR = 5, 0.7
"""Largest number of clock offsets that are tried by fits, and a limit on the ratio of two median misfits: of the best
offset, and of any other offset. If a ratio is above this limit, the best offset is ambiguous."""

TRIED, FITTED = 300, 1500
"""Largest numbers of samples: in a fit that tries a clock offset, and in the final fit of the clocks."""

RATE_STD = 2e-4
"""Prior standard deviation of the relative difference of two clocks' rates; crystals keep 100 parts per million."""

STEP = 1e-3
"""Time step of the numerical derivative of residuals by the clock's offset, s."""

REST, SETTLING = 0.4, 0.3
"""Shortest standstill of the arm that gives a row, s, and time after the stop in which the arm may still swing, s."""

SPREADS, FINEST, COARSEST = 8.0, 2e-5, 3e-3
"""A joint rests if the range of its values is at most SPREADS standard deviations of the joint log's noise. This limit
is at least FINEST and at most COARSEST, rad or m."""

PATH, MOST_ROWS = 0.02, 2000
"""Path length in joint space between two rows of a motion, rad and m together, and largest number of such rows."""

Read = Callable[[Table, description.DescriptionFile], Observations]
"""Function that reads a table of joints and readings by its description, each row as if measured at rest."""


@dataclass(frozen=True, eq=False)
class Timed(Observations):
    """Rows whose joints depend on two further unknowns: the offset and the rate of the instrument's clock.

    Attributes:
        rows: The rows, with the joints at the first guess of the clocks.
        times: Time of each row on the instrument's clock ``(N,)``, s, from the middle of the recording.
        joints_at: Function that gives the joints ``(N, n)``, rad or m, at times ``(N,)`` on the joint log's clock, s,
            from the same middle.
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
        """Return the rows with the joints at their times; ``clock`` is the clock's offset, s, and relative rate."""
        return replace(self.rows, joints=self.joints_at(self.times / (1.0 + clock[1]) - clock[0]))  # type: ignore[type-var]

    def unknowns(self) -> tuple[str, ...]:
        """Return the names of the rows' own unknowns, then the names of the clock's offset and rate."""
        return (*self.rows.unknowns(), "clock_offset", "clock_rate")

    def tolerances(self) -> Array:
        """Return the expected size of each of the `unknowns`, in its unit, for scaling the least squares."""
        return np.concatenate([self.rows.tolerances(), [1e-3, 1e-5]])

    def start(self, model: ArmModel) -> Array:
        """Return starting values of the rows' own unknowns, then zeros for the clock's offset and rate."""
        return np.concatenate([self.rows.start(model), np.zeros(2)])

    def equations(self) -> tuple[Rows, Rows]:
        """Return the indices, from 0, of row and channel of each equation, both ``(E,)``.

        The last equation is the prior of the clock's rate, whose row is -1.
        """
        rows, channels = self.rows.equations()
        return np.r_[rows, -1], np.r_[channels, 0]

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Compute the whitened residuals of the rows, then the residual of the prior of the clock's rate."""
        own, clock = np.split(unknowns, [-2])
        return np.concatenate([self.at(clock).residual(model, own), -clock[1:] / RATE_STD])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Compute the derivatives of the whitened residuals with respect to the arm's parameters and to `unknowns`.

        The derivatives with respect to the clock's offset and rate come from the joint velocities.
        """
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
        """Compute the derivative of the rows' whitened residuals ``(E,)`` with respect to the clock's offset, 1/s."""
        own, clock = np.split(unknowns, [-2])
        late, early = (self.at(clock + np.array([step, 0.0])).residual(model, own) for step in (STEP, -STEP))
        return np.asarray((late - early) / (2.0 * STEP))

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Compute measured minus predicted readings of the rows, with the joints by the clock's offset and rate.

        Args:
            model: The arm.
            unknowns: Values of the `unknowns`; the last two are the clock's offset, s, and relative rate.
        """
        own, clock = np.split(unknowns, [-2])
        return self.at(clock).misses(model, own)

    def select(self, rows: Any) -> Self:
        """Return the rows that indices (from 0) or a mask select."""
        return replace(self, rows=self.rows.select(rows), times=self.times[np.asarray(rows)])


@dataclass(frozen=True, eq=False)
class Logs:
    """A recording: an instrument's samples and a joint log.

    Attributes:
        table: The instrument's log without lost samples.
        layout: The column description of the recording.
        geometry: The arm's nominal geometry.
        times: Time of each sample on the instrument's clock ``(T,)``, s, from the first sample.
        values: Names of the columns that are read from the instrument's log, and their values ``(T, k)``, in the file's
            units.
        log: Time of each entry of the joint log ``(M,)``, s, from the first entry.
        joints: Joints of each entry of the joint log ``(M, n)``, rad or m.
        entries: Names of the columns that are read from the joint log, and their values ``(M, j)``, in the file's
            units.
        first: Time of the first sample on the instrument's clock, s.
        began: The instrument's clock at its first sample minus the joint log's clock at its first entry, s.
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
        """Spline of the joint log's columns over time, in the file's units."""
        return CubicSpline(self.log, self.entries[1])

    @cached_property
    def joint_spline(self) -> CubicSpline:
        """Spline of the joints over time, rad or m."""
        return CubicSpline(self.log, self.joints)

    def covered(self, times: Array) -> NDArray[np.bool_]:
        """Return a mask ``(T,)`` of the times, on the joint log's clock, that lie within the log and not in a gap."""
        steps = np.diff(self.log)
        place = np.clip(np.searchsorted(self.log, times) - 1, 0, len(steps) - 1)
        inside = (times >= self.log[0]) & (times <= self.log[-1])
        return np.asarray(inside & (steps[place] <= np.maximum(5.0 * np.median(steps), STEP)))

    def rows(self, times: Array, groups: Sequence[Rows]) -> Table:
        """Make a table with one row per group of samples: the means of the readings, and of the joints at their times.

        Args:
            times: Time of each sample on the joint log's clock ``(T,)``, s.
            groups: Indices, from 0, of the samples of each group.
        """
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
        table = Table(self.table.where, [*self.entries[0], *names], [[] for _ in lines], lines, ".")
        table.cache = dict(zip(table.header, np.c_[np.stack(joints), np.stack(means)].T, strict=True))
        return table


def read_recording(
    table: Table, path: Path, layout: description.DescriptionFile, where: str, geometry: Geometry, read: Read
) -> tuple[Table, description.DescriptionFile, Clocks]:
    """Turn an instrument's log and its joint log into rows.

    Each standstill of the arm gives a row with the mean of its samples. If standstills are too few, rows are single
    samples of the motion.

    Args:
        table: The instrument's log.
        path: The file of the instrument's log.
        layout: The column description, with [recording].
        where: Name of the description, for messages.
        geometry: The arm's nominal geometry.
        read: Function that reads a table as measurements of the arm at rest.

    Returns:
        The rows, the description and the clocks. If the rows are single samples, the uncertainties in the description
        are increased by the effect of the clocks' uncertainty.

    Raises:
        InputError: If a time is out of order, if the logs do not belong together, or if their offset cannot be
            determined.
    """
    logs = _logs(table, path, layout, where, geometry)
    timed, found, first, middle = _first_guess(logs, read)
    timed = timed.select(sigma_of(found, timed) <= OUTLIER_SIGMA)
    solution = solve(prior_model("recording", found.geometry, known=False), timed)
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
        factors = [np.sqrt(1.0 + np.mean(drift[channels == i] ** 2)) for i in np.unique(channels)]
        layout = _with_std(logs.layout, factors)
    return logs.rows(times, groups), logs.layout if still else layout, clocks


def _with_std(layout: description.DescriptionFile, factors: list[float]) -> description.DescriptionFile:
    """Return the description with its stated uncertainties multiplied by factors.

    Args:
        layout: The description.
        factors: The factor for readings, then, if attitudes were measured, the factor for attitudes.
    """
    measured = layout.measured
    if measured.std is not None:
        layout = replace(layout, **{layout.kind: replace(measured, std=measured.std * factors[0])})
    if layout.rotation is not None and len(factors) > 1:
        layout = replace(layout, rotation=replace(layout.rotation, std=layout.rotation.std * factors[1]))
    return layout


def _logs(table: Table, path: Path, layout: description.DescriptionFile, where: str, geometry: Geometry) -> Logs:
    """Read both logs of a recording, check their times, and leave out lost samples.

    Args:
        table: The instrument's log.
        path: The file of the instrument's log.
        layout: The column description, with [recording].
        where: Name of the description, for messages.
        geometry: The arm's nominal geometry.
    """
    told = layout.recording
    assert told is not None
    home = path.parent / told.joints.replace(kind_readers.STEM, path.name if path.is_dir() else path.stem)
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
    jumps = (np.abs(np.diff(joints, axis=0)) > np.pi) & ~np.array(geometry.prismatic)
    for row, joint in np.argwhere(jumps)[:1]:
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
    """Return the table without lost samples, that is samples with an empty cell or a position at 0, 0, 0.

    Args:
        table: The instrument's log.
        layout: The column description.
        names: The columns or expressions whose cells must not be empty.
    """
    lost = np.zeros(len(table.lines), dtype=bool)
    for name in _columns_in(names, table.header):
        lost |= table.fill_blanks(name)
    if layout.kind in ("position", "reflectors"):
        lost |= (table.values(layout.columns).reshape(len(lost), -1, 3) == 0.0).all(axis=2).any(axis=1)
    rows = np.flatnonzero(~lost).tolist()
    if len(rows) < LEAST_SAMPLES:
        raise InputError(f"{table.where} has {len(rows)} samples; a recording needs at least {LEAST_SAMPLES}")
    return table.select(rows)


def _complete(log: Table, names: tuple[str, ...]) -> Table:
    """Return the messages of a joint log that have all columns of the expressions ``names``.

    A topic may also carry other messages, such as messages of a gripper alone.
    """
    lacking = np.zeros(len(log.lines), dtype=bool)
    for name in _columns_in(names, log.header):
        lacking |= np.array([not cell for cell in log.texts(name)])
    if lacking.all():
        raise InputError(f"no message of {log.where} has all of {listed(names)}; record a topic where one has them all")
    return log.select(np.flatnonzero(~lacking).tolist())


def _columns_in(expressions: Sequence[str], header: list[str]) -> set[str]:
    """Return the columns in ``header`` that expressions of columns use."""
    trees = [tree for tree in map(table_files.expression_tree, expressions) if tree is not None]
    words = {node.id for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Name)}
    return (words | set(expressions)) & set(header)


def _times(table: Table, name: str, unit: str) -> Array:
    """Read the times of a log ``(T,)``, s, and check that they are strictly increasing.

    Args:
        table: The log.
        name: The column of the times.
        unit: The column's unit, a key of `description.SECONDS`.
    """
    times = table.value(name) * description.SECONDS[unit]
    steps = np.diff(times)
    if len(times) < 4:
        raise InputError(f"{table.where} has {len(times)} rows; a log needs at least 4")
    for row in np.flatnonzero(steps <= 0)[:1]:
        fault = "repeats the time before it" if steps[row] == 0 else "lies before the time above it"
        raise InputError(f"{table.cell(row + 1, name)} {fault}; give a log in the order of its clock, each time once")
    return np.asarray(times)


# The clocks, roughly: at which lag do the speeds of tool and readings agree?


def _speeds(logs: Logs) -> tuple[Array, Array, float]:
    """Compute two speeds over time: of the nominal tool by the joint log, and of the readings.

    Speeds are angular if attitudes were measured, else linear. They do not depend on the base, and hardly on the tool.

    Returns:
        Two arrays and a number. The first array is the motion of the tool per `CHORD` of time ``(A,)``, rad or m. The
        second is the motion of the readings per `CHORD` ``(B,)``, rad or the file's unit. The number is the time step
        of both, s.
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
        seen = Slerp(logs.times, Rotation.from_matrix(table_files.rotations(layout.rotation.convention, columns)))
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
    """Compute the correlation of two signals at every lag, and the number of samples that overlap at that lag.

    Entry k, from 0, compares ``one[i]`` with ``other[i - k + len(other) - 1]``.
    """
    from scipy.signal import correlate  # late: it takes half a second

    one, other = (part - part.mean() for part in (one, other))
    summed = partial(correlate, method="fft")
    here, there = np.ones(len(one)), np.ones(len(other))
    count = np.maximum(np.rint(summed(here, there)), 1.0)
    left, right = summed(one, there), summed(here, other)
    varied = (summed(one**2, there) - left**2 / count) * (summed(here, other**2) - right**2 / count)
    floor = 1e-9 * (one @ one) * (other @ other)
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = (summed(one, other) - left * right / count) / np.sqrt(np.maximum(varied, 0.0))
    return np.where(varied > floor, np.clip(alike, -0.999999, 0.999999), 0.0), count


def _peaks(logs: Logs) -> list[float]:
    """Return candidates for the clocks' offset: times of the instrument's first sample, s.

    The times are on the joint log's clock, from the joint log's first entry.

    Raises:
        InputError: If nothing moves, or the speeds agree at no offset.
    """
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
    """Return samples with their joints at one offset of the clocks; None if too few samples lie within the joint log.

    Args:
        logs: The recording.
        start: Time of the instrument's first sample on the joint log's clock, s from the joint log's first entry.
        most: Largest number of samples to take.
        read: Function that reads a table as measurements of the arm at rest.

    Returns:
        The samples, the offset ``-start``, s, and the mean time of the usable samples from the first sample, s.
    """
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
    """Fit base, tool and clocks, and decide between candidate offsets of the clocks.

    Returns:
        The samples, their fit, the first guess of the offset, s, and the mean sample time from the first sample, s.

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
    (miss, _, found), *others = tried
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
    """Fit base, tool and clocks to samples.

    Args:
        nominal: The arm's nominal geometry.
        timed: The samples.
        start: The geometry with base and tool to start from; None to compute a rough start from the samples.
    """
    start = start or rough_start(nominal, timed.rows)
    return identify(frames_model(nominal), start, [timed], max_iterations=60)


# Which samples make a row: those of a rest together, or single ones on the way.


def _rests(logs: Logs, times: Array, usable: Rows) -> list[Rows]:
    """Return the indices, from 0, of the samples of each rest of the arm, without the time in which the arm settles.

    Args:
        logs: The recording.
        times: Time of each sample on the joint log's clock ``(T,)``, s.
        usable: Indices, from 0, of the samples that lie within the joint log.
    """
    step = np.median(np.diff(logs.log))
    width = max(round(REST / step), 3)
    if len(logs.log) <= width:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(logs.joints, width, axis=0)
    jerks = np.abs(np.diff(logs.joints, 3, axis=0))
    noise = np.minimum(np.median(jerks, axis=0) / (0.6745 * np.sqrt(20.0)), np.percentile(windows.std(axis=2), 10, 0))
    digit = np.array([np.min(part[part > 0], initial=0.0) if (part > 0).any() else 0.0 for part in jerks.T])
    within = np.clip(np.maximum(SPREADS * noise, 1.5 * np.minimum(digit, noise)), FINEST, COARSEST)
    still = (np.ptp(windows, axis=2) <= within).all(axis=1)
    resting = np.convolve(still, np.ones(width, dtype=int)) > 0  # every entry of a window that stands still
    edges = np.flatnonzero(np.diff(np.r_[False, resting, False].astype(int)))
    groups = []
    for first, last in edges.reshape(-1, 2):
        begin, end = logs.log[first] + SETTLING, logs.log[last - 1] - 2.0 * step
        group = usable[(times[usable] >= begin) & (times[usable] <= end)]
        if len(group) >= 3 and end - begin >= REST / 2:
            groups.append(group)
    return groups


def _thinned(logs: Logs, times: Array, usable: Rows) -> list[Rows]:
    """Return the indices, from 0, of single samples that are spaced by a path length in joint space (`PATH`).

    Each index is an array of its own. `_rests` explains the arguments.
    """
    joints = logs.joint_spline(times[usable])
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(joints, axis=0), axis=1))]
    _, first = np.unique(np.floor(way / max(PATH, way[-1] / MOST_ROWS)), return_index=True)
    return [usable[[i]] for i in first]
