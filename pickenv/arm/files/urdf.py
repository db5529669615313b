"""URDF in: any serial chain of revolute, continuous, prismatic and fixed joints of a tree becomes a `Geometry`.

Joints that mimic another are no joints of the arm; the joint that they follow moves their links too. Where no tip is
named, it is the flange (`pickenv.arm.files.flange`), and the arm's source says so.

Lengths in metres and angles in radians, as URDF has them; rpy is rotation about fixed x, y, z axes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.arm import MOST_RATIO, Arm
from pickenv.arm.files.flange import Carried, flange
from pickenv.arm.files.joint_chain import ChainJoint, Drive, JointRow, driver_of
from pickenv.arm.files.xml_values import xml_number, xml_numbers, xml_root
from pickenv.arm.kinematics.axes import PARALLEL
from pickenv.arm.kinematics.geometry import Array, Pose, behind, identity_pose
from pickenv.errors import InputError
from pickenv.texts import shortened
from pickenv.toml_tables import M_PER_S, RAD, RAD_PER_S, M

MOVING = {"revolute": False, "continuous": False, "prismatic": True}

Element = ElementTree.Element


def load_urdf(path: str | Path, tip: str | None = None, base: str | None = None) -> Arm:
    """Read the chain from link ``base`` to link ``tip`` of a URDF file.

    Args:
        path: The file.
        tip: Last link, whose frame is the tool; the flange when left out.
        base: First link, whose frame is the world; the root when left out.

    Raises:
        InputError: If the file, a link or a joint is unusable; the message names it.
    """
    path = Path(path)
    return urdf_row(path, tip, base).arm(path, "URDF", bool(tip))


def urdf_row(path: Path, tip: str | None = None, base: str | None = None) -> JointRow:
    """The joints that `load_urdf` makes an arm of.

    Raises:
        InputError: If the file, a link or a joint is unusable; the message names it.
    """
    root = xml_root(path, ".urdf")
    try:
        elements = [joint for joint in root.iter("joint") if joint.find("child") is not None]
        named = _unique(elements)
        chain, last = _chain(elements, tip, base)
        joints, tool, drives = _joints(chain, named)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    mount = str(chain[-1].get("name")) if chain[-1].get("type") == "fixed" else None
    return JointRow(
        shortened(root.get("name", path.stem)), _link(chain[0], "parent"), last, tuple(joints), tool, drives, mount
    )


def _joints(chain: list[Element], named: Mapping[str, Element]) -> tuple[list[ChainJoint], Pose, dict[str, Drive]]:
    """The joints of a row of elements, the tip in the last one's frame, and what drives them."""
    joints: list[ChainJoint] = []
    drives: dict[str, Drive] = {}
    before = identity_pose()  # from the last joint that moves
    for joint in chain:
        origin = joint.find("origin")
        turn = Rotation.from_euler("xyz", _numbers(origin, "rpy", joint)).as_matrix()
        before = behind(before, Pose(_numbers(origin, "xyz", joint), turn))
        kind = str(joint.get("type"))
        if kind == "fixed":
            continue
        if kind not in MOVING:
            raise InputError(
                f"joint {_name(joint)} has type '{shortened(kind)}'; only serial R and P chains are supported"
            )
        driver, ratio, offset = _driver(joint, named)
        axis = joint.find("axis")
        direction = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis, "xyz", joint)
        length = float(np.linalg.norm(direction))
        if length < PARALLEL:
            raise InputError(f"joint {_name(joint)} has an axis without direction; give a unit vector")
        name = str(driver.get("name"))
        if ratio:
            drives[name] = Drive(MOVING[str(driver.get("type"))], *_limits(driver))
        free = joint is driver or not ratio or kind == "continuous" or joint.find("limit") is None
        allowed = None if free else _limits(joint)
        shown = str(joint.get("name"))
        joints.append(ChainJoint(shown, name, ratio, offset, MOVING[kind], before, direction / length, allowed))
        before = identity_pose()
    return joints, before, drives


def _unique(joints: list[Element]) -> dict[str, Element]:
    """The joints by name; URDF asks for each name once, and for one joint before each link."""
    named: dict[str, Element] = {}
    before: dict[str, Element] = {}
    for joint in joints:
        name, child = str(joint.get("name")), _link(joint, "child")
        if name in named:
            raise InputError(f"joint {_name(joint)} is given twice; rename one")
        if child in before:
            raise InputError(
                f"link '{shortened(child)}' is the child of joints {_name(before[child])} and {_name(joint)}; "
                "give each link one joint before it"
            )
        named[name] = before[child] = joint
    return named


def _chain(joints: list[Element], tip: str | None, base: str | None) -> tuple[list[Element], str]:
    """The joints from ``base`` to ``tip``, and the tip; loops are refused."""
    above = {_link(joint, "child"): joint for joint in joints}
    checked: set[str] = set()
    for start in above:
        trail: set[str] = set()
        link = start
        while link in above and link not in checked:
            if link in trail:
                raise InputError(
                    f"joint {_name(above[link])} closes a loop: link '{shortened(link)}' stands on itself; an "
                    "arm is an open chain"
                )
            trail.add(link)
            link = _link(above[link], "parent")
        checked |= trail
    tip = tip or _flange(joints, above, base)
    chain: list[Element] = []
    link = tip
    while link in above and link != base:
        chain.append(above[link])
        link = _link(above[link], "parent")
    if not chain or (base is not None and link != base):
        raise InputError(
            f"no chain of joints leads from link '{shortened(base or 'root')}' to link '{shortened(tip)}'; "
            "name existing links"
        )
    return chain[::-1], tip


def _flange(joints: list[Element], above: Mapping[str, Element], base: str | None) -> str:
    """The link at which the arm's own joints end."""
    children: dict[str, list[Carried]] = {}
    for joint in joints:
        moving = () if joint.get("type") == "fixed" else (str(joint.get("name")),)
        children.setdefault(_link(joint, "parent"), []).append(Carried(_link(joint, "child"), moving))
    roots = [link for link in children if link not in above] or [""]
    return flange(children, base or roots[0])


def _driver(joint: Element, named: Mapping[str, Element]) -> tuple[Element, float, float]:
    """The joint that moves this one, and the multiplier and offset between them."""

    def mimicked(name: str) -> tuple[str, float, float] | None:
        mimic = named[name].find("mimic")
        if mimic is None:
            return None
        leader = mimic.get("joint", "")
        if leader not in named:
            raise InputError(
                f"joint {_name(named[name])} mimics '{shortened(leader)}', which is no joint of the file; name one "
                "that is"
            )
        words = [(mimic.get(key, default), key) for key, default in (("multiplier", "1"), ("offset", "0"))]
        owner = f"of joint {_name(named[name])}"
        multiplier, offset = (xml_number(text, f"{key} {owner}", MOST_RATIO) for text, key in words)
        return leader, multiplier, offset

    driver, ratio, offset = driver_of(str(joint.get("name")), mimicked)
    if str(named[driver].get("type")) not in MOVING:
        raise InputError(f"joint {_name(joint)} mimics {_name(named[driver])}, which does not move; name one that does")
    return named[driver], ratio, offset


def _limits(joint: Element) -> tuple[float, float, float]:
    """Lower and upper limit and speed of a joint; a continuous one is given one turn."""
    kind, limit = str(joint.get("type")), joint.find("limit")
    unit = "m" if MOVING[kind] else "rad"
    if limit is None and kind != "continuous":
        raise InputError(f"{kind} joint {_name(joint)} has no <limit>; give lower and upper in {unit}, and velocity")
    attributes = {} if limit is None else limit.attrib
    most, fastest = (M.most, M_PER_S.most) if unit == "m" else (RAD.most, RAD_PER_S.most)
    lower, upper = -np.pi, np.pi
    if kind != "continuous":
        lower, upper = (
            xml_number(attributes.get(key, "0"), f"{key} limit of joint {_name(joint)}", most)
            for key in ("lower", "upper")
        )
        if lower >= upper:
            raise InputError(
                f"joint {_name(joint)} has a lower limit of {lower:g} {unit}, not below its upper limit of "
                f"{upper:g} {unit}; correct them"
            )
    speed = xml_number(attributes.get("velocity", "1"), f"velocity limit of joint {_name(joint)}", fastest)
    if speed <= 0:
        raise InputError(
            f"the velocity limit of joint {_name(joint)} is {speed:g}; give the joint's largest speed in "
            f"{unit}/s, above zero"
        )
    return lower, upper, speed


def _link(joint: Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else str(element.get("link"))


def _name(joint: Element) -> str:
    return f"'{shortened(joint.get('name'))}'"


def _numbers(element: Element | None, key: str, joint: Element) -> Array:
    text = "0 0 0" if element is None else element.get(key, "0 0 0")
    return xml_numbers(text, f"{key} of joint {_name(joint)}", (RAD if key == "rpy" else M).most)
