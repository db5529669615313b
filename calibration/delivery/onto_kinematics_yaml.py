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
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from pickenv.arm.files.joint_chain import ChainJoint, Drive, behind
from pickenv.arm.files.urdf_text import roll_pitch_yaw
from pickenv.arm.kinematics.geometry import Pose, identity_pose, inverse_pose
from pickenv.calibration.delivery.corrected_chain import Z
from pickenv.calibration.delivery.origin_lines import Document, one_line, provenance
from pickenv.calibration.delivery.patched import OwnChain, correction, is_moved
from pickenv.calibration.delivery.same_chain import link_frames
from pickenv.calibration.delivery.xml_edit import Edit, edited
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.texts import parsed, read_text, shortened

LENGTHS, ANGLES = ("x", "y", "z"), ("roll", "pitch", "yaw")
UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
UR_TWISTS = (0.0, math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2)
"""alpha of a UR's modified DH table, rad: its frames are those of ur_description."""


def onto_kinematics_yaml(calibration: Calibration, path: Path) -> Document:
    """The text of a kinematics YAML with corrected origins; other lines, and its hash, stay.

    Raises:
        InputError: If the file is unusable or of another arm.
    """
    text = read_text(path, "a kinematics YAML")
    origins = _origins(parsed(lambda: yaml.safe_load(text), path, "YAML"), path)
    joints = [ChainJoint(name, name, 1.0, 0.0, False, pose, Z) for name, pose in origins.items()]
    drives = {name: Drive(False, -math.pi, math.pi, 1.0) for name in origins}
    found = correction(calibration, OwnChain(path.name, joints, identity_pose(), drives, None))
    data = text.encode()
    edits: list[Edit] = []
    for (name, old), new in zip(origins.items(), found.chain.origins, strict=True):
        moved = is_moved(old, new)
        values = dict(zip(LENGTHS, new.position, strict=True)) if moved[0] else {}
        if moved[1]:
            values |= dict(zip(ANGLES, roll_pitch_yaw(np.asarray(new.rotation)), strict=True))
        edits += _edits(data, name, list(origins), {key: float(value) for key, value in values.items()}, path)
    return Document(edited(data, edits), (*found.notes, "the hash is the robot's own and stays"))


def _origins(content: Any, path: Path) -> dict[str, Pose]:
    """Origins by link, in the file's order."""
    links = content.get("kinematics") if isinstance(content, dict) else None
    if not isinstance(links, dict):
        raise InputError(f"{path} has no 'kinematics'; give a file such as ur_description's default_kinematics.yaml")
    found = {}
    for name, link in links.items():
        if name == "hash":
            continue
        numbers = [link.get(key) if isinstance(link, dict) else None for key in (*LENGTHS, *ANGLES)]
        if not all(isinstance(number, int | float) and math.isfinite(number) for number in numbers):
            raise InputError(f"{path}: '{shortened(name)}' lacks a number among x, y, z, roll, pitch, yaw; add it")
        values = np.array(numbers, dtype=float)
        found[str(name)] = Pose(values[:3], Rotation.from_euler("xyz", values[3:]).as_matrix())
    if not found:
        raise InputError(f"{path} names no link under 'kinematics'; give a file with all of the arm's")
    return found


def _edits(data: bytes, name: str, names: list[str], values: dict[str, float], path: Path) -> list[Edit]:
    """What gives a link's keys new numbers, between its name and the next link's."""
    if not values:
        return []
    places = {
        each: found.end()
        for each in (*names, "hash")
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
    before = inverse_pose(own.base)
    poses = [behind(before, pose) for pose in link_frames(replace(calibration.identified, base=own.base), np.zeros(6))]
    lines = [f"# {one_line(line)}" for line in provenance(calibration)]
    lines += ["# for ur_description of ROS 2, 2.x; the hash is not the controller's, so ur_robot_driver will say so"]
    lines += ["kinematics:"]
    stands = identity_pose()
    for name, pose in zip(UR_LINKS, poses, strict=True):
        origin = behind(inverse_pose(stands), pose)
        values = [*origin.position, *roll_pitch_yaw(np.asarray(origin.rotation))]
        lines.append(f"  {name}:")
        lines += [
            f"    {key}: {yaml_number(float(value))}" for key, value in zip((*LENGTHS, *ANGLES), values, strict=True)
        ]
        stands = pose
    lines.append(f"  hash: calib_pickenv_{calibration.arm_fingerprint}")
    notes = (
        "the links' origins; a tool and where the instrument stood are no part of this file",
        "the hash is not the controller's: with --onto your robot's own file it is kept",
    )
    return Document(("\n".join(lines) + "\n").encode(), notes)
