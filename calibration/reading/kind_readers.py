"""Read measurements other than poses: reflectors, wires, bars, contacts of a tool point, inclinometers, and pictures.

Rows that the instrument cannot have measured are refused, and the message names file and line. Examples are a lost
reflector, a tool without contact, a length in another unit, or a direction that is not of unit length. Contacts that
are all in one pose are refused too.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Array, Geometry, Pose
from pickenv.base import LIMITS, TO_SI, InputError, check_limit, listed, read_text, register, yaml_content
from pickenv.calibration.camera.boards import Corners, Grey, corners_at, find_corners, find_tags, opencv, read_lens
from pickenv.calibration.model import kinds
from pickenv.calibration.model.arm_model import ArmModel, joints_of_finished_poses
from pickenv.calibration.model.observations import SAME_POSE, Observations, Origins, Rows, origins_of
from pickenv.calibration.model.pixels import LENS_NAMES, Lens, PixelObservations
from pickenv.calibration.reading import description
from pickenv.calibration.reading.table_files import Table, read_table, rotations, table_of_entries

# Files of one layout as columns of numbers, with their descriptions: what the readers of all kinds begin with.


@dataclass(frozen=True, eq=False)
class Files:
    """Files of one layout with their descriptions and joints: the input of the reader of every kind of measurement.

    Attributes:
        tables: The columns of each file.
        given: The column description of each file.
        where: Name of the description, for messages.
        geometry: The arm's nominal geometry.
        joints: Joints of all rows ``(N, n)``, rad or m.
        source: Name of the files, for messages.
        origins: File and line of each row.
    """

    tables: list[Table]
    given: list[description.DescriptionFile]
    where: str
    geometry: Geometry
    joints: Array
    source: str
    origins: Origins

    @property
    def first(self) -> description.DescriptionFile:
        """The first file's description; the other files' descriptions differ from it at most in units."""
        return self.given[0]

    def values(self) -> Array:
        """Return the readings of all rows ``(N, k)``, in SI units, from the columns that say what was measured."""
        return np.concatenate([t.values(d.columns) * TO_SI[d.unit] for t, d in self.pairs()])

    def place(self, row: int) -> str:
        """Return text for messages that names the file and line of the row with index ``row`` (from 0)."""
        return "{}: row {}".format(*self.origins.place(row))

    def pairs(self) -> Iterator[tuple[Table, description.DescriptionFile]]:
        """Iterate over the files: each file's table with its description."""
        return zip(self.tables, self.given, strict=True)


# What no row of a measurement file may be: implausible, a lost target, a repetition; each named by file and line.


QUANTITIES = {"temperature": "temperature_K", "payload": "payload_kg", "torque": "torque_Nm"}
"""For each recorded condition, the name of its limits in `pickenv.base.errors`; temperatures are from the reference."""

FARTHEST = 1e4
"""Largest distance at which an instrument can see a tool, m."""


def refuse_repeated_joints(layout: description.DescriptionFile, where: str, joints: Array, geometry: Geometry) -> None:
    """Refuse two joints with equal values in every row, since most likely one column was read twice.

    Joints that never move, and files of two rows or fewer, are not checked.

    Args:
        layout: The column description.
        where: Name of the description or file, for messages.
        joints: Joints of all rows ``(N, n)``, rad or m.
        geometry: The arm's nominal geometry.
    """
    for pair in combinations(range(geometry.joints), 2):
        one, other = (joints[:, i] for i in pair)
        if len(joints) > 2 and np.ptp(one) > 0 and np.array_equal(one, other):
            names = [f"joint {i + 1} ({geometry.joint_names[i]}, column '{layout.joint_columns[i]}')" for i in pair]
            both = f"{where}: {' and '.join(names)}"
            raise InputError(f"{both} hold the same number in every row; name each joint's own column")


def refuse_unseen(table: Table, layout: description.DescriptionFile) -> None:
    """Refuse positions that no instrument can have measured.

    These are positions beyond `FARTHEST`, and positions at exactly 0, 0, 0 unless all rows are at 0, 0, 0. Trackers
    write zeros for a lost reflector.

    Args:
        table: The file.
        layout: The column description.
    """
    values = table.values(layout.columns)
    for row, column in np.argwhere(np.abs(values) * TO_SI[layout.unit] > FARTHEST)[:1]:
        raise InputError(
            f"{table.cell(row, layout.columns[column])} is {values[row, column]:.6g} {layout.unit}, farther "
            "than any instrument sees; correct or remove the row"
        )
    zero = (values == 0).all(axis=1)
    if zero.any() and not zero.all():
        raise InputError(
            f"{table.where}: row {table.lines[int(np.argmax(zero))]} holds the position 0, 0, 0, which usually means "
            f"that the tracker lost the reflector ({int(zero.sum())} such rows); remove them"
        )


def refuse_duplicates(rows: Observations) -> None:
    """Refuse rows that equal another row to the last digit. They would count twice, and leak into held-out rows."""
    numbers, origins = np.concatenate([rows.joints, rows.readings()], axis=1), origins_of(rows)
    _, first, inverse, count = np.unique(numbers, axis=0, return_index=True, return_inverse=True, return_counts=True)
    for row in np.setdiff1d(np.arange(len(numbers)), first)[:1].tolist():
        file, line = origins.place(int(first[inverse.ravel()[row]]))
        place, this = origins.place(row)
        raise InputError(
            f"{place}: row {this} repeats row {line}{'' if file == place else f' of {file}'} to the last digit "
            f"({int((count - 1).sum())} repeated rows in all); remove them, they would count twice"
        )


def read_joints(table: Table, layout: description.DescriptionFile, where: str, geometry: Geometry) -> Array:
    """Read the joints of every row ``(N, n)``, rad or m.

    Args:
        table: The file.
        layout: The column description.
        where: Name of the description or file, for messages.
        geometry: The arm's nominal geometry.

    Raises:
        InputError: If the number or the units of the joint columns do not fit the arm. Also if a joint lies far beyond
            its limits, which almost always means a wrong unit, deg for rad or mm for m.
    """
    columns, count, n = [], len(layout.joint_units), geometry.joints
    if count != n:
        names = listed(geometry.joint_names)
        raise InputError(f"{where}: {count} joint columns are named, but the arm has {n} joints: {names}")
    for i, (column, unit) in enumerate(zip(layout.joint_columns, layout.joint_units, strict=True)):
        kind, units = ("prismatic", description.LENGTHS) if geometry.prismatic[i] else ("revolute", description.ANGLES)
        if unit not in units:
            raise InputError(f"{where}: joint {i + 1} is {kind}, but its unit is '{unit}'; give {' or '.join(units)}")
        scale, lower, upper = TO_SI[unit], geometry.lower[i], geometry.upper[i]
        values = table.value(column) * scale
        room = upper - lower if geometry.prismatic[i] else max(upper - lower, 2 * np.pi)
        outside = (values < lower - room) | (values > upper + room)
        for row in np.flatnonzero(outside)[:1]:
            likely = {"rad": "deg", "deg": "rad", "m": "mm", "mm": "m"}[unit]
            mixed = f" ({int(outside.sum())} of {len(values)} rows are so)" if not outside.all() else ""
            raise InputError(
                f"{table.cell(row, column)} is {values[row] / scale:.6g} {unit}, but "
                f"joint {i + 1} ({geometry.joint_names[i]}) moves over {lower / scale:.4g} to {upper / scale:.4g} "
                f"{unit}; its unit is probably {likely}{mixed}"
            )
        columns.append(values)
    return np.stack(columns, -1)


def refuse_implausible_conditions(table: Table, name: str, values: Array, columns: tuple[str, ...]) -> None:
    """Refuse temperatures, payloads or torques beyond the limits of `QUANTITIES`; no arm works beyond them.

    Args:
        table: The file.
        name: The condition, one of `QUANTITIES`.
        values: The condition's values ``(N, k)``, SI; temperatures relative to the reference.
        columns: Names of the k columns, for messages.
    """
    least, most, _ = LIMITS[QUANTITIES[name]]
    for row, column in np.argwhere((values < least) | (values > most))[:1]:
        place = f"{table.cell(row, columns[column])} as {QUANTITIES[name]}"
        check_limit(place, float(values[row, column]), QUANTITIES[name])


def read_attitudes(table: Table, described: description.RotationTable | None) -> Array:
    """Read and check the values ``(N, 3 or 4)`` of a file's attitude columns: angles in rad, or quaternions.

    Args:
        table: The file.
        described: Section [rotation], whose unit was checked; not None.

    Raises:
        InputError: If a quaternion is not of unit length, or an angle is larger than any rotation needs.
    """
    assert described is not None
    columns = described.columns
    values = table.values(columns) * (1.0 if len(columns) == 4 else TO_SI[described.unit])
    if len(columns) == 4:
        excess = np.abs(np.linalg.norm(values, axis=1) - 1.0)
        if excess.max() > 0.01:
            line = table.lines[int(np.argmax(excess))]
            raise InputError(f"{table.where}: row {line} holds a quaternion that is not of unit length")
    elif np.abs(values).max() > 4 * np.pi:
        bad, column = divmod(int(np.argmax(np.abs(values))), 3)
        hint = "its unit is probably deg" if described.unit == "rad" else "correct or remove the row"
        size = f"{np.abs(values[bad, column]):.0f} rad, which no rotation needs"
        raise InputError(f"{table.cell(bad, columns[column])} is {size}; {hint}")
    return values


TURNED = float(np.radians(1.0))
"""Range of each joint over several rows, rad or m, below which these rows count as one pose."""

UNIT_LENGTH = 0.02
"""Largest allowed difference of a direction vector's length from 1."""

EXPLAINED, UNEXPLAINED = 0.2, 0.5
"""Limits on the misfit of a wire's lengths to the best anchor, as a share of the lengths' spread. In the right unit the
misfit is below the first limit. In a wrong unit it is at or above the second limit."""


@register("instrument", "reflectors")
def _reflectors(files: Files, section: description.ReflectorsTable) -> kinds.ReflectorObservations:
    """Read positions of several reflectors.

    A reflector counts as lost in a row only if it is marked there as the description's ``lost`` says.
    """
    first = files.first
    points, visible_parts = [], []
    for table in files.tables:
        blank = np.zeros((len(table.lines), len(first.columns)), dtype=bool)
        if "empty" in section.lost:
            blank = np.stack([table.fill_blanks(name) for name in first.columns], -1)
        values = table.values(first.columns).reshape(len(table.lines), -1, 3) * TO_SI[first.unit]
        empty, zero = blank.reshape(values.shape).any(axis=2), (values == 0).all(axis=2)
        for row, which in () if "zeros" in section.lost else np.argwhere(zero & ~empty)[:1]:
            raise InputError(
                f"{table.where}: row {table.lines[row]}: reflector {which + 1} lies at 0, 0, 0, which usually means "
                "that the tracker lost it; say lost = 'zeros' in [reflectors], or remove the row"
            )
        points.append(values)
        visible_parts.append(~(empty | zero))
    visible = np.concatenate(visible_parts)
    if (visible.sum(axis=0) < 3).any():
        which = int(np.argmin(visible.sum(axis=0)))
        raise InputError(f"{files.source}: reflector {which + 1} was seen in fewer than three poses; leave it out")
    data = kinds.ReflectorObservations(files.joints, np.concatenate(points), visible, first.std)
    places = np.reshape(section.places, (-1, 3)) if section.places else None
    return replace(data, places=places, places_std=section.places_std)


@register("instrument", "wire")
def _wire(files: Files, section: description.WireTable) -> kinds.DistanceObservations:
    """Read lengths of a draw wire; refuse lengths that are not above zero or fit only in another unit."""
    length = files.values()[:, 0]
    for row in np.flatnonzero(length <= 0.0)[:1]:
        raise InputError(f"{files.place(row)}: a length of {length[row] * 1e3:.6g} mm is not above zero; correct it")
    data = _distances(files, section, length, zero=section.zero, zero_std=section.zero_std, scale_std=section.scale_std)
    _refuse_other_unit(files, data)
    return data


@register("instrument", "plane")
@register("instrument", "sphere")
@register("instrument", "bar")
def _kept(files: Files, section: description.ContactTable) -> kinds.DistanceObservations:
    """Read contacts at a ball bar, a sphere or a plane: one distance for all rows, known or to be fitted."""
    length = getattr(section, "length", 0.0)  # a plane has none; None is to be fitted
    zero_std = np.inf if length is None else getattr(section, "length_std", 0.0)
    surface = "plane" if files.first.kind == "plane" else "point"
    data = _distances(files, section, np.full(len(files.joints), length or 0.0), zero_std=zero_std, surface=surface)
    _refuse_one_pose(files, np.arange(len(files.joints)))
    return data


@register("instrument", "dial")
def _dial(files: Files, section: description.DialTable) -> kinds.DistanceObservations:
    """Read a dial gauge, whose readings are distances from a plane; refuse readings without contact."""
    reading = files.values()[:, 0]
    for row in np.flatnonzero(np.isclose(reading, section.free, rtol=0.0, atol=1e-9))[:1]:
        raise InputError(
            f"{files.place(row)}: the dial reads {reading[row] * 1e3:.6g} mm, as one that touches nothing; remove "
            "the row, or say in [dial] what it reads then (free_mm)"
        )
    return _distances(files, section, reading, surface="plane", scale_std=section.scale_std)


def _distances(files: Files, section: description.ContactTable, read: Array, **more: Any) -> kinds.DistanceObservations:
    """Return readings as distances, with the fields that all contact measurements share.

    Args:
        files: The files.
        section: The section of the description.
        read: The readings ``(N,)``, m.
        **more: Further fields of `DistanceObservations`.
    """
    return kinds.DistanceObservations(length=read, **_contact(files, section), **more)


def _contact(files: Files, section: description.ContactTable) -> dict[str, Any]:
    """Return the fields that all contact measurements share, by name: joints, uncertainty, kind and tool point.

    Raises:
        InputError: If the contact column of a row is 0 or empty.
    """
    for table in files.tables if section.contact is not None else ():
        table.fill_blanks(str(section.contact))
        for row in np.flatnonzero(table.column(str(section.contact)) == 0.0)[:1]:
            raise InputError(f"{table.cell(row, section.contact)} says that nothing was touched; remove the row")
    tip = {"tip": section.tool_point, "tip_std": section.tip_std}
    return {"joints": files.joints, "std": files.first.std, "kind": files.first.kind, **tip}


@register("instrument", "touches")
def _touches(files: Files, section: description.ContactTable) -> kinds.SocketObservations:
    """Read contacts with one fixed point, the same in every row."""
    socket, none = np.zeros(len(files.joints), dtype=np.int64), np.zeros((0, 2), dtype=np.int64)
    return _rests(files, section, socket, pairs=none, spacing=np.zeros(0), places=("point",))


@register("instrument", "sockets")
def _sockets(files: Files, section: description.SocketsTable) -> kinds.SocketObservations:
    """Read contacts with several sockets, and the pairs of sockets with known spacing.

    If a column numbers the sockets, consecutive numbers make a pair. Otherwise each file holds one socket, and the two
    files of a folder make a pair.
    """
    names: tuple[str, ...] = ()
    if files.first.columns:
        numbers = np.concatenate([table.value(files.first.columns[0]) for table in files.tables])
        labels, socket = np.unique(numbers, return_inverse=True)
        folders = [str(i // 2) for i in range(len(labels))]
        names = tuple(f"socket{label:g}" for label in labels)
    else:
        socket = files.origins.file
        folders = [str(Path(table.where).parent) for table in files.tables]
    members = {folder: [i for i, home in enumerate(folders) if home == folder] for folder in folders}
    for folder, sockets in members.items():
        if section.spacing is not None and len(sockets) != 2:
            raise InputError(
                f"{files.source}: a spacing is given for pairs of sockets, but '{folder}' holds {len(sockets)}; give "
                "two files per folder, or leave spacing_mm out"
            )
    pairs = np.array([] if section.spacing is None else list(members.values()), dtype=np.int64).reshape(-1, 2)
    spacing = np.full(len(pairs), section.spacing or 0.0)
    spaced = {"pairs": pairs, "spacing": spacing, "spacing_std": section.spacing_std}
    return _rests(files, section, socket, places=names, **spaced)


def _rests(files: Files, section: description.ContactTable, socket: Rows, **more: Any) -> kinds.SocketObservations:
    """Return contacts with sockets; refuse a socket whose rows are all in one pose.

    Args:
        files: The files.
        section: The section of the description.
        socket: Number of each row's socket ``(N,)``, from 0.
        **more: Further fields of `SocketObservations`.
    """
    contact = _contact(files, section)
    for place in np.unique(socket):
        _refuse_one_pose(files, np.flatnonzero(socket == place))
    return kinds.SocketObservations(socket=np.asarray(socket, dtype=np.int64), **contact, **more)


@register("instrument", "tilt")
def _tilt(files: Files, section: description.TiltTable) -> kinds.TiltObservations:
    """Read the components of the downward direction along the sensor's axes; an inclination gives its sine."""
    values = np.concatenate([table.values(section.columns) for table in files.tables])
    std = np.full(values.shape, section.std)
    if section.unit != "g":
        angles = values * TO_SI[section.unit]
        for row, column in np.argwhere(np.abs(angles) > np.pi / 2)[:1]:
            raise InputError(
                f"{files.place(row)}: an inclination of {np.degrees(angles[row, column]):.4g} deg is beyond 90; "
                "correct the row, or the unit of [tilt]"
            )
        values, std = np.sin(angles), std * np.maximum(np.cos(angles), UNIT_LENGTH)
    size = np.linalg.norm(values, axis=1)
    wrong = size > 1.0 + UNIT_LENGTH if values.shape[1] < 3 else np.abs(size - 1.0) > UNIT_LENGTH
    for row in np.flatnonzero(wrong)[:1]:
        raise InputError(
            f"{files.place(row)}: the components of down have length {size[row]:.4g}, not 1; divide them by "
            "gravity, or remove rows in which the arm still moved"
        )
    _refuse_one_pose(files, np.arange(len(files.joints)))
    return kinds.TiltObservations(files.joints, values, std, axes_std=section.axes_std, down_std=section.down_std)


def _refuse_one_pose(files: Files, rows: Rows) -> None:
    """Refuse rows that were all taken in one pose, because they say nothing about the arm.

    Args:
        files: The files.
        rows: Indices, from 0, of the rows of one socket, or of one touched point or surface.
    """
    if len(rows) > 1 and np.ptp(files.joints[rows], axis=0).max() < TURNED:
        raise InputError(
            f"{files.source}: all {len(rows)} rows of one place are in one pose, to a degree; turn the tool and move "
            "every joint between them"
        )


def _refuse_other_unit(files: Files, data: kinds.DistanceObservations) -> None:
    """Refuse lengths of a wire that fit no anchor in the stated unit, but fit one in the other unit (m or mm)."""

    def left(factor: float) -> float:
        read = replace(data, length=data.length * factor, scale_std=0.0, tip_std=0.0)
        model = ArmModel.of(files.geometry)
        misses = read.misses(model, read.start(model))[:, 0]
        spread = np.median(np.abs(read.length - np.median(read.length)))
        return float(np.median(np.abs(misses)) / max(float(spread), 1e-12))

    if left(1.0) < UNEXPLAINED:
        return
    unit = files.first.unit
    likely, factor = ("m", 1e3) if unit == "mm" else ("mm", 1e-3)
    if left(factor) < EXPLAINED:
        median = np.median(data.length) / TO_SI[unit]
        raise InputError(
            f"{files.source}: lengths of {median:.4g} {unit} (median) fit no anchor, but as {likely} they do; correct "
            "unit of [wire]"
        )


# Views of a board: pictures with the arm's joints or finished poses beside them, or a table of corners found in them.
# Every view is named by its picture, or by the line where its corners begin. What a picture shows is found when it is
# read (`pickenv.calibration.camera.boards`), and a picture that shows nothing is refused by name.


STEM = "{file}"
"""Placeholder in a path. In a picture's path it stands for the name of the pose file without ending. In a joint log's
path it stands for the name of the instrument's file without ending, or for the name of a bag."""

MANY_BLIND = 0.25
"""Share of pictures without a detected corner above which all pictures are refused, since something is wrong."""

DEFAULT_STD = 0.3
"""Standard uncertainty, px, of corners in a table whose description states none."""


def read_views(
    table: Table, home: Path, geometry: Geometry, file: description.DescriptionFile, where: str
) -> PixelObservations:
    """Read views of a board or another target: pictures, or a table of the corners detected in them.

    Args:
        table: The views, one row each, or their corners.
        home: Folder that the paths of pictures start from.
        geometry: The arm's nominal geometry, for joint count and types. It is not used if tool poses are given in
            place of joint values.
        file: The description, with [pixels], [board] and [camera].
        where: Name of the description, for messages.

    Raises:
        InputError: If something is wrong; the message names the file, row, column or picture.
    """
    assert file.pixels is not None and file.camera is not None
    camera = _lens(file.camera, home)
    pictures: list[Path] = []
    if file.pixels.columns:
        rows, views = _found_in_table(table, file.pixels, file.target_points[1])
        remarks = [""] * len(rows)
    else:
        pictures = _pictures(table, file.pixels, home)
        views, remarks = _found_in_pictures(table, file, pictures, camera)
        rows = list(range(len(table.lines)))
    if (poses := file.poses) is None:
        every = read_joints(table, file, where, geometry)
        joints = every[rows]
        refuse_repeated_joints(file, where, joints, geometry)
    else:
        turned = rotations(poses.convention, read_attitudes(table, poses.attitudes))
        every = joints_of_finished_poses(Pose(table.values(poses.columns) * TO_SI[poses.unit], turned))
        joints = every[rows]
    if file.pixels.view is not None and file.pixels.columns:
        _refuse_moved(table, table.texts(file.pixels.view), every)
    corners, visible, std = map(np.stack, zip(*views, strict=True))
    lines = np.array(table.lines, dtype=np.int64)[rows]
    std = std if file.pixels.std is None else np.full_like(std, file.pixels.std)
    origins = Origins((table.where,), np.zeros_like(lines), lines)
    lens = camera, _lens_std(file.camera)
    data = PixelObservations(joints, corners, visible, file.target_points[0], *lens, std, file.pixels.mount or "world")
    names = np.array([str(path) for path in pictures]) if pictures else None
    data = replace(data, source=table.where, remarks=np.array(remarks), pictures=names, origins=origins)
    refuse_duplicates(data)
    return data


def views_table(
    paths: Sequence[str | Path], pixels: description.PixelsTable, layout: description.DescriptionFile
) -> tuple[Table, Path]:
    """Read the table of views, which has one row per view or one per corner.

    Args:
        paths: A list of one CSV or YAML file, or of one folder whose files match the description's ``files``.
        pixels: Section [pixels] of the description.
        layout: The description.

    Returns:
        The table, and the folder that the paths of pictures start from.

    Raises:
        InputError: If there is more than one path, or if something is wrong with the file.
    """
    if len(paths) != 1:
        raise InputError(f"views of a board are given as one file or folder, not as {len(paths)}; give one")
    path = Path(paths[0])
    if not path.is_dir():
        return read_table(path, layout.separator, layout.decimal, layout.names), path.parent
    if pixels.files is None:
        raise InputError(f"{path} is a folder; give a file, or say in [pixels] which files it holds (files)")
    files = sorted(path.glob(pixels.files), key=_by_number)
    if not files:
        raise InputError(f"{path} holds no file {pixels.files}; give another folder, or correct files of [pixels]")
    return table_of_entries(str(path), [_entry(file) for file in files]), path


def _entry(file: Path) -> dict[str, str]:
    """Return the entries of a YAML file that describes one view, with the file's name (no ending) added as "file"."""
    content = yaml_content(read_text(file, "a YAML file"), file)
    entry = {str(key): str(value) for key, value in content.items()} if isinstance(content, dict) else {}
    if not entry:
        raise InputError(f"{file} holds no numbers by name; give one file per view with the pose in it")
    return entry | {"file": file.stem}


def _by_number(file: Path) -> list[tuple[int, str]]:
    """Return a sort key for a file by the numbers in its name, so that 2.yaml comes before 10.yaml."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", file.name)]


def _pictures(table: Table, pixels: description.PixelsTable, home: Path) -> list[Path]:
    """Return the path of each row's picture; paths in the table start from the folder ``home``."""
    pattern = str(pixels.picture)
    if STEM in pattern:
        return [home / pattern.replace(STEM, stem) for stem in table.texts("file")]
    return [home / name for name in table.texts(pattern)]


def _found_in_pictures(
    table: Table, file: description.DescriptionFile, pictures: Sequence[Path], camera: Lens
) -> tuple[list[Corners], list[str]]:
    """Detect the corners in each row's picture.

    A few pictures without a corner are kept, to be listed in reports.

    Args:
        table: The views, one row each.
        file: The description, with [board] or [target].
        pictures: Path of each row's picture.
        camera: The lens.

    Returns:
        The corners of each picture, and for each picture the reason why it shows no corner (empty if it shows one).

    Raises:
        InputError: If a picture is missing or of another size than the lens, or if more than `MANY_BLIND` show none.
    """
    views, remarks, numbers = [], [], file.target_points[1]
    for path, line in zip(pictures, table.lines, strict=True):
        if not path.is_file():
            raise InputError(f"{table.where}: row {line}: picture {path} does not exist; correct or remove the row")
        picture, remark = _grey(path), ""
        height, width = picture.shape
        if (width, height) != camera.size:
            raise InputError(
                f"{table.where}: row {line}: the picture has {width} x {height} px, but the lens is for "
                f"{camera.size[0]} x {camera.size[1]}; give the camera's numbers at this resolution"
            )
        try:
            if file.target is None:
                assert file.board is not None
                views.append(find_corners(file.board, picture, str(path)))
            else:
                views.append(find_tags(str(file.target.dictionary), numbers, picture, str(path)))
        except InputError as error:
            views.append(corners_at(len(numbers), [], np.zeros((0, 2)), []))
            remark = str(error)
        remarks.append(remark)
    faults = list(filter(None, remarks))
    if len(faults) > MANY_BLIND * len(views):
        raise InputError(faults[0])
    return views, remarks


def _grey(path: Path) -> Grey:
    """Read a picture's grey values ``(h, w)``, 0 to 255."""
    picture = opencv().imread(str(path), opencv().IMREAD_GRAYSCALE)
    if picture is None:
        raise InputError(f"{path} is no picture that OpenCV can read; give a JPEG or PNG file")
    return np.asarray(picture, dtype=np.uint8)


def _found_in_table(
    table: Table, pixels: description.PixelsTable, known: Sequence[int]
) -> tuple[list[int], list[Corners]]:
    """Read a table of corners.

    Args:
        table: The table, with one row per corner.
        pixels: Section [pixels] of the description.
        known: Numbers of the board's corners; the table may hold no others.

    Returns:
        The index, from 0, of the first row of each view, and the corners of each view.
    """
    assert pixels.view is not None and pixels.corner is not None
    views, numbers, places = table.texts(pixels.view), table.value(pixels.corner), table.values(pixels.columns)
    rows: list[int] = []
    corners: list[Corners] = []
    for row in np.flatnonzero(~np.isin(numbers, known))[:1]:
        raise InputError(
            f"{table.where}: row {table.lines[row]}: corner {numbers[row]:g} is none of the board's {len(known)} "
            f"({known[0]} to {known[-1]}); correct it, or [board] or [target]"
        )
    places_of = {number: i for i, number in enumerate(known)}
    numbers = np.array([places_of[int(number)] for number in numbers])
    for name in dict.fromkeys(views):
        mine = np.array([i for i, view in enumerate(views) if view == name])
        if len(np.unique(numbers[mine])) < len(mine):
            raise InputError(f"{table.where}: view '{name}' has a corner twice; remove one")
        rows.append(int(mine[0]))
        corners.append(corners_at(len(known), numbers[mine], places[mine], DEFAULT_STD))
    return rows, corners


def _refuse_moved(table: Table, views: Sequence[str], joints: Array) -> None:
    """Refuse corners of one view at different joints (or tool poses in their place): they are of several pictures.

    Args:
        table: The corners, one row each.
        views: Name of each row's view.
        joints: Joints of each row ``(N, n)``, rad or m.
    """
    first: dict[str, int] = {}
    for row, name in enumerate(views):
        begin = first.setdefault(name, row)
        if np.abs(joints[row] - joints[begin]).max() > SAME_POSE:
            raise InputError(
                f"{table.where}: rows {table.lines[begin]} and {table.lines[row]} are of view '{name}', but the arm "
                "stands otherwise in them; give each picture a name of its own"
            )


def _lens(given: description.LensTable, home: Path) -> Lens:
    """Return the lens that section [camera] gives by numbers, or by a file whose path starts from folder ``home``."""
    if given.file is not None:
        return read_lens(home / given.file)
    distortion = np.resize([*given.distortion, 0.0], 5)  # the fifth is zero if four are given
    values = np.array([given.fx, given.fy, given.cx, given.cy, *distortion], dtype=float)
    return Lens(values, (given.width or 0, given.height or 0))


def _lens_std(given: description.LensTable) -> Array:
    """Return the standard uncertainty of each number of the lens: 0 if fixed, infinite if free, or the stated prior."""
    if given.lens == "prior":
        return np.array([given.prior_px] * 4 + [given.prior_distortion] * 5)
    return np.full(len(LENS_NAMES), 0.0 if given.lens == "fixed" else np.inf)
