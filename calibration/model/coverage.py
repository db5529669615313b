"""What the chosen poses hide: parameters that such an instrument could tell, but these poses cannot.

The rank on the actual poses is compared with the rank on poses from the whole joint ranges; joints whose range, if it
were used, would bring the lost parameters back are named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import ErrorModel
from pickenv.calibration.model.identifiability import identifiability
from pickenv.calibration.model.measurements import Measurements, random_joints
from pickenv.errors import InputError

PROBES = 200
"""Poses drawn from the whole joint ranges."""

LOST_SHARE = 0.25
"""Poses that lose more than this share of the parameters that full-range poses show do not bear a fit of all."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Rank of a data set's poses against the rank that the joint ranges allow.

    Attributes:
        rank: On the actual poses.
        full_rank: On poses from the whole joint ranges, with the same instrument.
        lost: Parameters that only these poses hide.
        move: Indices of the joints that would bring them back if they were moved over their ranges; empty if none is
            lost.
        used: Share of each joint's range that the poses use ``(n,)``, 0 to 1 (above 1 beyond the limits).
        joint_names: Names of the joints.
    """

    rank: int
    full_rank: int
    lost: tuple[str, ...]
    move: tuple[int, ...]
    used: Array
    joint_names: tuple[str, ...]

    @property
    def little(self) -> bool:
        """Whether the poses lose more than `LOST_SHARE` of the parameters."""
        return self.full_rank - self.rank > LOST_SHARE * self.full_rank

    def advice(self) -> str:
        """One sentence: nothing is lost, or what is, and which joints to move."""
        if not self.lost:
            return f"the poses tell all {self.full_rank} parameters that this arm and instrument allow"
        joints = ", ".join(
            f"{self.joint_names[i]} (now over {100 * self.used[i]:.0f} % of its range)" for i in self.move
        )
        remedy = f"move {joints} further" if joints else "measure more varied poses (`pickenv plan-poses`)"
        what = "parameter" if len(self.lost) == 1 else "parameters"
        return f"{what} {', '.join(self.lost)} cannot be told from others because of the poses alone; {remedy}"


def pose_coverage(model: ErrorModel, geometry: Geometry, measurements: Measurements) -> Coverage:
    """Compare the rank on the actual poses with the rank on full-range poses.

    Args:
        model: Geometric parameters.
        geometry: The arm.
        measurements: The data set; only its joints, kind and uncertainties matter.
    """
    rng = np.random.default_rng(0)
    actual = measurements.joints
    drawn = random_joints(geometry, PROBES, rng)
    used = np.ptp(actual, axis=0) / (geometry.upper - geometry.lower)
    resampled = actual[rng.integers(0, len(actual), PROBES)]

    def dropped(joints: Array) -> set[str]:
        by_arm, _ = measurements.imagined(joints).jacobian(ArmModel.of(geometry), np.zeros(0))
        matrix = by_arm[:, model.columns] * model.tolerance
        found = identifiability(matrix, model.names, model.tolerance, len(joints))
        return {item.name for item in found.dropped}

    def moved(joints: list[int]) -> Array:
        mixed = resampled.copy()
        mixed[:, joints] = drawn[:, joints]
        return mixed

    here, best = dropped(actual), dropped(drawn)
    chosen: list[int] = []
    left, now = list(range(geometry.joints)), here
    while left and len(now) > len(best):
        trials = {i: dropped(moved([*chosen, i])) for i in left}
        one = min(trials, key=lambda i: len(trials[i]))
        if len(trials[one]) >= len(now) and len(left) > 1:
            # No single joint helps: two must move together; take the one that is used least and go on.
            one = min(left, key=lambda i: float(used[i]))
        chosen.append(one)
        left.remove(one)
        now = trials[one]
    return Coverage(
        rank=len(model.names) - len(here),
        full_rank=len(model.names) - len(best),
        lost=tuple(name for name in model.names if name in here - best),
        move=tuple(sorted(chosen)),
        used=used,
        joint_names=geometry.joint_names,
    )


def refuse_lost(coverage: Coverage, geometry: Geometry, measurements: Measurements) -> None:
    """Refuse poses that hide more than `LOST_SHARE` of what poses over the whole joint ranges would show.

    Raises:
        InputError: Names the parameters, and joints that hardly move.
    """
    if not coverage.little:
        return
    still = [f"joint {i + 1} ({geometry.joint_names[i]})" for i in np.flatnonzero(coverage.used < 0.02)]
    hint = f"; {', '.join(still)} hardly move" if still else ""
    raise InputError(
        f"{measurements.source}: these poses show {coverage.rank} of the {coverage.full_rank} parameters that full-"
        f"range poses show, and lose {', '.join(coverage.lost[:8])}{hint}; measure poses that move every joint"
    )
