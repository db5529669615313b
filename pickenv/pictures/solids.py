"""Solids as triangles: rods and balls are stretched from one template, cups are turned, leaves and ground laid out.

Units: m.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from pickenv.arm.kinematics.geometry import Array
from pickenv.pictures.stage import Balls, Colours, Dial, Mesh, Pixels, Rgb, Rods, Stage, backdrop, ink, rgba

# Words and the dial of the miss, written onto a picture with Pillow. Units: px, mm on the dial.


MARGIN = 8
SMALL, LARGE = 1 / 26, 1 / 19
"""Heights of letters, as shares of the picture's height."""
DIAL = 0.27
"""Its width, as a share of the picture's height."""
SHOWN, RIM = 2.2, 0.93
"""Radii of the ring from the dial's middle to its rim; a miss beyond is drawn on the rim."""
PLATE = 205
"""Opacity of what lies behind words and dial."""


def lettered(pixels: Pixels, stage: Stage) -> Pixels:
    """The picture with the stage's words and dial."""
    if not stage.words and stage.dial is None:
        return pixels
    picture = Image.fromarray(pixels)
    pen = ImageDraw.Draw(picture, "RGBA")
    width, height = stage.size
    if stage.dial is not None:
        _draw_dial(pen, stage.dial, stage)
    below = dict.fromkeys(("top left", "top right", "bottom left", "bottom right"), MARGIN - 2.0)
    lines = [words for words in stage.words if isinstance(words.place, str)]
    for words in lines:
        assert isinstance(words.place, str)
        font = _font(round(height * (LARGE if words.large else SMALL)))
        wide, high = font.getlength(words.text), sum(font.getmetrics())
        x = MARGIN if "left" in words.place else width - MARGIN - wide
        y = below[words.place] if "top" in words.place else height - below[words.place] - high
        _write(pen, (x, y), words.text, font, words.colour or ink(stage.dark), stage.dark)
        below[words.place] += high + 3
    for words in stage.words:
        if not isinstance(words.place, str):
            x, y, depth = stage.eye.project(words.place, stage.size).tolist()
            font = _font(round(height * (LARGE if words.large else SMALL)))
            wide = font.getlength(words.text)
            if depth > 0.0 and 0 <= x < width and 0 <= y < height:
                at = float(np.clip(x - wide / 2, MARGIN, width - MARGIN - wide)), y
                _write(pen, at, words.text, font, words.colour or ink(stage.dark), stage.dark)
    return np.array(picture)


def strip(text: str, size: tuple[int, int], dark: bool) -> Pixels:
    """A line of words on a plain background, ``(height, width, 3)``."""
    width, height = size
    picture = Image.new("RGB", size, backdrop(dark)[1])
    font = _font(round(0.5 * height))
    ImageDraw.Draw(picture).text((width / 2, height / 2), text, fill=ink(dark), font=font, anchor="mm")
    return np.array(picture)


def _write(
    pen: ImageDraw.ImageDraw, at: tuple[float, float], text: str, font: ImageFont.FreeTypeFont, colour: Rgb, dark: bool
) -> None:
    box = (at[0] - 4, at[1] - 1, at[0] + font.getlength(text) + 4, at[1] + sum(font.getmetrics()))
    pen.rounded_rectangle(box, radius=4, fill=_plate(dark))
    pen.text(at, text, fill=colour, font=font, anchor="la")


def _plate(dark: bool) -> tuple[int, int, int, int]:
    return (20, 23, 29, PLATE) if dark else (255, 255, 255, PLATE)


def _draw_dial(pen: ImageDraw.ImageDraw, dial: Dial, stage: Stage) -> None:
    width, height = stage.size
    half = DIAL * height / 2
    x, y = width - MARGIN - half, height - MARGIN - half
    ring, lines = half / SHOWN, ink(stage.dark)
    pen.ellipse([x - half, y - half, x + half, y + half], fill=_plate(stage.dark), outline=(*lines, 70), width=1)
    pen.line([x - half, y, x + half, y], fill=(*lines, 45), width=1)
    pen.line([x, y - half, x, y + half], fill=(*lines, 45), width=1)
    pen.ellipse([x - ring, y - ring, x + ring, y + ring], outline=(46, 139, 87, 255), width=2)
    places = dial.marks_mm / dial.tolerance_mm
    places = places * np.minimum(1.0, RIM * SHOWN / np.maximum(np.linalg.norm(places, axis=1, keepdims=True), 1e-9))
    for number, (px, py) in enumerate(places.tolist(), start=1):
        present = number == len(places)
        mx, my, r = x + ring * px, y - ring * py, 5 if present else 3
        edge = (*lines, 255) if present else None
        pen.ellipse([mx - r, my - r, mx + r, my + r], fill=(*dial.colour, 255 if present else 130), outline=edge)
    if dial.label:
        font = _font(round(height * SMALL))
        wide = font.getlength(dial.label)
        at = (min(x - wide / 2, width - MARGIN - wide), y - half - sum(font.getmetrics()) - 3)
        _write(pen, at, dial.label, font, lines, stage.dark)


@lru_cache(maxsize=8)
def _font(height: int) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which comes with matplotlib."""
    from matplotlib import get_data_path

    return ImageFont.truetype(Path(get_data_path()) / "fonts/ttf/DejaVuSans.ttf", height)


AROUND, ARCS = 14, 4
"""Corners around a rod, and steps from its rim to its pole: as few as look round in a picture of 480 x 360 px."""


class Triangles(NamedTuple):
    """Corners with normals and colours, and the triangles between them.

    Attributes:
        corners: ``(V, 3)``, m.
        normals: ``(V, 3)``.
        colour: ``(V, 4)``, 0 to 255.
        triangles: ``(T, 3)``.
    """

    corners: Array
    normals: Array
    colour: Colours
    triangles: NDArray[np.intp]


@lru_cache(maxsize=1)
def _template() -> tuple[Array, NDArray[np.bool_], NDArray[np.intp]]:
    """A unit ball cut at its equator: corners (V, 3), which of them belong to the far half, triangles (T, 3)."""
    lift = np.linspace(0.0, np.pi / 2, ARCS + 1)[:-1]
    rings = np.concatenate([-lift[::-1], lift])
    turn = 2.0 * np.pi * np.arange(AROUND) / AROUND
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(AROUND)], axis=-1)
    body = ring * np.cos(rings)[:, None, None] + [0.0, 0.0, 1.0] * np.sin(rings)[:, None, None]
    corners = np.concatenate([body.reshape(-1, 3), [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    far = np.concatenate([np.repeat(np.arange(len(rings)) >= ARCS, AROUND), [False, True]])
    i = np.arange(AROUND)
    j = (i + 1) % AROUND
    low, high = len(corners) - 2, len(corners) - 1
    top = AROUND * (len(rings) - 1)
    faces = [np.stack([np.full(AROUND, low), j, i], -1), np.stack([np.full(AROUND, high), top + i, top + j], -1)]
    for below in AROUND * np.arange(len(rings) - 1):
        above = below + AROUND
        faces += [np.stack([below + i, below + j, above + j], -1), np.stack([below + i, above + j, above + i], -1)]
    return corners, far, np.concatenate(faces)


def rod_triangles(rods: Rods) -> Triangles:
    """Rods as triangles, all of one template."""
    corners, far, faces = _template()
    along = rods.end - rods.start
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    z = np.where(length > 1e-9, along / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
    x = np.cross(z, np.where(np.abs(z[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    normals = np.einsum("vk,nkj->nvj", corners, np.stack([x, np.cross(z, x), z], axis=1))
    ends = np.where(far[None, :, None], rods.end[:, None], rods.start[:, None])
    return _joined(ends + normals * rods.radius[:, None, None], normals, rods.colour, faces)


def ball_triangles(balls: Balls) -> Triangles:
    """Balls as triangles, all of one template."""
    corners, _, faces = _template()
    normals = np.broadcast_to(corners, (len(balls.centre), *corners.shape))
    return _joined(balls.centre[:, None] + normals * balls.radius[:, None, None], normals, balls.colour, faces)


def _joined(corners: Array, normals: Array, colour: Colours, faces: NDArray[np.intp]) -> Triangles:
    """N copies of a template, (N, V, 3), as one set of triangles."""
    count, each = corners.shape[:2]
    shifted = (faces + each * np.arange(count)[:, None, None]).reshape(-1, 3)
    return Triangles(corners.reshape(-1, 3), normals.reshape(-1, 3), np.repeat(colour, each, axis=0), shifted)


def mesh_triangles(surface: Mesh) -> Triangles:
    """A surface with the normals of its corners: the mean of those of the triangles around each, by area."""
    a, b, c = (surface.corners[surface.triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(surface.corners, dtype=float)
    for k in range(3):
        np.add.at(normals, surface.triangles[:, k], face)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    return Triangles(surface.corners, normals, surface.colour, surface.triangles)


def all_triangles(parts: Sequence[Triangles]) -> Triangles:
    """Several sets of triangles as one."""
    if not parts:
        return Triangles(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 4), np.uint8), np.empty((0, 3), np.intp))
    first = np.cumsum([0, *(len(part.corners) for part in parts[:-1])])
    triangles = [part.triangles + shift for part, shift in zip(parts, first, strict=True)]
    corners, normals, colour = (np.concatenate([part[k] for part in parts]) for k in range(3))
    return Triangles(corners, normals, colour.astype(np.uint8), np.concatenate(triangles))


def turned(profile: ArrayLike, point: Array, axis: Array, colour: Rgb, opacity: float = 1.0, around: int = 24) -> Mesh:
    """A surface of revolution.

    Args:
        profile: Radius and height of points along its outline ``(P, 2)``, m; an edge is kept by giving a point twice.
        point: Where height is zero ``(3,)``, m.
        axis: Unit vector in which height grows ``(3,)``.
        colour: Red, green, blue.
        opacity: 0 to 1.
        around: Corners around the axis.
    """
    outline = np.asarray(profile, dtype=float)
    x = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    x = x / np.linalg.norm(x)
    turn = 2.0 * np.pi * np.arange(around) / around
    ring = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * np.cross(axis, x)
    corners = point + outline[:, None, :1] * ring + outline[:, None, 1:] * axis
    i = np.arange(around)
    j, faces = (i + 1) % around, []
    for k in range(len(outline) - 1):
        if np.allclose(outline[k], outline[k + 1]):
            continue
        low, high = k * around, (k + 1) * around
        faces += [np.stack([low + i, low + j, high + j], -1), np.stack([low + i, high + j, high + i], -1)]
    corners = corners.reshape(-1, 3)
    return Mesh(corners, np.concatenate(faces), rgba(colour, len(corners), opacity))


def chequered(low: ArrayLike, high: ArrayLike, height: float, square: float, colours: tuple[Rgb, Rgb]) -> Mesh:
    """Level ground of squares in two colours, from ``low`` (2,) to at least ``high`` (2,), m."""
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
    """Leaves of all attitudes and some shades, each a bent rhomb of two triangles.

    Args:
        places: Their middles ``(N, 3)``, m.
        length: m.
        width: m.
        colour: Red, green, blue of a middling leaf.
        rng: Source of attitudes and shades.
    """
    count = len(places)
    basis, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    long, across, normal = basis[:, 0] * length / 2, basis[:, 1] * width / 2, basis[:, 2] * width / 5
    corners = np.stack([places - long, places - across + normal, places + long, places + across + normal], axis=1)
    shade = np.clip(np.asarray(colour) * (0.75 + 0.5 * rng.random((count, 1))), 0, 255)
    colours = np.column_stack([shade, np.full(count, 255.0)]).astype(np.uint8)
    return Mesh(corners.reshape(-1, 3), _fans(count), np.repeat(colours, 4, axis=0))


def _fans(count: int) -> NDArray[np.intp]:
    """Two triangles for each of ``count`` runs of four corners."""
    return (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
