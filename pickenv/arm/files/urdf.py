"""URDF in and out: any serial chain of revolute, continuous, prismatic and fixed joints becomes a `Geometry` and back.

Joints that mimic another are no joints of the arm: one joint moves their links too
(`pickenv.arm.kinematics.geometry.Coupling`), whether it stands in the chain or beside it. Slides that follow one
another and are moved by one joint are one slide, exactly: two stages of a lift give one link whose ratio is the sum
of theirs, along the sum of their directions. Offsets go into the zero position, and a joint's limits and speed are
what every link that it moves allows.

Lengths in metres and angles in radians, as URDF has them; rpy is rotation about fixed x, y, z axes.
"""

from __future__ import annotations

import codecs
import re
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pickenv.arm.files.arm import MOST_RATIO, Arm
from pickenv.arm.files.link_origins import link_origins
from pickenv.arm.kinematics.axes import PARALLEL, geometry_from_axes
from pickenv.arm.kinematics.geometry import Array, Coupling, Geometry, Pose, identity_pose
from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.texts import decimal_number, parsed, read_text, shortened
from pickenv.toml_tables import M_PER_S, RAD, RAD_PER_S, M

MOVING = {"revolute": False, "continuous": False, "prismatic": True}
ROD_RADIUS, SHORTEST_ROD = 0.015, 0.02
"""m; of the rods that viewers draw for the links. Kinematics do not look at them."""

Element = ElementTree.Element


@dataclass(frozen=True, eq=False)
class _Link:
    """A link that moves: by ``ratio`` times the value of the joint ``driver``, along or about ``direction`` (unit)."""

    driver: str
    ratio: float
    slides: bool
    point: Array
    direction: Array


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
    root = _root(path)
    try:
        geometry, speed, tip = _geometry(root, tip, base)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return Arm(shortened(root.get("name", path.stem)), f"URDF {path.name}, tip {tip}", geometry, None, speed)


def _geometry(root: Element, tip: str | None, base: str | None) -> tuple[Geometry, Array, str]:
    """The chain between two links, the largest speeds of its joints, and the name of its last link."""
    joints = [joint for joint in root.iter("joint") if joint.find("child") is not None]
    named = _unique(joints)
    chain, tip = _chain(joints, tip, base)
    limits: dict[str, tuple[float, float, float]] = {}
    links: list[_Link] = []
    rotation, position = np.eye(3), np.zeros(3)
    for joint in chain:
        origin = joint.find("origin")
        position = position + rotation @ _numbers(origin, "xyz")
        rotation = rotation @ Rotation.from_euler("xyz", _numbers(origin, "rpy")).as_matrix()
        kind = str(joint.get("type"))
        if kind == "fixed":
            continue
        if kind not in MOVING:
            raise InputError(
                f"joint {_name(joint)} has type '{shortened(kind)}'; only serial R and P chains are supported"
            )
        driver, ratio, offset = _driver(joint, named)
        axis = joint.find("axis")
        direction = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis, "xyz")
        length = float(np.linalg.norm(direction))
        if length < PARALLEL:
            raise InputError(f"joint {_name(joint)} has an axis without direction; give a unit vector")
        direction = rotation @ direction / length
        if ratio:
            name = str(driver.get("name"))
            own = _limits(driver)
            limits[name] = _within(limits.get(name, own), joint, driver, ratio, offset)
            links.append(_Link(name, ratio, MOVING[kind], position, direction))
        if MOVING[kind]:
            position = position + direction * offset
        else:
            rotation = Rotation.from_rotvec(direction * offset).as_matrix() @ rotation
    links = _one_slide_each(links)
    if not links:
        raise InputError(f"the chain to link '{shortened(tip)}' has no moving joint")
    names = _in_order(links, named)
    prismatic = tuple(MOVING[str(named[name].get("type"))] for name in names)
    points, directions = (np.array([getattr(link, key) for link in links]) for key in ("point", "direction"))
    lower, upper, speed = np.array([limits[name] for name in names]).T
    geometry = geometry_from_axes(names, prismatic, points, directions, Pose(position, rotation), lower, upper)
    slides, ratios = tuple(link.slides for link in links), tuple(link.ratio for link in links)
    coupling = Coupling(tuple(names.index(link.driver) for link in links), ratios, slides)
    alone = coupling == Coupling(tuple(range(len(names))), (1.0,) * len(names), prismatic)
    return geometry if alone else replace(geometry, coupling=coupling), speed, tip


def _root(path: Path) -> Element:
    """The XML of a file; entities, which can grow without end, are refused."""
    text = read_text(path, "a .urdf file")
    declared = re.match(r"""<\?xml[^>]*?encoding\s*=\s*["']([^"']*)""", text)
    if declared:
        encoding = parsed(lambda: codecs.lookup(declared[1]).name, path, "XML")
        if encoding != "utf-8" and not text.isascii():
            raise InputError(
                f"{path} says that its encoding is '{declared[1]}', but it is UTF-8; correct its first line"
            )
    if "<!ENTITY" in text:
        raise InputError(f"{path} declares XML entities, which no URDF needs; write their text out")
    return parsed(lambda: ElementTree.fromstring(text), path, "XML")


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
    """The joints from ``base`` to ``tip``, and the tip; each link's depth is counted once, and loops are refused."""
    above = {_link(joint, "child"): joint for joint in joints}
    depth: dict[str, int] = {}
    for start in above:
        trail: dict[str, Element] = {}
        link = start
        while link in above and link not in depth:
            if link in trail:
                raise InputError(
                    f"joint {_name(above[link])} closes a loop: link '{shortened(link)}' stands on itself; an "
                    "arm is an open chain"
                )
            trail[link] = above[link]
            link = _link(above[link], "parent")
        for count, passed in enumerate(reversed(trail), start=depth.get(link, 0) + 1):
            depth[passed] = count
    tip = tip or max(above, key=depth.__getitem__, default="")
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


def _driver(joint: Element, named: Mapping[str, Element]) -> tuple[Element, float, float]:
    """The joint that moves this one, and the multiplier and offset between them; a joint may mimic one that mimics."""
    ratio, offset, passed = 1.0, 0.0, joint
    seen = {joint.get("name")}
    while (mimic := passed.find("mimic")) is not None:
        followed = mimic.get("joint", "")
        if followed in seen:
            raise InputError(f"joint {_name(joint)} mimics itself; name the joint that is driven")
        seen.add(followed)
        if followed not in named:
            raise InputError(
                f"joint {_name(passed)} mimics '{shortened(followed)}', which is no joint of the file; name one that is"
            )
        words = [(mimic.get(key, default), key) for key, default in (("multiplier", "1"), ("offset", "0"))]
        multiplier, shift = (_number(text, f"{key} of joint {_name(passed)}", MOST_RATIO) for text, key in words)
        ratio, offset, passed = ratio * multiplier, offset + ratio * shift, named[followed]
    if str(passed.get("type")) not in MOVING:
        raise InputError(f"joint {_name(joint)} mimics {_name(passed)}, which does not move; name one that does")
    return passed, ratio, offset


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
            _number(attributes.get(key, "0"), f"{key} limit of joint {_name(joint)}", most)
            for key in ("lower", "upper")
        )
        if lower >= upper:
            raise InputError(
                f"joint {_name(joint)} has a lower limit of {lower:g} {unit}, not below its upper limit of "
                f"{upper:g} {unit}; correct them"
            )
    speed = _number(attributes.get("velocity", "1"), f"velocity limit of joint {_name(joint)}", fastest)
    if speed <= 0:
        raise InputError(
            f"the velocity limit of joint {_name(joint)} is {speed:g}; give the joint's largest speed in "
            f"{unit}/s, above zero"
        )
    return lower, upper, speed


def _within(
    own: tuple[float, float, float], joint: Element, driver: Element, ratio: float, offset: float
) -> tuple[float, float, float]:
    """Limits and speed of a driver, narrowed to what a joint that follows it allows."""
    if joint is driver or joint.get("type") == "continuous" or joint.find("limit") is None:
        return own
    lower, upper, speed = _limits(joint)
    ends = sorted(((lower - offset) / ratio, (upper - offset) / ratio))
    lower, upper = max(own[0], ends[0]), min(own[1], ends[1])
    if lower >= upper:
        raise InputError(
            f"joint {_name(joint)} follows {_name(driver)}, and their limits leave no motion; correct them"
        )
    return lower, upper, min(own[2], speed / abs(ratio))


def _one_slide_each(links: list[_Link]) -> list[_Link]:
    """Slides that follow one another commute: those of one driver are one slide along the sum of their directions."""
    found: list[_Link] = []
    first = 0  # of the slides that follow one another
    for link in links:
        same = [i for i in range(first, len(found)) if found[i].driver == link.driver]
        if link.slides and same:
            mine = found[same[0]]
            along = mine.ratio * mine.direction + link.ratio * link.direction
            length = float(np.linalg.norm(along))
            if length < PARALLEL:
                raise InputError(
                    f"joint '{shortened(link.driver)}' moves two slides that cancel each other; correct the "
                    "multiplier of the one that mimics"
                )
            ratio = length if along @ mine.direction >= 0 else -length  # the first slide's direction is kept
            found[same[0]] = replace(mine, ratio=ratio, direction=along / ratio)
            continue
        found.append(link)
        if not link.slides:
            first = len(found)
    return found


def _in_order(links: list[_Link], named: Mapping[str, Element]) -> tuple[str, ...]:
    """The drivers' names: each stands where a link moves just as it does, or else where it first moves one."""
    places: dict[str, int] = {}
    for i, link in reversed(list(enumerate(links))):
        places[link.driver] = i
    for i, link in reversed(list(enumerate(links))):
        if link.ratio == 1.0 and link.slides == MOVING[str(named[link.driver].get("type"))]:
            places[link.driver] = i
    return tuple(sorted(places, key=places.__getitem__))


def _link(joint: Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else str(element.get("link"))


def _name(joint: Element) -> str:
    return f"'{shortened(joint.get('name'))}'"


def _numbers(element: Element | None, key: str) -> Array:
    text = "0 0 0" if element is None else element.get(key, "0 0 0")
    parts = [decimal_number(part) for part in text.split()]
    values = np.array([np.nan if part is None else part for part in parts])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(f"'{shortened(text)}' is not three numbers ({key})")
    most = (RAD if key == "rpy" else M).most
    if np.abs(values).max() > most:
        raise InputError(f"{key} '{shortened(text)}' has a number above {most:g}, which no arm has")
    return values


def _number(text: str, owner: str, most: float) -> float:
    value = decimal_number(text)
    if value is None or not np.isfinite(value):
        raise InputError(f"the {owner} is '{shortened(text)}'; give a finite number")
    if abs(value) > most:
        raise InputError(f"the {owner} is {value:g}; no arm has more than {most:g} there")
    return value


def urdf_text(geometry: Geometry, name: str, speed: Array | None = None) -> str:
    """A URDF of the chain, one joint per link, ``base`` to ``tool``; exact, so forward kinematics agree to rounding.

    Each link is drawn as a rod to the next joint, and a slide as a rod back to where it starts. Where a joint moves
    several links, those after its own mimic it; where it moves none as it moves itself, it stands beside the chain.
    Characters that XML cannot hold are left out of names.
    """
    robot = Element("robot", name=_printable(name))
    body = ElementTree.SubElement(robot, "link", name="base")
    parent = "base"
    speeds = np.ones(geometry.joints) if speed is None else speed
    leaders, titles = leading_links(geometry), [_printable(title) for title in geometry.joint_names]
    owners = range(geometry.links) if geometry.coupling is None else geometry.coupling.joint
    ratios = (1.0,) * geometry.links if geometry.coupling is None else geometry.coupling.ratio
    links = zip(owners, ratios, geometry.slides, link_origins(geometry), strict=True)
    for i, (owner, ratio, slides, origin) in enumerate(links):
        link = f"link{i + 1}"
        _rod(body, origin.position)
        body = ElementTree.SubElement(robot, "link", name=link)
        ends = sorted((ratio * float(geometry.lower[owner]), ratio * float(geometry.upper[owner])))
        if slides:
            _rod(body, np.array([0.0, 0.0, -ends[1]]))
        title = titles[owner] if leaders[owner] == i else _printable(geometry.link_names[i])
        if leaders[owner] != i and title == titles[owner]:
            title += " (follows)"
        joint = _joint(robot, title, slides, parent, link, origin, (*ends, abs(ratio) * speeds[owner]))
        if leaders[owner] != i:
            ElementTree.SubElement(joint, "mimic", joint=titles[owner], multiplier=repr(ratio), offset="0.0")
        parent = link
    for owner, leader in enumerate(leaders):
        if leader is None:  # what is commanded moves no link as it moves itself: a drive of its own, beside the chain
            drive = f"drive{owner + 1}"
            ElementTree.SubElement(robot, "link", name=drive)
            most = (geometry.lower[owner], geometry.upper[owner], speeds[owner])
            _joint(robot, titles[owner], geometry.prismatic[owner], "base", drive, identity_pose(), most)
    _rod(body, geometry.tool.position)
    ElementTree.SubElement(robot, "link", name="tool")
    _joint(robot, "tool_mount", None, parent, "tool", geometry.tool)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def leading_links(geometry: Geometry) -> list[int | None]:
    """For each joint, the first link that moves just as the joint does; None where there is none."""
    found: list[int | None] = []
    for joint, slides in enumerate(geometry.prismatic):
        links = [i for i, ratio in geometry.links_of(joint) if ratio == 1.0 and geometry.slides[i] == slides]
        found.append(links[0] if links else None)
    return found


def _printable(name: str) -> str:
    return "".join(c if c.isprintable() else " " for c in name)


def _joint(
    robot: Element, name: str, slides: bool | None, parent: str, child: str, origin: Pose, limits: Sequence[float] = ()
) -> Element:
    """A joint along or about z with its lower and upper limit and speed; fixed where ``slides`` is None."""
    kind = "fixed" if slides is None else "prismatic" if slides else "revolute"
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    with warnings.catch_warnings():  # at pitch 90 deg roll is set to zero, which is as good an answer as any
        warnings.filterwarnings("ignore", message="Gimbal lock")
        rpy = Rotation.from_matrix(origin.rotation).as_euler("xyz")
    ElementTree.SubElement(joint, "origin", xyz=_text(origin.position), rpy=_text(rpy))
    if slides is not None:
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
        ends = dict(zip(("lower", "upper", "velocity"), map(_text, limits), strict=True))
        ElementTree.SubElement(joint, "limit", {**ends, "effort": "0"})
    return joint


def _text(numbers: ArrayLike) -> str:
    return " ".join(repr(float(number)) for number in np.atleast_1d(numbers))


def _rod(link: Element, end: Array) -> None:
    """Draw a link as a rod from its origin to ``end``, m."""
    length = float(np.linalg.norm(end))
    if length < SHORTEST_ROD:
        return
    tilt = np.arccos(end[2] / length), np.arctan2(end[1], end[0])
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=_text(end / 2.0), rpy=f"0 {_text(tilt)}")
    shape = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(shape, "cylinder", length=repr(length), radius=repr(ROD_RADIUS))


def write_urdf(geometry: Geometry, path: str | Path, name: str = "arm", speed: Array | None = None) -> Path:
    """Write `urdf_text` to a file, whole or not at all."""
    return write_text(path, urdf_text(geometry, name, speed))
