"""What any camera, modelled or rendered, tells the arm: where fruit is believed to be, and with what confidence.

Units: m.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pickenv.errors import InputError
from pickenv.orchard import checks
from pickenv.orchard.checks import Array, Integers


@dataclass(frozen=True, eq=False)
class Detections:
    """Fruit as a camera reports it.

    Attributes:
        positions: Believed fruit centres, m, shape (m, 3), in the frame in which the true fruit was given.
        fruit: Index of the true fruit behind each detection, -1 where there is none or it is not known, shape (m,).
        confidence: From 0 to 1, shape (m,).
    """

    positions: Array
    fruit: Integers
    confidence: Array

    def __post_init__(self) -> None:
        if self.positions.ndim != 2 or self.positions.shape[-1] != 3:
            raise InputError(f"detected positions must have shape (m, 3), not {self.positions.shape}")
        for name in ("fruit", "confidence"):
            if getattr(self, name).shape != (len(self.positions),):
                raise InputError(f"there are {len(self.positions)} detections but {name} has another length")

    def __len__(self) -> int:
        return len(self.positions)


def match_detections(detections: Detections, positions: ArrayLike, within: float) -> Detections:
    """Name the true fruit behind each detection: one to one, least total distance, none farther than ``within`` m.

    Args:
        detections: What a camera reported; its fruit indices are ignored.
        positions: True fruit centres, m, shape (n, 3), in the same frame.
        within: Largest distance at which a detection counts as this fruit, m.
    """
    from scipy.optimize import linear_sum_assignment

    checks.positive("the matching distance (m)", within)
    truth = checks.points("true fruit positions", positions).reshape(-1, 3)
    distance = np.linalg.norm(detections.positions[:, None] - truth[None], axis=-1)
    seen, fruit = linear_sum_assignment(np.minimum(distance, 2 * within * max(len(detections), len(truth), 1)))
    near = distance[seen, fruit] <= within
    index = np.full(len(detections), -1, dtype=np.int64)
    index[seen[near]] = fruit[near]
    return replace(detections, fruit=index)
