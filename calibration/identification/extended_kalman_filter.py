"""Extended Kalman filter on the identifiable parameters: the recursive twin of the least squares (Qiao 2026, "EKF").

One pose at a time, online, or a whole data set in one pass. Covariances are updated in Joseph's form (Bucy and Joseph
1968), which stays symmetric and positive; drift enters as process noise; an innovation gate may refuse outliers. SI.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv

from pickenv.arm import Array, Geometry, Pose, pose_error
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.base import InputError
from pickenv.calibration.identification.least_squares import Identifiability, Identification, identifiability
from pickenv.calibration.model.arm_model import ArmModel, Conditions, ErrorModel
from pickenv.calibration.model.measurements import Measurements

PRIOR = 10.0
"""Prior standard deviation of a parameter, in its tolerances: 10 mm and 0.6 deg for geometry."""

HOUR = 3600.0
"""s; drifts are stated per root hour."""


@dataclass(frozen=True, eq=False)
class FilterState:
    """The filter's knowledge after the poses it has seen.

    Attributes:
        arm_model: Current estimate: geometry and coefficients of terms.
        columns: Indices ``(p,)`` of the estimated parameters in ``arm_model.parameter_names``.
        tolerance: Their scale ``(p,)``, m or rad.
        covariance: Covariance of their errors ``(p, p)``, m and rad.
        updates: Poses accepted.
        rejected: Poses refused by the innovation gate.
        innovation: Last measured minus predicted pose ``(6,)`` or ``(3,)``, m and rad; empty before the first.
        nis: Last normalised innovation squared (NIS); 1 per coordinate is expected.
    """

    arm_model: ArmModel
    columns: NDArray[np.int64]
    tolerance: Array
    covariance: Array
    updates: int = 0
    rejected: int = 0
    innovation: Array = field(default_factory=lambda: np.empty(0))
    nis: float = 0.0

    @property
    def geometry(self) -> Geometry:
        """Current geometry."""
        return self.arm_model.geometry

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(self.arm_model.parameter_names[k] for k in self.columns)

    @property
    def standard_deviation(self) -> Array:
        """Standard deviation of the estimated parameters ``(p,)``, m or rad."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def pose_covariance(self, joints: ArrayLike) -> Array:
        """Covariance of the predicted pose ``(..., 6, 6)``, m and rad, at joints ``(..., n)``: J P J^T."""
        return self.arm_model.pose_covariance(self.columns, self.covariance, joints)


def start_filter(
    model: ErrorModel, start: Geometry | ArmModel, joints: Array, *, full_pose: bool = True, prior: float = PRIOR
) -> FilterState:
    """A filter that knows nothing but the nominal arm.

    Args:
        model: The parameters to choose from; those that the poses cannot tell apart stay out.
        start: Geometry, or geometry with terms, to start from.
        joints: Joints ``(N, n)`` of poses such as will be measured, or are planned; they decide what is identifiable.
        full_pose: False if only positions will be measured.
        prior: Prior standard deviation in tolerances of each parameter.

    Raises:
        InputError: If the poses are so few that they would leave parameters out that others identify.
    """
    return _diffuse(model, ArmModel.of(start), joints, 6 if full_pose else 3, None, prior)[0]


def continue_filter(model: ErrorModel, identified: Identification, *, inflation: float = 1.0) -> FilterState:
    """A filter that goes on from a least-squares identification of ``model``, with its covariance.

    Args:
        model: The model that was identified.
        identified: The identification; the data's own unknowns (reflectors, anchors) are left behind.
        inflation: Factor on its standard deviations, for an arm that may have changed since.

    Raises:
        InputError: If the identification has no covariance, because it had no spare equations.
    """
    count = len(identified.unknowns)
    base = identified.identifiability.kept
    ours = base >= count
    covariance = identified.covariance[np.ix_(ours, ours)] * inflation**2
    if not np.isfinite(covariance).all():
        raise InputError("the identification has no covariance to go on from; measure more poses than parameters need")
    places = base[ours] - count
    return FilterState(identified.arm_model, model.columns[places], model.tolerance[places], covariance)


def predict(state: FilterState, process_noise: ArrayLike, seconds: float) -> FilterState:
    """Let time pass: parameters may have drifted.

    Args:
        state: The state.
        process_noise: Covariance that the parameters gain per second ``(p, p)``; see `random_walk`, `thermal_walk`.
        seconds: Time since the last update.
    """
    return replace(state, covariance=state.covariance + np.asarray(process_noise) * seconds)


def random_walk(state: FilterState, tolerances: float) -> Array:
    """Process noise ``(p, p)`` per second: every parameter wanders by so many of its tolerances per root hour.

    For drifts of unknown shape; where the cause is known, `thermal_walk` and `offset_walk` follow it with less noise.
    """
    return np.asarray(np.diag((tolerances * state.tolerance) ** 2) / HOUR)


def thermal_walk(state: FilterState, joints: Array, kelvin: float, expansion: float = 23e-6) -> Array:
    """Process noise ``(p, p)`` per second of an arm whose links grow together: one direction, not p of them.

    Args:
        state: The state.
        joints: Joints ``(N, n)`` over the working range.
        kelvin: Change of temperature per root hour, K.
        expansion: Linear thermal expansion, 1/K; aluminium where left out.
    """
    geometry = state.geometry
    n = geometry.links
    growth = np.zeros(len(state.arm_model.parameter_names))
    growth[n : 2 * n], growth[3 * n : 4 * n] = geometry.a, geometry.d
    return _carried(state, joints, growth[None] * expansion * kelvin)


def offset_walk(state: FilterState, joints: Array, length: float, angle: float) -> Array:
    """Process noise ``(p, p)`` per second of joint zeros that wander: encoders, belts, slipping couplings.

    Args:
        state: The state.
        joints: Joints ``(N, n)`` over the working range.
        length: Drift of a prismatic joint's zero per root hour, m.
        angle: Drift of a revolute joint's zero per root hour, rad.
    """
    geometry = state.geometry
    n = geometry.links
    shifts = np.zeros((geometry.joints, len(state.arm_model.parameter_names)))
    for joint, drifts in enumerate(np.where(geometry.prismatic, length, angle)):
        for i, ratio in geometry.links_of(joint):
            shifts[joint, 3 * n + i if geometry.slides[i] else 2 * n + i] = drifts * ratio
    return _carried(state, joints, shifts)


def _carried(state: FilterState, joints: Array, drifts: Array) -> Array:
    """Covariance gained per second when all parameters drift by each row of ``drifts`` ``(k, P)`` per root hour.

    The drift of a parameter that is not estimated is carried by those that absorb it.
    """
    jacobian = state.arm_model.jacobian(np.asarray(joints, dtype=float), None).reshape(-1, drifts.shape[1])
    scaled = jacobian[:, state.columns] * state.tolerance
    directions = np.linalg.lstsq(scaled, jacobian @ drifts.T, rcond=None)[0] * state.tolerance[:, None]
    return np.asarray(directions @ directions.T / HOUR)


def update(
    state: FilterState,
    joints: ArrayLike,
    observed: Pose | ArrayLike,
    noise: MeasurementNoise,
    *,
    conditions: Conditions | None = None,
    gate: float | None = None,
) -> FilterState:
    """Learn from one pose.

    Args:
        state: The state before.
        joints: Commanded joints ``(n,)``, rad or m.
        observed: The tool's pose as it was seen, or its position ``(3,)`` in m.
        noise: Standard deviations of one coordinate, m and rad; add what the model cannot explain.
        conditions: Payload, temperature and torques of this pose, if the model has terms that need them.
        gate: Refuse the pose if its innovation is less likely than 1 - gate (say 0.9999); None accepts all.

    Returns:
        The state after; refused poses only count in ``rejected``.

    Raises:
        InputError: If joints or the observation are not finite.
    """
    joints = np.asarray(joints, dtype=float)[None]
    predicted = state.arm_model.pose(joints, conditions)
    if isinstance(observed, Pose):
        innovation = pose_error(predicted, Pose(observed.position[None], observed.rotation[None]))[0]
    else:
        innovation = np.asarray(observed, dtype=float) - predicted.position[0]
    rows = len(innovation)
    if not np.isfinite(innovation).all():
        raise InputError("the observed pose or its joints are not finite; leave the pose out")
    jacobian = state.arm_model.jacobian(joints, conditions)[0, :rows][:, state.columns]
    variance = np.repeat([noise.position_std, noise.attitude_std], 3)[:rows] ** 2
    crossed = jacobian @ state.covariance
    expected = crossed @ jacobian.T + np.diag(variance)
    solved = np.linalg.solve(expected, np.column_stack([crossed, innovation]))
    nis = float(innovation @ solved[:, -1])
    if gate is not None and nis > 2.0 * gammaincinv(rows / 2.0, gate):  # quantile of chi squared
        return replace(state, rejected=state.rejected + 1, innovation=innovation, nis=nis)
    gain = solved[:, :-1].T
    shrink = np.eye(len(gain)) - gain @ jacobian
    covariance = shrink @ state.covariance @ shrink.T + (gain * variance) @ gain.T
    delta = np.zeros(len(state.arm_model.parameter_names))
    delta[state.columns] = gain @ innovation
    return replace(
        state,
        arm_model=state.arm_model.displaced(delta),
        covariance=(covariance + covariance.T) / 2.0,
        updates=state.updates + 1,
        innovation=innovation,
        nis=nis,
    )


@dataclass(frozen=True, eq=False)
class Filtered:
    """An arm filtered from measurements in one pass, with its evidence.

    Attributes:
        state: The filter's last state: arm, covariance, counts.
        identifiability: What could be identified, what was dropped, and what absorbed it.
        delta: Estimated minus starting parameters, m or rad, per model parameter (0 for dropped ones).
        innovations: Measured minus predicted pose of each row before it was used ``(N, 6)`` or ``(N, 3)``, m and rad.
        nis: Normalised innovation squared of each ``(N,)``.
        rejected: Rows that the gate refused, counted from 0.
    """

    state: FilterState
    identifiability: Identifiability
    delta: Array
    innovations: Array
    nis: Array
    rejected: tuple[int, ...]

    @property
    def geometry(self) -> Geometry:
        """The estimated geometry."""
        return self.state.geometry

    @property
    def standard_deviation(self) -> Array:
        """Standard deviation of every model parameter, m or rad, under the assumed noise; NaN for dropped ones."""
        return self.identifiability.of_all(self.state.standard_deviation)

    @property
    def consistency(self) -> float:
        """Mean normalised innovation squared per coordinate: 1 if the assumed noise explains the innovations."""
        used = np.setdiff1d(np.arange(len(self.nis)), self.rejected)
        return float(np.mean(self.nis[used]) / self.innovations.shape[1]) if len(used) else float("nan")


def filter_measurements(
    model: ErrorModel,
    start: Geometry | ArmModel,
    measurements: Measurements,
    *,
    noise: MeasurementNoise | None = None,
    prior: float = PRIOR,
    gate: float | None = None,
) -> Filtered:
    """Pass once over a data set, row by row, of an arm that does not drift; else go by `predict` and `update`.

    Args:
        model: The parameters.
        start: Geometry, or geometry with terms, to start from; it must lie near the data (see `align`).
        measurements: Poses or positions.
        noise: Assumed noise; the data set's own where left out.
        prior: Prior standard deviation in tolerances of each parameter.
        gate: As in `update`.

    Raises:
        InputError: If there are too few poses for what is to be identified.
    """
    arm = ArmModel.of(start)
    rows, conditions = measurements.rows_per_pose, measurements.conditions
    state, base = _diffuse(model, arm, measurements.joints, rows, conditions, prior)
    noise = noise or MeasurementNoise(measurements.position_std, measurements.attitude_std)
    states = [state]
    for i in range(len(measurements)):
        row = measurements.select([i])
        observed = row.position[0] if row.rotation is None else Pose(row.position[0], row.rotation[0])
        state = update(state, row.joints[0], observed, noise, conditions=row.conditions, gate=gate)
        states.append(state)
    return Filtered(
        state=state,
        identifiability=base,
        delta=arm.difference(state.arm_model)[model.columns],
        innovations=np.array([step.innovation for step in states[1:]]),
        nis=np.array([step.nis for step in states[1:]]),
        rejected=tuple(np.flatnonzero(np.diff([step.rejected for step in states])).tolist()),
    )


def _diffuse(
    model: ErrorModel, arm: ArmModel, joints: Array, rows: int, conditions: Conditions | None, prior: float
) -> tuple[FilterState, Identifiability]:
    """A wide prior on what ``rows`` coordinates of poses at these joints tell apart, each weighted by its tolerance."""
    if len(joints) * rows < len(model.columns):
        raise InputError(
            f"{len(joints)} poses cannot decide which of {len(model.columns)} parameters are identifiable; give the "
            f"joints of at least {-(-len(model.columns) // rows)} poses, measured or planned"
        )
    jacobian = arm.jacobian(np.asarray(joints, dtype=float), conditions)[:, :rows, model.columns] * model.tolerance
    base = identifiability(jacobian.reshape(-1, len(model.columns)), model.names, model.tolerance, len(joints))
    tolerance = model.tolerance[base.kept]
    return FilterState(arm, model.columns[base.kept], tolerance, np.diag((prior * tolerance) ** 2)), base
