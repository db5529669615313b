"""A calibration onto a robot's own URDF: attributes of joint origins change, and no other byte.

Where the tip is the last joint's own link and the calibrated tool lies beside that joint's axis, the tool is a new link
`TIP_calibrated` fixed to the tip; in an MJCF a site of that name.

Written against URDF as ROS 2 has it (https://wiki.ros.org/urdf/XML, version 1.0); xacro is expanded first. Lengths in
metres, rpy in radians about fixed axes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Arm, Geometry, Pose, draw_plants, identity_pose, load_tolerances, plant_at, rotation_vector
from pickenv.arm.files.arm_file import UR_KEYS, UR_LINKS, ur_row
from pickenv.arm.files.joint_chain import ChainJoint, link_origins
from pickenv.arm.files.mjcf import ORIENTATIONS, MjcfValues, mjcf_row, truth, write_mjcf
from pickenv.arm.files.urdf import leading_links, roll_pitch_yaw, urdf_row, urdf_text
from pickenv.arm.files.xml_values import numbers_text, xml_numbers, xml_root
from pickenv.arm.kinematics.geometry import behind, inverse_pose
from pickenv.base import RAD, InputError, M, one_line, shortened, write_text
from pickenv.calibration.delivery.corrected_chain import (
    Document,
    Edit,
    SameChain,
    StartTag,
    Z,
    attribute_edits,
    attribute_spans,
    corrected_chain,
    correction,
    edited,
    inserted_before,
    inserted_first,
    is_moved,
    own_origin,
    provenance,
    refuse_lost_files,
    start_tags,
)
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.twin import twin


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
    frame = f"{chain.tip}_calibrated"
    found = correction(calibration, chain, path, frame)
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
    if found.frame is not None:
        edits += _behind_tip(data, tags, chain.joints[-1].name, chain.tip, frame, found.frame, path)
    return Document(edited(data, edits), found.notes)


def _behind_tip(
    data: bytes, tags: list[StartTag], last: str, tip: str, frame: str, pose: Pose, path: Path
) -> list[Edit]:
    """A link that is fixed to the tip, before the tip's own joint; one that an earlier calibration wrote is moved."""
    joint = f"{frame}_joint"
    if any(tag.name == "link" and tag.attributes.get("name") == frame for tag in tags):
        place = next(
            (i for i, tag in enumerate(tags) if tag.name == "joint" and tag.attributes.get("name") == joint), -1
        )
        parents = [tag.attributes.get("link") for tag in tags if tag.name == "parent" and tag.parent == place]
        if parents != [tip]:
            raise InputError(f"{path} has a link '{shortened(frame)}' of its own, where the calibrated tool is written")
        return _moved(data, tags, place, pose)
    origin = (
        f'<origin xyz="{numbers_text(pose.position)}" rpy="{numbers_text(roll_pitch_yaw(np.asarray(pose.rotation)))}"/>'
    )
    ends = f"<parent link={quoteattr(tip)}/><child link={quoteattr(frame)}/>"
    elements = (
        f"<link name={quoteattr(frame)}/>",
        f'<joint name={quoteattr(joint)} type="fixed">{origin}{ends}</joint>',
    )
    return [inserted_before(data, tags[_joint(tags, last)], *elements)]


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


# A calibration onto a robot's own MJCF: pos and quat of the bodies that joints move change, and no other byte.
# Written against MJCF as MuJoCo 3 reads it. An orientation told otherwise (euler, axisangle, xyaxes, zaxis) becomes a
# quat in the same place. What a file includes is not changed: the bodies must stand in the file itself. Metres.


def onto_mjcf(calibration: Calibration, path: Path, tip: str | None, out: Path) -> Document:
    """The text of an MJCF with its bodies where the calibration found them.

    Args:
        calibration: Of the same arm, whatever frames its table has.
        path: The file.
        tip: Last body or site; the flange when left out.
        out: Where it will be written, from where its meshes must be found.

    Raises:
        InputError: If the file is unusable, of another arm, its bodies stand elsewhere, or its meshes would be lost.
    """
    row = mjcf_row(path, tip)
    frame = f"{row.tip}_calibrated"
    found = correction(calibration, row, path, frame)
    values = MjcfValues.of(xml_root(path, "MJCF (.xml)"))
    data = path.read_bytes()
    tags = start_tags(data)
    refuse_lost_files(path, out, _files(tags))
    edits: list[Edit] = []
    taken: set[str] = set()
    for joint, new in zip(row.joints, found.chain.origins, strict=True):
        if not any(is_moved(joint.origin, new)):
            continue
        if joint.body in taken:
            raise InputError(
                f"{path}: joint '{shortened(joint.name)}' is the second of body '{shortened(joint.body)}', whose place "
                "cannot hold corrections of both; give each joint a body of its own"
            )
        tag, place = _named(tags, "body", joint.body, path), Pose(joint.within, np.eye(3))
        corrected = own_origin(behind(values.pose(tag.attributes), place), joint.origin, new)
        edits += _moved_body(data, tag, values, behind(corrected, inverse_pose(place)))
        taken.add(joint.body)
    if found.mount is not None and row.mount is not None:
        kind, _, name = row.mount.rpartition(" ") if row.mount.startswith("site ") else ("body", "", row.mount)
        tag = _named(tags, kind, name, path)
        edits += _moved_body(data, tag, values, own_origin(values.pose(tag.attributes), row.tool, found.mount))
    if found.frame is not None:
        earlier = [tag for tag in tags if tag.name == "site" and tag.attributes.get("name") == frame]
        if earlier:
            edits += _moved_body(data, earlier[0], values, found.frame)
        else:
            stands = f'pos="{numbers_text(found.frame.position)}" quat="{_quaternion(found.frame)}"'
            site = f"<site name={quoteattr(frame)} {stands}/>"
            edits.append(inserted_first(data, _named(tags, "body", row.tip, path), site))
    return Document(edited(data, edits), found.notes)


def _named(tags: list[StartTag], kind: str, name: str, path: Path) -> StartTag:
    """The body or site of that name in the file itself."""
    found = [tag for tag in tags if tag.name == kind and tag.attributes.get("name") == name]
    if found:
        return found[0]
    if any(tag.name == "include" for tag in tags):
        raise InputError(
            f"{path}: {kind} '{shortened(name)}' stands in a file that it includes, and only {path.name} would be "
            "written; give --onto a model in one file, as MuJoCo saves it"
        )
    raise InputError(f"{path}: {shortened(name)} has no name of its own to be found by; name every body of the arm")


def _moved_body(data: bytes, tag: StartTag, values: MjcfValues, new: Pose) -> list[Edit]:
    """What gives a body a new place; what does not change keeps its text."""
    position, turned = is_moved(values.pose(tag.attributes), new)
    written = {"pos": numbers_text(new.position)} if position else {}
    told = next((key for key in ORIENTATIONS if key in tag.attributes), "quat")
    edits: list[Edit] = []
    if turned:
        quat = _quaternion(new)
        if told == "quat":
            written["quat"] = quat
        else:
            start, _, end = attribute_spans(data, tag)[0][told]
            edits.append(Edit(start, end + 1, f'quat="{quat}"'.encode()))
    return edits + attribute_edits(data, tag, written)


def _quaternion(pose: Pose) -> str:
    """An orientation as MJCF's quat."""
    *xyz, w = Rotation.from_matrix(np.asarray(pose.rotation)).as_quat(canonical=True)
    return numbers_text([w, *xyz])


def _files(tags: list[StartTag]) -> list[str]:
    """Meshes and included files that a model names, from its own folder."""
    compiler: dict[str, str] = {}
    for tag in tags:
        if tag.name == "compiler":
            compiler |= tag.attributes
    folder = compiler.get("meshdir", compiler.get("assetdir", ""))
    strips = truth(compiler.get("strippath", "false"))
    found = []
    for tag in tags:
        name = tag.attributes.get("file", "")
        if tag.name == "mesh" and name:
            found.append(str(PurePosixPath(folder) / (PurePosixPath(name).name if strips else name)))
        elif tag.name == "include":
            found.append(name)
    return found


# A calibration onto the kinematics YAML that a xacro takes its joint origins from; the xacro itself needs no change.
# Written against ur_description of ROS 2 (Universal_Robots_ROS2_Description 2.x:
# config/UR_TYPE/default_kinematics.yaml): ``kinematics`` holds x, y, z, roll, pitch, yaw per link, in the chain's
# order, metres and radians, all axes on z, and a ``hash`` by which the driver knows the controller's own calibration.
# The hash is kept: it is the robot's.


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


# Where the instrument stands and what it aims at, as ROS 2's ``static_transform_publisher`` lines. Written against
# tf2_ros of ROS 2 Humble and later (``--x`` to ``--qw``, ``--frame-id``, ``--child-frame-id``); metres and
# quaternions. The measurement's frame (tracker, camera or board) is published as a child of the robot's base, as the
# base is the root of a robot's tree.


def static_transforms(calibration: Calibration, path: Path | None = None, tip: str | None = None) -> Document:
    """A shell script with a line for the measurement's frame and one for the calibrated tool.

    Args:
        calibration: The calibration.
        path: The robot's own URDF, whose frames are named; without it they are those of the arm's table.
        tip: Its last link, in which the tool is told; the flange when left out.

    Raises:
        InputError: If the file is unusable, of another arm or has no named frames, or a name is none for ROS.
    """
    own, names = calibration.arm, ("base_link", "tool0")
    measured = behind(own.base, inverse_pose(calibration.identified.base))
    hand = behind(inverse_pose(own.tool), calibration.identified.tool)
    if path is not None:
        if path.suffix.lower() != ".urdf":
            raise InputError(f"{path} has no named frames; give --onto the robot's URDF, or leave it out")
        row = urdf_row(path, tip)
        robot = correction(calibration, row, path)
        names = (row.root, row.tip)
        measured, hand = behind(robot.same.root, measured), robot.chain.hand
    for name in names:
        if not re.fullmatch(r"[\w./-]+", name):
            raise InputError(f"'{one_line(name)}' is no name of a ROS frame; use letters, digits, '_' and '/'")
    root, last = names
    lines = ["#!/bin/sh", *(f"# {one_line(line)}" for line in provenance(calibration))]
    lines += [
        "# for tf2_ros of ROS 2 Humble and later; metres and quaternions",
        f"# measurement_frame: what the measurements are told in (tracker, camera or board), seen from {root}",
        _line(measured, root, "measurement_frame") + " &",
        f"# calibrated_tool: what was measured at the arm's end, seen from {last}",
        _line(hand, last, "calibrated_tool"),
    ]
    known = calibration.record.get("frames") != "fitted"
    said = (
        "base and tool were taken as known, so both lines say what the calibration was told"
        if known
        else (f"measurement_frame is where {root} stands for the instrument, if the first joint stands in it as drawn")
    )
    return Document(("\n".join(lines) + "\n").encode(), (said,))


def _line(pose: Pose, frame: str, child: str) -> str:
    turn = Rotation.from_matrix(np.asarray(pose.rotation)).as_quat()
    values = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), [*pose.position, *turn], strict=True))
    numbers = " ".join(f"--{name} {float(value)!r}" for name, value in values.items())
    return f"ros2 run tf2_ros static_transform_publisher {numbers} --frame-id {frame} --child-frame-id {child}"


# The corrected arm as a URDF of its own, for arms that have none: rods from the robot's base to the tool. Written
# against URDF as ROS 2 has it (version 1.0). A robot's own URDF is patched instead (`onto_urdf`).


def write_arm_urdf(calibration: Calibration, arm: Arm, path: str | Path) -> Path:
    """Write the corrected arm from the robot's own base to its tool, with where it comes from.

    Frames that were fitted are the instrument's and no part of the robot: base and tool are then the arm's own.
    """
    own = calibration.arm
    tool = own.tool if calibration.record.get("frames") == "fitted" else calibration.identified.tool
    placed = replace(calibration.in_own_base, tool=tool)
    text = urdf_text(placed, f"{arm.name}_calibrated", arm.speed)
    declaration, _, rest = text.partition("\n")
    words = (*provenance(calibration), "written against URDF 1.0, as ROS 2 has it")
    comment = "\n".join(one_line(line).replace("--", "- -") for line in words)
    return write_text(path, f"{declaration}\n<!--\n{comment}\n-->\n{rest}")


# A calibrated arm for MuJoCo: as the controller has it, as it was found, and arms that the data allow.


NOTE = (
    "Arm '{arm}', {which}, in its own base frame. Geometry alone: no model of links holds terms and residual. Masses "
    "and inertias are those of rods, not measured."
)


def export_mjcf(
    calibration: Calibration, arm: Arm, path: str | Path, *, sample: int = 0, seed: int = 0, tolerances: str = "medium"
) -> list[Path]:
    """Write ``path`` (identified), and beside it ``…_nominal`` and ``…_1`` to ``…_n``, arms that the data allow.

    Returns:
        The files written, the identified arm's first.

    Raises:
        InputError: If it is another arm's calibration, or a file cannot be written.
    """
    plant = twin(calibration, arm, geometry_only=True)
    models = [("as calibrated", plant.geometry), ("nominal", arm.nominal)]
    if sample:
        arms = draw_plants(plant, load_tolerances(tolerances), sample, np.random.default_rng(seed))
        models += [(f"one that the data allow, number {i + 1}", plant_at(arms, i).geometry) for i in range(sample)]
    return [
        write_mjcf(geometry, place, f"{arm.name}: {which}", NOTE.format(arm=arm.name, which=which))
        for place, (which, geometry) in zip(mjcf_files(path, sample), models, strict=True)
    ]


def mjcf_files(path: str | Path, sample: int) -> list[Path]:
    """The files that `export_mjcf` writes; "/" or "..", which name none, as they are."""
    path = Path(path)
    if path.name in ("", ".."):
        return [path]
    endings = ["", "_nominal", *(f"_{i + 1}" for i in range(sample))]
    return [path.with_name(f"{path.stem}{ending}{path.suffix or '.xml'}") for ending in endings]


# The corrected arm as an arm file that `pickenv.arm.load_arm` reads, with all its digits. Parametric terms and the
# residual have no place in a geometry and are said to be left out.


def arm_toml(calibration: Calibration, arm: Arm) -> str:
    """The corrected arm as the text of an arm file; base and tool are those of the calibration.

    Hayati's beta is written (``beta_deg``) only for joints that have one. Links that follow another joint are joint
    tables with ``follows`` and ``ratio``.

    Raises:
        InputError: If a joint moves no link of its own kind (a rack and its pinion): only URDF has joints without one.
    """
    geometry = calibration.identified
    leaders = _leading_tables(geometry)
    lines = [f"# {one_line(line)}" for line in provenance(calibration)]
    lines += _entries({"name": f"{arm.name}_calibrated", "source": f"pickenv calibration of {arm.name}; {arm.source}"})
    lines += ['convention = "modified" # Rot(x, alpha) Trans(x, a) Rot(y, beta) Rot(z, theta) Trans(z, d)']
    lines += _entries({"joint_count": geometry.links})
    for i, owner in enumerate(geometry.owners):
        slides, leader, ratio = geometry.slides[i], leaders[owner], dict(geometry.links_of(owner))[i]
        unit, scale = ("mm", 1e3) if slides else ("deg", float(np.degrees(1.0)))
        joint: dict[str, Any] = {
            "number": i + 1,
            "name": geometry.joint_names[owner] if leader == i else geometry.link_names[i],
            "type": "P" if slides else "R",
            "alpha_deg": np.degrees(geometry.alpha[i]),
            "a_mm": geometry.a[i] * 1e3,
        }
        if geometry.beta[i]:
            joint["beta_deg"] = np.degrees(geometry.beta[i])
        joint |= {"theta_deg": np.degrees(geometry.theta[i]), "d_mm": geometry.d[i] * 1e3}
        if ratio != 1.0:
            joint["ratio"] = ratio
        if leader != i:
            joint["follows"] = leader + 1
        else:
            limits = {"lower": geometry.lower[owner], "upper": geometry.upper[owner]}
            joint |= {f"{key}_{unit}": value * scale for key, value in limits.items()}
            joint[f"speed_{unit}_per_s"] = arm.speed[owner] * scale
        lines += ["", "[[joints]]", *_entries(joint)]
    for key, pose in (("base", geometry.base), ("tool", geometry.tool)):
        vector = np.degrees(rotation_vector(pose.rotation))
        lines += ["", f"[{key}]", *_entries({"position_mm": pose.position * 1e3, "rotation_vector_deg": vector})]
    return "\n".join(lines) + "\n"


def _leading_tables(geometry: Geometry) -> list[int]:
    """For each joint, the link whose table is the joint's own: one that moves just as it does, or else by a ratio."""
    leaders = []
    for joint, found in enumerate(leading_links(geometry)):
        kind = [i for i, _ in geometry.links_of(joint) if geometry.slides[i] == geometry.prismatic[joint]]
        if not kind:
            raise InputError(f"joint '{geometry.joint_names[joint]}' moves no link of its own kind; write URDF instead")
        leaders.append(kind[0] if found is None else found)
    if leaders != sorted(leaders):
        raise InputError("the joints of this arm stand in another order than their links; write URDF instead")
    return leaders


def write_arm_toml(calibration: Calibration, arm: Arm, path: str | Path) -> Path:
    """Write `arm_toml`, whole or not at all."""
    return write_text(path, arm_toml(calibration, arm))


def _entries(table: Mapping[str, Any]) -> list[str]:
    """Lines of a TOML table of texts, numbers and vectors."""
    return [f"{key} = {_toml(value)}" for key, value in table.items()]


def _toml(value: Any) -> str:
    """A text, which has JSON's escapes and no control characters, a number with all its digits, or a vector."""
    if isinstance(value, str):
        return '"' + one_line(value).replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, np.ndarray):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value if isinstance(value, int) else float(value))
