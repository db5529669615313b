"""Fruit read from a stereo pair as Li et al. 2016 do (section 2.2): R − G, Otsu, morphology, centroids, disparity.

Two erosions with a 3 × 3 square remove specks, regions under a fifth of the largest go, two dilations restore the
rest; the centroids' disparity gives depth. Clusters are not told apart: touching fruit is one region, as in the
paper. Units: m, px. Needs scikit-image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import PX, SHARE, WHOLE, WHOLE_PX, InputError, require, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Flags, Integers

# What any camera, modelled or rendered, tells the arm: where fruit is believed to be, and with what confidence.
# Units: m.


@dataclass(frozen=True, eq=False)
class Detections:
    """Fruit as a camera reports it.

    Attributes:
        positions: Believed fruit centres, m, shape (m, 3), in the frame in which the true fruit was given.
        fruit: Index of the true fruit behind each detection, -1 where there is none or it is not known, shape (m,).
        confidence: From 0 to 1, shape (m,).
    """

    positions: Array
    fruit: Integers
    confidence: Array

    def __post_init__(self) -> None:
        if self.positions.ndim != 2 or self.positions.shape[-1] != 3:
            raise InputError(f"detected positions must have shape (m, 3), not {self.positions.shape}")
        for name in ("fruit", "confidence"):
            if getattr(self, name).shape != (len(self.positions),):
                raise InputError(f"there are {len(self.positions)} detections but {name} has another length")

    def __len__(self) -> int:
        return len(self.positions)


def match_detections(detections: Detections, positions: ArrayLike, within: float) -> Detections:
    """Name the true fruit behind each detection: one to one, least total distance, none farther than ``within`` m.

    Args:
        detections: What a camera reported; its fruit indices are ignored.
        positions: True fruit centres, m, shape (n, 3), in the same frame.
        within: Largest distance at which a detection counts as this fruit, m.
    """
    from scipy.optimize import linear_sum_assignment

    checks.positive("the matching distance (m)", within)
    truth = checks.points("true fruit positions", positions).reshape(-1, 3)
    distance = np.linalg.norm(detections.positions[:, None] - truth[None], axis=-1)
    seen, fruit = linear_sum_assignment(np.minimum(distance, 2 * within * max(len(detections), len(truth), 1)))
    near = distance[seen, fruit] <= within
    index = np.full(len(detections), -1, dtype=np.int64)
    index[seen[near]] = fruit[near]
    return replace(detections, fruit=index)


# A stereo pair of pinhole cameras and the steps by which fruit is read from its pictures. Camera frame: x right, y
# down, z ahead, origin at the left camera; the right camera is a base line further along x. Units: m, px.


@toml_table
class StereoCamera:
    """Two parallel cameras.

    Attributes:
        name: Name of the preset.
        source: Where its numbers come from.
        focal_length: px.
        baseline: m.
        image: Width and height, px.
        nearest: Least distance that is matched, m.
        farthest: Largest distance that is matched, m.
        erosions: Erosions of 3 × 3 after the threshold.
        dilations: Dilations of 3 × 3 at the end.
        least_area_share: Regions below this share of the largest are noise.
        least_correlation: Correlation from which a match counts.
        margin: Surroundings that the matched patch takes along, px: edges carry the match.
    """

    name: str
    source: str
    focal_length: Annotated[float, PX.positive]
    baseline: Annotated[float, MM.positive]
    image: Annotated[tuple[int, int], WHOLE_PX.at_least(16)]
    nearest: Annotated[float, MM.positive]
    farthest: Annotated[float, MM]
    erosions: Annotated[int, WHOLE.not_negative]
    dilations: Annotated[int, WHOLE.not_negative]
    least_area_share: Annotated[float, SHARE]
    least_correlation: Annotated[float, SHARE]
    margin: Annotated[int, WHOLE_PX.not_negative] = 3

    def __post_init__(self) -> None:
        name = f"of stereo camera '{self.name}'"
        checks.bounded(name[3:], self)
        checks.measuring_range(name[3:], self.nearest, self.farthest)
        if self.focal_length * self.baseline / self.nearest >= self.image[0]:
            raise InputError(f"at its least distance the disparity {name} is wider than its image; raise nearest")


def load_stereo_camera(name: str | Path) -> StereoCamera:
    """Read a stereo camera by name (`shipped("vision")`) or from a path to a TOML file."""
    return preset_files.load("vision", name, StereoCamera)


def project(camera: StereoCamera, positions: ArrayLike) -> Array:
    """Column and row in the left image and disparity, px, shape (..., 3), of positions in the camera frame (..., 3)."""
    x, y, z = np.moveaxis(checks.points("positions in the camera frame", positions), -1, 0)
    if (z <= 0).any():
        raise InputError("a position lies behind the camera; positions in the camera frame need z above zero")
    column = camera.image[0] / 2 - 0.5 + camera.focal_length * x / z
    row = camera.image[1] / 2 - 0.5 + camera.focal_length * y / z
    return np.stack([column, row, camera.focal_length * camera.baseline / z], axis=-1)


def triangulate(camera: StereoCamera, pixels: ArrayLike) -> Array:
    """Positions in the camera frame, m, from column, row and disparity, (..., 3): inverse of `project`."""
    column, row, disparity = np.moveaxis(checks.points("pixels", pixels), -1, 0)
    if (disparity <= 0).any():
        raise InputError("a disparity is not above zero; such a point is at infinity")
    z = camera.focal_length * camera.baseline / disparity
    x = (column - camera.image[0] / 2 + 0.5) * z / camera.focal_length
    y = (row - camera.image[1] / 2 + 0.5) * z / camera.focal_length
    return np.stack([x, y, z], axis=-1)


SQUARE = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True, eq=False)
class Regions:
    """Fruit regions of one image.

    Attributes:
        centroids: Column and row, px, shape (m, 2).
        areas: px, shape (m,).
        boxes: First row, first column, end row, end column, shape (m, 4).
        mask: Pixels taken for fruit, shape (height, width).
    """

    centroids: Array
    areas: Integers
    boxes: Integers
    mask: Flags


def red_minus_green(image: ArrayLike) -> Array:
    """Colour difference R − G of an image (height, width, 3), −255 to 255."""
    pixels = np.asarray(image)
    if pixels.ndim != 3 or pixels.shape[-1] != 3 or pixels.dtype != np.uint8:
        raise InputError(f"an image must be uint8 of shape (height, width, 3), not {pixels.dtype} of {pixels.shape}")
    return np.asarray(pixels[..., 0].astype(np.float64) - pixels[..., 1])


def fruit_threshold(difference: Array) -> float:
    """Otsu's threshold of R − G, never below zero; above all of it where it is the same everywhere."""
    require("skimage")
    from skimage.filters import threshold_otsu

    if difference.min() == difference.max():
        return float("inf")
    return max(float(threshold_otsu(difference)), 0.0)  # type: ignore[no-untyped-call]


def fruit_mask(camera: StereoCamera, image: ArrayLike) -> Flags:
    """Pixels taken for fruit, shape (height, width): Otsu's threshold of R − G, never below zero, then morphology."""
    require("skimage")
    from skimage.measure import label
    from skimage.morphology import dilation, erosion

    difference = red_minus_green(image)
    mask = difference > fruit_threshold(difference)
    if not mask.any():
        return np.asarray(mask, dtype=bool)
    for _ in range(camera.erosions):
        mask = erosion(mask, SQUARE)
    regions = np.asarray(label(mask, connectivity=2))  # type: ignore[no-untyped-call]
    areas = np.bincount(regions.ravel())
    areas[0] = 0
    mask = (areas >= max(camera.least_area_share * areas.max(), 1.0))[regions]
    for _ in range(camera.dilations):
        mask = dilation(mask, SQUARE)
    return np.asarray(mask, dtype=bool)


def fruit_regions(camera: StereoCamera, image: ArrayLike) -> Regions:
    """Regions of fruit in one image: centroids, areas, boxes."""
    require("skimage")
    from skimage.measure import label, regionprops

    mask = fruit_mask(camera, image)
    found = regionprops(label(mask, connectivity=2))  # type: ignore[no-untyped-call]
    return Regions(
        centroids=np.array([region.centroid[::-1] for region in found], dtype=float).reshape(-1, 2),
        areas=np.array([region.area for region in found], dtype=np.int64),
        boxes=np.array([region.bbox for region in found], dtype=np.int64).reshape(-1, 4),
        mask=mask,
    )


def matched_sizes(camera: StereoCamera, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> None:
    """Refuse a pair of images that are not of the camera's size."""
    width, height = camera.image
    for side, image in (("left", left), ("right", right)):
        if np.shape(image)[:2] != (height, width):
            raise InputError(
                f"the {side} image has shape {np.shape(image)}, not that of the camera, {(height, width, 3)}"
            )


def locate(camera: StereoCamera, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Detections:
    """Fruit in the camera frame from a stereo pair.

    Args:
        camera: The stereo pair.
        left: Left image, uint8, shape (height, width, 3).
        right: Right image, likewise.

    Returns:
        One detection per region that finds its match in the right image; its confidence is the match's correlation,
        and which true fruit it is, is not known (-1).

    Raises:
        InputError: If the images are not of the camera's size or are not colour images.
    """
    matched_sizes(camera, left, right)
    regions, first, second = fruit_regions(camera, left), red_minus_green(left), red_minus_green(right)
    found = [
        (*centroid, *_disparity(camera, first, second, box))
        for centroid, box in zip(regions.centroids, regions.boxes, strict=True)
    ]
    pixels = np.array(found, dtype=float).reshape(-1, 4)
    pixels = pixels[pixels[:, 3] >= camera.least_correlation]
    positions = triangulate(camera, pixels[:, :3]) if len(pixels) else np.zeros((0, 3))
    return Detections(positions, np.full(len(pixels), -1, dtype=np.int64), np.clip(pixels[:, 3], 0.0, 1.0))


def _disparity(camera: StereoCamera, first: Array, second: Array, box: Integers) -> tuple[float, float]:
    """Disparity in px, to a fraction by a parabola through the peak, and correlation of the patch around a region."""
    require("skimage")
    from skimage.feature import match_template

    width, height = camera.image
    top, bottom = max(int(box[0]) - camera.margin, 0), min(int(box[2]) + camera.margin, height)
    start, end = max(int(box[1]) - camera.margin, 0), min(int(box[3]) + camera.margin, width)
    reach = camera.focal_length * camera.baseline
    low = max(start - int(np.ceil(reach / camera.nearest)), 0)
    high = end - int(reach / camera.farthest)
    if high - low < end - start:
        return 1.0, -1.0  # the match would lie outside the right image
    strip, patch = second[top:bottom, low:high], first[top:bottom, start:end]
    score = np.asarray(match_template(strip, patch))[0]  # type: ignore[no-untyped-call]
    peak = int(np.argmax(score))
    shift = 0.0
    if 0 < peak < len(score) - 1:
        before, at, after = score[peak - 1 : peak + 2]  # the first of the largest: what is before is smaller
        shift = 0.5 * (before - after) / (before - 2 * at + after)
    return float(start - low - peak - shift), float(score[peak])
