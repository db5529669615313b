"""LeRobot's calibration files: read, and given joint offsets.

Written against LeRobot since its hardware redesign of June 2025 (`MotorCalibration`, src/lerobot/motors/motors_bus.py):
a JSON object with ``id``, ``drive_mode``, ``homing_offset``, ``range_min`` and ``range_max`` per motor, in counts. A
Feetech servo reports Present_Position = Actual_Position - Homing_Offset, and LeRobot's degrees are (Present_Position -
middle of the range) 360 / 4095. A joint whose reading lacks some counts is therefore given a homing offset of as many
counts less; the range keeps its numbers, so its ends move along with the zero.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.calibration.delivery.joint_offsets import JointOffsets
from pickenv.calibration.delivery.origin_lines import Document
from pickenv.errors import InputError
from pickenv.texts import listed, parsed, read_text, shortened

COUNTS = 4095
"""Counts that LeRobot takes for a turn of an STS3215: its resolution less one."""

LARGEST_HOMING = 2047
"""The servo keeps a sign and eleven bits."""

FIELDS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")


@dataclass(frozen=True)
class LerobotMotor:
    """One motor of a LeRobot calibration, in counts."""

    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

    def limits(self) -> tuple[float, float]:
        """Smallest and largest reading, rad: half the range to either side of its middle."""
        half = (self.range_max - self.range_min) / COUNTS * np.pi
        return -half, half


def read_lerobot(path: str | Path) -> dict[str, LerobotMotor]:
    """The motors of a LeRobot calibration file, by name.

    Raises:
        InputError: If it is none, or of the old form.
    """
    path = Path(path)
    text = read_text(path, "a LeRobot calibration (.json)")
    found: Any = parsed(lambda: json.loads(text), path, "JSON")
    if isinstance(found, dict) and isinstance(found.get("homing_offset"), list):
        raise InputError(
            f"{path} is a LeRobot calibration from before its redesign of June 2025 (it lists homing_offset by "
            "motor_names); run lerobot-calibrate of a newer LeRobot and give the file that it writes"
        )
    if not isinstance(found, dict) or not found:
        raise InputError(f"{path} names no motors; give the calibration that lerobot-calibrate writes")
    servos = {}
    for name, motor in found.items():
        for field in FIELDS:
            if not isinstance(motor, dict) or type(motor.get(field)) is not int:
                raise InputError(
                    f"{path}: motor '{shortened(name)}' has no whole number '{field}'; give the calibration that "
                    "lerobot-calibrate writes"
                )
        servos[name] = LerobotMotor(**{field: motor[field] for field in FIELDS})
    return servos


def onto_lerobot(found: JointOffsets, path: Path) -> Document:
    """The text of a LeRobot calibration with corrected homing offsets; nothing else in it changes.

    Args:
        found: The offsets, of joints named as the motors are.
        path: The file.

    Raises:
        InputError: If a joint has no motor of its name, or cannot be moved as far.
    """
    servos = read_lerobot(path)
    data = path.read_bytes()
    left, moved = 0.0, 0
    for name, slides, offset in zip(found.names, found.slides, found.offsets, strict=True):
        servo = servos.get(name)
        if servo is None:
            raise InputError(
                f"{path} has no motor '{shortened(name)}', only {listed(servos)}; name the arm's joints as the motors"
            )
        if slides or servo.drive_mode:
            why = "slides" if slides else "has drive_mode 1, which LeRobot reads in one of two ways"
            raise InputError(f"joint '{shortened(name)}' {why}; its homing offset cannot be written")
        exact = float(offset) * COUNTS / (2.0 * np.pi)
        homing = servo.homing_offset - round(exact)
        if abs(homing) > LARGEST_HOMING:
            raise InputError(
                f"joint '{shortened(name)}' would need a homing offset of {homing} counts, but the servo keeps "
                f"{LARGEST_HOMING} at most; turn the horn on by a tooth, or home it elsewhere, and calibrate again"
            )
        left, moved = max(left, abs(exact - round(exact))), max(moved, abs(round(exact)))
        pattern = rf'({re.escape(json.dumps(name))}\s*:\s*\{{[^{{}}]*?"homing_offset"\s*:\s*)-?\d+'.encode()
        data, written = re.subn(pattern, rb"\g<1>" + str(homing).encode(), data)
        if not written:
            raise InputError(
                f"{path}: the homing_offset of '{shortened(name)}' is not where LeRobot writes it; save it anew"
            )
    notes = (
        found.note(),
        f"homing offsets move by up to {moved} counts; rounding to whole counts leaves up to "
        f"{360.0 / COUNTS * left:.2g} deg, and the ends of each range move along with its zero",
        "taken for granted: angles were LeRobot's degrees with its sign (Feetech servos: present = actual - homing)",
        "LeRobot will find on connecting that file and motors differ: let it use the file",
    )
    return Document(data, notes)
