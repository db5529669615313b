"""Read measurement files of any kind: in pickenv's columns, or in other columns that a column description explains.

`read_measurements` reads poses or positions. `read_observations` reads any kind, from one file or several.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm, Array, Geometry, Pose, inverse, rotation_matrix
from pickenv.base import TO_SI, InputError, listed, register, shortened, shown
from pickenv.base.registry import get
from pickenv.calibration.model.arm_model import Conditions
from pickenv.calibration.model.measurements import (
    FRAMES,
    FRAMES_COLUMN,
    OWN_CONDITIONS,
    Frames,
    Measurements,
    joint_columns,
)
from pickenv.calibration.model.observations import Clocks, Observations, Origins, origins_of
from pickenv.calibration.reading import description, kind_readers, recording, table_files


def read_measurements(
    path: str | Path, geometry: Geometry | Arm, columns: str | Path | None = None, *, repeats: bool = False
) -> Measurements:
    """Read a file of poses or positions.

    Args:
        path: The file.
        geometry: The arm, or its nominal geometry, for joint count and types.
        columns: Name or path of a column description; None for pickenv's own format.
        repeats: Whether a row may equal another to the last digit, as repeated measurements of a pose can. If False,
            such rows are refused.

    Raises:
        InputError: Names the file, row, column or unit at fault.
    """
    rows = read_observations([path], geometry, columns, repeats=repeats)
    poses: Measurements | None = rows.poses
    if poses is None:
        raise InputError(
            f"{path}: holds {rows.kind}, not poses or positions, which are needed here; describe them as [position]"
        )
    return poses


def read_observations(
    paths: Sequence[str | Path], geometry: Geometry | Arm, columns: str | Path | None = None, *, repeats: bool = False
) -> Observations:
    """Read measurements of any kind from one file, or from several files of one layout, as one data set.

    Without a socket column, each file of sockets holds one socket, and the two files of a folder are a pair.

    Args:
        paths: The files.
        geometry: The arm, or its nominal geometry, for joint count and types.
        columns: Name or path of a column description; None for pickenv's own format.
        repeats: Whether a row may equal another to the last digit, as repeated measurements of a pose can. If False,
            such rows are refused.

    Raises:
        InputError: Names the file, row, column or unit at fault, or says that the files hold several data sets.
    """
    sets = read_scene(paths, geometry, columns, repeats=repeats)
    if len(sets) > 1:
        rows_of = listed(" of ".join(filter(None, origins_of(part).scene)) or part.source for part in sets)
        raise InputError(f"{paths[0]}: has rows of {rows_of}, of which one is needed here; name it in [scene]")
    return sets[0]


def read_scene(
    paths: Sequence[str | Path], geometry: Geometry | Arm, columns: str | Path | None = None, *, repeats: bool = False
) -> list[Observations]:
    """Read measurements as `read_observations` does, as one data set for each pair of sensor and target.

    Args:
        paths: The files.
        geometry: The arm, or its nominal geometry, for joint count and types.
        columns: Name or path of a column description, whose [scene] may name columns of sensors and targets.
        repeats: Whether a row may equal another to the last digit.

    Raises:
        InputError: Names the file, row, column or unit at fault.
    """
    geometry = geometry.nominal if isinstance(geometry, Arm) else geometry
    if not isinstance(geometry, Geometry):
        raise InputError(f"geometry is {shown(geometry)}; give the arm, as `pickenv.load_arm` returns it")
    if not paths:
        raise InputError("no measurement file was given; give at least one")
    table_files.refuse_repeated(paths)
    given = None if columns is None else description.load_description(columns)
    where = "" if columns is None else str(description.description_path(columns))
    if given is not None and given.pixels is not None:
        logs = [kind_readers.views_table(paths, given.pixels, given)]
    else:
        form = () if given is None else (given.separator, given.decimal, given.names)
        topic = None if given is None or given.recording is None else given.recording.topic
        logs = [(table_files.read_log(Path(path), topic, *form), Path(path)) for path in paths]
    return [_data_set(part, geometry, layout, where, repeats) for layout, part in _by_scene(logs, given)]


Log = tuple[table_files.Table, Path]
"""A file as a table, and the file's path. For views, a folder takes the place of the path: paths of pictures start
there."""


def _by_scene(
    logs: list[Log], given: description.DescriptionFile | None
) -> list[tuple[description.DescriptionFile | None, list[Log]]]:
    """Split files by the sensor, target and series of their rows.

    Args:
        logs: The files.
        given: The files' column description. If it has no [scene] or is None, all files are one part.

    Returns:
        For each part, a column description whose [scene] names the part's sensor and target, and the part's files.

    Raises:
        InputError: If a row has an empty name, or no row names the sensor, target or series of the description. Also if
            [scene.links] names an unknown sensor or target.
    """
    if given is None or given.scene == description.SceneTable():
        return [(given, logs)]
    scene, parts = given.scene, dict[tuple[str, ...], list[Log]]()
    asked = [(what, getattr(scene, f"{what}_column"), getattr(scene, what)) for what in ("sensor", "target", "series")]
    known = {scene.sensor, scene.target}
    for table, path in logs:
        rows_of, rows = dict[tuple[str, ...], list[int]](), list(range(len(table.lines)))
        texts = [[name] * len(rows) if column is None else table.texts(column) for _, column, name in asked]
        known.update(*texts[:2])
        for i, (_, _, name) in enumerate(asked):
            rows = [row for row in rows if texts[i][row] == name] if name else rows
        for row in rows:
            for (_, column, _), cells in zip(asked, texts, strict=True):
                if column is not None and not cells[row]:
                    raise InputError(f"{table.cell(row, column)} is empty; name the row's own, or remove the row")
            rows_of.setdefault(tuple(cells[row] for cells in texts), []).append(row)
        for names, of_names in rows_of.items():
            where = f"{table.where}, series {shortened(names[2])}" if names[2] else table.where
            part = names[:2] if given.pixels is None else names  # a data set of views is one file
            parts.setdefault(part, []).append((table.select(of_names, where), path))
    for name, _ in scene.links:
        if name not in known:
            named = listed(sorted(known - {""})) or "without names"
            raise InputError(
                f"{logs[0][0].where}: [scene.links] has '{shortened(name)}', but sensors and targets are {named}"
            )
    if not parts:
        named = " and ".join(f"{what} '{shortened(name)}' in column '{column}'" for what, column, name in asked if name)
        raise InputError(f"{logs[0][0].where}: no row names {named}; correct [scene]")
    return [
        (replace(given, scene=replace(scene, sensor=names[0], target=names[1])), part) for names, part in parts.items()
    ]


def _data_set(
    logs: list[Log], geometry: Geometry, given: description.DescriptionFile | None, where: str, repeats: bool
) -> Observations:
    """Read files of one layout, whose rows are of one sensor and one target, as one data set.

    Args:
        logs: The files.
        geometry: The arm's nominal geometry.
        given: The column description; None for pickenv's own format.
        where: Name of the description, for messages; empty for pickenv's own format.
        repeats: Whether a row may equal another to the last digit.
    """
    tables = [table for table, _ in logs]
    names, links = (("", ""), ("", "")) if given is None else given.ends
    geometry = _between(geometry, links, where or tables[0].where)
    if given is not None and given.pixels is not None:
        return _placed(kind_readers.read_views(*logs[0], geometry, given, where), geometry, scene=names)
    layouts = [given or own_description(geometry, table.header, table.where) for table in tables]
    logged, described, clocks = tables, layouts, tuple[Clocks, ...]()
    if given is not None and given.recording is not None:

        def read(table: table_files.Table, layout: description.DescriptionFile) -> Observations:
            return _rows([table], [layout], where, geometry, "fitted")

        parts = [recording.read_recording(table, path, given, where, geometry, read) for table, path in logs]
        tables, layouts, clocks = [part[0] for part in parts], [part[1] for part in parts], tuple(p[2] for p in parts)
    rows = _rows(tables, layouts, where, geometry, "fitted" if given is not None else _frames(tables))
    if not repeats:
        kind_readers.refuse_duplicates(rows)
    return _placed(rows, geometry, scene=names, clocks=clocks, repeat=_repeat(logged, described))


def own_description(geometry: Geometry, header: list[str], where: str) -> description.DescriptionFile:
    """Make the column description of a file in pickenv's own CSV format.

    Args:
        geometry: The arm's nominal geometry, whose joints give the names of joint columns.
        header: Column names of the file.
        where: The file, for messages.

    Raises:
        InputError: If a joint column is missing or its unit unknown, or if a condition's column is not of that format.
    """
    expected = joint_columns(geometry.prismatic)
    joints = dict[str, str]()  # the unit of each column
    for name in expected:
        stem = name.rpartition("_")[0]
        columns = [column for column in header if column.rpartition("_")[0] == stem]
        unit = columns[0].rpartition("_")[2] if len(columns) == 1 else ""
        if unit not in description.LENGTHS + description.ANGLES:
            faults = ("is missing", f"has the unknown unit '{unit}'", "is given twice")
            fault, ours = faults[min(len(columns), 2)], f"{', '.join(expected)}, x_mm, y_mm, z_mm"
            raise InputError(f"{where}: joint column '{name}' {fault}; our format has {ours}")
        joints[columns[0]] = unit
    _refuse_more_joints(header, expected, geometry, where)
    position_unit = "m" if "x_m" in header else "mm"
    has_rotation = any(column.startswith(("rx_", "ry_", "rz_")) for column in header)
    rotation_unit = "rad" if "rx_rad" in header else "deg"
    for column in header:
        if column.lower().startswith(("temp", "payload", "torque")) and column not in OWN_CONDITIONS:
            raise InputError(
                f"{where}: column '{shortened(column)}' is none of our format's, which records "
                f"{' and '.join(OWN_CONDITIONS)}; rename it, describe it in [conditions] of `columns`, or remove it"
            )
    angles, (warmth, mass) = tuple(f"r{axis}_{rotation_unit}" for axis in "xyz"), OWN_CONDITIONS
    return description.DescriptionFile(
        joints=description.JointsTable(tuple(joints), units=tuple(joints.values())),
        position=description.LengthsTable(
            columns=tuple(f"{axis}_{position_unit}" for axis in "xyz"), unit=position_unit
        ),
        rotation=description.RotationTable(angles, rotation_unit, "rotation_vector") if has_rotation else None,
        conditions=description.ConditionsTable(
            description.TemperatureTable(warmth, "degC") if warmth in header else None,
            description.PayloadTable(mass, "kg") if mass in header else None,
        ),
    )


def _refuse_more_joints(header: Sequence[str], expected: Sequence[str], geometry: Geometry, where: str) -> None:
    """Refuse a joint column that is of none of the arm's joints.

    A column of a mimic joint or a slide would otherwise renumber the other joints.

    Args:
        header: Column names of the file.
        expected: Names of the arm's joint columns.
        geometry: The arm's nominal geometry.
        where: The file, for messages.
    """
    stems = {name.rpartition("_")[0] for name in expected}
    for column in header:
        stem, _, unit = column.rpartition("_")
        numbered = stem[:1] == "q" and stem[1:].isdecimal() and unit in description.LENGTHS + description.ANGLES
        if numbered and stem not in stems:
            raise InputError(
                f"{where}: column '{shortened(column)}' is of none of the arm's joints, which are "
                f"{listed(geometry.joint_names)} in this order; remove it (a mimic joint has no column), or number the "
                "columns so"
            )


def _between(geometry: Geometry, links: tuple[str, str], where: str) -> Geometry:
    """Return the geometry whose poses are the poses of the second link relative to the first link.

    A single chain, which is no whole robot, is returned unchanged.

    Args:
        geometry: The geometry of the robot.
        links: Names of the two links; an empty name is the world.
        where: Name of the description or file, for messages.

    Raises:
        InputError: If the robot has no such link, if both links move together, or if links of a single chain are named.
    """
    tree, ends = geometry.tree, []
    for name in links:
        if name and (tree is None or name not in tree.names):
            what = "the arm is a single chain" if tree is None else f"the arm has {', '.join(tree.names)}"
            advice = f"name all of [scene]'s links in the arm, as in robot.urdf#{','.join(filter(None, links))}"
            raise InputError(f"{where}: [scene] names link '{shortened(name)}', but {what}; {advice}")
        ends.append(-1 if tree is None or not name else tree.carriers[tree.names.index(name)])
    if tree is None:
        return geometry
    if ends[0] == ends[1]:
        both = f"'{shortened(links[0])}' and '{shortened(links[1])}'" if any(links) else "neither sensor nor target"
        moved = "do not move against each other" if any(links) else "is on a link of this whole robot"
        raise InputError(f"{where}: {both} {moved}; name sensor_link or target_link in [scene]")
    return geometry.between(*ends)


def _placed(rows: Any, geometry: Geometry, **origins: Any) -> Observations:
    """Return rows with their `Origins` added, and for a whole robot with the links of sensor and target added too.

    Args:
        rows: The rows, `Observations` of any kind.
        geometry: The geometry from `_between`.
        **origins: Fields of `Origins`, such as the names of sensor and target in the order of ``DescriptionFile.ends``.
    """
    conditions = rows.conditions
    if geometry.tree is not None:
        between = np.tile([geometry.tree.sensor, geometry.tree.target], (len(rows.joints), 1))
        conditions = replace(conditions, between=between)
    placed: Observations = replace(rows, origins=replace(origins_of(rows), **origins), conditions=conditions)
    return placed


def _rows(
    tables: list[table_files.Table],
    layouts: list[description.DescriptionFile],
    where: str,
    geometry: Geometry,
    frames: Frames,
) -> Observations:
    """Read the rows of tables of one layout as `Observations` of any kind except pixels.

    Args:
        tables: The files.
        layouts: The column description of each file.
        where: Name of the descriptions, for messages; it may be empty.
        geometry: The arm's nominal geometry.
        frames: "known" if the rows are poses of the arm's own tool in its own base frame, else "fitted".
    """
    pairs = zip(tables, layouts, strict=True)
    joints = np.concatenate([kind_readers.read_joints(*pair, where or pair[0].where, geometry) for pair in pairs])
    source = tables[0].where if len(tables) == 1 else f"{tables[0].where} and {len(tables) - 1} more"
    file = np.repeat(np.arange(len(tables)), [len(table.lines) for table in tables])
    lines = np.concatenate([np.array(table.lines, dtype=np.int64) for table in tables])
    origins = Origins(tuple(table.where for table in tables), file, lines)
    where = where or tables[0].where
    files = kind_readers.Files(tables, layouts, where, geometry, joints, source, origins)
    kind_readers.refuse_repeated_joints(files.first, where, joints, geometry)
    rows: Any = get("instrument", files.first.kind)(files, files.first.measured)
    known: dict[str, Frames] = {} if frames == "fitted" else {"frames": frames}
    complete: Observations = replace(rows, source=source, conditions=_conditions(files), origins=origins, **known)
    return complete


def _frames(tables: list[table_files.Table]) -> Frames:
    """Read the word "known" or "fitted" for base and tool from files in pickenv's own format; "fitted" if none has it.

    Raises:
        InputError: If a row has another word, or if the rows do not all have the same one.
    """
    places_of: dict[str, str] = {}
    for table in tables:
        if FRAMES_COLUMN not in table.header:
            places_of.setdefault("fitted", table.where)
            continue
        for text, line in zip(table.texts(FRAMES_COLUMN), table.lines, strict=True):
            places_of.setdefault(text, f"{table.where}: row {line}")
    for text, place in places_of.items():
        if text not in FRAMES:
            raise InputError(f"{place}, column '{FRAMES_COLUMN}' holds '{text[:40]}'; give {' or '.join(FRAMES)}")
    if len(places_of) > 1:
        places = " but ".join(f"{place} says {text}" for text, place in places_of.items())
        raise InputError(f"{places}: base and tool cannot be both; calibrate these rows one by one")
    return "known" if "known" in places_of else "fitted"


def _conditions(files: kind_readers.Files) -> Conditions:
    """Read payload, temperature relative to the reference, and torques; only those that every file records."""
    conditions: dict[str, Array] = {}
    for name in ("temperature", "payload", "torque"):
        parts = []
        for table, layout in files.pairs():
            recorded = layout.conditions.recorded(layout.joint_units)
            if name in recorded:
                columns, scales, reference = recorded[name]
                values = (table.values(columns) - reference) * np.array(scales)
                kind_readers.refuse_implausible_conditions(table, name, values, columns)
                parts.append(values if name == "torque" else values[:, 0])
        if len(parts) == len(files.tables):
            conditions[name] = np.concatenate(parts)
    return Conditions(conditions.get("payload"), conditions.get("temperature"), conditions.get("torque"))


@register("instrument", "position")
def _poses(files: kind_readers.Files, _section: Any) -> Measurements:
    """Read poses or positions.

    Raises:
        InputError: If a row is implausible, or if [rotation] names no convention; the message then lists the errors
            that each convention would leave.
    """
    first, position = files.first, files.values()
    rotation, attitudes = None, first.rotation
    for table, layout in files.pairs():
        kind_readers.refuse_unseen(table, layout)
        if (layout.rotation is None) != (attitudes is None):
            without, with_ = (files.tables[0], table) if attitudes is None else (table, files.tables[0])
            raise InputError(
                f"{without.where} holds positions alone, {with_.where} attitudes too; give each a description of its "
                "own (`columns`), or remove the attitudes"
            )
    if attitudes is not None:
        values = np.concatenate([kind_readers.read_attitudes(t, d.rotation) for t, d in files.pairs()])
        if attitudes.convention is None:
            fits = table_files.convention_table(files.geometry, files.joints, position, values, files.source)
            raise InputError(
                f"{files.where}: [rotation] names no convention, and none is guessed; after fitting base and tool "
                f"each would leave, on average:\n{fits}\n"
                "name one of them, or the maker's, as convention in [rotation]"
            )
        rotation = table_files.rotations(attitudes.convention, values)
    stated = first.measured.std is not None
    rows = Measurements(files.joints, position, rotation, files.geometry.prismatic, first.std, std_stated=stated)
    return rows if attitudes is None else replace(rows, attitude_std=attitudes.std)


def _repeat(tables: list[table_files.Table], layouts: list[description.DescriptionFile]) -> float | None:
    """Compute the RMS scatter of repeated positions, m, from the files' ``std_columns``; None without these columns.

    ``layouts`` has the column description of each file in ``tables``.
    """
    squares = []
    for table, layout in zip(tables, layouts, strict=True):
        if std_columns := getattr(layout.measured, "std_columns", ()):
            std = table.values(std_columns) * TO_SI[layout.unit]
            squares.append(np.sum(std**2, axis=1) / (std.shape[1] / min(std.shape[1], 3)))
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else None


# Reading targets for a calibrated arm: our own CSV columns, joints (q1_deg, q2_mm, …) or tool poses (x_mm … rz_deg).
# Poses give the tool's rotation vector; other columns of the file are left alone. Faults are named by row and column.


POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")


@dataclass(frozen=True, eq=False)
class Targets:
    """N targets for an arm, given as joints or as tool poses.

    Attributes:
        joints: Nominal joint targets ``(N, n)``, rad or m; None if poses were given.
        pose: N tool poses, m; None if joints were given.
        lines: Line of each target in its file ``(N,)``, from 1.
        source: The file, for messages.
    """

    joints: Array | None
    pose: Pose | None
    lines: tuple[int, ...]
    source: str


def read_targets(path: str | Path, geometry: Geometry) -> Targets:
    """Read targets from a CSV file: joint targets if it has all joint columns, else tool poses.

    Joint columns are such as q1_deg or q2_mm. Pose columns are those of `POSE_COLUMNS`, with a rotation vector.

    Args:
        path: CSV file with a header.
        geometry: The arm's nominal geometry, for joint count and types.

    Raises:
        InputError: Names the file, and the row and column at fault.
    """
    table = table_files.read_table(path)
    columns = joint_columns(geometry.prismatic)
    as_joints = all(name in table.header for name in columns)
    if not as_joints and not all(name in table.header for name in POSE_COLUMNS):
        raise InputError(
            f"{path} has neither all joint columns ({', '.join(columns)}) nor all pose columns "
            f"({', '.join(POSE_COLUMNS)}); it has {listed(table.header)}"
        )
    values = table.values(tuple(columns) if as_joints else POSE_COLUMNS)
    lines = tuple(table.lines)
    if as_joints:
        _refuse_more_joints(table.header, columns, geometry, table.where)
        return Targets(values * np.where(geometry.prismatic, 1e-3, np.radians(1.0)), None, lines, table.where)
    pose = Pose(values[:, :3] * 1e-3, rotation_matrix(np.radians(values[:, 3:])))
    return Targets(None, pose, lines, table.where)


def joints_of(targets: Targets, geometry: Geometry) -> Array:
    """Return targets as joints ``(N, n)``, rad or m; pose targets go through the inverse kinematics.

    Args:
        targets: The targets.
        geometry: The arm's nominal geometry.

    Raises:
        InputError: If a pose cannot be reached, or if poses are given for a whole robot.
    """
    if targets.joints is not None:
        return targets.joints
    assert targets.pose is not None
    if geometry.tree is not None:
        raise InputError(f"{targets.source} has poses, but a whole robot has no one tool to take them; give joints")
    solution = inverse(geometry, targets.pose)
    if not solution.reached.all():
        row = targets.lines[int(np.argmin(solution.reached))]
        raise InputError(f"{targets.source}: row {row} is a pose that the arm cannot reach; correct or remove the row")
    return solution.joints
