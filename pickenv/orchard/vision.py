"""Detectors of fruit in stereo images: by regions as in Li et al. 2016 (section 2.2), or by circles.

Li's detector applies Otsu's threshold to the colour difference R − G. Two erosions with a 3 × 3 square then remove
specks. Regions smaller than a fifth of the largest are dropped, and two dilations restore the size of the others. The
disparity of a region's centroid gives depth. Touching fruit form one region, as in the paper.

The other detector finds circles: the visible part of a rim is sufficient to find the centre of a fruit behind leaves.
The gradient of R − G points into the fruit, so every edge pixel votes for centres along its gradient (a Hough transform
with gradient directions). Each circle is then fitted to sub-pixel edges. Only pixels of fruit colour, and a border
around them, are matched in the right image. Touching fruit give several circles. Units: m, px. Needs scikit-image.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import NUMBER, PX, SHARE, WHOLE, WHOLE_PX, InputError, require, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Flags, Integers


def match_detections(detections: ArrayLike, positions: ArrayLike, within: float) -> Integers:
    """Match detections to true fruit one to one, with the least total distance.

    Args:
        detections: Positions of detections, m, shape (m, 3).
        positions: True fruit centres in the same frame, m, shape (n, 3).
        within: Largest distance between a detection and its fruit, m.

    Returns:
        Index in ``positions`` (from 0) of the fruit of each detection, shape (m,); -1 for a false detection.

    Raises:
        InputError: If a number is not finite, the distance is not above zero, or a shape is wrong.
    """
    from scipy.optimize import linear_sum_assignment

    checks.numbers("the matching distance (m)", within, positive=True)
    seen = checks.points("detected positions", detections).reshape(-1, 3)
    truth = checks.points("true fruit positions", positions).reshape(-1, 3)
    distance = np.linalg.norm(seen[:, None] - truth[None], axis=-1)
    rows, fruit = linear_sum_assignment(np.minimum(distance, 2 * within * max(len(seen), len(truth), 1)))
    near = distance[rows, fruit] <= within
    index = np.full(len(seen), -1, dtype=np.int64)
    index[rows[near]] = fruit[near]
    return index


# A stereo pair of pinhole cameras and the steps by which fruit is read from its pictures. Camera frame: x right, y
# down, z ahead, origin at the left camera; the right camera is a base line further along x. Units: m, px.


@toml_table
class StereoCamera(checks.Preset):
    """A stereo pair of two parallel pinhole cameras, and the parameters of Li's detector.

    Attributes:
        name: Name of the preset.
        source: Source of its numbers.
        focal_length: Focal length, px.
        baseline: Distance between the cameras, m.
        image: Width and height of an image, px.
        nearest: Least distance at which fruit is searched for in the right image, m.
        farthest: Largest distance at which fruit is searched for in the right image, m.
        erosions: Number of erosions with a 3 × 3 square after the threshold.
        dilations: Number of dilations with a 3 × 3 square at the end.
        least_area_share: Share of the largest region's area below which a region is dropped as noise.
        least_correlation: Least correlation of a valid match; for the circle detector, its least agreement.
        margin: Width of the border that is added to a region when it is matched, px. The match relies on edges.
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
        name = f"stereo camera '{self.name}'"
        super().__post_init__()
        checks.measuring_range(name, self.nearest, self.farthest)
        if self.focal_length * self.baseline / self.nearest >= self.image[0]:
            raise InputError(f"at its least distance the disparity of {name} is wider than its image; raise nearest")


load_stereo_camera = preset_files.loader("vision", StereoCamera)
"""Read a stereo camera by its name, one of `shipped("vision")`, or from a TOML file by its path."""


def project(camera: StereoCamera, positions: ArrayLike) -> Array:
    """Project positions in the camera frame into the left image.

    Args:
        camera: The stereo pair.
        positions: Positions in the camera frame, m, (..., 3).

    Returns:
        Pixel column from the left, pixel row from the top (both from 0), and disparity, px, (..., 3).

    Raises:
        InputError: If a position lies behind the camera or is not finite.
    """
    x, y, z = np.moveaxis(checks.points("positions in the camera frame", positions), -1, 0)
    if (z <= 0).any():
        raise InputError("a position lies behind the camera; positions in the camera frame need z above zero")
    column = camera.image[0] / 2 - 0.5 + camera.focal_length * x / z
    row = camera.image[1] / 2 - 0.5 + camera.focal_length * y / z
    return np.stack([column, row, camera.focal_length * camera.baseline / z], axis=-1)


def triangulate(camera: StereoCamera, pixels: ArrayLike) -> Array:
    """Compute positions in the camera frame from pixels of the left image and disparities; the inverse of `project`.

    Args:
        camera: The stereo pair.
        pixels: Pixel column from the left, pixel row from the top (both from 0), and disparity, px, (..., 3).

    Returns:
        Positions in the camera frame, m, (..., 3).

    Raises:
        InputError: If a disparity is not above zero, or a number is not finite.
    """
    column, row, disparity = np.moveaxis(checks.points("pixels", pixels), -1, 0)
    if (disparity <= 0).any():
        raise InputError("a disparity is not above zero; such a point is at infinity")
    z = camera.focal_length * camera.baseline / disparity
    x = (column - camera.image[0] / 2 + 0.5) * z / camera.focal_length
    y = (row - camera.image[1] / 2 + 0.5) * z / camera.focal_length
    return np.stack([x, y, z], axis=-1)


SQUARE = np.ones((3, 3), dtype=bool)


def red_minus_green(image: ArrayLike) -> Array:
    """Return the colour difference R − G, from −255 to 255, (height, width), of an image (height, width, 3).

    Raises:
        InputError: If the image is not uint8 of that shape.
    """
    pixels = np.asarray(image)
    if pixels.ndim != 3 or pixels.shape[-1] != 3 or pixels.dtype != np.uint8:
        raise InputError(f"an image must be uint8 of shape (height, width, 3), not {pixels.dtype} of {pixels.shape}")
    return np.asarray(pixels[..., 0].astype(np.float64) - pixels[..., 1])


def fruit_threshold(difference: Array) -> float:
    """Return Otsu's threshold of the colour difference R − G, at least zero; infinity if R − G is constant."""
    require("skimage")
    from skimage.filters import threshold_otsu

    flat = difference.min() == difference.max()
    return float("inf") if flat else max(float(threshold_otsu(difference)), 0.0)  # type: ignore[no-untyped-call]


def fruit_mask(camera: StereoCamera, image: ArrayLike) -> Flags:
    """Return a mask of the fruit's pixels, (height, width), by `fruit_threshold` and Li's erosions and dilations.

    Args:
        camera: The stereo pair, which has the detector's parameters.
        image: Image, uint8, (height, width, 3).
    """
    require("skimage")
    from skimage.measure import label
    from skimage.morphology import dilation, erosion

    difference = red_minus_green(image)
    mask = difference > fruit_threshold(difference)
    for _ in range(camera.erosions):
        mask = erosion(mask, SQUARE)
    regions = np.asarray(label(mask, connectivity=2))  # type: ignore[no-untyped-call]
    areas = np.bincount(regions.ravel())
    areas[0] = 0
    mask = (areas >= max(camera.least_area_share * areas.max(), 1.0))[regions]
    for _ in range(camera.dilations):
        mask = dilation(mask, SQUARE)
    return np.asarray(mask, dtype=bool)


def fruit_regions(camera: StereoCamera, image: ArrayLike) -> tuple[Array, Integers]:
    """Find the connected regions of the fruit pixels, which `fruit_mask` marks.

    Args:
        camera: The stereo pair, which has the detector's parameters.
        image: Image, uint8, (height, width, 3).

    Returns:
        Two arrays. The first has the regions' centroids, pixel column and pixel row, (m, 2). The second has their
        bounding boxes, px, (m, 4): first row, first column, the row after the last, and the column after the last. Rows
        and columns count from 0.
    """
    require("skimage")
    from skimage.measure import label, regionprops

    regions = regionprops(label(fruit_mask(camera, image), connectivity=2))  # type: ignore[no-untyped-call]
    centroids = np.array([region.centroid[::-1] for region in regions], dtype=float).reshape(-1, 2)
    return centroids, np.array([region.bbox for region in regions], dtype=np.int64).reshape(-1, 4)


def matched_sizes(camera: StereoCamera, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> None:
    """Check that both images have the camera's size.

    Raises:
        InputError: If an image has another size.
    """
    width, height = camera.image
    for side, image in (("left", left), ("right", right)):
        if np.shape(image)[:2] != (height, width):
            raise InputError(
                f"the {side} image has shape {np.shape(image)}, not that of the camera, {(height, width, 3)}"
            )


def locate(camera: StereoCamera, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[Array, Array]:
    """Locate fruit in a pair of images by Li's detector.

    Args:
        camera: The stereo pair.
        left: Left image, uint8, shape (height, width, 3).
        right: Right image, uint8, shape (height, width, 3).

    Returns:
        Two arrays, for the regions with a valid match in the right image: positions in the camera frame, m, (m, 3), and
        correlations of the matches, (m,).

    Raises:
        InputError: If the images are not of the camera's size or are not colour images.
    """
    matched_sizes(camera, left, right)
    regions, first, second = fruit_regions(camera, left), red_minus_green(left), red_minus_green(right)
    matches = [(*centroid, *_disparity(camera, first, second, box)) for centroid, box in zip(*regions, strict=True)]
    return _detections(camera, matches)


def _detections(camera: StereoCamera, matches: Sequence[tuple[float, ...]]) -> tuple[Array, Array]:
    """Return positions in the camera frame, m, (m, 3), and agreements (m,) of the matches that agree well enough.

    Args:
        camera: The stereo pair, whose ``least_correlation`` is the least agreement.
        matches: For each match the pixel column and row in the left image, the disparity, px, and the agreement.
    """
    pixels = np.array(matches, dtype=float).reshape(-1, 4)
    pixels = pixels[pixels[:, 3] >= camera.least_correlation]
    return triangulate(camera, pixels[:, :3]), np.minimum(pixels[:, 3], 1.0)


def _disparity(camera: StereoCamera, first: Array, second: Array, box: Integers) -> tuple[float, float]:
    """Return the disparity of the patch around a region, px, and the correlation of its match, -1 without a match.

    A parabola through three correlations refines the disparity.

    Args:
        camera: The stereo pair.
        first: R − G of the left image, (height, width).
        second: R − G of the right image, (height, width).
        box: The region's bounding box in the left image, as in `fruit_regions`.
    """
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
    shift = float(summit(*score[peak - 1 : peak + 2])) if 0 < peak < len(score) - 1 else 0.0
    return float(start - low - peak - shift), float(score[peak])


STEP, SPREAD = 2, 1.5  # of the radii that are voted for, and of a vote around its pixel
ROUNDS, SETTLED = 6, 1e-3  # of a circle's fit
APART = 0.8  # centres nearer than this, in radii, are one fruit
AHEAD = 0.8  # cosine of the angle within which an edge's slope has to point to the centre
LEAST_EDGES = 8
LEANING = 3.0  # weight of the voted radius, in edge pixels


@toml_table
class CircleSearch(checks.Preset):
    """Parameters of the circle detector; see circles.toml.

    Attributes:
        smallest: Least radius, px.
        largest: Largest radius, px.
        blur: Standard deviation of the Gaussian filter for gradients, px.
        least_arc: Least visible share of a circle's rim.
        least_fruit: Least share of a disc that has the colour of fruit.
        rim: Largest distance from a circle at which an edge belongs to its rim, px.
        tight: Distance from a circle at which the weight of an edge in the fit is half, px.
        surroundings: Width of the border that is added to a disc when it is matched, px.
        contrast: Limit of the colour difference between matched pixels, grey levels. Larger differences come from an
            obstacle in one image and are clipped to this limit.
        source: Source of its numbers.
    """

    smallest: Annotated[int, WHOLE_PX.at_least(3)]
    largest: Annotated[int, WHOLE_PX.at_least(3)]
    blur: Annotated[float, PX.positive]
    least_arc: Annotated[float, SHARE]
    least_fruit: Annotated[float, SHARE]
    rim: Annotated[float, PX.positive]
    tight: Annotated[float, PX.positive]
    surroundings: Annotated[int, WHOLE_PX.at_least(1)]
    contrast: Annotated[float, NUMBER.positive]
    source: str = ""


Edges = tuple[Array, Array]
"""Two arrays about k edges of an image. The first has their sub-pixel positions, column and row, px, (k, 2). The second
has the unit gradients of R − G there, (k, 2)."""


load_circle_search = preset_files.loader("circles", CircleSearch)
"""Read a `CircleSearch` by its name, one of `shipped("circles")`, or from a TOML file by its path."""


def fruit_circles(search: CircleSearch, image: ArrayLike) -> tuple[Array, Flags]:
    """Find the circles of fruit in one image.

    Args:
        search: Parameters of the circle detector.
        image: Image, uint8, (height, width, 3).

    Returns:
        Two arrays. The first has each circle's column and row of the centre, and radius, px, (m, 3). The circle with
        the most complete rim comes first. The second is a mask of the pixels of fruit colour, (height, width).
    """
    from scipy import ndimage

    difference = red_minus_green(image)
    mask = np.asarray(ndimage.gaussian_filter(difference, search.blur) > fruit_threshold(difference))
    edges = _edges(search, difference, mask)
    circles: list[tuple[float, float, float]] = []
    for column, row, radius in _voted(search, edges, (mask.shape[0], mask.shape[1])):
        if _taken(circles, column, row, radius):
            continue
        circle = _fitted(search, edges, column, row, radius)
        sound = search.smallest - STEP < circle[2] < search.largest + STEP and not _taken(circles, *circle)
        if sound and _filled(mask, *circle) >= search.least_fruit:
            circles.append(circle)
    return np.array(circles, dtype=float).reshape(-1, 3), mask


def _edges(search: CircleSearch, difference: Array, mask: Flags) -> Edges:
    """Return the sub-pixel edges near the rim of the mask, where the slope of R − G is steepest.

    ``difference`` is R − G of the image, ``mask`` its pixels of fruit colour, (height, width) each.
    """
    from scipy import ndimage

    down, right = (ndimage.gaussian_filter(difference, search.blur, order) for order in ((1, 0), (0, 1)))
    steep = np.hypot(down, right)
    rim = ndimage.binary_dilation(mask) & ~ndimage.binary_erosion(mask, border_value=1) & (steep > 0)
    rows, columns = np.nonzero(rim)
    slopes = np.stack([right[rim], down[rim]], axis=-1) / steep[rim][:, None]
    offsets = np.arange(-2.5, 2.6, 0.5)
    along = [[rows + o * slopes[:, 1], columns + o * slopes[:, 0]] for o in offsets]
    height = np.stack([ndimage.map_coordinates(steep, at, order=1, mode="nearest") for at in along])
    top = np.clip(height.argmax(axis=0), 1, len(offsets) - 2)
    edges = np.arange(len(top))
    peak = offsets[top] + 0.5 * summit(height[top - 1, edges], height[top, edges], height[top + 1, edges])
    return np.stack([columns, rows], axis=-1) + peak[:, None] * slopes, slopes


def summit(before: ArrayLike, at: ArrayLike, after: ArrayLike) -> Array:
    """Return the position of the extremum of a parabola through three equidistant values, clipped to −1 to 1.

    The position is in steps from the middle value. It is 0 if the three values lie on a line.
    """
    before, at, after = (np.asarray(v, dtype=float) for v in (before, at, after))
    bend = before - 2 * at + after
    flat = np.abs(bend) < 1e-12
    return np.asarray(np.where(flat, 0.0, np.clip(0.5 * (before - after) / np.where(flat, 1.0, bend), -1.0, 1.0)))


def _voted(search: CircleSearch, edges: Edges, shape: tuple[int, int]) -> list[tuple[float, float, float]]:
    """Return column, row and radius, px, of circles whose visible share of the rim is at least ``search.least_arc``.

    The circle with the most complete rim comes first. ``shape`` is the height and width of the image, px.
    """
    from scipy import ndimage
    from skimage.feature import peak_local_max

    height, width = shape
    radii = np.arange(search.smallest, search.largest + 1, STEP)
    votes, (places, slopes) = np.zeros((len(radii), height, width)), edges
    for i, radius in enumerate(radii.tolist()):
        at = np.rint(places + radius * slopes).astype(np.int64)
        inside = ((at >= 0) & (at < [width, height])).all(axis=1)
        counts = np.bincount(at[inside, 1] * width + at[inside, 0], minlength=height * width)
        full = 2 * 2 * np.pi * radius / (2 * np.pi * SPREAD**2)  # the rim is two pixels wide
        votes[i] = ndimage.gaussian_filter(counts.reshape(height, width).astype(float), SPREAD) / full
    votes = ndimage.gaussian_filter1d(votes, 0.5, axis=0, mode="constant")
    most, best = votes.max(axis=0), votes.argmax(axis=0)
    peaks = peak_local_max(most, min_distance=3, threshold_abs=search.least_arc)  # type: ignore[no-untyped-call]
    return [(float(column), float(row), float(radii[best[row, column]])) for row, column in peaks.tolist()]


def _taken(circles: list[tuple[float, float, float]], column: float, row: float, radius: float) -> bool:
    return any(np.hypot(column - c, row - r) < APART * max(radius, size) for c, r, size in circles)


def _fitted(search: CircleSearch, edges: Edges, column: float, row: float, voted: float) -> tuple[float, float, float]:
    """Return column, row and radius, px, of a circle fitted to the edges near a circle that `_voted` returned.

    The fit is by weighted least squares, in which edges far from the circle have small weights.

    Args:
        search: Parameters of the circle detector.
        edges: Edges of the image.
        column: Column of the centre that `_voted` returned, px.
        row: Row of the centre that `_voted` returned, px.
        voted: Radius that `_voted` returned, px.
    """
    centre, radius = np.array([column, row]), voted
    near = np.hypot(*(edges[0] - centre).T) < voted + 2 * search.rim
    places, slopes = (part[near] for part in edges)
    for _ in range(ROUNDS):
        out = places - centre
        distance = np.hypot(*out.T)
        miss = distance - radius
        rim = (np.abs(miss) < search.rim) & (-(slopes * out).sum(axis=1) > AHEAD * distance)
        if rim.sum() < LEAST_EDGES:
            break
        slope = np.column_stack([out[rim] / distance[rim, None], np.ones(int(rim.sum()))])
        weighted = slope * (1.0 / (1.0 + (miss[rim] / search.tight) ** 2))[:, None]
        normal, side = weighted.T @ slope, weighted.T @ miss[rim]
        normal[2, 2] += LEANING
        side[2] += LEANING * (voted - radius)
        step = np.linalg.solve(normal + 1e-9 * np.eye(3), side)
        centre, radius = centre + step[:2], radius + float(step[2])
        if np.abs(step).max() < SETTLED:
            break
    return float(centre[0]), float(centre[1]), radius


def _window(shape: tuple[int, ...], column: float, row: float, reach: float) -> tuple[Integers, Integers, Array]:
    """Return row, column and distance from a point, px, of each pixel in the square around the point.

    Args:
        shape: Height and width of the image, px.
        column: Column of the point, px.
        row: Row of the point, px.
        reach: Half the edge of the square, px.
    """
    rows = np.arange(max(math.ceil(row - reach), 0), min(math.floor(row + reach) + 1, shape[0]))
    columns = np.arange(max(math.ceil(column - reach), 0), min(math.floor(column + reach) + 1, shape[1]))
    across, down = np.meshgrid(columns, rows)
    return down.astype(np.int64), across.astype(np.int64), np.hypot(across - column, down - row)


def _filled(mask: Flags, column: float, row: float, radius: float) -> float:
    down, across, distance = _window(mask.shape, column, row, radius)
    inside = mask[down, across][distance < radius]
    return float(inside.mean()) if inside.size else 0.0


def locate_circles(
    camera: StereoCamera, search: CircleSearch, left: NDArray[np.uint8], right: NDArray[np.uint8]
) -> tuple[Array, Array]:
    """Locate fruit in a pair of images by the circle detector.

    Args:
        camera: The stereo pair.
        search: Parameters of the circle detector.
        left: Left image, uint8, shape (height, width, 3).
        right: Right image, uint8, shape (height, width, 3).

    Returns:
        Two arrays, for the circles with a valid match in the right image: positions in the camera frame, m, (m, 3), and
        agreements of the matches, 0 to 1, (m,).

    Raises:
        InputError: If the images are not of the camera's size or are not colour images.
    """
    matched_sizes(camera, left, right)
    (circles, mask), first, second = fruit_circles(search, left), red_minus_green(left), red_minus_green(right)
    matches = [(*circle[:2], *_matched(camera, search, first, second, mask, circle)) for circle in circles.tolist()]
    return _detections(camera, matches)


def _matched(
    camera: StereoCamera, search: CircleSearch, first: Array, second: Array, mask: Flags, circle: Sequence[float]
) -> tuple[float, float]:
    """Return the disparity of a circle, px, and the agreement of its match, 0 to 1; -1 if there is no match.

    The agreement is 1 - mean((difference / contrast)^2) over the matched pixels. Each difference is clipped to the
    contrast.

    Args:
        camera: The stereo pair.
        search: Parameters of the circle detector, with the contrast.
        first: R − G of the left image, (height, width).
        second: R − G of the right image, (height, width).
        mask: Mask of the fruit pixels of the left image, (height, width).
        circle: Column and row of the centre in the left image, and radius, px.
    """
    from scipy import ndimage

    column, row, radius = circle
    down, across, distance = _window(mask.shape, column, row, radius + search.surroundings)
    fruit = mask[down, across] & (distance < radius)
    around = ndimage.binary_dilation(fruit, iterations=2) & (distance > radius - 1)
    patch = fruit | (around & (distance < radius + search.surroundings))
    rows, columns = down[patch], across[patch]
    reach = camera.focal_length * camera.baseline
    tried = np.arange(int(reach / camera.farthest), int(np.ceil(reach / camera.nearest)) + 1)
    tried = tried[tried <= (columns.min() if columns.size else -1)]
    if len(tried) < 3:
        return 1.0, -1.0  # the match would lie outside the right image
    apart = first[rows, columns] - second[rows, columns - tried[:, None]]
    cost = np.minimum(apart**2, search.contrast**2).mean(axis=1) / search.contrast**2
    best = int(np.argmin(cost))
    if not 0 < best < len(tried) - 1:
        return 1.0, -1.0
    return float(tried[best] + summit(*cost[best - 1 : best + 2])), 1.0 - float(cost[best])
