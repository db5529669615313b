"""Read arms by name or from a file of any format. This module reads TOML files and UR kinematics files itself.

An arm's TOML file has its nominal link table, limits, base and tool. For a simulated arm it also has the link
parameters of the true arm. TOML files are in degrees and millimetres, as their keys say; objects are in radians and
metres. The shipped arms are in `pickenv/arm/files/arms`. A joint table with ``follows`` describes a link that
another joint moves. The link's displacement is ``ratio`` times the joint's displacement.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.files.arm import MOST_RATIO, Arm, Load
from pickenv.arm.files.joint_chain import ChainJoint, Drive, JointRow, geometry_of, xml_number
from pickenv.arm.kinematics.geometry import Array, Coupling, Geometry, Pose, from_standard_dh, identity_pose
from pickenv.arm.kinematics.task_space import rotation_matrix
from pickenv.base import InputError, in_file, read_text, register, registry, shortened, toml_tables, yaml_content

ARMS = Path(__file__).parent / "arms"

COLUMNS = ("alpha", "a", "theta", "d")
Type = toml_tables.Check(lambda value: value in ("R", "P"), "'R' (revolute) or 'P' (prismatic)")
NOT_ZERO = toml_tables.Check(lambda value: value != 0, "a number that is not 0")
Vector = tuple[float, float, float]


@toml_tables.toml_table
class JointTable:
    """The keys that all entries of [[joints]] in an arm file share: revolute, prismatic and following links.

    ``number`` counts the links from 1. ``alpha`` to ``beta`` are the nominal link parameters (`Geometry`); ``true_…``
    are the link parameters of the true arm. ``ratio`` is the link's displacement per displacement of the joint that
    moves it. ``mass`` and ``centre`` are the link's mass and centre of mass (`Load`).
    """

    _: KW_ONLY
    number: Annotated[int, toml_tables.WHOLE]
    name: Annotated[str, toml_tables.LINE] | None = None
    ratio: Annotated[float, toml_tables.Unit(most=MOST_RATIO), NOT_ZERO] = 1.0
    alpha: Annotated[float, toml_tables.DEG]
    a: Annotated[float, toml_tables.MM]
    theta: Annotated[float, toml_tables.DEG]
    d: Annotated[float, toml_tables.MM]
    beta: Annotated[float, toml_tables.DEG] = 0.0
    mass: Annotated[float, toml_tables.KG.not_negative] | None = None
    centre: Annotated[Vector, toml_tables.MM] = (0.0, 0.0, 0.0)
    true_alpha: Annotated[float, toml_tables.DEG] | None = None
    true_a: Annotated[float, toml_tables.MM] | None = None
    true_theta: Annotated[float, toml_tables.DEG] | None = None
    true_d: Annotated[float, toml_tables.MM] | None = None


@toml_tables.toml_table
class Revolute(JointTable):
    """An entry of [[joints]] in an arm file: a revolute joint and the link that it moves."""

    type: Annotated[Literal["R"], Type]
    lower: Annotated[float, toml_tables.DEG]
    upper: Annotated[float, toml_tables.DEG]
    speed: Annotated[float, toml_tables.DEG_PER_S.positive]


@toml_tables.toml_table
class Prismatic(JointTable):
    """An entry of [[joints]] in an arm file: a prismatic joint and the link that it moves."""

    type: Annotated[Literal["P"], Type]
    lower: Annotated[float, toml_tables.MM]
    upper: Annotated[float, toml_tables.MM]
    speed: Annotated[float, toml_tables.MM_PER_S.positive]


@toml_tables.toml_table
class Follower(JointTable):
    """An entry of [[joints]] in an arm file: a link without a joint of its own, which another link's joint moves.

    ``follows`` is the number, from 1, of that other link.
    """

    type: Annotated[Literal["R", "P"], Type]
    follows: Annotated[int, toml_tables.WHOLE]


def _kind(joint: Mapping[str, Any]) -> type[JointTable]:
    if "follows" in joint:
        return Follower
    slides = joint.get("type") == "P" or (joint.get("type") != "R" and "lower_mm" in joint)
    return Prismatic if slides else Revolute


@toml_tables.toml_table
class PoseTable:
    """The table [base] or [tool] of an arm file: a pose."""

    position: Annotated[Vector, toml_tables.MM] = (0.0, 0.0, 0.0)
    rotation_vector: Annotated[Vector, toml_tables.DEG] = (0.0, 0.0, 0.0)

    def pose(self) -> Pose:
        """Return the table's pose."""
        return Pose(np.array(self.position), rotation_matrix(np.array(self.rotation_vector)))


@toml_tables.toml_table
class ArmFile:
    """The content of an arm's TOML file; see `pickenv.arm.files.arm.Arm`."""

    joint_count: Annotated[int, toml_tables.WHOLE.positive]
    joints: Annotated[
        tuple[Annotated[Revolute | Prismatic | Follower, toml_tables.Kinds(_kind)], ...],
        toml_tables.Check(lambda value: isinstance(value, list), "one [[joints]] table per joint"),
    ]
    name: Annotated[str, toml_tables.LINE] = ""
    source: Annotated[str, toml_tables.LINE] = ""
    convention: Literal["modified", "standard"] = "modified"
    tolerance_class: Annotated[str, toml_tables.LINE] | None = None
    base: PoseTable = PoseTable()
    tool: PoseTable = PoseTable()

    def __post_init__(self) -> None:
        numbers = [joint.number for joint in self.joints]
        for number in range(1, self.joint_count + 1):
            if numbers.count(number) != 1:
                state = "given twice" if number in numbers else "missing"
                raise InputError(f"joint {number} is {state}; joint_count asks for 1 to {self.joint_count}, once each")
        if extra := [number for number in numbers if not 1 <= number <= self.joint_count]:
            raise InputError(f"joint number {extra[0]} is not in 1..{self.joint_count}; correct it or joint_count")
        leaders = {joint.number for joint in self.joints if not isinstance(joint, Follower)}
        for joint in self.joints:
            if isinstance(joint, Follower):
                if joint.follows not in leaders:
                    raise InputError(f"joint {joint.number} follows {joint.follows}; name a joint that follows none")
            elif joint.lower >= joint.upper:
                raise InputError(f"joint {joint.number} has a lower limit that is not below its upper limit")
            for key in COLUMNS if self.simulated else ():
                if getattr(joint, f"true_{key}") is None:
                    unit = "mm" if key in ("a", "d") else "deg"
                    raise InputError(f"true_{key}_{unit} of joint {joint.number} is missing; give all true_… or none")
        weighed = [joint.number for joint in self.joints if joint.mass is not None]
        if self.convention == "standard" and (self.simulated or weighed or any(joint.beta for joint in self.joints)):
            raise InputError("true_… values, beta_deg and mass_kg need convention = 'modified'")
        if bare := [joint.number for joint in self.joints if weighed and joint.mass is None]:
            raise InputError(f"mass_kg of joint {bare[0]} is missing; give the mass of every link, or of none")

    @property
    def simulated(self) -> bool:
        """Whether the file gives the true link parameters."""
        return any(getattr(joint, f"true_{key}") is not None for joint in self.joints for key in COLUMNS)


def read_arm(path: Path) -> Arm:
    """Read the arm that a TOML file describes.

    Raises:
        InputError: If the file is malformed; the message names file, line and joint or key.
    """
    file = toml_tables.read_toml(ArmFile, path)
    links = sorted(file.joints, key=lambda joint: joint.number)
    leaders = [link for link in links if not isinstance(link, Follower)]
    names = tuple(link.name if link.name is not None else f"J{link.number}" for link in leaders)
    prismatic = tuple(link.type == "P" for link in leaders)

    def column(key: str, among: list[Any] = links) -> Array:
        return np.array([getattr(link, key) for link in among], dtype=float)

    build: Any = from_standard_dh
    numbers: dict[str, Any] = {key: column(key) for key in COLUMNS}
    if file.convention == "modified":
        build, numbers["beta"] = Geometry, column("beta")
    limits = {key: column(key, leaders) for key in ("lower", "upper")}
    nominal: Geometry = build(names, prismatic, **numbers, **limits, base=file.base.pose(), tool=file.tool.pose())
    nominal = replace(nominal, coupling=_coupling(links, leaders))
    built: dict[str, Any] = {key: column(f"true_{key}") for key in COLUMNS} if file.simulated else {}
    true = replace(nominal, **built) if built else None
    masses, centres = (tuple(getattr(link, key) for link in links) for key in ("mass", "centre"))
    load = None if masses[0] is None else Load(masses, centres)
    return Arm(file.name, file.source, nominal, true, column("speed", leaders), file.tolerance_class, load)


def _coupling(links: list[Any], leaders: list[Any]) -> Coupling | None:
    """Return the joint that moves each link, from the entries' ``follows`` and ``ratio``.

    Return None if each joint moves its own link alone. ``links`` are the entries of [[joints]] in order,
    ``leaders`` the entries that have a joint of their own.
    """
    if len(leaders) == len(links) and all(link.ratio == 1.0 for link in links):
        return None
    order = {link.number: i for i, link in enumerate(leaders)}
    owners = (order[link.follows if isinstance(link, Follower) else link.number] for link in links)
    return Coupling(tuple(owners), tuple(link.ratio for link in links), tuple(link.type == "P" for link in links))


# A Universal Robots arm by its kinematics file: `default_kinematics.yaml` of ROS's `ur_description` (format of 2.x).
# `ur_calibration` writes such a file from what the maker measured of one robot and its controller keeps. Each of six
# joints turns about z of a frame that the file places in the frame before, by x, y, z in m and roll, pitch, yaw in
# rad about fixed axes. The base is the controller's (`base` of ROS), the tip its flange (`tool0`).


UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR_KEYS = dict.fromkeys("xyz", toml_tables.M.most) | dict.fromkeys(("roll", "pitch", "yaw"), toml_tables.RAD.most)
"""Keys of a link in a UR kinematics file, each with the largest absolute value allowed, m or rad."""

LIMITS_OF = "ur10e"
"""The arm whose limits and speeds are used, because a UR kinematics file has none; it is the slowest of its series."""


@register("arm_format", "yml")
@register("arm_format", "yaml")
def load_ur_yaml(path: str | Path, tip: str | None = None) -> Arm:
    """Read the arm of a UR kinematics file; its tool is the flange.

    Args:
        path: The file.
        tip: Must be None or empty, because the file has no other tip.

    Raises:
        InputError: If the file is no UR kinematics file, if a joint or a number is missing, or if ``tip`` is not empty.
            The message says which.
    """
    path = Path(path)
    if tip:
        raise InputError(f"{path} ends at the flange, and names no '{shortened(tip)}'; leave # and what follows out")
    row, mark = ur_row(path)
    geometry, speed, *_ = geometry_of([row])
    source = f"UR kinematics {path.name}{mark}; limits and speeds are those of {LIMITS_OF}, which the file has not"
    return Arm(path.stem, source, geometry, None, speed)


def ur_row(path: Path) -> tuple[JointRow, str]:
    """Read the chain of joints of a UR kinematics file.

    Returns:
        Two values. The first is the chain of joints, from which `load_ur_yaml` makes an arm. The second is a text to
        append to the arm's source: a comma and the hash of the robot in the file; empty if the file has no hash.

    Raises:
        InputError: If the file is no UR kinematics file, or a joint or a number is missing; the message names it.
    """
    content = yaml_content(read_text(path, "a UR kinematics file (.yaml)"), path)
    links = content.get("kinematics") if isinstance(content, Mapping) else None
    if not isinstance(links, Mapping):
        raise InputError(f"{path} has no 'kinematics'; give a UR kinematics file as ur_calibration writes it")
    like = read_arm(ARMS / f"{LIMITS_OF}.toml")
    limits = np.stack([like.nominal.lower, like.nominal.upper, like.speed], axis=1).tolist()
    drives = {name: Drive(False, *numbers) for name, numbers in zip(UR_JOINTS, limits, strict=True)}
    joints = []
    for link, name in zip(UR_LINKS, UR_JOINTS, strict=True):
        numbers = links.get(link)
        if not isinstance(numbers, Mapping) or any(key not in numbers for key in UR_KEYS):
            raise InputError(f"{path}: '{link}' of kinematics lacks one of {', '.join(UR_KEYS)}; give all six")
        with in_file(path):
            values = [xml_number(str(numbers[key]), f"{key} of {link}", most) for key, most in UR_KEYS.items()]
        origin = Pose(np.array(values[:3]), Rotation.from_euler("xyz", values[3:]).as_matrix())
        joints.append(ChainJoint(name, name, 1.0, 0.0, False, origin, np.array([0.0, 0.0, 1.0])))
    mark = f", {shortened(links['hash'])}" if "hash" in links else ""
    return JointRow(path.stem, "base", "tool0", tuple(joints), identity_pose(), drives), mark


def shipped_arms() -> list[str]:
    """Return the names of the arms that come with pickenv."""
    return toml_tables.shipped_in(ARMS)


def load_arm(name: str | Path, whole: bool = False) -> Arm:
    """Read a shipped arm by its name, or an arm from a TOML, URDF, MJCF or UR kinematics file.

    Args:
        name: Name or path: "ur5", "arm.toml", "arm.urdf#tip_link", "arm.xml#body_or_site", or the file
            "default_kinematics.yaml" of ROS's `ur_description`. Without a tip, the tool of a URDF or MJCF arm is the
            flange, and the arm's `source` names the link.
        whole: Whether several tips may be given, to read a whole robot: "robot.urdf#head,left_wrist,right_wrist".

    Raises:
        InputError: If the arm is unknown, or its file is malformed; the message names the file and the joint or key.
    """
    path, _, tip = str(name).partition("#")
    if "," in tip and not whole:
        raise InputError(f"{name} names several links, as `calibrate` takes a whole robot; name one here")
    ending = Path(path).suffix[1:].replace("xacro", "urdf")
    reader = registry.get("arm_format", ending) if ending in registry.names("arm_format") else load_toml
    return cast(Arm, reader(path, tip or None))


@register("arm_format", "toml")
def load_toml(path: str | Path, tip: str | None = None) -> Arm:
    """Read a shipped arm by its name, or an arm from a TOML file.

    Args:
        path: The name or the file.
        tip: Must be None or empty, because a TOML file gives the tool itself.

    Raises:
        InputError: If there is no such arm, or the file is malformed.
    """
    endings = ", ".join(f".{name}" for name in registry.names("arm_format"))
    file = toml_tables.file_named("arm", f"{path}#{tip}" if tip else path, ARMS, endings)
    return _read(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=32)
def _read(path: Path, _modified: int) -> Arm:
    return read_arm(path)
