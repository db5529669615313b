"""Draws stages without VTK: solids as flat shapes, from far to near, with Pillow.

Rods are strokes, balls discs, meshes triangles in the light of one lamp. What goes through one another is drawn in the
order of its middles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from PIL import Image, ImageDraw

from pickenv.arm import Array
from pickenv.pictures.stage import Balls, Eye, Mesh, Pixels, Rods, Stage, backdrop

FINER = 2
"""Shapes are drawn so much larger, and then made smaller, for smooth edges."""
NEAREST = 0.05
LIGHT = np.array([-0.45, 0.65, -0.6]) / np.linalg.norm([0.45, 0.65, 0.6])
"""Towards the lamp: to the right, up, and away from the eye."""
SHADE = 0.72
"""Brightness of the sides of rods and balls."""

Shape = tuple[float, Callable[[ImageDraw.ImageDraw], None]]


def draw_plainly(stage: Stage) -> Pixels:
    """The stage without its words, ``(height, width, 3)``."""
    width, height = (FINER * side for side in stage.size)
    upper, lower = (np.array(colour, dtype=float) for colour in backdrop(stage.dark))
    share = np.linspace(0.0, 1.0, height)[:, None]
    rows = (upper + share * (lower - upper)).astype(np.uint8)
    picture = Image.fromarray(np.repeat(rows[:, None], width, axis=1))
    pen = ImageDraw.Draw(picture, "RGBA")
    shapes: list[Shape] = []
    size = (width, height)
    for mesh in (*stage.still, *stage.meshes):
        shapes += _triangles(mesh, stage.eye, size)
    for rods in stage.rods:
        shapes += _strokes(rods, stage.eye, size)
    for balls in stage.balls:
        shapes += _discs(balls, stage.eye, size)
    for _, draw in sorted(shapes, key=lambda shape: -shape[0]):
        draw(pen)
    return np.array(picture.reduce(FINER))


def _triangles(mesh: Mesh, eye: Eye, size: tuple[int, int]) -> Iterator[Shape]:
    seen = eye.project(mesh.corners, size)[mesh.triangles]
    solid = mesh.corners[mesh.triangles]
    normals = np.cross(solid[:, 1] - solid[:, 0], solid[:, 2] - solid[:, 0]) @ eye.axes().T
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    towards = np.where(normals[:, 2:] > 0.0, -normals, normals)
    bright = np.clip(0.55 + 0.5 * towards @ LIGHT, 0.0, 1.0)
    colours = mesh.colour[mesh.triangles[:, 0]].astype(float)
    colours[:, :3] *= bright[:, None]
    for corners, colour in zip(seen, colours.astype(int).tolist(), strict=True):
        if corners[:, 2].min() > NEAREST:
            flat = [tuple(corner) for corner in corners[:, :2].tolist()]
            yield float(corners[:, 2].max()), lambda pen, p=flat, c=tuple(colour): pen.polygon(p, fill=c)  # type: ignore[misc]


def _strokes(rods: Rods, eye: Eye, size: tuple[int, int]) -> Iterator[Shape]:
    start, end = eye.project(rods.start, size), eye.project(rods.end, size)
    for a, b, radius, colour in zip(start, end, rods.radius, rods.colour.astype(int), strict=True):
        if min(a[2], b[2]) > NEAREST:
            depth = float(a[2] + b[2]) / 2
            yield depth - float(radius), _stroke(a, b, float(radius * eye.pixels_per_metre(depth, size)), colour)


def _stroke(a: Array, b: Array, radius: float, colour: Array) -> Callable[[ImageDraw.ImageDraw], None]:
    clear, dark = int(colour[3]), tuple((colour[:3] * SHADE).astype(int))
    light = tuple(int(value) for value in colour[:3])

    def draw(pen: ImageDraw.ImageDraw) -> None:
        if clear < 255:
            pen.line([a[0], a[1], b[0], b[1]], fill=(*light, clear), width=max(int(2 * radius), 1))
            return
        for x, y in ((a[0], a[1]), (b[0], b[1])):
            pen.ellipse([x - radius, y - radius, x + radius, y + radius], fill=dark)
        pen.line([a[0], a[1], b[0], b[1]], fill=dark, width=max(round(2 * radius), 1))
        up = 0.25 * radius
        pen.line([a[0], a[1] - up, b[0], b[1] - up], fill=light, width=max(round(1.1 * radius), 1))

    return draw


def _discs(balls: Balls, eye: Eye, size: tuple[int, int]) -> Iterator[Shape]:
    seen = eye.project(balls.centre, size)
    for (x, y, depth), radius, colour in zip(seen.tolist(), balls.radius, balls.colour.astype(int), strict=True):
        if depth > NEAREST:
            yield depth - float(radius), _disc(x, y, float(radius * eye.pixels_per_metre(depth, size)), colour)


def _disc(x: float, y: float, radius: float, colour: Array) -> Callable[[ImageDraw.ImageDraw], None]:
    def draw(pen: ImageDraw.ImageDraw) -> None:
        for share, shift, shade in ((1.0, 0.0, SHADE), (0.8, 0.12, 1.0), (0.22, 0.4, 1.35)):
            fill = (*np.clip(colour[:3] * shade, 0, 255).astype(int).tolist(), int(colour[3]))
            cx, cy, r = x - shift * radius, y - shift * radius, share * radius
            pen.ellipse([cx - r, cy - r, cx + r, cy + r], fill=fill)

    return draw
