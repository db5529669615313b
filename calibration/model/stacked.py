"""Several data sets of one arm in one fit: other instruments, other days, other targets on the tool.

A station is a data set with frames of its own: an instrument that stood elsewhere sees the arm with another base, and
another target is another tool. Those frames are unknowns of the station, found with the arm; where it has none of its
own, the arm's are meant. SI units.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from pickenv.arm import Geometry, Pose, rotation_matrix
from pickenv.arm.kinematics.geometry import FRAME_PARAMETERS, Array, move_pose
from pickenv.calibration.model.arm_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, ArmModel, Conditions
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, Origins, Rows, hash_of, origins_of

OWN = ("base", "tool")
"""Frames that a station can have of its own."""

ALIKE = 0.1
"""Data sets are of one instrument where their uncertainties differ by no more than this share."""

WIDEST = 3
"""Components of a miss where kinds are mixed; lengths and pixels fill fewer, the rest is zero."""


@dataclass(frozen=True, eq=False)
class InstrumentStation:
    """A data set with frames of its own.

    Attributes:
        data: The data set.
        number: Which station it is, from 1; the unknowns of all but the first carry it in their names.
        base: Where its own base frame is looked for from; None where the arm's is meant.
        tool: Likewise of its own tool.
        scale: Its standard uncertainties count so many times; weighs instruments by what they scatter.
    """

    data: Observations
    number: int = 1
    base: Pose | None = None
    tool: Pose | None = None
    scale: float = 1.0

    @property
    def frames(self) -> dict[str, Pose]:
        """Its own frames, by name."""
        return {name: pose for name in OWN if (pose := getattr(self, name)) is not None}

    @property
    def suffix(self) -> str:
        """What the names of its unknowns end with."""
        return "" if self.number == 1 else f"_{self.number}"

    def unknowns(self) -> tuple[str, ...]:
        """The data's own, then those of the frames: base2_x."""
        own = tuple(f"{name}{self.suffix}" for name in self.data.unknowns())
        return own + tuple(f"{frame}{self.number}_{name}" for frame in self.frames for name in FRAME_PARAMETERS)

    def tolerances(self) -> Array:
        """Of a frame's deviation, as of the arm's own base and tool."""
        frame = np.repeat([LENGTH_TOLERANCE, ANGLE_TOLERANCE], 3)
        return np.concatenate([self.data.tolerances(), np.tile(frame, len(self.frames))])

    def start(self, model: ArmModel) -> Array:
        """The data's own start, and no deviation of the frames."""
        frames = np.zeros(6 * len(self.frames))
        return np.concatenate([self.data.start(self.seen(model, frames)), frames])

    def seen(self, model: ArmModel, deviations: Array) -> ArmModel:
        """The arm as this station sees it."""
        steps = zip(self.frames.items(), deviations.reshape(-1, 6), strict=True)
        moved: dict[str, Any] = {name: move_pose(pose, step) for (name, pose), step in steps}
        return replace(model, geometry=replace(model.geometry, **moved)) if moved else model

    def parted(self, unknowns: Array) -> tuple[Array, Array]:
        """The data's own unknowns, and the deviations of the frames."""
        count = len(unknowns) - 6 * len(self.frames)
        return unknowns[:count], unknowns[count:]

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Of the data, seen from here."""
        own, frames = self.parted(unknowns)
        return self.data.residual(self.seen(model, frames), own) / self.scale

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Likewise."""
        own, frames = self.parted(unknowns)
        return self.data.misses(self.seen(model, frames), own)

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Derivatives by the arm, less its frames where the station has its own, and by the unknowns."""
        own, frames = self.parted(unknowns)
        by_arm, by_own = self.data.jacobian(self.seen(model, frames), own)
        parts = [by_own]
        for frame in self.frames:
            columns = frame_columns(model.geometry, frame)
            parts.append(by_arm[:, columns])
            by_arm = by_arm.copy()
            by_arm[:, columns] = 0.0
        return by_arm / self.scale, np.concatenate(parts, axis=1) / self.scale


@dataclass(frozen=True, eq=False)
class Stacked:
    """Stations of one arm, one after the other.

    Attributes:
        stations: The stations; those with an instrument's frame come first.
    """

    stations: tuple[InstrumentStation, ...]

    @property
    def parts(self) -> tuple[Observations, ...]:
        """The data sets."""
        return tuple(station.data for station in self.stations)

    @property
    def joints(self) -> Array:
        """Of all rows."""
        return np.concatenate([part.joints for part in self.parts])

    @property
    def source(self) -> str:
        """The first one's."""
        more = len(self.stations) - 1
        return self.parts[0].source + (f" and {more} more" if more else "")

    @property
    def kind(self) -> str:
        """All kinds: position+sockets."""
        return "+".join(dict.fromkeys(part.kind for part in self.parts))

    @property
    def framed(self) -> bool:
        """Whether any instrument has a frame."""
        return any(part.framed for part in self.parts)

    @property
    def sized(self) -> bool:
        """Whether any knows a length."""
        return any(part.sized for part in self.parts)

    @property
    def miss_unit(self) -> str:
        """Angles beside lengths count as what they move at a metre."""
        units = {part.miss_unit for part in self.parts}
        return units.pop() if len(units) == 1 else "mm"

    @property
    def conditions(self) -> Conditions:
        """What every station recorded."""
        found: dict[str, Array] = {}
        for name in vars(Conditions()):
            values = [getattr(part.conditions, name) for part in self.parts]
            if all(value is not None for value in values):
                found[name] = np.concatenate(values)
        return Conditions(**found)

    @property
    def origins(self) -> Origins:
        """File and line of every row."""
        each = [origins_of(part) for part in self.parts]
        first = np.cumsum([0] + [len(origins.files) for origins in each[:-1]])
        return Origins(
            tuple(file for origins in each for file in origins.files),
            np.concatenate([origins.file + start for origins, start in zip(each, first, strict=True)]),
            np.concatenate([origins.line for origins in each]),
        )

    @property
    def groups(self) -> Rows:
        """Groups of every station by themselves."""
        return _numbered([part.groups for part in self.parts])

    @property
    def rows_of_misses(self) -> Rows:
        """The row that each miss belongs to."""
        rows = zip(self.parts, self._first_rows(), strict=True)
        return np.concatenate([part.rows_of_misses + first for part, first in rows])

    def equations(self) -> tuple[Rows, Rows]:
        """Rows and channels; each station has channels of its own."""
        each = [part.equations() for part in self.parts]
        rows = [np.where(own >= 0, own + first, -1) for (own, _), first in zip(each, self._first_rows(), strict=True)]
        return np.concatenate(rows), _numbered([channels for _, channels in each])

    def unknowns(self) -> tuple[str, ...]:
        """Of all stations."""
        return tuple(name for station in self.stations for name in station.unknowns())

    def tolerances(self) -> Array:
        """Of all stations."""
        return np.concatenate([station.tolerances() for station in self.stations])

    def start(self, model: ArmModel) -> Array:
        """Of all stations."""
        return np.concatenate([station.start(model) for station in self.stations])

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Of all stations."""
        return np.concatenate([station.residual(model, own) for station, own in self._with(unknowns)])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Of all stations."""
        each = [station.jacobian(model, own) for station, own in self._with(unknowns)]
        return np.concatenate([by_arm for by_arm, _ in each]), block_diag(*(by_own for _, by_own in each))

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Of all stations ``(R, 3)``, m; what has fewer components is filled up with zeros."""
        return np.concatenate([_widened(station.misses(model, own)) for station, own in self._with(unknowns)])

    def seen_by_station(
        self, model: ArmModel, unknowns: Array
    ) -> Iterator[tuple[Observations, ArmModel, Array, float]]:
        """Each station's data, the arm as it sees it, the data's own unknowns, and what its uncertainties count."""
        for station, values in self._with(unknowns):
            own, frames = station.parted(values)
            yield station.data, station.seen(model, frames), own, station.scale

    def readings(self) -> Array:
        """Of all stations, each in columns of its own."""
        return np.asarray(block_diag(*(part.readings() for part in self.parts)))

    def fingerprint(self) -> str:
        """Of joints and readings."""
        return hash_of(self.joints, self.readings())

    def select(self, rows: ArrayLike) -> Self:
        """The stations that hold only the given rows; those without any are left out."""
        rows = np.asarray(rows)
        rows = np.flatnonzero(rows) if rows.dtype == bool else rows
        kept = []
        for station, first in zip(self.stations, self._first_rows(), strict=True):
            here = rows[(rows >= first) & (rows < first + len(station.data.joints))] - first
            if len(here):
                kept.append(replace(station, data=station.data.select(here)))
        first_station = self.stations[0]
        none = replace(first_station, data=first_station.data.select(np.arange(0)))
        return replace(self, stations=tuple(kept) or (none,))

    def weighed(self, scales: Sequence[float]) -> Self:
        """The stations weighed by their scatter, relative to the first one's."""
        stations = zip(self.stations, scales, strict=True)
        return replace(self, stations=tuple(replace(each, scale=each.scale * s / scales[0]) for each, s in stations))

    @property
    def places(self) -> Rows:
        """The place among the stations of each row ``(N,)``, from 0."""
        return np.repeat(np.arange(len(self.stations)), [len(part.joints) for part in self.parts])

    def from_the_first(self, model: ArmModel, unknowns: Array) -> Measurements | None:
        """Poses or positions of all stations as the first one would have measured them; None of other kinds.

        What a row differs by from the model is turned into the first one's axes, and of poses shifted to its tool.
        Where any station saw positions alone, attitudes are left out.

        Args:
            model: The arm as the first station sees it.
            unknowns: Values of `unknowns`.
        """
        parts = [part for part in self.parts if isinstance(part, Measurements)]
        if len(parts) < len(self.parts):
            return None
        wide = all(part.rotation is not None for part in parts)
        rows = rows_together([part if wide else part.positions_only() for part in parts])
        base, tool, expected = model.geometry.base, model.geometry.tool, model.pose(rows.joints, rows.conditions)
        errors, levers = [], []
        for (station, own), part in zip(self._with(unknowns), parts, strict=True):
            there = station.seen(model, station.parted(own)[1])
            missed = part.difference(there)[:, : rows.rows_per_pose].reshape(len(part), -1, 3)
            errors.append(missed @ (base.rotation @ there.geometry.base.rotation.T).T)
            levers.append(np.tile(tool.position - there.geometry.tool.position, (len(part), 1)))
        missed, flange = np.concatenate(errors), expected.rotation @ tool.rotation.T
        position, rotation = expected.position + missed[:, 0], None
        if wide:
            lever = (flange @ np.concatenate(levers)[..., None])[..., 0]
            position = position + np.cross(missed[:, 1], lever)
            rotation = rotation_matrix(missed[:, 1]) @ expected.rotation
        return replace(rows, position=position, rotation=rotation)

    def first_channels(self) -> list[int]:
        """The first channel of every station."""
        return _starts([len(channels) for channels in self._channels()])

    def channels_of(self, other: Stacked) -> Rows:
        """The channels of this data set that those of another are, some of whose stations may be missing."""
        starts = zip(self.stations, self.first_channels(), self._channels(), strict=True)
        own = {station.number: channels + first for station, first, channels in starts}
        return np.concatenate([own[station.number] for station in other.stations])

    def _channels(self) -> list[Rows]:
        return [np.arange(int(part.equations()[1].max(initial=-1)) + 1) for part in self.parts]

    def _first_rows(self) -> list[int]:
        return _starts([len(part.joints) for part in self.parts])

    def _with(self, unknowns: Array) -> Iterable[tuple[InstrumentStation, Array]]:
        ends = np.cumsum([0] + [len(station.unknowns()) for station in self.stations])
        return zip(self.stations, (unknowns[a:b] for a, b in pairwise(ends)), strict=True)


def joinable(parts: Sequence[Measurements]) -> bool:
    """Whether data sets can be one: poses or positions alike, of about the same uncertainty."""
    first = parts[0]
    return all(
        (part.kind, part.frames) == (first.kind, first.frames)
        and np.allclose((part.position_std, part.attitude_std), (first.position_std, first.attitude_std), ALIKE, 0.0)
        for part in parts
    )


def rows_together(parts: Sequence[Measurements]) -> Measurements:
    """Rows of `joinable` data sets one after the other; conditions that all of them recorded."""
    first = parts[0]
    if len(parts) == 1:
        return first
    rows = Stacked(tuple(InstrumentStation(part) for part in parts))
    turned = [part.rotation for part in parts if part.rotation is not None]
    return replace(
        first,
        joints=rows.joints,
        position=np.concatenate([part.position for part in parts]),
        rotation=np.concatenate(turned) if turned else None,
        source=rows.source,
        conditions=rows.conditions,
        origins=rows.origins,
    )


def frame_columns(geometry: Geometry, frame: str) -> Rows:
    """Indices of a frame's six parameters among a geometry's."""
    return 5 * geometry.links + 6 * OWN.index(frame) + np.arange(6)


def _starts(counts: Sequence[int]) -> list[int]:
    return [0, *np.cumsum(counts)[:-1].tolist()]


def _numbered(parts: Sequence[Rows]) -> Rows:
    """Numbers of several parts, none of which is shared."""
    first = _starts([int(part.max(initial=-1)) + 1 for part in parts])
    return np.concatenate([part + start for part, start in zip(parts, first, strict=True)])


def _widened(misses: Array) -> Array:
    return np.pad(misses, ((0, 0), (0, WIDEST - misses.shape[1])))
