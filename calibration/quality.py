"""Is this calibration good? Verdict first, then what it rests on: errors per degree of freedom, rank, condition, chi^2.

The chi^2 test asks whether the model is complete for the stated noise (s^2 = r^T W r / (N - p) against 1). Units: mm
and degrees on screens, SI inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

from calibration.coverage import Coverage
from calibration.identifiability import Identifiability
from calibration.least_squares import Identification, is_angle
from calibration.observability import Observability, observability_of
from pickenv.arm.geometry import Array

CORRELATED = 0.9
"""Parameters whose estimates correlate more than this are hard to tell apart."""

ILL_CONDITIONED = 300.0
"""Condition number above which small errors of the data move parameters far."""

OPTIMISTIC = 1.5
"""Held-out errors above this many times the training errors: the fit does not carry over."""

SMALL_SHARE = 0.01
"""Part of a combination that a reader need not see."""

SIGNIFICANCE = 0.05
"""Level of the chi^2 test."""

AXES = ("x", "y", "z", "rx", "ry", "rz")

Grade = Literal["good", "usable with care", "do not use"]


@dataclass(frozen=True)
class Completeness:
    """The chi^2 test of whether model and stated noise explain the residuals.

    Attributes:
        chi_square: Sum of squared residuals in stated standard uncertainties.
        degrees_of_freedom: Equations minus parameters.
        p_value: Chance of a chi^2 this large if the model were complete and the noise as stated.
        p_small: Chance of a chi^2 this small.
    """

    chi_square: float
    degrees_of_freedom: int
    p_value: float
    p_small: float

    @property
    def reduced(self) -> float:
        """chi^2 per degree of freedom; 1 is expected. NaN without spare equations."""
        return self.chi_square / self.degrees_of_freedom if self.degrees_of_freedom > 0 else float("nan")

    @property
    def complete(self) -> bool:
        """Whether nothing beyond the stated noise is left."""
        return self.p_value >= SIGNIFICANCE

    def sentence(self) -> str:
        """The test in words."""
        if self.degrees_of_freedom <= 0:
            return "there are no spare equations, so the model cannot be tested"
        said = f"reduced chi^2 {self.reduced:.3g}, {self.degrees_of_freedom} degrees of freedom"
        if not self.complete:
            return (
                f"what remains is {np.sqrt(self.reduced):.2g} times the stated noise ({said}): effects beyond the "
                "model are left, or the stated noise is too small"
            )
        if self.p_small < SIGNIFICANCE / 2:
            return f"what remains is smaller than the stated noise ({said}), which is probably stated too large"
        return f"what remains is the stated noise ({said}, p = {self.p_value:.2g}): the model is complete for it"


def completeness(found: Identification) -> Completeness:
    """The chi^2 test of an identification."""
    freedom = found.degrees_of_freedom
    if freedom <= 0:
        return Completeness(found.chi_square, freedom, float("nan"), float("nan"))
    law = stats.chi2(freedom)
    return Completeness(found.chi_square, freedom, float(law.sf(found.chi_square)), float(law.cdf(found.chi_square)))


def correlated_pairs(found: Identification, limit: float = CORRELATED) -> tuple[tuple[str, str, float], ...]:
    """Pairs of kept parameters whose estimates correlate by more than ``limit``, strongest first."""
    std = np.sqrt(np.diag(found.covariance))
    rho = found.covariance / std[:, None] / std
    names = found.identifiability.kept_names
    pairs = [(names[i], names[j], float(rho[i, j])) for i, j in np.argwhere(np.triu(np.abs(rho) > limit, 1))]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))


def base_combinations(found: Identifiability) -> dict[str, str]:
    """What each kept parameter really stands for, as text: its own deviation and those of the dropped ones it absorbs.

    Coefficients between lengths and angles are in mm/deg or deg/mm; shares below `SMALL_SHARE` are left out.
    """
    texts = {name: name for name in found.kept_names}
    for item in found.dropped:
        for name, share in item.absorbed_by.items():
            if abs(share) < SMALL_SHARE and is_angle(name) == is_angle(item.name):
                continue
            texts[name] += f" {'-' if share < 0 else '+'} {_coefficient(share, name, item.name)}{item.name}"
    return texts


def _coefficient(share: float, kept: str, dropped: str) -> str:
    unit, value = "", abs(share)
    if is_angle(kept) and not is_angle(dropped):
        unit, value = " deg/mm ", float(np.degrees(value)) * 1e-3
    elif is_angle(dropped) and not is_angle(kept):
        unit, value = " mm/deg ", float(np.radians(value)) * 1e3
    return (unit and f"{value:.4g}{unit}") or ("" if abs(value - 1) < 1e-6 else f"{value:.4g} ")


@dataclass(frozen=True)
class AxisErrors:
    """Errors along one degree of freedom, mm or deg.

    Attributes:
        axis: x, y, z, rx, ry or rz.
        unit: mm or deg.
        mean: Signed mean (bias).
        std: Standard deviation.
        rmse: Root mean square.
        max: Largest size.
    """

    axis: str
    unit: str
    mean: float
    std: float
    rmse: float
    max: float


def axis_errors(errors: Array) -> tuple[AxisErrors, ...]:
    """Statistics of pose errors ``(N, 6)`` or position errors ``(N, 3)``, m and rad, per degree of freedom."""
    scale = np.repeat([1e3, np.degrees(1.0)], 3)[: errors.shape[1]]
    rows = []
    for axis, column in zip(AXES, (errors * scale).T, strict=False):
        rmse = float(np.sqrt(np.mean(column**2)))
        unit = "deg" if axis.startswith("r") else "mm"
        rows.append(
            AxisErrors(axis, unit, float(column.mean()), float(column.std()), rmse, float(np.abs(column).max()))
        )
    return tuple(rows)


@dataclass(frozen=True)
class Finding:
    """One thing that a reader must know.

    Attributes:
        weight: "fail" (do not use it), "caution" (know this before use) or "note".
        text: One sentence.
    """

    weight: Literal["fail", "caution", "note"]
    text: str


@dataclass(frozen=True, eq=False)
class Quality:
    """A calibration's quality.

    Attributes:
        grade: The verdict.
        findings: Why, the gravest first.
        nominal: Held-out errors per axis before (base and tool fitted).
        calibrated: Held-out errors per axis after.
        observability: Of the kept parameters on the training poses.
        completeness: The chi^2 test.
        pairs: Correlated parameters.
        coverage: What the poses hide, where known.
    """

    grade: Grade
    findings: tuple[Finding, ...]
    nominal: tuple[AxisErrors, ...]
    calibrated: tuple[AxisErrors, ...]
    observability: Observability
    completeness: Completeness
    pairs: tuple[tuple[str, str, float], ...]
    coverage: Coverage | None

    def report(self) -> str:
        """For people: verdict, reasons, errors per degree of freedom, condition, correlations."""
        lines = [f"verdict: {self.grade.upper()}"]
        lines += [f"  {finding.weight}: {finding.text}" for finding in self.findings]
        lines.append(f"{'held out':>9}  {'mean':>9}  {'std':>9}  {'RMSE':>9}  {'max':>9}  {'RMSE before':>11}")
        for before, after in zip(self.nominal, self.calibrated, strict=True):
            numbers = "  ".join(f"{value:9.4f}" for value in (after.mean, after.std, after.rmse, after.max))
            lines.append(f"{after.axis + ' ' + after.unit:>9}  {numbers}  {before.rmse:11.4f}")
        seen = self.observability
        lines.append(
            f"condition {seen.condition:.1f}; O1 {seen.o1:.3g}, O2 {seen.o2:.3g}, O3 {seen.o3:.3g}, O4 {seen.o4:.3g}, "
            f"O5 {seen.o5:.3g}"
        )
        for first, second, rho in self.pairs[:10]:
            lines.append(f"correlated: {first}, {second} ({rho:+.3f})")
        return "\n".join(lines)


def judge_quality(
    found: Identification, trained: Array, before: Array, after: Array, coverage: Coverage | None = None
) -> Quality:
    """Grade a calibration.

    Args:
        found: The identification.
        trained: Errors left on the rows it was fitted to ``(N, 6)`` or ``(N, 3)``, m and rad.
        before: Held-out errors of the nominal arm with base and tool fitted ``(M, 6)`` or ``(M, 3)``.
        after: Held-out errors of the calibrated arm.
        coverage: From `calibration.coverage.pose_coverage`.
    """
    seen = observability_of(found.identifiability, found.poses)
    test = completeness(found)
    pairs = correlated_pairs(found) if np.isfinite(found.covariance).all() else ()
    findings = [*_failures(found, before, after), *_cautions(found, trained, after, seen, coverage)]
    findings.append(Finding("note", test.sentence()))
    if pairs:
        worst = f"{pairs[0][0]} and {pairs[0][1]} ({pairs[0][2]:+.2f})"
        findings.append(
            Finding(
                "note",
                f"{len(pairs)} pair{'s' * (len(pairs) > 1)} of parameters correlate by more than {CORRELATED:g}, most "
                f"{worst}: read them together, the predicted pose is not affected",
            )
        )
    weights = {finding.weight for finding in findings}
    grade: Grade = "do not use" if "fail" in weights else "usable with care" if "caution" in weights else "good"
    return Quality(grade, tuple(findings), axis_errors(before), axis_errors(after), seen, test, pairs, coverage)


def _rms_mm(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1)))) * 1e3


def _failures(found: Identification, before: Array, after: Array) -> list[Finding]:
    failures = []
    if not found.converged:
        failures.append(Finding("fail", "the identification did not converge, so its parameters mean nothing"))
    if _rms_mm(after) >= _rms_mm(before):
        failures.append(
            Finding(
                "fail",
                f"on held-out poses the calibrated arm is no better ({_rms_mm(after):.3f} mm RMS) than the nominal one "
                f"({_rms_mm(before):.3f} mm RMS); check units, conventions and the order of rows",
            )
        )
    return failures


def _cautions(
    found: Identification, trained: Array, after: Array, seen: Observability, coverage: Coverage | None
) -> list[Finding]:
    cautions = []
    if coverage is not None and coverage.lost:
        cautions.append(Finding("caution", coverage.advice()))
    if seen.condition > ILL_CONDITIONED:
        cautions.append(
            Finding(
                "caution",
                f"the condition number is {seen.condition:.0f}: some parameter combinations are hardly seen; plan the "
                "poses with `pickenv plan-poses`",
            )
        )
    if _rms_mm(after) > OPTIMISTIC * _rms_mm(trained):
        cautions.append(
            Finding(
                "caution",
                f"held-out errors ({_rms_mm(after):.3f} mm RMS) are {_rms_mm(after) / _rms_mm(trained):.1f} times as "
                "large as on the training rows: measure more poses, or poses like those that will be used",
            )
        )
    if found.degrees_of_freedom < found.identifiability.rank:
        cautions.append(
            Finding(
                "caution",
                f"{found.degrees_of_freedom} spare equations for {found.identifiability.rank} parameters are few; "
                "measure at least twice as many poses",
            )
        )
    return cautions
