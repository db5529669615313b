"""An arm as a serial chain of revolute and prismatic joints in modified DH parameters, with base and tool poses.

Link i is T(i-1,i) = Rot(x, alpha) Trans(x, a) Rot(y, beta) Rot(z, theta) Trans(z, d): Qiao 2026 eq (1), with Hayati's
beta added for consecutive parallel axes (zero in every nominal table). Units: metres and radians.

Where one drive moves several links (a two-stage lift, a parallelogram), links and joints are counted apart: the link
table has a row per link, and joint values, names and limits belong to the joints that are commanded (`Coupling`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

LINK_PARAMETERS = ("alpha", "a", "theta", "d", "beta")
FRAME_PARAMETERS = ("x", "y", "z", "rx", "ry", "rz")


class Pose(NamedTuple):
    """A pose, or a batch of them: position ``(..., 3)`` in metres and rotation matrix ``(..., 3, 3)``."""

    position: Array
    rotation: Array


def identity_pose() -> Pose:
    """The identity: the pose that moves nothing."""
    return Pose(np.zeros(3), np.eye(3))


def inverse_pose(pose: Pose) -> Pose:
    """The inverse of a pose ``(...)``: the pose of its reference frame, expressed in the frame of the pose."""
    back = np.swapaxes(pose.rotation, -1, -2)
    return Pose(-np.einsum("...ij,...j->...i", back, pose.position), back)


def behind(pose: Pose, after: Pose) -> Pose:
    """The pose ``after``, given in the frame ``pose``, expressed in the reference frame of ``pose``; or batches."""
    step = np.einsum("...ij,...j->...i", pose.rotation, after.position)
    return Pose(pose.position + step, pose.rotation @ after.rotation)


@dataclass(frozen=True)
class Coupling:
    """The joint that moves each link, where links move together: link i is displaced by ratio[i] q[joint[i]].

    A ratio of 0 marks a fixed link, with which a branch of a `LinkTree` begins.

    Where a link stands at zero joints is part of its theta or d.

    Attributes:
        joint: Index of the joint that moves the link, from 0, one per link (L,).
        ratio: Displacement of the link per displacement of its joint, rad or m per rad or m (L,).
        slides: Whether the link slides (L,); it may differ from its joint's kind (a rack and its pinion).
    """

    joint: tuple[int, ...]
    ratio: tuple[float, ...]
    slides: tuple[bool, ...]

    def displacements(self, q: Sequence[Any]) -> list[Any]:
        """The displacement of each link for joint values of any kind: floats, arrays or tensors."""
        return [ratio * q[joint] for joint, ratio in zip(self.joint, self.ratio, strict=True)]


@dataclass(frozen=True)
class LinkTree:
    """How the links of a whole robot stand on one another, and between which two of them a pose is meant.

    A pose leads from the link that carries a sensor to the link that carries its target: up the one branch, down the
    other. Frame 0, on which the robot stands, has the index -1.

    Attributes:
        parent: Index of the link that each link stands on (L,); it comes before that link.
        names: Names of the parts of the robot that may carry a sensor or a target.
        carriers: Index of the link that each of these parts is fixed to.
        sensor: Index of the link that carries the sensor.
        target: Index of the link that carries the target.
    """

    parent: tuple[int, ...]
    names: tuple[str, ...]
    carriers: tuple[int, ...]
    sensor: int = -1
    target: int = -1

    def carry(self, link: int) -> list[int]:
        """Indices of a link and of all that it stands on, frame 0 left out."""
        line = []
        while link >= 0:
            line.append(link)
            link = self.parent[link]
        return line


@dataclass(frozen=True, eq=False)
class Geometry:
    """Modified DH table of a serial chain with n joints and L links, its base and tool poses and its joint limits.

    Of a whole robot it is the table of all branches, one behind another (`LinkTree`). A branch begins with a fixed
    link, which no joint moves: its theta and d say where on the axis before it the branch leaves.

    Attributes:
        joint_names: One name per joint, as messages and tables print it.
        prismatic: For each joint, whether it slides (else it turns), shape (n,).
        alpha: Twist alpha(i-1) of each link, rad, shape (L,); L = n without a coupling. All five link parameters may
            carry leading batch dimensions (one table per arm).
        a: Length a(i-1) of each link, m.
        theta: Joint angle at zero displacement, rad; a revolute joint's displacement adds to it.
        d: Offset at zero displacement, m; a prismatic joint's displacement adds to it.
        beta: Hayati's second twist, rad, about y after Trans(x, a).
        lower: Lower joint limits, rad or m, shape (n,).
        upper: Upper joint limits.
        base: Pose of the chain's frame 0 in the measurement (world) frame.
        tool: Pose of the tool in the last link's frame.
        coupling: Which joint moves which links; None where each joint moves its own.
        tree: Which link stands on which; None where each stands on the one before.
    """

    joint_names: tuple[str, ...]
    prismatic: tuple[bool, ...]
    alpha: Array
    a: Array
    theta: Array
    d: Array
    beta: Array
    lower: Array
    upper: Array
    base: Pose
    tool: Pose
    coupling: Coupling | None = None
    tree: LinkTree | None = None

    @property
    def joints(self) -> int:
        """Number of joints n, which are what is commanded."""
        return len(self.prismatic)

    @property
    def links(self) -> int:
        """Number of links L: n, or more where one joint moves several."""
        return len(self.slides)

    @property
    def slides(self) -> tuple[bool, ...]:
        """For each link, whether it slides (else it turns), shape (L,)."""
        return self.prismatic if self.coupling is None else self.coupling.slides

    @property
    def owners(self) -> tuple[int, ...]:
        """For each link, the joint that moves it, shape (L,)."""
        return tuple(range(self.joints)) if self.coupling is None else self.coupling.joint

    @property
    def ratios(self) -> tuple[float, ...]:
        """For each link, its displacement per displacement of the joint that moves it, shape (L,)."""
        return (1.0,) * self.joints if self.coupling is None else self.coupling.ratio

    @property
    def link_names(self) -> tuple[str, ...]:
        """One name per link, shape (L,): its joint's name, with a number where the joint moves several links."""
        names = []
        for i, (joint, ratio) in enumerate(zip(self.owners, self.ratios, strict=True)):
            moved = [link for link, _ in self.links_of(joint)]
            place = f" ({moved.index(i) + 1} of {len(moved)})" if ratio and len(moved) > 1 else ""
            names.append(self.joint_names[joint] + place if ratio else f"mount of {self.joint_names[joint]}")
        return tuple(names)

    def links_of(self, joint: int) -> list[tuple[int, float]]:
        """Index and ratio of each link that a joint moves (see `Coupling`)."""
        return self._moved[joint]

    @cached_property
    def _moved(self) -> list[list[tuple[int, float]]]:
        moved: list[list[tuple[int, float]]] = [[] for _ in self.prismatic]
        for link, (owner, ratio) in enumerate(zip(self.owners, self.ratios, strict=True)):
            if ratio:
                moved[owner].append((link, ratio))
        return moved

    @property
    def hand(self) -> int:
        """Index of the link that carries the tool; -1 for frame 0."""
        return self.links - 1 if self.tree is None else self.tree.target

    @cached_property
    def senses(self) -> Array:
        """How the tool moves with what each link carries (L,): 1 as it does, -1 the other way, 0 not at all.

        It moves the other way where the link carries the sensor, and not at all where it carries both or neither.
        """
        if self.tree is None:
            return np.ones(self.links)
        target, sensor = self.tree.carry(self.tree.target), self.tree.carry(self.tree.sensor)
        return np.array([float(i in target) - float(i in sensor) for i in range(self.links)])

    def carries(self, link: int, other: int) -> bool:
        """Whether a link carries another, or is it."""
        return link <= other if self.tree is None else link in self.tree.carry(other)

    def between(self, sensor: int, target: int) -> Geometry:
        """This geometry with poses from one link of its tree to another."""
        assert self.tree is not None
        return replace(self, tree=replace(self.tree, sensor=sensor, target=target))

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of all 5L + 12 parameters, in the order of `parameter_jacobian`'s columns.

        Link parameters carry the paper's indices: alpha0..alpha(L-1), a0..a(L-1), theta1..L, d1..L, beta0..beta(L-1),
        then base_x..base_rz and tool_x..tool_rz.
        """
        links = [f"{name}{i + (name in ('theta', 'd'))}" for name in LINK_PARAMETERS for i in range(self.links)]
        return (*links, *(f"{frame}_{name}" for frame in ("base", "tool") for name in FRAME_PARAMETERS))

    @cached_property
    def parameter_is_angle(self) -> NDArray[np.bool_]:
        """For each parameter, whether it is an angle (rad) rather than a length (m), shape (5L + 12,)."""
        links = [name in ("alpha", "theta", "beta") for name in LINK_PARAMETERS for _ in range(self.links)]
        return np.array(links + [False, False, False, True, True, True] * 2)

    def displaced(self, delta: ArrayLike) -> Geometry:
        """This geometry with ``delta`` (5L + 12,) added to its parameters, in the order of `parameter_names`.

        Base and tool are moved on the manifold: positions add, rotations are multiplied from the left by the rotation
        of the given rotation vector (axes of the world for the base, of the last link for the tool).
        """
        delta = np.asarray(delta, dtype=float)
        n = self.links
        if delta.shape != (5 * n + 12,):
            raise ValueError(f"delta has shape {delta.shape}, but this geometry has {5 * n + 12} parameters")
        parts = zip(LINK_PARAMETERS, delta[: 5 * n].reshape(5, n), strict=True)
        links: dict[str, Any] = {name: getattr(self, name) + part for name, part in parts}
        base, tool = delta[5 * n :].reshape(2, 6)
        return replace(self, **links, base=move_pose(self.base, base), tool=move_pose(self.tool, tool))

    def difference(self, other: Geometry) -> Array:
        """The ``delta`` (5L + 12,) that turns this geometry into ``other`` (inverse of `displaced`)."""
        parts = [getattr(other, name) - getattr(self, name) for name in LINK_PARAMETERS]
        for mine, theirs in ((self.base, other.base), (self.tool, other.tool)):
            turn = Rotation.from_matrix(theirs.rotation @ mine.rotation.T).as_rotvec()
            parts += [theirs.position - mine.position, turn]
        return np.concatenate(parts)

    def fingerprint(self) -> str:
        """Hash of joint types, link parameters, base and tool, by which a fit to one arm is refused on another arm."""
        links = [getattr(self, name) for name in LINK_PARAMETERS]
        chain: list[object] = [self.prismatic, [v.tolist() for v in (*links, *self.base, *self.tool)]]
        if self.coupling is not None:
            chain.append([self.coupling.joint, self.coupling.ratio, self.coupling.slides])
        if self.tree is not None:
            chain.append([self.tree.parent, self.tree.names, self.tree.carriers])
        return hashlib.sha256(json.dumps(chain).encode()).hexdigest()[:16]


def move_pose(pose: Pose, delta: Array) -> Pose:
    """Add ``delta[:3]`` (m) to the position and turn the pose by the rotation vector ``delta[3:]`` (rad)."""
    return Pose(pose.position + delta[:3], Rotation.from_rotvec(delta[3:]).as_matrix() @ pose.rotation)


def from_standard_dh(
    joint_names: tuple[str, ...],
    prismatic: tuple[bool, ...],
    *,
    theta: ArrayLike,
    d: ArrayLike,
    a: ArrayLike,
    alpha: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    base: Pose | None = None,
    tool: Pose | None = None,
) -> Geometry:
    """Turn a standard (distal) DH table, Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha), into our modified one.

    The chain's product is regrouped: a and alpha of link i become those of modified link i + 1, and the last link's
    a and alpha move into the tool pose. Nothing is approximated.

    Args:
        joint_names: Names of the joints.
        prismatic: Joint types.
        theta: Standard DH angles, rad.
        d: Standard DH offsets, m.
        a: Standard DH lengths, m.
        alpha: Standard DH twists, rad.
        lower: Lower joint limits.
        upper: Upper joint limits.
        base: Base pose; identity when left out.
        tool: Tool pose behind the last standard frame; identity when left out.
    """
    a, alpha, theta, d, lower, upper = (np.asarray(v, dtype=float) for v in (a, alpha, theta, d, lower, upper))
    base, tool = base or identity_pose(), tool or identity_pose()
    last = Rotation.from_rotvec([alpha[-1], 0.0, 0.0]).as_matrix()
    hand = Pose(np.array([a[-1], 0.0, 0.0]) + last @ tool.position, last @ tool.rotation)
    twist, length = (np.concatenate([[0.0], values[:-1]]) for values in (alpha, a))
    return Geometry(joint_names, prismatic, twist, length, theta, d, np.zeros(len(a)), lower, upper, base, hand)
