"""Fruit read from a stereo pair as Li et al. 2016 do (section 2.2): R − G, Otsu, morphology, centroids, disparity.

Two erosions with a 3 × 3 square remove specks, regions under a fifth of the largest go, two dilations restore the
rest; the centroids' disparity gives depth. Clusters are not told apart: touching fruit is one region, as in the
paper. Units: m, px. Needs scikit-image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.errors import InputError
from pickenv.extras import require
from pickenv.orchard.checks import Array, Flags, Integers
from pickenv.orchard.detections import Detections
from pickenv.orchard.stereo import StereoCamera, triangulate

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
