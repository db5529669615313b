"""Meshes of triangles: surfaces of revolution (such as cups and branches), leaves, and ground.

Units: m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.pictures.stage import Mesh, Rgb, rgba


def mesh_triangles(surface: Mesh) -> Mesh:
    """Return the mesh with a normal at each corner: the area-weighted mean normal of the triangles that share it."""
    a, b, c = (surface.corners[surface.triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(surface.corners, dtype=float)
    for k in range(3):
        np.add.at(normals, surface.triangles[:, k], face)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    return replace(surface, normals=normals)


def all_triangles(parts: Sequence[Mesh]) -> Mesh:
    """Join several meshes into one."""
    if not parts:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.intp), np.empty((0, 4), np.uint8))
    first = np.cumsum([0, *(len(part.corners) for part in parts[:-1])])
    triangles = [part.triangles + shift for part, shift in zip(parts, first, strict=True)]
    corners, colour, normals = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("corners", "colour", "normals")
    )
    return Mesh(corners, np.concatenate(triangles), colour.astype(np.uint8), normals)


def ring_around(axis: Array, count: int) -> Array:
    """Return unit vectors ``(count, 3)`` perpendicular to the unit vector ``axis (3,)``, at equal angles around it."""
    x = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    x = x / np.linalg.norm(x)
    turn = 2.0 * np.pi * np.arange(count)[:, None] / count
    return np.asarray(np.cos(turn) * x + np.sin(turn) * np.cross(axis, x))


def turned(profile: ArrayLike, point: Array, axis: Array, colour: Rgb, around: int = 24) -> Mesh:
    """Make a surface of revolution.

    Args:
        profile: Radius and height of points along its outline ``(P, 2)``, m. A point that is listed twice makes a sharp
            edge.
        point: Point on the axis where the height is zero ``(3,)``, m.
        axis: Unit vector along the axis, in which height grows ``(3,)``.
        colour: Red, green, blue.
        around: Number of corners around the axis.
    """
    outline, ring = np.asarray(profile, dtype=float), ring_around(axis, around)
    corners = point + outline[:, None, :1] * ring + outline[:, None, 1:] * axis
    i = np.arange(around)
    j, faces = (i + 1) % around, []
    for k in range(len(outline) - 1):
        if np.allclose(outline[k], outline[k + 1]):
            continue
        low, high = k * around, (k + 1) * around
        faces += [np.stack([low + i, low + j, high + j], -1), np.stack([low + i, high + j, high + i], -1)]
    corners = corners.reshape(-1, 3)
    return Mesh(corners, np.concatenate(faces), rgba(colour, len(corners)))


def chequered(low: ArrayLike, high: ArrayLike, height: float, square: float, colours: tuple[Rgb, Rgb]) -> Mesh:
    """Make horizontal ground of squares in two colours.

    Args:
        low: Corner with the least x and y ``(2,)``, m; it is rounded down to whole squares.
        high: Opposite corner ``(2,)``, m, which the ground reaches at least.
        height: Height of the ground, m.
        square: Side of a square, m.
        colours: The two colours.
    """
    low = np.floor(np.asarray(low, dtype=float) / square) * square
    nx, ny = np.maximum(np.ceil((np.asarray(high, dtype=float) - low) / square - 1e-9).astype(int), 1)
    ix, iy = (grid.ravel() for grid in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    place = low + square * np.stack([ix, iy], -1)
    around = square * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    flat = (place[:, None] + around).reshape(-1, 2)
    corners = np.column_stack([flat, np.full(len(flat), height)])
    shade = np.stack([rgba(colour, 1)[0] for colour in colours])[(ix + iy) % 2]
    return Mesh(corners, _fans(len(place)), np.repeat(shade, 4, axis=0))


def leaf_mesh(places: Array, length: float, width: float, colour: ArrayLike, rng: np.random.Generator) -> Mesh:
    """Make leaves with random attitudes and shades, each a bent rhombus of two triangles.

    Args:
        places: Centres of the leaves ``(N, 3)``, m.
        length: Length of a leaf, m.
        width: Width of a leaf, m.
        colour: Red, green, blue of a leaf of medium shade.
        rng: Random generator for attitudes and shades.
    """
    count = len(places)
    basis, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    long, across, normal = basis[:, 0] * length / 2, basis[:, 1] * width / 2, basis[:, 2] * width / 5
    corners = np.stack([places - long, places - across + normal, places + long, places + across + normal], axis=1)
    shade = np.clip(np.asarray(colour) * (0.75 + 0.5 * rng.random((count, 1))), 0, 255)
    colours = np.column_stack([shade, np.full(count, 255.0)]).astype(np.uint8)
    return Mesh(corners.reshape(-1, 3), _fans(count), np.repeat(colours, 4, axis=0))


def _fans(count: int) -> NDArray[np.intp]:
    """Return the corner indices of two triangles for each of ``count`` quadrilaterals ``(2 count, 3)``.

    Quadrilateral i (from 0) has the corners 4 i to 4 i + 3.
    """
    return (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
