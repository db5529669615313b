"""Write recordings of a calibration or an evaluation, whose errors are first made into a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pickenv.arm import Arm, Array, Plant, forward, pose_error
from pickenv.base import InputError
from pickenv.calibration import Calibration, Compensator, Measurements
from pickenv.calibration.pipeline.calibration import uncertainty_from
from pickenv.inspect.recordings.comparison_recording import record_comparison
from pickenv.inspect.runs.comparison_summary import round_step, stage_label
from pickenv.inspect.runs.recorded_episodes import Comparison, FieldGrid, Reaches, ended, field_grid

CELLS = 10
"""Approximate number of cells along the longest side of a field whose points lie on no grid."""


def inspect_calibration(
    calibration: Calibration, evidence: Plant | Measurements, path: str | Path, *, grid_step: float = 0.1, seed: int = 0
) -> Path:
    """Write a recording of the errors before and after calibration, simulated over the workspace or at measured poses.

    Args:
        calibration: The calibration.
        evidence: A plant or measured poses. A plant (simulated true arm) is driven over its workspace, raw and
            compensated. From measured poses, which should be held out, the models' predictions are subtracted.
        path: The file to write (.rrd).
        grid_step: Distance between neighbouring poses of the grid at which the simulated arm's errors are computed, m.
        seed: Seed of the random joint values from which the workspace's extent is estimated.

    Returns:
        The path written.

    Raises:
        InputError: If the calibration is for another arm, there are too few poses, or the file cannot be written.
    """
    if isinstance(evidence, Plant):
        return record_comparison(_simulated(calibration, evidence, grid_step, seed), path)
    return record_comparison(_measured(calibration, evidence, seed), path)


def inspect_evaluation(
    runs: Mapping[str, Reaches], plant: Plant, path: str | Path, *, tolerance_mm: float = 5.0, seed: int = 0
) -> Path:
    """Write a recording of the final errors of several policies at the same fruit.

    Args:
        runs: The final states of each policy's episodes, by the policy's label. The first policy is the one without
            calibration (raw). All policies have the same fruit.
        plant: The simulated true arm, or the plant that a population of arms was drawn from.
        path: The file to write (.rrd).
        tolerance_mm: Radius of the gripper's capture region, mm.
        seed: Seed of the episodes, which is part of the recording's identity.

    Returns:
        The path written.

    Raises:
        InputError: If there are no runs, their fruit differ, or the file cannot be written.
    """
    if not runs:
        raise InputError("there are no episodes to show; give the ends of at least one policy's episodes")
    label, first = next(iter(runs.items()))
    for name, ends in runs.items():
        if not np.array_equal(ends.fruit_position, first.fruit_position):
            raise InputError(f"'{name}' did not reach for the same fruit as '{label}'; evaluate both with equal seeds")
    errors = {
        name: np.concatenate([ends.tool_position - ends.fruit_position, ends.pose_error[:, 3:]], axis=1)
        for name, ends in runs.items()
    }
    comparison = Comparison(
        policies=tuple(ended(name, ends).with_field(errors[name]) for name, ends in runs.items()),
        plant=plant,
        tolerance_mm=tolerance_mm,
        seed=seed,
        seeds=first.seeds,
        grid=_grid_around(first.fruit_position, first.joint_command),  # the field's points are the fruit
    )
    return record_comparison(comparison, path)


def _simulated(calibration: Calibration, plant: Plant, grid_step: float, seed: int) -> Comparison:
    """Return a comparison of raw, LS and, if learnt, LS with residual, each driving the plant over its workspace.

    ``grid_step`` and ``seed`` are those of `inspect_calibration`.
    """
    if calibration.arm_fingerprint != plant.arm.fingerprint():
        raise InputError(
            f"the calibration is of arm '{calibration.arm_name}', not of '{plant.arm.name}' with this geometry; "
            "fit one for this arm"
        )
    grid = field_grid(calibration.nominal, grid_step, seed)
    target = forward(calibration.nominal, grid.joints)
    stages: dict[str, Compensator | None] = {"raw": None, "LS": calibration.compensator(with_residual=False)}
    if calibration.learnt is not None:
        stages[stage_label(calibration)] = calibration.compensator()
    errors = {
        label: pose_error(target, plant.tool_pose(grid.joints if send is None else send(grid.joints)))
        for label, send in stages.items()
    }
    return _without_reaches(calibration, plant, errors, grid, seed)


def _measured(calibration: Calibration, data: Measurements, seed: int) -> Comparison:
    """Return a comparison of raw, LS and, if learnt, LS with residual, as predictions of measured poses.

    The true arm of the comparison is the identified arm.
    """
    if len(data) < 2:
        raise InputError(f"{data.source}: {len(data)} poses are too few to show; give at least two")
    errors = {"raw": data.difference(calibration.nominal), "LS": data.difference(calibration.model)}
    if calibration.learnt is not None:
        errors[stage_label(calibration)] = calibration.errors(data)
    unknown = np.ones(calibration.nominal.joints)  # the joints' speeds, which no recording shows
    arm = Arm(calibration.arm_name, data.source, calibration.nominal, None, unknown)
    plant = Plant(f"{calibration.arm_name}, measured", arm, calibration.identified)
    points = forward(calibration.nominal, data.joints).position
    return _without_reaches(calibration, plant, errors, _grid_around(points, data.joints), seed)


def _without_reaches(
    calibration: Calibration, plant: Plant, errors: Mapping[str, Array], grid: FieldGrid, seed: int
) -> Comparison:
    uncertainty, points, poses = uncertainty_from(calibration.record), np.empty((0, 3)), np.empty((0, 6))
    none = Reaches((), poses, poses, np.empty(0, dtype=np.bool_), grid.joints[:0], points, points)
    return Comparison(
        policies=tuple(ended(label, none).with_field(error) for label, error in errors.items()),
        plant=plant,
        tolerance_mm=0.0,
        seed=seed,
        grid=grid,
        field_uncertainty=None if uncertainty is None else uncertainty.standard(calibration.model, grid.joints)[0],
    )


def _grid_around(points: Array, joints: Array) -> FieldGrid:
    """Return a grid around irregular points ``(F, 3)``, m, at which the arm has ``joints`` ``(F, n)``.

    Cells are cubes of a round size, with about `CELLS` cells along the longest side.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    step = round_step(max(float((high - low).max()), 1e-3) / CELLS)
    shape = np.maximum(np.ceil((high - low) / step).astype(int), 1)
    corner = (low + high - shape * step) / 2.0
    index = np.clip(((points - corner) / step).astype(np.int64), 0, shape - 1)
    return FieldGrid(tuple(shape.tolist()), corner + step / 2.0, step, index, points, joints)
