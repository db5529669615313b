"""Read and write URDF. Any chain of revolute, continuous, prismatic and fixed joints can be read as a `Geometry`.

A joint that mimics another does not count as a joint of the arm; the mimicked joint moves the links of both. By default
the tip is the flange (`pickenv.arm.files.joint_chain.flange`), and the arm's source says so.

Lengths in metres and angles in radians, as URDF has them; rpy is rotation about fixed x, y, z axes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.arm import MOST_RATIO, Arm
from pickenv.arm.files.joint_chain import (
    Carried,
    ChainJoint,
    Drive,
    Element,
    JointRow,
    Mass,
    arm_of,
    driver_of,
    flange,
    link_origins,
    numbers_text,
    unit_vector,
    xml_mass,
    xml_number,
    xml_numbers,
    xml_root,
)
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose, behind, identity_pose
from pickenv.base import M_PER_S, RAD, RAD_PER_S, InputError, M, in_file, one_line, register, shortened, write_text

# URDF out: a chain as rods from joint to joint, exact, so that forward kinematics agree to rounding. Lengths in
# metres and angles in radians, as URDF has them; rpy is rotation about fixed x, y, z axes.


ROD_RADIUS, SHORTEST_ROD = 0.015, 0.02
"""Radius and least length, m, of the rods that viewers draw for the links; kinematics do not use them."""

MASS, INERTIA, EFFORT = 0.1, 1e-4, 100.0
"""Mass, inertia and largest effort, in SI units, of every moving link and joint. They are placeholders, because
simulators refuse a link without mass and a joint without effort."""


def urdf_text(geometry: Geometry, name: str, speed: Array | None = None) -> str:
    """Return the URDF of an arm as text: a chain from link ``base`` to link ``tool`` with one joint per link.

    The URDF's forward kinematics agree with the geometry's to rounding. Each link is drawn as a rod to the next joint,
    and a slide as a rod back to its start. If a joint moves several links, the first link with ratio 1 and the joint's
    type gets the joint itself, and the others mimic it. If there is no such link, the joint moves a link of its own
    beside the chain, and all links mimic it. Characters that XML cannot hold are left out of names.

    Args:
        geometry: The arm.
        name: Name of the robot.
        speed: Largest joint speeds ``(n,)``, rad/s or m/s; 1 by default.
    """
    robot = Element("robot", name=one_line(name))
    body = ElementTree.SubElement(robot, "link", name="base")
    parent = "base"
    speeds = np.ones(geometry.joints) if speed is None else speed
    leaders, titles = leading_links(geometry), [one_line(title) for title in geometry.joint_names]
    links = zip(geometry.owners, geometry.ratios, geometry.slides, link_origins(geometry), strict=True)
    for i, (owner, ratio, slides, origin) in enumerate(links):
        link = f"link{i + 1}"
        _rod(body, origin.position)
        body = _moving_link(robot, link)
        ends = sorted((ratio * float(geometry.lower[owner]), ratio * float(geometry.upper[owner])))
        if slides:
            _rod(body, np.array([0.0, 0.0, -ends[1]]))
        title = titles[owner] if leaders[owner] == i else one_line(geometry.link_names[i])
        if leaders[owner] != i and title == titles[owner]:
            title += " (follows)"
        joint = _joint(robot, title, slides, parent, link, origin, (*ends, abs(ratio) * speeds[owner]))
        if leaders[owner] != i:
            ElementTree.SubElement(joint, "mimic", joint=titles[owner], multiplier=repr(ratio), offset="0.0")
        parent = link
    for owner, leader in enumerate(leaders):
        if leader is None:  # what is commanded moves no link as it moves itself: a drive of its own, beside the chain
            drive = f"drive{owner + 1}"
            _moving_link(robot, drive)
            most = (geometry.lower[owner], geometry.upper[owner], speeds[owner])
            _joint(robot, titles[owner], geometry.prismatic[owner], "base", drive, identity_pose(), most)
    _rod(body, geometry.tool.position)
    ElementTree.SubElement(robot, "link", name="tool")
    _joint(robot, "tool_mount", None, parent, "tool", geometry.tool)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def leading_links(geometry: Geometry) -> list[int | None]:
    """Return for each joint the index of the first link with ratio 1 and the joint's type; None if there is none."""
    return [
        next((i for i, ratio in geometry.links_of(joint) if ratio == 1.0 and geometry.slides[i] == slides), None)
        for joint, slides in enumerate(geometry.prismatic)
    ]


def _moving_link(robot: Element, name: str) -> Element:
    link = ElementTree.SubElement(robot, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "mass", value=repr(MASS))
    moments = {"ixx": INERTIA, "ixy": 0.0, "ixz": 0.0, "iyy": INERTIA, "iyz": 0.0, "izz": INERTIA}
    ElementTree.SubElement(inertial, "inertia", {axes: repr(moment) for axes, moment in moments.items()})
    return link


def _joint(
    robot: Element, name: str, slides: bool | None, parent: str, child: str, origin: Pose, limits: Sequence[float] = ()
) -> Element:
    """Add a joint to a robot, and return the joint's element. The joint's axis is z of the joint's own frame.

    Args:
        robot: The robot's element.
        name: Name of the joint.
        slides: Whether the joint slides (else it turns); None for a fixed joint.
        parent: Name of the parent link.
        child: Name of the child link.
        origin: Pose of the joint's frame in the parent link's frame.
        limits: Lower limit, upper limit and speed, rad and rad/s or m and m/s; empty for a fixed joint.
    """
    kind = "fixed" if slides is None else "prismatic" if slides else "revolute"
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    rpy = roll_pitch_yaw(origin.rotation)
    ElementTree.SubElement(joint, "origin", xyz=numbers_text(origin.position), rpy=numbers_text(rpy))
    if slides is not None:
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
        ends = dict(zip(("lower", "upper", "velocity"), map(numbers_text, limits), strict=True))
        ElementTree.SubElement(joint, "limit", {**ends, "effort": repr(EFFORT)})
    return joint


def roll_pitch_yaw(rotation: Array) -> Array:
    """Return the angles roll, pitch, yaw (3,), rad, of a matrix R = Rz(yaw) Ry(pitch) Rx(roll); exact at any pitch."""
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    sine, cosine = np.sin(roll), np.cos(roll)
    # With the roll taken off what remains is Rz Ry, whose second column is (-sin yaw, cos yaw, 0).
    yaw = np.arctan2(sine * rotation[0, 2] - cosine * rotation[0, 1], cosine * rotation[1, 1] - sine * rotation[1, 2])
    return np.array([roll, pitch, yaw])


def _rod(link: Element, end: Array) -> None:
    """Draw a link as a rod from its origin to ``end``, in the link's frame, m."""
    if (length := float(np.linalg.norm(end))) < SHORTEST_ROD:
        return
    tilt = np.arccos(end[2] / length), np.arctan2(end[1], end[0])
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=numbers_text(end / 2.0), rpy=f"0 {numbers_text(tilt)}")
    shape = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(shape, "cylinder", length=repr(length), radius=repr(ROD_RADIUS))


def write_urdf(geometry: Geometry, path: str | Path, name: str = "arm", speed: Array | None = None) -> Path:
    """Write `urdf_text` to a file and return its path; if this fails, no incomplete file is left.

    Args:
        geometry: The arm.
        path: The file to write.
        name: Name of the robot.
        speed: Largest joint speeds ``(n,)``, rad/s or m/s; 1 by default.
    """
    return write_text(path, urdf_text(geometry, name, speed))


MOVING = {"revolute": False, "continuous": False, "prismatic": True}


@register("arm_format", "urdf")
def load_urdf(path: str | Path, tip: str | None = None) -> Arm:
    """Read the chain from the root to link ``tip`` of a URDF file.

    Args:
        path: The file.
        tip: Last link of the arm, whose frame is the tool; the flange by default. For a whole robot, the links with
            sensors and targets, separated by commas.

    Raises:
        InputError: If the file, a link or a joint is unusable; the message names it.
    """
    path = Path(path)
    rows = [urdf_row(path, part) for part in (tip.split(",") if tip else [tip])]
    return arm_of(rows, path, "URDF", named=bool(tip))


def urdf_row(path: Path, tip: str | None = None) -> JointRow:
    """Read the chain of joints from the root link of a URDF file to link ``tip``; `load_urdf` makes an arm of it.

    Args:
        path: The file.
        tip: Name of the last link. By default it is the flange, as `joint_chain.flange` finds it in the tree of links.

    Raises:
        InputError: If the file, a link or a joint is unusable; the message names it.
    """
    root = xml_root(path, ".urdf")
    if "${" in ElementTree.tostring(root, "unicode") or any("wiki/xacro}" in part.tag for part in root.iter()):
        raise InputError(f"{path} is a xacro that was not expanded; give the URDF that `xacro {path}` prints")
    with in_file(path):
        by_name, above = _unique([joint for joint in root.iter("joint") if joint.find("child") is not None])
        chain, last = _chain(above, tip)
        joints, tool, drives = _joints(chain, by_name)
        masses = tuple(_masses(root, above))
    mount = str(chain[-1].get("name")) if chain[-1].get("type") == "fixed" else None
    name, first = shortened(root.get("name", path.stem)), _link(chain[0], "parent")
    return JointRow(name, first, last, tuple(joints), tool, drives, mount, masses)


def _masses(root: Element, above: Mapping[str, Element]) -> Iterator[Mass]:
    """Yield the mass of each link that has <inertial>; ``above`` is the joint above each link, by the link's name."""
    for link in root.iterfind("link"):
        if (inertial := link.find("inertial")) is None:
            continue
        name, mass, origin = str(link.get("name")), inertial.find("mass"), inertial.find("origin")
        owner = f"link '{shortened(name)}'"
        kg = xml_mass("" if mass is None else mass.get("value", ""), owner)
        text = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
        point = xml_numbers(text, f"centre of mass of {owner}", M.most)
        path = []
        while name in above:
            path.append((str(above[name].get("name")), point))
            place = _origin(above[name])
            point, name = place.position + place.rotation @ point, _link(above[name], "parent")
        yield Mass(kg, tuple(path))


def _origin(joint: Element) -> Pose:
    """Return the pose of a joint in the frame of its parent link."""
    origin = joint.find("origin")
    turn = Rotation.from_euler("xyz", _numbers(origin, "rpy", joint)).as_matrix()
    return Pose(_numbers(origin, "xyz", joint), turn)


def _joints(chain: list[Element], by_name: Mapping[str, Element]) -> tuple[list[ChainJoint], Pose, dict[str, Drive]]:
    """Return the moving joints of a chain, the tip's pose in the last joint's frame, and the commanded joints by name.

    ``chain`` has the joint elements from root to tip, ``by_name`` all joint elements of the file.
    """
    joints: list[ChainJoint] = []
    drives: dict[str, Drive] = {}
    before = identity_pose()  # from the last joint that moves
    for joint in chain:
        before = behind(before, _origin(joint))
        kind = str(joint.get("type"))
        if kind == "fixed":
            continue
        if kind not in MOVING:
            raise InputError(f"joint {_name(joint)} has type '{shortened(kind)}'; only serial R and P chains are arms")
        driver, ratio, offset = _driver(joint, by_name)
        axis = joint.find("axis")
        direction = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis, "xyz", joint)
        direction = unit_vector(direction, f"axis of joint {_name(joint)}")
        name = str(driver.get("name"))
        if ratio:
            drives[name] = Drive(MOVING[str(driver.get("type"))], *_limits(driver))
        free = joint is driver or not ratio or kind == "continuous" or joint.find("limit") is None
        allowed, motion = None if free else _limits(joint), (ratio, offset, MOVING[kind])
        joints.append(ChainJoint(str(joint.get("name")), name, *motion, before, direction, allowed))
        before = identity_pose()
    return joints, before, drives


def _unique(joints: list[Element]) -> tuple[dict[str, Element], dict[str, Element]]:
    """Return the joints by name and by child link; raise an error if a name or a child link occurs twice."""
    by_name: dict[str, Element] = {}
    above: dict[str, Element] = {}
    for joint in joints:
        name, child = str(joint.get("name")), _link(joint, "child")
        if name in by_name:
            raise InputError(f"joint {_name(joint)} is given twice; rename one")
        if child in above:
            pair = f"{_name(above[child])} and {_name(joint)}"
            raise InputError(f"link '{shortened(child)}' is the child of joints {pair}; give each link one joint")
        by_name[name] = above[child] = joint
    return by_name, above


def _chain(above: Mapping[str, Element], tip: str | None) -> tuple[list[Element], str]:
    """Return the joints from the root to ``tip`` (the flange if None) and the tip's name; raise an error for a loop.

    ``above`` is the joint above each link, by the link's name.
    """
    try:
        TopologicalSorter({link: [_link(joint, "parent")] for link, joint in above.items()}).prepare()
    except CycleError as error:
        link = error.args[1][0]
        loop = f"joint {_name(above[link])} closes a loop: link '{shortened(link)}' stands on itself"
        raise InputError(f"{loop}; an arm is an open chain") from None
    tip = tip or _flange(above)
    chain, link = [], tip
    while link in above:
        chain.append(above[link])
        link = _link(above[link], "parent")
    if not chain:
        raise InputError(f"no chain of joints leads from link 'root' to link '{shortened(tip)}'; name existing links")
    return chain[::-1], tip


def _flange(above: Mapping[str, Element]) -> str:
    """Return the name of the flange, as `joint_chain.flange` finds it; ``above`` is the joint above each link."""
    children: dict[str, list[Carried]] = {}
    for link, joint in above.items():
        moving = () if joint.get("type") == "fixed" else (str(joint.get("name")),)
        children.setdefault(_link(joint, "parent"), []).append(Carried(link, moving))
    return flange(children, next((link for link in children if link not in above), ""))


def _driver(joint: Element, by_name: Mapping[str, Element]) -> tuple[Element, float, float]:
    """Return the joint that drives ``joint``, over any number of mimics, with overall multiplier and offset.

    ``by_name`` has all joint elements of the file by name. The offset is in rad or m.
    """

    def mimicked(name: str) -> tuple[str, float, float] | None:
        if (mimic := by_name[name].find("mimic")) is None:
            return None
        leader = mimic.get("joint", "")
        owner = f"joint {_name(by_name[name])}"
        if leader not in by_name:
            raise InputError(f"{owner} mimics '{shortened(leader)}', which is no joint of the file; name one that is")
        multiplier = xml_number(mimic.get("multiplier", "1"), f"multiplier of {owner}", MOST_RATIO)
        return leader, multiplier, xml_number(mimic.get("offset", "0"), f"offset of {owner}", MOST_RATIO)

    driver, ratio, offset = driver_of(str(joint.get("name")), mimicked)
    leader = by_name[driver]
    if str(leader.get("type")) not in MOVING:
        raise InputError(f"joint {_name(joint)} mimics {_name(leader)}, which does not move; name one that does")
    return leader, ratio, offset


def _limits(joint: Element) -> tuple[float, float, float]:
    """Return a joint's lower limit, upper limit and speed; the range of a continuous joint is one turn.

    The unit is rad and rad/s, or m and m/s for a prismatic joint.
    """
    kind, limit = str(joint.get("type")), joint.find("limit")
    unit, most, fastest = ("m", M.most, M_PER_S.most) if MOVING[kind] else ("rad", RAD.most, RAD_PER_S.most)
    if limit is None and kind != "continuous":
        raise InputError(f"{kind} joint {_name(joint)} has no <limit>; give lower and upper in {unit}, and velocity")
    attributes = {} if limit is None else limit.attrib

    def number(key: str, default: str, most: float) -> float:
        return xml_number(attributes.get(key, default), f"{key} limit of joint {_name(joint)}", most)

    lower, upper = -np.pi, np.pi
    if kind != "continuous":
        lower, upper = number("lower", "0", most), number("upper", "0", most)
    if lower >= upper:
        ends = f"a lower limit of {lower:g} {unit}, not below its upper limit of {upper:g} {unit}"
        raise InputError(f"joint {_name(joint)} has {ends}; correct them")
    if (speed := number("velocity", "1", fastest)) <= 0:
        raise InputError(f"the velocity limit of joint {_name(joint)} is {speed:g}; give it in {unit}/s, above zero")
    return lower, upper, speed


def _link(joint: Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else str(element.get("link"))


def _name(joint: Element) -> str:
    return f"'{shortened(joint.get('name'))}'"


def _numbers(element: Element | None, key: str, joint: Element) -> Array:
    text = "0 0 0" if element is None else element.get(key, "0 0 0")
    return xml_numbers(text, f"{key} of joint {_name(joint)}", (RAD if key == "rpy" else M).most)
