"""Fruit in a canopy: counts by block become positions, clusters hang together, and no two fruit share a place.

Each cluster starts as a ring of touching fruit around a random centre in its block, tilted at random; fruit that
overlaps is pushed apart within its block. Units: m. Frame: see canopy.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.errors import InputError
from pickenv.orchard.canopy import Canopy, face
from pickenv.orchard.checks import Array, Integers
from pickenv.orchard.fruit import FruitMap, FruitSize, sample_counts, sample_diameters

ROUNDS = 2000  # of pushing apart; a block with 18 apples takes a few hundred
MOST_FILLED = 0.5  # of a block's volume; spheres thrown in at random jam at 0.64
OVERLAP = 1e-4  # m that two fruit may dent each other


@dataclass(frozen=True, eq=False)
class Fruit:
    """The fruit that one machine stop finds.

    Attributes:
        positions: Centres in the orchard frame, m, shape (n, 3).
        diameters: Diameters, m, shape (n,).
        clusters: Number of the cluster that each fruit hangs in, shape (n,).
    """

    positions: Array
    diameters: Array
    clusters: Integers

    def __len__(self) -> int:
        return len(self.positions)


def sample_fruit(fruit_map: FruitMap, size: FruitSize, canopy: Canopy, rng: np.random.Generator) -> Fruit:
    """Draw the fruit of one canopy.

    The map's rows of blocks are spread over the canopy's height and its width is cut into whole blocks; apples per
    metre of row stay.

    Args:
        fruit_map: How many fruit hang in which row of blocks.
        size: Fruit diameters.
        canopy: The volume to fill.
        rng: Source of every random draw.

    Returns:
        Fruit that lies inside the canopy and does not overlap.

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
    clusters = np.repeat(np.arange(len(low) // fruit_map.cluster_size), fruit_map.cluster_size)
    diameters = sample_diameters(size, len(low), rng)
    middle = low[:: fruit_map.cluster_size] + cell * rng.random((len(low) // fruit_map.cluster_size, 3))
    ring = _rings(diameters.reshape(-1, fruit_map.cluster_size), rng)
    upright = (middle[:, None] + ring).reshape(-1, 3)
    positions = _apart(upright, low, low + cell, diameters, canopy)
    return Fruit(positions, diameters, clusters.astype(np.int64))


def _rings(diameters: Array, rng: np.random.Generator) -> Array:
    """Offsets from a cluster's centre, (clusters, size, 3): a regular polygon of touching fruit, tilted at random."""
    count, size = diameters.shape
    if size == 1:
        return np.zeros((count, 1, 3))
    radius = 1.001 * diameters.max(axis=1, initial=0.0) / (2 * np.sin(np.pi / size))
    angle = 2 * np.pi * (np.arange(size) / size + rng.random((count, 1)))
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1) * radius[:, None, None]
    basis, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return np.asarray(np.einsum("cij,csj->csi", basis, ring))


def _apart(upright: Array, low: Array, high: Array, diameters: Array, canopy: Canopy) -> Array:
    """Fruit centres in the leaning canopy: pairs that overlap are pushed apart, and each fruit is kept in its block."""
    from scipy.spatial import cKDTree

    lean = np.array([0.0, 1.0, 0.0])
    for _ in range(ROUNDS):
        upright = np.clip(upright, low, high)
        leaning = upright + face(canopy, upright[:, 2])[:, None] * lean
        if len(leaning) < 2:
            return np.asarray(leaning)
        first, second = cKDTree(leaning).query_pairs(float(diameters.max()), output_type="ndarray").T
        apart = leaning[second] - leaning[first]
        distance = np.linalg.norm(apart, axis=-1)
        overlap = (diameters[first] + diameters[second]) / 2 - distance
        if not (overlap > OVERLAP).any():
            return np.asarray(leaning)
        push = 0.5 * (np.maximum(overlap, 0.0) + OVERLAP / 2) * (overlap > 0)
        step = push[:, None] * apart / np.maximum(distance, 1e-9)[:, None]
        moved = np.zeros_like(leaning)
        np.add.at(moved, first, -step)
        np.add.at(moved, second, step)
        leaning = leaning + moved
        upright = leaning - face(canopy, leaning[:, 2])[:, None] * lean
    raise _too_full(canopy, len(upright))


def _too_full(canopy: Canopy, count: int) -> InputError:
    return InputError(
        f"canopy '{canopy.name}' is too full to keep {count} fruit apart; lower the density or deepen the canopy"
    )
