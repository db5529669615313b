"""Learnt residuals, models of the error that remains after the geometric fit, with one interface for all regressors.

A model predicts this error from the joints and, if there are any, the conditions. It follows Qiao 2026 eqs (17)-(18)
with any regressor: BPNN, RBF network, Gaussian process. Inputs are joints in rad and m, standardised; joints with a
large range enter as sine and cosine. Outputs are residuals of poses (6) or positions (3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.base import InputError, require
from pickenv.base.container import named_part, part_of
from pickenv.base.registry import get
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
            InputError: If the number of joints or conditions differs from that at training.
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
            InputError: If joints or conditions differ in number from those of training.
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
of the time, and its error on measured arms is within 6 % of that of the full search."""


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
        periodic_span: Revolute joints whose values span more than this, rad, enter as sine and cosine; infinite for
            none.

    Raises:
        InputError: If the model is unknown, a number is not finite, or there are too few rows.
    """
    require_residual(name)
    if not (np.isfinite(joints).all() and np.isfinite(residuals).all()):
        raise InputError(f"joints or residuals for the residual model '{name}' are not all finite; remove those rows")
    inputs = joint_inputs(joints, prismatic, conditions, periodic_span=periodic_span)
    model = (fitter or get("residual", name).fit)(inputs(joints, conditions), residuals, rng)
    return LearntResidual(name, inputs, model)
