"""A renderer of pictures of a board, with known truth: each pixel's ray is cut with the board's plane."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter, map_coordinates

from pickenv.arm import Array, Pose
from pickenv.calibration import Board, Lens, board_picture
from pickenv.calibration.camera.boards import Grey
from pickenv.calibration.model.pixels import undistorted

SAMPLES = 3
"""Rays along each side of a pixel."""
PIXELS_PER_SQUARE = 160


def render(
    board: Board, lens: Lens, pose: Pose, rng: np.random.Generator, noise: float = 2.0, blur: float = 0.6
) -> Grey:
    """The picture ``(h, w)`` of a board that stands at `pose` in the camera's frame.

    Args:
        board: The board; grey surrounds its white margin.
        lens: The camera.
        pose: Of the board.
        rng: Draws the noise.
        noise: Standard deviation, grey values.
        blur: Standard deviation, px.
    """
    width, height = lens.size
    rays = rays_of(lens)
    normal = pose.rotation[:, 2]
    along = (normal @ pose.position) / (rays @ normal)
    points = (rays * along[..., None] - pose.position) @ pose.rotation
    drawn = board_picture(board, PIXELS_PER_SQUARE).astype(float)
    scale = PIXELS_PER_SQUARE / board.square
    flat = points[..., :2] * scale - 0.5
    grey = map_coordinates(drawn, [flat[..., 1], flat[..., 0]], order=1, mode="constant", cval=255.0)
    margin = 0.5 * PIXELS_PER_SQUARE
    outside = (flat < -margin).any(-1) | (flat > np.array(drawn.shape[::-1]) + margin).any(-1)
    grey[outside | (along <= 0.0)] = 128.0
    mean = grey.reshape(height, SAMPLES, width, SAMPLES).mean(axis=(1, 3))
    return np.clip(np.rint(gaussian_filter(mean, blur) + rng.normal(0.0, noise, mean.shape)), 0, 255).astype(np.uint8)


@cache
def rays_of(lens: Lens) -> Array:
    """The rays of all samples of a picture ``(h s, w s, 3)``, with z = 1: splines through those of every few pixels."""
    x, y = ((np.arange(side)[:, None] + (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5).ravel() for side in lens.size)
    few, some = (np.linspace(places[0], places[-1], 201) for places in (x, y))
    across, down = np.moveaxis(undistorted(lens.values, np.stack(np.meshgrid(few, some), axis=-1)), -1, 0)
    rays = [RectBivariateSpline(some, few, values)(y, x) for values in (across, down)]
    return np.stack([*rays, np.ones_like(rays[0])], axis=-1)


@pytest.fixture(scope="session")
def rendered() -> Callable[..., Grey]:
    return render


@pytest.fixture(scope="session")
def webcam() -> Lens:
    values = np.array([620.0, 622.0, 323.0, 238.0, -0.08, 0.05, 0.0008, -0.0005, 0.01])
    return Lens(values, (640, 480), "webcam")
