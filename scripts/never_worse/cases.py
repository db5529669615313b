"""The cases in which a calibration must never be worse than the drawing, each by the default command.

A case fits what a user would fit and judges it where the truth is known. Its rows say where, in one unit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from never_worse.judge import (
    PoseOf,
    aligned_errors,
    calibrated_flange,
    chain_of_origins,
    covered,
    flange_of,
    regions,
    rms,
)

import pickenv
from pickenv.arm import load_arm
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration import Result, read_observations

MM = 1e3


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        subject: What was fitted.
        where: Where, or on what, it is judged.
        calibrated: Figure of the calibrated arm by the default command, in `unit`.
        nominal: The same of the nominal arm; None where there is none.
        plain: The same of plain least squares; None where it was not asked.
        unit: Of the three.
        within95: Share of the true errors that are within what was stated for 95 of 100; None where not asked.
        grade: The verdict.
        at_most: What `calibrated` must not exceed; None where the row is for information.
    """

    subject: str
    where: str
    calibrated: float
    nominal: float | None = None
    plain: float | None = None
    unit: str = "mm"
    within95: float | None = None
    grade: str | None = None
    at_most: float | None = None

    @property
    def meets(self) -> bool | None:
        """Whether the row is at most what it may be; None where nothing is asked."""
        return None if self.at_most is None else self.calibrated <= self.at_most

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "meets": self.meets}


@dataclass(frozen=True)
class Settings:
    """What the cases are run with.

    Attributes:
        data: Folder of the measured data sets.
        folder: Where generated sequences and files are kept.
        seed: Seeds everything that is drawn.
        sequences: KinHEC sequences of each arm.
        arms: Printed SO-101 that are drawn.
        step: Called with what was done, after each fit.
    """

    data: Path
    folder: Path
    seed: int = 0
    sequences: int = 8
    arms: int = 30
    step: Callable[[str], None] = print


def grade_of(result: Result) -> str:
    """The verdict's word."""
    return str(result.quality.grade)


def judged(
    subject: str, result: Result, nominal: PoseOf, truth: PoseOf, where: dict[str, Array], at_most: dict[str, float]
) -> list[Row]:
    """Rows of one calibration against the true arm, region by region."""
    calibration = result.calibration
    flange, rows = calibrated_flange(calibration), []
    for name, joints in where.items():
        rows.append(
            Row(
                subject,
                name,
                MM * rms(aligned_errors(flange, truth, joints)),
                MM * rms(aligned_errors(nominal, truth, joints)),
                within95=covered(calibration, truth, joints),
                grade=grade_of(result),
                at_most=at_most.get(name),
            )
        )
    return rows


UR10E_LIMITS = {"at the poses": 0.85, "0.15 rad beside": 1.0, "box of ranges": 1.3, "all joints": 1.6}


def ur10e(settings: Settings) -> list[Row]:
    """23 pictures of a real UR10e, against its maker's factory calibration, which the judge alone reads."""
    folder, arm = settings.data / "ur10e_realsense", load_arm("ur10e")
    views, columns = folder / "views.csv", folder / "columns.toml"
    truth = chain_of_origins(folder / "factory_kinematics.yaml")
    measured = read_observations([views], arm.nominal, columns).observations.joints
    result = pickenv.calibrate(arm, views, columns=columns)
    settings.step("23 pictures")
    every = np.full(arm.nominal.joints, np.pi)
    where = regions(measured, -every, every, settings.seed)
    return judged("UR10e, 23 pictures", result, flange_of(arm.nominal), truth, where, UR10E_LIMITS)


CASES: dict[str, Callable[[Settings], list[Row]]] = {"ur10e": ur10e}
