"""Solids around an arm: fruit on stems, leaves and branches of a row of trees, ground, a crate. Units: m.

A row of trees is along x. Leaves are as dense as in a canopy's preset. Other leaves, which environments draw at random
in every episode, hide fruit from a camera.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm import Array, Geometry
from pickenv.orchard import load_look, sample_leaves
from pickenv.pictures.arm_shapes import JOINT, Solids, arm_look
from pickenv.pictures.solids import chequered, leaf_mesh, turned
from pickenv.pictures.stage import Eye, Mesh, Rods, rgba, spheres

RIPE, GREEN, MISSED_FRUIT = (205, 42, 46), (170, 188, 92), (226, 120, 40)
BARK, STEM = (122, 92, 66), (104, 84, 52)
GROUND = {False: ((226, 230, 220), (214, 220, 208)), True: ((52, 58, 64), (46, 52, 58))}
"""The two colours of the ground's squares, for a light (False) and a dark (True) background."""
CRATE = (0.28, 0.8)
"""Position of the crate's corner on the picture, as shares of the picture's width and height."""
SQUARE, SPREAD = 0.5, 6.0
TWIG = 0.09
BRIGHTER = 1.35
"""Factor by which leaves are brighter here than in the images of a simulated camera."""


def fruit_solids(places: Array, diameters: ArrayLike, colours: Array, hanging: ArrayLike = True) -> Solids:
    """Return the solids of fruit, with stems where it hangs.

    Args:
        places: Positions of the fruit (N, 3), m.
        diameters: Diameter of all fruit, or of each (N,), m.
        colours: Red, green, blue of each fruit (N, 3), 0 to 255.
        hanging: Whether fruit hangs, and so has a stem: for all fruit, or for each (N,).
    """
    radius = np.broadcast_to(np.asarray(diameters, dtype=float) / 2, len(places))
    shades = np.column_stack([colours, np.full(len(places), 255)]).astype(np.uint8).reshape(-1, 4)
    balls = spheres(places, radius, shades)
    top = (places + radius[:, None] * [0.0, 0.0, 0.9])[np.broadcast_to(hanging, len(places))]
    twigs = Rods(top, top + np.array([0.012, 0.0, TWIG]), np.full(len(top), 0.004), rgba(STEM, len(top)))
    return (twigs,), (balls,), ()


def sprig(place: Array, diameter: float) -> Solids:
    """Return the solids of a few leaves and a piece of branch above a single fruit.

    The fruit's centre is ``place (3,)``, m, world frame, and ``diameter`` is in m.
    """
    top = place + np.array([0.012, 0.0, 0.9 * diameter / 2 + TWIG])
    ends = top + np.array([[-0.16, -0.05, -0.01], [0.14, 0.04, 0.03]])
    branch = Rods(ends[:1], ends[1:], np.array([0.009]), rgba(BARK, 1))
    rng = np.random.default_rng(0)
    return (branch,), (), (_leaves(top + rng.normal(0.0, 1.0, (9, 3)) * [0.09, 0.05, 0.025], rng),)


def _leaves(places: Array, rng: np.random.Generator) -> Mesh:
    look = load_look("red_apples")
    return leaf_mesh(places, look.leaf_length, look.leaf_width, BRIGHTER * np.array(look.leaf), rng)


@lru_cache(maxsize=8)
def row_of_trees(
    low: tuple[float, ...], high: tuple[float, ...], leaf_area_per_volume: float, ground: float
) -> tuple[Mesh, ...]:
    """Return the meshes of trunks, horizontal branches and leaves in a box. Equal arguments give the same objects.

    Args:
        low: Lowest corner of the box (3,), m, world frame.
        high: Highest corner of the box (3,), m, world frame.
        leaf_area_per_volume: Area of leaves per volume of the box, m^2/m^3.
        ground: Height of the ground, from which trunks start, m.
    """
    rng = np.random.default_rng(0)
    bottom, top = np.array(low), np.array(high)
    middle = (bottom[1] + top[1]) / 2
    trunks = np.linspace(bottom[0], top[0], max(round((top[0] - bottom[0]) / 0.9), 1) + 1)
    levels = np.arange(bottom[2] + 0.12, top[2] + 0.1, 0.24)
    wood = [_branch([x, middle, ground], [x + 0.03, middle, top[2] + 0.12], 0.024) for x in trunks]
    wood += [_branch([bottom[0] - 0.1, middle, z], [top[0] + 0.1, middle, z + 0.02], 0.011) for z in levels]
    places = sample_leaves(bottom, top, leaf_area_per_volume, load_look("red_apples"), rng)
    return (*wood, _leaves(places, rng)) if len(places) else tuple(wood)


def _branch(start: ArrayLike, end: ArrayLike, radius: float) -> Mesh:
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    outline = [[0.0, 0.0], [radius, 0.0], [radius, 0.0], [radius, length], [radius, length], [0.0, length]]
    return turned(outline, np.asarray(start), along / length, BARK)


@lru_cache(maxsize=8)
def ground_around(x: float, y: float, height: float, dark: bool) -> Mesh:
    """Return the mesh of level ground around the point ``x``, ``y``, m, at a ``height``, m, in the world frame.

    ``dark`` says whether the background is dark. Equal arguments give the same object.
    """
    return chequered((x - SPREAD / 2, y - SPREAD / 2), (x + SPREAD / 2, y + SPREAD / 2), height, SQUARE, GROUND[dark])


@lru_cache(maxsize=8)
def pedestal(geometry: Geometry, ground: float) -> Mesh:
    """Return the mesh of the column under an arm's base, from height ``ground``, m. Equal arguments give one object."""
    x, y, top = geometry.base.position.tolist()
    across, high = arm_look(geometry).radius[0] * np.array([2.2, 2.2, 2.2, 1.5, 1.5, 1.5, 0.0]), top - ground
    outline = np.column_stack([across, [0.0, 0.03, 0.03, 0.06, high, high, high]])
    return turned(outline, np.array([x, y, ground]), np.array([0.0, 0.0, 1.0]), JOINT)


def crate(eye: Eye, size: tuple[int, int], count: int, diameter: float, ground: float) -> Solids:
    """Return the solids of a crate on legs with picked fruit, in the lower left of the picture.

    Args:
        eye: The viewpoint.
        size: Width and height of the picture, px.
        count: Number of fruit in the crate.
        diameter: Diameter of the fruit, m.
        ground: Height of the ground, m.
    """
    distance = float(np.linalg.norm(eye.target - eye.position))
    corner = eye.point_at((CRATE[0] * size[0], CRATE[1] * size[1]), distance, size)
    wide, along = 5, diameter * 1.05
    number = np.arange(count)
    place = np.stack([number % wide, (number // wide) % wide, number // wide**2], axis=-1) + 0.5
    _, balls, _ = fruit_solids(corner + along * place, diameter, fruit_colours(count))
    side = along * wide
    edge = np.array([[0, 0, 0], [side, 0, 0], [side, side, 0], [0, side, 0]], dtype=float)
    start = np.concatenate([corner + edge + [0.0, 0.0, z] for z in (0.0, 0.6 * along)])
    end = np.concatenate([corner + np.roll(edge, -1, axis=0) + [0.0, 0.0, z] for z in (0.0, 0.6 * along)])
    feet = (corner + edge) * [1.0, 1.0, 0.0] + [0.0, 0.0, ground]
    start, end = np.concatenate([start, feet]), np.concatenate([end, corner + edge])
    slats = Rods(start, end, np.full(12, 0.008), rgba((196, 160, 110), 12))
    return (slats,), balls, ()


def fruit_colours(count: int) -> Array:
    """Return the colours of ``count`` ripe fruit (count, 3), an array that the caller may change."""
    return np.tile(np.array(RIPE), (count, 1))
