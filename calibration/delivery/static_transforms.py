"""Where the instrument stands and what it aims at, as ROS 2's ``static_transform_publisher`` lines.

Written against tf2_ros of ROS 2 Humble and later (``--x`` to ``--qw``, ``--frame-id``, ``--child-frame-id``); metres
and quaternions. The measurement's frame (tracker, camera or board) is published as a child of the robot's base, as the
base is the root of a robot's tree.
"""

from __future__ import annotations

import re

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm.kinematics.geometry import Pose, behind, inverse_pose
from pickenv.calibration.delivery.origin_lines import Document, provenance
from pickenv.calibration.delivery.patched import Correction
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.texts import one_line


def static_transforms(
    calibration: Calibration, robot: Correction | None = None, root: str = "base_link", tip: str = "tool0"
) -> Document:
    """A shell script with a line for the measurement's frame and one for the calibrated tool.

    Args:
        calibration: The calibration.
        robot: How the robot's own file tells of the arm; without it the frames are those of the arm's table.
        root: Name of the robot's base frame.
        tip: Name of the frame that the tool is told in: the file's tip, or the arm's nominal tool.
    """
    for name in (root, tip):
        if not re.fullmatch(r"[\w./-]+", name):
            raise InputError(f"'{one_line(name)}' is no name of a ROS frame; use letters, digits, '_' and '/'")
    own = calibration.arm
    measured = behind(own.base, inverse_pose(calibration.identified.base))
    hand = behind(inverse_pose(own.tool), calibration.identified.tool)
    if robot is not None:
        measured, hand = behind(robot.same.root, measured), robot.chain.hand
    lines = ["#!/bin/sh", *(f"# {one_line(line)}" for line in provenance(calibration))]
    lines += [
        "# for tf2_ros of ROS 2 Humble and later; metres and quaternions",
        f"# measurement_frame: what the measurements are told in (tracker, camera or board), seen from {root}",
        _line(measured, root, "measurement_frame") + " &",
        f"# calibrated_tool: what was measured at the arm's end, seen from {tip}",
        _line(hand, tip, "calibrated_tool"),
    ]
    known = calibration.record.get("frames") != "fitted"
    said = (
        "base and tool were taken as known, so both lines say what the calibration was told"
        if known
        else (f"measurement_frame is where {root} stands for the instrument, if the first joint stands in it as drawn")
    )
    return Document(("\n".join(lines) + "\n").encode(), (said,))


def _line(pose: Pose, frame: str, child: str) -> str:
    turn = Rotation.from_matrix(np.asarray(pose.rotation)).as_quat()
    values = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), [*pose.position, *turn], strict=True))
    numbers = " ".join(f"--{name} {float(value)!r}" for name, value in values.items())
    return f"ros2 run tf2_ros static_transform_publisher {numbers} --frame-id {frame} --child-frame-id {child}"
