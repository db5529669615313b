"""Attitude conventions by name, and, where a file names none, what each of them would leave after base and tool.

Euler angles are the commonest silent error in tracker files: six readings of the same three numbers all look plausible.
A convention is therefore never guessed; the table shows which one fits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.alignment import align
from pickenv.calibration.model.error_model import frames_model
from pickenv.calibration.model.measurements import Measurements
from pickenv.errors import InputError

GENERAL: dict[str, tuple[str, Callable[[Array], Rotation]]] = {
    "rotation_vector": ("angle", Rotation.from_rotvec),
    "quaternion_wxyz": ("none", lambda v: Rotation.from_quat(v, scalar_first=True)),
    "quaternion_xyzw": ("none", Rotation.from_quat),
    "euler_xyz_extrinsic": ("angle", lambda v: Rotation.from_euler("xyz", v)),
    "euler_xyz_intrinsic": ("angle", lambda v: Rotation.from_euler("XYZ", v)),
    "euler_zyx_extrinsic": ("angle", lambda v: Rotation.from_euler("zyx", v)),
    "euler_zyx_intrinsic": ("angle", lambda v: Rotation.from_euler("ZYX", v)),
    "euler_zyz_intrinsic": ("angle", lambda v: Rotation.from_euler("ZYZ", v)),
}

SAME_AS = {
    "kuka_abc": "euler_zyx_intrinsic",
    "fanuc_wpr": "euler_xyz_extrinsic",
    "abb_quaternion": "quaternion_wxyz",
    "ur_rotation_vector": "rotation_vector",
}
"""Makers' names for conventions that have a general one."""

CONVENTIONS = GENERAL | {maker: GENERAL[general] for maker, general in SAME_AS.items()}
"""Attitude conventions by name: the kind of their unit, and how values (N, 3 or 4), in rad, become rotations."""


def columns_of(convention: str) -> int:
    """Number of columns of a convention: 4 for quaternions, else 3."""
    return 4 if CONVENTIONS[convention][0] == "none" else 3


def rotations(convention: str, values: Array) -> Array:
    """Rotation matrices ``(N, 3, 3)`` of values ``(N, 3 or 4)``, in rad or as quaternions."""
    return np.asarray(CONVENTIONS[convention][1](values).as_matrix())


def convention_table(geometry: Geometry, joints: Array, position: Array, values: Array, where: str) -> str:
    """What each convention leaves after base and tool were fitted, best first, as lines of text.

    Args:
        geometry: Nominal geometry.
        joints: ``(N, n)``, rad or m.
        position: ``(N, 3)``, m.
        values: Attitude columns ``(N, 3 or 4)``, rad or quaternion.
        where: The file, for messages.
    """
    found: list[tuple[float, str]] = []
    for name in GENERAL:
        if columns_of(name) != values.shape[1]:
            continue
        data = Measurements(joints, position, rotations(name, values), geometry.prismatic, source=where)
        data_mean = _left(geometry, data)
        makers = ", ".join(maker for maker, general in SAME_AS.items() if general == name)
        label = f"{name} ({makers})" if makers else name
        found.append((data_mean[1], f"  {label:<42} {data_mean[0]:9.2f} mm  {data_mean[1]:7.2f} deg"))
    return "\n".join(line for _, line in sorted(found))


def _left(geometry: Geometry, data: Measurements) -> tuple[float, float]:
    """Mean position and attitude error after fitting base and tool, mm and deg."""
    try:
        fitted = align(geometry, data, frames_model(geometry), judge=False).geometry
    except (InputError, np.linalg.LinAlgError):
        return np.inf, np.inf
    left = data.difference(fitted)
    means = np.linalg.norm(left[:, :3], axis=1).mean() * 1e3, np.degrees(np.linalg.norm(left[:, 3:], axis=1).mean())
    return float(means[0]), float(means[1])
