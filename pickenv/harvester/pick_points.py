"""Trees, and where the machine looks and stands: zones of a tree's side (Li 2016, section 2.2), and pick points.

Trees are of an orchard row or of Li's lab, with fruit positions in the harvester's base frame. The machine's column
stands in front of the canopy, at the distance `Canopy.standoff`. The tree is at negative y.

At a pick point the master stands while its slaves pick. The point follows from eqs (7) to (12), as printed or
corrected, or from a search. The printed equations have two faults. They put frame 3 at polar angle theta2 and ignore
a2, although theta2 is the arm's heading. And eq (7) exchanges the left and right border fruit at negative y. The search
follows the paper's "master moves much, slaves little". Of the points from which most fruit is reached, it takes the one
with the least motion of the slaves. Units: m, rad, kg.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv import orchard as trees
from pickenv.arm import Array
from pickenv.base import DEG, MM, NUMBER, WHOLE, InputError, Then, check_known, read_toml, toml_table
from pickenv.harvester.machine import Machine
from pickenv.orchard import Viewpoint

PICKING_FILE = Path(__file__).parent / "picking.toml"


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
    orchard = read_toml(Orchard, PICKING_FILE, section="trees")
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
    return read_toml(Lab, PICKING_FILE, section="lab")


def lab_zone(canopy: trees.Canopy) -> Array:
    """Return width, depth (the depth of ``canopy``) and height of the zone in a picture of Li's lab, m, (3,)."""
    lab = load_lab()
    return np.array([lab.width, canopy.depth, lab.height])


# Zones: a grid of overlapping parts of a tree's side, each seen in one picture. Positions are in the machine's base
# frame: x along the row, the tree at negative y, z up.


STRATEGY_FILE = Path(__file__).parent / "strategy.toml"
AHEAD = np.array([0.0, -1.0, 0.0])
"""Direction from the machine to the trees, base frame, (3,)."""


@dataclass(frozen=True)
class Zone:
    """One part of a tree's side, including the overlap with its neighbours; base frame, m.

    Attributes:
        name: Row from the bottom and column by rising x, both from 1, for reports.
        left: Smallest x.
        right: Largest x.
        bottom: Smallest z.
        top: Largest z.
    """

    name: str
    left: float
    right: float
    bottom: float
    top: float

    def holds(self, positions: ArrayLike) -> NDArray[np.bool_]:
        """Return flags (...): whether positions (..., 3), base frame, m, are inside the zone in x and z."""
        points = np.asarray(positions, dtype=float)
        x, z = points[..., 0], points[..., 2]
        return np.asarray((x >= self.left) & (x <= self.right) & (z >= self.bottom) & (z <= self.top))

    @property
    def view(self) -> Viewpoint:
        """Camera's position for the zone's picture, base frame, m, and its direction of view, (3,) each.

        The position has the x and z of the zone's middle, and y = 0. The direction is -y, towards the trees.
        """
        return np.array([(self.left + self.right) / 2, 0.0, (self.bottom + self.top) / 2]), AHEAD


@toml_table
class Grid:
    """Division of a tree's side into zones.

    Attributes:
        columns: Number of zones side by side.
        rows: Number of zones above one another.
        overlap: Overlap of neighbouring zones, m.
    """

    columns: Annotated[int, WHOLE.positive]
    rows: Annotated[int, WHOLE.positive]
    overlap: Annotated[float, MM.not_negative]


def load_grid() -> Grid:
    """Return the table [zones] of the strategy file."""
    return read_toml(Grid, STRATEGY_FILE, section="zones")


def cut(grid: Grid, left: float, right: float, bottom: float, top: float) -> list[Zone]:
    """Return the zones that cover a tree's side, in the order in which they are harvested.

    The order goes from column to column by rising x: up the first column, down the second, up the third, and so on.

    Args:
        grid: Numbers of columns and rows, and their overlap.
        left: Smallest x of the side, m.
        right: Largest x, m.
        bottom: Smallest z, m.
        top: Largest z, m.

    Raises:
        InputError: If the side is empty or a zone would not be larger than its overlap.
    """
    if not (right > left and top > bottom):
        raise InputError(f"the tree's side from x {left} to {right} m and z {bottom} to {top} m is empty")
    wide, high = (right - left) / grid.columns, (top - bottom) / grid.rows
    if min(wide, high) <= grid.overlap:
        raise InputError(
            f"zones of {wide * 1e3:.0f} x {high * 1e3:.0f} mm cannot overlap by {grid.overlap * 1e3:.0f} mm; "
            "give fewer zones or less overlap"
        )
    half = grid.overlap / 2
    zones = []
    for column in range(grid.columns):
        for row in range(grid.rows) if column % 2 == 0 else reversed(range(grid.rows)):
            name, x, z = f"row {row + 1}, column {column + 1}", left + column * wide, bottom + row * high
            zones.append(Zone(name, x - half, x + wide + half, z - half, z + high + half))
    return zones


# Pick points.


METHODS = ("as_printed", "equations", "corrected", "search")


def border_indices(fruit: Array, printed: bool = False) -> tuple[int, int]:
    """Return the indices (from 0) of the left-most fruit P3 and the right-most P4, as seen from the base, by eq (7).

    As printed, eq (7) takes the fruit with the largest arctan(X/Y) as P3. At Y < 0, where Li's trees stand, this is the
    right-most fruit.

    Args:
        fruit: Positions in the base frame, m, (n, 3).
        printed: Whether to take eq (7) as printed.
    """
    x, y = fruit[:, 0], fruit[:, 1]
    bearing = np.arctan(x / y) if printed else np.arctan2(x, -y)
    return int(bearing.argmax()), int(bearing.argmin())


def pick_heading(fruit: Array, spacing: float, printed: bool = False) -> float:
    """Compute the heading theta2 of the master at its pick point by eqs (10) and (11), rad.

    Args:
        fruit: Positions in the base frame, m, (n, 3).
        spacing: Distance from the middle slave to the outermost slave, m; the paper's k0.
        printed: Whether to take eqs (7) and (11) as printed.

    Raises:
        InputError: If a border fruit is no farther than ``spacing`` from the master's axis.
    """
    first, last = border_indices(fruit, printed)
    (x3, y3), (x4, y4) = fruit[first, :2], fruit[last, :2]
    for x, y in ((x3, y3), (x4, y4)):
        if np.hypot(x, y) <= spacing:
            raise InputError(f"a border fruit at ({x:.3f}, {y:.3f}) m is nearer to the axis than the arms are apart")
    beta = np.arctan(x4 / abs(y4)) + np.arcsin(spacing / np.hypot(x4, y4))
    angle = np.arctan(abs(y3) / x3) if printed else np.arctan2(abs(y3), x3)
    gamma = angle + np.arcsin(spacing / np.hypot(x3, y3))
    return float((beta - gamma) / 2 - np.pi / 4)


def pick_point(machine: Machine, fruit: ArrayLike, method: str = "search") -> Array:
    """Return the master joints (3,) at the pick point, where the master stands while its slaves pick a zone's fruit.

    Args:
        machine: The machine.
        fruit: Positions in the base frame, m, (n, 3).
        method: "as_printed" takes eqs (7) to (12) as printed. "equations" corrects the border fruit of eq (7) and
            the arctangent of eq (11). "corrected" also takes theta2 as the master's joint theta1. "search" looks for
            the point from which most fruit is reached with least motion of the slaves.

    Returns:
        Joints, rad and m. The joints of "search" are within the limits; the joints of other methods may be outside.

    Raises:
        InputError: If there is no fruit, a coordinate is not finite or the method is unknown. Also if the fruit is too
            near for the equations (see `pick_heading`), or the point is nearer to the master's axis than a2.
    """
    fruit = np.asarray(fruit, dtype=float)
    if fruit.ndim != 2 or fruit.shape[-1] != 3 or not len(fruit) or not np.isfinite(fruit).all():
        raise InputError("a pick point needs at least one fruit, each with three finite coordinates")
    check_known("pick point method", method, METHODS)
    if method == "search":
        master = searched(machine, fruit)
    else:
        printed = method == "as_printed"
        span = float(machine.offsets[-1]) if machine.arms > 1 else 0.0  # the paper's k0: middle to side arm
        heading = pick_heading(fruit, span, printed)
        reach = float(np.hypot(fruit[:, 0], fruit[:, 1]).min() - machine.a4 - machine.slave_home[2])  # eq (9)
        stroke = float(machine.slave.upper[0] - machine.slave.lower[0])
        height = float(fruit[:, 2].min()) + stroke / 2  # eq (8)
        if method == "corrected":
            master = np.array([heading, height - machine.d1, reach])
        else:
            master = machine.master_inverse([reach * np.cos(heading), reach * np.sin(heading), height])  # eq (12)
    if not np.isfinite(master).all():
        raise InputError("the pick point is nearer to the axis than frame 3 can come; choose another zone")
    return master


def searched(machine: Machine, fruit: Array) -> Array:
    """Return the master joints (3,), rad and m, from which most fruit is reached.

    Of several such joints, joints with little motion of the slaves are preferred. The search evaluates two grids of the
    master's headings and reaches (how far it extends). The second grid is finer, and lies around the best point of the
    first. Each grid is combined with a few heights (`_heights`): all slaves reach the same heights, so the height does
    not depend on heading and reach. ``fruit`` has positions in the base frame, m, (n, 3).
    """
    settings = _search()
    low, high = machine.master.nominal.lower, machine.master.nominal.upper
    farthest = high[2] + machine.a4 + machine.slave.upper[2] + machine.a2 + np.abs(machine.offsets).max()
    near = np.hypot(fruit[:, 0], fruit[:, 1]) <= farthest
    fruit = fruit[near] if near.any() else fruit  # what no arm could ever reach must not pull the pick point away
    heights = _heights(machine, fruit)
    bottom, top = machine.slave.lower[0], machine.slave.upper[0]
    window = np.abs(fruit[:, 2] - machine.d1 - heights[:, None] - (top + bottom) / 2)  # (k, n)
    inside = window <= (top - bottom) / 2 + 1e-9
    most = inside[int(inside.sum(axis=1).argmax())]
    middle = fruit[most if most.any() else slice(None), :2].mean(axis=0)
    distance = float(np.hypot(*middle))
    ahead = distance - machine.a4 - float(machine.slave.lower[2] + machine.slave.upper[2]) / 2
    heading = np.arctan2(middle[1], middle[0]) + np.arcsin(min(machine.a2 / distance, 1.0))
    best = np.clip([heading, 0.0, ahead], low, high)
    width = np.array([settings.heading, settings.reach])
    for _ in range(2):
        axes = [np.linspace(-w, w, settings.steps) for w in width]
        turn, reach = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
        candidates = np.clip(best + np.stack([turn, np.zeros_like(turn), reach], axis=-1), low, high)
        cost = _point_costs(machine, candidates, fruit, inside)
        which, at = np.unravel_index(int(np.argmin(cost)), cost.shape)
        best = candidates[which].copy()
        best[1] = heights[at]
        width = width * settings.keep_share
    return np.asarray(best)


def _heights(machine: Machine, fruit: Array) -> Array:
    """Return heights d2 of the master to try, m, (k,).

    One height is for the middle of the fruit. At each of the others, one fruit is at an end of the slaves' vertical
    slides. ``fruit`` has positions in the base frame, m, (n, 3).
    """
    z = np.unique(fruit[:, 2]) - machine.d1
    bottom, top = machine.slave.lower[0], machine.slave.upper[0]
    heights = np.concatenate([[(z[0] + z[-1]) / 2 - (top + bottom) / 2], z - bottom, z - top])
    return np.asarray(np.clip(heights, machine.master.nominal.lower[1], machine.master.nominal.upper[1]))


def _point_costs(machine: Machine, masters: Array, fruit: Array, inside: NDArray[np.bool_]) -> Array:
    """Return the costs (m, k) of m pairs of the master's heading and reach, each at k heights.

    Each fruit in reach of some arm subtracts one. The slaves' motion adds less than one. The number of fruit in reach
    of the arm that reaches fewest subtracts less than one.

    Args:
        machine: The machine.
        masters: Master joints, (m, 3).
        fruit: Positions in the base frame, m, (n, 3).
        inside: Whether the vertical slide reaches each fruit at each height, (k, n).
    """
    joints = machine.slave_inverse(masters, fruit)[..., 1:]  # (m, arms, n, 2): height is judged by ``inside``
    low, high = machine.slave.lower[1:], machine.slave.upper[1:]
    reached = ((joints >= low - 1e-9) & (joints <= high + 1e-9)).all(axis=-1)
    motion = (np.abs(joints - machine.slave_home[1:]) / (high - low)).sum(axis=-1)
    easiest = np.where(reached, motion, np.inf).min(axis=1)  # (m, n)
    in_reach = np.isfinite(easiest)
    easiest = np.where(in_reach, easiest, 0.0)
    within = inside.T.astype(float)  # (n, k)
    gained = in_reach @ within
    load = (reached @ within).min(axis=1)  # (m, k): fruit in reach of the arm that has fewest
    share = np.minimum(load / max(len(fruit) / machine.arms, 1.0), 1.0)
    return np.asarray(-gained + 0.3 * (easiest @ within) / (1.5 * len(fruit)) - 0.3 * share)


@toml_table
class Search:
    """Table [search] of a strategy file: the two grids of the search for a pick point.

    Attributes:
        heading: Half-width of the first grid in the master's heading, rad.
        reach: Half-width of the first grid in the master's reach (how far it extends), m.
        steps: Number of headings of each grid, and number of its reaches.
        keep_share: Half-widths of the second grid as a share of the half-widths of the first.
    """

    heading: Annotated[float, DEG.not_negative]
    reach: Annotated[float, MM.not_negative]
    steps: Annotated[int, WHOLE.positive]
    keep_share: Annotated[float, NUMBER.positive]


_search = cache(partial(read_toml, Search, STRATEGY_FILE, section="search"))
