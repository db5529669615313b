"""The arm model to identify: a geometry, and terms for compliance, weight, periodic drive errors and thermal expansion.

The predicted pose is the forward kinematics F(q), displaced by the sum of each coefficient times its column. The terms
displace it by millimetres, so a first-order model is exact to micrometres. Every parameter, geometric or not, is one
column of one Jacobian. SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pickenv.arm import (
    Arm,
    Array,
    Geometry,
    Load,
    Pose,
    displace_pose,
    identity_pose,
    joint_jacobian,
    parameter_jacobian,
)
from pickenv.arm.kinematics.forward import NEARLY_PARALLEL, attach, chain_of, forward, frames, split_joints
from pickenv.base import GRAVITY, InputError


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions in which each of N poses was measured, beside its joint values; None for a condition not recorded.

    Attributes:
        payload: Mass held at the tool ``(N,)``, kg.
        temperature: Temperature above the reference ``(N,)``, K.
        torque: Measured joint torques or forces ``(N, n)``, N*m or N, positive along the joint as gravity's are.
        between: For a robot whose links form a tree, indices of the links that carry the sensor and its target
            ``(N, 2)``, see `pickenv.arm.kinematics.geometry.LinkTree`.
    """

    payload: Array | None = None
    temperature: Array | None = None
    torque: Array | None = None
    between: NDArray[np.int64] | None = None

    def select(self, rows: NDArray[Any]) -> Conditions:
        """Return the conditions of the given poses (indices or a mask)."""
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
        """Names of the columns of `inputs`."""
        return tuple(name for name in ("payload", "temperature") if getattr(self, name) is not None)

    def refuse_other_inputs(self, record: Mapping[str, Any]) -> None:
        """Refuse a temperature where a residual was learnt with payloads, and the other way round.

        Args:
            record: Record of the calibration that has the residual.
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
        """Names of the term's coefficients."""

    def tolerances(self, geometry: Geometry) -> Array:
        """Scale of each coefficient ``(k,)``, in its own unit: the change that moves the tool by about 1 mm."""

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Pose displacement per unit of each coefficient ``(N, 6, k)``, m and rad, world axes."""

    def displacement(self, geometry: Geometry, joints: Array, conditions: Conditions, coefficients: Array) -> Array:
        """Return the pose displacement ``(N, 6)``, m and rad, world axes, for these coefficients ``(k,)``."""
        return np.asarray(self.columns(geometry, joints, conditions) @ coefficients)


class JointTerm(Term, Protocol):
    """A term of the error model that displaces joints, one for each coefficient; the tool moves to first order."""

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return each coefficient's joint ``(k,)``, and that joint's motion per unit of it ``(N, k)``, rad or m."""

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
        """Derivative of the pose with respect to every parameter ``(N, 6, 5n + 12 + k)``."""
        if conditions is not None and conditions.between is not None:
            return self._by_way(joints, conditions, lambda model, *rows: model.jacobian(*rows))
        conditions, geometric = conditions or Conditions(), parameter_jacobian(self.geometry, joints)
        columns = [term.columns(self.geometry, joints, conditions) for term in self.terms]
        return np.concatenate([geometric, *columns], axis=-1) if columns else geometric

    def _by_way(self, joints: ArrayLike, conditions: Conditions, question: Callable[..., Array]) -> Array:
        """Answers for the rows ``(N, ...)`` of a whole robot, those between the same two links at once."""
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
        """Return this model with ``delta`` ``(5n + 12 + k,)`` added to its parameters."""
        count = len(self.geometry.parameter_names)
        geometry = self.geometry.displaced(delta[:count])
        return replace(self, geometry=geometry, coefficients=self.coefficients + delta[count:])

    def difference(self, other: ArmModel) -> Array:
        """Return the ``delta`` for which ``self.displaced(delta)`` has the parameters of ``other``."""
        return np.concatenate([self.geometry.difference(other.geometry), other.coefficients - self.coefficients])


# Parametric terms for what geometry cannot say, each linear in its coefficients, so that least squares finds them.
# Joint compliance (1/k times torque), the arm's own weight, periodic drive errors, thermal expansion. Each gives the
# tool's displacement per unit of its coefficients, in world axes. SI units.


SHOWN = 1e-3
"""Relative cut-off of singular values in the fit of moments; combinations of moments below it stay at zero."""


ORDER_TOLERANCE = 0.25
"""Scale of the error in a harmonic's order, cycles per turn."""


@dataclass(frozen=True)
class ComplianceTerm(JointTerm):
    """Joint compliance: deflection dq = c tau under torque tau, with c = 1/k per joint (rad/(N*m) or m/N).

    The torque is the measured one if the data contain torques. Otherwise it is the gravity torque from ``moments``, the
    links' masses and first moments times g. These are fitted to measured torques, or are those of the arm's file.

    Attributes:
        joints: Indices of the compliant joints, from 0.
        weight: The gravity term that defines the moments; None without moments.
        moments: Value of each moment ``(k,)``, N or N*m, from `GravityTerm.weighed` or `GravityTerm.with_masses`.
    """

    joints: tuple[int, ...]
    weight: GravityTerm | None = None
    moments: tuple[float, ...] = ()

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Names of the coefficients, with the joint's number from 1, such as compliance1."""
        return tuple(f"compliance{i + 1}" for i in self.joints)

    def tolerances(self, geometry: Geometry) -> Array:
        """Scale of each compliance: 1 mrad at 10 N*m, or 1 mm at 100 N."""
        return np.array([1e-5 if geometry.prismatic[i] else 1e-4 for i in self.joints])

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return the compliant joints, and their torques ``(N, k)``, N*m or N."""
        return self.joints, self.torques(geometry, joints, conditions)[:, self.joints]

    def torques(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Return the measured torques of all joints ``(N, n)``, or the gravity torques if none were measured.

        Raises:
            InputError: If there are neither measured torques nor moments.
        """
        if conditions.torque is not None:
            return conditions.torque
        if self.weight is None:
            raise InputError("joint compliance needs measured torques; give a torque column")
        by_moment = self.weight.torques(geometry, joints, conditions) * np.array(self.moments)
        return np.asarray(by_moment @ (self.weight.owners(geometry)[:, None] == np.arange(geometry.joints)))


@dataclass(frozen=True)
class PeriodicTerm(JointTerm):
    """Periodic errors of the joints' drives: each harmonic adds s sin(order q) + c cos(order q) to its joint q.

    The coefficients are s and c of each harmonic, rad or m.

    Attributes:
        joints: The joint of each harmonic, from 0; a joint may have several harmonics.
        orders: Order of each harmonic. For a revolute joint it is in cycles per turn, not always a whole number. For a
            prismatic joint it is 2 pi over the period, 1/m.
        order_std: Standard uncertainties of the orders; empty if the orders were given rather than estimated.
    """

    joints: tuple[int, ...]
    orders: tuple[float, ...]
    order_std: tuple[float, ...] = ()

    def some(self, numbers: NDArray[np.int64]) -> PeriodicTerm:
        """Return a term with only the harmonics at these indices, from 0, and without the orders' uncertainties."""
        return PeriodicTerm(tuple(self.joints[i] for i in numbers), tuple(self.orders[i] for i in numbers))

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Names of the coefficients, such as periodic1_13.5_sin: joint (counted from 1), order, and sine or cosine."""
        pairs = zip(self.joints, self.orders, strict=True)
        return tuple(f"periodic{i + 1}_{order:.5g}_{part}" for i, order in pairs for part in ("sin", "cos"))

    def tolerances(self, geometry: Geometry) -> Array:
        """Scale of each coefficient: 1 mm for a prismatic joint, 3 mrad / order (equal slopes) for a revolute one."""
        pairs = zip(self.joints, self.orders, strict=True)
        return 1e-3 * np.repeat([1.0 if geometry.prismatic[i] else 3.0 / order for i, order in pairs], 2)

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return each coefficient's joint, and the sine and cosine of each harmonic ``(N, k)``."""
        angle = joints[:, self.joints] * np.array(self.orders)
        return np.repeat(self.joints, 2).tolist(), np.stack([np.sin(angle), np.cos(angle)], -1).reshape(len(joints), -1)


@dataclass(frozen=True)
class OrderTerm(JointTerm):
    """A term whose coefficients are changes of the orders of a `PeriodicTerm`, used to refine these orders.

    The tool displacement per unit change of an order is J q (s cos(order q) - c sin(order q)). J is the joint Jacobian,
    and s and c are the harmonic's coefficients.

    Attributes:
        wave: The term that has the harmonics.
        sines: Sine coefficient of each harmonic, rad or m.
        cosines: Cosine coefficient of each harmonic, rad or m.
    """

    wave: PeriodicTerm
    sines: tuple[float, ...]
    cosines: tuple[float, ...]

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Names of the order corrections, one per harmonic, numbered from 0: order0, order1."""
        return tuple(f"order{i}" for i in range(len(self.wave.orders)))

    def tolerances(self, geometry: Geometry) -> Array:
        """Scale of each order's error: half the step of the grid on which orders are searched."""
        return np.full(len(self.wave.orders), ORDER_TOLERANCE)

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return each harmonic's joint, and the joint's motion per unit change of the order ``(N, k)``, rad or m."""
        turned = joints[:, self.wave.joints]
        angle = turned * np.array(self.wave.orders)
        slope = np.array(self.sines) * np.cos(angle) - np.array(self.cosines) * np.sin(angle)
        return self.wave.joints, turned * slope


@dataclass(frozen=True)
class ThermalTerm(Term):
    """Thermal expansion: the lengths of all links grow with temperature by one common coefficient, 1/K."""

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """The one coefficient's name, "thermal"."""
        return ("thermal",)

    def tolerances(self, geometry: Geometry) -> Array:
        """Scale of the coefficient: 1 mm on 1 m at 20 K."""
        return np.array([5e-5])

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Return the pose displacement per unit of the coefficient ``(N, 6, 1)``, m and rad, world axes.

        It is the sum over all link lengths of the Jacobian's column times the length, times the temperature.

        Raises:
            InputError: If no temperatures are recorded.
        """
        if conditions.temperature is None:
            raise InputError("thermal expansion needs temperatures; give a temperature column")
        n = geometry.links
        jacobian = parameter_jacobian(geometry, joints)
        travel = joints if geometry.coupling is None else np.stack(geometry.coupling.displacements(list(joints.T)), 1)
        along_z = geometry.d + travel * np.array(geometry.slides)
        lengths = np.concatenate([np.broadcast_to(geometry.a, travel.shape), along_z], 1)
        by_length = jacobian[..., np.r_[n : 2 * n, 3 * n : 4 * n]]
        return np.asarray(np.einsum("nip,np->ni", by_length, lengths * conditions.temperature[:, None])[..., None])


@dataclass(frozen=True)
class GravityTerm(JointTerm):
    """Joint deflection under the arm's own weight, with unknown masses and stiffnesses.

    The torque tau on a joint is linear in the mass m and the first moments m r of every link that the joint carries. So
    the deflection c tau is linear in c m and c m r. Each pair of a joint and a moment has one coefficient (rad/m, or m
    for prismatic joints). Most coefficients are redundant, and the solver's rank decision drops them. A recorded
    payload adds one more coefficient per joint (rad/(kg*m)), for the payload's torque.

    Attributes:
        joints: Indices of the compliant joints, from 0.
        up: Direction opposite to gravity, in the axes of frame 0.
        payload: Whether the payload has coefficients of its own.
    """

    joints: tuple[int, ...]
    up: tuple[float, float, float]
    payload: bool = False

    def moments(self, geometry: Geometry) -> tuple[tuple[int, int, str], ...]:
        """Return the joint, link (indices from 0) and moment of each coefficient.

        Moment "m" is the mass at the link's origin; "x", "y" and "z" are the link's first moments; "p" is the payload
        at the tool.
        """
        return _moments(self, geometry)

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Names of the coefficients, such as gravity2_3x: joint and link (both counted from 1), and moment."""
        return tuple(f"gravity{i + 1}_{j + 1}{moment}" for i, j, moment in self.moments(geometry))

    def tolerances(self, geometry: Geometry) -> Array:
        """Scale of each coefficient: 1e-3, that is 1 mrad at 1 m, or 1 mm for a prismatic joint."""
        return np.full(len(self.moments(geometry)), 1e-3)

    def owners(self, geometry: Geometry) -> NDArray[np.int64]:
        """The joint that each coefficient belongs to ``(k,)``, from 0."""
        return np.array([i for i, _, _ in self.moments(geometry)])

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return each coefficient's joint ``(k,)``, and the torque on it per unit of the moment ``(N, k)``."""
        return self.owners(geometry).tolist(), self.torques(geometry, joints, conditions)

    def torques(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Return the torque ``(N, k)`` of each coefficient's moment on its joint, per unit of the moment.

        Raises:
            InputError: If the term has payload columns and no payloads are recorded.
        """
        if self.payload and conditions.payload is None:
            raise InputError("the payload's deflection needs payloads; give a payload column")
        geometry = geometry if geometry.tree is None else geometry.between(-1, geometry.tree.target)
        chain = chain_of(geometry)
        links = frames(np, chain, split_joints(geometry.joints, joints))
        # Axes and origin ``(4, 3, N)`` of each link, and of the tool: of what is carried. About an axis z a lever's
        # weight turns by z . (lever x up) = lever . (up x z).
        driven = (*links[1:], attach(chain.hand(links), chain.tool))
        components = np.empty((len(driven), 12, len(joints)))
        for frame, numbers in zip(driven, components, strict=True):
            for component, number in enumerate(frame):
                numbers[component] = number
        placed = components.reshape(-1, 4, 3, len(joints))
        up = geometry.base.rotation @ np.array(self.up)
        about = np.cross(up, placed[:, 2], axisb=1, axisc=1)
        torques = []
        for i, j, moment in self.moments(geometry):
            torque = np.zeros(len(joints))
            for k, ratio in geometry.links_of(i):
                if not geometry.carries(k, geometry.hand if moment == "p" else j):
                    continue
                if geometry.slides[k]:
                    torque -= ratio * (up @ placed[k][2]) * (moment in "mp")
                else:
                    lever = placed[j][3] - placed[k][3] if moment in "mp" else placed[j]["xyz".index(moment)]
                    torque -= ratio * np.einsum("in,in->n", lever, about[k])
            torques.append(torque * np.asarray(conditions.payload) if moment == "p" else torque)
        return np.stack(torques).T

    def weighed(self, geometry: Geometry, joints: Array, conditions: Conditions) -> ComplianceTerm:
        """Return a compliance term for these joints, with the moments fitted to the measured torques.

        The term can then predict torques where none are measured, for instance at targets. Moments that the poses do
        not determine stay small.
        """
        assert conditions.torque is not None
        columns, owners = self.torques(geometry, joints, conditions), self.owners(geometry)
        moments = np.zeros(len(owners))
        for i in self.joints:
            moments[owners == i] = np.linalg.lstsq(columns[:, owners == i], conditions.torque[:, i], rcond=SHOWN)[0]
        return ComplianceTerm(self.joints, self, tuple(moments.tolist()))

    def with_masses(self, geometry: Geometry, load: Load) -> ComplianceTerm:
        """Return a compliance term for these joints under the weight of known masses.

        Args:
            geometry: The arm.
            load: Its masses, one entry per link.
        """
        moments = []
        for i, j, moment in self.moments(geometry):
            driven = [link for link, _ in geometry.links_of(i)]
            if moment == "p":
                value = 1.0
            elif moment != "m":
                value = load.mass[j] * load.centre[j]["xyz".index(moment)]
            elif all(geometry.slides[link] for link in driven):  # all that it carries, and the next slide does not
                last = [max((k for k in driven if geometry.carries(k, o)), default=-1) for o in range(geometry.links)]
                value = sum(mass for mass, link in zip(load.mass, last, strict=True) if link == j)
            else:
                value = load.mass[j]
            moments.append(GRAVITY * value)
        return ComplianceTerm(self.joints, self, tuple(moments))


def weight_of(geometry: Geometry, payload: bool = False) -> GravityTerm:
    """Return the gravity term of all joints; the base of ``geometry`` defines which direction is up.

    Args:
        geometry: The arm.
        payload: Whether the payload has coefficients of its own.
    """
    up = geometry.base.rotation.T @ np.array([0.0, 0.0, 1.0])
    return GravityTerm(tuple(range(geometry.joints)), (float(up[0]), float(up[1]), float(up[2])), payload)


@lru_cache(maxsize=16)  # asked for at every step of a corrected arm
def _moments(term: GravityTerm, geometry: Geometry) -> tuple[tuple[int, int, str], ...]:
    moments: list[tuple[int, int, str]] = []
    for i in term.joints:
        driven = [link for link, _ in geometry.links_of(i)]
        if all(geometry.slides[link] for link in driven):
            moments += [(i, link, "m") for link in driven]
        else:
            links = [j for j, ratio in enumerate(geometry.ratios) if ratio and geometry.carries(driven[0], j)]
            moments += [(i, j, moment) for j in links for moment in "mxyz" if (j, moment) != (driven[0], "m")]
        if term.payload:
            moments.append((i, geometry.links, "p"))
    return tuple(moments)


KINDS: dict[str, type] = {
    "compliance": ComplianceTerm,
    "gravity": GravityTerm,
    "periodic": PeriodicTerm,
    "thermal": ThermalTerm,
}
"""Classes of terms, by the names used in files."""


def kind_of_term(term: Term) -> str:
    """The name of a term's kind."""
    return next(name for name, kind in KINDS.items() if isinstance(term, kind))


def specification(term: Any) -> dict[str, Any]:
    """Return a term as JSON content, from which `term_from` rebuilds it."""
    return {"kind": kind_of_term(term), **asdict(term)}


def term_from(content: Mapping[str, Any]) -> Term:
    """Rebuild a term from its `specification`, as stored in a calibration file.

    Raises:
        InputError: If the content is from an older version and has link masses, which this version does not support.
    """
    numbers = _tuples(content)
    kind = KINDS[numbers.pop("kind")]
    if numbers.pop("load", None) is not None:  # null in nearly all older files
        raise InputError("its compliance has link masses of its own, which pickenv no longer knows; calibrate anew")
    if numbers.get("weight"):
        numbers["weight"] = GravityTerm(**numbers["weight"])
    term: Term = kind(**numbers)
    return term


def _tuples(value: Any) -> Any:
    """Copy of a JSON value with every list, at any depth, turned into a tuple."""
    if isinstance(value, Mapping):
        return {key: _tuples(part) for key, part in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value


# The error model: which parameters of a geometry are identified, and on what scale. Complete for any serial chain:
# four modified DH parameters per joint, Hayati's beta where consecutive axes are parallel, base and tool pose. Rows
# are weighted by the measurement's uncertainty and columns by a parameter's tolerance, because rank and redundancy
# are meaningless in mixed units (Qiao 2026 digest, fact 2).


LENGTH_TOLERANCE = 1e-3
"""Scale of a length's deviation, m."""

ANGLE_TOLERANCE = 1e-3
"""Scale of an angle's deviation, rad (0.057 deg)."""


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """The parameters to identify.

    Attributes:
        columns: Indices into the arm's ``parameter_names`` ``(P,)``, in order of preference: of redundant parameters,
            the earlier one is kept.
        names: The parameters' names.
        tolerance: Scale of each parameter's deviation ``(P,)``, m or rad.
    """

    columns: NDArray[np.int64]
    names: tuple[str, ...]
    tolerance: Array

    def some(self, kept: NDArray[np.bool_]) -> ErrorModel:
        """Return the model of the parameters for which ``kept`` ``(P,)`` is True."""
        names = tuple(name for name, keep in zip(self.names, kept, strict=True) if keep)
        return ErrorModel(self.columns[kept], names, self.tolerance[kept])

    def joined(self, other: ErrorModel) -> ErrorModel:
        """Return a model of these parameters, followed by those of another model."""
        columns, tolerance = np.r_[self.columns, other.columns], np.r_[self.tolerance, other.tolerance]
        return ErrorModel(columns, self.names + other.names, tolerance)


def link_model(geometry: Geometry) -> ErrorModel:
    """Return the model of Qiao 2026: four MDH parameters of every joint, with base and tool known (eqs (7)-(8))."""
    return _model(geometry, _link_names(geometry))


def complete_model(geometry: Geometry) -> ErrorModel:
    """Return a model that is complete for any serial chain.

    It has base and tool pose, the MDH parameters, and Hayati's beta between parallel axes.
    """
    names = geometry.parameter_names
    frames = [name for name in names if name.startswith(("base_", "tool_"))]
    links = _link_names(geometry)
    betas = [f"beta{i}" for i in range(1, geometry.links) if abs(np.sin(geometry.alpha[i])) < NEARLY_PARALLEL]
    return _model(geometry, frames + links + betas)


def frames_model(geometry: Geometry) -> ErrorModel:
    """Return the model of base and tool pose alone.

    They are fitted before the error of a nominal arm is computed.
    """
    return _model(geometry, [name for name in geometry.parameter_names if name.startswith(("base_", "tool_"))])


def joint_zeros_model(geometry: Geometry) -> ErrorModel:
    """Return the model of the joint zeros alone: theta of every link that rotates, d of every link that slides."""
    return _model(geometry, [f"{'d' if slides else 'theta'}{i + 1}" for i, slides in enumerate(geometry.slides)])


def with_terms(model: ErrorModel, arm: ArmModel) -> ErrorModel:
    """Return a model of the given parameters, followed by the coefficients of the arm's terms."""
    count = len(arm.geometry.parameter_names)
    columns = np.arange(count, len(arm.parameter_names))
    return model.joined(ErrorModel(columns, arm.parameter_names[count:], arm.term_tolerances))


def _link_names(geometry: Geometry) -> list[str]:
    """Names of the MDH parameters in the order alpha, a, d, theta: lengths come before joint angles.

    Where an offset and angles are redundant (d3 = (theta2 - theta1) / a1 of the picking arm), the offset is thus kept:
    a length expresses a finite deviation exactly, angles only to first order.
    """
    kinds = ("alpha", "a", "d", "theta")
    return [name for kind in kinds for name in geometry.parameter_names if name.rstrip("0123456789") == kind]


def _model(geometry: Geometry, names: list[str]) -> ErrorModel:
    index = {name: i for i, name in enumerate(geometry.parameter_names)}
    columns = np.array([index[name] for name in names])
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
    """Return the parameters to identify for the arm of this name.

    For the pose carrier (`CARRIER`) they are base and tool pose. For every other arm they are the link parameters and,
    unless ``known_frames``, base and tool pose.
    """
    if arm == CARRIER:
        return frames_model(nominal)
    return link_model(nominal) if known_frames else complete_model(nominal)


def joints_of_finished_poses(poses: Pose) -> Array:
    """Return the joints ``(N, 6)``, m and rad, at which the tool of `pose_carrier` has the poses ``poses`` ``(N,)``."""
    geometry = pose_carrier().nominal
    zero = forward(geometry, np.zeros(6))
    along = np.stack([forward(geometry, row).position for row in np.eye(6)[:3]], axis=1)
    slides = np.linalg.solve(along, poses.position.T).T
    angles = Rotation.from_matrix(zero.rotation.T @ poses.rotation).as_euler("ZYZ")
    return np.concatenate([slides, angles * (1.0, -1.0, 1.0)], axis=1)
