"""Compute corrected joint origins for a robot's own file; joint readings and the shapes of links do not change.

N_i and C_i are the link frames of the arm's DH table before and after calibration. D_i is the frame of the file's joint
i. All these frames are taken at the zero of the file's joints. K_i = N_i^-1 D_i is constant. The corrected joint frame
is C_i K_i. The joint's new origin is C_i K_i relative to the corrected frame of the previous joint. The chain begins at
the robot's own base, so the instrument's place is no part of it. If the next axis is parallel, no measurement
determines the place of a link along its axis, and a fit may put it anywhere. The link then keeps its place in the file,
as in Universal Robots' own calibration (ur_calibration, correctAxis). A motion of the last joint shifts the
tool along the joint's axis or turns it about this axis. That part of the tool's correction is given to the joint,
unless the tool was fitted and is the instrument's. Metres and radians.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Array, Geometry, Pose, forward, identity_pose, rotation_matrix, rotation_vector
from pickenv.arm.files.joint_chain import ChainJoint, JointRow, arm_of, geometry_of, links_of, numbers_text
from pickenv.arm.kinematics.forward import NEARLY_PARALLEL, chain_of, frames, pose_of
from pickenv.arm.kinematics.geometry import behind, inverse_pose
from pickenv.base import InputError, in_file, shortened
from pickenv.calibration.delivery.document import left_out
from pickenv.calibration.identification.robust import apart
from pickenv.calibration.pipeline.calibration import Calibration

# Whether a file's chain of joints is the arm that was calibrated, told in other frames. A vendor's file and a table
# of DH parameters describe one arm where, joint by joint, the axes can be laid upon one another: the file's root
# stands somewhere in the table's base frame (G), and joint i of the table reads s_i q_i + z_i where the file's reads
# q_i. Signs and zeros that leave the joints' readings as they are are preferred; what the first joint's zero could be
# is taken as a turn of the root. Of an arm that begins with a slide, or has one before other axes have said where it
# stands, joints must read alike in both. Metres and radians.


NEAR, TURNED = 1e-4, 2e-4
"""Largest distance, m, and angle, rad, between two axes that count as equal; rounding in a file can cause as much."""
LEAST_SHARE = 1e-3
"""Share of `NEAR` and `TURNED` below which a relation of table and file counts as exact: 0.1 micrometre of `NEAR`."""

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
POSES = 12
"""Number of poses at which the link frames of file and table are compared."""


SameChain = tuple[Pose, Array, Array]
"""The relation of an arm's DH table to a file of the same chain: root, sign and zero. The root is the pose of the
table's world frame in the file's root link. The sign is 1 or -1 for each joint (n,). The zero is the table's joint
values (n,), rad or m, at the pose where all joints of the file are zero."""


@dataclass(frozen=True, eq=False)
class _Axis:
    """A joint axis: a point on it, m, its direction (a unit vector), and whether the joint slides."""

    point: Array
    direction: Array
    slides: bool

    def turned(self, sign: float) -> _Axis:
        """Return this axis with its direction multiplied by ``sign``, 1 or -1."""
        return _Axis(self.point, sign * self.direction, self.slides)

    def moved(self, by: Pose) -> _Axis:
        """Return this axis after the rigid motion ``by``."""
        return _Axis(by.position + by.rotation @ self.point, by.rotation @ self.direction, self.slides)

    def apart(self, other: _Axis) -> tuple[float, float]:
        """Return the distance, m (0 if this joint slides), and the angle, rad, from this axis to another."""
        turned = math.atan2(np.linalg.norm(np.cross(self.direction, other.direction)), self.direction @ other.direction)
        return (0.0 if self.slides else float(np.linalg.norm(_across(self.point - other.point, other)))), turned

    def same(self, other: _Axis) -> bool:
        """Return whether two axes are equal within `NEAR` and `TURNED`."""
        near, turned = self.apart(other)
        return near <= NEAR and turned <= TURNED


def link_frames(geometry: Geometry, joints: Array) -> list[Pose]:
    """Compute the poses ``(...)`` of all links in the world at joints ``(..., n)``, rad or m, without the tool."""
    return [pose_of(frame) for frame in frames(np, chain_of(geometry), list(np.moveaxis(joints, -1, 0)))[1:]]


def same_chain(arm: Geometry, file: Geometry, name: str, arm_name: str) -> SameChain:
    """Find the relation of an arm's DH table to a file that must describe the same arm.

    Args:
        arm: The arm's geometry before its calibration.
        file: The geometry that the file describes, from root to tip.
        name: Name of the file, for messages.
        arm_name: Name of the arm, for messages.

    Raises:
        InputError: If the file describes another arm; the message says from which joint on.
    """
    if arm.coupling != file.coupling or arm.slides != file.slides:
        kinds = ["".join("P" if slides else "R" for slides in chain.slides) for chain in (file, arm)]
        raise InputError(
            f"{name} has the chain {kinds[0]} to its tip, but the calibrated arm '{arm_name}' is {kinds[1]}; give the "
            "file of this arm, or name its last link as in file#link"
        )
    mine, theirs = _axes(arm), _axes(file)
    worst = {0: mine[0].apart(theirs[0])}
    fits, share = [], []
    for fit in _fits(arm, mine, theirs, worst):
        fits.append(fit)
        share.append(max(np.array(frames_apart(arm, file, *fit)) / (NEAR, TURNED)))
        if share[-1] <= LEAST_SHARE:  # no later fit changes the choice
            break
    if fits and min(share) <= 10.0:
        # The plainest that is no farther off than the file's digits leave the others: by chance one may come near.
        return next(fit for fit, off in zip(fits, share, strict=True) if off <= 10.0 * max(min(share), LEAST_SHARE))
    joint = max(worst)
    near, turned = worst[joint]
    raise InputError(
        f"{name} is of another arm than '{arm_name}': {file.link_names[joint]} lies {round(near * 1e3, 4):.3g} mm and "
        f"{round(math.degrees(turned), 4):.3g} deg from where '{arm_name}' has it; give the file of the arm that was "
        "calibrated"
    )


def _axes(geometry: Geometry) -> list[_Axis]:
    """Return the axis of each link's joint in the world, with all joints at zero."""
    links = zip(link_frames(geometry, np.zeros(geometry.joints)), geometry.slides, strict=True)
    return [_Axis(pose.position, pose.rotation[:, 2], slides) for pose, slides in links]


def _fits(
    arm: Geometry, mine: list[_Axis], theirs: list[_Axis], worst: dict[int, tuple[float, float]]
) -> Iterator[SameChain]:
    """Yield the relations between an arm and a file under which all joint axes agree, the simplest relation first.

    Args:
        arm: The arm's geometry before its calibration.
        mine: The joint axes by the arm's DH table.
        theirs: The joint axes by the file.
        worst: Dictionary that this function fills, by the index (from 0) of each joint whose two axes did not agree
            in some attempt. It holds the distance, m, and the angle, rad, between these axes in the best such attempt.
    """
    n, free = len(mine), arm.coupling is None
    signs = (1.0, -1.0) if free else (1.0,)

    def further(i: int, by: Pose, sign: list[float], zero: list[float]) -> Iterator[tuple[list[float], list[float]]]:
        """Yield signs and zeros of all joints with which axis i (from 0) and all later axes agree.

        Args:
            i: Index of the axis; axes 0 to i - 1 agree already.
            by: Motion that the root and earlier joints gave to axis i - 1 and all later axes.
            sign: Signs of joints 0 to i - 1.
            zero: Zeros of joints 0 to i - 2.
        """
        if i == n:
            yield sign, [*zero, 0.0]
            return
        last, axis = mine[i - 1].moved(by), mine[i].moved(by)
        for turn in signs:
            target = theirs[i].turned(turn)
            for value in (0.0, *([_value(last, axis, target)] if free and i > 1 else [])):
                onwards = _along(last, value)
                placed = axis.moved(onwards)
                if placed.same(target):
                    yield from further(i + 1, behind(onwards, by), [*sign, turn], [*zero, value])
                else:
                    worst[i] = min(worst.get(i, placed.apart(target)), placed.apart(target), key=sum)

    for turn in signs:
        for root in _roots(mine, theirs, turn):
            for sign, zero in further(1, root, [turn], []):
                plain = np.ones(arm.joints), np.zeros(arm.joints)  # of joints that move several links
                yield (root, np.array(sign), np.array(zero)) if free else (root, *plain)


def _roots(mine: list[_Axis], theirs: list[_Axis], turn: float) -> Iterator[Pose]:
    """Yield candidates for the root, the pose of the table's world frame in the file's root link.

    The first candidate is the identity, if it makes the first axes of both chains equal. The second is the best fit of
    all axes. The other candidates put the first axis of the table on the first axis of the file. This leaves open a
    shift along the axis and a turn about it. The first later axis that is not parallel fixes the shift. The second axis
    fixes the turn. If the arm begins with a prismatic joint, only the first two candidates are tried. With these two,
    joints have equal readings in both chains.

    Args:
        mine: The axes of the arm's DH table.
        theirs: The axes of the file.
        turn: Sign of the first joint, 1 or -1.
    """
    target = theirs[0].turned(turn)
    if mine[0].same(target):
        yield identity_pose()
    if turn == 1.0:
        yield _laid(mine, theirs)
    if mine[0].slides:
        return
    rotation, _ = Rotation.align_vectors(target.direction[None], mine[0].direction[None])
    rise = turn * _height(theirs) - _height(mine)
    laid = Pose(target.point + rise * target.direction - rotation.as_matrix() @ mine[0].point, rotation.as_matrix())
    yield laid
    if len(mine) == 1:
        return
    for second in (1.0, -1.0):
        yield behind(_along(target, _value(target, mine[1].moved(laid), theirs[1].turned(second))), laid)


def _height(axes: list[_Axis]) -> float:
    """Compute the position along the first axis, m from the axis's point, at which the chain leaves this axis.

    The position is the foot of the common normal of two axes: the last axis that is parallel to the first axis, and the
    next axis. It does not depend on joint values. It is 0 if all axes are parallel. It is also 0 if the first axis that
    is not parallel belongs to a prismatic joint or comes after a prismatic joint.
    """
    first = axes[0]
    for last, following in itertools.pairwise(axes):
        if following.slides:
            return 0.0
        across, gap = _across(following.direction, last), following.point - last.point
        if np.linalg.norm(across) > TURNED:
            a, b = last.direction, following.direction
            along = (gap @ a - (gap @ b) * (a @ b)) / (across @ across)
            return float((last.point + along * last.direction - first.point) @ first.direction)
    return 0.0


def _laid(mine: list[_Axis], theirs: list[_Axis]) -> Pose:
    """Fit the root to all axes by least squares, first to their directions, then to their positions.

    All joints are at zero. ``mine`` are the axes of the arm's DH table, ``theirs`` the axes of the file.
    """
    with warnings.catch_warnings():  # parallel axes leave it open; another root is tried then
        warnings.filterwarnings("ignore", message="Optimal rotation is not uniquely")
        turn = Rotation.align_vectors([axis.direction for axis in theirs], [axis.direction for axis in mine])[0]
    rotation = turn.as_matrix()
    turning = [(axis, their_axis) for axis, their_axis in zip(mine, theirs, strict=True) if not their_axis.slides]
    if not turning:
        return Pose(np.zeros(3), rotation)
    across = [np.eye(3) - np.outer(axis.direction, axis.direction) for _, axis in turning]
    gaps = [their_axis.point - rotation @ axis.point for axis, their_axis in turning]
    apart = np.concatenate([matrix @ gap for matrix, gap in zip(across, gaps, strict=True)])
    return Pose(np.linalg.lstsq(np.concatenate(across), apart, rcond=None)[0], rotation)


def _value(last: _Axis, here: _Axis, wanted: _Axis) -> float:
    """Compute the value, rad or m, of the joint on axis ``last`` that moves axis ``here`` onto axis ``wanted``.

    The result is 0 if the axes do not determine the value.
    """
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
    """Return the part of a vector that is perpendicular to an axis."""
    return np.asarray(vector - axis.direction * (axis.direction @ vector))


def _along(axis: _Axis, value: float) -> Pose:
    """Return the rigid motion by ``value``, rad or m, of a joint: a turn about ``axis``, or a shift along it."""
    if axis.slides:
        return Pose(value * axis.direction, np.eye(3))
    turn = Rotation.from_rotvec(value * axis.direction).as_matrix()
    return Pose(axis.point - turn @ axis.point, turn)


def frames_apart(arm: Geometry, file: Geometry, root: Pose, sign: Array, zero: Array) -> tuple[float, float]:
    """Compute the largest distance, m, and angle, rad, between the link frames of table and file over several poses.

    N_i is a link's frame in the table, U_i the link's frame in the file, and G the root. The frames are made equal at
    the first pose. The result is the largest change of K_i = N_i^-1 G^-1 U_i from the first pose to the other poses.

    Args:
        arm: The arm's geometry before its calibration.
        file: The geometry that the file describes.
        root: Pose of the table's world frame in the file's root link, G.
        sign: 1 or -1 for each joint (n,), the direction of its motion in the table relative to the file.
        zero: The table's joint values (n,), rad or m, at the pose where all joints of the file are zero.
    """
    fractions = np.mod(GOLDEN * np.arange(1, POSES * file.joints + 1).reshape(POSES, -1), 1.0) - 0.5
    joints = np.where(file.prismatic, 1.0, np.pi) * np.vstack([np.zeros(file.joints), fractions])
    most = np.zeros(2)
    for table, their_link in zip(link_frames(arm, joints * sign + zero), link_frames(file, joints), strict=True):
        laid = behind(inverse_pose(behind(root, table)), their_link)
        turned = Rotation.from_matrix(laid.rotation @ laid.rotation[0].T).magnitude()
        most = np.maximum(most, [np.linalg.norm(laid.position - laid.position[0], axis=-1).max(), turned.max()])
    return float(most[0]), float(most[1])


Z = np.array([0.0, 0.0, 1.0])


def corrected_origins(
    nominal: Geometry, identified: Geometry, branches: Sequence[Sequence[ChainJoint]], same: SameChain
) -> tuple[list[tuple[ChainJoint, Pose]], Pose]:
    """Compute the corrected origin of each joint of a file, and the calibrated tool's pose in the last joint's frame.

    A whole robot (a tree of links) has no single tool: the second result is then the identity. The fitted places of its
    sensors and targets are left out, since they are no part of the robot.

    Args:
        nominal: The arm's geometry before its calibration.
        identified: The calibrated geometry in the robot's own base. If base and tool were fitted, it has the base
            and tool of ``nominal``.
        branches: The file's joints from root to tip, as the only item. For a whole robot, one item for each named part
            of its tree.
        same: The relation of ``nominal`` to the file.
    """
    root, sign, zero = same
    tree, arms = nominal.tree, [nominal, identified]
    ways = [list(range(nominal.links))]
    if tree is not None:
        arms = [geometry.between(-1, 0) for geometry in arms]
        ways = [[link for link in reversed(tree.carry(end)) if nominal.ratios[link]] for end in tree.carriers]
    before, after = ([behind(root, pose) for pose in link_frames(geometry, zero)] for geometry in arms)
    signs = [float(sign[joint]) for joint in nominal.owners]
    moves: dict[str, tuple[ChainJoint, Pose]] = {}
    for way, joints in zip(ways, branches, strict=True):
        drawn, fitted = ([frames_of[link] for link in way] for frames_of in (before, after))
        corrected, senses = {name: origin for name, (_, origin) in moves.items()}, [signs[link] for link in way]
        origins, old, new = _moved_origins(drawn, fitted, joints, senses, corrected)
        moves |= {joint.name: (joint, origin) for joint, origin in zip(joints, origins, strict=True)}
    if tree is not None:
        return list(moves.values()), identity_pose()
    hand, last = behind(after[-1], identified.tool), joints[-1]
    if last.ratio:
        drawing, placed = behind(before[-1], nominal.tool), behind(inverse_pose(new), hand)
        axis, moved = last.axis, behind(placed, inverse_pose(behind(inverse_pose(old), drawing)))
        # The part of the tool's motion that shifts along the last axis and turns about it is the joint's.
        turn = rotation_matrix(axis * (axis @ rotation_vector(moved.rotation)))
        along = Pose(axis * (axis @ moved.position), turn)
        moves[last.name], new = (last, behind(origins[-1], along)), behind(new, along)
    return list(moves.values()), behind(inverse_pose(new), hand)


def _moved_origins(
    before: Sequence[Pose],
    after: Sequence[Pose],
    joints: Sequence[ChainJoint],
    signs: Sequence[float],
    corrected: Mapping[str, Pose],
) -> tuple[list[Pose], Pose, Pose]:
    """Compute the corrected origins of a file's joints.

    Args:
        before: Poses of the arm's links in the file's root, at the file's zero, before the calibration.
        after: The same poses after the calibration.
        joints: The joints of the file.
        signs: 1 or -1 for each link, the direction of its motion in the table relative to the file.
        corrected: Origins that are already corrected, by the joint's name.

    Returns:
        The origins, the uncorrected pose of the last joint's link in the file's root, and the corrected pose of it.
    """
    links = links_of(joints)
    places = {joint.name: place for place, link in enumerate(links) for joint in link}
    old = new = identity_pose()
    origins = []
    for joint in joints:
        old = behind(old, joint.origin)
        stood = behind(new, joint.origin)
        link = places.get(joint.name)
        if joint.name in corrected:
            stood = behind(new, corrected[joint.name])
        elif link is not None:
            laid = behind(inverse_pose(before[link]), old)
            if len(links[link]) == 1:
                laid = _laid_upon(laid, joint, signs[link])
            drawing, stood = stood, behind(after[link], laid)
            if _slips(before, link, joint):
                axis = stood.rotation @ joint.axis
                stood = Pose(stood.position + axis * (axis @ (drawing.position - stood.position)), stood.rotation)
        origins.append(behind(inverse_pose(new), stood))
        motion = joint.motion(joint.offset)
        old, new = behind(old, motion), behind(stood, motion)
    return origins, old, new


def _slips(before: Sequence[Pose], link: int, joint: ChainJoint) -> bool:
    """Return whether a link's place along its axis is arbitrary: its joint is revolute, and the next axis is parallel.

    Args:
        before: Poses of all links.
        link: Index of the link, from 0.
        joint: The link's joint in the file.
    """
    if joint.slides or link + 1 == len(before):
        return False
    axis, following = (pose.rotation[:, 2] for pose in before[link : link + 2])
    return bool(np.linalg.norm(np.cross(axis, following)) < NEARLY_PARALLEL)


def _laid_upon(laid: Pose, joint: ChainJoint, sign: float) -> Pose:
    """Return the pose of a file's joint in its link's frame, with the joint's axis exactly on the link's z axis.

    This undoes the rounding of the file.

    Args:
        laid: The pose of the joint in its link's frame, as the file gives it.
        joint: The joint.
        sign: 1 or -1, the direction of the joint's motion in the table relative to the file.
    """
    axis = laid.rotation @ joint.axis
    turn = Rotation.align_vectors(sign * Z[None], axis[None])[0].as_matrix()
    return Pose(laid.position if joint.slides else Z * laid.position[2], turn @ laid.rotation)


# What patching a robot's own file shares, whatever its format. Is it this arm, where do its joints stand now, what
# may the file hold of a calibration and what may it not: a file holds the links. It does not hold where an instrument
# stood or what it aimed at (base and tool that were fitted), nor terms and learnt residuals, for which no file of
# rigid links has a place.


RIGID = "not in the file, because rigid links cannot hold it"
"""Beginning of a sentence on what a file of rigid links leaves out."""

NOTHING = 1e-12
"""Change of an origin, m or rad, up to which its text in the file is not changed."""

COUNTED = 1e-7
"""Least shift or turn of a joint origin, m or rad, that counts. Priors alone move origins by less."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Corrected poses of a file's joints and tool; for a whole robot (a tree of links), joints alone.

    Attributes:
        moves: Each of the file's joints with its new origin, in the frame of `ChainJoint.origin`.
        notes: Sentences that say which parts of the calibration the file holds, and which it does not.
        root: Pose of the table's world frame in the file's root link.
        hand: Pose of the calibrated tool in the tip's frame, if the tip's own pose in the file does not change.
        mount: New pose of the tip in the last joint's frame; None if it does not change.
        frame: Pose of the calibrated tool in the tip's frame, for a new frame that is fixed to the tip. None if no such
            frame is needed or can be written.
    """

    moves: list[tuple[ChainJoint, Pose]]
    notes: tuple[str, ...]
    root: Pose = field(default_factory=identity_pose)
    hand: Pose = field(default_factory=identity_pose)
    mount: Pose | None = None
    frame: Pose | None = None


def correction(calibration: Calibration, rows: Sequence[JointRow], path: Path, frame: str = "") -> Correction:
    """Compute the corrected poses of the joints and the tool in a robot's own file.

    A link that a joint moves has its frame on that joint's axis. If the tip is such a link, the calibrated tool can lie
    beside the axis. The tool then becomes a new frame that is fixed to the tip.

    Args:
        calibration: The calibration.
        rows: The file's joints up to its tip; for a whole robot, one item for each of its named parts.
        path: The file, for messages.
        frame: Name of the new frame that is fixed to the tip; empty if the file's format has no such frames.

    Raises:
        InputError: If the file is of another arm.
    """
    arm, robot, own = calibration.arm, calibration.in_own_base, rows[0]
    if arm.tree is not None:
        with in_file(path):
            calibration.refuse_another(arm_of(rows, path, "whole robot"))
        alike = identity_pose(), np.ones(arm.joints), np.zeros(arm.joints)
        branches = [row.joints for row in rows]
        (moves, _), (plain, _) = (corrected_origins(arm, fit, branches, alike) for fit in (robot, arm))
        return Correction(moves, (moved_words(moves, plain), *left_out(calibration, RIGID)))
    with in_file(path):
        geometry, *_ = geometry_of(rows)
    same = same_chain(arm, geometry, path.name, calibration.arm_name)
    (moves, tool_mount), (plain, _) = (corrected_origins(arm, fit, [own.joints], same) for fit in (robot, arm))
    root, _, zero = same
    fitted = calibration.record.get("frames") == "fitted"
    hand = behind(inverse_pose(own.tool), tool_mount)
    if fitted:  # the robot's tool stays, and the one measured hangs on it
        hand = behind(hand, behind(inverse_pose(arm.tool), calibration.identified.tool))
    retooled = max(apart(calibration.arm.tool, calibration.identified.tool)) > NOTHING
    tool, tip = behind(root, forward(calibration.arm, zero)), forward(geometry, np.zeros(geometry.joints))
    near, turned = apart(tool, tip)
    corrects = near <= NEAR and turned <= TURNED and retooled and not fitted
    mount = tool_mount if corrects and own.mount is not None else None
    beside = apart(behind(inverse_pose(tip), tool), hand)
    lies_beside = max(beside) > NOTHING
    behind_tip = hand if corrects and own.mount is None and frame and lies_beside else None
    notes = [moved_words(moves, plain), *_readings(calibration, own, same)]
    size = f"{beside[0] * 1e3:.3g} mm and {round(math.degrees(beside[1]), 6):g} deg"
    if fitted:
        notes.append(
            "base and tool were fitted: where the instrument stood and what it aimed at are no part of the robot, so "
            "the file keeps its root and its tip; `kind='transforms'` writes both"
        )
    elif mount is not None:
        notes.append(f"the tool's correction is in the fixed joint '{own.mount}' before the tip")
    elif behind_tip is not None:
        notes.append(
            f"the calibrated tool is the new frame '{frame}', fixed to the tip {own.tip}: {size} of the tool's "
            "correction lie beside the last joint's axis, where no frame of its own link can stand"
        )
    elif lies_beside:
        notes.append(
            f"of the tool's correction {size} are left out: the file's tip is not the calibrated tool on a fixed "
            "joint; `kind='transforms'` writes them"
        )
    return Correction(moves, (*notes, *left_out(calibration, RIGID)), root, hand, mount, behind_tip)


def own_origin(own: Pose, whole: Pose, corrected: Pose) -> Pose:
    """Compute the new pose of an element in a file, relative to its parent element.

    Fixed elements between the element and the previous joint keep their poses.

    Args:
        own: The element's pose in the file, relative to its parent element.
        whole: The element's pose in the file, relative to the previous joint.
        corrected: The element's new pose, relative to the previous joint.
    """
    return behind(behind(own, inverse_pose(whole)), corrected)


def is_moved(old: Pose, new: Pose) -> tuple[bool, bool]:
    """Return whether the positions of two poses, and whether their rotations, differ by more than `NOTHING`."""
    position, turn = apart(old, new)
    return position > NOTHING, turn > NOTHING


def changed(old: Pose, new: Pose, place: str, attitude: str, words: Callable[[Pose], str]) -> dict[str, str]:
    """Return the new values of the attributes that hold a pose's position and attitude, by the attributes' names.

    An attribute that does not change is left out.

    Args:
        old: The pose in the file.
        new: The pose to write.
        place: Name of the position's attribute.
        attitude: Name of the attitude's attribute.
        words: Function that returns a pose's attitude as text.
    """
    shifted, turned = is_moved(old, new)
    return ({place: numbers_text(new.position)} if shifted else {}) | ({attitude: words(new)} if turned else {})


def _readings(calibration: Calibration, own: JointRow, same: SameChain) -> Iterator[str]:
    """Yield a sentence that names joints whose readings in the file differ from the arm's table, if there are any.

    ``own`` are the file's joints, and ``same`` is the relation of the table to the file.
    """
    drivers = dict.fromkeys(joint.driver for joint in own.joints if joint.ratio)  # in the file's order
    readings = [
        f"{name} = {sign:+.0f} x {joint} {'+' if zero >= 0 else '-'} {abs(zero):.6g}"
        for name, joint, sign, zero in zip(calibration.arm.joint_names, drivers, *same[1:], strict=True)
        if sign != 1 or zero
    ]
    if readings:
        yield f"joints read otherwise in the file (rad, m): {', '.join(readings)}; its own reading is kept"


def moved_words(moves: Sequence[tuple[ChainJoint, Pose]], plain: Sequence[tuple[ChainJoint, Pose]]) -> str:
    """Return a sentence that says how far the calibration moves joint origins.

    Args:
        moves: Each joint as the file has it, with its corrected origin.
        plain: Each joint with its corrected origin for an arm without errors. Such an origin differs from the file's
            origin by the file's rounding alone.
    """
    pairs = [(joint, old, new) for (joint, new), (_, old) in zip(moves, plain, strict=True)]
    apart_by = {joint.name: apart(old, new) for joint, old, new in pairs}
    sizes = {name: size for name, size in apart_by.items() if max(size) > COUNTED}
    rounded = any(any(is_moved(joint.origin, new)) for joint, _, new in pairs if joint.name not in sizes)
    if not sizes:
        more = " by more than the file's rounding" if rounded else "; nothing is changed"
        return f"no joint origin differs from what the file has{more}"
    far, turned = (max(sizes, key=lambda name: sizes[name][i]) for i in range(2))
    more = ", but for the file's rounding" if rounded else ""
    return (
        f"{len(sizes)} of {len(moves)} joint origins corrected: by up to {sizes[far][0] * 1e3:.3g} mm ({far}) "
        f"and {math.degrees(sizes[turned][1]):.3g} deg ({turned}); everything else is as it was{more}"
    )


def refuse_lost_files(path: Path, out: Path, names: Iterable[str]) -> None:
    """Refuse a robot's file if files that it names by relative paths are missing.

    These files must exist relative to the robot's file, and also relative to the new file.

    Args:
        path: The robot's own file.
        out: The new file.
        names: Paths or URLs that the robot's file names, such as paths of meshes.

    Raises:
        InputError: If such a file would not be found; the message names it and what to do.
    """
    for name in names:
        if not name or "://" in name or Path(name).is_absolute():
            continue
        if not (path.parent / name).is_file():
            raise InputError(f"{path} names '{shortened(name)}', which is not there; put it back or correct the name")
        if not (out.parent / name).is_file():
            raise InputError(f"{out} would not find '{shortened(name)}' from where it stands; write it beside {path}")
