"""What position errors mean for grippers: how the fruit lies in the tool, and whether it is taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pickenv.arm import forward
from pickenv.arm.kinematics.geometry import Array
from pickenv.inspect.runs.comparison import Comparison
from pickenv.orchard.gripper import Gripper, capture_probability, load_gripper, misalignment

GRIPPERS = ("li_cup", "compliant_hand")
CURVE_MM = np.linspace(0.0, 40.0, 401)
"""Lateral misalignments at which a gripper's curve is drawn, mm."""


@dataclass(frozen=True, eq=False)
class Gripped:
    """One policy's reaches as a gripper sees them.

    Attributes:
        lateral_mm: Distance of the fruit across the tool's axis ``(R,)``.
        success: For each gripper, the probability that it takes each fruit ``(R,)``.
    """

    lateral_mm: Array
    success: Mapping[str, Array]


def gripper_curves(names: tuple[str, ...] = GRIPPERS) -> dict[str, tuple[Array, Array]]:
    """For each gripper, lateral misalignment ``(N,)``, mm, and its probability of success ``(N,)``."""
    return {name: (CURVE_MM, capture_probability(load_gripper(name), CURVE_MM * 1e-3, 0.0, 0.0)) for name in names}


def gripped(comparison: Comparison, names: tuple[str, ...] = GRIPPERS) -> dict[str, Gripped]:
    """How the fruit of each reach lies in the true tool, by policy label.

    The tool is as the true arm holds it; it should point as the nominal arm does at the first policy's command.
    """
    grippers: dict[str, Gripper] = {name: load_gripper(name) for name in names}
    wanted = forward(comparison.nominal, comparison.policies[0].reach_joints).rotation[..., 2]
    found = {}
    for policy in comparison.policies:
        axis = comparison.plant.tool_pose(policy.reach_joints).rotation[..., 2]
        lying = misalignment(comparison.fruit - policy.reach_positions, axis, wanted)
        success = {n: capture_probability(g, lying.lateral, lying.axial, lying.angle) for n, g in grippers.items()}
        found[policy.label] = Gripped(lying.lateral * 1e3, success)
    return found
