"""Draw a stage (the contents of a picture) with MuJoCo if it works, else with Pillow, and show pictures in a window.

MuJoCo needs EGL, and a driver that fails might end the whole program. So MuJoCo is first tried in another process.
Pillow draws flat shapes: rods as strokes, balls as discs, and meshes as triangles lit by one lamp. It draws them from
far to near by their depths, also where solids intersect. With either library, words and the dial (the tool's miss,
seen along the tool) are drawn onto the picture with Pillow. Units: px, mm on the dial.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pickenv.arm import Array
from pickenv.base import InputError, is_there, require
from pickenv.pictures.stage import CORNERS, Dial, Eye, Mesh, Pixels, Rgb, Rods, Stage, backdrop, ink

if TYPE_CHECKING:
    from pickenv.pictures.mujoco_drawer import MujocoDrawer

PLAIN = "PICKENV_PLAIN_PICTURES"
"""Environment variable that, if set, makes Pillow draw all pictures, even if MuJoCo is installed."""
TRIAL = "pickenv.pictures.mujoco_drawer"

FINER = 2
NEAREST = 0.05
LIGHT = np.array([-0.45, 0.65, -0.6]) / np.linalg.norm([0.45, 0.65, 0.6])
"""Unit vector towards the lamp, with components to the right, up, and from the viewer into the scene."""
SHADE = 0.72
"""Brightness at the edges of drawn rods and balls, as a share of their full colour."""

MARGIN = 8
SMALL, LARGE = 1 / 26, 1 / 19
"""Heights of letters, as shares of the picture's height."""
DIAL, SHOWN, RIM = 0.27, 2.2, 0.93
PLATE = {False: (255, 255, 255, 205), True: (20, 23, 29, 205)}
"""Colour and opacity of the plates behind words and dial, for a light (False) and a dark (True) background."""

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
DPI = 80

Shape = tuple[float, Callable[[ImageDraw.ImageDraw], None]]
"""Depth of a shape, m, by which shapes are sorted, and the function that draws it."""


def painted(stage: Stage) -> Pixels:
    """Draw a stage (the contents of a picture) with its words and dial, as RGB pixels ``(height, width, 3)``."""
    draw = _mujoco(os.getpid()).draw if drawer_name() == "mujoco" else draw_plainly
    return lettered(draw(stage), stage)


@lru_cache(maxsize=1)
def drawer_name() -> str:
    """Return the name of the drawer in use, ``mujoco`` or ``plain`` (Pillow); it is determined once per process."""
    return "mujoco" if why_plain() is None else "plain"


def why_plain() -> str | None:
    """Return a sentence that says why pictures are drawn with Pillow; None if MuJoCo draws them.

    The module `TRIAL` is run in another process to test whether MuJoCo can draw.
    """
    require("matplotlib")
    if os.environ.get(PLAIN):
        return f"Pictures are drawn plainly, as {PLAIN} asks."
    if not is_there("mujoco"):
        return "Pictures are drawn plainly; for solid bodies install MuJoCo: pip install 'pickenv[render]'"
    if subprocess.run([sys.executable, "-m", TRIAL], capture_output=True, check=False, timeout=120).returncode != 0:
        return "Pictures are drawn plainly, as MuJoCo needs EGL; on Debian or Ubuntu: apt install libegl1 libopengl0"
    return None


@lru_cache(maxsize=1)
def _mujoco(process: int) -> MujocoDrawer:
    """Return MuJoCo's drawer for the process with the id ``process``; it is made once in each process."""
    from pickenv.pictures.mujoco_drawer import MujocoDrawer

    return MujocoDrawer()


def draw_plainly(stage: Stage) -> Pixels:
    """Draw a stage with Pillow, without its words and dial, as RGB pixels ``(height, width, 3)``.

    It is drawn `FINER` times as large and then reduced, for smooth edges.
    """
    size = width, height = FINER * stage.size[0], FINER * stage.size[1]
    upper, lower = (np.array(colour, dtype=float) for colour in backdrop(stage.dark))
    share = np.linspace(0.0, 1.0, height)[:, None]
    rows = (upper + share * (lower - upper)).astype(np.uint8)
    picture = Image.fromarray(np.repeat(rows[:, None], width, axis=1))
    pen = ImageDraw.Draw(picture, "RGBA")
    shapes = [shape for mesh in (*stage.still, *stage.meshes) for shape in _triangles(mesh, stage.eye, size)]
    shapes += [shape for rods in (*stage.rods, *stage.balls) for shape in _strokes_and_discs(rods, stage.eye, size)]
    for _, draw in sorted(shapes, key=lambda shape: -shape[0]):
        draw(pen)
    return np.array(picture.reduce(FINER))


def _triangles(mesh: Mesh, eye: Eye, size: tuple[int, int]) -> Iterator[Shape]:
    pixels = eye.project(mesh.corners, size)[mesh.triangles]
    solid = mesh.corners[mesh.triangles]
    normals = np.cross(solid[:, 1] - solid[:, 0], solid[:, 2] - solid[:, 0]) @ eye.axes().T
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    towards = np.where(normals[:, 2:] > 0.0, -normals, normals)
    bright = np.clip(0.55 + 0.5 * towards @ LIGHT, 0.0, 1.0)
    colours = mesh.colour[mesh.triangles[:, 0]].astype(float)
    colours[:, :3] *= bright[:, None]
    for corners, colour in zip(pixels, colours.astype(int).tolist(), strict=True):
        if corners[:, 2].min() > NEAREST:
            flat = [tuple(corner) for corner in corners[:, :2].tolist()]
            yield float(corners[:, 2].max()), partial(ImageDraw.ImageDraw.polygon, xy=flat, fill=tuple(colour))


def _strokes_and_discs(rods: Rods, eye: Eye, size: tuple[int, int]) -> Iterator[Shape]:
    start, end = eye.project(rods.start, size), eye.project(rods.end, size)
    for a, b, radius, colour in zip(start, end, rods.radius, rods.colour.astype(int), strict=True):
        if min(a[2], b[2]) > NEAREST:
            depth = float(a[2] + b[2]) / 2
            scaled = float(radius * eye.pixels_per_metre(depth, size))
            draw = _draw_disc if np.array_equal(a, b) else _draw_stroke
            yield depth - float(radius), partial(draw, (a[0], a[1], b[0], b[1]), scaled, colour)


def _draw_stroke(line: tuple[float, ...], radius: float, colour: Array, pen: ImageDraw.ImageDraw) -> None:
    light, dark = tuple(colour[:3].tolist()), tuple((colour[:3] * SHADE).astype(int))
    if colour[3] < 255:
        pen.line(line, fill=(*light, int(colour[3])), width=max(int(2 * radius), 1))
        return
    for x, y in (line[:2], line[2:]):
        pen.ellipse([x - radius, y - radius, x + radius, y + radius], fill=dark)
    pen.line(line, fill=dark, width=max(round(2 * radius), 1))
    x0, y0, x1, y1 = line
    up = 0.25 * radius
    pen.line([x0, y0 - up, x1, y1 - up], fill=light, width=max(round(1.1 * radius), 1))


def _draw_disc(line: tuple[float, ...], radius: float, colour: Array, pen: ImageDraw.ImageDraw) -> None:
    x, y, *_ = line
    for share, shift, shade in ((1.0, 0.0, SHADE), (0.8, 0.12, 1.0), (0.22, 0.4, 1.35)):
        fill = (*np.clip(colour[:3] * shade, 0, 255).astype(int).tolist(), int(colour[3]))
        cx, cy, r = x - shift * radius, y - shift * radius, share * radius
        pen.ellipse([cx - r, cy - r, cx + r, cy + r], fill=fill)


def lettered(pixels: Pixels, stage: Stage) -> Pixels:
    """Return a picture of a stage with the stage's dial and words drawn onto it.

    ``pixels`` ``(height, width, 3)`` is the picture without them. Words in corners come before words at points in
    space.
    """
    if not stage.words and stage.dial is None:
        return pixels
    picture = Image.fromarray(pixels)
    pen = ImageDraw.Draw(picture, "RGBA")
    width, height = stage.size
    if stage.dial is not None:
        _draw_dial(pen, stage.dial, stage)
    below = dict.fromkeys(CORNERS, MARGIN - 2.0)
    for words in sorted(stage.words, key=lambda words: not isinstance(words.place, str)):
        font = _font(round(height * (LARGE if words.large else SMALL)))
        wide, high = font.getlength(words.text), sum(font.getmetrics())
        if isinstance(words.place, str):
            x = MARGIN if "left" in words.place else width - MARGIN - wide
            y = below[words.place] if "top" in words.place else height - below[words.place] - high
            below[words.place] += high + 3
        else:
            x, y, depth = stage.eye.project(words.place, stage.size).tolist()
            if not (depth > 0.0 and 0 <= x < width and 0 <= y < height):
                continue
            x = float(np.clip(x - wide / 2, MARGIN, width - MARGIN - wide))
        _write(pen, (x, y), words.text, font, words.colour or ink(stage.dark), stage.dark)
    return np.array(picture)


def strip(text: str, size: tuple[int, int], dark: bool) -> Pixels:
    """Draw a centred line of text on a plain background, ``(height, width, 3)``; ``size`` is width and height, px."""
    width, height = size
    picture = Image.new("RGB", size, backdrop(dark)[1])
    font = _font(round(0.5 * height))
    ImageDraw.Draw(picture).text((width / 2, height / 2), text, fill=ink(dark), font=font, anchor="mm")
    return np.array(picture)


def _write(
    pen: ImageDraw.ImageDraw, at: tuple[float, float], text: str, font: ImageFont.FreeTypeFont, colour: Rgb, dark: bool
) -> None:
    box = (at[0] - 4, at[1] - 1, at[0] + font.getlength(text) + 4, at[1] + sum(font.getmetrics()))
    pen.rounded_rectangle(box, radius=4, fill=PLATE[dark])
    pen.text(at, text, fill=colour, font=font, anchor="la")


def _draw_dial(pen: ImageDraw.ImageDraw, dial: Dial, stage: Stage) -> None:
    """Draw the dial into the lower right corner of a picture.

    The dial's width is the share `DIAL` of the picture's height. The dial's radius is `SHOWN` times the ring's radius.
    A miss outside the dial is drawn at the share `RIM` of the dial's radius.
    """
    width, height = stage.size
    half = DIAL * height / 2
    x, y = width - MARGIN - half, height - MARGIN - half
    ring, lines = half / SHOWN, ink(stage.dark)
    pen.ellipse([x - half, y - half, x + half, y + half], fill=PLATE[stage.dark], outline=(*lines, 70), width=1)
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
    """Return the font DejaVu Sans, which comes with matplotlib, at a height in px."""
    from matplotlib import get_data_path

    return ImageFont.truetype(Path(get_data_path()) / "fonts/ttf/DejaVuSans.ttf", height)


class Window:
    """A matplotlib window that shows one picture after another.

    If the environment variable MPLBACKEND is "agg", the window shows nothing and raises no error. Tests without a
    screen use this.

    Raises:
        InputError: If there is no display.
    """

    def __init__(self, frames_per_second: float) -> None:
        self.off_screen = os.environ.get("MPLBACKEND", "").lower() == "agg"
        needs_display = sys.platform not in ("win32", "darwin") and not any(map(os.environ.get, DISPLAYS))
        if needs_display and not self.off_screen:
            raise InputError("render_mode='human' needs a display, and there is none; use render_mode='rgb_array'")
        self.pause = 1.0 / frames_per_second
        self._figure: Any = None
        self._image: Any = None

    def show(self, picture: Pixels) -> None:
        """Show a picture ``(height, width, 3)`` for the duration of one frame."""
        if self.off_screen:
            return
        from matplotlib import pyplot

        if self._figure is None:
            height, width = picture.shape[:2]
            self._figure = pyplot.figure("pickenv", figsize=(width / DPI, height / DPI), dpi=DPI)
            axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.set_axis_off()
            self._image = axes.imshow(picture)
            pyplot.show(block=False)
        self._image.set_data(picture)
        self._figure.canvas.draw_idle()
        self._figure.canvas.start_event_loop(self.pause)

    def close(self) -> None:
        """Close the window."""
        if self._figure is not None:
            from matplotlib import pyplot

            pyplot.close(self._figure)
            self._figure = self._image = None
