"""Calibrate on some rows, judge on others, and say it in figures that can be compared.

Nominal means after base and tool were fitted: an uncalibrated arm is not blamed for where the instrument stood. Terms
and residual model are chosen within the training rows, so that the held-out figures are those of rows never looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.arm_model import ArmModel, Term
from calibration.columns import NoiseFloor
from calibration.diagnosis import gross_outliers, lost_to_poses, refuse_gross_errors, robust_fit, suspicious
from calibration.error_model import complete_model
from calibration.fitting import Fit, fit
from calibration.gate import GateReport, judge_residuals
from calibration.least_squares import identify
from calibration.measurements import Measurements
from calibration.metrics import ErrorStatistics, error_statistics
from calibration.observations import Observations, PoseObservations
from calibration.other_kinds import fit_kind
from calibration.residual_models import FITTERS, Fitter, fit_residual
from calibration.robust import RobustIdentification
from calibration.rows import misses, unknowns_of
from calibration.term_choice import TermChoice, choose_terms, identify_terms, terms_of
from calibration.uncertainty import held_out_errors
from pickenv.arm import Arm
from pickenv.arm.geometry import Array
from pickenv.errors import InputError

GATE_ROWS = 3000
"""Residual models are judged on so many training rows at most, taken evenly."""

SLOW_ROWS = {"bpnn": 2000}
"""Training rows of the models whose time grows too fast."""

ENOUGH = 40
"""Fewer training rows than this are not enough to hold blocks out of."""


@dataclass(frozen=True)
class Choices:
    """What to do beyond geometry.

    Attributes:
        terms: "auto", or names of terms joined by "+", or "none".
        residual: "auto", a residual model's name, or "none".
        force: Whether a named residual model is used even if it does not win.
        robust: Whether gross outliers are left out (and listed) instead of refused.
        seed: Seeds everything random.
    """

    terms: str = "auto"
    residual: str = "auto"
    force: bool = False
    robust: bool = False
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Judged:
    """A calibration and its held-out errors.

    Attributes:
        arm: Name of the arm.
        fit: The best calibration and its evidence.
        geometric: The calibration of the geometry alone.
        train_rows: Rows used for the fit.
        test_rows: Rows held out.
        position: Held-out position errors by model, mm: "nominal", "geometric", then what was added.
        attitude: The same for attitude, deg; empty where no attitude was measured.
        best_model: Name of the best model, chosen without the held-out rows.
        terms: How terms were chosen; None where they were not.
        gate: The residual models' verdicts; None where none was judged.
        floor: What the files say about noise; None if not read from files.
        lost: Parameters that full-range poses would show and these do not.
        outliers: Gross outliers left out; None without ``robust``.
    """

    arm: str
    fit: Fit
    geometric: Fit
    train_rows: int
    test_rows: int
    position: Mapping[str, ErrorStatistics]
    attitude: Mapping[str, ErrorStatistics]
    best_model: str
    terms: TermChoice | None = None
    gate: GateReport | None = None
    floor: NoiseFloor | None = None
    lost: tuple[str, ...] = ()
    outliers: RobustIdentification | None = None

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        found = self.geometric.identification
        nominal, geometric = self.position["nominal"], self.position["geometric"]
        best = list(self.position.values())[-1]
        held_out: dict[str, Any] = {
            "nominal_rms_mm": nominal.rms,
            "geometric_rms_mm": geometric.rms,
            "geometric_mean_mm": geometric.mean,
            "geometric_mean_ci95_mm": geometric.mean_ci95,
            "best_rms_mm": best.rms,
            "best_mean_mm": best.mean,
            "best_model": self.best_model,
            **{f"{name}_mm": statistics.as_dict() for name, statistics in self.position.items()},
            **{f"{name}_deg": statistics.as_dict() for name, statistics in self.attitude.items()},
        }
        floor = self.floor
        return {
            "arm": self.arm,
            "measurement_kind": found.kind,
            "rows": {"train": self.train_rows, "test": self.test_rows},
            "parameters": len(found.identifiability.names),
            "rank": found.identifiability.rank,
            "dropped": {item.name: item.absorbed_by for item in found.identifiability.dropped},
            "lost_to_poses": list(self.lost),
            "condition": found.identifiability.condition,
            "converged": found.converged,
            "solve_seconds": found.solve_seconds,
            "unknowns_mm": {name: value * 1e3 for name, value in found.unknowns.items()},
            "held_out": held_out,
            "noise_floor_mm": None
            if floor is None
            else {key: None if value is None else value * 1e3 for key, value in vars(floor).items()},
            "terms": None
            if self.terms is None
            else {
                "chosen": self.terms.chosen,
                "blocked_rms_mm": {name: value * 1e3 for name, value in self.terms.blocked_rms.items()},
            },
            "gate": {} if self.gate is None else self.gate.as_dict()["models"],
            "outlier_rows": None if self.outliers is None else gross_outliers(self.outliers),
        }

    def report(self) -> str:
        """A report for people."""
        found = self.geometric.identification
        lines = [found.report()]
        if self.lost:
            lines.append(f"full-range poses would also show {', '.join(self.lost)}; these poses do not")
        if self.outliers is not None:
            lines.append(self.outliers.report())
        if self.terms is not None:
            tried = ", ".join(f"{name} {value * 1e3:.4f}" for name, value in self.terms.blocked_rms.items())
            lines.append(f"terms: {self.terms.chosen} (RMS on blocks of the training rows, mm: {tried})")
        if self.gate is not None:
            lines.append(self.gate.report())
        lines += [
            f"held out: {self.test_rows} rows (trained on {self.train_rows}), solved in "
            f"{1e3 * found.solve_seconds:.0f} ms; best model: {self.best_model}",
            f"{'':>30}  {'RMS mm':>8}  {'mean mm':>8}  {'95 % interval':>16}  {'p95 mm':>8}  {'max mm':>8}",
        ]
        labels = {"nominal": "nominal, base and tool fitted", "geometric": "calibrated geometry"}
        for name, position in self.position.items():
            low, high = position.mean_ci95
            line = f"{labels.get(name, name):>30}  {position.rms:8.4f}  {position.mean:8.4f}  {low:7.4f}..{high:7.4f}"
            line += f"  {position.p95:8.4f}  {position.max:8.4f}"
            attitude = self.attitude.get(name)
            lines.append(line + (f"  attitude mean {attitude.mean:.4f} deg" if attitude else ""))
        if self.floor is not None:
            lines.append(f"noise floor of a position: {self.floor.text()}")
        return "\n".join(lines)


def judge(arm: Arm, train: Observations, test: Observations, choices: Choices | None = None) -> Judged:
    """Calibrate on ``train``, in the order measured, and state the errors on ``test``; data of any kind.

    Raises:
        InputError: As `calibration.fit`; if rows are grossly off or show too few parameters; if a name is unknown.
    """
    choices = choices or Choices()
    if isinstance(train, PoseObservations) and isinstance(test, PoseObservations):
        return _judge_poses(arm, train.measurements, test.measurements, choices)
    geometric = best = fit_kind(arm, train)
    assert geometric.aligned is not None
    found, name = {"nominal": geometric.aligned, "geometric": geometric.identification}, "geometry"
    chosen, terms = _terms(arm, train, geometric, choices)
    if terms:
        best = _with_terms(geometric, terms, train)
        name += f"+{chosen.chosen if chosen else choices.terms}"
        found[name] = best.identification
    return Judged(
        arm=arm.name,
        fit=best,
        geometric=geometric,
        train_rows=len(train.joints),
        test_rows=len(test.joints),
        position={
            key: error_statistics(misses(test, item.arm_model, unknowns_of(item, train)) * 1e3)
            for key, item in found.items()
        },
        attitude={},
        best_model=name,
        terms=chosen,
    )


def _terms(
    arm: Arm, train: Observations, geometric: Fit, choices: Choices
) -> tuple[TermChoice | None, tuple[Term, ...]]:
    """The terms asked for, or chosen within the training rows."""
    if choices.terms != "auto":
        return None, terms_of(choices.terms, arm, train)
    if len(train.joints) < ENOUGH or geometric.aligned is None:
        return None, ()
    chosen = choose_terms(arm, geometric.aligned.geometry, train)
    return chosen, terms_of(chosen.chosen, arm, train)


def _with_terms(geometric: Fit, terms: tuple[Term, ...], train: Observations) -> Fit:
    """The calibration with parametric terms."""
    found = identify_terms(terms, geometric.identification, train)
    names = sorted({term.specification()["kind"] for term in terms})
    record = {**geometric.calibration.record, "terms": names}
    return Fit(replace(geometric.calibration, model=found.arm_model, record=record), found, geometric.aligned)


def _judge_poses(arm: Arm, train: Measurements, test: Measurements, choices: Choices) -> Judged:
    outliers = None
    if choices.robust:
        outliers = robust_fit(arm, train)
        train = train.select(np.setdiff1d(np.arange(len(train)), gross_outliers(outliers)))
    try:
        geometric = fit(arm, train)
    except InputError:
        if len(train) >= 12 and not choices.robust:
            _told_apart(arm, train)
        raise
    if not choices.robust and suspicious(geometric.identification.arm_model, train):
        refuse_gross_errors(arm, train)
    assert geometric.aligned is not None
    lost, _ = lost_to_poses(complete_model(arm.nominal), geometric.aligned.geometry, train)
    position_errors = {
        "nominal": held_out_errors(replace(geometric.calibration, model=ArmModel.of(geometric.aligned.geometry)), test),
        "geometric": held_out_errors(geometric.calibration, test),
    }
    best, name = geometric, "geometry"
    chosen, terms = _terms(arm, PoseObservations(train), geometric, choices)
    if terms:
        best = _with_terms(geometric, terms, PoseObservations(train))
        name += f"+{chosen.chosen if chosen else choices.terms}"
        position_errors[name] = held_out_errors(best.calibration, test)
    gate, selected = _gate(train, best, terms, choices)
    if selected is not None:
        best = _with_residual(best, train, selected, choices.seed)
        name += f"+{selected}"
        position_errors[name] = held_out_errors(best.calibration, test)
    full = test.rotation is not None
    return Judged(
        arm=arm.name,
        fit=best,
        geometric=geometric,
        train_rows=len(train),
        test_rows=len(test),
        position={key: error_statistics(values[:, :3] * 1e3) for key, values in position_errors.items()},
        attitude={key: error_statistics(np.degrees(values[:, 3:])) for key, values in position_errors.items()}
        if full
        else {},
        best_model=name,
        terms=chosen,
        gate=gate,
        lost=lost,
        outliers=outliers,
    )


def _told_apart(arm: Arm, data: Measurements) -> None:
    """After a fit that failed: if most rows agree with each other, say what is wrong with the others."""
    try:
        found = robust_fit(arm, data)
    except InputError:
        return  # no majority agrees: the first complaint stands
    if 2 * len(found.outliers) < len(data):
        refuse_gross_errors(arm, data)


def _gate(
    train: Measurements, best: Fit, terms: tuple[Term, ...], choices: Choices
) -> tuple[GateReport | None, str | None]:
    """Verdicts on residual models within the training rows, and the one to use."""
    if choices.residual == "none":
        return None, None
    if choices.residual != "auto" and choices.residual not in FITTERS:
        raise InputError(f"unknown residual model '{choices.residual}'; give auto, none or one of {', '.join(FITTERS)}")
    if len(train) < ENOUGH:
        return None, choices.residual if choices.force and choices.residual != "auto" else None
    names = tuple(FITTERS) if choices.residual == "auto" else (choices.residual,)
    data = train.select(np.unique(np.linspace(0, len(train) - 1, GATE_ROWS).astype(int)))
    assert best.aligned is not None
    aligned = best.aligned.geometry

    def refit(rows: Measurements) -> ArmModel:
        bare = identify(complete_model(aligned), aligned, rows)
        return identify_terms(terms, bare, PoseObservations(rows)).arm_model if terms else bare.arm_model

    report = judge_residuals(data, refit, np.random.default_rng(choices.seed), models=names, fitters=quick_fitters())
    report = surest(report)
    return report, names[0] if choices.force and choices.residual != "auto" else report.selected


def surest(report: GateReport) -> GateReport:
    """The report with the model selected that wins most on both: the blocks held out, and the inner ones.

    Both lie within the training rows here, so both may rank; a model that shone on one of them by luck counts half.
    """
    ranked = [
        (verdict.blocked_rms / verdict.geometric_blocked_rms * verdict.inner_rms / verdict.geometric_inner_rms, verdict)
        for verdict in report.verdicts
        if verdict.accepted and verdict.inner_rms is not None and verdict.geometric_inner_rms is not None
    ]
    if report.selected is None or not ranked:
        return report
    best = min(ranked, key=lambda pair: pair[0])[1]
    return replace(report, selected=best.model, blocked_rms=best.blocked_rms)


def quick_fitters() -> dict[str, Fitter]:
    """The slow residual models, trained on rows taken evenly where there are too many."""

    def thinned(fitter: Fitter, rows: int) -> Fitter:
        def fit_some(inputs: Array, targets: Array, rng: np.random.Generator) -> Any:
            chosen = np.unique(np.linspace(0, len(inputs) - 1, rows).astype(int))
            return fitter(inputs[chosen], targets[chosen], rng)

        return fit_some

    fitters: Mapping[str, Callable[..., Any]] = FITTERS
    return {name: thinned(fitters[name], rows) for name, rows in SLOW_ROWS.items()}


def _with_residual(best: Fit, train: Measurements, name: str, seed: int) -> Fit:
    """The calibration with a residual model learnt from all training rows."""
    left = PoseObservations(train).difference(best.calibration.model)
    learnt = fit_residual(
        name,
        train.joints,
        left,
        train.prismatic,
        np.random.default_rng(seed),
        conditions=train.conditions.inputs(),
        fitter=quick_fitters().get(name),
    )
    record = {**best.calibration.record, "residual": {"kind": name, "poses": len(train), "seed": seed}}
    return replace(best, calibration=replace(best.calibration, learnt=learnt, record=record))
