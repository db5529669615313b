"""Reading targets for a calibrated arm: our own CSV columns, joints (q1_deg, q2_mm, …) or tool poses (x_mm … rz_deg).

Poses give the tool's rotation vector; other columns of the file are left alone. Faults are named by row and column.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pickenv.arm import Geometry, Pose, inverse, rotation_matrix
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.measurements import joint_columns
from pickenv.calibration.reading.csv_table import read_table
from pickenv.errors import InputError
from pickenv.texts import listed

POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")


@dataclass(frozen=True, eq=False)
class Targets:
    """What the arm is asked to do.

    Attributes:
        joints: Nominal joint targets ``(N, n)``, rad or m; None if poses were given.
        pose: Tool poses, m; None if joints were given.
        lines: Line of each target in its file ``(N,)``, from 1.
        source: The file, for messages.
    """

    joints: Array | None
    pose: Pose | None
    lines: tuple[int, ...]
    source: str

    def __len__(self) -> int:
        """Number of targets."""
        return len(self.lines)


def read_targets(path: str | Path, geometry: Geometry) -> Targets:
    """Read joint targets if the file has all joint columns, else pose targets.

    Args:
        path: CSV file with a header.
        geometry: The arm, for joint count and types.

    Raises:
        InputError: Names the file, and the row and column at fault.
    """
    table = read_table(path)
    wanted = joint_columns(geometry.prismatic)
    as_joints = all(name in table.header for name in wanted)
    if not as_joints and not all(name in table.header for name in POSE_COLUMNS):
        raise InputError(
            f"{path} has neither all joint columns ({', '.join(wanted)}) nor all pose columns "
            f"({', '.join(POSE_COLUMNS)}); it has {listed(table.header)}"
        )
    values = table.values(tuple(wanted) if as_joints else POSE_COLUMNS)
    lines = tuple(table.lines)
    if as_joints:
        scale = np.where(geometry.prismatic, 1e-3, np.radians(1.0))
        return Targets(values * scale, None, lines, table.where)
    pose = Pose(values[:, :3] * 1e-3, rotation_matrix(np.radians(values[:, 3:])))
    return Targets(None, pose, lines, table.where)


def joints_of(targets: Targets, geometry: Geometry) -> Array:
    """The targets as joints ``(N, n)``: as given, or from the inverse kinematics.

    Raises:
        InputError: If a pose cannot be reached.
    """
    if targets.joints is not None:
        return targets.joints
    assert targets.pose is not None
    found = inverse(geometry, targets.pose)
    if not found.reached.all():
        row = targets.lines[int(np.argmin(found.reached))]
        raise InputError(f"{targets.source}: row {row} is a pose that the arm cannot reach; correct or remove the row")
    return found.joints
