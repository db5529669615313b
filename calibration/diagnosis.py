"""What is wrong with a data set as a whole: gross outliers, units mixed within a column, poses that show too little.

No single cell betrays these. A robust fit finds the poses that agree with each other; whatever the others have in
common (one column that fits in another unit) is said, and so are the parameters that full-range poses would show.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.arm_model import ArmModel, Conditions
from calibration.error_model import ErrorModel, complete_model, frames_model, stacked_jacobian
from calibration.identifiability import identifiability
from calibration.measurements import Measurements, random_joints
from calibration.observations import PoseObservations
from calibration.robust import RobustIdentification, robust_align, robust_identify
from pickenv.arm import Arm, Geometry
from pickenv.errors import InputError

SUSPICIOUS = 8.0
"""A largest error beyond this many median errors calls for the robust fit."""

GROSS = 30.0
"""Errors beyond this many robust standard deviations of a coordinate are no measurements of this pose."""

EXPLAINED = 8.0
"""A unit explains an outlier when it brings it within this many robust standard deviations."""

LOST_SHARE = 0.25
"""Poses that lose more than this share of the parameters that full-range poses show are refused."""


def suspicious(model: ArmModel, measurements: Measurements) -> bool:
    """Whether some errors are far larger than the median one."""
    size = np.linalg.norm(PoseObservations(measurements).difference(model)[:, :3], axis=1)
    return len(size) >= 12 and float(size.max()) > SUSPICIOUS * float(np.median(size))


def robust_fit(arm: Arm, measurements: Measurements) -> RobustIdentification:
    """Base, tool and geometry from the poses that agree with each other; the same every time."""
    aligned = robust_align(arm.nominal, measurements, frames_model(arm.nominal), np.random.default_rng(0))
    weighted = robust_identify(complete_model(arm.nominal), aligned.geometry, measurements)
    return weighted


def gross_outliers(found: RobustIdentification) -> list[int]:
    """Rows that are off beyond `GROSS`, largest first."""
    return [outlier.row for outlier in found.outliers if outlier.sigma > GROSS]


def refuse_gross_errors(arm: Arm, measurements: Measurements) -> None:
    """Refuse a data set in which some rows are off by far more than the others, and say what they have in common.

    Raises:
        InputError: Names rows, how far they are off, and the column and unit if one explains them.
    """
    found = robust_fit(arm, measurements)
    rows = gross_outliers(found)
    if not rows:
        return
    shown = ", ".join(str(row + 1) for row in sorted(rows)[:6]) + (" and more" if len(rows) > 6 else "")
    worst = found.outliers[0]
    unit = mixed_unit(arm, found, measurements, np.array(sorted(rows)))
    noun = "row" if len(rows) == 1 else "rows"
    if unit is not None:
        raise InputError(
            f"{measurements.source}: {noun} {shown} of the data (from 1) fit only if {unit}: units are mixed in one "
            "column; write all its rows in one unit"
        )
    raise InputError(
        f"{measurements.source}: {noun} {shown} of the data (from 1) are off by up to {worst.position * 1e3:.0f} mm "
        f"where the others agree within {3 * found.position_scale * 1e3:.2g} mm; remove them, or fit with --robust"
    )


def mixed_unit(
    arm: Arm, found: RobustIdentification, measurements: Measurements, rows: NDArray[np.int64]
) -> str | None:
    """The column and unit that explain most of the outliers, in words; None if none does."""
    outliers = measurements.select(rows)
    model = found.identification.arm_model
    best: tuple[float, str] | None = None
    for words, other in _readings(arm, outliers):
        size = np.linalg.norm(PoseObservations(other).difference(model)[:, :3], axis=1) / found.position_scale
        share = float(np.mean(size < EXPLAINED))
        if share >= 0.8 and (best is None or share > best[0]):
            best = (share, words)
    return best[1] if best else None


def _readings(arm: Arm, data: Measurements) -> list[tuple[str, Measurements]]:
    """The same rows with one joint column, or the positions, read in another unit."""
    found = []
    for i, slides in enumerate(arm.nominal.prismatic):
        names = ("mm", "m") if slides else ("deg", "rad")
        factor = 1e-3 if slides else np.pi / 180
        for written, scale in ((names[0], factor), (names[1], 1 / factor)):
            joints = data.joints.copy()
            joints[:, i] *= scale
            label = f"joint {i + 1} ({arm.nominal.joint_names[i]})"
            other = names[0] if written == names[1] else names[1]
            found.append((f"{label} is read in {written} there and in {other} elsewhere", replace(data, joints=joints)))
    for axes, label in (([0, 1, 2], "the position"), ([0], "x"), ([1], "y"), ([2], "z")):
        for written, other, scale in (("m", "mm", 1e3), ("mm", "m", 1e-3)):
            position = data.position.copy()
            position[:, axes] *= scale
            words = f"{label} is read in {written} there and in {other} elsewhere"
            found.append((words, replace(data, position=position)))
    return found


def lost_to_poses(model: ErrorModel, geometry: Geometry, measurements: Measurements) -> tuple[tuple[str, ...], int]:
    """Parameters that these poses cannot show but poses over the whole joint ranges would, and how many those show.

    Args:
        model: The parameters.
        geometry: The arm, aligned.
        measurements: The poses and their kind.

    Raises:
        InputError: If more than `LOST_SHARE` of them are lost.
    """
    here = identifiability(
        stacked_jacobian(model, geometry, measurements), model.names, model.tolerance, len(measurements)
    )
    count = max(60, min(len(measurements), 300))
    rotation = None if measurements.rotation is None else np.broadcast_to(np.eye(3), (count, 3, 3))
    joints = random_joints(geometry, count, np.random.default_rng(0))
    probe = replace(
        measurements, joints=joints, position=np.zeros((count, 3)), rotation=rotation, conditions=Conditions()
    )
    full = identifiability(stacked_jacobian(model, geometry, probe), model.names, model.tolerance, count)
    lost = tuple(name for name in full.kept_names if name not in here.kept_names)
    missing = full.rank - here.rank
    if missing > LOST_SHARE * full.rank:
        still = [
            f"joint {i + 1} ({geometry.joint_names[i]})"
            for i in range(geometry.joints)
            if np.ptp(measurements.joints[:, i]) < 0.02 * (geometry.upper[i] - geometry.lower[i])
        ]
        hint = f"; {', '.join(still)} hardly move" if still else ""
        raise InputError(
            f"{measurements.source}: these poses show {here.rank} of the {full.rank} parameters that full-range poses "
            f"show, and lose {', '.join(lost[:8])}{hint}; measure poses that move every joint"
        )
    return (lost[: max(missing, 0)] if missing > 0 else ()), full.rank
