"""Parametric terms of an arm model: compliance, bending, weight, periodic drive errors and thermal expansion.

Each term describes an effect that a geometry cannot describe. It gives the tool's displacement per unit of its
coefficients, in world axes. The displacement is linear in the coefficients, so least squares can fit them. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Array, Geometry, Load, parameter_jacobian
from pickenv.arm.kinematics.forward import attach, chain_of, frames, split_joints
from pickenv.base import GRAVITY, InputError
from pickenv.calibration.model.arm_model import Conditions, JointTerm, Term

SHOWN = 1e-3
"""Relative cut-off of singular values in the fit of moments; combinations of moments below it stay at zero."""


ORDER_TOLERANCE = 0.25
"""Scale of the error in a harmonic's order, cycles per turn."""


@dataclass(frozen=True)
class ComplianceTerm(JointTerm):
    """Joint compliance: deflection dq = c tau under torque tau, with c = 1/k per joint (rad/(N*m) or m/N).

    The torque is the measured torque if the data contain torques. Otherwise it is the gravity torque from ``moments``,
    the links' masses and first moments times g. The moments are fitted to measured torques, or come from the masses in
    the arm's file.

    Attributes:
        joints: Indices of the compliant joints, from 0.
        weight: The gravity term that defines the moments; None without moments.
        moments: Value of each moment ``(k,)``, N or N*m, from `GravityTerm.weighed` or `GravityTerm.with_masses`.
    """

    joints: tuple[int, ...]
    weight: GravityTerm | None = None
    moments: tuple[float, ...] = ()

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Return the names of the coefficients, with the joint's number from 1, such as compliance1."""
        return tuple(f"compliance{i + 1}" for i in self.joints)

    def tolerances(self, geometry: Geometry) -> Array:
        """Return the scale of each compliance: 1 mrad at 10 N*m, or 1 mm at 100 N."""
        return np.array([1e-5 if geometry.prismatic[i] else 1e-4 for i in self.joints])

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return the indices of the compliant joints, from 0, and their torques ``(N, k)``, N*m or N."""
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
    """Periodic errors of the joints' drives: each harmonic adds s sin(order q) + c cos(order q) to its joint's value q.

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
        """Return a term with the harmonics at these indices (from 0) alone. Each keeps its order, not `order_std`."""
        return PeriodicTerm(tuple(self.joints[i] for i in numbers), tuple(self.orders[i] for i in numbers))

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Return the coefficients' names, such as periodic1_13.5_sin: joint (from 1), order, and sine or cosine."""
        pairs = zip(self.joints, self.orders, strict=True)
        return tuple(f"periodic{i + 1}_{order:.5g}_{part}" for i, order in pairs for part in ("sin", "cos"))

    def tolerances(self, geometry: Geometry) -> Array:
        """Return each coefficient's scale: 1 mm if the joint is prismatic, else 3 mrad / order (equal slopes)."""
        pairs = zip(self.joints, self.orders, strict=True)
        return 1e-3 * np.repeat([1.0 if geometry.prismatic[i] else 3.0 / order for i, order in pairs], 2)

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return each coefficient's joint (index from 0), and the sine and cosine of each harmonic ``(N, k)``."""
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
        """Return the names of the order corrections, one per harmonic, numbered from 0: order0, order1."""
        return tuple(f"order{i}" for i in range(len(self.wave.orders)))

    def tolerances(self, geometry: Geometry) -> Array:
        """Return the scale of each order's error: half the step of the coarse grid on which orders are searched."""
        return np.full(len(self.wave.orders), ORDER_TOLERANCE)

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return each harmonic's joint (from 0), and its motion per unit change of the order ``(N, k)``, rad or m."""
        turned = joints[:, self.wave.joints]
        angle = turned * np.array(self.wave.orders)
        slope = np.array(self.sines) * np.cos(angle) - np.array(self.cosines) * np.sin(angle)
        return self.wave.joints, turned * slope


@dataclass(frozen=True)
class ThermalTerm(Term):
    """Thermal expansion: the lengths of all links grow with temperature by one common coefficient, 1/K."""

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Return the name of the only coefficient, "thermal"."""
        return ("thermal",)

    def tolerances(self, geometry: Geometry) -> Array:
        """Return the scale of the coefficient: 1 mm on 1 m at 20 K."""
        return np.array([5e-5])

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Return the pose displacement per unit of the coefficient ``(N, 6, 1)``, m and rad, world axes.

        For each link length, the length is multiplied by its column of the Jacobian. The displacement is the sum of
        these products, times the temperature.

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
    for prismatic joints). Most coefficients are redundant: their priors keep them small, or the solver's rank decision
    drops them. A recorded payload adds one more coefficient per joint (rad/(kg*m)), for the payload's torque.

    Attributes:
        joints: Indices of the compliant joints, from 0.
        up: Direction opposite to gravity, in the axes of frame 0.
        payload: Whether the payload has separate coefficients.
    """

    joints: tuple[int, ...]
    up: tuple[float, float, float]
    payload: bool = False

    @lru_cache(maxsize=16)  # noqa: B019 (asked for at every step of a corrected arm)
    def moments(self, geometry: Geometry) -> tuple[tuple[int, int, str], ...]:
        """Return the joint, link (indices from 0) and moment of each coefficient.

        Moment "m" is the mass at the link's origin; "x", "y" and "z" are the link's first moments; "p" is the payload
        at the tool.
        """
        moments: list[tuple[int, int, str]] = []
        for i in self.joints:
            driven = [link for link, _ in geometry.links_of(i)]
            if all(geometry.slides[link] for link in driven):
                moments += [(i, link, "m") for link in driven]
            else:
                links = [j for j, ratio in enumerate(geometry.ratios) if ratio and geometry.carries(driven[0], j)]
                moments += [(i, j, moment) for j in links for moment in "mxyz" if (j, moment) != (driven[0], "m")]
            if self.payload:
                moments.append((i, geometry.links, "p"))
        return tuple(moments)

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Return the coefficients' names, such as gravity2_3x: joint and link (both counted from 1), and moment."""
        return tuple(f"gravity{i + 1}_{j + 1}{moment}" for i, j, moment in self.moments(geometry))

    def tolerances(self, geometry: Geometry) -> Array:
        """Return the scale of each coefficient: 1e-3, that is 1 mrad at 1 m, or 1 mm for a prismatic joint."""
        return np.full(len(self.moments(geometry)), 1e-3)

    def owners(self, geometry: Geometry) -> NDArray[np.int64]:
        """Return the index, from 0, of the joint that each coefficient belongs to ``(k,)``."""
        return np.array([i for i, _, _ in self.moments(geometry)])

    def steps(self, geometry: Geometry, joints: Array, conditions: Conditions) -> tuple[Sequence[int], Array]:
        """Return each coefficient's joint (from 0), and the torque on that joint per unit of the moment ``(N, k)``."""
        return self.owners(geometry).tolist(), self.torques(geometry, joints, conditions)

    def torques(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Return the torque ``(N, k)`` of each coefficient's moment on its joint, per unit of the moment.

        Raises:
            InputError: If the term has payload columns and no payloads are recorded.
        """
        if self.payload and conditions.payload is None:
            raise InputError("the payload's deflection needs payloads; give a payload column")
        # Of what is carried. About an axis z a lever's weight turns by z . (lever x up) = lever . (up x z).
        placed = _placed(_from_base(geometry), joints)
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
        """Return a compliance term for the same joints, with the links' moments fitted to the measured torques.

        The compliance term predicts torques where none are measured, for instance at targets. Moments that the poses do
        not determine stay small.

        Args:
            geometry: The arm.
            joints: Joints ``(N, n)``, rad or m, at which the torques were measured.
            conditions: Conditions with measured torques.
        """
        assert conditions.torque is not None
        columns, owners = self.torques(geometry, joints, conditions), self.owners(geometry)
        moments = np.zeros(len(owners))
        for i in self.joints:
            moments[owners == i] = np.linalg.lstsq(columns[:, owners == i], conditions.torque[:, i], rcond=SHOWN)[0]
        return ComplianceTerm(self.joints, self, tuple(moments.tolist()))

    def with_masses(self, geometry: Geometry, load: Load) -> ComplianceTerm:
        """Return a compliance term for the same joints under the weight of known masses.

        Args:
            geometry: The arm.
            load: Masses and centres of mass of the arm's links, one entry per link.
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


def _from_base(geometry: Geometry) -> Geometry:
    """Return the geometry with poses relative to frame 0, where the direction up is known; a chain is unchanged."""
    return geometry if geometry.tree is None else geometry.between(-1, geometry.tree.target)


def _placed(geometry: Geometry, joints: Array) -> Array:
    """Return the axes x, y, z and the origin, m, of each link and of the tool ``(L + 1, 4, 3, N)``, in world axes."""
    chain = chain_of(geometry)
    links = frames(np, chain, split_joints(geometry.joints, joints))
    components = np.empty((len(links), 12, len(joints)))
    for frame, numbers in zip((*links[1:], attach(chain.hand(links), chain.tool)), components, strict=True):
        for component, number in enumerate(frame):
            numbers[component] = number
    return components.reshape(-1, 4, 3, len(joints))


@dataclass(frozen=True)
class BendingTerm(Term):
    """Deflection of joints across their axes, about x and y of their links' frames, under the weight of known masses.

    Each link has three coefficients, rad/(N*m): xx, yy and xy of a symmetric matrix from torques to rotations at the
    link's joint. The DH table decides which direction across the axis is x, so xy cannot be left out. A recorded
    payload is not part of the masses.

    Attributes:
        links: Indices, from 0, of the links whose joints yield.
        up: Direction opposite to gravity, in the axes of frame 0.
        mass: Mass of each link ``(L,)``, kg.
        centre: Centre of mass of each link in its frame ``(L, 3)``, m.
        pivots: Position along each link's axis, from the link's frame, at which it is joined to its parent ``(L,)``, m.
    """

    links: tuple[int, ...]
    up: tuple[float, float, float]
    mass: tuple[float, ...]
    centre: tuple[tuple[float, float, float], ...]
    pivots: tuple[float, ...]

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Return the names of the coefficients, such as bending2_xy: link (counted from 1) and axes."""
        return tuple(f"bending{i + 1}_{axes}" for i in self.links for axes in ("xx", "yy", "xy"))

    def tolerances(self, geometry: Geometry) -> Array:
        """Return the scale of each coefficient: 1 mrad at 10 N*m."""
        return np.full(len(self.names(geometry)), 1e-4)

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Return the pose displacement per unit of each coefficient ``(N, 6, k)``, m and rad, world axes."""
        placed, moved = _placed(_from_base(geometry), joints), _placed(geometry, joints)
        weights = np.array(self.mass)[:, None, None]
        moments = weights * (placed[:-1, 3] + np.einsum("lacn,la->lcn", placed[:-1, :3], np.array(self.centre)))
        up = geometry.base.rotation @ np.array(self.up)
        columns = []
        for i in self.links:
            carried = [j for j, ratio in enumerate(geometry.ratios) if ratio and geometry.carries(i, j)]
            pivot, point = (where[i, 3] + self.pivots[i] * where[i, 2] for where in (placed, moved))
            lever = moments[carried].sum(axis=0) - weights[carried].sum() * pivot
            across = np.cross(up, placed[i, :2], axisb=1, axisc=1)
            x, y = -GRAVITY * np.einsum("cn,acn->an", lever, across)  # torques
            arms = np.cross(moved[i, :2], moved[-1, 3] - point, axisa=1, axisb=0, axisc=1)
            turn_x, turn_y = geometry.senses[i] * np.concatenate([arms, moved[i, :2]], axis=1)
            columns += [turn_x * x, turn_y * y, turn_x * y + turn_y * x]
        return np.moveaxis(np.array(columns), -1, 0).swapaxes(1, 2)


def bending_of(arm: Arm, links: Sequence[int] | None = None) -> BendingTerm:
    """Return the bending term of an arm whose masses are known.

    Args:
        arm: The arm.
        links: Indices, from 0, of the links whose joints yield; None for all links that move.
    """
    assert arm.load is not None
    which = np.flatnonzero(arm.nominal.ratios) if links is None else np.array(links)
    pivots = np.zeros(arm.nominal.links) if arm.pivots is None else arm.pivots
    masses = arm.load.mass, arm.load.centre
    return BendingTerm(tuple(which.tolist()), weight_of(arm.nominal).up, *masses, tuple(pivots.tolist()))


def weight_of(geometry: Geometry, payload: bool = False) -> GravityTerm:
    """Return the gravity term of all joints.

    Args:
        geometry: The arm, whose base defines which direction is up.
        payload: Whether the payload has separate coefficients.
    """
    up = geometry.base.rotation.T @ np.array([0.0, 0.0, 1.0])
    return GravityTerm(tuple(range(geometry.joints)), (float(up[0]), float(up[1]), float(up[2])), payload)


KINDS: dict[str, type] = {
    "bending": BendingTerm,
    "compliance": ComplianceTerm,
    "gravity": GravityTerm,
    "periodic": PeriodicTerm,
    "thermal": ThermalTerm,
}
"""Classes of terms, by the names used in files."""


def kind_of_term(term: Term) -> str:
    """Return the name of a term's kind, a key of `KINDS`."""
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
    if numbers.pop("load", None) is not None:  # null in nearly all older files
        raise InputError("its compliance has link masses of its own, which pickenv no longer knows; calibrate anew")
    if numbers.get("weight"):
        numbers["weight"] = GravityTerm(**numbers["weight"])
    term: Term = KINDS[numbers.pop("kind")](**numbers)
    return term


def _tuples(value: Any) -> Any:
    """Return a copy of a JSON value with every list, at any depth, turned into a tuple."""
    if isinstance(value, Mapping):
        return {key: _tuples(part) for key, part in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
