"""Pictures of a screen as arrays ``(height, width, 3)``: whether they show anything, and whether they differ."""

from __future__ import annotations

import io
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Picture = NDArray[np.uint8]
Box = tuple[float, float, float, float]
"""Left, top, right, bottom; pixels."""


def decode(png: bytes) -> Picture:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def save(picture: Picture, path: Path) -> None:
    Image.fromarray(picture).save(path)


def crop(picture: Picture, box: Box) -> Picture:
    left, top, right, bottom = (round(edge) for edge in box)
    return picture[max(top, 0) : bottom, max(left, 0) : right]


def colours(picture: Picture) -> int:
    """How many colours a picture has, shades closer than 8 of 256 counted as one."""
    coarse = picture.reshape(-1, 3).astype(np.int32) // 8
    return len(np.unique(coarse @ np.array([1024, 32, 1])))


def changed_share(before: Picture, after: Picture) -> float:
    """Share of pixels that differ visibly; 1 where the pictures' sizes differ."""
    if before.shape != after.shape:
        return 1.0
    return float((np.abs(before.astype(int) - after).max(axis=-1) > 16).mean())


def settled(shoot: Callable[[], bytes], timeout: float = 30.0, pause: float = 0.2) -> bytes:
    """Shoot until two pictures in a row show the same: fonts, tables and eyes have then arrived."""
    last, end = shoot(), time.monotonic() + timeout
    while time.monotonic() < end:
        time.sleep(pause)
        png = shoot()
        if png == last or changed_share(decode(last), decode(png)) == 0.0:
            return png
        last = png
    raise TimeoutError(f"the picture still changed after {timeout:g} s")


def file_name(title: str) -> str:
    """A title as part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
