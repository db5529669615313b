"""URDF in and out: any serial chain of revolute, continuous, prismatic and fixed joints becomes a `Geometry` and back.

Lengths in metres and angles in radians, as URDF has them; rpy is rotation about fixed x, y, z axes.
"""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.arm_file import Arm
from pickenv.arm.axes import geometry_from_axes
from pickenv.arm.geometry import Array, Geometry, Pose
from pickenv.errors import InputError
from pickenv.files import write_text

MOVING = {"revolute": False, "continuous": False, "prismatic": True}
ROD_RADIUS, SHORTEST_ROD = 0.015, 0.02
"""m; of the rods that viewers draw for the links. Kinematics do not look at them."""


def load_urdf(path: str | Path, tip: str | None = None, base: str | None = None) -> Arm:
    """Read the chain from link ``base`` to link ``tip`` of a URDF file.

    Args:
        path: The file.
        tip: Last link, whose frame is the tool; the deepest link when left out.
        base: First link, whose frame is the world; the root when left out.

    Raises:
        InputError: If the file, a link or a joint is unusable; the message names it.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"URDF file {path} does not exist; give a path to a .urdf file")
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InputError(f"{path} is not valid XML: {error}") from error
    joints = [joint for joint in root.iter("joint") if joint.find("child") is not None]
    parent_joint = {_link(joint, "child"): joint for joint in joints}
    tip = tip or _deepest(parent_joint)
    chain: list[ElementTree.Element] = []
    link = tip
    while link in parent_joint and link != base:
        chain.insert(0, parent_joint[link])
        link = _link(parent_joint[link], "parent")
    if not chain or (base is not None and link != base):
        raise InputError(
            f"{path}: no chain of joints leads from link '{base or 'root'}' to link '{tip}'; name existing links"
        )
    rotation, position = np.eye(3), np.zeros(3)
    names, prismatic, points, directions, lower, upper, speed = [], [], [], [], [], [], []
    for joint in chain:
        origin = joint.find("origin")
        shift = _numbers(origin, "xyz", path)
        position = position + rotation @ shift
        rotation = rotation @ Rotation.from_euler("xyz", _numbers(origin, "rpy", path)).as_matrix()
        kind = str(joint.get("type"))
        if kind == "fixed":
            continue
        if kind not in MOVING:
            raise InputError(
                f"{path}: joint '{joint.get('name')}' has type '{kind}'; only serial R and P chains are supported"
            )
        axis = joint.find("axis")
        direction = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis, "xyz", path)
        names.append(str(joint.get("name")))
        prismatic.append(MOVING[kind])
        points.append(position)
        directions.append(rotation @ direction)
        limit = joint.find("limit")
        attributes = {} if limit is None or kind == "continuous" else limit.attrib
        numbers = {"lower": -np.pi, "upper": np.pi, "velocity": 1.0}
        for key in numbers.keys() & attributes.keys():
            numbers[key] = _number(attributes[key], f"{key} limit of joint '{joint.get('name')}'", path)
        lower.append(numbers["lower"])
        upper.append(numbers["upper"])
        speed.append(numbers["velocity"])
    if not names:
        raise InputError(f"{path}: the chain to link '{tip}' has no moving joint")
    tool = Pose(position, rotation)
    geometry = geometry_from_axes(
        tuple(names), tuple(prismatic), np.array(points), np.array(directions), tool, lower, upper
    )
    return Arm(str(root.get("name", path.stem)), f"URDF {path.name}, tip {tip}", geometry, None, np.array(speed))


def _link(joint: ElementTree.Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else str(element.get("link"))


def _deepest(parent_joint: dict[str, ElementTree.Element]) -> str:
    def depth(link: str) -> int:
        count = 0
        while link in parent_joint:
            link, count = _link(parent_joint[link], "parent"), count + 1
        return count

    return max(parent_joint, key=depth, default="")


def _numbers(element: ElementTree.Element | None, key: str, path: Path) -> Array:
    text = "0 0 0" if element is None else element.get(key, "0 0 0")
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.array([])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(f"{path}: '{text}' is not three numbers ({key})")
    return values


def _number(text: str, owner: str, path: Path) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{path}: the {owner} is '{text}'; give a finite number")
    return value


def urdf_text(geometry: Geometry, name: str, speed: Array | None = None) -> str:
    """A URDF of the chain, one link per joint, ``base`` to ``tool``; exact, so forward kinematics agree to rounding.

    Each link is drawn as a rod to the next joint, and a slide as a rod back to where it starts.
    """
    robot = ElementTree.Element("robot", name=name)
    body = ElementTree.SubElement(robot, "link", name="base")
    parent, pending = "base", geometry.base
    for i in range(geometry.joints):
        twist = Rotation.from_euler("x", geometry.alpha[i])
        turn = twist * Rotation.from_euler("y", geometry.beta[i]) * Rotation.from_euler("z", geometry.theta[i])
        # Before the joint's own motion about or along z: Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d).
        local = Pose(
            np.array([geometry.a[i], 0.0, 0.0]) + turn.as_matrix() @ np.array([0.0, 0.0, geometry.d[i]]),
            turn.as_matrix(),
        )
        origin = Pose(pending.position + pending.rotation @ local.position, pending.rotation @ local.rotation)
        link = f"link{i + 1}"
        _rod(body, origin.position)
        body = ElementTree.SubElement(robot, "link", name=link)
        if geometry.prismatic[i]:
            _rod(body, np.array([0.0, 0.0, -geometry.upper[i]]))
        kind = "prismatic" if geometry.prismatic[i] else "revolute"
        joint = _joint(robot, geometry.joint_names[i], kind, parent, link, origin)
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
        ElementTree.SubElement(
            joint,
            "limit",
            lower=repr(float(geometry.lower[i])),
            upper=repr(float(geometry.upper[i])),
            velocity=repr(float(speed[i])) if speed is not None else "1.0",
            effort="0",
        )
        parent, pending = link, Pose(np.zeros(3), np.eye(3))
    _rod(body, geometry.tool.position)
    ElementTree.SubElement(robot, "link", name="tool")
    _joint(robot, "tool_mount", "fixed", parent, "tool", geometry.tool)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, origin: Pose
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    with warnings.catch_warnings():  # at pitch 90 deg roll is set to zero, which is as good an answer as any
        warnings.filterwarnings("ignore", message="Gimbal lock")
        rpy = Rotation.from_matrix(origin.rotation).as_euler("xyz")
    xyz = " ".join(repr(float(v)) for v in origin.position)
    ElementTree.SubElement(joint, "origin", xyz=xyz, rpy=" ".join(repr(float(v)) for v in rpy))
    return joint


def _rod(link: ElementTree.Element, end: Array) -> None:
    """Draw a link as a rod from its origin to ``end``, m."""
    length = float(np.linalg.norm(end))
    if length < SHORTEST_ROD:
        return
    pitch, yaw = np.arccos(end[2] / length), np.arctan2(end[1], end[0])
    visual = ElementTree.SubElement(link, "visual")
    middle = " ".join(repr(float(v)) for v in end / 2.0)
    ElementTree.SubElement(visual, "origin", xyz=middle, rpy=f"0 {float(pitch)!r} {float(yaw)!r}")
    shape = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(shape, "cylinder", length=repr(length), radius=repr(ROD_RADIUS))


def write_urdf(geometry: Geometry, path: str | Path, name: str = "arm", speed: Array | None = None) -> Path:
    """Write `urdf_text` to a file, whole or not at all."""
    return write_text(path, urdf_text(geometry, name, speed))
