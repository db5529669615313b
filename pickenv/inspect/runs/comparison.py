"""What inspection looks at: errors of several policies on one arm, over a field of poses and over seeded reaches."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Plant
from pickenv.arm.kinematics.geometry import Array, Geometry
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.inspect.colours import policy_key
from pickenv.inspect.runs.field_grid import FieldGrid


@dataclass(frozen=True, eq=False)
class PolicyErrors:
    """One policy's errors.

    Attributes:
        key: Short name as in entity paths and JSON: raw, ls, ls_bpnn.
        label: Name for people: raw, LS, LS + BPNN.
        field_errors: True minus wanted tool position at the field's points ``(F, 3)``, m, world axes.
        reach_joints: Final joint commands given to the drives ``(R, n)``, rad or m.
        reach_positions: Final true tool positions ``(R, 3)``, m.
        position_error_mm: Final distance between true tool and fruit ``(R,)``.
        attitude_error_deg: Final attitude error ``(R,)``.
        success: Whether the fruit was inside the gripper's capture region ``(R,)``.
        field_attitude: True against wanted attitude at the field's points ``(F, 3)``, rotation vectors in world axes,
            rad; None where only positions are known.
    """

    key: str
    label: str
    field_errors: Array
    reach_joints: Array
    reach_positions: Array
    position_error_mm: Array
    attitude_error_deg: Array
    success: NDArray[np.bool_]
    field_attitude: Array | None = None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several policies on the same arm, the same field and the same fruit.

    Attributes:
        plant: The true arm that was simulated.
        nominal: Geometry the controller believes in.
        identified: Geometry found by the calibration.
        seed: Seed of the run.
        tolerance_mm: Radius of the gripper's capture region.
        grid_shape: Shape (nx, ny, nz) of the regular grid that the field's points were taken from.
        grid_origin: Centre of the grid's first cell, m, ``(3,)``.
        grid_step: Cell size, m.
        field_index: Integer grid index of each field point ``(F, 3)``; unreachable cells are left out.
        field_points: Wanted tool positions ``(F, 3)``, m.
        field_joints: Joints that bring the nominal arm there ``(F, n)``, rad or m.
        fruit: Fruit positions of the reaches ``(R, 3)``, m.
        policies: One entry per policy, raw first.
        field_uncertainty: Standard uncertainty of the calibrated tool position that the calibration itself predicts
            ``(F,)``, m; None where the calibration carries none.
    """

    plant: Plant
    nominal: Geometry
    identified: Geometry
    seed: int
    tolerance_mm: float
    grid_shape: tuple[int, int, int]
    grid_origin: Array
    grid_step: float
    field_index: NDArray[np.int64]
    field_points: Array
    field_joints: Array
    fruit: Array
    policies: tuple[PolicyErrors, ...]
    field_uncertainty: Array | None = None


def policy_errors(
    label: str,
    field: Array,
    joints: Array,
    positions: Array,
    errors: Array,
    success: NDArray[np.bool_],
    key: str | None = None,
) -> PolicyErrors:
    """A policy's errors, from pose errors.

    Args:
        label: Its name for people.
        field: True against wanted pose at the field's points ``(F, 6)``, or positions alone ``(F, 3)``, m and rad.
        joints: Final joint commands of the reaches ``(R, n)``, rad or m.
        positions: Final true tool positions ``(R, 3)``, m.
        errors: Final pose errors ``(R, 6)``, m and rad.
        success: Whether the fruit was inside the capture region ``(R,)``.
        key: Its short name; made from the label when left out.
    """
    return PolicyErrors(
        key=key or policy_key(label),
        label=label,
        field_errors=field[:, :3],
        reach_joints=joints,
        reach_positions=positions,
        position_error_mm=1e3 * np.linalg.norm(errors[:, :3], axis=1),
        attitude_error_deg=np.degrees(np.linalg.norm(errors[:, 3:], axis=1)),
        success=success,
        field_attitude=field[:, 3:] if field.shape[1] == 6 else None,
    )


def stage_label(calibration: Calibration) -> str:
    """What a calibration is called among policies: LS, or LS+BPNN after what it learnt of the rest."""
    return "LS" if calibration.learnt is None else f"LS+{calibration.learnt.kind.replace('_', ' ').upper()}"


def compared(
    plant: Plant,
    grid: FieldGrid,
    policies: Iterable[PolicyErrors],
    *,
    seed: int,
    fruit: Array | None = None,
    tolerance_mm: float = 0.0,
    identified: Geometry | None = None,
    uncertainty: Array | None = None,
) -> Comparison:
    """A comparison over a grid; without fruit there are no reaches, and the nominal arm counts as identified."""
    return Comparison(
        plant=plant,
        nominal=plant.arm.nominal,
        identified=plant.arm.nominal if identified is None else identified,
        seed=seed,
        tolerance_mm=tolerance_mm,
        grid_shape=grid.shape,
        grid_origin=grid.origin,
        grid_step=grid.step,
        field_index=grid.index,
        field_points=grid.points,
        field_joints=grid.joints,
        fruit=np.empty((0, 3)) if fruit is None else fruit,
        policies=tuple(policies),
        field_uncertainty=uncertainty,
    )
