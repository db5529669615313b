"""Where the identification of a data set of any kind starts: what of an arm is fitted, and base and tool from anywhere.

Poses and positions have closed forms; boards' poses in pictures and the reflector seen most often are poses and
positions of their own; wires and contacts start where the arm is said to stand. SI units.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pickenv.arm import Arm, Geometry, Pose
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import identify
from pickenv.calibration.identification.robust import (
    OUTLIER_SIGMA,
    align,
    refuse_another_arm,
    robust_align,
    robust_identify,
    sizes_of,
    unknowns_of,
)
from pickenv.calibration.model.arm_model import CARRIER, ArmModel, ErrorModel, frames_model, geometric_model
from pickenv.calibration.model.kinds.distances import ReflectorObservations
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, equally_spaced, nearest_rotation, origins_of
from pickenv.calibration.model.pixels import PixelObservations, undistorted
from pickenv.calibration.model.stacked import OWN, InstrumentStation, Stacked, joinable, rows_together
from pickenv.errors import InputError

# Where a flat board stands in a camera's frame, view by view: a homography, then its two rotations' common pose. A
# first pose to start from (Zhang 2000, section 3.1), not a result: the fit of the arm takes the corners themselves.

LEAST_CORNERS = 4


def board_poses(data: PixelObservations) -> Pose:
    """The board in the camera's frame in each view ``(V,)``.

    Args:
        data: Views with at least four corners each, not all in one line; the board's corners lie in its plane z = 0.
    """
    poses = [
        _pose(data.board[seen, :2], undistorted(data.camera.values, corners[seen]))
        for corners, seen in zip(data.corners, data.seen, strict=True)
    ]
    return Pose(np.array([p.position for p in poses]), np.array([p.rotation for p in poses]))


def _pose(flat: Array, rays: Array) -> Pose:
    """The pose whose first two columns and position are the homography from the board to the rays."""
    homography = _homography(flat, rays)
    scale = np.linalg.norm(homography[:, :2], axis=0).mean()
    first, second, position = (homography / scale).T
    if position[2] < 0.0:  # the board is in front of the camera
        first, second, position = -first, -second, -position
    rotation = nearest_rotation(np.stack([first, second, np.cross(first, second)], axis=1))
    return Pose(position, rotation)


def _homography(flat: Array, rays: Array) -> Array:
    """H of (ray, 1) ~ H (point, 1), by the normalised direct linear transform (Hartley 1997)."""
    middle, size = flat.mean(axis=0), float(np.sqrt(2.0) / np.linalg.norm(flat - flat.mean(axis=0), axis=1).mean())
    points = np.column_stack([(flat - middle) * size, np.ones(len(flat))])
    blank = np.zeros_like(points)
    rows = np.concatenate(
        [np.hstack([points, blank, -rays[:, :1] * points]), np.hstack([blank, points, -rays[:, 1:] * points])]
    )
    found = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    return np.asarray(
        found @ np.array([[size, 0.0, -size * middle[0]], [0.0, size, -size * middle[1]], [0.0, 0.0, 1.0]])
    )


FILE_ROWS, SET_UP_ROWS = 150, 450
"""Rows of a file, and of a set-up, that are looked at to find set-ups."""

COUNTED_ROWS = 30
"""Rows of a file that count as independent at most: neighbours share what the model leaves out."""

LEAST_ROWS = 8
"""A file with fewer rows does not tell whether it is another set-up."""

TRIES, PLAUSIBLE = 12, 10.0
"""Iterations of a trial, twice what a right one takes; and how many times farther rows of one set-up may be missed."""

SPARE = 3
"""The arm's geometry takes part where there are so many times as many equations as parameters; else frames alone."""


def fitted_model(arm: str, nominal: Geometry, known_frames: bool) -> ErrorModel:
    """What of an arm is identified: all of it, base and tool among it unless known; of finished poses these alone."""
    return frames_model(nominal) if arm == CARRIER else geometric_model(nominal, known_frames)


def rough_start(nominal: Geometry, data: Observations) -> Geometry:
    """Base and tool near those of the data: boards' poses give all, the reflector seen most often the base.

    Raises:
        InputError: If the reflector's positions do not fit the arm.
    """
    if isinstance(data, Stacked):
        return rough_start(nominal, data.parts[0])
    if isinstance(data, Measurements):
        return align(nominal, data, frames_model(nominal), judge=False).geometry
    if isinstance(data, PixelObservations):
        seen = board_poses(data)
        if data.mount == "hand":
            back = np.swapaxes(seen.rotation, 1, 2)
            seen = Pose(-(back @ seen.position[..., None])[..., 0], back)
        rough = Measurements(data.joints, seen.position, seen.rotation, nominal.prismatic, source=data.source)
        return align(nominal, rough, frames_model(nominal), judge=False).geometry
    if not isinstance(data, ReflectorObservations):
        return nominal
    which = int(np.argmax(data.seen.sum(axis=0)))
    rows = data.seen[:, which]
    one = Measurements(data.joints[rows], data.points[rows, which], None, nominal.prismatic, source=data.source)
    aligned = align(nominal, one, frames_model(nominal), judge=False).geometry
    refuse_another_arm(aligned, one, f"after fitting base and reflector {which + 1}", nominal)
    if data.places is None or len(data.places) < 3:
        return aligned
    local = data.seen_from(ArmModel.of(aligned))  # known places turn and shift the tool to where they are seen
    middle, centre = data.places.mean(axis=0), local.mean(axis=0)
    turn = nearest_rotation((local - centre).T @ (data.places - middle))
    tool, shift = aligned.tool, centre - turn @ middle
    return replace(aligned, tool=Pose(tool.position + tool.rotation @ shift, tool.rotation @ turn))


def robust_frames(arm: Arm, data: Observations) -> Geometry:
    """Base and tool from the rows that agree with each other; the same every time.

    Raises:
        InputError: If there are too few rows, or they do not fit the arm.
    """
    frames = frames_model(arm.nominal)
    if isinstance(data, Measurements):
        return robust_align(arm.nominal, data, frames, np.random.default_rng(0)).geometry
    return robust_identify(frames, rough_start(arm.nominal, data), data).geometry


def stations_of(arm: Arm, data: Sequence[Observations], own: Collection[str]) -> Stacked:
    """Data sets as stations of one arm, those with an instrument's frame first.

    Args:
        arm: The arm.
        data: The data sets.
        own: Which of "base" and "tool" each but the first has of its own; a set without a frame sees no base.

    Raises:
        InputError: If a set does not fit the arm.
    """
    first, *others = sorted(data, key=lambda part: not part.framed)
    stations = [_station(arm, part, number, own) for number, part in enumerate(others, start=2)]
    return Stacked((InstrumentStation(first), *stations))


def _station(arm: Arm, part: Observations, number: int, own: Collection[str]) -> InstrumentStation:
    """A data set with frames of its own, which are looked for from where they are if the arm is nominal."""
    start = robust_frames(arm, part) if part.framed else arm.nominal
    base = start.base if "base" in own and part.framed else None
    return InstrumentStation(part, number, base, start.tool if "tool" in own else None)


@dataclass(frozen=True)
class SetUp:
    """Data sets that one place of instrument and target explains.

    Attributes:
        parts: Their numbers, from 0.
        own: Which of "base" and "tool" differ from the first set-up's.
    """

    parts: tuple[int, ...]
    own: tuple[str, ...] = ()


def by_set_up(arm: Arm, parts: Sequence[Measurements]) -> Measurements | Stacked:
    """Poses or positions of several files: one data set where one set-up explains all, else a station for each set-up.

    Args:
        arm: The arm.
        parts: The files' rows.

    Raises:
        InputError: If the rows of a set-up do not fit the arm.
    """
    first, *others = set_ups(arm, parts)
    whole = [rows_together([parts[i] for i in each.parts]) for each in (first, *others)]
    if not others:
        return whole[0]
    stations = [
        _station(arm, part, number, each.own)
        for number, (part, each) in enumerate(zip(whole[1:], others, strict=True), 2)
    ]
    return Stacked((InstrumentStation(whole[0]), *stations))


def set_ups(arm: Arm, parts: Sequence[Measurements]) -> tuple[SetUp, ...]:
    """Which data sets share base and tool, as the rows tell: file by file, what leaves least at least frames (BIC).

    Rows of one file are alike, so that only `COUNTED_ROWS` of each count: frames of its own must take away a good part
    of what remains, not only surely some of it. Files that do not tell are taken as of the first set-up.
    """
    near = {i: rows for i, part in enumerate(parts) if (rows := _near_rows(arm, part)) is not None}
    first, *others = near or [0]
    known: tuple[SetUp, ...] = (SetUp((first,)),)
    for i in others:
        tried = [each for each in _with_file(known, parts, i) if _plausible(near, each, i)]
        known = min(tried, key=lambda each: _criterion(arm, near, each))
    for i in set(range(len(parts))) - {first, *others}:
        known = next(_with_file(known, parts, i))
    return tuple(replace(each, parts=tuple(sorted(each.parts))) for each in known)


def _near_rows(arm: Arm, part: Measurements) -> tuple[Measurements, Geometry] | None:
    """Some rows that agree with each other, and the arm where they see it; None where they are too few, or fit none."""
    part = part.select(equally_spaced(len(part), FILE_ROWS))
    try:
        aligned = robust_frames(arm, part) if len(part) >= LEAST_ROWS else None
    except InputError:
        aligned = None
    if aligned is None:
        return None
    return part.select(sizes_of(ArmModel.of(aligned), np.zeros(0), part).sigma <= OUTLIER_SIGMA), aligned


def _with_file(known: tuple[SetUp, ...], parts: Sequence[Measurements], i: int) -> Iterator[tuple[SetUp, ...]]:
    """The set-ups with one more file: as one of theirs, or as another."""
    for number, each in enumerate(known):
        if joinable([parts[each.parts[0]], parts[i]]):
            joined = replace(each, parts=(*each.parts, i))
            yield (*known[:number], joined, *known[number + 1 :])
        elif number == 0:
            yield (*known, SetUp((i,)))
    for own in (("base",), ("tool",), OWN):
        yield (*known, SetUp((i,), own))


def _plausible(near: Mapping[int, tuple[Measurements, Geometry]], tried: Sequence[SetUp], i: int) -> bool:
    """Whether a file and the set-up that it joins see each other's rows about as their own, with the nominal arm.

    Either way is enough: a file may tell little of its own frames.
    """
    others = [each.parts[0] for each in tried if i in each.parts and each.parts[0] != i]
    for j in others:
        ratio = [_missed(near[k][0], near[m][1]) / _missed(*near[k]) for k, m in ((i, j), (j, i))]
        if min(ratio) > PLAUSIBLE:
            return False
    return True


def _missed(rows: Measurements, by: Geometry) -> float:
    """Median miss by an arm, m, and a micrometre."""
    return 1e-6 + float(np.median(np.linalg.norm(rows.difference(by)[:, :3], axis=1)))


def _criterion(arm: Arm, near: Mapping[int, tuple[Measurements, Geometry]], tried: Sequence[SetUp]) -> float:
    """Schwarz's criterion of an arm and these set-ups; each file has a scatter of its own."""
    whole, stations = [], []
    for number, each in enumerate(tried, start=1):
        rows = rows_together([near[i][0] for i in each.parts])
        whole.append(rows.select(equally_spaced(len(rows), SET_UP_ROWS)))
        start = near[each.parts[0]][1]
        frames = {name: getattr(start, name) for name in each.own}
        stations.append(InstrumentStation(whole[-1], number, **frames))
    data = Stacked(tuple(stations))
    equations = sum(len(part) * part.rows_per_pose for part in whole)
    model = fitted_model(arm.name, arm.nominal, False)
    if equations < SPARE * (len(model.names) + len(data.unknowns())):
        model = frames_model(arm.nominal)
    try:
        fit = identify(model, ArmModel.of(near[tried[0].parts[0]][1]), [data], max_iterations=TRIES)
    except InputError:
        return np.inf
    owners = np.concatenate([origins_of(part).file + 1000 * k for k, part in enumerate(whole)])
    squares = data.residual(fit.arm_model, unknowns_of(fit, data)) ** 2
    total, spare = 0.0, equations / max(fit.degrees_of_freedom, 1)
    counted = 0
    for owner in np.unique(owners):
        here = owners == owner
        count = 3 * min(int(here.sum()), COUNTED_ROWS)
        total += count * float(np.log(np.mean(squares[here[data.equations()[0]]]) * spare))
        counted += count
    return total + float(np.log(counted)) * 6 * sum(len(each.own) for each in tried)


def placed(arm: Arm, stations: Stacked, parts: Sequence[Measurements]) -> Stacked:
    """Other files of known set-ups: each at the station whose frames it fits best.

    Args:
        arm: The arm.
        stations: Rows that tell the stations' frames.
        parts: The other files' rows.
    """
    known = [
        replace(each, data=each.data.select(equally_spaced(len(each.data.joints), FILE_ROWS)))
        for each in stations.stations
    ]
    data = Stacked(tuple(known))
    model = fitted_model(arm.name, arm.nominal, False)
    fit = identify(model, ArmModel.of(robust_frames(arm, known[0].data)), [data], max_iterations=60)
    seats: dict[int, list[Measurements]] = {}
    for part in parts:
        missed = []
        for each in known:
            own = Stacked((replace(each, data=part),))
            left = own.misses(fit.arm_model, unknowns_of(fit, own))
            missed.append(float(np.median(np.linalg.norm(left, axis=1))))
        seats.setdefault(int(np.argmin(missed)), []).append(part)
    return Stacked(tuple(replace(known[i], data=rows_together(seats[i])) for i in sorted(seats)))
