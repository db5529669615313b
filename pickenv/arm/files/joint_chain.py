"""Functions that the readers and writers of URDF and MJCF share: parse the file, and make its joints a `Geometry`.

A joint that follows another does not count as a joint of the arm. The followed joint, in the chain or beside it, moves
the links of both (`pickenv.arm.kinematics.geometry.Coupling`). Consecutive slides that one joint moves are equivalent
to one slide, whose motion is the sum of the slides' motions; so two stages of a lift become one link. Offsets become
part of the zero position. A joint's limits and speed are narrowed until all links that it moves allow them. Metres and
radians.
"""

from __future__ import annotations

import codecs
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pickenv.arm.files.arm import Arm, Load
from pickenv.arm.kinematics.forward import PARALLEL, chain_of, frames, geometry_from_axes, pose_of
from pickenv.arm.kinematics.geometry import (
    LINK_PARAMETERS,
    Array,
    Coupling,
    Geometry,
    LinkTree,
    Pose,
    behind,
    identity_pose,
)
from pickenv.base import KG, InputError, decimal_number, in_file, read_text, shortened
from pickenv.base.files import parsed

Element = ElementTree.Element


def xml_root(path: Path, ending: str) -> Element:
    """Return the root element of an XML file; entities are refused, because they can expand without limit.

    Args:
        path: The file.
        ending: Kind of the file in error messages, such as ".urdf".

    Raises:
        InputError: If the file cannot be read, is no XML, or declares entities.
    """
    text = read_text(path, f"a {ending} file")
    if declared := re.match(r"""<\?xml[^>]*?encoding\s*=\s*["']([^"']*)""", text):
        encoding = parsed(lambda: codecs.lookup(declared[1]).name, path, "XML")
        if encoding != "utf-8" and not text.isascii():
            raise InputError(f"{path} says its encoding is '{declared[1]}', but it is UTF-8; correct its first line")
    if "<!ENTITY" in text:
        raise InputError(f"{path} declares XML entities, which no arm needs; write their text out")
    return parsed(lambda: ElementTree.fromstring(text), path, "XML")


def xml_numbers(text: str, key: str, most: float, count: int = 3) -> Array:
    """Return the numbers that an attribute's text lists, ``(count,)``.

    Args:
        text: The attribute's text.
        key: Name of the attribute in error messages.
        most: Largest absolute value allowed.
        count: How many numbers the text must have: 2, 3, 4 or 6.

    Raises:
        InputError: If the text is not ``count`` finite numbers, or one of them is too large.
    """
    values = np.array([decimal_number(part) for part in text.split()], dtype=float)  # not a number where it is none
    if values.shape != (count,) or not np.isfinite(values).all():
        counted = {2: "two", 3: "three", 4: "four", 6: "six"}[count]
        raise InputError(f"'{shortened(text)}' is not {counted} numbers ({key})")
    if np.abs(values).max() > most:
        raise InputError(f"{key} '{shortened(text)}' has a number above {most:g}, which no arm has")
    return values


def xml_number(text: str, owner: str, most: float) -> float:
    """Return the number in an attribute's text.

    Args:
        text: The attribute's text.
        owner: What the number is, for error messages: "offset of joint 'J1'".
        most: Largest absolute value allowed.

    Raises:
        InputError: If the text is no number, or the number is too large.
    """
    value = decimal_number(text)
    if value is None or not np.isfinite(value):
        raise InputError(f"the {owner} is '{shortened(text)}'; give a finite number")
    if abs(value) > most:
        raise InputError(f"the {owner} is {value:g}; no arm has more than {most:g} there")
    return value


def xml_mass(text: str, owner: str) -> float:
    """Return the mass of a link or body, kg, from an attribute's text; ``owner`` is the link or body in messages.

    Raises:
        InputError: If the text is no number, or the number is negative or too large.
    """
    kg = xml_number(text, f"mass of {owner}", KG.most)
    if kg < 0.0:
        raise InputError(f"{owner} has a mass of {kg:g} kg; give one from 0")
    return kg


def unit_vector(values: Array, what: str) -> Array:
    """Return the unit vector in the direction of ``values``; ``what`` names the vector in error messages.

    Raises:
        InputError: If ``values`` is the zero vector.
    """
    if (length := float(np.linalg.norm(values))) < PARALLEL:
        raise InputError(f"{what} has no direction; give a unit vector")
    return values / length


def numbers_text(numbers: ArrayLike) -> str:
    """Return numbers as the text of an attribute, separated by spaces, with all their digits."""
    return " ".join(repr(float(number)) for number in np.atleast_1d(numbers))


def link_origins(geometry: Geometry) -> list[Pose]:
    """Return the pose of each link in the frame of the previous link, with joints at zero.

    The first pose includes the base, so it is in the world frame. A pose is the whole product Rx(alpha) Tx(a) Ry(beta)
    Rz(theta) Tz(d); a joint turns about, or slides along, z of the resulting frame.
    """
    origins, before = [], geometry.base
    for i in range(geometry.links):
        turn = Rotation.from_euler("XYZ", [geometry.alpha[i], geometry.beta[i], geometry.theta[i]]).as_matrix()
        local = np.array([geometry.a[i], 0.0, 0.0]) + geometry.d[i] * turn[:, 2]
        origins.append(behind(before, Pose(local, turn)))
        before = identity_pose()
    return origins


# Which link of a tree is the arm's flange, where nobody names one: never a finger, a wheel or a head. From the root on,
# the way leads where joints move. It ends where the chain branches or where only a gripper's joints follow; of the
# links that are fixed to its end, the one that its maker calls the flange is taken.


GRIPPERS = re.compile("finger|gripper|jaw|knuckle|thumb|claw|pinch|grasp", re.IGNORECASE)
"""Pattern of words by which the names of gripper joints are recognised."""

FLANGES = ("tool0", "flange", "attachment_site")
"""Names of the flange by convention, most specific first: ROS-Industrial, REP 199, MuJoCo Menagerie. A link's name may
have a prefix before them."""

SIDE = 2
"""A branch (wheels, a head, a pinion) is ignored if another branch has at least `SIDE` times as many joints."""


class Carried(NamedTuple):
    """A child link, and the names of the moving joints between parent and child; no names if the child is fixed.

    ``only_named`` is True for a link that only marks a place (an MJCF site). Such a link is taken as the flange only if
    it has one of the names `FLANGES`.
    """

    link: str
    joints: tuple[str, ...]
    only_named: bool = False


def flange(children: Mapping[str, Sequence[Carried]], root: str) -> str:
    """Find the flange, the link to which a tool is bolted, and return its name.

    Args:
        children: The children of each link, by the link's name; together they are a tree.
        root: Name of the root link.

    Raises:
        InputError: If the tree branches into two long chains: the longest has fewer than `SIDE` times the joints of the
            second-longest. There is no error if the chain from the root to the branching has more joints than the
            second-longest: the arm then ends at the branching.
    """
    order = [root]
    for link in order:  # grows as it is walked
        order += [branch.link for branch in children.get(link, ())]
    hands = _hands(children, order)
    below: dict[str, int] = {}  # most joints in a row behind a link, grippers left out

    def length(branch: Carried) -> int:
        return 0 if branch.link in hands else len(branch.joints) + below[branch.link]

    for link in reversed(order):
        below[link] = max(map(length, children.get(link, ())), default=0)
    link, passed = root, 0
    while branches := sorted(filter(length, children.get(link, ())), key=length, reverse=True):
        longest, second, *_ = *map(length, branches), 0
        if longest < SIDE * second:
            if passed > second:
                break
            names = " and ".join(f"'{shortened(branch.link)}'" for branch in branches[:2])
            where = f"the chain branches at link '{shortened(link)}' towards {names}"
            raise InputError(f"{where}; name the arm's last link, as in file#link")
        link, passed = branches[0].link, passed + len(branches[0].joints)
    fixed = [link]
    for end in fixed:
        fixed += [branch.link for branch in children.get(end, ()) if not branch.joints]
    for word in FLANGES:
        for end in fixed:
            if re.search(rf"(^|[^a-z0-9]){word}$", end, re.IGNORECASE):
                return end
    while True:  # onwards along what is fixed, as long as there is one way only
        branches = [branch for branch in children.get(link, ()) if not branch.only_named]
        if len(branches) != 1 or branches[0].joints:
            return link
        link = branches[0].link


def _hands(children: Mapping[str, Sequence[Carried]], order: Sequence[str]) -> set[str]:
    """Return the names of the gripper links.

    A joint with a gripper's name moves such a link, and all joints after the link have grippers' names too. The set is
    empty if all joints of the robot have grippers' names. ``children`` has the children of each link, by the link's
    name; ``order`` lists all links, parents first.
    """
    hands: set[str] = set()
    arms: set[str] = set()  # links behind which another joint stands
    for link in reversed(order):
        for branch in children.get(link, ()):
            if branch.link in arms or not all(map(GRIPPERS.search, branch.joints)):
                arms.add(link)
            elif branch.joints:
                hands.add(branch.link)
    return hands if order[0] in arms else set()


# The joints of an arm's description, one after another.


class Drive(NamedTuple):
    """A joint that is commanded: whether it slides, its limits in rad or m, and its largest speed in rad/s or m/s."""

    slides: bool
    lower: float
    upper: float
    speed: float


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """A joint between base and tip; its displacement is ``offset`` plus ``ratio`` times the driver's displacement.

    Attributes:
        name: Name of the joint, for messages.
        driver: Name of the commanded joint that drives this joint: its own name, or the name of the joint it follows.
        ratio: Displacement of this joint per displacement of the driver; 0 if it does not move.
        offset: Displacement of this joint if the driver is at zero, rad or m.
        slides: Whether the joint slides (else it turns).
        origin: Pose of the joint in the frame of the previous joint, or in the world frame for the first joint.
        axis: The joint's axis, a unit vector (3,) in its own frame.
        allowed: Smallest and largest displacement and largest speed, if these narrow the driver's limits; else None.
        body: Name of the body that the joint moves, if the file places bodies instead of joints (MJCF); else empty.
        within: Position of the joint in that body (3,), m.
    """

    name: str
    driver: str
    ratio: float
    offset: float
    slides: bool
    origin: Pose
    axis: Array
    allowed: tuple[float, float, float] | None = None
    body: str = ""
    within: Array = field(default_factory=lambda: np.zeros(3))

    def motion(self, value: float) -> Pose:
        """Return the pose of the moved link in the joint's frame, at the joint displacement ``value``, rad or m."""
        if self.slides:
            return Pose(value * self.axis, np.eye(3))
        return Pose(np.zeros(3), Rotation.from_rotvec(value * self.axis).as_matrix())


class Mass(NamedTuple):
    """The mass of one body of a robot file.

    Attributes:
        kg: The mass, kg; not a number if the file leaves it to the body's shapes.
        path: Names of the joints from the body to the root. Each name comes with the body's centre of mass (3,), m, in
            the frame of the link that this joint moves. The frame's origin is on the joint's axis. All joints between
            the link and the body are at zero.
    """

    kg: float
    path: tuple[tuple[str, Array], ...]


class JointRow(NamedTuple):
    """The chain of joints from the root of a robot file to a tip; "row" here means chain, not row of measurements.

    Attributes:
        name: Name of the robot in the file.
        root: Name of the first link.
        tip: Name of the last link.
        joints: The joints from root to tip, except fixed joints. The pose of a fixed joint is part of the origin of the
            next joint.
        tool: Pose of the tip in the frame of the last joint.
        drives: The commanded joints, by name.
        mount: What holds the tip: the name of a fixed joint (URDF), of a body without joints, or "site NAME" (MJCF).
            None if a moving joint holds the tip.
        masses: The masses of all bodies of the file, if it gives them.
    """

    name: str
    root: str
    tip: str
    joints: tuple[ChainJoint, ...]
    tool: Pose
    drives: Mapping[str, Drive]
    mount: str | None = None
    masses: tuple[Mass, ...] = ()

    def links(self, drives: dict[str, Drive]) -> tuple[list[ChainJoint], Pose]:
        """Return the moving joints, one per link, and the tip's pose, with all commanded joints at zero.

        The origins and axes of the joints, and the tip's pose, are in the world frame.

        Args:
            drives: Commanded joints by name, changed in place. Commanded joints of this chain are added. Their limits
                and speeds are narrowed until all joints that they move allow them.
        """
        links: list[ChainJoint] = []
        pose = identity_pose()
        for joint in self.joints:
            pose = behind(pose, joint.origin)
            if joint.ratio:
                drives[joint.driver] = _within(drives.get(joint.driver, self.drives[joint.driver]), joint)
                links.append(replace(joint, origin=pose, axis=pose.rotation @ joint.axis))
            pose = behind(pose, joint.motion(joint.offset))
        return list(map(_one_joint, links_of(links))), behind(pose, self.tool)


def arm_of(rows: Sequence[JointRow], path: Path, form: str, named: bool = True) -> Arm:
    """Return the arm that one chain of joints describes, or the whole robot that several chains describe.

    Args:
        rows: Chains of joints (`JointRow`): one for an arm; for a whole robot, one per part with a sensor or a target.
        path: The file, which becomes the arm's source.
        form: The file's format, such as "URDF".
        named: Whether the caller gave the tip; if not, the arm's source says that the tip is the flange by default.

    Raises:
        InputError: If `geometry_of` raises one; the message names the file.
    """
    with in_file(path):
        geometry, speed, load, pivots = geometry_of(rows)
    tips = ", ".join(row.tip for row in rows)
    end = f"{'' if named else ' by default its flange,'} tip {tips}" if len(rows) == 1 else f" whole robot with {tips}"
    return Arm(rows[0].name, f"{form} {path.name},{end}", geometry, None, speed, None, load, pivots)


def geometry_of(rows: Sequence[JointRow]) -> tuple[Geometry, Array, Load | None, Array]:
    """Return the geometry of an arm or of a whole robot, with joint speeds, masses and pivots.

    The chains of a whole robot share their first joints. The robot's link table holds one branch after another.

    Args:
        rows: Chains of joints (`JointRow`): one for an arm; for a whole robot, one per part with a sensor or a target.

    Returns:
        Four values. The first is the geometry. The second has the largest joint speeds ``(n,)``, rad/s or m/s. The
        third and the fourth are the attributes ``load`` and ``pivots`` of `Arm`.

    Raises:
        InputError: If no joint moves, if limits leave no motion, if two slides cancel each other, or if a chain
            branches off between two sections of a telescopic slide.
    """
    drives: dict[str, Drive] = {}
    joints: list[ChainJoint] = []  # of all branches, in the world's axes, each behind a fixed link of no motion
    zeros: list[Pose] = []  # their frames at zero joints
    parents: list[int] = []
    carriers: list[int] = []
    table, base, tool = np.zeros((5, 0)), identity_pose(), identity_pose()
    for row in rows:
        links, tip = row.links(drives)
        known = {joint.name: i for i, joint in enumerate(joints) if joint.ratio}
        shared = [known[link.name] for link in links if link.name in known]
        for link, i in zip(links, shared, strict=False):
            if (link.ratio, *link.axis) != (joints[i].ratio, *joints[i].axis):
                raise InputError(f"'{row.tip}' leaves slide '{link.name}' between two of its stages; name one end")
        last, branch = shared[-1] if shared else -1, links[len(shared) :]
        if branch:
            points, axes = [link.origin.position for link in branch], [link.axis for link in branch]
            if joints:
                stand = zeros[last] if last >= 0 else base
                points, axes = [stand.position, *points], [stand.rotation[:, 2], *axes]
            part = geometry_from_axes((), (), points, axes, tip, np.zeros(0), np.zeros(0))  # only its link table
            columns = np.stack([getattr(part, name) for name in LINK_PARAMETERS])
            if joints:  # the branch begins beside the link before, turned and shifted along its axis
                turn = stand.rotation.T @ part.base.rotation
                rise = float((part.base.position - stand.position) @ stand.rotation[:, 2])
                columns[:, 0] = 0.0, 0.0, np.arctan2(turn[1, 0], turn[0, 0]), rise, 0.0
                branch = [replace(branch[0], ratio=0.0, slides=False), *branch]
            else:
                base, tool = part.base, part.tool
            first = len(joints)
            parents += [last, *range(first, first + len(branch) - 1)]
            joints, table = [*joints, *branch], np.concatenate([table, columns], axis=1)
            numbers = dict(zip(LINK_PARAMETERS, columns, strict=True))
            still = replace(part, **numbers, base=stand if first else base, prismatic=(False,) * len(branch))
            zeros += [pose_of(frame) for frame in frames(math, chain_of(still), [0.0] * len(branch))[1:]]
            last = len(joints) - 1
        carriers.append(last)
    if not joints:
        ends, links_named = ("tip", "a link") if len(rows) == 1 else ("tips", "links")
        raise InputError(f"the chain to the {ends} has no moving joint; name {links_named} that an arm moves")
    names = _in_order([joint for joint in joints if joint.ratio], drives)
    prismatic, lower, upper, speed = zip(*(drives[name] for name in names), strict=True)
    ratios, slides = tuple(joint.ratio for joint in joints), tuple(joint.slides for joint in joints)
    coupling = Coupling(tuple(names.index(joint.driver) for joint in joints), ratios, slides)
    tree = LinkTree(tuple(parents), tuple(row.tip for row in rows), tuple(carriers), target=max(carriers))
    numbers = dict(zip(LINK_PARAMETERS, table, strict=True)) | {"lower": np.array(lower), "upper": np.array(upper)}
    geometry = Geometry(names, prismatic, **numbers, base=base, tool=tool, coupling=coupling, tree=tree)
    if len(rows) == 1:
        alone = coupling == Coupling(tuple(range(len(names))), (1.0,) * len(names), prismatic)
        geometry = replace(geometry, coupling=None if alone else coupling, tree=None)
    pairs = zip(joints, zeros, strict=True)
    pivots = np.array([zero.rotation[:, 2] @ (joint.origin.position - zero.position) for joint, zero in pairs])
    return geometry, np.array(speed), _load(rows[0].masses, joints, zeros), pivots


def _load(masses: Sequence[Mass], joints: Sequence[ChainJoint], zeros: Sequence[Pose]) -> Load | None:
    """Return the masses of the links; each body's mass is added to the last link in the table that carries the body.

    Return None if no body has a mass, if a mass is unknown, or if all masses are equal (placeholders).

    Args:
        masses: The masses of the bodies.
        joints: One joint per link, in world axes.
        zeros: Pose of each link in the world frame, with joints at zero.
    """
    places = {joint.name: i for i, joint in enumerate(joints) if joint.ratio}
    moments = np.zeros((len(joints), 4))
    carried: set[float] = set()
    for mass in masses:
        for name, centre in mass.path:
            if name in places:
                joint, zero = joints[places[name]], zeros[places[name]]
                motion = joint.motion(joint.offset)  # its axis is in the world's axes
                point = joint.origin.position + motion.position + motion.rotation @ joint.origin.rotation @ centre
                moments[places[name]] += mass.kg * np.r_[1.0, zero.rotation.T @ (point - zero.position)]
                carried.add(mass.kg)
                break
    kg = moments[:, 0]
    if len(carried) < 2 or np.isnan(kg).any():
        return None
    centres = moments[:, 1:] / np.where(kg > 0.0, kg, 1.0)[:, None]
    return Load(tuple(kg.tolist()), tuple(map(tuple, centres.tolist())))


def driver_of(name: str, followed: Callable[[str], tuple[str, float, float] | None]) -> tuple[str, float, float]:
    """Find the commanded joint that drives a joint, over any number of joints that follow one another.

    Args:
        name: Name of the driven joint.
        followed: Function that returns, for a joint's name, the joint that it follows, with ratio and offset. It
            returns None for a joint that follows no other.

    Returns:
        Three values: the commanded joint's name, a ratio, and an offset, rad or m. The driven joint's displacement is
        the offset plus the ratio times the commanded joint's displacement.

    Raises:
        InputError: If the joint follows itself.
    """
    ratio, offset, driver, names = 1.0, 0.0, name, {name}
    while (leader := followed(driver)) is not None:
        driver, factor, shift = leader
        if driver in names:
            raise InputError(f"joint '{shortened(name)}' mimics itself; name the joint that is driven")
        names.add(driver)
        ratio, offset = ratio * factor, offset + ratio * shift
    return driver, ratio, offset


def _within(driver: Drive, joint: ChainJoint) -> Drive:
    """Return ``driver`` with limits and speed narrowed until ``joint``, which the driver moves, allows them."""
    if joint.allowed is None:
        return driver
    least, most, speed = joint.allowed
    ends = sorted(((least - joint.offset) / joint.ratio, (most - joint.offset) / joint.ratio))
    lower, upper = max(driver.lower, ends[0]), min(driver.upper, ends[1])
    if lower >= upper:
        pair = f"joint '{shortened(joint.name)}' follows '{shortened(joint.driver)}'"
        raise InputError(f"{pair}, and their limits leave no motion; correct them")
    return Drive(driver.slides, lower, upper, min(driver.speed, speed / abs(joint.ratio)))


def links_of(joints: Sequence[ChainJoint]) -> list[list[ChainJoint]]:
    """Group joints by the link that they move together: one joint, or consecutive slides with the same driver.

    Joints with the ratio 0 are left out.
    """
    links: list[list[ChainJoint]] = []
    first = 0  # of the slides that follow one another
    for joint in joints:
        same = [link for link in links[first:] if joint.slides and link[0].driver == joint.driver]
        if joint.ratio and same:
            same[0].append(joint)
        elif joint.ratio:
            links.append([joint])
            first = first if joint.slides else len(links)
    return links


def _one_joint(link: Sequence[ChainJoint]) -> ChainJoint:
    """Return a link's joint; replace several slides by one slide along the ratio-weighted sum of their axes."""
    joint, *others = link
    if not others:
        return joint
    along = np.sum([slide.ratio * slide.axis for slide in link], axis=0)
    if (length := float(np.linalg.norm(along))) < PARALLEL:
        raise InputError(f"joint '{shortened(joint.driver)}' moves two slides that cancel each other; correct one")
    ratio = length if along @ joint.axis >= 0 else -length  # the first slide's direction is kept
    return replace(joint, ratio=ratio, axis=along / ratio)


def _in_order(links: list[ChainJoint], drives: Mapping[str, Drive]) -> tuple[str, ...]:
    """Return the names of the commanded joints ``drives`` in the order of their links in the table.

    The link of a commanded joint is the first link that the joint moves with the ratio 1 and with the joint's own type.
    If there is no such link, it is the first link that the joint moves. ``links`` has one joint per link.
    """

    def place(name: str) -> int:
        places = [i for i, link in enumerate(links) if link.driver == name]
        alike = [i for i in places if links[i].ratio == 1.0 and links[i].slides == drives[name].slides]
        return (alike or places)[0]

    return tuple(sorted(drives, key=place))
