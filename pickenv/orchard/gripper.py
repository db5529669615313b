"""Grippers and the misalignment that they tolerate: a rigid cup with fixed tolerances, or a compliant hand.

The probability that a compliant hand takes a fruit falls gradually with misalignment. The misalignment of a fruit in
the tool has three parts: lateral (across the tool's axis), axial (along it) and an angle. Units: m, rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, Union, cast

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import DEG, NUMBER, REQUIRED, Check, InputError, Kinds, Unit, register, toml_table
from pickenv.base.registry import get, load_all, names
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array

KIND = Check(lambda value: value in names("gripper"), "'cup' or 'hand'")


class Gripper(Protocol):
    """Interface of grippers. Classes of grippers are registered by name; a gripper file gives this name as ``kind``."""

    @property
    def name(self) -> str:
        """Name of this gripper, used in result tables."""

    @property
    def kind(self) -> str:
        """Name under which the gripper's class is registered."""

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """Return the probability that the gripper takes the fruit, 0 to 1, as an array.

        Args:
            lateral: Absolute value of the lateral misalignment, m. Shapes broadcast.
            axial: Absolute value of the axial misalignment, m.
            angle: Absolute value of the angle between the tool's axis and the axis that it should have, rad.
            diameter: Fruit diameter, m; None for the diameter for which the gripper is designed.
        """

    @property
    def tolerance(self) -> float:
        """Lateral misalignment that is tolerated without other misalignment, m.

        For a cup, it is the largest at which the fruit is taken. For a hand, a fruit is taken with a probability of 0.5
        at this misalignment.
        """


@register("gripper", "cup")
@toml_table
class Cup(checks.Preset):
    """A rigid cup: it takes the fruit if every misalignment stays within its tolerance.

    Attributes:
        name: Name of the preset.
        source: Source of its numbers.
        opening: Inner diameter, m.
        fruit: Fruit diameter for which the cup is designed, m.
        axial: Largest axial misalignment, m.
        angle: Largest angle between the cup's axis and the axis along which it should approach the fruit, rad.
        kind: Always "cup"; selects this class in a gripper file.
    """

    name: str
    source: str
    opening: Annotated[float, MM.positive]
    fruit: Annotated[float, MM.positive]
    axial: Annotated[float, MM.positive]
    angle: Annotated[float, DEG.positive]
    kind: Annotated[Literal["cup"], KIND, REQUIRED] = "cup"

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """Return 1 inside the tolerances and 0 outside; arguments as in `Gripper.probability`."""
        fruit = self.fruit if diameter is None else checks.numbers("the fruit diameter (m)", diameter, lowest=0.0)
        inside = (lateral <= (self.opening - fruit) / 2) & (axial <= self.axial) & (angle <= self.angle)
        return np.asarray(inside, dtype=np.float64)

    @property
    def tolerance(self) -> float:
        """Largest lateral misalignment at which a fruit of the diameter ``fruit`` is taken, m."""
        return (self.opening - self.fruit) / 2.0


@register("gripper", "hand")
@toml_table
class CompliantHand(checks.Preset):
    """A hand with soft fingers: logit of the success probability = intercept − lateral·|x| − axial·|z| − angle·|φ|.

    Attributes:
        name: Name of the preset.
        source: Source of its numbers.
        intercept: Logit without misalignment.
        lateral: Decrease of the logit per lateral misalignment x, 1/m.
        axial: Decrease of the logit per axial misalignment z, 1/m.
        angle: Decrease of the logit per angle φ, 1/rad.
        kind: Always "hand"; selects this class in a gripper file.
    """

    name: str
    source: str
    intercept: Annotated[float, NUMBER]
    lateral: Annotated[float, Unit("per_10mm", 100.0).positive]
    axial: Annotated[float, Unit("per_10mm", 100.0).not_negative]
    angle: Annotated[float, Unit("per_10deg", 18.0 / math.pi).not_negative]
    kind: Annotated[Literal["hand"], KIND, REQUIRED] = "hand"

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """Return the probability by the logistic function; it does not depend on ``diameter``.

        Arguments as in `Gripper.probability`.
        """
        logit = self.intercept - self.lateral * lateral - self.axial * axial - self.angle * angle
        return np.asarray(0.5 * (1.0 + np.tanh(logit / 2)))

    @property
    def tolerance(self) -> float:
        """Lateral misalignment at which the probability of taking a fruit is 0.5, m; 0 if it is always below 0.5."""
        return max(self.intercept / self.lateral, 0.0)


@toml_table
class Suction(checks.Preset):
    """Parameters of a suction cup for simulations with contact.

    Attributes:
        thickness: Thickness of the cup, m.
        lip: Distance between cup and fruit at which the cup's soft lip seals, m.
        holds: Holding force, as a multiple of the pulling force that detaches 95 % of fruit.
        turning: Damping of the rotation of a fruit about its stem, N·m·s.
        source: Source of its numbers.
    """

    thickness: Annotated[float, MM.positive]
    lip: Annotated[float, MM.not_negative]
    holds: Annotated[float, NUMBER.positive]
    turning: Annotated[float, Unit("N_m_s").not_negative]
    source: str = ""


load_suction = preset_files.loader("suction", Suction)
"""Read a suction cup by its name, one of `shipped("suction")`, or from a TOML file by its path."""


def misalignment(
    offset: ArrayLike, tool_axis: ArrayLike, wanted_axis: ArrayLike | None = None
) -> tuple[Array, Array, Array]:
    """Compute the misalignment of a fruit in the tool, in the form that `capture_probability` takes.

    Args:
        offset: Vector from the tool's point to the fruit's centre, m, shape (..., 3).
        tool_axis: Direction in which the tool approaches, shape (..., 3), in the same frame.
        wanted_axis: Direction in which the tool should approach, shape (..., 3); None for ``tool_axis``.

    Returns:
        Lateral misalignment, m, axial misalignment, m, and angle, rad, of shape (...) each. The axial misalignment is
        positive if the fruit is beyond the tool's point.
    """
    offset, axis = checks.points("the offset", offset), checks.directions("the tool axis", tool_axis)
    axial = np.einsum("...i,...i->...", offset, axis)
    lateral = np.linalg.norm(offset - axial[..., None] * axis, axis=-1)
    ideal = axis if wanted_axis is None else checks.directions("the wanted axis", wanted_axis)
    angle = np.arctan2(np.linalg.norm(np.cross(axis, ideal), axis=-1), np.einsum("...i,...i->...", axis, ideal))
    return lateral, axial, np.broadcast_to(angle, np.broadcast_shapes(angle.shape, axial.shape))


def capture_probability(
    gripper: Gripper, lateral: ArrayLike, axial: ArrayLike, angle: ArrayLike, diameter: ArrayLike | None = None
) -> Array:
    """Return the probability that a gripper takes the fruit, 0 to 1, as an array.

    Args:
        gripper: A cup (whose probability is 0 or 1), a hand, or a gripper of another package.
        lateral: Misalignment across the tool's axis, m; its sign does not matter. Shapes broadcast.
        axial: Misalignment along the tool's axis, m; its sign does not matter.
        angle: Angle between the tool's axis and the direction of approach that it should have, rad, of any sign.
        diameter: Fruit diameter, m; None for the diameter for which the gripper is designed.

    Raises:
        InputError: If a misalignment is NaN or infinite.
    """
    x = np.abs(checks.numbers("the lateral misalignment (m)", lateral))
    z = np.abs(checks.numbers("the axial misalignment (m)", axial))
    phi = np.abs(checks.numbers("the angular misalignment (rad)", angle))
    return gripper.probability(x, z, phi, diameter)


def load_gripper(name: str | Path) -> Gripper:
    """Read a gripper by its name or from a TOML file by its path.

    Args:
        name: Name of a preset (`shipped("gripper")`), path to a TOML file, or name of a registered class of grippers
            without parameters.

    Raises:
        InputError: If there is no such gripper, if its class has parameters and needs a file, or if the file is
            malformed.
    """
    if str(name) not in names("gripper"):
        return cast(Gripper, preset_files.load("gripper", name, gripper_kind))
    try:
        return cast(Gripper, get("gripper", str(name))())
    except TypeError as error:
        raise InputError(f"gripper '{name}' has numbers; give a file (.toml) with kind = '{name}' and them") from error


def gripper_kind(table: Mapping[str, Any]) -> type[Any]:
    """Return the gripper class that the key ``kind`` of a gripper file's table names; "cup" if the key is missing.

    Raises:
        InputError: If there is no such kind.
    """
    kind = table.get("kind", "cup")
    if kind not in names("gripper"):
        raise InputError(f"kind is {kind!r}; give {' or '.join(map(repr, names('gripper')))}")
    return cast(type[Any], get("gripper", kind))


def gripper_file() -> Any:
    """Return the type of a gripper file's content: the union of all registered gripper classes that are dataclasses."""
    kinds = tuple(kind for kind in load_all("gripper").values() if is_dataclass(kind))
    return Annotated[Union[kinds], Kinds(gripper_kind)]  # noqa: UP007 - their number is not known before
