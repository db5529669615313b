"""An arm as a serial chain of revolute and prismatic joints in modified DH parameters, with base and tool poses.

Link i is T(i-1,i) = Rot(x, alpha) Trans(x, a) Rot(y, beta) Rot(z, theta) Trans(z, d): Qiao 2026 eq (1), with Hayati's
beta added. Beta is for consecutive axes inclined by less than 45 degrees, unless they nearly meet at the first axis's
frame. Beta is zero in every shipped table. Units: metres and radians.

One drive may move several links (a two-stage lift, a parallelogram), so there may be more links than joints. The link
table has a row per link. Joint values, names and limits belong to the commanded joints (`Coupling`).
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
    """Return the identity pose: position zero, and the identity matrix as rotation."""
    return Pose(np.zeros(3), np.eye(3))


def inverse_pose(pose: Pose) -> Pose:
    """Return the inverse of a pose ``(...)``: the pose of its reference frame, expressed in the frame of the pose."""
    back = np.swapaxes(pose.rotation, -1, -2)
    return Pose(-np.einsum("...ij,...j->...i", back, pose.position), back)


def behind(pose: Pose, after: Pose) -> Pose:
    """Compose two poses, or batches of them: ``after`` is given in the frame ``pose``.

    Returns:
        The pose ``after``, expressed in the reference frame of ``pose``.
    """
    step = np.einsum("...ij,...j->...i", pose.rotation, after.position)
    return Pose(pose.position + step, pose.rotation @ after.rotation)


@dataclass(frozen=True)
class Coupling:
    """The joint that moves each link, for an arm in which one joint moves several links.

    The displacement of link i is ratio[i] q[joint[i]]. A ratio of 0 marks a fixed link. Each branch of a `LinkTree`
    begins with a fixed link.

    The displacement of a link at zero joints is part of its theta or d.

    Attributes:
        joint: For each link, the index of the joint that moves it, from 0 (L,).
        ratio: Displacement of the link per displacement of its joint, rad or m per rad or m (L,).
        slides: Whether the link slides, else it turns (L,). A joint that turns may move a link that slides (pinion and
            rack).
    """

    joint: tuple[int, ...]
    ratio: tuple[float, ...]
    slides: tuple[bool, ...]

    def displacements(self, q: Sequence[Any]) -> list[Any]:
        """Return the displacement of each of the L links, rad or m.

        Args:
            q: The n joint displacements, rad or m: floats, or arrays or tensors of one shape.
        """
        return [ratio * q[joint] for joint, ratio in zip(self.joint, self.ratio, strict=True)]


@dataclass(frozen=True)
class LinkTree:
    """The tree of a robot's links, and the two links between which a tool pose is computed.

    A tool pose is the pose of the target's link relative to the sensor's link. Frame 0, the root of the tree, has the
    index -1.

    Attributes:
        parent: Index of each link's parent link (L,), from 0; -1 for frame 0. A parent comes before its child.
        names: Names of the parts of the robot that may carry a sensor or a target.
        carriers: For each of these parts, the index of the link that it is fixed to.
        sensor: Index of the link that carries the sensor.
        target: Index of the link that carries the target.
    """

    parent: tuple[int, ...]
    names: tuple[str, ...]
    carriers: tuple[int, ...]
    sensor: int = -1
    target: int = -1

    def carry(self, link: int) -> list[int]:
        """Return the indices of a link and of its ancestors, from the link towards frame 0, without frame 0."""
        line = []
        while link >= 0:
            line.append(link)
            link = self.parent[link]
        return line


@dataclass(frozen=True, eq=False)
class Geometry:
    """Modified DH table of a serial chain with n joints and L links, its base and tool poses and its joint limits.

    For a whole robot, the table holds all branches, one after another (`LinkTree`). A branch begins with a fixed link,
    which no joint moves. That link's theta and d say where on the parent link's axis the branch begins.

    Attributes:
        joint_names: One name per joint, used in messages and tables.
        prismatic: For each joint, whether it slides (else it turns), shape (n,).
        alpha: Twist alpha(i-1) of each link i, counted from 1, rad, shape (L,); L = n without a coupling. All five link
            parameters may carry leading batch dimensions (one table per arm).
        a: Length a(i-1) of each link, m.
        theta: Joint angle at zero displacement, rad; a revolute joint's displacement adds to it.
        d: Offset at zero displacement, m; a prismatic joint's displacement adds to it.
        beta: Hayati's second twist, rad, about y after Trans(x, a).
        lower: Lower joint limits, rad or m, shape (n,).
        upper: Upper joint limits.
        base: Pose of the chain's frame 0 in the measurement (world) frame.
        tool: Pose of the tool in the last link's frame.
        coupling: Which joint moves which links; None if joint i moves link i alone.
        tree: The tree of the links; None if each link's parent is the link before it.
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
        """Number of commanded joints n."""
        return len(self.prismatic)

    @property
    def links(self) -> int:
        """Number of links L: n, or more if a joint moves several links."""
        return len(self.slides)

    @property
    def slides(self) -> tuple[bool, ...]:
        """For each link, whether it slides (else it turns), shape (L,)."""
        return self.prismatic if self.coupling is None else self.coupling.slides

    @property
    def owners(self) -> tuple[int, ...]:
        """For each link, the index of the joint that moves it, from 0, shape (L,)."""
        return tuple(range(self.joints)) if self.coupling is None else self.coupling.joint

    @property
    def ratios(self) -> tuple[float, ...]:
        """For each link, the ratio of its displacement to the displacement of the joint that moves it, shape (L,)."""
        return (1.0,) * self.joints if self.coupling is None else self.coupling.ratio

    @property
    def link_names(self) -> tuple[str, ...]:
        """One name per link, shape (L,): the name of the joint that moves it.

        If a joint moves several links, the link's number among them follows, from 1: "J2 (1 of 2)". A fixed link has
        the name "mount of JOINT", with the joint that `owners` gives for the link.
        """
        names = []
        for i, (joint, ratio) in enumerate(zip(self.owners, self.ratios, strict=True)):
            moved = [link for link, _ in self.links_of(joint)]
            place = f" ({moved.index(i) + 1} of {len(moved)})" if ratio and len(moved) > 1 else ""
            names.append(self.joint_names[joint] + place if ratio else f"mount of {self.joint_names[joint]}")
        return tuple(names)

    def links_of(self, joint: int) -> list[tuple[int, float]]:
        """Return the index and the ratio (see `Coupling`) of each link that a joint moves; indices count from 0."""
        links = enumerate(zip(self.owners, self.ratios, strict=True))
        return [(link, ratio) for link, (owner, ratio) in links if owner == joint and ratio]

    @property
    def hand(self) -> int:
        """Index of the link that carries the tool; -1 for frame 0."""
        return self.links - 1 if self.tree is None else self.tree.target

    @cached_property
    def senses(self) -> Array:
        """Sign of each link's effect on the tool pose (L,): 1 if the link carries the target, -1 if the sensor.

        The tool pose is the target's pose relative to the sensor. A link that carries both or neither has the sign 0,
        because its motion does not change this pose.
        """
        if self.tree is None:
            return np.ones(self.links)
        target, sensor = self.tree.carry(self.tree.target), self.tree.carry(self.tree.sensor)
        return np.array([float(i in target) - float(i in sensor) for i in range(self.links)])

    def carries(self, link: int, other: int) -> bool:
        """Return whether ``other`` is the link ``link`` itself or one of its descendants; both are indices from 0."""
        return link <= other if self.tree is None else link in self.tree.carry(other)

    def between(self, sensor: int, target: int) -> Geometry:
        """Return this geometry with another sensor link and target link; it must have a tree.

        Args:
            sensor: Index of the link that carries the sensor; -1 for frame 0.
            target: Index of the link that carries the target; -1 for frame 0.
        """
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
        """Return this geometry with ``delta`` (5L + 12,) added to its parameters, in the order of `parameter_names`.

        Base and tool are moved on the manifold. Their positions are changed by addition. Their rotations are multiplied
        from the left by the rotation matrix of a rotation vector in ``delta``. This vector is in world axes for the
        base, in the last link's axes for the tool.

        Raises:
            ValueError: If ``delta`` has another shape.
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
        """Return the ``delta`` (5L + 12,) that turns this geometry into ``other`` (inverse of `displaced`)."""
        parts = [getattr(other, name) - getattr(self, name) for name in LINK_PARAMETERS]
        for mine, theirs in ((self.base, other.base), (self.tool, other.tool)):
            turn = Rotation.from_matrix(theirs.rotation @ mine.rotation.T).as_rotvec()
            parts += [theirs.position - mine.position, turn]
        return np.concatenate(parts)

    def fingerprint(self) -> str:
        """Return one hash over joint types, link parameters, base, tool, coupling and tree (16 hexadecimal digits).

        The links of sensor and target do not count. A calibration of one arm is refused on an arm with another hash.
        """
        links = [getattr(self, name) for name in LINK_PARAMETERS]
        chain: list[object] = [self.prismatic, [v.tolist() for v in (*links, *self.base, *self.tool)]]
        if self.coupling is not None:
            chain.append([self.coupling.joint, self.coupling.ratio, self.coupling.slides])
        if self.tree is not None:
            chain.append([self.tree.parent, self.tree.names, self.tree.carriers])
        return hashlib.sha256(json.dumps(chain).encode()).hexdigest()[:16]


def move_pose(pose: Pose, delta: Array) -> Pose:
    """Return the pose with ``delta[:3]`` (m) added to its position, and turned by the rotation vector ``delta[3:]``.

    The rotation vector is in rad, in the axes of the frame in which the pose is given.
    """
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
    """Return the `Geometry` of a standard (distal) DH table, Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha).

    The factors are regrouped into modified DH links: a and alpha of link i become a and alpha of modified link
    i + 1. The last link's a and alpha become part of the tool pose. The conversion is exact.

    Args:
        joint_names: Names of the joints.
        prismatic: For each joint, whether it slides (else it turns).
        theta: Standard DH angles (n,), rad.
        d: Standard DH offsets (n,), m.
        a: Standard DH lengths (n,), m.
        alpha: Standard DH twists (n,), rad.
        lower: Lower joint limits (n,), rad or m.
        upper: Upper joint limits (n,), rad or m.
        base: Base pose; the identity by default.
        tool: Tool pose in the last standard frame; the identity by default.
    """
    a, alpha, theta, d, lower, upper = (np.asarray(v, dtype=float) for v in (a, alpha, theta, d, lower, upper))
    base, tool = base or identity_pose(), tool or identity_pose()
    last = Rotation.from_rotvec([alpha[-1], 0.0, 0.0]).as_matrix()
    hand = Pose(np.array([a[-1], 0.0, 0.0]) + last @ tool.position, last @ tool.rotation)
    twist, length = (np.concatenate([[0.0], values[:-1]]) for values in (alpha, a))
    return Geometry(joint_names, prismatic, twist, length, theta, d, np.zeros(len(a)), lower, upper, base, hand)
