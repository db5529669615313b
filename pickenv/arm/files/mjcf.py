"""MJCF in: hinges and slides between the world and a body or a site of a MuJoCo model, as a `Geometry`.

Poses and joints are placed as MuJoCo 3 places them: pos with quat, axisangle, euler, xyaxes or zaxis, compiler angle
and eulerseq, default classes, childclass, frames, several joints on a body, ref, and included files. A joint that an
equality constraint ties to another follows it. A constraint that closes a loop through the chain is refused.

Inside everything is metres and radians. MJCF has no joint speeds; 1 rad/s and 1 m/s are taken.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.arm import MOST_RATIO, Arm
from pickenv.arm.files.flange import Carried, flange
from pickenv.arm.files.joint_chain import ChainJoint, Drive, JointRow, driver_of
from pickenv.arm.files.link_origins import link_origins
from pickenv.arm.files.urdf import ROD_RADIUS, leading_links
from pickenv.arm.files.xml_values import numbers_text, xml_number, xml_numbers, xml_root
from pickenv.arm.kinematics.forward import PARALLEL
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose, behind, identity_pose
from pickenv.arm.kinematics.pose_error import rotation_matrix
from pickenv.base import (
    DEG,
    RAD,
    InputError,
    M,
    decimal_number,
    is_file,
    listed,
    one_line,
    register,
    shortened,
)

# MJCF out: any chain as a MuJoCo model with joints, limits, position drives and a site at the tool. Forward
# kinematics are exact. Masses are not known of an arm's table: each link is a rod of `DENSITY`, so that inertias are
# valid and a simulation runs; they say nothing about the real arm. Metres, radians, kg.


DENSITY, LEAST_MASS = 3.0, 0.2
"""kg/m of a link, and the lightest one's mass in kg."""

STIFFNESS, DAMPING = 2000.0, 200.0
"""Of the position drives, N*m/rad or N/m, and N*m*s/rad or N*s/m."""

TOOL_SITE = "tool"

Element = ElementTree.Element


def mjcf_text(geometry: Geometry, name: str, comment: str = "") -> str:
    """A MuJoCo model of the chain; a site named "tool" has the tool's pose.

    Where a joint moves several links, those after its own follow it by an equality constraint: set their joint
    positions too where only kinematics are computed. Characters that XML cannot hold are left out of names.

    Raises:
        InputError: If a joint moves no link as it moves itself, for which MJCF has no joint; URDF has.
    """
    leaders = leading_links(geometry)
    if None in leaders:
        title = geometry.joint_names[leaders.index(None)]
        raise InputError(f"joint '{title}' moves no link as it moves itself; write URDF instead")
    root = Element("mujoco", model=one_line(name))
    if comment:
        root.append(ElementTree.Comment(one_line(comment.replace("--", "- -"))))
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true")
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
    ElementTree.SubElement(body, "site", {"name": TOOL_SITE, "size": "0.01", **_placed(geometry.tool)})
    root.append(drives)
    if len(couplings):
        root.append(couplings)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _weigh(body: Element, end: Array) -> None:
    """Mass and inertia of a rod from a link's origin to ``end``, m, and its picture."""
    length = float(np.linalg.norm(end))
    mass = max(DENSITY * length, LEAST_MASS)
    inertia = mass * (
        length**2 / 12.0 + ROD_RADIUS**2 / 2.0
    )  # across the rod; along it no less, so that it is never singular
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
ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")


def truth(word: str) -> bool:
    """What "true" and "false" mean."""
    return word == "true"


@dataclass(frozen=True)
class MjcfValues:
    """How a file is to be read.

    Attributes:
        degrees: Whether its angles are degrees, which is MJCF's default.
        sequence: Order of its Euler angles; small letters turn about moving axes.
        autolimits: Whether a range alone limits a joint.
        defaults: Attributes of each class of defaults, by element and class.
    """

    degrees: bool
    sequence: str
    autolimits: bool
    defaults: Mapping[tuple[str, str], Attributes]

    @classmethod
    def of(cls, root: Element) -> MjcfValues:
        """The settings of a whole file.

        Raises:
            InputError: If a setting is unknown.
        """
        given: dict[str, str] = {}
        for compiler in root.iterfind("compiler"):
            given |= compiler.attrib
        unit, sequence = given.get("angle", "degree"), given.get("eulerseq", "xyz")
        if unit not in ("degree", "radian"):
            raise InputError(f"angle of <compiler> is '{shortened(unit)}'; give degree or radian")
        if len(sequence) != 3 or set(sequence) - set("xyzXYZ"):
            raise InputError(f"eulerseq of <compiler> is '{shortened(sequence)}'; give three of x, y, z, X, Y, Z")
        defaults: dict[tuple[str, str], Attributes] = {}
        waiting = [(part, "main", "") for part in reversed(root.findall("default"))]
        while waiting:
            part, name, above = waiting.pop()
            for tag in ("joint", "site"):
                found = dict(defaults.get((tag, name), defaults.get((tag, above), {})))
                for own in part.iterfind(tag):
                    found = _over(found, own.attrib)
                defaults[tag, name] = found
            inner = [(child, child.get("class", ""), name) for child in part.iterfind("default")]
            waiting += inner[::-1]
        return cls(unit == "degree", sequence, truth(given.get("autolimits", "true")), defaults)

    def merged(self, tag: str, element: Element, childclass: str) -> Attributes:
        """An element's attributes over those of its class.

        Raises:
            InputError: If there is no such class.
        """
        name = element.get("class", childclass) or "main"
        if name != "main" and (tag, name) not in self.defaults:
            raise InputError(f"there is no default class '{shortened(name)}'; name one of the file")
        return _over(self.defaults.get((tag, name), {}), element.attrib)

    def angle(self, value: float) -> float:
        """An angle of the file, rad."""
        return math.radians(value) if self.degrees else value

    def vector(self, given: Attributes, key: str, most: float) -> Array:
        """Three numbers, or zeros."""
        return xml_numbers(given.get(key, "0 0 0"), key, most)

    def direction(self, given: Attributes, owner: str) -> Array:
        """The unit vector of a joint's axis."""
        return _unit(xml_numbers(given.get("axis", "0 0 1"), "axis", M.most), f"axis of {owner}")

    def joint_number(self, given: Attributes, key: str, slides: bool, owner: str) -> float:
        """A joint's number, m or rad."""
        value = xml_number(given.get(key, "0"), owner, M.most if slides else self._most)
        return value if slides else self.angle(value)

    def limits(self, given: Attributes, slides: bool) -> tuple[float, float] | None:
        """Lower and upper end of a joint's range where it is limited."""
        word = given.get("limited", "auto")
        if word == "false" or "range" not in given:
            return None
        low, high = map(float, xml_numbers(given["range"], "range", M.most if slides else self._most, 2))
        if word != "true" and not (self.autolimits and low < high):
            return None
        return (low, high) if slides else (self.angle(low), self.angle(high))

    def pose(self, given: Attributes) -> Pose:
        """Where a body, frame or site stands in its parent."""
        return Pose(self.vector(given, "pos", M.most), self._rotation(given))

    def polynomial(self, text: str, owner: str, most: float) -> list[float]:
        """The five coefficients of a joint's tie; those left out are MuJoCo's."""
        parts = [decimal_number(part) for part in text.split()]
        good = [part for part in parts if part is not None and math.isfinite(part) and abs(part) <= most]
        if len(good) != len(parts) or len(parts) > 5:
            raise InputError(f"polycoef of joint '{shortened(owner)}' is '{shortened(text)}'; give up to five numbers")
        return [*good, *(0.0, 1.0, 0.0, 0.0, 0.0)[len(good) :]]

    @property
    def _most(self) -> float:
        return DEG.most if self.degrees else RAD.most

    def _rotation(self, given: Attributes) -> Array:
        ways = [key for key in ORIENTATIONS if key in given]
        if len(ways) > 1:
            raise InputError(f"an orientation is given by both {ways[0]} and {ways[1]}; leave one out")
        match ways:
            case ["quat"]:
                w, *xyz = _unit(xml_numbers(given["quat"], "quat", M.most, 4), "quat")
                return np.asarray(Rotation.from_quat([*xyz, w]).as_matrix())
            case ["axisangle"]:
                turn = xml_numbers(given["axisangle"], "axisangle", self._most, 4)
                return rotation_matrix(_unit(turn[:3], "axisangle") * self.angle(float(turn[3])))
            case ["euler"]:
                turned = np.eye(3)
                turns = xml_numbers(given["euler"], "euler", self._most).tolist()
                for letter, angle in zip(self.sequence, turns, strict=True):
                    step = rotation_matrix(np.eye(3)["xyz".index(letter.lower())] * self.angle(angle))
                    turned = turned @ step if letter.islower() else step @ turned
                return turned
            case ["xyaxes"]:
                numbers = xml_numbers(given["xyaxes"], "xyaxes", M.most, 6)
                x = _unit(numbers[:3], "xyaxes")
                y = _unit(numbers[3:] - x * (x @ numbers[3:]), "xyaxes")
                return np.column_stack([x, y, np.cross(x, y)])
            case ["zaxis"]:
                z = _unit(xml_numbers(given["zaxis"], "zaxis", M.most), "zaxis")
                across = np.array([-z[1], z[0], 0.0])  # the shortest turn from z to it
                sine = float(np.linalg.norm(across))
                axis = across / sine if sine > 1e-10 else np.array([1.0, 0.0, 0.0])
                return rotation_matrix(axis * math.atan2(sine, z[2]))
        return np.eye(3)


def _over(below: Attributes, own: Attributes) -> dict[str, str]:
    """Attributes over inherited ones; of orientations one remains, and any other way beats quat, as in MuJoCo."""
    ways = [key for key in ORIENTATIONS if key in own]
    inherited = [key for key in ORIENTATIONS[1:] if key in below]
    dropped = {"quat"} if ways == ["quat"] and inherited else set()
    kept = {key: value for key, value in below.items() if not ways or dropped or key not in ORIENTATIONS}
    return {**kept, **{key: value for key, value in own.items() if key not in dropped}}


def _unit(values: Array, what: str) -> Array:
    length = float(np.linalg.norm(values))
    if length < PARALLEL:
        raise InputError(f"{what} has no direction; give a unit vector")
    return values / length


WORLD = "world"


@dataclass(frozen=True, eq=False)
class _Joint:
    name: str
    given: Attributes
    within: Pose


@dataclass(frozen=True, eq=False)
class _Body:
    """A body or a site: where it stands, and the joints that move it, in the file's order."""

    name: str
    parent: str
    pose: Pose
    joints: list[_Joint] = field(default_factory=list)
    site: bool = False
    mocap: bool = False


@register("arm_format", "xml")
def load_mjcf(path: str | Path, tip: str | None = None) -> Arm:
    """Read the chain from the world to a body or a site of a MuJoCo model.

    Args:
        path: The file (.xml).
        tip: The body, or else the site, whose frame is the tool; the flange when left out.

    Raises:
        InputError: If the file, a body or a joint is unusable; the message names it.
    """
    path = Path(path)
    return mjcf_row(path, tip).arm(path, "MJCF", bool(tip))


def mjcf_row(path: Path, tip: str | None = None) -> JointRow:
    """The joints that `load_mjcf` makes an arm of.

    Raises:
        InputError: If the file, a body or a joint is unusable; the message names it.
    """
    root = xml_root(path, "MJCF (.xml)")
    if root.tag != "mujoco":
        advice = "name it .urdf" if root.tag == "robot" else "give a MuJoCo model"
        raise InputError(f"{path} is no MJCF: its first element is <{shortened(root.tag)}>; {advice}")
    _follow_includes(root, path)
    try:
        values = MjcfValues.of(root)
        bodies = _bodies(root, values)
        last = _end(bodies, tip)
        chain = _above(bodies, last)[::-1]
        joints, tool, drives = _joints(chain, bodies, root, values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    mount = None if bodies[last].joints else last
    name = shortened(root.get("model", path.stem))
    return JointRow(name, WORLD, bodies[last].name, tuple(joints), tool, drives, mount)


def _follow_includes(root: Element, main: Path) -> None:
    """Put what is included in its place; as in MuJoCo, each file once, and named from the main file's folder."""
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
    """Bodies by name, with the world, and sites by "site NAME"."""
    bodies = {WORLD: _Body(WORLD, "", identity_pose())}
    waiting = [
        (world, WORLD, identity_pose(), world.get("childclass", "")) for world in reversed(root.findall("worldbody"))
    ]
    while waiting:
        element, owner, within, childclass = waiting.pop()
        deeper = []
        for part in element:
            if part.tag == "frame":
                pose = behind(within, values.pose(part.attrib))
                deeper.append((part, owner, pose, part.get("childclass", childclass)))
            elif part.tag == "body":
                name = part.get("name", f"body {len(bodies)}")
                if name in bodies:
                    raise InputError(f"body '{shortened(name)}' is given twice; rename one")
                pose = behind(within, values.pose(part.attrib))
                bodies[name] = _Body(name, owner, pose, mocap=truth(part.get("mocap", "false")))
                deeper.append((part, name, identity_pose(), part.get("childclass", childclass)))
            elif part.tag == "site":
                given = values.merged("site", part, childclass)
                name = part.get("name", f"{len(bodies)}")
                bodies[f"site {name}"] = _Body(name, owner, behind(within, values.pose(given)), site=True)
            elif part.tag in ("joint", "freejoint"):
                joints = bodies[owner].joints
                given = values.merged("joint", part, childclass)
                if part.tag == "freejoint":
                    given = {"type": "free"}
                name = part.get("name", f"joint {len(joints) + 1} of {owner}")
                joints.append(_Joint(name, given, within))
        waiting += deeper[::-1]
    return bodies


def _end(bodies: Mapping[str, _Body], tip: str | None) -> str:
    """Key of the body or site that is the tip."""
    if tip is None:
        children: dict[str, list[Carried]] = {}
        for key, body in bodies.items():
            moving = tuple(joint.name for joint in body.joints)
            children.setdefault(body.parent, []).append(Carried(key, moving, only_named=body.site))
        return flange(children, WORLD)
    for key in (tip, f"site {tip}"):
        if key in bodies and key != WORLD:
            return key
    known = listed((body.name for key, body in bodies.items() if key != WORLD and not body.site), 200)
    raise InputError(f"there is no body or site '{shortened(tip)}'; name one of the file, such as {known or 'none'}")


def _above(bodies: Mapping[str, _Body], key: str) -> list[str]:
    """A body and those that it stands on, up to the world, which is left out."""
    found = []
    while key != WORLD:
        found.append(key)
        key = bodies[key].parent
    return found


def _joints(
    chain: list[str], bodies: Mapping[str, _Body], root: Element, values: MjcfValues
) -> tuple[list[ChainJoint], Pose, dict[str, Drive]]:
    """Joints along a chain of bodies, what stands behind the last of them, and the joints that drive them."""
    owners: dict[str, str] = {}
    every: dict[str, _Joint] = {}
    for key, body in bodies.items():
        for joint in body.joints:
            if joint.name in every:
                raise InputError(f"joint '{shortened(joint.name)}' is given twice; rename one")
            every[joint.name], owners[joint.name] = joint, key
    ties = _ties(root, values, every)
    _refuse_loops(root, bodies, {key for key in chain if bodies[key].joints})
    found: list[ChainJoint] = []
    drives: dict[str, Drive] = {}
    before = identity_pose()
    for key in chain:
        before = behind(before, bodies[key].pose)
        for joint in bodies[key].joints:
            driver, ratio, offset = driver_of(joint.name, lambda name: ties.get(name))
            if driver == WORLD:
                ratio = 0.0
            slides, ref, lower, upper, limited = _kind(joint, bodies[key], values)
            anchor = values.vector(joint.given, "pos", M.most)
            axis = values.direction(joint.given, f"joint '{shortened(joint.name)}'")
            placed = behind(joint.within, Pose(anchor, np.eye(3)))
            if ratio:
                own = _kind(every[driver], bodies[owners[driver]], values)
                offset -= ratio * own[1]
                drives[driver] = Drive(own[0], own[2], own[3], 1.0)
            allowed = (lower - ref, upper - ref, math.inf) if ratio and limited and driver != joint.name else None
            moved = joint.within.rotation @ axis
            origin = behind(before, Pose(placed.position, np.eye(3)))
            row = ChainJoint(joint.name, driver, ratio, offset, slides, origin, moved, allowed, key, placed.position)
            found.append(row)
            before = Pose(-placed.position, np.eye(3))
    return found, before, drives


def _kind(joint: _Joint, body: _Body, values: MjcfValues) -> tuple[bool, float, float, float, bool]:
    """Whether a joint slides, its reference, its limits, and whether they are the file's own."""
    kind, name = joint.given.get("type", "hinge"), shortened(joint.name)
    if kind not in ("hinge", "slide"):
        raise InputError(
            f"joint '{name}' of body '{shortened(body.name)}' is of type {shortened(kind)}; only chains of hinges and "
            "slides are arms"
        )
    slides = kind == "slide"
    ref = values.joint_number(joint.given, "ref", slides, f"ref of joint '{name}'")
    span = values.limits(joint.given, slides)
    if span is None and slides:
        raise InputError(f"slide joint '{name}' has no range; give its lower and upper end in m")
    lower, upper = span or (-math.pi, math.pi)
    if lower >= upper:
        raise InputError(f"joint '{name}' has a range whose lower end is not below its upper end; correct it")
    return slides, ref, lower, upper, span is not None


def _ties(root: Element, values: MjcfValues, every: Mapping[str, _Joint]) -> dict[str, tuple[str, float, float]]:
    """For each joint that an equality constraint ties: the joint that it follows, or the world; ratio and offset."""
    found: dict[str, tuple[str, float, float]] = {}
    for tie in root.iterfind("equality/joint"):
        name, leader = tie.get("joint1", ""), tie.get("joint2", WORLD)
        if not truth(tie.get("active", "true")):
            continue
        if name not in every or (leader != WORLD and leader not in every):
            raise InputError(
                f"an equality constraint ties joint '{shortened(name)}' to '{shortened(leader)}', and one of them is "
                "no joint of the file; correct its name"
            )
        if name in found:
            raise InputError(f"two equality constraints tie joint '{shortened(name)}'; leave one active")
        shift, factor, *higher = values.polynomial(tie.get("polycoef", "0 1 0 0 0"), name, MOST_RATIO)
        if any(higher) and leader != WORLD:
            raise InputError(
                f"joint '{shortened(name)}' follows '{shortened(leader)}' by a curve; an arm's joints follow in "
                "proportion only"
            )
        found[name] = leader, factor, shift
    return found


def _refuse_loops(root: Element, bodies: Mapping[str, _Body], moved: set[str]) -> None:
    """A constraint between bodies closes a loop; one that holds a joint of the chain makes it no open chain."""
    for kind in ("connect", "weld"):
        for tie in root.iterfind(f"equality/{kind}"):
            if not truth(tie.get("active", "true")):
                continue
            ends = [tie.get("body1"), tie.get("body2")]
            ends = [f"site {tie.get(f'site{i + 1}')}" if tie.get("site1") else end for i, end in enumerate(ends)]
            held = [end for end in ends if end in bodies]
            if any(bodies[end].mocap for end in held if end is not None):
                continue  # a handle by which a program moves the model
            ways = [set(_above(bodies, end)) for end in held if end is not None]
            across = ways[0] ^ ways[1] if len(ways) == 2 else ways[0] if ways else set()
            if caught := across & moved:
                raise InputError(
                    f"a {kind} constraint closes a loop through body '{shortened(min(caught))}'; an arm is an open "
                    "chain, so name a tip before the loop"
                )
