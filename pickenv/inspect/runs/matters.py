"""Does a calibration change picks? For which gripper, and how well the fruit must be seen for it to show.

The tool ends beside the fruit by its own error and by the perception's: a normal error of so many mm per axis across
the tool, independent of the arm's. Whether the gripper then takes the fruit is its curve's to say. Millimetres, shares.
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
"""Lateral misalignments at which a gripper's curve is drawn, mm."""


def gripper_curves(names: tuple[str, ...] = GRIPPERS) -> dict[str, tuple[Array, Array]]:
    """For each gripper, lateral misalignment ``(N,)``, mm, and its probability of success ``(N,)``."""
    return {name: (CURVE_MM, capture_probability(load_gripper(name), CURVE_MM * 1e-3, 0.0, 0.0)) for name in names}


def gripped(comparison: Comparison) -> dict[str, tuple[Array, dict[str, Array]]]:
    """The fruit of each reach as it lies in the true tool, by policy label.

    The tool is as the true arm holds it; it should point as the nominal arm does at the first policy's command.

    Returns:
        For each policy, distances of the fruit across the tool's axis ``(R,)``, mm, and for each gripper the
        probability that it takes each fruit ``(R,)``.
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
"""Standard deviations per axis at which fruit may be seen."""
MATTERS = 0.05
"""Share of picks below which a calibration is said to change none: five of a hundred."""
NONE = 0.005
"""Share of picks below which the printed shares are equal, or nearly so."""
RINGS, SPOKES = 24, 24
"""Of the perception's errors: distances of equal probability, and directions."""


Change: TypeAlias = Mapping[str, Any]
"""The effect of a calibration on the picks of one gripper, as it stands in JSON: ``gripper``, its name;
``perception_mm``, standard deviation of the fruit's seen position per axis, mm; ``before`` and ``after``, shares of
fruit taken without calibration and with it."""


def _gain(change: Change) -> float:
    """Gain by calibration, as a share of fruit."""
    return float(change["after"] - change["before"])


def pick_share(gripper: Gripper, lateral_mm: ArrayLike, perception_mm: float) -> float:
    """Share of fruit that a gripper takes.

    Args:
        gripper: The gripper; the tool points as it should.
        lateral_mm: Distance of the fruit across the tool's axis that the arm's own error leaves ``(N,)``, mm.
        perception_mm: Standard deviation per axis of where the fruit is seen, mm.
    """
    error = np.asarray(lateral_mm, dtype=float)[:, None, None]
    ring = perception_mm * np.sqrt(-2.0 * np.log1p(-(np.arange(RINGS) + 0.5) / RINGS))[:, None]
    spoke = 2.0 * np.pi * (np.arange(SPOKES) + 0.5) / SPOKES
    lateral: Array = np.sqrt(np.maximum(error**2 + ring**2 + 2.0 * error * ring * np.cos(spoke), 0.0))
    return float(capture_probability(gripper, lateral * 1e-3, 0.0, 0.0).mean())


def pick_changes(before_mm: ArrayLike, after_mm: ArrayLike) -> list[Change]:
    """The effect of a calibration on picks, for each of `GRIPPERS` and of `PERCEPTION_MM`.

    Args:
        before_mm: Lateral errors without calibration ``(N,)``, mm.
        after_mm: The same with it.
    """
    return [
        {
            "gripper": name,
            "perception_mm": perception,
            "before": pick_share(gripper, before_mm, perception),
            "after": pick_share(gripper, after_mm, perception),
        }
        for name, gripper in ((name, load_gripper(name)) for name in GRIPPERS)
        for perception in PERCEPTION_MM
    ]


def change_cells(change: Change) -> tuple[str, ...]:
    """A change as cells of a table: gripper, perception error, shares without and with, points of % between."""
    shares = (f"{100.0 * share:.1f}" for share in (change["before"], change["after"]))
    return (change["gripper"], f"{change['perception_mm']:g}", *shares, f"{100.0 * _gain(change):+.1f}")


def matters(plant: str, changes: Sequence[Change], between: tuple[str, str] = ("without", "with calibration")) -> str:
    """In a few sentences: on which arm, for which gripper and perception error picks change.

    Args:
        plant: The arm's name.
        changes: From `pick_changes`.
        between: What stands behind the shares before and after: "with raw" and "with LS" for two policies.
    """

    def both(change: Change) -> str:
        before, after = 100.0 * change["before"], 100.0 * change["after"]
        return f"{before:.0f} % taken {between[0]}, {after:.0f} % {between[1]}"

    best = sorted(
        (
            max((c for c in changes if c["gripper"] == name), key=lambda c: abs(_gain(c)))
            for name in dict.fromkeys(c["gripper"] for c in changes)
        ),
        key=lambda c: -abs(_gain(c)),
    )
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
