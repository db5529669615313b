"""The gate: a learnt residual is believed only if it wins where it was never trained, on contiguous blocks of rows.

A random split flatters models that interpolate between neighbouring poses. Verdicts come from blocks held out of all
training; the choice among models comes from blocks within the training rows, so that the outer ones stay a fair test.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from operator import attrgetter
from typing import Any

import numpy as np

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.splits import Rows, blocked_split, contiguous_folds, random_split, same_poses
from pickenv.calibration.residuals.regressor import Fitter
from pickenv.calibration.residuals.residual_models import FITTERS, fit_residual
from pickenv.errors import InputError

MARGIN = 0.02
"""A residual model must cut the blocked RMS by more than this share; less is no gain."""

FOLDS = 5
"""Contiguous folds of the cross-validation within the training rows."""

Refit = Callable[[Measurements], Geometry | ArmModel]
"""Identifies the arm from training rows alone; a constant function where the arm was identified from other data."""


@dataclass(frozen=True)
class GateVerdict:
    """How one residual model fares. All RMS are of the position error's norm, m, unless they say attitude (rad).

    Attributes:
        model: Name of the residual model.
        random_rms: On randomly held-out rows, with the residual; None where it could not be fitted.
        blocked_rms: On the held-out blocks, with the residual; None likewise.
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
    random_rms: float | None
    blocked_rms: float | None
    geometric_random_rms: float
    geometric_blocked_rms: float
    blocked_attitude_rms: float | None
    geometric_blocked_attitude_rms: float | None
    inner_rms: float | None = None
    geometric_inner_rms: float | None = None
    accepted: bool = False
    reason: str = ""


@dataclass(frozen=True)
class GateReport:
    """All verdicts and the choice.

    Attributes:
        verdicts: One per model, in the order given.
        selected: The accepted model with the smallest inner RMS, or None: the residual stays off.
        blocked_rms: Of the selection on the held-out blocks, m (the geometric one where nothing is selected).
    """

    verdicts: tuple[GateVerdict, ...]
    selected: str | None
    blocked_rms: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON; lengths in mm and angles in degrees, as the names then say."""
        models = {}
        for verdict in self.verdicts:
            named: dict[str, Any] = {"accepted": verdict.accepted, "reason": verdict.reason}
            for key, value in vars(verdict).items():
                if key.endswith("rms"):
                    unit, scale = ("deg", np.degrees(1.0)) if key.endswith("attitude_rms") else ("mm", 1e3)
                    named[f"{key}_{unit}"] = None if value is None else float(value * scale)
            models[verdict.model] = dict(sorted(named.items()))
        return {"models": models, "selected": self.selected, "blocked_rms_mm": self.blocked_rms * 1e3}


def gate_residuals(
    measurements: Measurements,
    refit: Refit,
    rng: np.random.Generator,
    *,
    models: Sequence[str] = tuple(FITTERS),
    fitters: Mapping[str, Fitter] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> GateReport:
    """Judge residual models on random and on blocked hold-out, and choose one honestly.

    On every split the arm is identified anew from the training rows, then the residual from the same rows. A model is
    accepted if it cuts the blocked RMS by more than `MARGIN`, does not make attitudes worse by more than that, and
    wins likewise when cross-validated over contiguous folds of the blocked split's training rows. That cross-validation
    ranks the accepted models. So the held-out blocks may veto a model but never rank models: picking the best of
    several on the rows that then state its error would flatter it.

    Args:
        measurements: Poses or positions, in the order they were measured.
        refit: Identifies the arm from training rows.
        rng: Seeds the random split and every fit.
        models: Names of `FITTERS`.
        fitters: Other ways to fit a named model, such as with other settings.
        progress: Called with (models judged, models in all).

    Raises:
        InputError: If there are no models, or too few rows to hold blocks out.
    """
    if not models:
        raise InputError(f"no residual model was named; give some of {', '.join(FITTERS)}")
    test_rows = len(measurements) // 5
    seeds = [int(rng.integers(2**63)) for _ in models]
    poses = same_poses(measurements.joints)
    blocked = _Trial.of(measurements, refit, *blocked_split(poses, test_rows))
    shuffled = _Trial.of(measurements, refit, *random_split(poses, test_rows, rng))

    @cache
    def inner() -> list[_Trial]:
        folds = contiguous_folds(blocked.train.groups, same_poses(blocked.train.joints), FOLDS)
        return [_Trial.of(blocked.train, refit, *rows) for rows in folds]

    verdicts = []
    for number, (name, seed) in enumerate(zip(models, seeds, strict=True)):
        if progress is not None:
            progress(number, len(models))
        fitter = (fitters or {}).get(name)
        verdicts.append(_verdict(name, partial(_left_by, name, seed, fitter), blocked, shuffled, inner))
    if progress is not None:
        progress(len(models), len(models))
    chosen = min((verdict for verdict in verdicts if verdict.accepted), key=attrgetter("inner_rms"), default=None)
    blocked_rms = position_rms(blocked.test_residual) if chosen is None else chosen.blocked_rms
    assert blocked_rms is not None  # whatever was chosen was judged
    return GateReport(tuple(verdicts), None if chosen is None else chosen.model, blocked_rms)


def position_rms(residuals: Array) -> float:
    """Root mean square of the position error's norm, m, of residuals ``(N, 3)`` or ``(N, 6)``."""
    return float(np.sqrt(np.mean(np.sum(residuals[:, :3] ** 2, axis=1))))


def _attitude_rms(residuals: Array) -> float | None:
    return None if residuals.shape[1] < 6 else position_rms(residuals[:, 3:])


@dataclass(frozen=True, eq=False)
class _Trial:
    """One split with the arm identified from its training rows, and what that leaves on both sides."""

    train: Measurements
    test: Measurements
    train_residual: Array
    test_residual: Array

    @staticmethod
    def of(measurements: Measurements, refit: Refit, train_rows: Rows, test_rows: Rows) -> _Trial:
        train, test = measurements.select(train_rows), measurements.select(test_rows)
        found = refit(train)
        return _Trial(train, test, train.difference(found), test.difference(found))


def _left_by(name: str, seed: int, fitter: Fitter | None, trial: _Trial) -> Array:
    """What a model that learns from the trial's training rows leaves of its other rows."""
    train, test = trial.train, trial.test
    model = fit_residual(
        name,
        train.joints,
        trial.train_residual,
        train.prismatic,
        np.random.default_rng(seed),
        conditions=train.conditions.inputs(),
        fitter=fitter,
    )
    return trial.test_residual - model.predict(test.joints, test.conditions.inputs())


def _verdict(
    name: str,
    left_by: Callable[[_Trial], Array],
    blocked: _Trial,
    shuffled: _Trial,
    inner: Callable[[], Sequence[_Trial]],
) -> GateVerdict:
    """How a model fares; the inner trials are made for those that win on the outer blocks."""
    untouched = blocked.test_residual
    verdict = GateVerdict(
        model=name,
        random_rms=None,
        blocked_rms=None,
        geometric_random_rms=position_rms(shuffled.test_residual),
        geometric_blocked_rms=position_rms(untouched),
        blocked_attitude_rms=None,
        geometric_blocked_attitude_rms=_attitude_rms(untouched),
    )
    try:
        left, random_left = left_by(blocked), left_by(shuffled)
    except InputError as error:
        return replace(verdict, reason=f"not fitted: {error}")
    accepted, reason = _compared(untouched, left)
    verdict = replace(
        verdict,
        random_rms=position_rms(random_left),
        blocked_rms=position_rms(left),
        blocked_attitude_rms=_attitude_rms(left),
        reason=reason,
    )
    if not accepted:
        return verdict
    before = np.concatenate([trial.test_residual for trial in inner()])
    try:
        after = np.concatenate([left_by(trial) for trial in inner()])
    except InputError as error:
        return replace(verdict, accepted=False, reason=f"not fitted to fewer rows: {error}")
    accepted, inside = _compared(before, after)
    return replace(
        verdict,
        inner_rms=position_rms(after),
        geometric_inner_rms=position_rms(before),
        accepted=accepted,
        reason=reason if accepted else f"{inside} cross-validated over the other blocks ({reason})",
    )


def _compared(before: Array, after: Array) -> tuple[bool, str]:
    """Whether a residual wins, and why."""
    gain = 1.0 - position_rms(after) / position_rms(before)
    if not gain > MARGIN:
        return False, f"no gain: {'cuts' if gain >= 0 else 'raises'} the blocked RMS by {abs(gain):.0%}"
    turned, untouched = _attitude_rms(after), _attitude_rms(before)
    if turned is not None and untouched is not None and turned > (1.0 + MARGIN) * untouched:
        return False, f"no gain: positions gain {gain:.0%}, but attitudes lose {turned / untouched - 1.0:.0%}"
    return True, f"cuts the blocked RMS by {gain:.0%}"
