"""Extended Kalman filter of the identifiable parameters: recursive identification, pose by pose (Qiao 2026, "EKF").

Covariances are updated in Joseph's form (Bucy and Joseph 1968), which stays symmetric and positive. Drift enters as
process noise. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Geometry, MeasurementNoise, Pose, pose_error
from pickenv.base import InputError
from pickenv.calibration.identification.least_squares import identifiability
from pickenv.calibration.model.arm_model import ArmModel, ErrorModel

PRIOR = 10.0
"""Prior standard deviation of a parameter as a multiple of its tolerance: 10 mm and 0.6 deg for geometry."""

HOUR = 3600.0
"""Seconds in an hour; drifts are stated per root hour."""


@dataclass(frozen=True, eq=False)
class FilterState:
    """The filter's estimate and its covariance, after the poses measured so far.

    Attributes:
        arm_model: Current estimate: geometry and coefficients of terms.
        columns: Indices ``(p,)`` of the estimated parameters in ``arm_model.parameter_names``.
        tolerance: Typical deviation of each estimated parameter ``(p,)``, m or rad.
        covariance: Covariance of the parameters' errors ``(p, p)``, m and rad.
    """

    arm_model: ArmModel
    columns: NDArray[np.int64]
    tolerance: Array
    covariance: Array

    @property
    def geometry(self) -> Geometry:
        """Current geometry."""
        return self.arm_model.geometry


def start_filter(
    model: ErrorModel, start: Geometry | ArmModel, joints: Array, *, full_pose: bool = True, prior: float = PRIOR
) -> FilterState:
    """Return the first state of a filter that knows only the nominal arm.

    Args:
        model: Candidate parameters; those that the poses do not identify are left out.
        start: Geometry, or geometry with terms, to start from.
        joints: Joints ``(N, n)``, rad or m, of poses like those to be measured. These poses decide which parameters are
            identifiable.
        full_pose: False if only positions will be measured.
        prior: Prior standard deviation of each parameter, as a multiple of its tolerance.

    Raises:
        InputError: If the poses give fewer equations than there are candidate parameters.
    """
    arm, joints, rows = ArmModel.of(start), np.asarray(joints, dtype=float), 6 if full_pose else 3
    if len(joints) * rows < len(model.columns):
        raise InputError(
            f"{len(joints)} poses cannot decide which of {len(model.columns)} parameters are identifiable; give the "
            f"joints of at least {-(-len(model.columns) // rows)} poses, measured or planned"
        )
    jacobian = arm.jacobian(joints)[:, :rows, model.columns] * model.tolerance
    base = identifiability(jacobian.reshape(-1, len(model.columns)), model.names, model.tolerance, len(joints))
    tolerance = model.tolerance[base.kept]
    return FilterState(arm, model.columns[base.kept], tolerance, np.diag((prior * tolerance) ** 2))


def predict(state: FilterState, process_noise: ArrayLike, seconds: float) -> FilterState:
    """Return the state after some time, in which the parameters may have drifted.

    Args:
        state: The state before.
        process_noise: Covariance that the parameters gain per second ``(p, p)``; see `random_walk`.
        seconds: Time since the last update.
    """
    return replace(state, covariance=state.covariance + np.asarray(process_noise) * seconds)


def random_walk(state: FilterState, tolerances: float) -> Array:
    """Return the process noise ``(p, p)`` per second of a random walk, which represents drifts of unknown cause.

    Args:
        state: The filter's state.
        tolerances: Standard deviation of each parameter's drift after one hour, as a multiple of its tolerance. It
            grows with the square root of time.
    """
    return np.asarray(np.diag((tolerances * state.tolerance) ** 2) / HOUR)


def update(state: FilterState, joints: ArrayLike, observed: Pose | ArrayLike, noise: MeasurementNoise) -> FilterState:
    """Return the state after one measured pose.

    Args:
        state: The state before.
        joints: Commanded joints ``(n,)``, rad or m.
        observed: Measured pose of the tool, or its position ``(3,)``, m.
        noise: Standard deviations of one coordinate, m and rad, including errors that the model cannot explain.

    Raises:
        InputError: If joints or the observation are not finite.
    """
    joints = np.asarray(joints, dtype=float)[None]
    predicted = state.arm_model.pose(joints)
    if isinstance(observed, Pose):
        innovation = pose_error(predicted, Pose(observed.position[None], observed.rotation[None]))[0]
    else:
        innovation = np.asarray(observed, dtype=float) - predicted.position[0]
    rows = len(innovation)
    if not np.isfinite(innovation).all():
        raise InputError("the observed pose or its joints are not finite; leave the pose out")
    jacobian = state.arm_model.jacobian(joints)[0, :rows][:, state.columns]
    variance = np.repeat([noise.position_std, noise.attitude_std], 3)[:rows] ** 2
    crossed = jacobian @ state.covariance
    gain = np.linalg.solve(crossed @ jacobian.T + np.diag(variance), crossed).T
    shrink = np.eye(len(gain)) - gain @ jacobian
    covariance = shrink @ state.covariance @ shrink.T + (gain * variance) @ gain.T
    delta = np.zeros(len(state.arm_model.parameter_names))
    delta[state.columns] = gain @ innovation
    return replace(state, arm_model=state.arm_model.displaced(delta), covariance=(covariance + covariance.T) / 2.0)
