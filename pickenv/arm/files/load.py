"""Arms by name or by file: TOML (`arm_file`), URDF (`urdf`), MJCF (`mjcf`), a UR controller's YAML, or of others."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.arm import Arm
from pickenv.arm.files.arm_file import ARMS, read_arm
from pickenv.arm.files.joint_chain import ChainJoint, Drive, JointRow, xml_number
from pickenv.arm.kinematics.geometry import Pose, identity_pose
from pickenv.base import RAD, InputError, M, file_named, read_text, register, shipped_in, shortened, yaml_content
from pickenv.base.registry import get, names

# A Universal Robots arm by its kinematics file: `default_kinematics.yaml` of ROS's `ur_description` (format of 2.x).
# `ur_calibration` writes such a file from what the maker measured of one robot and its controller keeps. Each of six
# joints turns about z of a frame that the file places in the frame before, by x, y, z in m and roll, pitch, yaw in
# rad about fixed axes. The base is the controller's (`base` of ROS), the tip its flange (`tool0`).


UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
LIMITS_OF = "ur10e"
"""The file has no limits and speeds; this arm's are taken, the slowest of its series."""


@register("arm_format", "yml")
@register("arm_format", "yaml")
def load_ur_yaml(path: str | Path, tip: str | None = None) -> Arm:
    """Read a UR kinematics file, whose arm ends at its flange.

    Raises:
        InputError: If it is none, a joint or a number is missing, or a tip is named; the message says which.
    """
    path = Path(path)
    if tip:
        raise InputError(f"{path} ends at the flange, and names no '{shortened(tip)}'; leave # and what follows out")
    row, mark = ur_row(path)
    geometry, speed = row.geometry()
    source = f"UR kinematics {path.name}{mark}; limits and speeds are those of {LIMITS_OF}, which the file has not"
    return Arm(path.stem, source, geometry, None, speed)


def ur_row(path: Path) -> tuple[JointRow, str]:
    """The joints that `load_ur_yaml` makes an arm of, and the file's mark of the robot.

    Raises:
        InputError: If it is none, or a joint or a number is missing; the message names it.
    """
    content = yaml_content(read_text(path, "a UR kinematics file (.yaml)"), path)
    links = content.get("kinematics") if isinstance(content, Mapping) else None
    if not isinstance(links, Mapping):
        raise InputError(f"{path} has no 'kinematics'; give a UR kinematics file as ur_calibration writes it")
    like = read_arm(ARMS / f"{LIMITS_OF}.toml")
    joints, drives = [], {}
    for i, (link, name) in enumerate(zip(UR_LINKS, UR_JOINTS, strict=True)):
        numbers = links.get(link)
        if not isinstance(numbers, Mapping) or any(key not in numbers for key in UR_KEYS):
            raise InputError(f"{path}: '{link}' of kinematics lacks one of {', '.join(UR_KEYS)}; give all six")
        try:
            values = [
                xml_number(str(numbers[key]), f"{key} of {link}", (M if key in "xyz" else RAD).most) for key in UR_KEYS
            ]
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        origin = Pose(np.array(values[:3]), Rotation.from_euler("xyz", values[3:]).as_matrix())
        joints.append(ChainJoint(name, name, 1.0, 0.0, False, origin, np.array([0.0, 0.0, 1.0])))
        limits = (like.nominal.lower[i], like.nominal.upper[i], like.speed[i])
        drives[name] = Drive(False, *map(float, limits))
    mark = f", {shortened(links['hash'])}" if "hash" in links else ""
    return JointRow(path.stem, "base", "tool0", tuple(joints), identity_pose(), drives), mark


def shipped_arms() -> list[str]:
    """Names of the arms that come with pickenv."""
    return shipped_in(ARMS)


def load_arm(name: str | Path) -> Arm:
    """Read an arm by name (a shipped one), or from a path to a TOML, URDF, MJCF or UR kinematics file.

    Args:
        name: "ur5", "arm.toml", "arm.urdf#tip_link", "arm.xml#body_or_site", or "default_kinematics.yaml" as
            `ur_description` has it. Without a tip the arm ends at its flange; its source then says at which link.

    Raises:
        InputError: If the arm is unknown, or its file is malformed; the message names the file and the joint or key.
    """
    path, _, tip = str(name).partition("#")
    ending = Path(path).suffix[1:]
    reader = get("arm_format", ending) if ending in names("arm_format") else load_toml
    arm: Arm = reader(path, tip or None)
    return arm


@register("arm_format", "toml")
def load_toml(path: str | Path, tip: str | None = None) -> Arm:
    """Read an arm by the name of a shipped one or from a TOML file, which says itself where the arm ends."""
    endings = ", ".join(f".{name}" for name in names("arm_format"))
    file = file_named("arm", f"{path}#{tip}" if tip else path, ARMS, endings)
    return _read(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=32)
def _read(path: Path, _modified: int) -> Arm:
    return read_arm(path)
