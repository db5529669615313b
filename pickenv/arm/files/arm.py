"""An arm: its nominal geometry, its joint speeds and, if it is simulated, its true geometry."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.kinematics.forward import Scalar
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Coupling, Geometry, LinkTree, Pose
from pickenv.base import KG, MM, InputError, Then, fault, toml_table

MOST_RATIO = 1e3
"""Largest allowed ratio of a link's displacement to the displacement of the joint that moves it."""


def arm_in(context: Mapping[str, Any] | None) -> Arm | None:
    """Return the arm of the plant file that is being read, from the ``context`` that its reader passes on.

    Return None if no plant file is being read or the file names no arm.
    """
    return (context or {}).get("arm")


def _per_joint(values: Any, context: Any) -> Any:
    if (arm := arm_in(context)) is not None and len(values) != arm.nominal.joints:
        raise fault(f"{arm.nominal.joints} entries, one per joint")
    return values


PER_JOINT = Then(_per_joint)
"""Annotation of a list that must have one entry per joint of the arm."""


@toml_table
class Load:
    """The masses of an arm and its payload.

    Attributes:
        mass: Mass of each link (n,), kg.
        centre: Centre of mass of each link in the link's frame (n, 3), m.
        payload: Mass held at the tool's origin, kg.
    """

    mass: Annotated[tuple[Scalar, ...], KG.not_negative, PER_JOINT]
    centre: Annotated[tuple[tuple[float, float, float], ...], MM, PER_JOINT]
    payload: Annotated[Scalar, KG.not_negative] = 0.0


@dataclass(frozen=True, eq=False)
class Arm:
    """A named arm.

    Attributes:
        name: The name in the arm's file.
        source: Source of the arm's numbers.
        nominal: The geometry that the controller uses.
        true: The geometry as built, if the file gives one (simulated arms), else None.
        speed: Largest joint speeds, rad/s or m/s, shape (n,).
        tolerance_class: Name of the tolerance class of the arm's parts, if the file gives one, else None.
        load: The masses that the links carry, if the file gives them, else None.
        pivots: Position of each link's joint on its axis, as the distance from the origin of the link's frame (L,), m.
            None if the file does not place joints; each joint then is at the origin of its link's frame.
    """

    name: str
    source: str
    nominal: Geometry
    true: Geometry | None
    speed: Array
    tolerance_class: str | None = None
    load: Load | None = None
    pivots: Array | None = None

    def fingerprint(self) -> str:
        """Return the hash of the nominal geometry; a calibration is refused on an arm with another hash."""
        return self.nominal.fingerprint()

    def refuse_another(self, geometry: Geometry, what: str) -> None:
        """Raise an `InputError` unless ``geometry`` is this arm's nominal geometry.

        Args:
            geometry: The geometry for which something was made.
            what: Beginning of the message, which says what was made: "the calibration belongs to arm 'ur5'".
        """
        if geometry.fingerprint() != self.fingerprint():
            raise InputError(
                f"{what} with another geometry than '{self.name}'; give the file that it was made with, or calibrate "
                "this arm"
            )

    def holding(self, payload: float, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Arm:
        """Return the arm with a payload at the tool, as part of its last link.

        Args:
            payload: Mass of the payload, kg.
            centre: Centre of mass of the payload in the tool's frame (3,), m.

        Raises:
            InputError: If the arm has no masses or is a whole robot, a number is not finite, or the mass is negative.
        """
        if self.load is None:
            raise InputError(f"arm '{self.name}' has no masses, which a payload adds to; give a file with <inertial>")
        if self.nominal.tree is not None:
            raise InputError(f"arm '{self.name}' is a whole robot; add the payload to the mass of a link in its file")
        place = np.array(centre, dtype=float)
        if place.shape != (3,) or not np.isfinite([payload, *place]).all() or payload < 0.0:
            raise InputError(f"a payload of {payload:g} kg at {place}: give a mass from 0, and x, y and z in m")
        tool, mass, last = self.nominal.tool, list(self.load.mass), np.array(self.load.centre[-1])
        mass[-1] += payload
        shift = payload / mass[-1] if payload else 0.0
        last = last + shift * (tool.position + tool.rotation @ place - last)
        return replace(self, load=Load(tuple(mass), (*self.load.centre[:-1], tuple(last.tolist()))))


# A geometry as named arrays and back, for files: what comes back is checked, because it will move an arm.


ORTHONORMAL = 1e-9
"""Largest allowed deviation of an entry of R R^T from the identity, for a rotation matrix R. It is far above rounding
errors and far below errors that matter at the tool."""


def geometry_arrays(geometry: Geometry) -> dict[str, Array]:
    """Return the numbers of a geometry as arrays by name, for saving; joint names and joint types are not included."""
    arrays = {name: getattr(geometry, name) for name in (*LINK_PARAMETERS, "lower", "upper")}
    for key, pose in (("base", geometry.base), ("tool", geometry.tool)):
        arrays |= {f"{key}_position": pose.position, f"{key}_rotation": pose.rotation}
    if (coupling := geometry.coupling) is not None:
        arrays["coupling"] = np.array([coupling.joint, coupling.ratio, coupling.slides], dtype=float)
    if (tree := geometry.tree) is not None:
        arrays |= {"tree": np.array(tree.parent, dtype=float), "tree_names": np.array(tree.names)}
        arrays["tree_links"] = np.array([*tree.carriers, tree.sensor, tree.target], dtype=float)
    return arrays


def geometry_from_arrays(
    named: Mapping[str, NDArray[Any]], joint_names: Sequence[str], prismatic: Sequence[bool], which: str
) -> Geometry:
    """Rebuild a geometry from the arrays that `geometry_arrays` returned, after checking them.

    Args:
        named: The arrays by name.
        joint_names: One name per joint.
        prismatic: For each joint, whether it slides (else it turns).
        which: Name of the geometry in error messages, such as "nominal".

    Raises:
        KeyError: If an array is missing.
        InputError: If an array has a wrong shape or is not finite, if a matrix is no rotation, or if a lower limit is
            not below its upper limit.
    """
    if not all(isinstance(name, str) for name in joint_names) or not all(type(kind) is bool for kind in prismatic):
        raise InputError("joint names are text, and joint types are true (slides) or false (turns)")
    if len(joint_names) != len(prismatic) or not joint_names:
        raise InputError(f"{len(joint_names)} joint names are given for {len(prismatic)} joints")
    joints = len(prismatic)
    coupling = _coupling(named, joints, which) if "coupling" in named else None
    links = joints if coupling is None else len(coupling.joint)
    shapes = dict.fromkeys(LINK_PARAMETERS, (links,)) | dict.fromkeys(("lower", "upper"), (joints,))
    numbers = {name: finite(named, name, shape, which) for name, shape in shapes.items()}
    for name, lower, upper in zip(joint_names, numbers["lower"], numbers["upper"], strict=True):
        if lower >= upper:
            raise InputError(f"the lower limit of joint {name} in {which} is not below its upper limit")
    base, tool = (_pose(named, key, which) for key in ("base", "tool"))
    tree = _tree(named, links, which) if "tree" in named else None
    return Geometry(tuple(joint_names), tuple(prismatic), **numbers, base=base, tool=tool, coupling=coupling, tree=tree)


def _tree(named: Mapping[str, NDArray[Any]], links: int, which: str) -> LinkTree:
    """Return the saved `LinkTree` after checking it: each link's parent must come before the link.

    Args:
        named: The saved arrays by name.
        links: Number of links.
        which: Name of the geometry in error messages.
    """
    parts = tuple(str(name) for name in named["tree_names"])
    parent = tuple(map(int, finite(named, "tree", (links,), which)))
    *carriers, sensor, target = map(int, finite(named, "tree_links", (len(parts) + 2,), which))
    if any(not -1 <= stands < i for i, stands in enumerate(parent)) or not -1 <= min(carriers) <= max(carriers) < links:
        raise InputError(f"{which}/tree names a link that is not there, or comes later")
    return LinkTree(parent, parts, tuple(carriers), sensor, target)


def _coupling(named: Mapping[str, NDArray[Any]], joints: int, which: str) -> Coupling:
    """Return the saved `Coupling` after checking its joints, ratios and link types.

    Args:
        named: The saved arrays by name.
        joints: Number of joints.
        which: Name of the geometry in error messages.
    """
    joint, ratio, slides = finite(named, "coupling", (3, named["coupling"].shape[-1]), which).tolist()
    if not set(joint) <= set(range(joints)) or ("tree" not in named and 0.0 in ratio) or not set(slides) <= {0.0, 1.0}:
        raise InputError(f"{which}/coupling names a joint that is not there, a ratio of zero, or no kind of link")
    return Coupling(tuple(map(int, joint)), tuple(ratio), tuple(map(bool, slides)))


def finite(named: Mapping[str, NDArray[Any]], name: str, shape: tuple[int, ...], which: str) -> Array:
    """Return the array called ``name`` after checking that it has this shape and holds finite float64 numbers.

    Args:
        named: The arrays by name.
        name: Name of the array.
        shape: The required shape.
        which: Name of the array's owner in error messages.

    Raises:
        KeyError: If there is no such array.
        InputError: If the shape or the dtype is wrong, or a number is not finite.
    """
    value = named[name]
    if value.shape != shape or value.dtype != np.float64:
        raise InputError(f"{which}/{name} holds {value.dtype} of shape {value.shape}, not numbers of shape {shape}")
    if not np.isfinite(value).all():
        place = tuple(int(i) + 1 for i in np.argwhere(~np.isfinite(value))[0])
        raise InputError(f"{which}/{name} holds {value[~np.isfinite(value)][0]} at place {place}")
    return value


def _pose(named: Mapping[str, NDArray[Any]], key: str, which: str) -> Pose:
    position = finite(named, f"{key}_position", (3,), which)
    matrix = finite(named, f"{key}_rotation", (3, 3), which)
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ORTHONORMAL or np.linalg.det(matrix) < 0:
        raise InputError(f"{which}/{key}_rotation is not a rotation (orthonormal and right-handed)")
    return Pose(position, matrix)


# What a thing made of numbers holds, as a hash: equal content, equal hash, wherever it came from.


def content_sha256(*parts: Any) -> str:
    """Return one SHA-256 hash over the values of all ``parts`` (dataclasses, arrays, numbers, text), in hexadecimal."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=_plain).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Convert what JSON lacks: an array to lists, a dataclass to a mapping of its fields."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return {field.name: getattr(value, field.name) for field in fields(value)}
