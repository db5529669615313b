"""What patching a robot's own file shares, whatever its format.

Is it this arm, where do its joints stand now, what may the file hold of a calibration and what may it not: a file
holds the links. It does not hold where an instrument stood or what it aimed at (base and tool that were fitted), nor
terms and learnt residuals, for which no file of rigid links has a place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pickenv.arm import forward
from pickenv.arm.files.joint_chain import JointRow
from pickenv.arm.kinematics.geometry import Pose, behind, inverse_pose
from pickenv.calibration.delivery.corrected_chain import CorrectedChain, corrected_chain
from pickenv.calibration.delivery.origin_lines import left_out
from pickenv.calibration.delivery.same_chain import NEAR, TURNED, SameChain, same_chain
from pickenv.calibration.identification.alignment import apart
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.texts import shortened

NOTHING = 1e-12
"""m and rad; an origin that moves by less keeps its text."""


@dataclass(frozen=True, eq=False)
class Correction:
    """What a file's joints are given.

    Attributes:
        chain: Where the joints stand.
        same: How the file tells of the arm.
        mount: New pose of the tip in the last joint's frame; None where it stays.
        notes: What the file holds, and what it does not, a sentence each.
    """

    chain: CorrectedChain
    same: SameChain
    mount: Pose | None
    notes: tuple[str, ...]


def correction(calibration: Calibration, own: JointRow, path: Path) -> Correction:
    """Where the joints of a robot's own file stand after calibration.

    Args:
        calibration: The calibration.
        own: The file's joints.
        path: The file, for messages.

    Raises:
        InputError: If the file is of another arm.
    """
    try:
        geometry, _ = own.geometry()
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    same = same_chain(calibration.arm, geometry, path.name, calibration.arm_name)
    known = calibration.record.get("frames") != "fitted"
    chain = corrected_chain(calibration.arm, calibration.in_own_base, own.joints, own.tool, same)
    retooled = max(apart(calibration.arm.tool, calibration.identified.tool)) > NOTHING
    tool, tip = behind(same.root, forward(calibration.arm, same.zero)), forward(geometry, np.zeros(geometry.joints))
    near, turned = apart(tool, tip)
    at_tip = near <= NEAR and turned <= TURNED
    mount = chain.mount if known and at_tip and own.mount is not None and retooled else None
    return Correction(chain, same, mount, tuple(_notes(calibration, own, chain, same, mount)))


def own_origin(own: Pose, whole: Pose, corrected: Pose) -> Pose:
    """The corrected pose of one element, before which others may be fixed that stay.

    Args:
        own: Pose that the element gives now.
        whole: Pose that it gives with those fixed before it, since the joint before.
        corrected: What this one becomes.
    """
    return behind(behind(own, inverse_pose(whole)), corrected)


def is_moved(old: Pose, new: Pose) -> tuple[bool, bool]:
    """Whether position and rotation differ by more than their last digits."""
    position, turn = apart(old, new)
    return position > NOTHING, turn > NOTHING


def _notes(
    calibration: Calibration, own: JointRow, chain: CorrectedChain, same: SameChain, mount: Pose | None
) -> list[str]:
    moves = {
        joint.name: apart(joint.origin, new)
        for joint, new in zip(own.joints, chain.origins, strict=True)
        if any(is_moved(joint.origin, new))
    }
    notes = []
    if moves:
        far = max(moves, key=lambda name: moves[name][0])
        turned = max(moves, key=lambda name: moves[name][1])
        notes.append(
            f"{len(moves)} of {len(own.joints)} joint origins corrected: by up to {moves[far][0] * 1e3:.3g} mm ({far}) "
            f"and {math.degrees(moves[turned][1]):.3g} deg ({turned}); everything else is as it was"
        )
    else:
        notes.append("no joint origin differs from what the file has; nothing is changed")
    if not same.plain():
        said = [
            f"{name} = {sign:+.0f} x {joint} {'+' if zero >= 0 else '-'} {abs(zero):.6g}"
            for name, joint, sign, zero in zip(
                calibration.arm.joint_names, _drivers(own), same.sign, same.zero, strict=True
            )
            if sign != 1 or zero
        ]
        notes.append(f"joints read otherwise in the file (rad, m): {', '.join(said)}; its own reading is kept")
    if calibration.record.get("frames") == "fitted":
        notes.append(
            "base and tool were fitted: where the instrument stood and what it aimed at are no part of the robot, so "
            "the file keeps its root and its tip; --as transforms writes both"
        )
    elif mount is not None:
        notes.append(f"the tool's correction is in the fixed joint '{own.mount}' before the tip")
    elif max(retooled := apart(calibration.arm.tool, calibration.identified.tool)) > NOTHING:
        notes.append(
            f"the tool's correction ({retooled[0] * 1e3:.3g} mm, {math.degrees(retooled[1]):.3g} deg) is left out: the "
            "file's tip is not the calibrated tool on a fixed joint; --as transforms writes it"
        )
    left = left_out(calibration)
    if left:
        notes.append(f"not in the file, because rigid links cannot hold it: {', '.join(left)}")
    return notes


def _drivers(own: JointRow) -> list[str]:
    """Names of the joints that are commanded, in the file's order."""
    return list(dict.fromkeys(joint.driver for joint in own.joints if joint.ratio))


def refuse_lost_files(path: Path, out: Path, names: Sequence[str]) -> None:
    """Refuse where a file names others beside it that are not there, or would not be found from the new file's place.

    Raises:
        InputError: Names the file and what to do.
    """
    for name in names:
        if not name or "://" in name or Path(name).is_absolute():
            continue
        if not (path.parent / name).is_file():
            raise InputError(f"{path} names '{shortened(name)}', which is not there; put it back or correct the name")
        if not (out.parent / name).is_file():
            raise InputError(
                f"{out} would not find '{shortened(name)}' from where it stands; write it beside {path.name}, in "
                f"{path.parent}"
            )
