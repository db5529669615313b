"""MJCF out: any chain as a MuJoCo model with joints, limits, position drives and a site at the tool.

Forward kinematics are exact. Masses are not known of an arm's table: each link is a rod of `DENSITY`, so that inertias
are valid and a simulation runs; they say nothing about the real arm. Metres, radians, kg.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.link_origins import link_origins
from pickenv.arm.files.urdf_text import ROD_RADIUS, leading_links
from pickenv.arm.files.xml_values import numbers_text
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose
from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.texts import one_line

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


def write_mjcf(geometry: Geometry, path: str | Path, name: str = "arm", comment: str = "") -> Path:
    """Write `mjcf_text` to a file, whole or not at all."""
    return write_text(path, mjcf_text(geometry, name, comment))


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
