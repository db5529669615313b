"""Does a calibration change picks? For which gripper, and how well the fruit must be seen for it to show.

The tool ends beside the fruit by its own error and by the perception's: a normal error of so many mm per axis across
the tool, independent of the arm's. Whether the gripper then takes the fruit is its curve's to say. Millimetres, shares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class PickChange:
    """The effect of a calibration on the picks of one gripper.

    Attributes:
        gripper: Its name.
        perception_mm: Standard deviation of the fruit's seen position per axis, mm.
        before: Share of fruit taken without calibration.
        after: Share taken with it.
    """

    gripper: str
    perception_mm: float
    before: float
    after: float

    @property
    def gain(self) -> float:
        """Gain by calibration, as a share of fruit."""
        return self.after - self.before


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


def pick_changes(before_mm: ArrayLike, after_mm: ArrayLike) -> list[PickChange]:
    """The effect of a calibration on picks, for each of `GRIPPERS` and of `PERCEPTION_MM`.

    Args:
        before_mm: Lateral errors without calibration ``(N,)``, mm.
        after_mm: The same with it.
    """
    return [
        PickChange(name, perception, *(pick_share(gripper, errors, perception) for errors in (before_mm, after_mm)))
        for name, gripper in ((name, load_gripper(name)) for name in GRIPPERS)
        for perception in PERCEPTION_MM
    ]


def change_cells(change: PickChange) -> tuple[str, ...]:
    """A change as cells of a table: gripper, perception error, shares without and with, points of % between."""
    shares = (f"{100.0 * share:.1f}" for share in (change.before, change.after))
    return (change.gripper, f"{change.perception_mm:g}", *shares, f"{100.0 * change.gain:+.1f}")


def matters(
    plant: str, changes: Sequence[PickChange], between: tuple[str, str] = ("without", "with calibration")
) -> str:
    """In a few sentences: on which arm, for which gripper and perception error picks change.

    Args:
        plant: The arm's name.
        changes: From `pick_changes`.
        between: What stands behind the shares before and after: "with raw" and "with LS" for two policies.
    """

    def both(change: PickChange) -> str:
        before, after = (
            f"{100.0 * share:.0f} % {word}"
            for share, word in zip((change.before, change.after), (f"taken {between[0]}", between[1]), strict=True)
        )
        return f"{before}, {after}"

    best = sorted(
        (
            max((c for c in changes if c.gripper == name), key=lambda c: abs(c.gain))
            for name in dict.fromkeys(c.gripper for c in changes)
        ),
        key=lambda c: -abs(c.gain),
    )
    if abs(best[0].gain) < MATTERS:
        most = abs(np.ceil(100.0 * abs(best[0].gain) - 1e-9))  # no minus before a zero
        return (
            f"On {plant} this changes no more than {most:.0f} of 100 picks, with any gripper "
            f"and however well the fruit is seen; most {_where(best[0])}: {both(best[0])}."
        )
    yes = [f"{_where(c)}: {both(c)}" for c in best if abs(c.gain) >= MATTERS]
    no = [f"{c.gripper} ({both(c)})" for c in best if abs(c.gain) < MATTERS]
    first = f"On {plant} this changes picks {'; '.join(yes)}."
    sharp = next(c for c in changes if c.gripper == best[0].gripper and c.perception_mm == PERCEPTION_MM[0])
    if abs(sharp.gain) < MATTERS:
        few = "none" if abs(sharp.gain) < NONE else "hardly any"
        first += f" Were the fruit seen without error, it would change {few} ({both(sharp)})."
    return first + (f" Hardly a pick changes with {' and '.join(no)}." if no else "")


def _where(change: PickChange) -> str:
    perception = f"seen to {change.perception_mm:g} mm per axis" if change.perception_mm else "seen without error"
    return f"with {change.gripper} and the fruit {perception}"
