"""Where the joints of a file's chain stand once its arm is calibrated; joints read and links are shaped as before.

N_i and C_i are link frames of the table before and after calibration, D_i the frame of the file's joint i, all where
the file's joints are zero. K_i = N_i^-1 D_i is constant. The corrected joint stands at C_i K_i, and its origin is that
in the corrected frame before it. The chain begins at the robot's own base: where an instrument stood is no part of it.
Where the next axis is parallel, no pose tells where along its axis a link stands, and a fit puts it anywhere; then it
stays where the file draws it, as Universal Robots' own calibration has it (ur_calibration, correctAxis). What moves the
tool along or about the last axis is the joint's as well, and is given to the joint. Metres and radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Geometry, rotation_matrix, rotation_vector
from pickenv.arm.files.joint_chain import ChainJoint
from pickenv.arm.kinematics.geometry import Pose, behind, identity_pose, inverse_pose
from pickenv.calibration.delivery.same_chain import SameChain, link_frames

Z = np.array([0.0, 0.0, 1.0])
PARALLEL = 1e-3
"""Axes count as parallel below this sine of the angle between them, digits that a file cut included."""


@dataclass(frozen=True, eq=False)
class CorrectedChain:
    """A file's chain with the joints where calibration found them.

    Attributes:
        origins: New origin of each of the file's joints, told as `ChainJoint.origin` is.
        tip: Pose of the file's tip in its root at zero joints, with the old mount of the tip.
        hand: Pose of the calibrated tool in the tip.
        mount: Pose of the tip in the last joint's frame with which the tip is the calibrated tool.
    """

    origins: tuple[Pose, ...]
    tip: Pose
    hand: Pose
    mount: Pose


def corrected_chain(
    nominal: Geometry, found: Geometry, joints: Sequence[ChainJoint], tool: Pose, same: SameChain
) -> CorrectedChain:
    """The corrected origins of a file's joints.

    Args:
        nominal: The arm as it was before its calibration.
        found: The calibrated arm, with the base as it was where an instrument's frame was fitted.
        joints: Of the file.
        tool: Pose of the file's tip in the frame of its last joint.
        same: How the file tells of ``nominal``.
    """
    before, after = (
        [behind(same.root, pose) for pose in link_frames(geometry, same.zero)] for geometry in (nominal, found)
    )
    links = links_moved(joints)
    old = new = identity_pose()
    origins = []
    for place, joint in enumerate(joints):
        old = behind(old, joint.origin)
        stood = behind(new, joint.origin)
        link = links[place]
        if link is not None:
            laid = behind(inverse_pose(before[link]), old)
            if links.count(link) == 1:
                laid = _laid_upon(laid, joint, float(same.sign[nominal.owners[link]]))
            drawn, stood = stood, behind(after[link], laid)
            if _slips(before, link, joint):
                axis = stood.rotation @ joint.axis
                stood = Pose(stood.position + axis * (axis @ (drawn.position - stood.position)), stood.rotation)
        origins.append(behind(inverse_pose(new), stood))
        moved = joint.motion(joint.offset)
        old, new = behind(old, moved), behind(stood, moved)
    hand = behind(after[-1], found.tool)
    if joints and joints[-1].ratio:
        drawn, placed = behind(before[-1], nominal.tool), behind(inverse_pose(new), hand)
        along = _along(behind(placed, inverse_pose(behind(inverse_pose(old), drawn))), joints[-1])
        origins[-1], new = behind(origins[-1], along), behind(new, along)
    tip = behind(new, tool)
    return CorrectedChain(tuple(origins), tip, behind(inverse_pose(tip), hand), behind(inverse_pose(new), hand))


def _along(moved: Pose, joint: ChainJoint) -> Pose:
    """The part of a small motion that shifts along a joint's axis and turns about it."""
    turn = joint.axis * (joint.axis @ rotation_vector(moved.rotation))
    return Pose(joint.axis * (joint.axis @ moved.position), rotation_matrix(turn))


def _slips(before: Sequence[Pose], link: int, joint: ChainJoint) -> bool:
    """Whether a link may stand anywhere along its axis: it turns, and the next axis is parallel."""
    if joint.slides or link + 1 == len(before):
        return False
    return bool(np.linalg.norm(np.cross(before[link].rotation[:, 2], before[link + 1].rotation[:, 2])) < PARALLEL)


def links_moved(joints: Sequence[ChainJoint]) -> list[int | None]:
    """The arm's link that each of a file's joints moves: slides in a row that one joint moves are one link."""
    found: list[int | None] = []
    row: dict[str, int] = {}
    count = 0
    for joint in joints:
        if not joint.ratio:
            found.append(None)
        elif joint.slides and joint.driver in row:
            found.append(row[joint.driver])
        else:
            row = {**row, joint.driver: count} if joint.slides else {}
            found.append(count)
            count += 1
    return found


def _laid_upon(laid: Pose, joint: ChainJoint, sign: float) -> Pose:
    """The pose of a file's joint in its link's frame, with the axis exactly on z; digits that the file cut go here."""
    axis = laid.rotation @ joint.axis
    turn = Rotation.align_vectors(sign * Z[None], axis[None])[0].as_matrix()
    position = laid.position if joint.slides else Z * laid.position[2]
    return Pose(position, turn @ laid.rotation)
