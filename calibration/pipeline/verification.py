"""An old calibration on new rows: still good, drifted, or of another arm. mm and degrees on screens, SI inside."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.assessment.metrics import ErrorStatistics, error_statistics
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.diagnosis import LeftOut
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, origins_of
from pickenv.calibration.model.splits import BLOCKS, Rows
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.restation import (
    REFIT_ROWS,
    errors_there,
    expected_square,
    near_rows,
    restationed,
    weighed_by_reach,
)
from pickenv.errors import InputError

GROWN = 1.5
"""Errors may be so many times what is expected before a calibration counts as drifted: rows of another region of the
workspace are up to 1.3 times worse on four sets of one robot."""

ELSEWHERE = 20.0
"""Errors of more than so many times what is expected are those of another station."""

Status = Literal["still good", "drifted", "another arm", "another station"]


@dataclass(frozen=True, eq=False)
class Verification:
    """What new rows say of a calibration.

    Attributes:
        status: The verdict.
        reason: Why, in a sentence.
        calibrated: Errors of the calibrated arm, mm.
        nominal: Errors of the nominal arm, with the same frames refitted on the same rows, mm.
        expected: What the RMS should be, mm.
        rows: Rows judged.
        refitted: Rows that base and tool were found from.
        moved: How far base and tool lie from where they were, by name: m and rad.
        since: The first row from which on errors stay large, in words; None where they do not.
        left_out: Rows far off from all others.
    """

    status: Status
    reason: str
    calibrated: ErrorStatistics
    nominal: ErrorStatistics
    expected: float
    rows: int
    refitted: int
    moved: dict[str, tuple[float, float]]
    since: str | None
    left_out: tuple[LeftOut, ...]

    def text(self) -> str:
        """For the terminal: the verdict first."""
        heads = ("arm", "RMS (mm)", "mean (mm)", "95 % interval (mm)", "p95 (mm)", "max (mm)")
        rows = []
        for name, s in (("nominal", self.nominal), ("calibrated", self.calibrated)):
            interval = "none" if s.mean_ci95 is None else " to ".join(map(figure, s.mean_ci95))
            rows.append((name, figure(s.rms), figure(s.mean), interval, figure(s.p95), figure(s.max)))
        how = f"base and tool as they were; expected of the calibrated arm: {figure(self.expected)} mm RMS"
        if self.refitted:
            how = (
                f"{' and '.join(self.moved)} found from {self.refitted} other rows, of both arms; expected of the "
                f"calibrated arm: {figure(self.expected)} mm RMS"
            )
        blocks = [Block(f"Errors on {self.rows} rows", heads, tuple(rows), how)]
        if self.moved:
            moved = tuple((name, figure(m * 1e3), figure(float(np.degrees(a)))) for name, (m, a) in self.moved.items())
            blocks.append(Block("Moved since the calibration", ("frame", "by (mm)", "turned (deg)"), moved, ""))
        if self.left_out:
            far = tuple((item.text(),) for item in self.left_out)
            blocks.append(Block("Rows left out", (), far, "too far off to be measurements of these poses"))
        return "\n".join([f"verdict: {self.status.upper()}: {self.reason}", *(block.text() for block in blocks)])

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "status": self.status,
            "reason": self.reason,
            "rows": self.rows,
            "refit_rows": self.refitted,
            "calibrated_mm": self.calibrated.as_dict(),
            "nominal_mm": self.nominal.as_dict(),
            "expected_rms_mm": self.expected,
            "moved": {name: {"mm": m * 1e3, "deg": float(np.degrees(a))} for name, (m, a) in self.moved.items()},
            "since": self.since,
            "left_out_rows": [vars(item) for item in self.left_out],
        }


def verify(
    calibration: Calibration, data: Observations, refit: Collection[str] = (), refit_rows: int = REFIT_ROWS
) -> Verification:
    """Judge an old calibration on new rows.

    Args:
        calibration: The calibration.
        data: New poses or positions of the same robot.
        refit: Which of "base" and "tool" are found anew first, because the instrument or its target was moved.
        refit_rows: Rows to find them from.

    Raises:
        InputError: If these are no poses or positions, or too few.
    """
    if not isinstance(data, Measurements):
        raise InputError(f"{data.source} holds {data.kind}; a calibration is verified on poses or positions")
    if len(data) < 3:
        raise InputError(f"{data.source}: {len(data)} rows judge nothing; measure at least 3")
    nominal = replace(calibration, model=ArmModel.of(calibration.nominal), learnt=None)
    data, left_out = near_rows(calibration, data, refit, refit_rows)
    moved: dict[str, tuple[float, float]] = {}
    if refit:
        at = restationed(calibration, data, refit, refit_rows)
        rest, expected, moved = at.rest, at.expected, at.moved
        errors = errors_there(at, calibration, data)
        # The nominal arm sees the same rows: nobody is blamed for where the instrument stands.
        before = errors_there(restationed(nominal, data, refit, refit_rows, at.used), nominal, data)
    else:
        errors, before, rest = calibration.errors(data), nominal.errors(data), np.arange(len(data))
        expected = np.full(len(data), expected_square(weighed_by_reach(calibration, data)))
    blocks = np.arange(len(rest)) * BLOCKS // len(rest) if len(rest) >= 4 * BLOCKS else None
    mine, theirs = (error_statistics(e[:, :3] * 1e3, blocks) for e in (errors, before))
    wanted = float(np.sqrt(expected.mean())) * 1e3
    since = _since(data, rest, errors, expected)
    status, reason = _verdict(mine, theirs, wanted, bool(refit), since)
    return Verification(
        status, reason, mine, theirs, wanted, len(rest), refit_rows if refit else 0, moved, since, left_out
    )


def _since(data: Measurements, rest: Rows, errors: Array, expected: Array) -> str | None:
    """The first of the contiguous blocks from which on all are larger than they may be."""
    if len(rest) < 4 * BLOCKS:
        return None
    parts = np.array_split(np.arange(len(rest)), BLOCKS)
    ratio = [float(np.sqrt(np.mean(np.sum(errors[part, :3] ** 2, axis=1)) / expected[part].mean())) for part in parts]
    large = np.array(ratio) > GROWN
    if not large[-1] or large.all():
        return None
    first = int(np.flatnonzero(~large)[-1]) + 1
    file, line = origins_of(data).place(int(rest[parts[first][0]]))
    return f"from {file}, row {line}, on"


def _verdict(
    mine: ErrorStatistics, theirs: ErrorStatistics, wanted: float, refitted: bool, since: str | None
) -> tuple[Status, str]:
    ratio = mine.rms / wanted
    said = f"{figure(mine.rms)} mm RMS where {figure(wanted)} mm are expected"
    when = f" {since}" if since else " since the calibration"
    if not refitted and ratio > ELSEWHERE:
        return "another station", (
            f"the rows miss by {said}: instrument or target were moved, or it is another arm; give --refit base,tool"
        )
    if ratio <= GROWN and since is None:
        return "still good", f"{said}, and {figure(theirs.rms)} mm with the nominal arm"
    if mine.rms >= theirs.rms:
        return "another arm", (
            f"{said}, and no less than the nominal arm's {figure(theirs.rms)} mm: it is of another arm, or of another "
            "part of the workspace; calibrate anew"
        )
    grown = float(np.sqrt(max(mine.rms**2 - wanted**2, 0.0)))
    return "drifted", (
        f"{said}: it is this arm's, for the nominal one misses by {figure(theirs.rms)} mm, but {figure(grown)} mm RMS "
        f"have come{when}, by a change of the arm or where it was not measured; calibrate anew"
    )
