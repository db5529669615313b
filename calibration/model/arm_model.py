"""The arm model to identify: a geometry, and terms for compliance, weight, periodic drive errors and thermal expansion.

The predicted pose is the forward kinematics F(q), displaced by the sum over all coefficients of coefficient times
column. The terms displace the pose by millimetres, so a first-order model is exact to micrometres. Every parameter,
geometric or not, is one column of one Jacobian. SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pickenv.arm import Arm, Array, Geometry, Pose, displace_pose, identity_pose, joint_jacobian, parameter_jacobian
from pickenv.arm.kinematics.forward import NEARLY_PARALLEL, forward
from pickenv.base import InputError


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions in which each of N poses was measured, beside its joint values; None for a condition not recorded.

    Attributes:
        payload: Mass held at the tool ``(N,)``, kg.
        temperature: Temperature above the reference ``(N,)``, K.
        torque: Measured joint torques or forces ``(N, n)``, N*m or N; positive if the load, such as gravity, pushes in
            the joint's positive direction.
        between: For a robot whose links form a tree, indices of the links that carry the sensor and its target
            ``(N, 2)``, from 0, with -1 for the world; see `pickenv.arm.kinematics.geometry.LinkTree`.
    """

    payload: Array | None = None
    temperature: Array | None = None
    torque: Array | None = None
    between: NDArray[np.int64] | None = None

    def select(self, rows: NDArray[Any]) -> Conditions:
        """Return the conditions of the poses that ``rows`` selects (indices or a mask)."""
        return Conditions(**{name: None if part is None else part[rows] for name, part in vars(self).items()})

    def repeated(self, shape: tuple[int, ...]) -> Conditions:
        """Repeat a single payload and a single temperature for every pose of a batch; leave torques and links out.

        Args:
            shape: Shape of the batch. The result is flat, with one entry per pose.
        """
        count, parts = int(np.prod(shape)), (self.payload, self.temperature)
        payload, temperature = (None if part is None else np.broadcast_to(part, (count,)) for part in parts)
        return Conditions(payload, temperature)

    def inputs(self) -> Array | None:
        """Return payload and temperature ``(N, k)``, inputs of a learnt residual; None if neither is known."""
        columns = [getattr(self, name) for name in self.input_names()]
        return np.stack(columns, -1) if columns else None

    def input_names(self) -> tuple[str, ...]:
        """Return the names of the columns of `inputs`."""
        return tuple(name for name in ("payload", "temperature") if getattr(self, name) is not None)

    def refuse_other_inputs(self, record: Mapping[str, Any]) -> None:
        """Refuse these conditions if a residual was learnt with different ones.

        Args:
            record: Record of the calibration that has the residual.

        Raises:
            InputError: If `input_names` is not empty and differs from the names that the residual was learnt with.
        """
        residual = record.get("residual")
        trained = residual.get("conditions") if isinstance(residual, Mapping) else None
        names = self.input_names()
        if trained and names and list(names) != list(trained):
            learnt = f"the learnt residual depends on {' and '.join(trained)}"
            raise InputError(f"{learnt}, but {' and '.join(names)} is given; give what it was learnt with")


class Term(Protocol):
    """A physical effect beyond geometry, whose pose displacement is linear in the effect's k coefficients."""

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Return the names of the term's coefficients."""

    def tolerances(self, geometry: Geometry) -> Array:
        """Return the scale of each coefficient ``(k,)``, in its unit: the change that moves the tool by about 1 mm."""

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Return the pose displacement per unit of each coefficient ``(N, 6, k)``, m and rad, world axes."""

    def displacement(self, geometry: Geometry, joints: Array, conditions: Conditions, coefficients: Array) -> Array:
        """Return the pose displacement ``(N, 6)``, m and rad, world axes, for these coefficients ``(k,)``."""
        return np.asarray(self.columns(geometry, joints, conditions) @ coefficients)


class JointTerm(Term, Protocol):
    """A term that displaces one joint per coefficient; the tool's displacement follows to first order."""

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return each coefficient's joint, from 0, and that joint's motion per unit of the coefficient ``(N, k)``.

        The motion is in rad or m.
        """

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Return the pose displacement per unit of each coefficient ``(N, 6, k)``, m and rad, world axes.

        It is the joint Jacobian's column times the joint's motion from `steps`. In memory, poses are the innermost
        axis.
        """
        which, steps = self.steps(geometry, joints, conditions)
        by_joint = np.moveaxis(joint_jacobian(geometry, joints), 0, -1)
        return np.asarray(np.moveaxis(by_joint[:, list(which)] * steps.T, -1, 0))

    def displacement(self, geometry: Geometry, joints: Array, conditions: Conditions, coefficients: Array) -> Array:
        """Return the joint Jacobian times the total motion of each joint ``(N, 6)``, m and rad."""
        which, steps = self.steps(geometry, joints, conditions)
        displacements = (coefficients * (np.arange(geometry.joints)[:, None] == list(which))) @ steps.T
        by_joint = np.moveaxis(joint_jacobian(geometry, joints), 0, -1)
        return np.asarray(np.einsum("ijn,jn->ni", by_joint, displacements))


@dataclass(frozen=True, eq=False)
class ArmModel:
    """A geometry with the coefficients of its terms.

    Attributes:
        geometry: The geometry.
        terms: The physical effects beyond geometry.
        coefficients: Coefficients of all terms ``(k,)``, term by term.
    """

    geometry: Geometry
    terms: tuple[Term, ...] = ()
    coefficients: Array = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def of(geometry: Geometry | ArmModel, terms: tuple[Term, ...] = ()) -> ArmModel:
        """Return a model of this geometry with all coefficients zero; an `ArmModel` is returned unchanged."""
        if isinstance(geometry, ArmModel):
            return geometry
        return ArmModel(geometry, terms, np.zeros(sum(len(term.names(geometry)) for term in terms)))

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the geometry's 5n + 12 parameters, then of the terms' coefficients."""
        return self.geometry.parameter_names + tuple(name for term in self.terms for name in term.names(self.geometry))

    @property
    def term_tolerances(self) -> Array:
        """Scales of the coefficients of all terms ``(k,)``."""
        return np.concatenate([np.zeros(0), *(term.tolerances(self.geometry) for term in self.terms)])

    def pose(self, joints: ArrayLike, conditions: Conditions | None = None) -> Pose:
        """Return the predicted tool poses at joints ``(..., n)``, rad or m."""
        if conditions is not None and conditions.between is not None:
            parts = self._by_way(joints, conditions, lambda model, *row: np.dstack(model.pose(*row)[::-1]))
            return Pose(parts[..., 3], np.ascontiguousarray(parts[..., :3]))
        pose = forward(self.geometry, joints)
        return pose if not self.terms else displace_pose(pose, self.displacement(joints, conditions))

    def displacement(self, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Return the displacement of the pose by all terms together ``(..., 6)``, m and rad."""
        if conditions is not None and conditions.between is not None:
            return self._by_way(joints, conditions, lambda model, *rows: model.displacement(*rows))
        joints = np.asarray(joints, dtype=float)
        flat, first = joints.reshape(-1, joints.shape[-1]), 0
        total = np.zeros((len(flat), 6))
        for term in self.terms:
            last = first + len(term.names(self.geometry))
            total += term.displacement(self.geometry, flat, conditions or Conditions(), self.coefficients[first:last])
            first = last
        return np.reshape(total, (*joints.shape[:-1], 6))

    def jacobian(self, joints: Array, conditions: Conditions | None = None) -> Array:
        """Return the derivative of the pose with respect to every parameter ``(N, 6, 5n + 12 + k)``."""
        if conditions is not None and conditions.between is not None:
            return self._by_way(joints, conditions, lambda model, *rows: model.jacobian(*rows))
        conditions, geometric = conditions or Conditions(), parameter_jacobian(self.geometry, joints)
        columns = [term.columns(self.geometry, joints, conditions) for term in self.terms]
        return np.concatenate([geometric, *columns], axis=-1) if columns else geometric

    def _by_way(self, joints: ArrayLike, conditions: Conditions, question: Callable[..., Array]) -> Array:
        """Return results ``(N, ...)`` for N rows of a whole robot, computed for one pair of links at a time.

        Args:
            joints: Joints ``(N, n)``, rad or m.
            conditions: Conditions of the rows; ``conditions.between`` has the pair of links of each row.
            question: Function that returns the results of M rows with one pair of links ``(M, ...)``. Its arguments are
                the model of the chain between these links, the rows' joints, and the rows' other conditions.
        """
        assert conditions.between is not None
        ways, way = np.unique(conditions.between, axis=0, return_inverse=True)
        answer, joints = np.zeros(0), np.asarray(joints, dtype=float)
        for i, (sensor, target) in enumerate(ways.tolist()):
            rows = np.flatnonzero(way.ravel() == i)
            model = replace(self, geometry=self.geometry.between(sensor, target))
            part = question(model, joints[rows], replace(conditions.select(rows), between=None))
            if not i:
                answer = np.empty((len(joints), *part.shape[1:]))
            answer[rows] = part
        return answer

    def displaced(self, delta: Array) -> ArmModel:
        """Return this model with ``delta`` ``(5n + 12 + k,)`` added to its parameters, in the order of their names."""
        count = len(self.geometry.parameter_names)
        geometry = self.geometry.displaced(delta[:count])
        return replace(self, geometry=geometry, coefficients=self.coefficients + delta[count:])

    def moved(self, columns: NDArray[np.int64], change: Array) -> ArmModel:
        """Return this model with ``change`` ``(p,)`` added to the parameters with the indices ``columns`` ``(p,)``."""
        delta = np.zeros(len(self.parameter_names))
        delta[columns] = change
        return self.displaced(delta)

    def difference(self, other: ArmModel) -> Array:
        """Return the ``delta`` for which ``self.displaced(delta)`` has the parameters of ``other``."""
        return np.concatenate([self.geometry.difference(other.geometry), other.coefficients - self.coefficients])


# The error model: which parameters of a geometry are identified, and on what scale. Complete for any serial chain:
# four modified DH parameters per joint, Hayati's beta where axes are parallel or the table has it, base and tool pose.
# Rows are weighted by the measurement's uncertainty and columns by a parameter's tolerance, because rank and
# redundancy are meaningless in mixed units (Qiao 2026 digest, fact 2).


LENGTH_TOLERANCE = 1e-3
"""Typical deviation of a length, m, by which the length's column of the Jacobian is scaled."""

ANGLE_TOLERANCE = 1e-3
"""Typical deviation of an angle, rad (0.057 deg), by which the angle's column of the Jacobian is scaled."""


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """The parameters to identify.

    Attributes:
        columns: Indices into the arm's ``parameter_names`` ``(P,)``, in order of preference: if parameters are
            redundant, the earlier parameters are kept.
        names: The parameters' names.
        tolerance: Typical deviation of each parameter ``(P,)``, m or rad, by which its Jacobian column is scaled.
    """

    columns: NDArray[np.int64]
    names: tuple[str, ...]
    tolerance: Array

    def some(self, kept: NDArray[np.bool_]) -> ErrorModel:
        """Return the model of the parameters for which ``kept`` ``(P,)`` is True."""
        names = tuple(name for name, keep in zip(self.names, kept, strict=True) if keep)
        return ErrorModel(self.columns[kept], names, self.tolerance[kept])

    def joined(self, other: ErrorModel) -> ErrorModel:
        """Return a model of these parameters, followed by the parameters of another model."""
        columns, tolerance = np.r_[self.columns, other.columns], np.r_[self.tolerance, other.tolerance]
        return ErrorModel(columns, self.names + other.names, tolerance)


def link_model(geometry: Geometry) -> ErrorModel:
    """Return the model of Qiao 2026: four MDH parameters of every joint, with base and tool known (eqs (7)-(8))."""
    return _model(geometry, _link_names(geometry))


def complete_model(geometry: Geometry) -> ErrorModel:
    """Return a model that is complete for any serial chain.

    The parameters are base and tool pose, the MDH parameters, and Hayati's beta. Beta is included between parallel
    axes, and for joints whose beta in the table is not zero.
    """
    parallel = (np.abs(np.sin(geometry.alpha)) < NEARLY_PARALLEL) | (geometry.beta != 0.0)
    betas = [f"beta{i}" for i in range(1, geometry.links) if parallel[i]]
    return frames_model(geometry).joined(_model(geometry, _link_names(geometry) + betas))


def frames_model(geometry: Geometry) -> ErrorModel:
    """Return the model of base and tool pose alone.

    Base and tool are fitted before the error of a nominal arm is computed.
    """
    return _model(geometry, [name for name in geometry.parameter_names if name.startswith(("base_", "tool_"))])


def joint_zeros_model(geometry: Geometry) -> ErrorModel:
    """Return the model of the joint zeros alone: theta of every link that rotates, d of every link that slides."""
    return _model(geometry, [f"{'d' if slides else 'theta'}{i + 1}" for i, slides in enumerate(geometry.slides)])


def with_terms(model: ErrorModel, arm: ArmModel) -> ErrorModel:
    """Return ``model``, the parameters to identify, followed by all coefficients of the terms of ``arm``."""
    count = len(arm.geometry.parameter_names)
    columns = np.arange(count, len(arm.parameter_names))
    return model.joined(ErrorModel(columns, arm.parameter_names[count:], arm.term_tolerances))


def _link_names(geometry: Geometry) -> list[str]:
    """Return the names of the MDH parameters in the order alpha, a, d, theta, so that lengths precede joint angles.

    If an offset d and angles theta are redundant, the offset is kept, because it is earlier in this order. A length
    expresses a finite deviation exactly, and angles only to first order. The picking arm has such a redundancy:
    d3 = (theta2 - theta1) / a1.
    """
    kinds = ("alpha", "a", "d", "theta")
    return [name for kind in kinds for name in geometry.parameter_names if name.rstrip("0123456789") == kind]


def _model(geometry: Geometry, names: list[str]) -> ErrorModel:
    """Return the model of the parameters with these names, in this order."""
    columns = np.array([geometry.parameter_names.index(name) for name in names])
    tolerance = np.where(geometry.parameter_is_angle[columns], ANGLE_TOLERANCE, LENGTH_TOLERANCE)
    return ErrorModel(columns, tuple(names), tolerance)


# Poses that a controller reports, where its joint angles are not known: the joints of an arm that is nothing but
# them. A gantry with a wrist can stand in any pose. Its joints are the pose in other words, and none of its own
# parameters is ever fitted; base and tool are, as of any arm.


REACH = 100.0
"""Travel of the pose carrier's prismatic joints to either side, m: farther than any robot reaches."""

_QUARTER = np.pi / 2.0


CARRIER = "finished_poses"
"""Name of the arm that `pose_carrier` makes, for tool poses given in place of joint values."""


def pose_carrier() -> Arm:
    """Return an arm whose six joint values are the tool pose itself.

    It serves data in which a controller reports tool poses in place of joint values. The joints are translations along
    z, x and y, then three wrist angles (z, y, z).
    """
    # z, then x, then y: each link's axis is turned from the one before by quarter turns.
    return Arm(
        name=CARRIER,
        source="poses as a controller reports them",
        nominal=Geometry(
            joint_names=("z", "x", "y", "wrist1", "wrist2", "wrist3"),
            prismatic=(True, True, True, False, False, False),
            alpha=np.array([0.0, _QUARTER, _QUARTER, 0.0, _QUARTER, -_QUARTER]),
            a=np.zeros(6),
            theta=np.array([_QUARTER, _QUARTER, 0.0, 0.0, 0.0, 0.0]),
            d=np.zeros(6),
            beta=np.zeros(6),
            lower=np.array([-REACH] * 3 + [-np.pi] * 3),
            upper=np.array([REACH] * 3 + [np.pi] * 3),
            base=identity_pose(),
            tool=identity_pose(),
        ),
        true=None,
        speed=np.ones(6),
    )


def fitted_model(arm: str, nominal: Geometry, known_frames: bool) -> ErrorModel:
    """Return the parameters of an arm to identify.

    For the pose carrier (`CARRIER`) they are base and tool pose. Every other arm has the parameters of `link_model` if
    base and tool are known, else the parameters of `complete_model`.

    Args:
        arm: The arm's name.
        nominal: The arm's nominal geometry.
        known_frames: Whether base and tool are known.
    """
    if arm == CARRIER:
        return frames_model(nominal)
    return link_model(nominal) if known_frames else complete_model(nominal)


def joints_of_finished_poses(poses: Pose) -> Array:
    """Return the joints ``(N, 6)``, m and rad, at which the tool of `pose_carrier` has the poses ``poses`` ``(N,)``."""
    geometry = pose_carrier().nominal
    along = np.stack([forward(geometry, row).position for row in np.eye(6)[:3]], axis=1)
    angles = Rotation.from_matrix(forward(geometry, np.zeros(6)).rotation.T @ poses.rotation).as_euler("ZYZ")
    return np.concatenate([np.linalg.solve(along, poses.position.T).T, angles * (1.0, -1.0, 1.0)], axis=1)
