"""Calibrate and judge arms one by one, with the same functions as a real arm's calibration: the reference.

Every arm is worked on with arrays of the same shapes and one thread, so that its numbers are the same to the bit
whatever the executor, the workers and the chunks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.pose_error import pose_error
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.plant_batch import plant_at
from pickenv.calibration.compensation.compensator import Compensator
from pickenv.calibration.identification.least_squares import identify_converged
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.measurements import simulated_tracker
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.residuals.residual_models import fit_residual
from pickenv.errors import InputError
from pickenv.study.design.config import LS, RAW, Setting
from pickenv.study.design.protocol import RESIDUAL, Circumstances, Protocol, carrying, measured, spread_joints
from pickenv.study.results.outcomes import Outcomes, chunk_table, gathered, reach_status
from pickenv.study.results.row_table import OK
from pickenv.threads import single_threaded


@dataclass(frozen=True, eq=False)
class ArmCommands:
    """What an arm is told to reach its fruit.

    Attributes:
        joints: Joint commands ``(M, n)``, rad or m.
        status: `pickenv.study.results.row_table.OK`, or why the arm could not be calibrated.
        iterations: Steps of the least squares.
    """

    joints: Array
    status: str = OK
    iterations: int = 0


def evaluate_chunk(protocol: Protocol, chunk: int) -> pa.Table:
    """The rows of a chunk of arms."""
    arms = protocol.config.arms_of(chunk)
    populations = []
    with single_threaded():
        each = [protocol.circumstances(arm) for arm in arms]
        for settings in protocol.populations():
            plants = protocol.draw(settings[0], arms)
            found = [evaluate_arm(protocol, settings, plant_at(plants, i), given) for i, given in enumerate(each)]
            populations.append((plants, [gathered(outcomes) for outcomes in zip(*found, strict=True)]))
    return chunk_table(protocol, arms, populations)


def evaluate_arm(protocol: Protocol, settings: Sequence[Setting], arm: Plant, given: Circumstances) -> list[Outcomes]:
    """Calibrate and judge one true arm in several settings.

    Args:
        protocol: The study.
        settings: The settings; the arm need not be of their populations.
        arm: The true arm.
        given: Its fruit, its calibration poses and how its tracker errs.

    Returns:
        For each setting, the outcomes of one arm.
    """
    known: dict[tuple[Any, ...], ArmCommands] = {}
    outcomes = []
    wanted = forward(protocol.nominal, given.fruit)
    for setting in settings:
        key = (setting.method, setting.poses, setting.noise)
        if key not in known:  # a payload changes where the arm ends, not what it is told
            known[key] = arm_commands(protocol, setting, arm, given)
        told = known[key]
        error = pose_error(wanted, carrying(arm, setting.payload_kg).tool_pose(told.joints))
        position, attitude = (np.linalg.norm(part, axis=1)[None] for part in (error[:, :3], error[:, 3:]))
        outcomes.append(Outcomes(setting, [told.status], [told.iterations], position, attitude))
    return outcomes


def arm_commands(protocol: Protocol, setting: Setting, arm: Plant, given: Circumstances) -> ArmCommands:
    """Calibrate one arm as the setting says, and correct its commands."""
    if setting.method == RAW:
        return ArmCommands(given.fruit)
    try:
        compensator, iterations = _calibrated(protocol, setting, arm, given)
    except InputError as error:
        return ArmCommands(given.fruit, str(error))
    except np.linalg.LinAlgError as error:
        return ArmCommands(given.fruit, f"the identification broke down: {error}")
    joints, wanted = compensator(given.fruit), forward(protocol.nominal, given.fruit).position
    miss = np.linalg.norm(compensator.predict(joints).position - wanted, axis=1)
    missed = int(np.sum(miss > 1e-3 * protocol.config.radius_mm))
    return ArmCommands(joints, reach_status(missed, protocol.config), iterations)


def _calibrated(protocol: Protocol, setting: Setting, arm: Plant, given: Circumstances) -> tuple[Compensator, int]:
    """The compensator of one arm, and the steps of its least squares."""
    found = identify_converged(protocol.model, protocol.nominal, measured(protocol, arm, setting, given))
    iterations = len(found.residual_rms) - 1
    _, _, kind = setting.method.partition(f"{LS}+")
    if not kind:
        return Compensator(protocol.nominal, found.geometry), iterations
    rng = protocol.stream(RESIDUAL, given.number)
    joints = spread_joints(protocol.nominal, protocol.config.residual_poses, rng)
    further = simulated_tracker(arm, joints, rng, protocol.instrument(setting))
    targets = further.difference(found.arm_model)
    learnt = fit_residual(kind, further.joints, targets, further.prismatic, rng)
    calibration = Calibration(
        protocol.design.arm.name, protocol.nominal, protocol.nominal, ArmModel.of(found.geometry), learnt, record={}
    )
    return calibration.compensator(), iterations
