"""Calibrate on some rows, judge on others, and say it in figures that can be compared.

Nominal means after base and tool were fitted: an uncalibrated arm is not blamed for where the instrument stood.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.error_model import residual
from calibration.fitting import Fit, fit
from calibration.measurements import Measurements
from calibration.metrics import ErrorStatistics, error_statistics
from calibration.splits import blocked_split, random_split
from pickenv.arm import Arm
from pickenv.errors import InputError


@dataclass(frozen=True, eq=False)
class Judged:
    """A calibration and its held-out errors.

    Attributes:
        arm: Name of the arm.
        fit: The calibration and its evidence.
        train_rows: Rows used for the fit.
        test_rows: Rows held out.
        nominal: Held-out position errors of the nominal geometry after fitting base and tool, mm.
        geometric: Held-out position errors of the identified geometry, mm.
        nominal_attitude: The same for attitude, deg; None for position measurements.
        geometric_attitude: The same for attitude, deg; None for position measurements.
    """

    arm: str
    fit: Fit
    train_rows: int
    test_rows: int
    nominal: ErrorStatistics
    geometric: ErrorStatistics
    nominal_attitude: ErrorStatistics | None
    geometric_attitude: ErrorStatistics | None

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        found = self.fit.identification
        held_out: dict[str, Any] = {
            "nominal_rms_mm": self.nominal.rms,
            "geometric_rms_mm": self.geometric.rms,
            "geometric_mean_mm": self.geometric.mean,
            "geometric_mean_ci95_mm": self.geometric.mean_ci95,
            "nominal_mm": self.nominal.as_dict(),
            "geometric_mm": self.geometric.as_dict(),
        }
        if self.nominal_attitude is not None and self.geometric_attitude is not None:
            held_out["nominal_deg"] = self.nominal_attitude.as_dict()
            held_out["geometric_deg"] = self.geometric_attitude.as_dict()
        return {
            "arm": self.arm,
            "measurement_kind": found.kind,
            "rows": {"train": self.train_rows, "test": self.test_rows},
            "parameters": len(found.identifiability.names),
            "rank": found.identifiability.rank,
            "dropped": {item.name: item.absorbed_by for item in found.identifiability.dropped},
            "condition": found.identifiability.condition,
            "converged": found.converged,
            "solve_seconds": found.solve_seconds,
            "held_out": held_out,
        }

    def report(self) -> str:
        """A report for people."""
        rows = [("nominal, base and tool fitted", self.nominal, self.nominal_attitude)]
        rows.append(("calibrated geometry", self.geometric, self.geometric_attitude))
        lines = [
            self.fit.identification.report(),
            f"held out: {self.test_rows} rows (trained on {self.train_rows}), solved in "
            f"{1e3 * self.fit.identification.solve_seconds:.0f} ms",
            f"{'':>30}  {'RMS mm':>8}  {'mean mm':>8}  {'95 % interval':>16}  {'p95 mm':>8}  {'max mm':>8}",
        ]
        for label, position, attitude in rows:
            low, high = position.mean_ci95
            line = f"{label:>30}  {position.rms:8.4f}  {position.mean:8.4f}  {low:7.4f}..{high:7.4f}"
            line += f"  {position.p95:8.4f}  {position.max:8.4f}"
            lines.append(line + (f"  attitude mean {attitude.mean:.4f} deg" if attitude else ""))
        return "\n".join(lines)


def choose_rows(
    measurements: Measurements, split: str, test_rows: int | None, seed: int
) -> tuple[Measurements, Measurements]:
    """Split one data set into training and held-out rows; ``split`` is "random" or "blocked"."""
    count = len(measurements)
    wanted = max(1, count // 5) if test_rows is None else test_rows
    if split == "random":
        train, test = random_split(count, wanted, np.random.default_rng(seed))
    elif split == "blocked":
        train, test = blocked_split(count, wanted)
    else:
        raise InputError(f"split is '{split}'; give random or blocked")
    return measurements.select(train), measurements.select(test)


def calibrate_and_judge(arm: Arm, train: Measurements, test: Measurements) -> Judged:
    """Fit base, tool and geometry on ``train`` and state the errors on ``test``.

    Raises:
        InputError: As `calibration.fit`.
    """
    found = fit(arm, train)
    before, after = residual(found.calibration.nominal, test), residual(found.calibration.identified, test)
    full = test.rotation is not None
    return Judged(
        arm=arm.name,
        fit=found,
        train_rows=len(train),
        test_rows=len(test),
        nominal=error_statistics(before[:, :3] * 1e3),
        geometric=error_statistics(after[:, :3] * 1e3),
        nominal_attitude=error_statistics(np.degrees(before[:, 3:])) if full else None,
        geometric_attitude=error_statistics(np.degrees(after[:, 3:])) if full else None,
    )
