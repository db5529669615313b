"""Words and the dial of the miss, written onto a picture with Pillow. Units: px, mm on the dial."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pickenv.pictures.stage import Dial, Pixels, Rgb, Stage, ink

MARGIN = 8
SMALL, LARGE = 1 / 26, 1 / 19
"""Heights of letters, as shares of the picture's height."""
DIAL = 0.27
"""Its width, as a share of the picture's height."""
SHOWN = 2.2
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
    below = {corner: float(MARGIN) for corner in ("top left", "top right", "bottom left", "bottom right")}
    lines = [words for words in stage.words if isinstance(words.place, str)]
    for words in lines:
        assert isinstance(words.place, str)
        font = _font(round(height * (LARGE if words.large else SMALL)))
        left, top, right, bottom = font.getbbox(words.text, anchor="lt")
        wide, high = right - left, bottom - top
        x = MARGIN if "left" in words.place else width - MARGIN - wide
        y = below[words.place] if "top" in words.place else height - below[words.place] - high
        _write(pen, (x, y), words.text, font, words.colour or ink(stage.dark), stage.dark)
        below[words.place] += high + 9
    for words in stage.words:
        if not isinstance(words.place, str):
            x, y, depth = stage.eye.project(words.place, stage.size).tolist()
            font = _font(round(height * (LARGE if words.large else SMALL)))
            wide = font.getlength(words.text)
            if depth > 0.0 and 0 <= x < width and 0 <= y < height:
                at = float(np.clip(x - wide / 2, MARGIN, width - MARGIN - wide)), y
                _write(pen, at, words.text, font, words.colour or ink(stage.dark), stage.dark)
    return np.array(picture)


def _write(
    pen: ImageDraw.ImageDraw, at: tuple[float, float], text: str, font: ImageFont.FreeTypeFont, colour: Rgb, dark: bool
) -> None:
    left, top, right, bottom = font.getbbox(text, anchor="lt")
    box = (at[0] + left - 4, at[1] + top - 3, at[0] + right + 4, at[1] + bottom + 3)
    pen.rounded_rectangle(box, radius=4, fill=_plate(dark))
    pen.text(at, text, fill=colour, font=font, anchor="lt")


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
    places = np.concatenate([np.reshape(dial.trail_mm, (-1, 2)), np.reshape(dial.miss_mm, (1, 2))]) / dial.tolerance_mm
    far = np.linalg.norm(places, axis=1, keepdims=True)
    places *= np.minimum(1.0, SHOWN * 0.93 / np.maximum(far, 1e-9))
    flat = [(x + ring * px, y - ring * py) for px, py in places.tolist()]
    if len(flat) > 1:
        pen.line(flat, fill=(*dial.colour, 130), width=2)
    mx, my = flat[-1]
    pen.ellipse([mx - 5, my - 5, mx + 5, my + 5], fill=(*dial.colour, 255), outline=(*lines, 255), width=1)


@lru_cache(maxsize=8)
def _font(height: int) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which comes with matplotlib."""
    from matplotlib import get_data_path

    return ImageFont.truetype(Path(get_data_path()) / "fonts/ttf/DejaVuSans.ttf", height)
