"""How well the calibrated arm's tool pose is known, anywhere: u^2 = J C J^T + u_repeat^2 (GUM, JCGM 100:2008, 5.1.2).

C is the covariance of the identified parameters; u_repeat is what one reach scatters by that the parameters do not say:
repeatability, and what the model leaves out. A calibration keeps both in its record, so that a command can be given
with its uncertainty later. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.pipeline.calibration import Calibration


@dataclass(frozen=True, eq=False)
class PoseUncertainty:
    """Uncertainty of predicted poses of one calibrated arm.

    Attributes:
        names: Identified parameters of the arm.
        covariance: Of their errors ``(p, p)``, m and rad.
        position_repeat: Standard deviation of one position coordinate that the parameters do not explain, m.
        attitude_repeat: The same of one attitude coordinate, rad; None where only positions were measured.
    """

    names: tuple[str, ...]
    covariance: Array
    position_repeat: float
    attitude_repeat: float | None

    def pose_covariance(self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Covariance ``(..., 6, 6)`` of the tool pose, m and rad, world axes, at joints ``(..., n)``.

        Attitude rows of an arm of which only positions were measured hold the parameters' part alone.
        """
        columns = [model.parameter_names.index(name) for name in self.names]
        repeat = np.repeat([self.position_repeat, self.attitude_repeat or 0.0], 3) ** 2
        return model.pose_covariance(columns, self.covariance, joints, conditions) + np.diag(repeat)

    def standard(
        self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None
    ) -> tuple[Array, Array | None]:
        """Standard uncertainties of position ``(...)``, m, and attitude ``(...)``, rad: root of the three variances.

        That of the attitude is None where only positions were measured.
        """
        variance = np.diagonal(self.pose_covariance(model, joints, conditions), axis1=-2, axis2=-1)
        position, attitude = np.sqrt(variance[..., :3].sum(-1)), np.sqrt(variance[..., 3:].sum(-1))
        return position, None if self.attitude_repeat is None else attitude

    def as_record(self) -> dict[str, Any]:
        """For a calibration's record (JSON)."""
        return {
            "parameters": list(self.names),
            "covariance": self.covariance.tolist(),
            "position_repeat_m": self.position_repeat,
            "attitude_repeat_rad": self.attitude_repeat,
        }


def pose_uncertainty(found: Identification, errors: Array, unit: str = "mm") -> PoseUncertainty:
    """Uncertainty from an identification and the errors that it leaves.

    Args:
        found: The identification.
        errors: Measured minus predicted poses, best held-out ones, ``(N, 6)`` or positions ``(N, 3)``, m and rad; their
            RMS per coordinate is taken as u_repeat, so it includes the instrument's noise and errs on the large side.
        unit: "deg" where the errors are misses of directions ``(N, k)``, rad: of positions no more is known then than
            what the parameters say.
    """
    positions, attitudes = (np.zeros(1), errors) if unit == "deg" else (errors[:, :3], errors[:, 3:])
    own = set(found.arm_model.parameter_names)
    places = [i for i, name in enumerate(found.identifiability.kept_names) if name in own]
    return PoseUncertainty(
        names=tuple(found.identifiability.kept_names[i] for i in places),
        covariance=found.covariance[np.ix_(places, places)],
        position_repeat=float(np.sqrt(np.mean(positions**2))),
        attitude_repeat=float(np.sqrt(np.mean(attitudes**2))) if attitudes.size else None,
    )


def uncertainty_from(record: Mapping[str, Any]) -> PoseUncertainty | None:
    """The uncertainty that a calibration's record holds, or None if it holds none or no spare equations gave one."""
    kept = record.get("uncertainty")
    if not isinstance(kept, Mapping):
        return None
    covariance = np.array(kept["covariance"], dtype=float)
    if not np.isfinite(covariance).all():
        return None
    return PoseUncertainty(
        tuple(kept["parameters"]), covariance, float(kept["position_repeat_m"]), kept["attitude_repeat_rad"]
    )


def held_out_errors(calibration: Calibration, data: Measurements) -> Array:
    """Measured minus predicted ``(N, 6)`` or ``(N, 3)``, m and rad, with terms and the learnt residual, where any."""
    errors = data.difference(calibration.model)
    if calibration.learnt is not None:
        inputs = data.conditions.inputs() if calibration.learnt.inputs.conditions else None
        learnt = calibration.learnt.predict(data.joints, inputs)
        width = min(learnt.shape[1], errors.shape[1])
        errors[:, :width] -= learnt[:, :width]
    return errors
