"""Parts that readers and writers of URDF and of MJCF share: the flange of a tree, and joints in a row as a `Geometry`.

Joints that follow another are no joints of the arm: one joint moves their links too
(`pickenv.arm.kinematics.geometry.Coupling`), whether it stands in the chain or beside it. Slides that follow one
another and are moved by one joint are one slide, exactly: two stages of a lift give one link whose ratio is the sum
of theirs, along the sum of their directions. Offsets go into the zero position, and a joint's limits and speed are
what every link that it moves allows. Metres and radians.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.arm import Arm
from pickenv.arm.kinematics.forward import PARALLEL, geometry_from_axes
from pickenv.arm.kinematics.geometry import Array, Coupling, Geometry, Pose, behind, identity_pose
from pickenv.base import InputError, shortened


def link_origins(geometry: Geometry) -> list[Pose]:
    """Pose of each link in the link before it, its joint at zero; the base is part of the first.

    A joint then moves about, or along, its link's z: Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d) is all that is before it.
    """
    origins, before = [], geometry.base
    for i in range(geometry.links):
        twist = Rotation.from_euler("x", geometry.alpha[i])
        turn = twist * Rotation.from_euler("y", geometry.beta[i]) * Rotation.from_euler("z", geometry.theta[i])
        local = np.array([geometry.a[i], 0.0, 0.0]) + turn.as_matrix() @ np.array([0.0, 0.0, geometry.d[i]])
        origins.append(behind(before, Pose(local, turn.as_matrix())))
        before = identity_pose()
    return origins


# Which link of a tree is the arm's flange, where nobody names one: never a finger, a wheel or a head. From the root on,
# the way leads where joints move. It ends where the chain branches or where only a gripper's joints follow; of the
# links that are fixed to its end, the one that its maker calls the flange is taken.


GRIPPERS = re.compile("finger|gripper|jaw|knuckle|thumb|claw|pinch|grasp", re.IGNORECASE)
"""Words in the names of joints that move a gripper."""

FLANGES = ("tool0", "flange", "attachment_site")
"""Makers' names of the flange, surest first: ROS-Industrial, REP 199, MuJoCo Menagerie; each may have a prefix."""

SIDE = 2
"""A branch is passed by where the way beside it has at least so many times its joints: wheels, a head, a pinion."""


class Carried(NamedTuple):
    """A link and what holds it: the moving joints before it, by name; none where it is fixed.

    ``only_named`` says that it is a mere mark, which is the flange only where it is called so.
    """

    link: str
    joints: tuple[str, ...]
    only_named: bool = False


def flange(children: Mapping[str, Sequence[Carried]], root: str) -> str:
    """The link to which a tool is bolted.

    Args:
        children: What stands on each link; a tree.
        root: Where the arm stands.

    Raises:
        InputError: If the tree branches into arms, or into a gripper, before anything like an arm has moved.
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
            raise InputError(
                f"the chain branches at link '{shortened(link)}' towards {names}; name the arm's last link, "
                "as in file#link"
            )
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
    """Links behind whose joints, and before them, only joints named as a gripper's stand; none if all were."""
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
    """A joint that is commanded: whether it slides, its limits and its largest speed, rad or m, and per second."""

    slides: bool
    lower: float
    upper: float
    speed: float


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """A joint on the way from base to tip: it is displaced by ``offset`` plus ``ratio`` times its driver's value.

    Attributes:
        name: Its name, for messages.
        driver: Name of the joint that moves it: its own, or that of the joint that it follows.
        ratio: Displacement per displacement of the driver; 0 where it does not move.
        offset: Displacement at zero of the driver, rad or m.
        slides: Whether it slides (else it turns).
        origin: Its pose in the frame of the joint before, or of the world.
        axis: Unit vector (3,), in its own frame.
        allowed: Smallest and largest displacement and speed, where they narrow what the driver may do.
        body: Name of the body that it moves, where the file places bodies and not joints.
        within: Its place in that body (3,).
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
        """The pose, in the joint's own frame, of what it carries once displaced by ``value``, rad or m."""
        if self.slides:
            return Pose(value * self.axis, np.eye(3))
        return Pose(np.zeros(3), Rotation.from_rotvec(value * self.axis).as_matrix())


class JointRow(NamedTuple):
    """The joints of a file from its root to a tip, as its reader found them.

    Attributes:
        name: What the file calls the robot.
        root: Name of the first link.
        tip: Name of the last link.
        joints: Those that move, or may; what is fixed between them is part of their origins.
        tool: Pose of the tip in the frame of the last joint.
        drives: The drivers by name.
        mount: Name of the fixed joint, or of the site, that holds the tip; None where a moving joint does.
    """

    name: str
    root: str
    tip: str
    joints: tuple[ChainJoint, ...]
    tool: Pose
    drives: Mapping[str, Drive]
    mount: str | None = None

    def geometry(self) -> tuple[Geometry, Array]:
        """The arm that the row makes, and the largest speeds of its drives.

        Raises:
            InputError: If no joint moves, or limits or slides leave no motion.
        """
        links: list[ChainJoint] = []  # in the world's axes
        drives: dict[str, Drive] = {}
        pose = identity_pose()
        for joint in self.joints:
            pose = behind(pose, joint.origin)
            if joint.ratio:
                driver = drives.get(joint.driver, self.drives[joint.driver])
                drives[joint.driver] = _within(driver, joint)
                links.append(replace(joint, origin=pose, axis=pose.rotation @ joint.axis))
            pose = behind(pose, joint.motion(joint.offset))
        links = _one_slide_each(links)
        if not links:
            raise InputError("the chain to the tip has no moving joint; name a link that an arm moves")
        names = _in_order(links, drives)
        prismatic = tuple(drives[name].slides for name in names)
        points, axes = np.array([link.origin.position for link in links]), np.array([link.axis for link in links])
        lower, upper, speed = np.array([drives[name][1:] for name in names]).T
        geometry = geometry_from_axes(names, prismatic, points, axes, behind(pose, self.tool), lower, upper)
        slides, ratios = tuple(link.slides for link in links), tuple(link.ratio for link in links)
        coupling = Coupling(tuple(names.index(link.driver) for link in links), ratios, slides)
        alone = coupling == Coupling(tuple(range(len(names))), (1.0,) * len(names), prismatic)
        return geometry if alone else replace(geometry, coupling=coupling), speed

    def arm(self, path: Path, form: str, by_name: bool) -> Arm:
        """The arm of a file.

        Args:
            path: The file.
            form: Its format.
            by_name: Whether the tip was named; else the arm's source says which link was taken.

        Raises:
            InputError: As `geometry` does; the message names the file.
        """
        try:
            geometry, speed = self.geometry()
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        default = "" if by_name else " by default its flange,"
        return Arm(self.name, f"{form} {path.name},{default} tip {self.tip}", geometry, None, speed)


def driver_of(name: str, followed: Callable[[str], tuple[str, float, float] | None]) -> tuple[str, float, float]:
    """The joint that moves a joint in the end, and the ratio and offset between their displacements.

    Args:
        name: The joint; it may follow one that follows another.
        followed: For a joint's name, the joint that it follows, with ratio and offset; None where it is driven.

    Raises:
        InputError: If it follows itself.
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
    """A driver, narrowed to what a joint that follows it allows."""
    if joint.allowed is None:
        return driver
    least, most, speed = joint.allowed
    ends = sorted(((least - joint.offset) / joint.ratio, (most - joint.offset) / joint.ratio))
    lower, upper = max(driver.lower, ends[0]), min(driver.upper, ends[1])
    if lower >= upper:
        raise InputError(
            f"joint '{shortened(joint.name)}' follows '{shortened(joint.driver)}', and their limits leave no motion; "
            "correct them"
        )
    return Drive(driver.slides, lower, upper, min(driver.speed, speed / abs(joint.ratio)))


def _one_slide_each(links: list[ChainJoint]) -> list[ChainJoint]:
    """Slides that follow one another commute: those of one driver are one slide along the sum of their directions."""
    joined: list[ChainJoint] = []
    first = 0  # of the slides that follow one another
    for link in links:
        same = [i for i in range(first, len(joined)) if joined[i].driver == link.driver]
        if not (link.slides and same):
            joined.append(link)
            first = first if link.slides else len(joined)
            continue
        slide = joined[same[0]]
        along = slide.ratio * slide.axis + link.ratio * link.axis
        length = float(np.linalg.norm(along))
        if length < PARALLEL:
            raise InputError(
                f"joint '{shortened(link.driver)}' moves two slides that cancel each other; correct the "
                "multiplier of the one that mimics"
            )
        ratio = length if along @ slide.axis >= 0 else -length  # the first slide's direction is kept
        joined[same[0]] = replace(slide, ratio=ratio, axis=along / ratio)
    return joined


def _in_order(links: list[ChainJoint], drives: Mapping[str, Drive]) -> tuple[str, ...]:
    """The drivers' names: each stands where a link moves just as it does, or else where it first moves one."""

    def place(name: str) -> int:
        places = [i for i, link in enumerate(links) if link.driver == name]
        alike = [i for i in places if links[i].ratio == 1.0 and links[i].slides == drives[name].slides]
        return (alike or places)[0]

    return tuple(sorted(drives, key=place))
