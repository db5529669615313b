"""Calibrate and judge arms of a study one by one, with the same functions as a real arm's calibration: the reference.

Every arm is worked on with arrays of the same shapes and one thread, so that its numbers are the same to the bit
whatever the executor, the workers and the chunks. Errors are m and rad; the columns of rows are mm and deg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pickenv.arm import Array, Plant, forward, plant_at, pose_error
from pickenv.base import InputError, single_threaded
from pickenv.calibration import Calibration, Compensator, simulated_tracker
from pickenv.calibration.identification.least_squares import identify_converged
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.residuals.residual_models import fit_residual
from pickenv.experiments.engine import Rows
from pickenv.experiments.study import (
    LS,
    RAW,
    RESIDUAL_STREAM,
    Circumstances,
    Protocol,
    Setting,
    StudyConfig,
    carrying,
    deviations,
    measured,
    spread_joints,
)

OK = "ok"
"""Status of an arm that was calibrated and judged; any other is a sentence that says why it was not."""
NOT_FINITE = "the simulated arm has no finite pose at some fruit"
ERROR = "error_mean_mm"
FIGURES = (ERROR, "error_rms_mm", "error_p50_mm", "error_p95_mm", "error_max_mm", "attitude_mean_deg")
"""Columns of errors over an arm's fruit, NaN where the status is not `OK`; so is ``share_within``."""


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What became of N arms in one setting.

    Attributes:
        setting: The setting.
        status: For each arm, `OK` or why it could not be judged ``(N,)``.
        iterations: Steps of its least squares ``(N,)``.
        position: True tool against wanted tool at each fruit ``(N, M)``, m; anything where the status is not OK.
        attitude: The same for the attitude, rad.
    """

    setting: Setting
    status: Sequence[str]
    iterations: Sequence[int]
    position: Array
    attitude: Array


def gathered(outcomes: Sequence[Outcomes]) -> Outcomes:
    """Outcomes of some arms each in one setting, as one."""
    return Outcomes(
        setting=outcomes[0].setting,
        status=[text for part in outcomes for text in part.status],
        iterations=[steps for part in outcomes for steps in part.iterations],
        position=np.concatenate([part.position for part in outcomes]),
        attitude=np.concatenate([part.attitude for part in outcomes]),
    )


def evaluate_chunk(protocol: Protocol, chunk: int, rng: object = None) -> Rows:
    """The rows of a chunk of arms; what they draw follows from the study's seed and their numbers, not from ``rng``."""
    arms = protocol.config.arms_of(chunk)
    populations = []
    with single_threaded():
        around = [protocol.circumstances(arm) for arm in arms]
        for settings in protocol.populations():
            plants = protocol.draw(settings[0], arms)
            outcomes = [evaluate_arm(protocol, settings, plant_at(plants, i), met) for i, met in enumerate(around)]
            populations.append((plants, [gathered(parts) for parts in zip(*outcomes, strict=True)]))
    return chunk_rows(protocol, arms, populations)


def evaluate_arm(protocol: Protocol, settings: Sequence[Setting], arm: Plant, around: Circumstances) -> list[Outcomes]:
    """Calibrate and judge one true arm in several settings.

    Args:
        protocol: The study.
        settings: The settings; the arm need not be of their populations.
        arm: The true arm.
        around: Its fruit, its calibration poses and how its tracker errs.

    Returns:
        For each setting, the outcomes of one arm.
    """
    commands: dict[tuple[Any, ...], ArmCommands] = {}
    outcomes = []
    targets = forward(protocol.nominal, around.fruit)
    for setting in settings:
        key = (setting.method, setting.poses, setting.noise)
        if key not in commands:  # a payload changes where the arm ends, not what it is told
            commands[key] = arm_commands(protocol, setting, arm, around)
        command = commands[key]
        error = pose_error(targets, carrying(arm, setting.payload_kg).tool_pose(command.joints))
        position, attitude = (np.linalg.norm(part, axis=1)[None] for part in (error[:, :3], error[:, 3:]))
        outcomes.append(Outcomes(setting, [command.status], [command.iterations], position, attitude))
    return outcomes


@dataclass(frozen=True, eq=False)
class ArmCommands:
    """What an arm is told to reach its fruit.

    Attributes:
        joints: Joint commands ``(M, n)``, rad or m.
        status: `OK`, or why the arm could not be calibrated.
        iterations: Steps of the least squares.
    """

    joints: Array
    status: str = OK
    iterations: int = 0


def arm_commands(protocol: Protocol, setting: Setting, arm: Plant, around: Circumstances) -> ArmCommands:
    """Calibrate one arm as the setting says, and correct its commands."""
    if setting.method == RAW:
        return ArmCommands(around.fruit)
    try:
        compensator, iterations = _calibrated(protocol, setting, arm, around)
    except InputError as error:
        return ArmCommands(around.fruit, str(error))
    except np.linalg.LinAlgError as error:
        return ArmCommands(around.fruit, f"the identification broke down: {error}")
    joints, targets = compensator(around.fruit), forward(protocol.nominal, around.fruit).position
    miss = np.linalg.norm(compensator.predict(joints).position - targets, axis=1)
    missed = int(np.sum(miss > 1e-3 * protocol.config.radius_mm))
    return ArmCommands(joints, reach_status(missed, protocol.config), iterations)


def _calibrated(protocol: Protocol, setting: Setting, arm: Plant, around: Circumstances) -> tuple[Compensator, int]:
    """The compensator of one arm, and the steps of its least squares."""
    identified = identify_converged(protocol.model, protocol.nominal, measured(protocol, arm, setting, around))
    iterations = len(identified.residual_rms) - 1
    _, _, kind = setting.method.partition(f"{LS}+")
    if not kind:
        return Compensator(protocol.nominal, identified.geometry), iterations
    rng = protocol.stream(RESIDUAL_STREAM, around.number)
    joints = spread_joints(protocol.nominal, protocol.config.residual_poses, rng)
    further = simulated_tracker(arm, joints, rng, protocol.instrument(setting))
    targets = further.difference(identified.arm_model)
    learnt = fit_residual(kind, further.joints, targets, further.prismatic, rng)
    model = ArmModel.of(identified.geometry)
    calibration = Calibration(protocol.design.arm.name, protocol.nominal, protocol.nominal, model, learnt, record={})
    return calibration.compensator(), iterations


def reach_status(missed: int, config: StudyConfig) -> str:
    """Status of an arm whose commands end far from this many fruit by the calibration's own word."""
    if (config.fruit - missed) / config.fruit >= config.share:
        return OK
    return (
        f"{missed} of {config.fruit} fruit are out of this arm's reach: by its calibration its commands end more than "
        f"{config.radius_mm:g} mm away"
    )


def figures(position: Array, attitude: Array, radius_mm: float) -> dict[str, Array]:
    """Error columns ``(N,)`` of arms with these errors ``(N, M)``, m and rad."""
    position_mm = 1e3 * np.ascontiguousarray(position)
    median, p95 = np.percentile(position_mm, [50, 95], axis=1)
    values = (
        position_mm.mean(axis=1),
        np.sqrt(np.mean(position_mm**2, axis=1)),
        median,
        p95,
        position_mm.max(axis=1),
        np.degrees(np.ascontiguousarray(attitude).mean(axis=1)),
    )
    return dict(zip(FIGURES, values, strict=True)) | {"share_within": np.mean(position_mm <= radius_mm, axis=1)}


def chunk_rows(protocol: Protocol, arms: range, populations: Sequence[tuple[Plant, Sequence[Outcomes]]]) -> Rows:
    """The rows of a chunk, one for each arm and setting, sorted by both.

    Args:
        protocol: The study.
        arms: Numbers of the chunk's arms.
        populations: For each population, its true arms and their outcomes in each of its settings.
    """
    parts = [
        _columns(arms, outcomes, protocol.config.radius_mm) | columns_of_arms
        for plants, settings in populations
        for columns_of_arms in [deviations(protocol.design, plants)]
        for outcomes in settings
    ]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.lexsort((columns["setting"], columns["arm"]))
    return Rows({name: values[order] for name, values in columns.items()})


def _columns(arms: range, outcomes: Outcomes, radius_mm: float) -> dict[str, Any]:
    count = len(arms)
    finite = np.isfinite(outcomes.position + outcomes.attitude).all(axis=1)
    status = np.where((np.array(outcomes.status) == OK) & ~finite, NOT_FINITE, outcomes.status)
    columns: dict[str, Any] = {"setting": None, "arm": np.arange(arms.start, arms.stop)}
    for name, value in outcomes.setting.columns().items():
        columns[name] = np.full(count, value, dtype=np.int32 if isinstance(value, int) else None)
    columns |= {"status": status, "iterations": np.asarray(outcomes.iterations, dtype=np.int32)}
    columns |= {name: np.full(count, np.nan) for name in (*FIGURES, "share_within")}
    is_ok = status == OK
    if is_ok.any():
        for name, values in figures(outcomes.position[is_ok], outcomes.attitude[is_ok], radius_mm).items():
            columns[name][is_ok] = values
    return columns
