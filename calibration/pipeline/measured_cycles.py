"""Pose accuracy of a real arm by ISO 9283:1998, from measured rows that visit a few commanded poses many times.

The commanded poses are those of the nominal arm at the commanded joints. If the instrument was not registered to the
arm, the arm's base is fitted first, and with enough poses its tool too. Pose accuracy (AP) and repeatability (RP) are
computed as in the simulated test (`pickenv.arm.plant.iso9283`). mm and deg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pickenv.arm import Arm, Geometry, forward, identity_pose
from pickenv.arm.plant.iso9283 import CYCLES, FEWEST_CYCLES, pose_drift, pose_performance
from pickenv.base import InputError, count_of
from pickenv.calibration.identification.robust import refuse_another_arm, registered
from pickenv.calibration.model.measurements import Measurements, joint_columns, screen_units
from pickenv.calibration.model.observations import Rows, nearest_rotation, origins_of, same_poses
from pickenv.calibration.pipeline.fitting import fit_frames


def measured_iso9283(arm: Arm, rows: Measurements) -> dict[str, Any]:
    """Compute pose accuracy (AP), repeatability (RP) and drift of a measured arm, with 95 % intervals over the cycles.

    Rows whose joints differ by 2e-4 rad or m at most are cycles of one pose (`same_poses`), in the order of the rows.

    Args:
        arm: The arm.
        rows: Measured poses or positions, in the order in which they were taken. If their frames are not known, base
            and tool are fitted to the mean of each pose. The fit makes AP smaller than it is, and leaves RP unchanged.

    Returns:
        The results as values for JSON, in mm and deg. "poses" holds for each pose its name (P1 is the first in the
        file), its joints, AP and RP (`pose_performance`). Its "drift" is the change over the cycles (`pose_drift`).
        "fitted" says which of base and tool were fitted. "fitted_numbers" is the number of parameters of the fitted
        frames. "of_numbers" is the number of coordinates of all mean poses. If "of_numbers" is not larger than
        "fitted_numbers", accuracies are None. "still" is the number of rows that come directly after a row of the same
        pose.

    Raises:
        InputError: If a pose has too few cycles, or the rows do not fit the arm.
    """
    number = same_poses(rows.joints)
    cycles = [np.flatnonzero(number == i) for i in range(int(number.max()) + 1)]
    counts = np.array([len(visits) for visits in cycles])
    if counts.min() < FEWEST_CYCLES:
        i = int(np.argmax(counts < FEWEST_CYCLES))
        file, line = origins_of(rows).place(int(cycles[i][0]))
        raise InputError(
            f"{file}: P{i + 1}, the pose of row {line}, has {count_of(counts[i], 'cycle')}, and "
            f"repeatability needs {FEWEST_CYCLES} of each pose; measure more, or remove the rows of such poses "
            f"({int((counts < FEWEST_CYCLES).sum())} of {len(counts)})"
        )
    means = _means(rows, cycles)
    frames, geometry = _placed(arm, means)
    numbers = means.rows_per_pose * len(means)
    fitted = sum({"base": 6, "tool": means.rows_per_pose}[frame] for frame in frames)
    errors = replace(rows, joints=means.joints[number]).difference(geometry)
    poses = []
    for i, visits in enumerate(cycles):
        joints = dict(zip(joint_columns(rows.prismatic), means.joints[i] * screen_units(rows.prismatic), strict=True))
        figures = pose_performance(f"P{i + 1}", errors[visits]) | {"drift": pose_drift(errors[visits])}
        poses.append((figures if fitted < numbers else _without_accuracy(figures)) | {"joints": joints})
    return {
        **{"standard": "ISO 9283:1998", "measured": True, "rows": rows.source, "arm": arm.name},
        **{"fitted": frames, "fitted_numbers": fitted, "of_numbers": numbers},
        **{"cycles_of_the_standard": CYCLES, "still": int((np.diff(number) == 0).sum()), "poses": poses},
    }


def _means(rows: Measurements, cycles: Sequence[Rows]) -> Measurements:
    """Return the mean row of each pose over its cycles; ``cycles`` has the indices, from 0, of each pose's rows."""
    first = rows.select([visits[0] for visits in cycles])
    rotation = None
    if rows.rotation is not None:
        rotation = nearest_rotation(np.array([rows.rotation[visits].mean(axis=0) for visits in cycles]))
    parts = rows.joints, rows.position
    joints, position = (np.array([part[visits].mean(axis=0) for visits in cycles]) for part in parts)
    return replace(first, joints=joints, position=position, rotation=rotation)


def _placed(arm: Arm, means: Measurements) -> tuple[list[str], Geometry]:
    """Fit base and tool to the mean poses, and return the names of the fitted frames and the geometry with them.

    The tool is fitted if the means have at least twice as many coordinates as both frames have parameters. Else it is
    the arm's own tool, since five poses of one attitude, as in the standard, do not determine a tool.

    Raises:
        InputError: If the means do not fit the arm.
    """
    if means.frames == "known" or means.rows_per_pose * len(means) >= 2 * (6 + means.rows_per_pose):
        aligned = fit_frames(arm, means, means.frames == "known")
        return ([], arm.nominal) if aligned is None else (["base", "tool"], aligned.geometry)
    chain = forward(replace(arm.nominal, base=identity_pose(), tool=identity_pose()), means.joints)
    geometry = registered(arm.nominal, arm.nominal.tool, chain, means)
    refuse_another_arm(geometry, means, "after fitting its base")
    return ["base"], geometry


def _without_accuracy(figures: dict[str, Any]) -> dict[str, Any]:
    """Return a pose's results (`pose_performance`) with accuracies and mean errors set to None, also in its drift."""

    def without(part: dict[str, Any]) -> dict[str, Any]:
        return {key: None if key.startswith(("accuracy", "mean_error")) else value for key, value in part.items()}

    return without(figures) | {"drift": None if figures["drift"] is None else without(figures["drift"])}
