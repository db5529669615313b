"""Reduce a calibration to joint offsets, and state the errors that these cannot correct.

Controllers and servos often take one number per joint: the error of its reading. Least squares finds the offsets that
bring the nominal arm nearest to the calibrated one over the region where it was measured. Pose differences in m and in
rad have equal weight; if only positions were measured, only positions count. The errors that offsets cannot correct are
stated in mm. If base and tool were fitted, a part of the offsets has the same effect as a motion of base or tool.
This part is left to base and tool. For a revolute first joint it is the whole offset. SI units.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from pickenv.arm import Array, Geometry, forward, joint_jacobian, parameter_jacobian, pose_error, rotation_vector
from pickenv.arm.kinematics.geometry import FRAME_PARAMETERS, LINK_PARAMETERS
from pickenv.base import InputError, decimal_number, listed, one_line, read_text, register, shortened
from pickenv.base.files import parsed
from pickenv.calibration.delivery import document
from pickenv.calibration.identification.least_squares import is_angle
from pickenv.calibration.model.arm_model import frames_model
from pickenv.calibration.model.measurements import screen_unit
from pickenv.calibration.pipeline.calibration import Calibration, uncertainty_from

STEPS = 6
"""Number of Gauss-Newton steps; offsets of a few degrees need three."""

LOST = 1e-6
"""Effect of an offset on poses, as a share of the largest such effect, below which the offset is not determined."""

SPREAD = 256
"""Number of poses at which the nominal and the calibrated arm are compared if the caller passes no joint values."""


@dataclass(frozen=True, eq=False)
class JointOffsets:
    """Offsets of joint readings: the true joint value is the reading plus the offset.

    Attributes:
        offsets: Offsets (n,), rad or m; 0 if the data do not determine an offset.
        untold: Names of the joints whose offsets the data do not determine.
        deviation: Standard deviations of the offsets (n,), rad or m; NaN if the calibration holds no covariance or the
            data do not determine the offset.
        without: Mean position difference between nominal and calibrated arm over the poses, m.
        left: Mean position difference that remains with the offsets, m.
        left_turn: Mean attitude difference that remains with the offsets, rad; None if only positions were measured.
        poses: Number of poses at which the arms were compared.
        region: Words for these poses in messages, such as "poses within the joint limits".
    """

    offsets: Array
    untold: tuple[str, ...]
    deviation: Array
    without: float
    left: float
    left_turn: float | None
    poses: int
    region: str

    def note(self) -> str:
        """Return a sentence that says how much the offsets correct, and which difference remains."""
        turn = "" if self.left_turn is None else f" and {np.degrees(self.left_turn):.3g} deg"
        untold = f"; of {', '.join(self.untold)} these data tell none" if self.untold else ""
        return (
            f"joint offsets alone: over {self.poses} {self.region} the nominal arm lies {self.without * 1e3:.3g} mm "
            f"from the calibrated one, with these offsets {self.left * 1e3:.3g} mm{turn} (means); the rest of the "
            f"calibration is left out{untold}"
        )


def joint_offsets(calibration: Calibration, joints: Array | None = None) -> JointOffsets:
    """Compute the joint offsets that bring the nominal arm nearest to the calibrated arm.

    Args:
        calibration: A calibration of any arm.
        joints: Joint values ``(N, n)``, rad or m, at which the arms are compared. If None, they fill the measured
            joint ranges, or the joint limits if the calibration holds no ranges.

    Raises:
        InputError: If the calibration's terms need payloads, temperatures or torques, which offsets cannot follow.
    """
    joints, region = _filling(calibration) if joints is None else (joints, "poses given")
    try:
        target = calibration.predict(joints)
    except InputError as error:
        raise InputError(f"offsets cannot follow this calibration's terms: {error}; give `terms='none'`") from error
    fitted = calibration.record.get("frames") == "fitted"
    columns = frames_model(calibration.arm).columns[: None if fitted else 0]
    rows = slice(0, 3 if calibration.record.get("kind") == "position" else 6)
    nominal = calibration.nominal
    offsets = np.zeros(nominal.joints)
    without = np.linalg.norm(pose_error(forward(nominal, joints), target)[:, :3], axis=1).mean()
    for _ in range(STEPS):
        missed = pose_error(forward(nominal, joints + offsets), target)[:, rows].ravel()
        way, effect, frames = _way(nominal, joints + offsets, rows, columns)
        step = way @ missed
        offsets = offsets + step
        if fitted:
            delta = np.zeros(len(nominal.parameter_names))
            delta[columns] = np.linalg.lstsq(frames, missed - effect @ step, rcond=LOST)[0]
            nominal = nominal.displaced(delta)
    errors = pose_error(forward(nominal, joints + offsets), target)
    left, turn = (float(np.linalg.norm(part, axis=1).mean()) for part in (errors[:, :3], errors[:, 3:]))
    untold = tuple(name for name, row in zip(nominal.joint_names, way, strict=True) if not row.any())
    deviation, left_turn = _deviation(calibration, joints, rows, columns), None if rows.stop == 3 else turn
    return JointOffsets(offsets, untold, deviation, float(without), left, left_turn, len(joints), region)


def _way(nominal: Geometry, joints: Array, rows: slice, columns: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Compute the linear maps between pose differences, joint offsets and changes of base and tool.

    Args:
        nominal: The geometry.
        joints: Joint values ``(N, n)``, rad or m.
        rows: Slice of the components of a pose difference that count: the first 3, or all 6.
        columns: Indices, from 0, of the parameters of base and tool that were fitted; empty if both are known.

    Returns:
        Three matrices. The first maps pose differences to the offsets that correct them, without the part that base and
        tool can correct too. The second maps changes of offsets to changes of poses. The third maps changes of the
        parameters of base and tool to changes of poses.
    """
    count = len(joints) * rows.stop
    effect = joint_jacobian(nominal, joints)[:, rows].reshape(count, -1)
    frames = parameter_jacobian(nominal, joints)[:, rows, columns].reshape(count, len(columns))
    beyond = effect - frames @ np.linalg.lstsq(frames, effect, rcond=LOST)[0]
    size = np.linalg.norm(beyond, axis=0)
    large = size > LOST * size.max()
    way = np.zeros(beyond.T.shape)
    way[large] = np.linalg.pinv(beyond[:, large], rcond=LOST)
    return way, effect, frames


def _deviation(calibration: Calibration, joints: Array, rows: slice, columns: NDArray[np.int64]) -> Array:
    """Compute standard deviations of the offsets (n,), rad or m, from the parameters' covariance; NaN if unknown.

    `_way` explains the arguments ``joints``, ``rows`` and ``columns``.
    """
    sure = uncertainty_from(calibration.without_residual().record)
    if sure is None:
        return np.full(calibration.arm.joints, np.nan)
    nominal = calibration.nominal
    places = [i for i, name in enumerate(sure.names) if name in nominal.parameter_names]
    identified = [nominal.parameter_names.index(sure.names[i]) for i in places]
    way, *_ = _way(nominal, joints, rows, columns)
    way = way @ parameter_jacobian(nominal, joints)[:, rows, identified].reshape(way.shape[1], -1)
    variance = np.einsum("ij,jk,ik->i", way, sure.covariance[np.ix_(places, places)], way)
    return np.where(way.any(axis=1), np.sqrt(variance), np.nan)


def _filling(calibration: Calibration) -> tuple[Array, str]:
    """Return joint values that fill the measured joint ranges, or else the joint limits, and words for this region.

    The values are a Halton sequence, so they are always the same for one calibration.
    """
    arm, ranges = calibration.arm, calibration.record.get("joint_ranges")
    low, high = (arm.lower, arm.upper) if ranges is None else np.array(ranges, dtype=float)
    half = np.minimum((high - low) / 2, np.where(arm.prismatic, np.inf, np.pi))  # a turn at most
    unit = qmc.Halton(arm.joints, scramble=False).random(SPREAD + 1)[1:]
    joints = (low + high) / 2 + half * (2.0 * unit - 1.0)
    return np.asarray(joints), f"poses within the {'joint limits' if ranges is None else 'ranges measured'}"


# LeRobot's calibration files: read, and given joint offsets. Written against LeRobot since its hardware redesign of
# June 2025 (`MotorCalibration`, src/lerobot/motors/motors_bus.py): a JSON object with ``id``, ``drive_mode``,
# ``homing_offset``, ``range_min`` and ``range_max`` per motor, in counts. A Feetech servo reports Present_Position =
# Actual_Position - Homing_Offset, and LeRobot's degrees are (Present_Position - middle of the range) 360 / 4095. A
# joint whose reading lacks some counts is therefore given a homing offset of as many counts less; the range keeps its
# numbers, so its ends move along with the zero.


COUNTS = 4095
"""Number of counts that LeRobot takes for one turn of an STS3215 servo: the servo's resolution minus one."""

LARGEST_HOMING = 2047
"""Largest homing offset of the servo, in counts; the servo stores it as a sign and eleven bits."""

FIELDS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")


def _lerobot_motors(path: Path) -> dict[str, dict[str, int]]:
    """Return the motors of a LeRobot calibration file by name, each with the whole numbers of `FIELDS`."""
    text = read_text(path, "a LeRobot calibration (.json)")
    motors: Any = parsed(lambda: json.loads(text), path, "JSON")
    if isinstance(motors, dict) and isinstance(motors.get("homing_offset"), list):
        raise InputError(
            f"{path} is a LeRobot calibration from before its redesign of June 2025 (it lists homing_offset by "
            "motor_names); run lerobot-calibrate of a newer LeRobot and give the file that it writes"
        )
    if not isinstance(motors, dict) or not motors:
        raise InputError(f"{path} names no motors; give the calibration that lerobot-calibrate writes")
    for name, motor in motors.items():
        for field in FIELDS:
            if not isinstance(motor, dict) or type(motor.get(field)) is not int:
                place = f"{path}: motor '{shortened(name)}'"
                raise InputError(f"{place} has no whole number '{field}'; give what lerobot-calibrate writes")
    return motors


@register("exporter", "lerobot")
def lerobot_document(calibration: Calibration, order: document.Order) -> document.Document:
    """Make the robot's own LeRobot calibration file with corrected homing offsets; nothing else in it changes.

    ``order`` holds the options of the export.

    Raises:
        InputError: If no such file is given or it is unusable. Also if a joint has no motor of its name, is prismatic
            or has drive_mode 1. Also if a homing offset is larger than the servo can hold.
    """
    path = order.onto
    if path is None:
        raise InputError("a LeRobot file keeps ids and ranges; give `onto`, the one that lerobot-calibrate wrote")
    shift, servos = joint_offsets(calibration), _lerobot_motors(path)
    data = path.read_bytes()
    arm, exact = calibration.arm, shift.offsets * COUNTS / (2.0 * np.pi)
    counts = np.rint(exact).astype(int)
    for name, slides, count in zip(arm.joint_names, arm.prismatic, counts.tolist(), strict=True):
        servo = servos.get(name)
        if servo is None:
            raise InputError(f"{path} has no motor '{shortened(name)}', only {listed(servos)}; name joints as motors")
        if slides or servo["drive_mode"]:
            why = "slides" if slides else "has drive_mode 1, which LeRobot reads in one of two ways"
            raise InputError(f"joint '{shortened(name)}' {why}; its homing offset cannot be written")
        homing = servo["homing_offset"] - count
        if abs(homing) > LARGEST_HOMING:
            raise InputError(
                f"joint '{shortened(name)}' would need a homing offset of {homing} counts, but the servo keeps "
                f"{LARGEST_HOMING} at most; turn the horn on by a tooth, or home it elsewhere, and calibrate again"
            )
        pattern = rf'({re.escape(json.dumps(name))}\s*:\s*\{{[^{{}}]*?"homing_offset"\s*:\s*)-?\d+'.encode()
        data, written = re.subn(pattern, rb"\g<1>" + str(homing).encode(), data)
        if not written:
            raise InputError(f"{path}: homing_offset of '{shortened(name)}' is not where LeRobot writes it; save anew")
    notes = (
        shift.note(),
        f"homing offsets move by up to {np.abs(counts).max()} counts; rounding to whole counts leaves up to "
        f"{360.0 / COUNTS * np.abs(exact - counts).max():.2g} deg, and the ends of each range move along with its zero",
        "taken for granted: angles were LeRobot's degrees with its sign (Feetech servos: present = actual - homing)",
        "LeRobot will find on connecting that file and motors differ: let it use the file",
    )
    return document.Document(data, notes)


# Joint offsets as files: a table with encoder counts, and ros2_control parameters. The arm stands at a joint's
# reading plus its offset (`joint_offsets`). Tables are in degrees and mm; ros2_control's parameters in rad and m.
# Written against dynamixel_hardware of July 2026, whose joints take ``<param name="offset">`` and report raw minus
# offset.


TABLE_FORMAT = "pickenv joint offsets 1"


@register("exporter", "offsets")
def offset_table(calibration: Calibration, order: document.Order) -> document.Document:
    """Make a table of the offsets to add to joint readings, as CSV, or as JSON if the file ends in .json.

    Offsets are in deg or mm. If ``order``, the options of the export, has encoder counts per turn, revolute joints also
    have their offset in whole counts.
    """
    rows: list[dict[str, Any]] = []
    shift = joint_offsets(calibration)
    joints = zip(calibration.arm.joint_names, calibration.arm.prismatic, shift.offsets, shift.deviation, strict=True)
    for name, slides, value, deviation in joints:
        unit, scale = screen_unit(slides)
        row: dict[str, Any] = {"joint": name, "unit": unit, "add_to_reading": float(value * scale)}
        row["standard_deviation"] = None if np.isnan(deviation) else float(deviation * scale)
        if order.counts_per_turn is not None:
            row["counts"] = None if slides else round(value * order.counts_per_turn / (2.0 * np.pi))
        rows.append(row)
    return _table(rows, order.out, TABLE_FORMAT, calibration, (shift.note(),))


def _table(
    rows: list[dict[str, Any]], out: Path, form: str, calibration: Calibration, notes: tuple[str, ...]
) -> document.Document:
    """Make a document of rows: CSV below comment lines (None is an empty cell), or JSON if ``out`` ends in .json.

    Args:
        rows: The rows as dictionaries, all with the same columns.
        out: The file to write.
        form: Name and version of the format, for the head of the document.
        calibration: The calibration, whose origin the head states too.
        notes: Sentences for the head and for `Document.notes`.
    """
    words = (*document.provenance(calibration), *notes)
    if out.suffix.lower() == ".json":
        content = {"format": form, "origin": list(words), "rows": rows}
        return document.Document((json.dumps(content, indent=2) + "\n").encode(), notes)
    text = io.StringIO("".join(f"# {one_line(line)}\n" for line in (form, *words)))
    text.seek(0, io.SEEK_END)
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return document.Document(text.getvalue().encode(), notes)


@register("exporter", "ros2-control")
def ros2_offsets(calibration: Calibration, order: document.Order) -> document.Document:
    """Write the offsets as ros2_control parameters into the robot's own description, or into a new file.

    A joint reports its raw reading minus its parameter "offset", rad or m. The reading must grow by the calibration's
    offset, so this offset is subtracted from the joint's parameter. A new file holds the joints alone, without the ids
    of servos. ``order`` holds the options of the export.

    Raises:
        InputError: If the description is unusable, or a joint is not in it.
    """
    onto, shift = order.onto, joint_offsets(calibration)
    notes, offsets = (shift.note(),), dict(zip(calibration.arm.joint_names, shift.offsets, strict=True))
    if onto is None:
        rule = "reported = raw - offset, rad and m; take each off the offset that your joint has, if any"
        origin = (*document.provenance(calibration), f"for dynamixel_hardware of July 2026: {rule}")
        lines = [*document.xml_comment(origin), "<ros2_control>"]
        for name, value in offsets.items():
            lines += [f"  <joint name={quoteattr(one_line(name))}>", f"    {_param(value)}", "  </joint>"]
        return document.Document(("\n".join([*lines, "</ros2_control>"]) + "\n").encode(), notes)
    read_text(onto, "a robot description")
    data = onto.read_bytes()
    tags = parsed(lambda: document.start_tags(data), onto, "XML")
    controls = {i for i, tag in enumerate(tags) if tag.name == "ros2_control"}
    places = [i for i, tag in enumerate(tags) if tag.name == "joint" and tag.parent in controls]
    joints = {tags[i].attributes.get("name", ""): i for i in places}
    edits: list[document.Edit] = []
    for name, value in offsets.items():
        if name not in joints:
            names = "no <ros2_control> joint at all" if not joints else f"only {', '.join(map(shortened, joints))}"
            raise InputError(f"{onto} has no <ros2_control> joint '{shortened(name)}', {names}; name them as the arm's")
        place = joints[name]
        param = next((tag for tag in tags if tag.parent == place and tag.is_named("param", "offset")), None)
        if param is None:
            edits.append(document.inserted_first(data, tags[place], _param(value)))
            continue
        end = data.index(b"<", param.end)
        before = decimal_number(data[param.end : end].decode().strip())
        if before is None or not np.isfinite(before):
            raise InputError(f"{onto}: the offset of joint '{shortened(name)}' is no number; write one, in rad or m")
        edits.append((param.end, end, repr(before - float(value)).encode()))
    return document.Document(document.edited(data, edits), notes)


def _param(offset: float) -> str:
    """Return the XML of a joint's new parameter "offset": minus the calibration's ``offset``."""
    return f'<param name="offset">{0.0 - float(offset)!r}</param>'


# The corrected parameters as a plain table: modified and standard DH, before, after, change, standard deviation.
# Modified (Craig): Rot(x, alpha) Trans(x, a) Rot(y, beta) Rot(z, theta) Trans(z, d), row i leads from link i - 1 to
# i. Standard (Denavit, Hartenberg): Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha) Rot(y, beta): the same
# factors, grouped anew, so alpha, a and beta stand a row earlier; what comes before the first and after the last is
# the table's row 0 and, in the last row, what the tool holds of it (zero here). Hayati's beta is zero where no axes
# are parallel or meet at a small angle.


DH_TABLES_TABLE_FORMAT = "pickenv DH parameters 1"
BEHIND = ("alpha", "a", "beta")
"""DH parameters that are one row earlier in a standard DH table than in a modified one."""
KEPT = "parameters without a standard deviation were not identified and keep their nominal values; others absorb them"


@register("exporter", "table")
def dh_table(calibration: Calibration, order: document.Order) -> document.Document:
    """Make a table of the DH parameters before and after calibration, as CSV, or as JSON if the file ends in .json.

    Angles are in deg, lengths in mm. Parameters are given for the modified and for the standard convention. A
    parameter that was not identified keeps its nominal value and has no standard deviation. ``order`` holds the options
    of the export.
    """
    notes = (KEPT, *document.left_out(calibration, "not in the table, because no geometry can hold it"))
    sure = uncertainty_from(calibration.without_residual().record)
    std = {} if sure is None else dict(zip(sure.names, np.sqrt(np.diag(sure.covariance)), strict=True))
    nominal, identified = _parameters(calibration.nominal), _parameters(calibration.identified)
    rows = []
    heads = ("table", "row", "joint", "parameter", "unit", "nominal", "corrected", "change", "standard_deviation")
    for *place, name in _table_rows(calibration.identified):
        unit, scale = screen_unit(not is_angle(name))
        before, after = (float(values.get(name, 0.0) * scale) for values in (nominal, identified))
        deviation = float(std[name] * scale) if name in std else None
        cells = (*place, name.rstrip("0123456789"), unit, before, after, after - before, deviation)
        rows.append(dict(zip(heads, cells, strict=True)))
    return _table(rows, order.out, DH_TABLES_TABLE_FORMAT, calibration, notes)


def _parameters(geometry: Geometry) -> dict[str, float]:
    """Return a geometry's parameters by name, rad and m, in the order of `parameter_names`."""
    links = [getattr(geometry, kind) for kind in LINK_PARAMETERS]
    frames = [[*pose.position, *rotation_vector(pose.rotation)] for pose in (geometry.base, geometry.tool)]
    return dict(zip(geometry.parameter_names, np.concatenate([*links, *frames]).tolist(), strict=True))


def _table_rows(geometry: Geometry) -> Iterator[tuple[str, int, str, str]]:
    """Yield table name, row number, joint and parameter for each line of the modified and the standard DH table.

    Rows of links are numbered from 1; row 0 of the standard table is the base. Base and tool follow as separate tables.
    Parameters are named as in the modified table.
    """
    for table, shift in (("modified", 0), ("standard", 1)):
        for i, joint in enumerate(geometry.link_names):
            for kind in LINK_PARAMETERS:
                yield table, i + 1, joint, f"{kind}{i + shift if kind in BEHIND else i + 1}"
    for kind in BEHIND:
        yield "standard", 0, "base", f"{kind}0"
    for frame in ("base", "tool"):
        for axis in FRAME_PARAMETERS:
            yield frame, 0, frame, f"{frame}_{axis}"
