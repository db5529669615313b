"""Differences of poses, Jacobians of the tool pose, and the part of a pose error that joint motion can remove.

Positions are in metres and attitudes are rotation vectors, both in world axes. Euler angles are never used, because
their differences exaggerate attitude errors. Formulas take components (floats, NumPy arrays or torch tensors, see
`pickenv.arm.kinematics.forward`).

The hybrid picking arm has six joints but task rank 5 everywhere (J1, J2 and J4 are parallel, J5 and J6 too). Therefore
J^-1 of Qiao 2026 eq (15) does not exist, and the truncated pseudo-inverse takes its place. Singular values below
`DIRECTION_TOLERANCE` times the largest are cut off, and the attitude error along the missing direction is reported
separately. One radian has the weight of one metre unless said otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dgelss
from scipy.spatial.transform import Rotation

from pickenv.arm.kinematics.forward import (
    ONE,
    Frame,
    Scalar,
    Scalars,
    attach,
    chain_of,
    chosen,
    frame_of,
    frames,
    pose_of,
    possible,
    set_aside,
    split_joints,
)
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry, Pose

REVERSED = -0.99
"""Cosine of a rotation angle (172 degrees). At larger angles the axis is computed from the symmetric part of the
matrix, because the sine is too small."""

SMALL_SINE = 0.1
"""Largest sine of a rotation angle at which the series `ARC_SINE` is exact to rounding."""

ARC_SINE = tuple(math.comb(2 * k, k) / 4.0**k / (2 * k + 1) for k in range(8))
"""Taylor coefficients of arcsin(s) / s in s^2."""


def rotation_vector(rotation: ArrayLike) -> Array:
    """Return the rotation vectors ``(..., 3)``, rad, of rotation matrices ``(..., 3, 3)``."""
    rotation = np.asarray(rotation, dtype=float)
    return Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec().reshape(*rotation.shape[:-2], 3)


def rotation_matrix(vector: ArrayLike) -> Array:
    """Return the rotation matrices ``(..., 3, 3)`` of rotation vectors ``(..., 3)``, rad."""
    vector = np.asarray(vector, dtype=float)
    return Rotation.from_rotvec(vector.reshape(-1, 3)).as_matrix().reshape(*vector.shape[:-1], 3, 3)


def rotation_between(m: ModuleType, reference: Scalars, actual: Scalars) -> tuple[Scalar, ...]:
    """Return the rotation vector of R_actual R_reference^T in world axes: three components, rad, of norm up to pi.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        reference: A `Frame`, or its first nine components (its axes), in world axes.
        actual: The `Frame` that is compared with ``reference``, or its first nine components.
    """
    axx, axy, axz, ayx, ayy, ayz, azx, azy, azz = actual[:9]
    bxx, bxy, bxz, byx, byy, byz, bzx, bzy, bzz = reference[:9]
    (sx, sy, sz), (xx, yy, zz) = _turn(reference, actual)
    cosine, sine = 0.5 * (xx + yy + zz - 1.0), m.sqrt(sx * sx + sy * sy + sz * sz)
    angle = m.atan2(sine, cosine)
    scale = angle / (sine + 1e-30)
    vector = scale * sx, scale * sy, scale * sz
    reverse = cosine < REVERSED
    if reverse is False or not possible(m, reverse):
        return vector
    # Half of R + R^T, less the cosine on its diagonal, is (1 - cosine) a a^T: its largest column gives the axis a.
    xy = 0.5 * (axx * bxy + ayx * byy + azx * bzy + axy * bxx + ayy * byx + azy * bzx)
    xz = 0.5 * (axx * bxz + ayx * byz + azx * bzz + axz * bxx + ayz * byx + azz * bzx)
    yz = 0.5 * (axy * bxz + ayy * byz + azy * bzz + axz * bxy + ayz * byy + azz * bzy)
    x_largest, y_largest = (xx >= yy) & (xx >= zz), yy >= zz
    ux = chosen(m, x_largest, xx - cosine, chosen(m, y_largest, xy, xz))
    uy = chosen(m, x_largest, xy, chosen(m, y_largest, yy - cosine, yz))
    uz = chosen(m, x_largest, xz, chosen(m, y_largest, yz, zz - cosine))
    scale = angle / m.sqrt(ux * ux + uy * uy + uz * uz + 1e-30)
    scale = chosen(m, ux * sx + uy * sy + uz * sz < 0.0, -scale, scale)
    return tuple(chosen(m, reverse, scale * u, v) for u, v in zip((ux, uy, uz), vector, strict=True))


def _turn(reference: Scalars, actual: Scalars) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
    """Return sin(angle) times the axis of R = R_actual R_reference^T, and the diagonal of R, three components each.

    ``reference`` and ``actual`` are frames, or their first nine components.
    """
    axx, axy, axz, ayx, ayy, ayz, azx, azy, azz = actual[:9]
    bxx, bxy, bxz, byx, byy, byz, bzx, bzy, bzz = reference[:9]
    # The first is half the sum of the cross products of corresponding axes.
    sx = 0.5 * (bxy * axz - bxz * axy + byy * ayz - byz * ayy + bzy * azz - bzz * azy)
    sy = 0.5 * (bxz * axx - bxx * axz + byz * ayx - byx * ayz + bzz * azx - bzx * azz)
    sz = 0.5 * (bxx * axy - bxy * axx + byx * ayy - byy * ayx + bzx * azy - bzy * azx)
    xx = axx * bxx + ayx * byx + azx * bzx
    yy = axy * bxy + ayy * byy + azy * bzy
    zz = axz * bxz + ayz * byz + azz * bzz
    return (sx, sy, sz), (xx, yy, zz)


def small_rotation(m: ModuleType, reference: Scalars, actual: Scalars) -> tuple[Scalar, ...]:
    """Return the vector of `rotation_between`, computed faster if all angles are below six degrees.

    Small angles are computed by a series of the arc sine, large ones by `rotation_between`, which explains the
    arguments.
    """
    sines, (xx, yy, zz) = _turn(reference, actual)
    sx, sy, sz = sines
    square = sx * sx + sy * sy + sz * sz
    scale = ARC_SINE[-1] * square
    for term in ARC_SINE[-2:0:-1]:
        scale = (scale + term) * square
    scale = scale + ARC_SINE[0]
    vector = scale * sx, scale * sy, scale * sz
    large = (square > SMALL_SINE**2) | (xx + yy + zz < 1.0)
    if set_aside(m, large) or not possible(m, large):
        return vector
    exact = rotation_between(m, reference, actual)
    return tuple(chosen(m, large, part, series) for part, series in zip(exact, vector, strict=True))


def frame_error(
    m: ModuleType, reference: Frame, actual: Frame, rotation: Callable[..., tuple[Scalar, ...]] = rotation_between
) -> tuple[Scalar, ...]:
    """Compute the error of ``actual`` relative to ``reference``, as `pose_error` does for poses.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        reference: The frame from which the error is measured.
        actual: The frame whose error is computed.
        rotation: The function that computes the rotation vector: `rotation_between` or `small_rotation`.

    Returns:
        The components x, y, z, rx, ry, rz (m, rad, world axes).
    """
    apx, apy, apz = actual[9:]
    bpx, bpy, bpz = reference[9:]
    return (apx - bpx, apy - bpy, apz - bpz, *rotation(m, reference, actual))


def displaced_frame(m: ModuleType, frame: Frame, error: Scalars) -> Frame:
    """Return the frame whose `frame_error` relative to ``frame`` is ``error``, by Rodrigues' formula.

    Args:
        m: The namespace of the functions: ``math``, ``numpy`` or ``torch``.
        frame: The frame to displace.
        error: Six components x, y, z, rx, ry, rz (m, rad, world axes).
    """
    dx, dy, dz, wx, wy, wz = error
    square = wx * wx + wy * wy + wz * wz + 1e-40
    angle = m.sqrt(square)
    first, half = m.sin(angle) / angle, m.sin(0.5 * angle)
    second = 2.0 * half * half / square
    turned: list[Scalar] = []
    for i in (0, 3, 6):
        x, y, z = frame[i : i + 3]
        along = second * (wx * x + wy * y + wz * z)
        turned.append(x + first * (wy * z - wz * y) + wx * along - second * square * x)
        turned.append(y + first * (wz * x - wx * z) + wy * along - second * square * y)
        turned.append(z + first * (wx * y - wy * x) + wz * along - second * square * z)
    return (*turned, frame[9] + dx, frame[10] + dy, frame[11] + dz)


def pose_error(reference: Pose, actual: Pose) -> Array:
    """Compute the error of the pose ``actual`` relative to the pose ``reference``, or for batches of poses.

    Returns:
        Array ``(..., 6)``: position difference in m, then the rotation vector of R_actual R_reference^T in rad, both
        in world axes.
    """
    m = math if reference.position.ndim == actual.position.ndim == 1 else np
    return np.stack(np.broadcast_arrays(*frame_error(m, frame_of(reference), frame_of(actual))), axis=-1)


def displace_pose(pose: Pose, error: ArrayLike) -> Pose:
    """Return the pose whose `pose_error` relative to ``pose`` is ``error`` ``(..., 6)``, m and rad."""
    error = np.asarray(error, dtype=float)
    if pose.position.ndim == error.ndim == 1:
        frame = np.array(displaced_frame(math, frame_of(pose), error.tolist()))
        return Pose(frame[9:], frame[:9].reshape(3, 3).T)
    return pose_of(displaced_frame(np, frame_of(pose), list(np.ascontiguousarray(np.moveaxis(error, -1, 0)))))


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
"""Share of the largest singular value below which joint motion cannot move the tool in a direction. On the picking arm
the fifth singular value stays above 0.11 times the first. A real picking arm's sixth singular value stays below 0.001
times the first."""


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
        Two arrays. The first has the directions as orthonormal columns ``(..., 6, 6)`` by falling singular value. A
        column is a position in m, then a rotation vector in rad times ``weight``, in world axes. The second is the task
        rank ``(...)``: the number of directions in which joint motion moves the tool.
    """
    u, s, _ = np.linalg.svd(joint_jacobian(geometry, q) * np.repeat([1.0, weight], 3)[:, None])
    return u, np.sum(s > tolerance * s[..., :1], axis=-1)


def noncompensable_error(
    geometry: Geometry, q: ArrayLike, error: ArrayLike, tolerance: float = DIRECTION_TOLERANCE, weight: float = 1.0
) -> Array:
    """Compute the part ``(..., 6)`` of a pose error that no small joint motion removes.

    This part remains after the joint motion that makes the weighted error smallest. For the picking arm this part is a
    rotation about z1 x z5, because J1, J2 and J4 are parallel, and so are J5 and J6.

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
