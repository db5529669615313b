"""Reading measured files of any kind: our own columns, or any foreign file through a description of its columns.

`read_measurements` gives poses or positions; `read_observations` any kind, from one file or several, together with
what the file itself says about noise: repeat sigma and the size of its last digit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import Conditions
from pickenv.calibration.model.measurements import FRAMES, FRAMES_COLUMN, Frames, Measurements
from pickenv.calibration.model.observations import (
    DistanceObservations,
    Observations,
    ReflectorObservations,
    SocketObservations,
)
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.reading.conventions import CONVENTIONS, columns_of, convention_table, rotations
from pickenv.calibration.reading.csv_table import Table, read_table, refuse_repeated
from pickenv.calibration.reading.description import (
    ColumnDescription,
    joint_scales,
    load_description,
    own_description,
    shipped_descriptions,
)
from pickenv.calibration.reading.row_checks import (
    refuse_duplicates,
    refuse_far,
    refuse_implausible_joints,
    refuse_origin,
    refuse_repeated_joints,
)
from pickenv.errors import InputError
from pickenv.toml_tables import TO_SI

__all__ = [
    "CONVENTIONS",
    "NoiseFloor",
    "Reading",
    "load_description",
    "read_measurements",
    "read_observations",
    "shipped_descriptions",
]


@dataclass(frozen=True)
class NoiseFloor:
    """What a file itself says about its noise, as the RMS of a position error's norm, m; None where it says nothing.

    Attributes:
        repeat: From columns of the repeat sigma.
        digits: From the last digit of the position columns: size / sqrt(12) per coordinate.
    """

    repeat: float | None
    digits: float | None

    def text(self) -> str:
        """For people, in mm."""
        parts = [] if self.repeat is None else [f"repeatability {self.repeat * 1e3:.4f} mm"]
        parts += [] if self.digits is None else [f"digits of the file {self.digits * 1e3:.2g} mm"]
        return " and ".join(parts) if parts else "not stated by the file"


@dataclass(frozen=True, eq=False)
class Reading:
    """Measurements of any kind as they were read.

    Attributes:
        observations: The data.
        floor: What the files say about noise.
        groups: File of each row, counted from 0, ``(N,)``.
    """

    observations: Observations
    floor: NoiseFloor
    groups: NDArray[np.int64]

    @property
    def measurements(self) -> Measurements | None:
        """The data as poses or positions; None where they are of another kind."""
        return self.observations if isinstance(self.observations, Measurements) else None


def read_measurements(path: str | Path, geometry: Geometry, columns: str | Path | None = None) -> Measurements:
    """Read a file of poses or positions.

    Args:
        path: The file.
        geometry: The arm's nominal geometry, for joint count and types.
        columns: Name or path of a column description; None for our own format.

    Raises:
        InputError: Names the file, row, column or unit at fault.
    """
    found = read_observations([path], geometry, columns)
    if found.measurements is None:
        raise InputError(f"{path}: holds {found.observations.kind}, not poses or positions; use read_observations")
    return found.measurements


def read_observations(paths: Sequence[str | Path], geometry: Geometry, columns: str | Path | None = None) -> Reading:
    """Read measurements of any kind from one file or several of one layout.

    Files of sockets that name no socket column hold one socket each; the files of one folder make a pair.

    Args:
        paths: The files.
        geometry: The arm's nominal geometry, for joint count and types.
        columns: Name or path of a column description; None for our own format.

    Raises:
        InputError: Names the file, row, column or unit at fault.
    """
    if not paths:
        raise InputError("no measurement file was given; give at least one")
    refuse_repeated(paths)
    description = None if columns is None else load_description(columns)
    tables = []
    for path in paths:
        if description is None:
            tables.append(read_table(path))
        else:
            tables.append(read_table(path, description.separator, description.decimal, description.names))
    given = [description or own_description(geometry, table.header, table.where) for table in tables]
    joints = np.concatenate([_joints(table, each, geometry) for table, each in zip(tables, given, strict=True)])
    first = given[0]
    conditions = _conditions(tables, given)
    source = tables[0].where if len(tables) == 1 else f"{tables[0].where} and {len(tables) - 1} more"
    groups = np.repeat(np.arange(len(tables)), [len(table.lines) for table in tables])
    lines = np.concatenate([np.array(table.lines, dtype=np.int64) for table in tables])
    origins = Origins(tuple(table.where for table in tables), groups, lines)
    refuse_repeated_joints(given, joints, geometry)
    frames = {"frames": _frames(tables)} if description is None else {}
    found: Any = READERS[first.kind](tables, given, joints, conditions, geometry, source)
    found = replace(found, origins=origins, **frames)
    refuse_duplicates(joints, found, origins)
    return Reading(found, _floor(tables, given), groups)


def _frames(tables: list[Table]) -> Frames:
    """What files of our own format say about base and tool in every row; where they say nothing, both are fitted."""
    said: dict[str, str] = {}
    for table in tables:
        if FRAMES_COLUMN not in table.header:
            said.setdefault("fitted", table.where)
            continue
        index = table.index(FRAMES_COLUMN)
        for row, line in zip(table.rows, table.lines, strict=True):
            said.setdefault(row[index].strip() if index < len(row) else "", f"{table.where}: row {line}")
    for text, place in said.items():
        if text not in FRAMES:
            raise InputError(f"{place}, column '{FRAMES_COLUMN}' holds '{text[:40]}'; give {' or '.join(FRAMES)}")
    if len(said) > 1:
        places = " but ".join(f"{place} says {text}" for text, place in said.items())
        raise InputError(f"{places}: base and tool cannot be both; calibrate these rows one by one")
    return "known" if "known" in said else "fitted"


def _joints(table: Table, description: ColumnDescription, geometry: Geometry) -> Array:
    columns = []
    for i, scale in enumerate(joint_scales(description, geometry)):
        columns.append(table.value(description.joints[i]) * scale)
        refuse_implausible_joints(table, geometry, i, columns[-1], description.joints[i], description.joint_units[i])
    return np.stack(columns, -1)


def _conditions(tables: list[Table], given: list[ColumnDescription]) -> Conditions:
    """Payload, temperature above the reference, and torques, where every file has them."""
    found: dict[str, Array] = {}
    for name in ("temperature", "payload", "torque"):
        parts = []
        for table, description in zip(tables, given, strict=True):
            condition = (description.conditions or {}).get(name)
            if condition is not None:
                values = (table.values(condition.columns) - condition.reference) * np.array(condition.scales)
                parts.append(values if name == "torque" else values[:, 0])
        if len(parts) == len(tables):
            found[name] = np.concatenate(parts)
    return Conditions(**found)


def _poses(
    tables: list[Table],
    given: list[ColumnDescription],
    joints: Array,
    conditions: Conditions,
    geometry: Geometry,
    source: str,
) -> Measurements:
    """Poses or positions; unnamed attitude conventions are refused with what each would leave."""
    first, pairs = given[0], list(zip(tables, given, strict=True))
    position = np.concatenate([t.values(d.position) * TO_SI[d.position_unit] for t, d in pairs])
    for table, description in pairs:
        refuse_far(table, description)
        refuse_origin(table, description)
    rotation = None
    if first.rotation:
        values = np.concatenate([_attitudes(table, description) for table, description in pairs])
        if first.convention is None:
            raise InputError(
                f"{first.where}: [rotation] names no convention, and none is guessed; after fitting base and tool "
                f"each would leave, on average:\n{convention_table(geometry, joints, position, values, source)}\n"
                "name one of them, or the maker's, as convention in [rotation]"
            )
        rotation = rotations(first.convention, values)
    return Measurements(
        joints=joints,
        position=position,
        rotation=rotation,
        prismatic=geometry.prismatic,
        position_std=first.position_std,
        std_stated=first.std_stated,
        attitude_std=first.attitude_std,
        source=source,
        conditions=conditions,
    )


def _attitudes(table: Table, description: ColumnDescription) -> Array:
    """Attitude columns in rad, or quaternions, checked."""
    values = table.values(description.rotation) * TO_SI[description.rotation_unit]
    wanted = len(description.rotation) if description.convention is None else columns_of(description.convention)
    if values.shape[1] != wanted:
        raise InputError(f"{description.where}: convention '{description.convention}' needs {wanted} columns")
    if wanted == 4 and np.any(np.abs(np.linalg.norm(values, axis=1) - 1.0) > 0.01):
        bad = int(np.argmax(np.abs(np.linalg.norm(values, axis=1) - 1.0)))
        raise InputError(f"{table.where}: row {table.lines[bad]} holds a quaternion that is not of unit length")
    if wanted == 3 and np.abs(values).max() > 4 * np.pi:
        bad, column = divmod(int(np.argmax(np.abs(values))), values.shape[1])
        hint = "its unit is probably deg" if description.rotation_unit == "rad" else "correct or remove the row"
        raise InputError(
            f"{table.where}: row {table.lines[bad]}, column '{description.rotation[column]}' is "
            f"{np.abs(values[bad, column]):.0f} rad, which no rotation needs; {hint}"
        )
    return values


def _reflectors(
    tables: list[Table],
    given: list[ColumnDescription],
    joints: Array,
    conditions: Conditions,
    geometry: Geometry,
    source: str,
) -> ReflectorObservations:
    """Reflector groups; a reflector counts as lost only as the description says that it is marked."""
    first = given[0]
    points, seen = [], []
    for table in tables:
        blank = np.zeros((len(table.lines), len(first.position)), dtype=bool)
        if "empty" in first.lost:
            blank = np.stack([table.blank(name) for name in first.position], -1)
            for name in first.position:
                table.fill_blanks(name)
        values = table.values(first.position).reshape(len(table.lines), -1, 3) * TO_SI[first.position_unit]
        empty, zero = blank.reshape(values.shape).any(axis=2), (values == 0).all(axis=2)
        if (zero & ~empty).any() and "zeros" not in first.lost:
            row, which = np.argwhere(zero & ~empty)[0]
            raise InputError(
                f"{table.where}: row {table.lines[row]}: reflector {which + 1} lies at 0, 0, 0, which usually means "
                "that the tracker lost it; say lost = 'zeros' in [reflectors], or remove the row"
            )
        points.append(values)
        seen.append(~(empty | (zero if "zeros" in first.lost else empty)))
    visible = np.concatenate(seen)
    if (visible.sum(axis=0) < 3).any():
        which = int(np.argmin(visible.sum(axis=0)))
        raise InputError(f"{source}: reflector {which + 1} was seen in fewer than three poses; leave it out")
    return ReflectorObservations(
        joints=joints,
        points=np.concatenate(points),
        seen=visible,
        covariance=np.eye(3) * first.position_std**2,
        conditions=conditions,
        source=source,
    )


def _distances(
    tables: list[Table],
    given: list[ColumnDescription],
    joints: Array,
    conditions: Conditions,
    geometry: Geometry,
    source: str,
) -> DistanceObservations:
    first = given[0]
    length = np.concatenate([table.values(first.position)[:, 0] for table in tables]) * TO_SI[first.position_unit]
    if (length <= 0).any():
        raise InputError(f"{source}: a length is not above zero; correct or remove the row")
    return DistanceObservations(joints, length, first.position_std, conditions, source)


def _sockets(
    tables: list[Table],
    given: list[ColumnDescription],
    joints: Array,
    conditions: Conditions,
    geometry: Geometry,
    source: str,
) -> SocketObservations:
    """Sockets by a column, in consecutive pairs of their numbers; or one per file, the files of a folder a pair."""
    first = given[0]
    if first.position:
        named = np.concatenate([table.value(first.position[0]) for table in tables])
        labels, socket = np.unique(named, return_inverse=True)
        folders = [str(i // 2) for i in range(len(labels))]
    else:
        socket = np.repeat(np.arange(len(tables)), [len(table.lines) for table in tables])
        folders = [str(Path(table.where).parent) for table in tables]
    sockets: dict[str, list[int]] = {}
    for i, folder in enumerate(folders):
        sockets.setdefault(folder, []).append(i)
    pairs = [(members[0], other) for members in sockets.values() for other in members[1:2]]
    if first.spacing is not None and any(len(members) != 2 for members in sockets.values()):
        folder = next(folder for folder, members in sockets.items() if len(members) != 2)
        raise InputError(
            f"{source}: a spacing is given for pairs of sockets, but '{folder}' holds {len(sockets[folder])}; give two "
            "files per folder, or leave spacing_mm out"
        )
    known = pairs if first.spacing is not None else []
    return SocketObservations(
        joints=joints,
        socket=np.asarray(socket, dtype=np.int64),
        pairs=np.array(known, dtype=np.int64).reshape(-1, 2),
        spacing=np.full(len(known), first.spacing or 0.0),
        std=first.position_std,
        spacing_std=first.spacing_std,
        conditions=conditions,
        source=source,
    )


READERS: dict[str, Callable[..., Observations]] = {
    "position": _poses,
    "reflectors": _reflectors,
    "distance": _distances,
    "sockets": _sockets,
}
"""How each kind of `pickenv.calibration.reading.description.KINDS` is read."""


def _floor(tables: list[Table], given: list[ColumnDescription]) -> NoiseFloor:
    """Repeat sigma and quantisation, over all files."""
    repeat, digits = [], []
    for table, description in zip(tables, given, strict=True):
        if description.kind == "sockets":
            continue
        unit = TO_SI[description.position_unit]
        if description.position_std_columns:
            std = table.values(description.position_std_columns) * unit
            repeat.append(np.sum(std**2, axis=1) / (std.shape[1] / min(std.shape[1], 3)))
        step = table.resolution(description.position) * unit
        if step:
            digits.append(step * np.sqrt(min(len(description.position), 3) / 12.0))
    return NoiseFloor(
        repeat=float(np.sqrt(np.mean(np.concatenate(repeat)))) if repeat else None,
        digits=float(max(digits)) if digits else None,
    )
