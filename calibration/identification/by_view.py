"""Uncertainty where one row gives many equations: those of a picture share the error of the arm's pose behind it.

Taken as independent, the corners of a picture promise parameters several times better than they are as soon as the
arm does not stand quite where its joints say. Leaving out one picture at a time (the jackknife over clusters, CR3 of
Bell and McCaffrey 2002) asks the data themselves how far each picture pulls, whatever its corners share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.observations import Equations
from pickenv.calibration.model.splits import Rows

POSE = 6
"""Equations that one pose can be worth; what a row gives beyond them it gives again."""


def shared_rows(sets: Sequence[Equations]) -> Rows | None:
    """The row of each equation ``(E,)``, -1 where it belongs to none; None where no data set gives many for a row."""
    found, first, many = [], 0, False
    for part in sets:
        asked = getattr(part, "equations", None)
        if asked is None:  # what is known beforehand: it is given whole, and with all of its equations or none
            return None
        rows = asked()[0]
        many = many or len(rows) > POSE * max(len(part.joints), 1)
        found.append(np.where(rows < 0, -1, rows + first))
        first += len(part.joints)
    return np.concatenate(found) if many else None


def jackknife_covariance(factor: Array, matrix: Array, weighted: Array, rows: Rows) -> Array | None:
    """Covariance ``(p, p)`` of the parameters of a least-squares fit by leaving out one row at a time.

    Args:
        factor: Inverse of R of the whitened Jacobian's QR decomposition ``(p, p)``.
        matrix: The Jacobian ``(E, p)``.
        weighted: Whitened residuals ``(E,)``.
        rows: Of `shared_rows`; equations of none (priors) count with the uncertainty that they state.

    Returns:
        None where the rows are too few to say (less than a third more pose equations than parameters), or one of them
        alone holds a parameter.
    """
    basis = matrix @ factor
    names = np.unique(rows[rows >= 0])
    count = basis.shape[1]
    if 3 * POSE * len(names) < 4 * count or len(names) < 3:
        return None
    pulls = []
    for name in names:
        own = basis[rows == name]
        rest = np.eye(count) - own.T @ own
        if np.linalg.eigvalsh(rest)[0] < 1e-6:
            return None
        pulls.append(np.linalg.solve(rest, own.T @ weighted[rows == name]))
    pulled, stated = np.array(pulls), basis[rows < 0]
    spread = pulled.T @ pulled * (len(names) - 1) / len(names) + stated.T @ stated
    return np.asarray(factor @ spread @ factor.T)
