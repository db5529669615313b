"""Whether a file's chain of joints is the arm that was calibrated, told in other frames.

A vendor's file and a table of DH parameters describe one arm where, joint by joint, the axes can be laid upon one
another: the file's root stands somewhere in the table's base frame (G), and joint i of the table reads
s_i q_i + z_i where the file's reads q_i. Signs and zeros that leave the joints' readings as they are are preferred;
what the first joint's zero could be is taken as a turn of the root. Of an arm that begins with a slide, or has one
before other axes have said where it stands, joints must read alike in both. Metres and radians.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Geometry
from pickenv.arm.kinematics.forward import chain_of, frames, pose_of
from pickenv.arm.kinematics.geometry import Array, Pose, behind, identity_pose, inverse_pose
from pickenv.errors import InputError

NEAR, TURNED = 1e-4, 2e-4
"""m and rad; how far axes may lie apart that are the same: what a file's last digits leave."""

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
POSES = 12
"""Poses at which the frames of file and table are compared."""


@dataclass(frozen=True, eq=False)
class SameChain:
    """How an arm's table and a file tell of one chain.

    Attributes:
        root: Pose of the table's world frame in the file's root.
        sign: For each joint, 1 or -1 (n,).
        zero: The table's joint values where the file's are zero (n,), rad or m.
        apart: How far the frames of both lie apart at most, once laid upon one another at one pose: m, rad.
    """

    root: Pose
    sign: Array
    zero: Array
    apart: tuple[float, float] = (0.0, 0.0)

    def plain(self) -> bool:
        """Whether joints read alike in both."""
        return bool((self.sign == 1).all() and (self.zero == 0).all())


@dataclass(frozen=True, eq=False)
class _Axis:
    """A joint axis: a point on it, its direction, and whether the joint slides."""

    point: Array
    direction: Array
    slides: bool

    def moved(self, by: Pose) -> _Axis:
        return _Axis(by.position + by.rotation @ self.point, by.rotation @ self.direction, self.slides)

    def apart(self, other: _Axis) -> tuple[float, float]:
        """Distance, m (0 of slides), and angle, rad, to another axis."""
        turned = math.atan2(np.linalg.norm(np.cross(self.direction, other.direction)), self.direction @ other.direction)
        return (0.0 if self.slides else float(np.linalg.norm(_across(self.point - other.point, other)))), turned

    def same(self, other: _Axis) -> bool:
        near, turned = self.apart(other)
        return near <= NEAR and turned <= TURNED


def link_frames(geometry: Geometry, joints: Array) -> list[Pose]:
    """Poses of the links ``(...)`` in the world at joints ``(..., n)``, first to last, before the tool."""
    return [pose_of(frame) for frame in frames(np, chain_of(geometry), list(np.moveaxis(joints, -1, 0)))[1:]]


def same_chain(arm: Geometry, file: Geometry, name: str, arm_name: str) -> SameChain:
    """How ``file`` tells of the same chain as ``arm``.

    Args:
        arm: The arm as it was before its calibration.
        file: The chain of the file, root to tip.
        name: What messages call the file.
        arm_name: What they call the arm.

    Raises:
        InputError: If it is another arm; says from which joint on.
    """
    if arm.coupling != file.coupling or arm.slides != file.slides:
        kinds = ["".join("P" if slides else "R" for slides in chain.slides) for chain in (file, arm)]
        raise InputError(
            f"{name} has the chain {kinds[0]} to its tip, but the calibrated arm '{arm_name}' is {kinds[1]}; give the "
            "file of this arm, or name its last link as in file#link"
        )
    mine, theirs = _axes(arm), _axes(file)
    worst = {0: mine[0].apart(theirs[0])}
    for root, sign, zero in _fits(arm, mine, theirs, worst):
        apart = _apart(arm, file, root, sign, zero)
        if apart[0] <= 10 * NEAR and apart[1] <= 10 * TURNED:
            return SameChain(root, sign, zero, apart)
    joint = max(worst)
    near, turned = worst[joint]
    raise InputError(
        f"{name} is of another arm than '{arm_name}': {file.link_names[joint]} lies {round(near * 1e3, 4):.3g} mm and "
        f"{round(math.degrees(turned), 4):.3g} deg from where '{arm_name}' has it; give the file of the arm that was "
        "calibrated"
    )


def _axes(geometry: Geometry) -> list[_Axis]:
    poses = link_frames(geometry, np.zeros(geometry.joints))
    return [
        _Axis(pose.position, pose.rotation[:, 2], slides) for pose, slides in zip(poses, geometry.slides, strict=True)
    ]


def _fits(
    arm: Geometry, mine: list[_Axis], theirs: list[_Axis], worst: dict[int, tuple[float, float]]
) -> Iterator[tuple[Pose, Array, Array]]:
    """Roots, signs and zeros with which the axes agree, the plainest first; ``worst`` learns where others part."""
    n, free = len(mine), arm.coupling is None
    signs = (1.0, -1.0) if free else (1.0,)

    def further(i: int, by: Pose, sign: list[float], zero: list[float]) -> Iterator[tuple[list[float], list[float]]]:
        """With axes 0 to i - 1 agreed, and the motion ``by`` of what stands on the last of them, the ways on."""
        if i == n:
            yield sign, [*zero, 0.0]
            return
        last, here = mine[i - 1].moved(by), mine[i].moved(by)
        for turn in signs:
            wanted = _Axis(theirs[i].point, turn * theirs[i].direction, theirs[i].slides)
            for value in (0.0, *([_value(last, here, wanted)] if free and i > 1 else [])):
                onwards = _along(last, value)
                there = here.moved(onwards)
                if there.same(wanted):
                    yield from further(i + 1, behind(onwards, by), [*sign, turn], [*zero, value])
                else:
                    best = worst.get(i)
                    found = there.apart(wanted)
                    if best is None or sum(found) < sum(best):
                        worst[i] = found

    for turn in signs:
        for root in _roots(mine, theirs, turn):
            for sign, zero in further(1, root, [turn], []):
                plain = np.ones(arm.joints), np.zeros(arm.joints)  # of joints that move several links
                yield (root, np.array(sign), np.array(zero)) if free else (root, *plain)


def _roots(mine: list[_Axis], theirs: list[_Axis], turn: float) -> Iterator[Pose]:
    """Where the first axes agree: as the frames are, then with all axes laid upon all, then the first upon the first.

    About the first axis the second then says where; along it the first axis that is not parallel. Of an arm that begins
    with a slide joints read alike.
    """
    wanted = _Axis(theirs[0].point, turn * theirs[0].direction, theirs[0].slides)
    if mine[0].same(wanted):
        yield identity_pose()
    if turn == 1.0:
        yield _laid(mine, theirs)
    if mine[0].slides:
        return
    rotation, _ = Rotation.align_vectors(wanted.direction[None], mine[0].direction[None])
    rise = turn * _height(theirs) - _height(mine)
    laid = Pose(wanted.point + rise * wanted.direction - rotation.as_matrix() @ mine[0].point, rotation.as_matrix())
    yield laid
    if len(mine) == 1:
        return
    for second in (1.0, -1.0):
        other = _Axis(theirs[1].point, second * theirs[1].direction, theirs[1].slides)
        yield behind(_along(wanted, _value(wanted, mine[1].moved(laid), other)), laid)


def _height(axes: list[_Axis]) -> float:
    """How far along the first axis, from its point, the chain leaves it; 0 where it does not, or where a slide does.

    It leaves at the common normal of the last axis that is parallel to it and the next one, whatever the joints read.
    """
    first = axes[0]
    for last, following in itertools.pairwise(axes):
        if following.slides:
            return 0.0
        across, gap = _across(following.direction, last), following.point - last.point
        if np.linalg.norm(across) > TURNED:
            along = (gap @ last.direction - (gap @ following.direction) * (last.direction @ following.direction)) / (
                across @ across
            )
            return float((last.point + along * last.direction - first.point) @ first.direction)
    return 0.0


def _laid(mine: list[_Axis], theirs: list[_Axis]) -> Pose:
    """The root with which axes agree best where joints read alike: directions first, then places, least squares."""
    with warnings.catch_warnings():  # parallel axes leave it open; another root is tried then
        warnings.filterwarnings("ignore", message="Optimal rotation is not uniquely")
        turn = Rotation.align_vectors([axis.direction for axis in theirs], [axis.direction for axis in mine])[0]
    rotation = turn.as_matrix()
    across = [np.eye(3) - np.outer(axis.direction, axis.direction) for axis in theirs if not axis.slides]
    gaps = [own.point - rotation @ axis.point for axis, own in zip(mine, theirs, strict=True) if not own.slides]
    if not gaps:
        return Pose(np.zeros(3), rotation)
    apart = np.concatenate([matrix @ gap for matrix, gap in zip(across, gaps, strict=True)])
    return Pose(np.linalg.lstsq(np.concatenate(across), apart, rcond=None)[0], rotation)


def _value(last: _Axis, here: _Axis, wanted: _Axis) -> float:
    """How far the joint of ``last`` brings ``here`` to ``wanted``; 0 where it cannot tell."""
    if last.slides:
        if wanted.slides:
            return 0.0
        step, gap = _across(last.direction, wanted), _across(wanted.point - here.point, wanted)
        return float(step @ gap / (step @ step)) if step @ step > TURNED**2 else 0.0
    start, end = (_across(axis.direction, last) for axis in (here, wanted))
    if min(np.linalg.norm(start), np.linalg.norm(end)) < TURNED:  # parallel: the places tell
        start, end = (_across(axis.point - last.point, last) for axis in (here, wanted))
        if min(np.linalg.norm(start), np.linalg.norm(end)) < NEAR or wanted.slides:
            return 0.0
    return math.atan2(np.cross(start, end) @ last.direction, start @ end)


def _across(vector: Array, axis: _Axis) -> Array:
    """The part of a vector across an axis."""
    return np.asarray(vector - axis.direction * (axis.direction @ vector))


def _along(axis: _Axis, value: float) -> Pose:
    """The motion of a joint by ``value``."""
    if axis.slides:
        return Pose(value * axis.direction, np.eye(3))
    turn = Rotation.from_rotvec(value * axis.direction).as_matrix()
    return Pose(axis.point - turn @ axis.point, turn)


def _apart(arm: Geometry, file: Geometry, root: Pose, sign: Array, zero: Array) -> tuple[float, float]:
    """How far K_i = N_i^-1 G^-1 U_i changes over poses, m and rad, N_i of the table and U_i of the file."""
    fractions = np.mod(GOLDEN * np.arange(1, POSES * file.joints + 1).reshape(POSES, -1), 1.0) - 0.5
    joints = np.where(file.prismatic, 1.0, np.pi) * np.vstack([np.zeros(file.joints), fractions])
    most = np.zeros(2)
    for table, own in zip(link_frames(arm, joints * sign + zero), link_frames(file, joints), strict=True):
        laid = behind(inverse_pose(behind(root, table)), own)
        turned = Rotation.from_matrix(laid.rotation @ laid.rotation[0].T).magnitude()
        most = np.maximum(most, [np.linalg.norm(laid.position - laid.position[0], axis=-1).max(), turned.max()])
    return float(most[0]), float(most[1])
