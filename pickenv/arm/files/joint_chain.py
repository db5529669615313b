"""The joints of an arm's description, one after another, as a `Geometry`: what readers of URDF and of MJCF share.

Joints that follow another are no joints of the arm: one joint moves their links too
(`pickenv.arm.kinematics.geometry.Coupling`), whether it stands in the chain or beside it. Slides that follow one
another and are moved by one joint are one slide, exactly: two stages of a lift give one link whose ratio is the sum
of theirs, along the sum of their directions. Offsets go into the zero position, and a joint's limits and speed are
what every link that it moves allows. Metres and radians.
"""

from __future__ import annotations

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
        """The arm that the row makes, and the largest speeds of its drives; raises as `chain_geometry` does."""
        return chain_geometry(self.joints, self.tool, self.drives)

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
        chosen = "" if by_name else " by default its flange,"
        return Arm(self.name, f"{form} {path.name},{chosen} tip {self.tip}", geometry, None, speed)


@dataclass(frozen=True, eq=False)
class _Link:
    """A link that moves: by ``ratio`` times the value of the joint ``driver``, along or about ``direction`` (unit)."""

    driver: str
    ratio: float
    slides: bool
    point: Array
    direction: Array


def driver_of(name: str, followed: Callable[[str], tuple[str, float, float] | None]) -> tuple[str, float, float]:
    """The joint that moves a joint in the end, and the ratio and offset between their displacements.

    Args:
        name: The joint; it may follow one that follows another.
        followed: For a joint's name, the joint that it follows, with ratio and offset; None where it is driven.

    Raises:
        InputError: If it follows itself.
    """
    ratio, offset, passed, seen = 1.0, 0.0, name, {name}
    while (link := followed(passed)) is not None:
        passed, factor, shift = link
        if passed in seen:
            raise InputError(f"joint '{shortened(name)}' mimics itself; name the joint that is driven")
        seen.add(passed)
        ratio, offset = ratio * factor, offset + ratio * shift
    return passed, ratio, offset


def chain_geometry(joints: Sequence[ChainJoint], tool: Pose, drives: Mapping[str, Drive]) -> tuple[Geometry, Array]:
    """The arm that joints in a row make, and the largest speeds of its drives.

    Args:
        joints: From base to tip.
        tool: Pose of the tip in the frame of the last joint.
        drives: The drivers by name.

    Raises:
        InputError: If no joint moves, or limits or slides leave no motion.
    """
    links: list[_Link] = []
    found: dict[str, Drive] = {}
    here = identity_pose()
    for joint in joints:
        here = behind(here, joint.origin)
        direction = here.rotation @ joint.axis
        if joint.ratio:
            found[joint.driver] = _within(found.get(joint.driver, drives[joint.driver]), joint)
            links.append(_Link(joint.driver, joint.ratio, joint.slides, here.position, direction))
        here = behind(here, joint.motion(joint.offset))
    links = _one_slide_each(links)
    if not links:
        raise InputError("the chain to the tip has no moving joint; name a link that an arm moves")
    names = _in_order(links, found)
    prismatic = tuple(found[name].slides for name in names)
    points, directions = (np.array([getattr(link, key) for link in links]) for key in ("point", "direction"))
    lower, upper, speed = np.array([found[name][1:] for name in names]).T
    geometry = geometry_from_axes(names, prismatic, points, directions, behind(here, tool), lower, upper)
    slides, ratios = tuple(link.slides for link in links), tuple(link.ratio for link in links)
    coupling = Coupling(tuple(names.index(link.driver) for link in links), ratios, slides)
    alone = coupling == Coupling(tuple(range(len(names))), (1.0,) * len(names), prismatic)
    return geometry if alone else replace(geometry, coupling=coupling), speed


def _within(own: Drive, joint: ChainJoint) -> Drive:
    """A driver, narrowed to what a joint that follows it allows."""
    if joint.allowed is None:
        return own
    least, most, speed = joint.allowed
    ends = sorted(((least - joint.offset) / joint.ratio, (most - joint.offset) / joint.ratio))
    lower, upper = max(own.lower, ends[0]), min(own.upper, ends[1])
    if lower >= upper:
        raise InputError(
            f"joint '{shortened(joint.name)}' follows '{shortened(joint.driver)}', and their limits leave no motion; "
            "correct them"
        )
    return Drive(own.slides, lower, upper, min(own.speed, speed / abs(joint.ratio)))


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


def _in_order(links: list[_Link], drives: Mapping[str, Drive]) -> tuple[str, ...]:
    """The drivers' names: each stands where a link moves just as it does, or else where it first moves one."""
    places: dict[str, int] = {}
    for i, link in reversed(list(enumerate(links))):
        places[link.driver] = i
    for i, link in reversed(list(enumerate(links))):
        if link.ratio == 1.0 and link.slides == drives[link.driver].slides:
            places[link.driver] = i
    return tuple(sorted(places, key=places.__getitem__))
