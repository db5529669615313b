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

import numpy as np

from pickenv.arm.files.arm import MOST_RATIO, Arm
from pickenv.arm.files.flange import Carried, flange
from pickenv.arm.files.joint_chain import ChainJoint, Drive, JointRow, driver_of
from pickenv.arm.files.mjcf_values import Attributes, MjcfValues, truth
from pickenv.arm.files.xml_values import xml_root
from pickenv.arm.kinematics.geometry import Pose, behind, identity_pose
from pickenv.errors import InputError
from pickenv.texts import is_file, listed, shortened
from pickenv.toml_tables import M

Element = ElementTree.Element
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
