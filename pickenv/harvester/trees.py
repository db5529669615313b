"""Trees of an orchard row or of Li's lab, with fruit positions in the harvester's base frame.

The machine's column stands in front of the canopy, at the distance `Canopy.standoff`. The tree is at negative y.
Units: m, kg.
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
    """One side of a tree, in front of the machine.

    Attributes:
        fruit: Fruit centres in the base frame, m, (n, 3).
        diameters: Diameters of the fruit, m, (n,).
        masses: Masses of the fruit, kg, (n,).
        side: Limits of the side that is divided into zones, base frame, m: smallest and largest x, smallest and largest
            z.
    """

    fruit: Array
    diameters: Array
    masses: Array
    side: tuple[float, float, float, float]

    def __len__(self) -> int:
        return len(self.fruit)


@toml_table
class Orchard:
    """Table [trees] of a picking file: the model from which trees are drawn.

    Attributes:
        canopy: Canopy, a preset of `pickenv.orchard`.
        fruit_map: Distribution of the fruit over the canopy, a preset of `pickenv.orchard`.
        fruit_size: Diameters and density of the fruit, a preset of `pickenv.orchard`.
        per_metre: Number of fruit per metre of the row of trees.
    """

    canopy: Annotated[trees.Canopy, Then(lambda name, _: trees.load_canopy(name), str)]
    fruit_map: Annotated[trees.FruitMap, Then(lambda name, _: trees.load_fruit_map(name), str)]
    fruit_size: Annotated[trees.FruitSize, Then(lambda name, _: trees.load_fruit_size(name), str)]
    per_metre: Annotated[float, NUMBER.not_negative]


@toml_table
class Lab:
    """Table [lab] of a picking file: the experiment of Li 2016, section 5.2.

    Attributes:
        canopy: Name of the canopy.
        runs: Number of pictures, each of one zone.
        fruit: Number of fruit in each picture.
        width: Width of the zone in a picture, m.
        height: Height of the zone in a picture, m.
        apart: Least distance between two fruit, m.
    """

    canopy: str
    runs: Annotated[int, WHOLE.positive]
    fruit: Annotated[int, WHOLE.positive]
    width: Annotated[float, MM.positive]
    height: Annotated[float, MM.positive]
    apart: Annotated[float, MM.positive]


def load_orchard(*, per_metre: float | None = None, fruit_map: str | None = None, canopy: str | None = None) -> Orchard:
    """Read the model of trees from the picking file that comes with pickenv.

    Args:
        per_metre: Number of fruit per metre of the row of trees; the file's by default.
        fruit_map: Fruit map of `pickenv.orchard`; the file's by default. "v_trellis" hangs fruit in clusters of three.
        canopy: Canopy of `pickenv.orchard`; the file's by default. "li2016_bare" has no leaves.

    Raises:
        InputError: If a preset is unknown or a number is outside its limits.
    """
    orchard = read_toml(Orchard, SHIPPED, section="trees")
    per_metre = orchard.per_metre if per_metre is None else per_metre
    crop = orchard.fruit_map if fruit_map is None else trees.load_fruit_map(fruit_map)
    row = orchard.canopy if canopy is None else trees.load_canopy(canopy)
    return replace(orchard, canopy=row, fruit_map=crop.scaled(per_metre), per_metre=per_metre)


def sample_tree(machine: Machine, orchard: Orchard, rng: np.random.Generator) -> Tree:
    """Draw one side of a tree, with fruit positions in the machine's base frame.

    Args:
        machine: The machine.
        orchard: Model from which the tree is drawn.
        rng: Random generator.
    """
    canopy = orchard.canopy
    positions, diameters = trees.sample_fruit(orchard.fruit_map, orchard.fruit_size, canopy, rng)
    half = canopy.width / 2
    side = (-half, half, canopy.bottom - machine.base_height, canopy.top - machine.base_height)
    masses = trees.fruit_masses(orchard.fruit_size, diameters)
    return Tree(in_base_frame(machine, canopy, positions), diameters, masses, side)


def in_base_frame(machine: Machine, canopy: trees.Canopy, positions: Array) -> Array:
    """Convert positions (..., 3) from the orchard frame to the machine's base frame, m.

    The base frame is turned by 180 degrees about z. Its origin is at the machine's column, at the height of the base
    above the ground.
    """
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([-x, -(y + canopy.standoff), z - machine.base_height], axis=-1)


def tree_leaves(machine: Machine, eyes: trees.Eyes, rng: np.random.Generator) -> trees.Leaves | None:
    """Draw the leaves of a tree in the machine's base frame; return None unless ``eyes`` renders pictures.

    ``eyes`` is the model of how cameras see fruit; it has the canopy.
    """
    leaves = trees.foliage(eyes, rng)
    return None if leaves is None else replace(leaves, places=in_base_frame(machine, eyes.canopy, leaves.places))


@cache
def load_lab() -> Lab:
    """Return the table [lab] of the picking file (Li's experiment); the file is read only once."""
    return read_toml(Lab, SHIPPED, section="lab")


def lab_zone(canopy: trees.Canopy) -> Array:
    """Return width, depth (that of ``canopy``) and height of the zone that a picture of Li's lab shows, m, (3,)."""
    lab = load_lab()
    return np.array([lab.width, canopy.depth, lab.height])
