"""From the errors of arms at their fruit to rows of the result table: m and rad come in, mm and deg go out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.plant import Plant
from pickenv.study.design.config import Setting, StudyConfig, deviations
from pickenv.study.design.protocol import Protocol
from pickenv.study.results.row_table import FIGURES, OK, make_table, setting_columns


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What became of N arms in one setting.

    Attributes:
        setting: The setting.
        status: For each arm, `pickenv.study.results.row_table.OK` or why it could not be judged ``(N,)``.
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


def reach_status(missed: int, config: StudyConfig) -> str:
    """Status of an arm whose commands end far from this many fruit by the calibration's own word."""
    if (config.fruit - missed) / config.fruit >= config.share:
        return OK
    return (
        f"{missed} of {config.fruit} fruit are out of this arm's reach: by its calibration its commands end more than "
        f"{config.radius_mm:g} mm away"
    )


NOT_FINITE = "the simulated arm has no finite pose at some fruit"


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


def chunk_table(protocol: Protocol, arms: range, populations: Sequence[tuple[Plant, Sequence[Outcomes]]]) -> pa.Table:
    """The rows of a chunk.

    Args:
        protocol: The study.
        arms: Numbers of the chunk's arms.
        populations: For each population, its true arms and their outcomes in each of its settings.
    """
    parts = [
        _columns(protocol, arms, outcomes) | drawn
        for plants, settings in populations
        for drawn in [deviations(protocol.design, plants)]
        for outcomes in settings
    ]
    return make_table({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def _columns(protocol: Protocol, arms: range, outcomes: Outcomes) -> dict[str, Any]:
    setting, count = outcomes.setting, len(arms)
    finite = np.asarray(np.isfinite(outcomes.position + outcomes.attitude).all(axis=1))
    status = [
        NOT_FINITE if text == OK and not sound else text for text, sound in zip(outcomes.status, finite, strict=True)
    ]
    judged = np.array([text == OK for text in status])
    columns: dict[str, Any] = {name: np.full(count, value) for name, value in setting_columns(setting).items()}
    columns |= {"arm": np.arange(arms.start, arms.stop), "status": np.array(status)}
    columns |= {"iterations": np.asarray(outcomes.iterations)}
    columns |= {name: np.full(count, np.nan) for name in (*FIGURES, "share_within")}
    if judged.any():
        found = figures(outcomes.position[judged], outcomes.attitude[judged], protocol.config.radius_mm)
        for name, values in found.items():
            columns[name][judged] = values
    return columns
