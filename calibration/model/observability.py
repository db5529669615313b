"""How well a data set tells the parameters: observability indices O1-O5 from the Jacobian's singular values.

O1 Borm and Menq 1991, O2 Driels and Pathre 1990, O3 Nahvi, Hollerbach and Hayward 1994, O4 Nahvi and Hollerbach 1996,
O5 Sun and Hollerbach 2008. Rows in standard uncertainties, columns in tolerances, so the indices have no unit.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.identifiability import Identifiability


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
