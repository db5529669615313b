"""Which effect costs how many millimetres at the tip: one at a time, all but one, and all together.

Every figure is the distance between two tool positions at the same joint command: after a reach at full speed and a
short wait, on a machine that has been running for some time.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.campaign import switched_on
from pickenv.arm.plant.motion import Pace, moved
from pickenv.arm.plant.plant import EFFECTS, FOUND, Plant

TABLE = ("geometry", *(name for name in EFFECTS if name != "measurement_noise"))
"""Rows of a designed arm's table; measurement noise never moves the arm. A calibrated one's has `FOUND` too."""


@dataclass(frozen=True)
class Share:
    """How far the tool moves, over all reaches, mm.

    Attributes:
        mean: Mean distance.
        p95: 95th percentile.
        max: Largest.
        varying: Mean distance after each axis' mean is taken off: what no constant offset removes.
    """

    mean: float
    p95: float
    max: float
    varying: float


@dataclass(frozen=True)
class EffectShares:
    """Each effect's share of the tip's position error.

    Attributes:
        plant: Name of the plant.
        reaches: Number of reaches.
        running_hours: Time since the machine was switched on.
        dwell: Waiting time between arrival and measurement, s.
        alone: For each effect that is on, its share when it is the only one; ``geometry`` is the true against the
            nominal geometry.
        without: For each of them, true tool against the nominal one with everything on but it: the error that remains.
        all: True tool against the nominal one, everything on.
        sum_of_means: Sum of the means of ``alone``, mm: all shares in one line, the worst case.
        root_sum_square: Root of the sum of the squared means of ``alone``, mm: shares in random directions.
    """

    plant: str
    reaches: int
    running_hours: float
    dwell: float
    alone: dict[str, Share]
    without: dict[str, Share]
    all: Share
    sum_of_means: float
    root_sum_square: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON; every length in mm, and the name of the unit in the key."""
        return {"unit": "mm", **asdict(self)}

    def report(self) -> str:
        """A table for people."""
        head = f"{'effect':<20}{'alone: mean':>13}{'varying':>10}{'p95':>9}{'max':>9}{'without: mean':>17}"
        lines = [
            f"Tip error of plant {self.plant} in mm: {self.reaches} reaches, {self.dwell:g} s after arrival, "
            f"{self.running_hours:g} h after start",
            head,
            "-" * len(head),
        ]
        for name, share in self.alone.items():
            figures = f"{share.mean:13.3f}{share.varying:10.3f}{share.p95:9.3f}{share.max:9.3f}"
            lines.append(f"{name.replace('_', ' '):<20}{figures}{self.without[name].mean:17.3f}")
        lines.append("-" * len(head))
        total = self.all
        lines.append(f"{'all':<20}{total.mean:13.3f}{total.varying:10.3f}{total.p95:9.3f}{total.max:9.3f}{0.0:17.3f}")
        lines.append("alone: the only effect that is on; without: what all the others leave")
        lines.append(f"sum of the means {self.sum_of_means:.3f}, root of the sum of squares {self.root_sum_square:.3f}")
        return "\n".join(lines)


def draw_reaches(plant: Plant, count: int, rng: np.random.Generator) -> Array:
    """Joints ``(count, n)`` spread evenly over the ranges, rad or m."""
    geometry = plant.arm.nominal
    return rng.uniform(geometry.lower, geometry.upper, (count, geometry.joints))


def effect_shares(
    plant: Plant, joints: ArrayLike, *, running_time: float = 7200.0, pace: Pace | None = None
) -> EffectShares:
    """Each effect's share of the tip error.

    Args:
        plant: The arm, on single numbers (not a batch of arms).
        joints: Joint commands ``(P, n)`` to reach, rad or m; each is approached from the one before it.
        running_time: Time since the machine was switched on, s.
        pace: How the reaches are made; full speed and 0.5 s of waiting when left out.
    """
    pace = pace or Pace()
    joints = np.asarray(joints, dtype=float)
    if joints.ndim != 2 or len(joints) < 2:
        raise ValueError(f"joints have shape {joints.shape}; give at least two rows of joint commands")
    on = [name for name in (*TABLE, *FOUND) if name == "geometry" or getattr(plant, name) is not None]
    believed = forward(plant.arm.nominal, joints).position

    def reached(*effects: str) -> Array:
        some = plant.without(name for name in (*EFFECTS, *FOUND) if name not in effects)
        if "geometry" not in effects:
            some = replace(some, geometry=plant.arm.nominal)
        return _reached(some, joints, running_time, pace)

    everything = reached(*on)
    alone = {name: _share(reached(name) - believed) for name in on}
    without = {name: _share(reached(*(other for other in on if other != name)) - believed) for name in on}
    means = [share.mean for share in alone.values()]
    return EffectShares(
        plant=plant.name,
        reaches=len(joints),
        running_hours=running_time / 3600.0,
        dwell=pace.dwell,
        alone=alone,
        without=without,
        all=_share(everything - believed),
        sum_of_means=float(np.sum(means)),
        root_sum_square=float(np.sqrt(np.sum(np.square(means)))),
    )


def _reached(plant: Plant, joints: Array, running_time: float, pace: Pace) -> Array:
    """True tool positions ``(P, 3)`` after reaches from the joints before (the first from the last), m."""
    start = np.roll(joints, 1, axis=0)
    _, frame = moved(plant, np, switched_on(plant, np, start, running_time), start, joints, pace)
    return np.stack(np.broadcast_arrays(*frame[9:]), -1)


def _share(moved_by: Array) -> Share:
    millimetres = 1e3 * np.linalg.norm(moved_by, axis=-1)
    varying = 1e3 * np.linalg.norm(moved_by - moved_by.mean(axis=0), axis=-1)
    return Share(
        mean=float(millimetres.mean()),
        p95=float(np.quantile(millimetres, 0.95)),
        max=float(millimetres.max()),
        varying=float(varying.mean()),
    )
