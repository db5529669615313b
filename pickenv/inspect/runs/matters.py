"""Whether a calibration changes picks, for each gripper and each error of perception.

The tool misses the fruit by the sum of the arm's error and the perception error. The perception error is normal, across
the tool's axis, and independent of the arm's error. Its standard deviation per axis is given. The gripper's curve of
success against misalignment gives the probability that the fruit is taken. Units: mm; picks as shares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array, forward
from pickenv.inspect.runs.recorded_episodes import Comparison
from pickenv.orchard import Gripper, capture_probability, load_gripper, misalignment

# What position errors mean for grippers: how the fruit lies in the tool, and whether it is taken.


GRIPPERS = ("li_cup", "compliant_hand")
CURVE_MM = np.linspace(0.0, 40.0, 401)
"""Lateral misalignments at which the curve of a gripper's success is drawn, mm."""


def gripper_curves(names: tuple[str, ...] = GRIPPERS) -> dict[str, tuple[Array, Array]]:
    """Return, for each gripper, lateral misalignments ``(N,)``, mm, and the probability of success at each ``(N,)``."""
    return {name: (CURVE_MM, capture_probability(load_gripper(name), CURVE_MM * 1e-3, 0.0, 0.0)) for name in names}


def gripped(comparison: Comparison) -> dict[str, tuple[Array, dict[str, Array]]]:
    """Return the lateral misalignment of each reach, and the probability that each gripper takes its fruit.

    The tool's axis is that of the true arm. The wanted axis is that of the nominal arm at the first policy's command.

    Returns:
        For each policy, by label: distances of the fruit from the tool's axis ``(R,)``, mm, and for each gripper the
        probability that it takes the fruit ``(R,)``.
    """
    grippers: dict[str, Gripper] = {name: load_gripper(name) for name in GRIPPERS}
    target = forward(comparison.nominal, comparison.policies[0].ends.joint_command).rotation[..., 2]
    by_policy = {}
    for policy in comparison.policies:
        ends = policy.ends
        axis = comparison.plant.tool_pose(ends.joint_command).rotation[..., 2]
        lying = misalignment(comparison.fruit - ends.tool_position, axis, target)
        success = {name: capture_probability(gripper, *lying) for name, gripper in grippers.items()}
        by_policy[policy.label] = lying[0] * 1e3, success
    return by_policy


PERCEPTION_MM = (0.0, 1.0, 2.0, 3.0, 5.0)
"""Standard deviations per axis of the perceived fruit position, mm, for which picks are computed."""
MATTERS = 0.05
"""Smallest change in the share of picks that is reported as a change: five of a hundred picks."""
NONE = 0.005
"""Change in the share of picks below which the printed shares are equal, or nearly so."""
RINGS, SPOKES = 24, 24
"""Numbers of distances, equally probable, and of directions at which the perception error is sampled."""


Change: TypeAlias = Mapping[str, Any]
"""The effect of a calibration on the picks of one gripper, as in JSON. ``gripper`` is the gripper's name.
``perception_mm`` is the standard deviation of the perceived fruit position per axis, mm. ``before`` and ``after`` are
the shares of fruit taken without and with calibration."""


def _gain(change: Change) -> float:
    """Return the gain in picks by calibration, as a share of fruit from -1 to 1."""
    return float(change["after"] - change["before"])


def pick_share(gripper: Gripper, lateral_mm: ArrayLike, perception_mm: float) -> float:
    """Return the share of fruit that a gripper takes, given the arm's errors and the perception error.

    Args:
        gripper: The gripper; the tool is assumed to point as wanted.
        lateral_mm: Distances of the fruit from the tool's axis, from the arm's own error alone ``(N,)``, mm.
        perception_mm: Standard deviation of the perceived fruit position per axis, mm.
    """
    error = np.asarray(lateral_mm, dtype=float)[:, None, None]
    ring = perception_mm * np.sqrt(-2.0 * np.log1p(-(np.arange(RINGS) + 0.5) / RINGS))[:, None]
    spoke = 2.0 * np.pi * (np.arange(SPOKES) + 0.5) / SPOKES
    lateral: Array = np.sqrt(np.maximum(error**2 + ring**2 + 2.0 * error * ring * np.cos(spoke), 0.0))
    return float(capture_probability(gripper, lateral * 1e-3, 0.0, 0.0).mean())


def pick_changes(before_mm: ArrayLike, after_mm: ArrayLike) -> list[Change]:
    """Return the effect of a calibration on picks, for each of `GRIPPERS` and of `PERCEPTION_MM`.

    Args:
        before_mm: Lateral errors without calibration ``(N,)``, mm.
        after_mm: Lateral errors with calibration ``(N,)``, mm.
    """
    sides, grippers = {"before": before_mm, "after": after_mm}, {name: load_gripper(name) for name in GRIPPERS}
    return [
        {"gripper": name, "perception_mm": perception}
        | {side: pick_share(gripper, lateral_mm, perception) for side, lateral_mm in sides.items()}
        for name, gripper in grippers.items()
        for perception in PERCEPTION_MM
    ]


def change_cells(change: Change) -> tuple[str, ...]:
    """Return a change as table cells: gripper, perception error, shares without and with calibration, and gain.

    Perception errors are in mm, shares in %, and the gain is in percentage points.
    """
    shares = (f"{100.0 * share:.1f}" for share in (change["before"], change["after"]))
    return (change["gripper"], f"{change['perception_mm']:g}", *shares, f"{100.0 * _gain(change):+.1f}")


def matters(plant: str, changes: Sequence[Change], between: tuple[str, str] = ("without", "with calibration")) -> str:
    """Return a few sentences that say for which gripper and perception error picks change on an arm.

    Args:
        plant: The arm's name.
        changes: The changes, from `pick_changes`.
        between: Words that follow the shares before and after calibration, such as "with raw" and "with LS".
    """

    def both(change: Change) -> str:
        before, after = 100.0 * change["before"], 100.0 * change["after"]
        return f"{before:.0f} % taken {between[0]}, {after:.0f} % {between[1]}"

    largest: dict[str, Change] = {}  # of each gripper
    for change in sorted(changes, key=lambda c: -abs(_gain(c))):
        largest.setdefault(change["gripper"], change)
    best = list(largest.values())
    if abs(_gain(best[0])) < MATTERS:
        most = abs(np.ceil(100.0 * abs(_gain(best[0])) - 1e-9))  # no minus before a zero
        return (
            f"On {plant} this changes no more than {most:.0f} of 100 picks, with any gripper "
            f"and however well the fruit is seen; most {_where(best[0])}: {both(best[0])}."
        )
    yes = [f"{_where(c)}: {both(c)}" for c in best if abs(_gain(c)) >= MATTERS]
    no = [f"{c['gripper']} ({both(c)})" for c in best if abs(_gain(c)) < MATTERS]
    first = f"On {plant} this changes picks {'; '.join(yes)}."
    sharp = next(c for c in changes if c["gripper"] == best[0]["gripper"] and c["perception_mm"] == PERCEPTION_MM[0])
    if abs(_gain(sharp)) < MATTERS:
        few = "none" if abs(_gain(sharp)) < NONE else "hardly any"
        first += f" Were the fruit seen without error, it would change {few} ({both(sharp)})."
    return first + (f" Hardly a pick changes with {' and '.join(no)}." if no else "")


def _where(change: Change) -> str:
    error = change["perception_mm"]
    perception = f"seen to {error:g} mm per axis" if error else "seen without error"
    return f"with {change['gripper']} and the fruit {perception}"
