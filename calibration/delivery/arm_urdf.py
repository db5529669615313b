"""The corrected arm as a URDF of its own, for arms that have none: rods from the robot's base to the tool.

Written against URDF as ROS 2 has it (version 1.0). A robot's own URDF is patched instead (`onto_urdf`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pickenv.arm import Arm
from pickenv.arm.files.urdf_text import urdf_text
from pickenv.calibration.delivery.origin_lines import provenance
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.files import write_text
from pickenv.texts import one_line


def write_arm_urdf(calibration: Calibration, arm: Arm, path: str | Path) -> Path:
    """Write the corrected arm from the robot's own base to its tool, with where it comes from.

    Frames that were fitted are the instrument's and no part of the robot: base and tool are then the arm's own.
    """
    own = calibration.arm
    tool = own.tool if calibration.record.get("frames") == "fitted" else calibration.identified.tool
    placed = replace(calibration.in_own_base, tool=tool)
    text = urdf_text(placed, f"{arm.name}_calibrated", arm.speed)
    declaration, _, rest = text.partition("\n")
    words = (*provenance(calibration), "written against URDF 1.0, as ROS 2 has it")
    comment = "\n".join(one_line(line).replace("--", "- -") for line in words)
    return write_text(path, f"{declaration}\n<!--\n{comment}\n-->\n{rest}")
