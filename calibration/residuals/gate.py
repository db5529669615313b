"""The gate: a learnt residual is believed only if it wins where it was never trained, on contiguous blocks of rows.

A random split flatters models that interpolate between neighbouring poses. Verdicts come from blocks held out of all
training; the choice among models comes from blocks within the training rows, so that the outer ones stay a fair test.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.splits import Rows, blocked_split, random_split
from pickenv.calibration.residuals.residual_models import FITTERS, Fitter, fit_residual
from pickenv.errors import InputError

MARGIN = 0.02
"""A residual model must cut the blocked RMS by more than this share; less is no gain."""

FOLDS = 5
"""Contiguous folds of the cross-validation within the training rows."""

Refit = Callable[[Measurements], Geometry | ArmModel]
"""Identifies the arm from training rows alone; a constant function where the arm was identified from other data."""


@dataclass(frozen=True)
class Verdict:
    """How one residual model fares. All RMS are of the position error's norm, m, unless they say attitude (rad).

    Attributes:
        model: Name of the residual model.
        random_rms: On randomly held-out rows, with the residual.
        blocked_rms: On the held-out blocks, with the residual.
        geometric_random_rms: On the same random rows without it.
        geometric_blocked_rms: On the same blocks without it.
        blocked_attitude_rms: Attitude on the held-out blocks; None for position measurements.
        geometric_blocked_attitude_rms: The same without the residual.
        inner_rms: Cross-validated over blocks within the training rows; None where it was not needed.
        geometric_inner_rms: The same without the residual.
        accepted: Whether it won on the held-out blocks and on those within the training rows.
        reason: Why, in words.
    """

    model: str
    random_rms: float
    blocked_rms: float
    geometric_random_rms: float
    geometric_blocked_rms: float
    blocked_attitude_rms: float | None
    geometric_blocked_attitude_rms: float | None
    inner_rms: float | None
    geometric_inner_rms: float | None
    accepted: bool
    reason: str


@dataclass(frozen=True)
class GateReport:
    """All verdicts and the choice.

    Attributes:
        verdicts: One per model, in the order given.
        selected: The accepted model with the smallest inner RMS, or None: the residual stays off.
        blocked_rms: Of the selection on the held-out blocks, m (the geometric one where nothing is selected).
        held_out: Rows of the held-out blocks, counted from 0.
    """

    verdicts: tuple[Verdict, ...]
    selected: str | None
    blocked_rms: float
    held_out: tuple[int, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON; lengths in mm and angles in degrees, as the names then say."""
        models = {}
        for verdict in self.verdicts:
            values = asdict(verdict)
            named = {key: values[key] for key in ("accepted", "reason")}
            for key in values.keys() - named.keys() - {"model"}:
                turned = key.endswith("attitude_rms")
                scale = np.degrees(1.0) if turned else 1e3
                named[f"{key}_{'deg' if turned else 'mm'}"] = (
                    None if values[key] is None else float(values[key] * scale)
                )
            models[verdict.model] = dict(sorted(named.items()))
        return {"models": models, "selected": self.selected, "blocked_rms_mm": self.blocked_rms * 1e3}


def judge_residuals(
    measurements: Measurements,
    refit: Refit,
    rng: np.random.Generator,
    *,
    models: Sequence[str] = tuple(FITTERS),
    fitters: Mapping[str, Fitter] | None = None,
    test_rows: int | None = None,
    folds: int = FOLDS,
    margin: float = MARGIN,
) -> GateReport:
    """Judge residual models on random and on blocked hold-out, and choose one honestly.

    On every split the arm is identified anew from the training rows, then the residual from the same rows. A model is
    accepted if it cuts the blocked RMS by more than ``margin``, does not make attitudes worse by more than that, and
    wins likewise when cross-validated over contiguous folds of the blocked split's training rows. That cross-validation
    ranks the accepted models. So the held-out blocks may veto a model but never rank models: picking the best of
    several on the rows that then state its error would flatter it.

    Args:
        measurements: Poses or positions, in the order they were measured.
        refit: Identifies the arm from training rows.
        rng: Seeds the random split and every fit.
        models: Names of `FITTERS`.
        fitters: Other ways to fit a named model, such as with other settings.
        test_rows: Rows held out; a fifth when left out.
        folds: Folds of the inner cross-validation.
        margin: Share of the RMS that must be gained.

    Raises:
        InputError: If there are no models, or too few rows to hold blocks out.
    """
    if not models:
        raise InputError(f"no residual model was named; give some of {', '.join(FITTERS)}")
    fitters = fitters or {}
    count = len(measurements)
    test_rows = count // 5 if test_rows is None else test_rows
    seeds = {name: int(rng.integers(2**63)) for name in models}

    def fitted(name: str, data: Measurements, residuals: Array) -> Callable[[Measurements], Array]:
        own = np.random.default_rng(seeds[name])
        conditions = data.conditions.inputs()
        model = fit_residual(
            name, data.joints, residuals, data.prismatic, own, conditions=conditions, fitter=fitters.get(name)
        )
        return lambda other: model.predict(other.joints, other.conditions.inputs())

    blocked = _Trial.of(measurements, refit, *blocked_split(count, test_rows))
    shuffled = _Trial.of(measurements, refit, *random_split(count, test_rows, rng))
    inner: list[_Trial] | None = None
    verdicts = []
    for name in models:
        try:
            predict_blocked = fitted(name, blocked.train, blocked.train_residual)
            predict_random = fitted(name, shuffled.train, shuffled.train_residual)
        except InputError as error:
            verdicts.append(_refused(name, blocked, shuffled, str(error)))
            continue
        left = blocked.test_residual - predict_blocked(blocked.test)
        accepted, reason = _compared(blocked.test_residual, left, margin)
        inner_rms = geometric_inner = None
        if accepted:
            if inner is None:
                inner = [_Trial.of(blocked.train, refit, *rows) for rows in contiguous_folds(len(blocked.train), folds)]
            untouched = np.concatenate([trial.test_residual for trial in inner])
            remaining = np.concatenate(
                [trial.test_residual - fitted(name, trial.train, trial.train_residual)(trial.test) for trial in inner]
            )
            inner_rms, geometric_inner = position_rms(remaining), position_rms(untouched)
            wins_inside, inside = _compared(untouched, remaining, margin)
            if not wins_inside:
                accepted, reason = False, f"{inside} cross-validated over the other blocks ({reason})"
        verdicts.append(
            Verdict(
                model=name,
                random_rms=position_rms(shuffled.test_residual - predict_random(shuffled.test)),
                blocked_rms=position_rms(left),
                geometric_random_rms=position_rms(shuffled.test_residual),
                geometric_blocked_rms=position_rms(blocked.test_residual),
                blocked_attitude_rms=_attitude_rms(left),
                geometric_blocked_attitude_rms=_attitude_rms(blocked.test_residual),
                inner_rms=inner_rms,
                geometric_inner_rms=geometric_inner,
                accepted=accepted,
                reason=reason,
            )
        )
    chosen = _chosen(verdicts)
    return GateReport(
        verdicts=tuple(verdicts),
        selected=chosen.model if chosen else None,
        blocked_rms=chosen.blocked_rms if chosen else position_rms(blocked.test_residual),
        held_out=tuple(int(row) for row in blocked.test_rows),
    )


def contiguous_folds(rows: int, folds: int) -> list[tuple[Rows, Rows]]:
    """Cut rows into contiguous folds: for each, the training rows and the held-out rows.

    Raises:
        InputError: If there are fewer than two folds, or fewer rows than folds.
    """
    if not 2 <= folds <= rows:
        raise InputError(f"{rows} rows cannot be cut into {folds} folds; give 2 to {rows}")
    parts = np.array_split(np.arange(rows), folds)
    return [(np.concatenate(parts[:i] + parts[i + 1 :]), parts[i]) for i in range(folds)]


def position_rms(residuals: Array) -> float:
    """Root mean square of the position error's norm, m, of residuals ``(N, 3)`` or ``(N, 6)``."""
    return float(np.sqrt(np.mean(np.sum(residuals[:, :3] ** 2, axis=1))))


def _attitude_rms(residuals: Array) -> float | None:
    return None if residuals.shape[1] < 6 else float(np.sqrt(np.mean(np.sum(residuals[:, 3:] ** 2, axis=1))))


@dataclass(frozen=True, eq=False)
class _Trial:
    """One split with the arm identified from its training rows, and what that leaves on both sides."""

    train: Measurements
    test: Measurements
    train_residual: Array
    test_residual: Array
    test_rows: Rows

    @staticmethod
    def of(measurements: Measurements, refit: Refit, train_rows: Rows, test_rows: Rows) -> _Trial:
        train, test = measurements.select(train_rows), measurements.select(test_rows)
        found = refit(train)
        return _Trial(train, test, train.difference(found), test.difference(found), test_rows)


def _compared(before: Array, after: Array, margin: float) -> tuple[bool, str]:
    """Whether a residual wins, and why."""
    gain = 1.0 - position_rms(after) / position_rms(before)
    if not gain > margin:
        return False, f"no gain: {'cuts' if gain >= 0 else 'raises'} the blocked RMS by {abs(gain):.0%}"
    turned, untouched = _attitude_rms(after), _attitude_rms(before)
    if turned is not None and untouched is not None and turned > (1.0 + margin) * untouched:
        return False, f"no gain: positions gain {gain:.0%}, but attitudes lose {turned / untouched - 1.0:.0%}"
    return True, f"cuts the blocked RMS by {gain:.0%}"


def _chosen(verdicts: Sequence[Verdict]) -> Verdict | None:
    """The accepted model that is best within the training rows."""
    ranked = [(v.inner_rms, v) for v in verdicts if v.accepted and v.inner_rms is not None]
    return min(ranked, key=lambda pair: pair[0])[1] if ranked else None


def _refused(name: str, blocked: _Trial, shuffled: _Trial, reason: str) -> Verdict:
    """The verdict on a model that could not be fitted: what geometry alone gives, and why."""
    random_rms, blocked_rms = position_rms(shuffled.test_residual), position_rms(blocked.test_residual)
    attitude = _attitude_rms(blocked.test_residual)
    return Verdict(
        name,
        random_rms,
        blocked_rms,
        random_rms,
        blocked_rms,
        attitude,
        attitude,
        None,
        None,
        False,
        f"not fitted: {reason}",
    )
