"""Measurements of an arm: joint values, and the tool poses that instruments measured, at one station or at several.

The CSV files of pickenv name every column with its unit: q1_deg, q2_mm, …, x_mm, y_mm, z_mm. Full poses also have the
rotation vector rx_deg, ry_deg, rz_deg. Other files are read through a column description
(`pickenv.calibration.reading.read`).
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from pickenv.arm import Array, Geometry, Plant, Pose, pose_error, rotation_matrix, rotation_vector
from pickenv.arm.kinematics.geometry import FRAME_PARAMETERS, move_pose
from pickenv.arm.plant.campaign import TRACKER, Instrument, NormalDraws, load_instrument, measured_poses, normal_draws
from pickenv.base import InputError, register, write_whole
from pickenv.calibration.model.arm_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, ArmModel, Conditions
from pickenv.calibration.model.observations import Observations, Origins, Rows, hash_of, origins_of, worked_out

OWN_CONDITIONS = ("temperature_degC", "payload_kg")
"""Columns of pickenv's own CSV format besides the columns of joints and poses."""
ROOM_TEMPERATURE = 20.0
"""Temperature that counts as the reference if none is given, degC."""
POSITION_STD = 15e-6
"""Standard uncertainty of a position when a file states none, m: a laser tracker at a few metres."""

ATTITUDE_STD = 2e-4
"""Standard uncertainty of an attitude when a file states none, rad: a 100 mm reflector triad."""


Frames = Literal["known", "fitted"]
"""Choices for base and tool. "known": the poses are those of the arm's own tool in the arm's own base frame. "fitted":
the places of the instrument and of its target are unknown, so base and tool are fitted."""

FRAMES: tuple[Frames, ...] = get_args(Frames)

FRAMES_COLUMN = "frames"
"""Column of pickenv's CSV format for a data set's `Frames`; its value is the same in every row."""


@register("observation", "tracked")
@dataclass(frozen=True, eq=False)
class Measurements(Observations):
    """A data set of N measured poses of an arm with n joints: the most common kind of `Observations`.

    Attributes:
        joints: Commanded joint displacements ``(N, n)``, rad or m.
        position: Measured tool positions ``(N, 3)``, m, in the instrument's frame.
        rotation: Measured tool rotations ``(N, 3, 3)``, or None if only positions were measured.
        prismatic: Whether each joint is prismatic, which decides the unit of its column.
        position_std: Standard uncertainty of one position coordinate, m.
        attitude_std: Standard uncertainty of one attitude coordinate, rad.
        source: Where the data come from, for messages.
        conditions: Payload, temperature and torques of each pose, where known.
        origins: File and line of each row; None if the rows come from no file.
        frames: "known" for poses of the arm's own tool in the arm's own base frame. "fitted" if the places of the
            instrument, and of its target on the tool, are unknown.
        std_stated: Whether a file or the instrument states the uncertainties; if False they are the defaults.
    """

    joints: Array
    position: Array
    rotation: Array | None
    prismatic: tuple[bool, ...]
    position_std: float = POSITION_STD
    attitude_std: float = ATTITUDE_STD
    source: str = "measurements"
    conditions: Conditions = field(default_factory=Conditions)
    origins: Origins | None = None
    frames: Frames = "fitted"
    std_stated: bool = False
    framed = True
    per_row = ("position", "rotation")

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.joints)

    @worked_out
    def kind(self) -> str:
        """Name of the kind: "pose" or "position"."""
        return "position" if self.rotation is None else "pose"

    @property
    def rows_per_pose(self) -> int:
        """Number of scalar equations per measured pose: 6 for full poses, 3 for positions."""
        return 3 if self.rotation is None else 6

    @property
    def row_weights(self) -> Array:
        """Weights of the 3 or 6 coordinates of a measured pose: one over their standard uncertainties."""
        return np.asarray(1.0 / np.repeat([self.position_std, self.attitude_std], 3)[: self.rows_per_pose])

    def difference(self, model: Geometry | ArmModel) -> Array:
        """Return measured minus predicted poses ``(N, 6 or 3)``, m and rad (rotation vector), in instrument axes."""
        predicted = ArmModel.of(model).pose(self.joints, self.conditions)
        if self.rotation is None:
            return np.asarray(self.position - predicted.position)
        return pose_error(predicted, Pose(self.position, self.rotation))

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Return the measured minus the predicted poses, in standard uncertainties, as one vector ``(E,)``."""
        return np.asarray((self.difference(model) * self.row_weights).ravel())

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Return whitened derivatives of the poses with respect to the arm's parameters (Qiao 2026 eq (8)).

        The second array, the derivatives with respect to unknowns, has no columns.
        """
        jacobian = np.moveaxis(model.jacobian(self.joints, self.conditions), 0, -1)
        flat = np.empty((jacobian.shape[1], len(self), self.rows_per_pose))
        for i, weight in enumerate(self.row_weights):
            np.multiply(jacobian[i], weight, out=flat[..., i])
        return flat.reshape(len(flat), -1).T, np.zeros((flat[0].size, 0))

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Return measured minus predicted positions ``(N, 3)``, m."""
        return self.difference(model)[:, :3]

    def equations(self) -> tuple[Rows, Rows]:
        """Return the row (index from 0) and the channel of each equation, both ``(E,)``.

        Positions are channel 0, and attitudes channel 1.
        """
        channels = np.repeat([0, 1], 3)[: self.rows_per_pose]
        return np.repeat(np.arange(len(self)), self.rows_per_pose), np.tile(channels, len(self))

    def readings(self) -> Array:
        """Return the measured positions ``(N, 3)``, m."""
        return self.position

    @property
    def poses(self) -> Measurements:
        """The rows as `Measurements`, which are this data set itself."""
        return self

    def joinable(self, other: Measurements) -> bool:
        """Return whether two data sets can be joined: same kind, same `frames`, and about the same uncertainty."""
        stds, others = (self.position_std, self.attitude_std), (other.position_std, other.attitude_std)
        return (self.kind, self.frames) == (other.kind, other.frames) and np.allclose(others, stds, ALIKE, 0.0)

    def positions_only(self) -> Measurements:
        """Return the same data set without attitudes."""
        return replace(self, rotation=None)

    def fingerprint(self) -> str:
        """Return one hash over joints, positions and attitudes together."""
        return hash_of(self.joints, self.position, *([] if self.rotation is None else [self.rotation]))

    def table(self) -> tuple[list[str], Array]:
        """Return the names of the columns with their units, and the table of values in these units, one row per pose.

        Known payloads and temperatures have columns. Torques have none, since pickenv's CSV format cannot hold them.
        """
        names = [*joint_columns(self.prismatic), "x_mm", "y_mm", "z_mm"]
        columns = [self.joints * screen_units(self.prismatic), self.position * 1e3]
        if self.rotation is not None:
            names += ["rx_deg", "ry_deg", "rz_deg"]
            columns.append(np.degrees(rotation_vector(self.rotation)))
        recorded = (self.conditions.temperature, self.conditions.payload)
        for name, values, reference in zip(OWN_CONDITIONS, recorded, (ROOM_TEMPERATURE, 0.0), strict=True):
            if values is not None:
                names.append(name)
                columns.append(values[:, None] + reference)
        return names, np.concatenate(columns, axis=1)

    def write_csv(self, path: str | Path) -> Path:
        """Write a CSV file in pickenv's format, whole or not at all; `reading.read.read_measurements` reads it back.

        If the frames are known, a last column says so in every row.
        """
        names, values = self.table()
        if self.frames == "fitted":
            return write_table(path, names, values)
        frames = np.full((len(self), 1), self.frames, dtype=object)
        return write_table(path, [*names, FRAMES_COLUMN], np.concatenate([values.astype(object), frames], axis=1))


def joint_columns(prismatic: Sequence[bool]) -> list[str]:
    """Return the names of the joint columns of pickenv's CSV format."""
    return [f"q{i + 1}_{screen_unit(slides)[0]}" for i, slides in enumerate(prismatic)]


def screen_unit(length: bool) -> tuple[str, float]:
    """Return the unit in files and on screens, and the factor from m or rad.

    Args:
        length: True for a length, in mm; False for an angle, in deg.
    """
    return ("mm", 1e3) if length else ("deg", float(np.degrees(1.0)))


def screen_units(prismatic: Sequence[bool]) -> Array:
    """Return the factors ``(n,)`` from rad or m to the unit of each joint on screens, deg or mm."""
    return np.array([screen_unit(slides)[1] for slides in prismatic])


def write_table(path: str | Path, names: list[str], values: Array | NDArray[np.object_]) -> Path:
    """Write a CSV file with a header and return its path; numbers keep all their digits.

    Args:
        path: The file.
        names: Names of the k columns.
        values: The table ``(N, k)``.
    """

    def write(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            writer.writerows(values.tolist())

    return write_whole(path, write)


def write_joints(path: str | Path, joints: Array, prismatic: tuple[bool, ...]) -> Path:
    """Write joints ``(N, n)``, rad or m, as a CSV file with columns such as q1_deg and q2_mm."""
    return write_table(path, joint_columns(prismatic), joints * screen_units(prismatic))


def random_joints(geometry: Geometry, count: int, rng: np.random.Generator) -> Array:
    """Draw joints ``(count, n)``, rad or m, uniformly from the joint ranges, as in the protocol of Qiao 2026."""
    return rng.uniform(geometry.lower, geometry.upper, (count, geometry.joints))


def simulated_tracker(
    plant: Plant, joints: ArrayLike, rng: np.random.Generator, instrument: Instrument | str = TRACKER
) -> Measurements:
    """Simulate an instrument that measures the tool poses of an arm at ``joints``, one after another.

    The poses are those of the arm's own tool in the arm's own base frame. One call is one campaign: the arm is switched
    on, warms up, drives from pose to pose and waits before each reading. The target is mounted on the tool once. The
    instrument "ideal" waits at each pose without limit.

    Args:
        plant: The plant, that is the true arm with its errors.
        joints: Joint commands ``(N, n)`` in the order of the visits, rad or m.
        rng: Draws the errors of the readings. A child generator draws the friction at each stop and the target's
            mounting.
        instrument: A name of `pickenv.arm.load_instrument`, a path to a file, or an `Instrument`.

    Raises:
        InputError: If joints have another shape or are not finite, or the instrument is unknown.
    """
    joints = np.asarray(joints, dtype=float)
    if joints.ndim != 2 or joints.shape[1] != plant.geometry.joints:
        raise InputError(f"joints have shape {joints.shape}; give (N, {plant.geometry.joints}), one row per pose")
    if not np.isfinite(joints).all():
        row = int(np.argmin(np.isfinite(joints).all(axis=1)))
        raise InputError(f"the joints of pose {row} are {joints[row].tolist()}; give finite ones, rad or m")
    instrument = instrument if isinstance(instrument, Instrument) else load_instrument(instrument)
    return tracked(plant, instrument, joints, normal_draws(plant, len(joints), rng))


def tracked(plant: Plant, instrument: Instrument, joints: Array, draws: NormalDraws) -> Measurements:
    """Simulate the tool poses that an instrument measures of an arm, with random draws made beforehand.

    Args:
        plant: The plant, that is the true arm with its errors.
        instrument: The instrument.
        joints: Joint commands ``(N, n)`` in the order of the visits, rad or m.
        draws: Standard normal draws for the N poses.
    """
    pose, noise = measured_poses(plant, joints, instrument, draws), instrument.noise_on(plant)
    std = attitude_std = 0.0
    if noise is not None:
        ranges = np.linalg.norm(pose.position - instrument.stand, axis=-1)
        std, attitude_std = noise.position_std_at(float(ranges.mean()) if len(joints) else 0.0), noise.attitude_std
    return Measurements(
        joints=joints,
        position=pose.position,
        rotation=pose.rotation,
        prismatic=plant.geometry.prismatic,
        position_std=std or POSITION_STD,
        attitude_std=attitude_std or ATTITUDE_STD,
        source=f"simulated {instrument.name.replace('_', ' ')} on plant {plant.name}",
        frames="known",
        std_stated=noise is not None,
    )


# Several data sets of one arm in one fit: other instruments, other days, other targets on the tool. A station is a
# data set with frames of its own: an instrument that stood elsewhere sees the arm with another base, and another
# target is another tool. Those frames are unknowns of the station, found with the arm; where it has none of its own,
# the arm's are meant. SI units.


OWN = ("base", "tool")
"""Names of the frames that may differ between stations."""

FRAME_TOLERANCES = np.repeat([LENGTH_TOLERANCE, ANGLE_TOLERANCE], 3)
"""Typical deviations of a frame's six coordinates, m and rad, by which their Jacobian columns are scaled."""

ALIKE = 0.1
"""Data sets whose uncertainties differ by no more than this share count as measured by one instrument."""


@dataclass(frozen=True, eq=False)
class InstrumentStation:
    """A station: one data set, with the base and tool frames that it does not share with the arm model.

    Attributes:
        data: The data set.
        number: Number of the station, from 1; from 2 on it is part of the names of the station's unknowns.
        base: Starting value of the station's own base frame; None if the station uses the arm's base frame.
        tool: Starting value of the station's own tool frame; None if the station uses the arm's tool frame.
        scale: Factor on the data's standard uncertainties, which weighs instruments by their scatter.
        owners: Number, from 1, of the station that owns a frame, by the frame's name ("base" or "tool"). This station
            owns the frames that are not listed.
    """

    data: Observations
    number: int = 1
    base: Pose | None = None
    tool: Pose | None = None
    scale: float = 1.0
    owners: Mapping[str, int] = field(default_factory=dict)

    @property
    def frames(self) -> dict[str, Pose]:
        """The station's own frames, by name."""
        return {name: pose for name in OWN if (pose := getattr(self, name)) is not None}

    @property
    def suffix(self) -> str:
        """Ending of the names of the data's own unknowns, such as _2; empty for the first station."""
        return "" if self.number == 1 else f"_{self.number}"

    def unknowns(self) -> tuple[str, ...]:
        """Return the names of the data's own unknowns, then of the frames' deviations, such as base2_x."""
        names = tuple(f"{name}{self.suffix}" for name in self.data.unknowns())
        frames = [f"{frame}{self.owners.get(frame, self.number)}" for frame in self.frames]
        return names + tuple(f"{frame}_{name}" for frame in frames for name in FRAME_PARAMETERS)

    def tolerances(self) -> Array:
        """Return the scales of the data's own unknowns, then of the frames' deviations (`FRAME_TOLERANCES`)."""
        return np.concatenate([self.data.tolerances(), np.tile(FRAME_TOLERANCES, len(self.frames))])

    def start(self, model: ArmModel) -> Array:
        """Return starting values of the data's own unknowns, then zeros for the frames' deviations."""
        frames = np.zeros(6 * len(self.frames))
        return np.concatenate([self.data.start(self.seen(model, frames)[0]), frames])

    def seen(self, model: ArmModel, unknowns: Array) -> tuple[ArmModel, Array]:
        """Return the arm with this station's own frames, and the values of the data's own unknowns.

        Args:
            model: The arm, with the first station's frames.
            unknowns: Values of the station's unknowns, in the order of `unknowns`.
        """
        values, deviations = np.split(unknowns, [len(unknowns) - 6 * len(self.frames)])
        steps = zip(self.frames.items(), deviations.reshape(-1, 6), strict=True)
        frames: dict[str, Any] = {name: move_pose(pose, step) for (name, pose), step in steps}
        return replace(model, geometry=replace(model.geometry, **frames)) if frames else model, values

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Return whitened derivatives with respect to the arm's parameters and to the station's unknowns.

        If the station has a frame of its own, the arm's columns of that frame are zero.

        Args:
            model: The arm, with the first station's frames.
            unknowns: Values of the station's unknowns, in the order of `unknowns`.
        """
        by_arm, by_own = self.data.jacobian(*self.seen(model, unknowns))
        columns = np.concatenate([np.zeros(0, int), *(frame_columns(model.geometry, frame) for frame in self.frames)])
        by_own, by_arm = np.concatenate([by_own, by_arm[:, columns]], axis=1), by_arm.copy()
        by_arm[:, columns] = 0.0
        return by_arm / self.scale, by_own / self.scale


@dataclass(frozen=True, eq=False)
class Stacked(Observations):
    """The data sets of several stations of one arm, stacked as one data set.

    If unknowns of several stations have the same name, they are one unknown.

    Attributes:
        stations: The stations. Stations whose instrument has a frame come first.
    """

    stations: tuple[InstrumentStation, ...]

    @property
    def parts(self) -> tuple[Observations, ...]:
        """The data sets of the stations."""
        return tuple(station.data for station in self.stations)

    @worked_out
    def joints(self) -> Array:
        """Joints of all rows, station by station."""
        return np.concatenate([part.joints for part in self.parts])

    @worked_out
    def source(self) -> str:
        """The first file of the stations, and how many more files they have."""
        first, *others = dict.fromkeys(file for part in self.parts for file in origins_of(part).files)
        return first + (f" and {len(others)} more" if others else "")

    @worked_out
    def kind(self) -> str:
        """Names of all kinds, joined by a plus sign, such as position+sockets."""
        return "+".join(dict.fromkeys(part.kind for part in self.parts))

    @worked_out
    def framed(self) -> bool:
        """Whether any station's instrument has a frame."""
        return any(part.framed for part in self.parts)

    @worked_out
    def sized(self) -> bool:
        """Whether the data of any station involve a known length."""
        return any(part.sized for part in self.parts)

    @worked_out
    def miss_unit(self) -> str:
        """Unit of the misses on screens; "mm" if units are mixed.

        An angle is then shown as the motion of a point at 1 m.
        """
        units = {part.miss_unit for part in self.parts}
        return units.pop() if len(units) == 1 else "mm"

    @worked_out
    def conditions(self) -> Conditions:
        """The conditions that every station recorded."""
        parts = [vars(part.conditions) for part in self.parts]
        common = [name for name in parts[0] if all(part[name] is not None for part in parts)]
        return Conditions(**{name: np.concatenate([part[name] for part in parts]) for name in common})

    @worked_out
    def origins(self) -> Origins:
        """Files, lines and clocks of all rows, and the first station's scatter of repeated measurements."""
        parts = [origins_of(part) for part in self.parts]
        starts = _starts([len(origins.files) for origins in parts])
        return Origins(
            tuple(file for origins in parts for file in origins.files),
            np.concatenate([origins.file + start for origins, start in zip(parts, starts, strict=True)]),
            np.concatenate([origins.line for origins in parts]),
            tuple(dict.fromkeys(clock for origins in parts for clock in origins.clocks)),
            repeat=parts[0].repeat,
        )

    @property
    def groups(self) -> Rows:
        """Number, from 0, of each row's group for splits ``(N,)``; no two stations share a group."""
        return _numbered([part.groups for part in self.parts])

    @property
    def rows_of_misses(self) -> Rows:
        """Index, from 0, of the row that each miss belongs to ``(R,)``; rows are counted through all stations."""
        rows = zip(self.parts, self._first_rows(), strict=True)
        return np.concatenate([part.rows_of_misses + first for part, first in rows])

    def equations(self) -> tuple[Rows, Rows]:
        """Return the row and the channel of each equation, both indices from 0 ``(E,)``; stations share no channel."""
        parts = [part.equations() for part in self.parts]
        rows = [np.where(row >= 0, row + first, -1) for (row, _), first in zip(parts, self._first_rows(), strict=True)]
        return np.concatenate(rows), _numbered([channels for _, channels in parts])

    def unknowns(self) -> tuple[str, ...]:
        """Return the names of the unknowns of all stations."""
        return tuple(dict.fromkeys(name for station in self.stations for name in station.unknowns()))

    def tolerances(self) -> Array:
        """Return the scales of the deviations of all stations' unknowns."""
        return self._of_all([station.tolerances() for station in self.stations])

    def start(self, model: ArmModel) -> Array:
        """Return starting values of the unknowns of all stations."""
        return self._of_all([station.start(model) for station in self.stations])

    @cached_property
    def _places(self) -> list[Rows]:
        """Indices, from 0, of each station's unknowns among the unknowns of all stations."""
        place = {name: i for i, name in enumerate(self.unknowns())}
        return [np.array([place[name] for name in station.unknowns()], dtype=int) for station in self.stations]

    def _of_all(self, parts: Sequence[Array]) -> Array:
        """Return one array over the unknowns of all stations ``(u,)``, from one array over each station's unknowns."""
        values = np.zeros(len(self.unknowns()))
        for places, part in zip(self._places, parts, strict=True):
            values[places] = part
        return values

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Return the whitened residuals of all stations."""
        stations = self._with(unknowns)
        return np.concatenate([part.data.residual(*part.seen(model, values)) / part.scale for part, values in stations])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Return the whitened derivatives of all stations with respect to the arm, and to all stations' unknowns."""
        parts = [station.jacobian(model, values) for station, values in self._with(unknowns)]
        by_unknowns = [np.zeros((len(by_own), len(unknowns))) for _, by_own in parts]
        for (_, by_own), places, columns in zip(parts, self._places, by_unknowns, strict=True):
            columns[:, places] = by_own
        return np.concatenate([by_arm for by_arm, _ in parts]), np.concatenate(by_unknowns)

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Return the misses of all stations ``(R, 3)``, m; misses with fewer components are padded with zeros."""
        parts = [station.data.misses(*station.seen(model, values)) for station, values in self._with(unknowns)]
        return np.concatenate([np.pad(part, ((0, 0), (0, 3 - part.shape[1]))) for part in parts])

    def by_tool(self, model: ArmModel, unknowns: Array) -> Array:
        """Return derivatives ``(E, 6)`` of all equations, each with respect to the tool pose of its own station."""
        stations = self._with(unknowns)
        return np.concatenate([part.data.by_tool(*part.seen(model, values)) / part.scale for part, values in stations])

    def readings(self) -> Array:
        """Return the readings of all stations ``(N, k)``, each station's in separate columns."""
        return np.asarray(block_diag(*(part.readings() for part in self.parts)))

    def select(self, rows: ArrayLike) -> Self:
        """Return the data set of only the given rows (indices or a mask), without stations that have none of them."""
        first, parts = self._first_rows(), self.parts
        owner = np.repeat(np.arange(len(parts)), [len(part.joints) for part in parts])
        numbers = np.arange(len(owner))[np.asarray(rows)]
        used = np.unique(owner[numbers]).tolist() or [0]
        data = {i: parts[i].select(numbers[owner[numbers] == i] - first[i]) for i in used}
        return replace(self, stations=tuple(replace(self.stations[i], data=data[i]) for i in used))

    def weighed(self, scales: Array) -> Self:
        """Return the data set with its stations weighed by their scatter, relative to the first station.

        A station's scatter is the scatter of its first channel. Each station's ``scale`` is multiplied by the station's
        scatter, and divided by the first station's scatter.

        Args:
            scales: Scatter of each channel ``(C,)``. A channel holds readings of one unit and one uncertainty.
        """
        factors = scales[self._first_channels()].tolist()
        stations = zip(self.stations, factors, strict=True)
        return replace(self, stations=tuple(replace(s, scale=s.scale * f / factors[0]) for s, f in stations))

    def from_the_first(self, model: ArmModel, unknowns: Array) -> Measurements | None:
        """Return all poses or positions as the first station would have measured them.

        The result is None if a station has data of another kind, or if the robot's links form a tree. Each row's
        difference from the model is rotated into the first station's axes. For poses it is also transferred to the
        first station's tool. If any station measured positions alone, attitudes are left out.

        Args:
            model: The arm, with the first station's base and tool.
            unknowns: Values of the unknowns of all stations, in the order of `unknowns`.
        """
        parts: list[Measurements] = [part.poses for part in self.parts if part.poses is not None]
        if len(parts) < len(self.parts) or model.geometry.tree is not None:
            return None
        wide = all(part.rotation is not None for part in parts)
        rows = rows_together([part if wide else part.positions_only() for part in parts])
        base, tool, expected = model.geometry.base, model.geometry.tool, model.pose(rows.joints, rows.conditions)
        errors, levers = [], []
        for (station, values), part in zip(self._with(unknowns), parts, strict=True):
            arm, _ = station.seen(model, values)
            error = part.difference(arm)[:, : rows.rows_per_pose].reshape(len(part), -1, 3)
            errors.append(error @ (base.rotation @ arm.geometry.base.rotation.T).T)
            levers.append(np.tile(tool.position - arm.geometry.tool.position, (len(part), 1)))
        error, flange = np.concatenate(errors), expected.rotation @ tool.rotation.T
        position, rotation = expected.position + error[:, 0], None
        if wide:
            lever = (flange @ np.concatenate(levers)[..., None])[..., 0]
            position = position + np.cross(error[:, 1], lever)
            rotation = rotation_matrix(error[:, 1]) @ expected.rotation
        return replace(rows, position=position, rotation=rotation)

    def channels_of(self, other: Observations) -> Rows:
        """Return the indices, from 0, of this data set's channels that ``other`` has too.

        Args:
            other: Rows of the same stations; some stations may be missing.
        """
        starts = zip(self.stations, self._first_channels(), strict=True)
        channels = {station.number: station.data.channels_of(station.data) + first for station, first in starts}
        return np.concatenate([channels[station.number] for station in other.stations])

    def _first_channels(self) -> list[int]:
        """Return the index of each station's first channel among the channels of all stations."""
        return _starts([len(part.channels_of(part)) for part in self.parts])

    def _first_rows(self) -> list[int]:
        """Return the index of each station's first row among the rows of all stations."""
        return _starts([len(part.joints) for part in self.parts])

    def _with(self, unknowns: Array) -> Iterable[tuple[InstrumentStation, Array]]:
        """Return each station with its part of ``unknowns``, the unknowns of all stations."""
        return zip(self.stations, (unknowns[places] for places in self._places), strict=True)


def rows_together(parts: Sequence[Measurements]) -> Measurements:
    """Join data sets into one, with the conditions that all of them recorded.

    Args:
        parts: The data sets, which `Measurements.joinable` accepts.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    rows = Stacked(tuple(InstrumentStation(part) for part in parts))
    rotations = [part.rotation for part in parts if part.rotation is not None]
    return replace(
        first,
        joints=rows.joints,
        position=np.concatenate([part.position for part in parts]),
        rotation=np.concatenate(rotations) if rotations else None,
        source=rows.source,
        conditions=rows.conditions,
        origins=rows.origins,
    )


def frame_columns(geometry: Geometry, frame: str) -> Rows:
    """Return the indices ``(6,)`` of the parameters of ``frame``, "base" or "tool", in ``geometry.parameter_names``."""
    return 5 * geometry.links + 6 * OWN.index(frame) + np.arange(6)


def _starts(counts: Sequence[int]) -> list[int]:
    """Return the index at which each part starts if parts with these counts of entries are concatenated."""
    return [0, *np.cumsum(counts)[:-1].tolist()]


def _numbered(parts: Sequence[Rows]) -> Rows:
    """Concatenate arrays of numbers from 0, such as rows' groups, shifted so that no two arrays share a number."""
    first = _starts([int(part.max(initial=-1)) + 1 for part in parts])
    return np.concatenate([part + start for part, start in zip(parts, first, strict=True)])
