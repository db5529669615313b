"""What a calibration is given: the arm, and rows from files or arrays, one set-up or several stations of one arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Array, Geometry, forward, load_arm
from pickenv.base import InputError
from pickenv.base.registry import names
from pickenv.calibration.identification.robust import by_set_up, placed, stations_of
from pickenv.calibration.model.arm_model import pose_carrier
from pickenv.calibration.model.measurements import OWN, Frames, Measurements, Stacked, joint_columns, random_joints
from pickenv.calibration.model.observations import Observations, equally_spaced, named, origins_of
from pickenv.calibration.pipeline.verification import REFIT_ROWS
from pickenv.calibration.reading.description import load_description
from pickenv.calibration.reading.read import NoiseFloor, joints_of, read_observations, read_targets
from pickenv.calibration.residuals.bpnn import BpnnSettings

# What a calibration may be asked for, and what does not go with what was measured.


@dataclass(frozen=True)
class Choices:
    """What to do beyond geometry.

    Attributes:
        terms: "auto", or names of terms joined by "+", or "none".
        residual: "auto", a residual model's name, or "none".
        force: Whether a named residual model is used even if it does not win.
        robust: Whether rows far off are left out; they are listed all the same.
        seed: Seeds everything random.
        frames: Whether base and tool are "known" or "fitted"; as the data say when None.
        learn_from: Poses for the named residual model, which is then used as it is, as the paper does; when None it
            learns from the training rows, if it wins there.
        settings: Settings of the network that learns from them; the paper's when None.
        lens: "fixed" or "free", for pictures; as their description says when None.
        refit: Which of "base" and "tool" the rows to judge by have of their own, as rows of another station do.
        refit_rows: So many of them are used to find those.
        fit: One of `pickenv.calibration.model.prior.FIT_WORDS`: "auto", all parameters by their priors; "offsets", the
            joints' zeros alone; "full", all of them without priors, as the papers do.
        tolerances: The tolerance class that parts are expected to be made to, by name or path; the arm's own, or that
            of a cobot, when None.
        prior_scale: Factor on its widths; found from the rows when None.
        workspace: Where the verdict speaks (`pickenv.calibration.pipeline.given.workspace_joints`); the joint limits
            when None.
    """

    terms: str = "auto"
    residual: str = "auto"
    force: bool = False
    robust: bool = True
    seed: int = 0
    frames: Frames | None = None
    learn_from: Measurements | None = None
    settings: BpnnSettings | None = None
    lens: str | None = None
    refit: tuple[str, ...] = ()
    refit_rows: int = REFIT_ROWS
    fit: str = "auto"
    tolerances: str | None = None
    prior_scale: float | None = None
    workspace: str | None = None


def refuse_options(train: Observations, choices: Choices) -> None:
    """Refuse what is there for poses and positions only."""
    learnt = choices.residual not in ("auto", "none")
    tracked = all(part.poses is not None for part in train.parts)
    options = {
        "`frames='known'`": choices.frames == "known",
        f"`residual='{choices.residual}'`": learnt and not tracked,
    }
    if choices.lens is not None and train.kind != "pixels":
        raise InputError(f"`lens` is for pictures, but {train.source} holds {train.kind}; leave it out")
    single, several = (" of one station", " of several") if tracked else ("", "")
    for option, asked_for in options.items():
        if asked_for:
            raise InputError(
                f"{option} is for poses and positions{single}, but {train.source} holds {train.kind}{several}; "
                "leave it out"
            )


Data = Observations | str | Path | Sequence[str | Path] | Sequence[Observations]
"""Rows: measurements, observations of any kind or several of them, or the files that hold them."""

Columns = str | Path | Sequence[str | Path] | None
"""Description of the files' columns, by name or path; several for one per file."""

STATIONS: dict[str, tuple[str, ...]] = {"none": (), "base": ("base",), "tool": ("tool",), "base,tool": OWN}
"""What stations can have of their own, as it is written."""


def given_arm(arm: Arm | str | Path | None, columns: Columns) -> Arm:
    """The arm; one that only carries poses where they are finished."""
    described = [load_description(description) for description in _each(columns)]
    if any(description.views is not None and description.views.poses for description in described):
        if arm is not None:
            raise InputError("finished poses have no joints to calibrate; leave the arm out, or describe its [joints]")
        return pose_carrier()
    if arm is None:
        raise InputError("no arm is given; name one, or its file, as `arm`")
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
    descriptions = _each(columns)
    if len(descriptions) > 1 and len(descriptions) != len(items):
        raise InputError(
            f"{len(descriptions)} column descriptions are given for {len(items)} files; give one, or one per file"
        )
    sets: list[tuple[list[Any], str | Path | None]]
    if len(descriptions) > 1:
        sets = [([file], layout_of_file) for file, layout_of_file in zip(items, descriptions, strict=True)]
    else:
        layout = descriptions[0] if descriptions else None
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


WORKSPACE_POSES, TRIALS = 400, 200_000
"""Joint vectors that stand for a workspace, and how many are drawn at most to find those that lie in a box."""


def workspace_joints(text: str | Path | None, geometry: Geometry) -> tuple[str, Array]:
    """What a workspace is called, and joints ``(M, n)`` all over it; the same every time.

    Args:
        text: A file of targets (joints or tool poses in our own columns); or ranges joined by commas, of joints in deg
            or mm (``q1=-90:90``) and of the tool's position in the controller's base frame in mm (``x=300:900``); what
            is not named is within the joint limits. All of these when None.
        geometry: The nominal arm.

    Raises:
        InputError: If a range cannot be read, or the arm reaches nothing in it.
    """
    rng = np.random.default_rng(0)
    if text is None:
        return "the joint limits", random_joints(geometry, WORKSPACE_POSES, rng)
    if "=" not in str(text):
        joints = joints_of(read_targets(text, geometry), geometry)
        return f"the targets of {text}", joints[equally_spaced(len(joints), WORKSPACE_POSES)]
    lower, upper = geometry.lower.copy(), geometry.upper.copy()
    box = np.array([[-np.inf, np.inf]] * 3)
    names = [name.split("_")[0] for name in joint_columns(geometry.prismatic)]
    for part in str(text).split(","):
        name, _, ends = part.strip().partition("=")
        try:
            low, high = (float(end) for end in ends.split(":"))
        except ValueError:
            raise InputError(
                f"workspace '{part.strip()}' is no range; write q1=-90:90 (deg or mm) or x=300:900 (mm)"
            ) from None
        if not low < high:
            raise InputError(f"workspace '{part.strip()}' is empty; give the lower end first")
        if name in names:
            joint = names.index(name)
            unit = 1e-3 if geometry.prismatic[joint] else np.radians(1.0)
            lower[joint], upper[joint] = max(low * unit, lower[joint]), min(high * unit, upper[joint])
            if not lower[joint] < upper[joint]:
                raise InputError(f"workspace '{part.strip()}' lies outside the limits of {geometry.joint_names[joint]}")
        elif name in ("x", "y", "z"):
            box["xyz".index(name)] = low * 1e-3, high * 1e-3
        else:
            raise InputError(
                f"workspace '{part.strip()}' names no joint or axis; give some of {', '.join([*names, 'x', 'y', 'z'])}"
            )
    joints = rng.uniform(lower, upper, (TRIALS if np.isfinite(box).any() else WORKSPACE_POSES, geometry.joints))
    if np.isfinite(box).any():
        place = forward(geometry, joints).position
        joints = joints[((place >= box[:, 0]) & (place <= box[:, 1])).all(axis=1)][:WORKSPACE_POSES]
        if len(joints) < 10:
            raise InputError(
                f"the arm reaches hardly anything within workspace '{text}'; check its axes, in mm from the base"
            )
    return f"workspace {text}", joints


def _each(columns: Columns) -> list[str | Path]:
    if columns is None:
        return []
    return [columns] if isinstance(columns, str | Path) else list(columns)


def _joined(
    arm: Arm, sets: list[Observations], stations: str | None, known: bool, like: Observations | None
) -> Observations:
    """One data set as it is; several as stations of one arm, as asked or as poses and positions tell."""
    if stations is None:
        tracked = [file for part in sets if part.poses is not None for file in _files(part.poses)]
        if isinstance(like, Stacked) and tracked:
            return placed(arm, like, tracked)
        free = not known and like is None and all(part.frames == "fitted" for part in tracked)
        if len(tracked) > 1 and free and all(part.poses is not None for part in sets):
            several = by_set_up(arm, tracked)
            return sets[0] if len(sets) == 1 and several.poses is not None else several
    return sets[0] if len(sets) == 1 else stations_of(arm, sets, STATIONS[stations or "base,tool"])


def _files(data: Measurements) -> list[Measurements]:
    """The rows of each file."""
    origins = origins_of(data)
    numbers = np.unique(origins.file)
    return [replace(data.select(origins.file == i), source=origins.files[i]) for i in numbers.tolist()]


def _refuse_no_numbers(arm: Arm, data: Observations) -> None:
    """Refuse arrays that no file could have held."""
    if not hasattr(data, "joints"):
        kinds = ", ".join(names("observation"))
        raise InputError(f"{type(data).__name__} are no measurements; give files, or observations ({kinds})")
    shape, joint_count = data.joints.shape, arm.nominal.joints
    if shape != (len(data.joints), joint_count):
        raise InputError(f"{data.source}: joints have shape {shape}, but arm '{arm.name}' has {joint_count} joints")
    named_values = {name: getattr(data, name, None) for name in ("joints", "position", "rotation", "length")}
    for name, values in {**named_values, "what was read": data.readings()}.items():
        if values is not None and not np.isfinite(values).all():
            rows = np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(axis=1)).tolist()
            places = named([origins_of(data).place(row) for row in rows])
            raise InputError(f"{places}: {name} is no finite number; correct or remove it")
