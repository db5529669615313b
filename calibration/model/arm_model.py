"""What is identified: a geometry, and parametric terms for what geometry cannot say (compliance, bending, lead, heat).

The pose is F(q) displaced by the sum of coefficient times column: the terms are small (millimetres), so first order is
exact to micrometres, and every parameter, geometric or not, is one column of one Jacobian. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Geometry, displace_pose, forward, parameter_jacobian
from pickenv.arm.kinematics.geometry import Array, Pose


@dataclass(frozen=True, eq=False)
class Conditions:
    """What else was known of each pose; None where it was not recorded.

    Attributes:
        payload: Mass held at the tool ``(N,)``, kg.
        temperature: Temperature above the reference ``(N,)``, K.
        torque: Measured joint torques or forces ``(N, n)``, N*m or N, positive along the joint as gravity's are.
    """

    payload: Array | None = None
    temperature: Array | None = None
    torque: Array | None = None

    def select(self, rows: NDArray[Any]) -> Conditions:
        """The conditions of the given rows."""
        return Conditions(**{name: None if part is None else part[rows] for name, part in vars(self).items()})

    def spread(self, shape: tuple[int, ...]) -> Conditions:
        """One value each, repeated for a batch of poses of this shape (flattened)."""
        count = int(np.prod(shape))
        parts = {name: getattr(self, name) for name in ("payload", "temperature")}
        return Conditions(
            **{name: None if part is None else np.broadcast_to(part, (count,)) for name, part in parts.items()}
        )

    def inputs(self) -> Array | None:
        """Payload and temperature as columns ``(N, k)`` for a learnt residual; None if neither is known."""
        columns = [part for part in (self.payload, self.temperature) if part is not None]
        return np.stack(columns, -1) if columns else None


class Term(Protocol):
    """One physical effect, linear in its coefficients."""

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Names of its coefficients."""

    def tolerances(self, geometry: Geometry) -> Array:
        """Scale of each coefficient: about 1 mm at the tool, in the coefficient's own unit."""

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Pose displacement per unit of each coefficient ``(N, 6, k)``, m and rad, world axes."""


@dataclass(frozen=True, eq=False)
class ArmModel:
    """A geometry with the coefficients of its terms.

    Attributes:
        geometry: The geometry.
        terms: The effects.
        coefficients: All their coefficients in order ``(k,)``.
    """

    geometry: Geometry
    terms: tuple[Term, ...] = ()
    coefficients: Array = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def of(geometry: Geometry | ArmModel, terms: tuple[Term, ...] = ()) -> ArmModel:
        """A model whose terms start at zero; a model is left as it is."""
        if isinstance(geometry, ArmModel):
            return geometry
        return ArmModel(geometry, terms, np.zeros(sum(len(term.names(geometry)) for term in terms)))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The geometry's 5n + 12 names, then the terms' coefficients."""
        return self.geometry.parameter_names + tuple(name for term in self.terms for name in term.names(self.geometry))

    @property
    def term_tolerances(self) -> Array:
        """Scales of the coefficients ``(k,)``."""
        return np.concatenate([np.zeros(0), *(term.tolerances(self.geometry) for term in self.terms)])

    def pose(self, joints: ArrayLike, conditions: Conditions | None = None) -> Pose:
        """Predicted tool pose at joints ``(..., n)``."""
        pose = forward(self.geometry, joints)
        return pose if not self.terms else displace_pose(pose, self.displacement(joints, conditions))

    def displacement(self, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """What the terms add to the pose ``(..., 6)``, m and rad."""
        joints = np.asarray(joints, dtype=float)
        flat = joints.reshape(-1, joints.shape[-1])
        return np.asarray((self._columns(flat, conditions) @ self.coefficients).reshape(*joints.shape[:-1], 6))

    def jacobian(self, joints: Array, conditions: Conditions | None = None) -> Array:
        """Derivative of the pose by every parameter ``(N, 6, 5n + 12 + k)``."""
        geometric = parameter_jacobian(self.geometry, joints)
        return np.concatenate([geometric, self._columns(joints, conditions)], axis=-1) if self.terms else geometric

    def pose_covariance(
        self, columns: ArrayLike, covariance: Array, joints: ArrayLike, conditions: Conditions | None = None
    ) -> Array:
        """Covariance J C J^T ``(..., 6, 6)`` of the pose at joints ``(..., n)``, m and rad.

        Args:
            columns: Indices of the parameters whose errors have the covariance C ``(p,)``.
            covariance: C ``(p, p)``, m and rad.
            joints: Joints, rad or m.
            conditions: As for `pose`.
        """
        joints = np.asarray(joints, dtype=float)
        jacobian = self.jacobian(joints.reshape(-1, joints.shape[-1]), conditions)[..., np.asarray(columns)]
        found = jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)
        return np.asarray(found.reshape(*joints.shape[:-1], 6, 6))

    def displaced(self, delta: Array) -> ArmModel:
        """This model with ``delta`` ``(5n + 12 + k,)`` added to its parameters."""
        count = len(self.geometry.parameter_names)
        return replace(
            self, geometry=self.geometry.displaced(delta[:count]), coefficients=self.coefficients + delta[count:]
        )

    def difference(self, other: ArmModel) -> Array:
        """The ``delta`` that turns this model into ``other``."""
        return np.concatenate([self.geometry.difference(other.geometry), other.coefficients - self.coefficients])

    def _columns(self, joints: Array, conditions: Conditions | None) -> Array:
        conditions = conditions or Conditions()
        return np.concatenate([term.columns(self.geometry, joints, conditions) for term in self.terms], axis=-1)
