"""Which parameters the data can tell apart: scaled QR redundancy, Qiao 2026 eqs (9)-(10), made independent of units.

Columns are taken in the model's order; a column that the kept ones before it already explain is dropped, and the
combination that absorbs it is named. The count does not depend on the order, the choice within a tied group does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from pickenv.arm.kinematics.geometry import FRAME_PARAMETERS, Array
from pickenv.calibration.model.arm_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, ArmModel, ErrorModel
from pickenv.calibration.model.observations import Equations

REDUNDANCY_TOLERANCE = 1e-3
"""A parameter is redundant when what it adds, for a deviation of one tolerance, is below this share of the largest."""


@dataclass(frozen=True)
class Dropped:
    """A parameter that the data cannot tell from others.

    Attributes:
        name: The parameter.
        absorbed_by: What a deviation of 1 (m or rad) of it looks like in the kept parameters (m or rad); empty if the
            parameter has no effect on the measurements at all.
    """

    name: str
    absorbed_by: dict[str, float]


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Result of `identifiability`.

    Attributes:
        names: All parameters, in order.
        kept: Indices of the identifiable base set.
        dropped: The others, each with what absorbs it.
        r_diagonal: |R_kk| of the scaled stacked Jacobian per parameter, ~0 for dropped ones (eq (9)).
        phi: |R_kk| / mean |R_kk|, the paper's ratio (eq (10)).
        singular_values: Of the scaled stacked Jacobian of the kept parameters, per pose (divided by sqrt(N)).
    """

    names: tuple[str, ...]
    kept: NDArray[np.int64]
    dropped: tuple[Dropped, ...]
    r_diagonal: Array
    phi: Array
    singular_values: Array

    @property
    def rank(self) -> int:
        """Number of identifiable parameters."""
        return len(self.kept)

    @property
    def condition(self) -> float:
        """Condition number of the kept, scaled parameters."""
        return float(self.singular_values[0] / self.singular_values[-1])

    def of_all(self, kept: Array) -> Array:
        """One value per parameter ``(P,)`` from one per kept one; NaN for dropped ones."""
        values = np.full(len(self.names), np.nan)
        values[self.kept] = kept
        return values

    @property
    def kept_names(self) -> tuple[str, ...]:
        """Names of the identifiable base set."""
        return tuple(self.names[k] for k in self.kept)


def identifiability(
    matrix: Array, names: tuple[str, ...], tolerance: Array, poses: int, rank_tolerance: float = REDUNDANCY_TOLERANCE
) -> Identifiability:
    """Find a largest identifiable subset of parameters.

    Args:
        matrix: Stacked Jacobian ``(rows, P)``, rows weighted, columns scaled by ``tolerance``.
        names: Parameter names.
        tolerance: The columns' scale, m or rad.
        poses: Number of poses that the rows come from.
        rank_tolerance: See `REDUNDANCY_TOLERANCE`.
    """
    r = np.asarray(np.linalg.qr(matrix, mode="r"))  # columns of the same lengths and angles, in fewer rows
    least = rank_tolerance * np.max(np.linalg.norm(r, axis=0))
    basis = np.zeros((len(r), 0))
    diagonal = np.zeros(len(names))
    for k in range(len(names)):
        rest = r[:, k]
        for _ in range(2):  # twice is enough for orthogonality to the last digit (Kahan, Parlett)
            rest = rest - basis @ (basis.T @ rest)
        diagonal[k] = np.linalg.norm(rest)
        if diagonal[k] > least:
            basis = np.column_stack([basis, rest / diagonal[k]])
    adds = diagonal > least
    kept = np.flatnonzero(adds)
    triangle = basis.T @ r[:, kept]
    dropped = []
    for k in np.flatnonzero(~adds).tolist():
        share = solve_triangular(triangle, basis.T @ r[:, k]) * tolerance[kept] / tolerance[k]
        scaled = np.abs(share) * tolerance[k] / tolerance[kept]
        absorbed = {names[j]: float(c) for j, c, s in zip(kept, share, scaled, strict=True) if s > 1e-3}
        dropped.append(Dropped(names[k], absorbed))
    return Identifiability(
        names=names,
        kept=kept,
        dropped=tuple(dropped),
        r_diagonal=diagonal,
        phi=diagonal / diagonal.mean(),
        singular_values=np.linalg.svd(r[:, kept], compute_uv=False) / np.sqrt(poses),
    )


# Measurements without a frame (wires, sockets) cannot see where arm and anchors stand together: hold the base still.
# Left free, that common motion is seen through the residuals alone: enough to pass for an identifiable parameter at
# the start, and nothing at all at the minimum. What the base could do as well (alpha0, a0, theta1, d1) is held with
# it. Where no length is known either (one point touched, a plane), an arm that shrinks to nothing explains all: hold
# its longest link, and so its size.


BASE = tuple(f"base_{name}" for name in FRAME_PARAMETERS)


def identifiable_parameters(
    model: ErrorModel,
    sets: Sequence[Equations],
    arm: ArmModel,
    unknowns: Sequence[Array],
    matrix: Array,
    names: tuple[str, ...],
    tolerance: Array,
    rank_tolerance: float = REDUNDANCY_TOLERANCE,
) -> Identifiability:
    """`identifiability` of the stacked system; base and size are held where no instrument has a frame or a length.

    Args:
        model: The parameters.
        sets: The data.
        arm: Where the Jacobian was taken.
        unknowns: The data's own unknowns there.
        matrix: Stacked, scaled Jacobian ``(rows, own + P)``, the data's own unknowns first.
        names: Names of its columns.
        tolerance: Their scale, m or rad.
        rank_tolerance: See `pickenv.calibration.model.identifiability.REDUNDANCY_TOLERANCE`.
    """
    poses = sum(len(part.joints) for part in sets)
    held = (
        {}
        if any(part.framed for part in sets)
        else _held_with_base(model, sets, arm, unknowns, matrix, names, poses, rank_tolerance)
    )
    left = matrix.copy()
    left[:, [k for k, name in enumerate(names) if name in held]] = 0.0
    found = identifiability(left, names, tolerance, poses, rank_tolerance)
    if not any(part.sized for part in sets):
        size = _held_size(arm, found)
        left[:, [k for k, name in enumerate(names) if name in size]] = 0.0
        found, held = identifiability(left, names, tolerance, poses, rank_tolerance), held | size
    return replace(found, dropped=tuple(held.get(item.name, item) for item in found.dropped))


def _held_size(arm: ArmModel, found: Identifiability) -> dict[str, Dropped]:
    """The longest link that can be seen, and how the other lengths would grow with it."""
    geometry, count = arm.geometry, arm.geometry.links
    lengths = dict(zip((f"a{i}" for i in range(count)), geometry.a, strict=True))
    lengths |= zip((f"d{i + 1}" for i in range(count)), geometry.d, strict=True)
    seen = {name: float(lengths[name]) for name in found.kept_names if abs(lengths.get(name, 0.0)) > 0.0}
    if not seen:
        return {}
    longest = max(seen, key=lambda name: abs(seen[name]))
    others = {name: -value / seen[longest] for name, value in seen.items() if name != longest}
    return {longest: Dropped(longest, others)}


def _held_with_base(
    model: ErrorModel,
    sets: Sequence[Equations],
    arm: ArmModel,
    unknowns: Sequence[Array],
    matrix: Array,
    names: tuple[str, ...],
    poses: int,
    rank_tolerance: float,
) -> dict[str, Dropped]:
    """The base's parameters, and those that do what the base could do."""
    own, first = len(names) - len(model.names), 5 * arm.geometry.links
    by_arm = np.concatenate([part.jacobian(arm, values)[0] for part, values in zip(sets, unknowns, strict=True)])
    scale = np.where(arm.geometry.parameter_is_angle[first : first + 6], ANGLE_TOLERANCE, LENGTH_TOLERANCE)
    others = [k for k, name in enumerate(model.names) if name not in BASE]
    columns = np.concatenate([by_arm[:, first : first + 6] * scale, matrix[:, own:][:, others]], axis=1)
    chain_names = (*BASE, *(model.names[k] for k in others))
    chain = identifiability(
        columns, chain_names, np.concatenate([scale, model.tolerance[others]]), poses, rank_tolerance
    )
    return {item.name: item for item in chain.dropped} | {name: Dropped(name, {}) for name in BASE}


# How well a data set tells the parameters: observability indices O1-O5 from the Jacobian's singular values. O1 Borm
# and Menq 1991, O2 Driels and Pathre 1990, O3 Nahvi, Hollerbach and Hayward 1994, O4 Nahvi and Hollerbach 1996, O5
# Sun and Hollerbach 2008. Rows in standard uncertainties, columns in tolerances, so the indices have no unit.


@dataclass(frozen=True)
class Observability:
    """Observability of m parameters from n poses; larger is better, save for the condition number.

    Attributes:
        o1: (s1 … sm)^(1/m) / sqrt(n): geometric mean; a D-optimal set maximises it.
        o2: sm / s1: inverse condition number.
        o3: sm: how well the worst combination is seen.
        o4: sm^2 / s1: noise amplification.
        o5: 1 / sum(1 / si): A-optimality's relative.
        condition: s1 / sm.
        poses: n.
    """

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float
    condition: float
    poses: int

    def as_dict(self) -> dict[str, float]:
        """For JSON."""
        return asdict(self)


def observability(singular_values: Array, poses: int) -> Observability:
    """Indices O1 to O5.

    Args:
        singular_values: Of the scaled stacked Jacobian of the identifiable parameters ``(m,)``.
        poses: Number of poses stacked.

    Raises:
        ValueError: If a singular value is not above zero: such parameters are not identifiable and must be left out.
    """
    s = np.sort(np.asarray(singular_values, dtype=float))[::-1]
    if not len(s) or s[-1] <= 0:
        raise ValueError("observability is defined for identifiable parameters, whose singular values are above zero")
    return Observability(
        o1=float(np.exp(np.mean(np.log(s))) / np.sqrt(poses)),
        o2=float(s[-1] / s[0]),
        o3=float(s[-1]),
        o4=float(s[-1] ** 2 / s[0]),
        o5=float(1.0 / np.sum(1.0 / s)),
        condition=float(s[0] / s[-1]),
        poses=poses,
    )


def observability_of(found: Identifiability, poses: int) -> Observability:
    """Indices of an identification's kept parameters on its own poses."""
    return observability(found.singular_values * np.sqrt(poses), poses)
