"""A calibration onto a robot's own URDF: attributes of joint origins change, and no other byte.

Written against URDF as ROS 2 has it (https://wiki.ros.org/urdf/XML, version 1.0); xacro is expanded first. Lengths in
metres, rpy in radians about fixed axes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.urdf import urdf_row
from pickenv.arm.files.urdf_text import roll_pitch_yaw
from pickenv.arm.files.xml_values import numbers_text, xml_numbers
from pickenv.arm.kinematics.geometry import Pose
from pickenv.calibration.delivery.origin_lines import Document
from pickenv.calibration.delivery.patched import (
    Correction,
    correction,
    is_moved,
    own_origin,
    refuse_lost_files,
)
from pickenv.calibration.delivery.xml_edit import (
    Edit,
    StartTag,
    attribute_edits,
    edited,
    inserted_first,
    start_tags,
)
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.toml_tables import RAD, M


def onto_urdf(calibration: Calibration, path: Path, tip: str | None, out: Path) -> Document:
    """The text of a URDF with its joint origins where the calibration found them.

    Args:
        calibration: Of the same arm, whatever frames its table has.
        path: The file.
        tip: Last link; the flange when left out.
        out: Where it will be written, from where its meshes must be found.

    Raises:
        InputError: If the file is unusable, of another arm, or its meshes would be lost.
    """
    chain = urdf_row(path, tip)
    found = correction(calibration, chain, path)
    data = path.read_bytes()
    tags = start_tags(data)
    refuse_lost_files(path, out, [tag.attributes.get("filename", "") for tag in tags if tag.name == "mesh"])
    edits: list[Edit] = []
    for joint, new in zip(chain.joints, found.chain.origins, strict=True):
        place = _joint(tags, joint.name)
        edits += _moved(data, tags, place, own_origin(_origin(tags, place), joint.origin, new))
    if found.mount is not None and chain.mount is not None:
        place = _joint(tags, chain.mount)
        edits += _moved(data, tags, place, own_origin(_origin(tags, place), chain.tool, found.mount))
    return Document(edited(data, edits), found.notes)


def urdf_correction(calibration: Calibration, path: Path, tip: str | None) -> tuple[Correction, str, str]:
    """How a URDF tells of the calibrated arm, and the names of its root and tip.

    Raises:
        InputError: If the file is unusable or of another arm.
    """
    chain = urdf_row(path, tip)
    return correction(calibration, chain, path), chain.root, chain.tip


def _joint(tags: list[StartTag], name: str) -> int:
    """Place of the joint of that name which has a child; transmissions name joints too."""
    holders = {tag.parent for tag in tags if tag.name == "child"}
    return next(
        i for i, tag in enumerate(tags) if tag.name == "joint" and i in holders and tag.attributes.get("name") == name
    )


def _origin_tag(tags: list[StartTag], joint: int) -> StartTag | None:
    return next((tag for tag in tags if tag.parent == joint and tag.name == "origin"), None)


def _origin(tags: list[StartTag], joint: int) -> Pose:
    tag = _origin_tag(tags, joint)
    values = {} if tag is None else tag.attributes
    position, rpy = (xml_numbers(values.get(key, "0 0 0"), key, unit.most) for key, unit in (("xyz", M), ("rpy", RAD)))
    return Pose(position, Rotation.from_euler("xyz", rpy).as_matrix())


def _moved(data: bytes, tags: list[StartTag], joint: int, new: Pose) -> list[Edit]:
    """What gives a joint a new origin; what does not change keeps its text."""
    position, turned = is_moved(_origin(tags, joint), new)
    values = {"xyz": numbers_text(new.position)} if position else {}
    if turned:
        values["rpy"] = numbers_text(roll_pitch_yaw(np.asarray(new.rotation)))
    if not values:
        return []
    tag = _origin_tag(tags, joint)
    if tag is None:
        said = " ".join(f'{key}="{value}"' for key, value in values.items())
        return [inserted_first(data, tags[joint], f"<origin {said}/>")]
    return attribute_edits(data, tag, values)
