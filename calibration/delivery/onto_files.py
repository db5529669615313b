"""Write a calibration into a robot's own files, or into new ones: arm file, URDF, MJCF, kinematics YAML, transforms.

If the tip is the last joint's own link, the calibrated tool can lie beside that joint's axis. The tool then becomes a
new link `TIP_calibrated` that is fixed to the tip. In an MJCF it becomes a site of that name.

Written against URDF as ROS 2 has it (https://wiki.ros.org/urdf/XML, version 1.0); xacro must be expanded before.
Lengths are in metres, rpy in radians about fixed axes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Arm, Geometry, Pose, draw_plants, identity_pose, load_tolerances, plant_at, rotation_vector
from pickenv.arm.files.arm_file import UR_KEYS, UR_LINKS, ur_row
from pickenv.arm.files.joint_chain import ChainJoint, link_origins, numbers_text, xml_numbers, xml_root
from pickenv.arm.files.mjcf import ORIENTATIONS, MjcfValues, mjcf_row, mjcf_text
from pickenv.arm.files.urdf import leading_links, roll_pitch_yaw, urdf_row, urdf_text
from pickenv.arm.kinematics.geometry import behind, inverse_pose
from pickenv.base import RAD, InputError, M, command_line, one_line, register, shortened
from pickenv.calibration.delivery import corrected_chain, document
from pickenv.calibration.model.measurements import screen_unit
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.twin import twin

SKELETON = "a skeleton without meshes or true masses, from the robot's base; `onto` patches a robot's own file"

NOTE = (
    "Arm '{arm}', {which}, in its own base frame. Geometry alone: no model of links holds terms and residual. Masses "
    "and inertias are those of rods, not measured."
)
"""Template of the comment in a new MJCF."""


# The corrected arm as an arm file that `pickenv.arm.load_arm` reads, with all its digits. Parametric terms and the
# residual have no place in a geometry and are said to be left out.


@register("exporter", "toml")
def toml_document(calibration: Calibration, order: document.Order) -> document.Document:
    """Write the corrected arm as a new arm file, with the base and tool of the calibration.

    Hayati's beta (``beta_deg``) is written only for joints where it is not zero. A link that follows another joint is
    written as a joint table with ``follows`` and ``ratio``. ``order`` holds the options of the export.

    Raises:
        InputError: If a joint that turns moves only links that slide, or the other way round (a rack and its pinion).
            Also if joints are in another order than their links. Only a URDF can hold such arms.
    """
    arm, geometry = order.arm_of(calibration), calibration.identified
    leaders = _leading_tables(geometry)
    lines = [f"# {one_line(line)}" for line in document.provenance(calibration)]
    lines += _entries({"name": f"{arm.name}_calibrated", "source": f"pickenv calibration of {arm.name}; {arm.source}"})
    lines += ['convention = "modified" # Rot(x, alpha) Trans(x, a) Rot(y, beta) Rot(z, theta) Trans(z, d)']
    lines += _entries({"joint_count": geometry.links})
    for i, owner in enumerate(geometry.owners):
        slides, leader, ratio = geometry.slides[i], leaders[owner], dict(geometry.links_of(owner))[i]
        unit, scale = screen_unit(slides)
        name = geometry.joint_names[owner] if leader == i else geometry.link_names[i]
        joint: dict[str, Any] = {"number": i + 1, "name": name, "type": "P" if slides else "R"}
        joint |= {"alpha_deg": np.degrees(geometry.alpha[i]), "a_mm": geometry.a[i] * 1e3}
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
    notes = document.left_out(calibration)
    if calibration.record.get("frames") == "fitted":
        notes.append("base and tool were fitted: [base] is seen by the instrument, and [tool] is its target")
    return document.Document(("\n".join(lines) + "\n").encode(), tuple(notes))


def _leading_tables(geometry: Geometry) -> list[int]:
    """Return, for each joint, the index (from 0) of the link whose table in the file represents the joint.

    It is a link that moves exactly as the joint does. If there is none, the joint moves its links by ratios. Then it is
    the first of these links that has the joint's kind (revolute or prismatic).
    """
    leaders = []
    for joint, leader in enumerate(leading_links(geometry)):
        kind = [i for i, _ in geometry.links_of(joint) if geometry.slides[i] == geometry.prismatic[joint]]
        if not kind:
            raise InputError(f"joint '{geometry.joint_names[joint]}' moves no link of its own kind; write URDF instead")
        leaders.append(kind[0] if leader is None else leader)
    if leaders != sorted(leaders):
        raise InputError("the joints of this arm stand in another order than their links; write URDF instead")
    return leaders


def _entries(table: Mapping[str, Any]) -> list[str]:
    """Return the lines of a TOML table of texts, numbers and vectors."""
    return [f"{key} = {_toml(value)}" for key, value in table.items()]


def _toml(value: Any) -> str:
    """Return a value in TOML: a text with escapes and no control characters, a number with all digits, or a vector."""
    if isinstance(value, str):
        return '"' + one_line(value).replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, np.ndarray):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value if isinstance(value, int) else float(value))


# A URDF: attributes of joint origins change, and no other byte.


@register("exporter", "urdf")
def urdf_document(calibration: Calibration, order: document.Order) -> document.Document:
    """Write the calibrated joint origins into the robot's own URDF, or write a new URDF with rods as links.

    The rods lead from the robot's own base to the tool. If base and tool were fitted, they belong to the instrument and
    are no part of the robot. A new URDF then has the base and tool of the arm before calibration. ``order`` holds
    the options of the export.

    Raises:
        InputError: If the robot's file is unusable or of another arm, or if the new file would not find its meshes.
    """
    if order.onto is None:
        return _new_urdf(calibration, order.arm_of(calibration))
    path, tree = order.onto, calibration.arm.tree
    rows = [urdf_row(path, tip) for tip in ([order.tip] if tree is None else tree.names)]
    row, data = rows[0], path.read_bytes()
    frame, tags = f"{row.tip}_calibrated", document.start_tags(data)
    new = corrected_chain.correction(calibration, rows, path, frame)
    meshes = (tag.attributes.get("filename", "") for tag in tags if tag.name == "mesh")
    corrected_chain.refuse_lost_files(path, order.out, meshes)
    moves = [(joint.name, joint.origin, origin) for joint, origin in new.moves]
    if new.mount is not None and row.mount is not None:
        moves.append((row.mount, row.tool, new.mount))
    edits: list[document.Edit] = []
    for name, old, corrected in moves:
        joint = _joint(tags, name)
        edits += _moved(data, tags, joint, corrected_chain.own_origin(_origin(tags, joint), old, corrected))
    if new.frame is not None:
        edits += _behind_tip(data, tags, row.joints[-1].name, row.tip, frame, new.frame, path)
    return document.Document(document.edited(data, edits), new.notes)


def _new_urdf(calibration: Calibration, arm: Arm) -> document.Document:
    """Make a new URDF of the calibrated arm with rods as links; ``arm`` gives name and joint speeds."""
    declaration, _, body = urdf_text(calibration.in_own_base, f"{arm.name}_calibrated", arm.speed).partition("\n")
    words = document.xml_comment((*document.provenance(calibration), "written against URDF 1.0, as ROS 2 has it"))
    data = "\n".join([declaration, *words, body]).encode()
    return document.Document(data, (*document.left_out(calibration), SKELETON))


def _behind_tip(
    data: bytes, tags: list[document.StartTag], last: str, tip: str, frame: str, pose: Pose, path: Path
) -> list[document.Edit]:
    """Return the edits that add the calibrated tool as a link fixed to the tip, or move that link if it exists.

    Args:
        data: The file's text.
        tags: Its start tags.
        last: Name of the last joint, before which a new link is written.
        tip: Name of the tip's link.
        frame: Name of the tool's link.
        pose: Pose of the tool in the tip's frame.
        path: The file, for messages.

    Raises:
        InputError: If the file has a link of that name which is not fixed to the tip.
    """
    joint = f"{frame}_joint"
    if any(tag.is_named("link", frame) for tag in tags):
        place = next((i for i, tag in enumerate(tags) if tag.is_named("joint", joint)), -1)
        parents = [tag.attributes.get("link") for tag in tags if tag.name == "parent" and tag.parent == place]
        if parents != [tip]:
            raise InputError(f"{path} has a link '{shortened(frame)}' of its own, where the calibrated tool is written")
        return _moved(data, tags, place, pose)
    origin = f'<origin xyz="{numbers_text(pose.position)}" rpy="{_rpy(pose)}"/>'
    ends = f"<parent link={quoteattr(tip)}/><child link={quoteattr(frame)}/>"
    mount = f'<joint name={quoteattr(joint)} type="fixed">{origin}{ends}</joint>'
    return [document.inserted_before(data, tags[_joint(tags, last)], f"<link name={quoteattr(frame)}/>", mount)]


def _joint(tags: list[document.StartTag], name: str) -> int:
    """Return the index in ``tags`` of the joint with this name that has a child link, unlike transmissions' joints."""
    holders = {tag.parent for tag in tags if tag.name == "child"}
    return next(i for i, tag in enumerate(tags) if i in holders and tag.is_named("joint", name))


def _origin_tag(tags: list[document.StartTag], joint: int) -> document.StartTag | None:
    """Return the tag "origin" within the joint at index ``joint`` of ``tags``, or None."""
    return next((tag for tag in tags if tag.parent == joint and tag.name == "origin"), None)


def _origin(tags: list[document.StartTag], joint: int) -> Pose:
    """Return the pose that the file gives as the origin of a joint; the identity if it gives none.

    ``joint`` is the index in ``tags`` of the joint's tag.
    """
    tag = _origin_tag(tags, joint)
    values = {} if tag is None else tag.attributes
    position, rpy = (xml_numbers(values.get(key, "0 0 0"), key, unit.most) for key, unit in (("xyz", M), ("rpy", RAD)))
    return Pose(position, Rotation.from_euler("xyz", rpy).as_matrix())


def _rpy(pose: Pose) -> str:
    """Return a pose's orientation as the text of URDF's rpy: roll, pitch and yaw, rad."""
    return numbers_text(roll_pitch_yaw(np.asarray(pose.rotation)))


def _moved(data: bytes, tags: list[document.StartTag], joint: int, new: Pose) -> list[document.Edit]:
    """Return the edits that give a joint of a URDF a new origin; an unchanged position or attitude keeps its text.

    Args:
        data: The file's text.
        tags: Its start tags.
        joint: Index of the joint's tag in ``tags``.
        new: The new origin.
    """
    values, tag = corrected_chain.changed(_origin(tags, joint), new, "xyz", "rpy", _rpy), _origin_tag(tags, joint)
    if tag is not None or not values:
        return [] if tag is None else document.attribute_edits(data, tag, values)
    attributes = " ".join(f'{key}="{value}"' for key, value in values.items())
    return [document.inserted_first(data, tags[joint], f"<origin {attributes}/>")]


# A calibration onto a robot's own MJCF: pos and quat of the bodies that joints move change, and no other byte.
# Written against MJCF as MuJoCo 3 reads it. An orientation told otherwise (euler, axisangle, xyaxes, zaxis) becomes a
# quat in the same place. What a file includes is not changed: the bodies must stand in the file itself. Metres.


@register("exporter", "mjcf")
def mjcf_document(calibration: Calibration, order: document.Order) -> document.Document:
    """Write the calibrated poses of bodies into the robot's own MJCF, or write new MJCFs with rods as links.

    ``order`` holds the options of the export. Without the robot's own file, the identified arm is written, and beside
    it the nominal arm (``…_nominal``). With ``order.sample``, arms that are drawn from the posterior are written too
    (``…_1`` to ``…_n``).

    Raises:
        InputError: If the robot's file is unusable or of another arm. Also if its bodies are in an included file, or if
            the new file would not find its meshes.
    """
    if order.onto is None:
        return _new_mjcf(calibration, order)
    path, tree = order.onto, calibration.arm.tree
    rows = [mjcf_row(path, tip) for tip in ([order.tip] if tree is None else tree.names)]
    row, frame = rows[0], f"{rows[0].tip}_calibrated"
    new = corrected_chain.correction(calibration, rows, path, frame)
    values = MjcfValues.of(xml_root(path, "MJCF (.xml)"))
    data = path.read_bytes()
    tags = document.start_tags(data)
    corrected_chain.refuse_lost_files(path, order.out, _files(tags))
    edits: list[document.Edit] = []
    taken: set[str] = set()
    for joint, origin in new.moves:
        if not any(corrected_chain.is_moved(joint.origin, origin)):
            continue
        if joint.body in taken:
            raise InputError(
                f"{path}: joint '{shortened(joint.name)}' is the second of body '{shortened(joint.body)}', whose place "
                "cannot hold corrections of both; give each joint a body of its own"
            )
        tag, place = _named(tags, "body", joint.body, path), Pose(joint.within, np.eye(3))
        corrected = corrected_chain.own_origin(behind(values.pose(tag.attributes), place), joint.origin, origin)
        edits += _moved_body(data, tag, values, behind(corrected, inverse_pose(place)))
        taken.add(joint.body)
    if new.mount is not None and row.mount is not None:
        kind, _, name = row.mount.rpartition(" ") if row.mount.startswith("site ") else ("body", "", row.mount)
        tag = _named(tags, kind, name, path)
        mount = corrected_chain.own_origin(values.pose(tag.attributes), row.tool, new.mount)
        edits += _moved_body(data, tag, values, mount)
    if new.frame is not None:
        earlier = [tag for tag in tags if tag.is_named("site", frame)]
        if earlier:
            edits += _moved_body(data, earlier[0], values, new.frame)
        else:
            stands = f'pos="{numbers_text(new.frame.position)}" quat="{_quaternion(new.frame)}"'
            site = f"<site name={quoteattr(frame)} {stands}/>"
            edits.append(document.inserted_first(data, _named(tags, "body", row.tip, path), site))
    return document.Document(document.edited(data, edits), new.notes)


def _new_mjcf(calibration: Calibration, order: document.Order) -> document.Document:
    """Make new MJCFs with rods as links: the identified arm, the nominal arm beside it, and the arms of the sample."""
    arm = order.arm_of(calibration)
    plant = twin(calibration, arm, geometry_only=True)
    models = [("as calibrated", plant.geometry), ("nominal", arm.nominal)]
    if order.sample:
        arms = draw_plants(plant, load_tolerances("medium"), order.sample, np.random.default_rng(order.seed))
        for i in range(order.sample):
            models.append((f"one that the data allow, number {i + 1}", plant_at(arms, i).geometry))
    data, *beside = (
        mjcf_text(geometry, f"{arm.name}: {which}", NOTE.format(arm=arm.name, which=which)).encode()
        for which, geometry in models
    )
    files = mjcf_files(order.out, order.sample)[1:]  # none where the name is none, which is refused when it is written
    return document.Document(data, (*document.left_out(calibration), SKELETON), dict(zip(files, beside, strict=False)))


def mjcf_files(path: str | Path, sample: int) -> list[Path]:
    """Return the paths of new MJCFs: for the identified arm, the nominal arm, and then each arm of a sample.

    A path that names no file, such as "/" or "..", is returned unchanged as the only path.

    Args:
        path: Path of the identified arm's file; ``.xml`` is appended if it has no ending.
        sample: Number of arms in the sample.
    """
    path = Path(path)
    if path.name in ("", ".."):
        return [path]
    endings = ["", "_nominal", *(f"_{i + 1}" for i in range(sample))]
    return [path.with_name(f"{path.stem}{ending}{path.suffix or '.xml'}") for ending in endings]


def _named(tags: list[document.StartTag], kind: str, name: str, path: Path) -> document.StartTag:
    """Return the start tag of a body or site in the file itself; included files are not searched.

    Args:
        tags: The file's start tags.
        kind: Name of the tag, "body" or "site".
        name: Name of the body or site.
        path: The file, for messages.

    Raises:
        InputError: If there is no such tag; the message says whether it may be in an included file.
    """
    tag = next((tag for tag in tags if tag.is_named(kind, name)), None)
    if tag is not None:
        return tag
    if any(tag.name == "include" for tag in tags):
        raise InputError(
            f"{path}: {kind} '{shortened(name)}' stands in a file that it includes, and only {path.name} would be "
            "written; give `onto` a model in one file, as MuJoCo saves it"
        )
    raise InputError(f"{path}: {shortened(name)} has no name of its own to be found by; name every body of the arm")


def _moved_body(data: bytes, tag: document.StartTag, values: MjcfValues, new: Pose) -> list[document.Edit]:
    """Return the edits that give a body or site a new pose; an unchanged position or attitude keeps its text.

    Args:
        data: The file's text.
        tag: The tag of the body or site.
        values: Settings of the file, such as its unit of angles, which are needed to read the present pose.
        new: The new pose.
    """
    texts = corrected_chain.changed(values.pose(tag.attributes), new, "pos", "quat", _quaternion)
    orientation = next((key for key in ORIENTATIONS if key in tag.attributes), "quat")
    edits: list[document.Edit] = []
    if orientation != "quat" and "quat" in texts:
        start, _, end = document.attribute_spans(data, tag)[0][orientation]
        edits.append((start, end + 1, f'quat="{texts.pop("quat")}"'.encode()))
    return edits + document.attribute_edits(data, tag, texts)


def _quaternion(pose: Pose) -> str:
    """Return a pose's orientation as the text of MJCF's quat: w, x, y, z."""
    *xyz, w = Rotation.from_matrix(np.asarray(pose.rotation)).as_quat(canonical=True)
    return numbers_text([w, *xyz])


def _files(tags: list[document.StartTag]) -> Iterator[str]:
    """Yield the paths of the meshes and included files that a model names, relative to the model's folder."""
    compiler = dict(item for tag in tags if tag.name == "compiler" for item in tag.attributes.items())
    folder = compiler.get("meshdir", compiler.get("assetdir", ""))
    strips = compiler.get("strippath", "false") == "true"
    for tag in tags:
        name = tag.attributes.get("file", "")
        if tag.name == "mesh" and name:
            yield str(PurePosixPath(folder) / (PurePosixPath(name).name if strips else name))
        elif tag.name == "include":
            yield name


# A calibration onto the kinematics YAML that a xacro takes its joint origins from; the xacro itself needs no change.
# Written against ur_description of ROS 2 (Universal_Robots_ROS2_Description 2.x:
# config/UR_TYPE/default_kinematics.yaml): ``kinematics`` holds x, y, z, roll, pitch, yaw per link, in the chain's
# order, metres and radians, all axes on z, and a ``hash`` by which the driver knows the controller's own calibration.
# The hash is kept: it is the robot's.


LENGTHS = ("x", "y", "z")
UR_TWISTS = (0.0, math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2)
"""Values of alpha, rad, in the modified DH table of a UR whose link frames are those of ur_description."""


@register("exporter", "kinematics-yaml")
def kinematics_yaml_document(calibration: Calibration, order: document.Order) -> document.Document:
    """Write corrected origins into the robot's own kinematics YAML; the file's other lines and hash do not change.

    ``order`` holds the options of the export. Without the robot's own file, a new one is written for ur_description's
    ``kinematics_params``. This needs a UR whose DH table has the maker's link frames.

    Raises:
        InputError: If the robot's file is unusable or of another arm. Also, for a new file, if the arm's DH table does
            not have the link frames of a UR.
    """
    if order.onto is None:
        return _new_kinematics_yaml(calibration)
    path = order.onto
    row, _ = ur_row(path)
    new = corrected_chain.correction(calibration, [row], path)
    data = path.read_bytes()
    edits: list[document.Edit] = []
    for link, (joint, origin) in zip(UR_LINKS, new.moves, strict=True):
        changes = corrected_chain.is_moved(joint.origin, origin)
        values = {key: value for key, value in _ur_values(origin).items() if changes[key not in LENGTHS]}
        edits += _edits(data, link, values, path)
    return document.Document(document.edited(data, edits), (*new.notes, "the hash is the robot's own and stays"))


def _ur_values(origin: Pose) -> dict[str, float]:
    """Return the numbers of a link's origin, m and rad, by their keys in the YAML."""
    values = [*origin.position, *roll_pitch_yaw(np.asarray(origin.rotation))]
    return {key: float(value) for key, value in zip(UR_KEYS, values, strict=True)}


def _edits(data: bytes, name: str, values: dict[str, float], path: Path) -> list[document.Edit]:
    """Return the edits that give new numbers to keys of a link in a YAML text.

    The keys stand between the link's name and the next link's name.

    Args:
        data: The text.
        name: Name of the link.
        values: The new numbers by key, m or rad.
        path: The file, for messages.

    Raises:
        InputError: If the link lacks one of the keys.
    """
    if not values:
        return []
    places = {
        key: match.end()
        for key in (*UR_LINKS, "hash")
        if (match := re.search(rb"^\s+" + re.escape(key.encode()) + rb"\s*:", data, re.MULTILINE)) is not None
    }
    start = places[name]
    end = min((place for place in places.values() if place > start), default=len(data))
    edits = []
    for key, value in values.items():
        number = re.compile(rb"\b" + key.encode() + rb"\s*:\s*([-+.\w]+)").search(data, start, end)
        if number is None:
            raise InputError(f"{path}: '{shortened(name)}' has no '{key}' in its own lines; write it out there")
        edits.append((number.start(1), number.end(1), yaml_number(value).encode()))
    return edits


def yaml_number(value: float) -> str:
    """Format a number with all its digits so that YAML 1.1 reads a number; YAML 1.1 would read 1e-05 as a text."""
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _new_kinematics_yaml(calibration: Calibration) -> document.Document:
    """Make a new kinematics YAML of a UR; refuse an arm whose DH table does not have the link frames of a UR."""
    arm = calibration.arm
    plain = arm.links == len(UR_LINKS) and not any(arm.slides) and arm.coupling is None
    if not plain or not np.allclose(arm.alpha, UR_TWISTS, atol=1e-9) or np.abs(arm.a[[0, 1, 4, 5]]).max() > 1e-9:
        table = f"the table of '{calibration.arm_name}'"
        raise InputError(f"{table} has not the frames of a UR; give `onto`, the default_kinematics.yaml of your UR")
    lines = [f"# {one_line(line)}" for line in document.provenance(calibration)]
    lines += ["# for ur_description of ROS 2, 2.x; the hash is not the controller's, so ur_robot_driver will say so"]
    lines += ["kinematics:"]
    based = replace(arm, base=identity_pose())
    drawing = zip(UR_LINKS, link_origins(based), strict=True)
    joints = [ChainJoint(link, link, 1.0, 0.0, False, pose, corrected_chain.Z) for link, pose in drawing]
    alike = identity_pose(), np.ones(len(UR_LINKS)), np.zeros(len(UR_LINKS))
    robot = calibration.in_own_base
    robot = replace(robot, base=behind(inverse_pose(arm.base), robot.base))
    for joint, origin in corrected_chain.corrected_origins(based, robot, [joints], alike)[0]:
        lines.append(f"  {joint.name}:")
        lines += [f"    {key}: {yaml_number(value)}" for key, value in _ur_values(origin).items()]
    lines.append(f"  hash: calib_pickenv_{calibration.arm_fingerprint}")
    notes = (
        "the links' origins; a tool and where the instrument stood are no part of this file",
        "the hash is not the controller's: with `onto`, your robot's own file, it is kept",
    )
    return document.Document(("\n".join(lines) + "\n").encode(), notes)


# Where the instrument stands and what it aims at, as ROS 2's ``static_transform_publisher`` lines. Written against
# tf2_ros of ROS 2 Humble and later (``--x`` to ``--qw``, ``--frame-id``, ``--child-frame-id``); metres and
# quaternions. The measurement's frame (tracker, camera or board) is published as a child of the robot's base, as the
# base is the root of a robot's tree.


@register("exporter", "transforms")
def static_transforms(calibration: Calibration, order: document.Order) -> document.Document:
    """Write a shell script that publishes two transforms in ROS 2: the measurement's frame and the calibrated tool.

    The measurement's frame is relative to the root of the robot's own URDF, the tool to the URDF's tip. Without a URDF,
    the two are relative to the arm's base and tool frames, which are then named base_link and tool0. ``order`` holds
    the options of the export.

    Raises:
        InputError: If the URDF is unusable, of another arm or without named frames, or if ROS does not allow a name.
    """
    path, names = order.onto, ("base_link", "tool0")
    measured = behind(calibration.arm.base, inverse_pose(calibration.identified.base))
    hand = behind(inverse_pose(calibration.arm.tool), calibration.identified.tool)
    if path is not None:
        if path.suffix.lower() != ".urdf":
            raise InputError(f"{path} has no named frames; give `onto` the robot's URDF, or leave it out")
        row = urdf_row(path, order.tip)
        robot = corrected_chain.correction(calibration, [row], path)
        names, measured, hand = (row.root, row.tip), behind(robot.root, measured), robot.hand
    for name in names:
        if not re.fullmatch(r"[\w./-]+", name):
            raise InputError(f"'{one_line(name)}' is no name of a ROS frame; use letters, digits, '_' and '/'")
    root, last = names
    lines = ["#!/bin/sh", *(f"# {one_line(line)}" for line in document.provenance(calibration))]
    lines += [
        "# for tf2_ros of ROS 2 Humble and later; metres and quaternions",
        f"# measurement_frame: what the measurements are told in (tracker, camera or board), seen from {root}",
        _line(measured, root, "measurement_frame") + " &",
        f"# calibrated_tool: what was measured at the arm's end, seen from {last}",
        _line(hand, last, "calibrated_tool"),
    ]
    note = "base and tool were taken as known, so both lines say what the calibration was told"
    if calibration.record.get("frames") == "fitted":
        note = f"measurement_frame is where {root} stands for the instrument, if the first joint stands in it as drawn"
    return document.Document(("\n".join(lines) + "\n").encode(), (note,))


def _line(pose: Pose, frame: str, child: str) -> str:
    """Return the shell command that publishes in ROS 2 the pose of frame ``child`` relative to ``frame``."""
    numbers = np.concatenate([pose.position, Rotation.from_matrix(np.asarray(pose.rotation)).as_quat()]).tolist()
    values = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), numbers, strict=True))
    program = ("ros2", "run", "tf2_ros", "static_transform_publisher")
    return command_line(*program, **values, frame_id=frame, child_frame_id=child)
