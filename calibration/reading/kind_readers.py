"""Readers of the kinds beyond poses: reflectors, wires and bars, what a tool point touches, and inclinometers.

Rows that no such instrument can have read are refused, by file and line: a lost reflector, a tool that did not touch,
a length in another unit, all touches in one pose, a direction that is none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.kinds.distances import DistanceObservations
from pickenv.calibration.model.kinds.reflectors import ReflectorObservations
from pickenv.calibration.model.kinds.sockets import SocketObservations
from pickenv.calibration.model.kinds.tilts import TiltObservations
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.splits import Rows
from pickenv.calibration.reading.kind_tables import (
    KNOWN,
    BarTable,
    ContactTable,
    DialTable,
    RadiusTable,
    ReflectorsTable,
    SocketsTable,
    TiltTable,
    WireTable,
)
from pickenv.calibration.reading.measured_files import Files
from pickenv.errors import InputError
from pickenv.toml_tables import TO_SI

TURNED = float(np.radians(1.0))
"""Touches whose joints all lie within this, rad or m, are made in one pose."""

UNIT_LENGTH = 0.02
"""A direction's length may differ from one by so much."""

EXPLAINED, UNEXPLAINED = 0.2, 0.5
"""Part of the spread of lengths that a wire's anchor leaves in the right unit at most, and in a wrong one at least."""


def _reflectors(files: Files) -> ReflectorObservations:
    """Reflector groups; a reflector counts as lost only as the description says that it is marked."""
    first, section = files.first, files.first.section
    assert isinstance(section, ReflectorsTable)
    points, seen = [], []
    for table in files.tables:
        blank = np.zeros((len(table.lines), len(first.position)), dtype=bool)
        if "empty" in section.lost:
            blank = np.stack([table.fill_blanks(name) for name in first.position], -1)
        values = table.values(first.position).reshape(len(table.lines), -1, 3) * TO_SI[first.position_unit]
        empty, zero = blank.reshape(values.shape).any(axis=2), (values == 0).all(axis=2)
        if (zero & ~empty).any() and "zeros" not in section.lost:
            row, which = np.argwhere(zero & ~empty)[0]
            raise InputError(
                f"{table.where}: row {table.lines[row]}: reflector {which + 1} lies at 0, 0, 0, which usually means "
                "that the tracker lost it; say lost = 'zeros' in [reflectors], or remove the row"
            )
        points.append(values)
        seen.append(~(empty | (zero if "zeros" in section.lost else empty)))
    visible = np.concatenate(seen)
    if (visible.sum(axis=0) < 3).any():
        which = int(np.argmin(visible.sum(axis=0)))
        raise InputError(f"{files.source}: reflector {which + 1} was seen in fewer than three poses; leave it out")
    return ReflectorObservations(
        joints=files.joints,
        points=np.concatenate(points),
        seen=visible,
        covariance=np.eye(3) * first.position_std**2,
        places=np.reshape(section.places, (-1, 3)) if section.places else None,
        places_std=section.places_std,
    )


def _wire(files: Files) -> DistanceObservations:
    section = files.first.section
    assert isinstance(section, WireTable)
    length = files.values()[:, 0]
    for row in np.flatnonzero(length <= 0.0)[:1]:
        raise InputError(f"{files.place(int(row))}: a length of {_mm(length[row])} mm is not above zero; correct it")
    _refuse_no_contact(files, section)
    data = replace(
        _distances(files, section, length),
        zero=section.begin,
        zero_std=section.zero_std,
        scale_std=section.scale_std,
    )
    _refuse_other_unit(files, data)
    return data


def _dial(files: Files) -> DistanceObservations:
    section = files.first.section
    assert isinstance(section, DialTable)
    reading = files.values()[:, 0]
    for row in np.flatnonzero(np.isclose(reading, section.free, rtol=0.0, atol=1e-9))[:1]:
        raise InputError(
            f"{files.place(int(row))}: the dial reads {_mm(reading[row])} mm, as one that touches nothing; remove the "
            "row, or say in [dial] what it reads then (free_mm)"
        )
    _refuse_no_contact(files, section)
    return replace(_distances(files, section, reading), surface="plane", scale_std=section.scale_std)


def _kept(files: Files) -> DistanceObservations:
    """A ball bar, a sphere, an edge or a plane: one distance in all rows, known or not."""
    section, kind = files.first.section, files.first.kind
    assert isinstance(section, ContactTable)
    _refuse_no_contact(files, section)
    _refuse_one_pose(files, np.arange(len(files.joints)))
    data = _distances(files, section, np.zeros(len(files.joints)))
    if isinstance(section, BarTable | RadiusTable):
        length, std = (section.length, section.length_std) if section.length else (0.0, np.inf)
        data = replace(data, length=data.length + length, zero_std=std)
    return replace(data, surface="line" if kind == "edge" else "plane" if kind == "plane" else "point")


def _distances(files: Files, section: ContactTable, readings: Array) -> DistanceObservations:
    return DistanceObservations(
        joints=files.joints,
        length=readings,
        std=files.first.position_std,
        tip=section.tool_point,
        tip_std=section.tip_std,
        kind=files.first.kind,
    )


def _touches(files: Files) -> SocketObservations:
    """One place that was touched in every row."""
    section, none = files.first.section, np.zeros((0, 2), dtype=np.int64)
    assert isinstance(section, ContactTable)
    _refuse_no_contact(files, section)
    _refuse_one_pose(files, np.arange(len(files.joints)))
    return SocketObservations(
        joints=files.joints,
        socket=np.zeros(len(files.joints), dtype=np.int64),
        pairs=none,
        spacing=np.zeros(0),
        std=files.first.position_std,
        kind=files.first.kind,
        places=("point",),
        tip=section.tool_point,
        tip_std=section.tip_std,
    )


def _sockets(files: Files) -> SocketObservations:
    """Sockets by a column, in consecutive pairs of their numbers; or one per file, the files of a folder a pair."""
    first, section = files.first, files.first.section
    assert isinstance(section, SocketsTable)
    _refuse_no_contact(files, section)
    names: tuple[str, ...] = ()
    if first.position:
        named = np.concatenate([table.value(first.position[0]) for table in files.tables])
        labels, socket = np.unique(named, return_inverse=True)
        folders = [str(i // 2) for i in range(len(labels))]
        names = tuple(f"socket{label:g}" for label in labels)
    else:
        socket = np.repeat(np.arange(len(files.tables)), [len(table.lines) for table in files.tables])
        folders = [str(Path(table.where).parent) for table in files.tables]
    sockets: dict[str, list[int]] = {}
    for i, folder in enumerate(folders):
        sockets.setdefault(folder, []).append(i)
    pairs = [] if section.spacing is None else list(sockets.items())
    for folder, members in pairs:
        if len(members) != 2:
            raise InputError(
                f"{files.source}: a spacing is given for pairs of sockets, but '{folder}' holds {len(members)}; give "
                "two files per folder, or leave spacing_mm out"
            )
    for place in np.unique(socket):
        _refuse_one_pose(files, np.flatnonzero(socket == place))
    return SocketObservations(
        joints=files.joints,
        socket=np.asarray(socket, dtype=np.int64),
        pairs=np.array([members for _, members in pairs], dtype=np.int64).reshape(-1, 2),
        spacing=np.full(len(pairs), section.spacing or 0.0),
        std=first.position_std,
        spacing_std=section.spacing_std,
        places=names,
        tip=section.tool_point,
        tip_std=section.tip_std,
    )


def _tilt(files: Files) -> TiltObservations:
    """Components of down; angles of inclination are taken as those whose sine the component is."""
    section = files.first.section
    assert isinstance(section, TiltTable)
    values = np.concatenate([table.values(section.position) for table in files.tables])
    std = np.full(values.shape, section.position_std)
    if section.position_unit != "g":
        angles = values * TO_SI[section.position_unit]
        for row, column in np.argwhere(np.abs(angles) > np.pi / 2)[:1]:
            raise InputError(
                f"{files.place(int(row))}: an inclination of {np.degrees(angles[row, column]):.4g} deg is beyond 90; "
                "correct the row, or the unit of [tilt]"
            )
        values, std = np.sin(angles), std * np.maximum(np.cos(angles), UNIT_LENGTH)
    size = np.linalg.norm(values, axis=1)
    wrong = size > 1.0 + UNIT_LENGTH if values.shape[1] < 3 else np.abs(size - 1.0) > UNIT_LENGTH
    for row in np.flatnonzero(wrong)[:1]:
        raise InputError(
            f"{files.place(int(row))}: the components of down have length {size[row]:.4g}, not 1; divide them by "
            "gravity, or remove rows in which the arm still moved"
        )
    _refuse_one_pose(files, np.arange(len(files.joints)))
    known = {word: 0.0 if said == KNOWN else np.inf for word, said in (("axes", section.mount), ("down", section.base))}
    return TiltObservations(files.joints, values, std, axes_std=known["axes"], down_std=known["down"])


def _mm(value: float) -> str:
    return f"{value * 1e3:.6g}"


def _refuse_no_contact(files: Files, section: ContactTable) -> None:
    """Rows whose contact column is empty or zero."""
    for table in files.tables if section.contact is not None else ():
        table.fill_blanks(str(section.contact))
        for row in np.flatnonzero(table.column(str(section.contact)) == 0.0)[:1]:
            raise InputError(
                f"{table.where}: row {table.lines[row]}, column '{section.contact}' says that nothing was touched; "
                "remove the row"
            )


def _refuse_one_pose(files: Files, rows: Rows) -> None:
    """Rows in one and the same pose tell nothing of the arm."""
    if len(rows) > 1 and np.ptp(files.joints[rows], axis=0).max() < TURNED:
        raise InputError(
            f"{files.source}: all {len(rows)} rows of one place are in one pose, to a degree; turn the tool and move "
            "every joint between them"
        )


def _refuse_other_unit(files: Files, data: DistanceObservations) -> None:
    """Lengths that an anchor explains in another unit only."""

    def left(factor: float) -> float:
        read = replace(data, length=data.length * factor, scale_std=0.0, tip_std=0.0)
        model = ArmModel.of(files.geometry)
        misses = read.misses(model, read.start(model))[:, 0]
        spread = np.median(np.abs(read.length - np.median(read.length)))
        return float(np.median(np.abs(misses)) / max(float(spread), 1e-12))

    if left(1.0) < UNEXPLAINED:
        return
    here = files.first.position_unit
    other, factor = ("m", 1e3) if here == "mm" else ("mm", 1e-3)
    if left(factor) < EXPLAINED:
        median = np.median(data.length) / TO_SI[here]
        raise InputError(
            f"{files.source}: lengths of {median:.4g} {here} (median) fit no anchor, but as {other} they do; correct "
            "unit of [wire]"
        )


KIND_READERS: dict[str, Callable[[Files], Observations]] = {
    "reflectors": _reflectors,
    "wire": _wire,
    "bar": _kept,
    "sphere": _kept,
    "edge": _kept,
    "plane": _kept,
    "dial": _dial,
    "touches": _touches,
    "sockets": _sockets,
    "tilt": _tilt,
}
"""How each of these kinds is read."""
