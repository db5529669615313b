"""Learnt residuals, models of the error that remains after the geometric fit, and the gate that accepts them.

All regressors have one interface. A model predicts the error from the joints and, if there are any, the conditions. The
method is that of Qiao 2026 eqs (17)-(18) with any regressor: BPNN, RBF network, Gaussian process. Inputs are joints in
rad and m, standardised; joints with a large range enter as sine and cosine. Outputs are residuals of poses (6) or
positions (3).

The gate accepts a residual only if it reduces the error on contiguous blocks of held-out rows. A random split flatters
models that interpolate between neighbouring poses. The verdicts come from blocks of rows that are held out of all
training. The choice among models comes from blocks of the training rows, so that the held-out blocks remain a fair
test. Rows of a cluster have similar errors, so each of them has a smaller weight.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Geometry
from pickenv.base import InputError, require
from pickenv.base.container import named_part, part_of
from pickenv.base.registry import get, names
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.measurements import Measurements, screen_unit
from pickenv.calibration.model.noise_and_priors import counted
from pickenv.calibration.model.observations import Rows, blocked_split, contiguous_folds, same_poses
from pickenv.calibration.residuals.gaussian_process import Fitter, GaussianProcess, Regressor, SavedArrays, column_std

PERIODIC_SPAN = 1.5 * np.pi
"""A revolute joint whose training values span more than this, rad, enters as sine and cosine, which are periodic."""


@dataclass(frozen=True, eq=False)
class JointInputs(SavedArrays):
    """The mapping from joints and conditions to a regressor's inputs.

    Attributes:
        conditions: Number of further inputs c, such as temperature or payload.
        periodic: Whether each joint enters as sine and cosine ``(n,)``.
        mean: Mean of each input over the training rows ``(F,)``.
        std: Standard deviation of each input over the training rows ``(F,)``.
    """

    conditions: int
    periodic: NDArray[np.bool_]
    mean: Array
    std: Array

    def __call__(self, joints: ArrayLike, conditions: ArrayLike | None = None) -> Array:
        """Return standardised inputs ``(..., F)`` for joints ``(..., n)``, rad or m, and conditions ``(..., c)``.

        Raises:
            InputError: If the number of joints or conditions differs from the number at training.
        """
        joints = np.asarray(joints, dtype=float)
        if joints.shape[-1:] != self.periodic.shape:
            raise InputError(f"joints have shape {joints.shape}, but the residual has {len(self.periodic)} joints")
        count = 0 if conditions is None else np.asarray(conditions).shape[-1]
        if count != self.conditions:
            raise InputError(f"the residual model needs {self.conditions} conditions beside the joints, not {count}")
        return (_raw_inputs(joints, conditions, self.periodic) - self.mean) / self.std


def joint_inputs(
    joints: Array, prismatic: Sequence[bool], conditions: Array | None = None, *, periodic_span: float = PERIODIC_SPAN
) -> JointInputs:
    """Return the mapping to a regressor's inputs, standardised over the training rows.

    Args:
        joints: Training joints ``(N, n)``, rad or m.
        prismatic: Whether each joint is prismatic.
        conditions: Conditions of the training rows ``(N, c)``.
        periodic_span: A revolute joint whose training values span more than this, rad, enters as sine and cosine.
    """
    periodic = ~np.asarray(prismatic, dtype=bool) & (np.ptp(joints, axis=0) > periodic_span)
    raw = _raw_inputs(joints, conditions, periodic)
    count = 0 if conditions is None else conditions.shape[-1]
    return JointInputs(count, periodic, raw.mean(axis=0), column_std(raw, 1.0))


def _raw_inputs(joints: Array, conditions: ArrayLike | None, periodic: NDArray[np.bool_]) -> Array:
    """Return a regressor's inputs ``(..., F)`` before they are standardised.

    These are joints, then sines and cosines of the joints marked in ``periodic`` ``(n,)``, then conditions.
    """
    if conditions is None and not periodic.any():
        return joints
    turning = joints[..., periodic]
    parts = [joints[..., ~periodic], np.sin(turning), np.cos(turning)]
    if conditions is not None:
        parts.append(np.broadcast_to(conditions, (*joints.shape[:-1], np.shape(conditions)[-1])))
    return np.concatenate(parts, axis=-1)


@dataclass(frozen=True, eq=False)
class LearntResidual:
    """A learnt residual of an arm: it maps joints, and conditions if there are any, to the remaining error.

    Attributes:
        kind: Name of the regressor in the registry.
        inputs: The mapping from joints and conditions to the regressor's inputs.
        model: The regressor.
    """

    kind: str
    inputs: JointInputs
    model: Regressor

    def predict(self, joints: ArrayLike, conditions: ArrayLike | None = None) -> Array:
        """Return the residual ``(..., 6)`` (m and rad, world axes), or ``(..., 3)`` if it was learnt from positions.

        Args:
            joints: Joint displacements ``(..., n)``, rad or m.
            conditions: Further inputs ``(..., c)`` in the order and units of training, if there were any.

        Raises:
            InputError: If the number of joints or conditions differs from the number at training.
        """
        return self.model.predict(self.inputs(joints, conditions))

    def faster(self) -> LearntResidual:
        """Return a faster version of this residual for control loops (see `Bpnn.fast`), or else this residual."""
        faster = getattr(self.model, "faster", None)
        return self if faster is None else replace(self, model=faster())

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays by name, for saving without pickle."""
        return {"kind": np.array(self.kind)} | self.inputs.arrays() | named_part("model_", self.model.arrays())

    @staticmethod
    def from_arrays(named: Mapping[str, NDArray[Any]]) -> LearntResidual:
        """Rebuild the residual from the arrays that `arrays` returns."""
        kind = str(named["kind"])
        inputs = JointInputs.from_arrays(named)
        return LearntResidual(kind, inputs, get("residual", kind).from_arrays(part_of(named, "model_")))


TRIAL_FITTERS: Mapping[str, Fitter] = {"gp": partial(GaussianProcess.fit, likelihood_rows=200, starts=4)}
"""Fitters of models that are only compared, on many splits. The Gaussian process has a shorter search. It takes a fifth
of the time, and its error on measured arms is within 6 % of the error after the full search."""


def require_residual(name: str) -> None:
    """Check that a residual model can be fitted, before any work is done.

    Raises:
        InputError: If there is no model of this name, or a package that its fit needs is missing.
    """
    require(*getattr(get("residual", name), "needs", ()))


def fit_residual(
    name: str,
    joints: Array,
    residuals: Array,
    prismatic: Sequence[bool],
    rng: np.random.Generator,
    *,
    conditions: Array | None = None,
    fitter: Fitter | None = None,
    periodic_span: float = PERIODIC_SPAN,
) -> LearntResidual:
    """Fit a residual model by name.

    Args:
        name: Name of a registered model: "bpnn", "rbf", "gp", or another package's.
        joints: Training joints ``(N, n)``, rad or m.
        residuals: Measured minus identified pose ``(N, 6)`` or position ``(N, 3)``, m and rad (Qiao 2026 eq (17)).
        prismatic: Whether each joint is prismatic.
        rng: The random generator of all draws.
        conditions: Further inputs ``(N, c)``, such as temperature or payload.
        fitter: Function that replaces the fit of this kind of model, for instance with other settings.
        periodic_span: Revolute joints whose values span more than this, rad, enter as sine and cosine; with infinity
            none do.

    Raises:
        InputError: If the model is unknown, a number is not finite, or there are too few rows.
    """
    require_residual(name)
    if not (np.isfinite(joints).all() and np.isfinite(residuals).all()):
        raise InputError(f"joints or residuals for the residual model '{name}' are not all finite; remove those rows")
    inputs = joint_inputs(joints, prismatic, conditions, periodic_span=periodic_span)
    model = (fitter or get("residual", name).fit)(inputs(joints, conditions), residuals, rng)
    return LearntResidual(name, inputs, model)


MARGIN = 0.02
"""Least share by which a residual model must cut the RMS on held-out blocks; less is no gain."""

AUTO = ("bpnn", "rbf", "gp")
"""Models that are tried by default. The list is fixed, so that other installed packages do not change the results."""

SLOW = ("bpnn",)
"""Models that take seconds to fit. They are tried last. If other models are tried too, slow models are tried only if
one of the others gains on the held-out blocks."""

Refit = Callable[[Measurements], Geometry | ArmModel]
"""Function that identifies the arm from training rows alone, or returns an arm identified from other data."""


@dataclass(frozen=True)
class GateVerdict:
    """The gate's verdict on one residual model, with the errors that the verdict comes from.

    Every RMS is of the position error's norm, m, unless its name says attitude (rad).

    Attributes:
        model: Name of the residual model.
        blocked_rms: RMS on the held-out blocks with the residual; None if the residual was not fitted.
        geometric_blocked_rms: RMS on the held-out blocks without the residual.
        blocked_attitude_rms: Attitude RMS on the held-out blocks with the residual; None for position measurements.
        geometric_blocked_attitude_rms: Attitude RMS on the held-out blocks without the residual.
        inner_rms: RMS cross-validated over blocks within the training rows, with the residual; None if it was not
            computed.
        geometric_inner_rms: RMS cross-validated over these inner blocks without the residual.
        accepted: Whether the model won on the held-out blocks and on the blocks within the training rows.
        reason: Reason for the verdict, in words.
    """

    model: str
    blocked_rms: float | None
    geometric_blocked_rms: float
    blocked_attitude_rms: float | None
    geometric_blocked_attitude_rms: float | None
    inner_rms: float | None = None
    geometric_inner_rms: float | None = None
    accepted: bool = False
    reason: str = ""


def selected(verdicts: Sequence[GateVerdict]) -> str | None:
    """Return the name of the accepted model with the smallest ``inner_rms``; None if no model was accepted."""
    best = min(filter(attrgetter("accepted"), verdicts), key=attrgetter("inner_rms"), default=None)
    return None if best is None else best.model


def verdicts_record(verdicts: Sequence[GateVerdict]) -> dict[str, dict[str, Any]]:
    """Return the verdicts as JSON content, by model; lengths are in mm and angles in degrees, as the keys say."""
    models = {}
    for verdict in verdicts:
        content: dict[str, Any] = {"accepted": verdict.accepted, "reason": verdict.reason}
        for key, value in vars(verdict).items():
            if key.endswith("rms"):
                unit, scale = screen_unit(not key.endswith("attitude_rms"))
                content[f"{key}_{unit}"] = None if value is None else float(value * scale)
        models[verdict.model] = dict(sorted(content.items()))
    return models


def gate_residuals(
    measurements: Measurements,
    refit: Refit,
    rng: np.random.Generator,
    *,
    models: Sequence[str] = AUTO,
    fitters: Mapping[str, Fitter] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[GateVerdict, ...]:
    """Judge residual models on held-out blocks; `selected` then chooses among the accepted ones.

    On every split the arm is identified again from the training rows, and the residual is then fitted to the same rows.
    A model is accepted if it cuts the RMS on the held-out blocks by more than `MARGIN` and does not increase the
    attitude RMS there by more than `MARGIN`. It must do both again when cross-validated over contiguous folds of the
    training rows. The cross-validation also ranks the accepted models. So the held-out blocks can reject a model but
    never rank models. If they also chose the best of several models, the error of this model on the blocks would look
    too small. A network takes seconds to fit, so it is tried last. If other models are tried too, the network is tried
    only if one of them gains on the held-out blocks (`SLOW`).

    Args:
        measurements: Poses or positions, in the order they were measured.
        refit: Identifies the arm from training rows.
        rng: Seeds every fit.
        models: Names of registered residual models.
        fitters: Functions that replace the fit of a model, by its name, for instance with other settings.
        progress: Called with (models judged, models in all).

    Returns:
        One verdict per model, in the order of ``models``.

    Raises:
        InputError: If there are no models, or too few rows to hold blocks out.
    """
    if not models:
        raise InputError(f"no residual model was named; give some of {', '.join(names('residual'))}")
    seeds = {name: int(rng.integers(2**63)) for name in models}
    blocked = _trial(measurements, refit, *blocked_split(same_poses(measurements.joints)))
    rows, _, _, untouched, counts = blocked

    @cache
    def inner() -> list[Trial]:
        folds = contiguous_folds(rows.groups, same_poses(rows.joints), folds=5)
        return [_trial(rows, refit, *fold) for fold in folds]

    bare = GateVerdict("", None, position_rms(untouched, counts), None, _attitude_rms(untouched, counts))
    verdicts: dict[str, GateVerdict] = {}
    for number, name in enumerate(sorted(models, key=SLOW.__contains__)):
        if progress is not None:
            progress(number, len(models))
        others = [verdict for verdict in verdicts.values() if verdict.model not in SLOW]
        if name in SLOW and others and not any(map(_wins_outside, others)):
            tried = " nor ".join(verdict.model for verdict in others)
            verdicts[name] = replace(bare, model=name, reason=f"not tried: no gain by {tried}, which learn sooner")
        else:
            learn = partial(_left_by, name, seeds[name], (fitters or {}).get(name))
            verdicts[name] = _verdict(replace(bare, model=name), learn, blocked, inner)
    if progress is not None:
        progress(len(models), len(models))
    return tuple(verdicts[name] for name in models)


def position_rms(residuals: Array, counts: Array | None = None) -> float:
    """Return the root mean square of the position error's norm, m.

    Args:
        residuals: Residuals ``(N, 3)`` or ``(N, 6)``, of which the first three columns are used, m.
        counts: Weight of each row ``(N,)``; equal if left out.
    """
    return float(np.sqrt(np.average(np.sum(residuals[:, :3] ** 2, axis=1), weights=counts)))


def _attitude_rms(residuals: Array, counts: Array) -> float | None:
    """Return the RMS attitude error, rad, weighted by ``counts`` ``(N,)``; None if residuals are positions alone."""
    return None if residuals.shape[1] < 6 else position_rms(residuals[:, 3:], counts)


Trial = tuple[Measurements, Measurements, Array, Array, Array]
"""One split, in five parts: training rows, held-out rows, training residuals, held-out residuals, and weights of the
held-out rows. Residuals are relative to the arm that was identified from the training rows."""


def _trial(measurements: Measurements, refit: Refit, train_rows: Rows, test_rows: Rows) -> Trial:
    """Return the split of the measurements into training and held-out rows, with the residuals of the refitted arm.

    Args:
        measurements: All rows.
        refit: Identifies the arm from the training rows.
        train_rows: Indices, from 0, of the training rows.
        test_rows: Indices, from 0, of the held-out rows.
    """
    train, test = measurements.select(train_rows), measurements.select(test_rows)
    model = refit(train)
    return train, test, train.difference(model), test.difference(model), counted(measurements.joints)[test_rows]


def _left_by(name: str, seed: int, fitter: Fitter | None, trial: Trial) -> Array:
    """Return the held-out rows' residual minus the prediction of a model that learns from the trial's training rows.

    Args:
        name: Name of the registered model.
        seed: Seed of the model's fit.
        fitter: Function that replaces the model's fit; None to keep it.
        trial: The split.
    """
    train, test, to_learn, untouched, _ = trial
    rows, rng = (train.joints, to_learn, train.prismatic), np.random.default_rng(seed)
    model = fit_residual(name, *rows, rng, conditions=train.conditions.inputs(), fitter=fitter)
    return untouched - model.predict(test.joints, test.conditions.inputs())


def _wins_outside(verdict: GateVerdict) -> bool:
    """Return whether the residual cuts the position RMS on the held-out blocks by more than `MARGIN`."""
    return verdict.blocked_rms is not None and verdict.blocked_rms < (1.0 - MARGIN) * verdict.geometric_blocked_rms


def _verdict(
    verdict: GateVerdict, left_by: Callable[[Trial], Array], blocked: Trial, inner: Callable[[], Sequence[Trial]]
) -> GateVerdict:
    """Return a model's verdict, completed with errors, acceptance and reason.

    Args:
        verdict: The verdict with the model's name, and with the errors on the held-out blocks without the residual.
        left_by: Function that fits the model on a split and returns the held-out residuals that remain.
        blocked: The split with held-out blocks.
        inner: Function that returns the splits within the training rows; called only if the model wins on ``blocked``.
    """
    *_, untouched, counts = blocked
    try:
        residual = left_by(blocked)
    except InputError as error:
        return replace(verdict, reason=f"not fitted: {error}")
    accepted, reason = _compared(untouched, residual, counts)
    rms, turned = position_rms(residual, counts), _attitude_rms(residual, counts)
    verdict = replace(verdict, blocked_rms=rms, blocked_attitude_rms=turned, reason=reason)
    if not accepted:
        return verdict
    *_, before, counts = map(np.concatenate, zip(*(trial[3:] for trial in inner()), strict=True))
    try:
        after = np.concatenate([left_by(trial) for trial in inner()])
    except InputError as error:
        return replace(verdict, accepted=False, reason=f"not fitted to fewer rows: {error}")
    accepted, inside = _compared(before, after, counts)
    reason = reason if accepted else f"{inside} cross-validated over the other blocks ({reason})"
    rms, without = position_rms(after, counts), position_rms(before, counts)
    return replace(verdict, inner_rms=rms, geometric_inner_rms=without, accepted=accepted, reason=reason)


def _compared(before: Array, after: Array, counts: Array) -> tuple[bool, str]:
    """Return whether a residual wins, and the reason in words; positions must gain, and attitudes must not lose.

    Args:
        before: Held-out residuals without the model ``(N, 3 or 6)``, m and rad.
        after: Held-out residuals with the model, in the same shape.
        counts: Weight of each row ``(N,)``.
    """
    gain = 1.0 - position_rms(after, counts) / position_rms(before, counts)
    if not gain > MARGIN:
        return False, f"no gain: {'cuts' if gain >= 0 else 'raises'} the blocked RMS by {abs(gain):.0%}"
    turned, untouched = _attitude_rms(after, counts), _attitude_rms(before, counts)
    if turned is not None and untouched is not None and turned > (1.0 + MARGIN) * untouched:
        return False, f"no gain: positions gain {gain:.0%}, but attitudes lose {turned / untouched - 1.0:.0%}"
    return True, f"cuts the blocked RMS by {gain:.0%}"
