"""What a gripper forgives: a cup with a hard edge, or a compliant hand that fails ever more often.

Misalignment of the fruit in the tool: lateral (across the tool's axis), axial (along it), angle. Units: m, rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array
from pickenv.toml_tables import DEG, NUMBER, REQUIRED, Check, Kinds, Unit, toml_table

KIND = Check(lambda value: value in ("cup", "hand"), "'cup' or 'hand'")


@toml_table
class Cup(checks.Preset):
    """A rigid cup: it takes the fruit if every misalignment stays within its tolerance.

    Attributes:
        name: Name of the preset.
        source: Where its numbers come from.
        opening: Inner diameter, m.
        fruit: Diameter of the fruit it is meant for, m.
        axial: Tolerance along the axis, m.
        angle: Tolerance of the axis' direction, rad.
        kind: Which table of a file this is.
    """

    name: str
    source: str
    opening: Annotated[float, MM.positive]
    fruit: Annotated[float, MM.positive]
    axial: Annotated[float, MM.positive]
    angle: Annotated[float, DEG.positive]
    kind: Annotated[Literal["cup"], KIND, REQUIRED] = "cup"


@toml_table
class CompliantHand(checks.Preset):
    """A hand with soft fingers: logit of success = intercept − lateral·|x| − axial·|z| − angle·|φ|.

    Attributes:
        name: Name of the preset.
        source: Where its numbers come from.
        intercept: Logit without misalignment.
        lateral: 1/m.
        axial: 1/m.
        angle: 1/rad.
        kind: Which table of a file this is.
    """

    name: str
    source: str
    intercept: Annotated[float, NUMBER]
    lateral: Annotated[float, Unit("per_10mm", 100.0).not_negative]
    axial: Annotated[float, Unit("per_10mm", 100.0).not_negative]
    angle: Annotated[float, Unit("per_10deg", 18.0 / math.pi).not_negative]
    kind: Annotated[Literal["hand"], KIND, REQUIRED] = "hand"


Gripper: TypeAlias = Cup | CompliantHand


@dataclass(frozen=True, eq=False)
class Misalignment:
    """How a fruit lies in the tool: m and rad, each of shape (...); axial is positive beyond the tool's point."""

    lateral: Array
    axial: Array
    angle: Array


def misalignment(offset: ArrayLike, tool_axis: ArrayLike, wanted_axis: ArrayLike | None = None) -> Misalignment:
    """Misalignment of a fruit from geometry.

    Args:
        offset: From the tool's point to the fruit's centre, m, shape (..., 3).
        tool_axis: Direction in which the tool approaches, shape (..., 3).
        wanted_axis: Direction in which it should approach, shape (..., 3); None means that it does.
    """
    offset, axis = checks.points("the offset", offset), checks.directions("the tool axis", tool_axis)
    axial = np.einsum("...i,...i->...", offset, axis)
    lateral = np.linalg.norm(offset - axial[..., None] * axis, axis=-1)
    if wanted_axis is None:
        return Misalignment(lateral, axial, np.zeros_like(axial))
    wanted = checks.directions("the wanted axis", wanted_axis)
    sine = np.linalg.norm(np.cross(axis, wanted), axis=-1)
    angle = np.arctan2(sine, np.einsum("...i,...i->...", axis, wanted))
    return Misalignment(
        lateral, axial, np.asarray(np.broadcast_to(angle, np.broadcast_shapes(angle.shape, axial.shape)))
    )


def capture_probability(
    gripper: Gripper, lateral: ArrayLike, axial: ArrayLike, angle: ArrayLike, diameter: ArrayLike | None = None
) -> Array:
    """Probability that the gripper takes the fruit.

    Args:
        gripper: A cup (0 or 1) or a hand.
        lateral: Across the tool's axis, m; sign does not matter. Shapes broadcast.
        axial: Along the tool's axis, m.
        angle: Between tool and wanted axis, rad.
        diameter: Fruit diameter, m; only a cup minds. None is the fruit it is meant for.

    Raises:
        InputError: If a misalignment is NaN or infinite.
    """
    x = np.abs(checks.numbers("the lateral misalignment (m)", lateral))
    z = np.abs(checks.numbers("the axial misalignment (m)", axial))
    phi = np.abs(checks.numbers("the angular misalignment (rad)", angle))
    if isinstance(gripper, CompliantHand):
        logit = gripper.intercept - gripper.lateral * x - gripper.axial * z - gripper.angle * phi
        return np.asarray(0.5 * (1.0 + np.tanh(logit / 2)))
    fruit = gripper.fruit if diameter is None else checks.numbers("the fruit diameter (m)", diameter, lowest=0.0)
    inside = (x <= (gripper.opening - fruit) / 2) & (z <= gripper.axial) & (phi <= gripper.angle)
    return np.asarray(inside, dtype=np.float64)


def lateral_tolerance(gripper: Gripper) -> float:
    """How far aside of the tool's axis a fruit may lie, m: always taken by a cup, one time in two by a hand."""
    if isinstance(gripper, CompliantHand):
        return max(gripper.intercept / gripper.lateral, 0.0)
    return (gripper.opening - gripper.fruit) / 2.0


def load_gripper(name: str | Path) -> Gripper:
    """Read a gripper by name (`shipped("gripper")`) or from a path to a TOML file."""
    return preset_files.load("gripper", name, gripper_kind)


def gripper_kind(table: Mapping[str, Any]) -> type[Gripper]:
    """Which gripper a table of a file is."""
    return CompliantHand if table.get("kind") == "hand" else Cup


GripperFile: TypeAlias = Annotated[Cup | CompliantHand, Kinds(gripper_kind)]
"""What a gripper file holds."""
