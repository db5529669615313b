"""Simple rendered stereo images of fruit and leaves, with the true object of each pixel.

Fruit are shaded spheres and leaves flat ellipses. Both are painted from far to near in each image, with the disparity
of their depth. Camera frame: x right, y down, z ahead, origin at the left camera. Units: m, px.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import NUMBER, SHARE, WHOLE, WHOLE_PX, InputError, Unit, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Integers
from pickenv.orchard.vision import StereoCamera, project

BACKGROUND, LEAF = -1, -2

Triple = tuple[float, float, float]


@toml_table
class Look(checks.Preset):
    """Colours and light of rendered images; colours are red, green and blue from 0 to 255.

    Attributes:
        fruit: Colour of fruit.
        leaf: Mean colour of leaves.
        background: Colour of the background.
        leaf_length: Length of a leaf, m.
        leaf_width: Width of a leaf, m.
        ambient: Ambient light on shaded sides of fruit, as a share of full light.
        highlight: Strength of the sun's reflection on fruit, as a share of white.
        pixel_noise: Standard deviation of the sensor's noise, grey levels.
        sun: Direction towards the sun, camera frame.
        source: Source of its numbers.
        sharpness: Exponent of the sun's reflection (Phong).
        patch: Edge of the light and dark squares of the background, px.
    """

    fruit: Annotated[Triple, Unit("rgb")]
    leaf: Annotated[Triple, Unit("rgb")]
    background: Annotated[Triple, Unit("rgb")]
    leaf_length: Annotated[float, MM.positive]
    leaf_width: Annotated[float, MM.positive]
    ambient: Annotated[float, SHARE]
    highlight: Annotated[float, SHARE]
    pixel_noise: Annotated[float, NUMBER.not_negative]
    sun: Annotated[Triple, NUMBER]
    source: str = ""
    sharpness: Annotated[int, WHOLE.at_least(1)] = 12
    patch: Annotated[int, WHOLE_PX.at_least(1)] = 16


@dataclass(frozen=True, eq=False)
class Leaves:
    """Leaves with their positions, attitudes and colours, so that several images can show the same leaves.

    Attributes:
        places: Centres, m, shape (m, 3).
        shapes: For each leaf, a matrix for its attitude and proportions, shape (m, 2, 2). It maps the leaf's ellipse in
            the image to the unit disc, after lengths are divided by half the larger of a leaf's length and width.
        colours: Red, green and blue of each leaf, 0 to 255, shape (m, 3).
    """

    places: Array
    shapes: Array
    colours: Array


@dataclass(frozen=True, eq=False)
class StereoPair:
    """A rendered pair of images.

    Attributes:
        left: Left image, red, green, blue, shape (height, width, 3), uint8.
        right: Right image, red, green, blue, shape (height, width, 3), uint8.
        shows: Object at each pixel of the left image, shape (height, width): index of a fruit, LEAF or BACKGROUND.
        visible: Visible share of each fruit's disc in the left image, shape (n,); 0 outside the image.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    shows: Integers
    visible: Array


load_look = preset_files.loader("look", Look)
"""Read a `Look` by its name, one of `shipped("look")`, or from a TOML file by its path."""


def sample_leaves(
    low: ArrayLike, high: ArrayLike, leaf_area_per_volume: float, look: Look, rng: np.random.Generator
) -> Array:
    """Draw leaf centres, m, (m, 3), uniformly in a box; their number has a Poisson distribution.

    Args:
        low: Corner of the box with the smallest coordinates, m, (3,).
        high: Corner of the box with the largest coordinates, m, (3,).
        leaf_area_per_volume: One-sided leaf area per volume, m²/m³.
        look: Look, which has the size of a leaf.
        rng: Random generator for all draws.

    Raises:
        InputError: If a number is not finite, the leaf area negative, or the high corner below the low corner.
    """
    low, high = (checks.points("the corners of the foliage", corner) for corner in (low, high))
    checks.numbers("the leaf area per volume (m²/m³)", leaf_area_per_volume, lowest=0.0)
    if (high < low).any():
        raise InputError("the foliage has a high corner below its low corner; exchange them")
    area = np.pi / 4 * look.leaf_length * look.leaf_width
    count = rng.poisson(leaf_area_per_volume * float(np.prod(high - low)) / area)
    return np.asarray(low + (high - low) * rng.random((count, 3)))


def render_stereo(
    camera: StereoCamera,
    positions: ArrayLike,
    diameters: ArrayLike,
    leaves: ArrayLike | Leaves,
    look: Look,
    rng: np.random.Generator,
) -> StereoPair:
    """Render both images of a stereo pair with fruit and leaves.

    Args:
        camera: The stereo pair.
        positions: Fruit centres in the camera frame, m, shape (n, 3).
        diameters: Fruit diameters, m, shape (n,) or a number.
        leaves: Leaves in the camera frame, or only their centres, m, shape (m, 3), as from `sample_leaves`.
        look: Colours and light.
        rng: Random generator for background and noise. If only the leaves' centres are given, their attitudes and
            shades are drawn from it too.

    Raises:
        InputError: If fruit or leaves lie behind the camera or a number is not finite.
    """
    positions, diameters = checks.fruit_arrays(positions, diameters)
    leaves = leaves if isinstance(leaves, Leaves) else turned_leaves(leaves, look, rng)
    width, height = camera.image
    places = np.concatenate([positions, leaves.places])
    pixels = project(camera, places)
    images = [_background(look, camera.image, rng) for _ in range(2)]
    shows = np.full((height, width), BACKGROUND, dtype=np.int64)
    leaf_sizes = np.full(len(leaves.places), max(look.leaf_length, look.leaf_width))
    reaches = camera.focal_length / places[:, 2] * (np.concatenate([diameters, leaf_sizes]) / 2)
    for item in np.argsort(-places[:, 2], kind="stable").tolist():
        is_fruit, reach = item < len(positions), reaches[item]
        for eye, image in enumerate(images):
            column, row = pixels[item, 0] - eye * pixels[item, 2], pixels[item, 1]
            start, end = max(int(column - reach), 0), min(int(column + reach) + 2, width)
            top, bottom = max(int(row - reach), 0), min(int(row + reach) + 2, height)
            if start >= end or top >= bottom:
                continue
            u = (np.arange(start, end) - column) / reach
            v = ((np.arange(top, bottom) - row) / reach)[:, None]
            if is_fruit:
                inside, colours = _sphere(look, u, v)
                colour = colours[inside]
            else:
                a, colour = leaves.shapes[item - len(positions)], leaves.colours[item - len(positions)]
                inside = (a[0, 0] * u + a[0, 1] * v) ** 2 + (a[1, 0] * u + a[1, 1] * v) ** 2 <= 1.0
            image[top:bottom, start:end][inside] = colour
            if eye == 0:
                shows[top:bottom, start:end][inside] = item if is_fruit else LEAF
    noisy = [np.clip(im + look.pixel_noise * rng.normal(size=im.shape), 0, 255).astype(np.uint8) for im in images]
    visible_pixels = np.bincount(shows[shows >= 0], minlength=len(positions))
    disc_pixels = np.maximum(np.pi * reaches[: len(positions)] ** 2, 1e-12)
    return StereoPair(noisy[0], noisy[1], shows, np.clip(visible_pixels / disc_pixels, 0.0, 1.0))


def _sphere(look: Look, u: Array, v: Array) -> tuple[NDArray[np.bool_], Array]:
    """Flags of the pixels that a unit sphere covers, and their colours.

    Args:
        look: Colours and light.
        u: Distances of the columns from the centre, to the right, in radii, (columns,).
        v: Distances of the rows from the centre, down, in radii, (rows, 1).

    Returns:
        Flags (rows, columns) and colours (rows, columns, 3).
    """
    square = np.asarray(u**2 + v**2, dtype=np.float64)
    ahead = np.sqrt(np.clip(1.0 - square, 0.0, None))
    sun = np.array(look.sun) / np.linalg.norm(look.sun)
    facing = np.clip(sun[0] * u + sun[1] * v - sun[2] * ahead, 0.0, None)
    mirrored = np.clip(2 * facing * ahead + sun[2], 0.0, None)  # the reflected ray's share towards the camera
    light = look.ambient + (1.0 - look.ambient) * facing
    white = 255.0 * look.highlight * mirrored[..., None] ** look.sharpness
    return square <= 1.0, np.asarray(light[..., None] * np.array(look.fruit) + white, dtype=np.float64)


def turned_leaves(places: ArrayLike, look: Look, rng: np.random.Generator) -> Leaves:
    """Draw attitudes and shades of leaves, uniformly, and return the leaves.

    Args:
        places: Centres of the leaves, m, (m, 3).
        look: Look, which has the size and the mean colour of leaves.
        rng: Random generator for all draws.
    """
    places = checks.points("leaf positions", places).reshape(-1, 3)
    count = len(places)
    basis, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    size = np.array([look.leaf_length, look.leaf_width]) / max(look.leaf_length, look.leaf_width)
    axes = basis[:, :2, :2] * size  # the leaf's two half axes, seen along z
    axes[np.abs(np.linalg.det(axes)) < 1e-3] = np.diag([1e-3, 1e-3])  # seen edge-on: nothing
    shade = np.array(look.leaf) * (0.7 + 0.6 * rng.random((count, 1)))
    return Leaves(places, np.asarray(np.linalg.inv(axes), dtype=np.float64), shade)


def _background(look: Look, image: tuple[int, int], rng: np.random.Generator) -> Array:
    """Background image of light and dark patches, (height, width, 3)."""
    coarse = 0.7 + 0.6 * rng.random((image[1] // look.patch + 1, image[0] // look.patch + 1))
    fine = np.kron(coarse, np.ones((look.patch, look.patch)))[: image[1], : image[0]]
    return np.asarray(fine[..., None] * np.array(look.background))
