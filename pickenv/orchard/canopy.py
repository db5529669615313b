"""The canopy: a slab of foliage beside the aisle, upright or leaning, in which the fruit hangs.

Orchard frame: x along the row, y from the aisle into the trees, z up from the ground. The face is the surface of the
canopy towards the aisle; it has y = 0 at the height of the lowest fruit. The share of a target that is visible through
foliage follows the law of Beer and Lambert: exp(−projection × leaf area per volume × path length). Fruit are spheres.
From a viewpoint each appears as a disc of angular radius asin(r/d), and nearer discs cover parts of farther ones.
Units: m, rad, m²/m³.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import DEG, NUMBER, SECONDS, SHARE, InputError, Unit, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Flags
from pickenv.orchard.fruit import FruitMap, FruitSize, sample_counts, sample_diameters

# Fruit in a canopy: counts by block become positions, clusters hang together, and no two fruit share a place. Each
# cluster starts as a ring of touching fruit around a random centre in its block, tilted at random; fruit that
# overlaps is pushed apart within its block. Units: m.


ROUNDS = 2000  # of pushing apart; a block with 18 apples takes a few hundred
MOST_FILLED = 0.5  # of a block's volume; spheres thrown in at random jam at 0.64
OVERLAP = 1e-4  # m that two fruit may dent each other


def sample_fruit(fruit_map: FruitMap, size: FruitSize, canopy: Canopy, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw positions and diameters of the fruit in one canopy.

    The square blocks of the fruit map become rectangles, so that a whole number of them fills the canopy's height
    and width. The expected number of fruit per metre of the row of trees is unchanged.

    Args:
        fruit_map: Distribution of the number of fruit per block of the fruiting wall.
        size: Distribution of diameters.
        canopy: The volume to fill.
        rng: Random generator for all draws.

    Returns:
        Centres in the orchard frame, m, (n, 3), and diameters, m, (n,), cluster by cluster. All centres are inside the
        canopy, and fruit do not overlap.

    Raises:
        InputError: If the canopy is so full that fruit cannot be kept apart.
    """
    rows = max(1, round((canopy.top - canopy.bottom) / fruit_map.block))
    columns = max(1, round(canopy.width / fruit_map.block))
    spread = fruit_map.with_rows(rows)
    if spread.density:
        spread = spread.scaled(fruit_map.density * canopy.width / (columns * fruit_map.block))
    counts = sample_counts(spread, columns, rng)
    cell = np.array([canopy.width / columns, canopy.depth, (canopy.top - canopy.bottom) / rows])
    row, column = np.nonzero(counts)
    low = np.stack([column * cell[0] - canopy.width / 2, np.zeros(len(row)), canopy.top - (row + 1) * cell[2]], axis=-1)
    low = np.repeat(low, counts[row, column], axis=0)  # the near, lower, left corner of each fruit's block
    roomy = np.prod(cell + size.mean) / (np.pi / 6 * size.mean**3) * MOST_FILLED
    if counts.max() > roomy:
        raise _too_full(canopy, int(counts.sum()))
    diameters = sample_diameters(size, len(low), rng)
    middle = low[:: fruit_map.cluster_size] + cell * rng.random((len(low) // fruit_map.cluster_size, 3))
    ring = _rings(diameters.reshape(-1, fruit_map.cluster_size), rng)
    return _apart((middle[:, None] + ring).reshape(-1, 3), low, low + cell, diameters, canopy), diameters


def _rings(diameters: Array, rng: np.random.Generator) -> Array:
    """Return offsets of fruit from their cluster's centre, m, (clusters, size, 3): tilted rings of touching fruit.

    ``diameters``, m, have the shape (clusters, size). Each ring has a random tilt.
    """
    count, size = diameters.shape
    if size == 1:
        return np.zeros((count, 1, 3))
    radius = 1.001 * diameters.max(axis=1, initial=0.0) / (2 * np.sin(np.pi / size))
    angle = 2 * np.pi * (np.arange(size) / size + rng.random((count, 1)))
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1) * radius[:, None, None]
    basis, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return np.asarray(np.einsum("cij,csj->csi", basis, ring))


def _apart(upright: Array, low: Array, high: Array, diameters: Array, canopy: Canopy) -> Array:
    """Return fruit centres in the leaning canopy, m, (n, 3), with overlapping pairs pushed apart inside their blocks.

    Args:
        upright: Centres as if the canopy were upright, m, (n, 3).
        low: Lowest corner of each fruit's block, m, (n, 3).
        high: Highest corner of each fruit's block, m, (n, 3).
        diameters: Fruit diameters, m, (n,).
        canopy: The canopy, which gives lean and volume.

    Raises:
        InputError: If fruit cannot be kept apart.
    """
    from scipy.spatial import cKDTree

    lean = np.array([0.0, 1.0, 0.0])
    for _ in range(ROUNDS):
        upright = np.clip(upright, low, high)
        leaning = upright + face(canopy, upright[:, 2])[:, None] * lean
        reach = float(diameters.max(initial=0.0))
        first, second = cKDTree(leaning).query_pairs(reach, output_type="ndarray").T
        apart = leaning[second] - leaning[first]
        distance = np.linalg.norm(apart, axis=-1)
        overlap = (diameters[first] + diameters[second]) / 2 - distance
        if not (overlap > OVERLAP).any():
            return np.asarray(leaning)
        push = 0.5 * (np.maximum(overlap, 0.0) + OVERLAP / 2) * (overlap > 0)
        step = push[:, None] * apart / np.maximum(distance, 1e-9)[:, None]
        shifts = np.zeros_like(leaning)
        np.add.at(shifts, first, -step)
        np.add.at(shifts, second, step)
        leaning = leaning + shifts
        upright = leaning - face(canopy, leaning[:, 2])[:, None] * lean
    raise _too_full(canopy, len(upright))


def _too_full(canopy: Canopy, count: int) -> InputError:
    return InputError(
        f"canopy '{canopy.name}' is too full to keep {count} fruit apart; lower the density or deepen the canopy"
    )


ROUNDING = 1e-9  # m


@toml_table
class Canopy(checks.Preset):
    """The slab of foliage that a picking machine faces at one stop; it continues along the row of trees past the fruit.

    Attributes:
        name: Name of the preset.
        source: Source of its numbers.
        bottom: Height of the lowest fruit above the ground, m.
        top: Height of the highest fruit above the ground, m.
        depth: Horizontal thickness of the slab, m.
        width: Length of the row of trees that is picked from one stop, m. Fruit has x from −width/2 to width/2.
        standoff: Distance from the machine's column to the face, m; the column is at y = −standoff.
        lean: Angle of the face from the vertical, rad. Positive leans away from the aisle, negative over the aisle.
        leaf_area_per_volume: One-sided leaf area per volume of canopy, m²/m³.
        leaf_projection: Mean projected area of a leaf across the line of sight, as a share of its area.
    """

    name: str
    source: str
    bottom: Annotated[float, MM.not_negative]
    top: Annotated[float, MM]
    depth: Annotated[float, MM.positive]
    width: Annotated[float, MM.positive]
    standoff: Annotated[float, MM.not_negative]
    lean: Annotated[float, DEG]
    leaf_area_per_volume: Annotated[float, NUMBER.not_negative]
    leaf_projection: Annotated[float, SHARE]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.top <= self.bottom:
            raise InputError(
                f"canopy '{self.name}' is empty: its top {self.top} m is not above its bottom {self.bottom} m"
            )
        if not abs(self.lean) < np.pi / 3:
            raise InputError(f"canopy '{self.name}' leans by {self.lean} rad; give less than 60 degrees (1.05 rad)")


load_canopy = preset_files.loader("canopy", Canopy)
"""Read a canopy by its name, one of `shipped("canopy")`, or from a TOML file by its path."""


def face(canopy: Canopy, height: ArrayLike) -> Array:
    """Return y of the canopy's face in the orchard frame, m, at heights above the ground, m, of any shape."""
    return np.asarray((np.asarray(height, dtype=float) - canopy.bottom) * np.tan(canopy.lean))


def depth_behind_face(canopy: Canopy, positions: ArrayLike) -> Array:
    """Return the horizontal distance of positions beyond the canopy's face, m, (...); negative in the aisle.

    Args:
        canopy: The canopy.
        positions: Positions in the orchard frame, m, (..., 3).
    """
    positions = checks.points("positions", positions)
    return np.asarray(positions[..., 1] - face(canopy, positions[..., 2]))


def foliage_path(canopy: Canopy, start: ArrayLike, end: ArrayLike) -> Array:
    """Return for each straight line the length of its part that lies in foliage, m, (...).

    Args:
        canopy: The canopy.
        start: Start points in the orchard frame, m, (..., 3). Shapes broadcast.
        end: End points in the orchard frame, m, (..., 3).
    """
    start, end = checks.points("start points", start), checks.points("end points", end)
    start, end = np.broadcast_arrays(start, end)
    slabs = (
        (start[..., 2], end[..., 2], canopy.bottom, canopy.top),
        (depth_behind_face(canopy, start), depth_behind_face(canopy, end), 0.0, canopy.depth),
    )
    enter, leave = np.zeros(start.shape[:-1]), np.ones(start.shape[:-1])
    for a, b, low, high in slabs:
        run = b - a
        still = np.abs(run) < ROUNDING
        outside = np.abs((a + b) / 2 - (low + high) / 2) > (high - low) / 2 + ROUNDING  # asked of ways along the slab
        run = np.where(still, 1.0, run)
        first, second = (low - a) / run, (high - a) / run
        enter = np.maximum(enter, np.where(still, outside, np.minimum(first, second)))
        leave = np.minimum(leave, np.where(still, ~outside, np.maximum(first, second)))
    return np.asarray(np.maximum(leave - enter, 0.0) * np.linalg.norm(end - start, axis=-1))


def foliage_transmission(canopy: Canopy, start: ArrayLike, end: ArrayLike) -> Array:
    """Return the expected visible share of small targets behind leaves, (...), 0 to 1.

    Args:
        canopy: The canopy.
        start: Viewpoints in the orchard frame, m, (..., 3). Shapes broadcast.
        end: Targets in the orchard frame, m, (..., 3).
    """
    extinction = canopy.leaf_projection * canopy.leaf_area_per_volume
    return np.asarray(np.exp(-extinction * foliage_path(canopy, start, end)))


def occlusion(canopy: Canopy, positions: ArrayLike, diameters: ArrayLike, viewpoint: ArrayLike) -> tuple[Array, Array]:
    """Return the expected visible share of each fruit from a viewpoint, and the side that is visible.

    Args:
        canopy: The foliage.
        positions: Fruit centres in the orchard frame, m, shape (n, 3).
        diameters: Fruit diameters, m, shape (n,) or a number.
        viewpoint: Camera positions in the orchard frame, m, shape (..., 3).

    Returns:
        Two arrays. The first is the share of each fruit's disc that neither leaves nor other fruit hide, shape
        (..., n). The second is the visible side of each fruit, shape (..., n, 3): a unit vector across the line of
        sight, away from the fruit that cover this one. It is zero for a fruit that no other fruit covers.

    Raises:
        InputError: If a number is not finite, a diameter is not above zero, or a viewpoint lies inside a fruit.
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
    visible_side = np.divide(away, length, out=np.zeros_like(away), where=length > 1e-12)
    return np.asarray(transmitted * np.prod(1.0 - covered, axis=-1)), visible_side


def disc_cover(radius: ArrayLike, other: ArrayLike, apart: ArrayLike) -> Array:
    """Return the share of a disc's area that another disc covers, 0 to 1.

    Args:
        radius: Radius of the covered disc, in any unit. Shapes broadcast.
        other: Radius of the covering disc, in the same unit.
        apart: Distance between the two centres, in the same unit.
    """
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
    """Return for each fruit whether a round tool can approach it without touching another fruit.

    Args:
        positions: Fruit centres, m, shape (n, 3), in any frame.
        diameters: Fruit diameters, m, shape (n,) or a number.
        direction: Direction in which the tool moves to the fruit, in the same frame, shape (3,) or (n, 3).
        tool_radius: Radius of the tool, m.
        buffer: Length of the straight approach that ends at the fruit's centre, m.

    Returns:
        Booleans, shape (n,).

    Raises:
        InputError: If a number is not finite or outside its limits, or a shape is wrong.
    """
    positions, diameters = checks.fruit_arrays(positions, diameters)
    checks.numbers("the tool radius (m)", tool_radius, positive=True)
    checks.numbers("the approach buffer (m)", buffer, lowest=0.0)
    direction = np.broadcast_to(checks.directions("the approach direction", direction), positions.shape)
    offset = positions[None, :, :] - positions[:, None, :]  # from target i to fruit j
    back = np.clip(np.einsum("ijk,ik->ij", offset, -direction), 0.0, buffer)
    gap = np.linalg.norm(offset + back[..., None] * direction[:, None, :], axis=-1) - diameters / 2 - tool_radius
    np.fill_diagonal(gap, np.inf)
    return np.asarray((gap >= 0).all(axis=1))


# Where a picking arm stands before the canopy, how big its tool is, and what it does to fruit. Units: m, s, N.


@toml_table
class Station(checks.Preset):
    """A place of picking: the section of canopy that an arm picks from, and a gripper that comes to fruit from below.

    It is not a station of measurements (a set-up of instrument and arm). The base frame is the arm's base frame; x is
    along the row of trees, y into the trees, z up.

    Attributes:
        middle: x of the section's middle in the base frame, m.
        face: y of the canopy's face in the base frame, m.
        mount: z of the lowest fruit in the base frame, m.
        width: Width of the section along x, m.
        height: Height of the section along z, m.
        depth: Depth of the section along y, m.
        tool_radius: Outer radius of the gripper, m.
        tool_length: Length by which the gripper extends below the tool's point, m.
        approach: Length of the straight approach from below to a fruit, m.
        blocked: Distance from the approach's axis within which another fruit blocks the approach, m.
        near: Largest distance between the controller's tool position and the measured fruit position at which the
            gripper closes, m.
        collected_below: Distance that the tool moves down with a detached fruit before the fruit counts as collected,
            m.
        bruise_speed: Least speed at which a tool bruises a fruit that it hits, m/s.
        knock: Distance by which a failed grasp pushes its fruit, m.
        most_push: Largest distance by which a fruit can be pushed, m.
        twist: Torque of the gripper at full command, N·m.
        grip: Time for gripping a fruit, s. It is added for each grasp, not simulated.
        deposit: Time for the way to the bin and back, s. It is added for each fruit brought to the bin, not simulated.
        release: Time for releasing a fruit, s. It is added for each fruit brought to the bin, not simulated.
        source: Source of its numbers.
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
    grip: Annotated[float, SECONDS.not_negative]
    deposit: Annotated[float, SECONDS.not_negative]
    release: Annotated[float, SECONDS.not_negative]
    source: str = ""

    def handling(self, grasps: int, fruit: int) -> float:
        """Return the time for all gripping, depositing and releasing, s. The simulated time does not include it.

        Args:
            grasps: Number of grasps.
            fruit: Number of fruit brought to the bin.
        """
        return self.grip * grasps + (self.deposit + self.release) * fruit


load_station = preset_files.loader("station", Station)
"""Read a station by its name, one of `shipped("station")`, or from a TOML file by its path."""
