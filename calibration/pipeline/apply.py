"""Apply a calibration: turn targets into corrected joint commands, each with its remaining error and uncertainty.

A joint target means the pose that the nominal arm would take there. Pose targets are first turned into nominal joints
by the inverse kinematics. The joints are then corrected by Qiao 2026 eqs (13)-(16), with a Jacobian inverse that
is truncated to the task's rank. A learnt residual model, if there is one, is part of the correction. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Array, Geometry, Pose, forward, inverse, joint_jacobian, noncompensable_error, pose_error
from pickenv.arm.kinematics.geometry import behind, inverse_pose
from pickenv.arm.kinematics.task_space import attitude_weight, truncated_inverse
from pickenv.base import InputError
from pickenv.calibration.compensation.compensator import Compensator
from pickenv.calibration.model.arm_model import Conditions
from pickenv.calibration.model.measurements import joint_columns, screen_units, write_table
from pickenv.calibration.pipeline.calibration import QUANTITIES, Calibration, Sizes
from pickenv.calibration.reading.read import Targets

POSITION_TOLERANCE = 1e-5
"""Position error that joint motion could remove, m, above which a target counts as not reached."""

ATTITUDE_TOLERANCE = 2e-5
"""Attitude error that joint motion could remove, rad, above which a target counts as not reached."""

PASSES = 4
"""Number of successive corrections of a command; the second one moves the tool by micrometres only."""

FRAMES = ("controller", "instrument")

OPTIONS = {"payload": "payload_kg", "temperature": "temperature_k"}
"""Options of `pickenv apply` for the conditions, by the name of the condition."""


@dataclass(frozen=True, eq=False)
class CorrectedCommands:
    """Corrected commands for N targets.

    Attributes:
        targets: The nominal joint targets ``(N, n)``, rad or m; for pose targets, the result of the inverse kinematics.
        joints: The commands ``(N, n)``, rad or m, within the joint limits. Use only the commands that `reached` marks.
        reached: Mask ``(N,)`` of the targets that are reached. The predicted errors that joint motion could remove are
            then at most 0.01 mm (`POSITION_TOLERANCE`) and 0.001 deg (`ATTITUDE_TOLERANCE`).
        before: Predicted pose error ``(N, 6)``, m and rad, if the target itself were commanded.
        remaining: Predicted pose error with the command ``(N, 6)``, m and rad.
        impossible: The part of ``remaining`` that no joint motion removes ``(N, 6)``.
        uncertainty: Two arrays ``(N,)``, the standard uncertainties of the reached position, m, and of the reached
            attitude, rad. An array is None if it is unknown.
        within95: Two arrays ``(N,)``, the bounds on the position error, m, and on the attitude error, rad. 95 of 100
            errors are below their bound. An array is None if it is unknown.
        reasons: The reason why a target is not reached, by the index of the target, from 0.
        lines: Line of each target in its file, from 1.
        prismatic: For each joint, whether it is prismatic.
        caution: The cautions of the calibration's verdict. If base and tool were fitted and the frame is
            "controller", also the mean error in the robot's own base frame. None if there are no cautions.
    """

    targets: Array
    joints: Array
    reached: NDArray[np.bool_]
    before: Array
    remaining: Array
    impossible: Array
    uncertainty: Sizes
    within95: Sizes
    reasons: dict[int, str]
    lines: tuple[int, ...]
    prismatic: tuple[bool, ...]
    caution: str | None = None

    def table(self) -> tuple[list[str], NDArray[np.object_]]:
        """Return the commands as a table: the column names with units, and one row per target.

        The commands of targets that are not reached are empty cells.
        """
        commands = (self.joints * screen_units(self.prismatic)).astype(object)
        commands[~self.reached] = ""  # a cell that streams these columns must not drive to where nothing is reached
        columns = dict(zip(joint_columns(self.prismatic), commands.T, strict=True))
        columns["reached"] = np.where(self.reached, "yes", "no")
        parts = {"uncorrected": self.before, "predicted": self.remaining, "noncompensable": self.impossible}
        for label, error in parts.items():
            columns[f"{label}_error_mm"], columns[f"{label}_error_deg"] = _sizes(error)
        for label, sizes in (("uncertainty", self.uncertainty), ("within95", self.within95)):
            for (unit, factor), size in zip(QUANTITIES.values(), sizes, strict=True):
                if size is not None:
                    columns[f"{label}_{unit}"] = size * factor
        columns["note"] = np.array([self.reasons.get(i, "") for i in range(len(self.lines))])
        return list(columns), np.stack([column.astype(object) for column in columns.values()], axis=1)

    def write_csv(self, path: str | Path) -> Path:
        """Write the table as a CSV file, whole or not at all, and return its path."""
        return write_table(path, *self.table())

    def report(self) -> str:
        """Return a summary in a few lines, which names the targets that cannot be reached."""
        lines = [f"{int(self.reached.sum())} of {len(self.reached)} targets can be reached"]
        lines += self._expected() if self.reached.any() else []
        lines += [] if self.caution is None else [f"  caution: {self.caution}"]
        return "\n".join(lines + [f"  row {self.lines[i]}: {reason}" for i, reason in self.reasons.items()])

    def _expected(self) -> list[str]:
        """Return lines for `report` on the errors that are expected at the targets that are reached."""
        parts = (self.before, self.remaining, self.impossible)
        before, after, never = ([float(size[self.reached].mean()) for size in _sizes(error)] for error in parts)
        lines = [
            f"  told the plain target, the arm would miss by {before[0]:.3f} mm and {before[1]:.4f} deg"
            " (mean, predicted)",
            f"  with the corrected commands {after[0]:.4f} mm and {after[1]:.4f} deg remain, of which "
            f"{never[1]:.4f} deg is a rotation that no joint motion removes",
        ]
        position = (self.uncertainty[0], self.within95[0])
        sure, within = (None if size is None else size[self.reached] for size in position)
        if sure is None:
            lines.append("  uncertainty unknown: this calibration file holds none; calibrate again to have it")
        else:
            lines.append(
                f"  standard uncertainty of the position reached: {1e3 * np.median(sure):.3f} mm (median), "
                f"{1e3 * np.max(sure):.3f} mm at most"
            )
        if within is not None:
            lines.append(
                f"  95 of 100 such commands end within {1e3 * np.median(within):.3f} mm (median of targets; "
                f"{1e3 * np.max(within):.3f} mm at most), as counted on held-out rows"
            )
        return lines


def apply_calibration(
    calibration: Calibration,
    arm: Arm,
    targets: Targets,
    *,
    frame: str = "controller",
    conditions: Conditions | None = None,
) -> CorrectedCommands:
    """Compute the commands that bring the calibrated arm to targets.

    Args:
        calibration: The calibration of this arm.
        arm: The arm.
        targets: Nominal joint targets, or tool poses.
        frame: Frame of pose targets. "controller" is the arm's own base, with the tool of the arm file. "instrument"
            is the frame in which the arm was measured, with the fitted tool.
        conditions: Payload and temperature, one value each, if the calibration depends on them.

    Raises:
        InputError: If the frame is unknown, or given for joint targets. Also if the calibration is of another arm,
            needs conditions that are not given, or does not depend on a condition that is given.
    """
    if frame not in FRAMES:
        raise InputError(f"frame is '{frame}'; give {' or '.join(FRAMES)}")
    if frame != "controller" and targets.pose is None:
        raise InputError(f"{targets.source} holds joints, which are in no frame; leave `frame` out, or give tool poses")
    calibration.refuse_another(arm)
    geometry = arm.nominal if frame == "controller" else calibration.nominal
    reasons: dict[int, str] = {}
    if targets.pose is None:
        assert targets.joints is not None
        wanted_joints, poses = targets.joints, forward(calibration.nominal, targets.joints)
        outside = (wanted_joints < geometry.lower - 1e-9) | (wanted_joints > geometry.upper + 1e-9)
        for i in np.flatnonzero(outside.any(axis=1)):
            joint = int(np.argmax(outside[i]))
            reasons[int(i)] = f"target of {geometry.joint_names[joint]} is outside its limits"
    else:
        solution = inverse(geometry, targets.pose)
        wanted_joints = solution.joints
        poses = targets.pose if frame == "instrument" else _carried(targets.pose, arm.nominal, calibration.nominal)
        for i in np.flatnonzero(~solution.reached):
            missed = np.degrees(solution.attitude_error[i])
            reasons[int(i)] = (
                f"no joints within the limits reach this pose; the nearest miss it by "
                f"{solution.position_error[i] * 1e3:.3g} mm and {missed:.3g} deg"
            )
    compensator = calibration.compensator(conditions=conditions, fast=False)
    commands = toward(compensator, poses, wanted_joints)
    cautions = [] if calibration.caution is None else [calibration.caution]
    if frame == "controller" and calibration.record.get("frames") == "fitted":
        interval = calibration.record.get("base_frame", {}).get("mean_ci95_mm")
        size = f"{interval[0]:#.3g} to {interval[1]:#.3g} mm" if interval else "unknown"
        cautions.append(
            "base and tool were fitted, and errors and uncertainties hold from there; in the robot's own base frame "
            f"the mean error is {size}"
        )
    present = conditions or Conditions()
    for name in present.input_names():
        more = replace(present, **{name: getattr(present, name) + 1.0})
        elsewhere = calibration.compensator(conditions=more, fast=False).predict(commands)
        if np.array_equal(elsewhere.position, compensator.predict(commands).position):
            raise InputError(f"nothing in this calibration depends on a {name}; leave `{OPTIONS[name]}` out")
    before = pose_error(poses, compensator.predict(wanted_joints))
    remaining = pose_error(poses, compensator.predict(commands))
    weight = attitude_weight(arm.nominal.joints)
    impossible = noncompensable_error(calibration.identified, commands, remaining, weight=weight)
    missed_position, missed_attitude = np.linalg.norm((remaining - impossible).reshape(-1, 2, 3), axis=2).T
    reached = (missed_position <= POSITION_TOLERANCE) & (missed_attitude <= ATTITUDE_TOLERANCE)
    for i in np.flatnonzero(~reached):
        at = (commands[i] <= geometry.lower) | (commands[i] >= geometry.upper)
        limits = ", ".join(geometry.joint_names[j] for j in np.flatnonzero(at)) or "no joint"
        reasons.setdefault(
            int(i),
            f"the correction is cut off by a joint limit ({limits}); {missed_position[i] * 1e3:.3g} mm and "
            f"{np.degrees(missed_attitude[i]):.3g} deg remain that a free joint could remove",
        )
    reached[list(reasons)] = False
    repeated = None if conditions is None else conditions.repeated((len(commands),))
    sure, within = calibration.uncertainty(commands, repeated)
    return CorrectedCommands(
        targets=wanted_joints,
        joints=commands,
        reached=reached,
        before=before,
        remaining=remaining,
        impossible=impossible,
        uncertainty=sure,
        within95=within,
        reasons=dict(sorted(reasons.items())),
        lines=targets.lines,
        prismatic=geometry.prismatic,
        caution="; ".join(cautions) or None,
    )


def _sizes(errors: Array) -> tuple[Array, Array]:
    """Return sizes ``(N,)``, mm and deg, of the position and attitude parts of pose errors ``(N, 6)``, m and rad."""
    return np.linalg.norm(errors[:, :3], axis=1) * 1e3, np.degrees(np.linalg.norm(errors[:, 3:], axis=1))


def toward(compensator: Compensator, wanted: Pose, start: Array) -> Array:
    """Compute the commands ``(N, n)``, rad or m, that bring the real tool to the poses ``wanted``.

    The correction of Qiao 2026 eq (15) is repeated `PASSES` times. A joint that would have to go beyond its limit stays
    at the limit, and the other joints take over what they can. On an arm with fewer than six joints, the position has
    priority over the attitude.

    Args:
        compensator: The calibrated arm.
        wanted: N poses in the frame of the calibrated geometry.
        start: Joints ``(N, n)``, rad or m, near the poses ``wanted``; the first correction starts there.
    """
    lower, upper = compensator.nominal.lower, compensator.nominal.upper
    weights = np.repeat([1.0, attitude_weight(compensator.nominal.joints)], 3)
    command = start.clip(lower, upper)
    for _ in range(PASSES):
        error = pose_error(compensator.predict(command), wanted) * weights
        jacobian = joint_jacobian(compensator.identified, command) * weights[:, None]
        free = np.ones_like(command)
        for _ in range(command.shape[1]):
            step = np.einsum("...ij,...j->...i", truncated_inverse(jacobian * free[:, None]), error) * free
            outward = ((command <= lower) & (step < 0)) | ((command >= upper) & (step > 0))
            if not outward.any():
                break
            free = free * ~outward
        command = (command + step).clip(lower, upper)
    return command


def _carried(pose: Pose, believed: Geometry, fitted: Geometry) -> Pose:
    """Transform tool poses in the controller's frame to poses of the fitted tool in the instrument's frame.

    Args:
        pose: Poses in the controller's frame.
        believed: The arm's geometry with the controller's base and tool.
        fitted: The geometry with the fitted base and tool.
    """
    flange = behind(behind(inverse_pose(believed.base), pose), inverse_pose(believed.tool))
    return behind(behind(fitted.base, flange), fitted.tool)
