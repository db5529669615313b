"""Words and the dial of the miss, written onto a picture with Pillow. Units: px, mm on the dial."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pickenv.pictures.stage import Dial, Pixels, Rgb, Stage, backdrop, ink

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
