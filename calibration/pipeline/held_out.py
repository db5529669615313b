"""Calibrate on some rows, judge on others, and say it in figures that can be compared.

Nominal means after base and tool were fitted: an uncalibrated arm is not blamed for where the instrument stood. Terms
and residual model are chosen within the training rows, so that the held-out figures are those of rows never looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pickenv.arm import Arm
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.diagnosis import checked_rows, refuse_lost, refuse_misses
from pickenv.calibration.identification.least_squares import identify
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.identification.term_choice import TermChoice, choose_terms, identify_terms, terms_of
from pickenv.calibration.model.arm_model import ArmModel, Term
from pickenv.calibration.model.coverage import pose_coverage
from pickenv.calibration.model.error_model import geometric_model
from pickenv.calibration.model.measurements import Frames, Measurements
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.pipeline.fitting import Fit, fit
from pickenv.calibration.pipeline.other_kinds import fit_kind
from pickenv.calibration.pipeline.result import Result, assess
from pickenv.calibration.residuals.gate import GateReport, judge_residuals
from pickenv.calibration.residuals.residual_models import FITTERS, Fitter, fit_residual
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
        frames: Whether base and tool are "known" or "fitted"; as the data say when None.
    """

    terms: str = "auto"
    residual: str = "auto"
    force: bool = False
    robust: bool = False
    seed: int = 0
    frames: Frames | None = None


def judge(arm: Arm, train: Observations, test: Observations, choices: Choices | None = None) -> Result:
    """Calibrate on ``train``, in the order measured, and judge on ``test``; data of any kind.

    Raises:
        InputError: As `calibration.fit`; if rows are far off, held out or not, or show too few parameters; if a name is
            unknown, or an option does not apply to this kind of measurement.
    """
    choices = choices or Choices()
    if isinstance(train, Measurements) and isinstance(test, Measurements):
        return _judge_poses(arm, train, test, choices)
    _refuse_options(train, choices)
    geometric = fit_kind(arm, train)
    found = geometric.identification
    missed = [part.misses(found.arm_model, unknowns_of(found, train)) for part in (train, test)]
    refuse_misses(train, test, (missed[0], missed[1]))
    chosen = _chosen_terms(arm, train, geometric, choices)
    name, best, _ = _with_terms(geometric, chosen.chosen if chosen else choices.terms, arm, train)
    steps = {} if best is geometric else {name: best}
    return assess(arm, best, train, test, geometric=geometric, steps=steps, terms=chosen)


def _refuse_options(train: Observations, choices: Choices) -> None:
    """Refuse what is there for poses and positions only."""
    given = {"--robust": choices.robust, "--frames known": choices.frames == "known"}
    given[f"--residual {choices.residual}"] = choices.residual not in ("auto", "none")
    for option, wanted in given.items():
        if wanted:
            raise InputError(
                f"{option} is for poses and positions, but {train.source} holds {train.kind}; leave it out"
            )


def _chosen_terms(arm: Arm, train: Observations, geometric: Fit, choices: Choices) -> TermChoice | None:
    """Terms chosen within the training rows; None where they were named, or the rows are too few to choose."""
    if choices.terms != "auto" or len(train.joints) < ENOUGH:
        return None
    return choose_terms(arm, geometric.calibration.nominal, train, geometric.aligned is None)


def _with_terms(geometric: Fit, wanted: str, arm: Arm, train: Observations) -> tuple[str, Fit, tuple[Term, ...]]:
    """The calibration with as many of the wanted terms, in their order, as converge; its name, and those terms."""
    names = [] if wanted == "auto" else wanted.split("+")
    while terms := terms_of("+".join(names) or "none", arm, train):
        found = identify_terms(terms, geometric.identification, train, geometric.aligned is None)
        if found.converged:
            kinds = sorted({term.specification()["kind"] for term in terms})
            record = {**geometric.calibration.record, "terms": kinds}
            calibration = replace(geometric.calibration, model=found.arm_model, record=record)
            return f"geometry+{'+'.join(names)}", Fit(calibration, found, geometric.aligned), terms
        names.pop()
    return "geometry", geometric, ()


def _judge_poses(arm: Arm, train: Measurements, test: Measurements, choices: Choices) -> Result:
    if choices.frames is None and train.frames != test.frames:
        raise InputError(
            f"{train.source} says that base and tool are {train.frames}, {test.source} that they are {test.frames}; "
            "give --frames"
        )
    known = (choices.frames or train.frames) == "known"
    train, test, left_out = checked_rows(arm, train, test, known=known, robust=choices.robust)
    geometric = fit(arm, train, known_frames=known)
    start = geometric.calibration.nominal
    coverage = pose_coverage(geometric_model(start, known), start, train)
    refuse_lost(coverage, start, train)
    chosen = _chosen_terms(arm, train, geometric, choices)
    name, best, terms = _with_terms(geometric, chosen.chosen if chosen else choices.terms, arm, train)
    steps = {} if best is geometric else {name: best}
    gate, selected = _gate(train, best, terms, choices)
    if selected is not None:
        best, name = _with_residual(best, train, selected, choices.seed), f"{name}+{selected}"
        steps[name] = best
    return assess(
        arm,
        best,
        train,
        test,
        geometric=geometric,
        steps=steps,
        terms=chosen,
        gate=gate,
        left_out=left_out,
        coverage=coverage,
    )


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
    start, known = best.calibration.nominal, best.aligned is None

    def refit(rows: Measurements) -> ArmModel:
        bare = identify(geometric_model(start, known), start, rows)
        return identify_terms(terms, bare, rows, known).arm_model if terms else bare.arm_model

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
    left = train.difference(best.calibration.model)
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
