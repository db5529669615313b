"""The point of the tool that an instrument sees or touches: where a wire is hooked, a ball's centre, a probe's tip.

It is stated in the tool's frame, exactly, within an uncertainty, or not at all; every instrument has its own. SI units.
"""

from __future__ import annotations

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.observations import point_jacobian

TIP = ("tip_x", "tip_y", "tip_z")
"""Names of its coordinates."""

Tip = tuple[float, float, float]
ORIGIN: Tip = (0.0, 0.0, 0.0)


def tool_points(model: ArmModel, joints: Array, conditions: Conditions, tip: Array) -> Array:
    """Where a point ``(3,)`` of the tool's frame is at joints ``(N, n)``: ``(N, 3)``, m."""
    pose = model.pose(joints, conditions)
    return np.asarray(pose.position + pose.rotation @ tip)


def tool_points_jacobian(model: ArmModel, joints: Array, conditions: Conditions, tip: Array) -> tuple[Array, Array]:
    """Its derivatives by the model ``(N, 3, P)`` and by the point's place on the tool ``(N, 3, 3)``."""
    rotation = model.pose(joints, conditions).rotation
    return point_jacobian(model.jacobian(joints, conditions), rotation @ tip), rotation
