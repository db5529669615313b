"""Grippers and what they forgive: a cup with a hard edge, or a compliant hand that fails ever more often.

Misalignment of the fruit in the tool: lateral (across the tool's axis), axial (along it), angle. Units: m, rad.
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
    """The members of a gripper; a class of them is registered, and read from files by its field ``kind``."""

    @property
    def name(self) -> str:
        """Its name in tables."""
        ...

    @property
    def kind(self) -> str:
        """The name that its class is registered by."""
        ...

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """Probability that it takes the fruit, from sizes of misalignment, m and rad, of shapes that broadcast."""
        ...

    @property
    def tolerance(self) -> float:
        """Distance from the tool's axis at which a fruit is taken, m: always by a cup, one time in two by a hand."""
        ...


@register("gripper", "cup")
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

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """1 inside the tolerances, 0 outside; without a diameter the fruit is the one that it is meant for."""
        fruit = self.fruit if diameter is None else checks.numbers("the fruit diameter (m)", diameter, lowest=0.0)
        inside = (lateral <= (self.opening - fruit) / 2) & (axial <= self.axial) & (angle <= self.angle)
        return np.asarray(inside, dtype=np.float64)

    @property
    def tolerance(self) -> float:
        """Distance aside up to which a fruit is always taken, m."""
        return (self.opening - self.fruit) / 2.0


@register("gripper", "hand")
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

    def probability(self, lateral: Array, axial: Array, angle: Array, diameter: ArrayLike | None) -> Array:
        """The logistic curve; the fruit's diameter does not matter."""
        logit = self.intercept - self.lateral * lateral - self.axial * axial - self.angle * angle
        return np.asarray(0.5 * (1.0 + np.tanh(logit / 2)))

    @property
    def tolerance(self) -> float:
        """Distance aside at which a fruit is taken one time in two, m."""
        return max(self.intercept / self.lateral, 0.0)


def misalignment(
    offset: ArrayLike, tool_axis: ArrayLike, wanted_axis: ArrayLike | None = None
) -> tuple[Array, Array, Array]:
    """Misalignment of a fruit in the tool from geometry, as `capture_probability` takes it.

    Args:
        offset: From the tool's point to the fruit's centre, m, shape (..., 3).
        tool_axis: Direction in which the tool approaches, shape (..., 3).
        wanted_axis: Direction in which it should approach, shape (..., 3); None means that it does.

    Returns:
        Lateral and axial, m, the latter positive beyond the tool's point, and the angle, rad, each of shape (...).
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
    """Probability that the gripper takes the fruit.

    Args:
        gripper: A cup (0 or 1), a hand, or another package's.
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
    return gripper.probability(x, z, phi, diameter)


def load_gripper(name: str | Path) -> Gripper:
    """Read a gripper by name (`shipped("gripper")`), from a path to a TOML file, or a registered one as it is made.

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
    """The class of gripper that a table of a file describes.

    Raises:
        InputError: If there is no such kind.
    """
    kind = table.get("kind", "cup")
    if kind not in names("gripper"):
        raise InputError(f"kind is {kind!r}; give {' or '.join(map(repr, names('gripper')))}")
    registered: type[Any] = get("gripper", kind)
    return registered


def gripper_file() -> Any:
    """The type of a gripper file: the union of all registered classes."""
    kinds = tuple(kind for kind in load_all("gripper").values() if is_dataclass(kind))
    return Annotated[Union[kinds], Kinds(gripper_kind)]  # noqa: UP007 - their number is not known before
