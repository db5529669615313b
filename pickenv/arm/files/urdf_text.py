"""URDF out: a chain as rods from joint to joint, exact, so that forward kinematics agree to rounding.

Lengths in metres and angles in radians, as URDF has them; rpy is rotation about fixed x, y, z axes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pickenv.arm.files.link_origins import link_origins
from pickenv.arm.files.xml_values import numbers_text
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose, identity_pose
from pickenv.files import write_text
from pickenv.texts import one_line

ROD_RADIUS, SHORTEST_ROD = 0.015, 0.02
"""m; of the rods that viewers draw for the links. Kinematics do not look at them."""

MASS, INERTIA, EFFORT = 0.1, 1e-4, 100.0
"""Of every moving link and joint, since simulators load nothing that weighs or lifts nothing; no arm's own."""

Element = ElementTree.Element


def urdf_text(geometry: Geometry, name: str, speed: Array | None = None) -> str:
    """A URDF of the chain, one joint per link, ``base`` to ``tool``; exact, so forward kinematics agree to rounding.

    Each link is drawn as a rod to the next joint, and a slide as a rod back to where it starts. Where a joint moves
    several links, those after its own mimic it; where it moves none as it moves itself, it stands beside the chain.
    Characters that XML cannot hold are left out of names.
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
    """For each joint, the first link that moves just as the joint does; None where there is none."""
    found: list[int | None] = []
    for joint, slides in enumerate(geometry.prismatic):
        links = [i for i, ratio in geometry.links_of(joint) if ratio == 1.0 and geometry.slides[i] == slides]
        found.append(links[0] if links else None)
    return found


def _moving_link(robot: Element, name: str) -> Element:
    link = ElementTree.SubElement(robot, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "mass", value=repr(MASS))
    moments = {
        axes: repr(INERTIA if axes[1] == axes[2] else 0.0) for axes in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    }
    ElementTree.SubElement(inertial, "inertia", moments)
    return link


def _joint(
    robot: Element, name: str, slides: bool | None, parent: str, child: str, origin: Pose, limits: Sequence[float] = ()
) -> Element:
    """A joint along or about z with its lower and upper limit and speed; fixed where ``slides`` is None."""
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
    """Angles (3,), rad, about fixed x, y, z of a rotation R = Rz(yaw) Ry(pitch) Rx(roll); exact at any pitch."""
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    sine, cosine = np.sin(roll), np.cos(roll)
    # With the roll taken off what remains is Rz Ry, whose second column is (-sin yaw, cos yaw, 0).
    yaw = np.arctan2(sine * rotation[0, 2] - cosine * rotation[0, 1], cosine * rotation[1, 1] - sine * rotation[1, 2])
    return np.array([roll, pitch, yaw])


def _rod(link: Element, end: Array) -> None:
    """Draw a link as a rod from its origin to ``end``, m."""
    length = float(np.linalg.norm(end))
    if length < SHORTEST_ROD:
        return
    tilt = np.arccos(end[2] / length), np.arctan2(end[1], end[0])
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=numbers_text(end / 2.0), rpy=f"0 {numbers_text(tilt)}")
    shape = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(shape, "cylinder", length=repr(length), radius=repr(ROD_RADIUS))


def write_urdf(geometry: Geometry, path: str | Path, name: str = "arm", speed: Array | None = None) -> Path:
    """Write `urdf_text` to a file, whole or not at all."""
    return write_text(path, urdf_text(geometry, name, speed))
