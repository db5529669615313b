"""Differences of poses: position in metres and attitude as a rotation vector, both in world axes.

Formulas take components (floats, NumPy arrays or torch tensors, see `pickenv.arm.kinematics.forward`). Functions of
`Pose` call these formulas. Euler angles are never used, because their differences exaggerate attitude errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pickenv.arm.kinematics.backend import chosen, possible, set_aside
from pickenv.arm.kinematics.forward import Frame, Scalar, Scalars, frame_of, pose_of
from pickenv.arm.kinematics.geometry import Array, Pose

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
    """Return the same vector as `rotation_between`, from the same arguments, but faster for angles up to six degrees.

    It is computed by a series of the arc sine.
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
