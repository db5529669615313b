"""Accuracy and repeatability by ISO 9283:1998 of a real arm, from measured rows that visit commanded poses again."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry
from pickenv.arm.plant.iso9283 import CYCLES, pose_performance
from pickenv.base import InputError
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.robust import align
from pickenv.calibration.model.arm_model import frames_model
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.pipeline.calibration import Calibration

SAME_POSE = 1e-3
"""Rows whose joints all lie within this of a pose's first row visit the same pose, rad or m."""

LEAST_VISITS = 5
"""Fewest visits of a pose for its figures; the standard asks for 30."""

SHOWN = 12
"""Most poses on a screen; those that repeat worst."""


def measured_performance(
    data: Measurements, nominal: Geometry, calibration: Calibration | None = None
) -> dict[str, Any]:
    """AP, RP and drift of every pose that the rows visit at least `LEAST_VISITS` times, in the order of the rows.

    Args:
        data: Measured poses or positions; joints are those that were commanded.
        nominal: The arm's nominal geometry, whose base and tool are fitted to the rows first.
        calibration: A calibration of this arm at the same station, to be judged as well.

    Returns:
        "raw", and "calibrated" where there is one: for each pose what
        `pickenv.arm.plant.iso9283.pose_performance` gives, the number of its "visits", and "drift_mm", the change of
        the mean position from first to last visit by a straight line, in x, y, z of the instrument; with
        "drift_ci95_mm", three intervals that hold together in 95 %. Angles are None where only positions were
        measured. Then "worst_accuracy_mm", "worst_repeatability_mm", and the number of rows "passed_over".

    Raises:
        InputError: If no pose is visited often enough, or the rows do not fit the arm at all.
    """
    groups = _visits(data.joints)
    often = [rows for rows in groups if len(rows) >= LEAST_VISITS]
    if not often:
        most = max(map(len, groups))
        raise InputError(
            f"{data.source}: the pose visited most has {most} of {len(data)} rows; ISO 9283 asks for {CYCLES} visits "
            f"of each commanded pose, and fewer than {LEAST_VISITS} tell nothing of its repeatability"
        )
    raw = data.difference(align(nominal, data, frames_model(nominal)).geometry)
    by_name = {"raw": raw} | ({} if calibration is None else {"calibrated": calibration.errors(data)})
    return {name: _figures(errors, often) for name, errors in by_name.items()}


def _visits(joints: Array) -> list[NDArray[np.intp]]:
    """The rows of each commanded pose, in the order of the poses' first rows."""
    groups: list[list[int]] = []
    places = np.empty((0, joints.shape[1]))
    for row, place in enumerate(joints):
        near = np.flatnonzero((np.abs(places - place) < SAME_POSE).all(axis=1))
        if len(near):
            groups[int(near[0])].append(row)
        else:
            groups.append([row])
            places = np.vstack([places, place])
    return [np.array(group) for group in groups]


def _figures(errors: Array, groups: list[NDArray[np.intp]]) -> dict[str, Any]:
    turned = errors.shape[1] == 6
    poses = []
    for number, rows in enumerate(groups, start=1):
        pose = pose_performance(f"P{number}", np.pad(errors[rows], ((0, 0), (0, 6 - errors.shape[1]))))
        if not turned:
            pose |= {"accuracy_deg": None, "repeatability_deg": None}
        change, half = _drift(1e3 * errors[rows, :3])
        ends = np.stack([change - half, change + half], axis=-1)
        poses.append(pose | {"visits": len(rows), "drift_mm": change.tolist(), "drift_ci95_mm": ends.tolist()})
    return {
        "poses": poses,
        "worst_accuracy_mm": max(pose["accuracy_mm"] for pose in poses),
        "worst_repeatability_mm": max(pose["repeatability_mm"] for pose in poses),
        "passed_over": len(errors) - sum(map(len, groups)),
    }


def _drift(values: Array) -> tuple[Array, Array]:
    """Change of values ``(n, 3)`` from first to last by a straight line, and half widths that hold together in 95 %."""
    from scipy.special import stdtrit

    n = len(values)
    time = np.linspace(-0.5, 0.5, n)
    change = time @ values / (time @ time)
    rest = values - values.mean(axis=0) - np.outer(time, change)
    std = np.sqrt((rest**2).sum(axis=0) / (n - 2) / (time @ time))
    return change, std * stdtrit(n - 2, 1.0 - 0.025 / 3.0)


def performance_text(performances: dict[str, Any], where: str) -> str:
    """The test report, for people: a table for the raw arm, and one for the calibrated arm."""
    heads = ("pose", "visits", "AP (mm)", "RP (mm)", "95 % of RP (mm)", "AP (deg)", "RP (deg)", "drift (mm)", "drifts")
    blocks = []
    for name, figures in performances.items():
        poses = sorted(figures["poses"], key=lambda pose: -float(pose["repeatability_mm"]))[:SHOWN]
        notes = [f"{len(figures['poses'])} poses; {figures['passed_over']} rows of poses visited too seldom left out"]
        if len(figures["poses"]) > SHOWN:
            notes.append(f"the {SHOWN} that repeat worst")
        if min(pose["visits"] for pose in figures["poses"]) < CYCLES:
            notes.append(f"the standard asks for {CYCLES} visits; RP has an interval from there on")
        rows = tuple(map(_cells, poses))
        blocks.append(Block(f"ISO 9283 on {where}, {name}", heads, rows, "; ".join(notes)).text())
    return "\n".join([*blocks, "raw: base and tool were fitted to these rows, so AP is of what that leaves"])


def _cells(pose: dict[str, Any]) -> tuple[str, ...]:
    ends, turns = pose["repeatability_ci95_mm"], pose["repeatability_deg"]
    drifts = any(low > 0.0 or high < 0.0 for low, high in pose["drift_ci95_mm"])
    return (
        pose["name"],
        str(pose["visits"]),
        figure(pose["accuracy_mm"]),
        figure(pose["repeatability_mm"]),
        "-" if ends is None else f"{figure(ends[0])} to {figure(ends[1])}",
        *("-" if turns is None else figure(angle) for angle in (pose["accuracy_deg"], turns and max(turns))),
        figure(float(np.linalg.norm(pose["drift_mm"]))),
        "yes" if drifts else "not told",
    )
