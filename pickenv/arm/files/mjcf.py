"""Read and write MJCF. The hinges and slides between the world and a body or a site can be read as a `Geometry`.

Files are read as MuJoCo 3 reads them: pos with quat, axisangle, euler, xyaxes or zaxis; compiler angle and eulerseq,
default classes, childclass, frames, several joints on a body, ref, and included files. A joint that an equality
constraint ties to another joint follows that joint. A constraint that closes a loop through the chain is refused.

A `Geometry` is in metres and radians. MJCF has no joint speeds; 1 rad/s and 1 m/s are used.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import TypeAlias

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
from pickenv.arm.files.urdf import ROD_RADIUS, leading_links
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose, behind, identity_pose
from pickenv.arm.kinematics.task_space import rotation_matrix
from pickenv.base import DEG, RAD, InputError, M, Unit, decimal_number, is_file, listed, one_line, register, shortened
from pickenv.base.files import in_file

# MJCF out: any chain as a MuJoCo model with joints, limits, position drives and a site at the tool. Forward
# kinematics are exact. Masses are not known of an arm's table: each link is a rod of `DENSITY`, so that inertias are
# valid and a simulation runs; they say nothing about the real arm. Metres, radians, kg.


DENSITY, LEAST_MASS = 3.0, 0.2
"""Mass per length of a link, kg/m, and the least mass of a link, kg."""

STIFFNESS, DAMPING = 2000.0, 200.0
"""Stiffness of the position drives, N*m/rad or N/m, and their damping, N*m*s/rad or N*s/m."""

RODS = "masses"
"""Name of the text element that marks a written file in which links have masses of rods, which are not read back."""


def mjcf_text(geometry: Geometry, name: str, comment: str = "") -> str:
    """Return a MuJoCo model of an arm as text; its site "tool" has the tool's pose.

    If a joint moves several links, the first link with ratio 1 and the joint's type gets the joint itself. Equality
    constraints make the other links follow. MuJoCo does not apply these constraints if it computes only kinematics;
    then set the positions of all joints yourself. Characters that XML cannot hold are left out of names.

    Args:
        geometry: The arm.
        name: Name of the model.
        comment: Comment at the beginning of the model; none if empty.

    Raises:
        InputError: If a joint moves no link with ratio 1 and the joint's type. Write URDF instead.
    """
    leaders = leading_links(geometry)
    if None in leaders:
        title = geometry.joint_names[leaders.index(None)]
        raise InputError(f"joint '{title}' moves no link as it moves itself; write URDF instead")
    root = Element("mujoco", model=one_line(name))
    if comment:
        root.append(ElementTree.Comment(one_line(re.sub("-(?=-)", "- ", comment))))
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true")
    custom = ElementTree.SubElement(root, "custom")
    ElementTree.SubElement(custom, "text", name=RODS, data=f"rods of {DENSITY:g} kg/m, for a simulation to run")
    body = ElementTree.SubElement(root, "worldbody")
    drives, couplings = Element("actuator"), Element("equality")
    origins = link_origins(geometry)
    ends = [*(origin.position for origin in origins[1:]), geometry.tool.position]
    links = zip(geometry.owners, geometry.ratios, geometry.slides, origins, ends, strict=True)
    for i, (owner, ratio, slides, origin, end) in enumerate(links):
        body = ElementTree.SubElement(body, "body", {"name": f"link{i + 1}", **_placed(origin)})
        _weigh(body, end)
        leads, title = leaders[owner] == i, one_line(geometry.joint_names[owner])
        limits = sorted((ratio * float(geometry.lower[owner]), ratio * float(geometry.upper[owner])))
        joint = title if leads else f"{title} (follows, link {i + 1})"
        kind = "slide" if slides else "hinge"
        ElementTree.SubElement(body, "joint", name=joint, type=kind, axis="0 0 1", range=numbers_text(limits))
        if leads:
            settings = {"kp": repr(STIFFNESS), "kv": repr(DAMPING), "ctrlrange": numbers_text(limits)}
            ElementTree.SubElement(drives, "position", {"name": title, "joint": joint, **settings})
        else:
            law = numbers_text([0.0, ratio, 0.0, 0.0, 0.0])
            ElementTree.SubElement(couplings, "joint", joint1=joint, joint2=title, polycoef=law)
    ElementTree.SubElement(body, "site", {"name": "tool", "size": "0.01", **_placed(geometry.tool)})
    root.append(drives)
    if len(couplings):
        root.append(couplings)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _weigh(body: Element, end: Array) -> None:
    """Give a link's body the mass, the inertia and the look of a rod from its origin to ``end``, body's frame, m."""
    length = float(np.linalg.norm(end))
    mass = max(DENSITY * length, LEAST_MASS)
    # Across the rod; along it no less, so that it is never singular.
    inertia = mass * (length**2 / 12.0 + ROD_RADIUS**2 / 2.0)
    inertial = {"pos": numbers_text(end / 2.0), "mass": repr(mass), "diaginertia": numbers_text([inertia] * 3)}
    ElementTree.SubElement(body, "inertial", inertial)
    if length > ROD_RADIUS:
        shape = {"type": "capsule", "fromto": numbers_text([0.0, 0.0, 0.0, *end]), "size": repr(ROD_RADIUS)}
        ElementTree.SubElement(body, "geom", {**shape, "contype": "0", "conaffinity": "0"})


def _placed(pose: Pose) -> dict[str, str]:
    x, y, z, w = Rotation.from_matrix(pose.rotation).as_quat()
    return {"pos": numbers_text(pose.position), "quat": numbers_text([w, x, y, z])}


# What the attributes of an MJCF element mean: default classes, units of angles, and the ways to tell an orientation.
# As MuJoCo 3's compiler reads them. Metres and radians come out.


Attributes: TypeAlias = Mapping[str, str]
ANGLES = {"degree": DEG, "radian": RAD}
ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")


@dataclass(frozen=True)
class MjcfValues:
    """Settings of an MJCF file that determine the meaning of its numbers.

    Attributes:
        unit: Unit of the file's angles: degrees, which are MJCF's default, or radians.
        sequence: Order of the file's Euler angles; small letters mean moving axes, capitals fixed axes.
        autolimits: Whether a joint with a range is limited without the attribute ``limited``.
        defaults: Attributes of each default class, by element and class.
    """

    unit: Unit
    sequence: str
    autolimits: bool
    defaults: Mapping[tuple[str, str], Attributes]

    @classmethod
    def of(cls, root: Element) -> MjcfValues:
        """Read the settings of a file from its root element.

        Raises:
            InputError: If a setting is unknown.
        """
        settings = {key: value for compiler in root.iterfind("compiler") for key, value in compiler.attrib.items()}
        angle, sequence = settings.get("angle", "degree"), settings.get("eulerseq", "xyz")
        if angle not in ANGLES:
            raise InputError(f"angle of <compiler> is '{shortened(angle)}'; give degree or radian")
        if len(sequence) != 3 or set(sequence) - set("xyzXYZ"):
            raise InputError(f"eulerseq of <compiler> is '{shortened(sequence)}'; give three of x, y, z, X, Y, Z")
        defaults: dict[tuple[str, str], Attributes] = {}
        waiting = [(part, "main", "") for part in reversed(root.findall("default"))]
        while waiting:
            part, name, above = waiting.pop()
            for tag in ("joint", "site"):
                inherited = dict(defaults.get((tag, name), defaults.get((tag, above), {})))
                defaults[tag, name] = reduce(_over, (element.attrib for element in part.iterfind(tag)), inherited)
            waiting += [(child, child.get("class", ""), name) for child in reversed(part.findall("default"))]
        return cls(ANGLES[angle], sequence, settings.get("autolimits", "true") == "true", defaults)

    def merged(self, tag: str, element: Element, childclass: str) -> Attributes:
        """Return an element's attributes, completed by the attributes of its default class.

        Args:
            tag: "joint" or "site".
            element: The element.
            childclass: Default class that is used if the element names none; empty for the main class.

        Raises:
            InputError: If there is no such class.
        """
        name = element.get("class", childclass) or "main"
        if name != "main" and (tag, name) not in self.defaults:
            raise InputError(f"there is no default class '{shortened(name)}'; name one of the file")
        return _over(self.defaults.get((tag, name), {}), element.attrib)

    def pose(self, attributes: Attributes) -> Pose:
        """Return the pose of a body, frame or site in its parent from its attributes."""
        return Pose(xml_numbers(attributes.get("pos", "0 0 0"), "pos", M.most), self._rotation(attributes))

    def motion(self, joint: _Joint, follows: bool = False) -> tuple[Drive, float, bool]:
        """Read a joint's motion.

        Args:
            joint: The joint.
            follows: Whether the joint follows another joint or is held, so that it needs no range of its own.

        Returns:
            Three values. The first is the joint as a `Drive`. The second is the joint's reference position (MJCF's
            ``ref``), rad or m. The third says whether the file limits the joint.

        Raises:
            InputError: If the joint is neither hinge nor slide, or its range is missing or empty.
        """
        attributes, name = joint.attributes, shortened(joint.name)
        kind, word = attributes.get("type", "hinge"), attributes.get("limited", "auto")
        if kind not in ("hinge", "slide"):
            owner = f"joint '{name}' of body '{shortened(joint.body)}'"
            raise InputError(f"{owner} is of type {shortened(kind)}; only chains of hinges and slides are arms")
        slides = kind == "slide"
        unit = M if slides else self.unit
        ref = xml_number(attributes.get("ref", "0"), f"ref of joint '{name}'", unit.most) * unit.scale
        ranged = "range" in attributes and word != "false"
        low, high = xml_numbers(attributes["range"], "range", unit.most, 2).tolist() if ranged else (0.0, 0.0)
        limited = ranged and (word == "true" or (self.autolimits and low < high))
        if slides and not limited and not follows:
            raise InputError(f"slide joint '{name}' has no range; give its lower and upper end in m")
        if limited and low >= high:
            raise InputError(f"joint '{name}' has a range whose lower end is not below its upper end; correct it")
        lower, upper = (low * unit.scale, high * unit.scale) if slides or limited else (-math.pi, math.pi)
        return Drive(slides, lower, upper, 1.0), ref, limited

    def _rotation(self, attributes: Attributes) -> Array:
        ways = [key for key in ORIENTATIONS if key in attributes]
        if len(ways) > 1:
            raise InputError(f"an orientation is given by both {ways[0]} and {ways[1]}; leave one out")
        match ways:
            case ["quat"]:
                w, *xyz = unit_vector(xml_numbers(attributes["quat"], "quat", M.most, 4), "quat")
                return np.asarray(Rotation.from_quat([*xyz, w]).as_matrix())
            case ["axisangle"]:
                turn = xml_numbers(attributes["axisangle"], "axisangle", self.unit.most, 4)
                return rotation_matrix(unit_vector(turn[:3], "axisangle") * (float(turn[3]) * self.unit.scale))
            case ["euler"]:
                turned = np.eye(3)
                turns = xml_numbers(attributes["euler"], "euler", self.unit.most).tolist()
                for letter, angle in zip(self.sequence, turns, strict=True):
                    step = rotation_matrix(np.eye(3)["xyz".index(letter.lower())] * (angle * self.unit.scale))
                    turned = turned @ step if letter.islower() else step @ turned
                return turned
            case ["xyaxes"]:
                numbers = xml_numbers(attributes["xyaxes"], "xyaxes", M.most, 6)
                x = unit_vector(numbers[:3], "xyaxes")
                y = unit_vector(numbers[3:] - x * (x @ numbers[3:]), "xyaxes")
                return np.column_stack([x, y, np.cross(x, y)])
            case ["zaxis"]:
                z = unit_vector(xml_numbers(attributes["zaxis"], "zaxis", M.most), "zaxis")
                across = np.array([-z[1], z[0], 0.0])  # the shortest turn from z to it
                sine = float(np.linalg.norm(across))
                axis = across / sine if sine > 1e-10 else np.array([1.0, 0.0, 0.0])
                return rotation_matrix(axis * math.atan2(sine, z[2]))
        return np.eye(3)


def _over(below: Attributes, own: Attributes) -> dict[str, str]:
    """Return the inherited attributes ``below``, overridden by an element's attributes ``own``.

    An element's orientation replaces an inherited one. But, as in MuJoCo, an element's quat is dropped if another kind
    of orientation (such as euler) is inherited.
    """
    ways = [key for key in ORIENTATIONS if key in own]
    if ways == ["quat"] and any(key in below for key in ORIENTATIONS[1:]):
        return {**below, **{key: value for key, value in own.items() if key != "quat"}}
    lower = {key: value for key, value in below.items() if not ways or key not in ORIENTATIONS}
    return {**lower, **own}


WORLD = "world"


@dataclass(frozen=True, eq=False)
class _Joint:
    name: str
    body: str
    attributes: Attributes
    within: Pose


@dataclass(frozen=True, eq=False)
class _Body:
    """A body or a site: its pose in the frame of its parent, and the joints that move it, in the file's order.

    ``mass`` has its mass, kg, and its centre of mass in its own frame, m; see `_inertial`.
    """

    name: str
    parent: str
    pose: Pose
    joints: list[_Joint] = field(default_factory=list)
    site: bool = False
    mocap: bool = False
    mass: tuple[float, Array] | None = None


@register("arm_format", "xml")
def load_mjcf(path: str | Path, tip: str | None = None) -> Arm:
    """Read the chain from the world to a body or a site of a MuJoCo model.

    Args:
        path: The file (.xml).
        tip: Name of the body, or else the site, whose frame is the tool; the flange by default. For a whole robot, the
            bodies or sites with sensors and targets, separated by commas.

    Raises:
        InputError: If the file, a body or a joint is unusable; the message names it.
    """
    path = Path(path)
    rows = [mjcf_row(path, part) for part in (tip.split(",") if tip else [tip])]
    return arm_of(rows, path, "MJCF", named=bool(tip))


def mjcf_row(path: Path, tip: str | None = None) -> JointRow:
    """Read the chain of joints from the world of a MuJoCo model to ``tip``; `load_mjcf` makes an arm of this chain.

    Args:
        path: The file (.xml).
        tip: Name of the body or site; the flange by default.

    Raises:
        InputError: If the file, a body or a joint is unusable; the message names it.
    """
    root = xml_root(path, "MJCF (.xml)")
    if root.tag != "mujoco":
        advice = "name it .urdf" if root.tag == "robot" else "give a MuJoCo model"
        raise InputError(f"{path} is no MJCF: its first element is <{shortened(root.tag)}>; {advice}")
    _follow_includes(root, path)
    with in_file(path):
        values = MjcfValues.of(root)
        bodies = _bodies(root, values)
        last = _end(bodies, tip)
        joints, tool, drives = _joints(_above(bodies, last)[::-1], bodies, root, values)
        masses = tuple(_masses(root, bodies))
    mount = None if bodies[last].joints else last
    name = shortened(root.get("model", path.stem))
    return JointRow(name, WORLD, bodies[last].name, tuple(joints), tool, drives, mount, masses)


def _follow_includes(root: Element, main: Path) -> None:
    """Replace includes by their files' content; as in MuJoCo, paths start at the main file's folder.

    A file that is included twice is refused.
    """
    taken: set[Path] = {main.resolve()}
    waiting = [root]
    for parent in waiting:  # grows as files come in
        for place, child in reversed(list(enumerate(parent))):
            if child.tag != "include":
                continue
            file = main.parent / child.get("file", "")
            if file.resolve() in taken:
                raise InputError(f"{main}: {shortened(file.name)} is included twice; include each file once")
            if not is_file(file):
                raise InputError(f"{main} includes {shortened(file, 200)}, which does not exist; correct its name")
            taken.add(file.resolve())
            parent[place : place + 1] = list(xml_root(file, "MJCF (.xml)"))
        waiting += parent


def _bodies(root: Element, values: MjcfValues) -> dict[str, _Body]:
    """Return the world and the bodies by their names, and the sites by the keys "site NAME".

    ``values`` are the settings of the file, by which the numbers in the elements under ``root`` are read.
    """
    bodies = {WORLD: _Body(WORLD, "", identity_pose())}
    worlds = reversed(root.findall("worldbody"))
    waiting = [(world, WORLD, identity_pose(), world.get("childclass", "")) for world in worlds]
    while waiting:
        element, owner, within, childclass = waiting.pop()
        deeper = []
        for part in element:
            inner = part.get("childclass", childclass)
            if part.tag == "frame":
                deeper.append((part, owner, behind(within, values.pose(part.attrib)), inner))
            elif part.tag == "body":
                name = part.get("name", f"body {len(bodies)}")
                if name in bodies:
                    raise InputError(f"body '{shortened(name)}' is given twice; rename one")
                pose = behind(within, values.pose(part.attrib))
                mocap = part.get("mocap", "false") == "true"
                bodies[name] = _Body(name, owner, pose, mocap=mocap, mass=_inertial(part, name))
                deeper.append((part, name, identity_pose(), inner))
            elif part.tag == "site":
                name, pose = part.get("name", f"{len(bodies)}"), values.pose(values.merged("site", part, childclass))
                bodies[f"site {name}"] = _Body(name, owner, behind(within, pose), site=True)
            elif part.tag in ("joint", "freejoint"):
                joints = bodies[owner].joints
                attributes = values.merged("joint", part, childclass)
                name = part.get("name", f"joint {len(joints) + 1} of {owner}")
                joints.append(_Joint(name, owner, attributes if part.tag == "joint" else {"type": "free"}, within))
        waiting += deeper[::-1]
    return bodies


def _inertial(body: Element, name: str) -> tuple[float, Array] | None:
    """Return the mass of a body, kg, and its centre of mass in the body's frame (3,), m.

    The mass is NaN if only the body's shapes determine it. Return None for a body without <inertial> and shapes.
    ``name`` names the body in error messages.
    """
    if (inertial := body.find("inertial")) is None:
        shapes = body.find("geom") is not None or body.find("frame/geom") is not None
        return (math.nan, np.zeros(3)) if shapes else None
    owner = f"body '{shortened(name)}'"
    kg = xml_mass(inertial.get("mass", ""), owner)
    return kg, xml_numbers(inertial.get("pos", "0 0 0"), f"centre of mass of {owner}", M.most)


def _masses(root: Element, bodies: Mapping[str, _Body]) -> Iterator[Mass]:
    """Yield the mass of each body; yield nothing if masses are placeholders (`RODS`) or computed from shapes."""
    by_shape = any(compiler.get("inertiafromgeom") == "true" for compiler in root.iterfind("compiler"))
    if by_shape or root.find(f"custom/text[@name='{RODS}']") is not None:
        return
    for owner in bodies.values():
        if owner.mass is not None:
            kg, point = owner.mass
            path = []
            for key in _above(bodies, owner.name):
                path += [(joint.name, point - _anchor(joint)) for joint in reversed(bodies[key].joints)]
                point = bodies[key].pose.position + bodies[key].pose.rotation @ point
            yield Mass(kg, tuple(path))


def _anchor(joint: _Joint) -> Array:
    """Return the joint's anchor, a point on its axis (3,), m, in the frame of the body that the joint moves."""
    point = xml_numbers(joint.attributes.get("pos", "0 0 0"), "pos", M.most)
    return behind(joint.within, Pose(point, np.eye(3))).position


def _end(bodies: Mapping[str, _Body], tip: str | None) -> str:
    """Return the key in ``bodies`` of the body or site that is the tip; the flange by default."""
    if tip is None:
        children: dict[str, list[Carried]] = {}
        for key, body in bodies.items():
            moving = tuple(joint.name for joint in body.joints)
            children.setdefault(body.parent, []).append(Carried(key, moving, only_named=body.site))
        return flange(children, WORLD)
    for key in (tip, f"site {tip}"):
        if key in bodies and key != WORLD:
            return key
    names = listed((body.name for key, body in bodies.items() if key != WORLD and not body.site), 200)
    raise InputError(f"there is no body or site '{shortened(tip)}'; name one of the file, such as {names or 'none'}")


def _above(bodies: Mapping[str, _Body], key: str) -> list[str]:
    """Return the keys in ``bodies`` of the body ``key`` and of its ancestors, towards the world, without the world."""
    keys = []
    while key != WORLD:
        keys.append(key)
        key = bodies[key].parent
    return keys


def _joints(
    chain: list[str], bodies: Mapping[str, _Body], root: Element, values: MjcfValues
) -> tuple[list[ChainJoint], Pose, dict[str, Drive]]:
    """Return the joints along a chain of bodies, the tip's pose in the last joint's frame, and the driving joints.

    Args:
        chain: Keys in ``bodies`` of the bodies from the world to the tip.
        bodies: All bodies and sites of the file, from `_bodies`.
        root: The file's root element.
        values: Settings of the file.
    """
    joints: dict[str, _Joint] = {}
    for joint in (joint for body in bodies.values() for joint in body.joints):
        if joint.name in joints:
            raise InputError(f"joint '{shortened(joint.name)}' is given twice; rename one")
        joints[joint.name] = joint
    ties = _ties(root, joints)
    _refuse_loops(root, bodies, {key for key in chain if bodies[key].joints})
    row: list[ChainJoint] = []
    drives: dict[str, Drive] = {}
    before = identity_pose()
    for key in chain:
        before = behind(before, bodies[key].pose)
        for joint in bodies[key].joints:
            driver, ratio, offset = driver_of(joint.name, ties.get)
            ratio = 0.0 if driver == WORLD else ratio
            motion, ref, limited = values.motion(joint, follows=driver != joint.name)
            axis = xml_numbers(joint.attributes.get("axis", "0 0 1"), "axis", M.most)
            axis = joint.within.rotation @ unit_vector(axis, f"axis of joint '{shortened(joint.name)}'")
            if ratio:
                drives[driver], zero, _ = values.motion(joints[driver])
                offset -= ratio * zero
            follows = ratio and limited and driver != joint.name
            allowed = (motion.lower - ref, motion.upper - ref, math.inf) if follows else None
            place = _anchor(joint)
            origin = behind(before, Pose(place, np.eye(3)))
            row.append(ChainJoint(joint.name, driver, ratio, offset, motion.slides, origin, axis, allowed, key, place))
            before = Pose(-place, np.eye(3))
    return row, before, drives


def _ties(root: Element, joints: Mapping[str, _Joint]) -> dict[str, tuple[str, float, float]]:
    """Return what each joint with an active equality constraint follows, by the joint's name.

    Args:
        root: The file's root element.
        joints: All joints of the file by name.

    Returns:
        Three values for each joint: the name of the followed joint (or of the world), a ratio, and an offset, rad or m.
        The joint's displacement is the offset plus the ratio times the followed joint's displacement.
    """
    ties: dict[str, tuple[str, float, float]] = {}
    for tie in root.iterfind("equality/joint"):
        name, leader, law = tie.get("joint1", ""), tie.get("joint2", WORLD), tie.get("polycoef", "")
        if tie.get("active", "true") != "true":
            continue
        if name not in joints or (leader != WORLD and leader not in joints):
            pair = f"'{shortened(name)}' to '{shortened(leader)}'"
            raise InputError(f"an equality constraint ties {pair}, and one of them is no joint of the file; correct it")
        if name in ties:
            raise InputError(f"two equality constraints tie joint '{shortened(name)}'; leave one active")
        numbers = [n for n in map(decimal_number, law.split()) if n is not None and abs(n) <= MOST_RATIO]
        if len(numbers) != len(law.split()) or len(numbers) > 5:
            raise InputError(f"polycoef of joint '{shortened(name)}' is '{shortened(law)}'; give up to five numbers")
        shift, factor, *higher = *numbers, *(0.0, 1.0, 0.0, 0.0, 0.0)[len(numbers) :]  # those left out are MuJoCo's
        if any(higher) and leader != WORLD:
            raise InputError(f"joint '{shortened(name)}' follows '{shortened(leader)}' by a curve, not in proportion")
        ties[name] = leader, factor, shift
    return ties


def _refuse_loops(root: Element, bodies: Mapping[str, _Body], moved: set[str]) -> None:
    """Raise an error if a constraint closes a loop through a body of the chain.

    Args:
        root: The file's root element.
        bodies: All bodies and sites of the file, from `_bodies`.
        moved: Keys in ``bodies`` of the bodies that the joints of the chain move.
    """
    for tie in (*root.iterfind("equality/connect"), *root.iterfind("equality/weld")):
        ends = [f"site {tie.get(f'site{i}')}" if tie.get("site1") else tie.get(f"body{i}") for i in (1, 2)]
        bound = [end for end in ends if end is not None and end in bodies]
        if tie.get("active", "true") != "true" or any(bodies[end].mocap for end in bound):
            continue  # a mocap body is a handle by which a program moves the model
        between = reduce(set.symmetric_difference, (set(_above(bodies, end)) for end in bound), set[str]())
        if caught := between & moved:
            loop = f"a {tie.tag} constraint closes a loop through body '{shortened(min(caught))}'"
            raise InputError(f"{loop}; an arm is an open chain, so name a tip before the loop")
