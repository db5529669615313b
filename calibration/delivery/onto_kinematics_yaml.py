"""A calibration onto the kinematics YAML that a xacro takes its joint origins from; the xacro itself needs no change.

Written against ur_description of ROS 2 (Universal_Robots_ROS2_Description 2.x: config/UR_TYPE/default_kinematics.yaml):
``kinematics`` holds x, y, z, roll, pitch, yaw per link, in the chain's order, metres and radians, all axes on z, and a
``hash`` by which the driver knows the controller's own calibration. The hash is kept: it is the robot's.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from pickenv.arm.files.joint_chain import ChainJoint
from pickenv.arm.files.link_origins import link_origins
from pickenv.arm.files.ur_yaml import UR_KEYS, UR_LINKS, ur_row
from pickenv.arm.files.urdf_text import roll_pitch_yaw
from pickenv.arm.kinematics.geometry import behind, identity_pose, inverse_pose
from pickenv.calibration.delivery.corrected_chain import Z, corrected_chain
from pickenv.calibration.delivery.origin_lines import Document, provenance
from pickenv.calibration.delivery.patched import correction, is_moved
from pickenv.calibration.delivery.same_chain import SameChain
from pickenv.calibration.delivery.xml_edit import Edit, edited
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.texts import one_line, shortened

LENGTHS = ("x", "y", "z")
UR_TWISTS = (0.0, math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2)
"""alpha of a UR's modified DH table, rad: its frames are those of ur_description."""


def onto_kinematics_yaml(calibration: Calibration, path: Path) -> Document:
    """The text of a kinematics YAML with corrected origins; other lines, and its hash, stay.

    Raises:
        InputError: If the file is unusable or of another arm.
    """
    row, _ = ur_row(path)
    found = correction(calibration, row, path)
    data = path.read_bytes()
    edits: list[Edit] = []
    for link, joint, new in zip(UR_LINKS, row.joints, found.chain.origins, strict=True):
        moved = is_moved(joint.origin, new)
        values = [*new.position, *roll_pitch_yaw(np.asarray(new.rotation))]
        changed = {key: float(value) for key, value in zip(UR_KEYS, values, strict=True) if moved[key not in LENGTHS]}
        edits += _edits(data, link, changed, path)
    return Document(edited(data, edits), (*found.notes, "the hash is the robot's own and stays"))


def _edits(data: bytes, name: str, values: dict[str, float], path: Path) -> list[Edit]:
    """What gives a link's keys new numbers, between its name and the next link's."""
    if not values:
        return []
    places = {
        each: found.end()
        for each in (*UR_LINKS, "hash")
        if (found := re.search(rb"^\s+" + re.escape(each.encode()) + rb"\s*:", data, re.MULTILINE)) is not None
    }
    start = places[name]
    end = min((place for place in places.values() if place > start), default=len(data))
    edits = []
    for key, value in values.items():
        number = re.compile(rb"\b" + key.encode() + rb"\s*:\s*([-+.\w]+)").search(data, start, end)
        if number is None:
            raise InputError(f"{path}: '{shortened(name)}' has no '{key}' in its own lines; write it out there")
        edits.append(Edit(number.start(1), number.end(1), yaml_number(value).encode()))
    return edits


def yaml_number(value: float) -> str:
    """A number with all its digits that YAML 1.1 takes for one: 1e-05 would be a text there."""
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def ur_kinematics_yaml(calibration: Calibration) -> Document:
    """A whole kinematics YAML of a UR whose table has the maker's frames, for ur_description's ``kinematics_params``.

    Raises:
        InputError: If the arm's table is no UR's.
    """
    own = calibration.arm
    plain = own.links == len(UR_LINKS) and not any(own.slides) and own.coupling is None
    if not plain or not np.allclose(own.alpha, UR_TWISTS, atol=1e-9) or np.abs(own.a[[0, 1, 4, 5]]).max() > 1e-9:
        raise InputError(
            f"the table of '{calibration.arm_name}' has not the frames of a UR; give --onto the "
            "default_kinematics.yaml of your UR type"
        )
    lines = [f"# {one_line(line)}" for line in provenance(calibration)]
    lines += ["# for ur_description of ROS 2, 2.x; the hash is not the controller's, so ur_robot_driver will say so"]
    lines += ["kinematics:"]
    based = replace(own, base=identity_pose())
    origins = link_origins(based)
    joints = [ChainJoint(link, link, 1.0, 0.0, False, pose, Z) for link, pose in zip(UR_LINKS, origins, strict=True)]
    alike = SameChain(identity_pose(), np.ones(len(UR_LINKS)), np.zeros(len(UR_LINKS)))
    robot = calibration.in_own_base
    robot = replace(robot, base=behind(inverse_pose(own.base), robot.base))
    found = corrected_chain(based, robot, joints, identity_pose(), alike)
    for link, origin in zip(UR_LINKS, found.origins, strict=True):
        values = [*origin.position, *roll_pitch_yaw(np.asarray(origin.rotation))]
        lines.append(f"  {link}:")
        lines += [f"    {key}: {yaml_number(float(value))}" for key, value in zip(UR_KEYS, values, strict=True)]
    lines.append(f"  hash: calib_pickenv_{calibration.arm_fingerprint}")
    notes = (
        "the links' origins; a tool and where the instrument stood are no part of this file",
        "the hash is not the controller's: with --onto your robot's own file it is kept",
    )
    return Document(("\n".join(lines) + "\n").encode(), notes)
