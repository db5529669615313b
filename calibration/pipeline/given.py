"""What a calibration is given: the arm, and rows from files or arrays, one set-up or several stations of one arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Geometry, load_arm
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.starts import by_set_up, placed, stations_of
from pickenv.calibration.model.finished_poses import pose_carrier
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, origins_of
from pickenv.calibration.model.origins import named
from pickenv.calibration.model.stacked import OWN, Stacked
from pickenv.calibration.reading.description import load_description
from pickenv.calibration.reading.read import NoiseFloor, read_observations
from pickenv.calibration.reading.targets import joints_of, read_targets
from pickenv.errors import InputError

Data = Observations | str | Path | Sequence[str | Path] | Sequence[Observations]
"""Rows: measurements, observations of any kind or several of them, or the files that hold them."""

Columns = str | Path | Sequence[str | Path] | None
"""Description of the files' columns, by name or path; several for one per file."""

STATIONS: dict[str, tuple[str, ...]] = {"none": (), "base": ("base",), "tool": ("tool",), "base,tool": OWN}
"""What stations can have of their own, as it is written."""


def given_arm(arm: Arm | str | Path | None, columns: Columns) -> Arm:
    """The arm; one that only carries poses where they are finished."""
    described = [load_description(each) for each in _each(columns)]
    if any(each.views is not None and each.views.poses for each in described):
        if arm is not None:
            raise InputError("finished poses have no joints to calibrate; leave the arm out, or describe its [joints]")
        return pose_carrier()
    if arm is None:
        raise InputError("no arm is given; name one, or its file (--arm)")
    return load_arm(arm) if isinstance(arm, str | Path) else arm


def given_rows(
    arm: Arm,
    data: Data,
    columns: Columns = None,
    stations: str | None = None,
    *,
    known: bool = False,
    like: Observations | None = None,
) -> tuple[Observations, NoiseFloor | None]:
    """Rows, and what their files say about noise (of several stations, the first one's).

    Args:
        arm: The arm.
        data: The rows, or their files.
        columns: How the files are laid out; of several descriptions each is for one file.
        stations: What each file, or data set, has of its own, of `STATIONS`. When left out, the rows tell which files
            of poses or positions are of one set-up, and other kinds have both frames of their own.
        known: Whether base and tool are known; then all files are of one set-up.
        like: Rows whose set-ups these are of, where they judge those.

    Raises:
        InputError: Names the file, row, column or unit at fault.
    """
    if stations is not None and stations not in STATIONS:
        raise InputError(f"stations is '{stations}'; give {', '.join(STATIONS)}")
    items: list[Any] = list(data) if isinstance(data, Sequence) and not isinstance(data, str) else [data]
    if not all(isinstance(item, str | Path) for item in items):
        if columns is not None:
            raise InputError("columns describe files, but rows are given; leave them out")
        for item in items:
            _refuse_no_numbers(arm, item)
        return _joined(arm, items, stations, known, like), None
    given = _each(columns)
    if len(given) > 1 and len(given) != len(items):
        raise InputError(
            f"{len(given)} column descriptions are given for {len(items)} files; give one, or one per file"
        )
    sets: list[tuple[list[Any], str | Path | None]]
    if len(given) > 1:
        sets = [([file], each) for file, each in zip(items, given, strict=True)]
    else:
        layout = given[0] if given else None
        sets = [(items, layout)] if stations is None else [([file], layout) for file in items]
    readings = [read_observations(files, arm.nominal, layout) for files, layout in sets]
    rows = [reading.observations for reading in readings]
    return _joined(arm, rows, stations, known, like), readings[0].floor


def pool_of(path: str | Path, geometry: Geometry, columns: str | Path | None = None) -> tuple[Array, NDArray[np.int64]]:
    """Joints ``(N, n)`` of a file of poses to choose from, and their lines in it ``(N,)``.

    Args:
        path: Joint targets or tool poses in our own columns; or measurements, where they are described.
        geometry: The arm.
        columns: Their description.

    Raises:
        InputError: Names the file, row, column or unit at fault, or a pose that cannot be reached.
    """
    if columns is None:
        targets = read_targets(path, geometry)
        return joints_of(targets, geometry), np.array(targets.lines, dtype=np.int64)
    data = read_observations([path], geometry, columns).observations
    return data.joints, origins_of(data).line


def _each(columns: Columns) -> list[str | Path]:
    if columns is None:
        return []
    return [columns] if isinstance(columns, str | Path) else list(columns)


def _joined(
    arm: Arm, sets: list[Observations], stations: str | None, known: bool, like: Observations | None
) -> Observations:
    """One data set as it is; several as stations of one arm, as asked or as poses and positions tell."""
    if stations is None:
        tracked = [file for part in sets if isinstance(part, Measurements) for file in _files(part)]
        if isinstance(like, Stacked) and tracked:
            return placed(arm, like, tracked)
        free = not known and like is None and all(part.frames == "fitted" for part in tracked)
        if len(tracked) > 1 and free and all(isinstance(part, Measurements) for part in sets):
            several = by_set_up(arm, tracked)
            return sets[0] if len(sets) == 1 and isinstance(several, Measurements) else several
    return sets[0] if len(sets) == 1 else stations_of(arm, sets, STATIONS[stations or "base,tool"])


def _files(data: Measurements) -> list[Measurements]:
    """The rows of each file."""
    origins = origins_of(data)
    numbers = np.unique(origins.file)
    return [replace(data.select(origins.file == i), source=origins.files[i]) for i in numbers.tolist()]


def _refuse_no_numbers(arm: Arm, data: Observations) -> None:
    """Refuse arrays that no file could have held."""
    if not hasattr(data, "joints"):
        raise InputError(f"{type(data).__name__} are no measurements; give files, Measurements or other observations")
    shape, wanted = data.joints.shape, arm.nominal.joints
    if shape != (len(data.joints), wanted):
        raise InputError(f"{data.source}: joints have shape {shape}, but arm '{arm.name}' has {wanted} joints")
    named_values = {name: getattr(data, name, None) for name in ("joints", "position", "rotation", "length")}
    for name, values in {**named_values, "what was read": data.readings()}.items():
        if values is not None and not np.isfinite(values).all():
            rows = np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(axis=1)).tolist()
            places = named([origins_of(data).place(row) for row in rows])
            raise InputError(f"{places}: {name} is no finite number; correct or remove it")
