"""Fruit as a machine's stereo pair sees it: in rendered pictures, by errors measured on such pictures, or exactly.

There are three visions. ``rendered`` draws both images and reads them. It is exact and takes a tenth of a second each
time. ``measured_errors`` draws errors from tables that were measured on rendered pictures, one for each canopy and
detector, by range. ``ideal`` sees all fruit where it is.

Errors are far from normal: most are small, and behind a leaf they are large. So a table cuts the located fruit of each
range into equal parts, from the least to the largest error. In each part the error is normal. The script
`scripts/studies/measure_sight.py` makes the tables. Camera frame: x right, y down, z ahead. Units: m, px.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import NUMBER, SHARE, WHOLE, InputError, toml_table
from pickenv.orchard import checks, preset_files, vision as stereo
from pickenv.orchard.camera import camera_axes, camera_frame, orchard_frame
from pickenv.orchard.canopy import Canopy, face
from pickenv.orchard.checks import MM, Array, Flags
from pickenv.orchard.render import Leaves, Look, StereoPair, load_look, render_stereo, sample_leaves, turned_leaves

PAIRS = ((0, 1), (0, 2), (1, 2))
"""Pairs of axes of the three correlations of an error."""

Lengths = tuple[tuple[float, float, float], ...]


@toml_table
class SightErrors(checks.Preset):
    """Errors of one detector in one canopy, one entry for each range of distance; see sight.toml.

    Intervals are of 95 %, over trees.

    Attributes:
        name: Names of canopy and detector.
        canopy: Preset of the canopy.
        detector: Name of the detector.
        leaf_area_per_volume: One-sided leaf area of the canopy, m²/m³.
        trees: Number of rendered trees.
        pictures: Number of rendered pictures.
        fruit: Number of fruit in them.
        edges: Distances ahead of the camera at which the ranges meet, m.
        visible: Mean visible share of a fruit's disc.
        in_sight: Share of fruit of which at least a part is visible.
        recall: Share of fruit that is located.
        recall_low: Lower end of its interval.
        recall_high: Upper end of its interval.
        bias: Mean error along x, y and z, m.
        bias_low: Lower end of its interval, m.
        bias_high: Upper end of its interval, m.
        spread: Standard deviation of the error along x, y and z, m.
        spread_low: Lower end of its interval, m.
        spread_high: Upper end of its interval, m.
        correlation: Correlations of the errors along x and y, x and z, y and z.
        part_bias: Mean error in each part of a range, from the least to the largest error, m.
        part_spread: Standard deviation of the error in each part, m.
        part_correlation: Correlations of the error in each part.
        false_per_picture: Mean number of false detections in a picture.
        lasting: Correlation between the errors of one fruit in two pictures from the same place.
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
"""Reads a table of errors by name (`shipped("sight")`) or from a path to a TOML file."""


def draw_chances(rng: np.random.Generator, count: int) -> Array:
    """Random numbers that decide about ``count`` fruit in a picture, (count, 5).

    The first is uniform and chooses the part of the located fruit. The others are standard normal: three for the error,
    one for whether the fruit is found.
    """
    return np.column_stack([rng.random(count), rng.normal(size=(count, 4))])


def next_picture(errors: SightErrors, before: Array, rng: np.random.Generator) -> Array:
    """Random numbers of the same fruit in a further picture from the same place, (n, 5): leaves still hang there.

    Args:
        errors: The table; `SightErrors.lasting` says how far the two pictures agree.
        before: Random numbers of the picture before, (n, 5); see `draw_chances`.
        rng: Source of the new numbers.
    """
    chances, fresh = before.copy(), rng.normal(size=(len(before), 4))
    chances[:, 1:] = errors.lasting * before[:, 1:] + np.sqrt(1.0 - errors.lasting**2) * fresh
    return chances


def sighted(errors: SightErrors, depth: ArrayLike, chances: Array, looks: int = 1) -> tuple[Flags, Flags, Array]:
    """Sight of fruit by a table of errors.

    Args:
        errors: The table.
        depth: Distances ahead of the camera, m, (n,).
        chances: Random numbers that decide, (n, 5); see `draw_chances`.
        looks: Number of pictures that are averaged; that lessens the part of the error that does not last.

    Returns:
        Flags of fruit in sight (n,), flags of located fruit (n,), and errors in the camera frame, m, (n, 3).
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
    """Cholesky factors of the covariances of the parts, m, (ranges, parts, 3, 3)."""
    spread, correlation = np.array(errors.part_spread), np.array(errors.part_correlation)
    matrices = np.broadcast_to(np.eye(3), (*spread.shape, 3)).copy()
    for i, (a, b) in enumerate(PAIRS):
        matrices[..., a, b] = matrices[..., b, a] = 0.999 * correlation[..., i]  # rounded numbers may be singular
    return np.asarray(spread[..., :, None] * np.linalg.cholesky(matrices))


VISIONS = ("rendered", "measured_errors", "ideal")
DETECTORS = ("li2016", "circles")
"""Names of the detectors: Li's regions and their centroids, and circles, of which leaves may hide a part."""

SAME = 1.0
"""Largest distance between a detection and its fruit, in diameters."""


@dataclass(frozen=True, eq=False)
class Eyes:
    """Model of how cameras see fruit in one canopy.

    Attributes:
        vision: One of `VISIONS`.
        detector: One of `DETECTORS`.
        canopy: The canopy, with its leaves.
        camera: The stereo pair.
        look: Colours and light of its pictures.
        search: Numbers of the circle detector.
        errors: Table of errors for ``measured_errors``, else None.
    """

    vision: str
    detector: str
    canopy: Canopy
    camera: stereo.StereoCamera
    look: Look
    search: stereo.CircleSearch
    errors: SightErrors | None


def load_eyes(vision: str, canopy: Canopy, detector: str = "li2016") -> Eyes:
    """Model of the stereo pair of Li et al. 2016 in a canopy.

    Args:
        vision: One of `VISIONS`.
        canopy: The canopy.
        detector: One of `DETECTORS`.

    Raises:
        InputError: If the vision or the detector is unknown, or no errors were measured in this canopy.
    """
    for parameter, name, names in (("vision", vision, VISIONS), ("detector", detector, DETECTORS)):
        if name not in names:
            raise InputError(f"unknown {parameter} '{name}'; give one of {', '.join(names)}")
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
"""The middle of the stereo pair, m, and its direction of view, (3,) each, in any frame with z up."""


def left_eye(camera: stereo.StereoCamera, view: Viewpoint) -> Array:
    """Position of the left camera of a stereo pair at a viewpoint, m, (3,)."""
    middle, looking = view
    return np.asarray(middle - camera.baseline / 2 * camera_axes(looking)[0])


@dataclass(frozen=True, eq=False)
class Sight:
    """Fruit as seen from a viewpoint.

    Attributes:
        in_sight: Whether at least a part of each fruit is visible, (n,).
        located: Whether the position of each fruit was measured, (n,).
        believed: Measured positions in the frame of the viewpoint, m, (n, 3). Only those of located fruit mean
            something.
        false: Positions of false detections in the frame of the viewpoint, m, (m, 3).
    """

    in_sight: Flags
    located: Flags
    believed: Array
    false: Array


def foliage(eyes: Eyes, rng: np.random.Generator) -> Leaves | None:
    """Leaves of a canopy in the orchard frame, as far along the row as a picture shows; None unless rendered."""
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
    """Pair of images from a viewpoint.

    Args:
        eyes: Camera and look.
        view: The viewpoint.
        fruit: True fruit centres in the frame of the viewpoint, m, (n, 3).
        diameters: Fruit diameters, m, (n,).
        leaves: Leaves in the frame of the viewpoint, or None.
        rng: Source of background and noise.
        looks: Number of pictures that are averaged; that lessens only the sensor's noise.
    """
    camera, eye, looking = eyes.camera, left_eye(eyes.camera, view), view[1]
    if leaves is None:
        leaves = turned_leaves(np.zeros((0, 3)), eyes.look, rng)
    places = camera_frame(leaves.places, eye, looking)
    half = np.array(camera.image) / 2 / camera.focal_length
    edge = np.array([camera.baseline + eyes.look.leaf_length, eyes.look.leaf_length])
    visible = (np.abs(places[:, :2]) <= half * places[:, 2:] + edge).all(axis=1)
    leaves = Leaves(places[visible], leaves.shapes[visible], leaves.colours[visible])
    look = replace(eyes.look, pixel_noise=eyes.look.pixel_noise / np.sqrt(looks))
    return render_stereo(camera, camera_frame(fruit, eye, looking), diameters, leaves, look, rng)


def read_picture(eyes: Eyes, pair: StereoPair) -> Array:
    """Positions of the fruit that the detector finds, camera frame, m, (k, 3)."""
    if eyes.detector == "circles":
        return stereo.locate_circles(eyes.camera, eyes.search, pair.left, pair.right)[0]
    return stereo.locate(eyes.camera, pair.left, pair.right)[0]


def located_fruit(
    pair: StereoPair, detections: Array, places: Array, diameters: ArrayLike
) -> tuple[Flags, Array, Array]:
    """Fruit that the detections of a picture locate.

    Args:
        pair: The images.
        detections: Positions of detections, camera frame, m, (k, 3).
        places: True fruit centres, camera frame, m, (n, 3).
        diameters: Fruit diameters, m, (n,).

    Returns:
        Flags of located fruit, (n,); positions, m, (n, 3); and positions of false detections, m, (m, 3). Positions are
        in the camera frame, and true ones where a fruit is not located.
    """
    located, positions = np.zeros(len(places), dtype=bool), places.copy()
    visible = np.flatnonzero(pair.visible > 0)
    if not len(visible):
        return located, positions, detections
    matched = stereo.match_detections(detections, places[visible], SAME * float(np.max(diameters)))
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
    """Sight of fruit from a viewpoint.

    Args:
        eyes: Model of how fruit is seen.
        view: The viewpoint.
        fruit: True fruit centres in the frame of the viewpoint, m, (n, 3).
        diameters: Fruit diameters, m, (n,).
        rng: Source of every random number that is not given.
        leaves: Leaves of a rendered picture, in the frame of the viewpoint.
        chances: Random numbers that decide where errors are measured ones, (n, 5); drawn by default.
        looks: Number of pictures that are averaged.
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
    """False detections, camera frame, m, (m, 3): anywhere in the image, as far away as the canopy."""
    camera, canopy = eyes.camera, eyes.canopy
    count = int(rng.poisson(mean_count))
    depth = canopy.standoff + canopy.depth * rng.random((count, 1))
    across = (rng.random((count, 2)) - 0.5) * np.array(camera.image) / camera.focal_length
    return np.concatenate([across * depth, depth], axis=-1)
