"""The trees that the harvester works: fruit in the machine's base frame, as the orchard has it or as in Li's lab.

The machine's column stands at the canopy's stand-off; the tree is at negative y. Units: m, kg.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np

from pickenv import orchard as trees
from pickenv.arm import Array
from pickenv.base import MM, NUMBER, WHOLE, Then, read_toml, toml_table
from pickenv.harvester.machine import Machine

SHIPPED = Path(__file__).parent / "picking.toml"


@dataclass(frozen=True, eq=False)
class Tree:
    """One side of a tree as the machine meets it.

    Attributes:
        fruit: Centres in the base frame, m, (n, 3).
        diameters: m, (n,).
        masses: kg, (n,).
        side: Left, right, bottom and top of the side that is cut into zones, m.
    """

    fruit: Array
    diameters: Array
    masses: Array
    side: tuple[float, float, float, float]

    def __len__(self) -> int:
        return len(self.fruit)


@toml_table
class Orchard:
    """[trees] of a picking file: presets of `pickenv.orchard`, and fruit per metre of row."""

    canopy: Annotated[trees.Canopy, Then(lambda name, _: trees.load_canopy(name), str)]
    fruit_map: Annotated[trees.FruitMap, Then(lambda name, _: trees.load_fruit_map(name), str)]
    fruit_size: Annotated[trees.FruitSize, Then(lambda name, _: trees.load_fruit_size(name), str)]
    per_metre: Annotated[float, NUMBER.not_negative]


@toml_table
class Lab:
    """[lab] of a picking file: canopy, images, fruit in each, size of the image and least distance of fruit, m."""

    canopy: str
    runs: Annotated[int, WHOLE.positive]
    fruit: Annotated[int, WHOLE.positive]
    width: Annotated[float, MM.positive]
    height: Annotated[float, MM.positive]
    apart: Annotated[float, MM.positive]


def load_orchard(
    path: str | Path = SHIPPED,
    *,
    per_metre: float | None = None,
    fruit_map: str | None = None,
    canopy: str | None = None,
) -> Orchard:
    """Read the trees of a picking file.

    Args:
        path: The file.
        per_metre: Fruit per metre of row instead of the file's.
        fruit_map: A fruit map of `pickenv.orchard` instead of the file's; "v_trellis" hangs fruit in clusters of three.
        canopy: A canopy of `pickenv.orchard` instead of the file's; "li2016_bare" has no leaves.
    """
    orchard = read_toml(Orchard, path, section="trees")
    per_metre = orchard.per_metre if per_metre is None else per_metre
    crop = orchard.fruit_map if fruit_map is None else trees.load_fruit_map(fruit_map)
    row = orchard.canopy if canopy is None else trees.load_canopy(canopy)
    return replace(orchard, canopy=row, fruit_map=crop.scaled(per_metre), per_metre=per_metre)


def sample_tree(machine: Machine, orchard: Orchard, rng: np.random.Generator) -> Tree:
    """Draw one tree side."""
    canopy = orchard.canopy
    positions, diameters = trees.sample_fruit(orchard.fruit_map, orchard.fruit_size, canopy, rng)
    half = canopy.width / 2
    side = (-half, half, canopy.bottom - machine.base_height, canopy.top - machine.base_height)
    return Tree(
        in_base_frame(machine, canopy, positions), diameters, trees.fruit_masses(orchard.fruit_size, diameters), side
    )


def in_base_frame(machine: Machine, canopy: trees.Canopy, positions: Array) -> Array:
    """Orchard positions (..., 3) in the base frame: x and y turn by half a turn, heights count from the base."""
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([-x, -(y + canopy.standoff), z - machine.base_height], axis=-1)


def tree_leaves(machine: Machine, eyes: trees.Eyes, rng: np.random.Generator) -> trees.Leaves | None:
    """A tree's leaves in the base frame; None where the eyes draw no pictures."""
    leaves = trees.foliage(eyes, rng)
    return None if leaves is None else replace(leaves, places=in_base_frame(machine, eyes.canopy, leaves.places))


@cache
def load_lab() -> Lab:
    """Read Li's experiment."""
    return read_toml(Lab, SHIPPED, section="lab")


def lab_zone(canopy: trees.Canopy) -> Array:
    """Width, depth and height of what an image of Li's lab shows, m, (3,)."""
    lab = load_lab()
    return np.array([lab.width, canopy.depth, lab.height])
