"""Where an instrument can measure at all, as its first rows tell: of wires, touches, contacts, boards in pictures.

A candidate keeps the touched point touched, the wire and the dial within the readings they gave, and the board in the
picture, about as far off as it was. All else can be measured anywhere. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.alignment import align
from pickenv.calibration.identification.diagnosis import without_blind_views
from pickenv.calibration.identification.robust import robust_identify
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.identification.starts import rough_start
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import frames_model
from pickenv.calibration.model.kinds.distances import DistanceObservations
from pickenv.calibration.model.kinds.sockets import SocketObservations
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.stacked import Stacked
from pickenv.calibration.planning.plan import MARGIN, candidate_joints
from pickenv.errors import InputError

ROUNDS = 60
"""Rounds in which candidates are looked for at most."""

STEPS, NEAR = 20, 1e-6
"""Newton steps that bring a tool point to where it must be, and how near they must end, m."""

STEP = 0.5
"""Largest step of a joint in them, rad or m."""

LEAST_SEEN = 0.5
"""Share of a board's corners that a candidate must see."""

WARY = 3.0
"""Corners must be predicted so many times farther inside the picture than those of the first views were off."""

FOCUS = 1.5
"""A board may stand so many times farther off than in the first views, or nearer."""


@dataclass(frozen=True, eq=False)
class FirstRows:
    """What a first measurement tells about the instrument.

    Attributes:
        data: Its rows.
        model: The nominal arm with base and tool as these rows have them.
        unknowns: The instrument's own unknowns, likewise.
    """

    data: Observations
    model: ArmModel
    unknowns: Array


def first_rows(arm: Arm, data: Observations) -> FirstRows:
    """Base, tool and the instrument's own unknowns from a few rows, of which some may be gross.

    Raises:
        InputError: If the rows are of several kinds, too few, or do not fit the arm.
    """
    data, _ = without_blind_views(data)
    if isinstance(data, Stacked):
        raise InputError(f"{data.source} holds {data.kind}; plan for one instrument, from a file of its rows alone")
    frames = frames_model(arm.nominal)
    if isinstance(data, Measurements):
        return FirstRows(data, ArmModel.of(align(arm.nominal, data, frames).geometry), np.zeros(0))
    found = robust_identify(frames, rough_start(arm.nominal, data), data).identification
    return FirstRows(data, found.arm_model, unknowns_of(found, data))


def measurable_joints(geometry: Geometry, first: FirstRows, count: int, rng: np.random.Generator) -> Array:
    """Joints ``(count or fewer, n)`` at which the instrument reads something, within their limits.

    Half of what is tried is drawn from the joint ranges, half near what was found, from the first rows on: few poses
    of all show a board.
    """
    room = geometry.upper - geometry.lower
    lower, upper = geometry.lower + MARGIN * room, geometry.upper - MARGIN * room
    found, seeds = np.zeros((0, geometry.joints)), np.clip(first.data.joints, lower, upper)
    for _ in range(ROUNDS):
        near = seeds[rng.integers(0, len(seeds), count)]
        sizes = 10.0 ** rng.uniform(-2.0, -0.5, (count, 1)) * room
        tried = np.concatenate([candidate_joints(geometry, count, rng), near + sizes * rng.normal(size=near.shape)])
        moved, good = measurable(first, np.clip(tried, lower, upper), geometry)
        good &= ((moved >= lower) & (moved <= upper)).all(axis=1)
        found = np.concatenate([found, moved[good]])
        seeds = np.concatenate([seeds, moved[good]])
        if len(found) >= count:
            break
    return found[rng.permutation(len(found))[:count]]


def measurable(
    first: FirstRows, joints: Array, geometry: Geometry, *, move: bool = True
) -> tuple[Array, NDArray[np.bool_]]:
    """Joints ``(N, n)`` moved to where the instrument reads something, and which of them ended there ``(N,)``.

    Args:
        first: The instrument.
        joints: Where to look.
        geometry: The nominal arm.
        move: Whether they may be moved; else they are judged where they are, to a millimetre.
    """
    data = first.data
    if isinstance(data, PixelObservations):
        return joints, _shown(first, joints)
    if not isinstance(data, SocketObservations | DistanceObservations):
        return joints, np.ones(len(joints), dtype=bool)
    if not move:
        return joints, np.linalg.norm(_short_of(first, joints), axis=1) <= 1e-3
    for _ in range(STEPS):
        left = _short_of(first, joints)
        if np.abs(left).max() <= NEAR:
            break
        steps = 1e-6 * np.eye(geometry.joints)
        misses = _misses(first, joints)
        slope = -np.stack([(_misses(first, joints + step) - misses) / 1e-6 for step in steps], axis=-1)
        square = slope @ np.swapaxes(slope, 1, 2)
        square += 1e-6 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(left.shape[1]) + 1e-12
        change = np.einsum("nij,ni->nj", slope, np.linalg.solve(square, left[..., None])[..., 0])
        joints = joints + np.clip(change, -STEP, STEP)
    return joints, np.abs(_short_of(first, joints)).max(axis=1) <= NEAR


def _misses(first: FirstRows, joints: Array) -> Array:
    return asked_at(first, joints).misses(first.model, first.unknowns)


def _short_of(first: FirstRows, joints: Array) -> Array:
    """How far the tool point is from where it could be read ``(N, k)``, m: a place, or a range of readings."""
    misses = _misses(first, joints)
    if not isinstance(first.data, DistanceObservations):
        return misses
    read = first.data.length
    predicted = np.resize(read, len(joints))[:, None] - misses
    return np.asarray(np.clip(predicted, read.min(), read.max()) - predicted)


def _shown(first: FirstRows, joints: Array) -> NDArray[np.bool_]:
    """Which views ``(N,)`` would show enough of the board, about as far off as in the first ones."""
    asked, taken = asked_at(first, joints), first.data
    assert isinstance(asked, PixelObservations) and isinstance(taken, PixelObservations)
    depths = taken.in_camera(first.model)[..., 2].mean(axis=1)
    depth = asked.in_camera(first.model)[..., 2].mean(axis=1)
    good = (depth > depths.min() / FOCUS) & (depth < depths.max() * FOCUS)
    return np.asarray(good & (asked.seen.mean(axis=1) >= LEAST_SEEN))


def asked_at(first: FirstRows, joints: Array) -> Observations:
    """What the instrument would be asked at other joints; of a board the corners that are seen there."""
    data: Any = first.data  # all kinds but stations can be imagined, which `first_rows` refuses
    asked: Observations = data.imagined(joints)
    if isinstance(asked, PixelObservations):
        off = data.pixel_errors(first.model, first.unknowns)
        margin = WARY * float(np.sqrt(np.mean(off**2)))
        return replace(asked, seen=asked.visible(first.model, first.unknowns, margin))
    return asked
