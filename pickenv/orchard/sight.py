"""Models of how a machine's stereo camera sees fruit: by rendered images, by measured errors, or without error.

There are three models, called visions. ``rendered`` renders both images and runs a detector on them. It is the exact
model, and takes a tenth of a second each time. ``measured_errors`` draws errors from tables that were measured on
rendered images. There is a table for each canopy and detector, with an entry for each range of distances. ``ideal``
detects all fruit without error.

Errors are far from normal: most are small, but errors of fruit behind leaves are large. Therefore a table divides the
located fruit of each range into parts of equal number, from the smallest to the largest error. In each part the error
is modelled as normal. The script `scripts/studies/measure_sight.py` makes the tables. Camera frame: x right, y down,
z ahead. Units: m, px.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import NUMBER, SHARE, WHOLE, WHOLE_PX, InputError, Unit, check_known, toml_table
from pickenv.orchard import checks, preset_files, vision as stereo
from pickenv.orchard.camera import camera_axes, camera_frame, orchard_frame
from pickenv.orchard.canopy import Canopy, face
from pickenv.orchard.checks import MM, Array, Flags, Integers

# Simple rendered stereo images of fruit and leaves, with the true object of each pixel. Fruit are shaded spheres and
# leaves flat ellipses. Both are painted from far to near in each image, with the disparity of their depth. Camera
# frame: x right, y down, z ahead, origin at the left camera.


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
        shapes: For each leaf, a matrix for its attitude and proportions, shape (m, 2, 2). First, offsets from the
            leaf's centre in the image are divided by half the leaf's length or width, whichever is larger. The matrix
            then maps the leaf's ellipse to the unit disc.
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
        shows: Object at each pixel of the left image, shape (height, width): index of a fruit, from 0, or a negative
            number, LEAF or BACKGROUND.
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
        InputError: If a number is not finite, the leaf area is negative, or the high corner is below the low corner.
    """
    low, high = (checks.points("the corners of the foliage", corner) for corner in (low, high))
    checks.numbers("the leaf area per volume (m²/m³)", leaf_area_per_volume, lowest=0.0)
    if (high < low).any():
        raise InputError("the foliage has a high corner below its low corner; exchange them")
    area = np.pi / 4 * look.leaf_length * look.leaf_width
    count = rng.poisson(leaf_area_per_volume * float(np.prod(high - low)) / area)
    return np.asarray(low + (high - low) * rng.random((count, 3)))


def render_stereo(
    camera: stereo.StereoCamera,
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
    pixels = stereo.project(camera, places)
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
    """Return flags of the pixels that a unit sphere covers, and the sphere's colours.

    Args:
        look: Colours and light.
        u: Distances of the pixel columns from the sphere's centre, to the right, in radii, (columns,).
        v: Distances of the pixel rows from the sphere's centre, down, in radii, (rows, 1).

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
    """Return a background image of light and dark patches, (height, width, 3), 0 to 255.

    ``image`` is the width and height of the image, px.
    """
    coarse = 0.7 + 0.6 * rng.random((image[1] // look.patch + 1, image[0] // look.patch + 1))
    fine = np.kron(coarse, np.ones((look.patch, look.patch)))[: image[1], : image[0]]
    return np.asarray(fine[..., None] * np.array(look.background))


# The three visions.


PAIRS = ((0, 1), (0, 2), (1, 2))
"""Pairs of axes (x, y, z are 0, 1, 2) to which the three correlations of an error belong, in their order."""

Lengths = tuple[tuple[float, float, float], ...]


@toml_table
class SightErrors(checks.Preset):
    """A table of the position errors of one detector in one canopy; see sight.toml.

    ``visible`` to ``part_correlation`` have one entry for each range of distances. Errors are in the camera frame.
    Confidence intervals are of 95 %, over trees.

    Attributes:
        name: Names of canopy and detector.
        canopy: Preset of the canopy.
        detector: Name of the detector.
        leaf_area_per_volume: One-sided leaf area of the canopy per volume, m²/m³.
        trees: Number of rendered trees.
        pictures: Number of rendered images.
        fruit: Number of fruit in these images.
        edges: Limits between the ranges of distance ahead of the camera, m.
        visible: Mean visible share of a fruit's disc.
        in_sight: Share of fruit that is visible at least in part.
        recall: Share of fruit that is located.
        recall_low: Lower end of the confidence interval of ``recall``.
        recall_high: Upper end of the confidence interval of ``recall``.
        bias: Mean error along x, y and z, m.
        bias_low: Lower end of the confidence interval of ``bias``, m.
        bias_high: Upper end of the confidence interval of ``bias``, m.
        spread: Standard deviation of the error along x, y and z, m.
        spread_low: Lower end of the confidence interval of ``spread``, m.
        spread_high: Upper end of the confidence interval of ``spread``, m.
        correlation: Correlations between the errors along x and y, along x and z, and along y and z.
        part_bias: Mean error in each part of a range, m. A part has an equal share of the located fruit; the first part
            has the smallest errors, the last part the largest.
        part_spread: Standard deviation of the error in each part, m.
        part_correlation: Correlations, as in ``correlation``, of the error in each part.
        false_per_picture: Mean number of false detections per image.
        lasting: Correlation between the errors of one fruit in two images from the same viewpoint.
        source: Source of its numbers.
    """

    name: str
    canopy: str
    detector: str
    leaf_area_per_volume: Annotated[float, NUMBER.not_negative]
    trees: Annotated[int, WHOLE.positive]
    pictures: Annotated[int, WHOLE.positive]
    fruit: Annotated[int, WHOLE.positive]
    edges: Annotated[tuple[float, ...], MM.positive]
    visible: Annotated[tuple[float, ...], SHARE]
    in_sight: Annotated[tuple[float, ...], SHARE]
    recall: Annotated[tuple[float, ...], SHARE]
    recall_low: Annotated[tuple[float, ...], SHARE]
    recall_high: Annotated[tuple[float, ...], SHARE]
    bias: Annotated[Lengths, MM]
    bias_low: Annotated[Lengths, MM]
    bias_high: Annotated[Lengths, MM]
    spread: Annotated[Lengths, MM.not_negative]
    spread_low: Annotated[Lengths, MM.not_negative]
    spread_high: Annotated[Lengths, MM.not_negative]
    correlation: Annotated[Lengths, NUMBER.within(-1.0, 1.0)]
    part_bias: Annotated[tuple[Lengths, ...], MM]
    part_spread: Annotated[tuple[Lengths, ...], MM.not_negative]
    part_correlation: Annotated[tuple[Lengths, ...], NUMBER.within(-1.0, 1.0)]
    false_per_picture: Annotated[float, NUMBER.not_negative]
    lasting: Annotated[float, SHARE]
    source: str = ""

    def __post_init__(self) -> None:
        ranges, parts = len(self.edges) + 1, len(self.part_bias[0]) if self.part_bias else 0
        tables = [getattr(self, name) for name in ("part_bias", "part_spread", "part_correlation")]
        rows = (self.in_sight, self.recall, self.bias, self.spread, *tables)
        if not parts or any(len(row) != ranges for row in rows) or {len(r) for t in tables for r in t} != {parts}:
            raise InputError(
                f"sight errors '{self.name}' have not one entry for each of {ranges} ranges and their parts"
            )
        super().__post_init__()


load_sight_errors = preset_files.loader("sight", SightErrors)
"""Read a table of errors by its name, one of `shipped("sight")`, or from a TOML file by its path."""


def draw_chances(rng: np.random.Generator, count: int) -> Array:
    """Draw five random numbers for each of ``count`` fruit in an image, (count, 5).

    The first number is uniform from 0 to 1 and selects a part of the table of errors. The next three decide the error
    along x, y and z, the fifth whether the fruit is located. These four are standard normal.
    """
    return np.column_stack([rng.random(count), rng.normal(size=(count, 4))])


def next_picture(errors: SightErrors, before: Array, rng: np.random.Generator) -> Array:
    """Draw the random numbers of the same fruit in another image from the same viewpoint, (n, 5).

    The new numbers are correlated with ``before``, because the leaves have not moved.

    Args:
        errors: The table of errors; its attribute ``lasting`` is the correlation of the normal numbers.
        before: Random numbers of the image before, (n, 5); see `draw_chances`.
        rng: Random generator for the new numbers.
    """
    chances, fresh = before.copy(), rng.normal(size=(len(before), 4))
    chances[:, 1:] = errors.lasting * before[:, 1:] + np.sqrt(1.0 - errors.lasting**2) * fresh
    return chances


def sighted(errors: SightErrors, depth: ArrayLike, chances: Array, looks: int = 1) -> tuple[Flags, Flags, Array]:
    """Compute from a table of errors which fruit are visible, which are located, and their position errors.

    Args:
        errors: The table.
        depth: Distances of the fruit ahead of the camera, m, (n,).
        chances: Random numbers that decide the result, (n, 5); see `draw_chances`.
        looks: Number of images that are averaged. Averaging reduces the part of the error that differs between images.

    Returns:
        Three arrays. The first says whether each fruit is visible at least in part, (n,). The second says whether each
        fruit is located, (n,). The third has the position error of each fruit in the camera frame, m, (n, 3).
    """
    from scipy.special import ndtr

    row = np.searchsorted(np.array(errors.edges), np.asarray(depth, dtype=float))
    parts = len(errors.part_bias[0])
    cell = row, np.minimum((chances[:, 0] * parts).astype(np.int64), parts - 1)
    level, recall = ndtr(chances[:, 4]), np.array(errors.recall)
    located = level < recall[row]
    in_sight = level < np.maximum(np.array(errors.in_sight), recall)[row]
    steady = np.sqrt(errors.lasting + (1.0 - errors.lasting) / looks)
    miss = (_roots(errors)[cell] * (steady * chances[:, None, 1:4])).sum(axis=-1)
    return in_sight, located, np.asarray(np.array(errors.part_bias)[cell] + miss)


def _roots(errors: SightErrors) -> Array:
    """Return the Cholesky factors of the errors' covariances, m, (ranges, parts, 3, 3).

    There is one factor for each range of distances and each part of it, as `SightErrors` divides them.
    """
    spread, correlation = np.array(errors.part_spread), np.array(errors.part_correlation)
    matrices = np.broadcast_to(np.eye(3), (*spread.shape, 3)).copy()
    for i, (a, b) in enumerate(PAIRS):
        matrices[..., a, b] = matrices[..., b, a] = 0.999 * correlation[..., i]  # rounded numbers may be singular
    return np.asarray(spread[..., :, None] * np.linalg.cholesky(matrices))


VISIONS = ("rendered", "measured_errors", "ideal")
DETECTORS = ("li2016", "circles")
"""Names of the detectors: centroids of fruit-coloured regions (Li et al. 2016), and circles through visible rims."""


@dataclass(frozen=True, eq=False)
class Eyes:
    """Model of how a stereo camera sees fruit in one canopy.

    Attributes:
        vision: "rendered", "measured_errors" or "ideal" (without errors): how an image is simulated.
        detector: "li2016" or "circles": the detector that finds fruit in an image (`DETECTORS`).
        canopy: The canopy.
        camera: The stereo pair.
        look: Colours and light of rendered images.
        search: Parameters of the circle detector.
        errors: Table of errors if ``vision`` is "measured_errors", else None.
    """

    vision: str
    detector: str
    canopy: Canopy
    camera: stereo.StereoCamera
    look: Look
    search: stereo.CircleSearch
    errors: SightErrors | None


def load_eyes(vision: str, canopy: Canopy, detector: str = "li2016") -> Eyes:
    """Return the model of how the stereo pair of Li et al. 2016 sees fruit in a canopy.

    Args:
        vision: "rendered", "measured_errors" or "ideal" (without errors): how an image is simulated.
        canopy: The canopy.
        detector: "li2016" or "circles": the detector that finds fruit in an image (`DETECTORS`).

    Raises:
        InputError: If the vision or the detector is unknown, or ``vision`` is "measured_errors" and there is no table
            of errors for this canopy, leaf area and detector.
    """
    check_known("vision", vision, VISIONS)
    check_known("detector", detector, DETECTORS)
    errors, table = None, f"{canopy.name}-{detector}"
    if vision == "measured_errors":
        errors = load_sight_errors(table) if table in preset_files.shipped("sight") else None
        if errors is None or errors.leaf_area_per_volume != canopy.leaf_area_per_volume:
            raise InputError(
                f"no errors were measured in canopy '{canopy.name}' with {canopy.leaf_area_per_volume:g} m2/m3 of "
                f"leaves by detector '{detector}'; give vision='rendered', or measure them: "
                "python scripts/studies/measure_sight.py"
            )
    camera, search = stereo.load_stereo_camera("li2016"), stereo.load_circle_search("li2016")
    return Eyes(vision, detector, canopy, camera, load_look("red_apples"), search, errors)


Viewpoint = tuple[Array, Array]
"""Two vectors (3,) in any frame with z up: the midpoint between the two cameras, m, and their direction of view."""


def left_eye(camera: stereo.StereoCamera, view: Viewpoint) -> Array:
    """Return the position of the left camera of a stereo pair, m, (3,), in the frame in which ``view`` is given.

    Args:
        camera: The stereo pair.
        view: Midpoint between the two cameras, m, and direction of view, (3,) each.
    """
    middle, looking = view
    return np.asarray(middle - camera.baseline / 2 * camera_axes(looking)[0])


@dataclass(frozen=True, eq=False)
class Sight:
    """Fruit as seen from a viewpoint.

    Attributes:
        in_sight: For each fruit, whether at least a part is visible, (n,).
        located: For each fruit, whether its position was measured, (n,).
        believed: Measured positions, m, (n, 3), in the frame in which the viewpoint was given. They are valid only for
            located fruit.
        false: Positions of false detections in the same frame, m, (m, 3).
    """

    in_sight: Flags
    located: Flags
    believed: Array
    false: Array


def foliage(eyes: Eyes, rng: np.random.Generator) -> Leaves | None:
    """Draw the leaves of the canopy, in the orchard frame, as far along the row of trees as an image shows.

    Args:
        eyes: Model of how fruit is seen.
        rng: Random generator for all draws.

    Returns:
        The leaves; None if the vision is not "rendered".
    """
    if eyes.vision != "rendered":
        return None
    canopy, camera = eyes.canopy, eyes.camera
    aside = canopy.width / 2 + (canopy.standoff + canopy.depth) * camera.image[0] / 2 / camera.focal_length
    low, high = [-aside, 0.0, canopy.bottom], [aside, canopy.depth, canopy.top]
    places = sample_leaves(low, high, canopy.leaf_area_per_volume, eyes.look, rng)
    places[:, 1] += face(canopy, places[:, 2])
    return turned_leaves(places, eyes.look, rng)


def picture(
    eyes: Eyes,
    view: Viewpoint,
    fruit: ArrayLike,
    diameters: ArrayLike,
    leaves: Leaves | None,
    rng: np.random.Generator,
    looks: int = 1,
) -> StereoPair:
    """Render the pair of images from a viewpoint.

    Args:
        eyes: Model of how fruit is seen, which has the camera and the look.
        view: Midpoint between the two cameras, m, and direction of view, (3,) each, in any frame with z up.
        fruit: True fruit centres in the frame of ``view``, m, (n, 3).
        diameters: Fruit diameters, m, (n,).
        leaves: Leaves in the frame of ``view``; None for no leaves.
        rng: Random generator for background and noise.
        looks: Number of images that are averaged, which reduces only the sensor's noise.
    """
    camera, eye, looking = eyes.camera, left_eye(eyes.camera, view), view[1]
    leaves = turned_leaves(np.zeros((0, 3)), eyes.look, rng) if leaves is None else leaves
    places = camera_frame(leaves.places, eye, looking)
    half = np.array(camera.image) / 2 / camera.focal_length
    edge = np.array([camera.baseline + eyes.look.leaf_length, eyes.look.leaf_length])
    visible = (np.abs(places[:, :2]) <= half * places[:, 2:] + edge).all(axis=1)
    leaves = Leaves(places[visible], leaves.shapes[visible], leaves.colours[visible])
    look = replace(eyes.look, pixel_noise=eyes.look.pixel_noise / np.sqrt(looks))
    return render_stereo(camera, camera_frame(fruit, eye, looking), diameters, leaves, look, rng)


def read_picture(eyes: Eyes, pair: StereoPair) -> Array:
    """Run the detector on a pair of images and return the positions of its detections, camera frame, m, (k, 3)."""
    if eyes.detector == "circles":
        return stereo.locate_circles(eyes.camera, eyes.search, pair.left, pair.right)[0]
    return stereo.locate(eyes.camera, pair.left, pair.right)[0]


def located_fruit(
    pair: StereoPair, detections: Array, places: Array, diameters: ArrayLike
) -> tuple[Flags, Array, Array]:
    """Match the detections of a pair of images to the true fruit.

    A correct detection is at most as far from its fruit as the largest fruit diameter.

    Args:
        pair: The images.
        detections: Positions of detections, camera frame, m, (k, 3).
        places: True fruit centres, camera frame, m, (n, 3).
        diameters: Fruit diameters, m, (n,).

    Returns:
        Three arrays. The first says whether each fruit is located, (n,). The second has the measured position of each
        fruit, m, (n, 3), or the true position of a fruit that is not located. The third has the positions of false
        detections, m, (m, 3). Positions are in the camera frame.
    """
    located, positions = np.zeros(len(places), dtype=bool), places.copy()
    visible = np.flatnonzero(pair.visible > 0)
    if not len(visible):
        return located, positions, detections
    matched = stereo.match_detections(detections, places[visible], float(np.max(diameters)))
    fruit = visible[matched[matched >= 0]]
    located[fruit], positions[fruit] = True, detections[matched >= 0]
    return located, positions, detections[matched < 0]


def see(
    eyes: Eyes,
    view: Viewpoint,
    fruit: ArrayLike,
    diameters: ArrayLike,
    rng: np.random.Generator,
    *,
    leaves: Leaves | None = None,
    chances: Array | None = None,
    looks: int = 1,
) -> Sight:
    """Simulate how fruit is seen from a viewpoint.

    Args:
        eyes: Model of how fruit is seen.
        view: Midpoint between the two cameras, m, and direction of view, (3,) each, in any frame with z up.
        fruit: True fruit centres in the frame of ``view``, m, (n, 3).
        diameters: Fruit diameters, m, (n,).
        rng: Random generator for all draws, except ``chances`` if these are not None.
        leaves: Leaves in the frame of ``view``, if ``eyes.vision`` is "rendered"; None for no leaves.
        chances: Random numbers, (n, 5), from `draw_chances` or `next_picture`, if ``eyes.vision`` is "measured_errors";
            drawn by default.
        looks: Number of images that are averaged.
    """
    fruit = np.asarray(fruit, dtype=float).reshape(-1, 3)
    if eyes.vision == "ideal":
        everything = np.ones(len(fruit), dtype=bool)
        return Sight(everything, everything, fruit.copy(), np.zeros((0, 3)))
    eye, looking = left_eye(eyes.camera, view), view[1]
    places = camera_frame(fruit, eye, looking)
    if eyes.vision == "rendered":
        pair = picture(eyes, view, fruit, diameters, leaves, rng, looks)
        located, positions, false = located_fruit(pair, read_picture(eyes, pair), places, diameters)
        in_sight = pair.visible > 0
    else:
        assert eyes.errors is not None
        chances = draw_chances(rng, len(fruit)) if chances is None else chances
        in_sight, located, error = sighted(eyes.errors, places[:, 2], chances, looks)
        positions, false = places + error, _phantoms(eyes, eyes.errors.false_per_picture, rng)
    positions, false = (orchard_frame(local, eye, looking) for local in (positions, false))
    return Sight(in_sight, located, positions, false)


def _phantoms(eyes: Eyes, mean_count: float, rng: np.random.Generator) -> Array:
    """Draw positions of false detections, camera frame, m, (m, 3): anywhere in the image, as far away as the canopy.

    Their number has a Poisson distribution with the mean ``mean_count``.
    """
    camera, canopy = eyes.camera, eyes.canopy
    count = int(rng.poisson(mean_count))
    depth = canopy.standoff + canopy.depth * rng.random((count, 1))
    across = (rng.random((count, 2)) - 0.5) * np.array(camera.image) / camera.focal_length
    return np.concatenate([across * depth, depth], axis=-1)
