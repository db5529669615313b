"""A Rerun recording of a setting's worst, median and best arm: their error fields and reaches side by side.

Each arm is calibrated at its own poses; all reach for the fruit of the worst one, so that they can be compared.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.pose_error import pose_error
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_batch import plant_at
from pickenv.errors import InputError
from pickenv.inspect.runs.comparison_summary import Comparison, PolicyErrors, compared, policy_errors
from pickenv.inspect.runs.field_grid import FieldGrid, field_grid
from pickenv.study.analysis.single_arms import ranked
from pickenv.study.design.config import Setting
from pickenv.study.design.protocol import Circumstances, Protocol, carrying, prepared_study
from pickenv.study.results.study_folder import read_rows, study_of
from pickenv.study.running.arm_by_arm import arm_commands

GRID_STEP = 0.1
"""Cell size of the error fields, m."""


def record_study(folder: str | Path, setting: int, path: str | Path) -> Path:
    """Write the recording of three arms of a setting (.rrd), whole or not at all.

    Args:
        folder: A study's results.
        setting: Number of the setting.
        path: The file to write, usually `arms.rrd`.

    Raises:
        InputError: If there is no such setting, or no arm of it has a result.
    """
    from pickenv.inspect.recordings.comparison_recording import record_comparison

    return record_comparison(arms_compared(folder, setting), path)


def arms_compared(folder: str | Path, setting: int) -> Comparison:
    """Worst, median and best arm of a setting in the place of policies; see `record_study`."""
    protocol = prepared_study(study_of(folder))
    if not 0 <= setting < len(protocol.settings):
        raise InputError(f"there is no setting {setting}; give a number from 0 to {len(protocol.settings) - 1}")
    chosen, grid = protocol.settings[setting], field_grid(protocol.nominal, GRID_STEP, protocol.config.seed)
    places = ranked(read_rows(folder), setting)
    arms = {name: plant_at(protocol.draw(chosen, range(arm, arm + 1)), 0) for name, (arm, _) in places.items()}
    fruit = protocol.circumstances(places["worst"][0]).fruit
    policies = (
        _arm_errors(
            protocol,
            chosen,
            grid,
            arms[name],
            replace(protocol.circumstances(arm), fruit=fruit),
            f"{name} arm (number {arm})",
            name,
        )
        for name, (arm, _) in places.items()
    )
    config = protocol.config
    return compared(
        arms["worst"],
        grid,
        policies,
        seed=config.seed,
        fruit=forward(protocol.nominal, fruit).position,
        tolerance_mm=config.radius_mm,
    )


def _arm_errors(
    protocol: Protocol, setting: Setting, grid: FieldGrid, arm: Plant, given: Circumstances, label: str, key: str
) -> PolicyErrors:
    """One arm's errors over the field and at its fruit, calibrated as the setting says."""
    loaded = carrying(arm, setting.payload_kg)

    def judged(given: Circumstances) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        joints = arm_commands(protocol, setting, arm, given).joints
        reached = loaded.tool_pose(joints)
        return joints, reached.position, pose_error(forward(protocol.nominal, given.fruit), reached)

    _, _, field = judged(replace(given, fruit=grid.joints))
    joints, positions, errors = judged(given)
    success = 1e3 * np.linalg.norm(errors[:, :3], axis=1) <= protocol.config.radius_mm
    return policy_errors(label, field, joints, positions, errors, success, key)
