"""Forward kinematics in scalar components, which may be Python floats, NumPy arrays or torch tensors.

A frame is twelve scalars (axes x, y, z and the origin, in world axes); ``m`` is the namespace that supplies sin, cos
and stack: `math`, `numpy` or `torch`. Operations whose names differ between these are defined here once, so that one
formula works with each of them. A function of plain floats alone returns a float. Qiao 2026 eqs (1)-(2); modified DH
with Hayati's beta. Metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Coupling, Geometry, LinkTree, Pose
from pickenv.base import InputError

ONE: Any = SimpleNamespace(
    sin=lambda angle: float(np.sin(angle)),
    cos=lambda angle: float(np.cos(angle)),
    sqrt=math.sqrt,
    minimum=min,
    maximum=max,
    clip=lambda value, low, high: min(max(value, low), high),
)
"""A namespace for floats with NumPy's sine and cosine. A single pose thus gets the same bits as in an array of poses,
without the cost of arrays."""


def namespace_of(m: ModuleType, value: Scalar) -> ModuleType:
    """Return the namespace with sin, cos, exp and sqrt for ``value``: `math` for plain numbers, else ``m``."""
    return math if isinstance(value, float | int) else m


def exponential(m: ModuleType, value: Scalar) -> Scalar:
    """Return the exponential of ``value``; ``m`` is ``numpy`` or ``torch`` if ``value`` is no plain number."""
    return namespace_of(m, value).exp(value)


def clipped(m: ModuleType, value: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """Return ``value`` clipped to the range from ``low`` to ``high``.

    The two limits are plain floats, or both are of the type of ``value``. ``m`` is the namespace: ``math``, ``numpy``
    or ``torch``.
    """
    if m is math:
        return low if value < low else high if value > high else value
    return m.minimum(m.maximum(value, low), high) if m is np else m.clip(value, low, high)


def chosen(m: ModuleType, condition: Scalar, yes: Scalar, no: Scalar) -> Scalar:
    """Return ``yes`` where ``condition`` is true, else ``no``.

    ``m`` is the namespace: ``math``, ``numpy`` or ``torch``.
    """
    if m is math or isinstance(condition, bool):
        return yes if condition else no
    return m.where(condition, yes, no)


def possible(m: ModuleType, condition: Scalar) -> bool:
    """Return whether ``condition`` may be true in some entry; always True with torch, to avoid waiting for the GPU.

    ``m`` is the namespace: ``math``, ``numpy`` or ``torch``.
    """
    return bool(condition) if m is math else bool(np.any(condition)) if m is np else True


def set_aside(m: ModuleType, condition: Scalar) -> bool:
    """Return whether the formula may skip a rare case, because a tracing namespace ``m`` has recorded the condition.

    Whoever runs the traced formula computes that case separately. Always False for `math`, `numpy` and `torch`.

    Args:
        m: The namespace of the formula: ``math``, ``numpy``, ``torch`` or one that traces.
        condition: Number or array that is true where the rare case occurs.
    """
    note = getattr(m, "set_aside", None)
    return note is not None and bool(note(condition))


def outside(m: ModuleType, function: Callable[..., None], values: Scalars, rows: int) -> list[Scalar] | None:
    """Record the call of a function of whole arrays, if ``m`` is a namespace that traces formulas.

    Args:
        m: The namespace of the formula: ``math``, ``numpy``, ``torch`` or one that traces.
        function: Function that takes an input array ``(k, N)`` and an output array ``(rows, N)`` and fills the output.
            Columns are independent of one another.
        values: The k inputs.
        rows: Number of outputs.

    Returns:
        The outputs; None if ``m`` does not trace.
    """
    note = getattr(m, "outside", None)
    return None if note is None else note(function, values, rows)


def nearest_whole(m: ModuleType, value: Scalar) -> Scalar:
    """Return the integer nearest to ``value``; halves are rounded to the even neighbour, as in IEEE 754.

    ``m`` is the namespace: ``math``, ``numpy`` or ``torch``.
    """
    return float(round(value)) if m is math else m.round(value)


# Modified DH parameters of any serial chain, from its joint axes at the zero position. Frame i has z on joint axis i
# and x on the common normal to axis i + 1 (Craig 2005, section 3.4). Frame 0 coincides with frame 1 at zero, so
# alpha0, a0, theta1 and d1 are zero and the base pose carries the rest. Metres and radians.


PARALLEL = 1e-9
"""Two axes count as parallel if the cross product of their directions is shorter than this."""

NEARLY_PARALLEL = 1e-2
"""Two axes count as nearly parallel if their cross product is shorter; their angle goes into Hayati's beta. Such small
angles come from a file's rounding or a part's tolerance. The common normal of such axes would be far away: kilometres,
if a file rounds half a turn to 3.1416."""

SKEW = 0.7
"""If the cross product of two axes is shorter than this, and the axes are far apart (`TILT_LEVER`), their angle goes
into beta too. Without beta, a small tilt of one axis would move both feet of the common normal far along the axes. They
would move by the normal's length times the tilt / sine^2; the sine is that angle's sine. With beta, the link runs
straight across to the other axis. Then a displacement of the other axis only turns the link, by the displacement /
distance."""

TILT_LEVER = 0.15
"""Two axes are far apart if their distance exceeds this length, m, times the sine of the angle between them. The
distance is measured straight across, from the frame on the first axis. The length is a part's tolerance of length
divided by its tolerance of angle."""


def geometry_from_axes(
    joint_names: tuple[str, ...],
    prismatic: tuple[bool, ...],
    points: ArrayLike,
    directions: ArrayLike,
    tool: Pose,
    lower: ArrayLike,
    upper: ArrayLike,
) -> Geometry:
    """Return the `Geometry` of an arm whose joint axes are given at zero joints.

    Args:
        joint_names: Names of the joints.
        prismatic: For each joint, whether it slides (else it turns).
        points: A point on each axis at zero joints ``(n, 3)``, m, world frame.
        directions: Axis directions ``(n, 3)``, world frame.
        tool: Tool pose at zero joints, world frame.
        lower: Lower joint limits ``(n,)``, rad or m.
        upper: Upper joint limits ``(n,)``, rad or m.

    Raises:
        InputError: If the direction of an axis is the zero vector.
    """
    points, directions = np.asarray(points, dtype=float), np.asarray(directions, dtype=float)
    lengths = np.linalg.norm(directions, axis=1)
    if np.any(lengths < PARALLEL):
        raise InputError(f"axis {int(np.argmin(lengths)) + 1} has no direction; give a unit vector")
    z = directions / lengths[:, None]
    n = len(z)
    origins, x = np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(n):
        before, previous = (origins[i - 1], x[i - 1]) if i else (points[0], np.array([1.0, 0.0, 0.0]))
        near = points[i] + z[i] * (z[i] @ (before - points[i]))  # foot of the frame before on this axis
        if i == n - 1:
            origins[i], x[i] = near, _perpendicular(z[i], previous)
        else:
            origins[i], x[i] = _common_normal(near, z[i], points[i + 1], z[i + 1], previous)
    table = np.zeros((5, n))
    for i in range(1, n):
        step, lean = origins[i] - origins[i - 1], float(z[i] @ x[i - 1])
        twist, turn = _angle(z[i - 1], z[i], x[i - 1]), _angle(x[i - 1], x[i], z[i])
        table[:, i] = twist, step @ x[i - 1], turn, step @ z[i], 0.0
        if abs(lean) > PARALLEL:  # only where the next axis is skew or nearly parallel, and leans along x
            along = (step @ z[i - 1]) / (z[i] @ z[i - 1])
            across = (x[i - 1] - lean * z[i]) / np.sqrt(1.0 - lean**2)
            table[:, i] = twist, step @ x[i - 1] - along * lean, _angle(across, x[i], z[i]), along, np.arcsin(lean)
    first, last = (np.column_stack([x[i], np.cross(z[i], x[i]), z[i]]) for i in (0, -1))
    base, hand = Pose(origins[0], first), Pose(last.T @ (tool.position - origins[-1]), last.T @ tool.rotation)
    low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    alpha, a, theta, d, beta = table
    return Geometry(joint_names, prismatic, alpha, a, theta, d, beta, low, high, base, hand)


def _common_normal(near: Array, z: Array, point: Array, next_z: Array, previous: Array) -> tuple[Array, Array]:
    """Return the frame on a joint's axis: its origin (3,), m, and its x direction (3,).

    They come from the common normal of this axis and the next axis. For parallel axes, and for axes whose angle goes
    into beta, the origin is ``near``.

    Args:
        near: A point on the joint's axis (3,), m.
        z: Direction of the joint's axis, a unit vector (3,).
        point: A point on the next axis (3,), m.
        next_z: Direction of the next axis, a unit vector (3,).
        previous: If the two axes coincide, x is as near to this direction (3,) as possible.
    """
    cross = np.cross(z, next_z)
    if (sine := float(np.linalg.norm(cross))) < PARALLEL:  # any normal will do: take the one at ``near``
        across = point - near - z * (z @ (point - near))
        distance = float(np.linalg.norm(across))
        return near, across / distance if distance > PARALLEL else _perpendicular(z, previous)
    if sine < SKEW:  # from ``near`` straight to the other axis
        across = point - near - next_z * (z @ (point - near)) / (z @ next_z)
        if (distance := float(np.linalg.norm(across))) > (PARALLEL if sine < NEARLY_PARALLEL else TILT_LEVER * sine):
            return near, across / distance
    # Distance along z from ``near`` to the foot: volume of (point - near, next_z, cross) over sine squared.
    along = float(np.cross(point - near, next_z) @ cross) / sine**2
    return near + along * z, cross / sine


def _perpendicular(z: Array, wish: Array) -> Array:
    """Return the unit vector perpendicular to the unit vector ``z`` that is nearest to the direction ``wish``."""
    across = wish - z * (z @ wish)
    if np.linalg.norm(across) < 1e-6:
        across = np.eye(3)[int(np.argmin(np.abs(z)))]
        across = across - z * (z @ across)
    return np.asarray(across / np.linalg.norm(across))


def _angle(start: Array, end: Array, axis: Array) -> float:
    """Return the angle from ``start`` to ``end`` about ``axis``, rad; all are unit vectors."""
    return float(np.arctan2(np.cross(start, end) @ axis, start @ end))


Scalar = Any
"""A Python float, a NumPy array or a torch tensor."""

Scalars = Sequence[Scalar]

Frame = tuple[Scalar, ...]
"""(xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz): components of the axes x, y, z and of the origin p."""

Flexure = Callable[[int, Frame], Frame]
"""A function from the index (from 0) and the frame of a link to the bent frame, to which the next link is attached."""


class Link(NamedTuple):
    """Constants of one link's transform: its parameters and their sines and cosines.

    ``beta`` holds the cosine and sine of Hayati's beta, or None if beta is zero.
    """

    prismatic: bool
    cos_alpha: Scalar
    sin_alpha: Scalar
    a: Scalar
    theta: Scalar
    d: Scalar
    cos_theta: Scalar
    sin_theta: Scalar
    beta: tuple[Scalar, Scalar] | None


class Chain(NamedTuple):
    """A geometry prepared for `frames`: base, links, tool (None if it is the identity), coupling and tree."""

    base: Frame
    links: tuple[Link, ...]
    tool: Frame | None
    coupling: Coupling | None = None
    tree: LinkTree | None = None

    def hand(self, links: Sequence[Frame]) -> Frame:
        """Return the frame, in world axes, of the link that carries the tool; ``links`` is the result of `frames`."""
        return links[-1] if self.tree is None else links[self.tree.target + 1]


def chain_of(geometry: Geometry, m: ModuleType = math) -> Chain:
    """Return ``geometry`` as a `Chain`, the form that `frames` takes.

    Args:
        geometry: A single geometry. If ``m`` is numpy, its link parameters may carry batch dimensions (one table per
            arm).
        m: ``math`` for constants that are Python floats, which work with joints of any kind. ``numpy`` for constants
            that are arrays.
    """
    single = m is math
    tables = (getattr(geometry, name) for name in LINK_PARAMETERS)
    columns = [table.tolist() if single else np.moveaxis(table, -1, 0) for table in tables]
    links = []
    for prismatic, alpha, a, theta, d, beta in zip(geometry.slides, *columns, strict=True):
        bent = (m.cos(beta), m.sin(beta)) if (beta if single else beta.any()) else None
        links.append(Link(prismatic, m.cos(alpha), m.sin(alpha), a, theta, d, m.cos(theta), m.sin(theta), bent))
    identity = not geometry.tool.position.any() and np.array_equal(geometry.tool.rotation, np.eye(3))
    tool = None if identity else frame_of(geometry.tool)
    return Chain(frame_of(geometry.base), tuple(links), tool, geometry.coupling, geometry.tree)


def frame_of(pose: Pose) -> Frame:
    """Return a pose as a `Frame` of twelve components: Python floats for one pose, arrays ``(...)`` for a batch."""
    if pose.position.ndim > 1:
        axes = np.ascontiguousarray(np.moveaxis(pose.rotation, (-1, -2), (0, 1)))
        return (*axes.reshape(9, *axes.shape[2:]), *np.moveaxis(pose.position, -1, 0))
    return (*(float(v) for v in pose.rotation.T.ravel()), *(float(v) for v in pose.position))


def pose_of(frame: Frame) -> Pose:
    """Return a frame as a `Pose` of arrays; its components are numbers, or arrays that broadcast."""
    shape = np.broadcast(*frame).shape
    position, axes = np.empty((*shape, 3)), np.empty((*shape, 3, 3))
    for i, (x, y, z, p) in enumerate(zip(*(frame[start : start + 3] for start in (0, 3, 6, 9)), strict=True)):
        axes[..., i, 0], axes[..., i, 1], axes[..., i, 2], position[..., i] = x, y, z, p
    return Pose(position, axes)


def frames(m: ModuleType, chain: Chain, q: Scalars, flexure: Flexure | None = None) -> list[Frame]:
    """Compute the frames of the base and of the L links, L + 1 in all, in world axes.

    If the chain has a `LinkTree` with a sensor link, the chain's base is the pose of that link. All frames are then
    computed relative to it.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        chain: The chain, from `chain_of`.
        q: The n joint displacements, rad or m: floats, or arrays of one shape.
        flexure: Function that bends a link's frame before the next link is attached (boom bending), or None.
    """
    result = _from_the_base(m, chain, q, flexure)
    if chain.tree is not None and chain.tree.sensor >= 0:
        result = [_from_the_sensor(chain, result, frame) for frame in result]
    return result


def _from_the_sensor(chain: Chain, links: list[Frame], frame: Frame) -> Frame:
    """Return ``frame`` moved with the whole chain, so that the sensor's link has the pose of the chain's base.

    ``links`` are the frames of base and links that `_from_the_base` returned; ``frame`` is in the same axes.
    """
    assert chain.tree is not None
    return attach(chain.base, frame_within(links[chain.tree.sensor + 1], frame))


def _from_the_base(m: ModuleType, chain: Chain, q: Scalars, flexure: Flexure | None = None) -> list[Frame]:
    """Compute the frames of base and links, with frame 0 at the chain's base even if a link carries the sensor.

    `frames` explains the arguments.
    """
    sin, cos = m.sin, m.cos
    if chain.coupling is not None:
        q = chain.coupling.displacements(q)
    xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = frame = chain.base
    result = [frame]
    for i, (prismatic, ca, sa, a, theta, d, ct, st, beta) in enumerate(chain.links):
        if chain.tree is not None:
            xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = result[chain.tree.parent[i] + 1]
        # Rot(x, alpha) turns y and z; Trans(x, a) is taken along the axis x before any further turn.
        yx, zx = ca * yx + sa * zx, ca * zx - sa * yx
        yy, zy = ca * yy + sa * zy, ca * zy - sa * yy
        yz, zz = ca * yz + sa * zz, ca * zz - sa * yz
        px, py, pz = px + a * xx, py + a * xy, pz + a * xz
        if beta is not None:
            cb, sb = beta
            xx, zx = cb * xx - sb * zx, cb * zx + sb * xx
            xy, zy = cb * xy - sb * zy, cb * zy + sb * xy
            xz, zz = cb * xz - sb * zz, cb * zz + sb * xz
        if prismatic:
            d = d + q[i]
        else:
            angle = theta + q[i]
            ct, st = cos(angle), sin(angle)
        xx, yx = ct * xx + st * yx, ct * yx - st * xx
        xy, yy = ct * xy + st * yy, ct * yy - st * xy
        xz, yz = ct * xz + st * yz, ct * yz - st * xz
        px, py, pz = px + d * zx, py + d * zy, pz + d * zz
        frame = (xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz)
        if flexure is not None:
            frame = flexure(i, frame)
            xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = frame
        result.append(frame)
    return result


def frame_within(reference: Frame, frame: Frame) -> Frame:
    """Express ``frame`` in the frame ``reference``; both are given in world axes. This is the inverse of `attach`."""
    gap = [p - q for p, q in zip(frame[9:], reference[9:], strict=True)]
    vectors, axes = (*(frame[i : i + 3] for i in (0, 3, 6)), gap), [reference[i : i + 3] for i in (0, 3, 6)]
    return tuple(x * u + y * v + z * w for x, y, z in vectors for u, v, w in axes)


def attach(frame: Frame, tool: Frame | None) -> Frame:
    """Return the tool's frame in world axes.

    Args:
        frame: Frame of the link that carries the tool, in world axes.
        tool: The tool's frame in that link's frame; None for the identity.
    """
    if tool is None:
        return frame
    xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = frame
    turned = []
    for i in (0, 3, 6, 9):
        u, v, w = tool[i : i + 3]
        turned += [u * xx + v * yx + w * zx, u * xy + v * yy + w * zy, u * xz + v * yz + w * zz]
    return (*turned[:9], px + turned[9], py + turned[10], pz + turned[11])


def tool_frame(m: ModuleType, chain: Chain, q: Scalars, flexure: Flexure | None = None) -> Frame:
    """Compute the frame of the tool in world axes; `frames` explains the arguments."""
    links = _from_the_base(m, chain, q, flexure)
    hand = chain.hand(links)
    if chain.tree is not None and chain.tree.sensor >= 0:
        hand = _from_the_sensor(chain, links, hand)
    return attach(hand, chain.tool)


def split_joints(geometry_joints: int, q: ArrayLike) -> list[Array]:
    """Check the shape of joints ``(..., n)`` and return them as n arrays ``(...,)``.

    Args:
        geometry_joints: Number of joints n of the arm's geometry.
        q: Joint displacements ``(..., n)``, rad or m.

    Raises:
        ValueError: If the last dimension is not n.
    """
    q = np.asarray(q, dtype=float)
    if q.ndim == 0 or q.shape[-1] != geometry_joints:
        raise ValueError(f"joints have shape {q.shape}, but this arm has {geometry_joints} joints (last axis)")
    return [q[..., i] for i in range(geometry_joints)]


def forward(geometry: Geometry, q: ArrayLike) -> Pose:
    """Compute the tool pose at joints ``q``.

    Args:
        geometry: The arm; its link parameters may carry batch dimensions that broadcast with ``q``'s.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Position ``(..., 3)`` in m and rotation ``(..., 3, 3)`` in the world frame (Qiao 2026 eq (2)).

    Raises:
        ValueError: If ``q`` does not have n joints.
    """
    chain = chain_of(geometry, math if geometry.alpha.ndim == 1 else np)
    return pose_of(tool_frame(np, chain, split_joints(geometry.joints, q)))


# The arm as something to draw: a polyline along its links. A link runs from the previous frame's origin along a to
# the elbow, then along d to its own origin. Metres.


SHORTEST_LINK = 0.02
"""Length, m, above which a link part is drawn; a part that is shorter in all poses is skipped."""


def nominal_points(geometry: Geometry, q: ArrayLike) -> Array:
    """Compute points ``(..., 2L + 2, 3)`` along an arm of L links, from the base to the tool, m, world frame.

    Each link has two parts, of lengths a and d; the points are the ends of these parts.

    Args:
        geometry: The arm.
        q: Joints ``(..., n)``, rad or m.
    """
    joints, chain = split_joints(geometry.joints, q), chain_of(geometry)
    links = frames(np, chain, joints)
    displacements = joints if chain.coupling is None else chain.coupling.displacements(joints)
    points = [links[0][9:]]
    for link, frame, displacement in zip(chain.links, links[1:], displacements, strict=True):
        zx, zy, zz, px, py, pz = frame[6:]
        d = link.d + displacement if link.prismatic else link.d
        points += [(px - d * zx, py - d * zy, pz - d * zz), (px, py, pz)]
    points.append(attach(links[-1], chain.tool)[9:])
    components = np.broadcast_arrays(*(value for point in points for value in point))
    return np.stack(components, -1).reshape(*components[0].shape, len(points), 3)


def true_points(geometry: Geometry, q: ArrayLike, tool: ArrayLike) -> Array:
    """Compute points ``(..., 2L + 2, 3)`` along the true arm of L links, m, world frame, for drawing.

    The points of the true geometry are shifted so that the last point is the tool's true position. The shift grows in
    proportion to the length along the arm. Base and tool are exact; the points between are approximate, because the
    places where compliance, drives or the ground displace the arm are not computed.

    Args:
        geometry: True geometry.
        q: Joint commands ``(..., n)``, rad or m.
        tool: True tool positions ``(..., 3)``, m, world frame.
    """
    points = nominal_points(geometry, q)
    lengths = np.linalg.norm(np.diff(points, axis=-2), axis=-1)
    along = np.concatenate([np.zeros_like(lengths[..., :1]), np.cumsum(lengths, axis=-1)], axis=-1)
    error = np.asarray(tool, dtype=float) - points[..., -1, :]
    return np.asarray(points + (along / along[..., -1:])[..., None] * error[..., None, :])


def drawn_parts(points: Array) -> list[int]:
    """Return the index, from 0, of the first point of each segment of polylines that is long enough to draw.

    ``points`` ``(..., K, 3)``, m, has one polyline of K points per pose. A segment between neighbouring points is long
    enough if it exceeds `SHORTEST_LINK` in some pose.
    """
    lengths = np.linalg.norm(np.diff(points, axis=-2), axis=-1).reshape(-1, points.shape[-2] - 1)
    return [int(i) for i in np.flatnonzero(lengths.max(axis=0) > SHORTEST_LINK)]
