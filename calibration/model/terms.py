"""Parametric terms for what geometry cannot say, each linear in its coefficients, so that least squares finds them.

Joint compliance (1/k times torque), boom bending, prismatic lead and periodic drive errors, thermal expansion. Each
gives the tool's displacement per unit of its coefficients, in world axes. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Geometry, forward, joint_jacobian, parameter_jacobian
from pickenv.arm.effects.structure import Load, gravity_torques
from pickenv.arm.kinematics.forward import chain_of, frames, split_joints
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import Conditions, Term
from pickenv.errors import InputError

SHOWN = 1e-3
"""Combinations of moments that poses show less than this share of the clearest are left at zero."""


@dataclass(frozen=True)
class ComplianceTerm:
    """Joints yield: dq = c tau, one coefficient c = 1/k per joint (rad/(N*m) or m/N).

    The torque is the measured one where the data hold it, else gravity's: from ``load`` and the payload recorded, or
    from ``moments``, what the measured torques said of the arm's weight.

    Attributes:
        joints: Indices of the joints that may yield, from 0.
        load: Link masses, or None.
        weight: Says which moments those are, or None.
        moments: Torque per unit of each ``(k,)``, fitted to measured torques by `weighed`.
    """

    joints: tuple[int, ...]
    load: Load | None
    weight: GravityTerm | None = None
    moments: tuple[float, ...] = ()

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Names count as the joints do: compliance1, compliance2."""
        return tuple(f"compliance{i + 1}" for i in self.joints)

    def tolerances(self, geometry: Geometry) -> Array:
        """1 mrad at 10 N*m, 1 mm at 100 N."""
        return np.array([1e-5 if geometry.prismatic[i] else 1e-4 for i in self.joints])

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """The joint Jacobian's columns times the torques."""
        torque = self.torques(geometry, joints, conditions)
        chosen = list(self.joints)
        return np.asarray(joint_jacobian(geometry, joints)[..., chosen] * torque[:, None, chosen])

    def torques(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Measured torques, or gravity's ``(N, n)``."""
        if conditions.torque is not None:
            return conditions.torque
        if self.load is None and self.weight is not None:
            by_moment = self.weight.torques(geometry, joints, conditions) * np.array(self.moments)
            return np.asarray(by_moment @ (self.weight.owners(geometry)[:, None] == np.arange(geometry.joints)))
        if self.load is None:
            raise InputError("joint compliance needs measured torques or link masses; give a torque column or a load")
        payload = self.load.payload if conditions.payload is None else conditions.payload
        chain = chain_of(geometry)
        found = frames(np, chain, split_joints(geometry.joints, joints))
        load = Load(self.load.mass, self.load.centre, payload)
        torque = np.stack(np.broadcast_arrays(*gravity_torques(chain, found, load), joints[:, 0])[:-1], -1)
        return torque if geometry.coupling is None else geometry.coupling.gathered(torque, geometry.joints)


@dataclass(frozen=True)
class BendingTerm:
    """A telescopic boom bends: coefficients F/EI for the tip load and w/EI for its own weight, both 1/m^2 and 1/m^3.

    Attributes:
        joint: Index of the prismatic joint whose link is the boom.
        length: Free length at zero displacement, m.
        end_mass: Mass at the tip without payload, kg; with a recorded payload the tip load scales with the sum.
    """

    joint: int
    length: float
    end_mass: float = 0.0

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Tip and own weight."""
        return (f"bending{self.joint + 1}_tip", f"bending{self.joint + 1}_own")

    def tolerances(self, geometry: Geometry) -> Array:
        """1 mm at 1 m."""
        return np.array([3e-3, 8e-3])

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Sag and slope of a cantilever under gravity across the boom, carried to the tool."""
        if geometry.coupling is not None:
            raise InputError("the bending of a boom needs an arm whose joints move one link each; leave the term out")
        chain = chain_of(geometry)
        found = frames(np, chain, split_joints(geometry.joints, joints))
        tip, tool = np.stack(found[self.joint + 1][9:], -1), forward(geometry, joints).position
        z = np.stack(np.broadcast_arrays(*found[self.joint + 1][6:9], joints[:, 0])[:3], -1)
        across = z * z[:, 2:] - np.array([0.0, 0.0, 1.0])
        turn = np.stack([-z[:, 1], z[:, 0], np.zeros(len(z))], -1)
        length = (joints[:, self.joint] + self.length)[:, None]
        share = np.ones((len(joints), 1))
        if conditions.payload is not None and self.end_mass > 0:
            share = (1.0 + conditions.payload / self.end_mass)[:, None]
        lever = tool - tip
        columns = []
        for sag, slope in (
            (share * length**3 / 3, share * length**2 / 2),
            (length**4 / 8, length**3 / 6),
        ):
            columns.append(np.concatenate([sag * across + np.cross(slope * turn, lever), slope * turn], -1))
        return np.stack(columns, -1)


@dataclass(frozen=True)
class LeadTerm:
    """Drives whose travel is off by a constant share: one coefficient (m/m or rad/rad) per joint named."""

    joints: tuple[int, ...]

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Names count as the joints do: lead2, lead3."""
        return tuple(f"lead{i + 1}" for i in self.joints)

    def tolerances(self, geometry: Geometry) -> Array:
        """1 mm per metre."""
        return np.full(len(self.joints), 1e-3)

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """The joint Jacobian's columns times the joints."""
        chosen = list(self.joints)
        return np.asarray(joint_jacobian(geometry, joints)[..., chosen] * joints[:, None, chosen])


@dataclass(frozen=True)
class PeriodicTerm:
    """Drives' periodic errors: sine and cosine coefficients (rad or m) of sin(order q) and cos(order q).

    Attributes:
        joints: The joint of each harmonic, from 0; one may have several.
        orders: The order of each: cycles per turn of a revolute joint, also fractional; 2 pi over the period (1/m) of a
            prismatic one.
        order_std: Standard uncertainties of the orders; empty where they were given, not found.
    """

    joints: tuple[int, ...]
    orders: tuple[float, ...]
    order_std: tuple[float, ...] = ()

    def some(self, numbers: NDArray[np.int64]) -> PeriodicTerm:
        """Some of the harmonics, counted from 0."""
        return PeriodicTerm(tuple(self.joints[i] for i in numbers), tuple(self.orders[i] for i in numbers))

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Joint, order and part: periodic1_13.5_sin."""
        pairs = zip(self.joints, self.orders, strict=True)
        return tuple(f"periodic{i + 1}_{order:.5g}_{part}" for i, order in pairs for part in ("sin", "cos"))

    def tolerances(self, geometry: Geometry) -> Array:
        """1 mm, or 3 mrad at one cycle per turn and less for higher orders: equally steep."""
        pairs = zip(self.joints, self.orders, strict=True)
        return 1e-3 * np.repeat([1.0 if geometry.prismatic[i] else 3.0 / order for i, order in pairs], 2)

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """The joint Jacobian's columns times sine and cosine."""
        chosen = list(self.joints)
        angle = joints[:, chosen] * np.array(self.orders)
        wave = np.stack([np.sin(angle), np.cos(angle)], -1)
        moved = np.asarray(joint_jacobian(geometry, joints)[..., chosen])
        return np.asarray((moved[..., None] * wave[:, None]).reshape(len(joints), 6, -1))


@dataclass(frozen=True)
class ThermalTerm:
    """All lengths of the links grow with temperature: one coefficient, 1/K."""

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """One name."""
        return ("thermal",)

    def tolerances(self, geometry: Geometry) -> Array:
        """1 mm on 1 m at 20 K."""
        return np.array([5e-5])

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Lengths times temperature times the parameter Jacobian."""
        if conditions.temperature is None:
            raise InputError("thermal expansion needs temperatures; give a temperature column")
        n = geometry.links
        jacobian = parameter_jacobian(geometry, joints)
        moved = joints if geometry.coupling is None else np.stack(geometry.coupling.displacements(list(joints.T)), -1)
        lengths = np.concatenate(
            [np.broadcast_to(geometry.a, moved.shape), geometry.d + moved * np.array(geometry.slides)], -1
        )
        chosen = jacobian[..., np.r_[n : 2 * n, 3 * n : 4 * n]]
        return np.asarray(np.einsum("nip,np->ni", chosen, lengths * conditions.temperature[:, None])[..., None])


@dataclass(frozen=True)
class GravityTerm:
    """Joints yield under the arm's own weight, with neither masses nor stiffnesses known.

    A joint's torque is linear in the mass and first moments of every link behind it, so c tau is linear in c m and
    c m r: one coefficient per joint and moment (rad/m, or m for slides). Most are redundant; the rank sees to that.
    With a recorded payload its torque at the tool is one more column per joint (rad/(kg*m)).

    Attributes:
        joints: Indices of the joints that may yield, from 0.
        up: Direction against gravity in the axes of frame 0.
        payload: Whether the payload's columns take part.
    """

    joints: tuple[int, ...]
    up: tuple[float, float, float]
    payload: bool = False

    def moments(self, geometry: Geometry) -> list[tuple[int, int, str]]:
        """(joint, link, moment) of each coefficient; "m" mass at the link's origin, "p" payload at the tool."""
        found = []
        for i in self.joints:
            moved = [link for link, _ in geometry.links_of(i)]
            if all(geometry.slides[link] for link in moved):
                found += [(i, link, "m") for link in moved]
            else:
                links = range(moved[0], geometry.links)
                found += [(i, j, moment) for j in links for moment in "mxyz" if (j, moment) != (moved[0], "m")]
            if self.payload:
                found.append((i, geometry.links, "p"))
        return found

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        """Joint, link and moment: gravity2_3x."""
        return tuple(f"gravity{i + 1}_{j + 1}{moment}" for i, j, moment in self.moments(geometry))

    def tolerances(self, geometry: Geometry) -> Array:
        """1 mrad at 1 m, 1 mm."""
        return np.full(len(self.moments(geometry)), 1e-3)

    def owners(self, geometry: Geometry) -> NDArray[np.int64]:
        """The joint that each coefficient belongs to ``(k,)``, from 0."""
        return np.array([i for i, _, _ in self.moments(geometry)])

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """The joint Jacobian's columns times each moment's torque."""
        torques = self.torques(geometry, joints, conditions)
        return np.asarray(joint_jacobian(geometry, joints)[..., self.owners(geometry)] * torques[:, None])

    def torques(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        """Torque of each moment on its joint, per unit of it ``(N, k)``."""
        if self.payload and conditions.payload is None:
            raise InputError("the payload's deflection needs payloads; give a payload column")
        chain = frames(np, chain_of(geometry), split_joints(geometry.joints, joints))
        placed = np.stack([np.stack(np.broadcast_arrays(*frame, joints[:, 0])[:12], -1) for frame in chain], 1)
        placed = placed.reshape(len(joints), geometry.links + 1, 4, 3)
        up = geometry.base.rotation @ np.array(self.up)
        tool, found = forward(geometry, joints).position, []
        for i, j, moment in self.moments(geometry):
            torque = np.zeros(len(joints))
            for k, ratio in geometry.links_of(i):
                z, origin = placed[:, k + 1, 2], placed[:, k + 1, 3]
                if k > j:
                    continue  # what hangs on link j is carried by the links before it
                if moment == "m":
                    lever = placed[:, j + 1, 3] - origin
                elif moment == "p":
                    lever = (tool - origin) * np.asarray(conditions.payload)[:, None]
                else:
                    lever = placed[:, j + 1, "xyz".index(moment)]
                if not geometry.slides[k]:
                    torque -= ratio * np.einsum("ni,ni->n", z, np.cross(lever, up))
                elif moment in "mp":
                    torque -= ratio * (z @ up) * (1.0 if moment == "m" else np.asarray(conditions.payload))
            found.append(torque)
        return np.stack(found, -1)


def weighed(weight: GravityTerm, geometry: Geometry, joints: Array, conditions: Conditions) -> ComplianceTerm:
    """Compliance of the joints of ``weight``, whose moments are fitted to the torques measured.

    So it knows torques where none are measured, as at targets. Moments that the poses do not show stay small.
    """
    assert conditions.torque is not None
    columns, owners = weight.torques(geometry, joints, conditions), weight.owners(geometry)
    moments = np.zeros(len(owners))
    for i in weight.joints:
        moments[owners == i] = np.linalg.lstsq(columns[:, owners == i], conditions.torque[:, i], rcond=SHOWN)[0]
    return ComplianceTerm(weight.joints, None, weight, tuple(moments.tolist()))


KINDS: dict[str, type] = {
    "bending": BendingTerm,
    "compliance": ComplianceTerm,
    "gravity": GravityTerm,
    "lead": LeadTerm,
    "periodic": PeriodicTerm,
    "thermal": ThermalTerm,
}
"""The terms by the names that files give them."""


def kind_of_term(term: Term) -> str:
    """The name of a term's kind."""
    return next(name for name, kind in KINDS.items() if isinstance(term, kind))


def specification(term: Any) -> dict[str, Any]:
    """What `term_from` needs to make a term again (JSON)."""
    return {"kind": kind_of_term(term), **asdict(term)}


def term_from(content: Mapping[str, Any]) -> Term:
    """Make a term again from its `specification`, as a calibration file holds it."""
    numbers = _tuples(content)
    kind = KINDS[numbers.pop("kind")]
    if numbers.get("load"):
        numbers["load"] = Load(**numbers["load"])
    if numbers.get("weight"):
        numbers["weight"] = GravityTerm(**numbers["weight"])
    term: Term = kind(**numbers)
    return term


def _tuples(value: Any) -> Any:
    """JSON's lists as tuples, however deep."""
    if isinstance(value, Mapping):
        return {key: _tuples(part) for key, part in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
