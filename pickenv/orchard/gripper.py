"""Grippers and the misalignment that they tolerate: a cup with a hard edge, or a compliant hand that fails gradually.

Misalignment of the fruit in the tool is lateral (across the tool's axis), axial (along it) and an angle. Units: m, rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, Union

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import DEG, NUMBER, REQUIRED, Check, InputError, Kinds, Unit, register, toml_table
from pickenv.base.registry import get, load_all, names
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array

KIND = Check(lambda value: value in names("gripper"), "'cup' or 'hand'")


class Gripper(Protocol):
    """The members of a gripper. A class of grippers is registered by name; files choose it by their field ``kind``."""

    @property
    def name(self) -> str:
        """Name of the gripper in tables."""

    @property
    def kind(self) -> str:
        """Name by which its class is registered."""

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """Probability that the gripper takes the fruit.

        Args:
            lateral: Size of the lateral misalignment, m. Shapes broadcast.
            axial: Size of the axial misalignment, m.
            angle: Size of the angle, rad.
            diameter: Fruit diameter, m; None is the fruit that the gripper is meant for.
        """

    @property
    def tolerance(self) -> float:
        """Distance from the tool's axis at which a fruit is taken, m: always by a cup, one time in two by a hand."""


@register("gripper", "cup")
@toml_table
class Cup(checks.Preset):
    """A rigid cup: it takes the fruit if every misalignment stays within its tolerance.

    Attributes:
        name: Name of the preset.
        source: Source of its numbers.
        opening: Inner diameter, m.
        fruit: Diameter of the fruit that the cup is meant for, m.
        axial: Largest axial misalignment, m.
        angle: Largest angle between the cup's axis and the wanted one, rad.
        kind: Kind of gripper in a file.
    """

    name: str
    source: str
    opening: Annotated[float, MM.positive]
    fruit: Annotated[float, MM.positive]
    axial: Annotated[float, MM.positive]
    angle: Annotated[float, DEG.positive]
    kind: Annotated[Literal["cup"], KIND, REQUIRED] = "cup"

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """Probability: 1 inside the tolerances, 0 outside. Without a diameter, the fruit is the one in ``fruit``."""
        fruit = self.fruit if diameter is None else checks.numbers("the fruit diameter (m)", diameter, lowest=0.0)
        inside = (lateral <= (self.opening - fruit) / 2) & (axial <= self.axial) & (angle <= self.angle)
        return np.asarray(inside, dtype=np.float64)

    @property
    def tolerance(self) -> float:
        """Distance aside up to which the fruit that the cup is meant for is always taken, m."""
        return (self.opening - self.fruit) / 2.0


@register("gripper", "hand")
@toml_table
class CompliantHand(checks.Preset):
    """A hand with soft fingers: logit of success = intercept − lateral·|x| − axial·|z| − angle·|φ|.

    Attributes:
        name: Name of the preset.
        source: Source of its numbers.
        intercept: Logit without misalignment.
        lateral: Fall of the logit with lateral misalignment, 1/m.
        axial: Fall of the logit with axial misalignment, 1/m.
        angle: Fall of the logit with the angle, 1/rad.
        kind: Kind of gripper in a file.
    """

    name: str
    source: str
    intercept: Annotated[float, NUMBER]
    lateral: Annotated[float, Unit("per_10mm", 100.0).not_negative]
    axial: Annotated[float, Unit("per_10mm", 100.0).not_negative]
    angle: Annotated[float, Unit("per_10deg", 18.0 / math.pi).not_negative]
    kind: Annotated[Literal["hand"], KIND, REQUIRED] = "hand"

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """Probability by the logistic curve; the fruit's diameter does not matter."""
        logit = self.intercept - self.lateral * lateral - self.axial * axial - self.angle * angle
        return np.asarray(0.5 * (1.0 + np.tanh(logit / 2)))

    @property
    def tolerance(self) -> float:
        """Distance aside at which a fruit is taken one time in two, m."""
        return max(self.intercept / self.lateral, 0.0)


@toml_table
class Suction(checks.Preset):
    """A suction cup where contact is simulated, and what it meets.

    Attributes:
        thickness: Thickness of the cup, m.
        lip: Distance at which its soft lip closes on a fruit, m.
        holds: Force with which it holds fruit, as a multiple of the pull that detaches 95 % of fruit.
        turning: Damping of a fruit that turns about its stem, N·m·s.
        source: Source of its numbers.
    """

    thickness: Annotated[float, MM.positive]
    lip: Annotated[float, MM.not_negative]
    holds: Annotated[float, NUMBER.positive]
    turning: Annotated[float, Unit("N_m_s").not_negative]
    source: str = ""


load_suction = preset_files.loader("suction", Suction)
"""Reads a suction cup by name (`shipped("suction")`) or from a path to a TOML file."""


def misalignment(
    offset: ArrayLike, tool_axis: ArrayLike, wanted_axis: ArrayLike | None = None
) -> tuple[Array, Array, Array]:
    """Misalignment of a fruit in the tool, as `capture_probability` takes it.

    Args:
        offset: Vector from the tool's point to the fruit's centre, m, shape (..., 3).
        tool_axis: Direction in which the tool approaches, shape (..., 3).
        wanted_axis: Direction in which it should approach, shape (..., 3); None stands for the tool's axis.

    Returns:
        Lateral misalignment, m, axial misalignment, m, and angle, rad, of shape (...) each. Axial is positive beyond
        the tool's point.
    """
    offset, axis = checks.points("the offset", offset), checks.directions("the tool axis", tool_axis)
    axial = np.einsum("...i,...i->...", offset, axis)
    lateral = np.linalg.norm(offset - axial[..., None] * axis, axis=-1)
    if wanted_axis is None:
        return lateral, axial, np.zeros_like(axial)
    ideal = checks.directions("the wanted axis", wanted_axis)
    sine = np.linalg.norm(np.cross(axis, ideal), axis=-1)
    angle = np.arctan2(sine, np.einsum("...i,...i->...", axis, ideal))
    return lateral, axial, np.broadcast_to(angle, np.broadcast_shapes(angle.shape, axial.shape))


def capture_probability(
    gripper: Gripper, lateral: ArrayLike, axial: ArrayLike, angle: ArrayLike, diameter: ArrayLike | None = None
) -> Array:
    """Probability that a gripper takes the fruit.

    Args:
        gripper: A cup (0 or 1), a hand, or a gripper of another package.
        lateral: Misalignment across the tool's axis, m; its sign does not matter. Shapes broadcast.
        axial: Misalignment along the tool's axis, m; its sign does not matter.
        angle: Angle between the tool's axis and the wanted one, rad; its sign does not matter.
        diameter: Fruit diameter, m; None is the fruit that the gripper is meant for.

    Raises:
        InputError: If a misalignment is NaN or infinite.
    """
    x = np.abs(checks.numbers("the lateral misalignment (m)", lateral))
    z = np.abs(checks.numbers("the axial misalignment (m)", axial))
    phi = np.abs(checks.numbers("the angular misalignment (rad)", angle))
    return gripper.probability(x, z, phi, diameter)


def load_gripper(name: str | Path) -> Gripper:
    """Read a gripper by name or file.

    Args:
        name: Name of a preset (`shipped("gripper")`), path of a TOML file, or name of a registered gripper that needs
            no numbers.

    Raises:
        InputError: If there is none of that name, it needs a file with its numbers, or the file is at fault.
    """
    if str(name) not in names("gripper"):
        gripper: Gripper = preset_files.load("gripper", name, gripper_kind)
        return gripper
    try:
        gripper = get("gripper", str(name))()
    except TypeError as error:
        raise InputError(f"gripper '{name}' has numbers; give a file (.toml) with kind = '{name}' and them") from error
    return gripper


def gripper_kind(table: Mapping[str, Any]) -> type[Any]:
    """Class of the gripper that a table of a file describes.

    Raises:
        InputError: If there is no such kind.
    """
    kind = table.get("kind", "cup")
    if kind not in names("gripper"):
        raise InputError(f"kind is {kind!r}; give {' or '.join(map(repr, names('gripper')))}")
    registered: type[Any] = get("gripper", kind)
    return registered


def gripper_file() -> Any:
    """Type of a gripper file: the union of all registered classes."""
    kinds = tuple(kind for kind in load_all("gripper").values() if is_dataclass(kind))
    return Annotated[Union[kinds], Kinds(gripper_kind)]  # noqa: UP007 - their number is not known before
