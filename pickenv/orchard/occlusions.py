"""What a camera can see and an arm can get at: foliage and fruit in the way, a free way from below.

Fruit are spheres, so from a viewpoint each is a disc of angular radius asin(r/d); nearer discs cover parts of farther
ones (area of two circles' overlap). Units: m, rad. Frame: see canopy.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import InputError, Unit, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.canopy import Canopy, foliage_transmission
from pickenv.orchard.checks import MM, Array, Flags


@dataclass(frozen=True, eq=False)
class Occlusion:
    """How much of each fruit a viewpoint sees, in expectation; leading dimensions are those of the viewpoints.

    Attributes:
        foliage: Share not hidden by leaves, shape (..., n).
        neighbours: Share not hidden by other fruit, shape (..., n).
        visible_side: Unit vectors across the line of sight, away from the fruit that hide this one; zero where none
            does, shape (..., n, 3).
    """

    foliage: Array
    neighbours: Array
    visible_side: Array

    @property
    def visible(self) -> Array:
        """Share of each fruit's disc in sight, shape (..., n)."""
        return np.asarray(self.foliage * self.neighbours)


def occlusion(canopy: Canopy, positions: ArrayLike, diameters: ArrayLike, viewpoint: ArrayLike) -> Occlusion:
    """Share of each fruit that a viewpoint sees.

    Args:
        canopy: The foliage.
        positions: Fruit centres, m, shape (n, 3).
        diameters: Fruit diameters, m, shape (n,) or a number.
        viewpoint: Camera positions, m, shape (..., 3).

    Raises:
        InputError: If a number is not finite, a diameter not above zero, or a viewpoint lies inside a fruit.
    """
    positions, diameters = checks.fruit_arrays(positions, diameters)
    viewpoint = checks.points("the viewpoint", viewpoint)
    sight = positions - viewpoint[..., None, :]
    distance = np.linalg.norm(sight, axis=-1)
    if (distance <= diameters / 2).any():
        raise InputError("the viewpoint lies inside a fruit; move the camera away")
    transmitted = foliage_transmission(canopy, viewpoint[..., None, :], positions)
    ray = sight / distance[..., None]
    radius = np.arcsin(diameters / 2 / distance)
    cosine = np.einsum("...ik,...jk->...ij", ray, ray)
    apart = np.arccos(np.clip(cosine, -1.0, 1.0))
    covered = disc_cover(radius[..., :, None], radius[..., None, :], apart)
    covered = np.where(distance[..., None, :] < distance[..., :, None], covered, 0.0)  # only by nearer fruit
    towards = ray[..., None, :, :] - cosine[..., None] * ray[..., :, None, :]  # across i's line of sight, towards j
    length = np.linalg.norm(towards, axis=-1, keepdims=True)
    towards = np.divide(towards, length, out=np.zeros_like(towards), where=length > 1e-9)
    away = -np.einsum("...ij,...ijk->...ik", covered, towards)
    length = np.linalg.norm(away, axis=-1, keepdims=True)
    return Occlusion(
        foliage=transmitted,
        neighbours=np.prod(1.0 - covered, axis=-1),
        visible_side=np.divide(away, length, out=np.zeros_like(away), where=length > 1e-12),
    )


def disc_cover(radius: ArrayLike, other: ArrayLike, apart: ArrayLike) -> Array:
    """Share of a disc's area under another disc, whose centre is ``apart`` away; any shapes that broadcast."""
    r, s, d = (np.asarray(value, dtype=float) for value in np.broadcast_arrays(radius, other, apart))
    inside = d <= np.abs(r - s) + 1e-12 * (r + s)
    safe = np.where(inside | (d >= r + s), np.maximum(r, s), d)  # any distance at which the discs cross
    a = np.arccos(np.clip((safe**2 + r**2 - s**2) / (2 * safe * r), -1.0, 1.0))
    b = np.arccos(np.clip((safe**2 + s**2 - r**2) / (2 * safe * s), -1.0, 1.0))
    lens = r**2 * (a - np.sin(2 * a) / 2) + s**2 * (b - np.sin(2 * b) / 2)
    lens = np.where(inside, np.pi * np.minimum(r, s) ** 2, np.where(d >= r + s, 0.0, lens))
    return np.asarray(np.clip(lens / (np.pi * r**2), 0.0, 1.0))


def approach_clear(
    positions: ArrayLike, diameters: ArrayLike, direction: ArrayLike, tool_radius: float, buffer: float = 0.1
) -> Flags:
    """Which fruit a round tool can come up to without touching another fruit.

    Args:
        positions: Fruit centres, m, shape (n, 3).
        diameters: Fruit diameters, m, shape (n,) or a number.
        direction: Direction of approach, shape (3,) or (n, 3); see `approach_direction`.
        tool_radius: Radius of the tool, m.
        buffer: Length of the straight approach that ends at the fruit's centre, m.

    Returns:
        Flags, shape (n,).
    """
    positions, diameters = checks.fruit_arrays(positions, diameters)
    checks.positive("the tool radius (m)", tool_radius)
    checks.not_negative("the approach buffer (m)", buffer)
    direction = np.broadcast_to(checks.directions("the approach direction", direction), positions.shape)
    offset = positions[None, :, :] - positions[:, None, :]  # from target i to fruit j
    back = np.clip(np.einsum("ijk,ik->ij", offset, -direction), 0.0, buffer)
    gap = np.linalg.norm(offset + back[..., None] * direction[:, None, :], axis=-1) - diameters / 2 - tool_radius
    np.fill_diagonal(gap, np.inf)
    return np.asarray((gap >= 0).all(axis=1))


# Where a picking arm stands before the canopy, how big its tool is, and what it does to fruit. Units: m, s, N.


@toml_table
class Station(checks.Preset):
    """A section of canopy before an arm's base; the arm comes from below.

    Attributes:
        middle: x of the section's middle in the base frame, m.
        face: y of the canopy's face, m.
        mount: z of its lowest fruit, m.
        width: Size of the section, m.
        height: m.
        depth: m.
        tool_radius: Outer radius of the gripper, m.
        tool_length: Its length below the tool's point, m.
        approach: Straight way from below to a fruit, m.
        blocked: Fruit nearer than this to the axis of that way blocks it, m.
        near: The gripper closes only where its fruit is believed to be nearer than this, m.
        collected_below: A detached fruit is collected once the tool has gone down by this, m.
        bruise_speed: A tool that hits a fruit faster than this bruises it, m/s.
        knock: How far a failed grasp pushes its fruit, m.
        most_push: How far any fruit can be pushed, m.
        twist: Torque of the gripper at full command, N·m.
        source: Where its numbers come from.
    """

    middle: Annotated[float, MM]
    face: Annotated[float, MM]
    mount: Annotated[float, MM]
    width: Annotated[float, MM.positive]
    height: Annotated[float, MM.positive]
    depth: Annotated[float, MM.positive]
    tool_radius: Annotated[float, MM.positive]
    tool_length: Annotated[float, MM.positive]
    approach: Annotated[float, MM.positive]
    blocked: Annotated[float, MM.positive]
    near: Annotated[float, MM.positive]
    collected_below: Annotated[float, MM.positive]
    bruise_speed: Annotated[float, Unit("m_per_s").positive]
    knock: Annotated[float, MM.positive]
    most_push: Annotated[float, MM.positive]
    twist: Annotated[float, Unit("N_m").positive]
    source: str = ""


def load_station(name: str | Path) -> Station:
    """Read a station by name (`shipped("station")`) or from a path to a TOML file."""
    return preset_files.load("station", name, Station)
