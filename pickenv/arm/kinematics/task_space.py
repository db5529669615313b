"""Jacobians of the tool pose, and the part of a pose error that joint motion can remove.

The hybrid picking arm has six joints but task rank 5 everywhere (J1, J2 and J4 are parallel, J5 and J6 too). Therefore
J^-1 of Qiao 2026 eq (15) does not exist, and the truncated pseudo-inverse takes its place. Singular values below
`DIRECTION_TOLERANCE` times the largest are cut off, and the attitude error along the missing direction is reported
separately. One radian has the weight of one metre unless said otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dgelss

from pickenv.arm.kinematics.backend import ONE
from pickenv.arm.kinematics.forward import Frame, Scalar, Scalars, attach, chain_of, frames, pose_of, split_joints
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry, Pose

# Joint and parameter Jacobians of the tool pose, analytic: in components, with a NumPy face for batches of poses.
# Rows are position (m) and rotation vector (rad) in world axes. The parameter Jacobian is Qiao 2026 eq (8) read as
# the horizontal concatenation [J_1^6 V_1 ... J_6^6 V_6] (the paper prints a sum), turned from tool into world axes,
# and extended by Hayati's beta, the base and the tool.


FEW = 8
"""Largest number of poses that are computed one by one, because this is faster than arrays."""

Column = tuple[Scalar, ...]
"""One column of a Jacobian, six components: position (m) and rotation vector (rad) in world axes."""


def link_column(kind: str, before: Scalars, after: Scalars, tool: Scalars, twist: Scalars) -> Column:
    """Return the derivative of the tool pose with respect to one parameter of a link.

    Several links are computed together if they are stacked along an axis of the components.

    Args:
        kind: Name of the parameter, from `LINK_PARAMETERS`.
        before: Frame of the parent link, twelve components, world axes; not used for theta and d.
        after: Frame of the link, twelve components, world axes; only used for theta and d.
        tool: Origin of the tool, three components, world axes, m.
        twist: Cosine and sine of the link's alpha, and its a; only used for beta.
    """
    x, y, z, px, py, pz = after[6:] if kind in ("theta", "d") else (*before[:3], *before[9:])
    if kind in ("a", "d"):
        return x, y, z, 0.0, 0.0, 0.0
    u, v, w = tool[0] - px, tool[1] - py, tool[2] - pz
    if kind == "beta":  # about y after Rot(x, alpha) and Trans(x, a)
        cosine, sine, a = twist
        u, v, w = u - a * x, v - a * y, w - a * z
        x, y, z = (cosine * along + sine * up for along, up in zip(before[3:6], before[6:9], strict=True))
    return y * w - z * v, z * u - x * w, x * v - y * u, x, y, z


def jacobian_columns(geometry: Geometry, links: Sequence[Frame], tool: Frame) -> list[Column]:
    """Return the columns of the joint Jacobian, one per joint.

    Args:
        geometry: The arm.
        links: Frames of base and links, from `pickenv.arm.kinematics.forward.frames`.
        tool: Frame of the tool, world axes.
    """
    hand = tool[9:]
    pairs = zip(geometry.slides, links[1:], strict=True)
    columns = [link_column("d" if slides else "theta", (), link, hand, ()) for slides, link in pairs]
    if geometry.tree is not None:
        signs = geometry.senses.tolist()
        columns = [tuple(sign * part for part in column) for sign, column in zip(signs, columns, strict=True)]
    if geometry.coupling is None:
        return columns
    gathered: list[Column] = [(0.0,) * 6] * geometry.joints
    for joint, ratio, column in zip(geometry.coupling.joint, geometry.coupling.ratio, columns, strict=True):
        gathered[joint] = tuple(total + ratio * part for total, part in zip(gathered[joint], column, strict=True))
    return gathered


def joint_jacobian(geometry: Geometry, q: ArrayLike) -> Array:
    """Compute the Jacobian of the tool pose with respect to the joints.

    Args:
        geometry: The arm.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Array ``(..., 6, n)``: rows position (m) and rotation vector (rad) in world axes, per rad or m (eq (13)).
    """
    links, tool, shape = _frames(geometry, q)
    return np.moveaxis(_stacked(jacobian_columns(geometry, links, tool), shape), (0, 1), (-2, -1))


def _stacked(columns: Sequence[Scalars], shape: tuple[int, ...]) -> Array:
    """Stack n columns or frames, of k components each, into an array ``(k, n, *shape)``; components broadcast."""
    stacked = np.empty((len(columns[0]), len(columns), *shape))
    for i, column in enumerate(columns):
        for row, value in enumerate(column):
            stacked[row, i] = value
    return stacked


def pose_and_jacobian(geometry: Geometry, q: Array) -> tuple[Pose, Array]:
    """Return the tool poses and the joint Jacobians ``(K, 6, n)`` at joints ``(K, n)`` of a single geometry.

    Both come from one pass over the links. Up to `FEW` poses are computed one by one in floats, which is faster than
    arrays and gives the same bits.
    """
    if len(q) > FEW:
        links, tool, shape = _frames(geometry, q)
        jacobian = _stacked(jacobian_columns(geometry, links, tool), shape)
        return pose_of(tool), np.moveaxis(jacobian, (0, 1), (-2, -1))
    chain, tools, jacobian = chain_of(geometry), [], np.empty((len(q), geometry.joints, 6))
    for row, joints in enumerate(q.tolist()):
        links = frames(ONE, chain, joints)
        tools.append(attach(chain.hand(links), chain.tool))
        jacobian[row] = jacobian_columns(geometry, links, tools[-1])
    parts: Array = np.array(tools).reshape(-1, 12)
    return Pose(parts[:, 9:], parts[:, :9].reshape(-1, 3, 3).swapaxes(-1, -2)), jacobian.swapaxes(-1, -2)


def parameter_jacobian(geometry: Geometry, q: ArrayLike) -> Array:
    """Compute the Jacobian of the tool pose with respect to all parameters of the geometry.

    Args:
        geometry: The arm.
        q: Joint displacements ``(..., n)``, rad or m.

    Returns:
        Array ``(..., 6, 5L + 12)``. Columns are in the order of ``geometry.parameter_names``, rows as in
        `joint_jacobian`. The values of one entry at all poses are contiguous in memory.
    """
    n = geometry.links
    frame_list, tool_frame, shape = _frames(geometry, q)
    links, tool = _stacked(frame_list, shape), _stacked([tool_frame[9:]], shape)[:, 0]  # components first
    jacobian = np.zeros((6, 5 * n + 12, *shape))
    angles = np.cos(geometry.alpha), np.sin(geometry.alpha), geometry.a
    twist = [np.moveaxis(np.broadcast_to(values, (*shape, n)), -1, 0) for values in angles]
    parents = slice(0, n) if geometry.tree is None else np.array(geometry.tree.parent) + 1
    before, after, origin = tuple(links[:, parents]), tuple(links[:, 1:]), tuple(tool)
    for k, kind in enumerate(LINK_PARAMETERS):
        for row, value in enumerate(link_column(kind, before, after, origin, twist)):
            jacobian[row, k * n : (k + 1) * n] = value
    if geometry.tree is not None:
        jacobian[:, : 5 * n] *= np.tile(geometry.senses, 5).reshape(-1, *[1] * len(shape))
    position, turn = jacobian[:3], jacobian[3:]
    base, hand = 5 * n, 5 * n + 6
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        position[k, base + k] = 1.0
        turn[k, base + 3 + k] = 1.0
        position[i, base + 3 + k] = geometry.base.position[j] - tool[j]  # axis k crossed with the lever
        position[j, base + 3 + k] = tool[i] - geometry.base.position[i]
        position[:, hand + k] = turn[:, hand + 3 + k] = links[3 * k : 3 * k + 3, geometry.hand + 1]
    return np.moveaxis(jacobian, (0, 1), (-2, -1))


def _frames(geometry: Geometry, q: ArrayLike) -> tuple[list[Frame], Frame, tuple[int, ...]]:
    """Return the frames of base and links, the frame of the tool, and the batch shape of the joints ``(..., n)``.

    Frames are in world axes. Their components are floats if ``q`` is a single pose.
    """
    joints = split_joints(geometry.joints, q)
    shape = np.broadcast_shapes(joints[0].shape, geometry.alpha.shape[:-1])
    m = np if shape else math
    chain = chain_of(geometry, math if geometry.alpha.ndim == 1 else np)
    links = frames(m, chain, joints if shape else [value.item() for value in joints])
    return links, attach(chain.hand(links), chain.tool), shape


DIRECTION_TOLERANCE = 5e-3
"""Share of the largest singular value below which joint motion cannot move the tool in a direction.

On the picking arm the fifth singular value stays above 0.11 of the first, and a real arm's sixth below 0.001.
"""


POSITION_FIRST = 0.05
"""Weight of a radian, in m, for arms of fewer than six joints, which cannot reach position and attitude together."""


def attitude_weight(joints: int) -> float:
    """Return the length, m, that counts as much as a radian in the tool pose of an arm with this number of joints."""
    return 1.0 if joints >= 6 else POSITION_FIRST


def truncated_inverse(jacobian: Array, tolerance: float = DIRECTION_TOLERANCE) -> Array:
    """Compute the pseudo-inverse ``(..., n, 6)`` of ``jacobian`` ``(..., 6, n)`` without small singular values.

    Args:
        jacobian: Jacobians ``(..., 6, n)``.
        tolerance: Share of the largest singular value below which singular values are cut off.
    """
    if jacobian.ndim > 2:
        return np.asarray(np.linalg.pinv(jacobian, rcond=tolerance))
    rows, n = jacobian.shape  # one matrix: LAPACK itself, without NumPy's overhead
    return np.asarray(dgelss(jacobian, np.eye(max(n, rows), rows), cond=tolerance)[1][:n])


def task_directions(
    geometry: Geometry, q: ArrayLike, tolerance: float = DIRECTION_TOLERANCE, weight: float = 1.0
) -> tuple[Array, Array]:
    """Compute the directions of tool motion (left singular vectors of the joint Jacobian) and the task rank.

    Args:
        geometry: The arm.
        q: Joints ``(..., n)``, rad or m.
        tolerance: Share of the largest singular value below which joint motion cannot move the tool in a direction.
        weight: Length, m, that counts as much as a radian.

    Returns:
        Orthonormal columns ``(..., 6, 6)`` by falling singular value (position in m, then the rotation vector in rad
        times ``weight``, world axes), and the task rank ``(...)``: the number of directions in which joint motion moves
        the tool.
    """
    u, s, _ = np.linalg.svd(joint_jacobian(geometry, q) * np.repeat([1.0, weight], 3)[:, None])
    return u, np.sum(s > tolerance * s[..., :1], axis=-1)


def noncompensable_error(
    geometry: Geometry, q: ArrayLike, error: ArrayLike, tolerance: float = DIRECTION_TOLERANCE, weight: float = 1.0
) -> Array:
    """Compute the part ``(..., 6)`` of a pose error that no small joint motion removes.

    It is what remains of the error after the joint motion that makes the weighted error smallest. For the picking arm
    this part is a rotation about z1 x z5, because J1, J2 and J4 are parallel, and so are J5 and J6.

    Args:
        geometry: The arm.
        q: Joints ``(..., n)``, rad or m.
        error: Pose errors ``(..., 6)``, m and rad, world axes.
        tolerance: Share of the largest singular value below which joint motion cannot move the tool in a direction.
        weight: Length, m, that counts as much as a radian.
    """
    weights = np.repeat([1.0, weight], 3)
    u, rank = task_directions(geometry, q, tolerance, weight)
    along = np.einsum("...ij,...i->...j", u, np.asarray(error, dtype=float) * weights)
    along *= np.arange(6) >= rank[..., None]  # what no joint motion reaches
    return np.asarray(np.einsum("...ij,...j->...i", u, along) / weights)


def damped_step(m: ModuleType, columns: Sequence[Column], twist: Scalars, damping: float) -> list[Scalar]:
    """Compute the joint motion for a small tool motion by damped least squares.

    Near a singular pose, damping keeps the joint motion small; the tool then moves less in the lost direction
    (Wampler 1986; Nakamura and Hanafusa 1986). A single arm gets the same bits as one arm of a batch.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        columns: Columns of the Jacobian, one per joint, each as long as ``twist``. Scale the rows to comparable units.
        twist: The wanted tool motion, in the units of the rows.
        damping: Damping, as a share of the sum of squares of all entries of the Jacobian.

    Returns:
        The motion of each joint, rad or m.
    """
    rows = range(len(twist))
    square = [[sum(column[i] * column[j] for column in columns) for j in range(i + 1)] for i in rows]
    least = damping * sum(square[i][i] for i in rows) + 0.0 * twist[0]
    factor: list[list[Scalar]] = []  # Cholesky's, of the damped square
    for i in rows:
        factor.append([])
        for j in range(i):
            factor[i].append((square[i][j] - sum(factor[i][k] * factor[j][k] for k in range(j))) / factor[j][j])
        factor[i].append(m.sqrt(square[i][i] + least - sum(part * part for part in factor[i])))
    solved = list(twist)
    for i in rows:
        solved[i] = (solved[i] - sum(factor[i][k] * solved[k] for k in range(i))) / factor[i][i]
    for i in reversed(rows):
        solved[i] = (solved[i] - sum(factor[k][i] * solved[k] for k in rows[i + 1 :])) / factor[i][i]
    return [sum(column[i] * solved[i] for i in rows) for column in columns]
