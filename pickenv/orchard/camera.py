"""An error model of cameras: the positions of fruit as a stereo or RGB-D camera measures them.

Along the line of sight, the error has a bias, which depends on distance d and light. It also has noise with the
standard deviation σ_z = sqrt(floor² + (a d²)²). A stereo camera with focal length f_px and baseline b has
a = σ_disparity/(f_px b). Across the line of sight, the standard deviation is pixel noise × d/f_px. The measured
centroid of a partly hidden fruit is shifted to the visible side, by up to the fruit's radius. A fruit is missed more
often if less of it is visible. Units: m, px, lx.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import LX, NUMBER, PX, REQUIRED, SHARE, WHOLE_PX, InputError, Unit, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Flags

DRAWS = 5  # normal numbers per measurement: three of noise, two for the side from which leaves hide the fruit


@toml_table
class Camera(checks.Preset):
    """The parameters of a camera's error model.

    Attributes:
        name: Name of the preset.
        source: Source of its numbers.
        focal_length: Focal length, px.
        image: Width and height of the image, px.
        nearest: Least distance at which fruit is detected, m.
        farthest: Largest distance at which fruit is detected, m.
        depth_noise: Standard deviation of depth divided by the square of distance, 1/m.
        pixel_noise: Standard deviation of a centroid in the image, px per axis.
        depth_noise_floor: Part of the depth noise that does not depend on distance, m.
        noise_light: Illuminance at which ``depth_noise`` and ``depth_noise_floor`` are valid, lx.
        noise_growth: Growth of depth noise with illuminance, 1/lx: factor exp(noise_growth × (light − noise_light)).
        bias: Mean error along the line of sight at ``bias_distance`` and ``bias_light``, m. If positive, the measured
            distance is too large.
        bias_distance: Distance at which ``bias`` is valid, m.
        bias_light: Illuminance at which ``bias`` is valid, lx.
        bias_per_distance: Change of the bias with distance, m/m.
        bias_per_light: Change of the bias with illuminance, m/lx.
        dropout: Probability of missing a fruit in full view.
        lost_below: Visible share of a fruit below which it is never detected.
        found_above: Least visible share at which the probability of missing a fruit is only ``dropout``. Between
            ``lost_below`` and ``found_above`` the probability of detection is linear in the visible share.
        occlusion_pull: Largest shift of the centroid to the visible side, as a share of the fruit's radius.
        light: Illuminance in which the camera is used, lx.
    """

    name: str
    source: str
    focal_length: Annotated[float, PX.positive]
    image: Annotated[tuple[int, int], WHOLE_PX.at_least(1)]
    nearest: Annotated[float, MM.positive]
    farthest: Annotated[float, MM]
    depth_noise: Annotated[float, Unit("mm_at_1m", 1e-3).not_negative]
    pixel_noise: Annotated[float, PX.not_negative]
    depth_noise_floor: Annotated[float, MM.not_negative] = 0.0
    noise_light: Annotated[float, LX.not_negative] = 0.0
    noise_growth: Annotated[float, Unit("per_lx")] = 0.0
    bias: Annotated[float, MM, REQUIRED] = 0.0
    bias_distance: Annotated[float, MM] = 0.0
    bias_light: Annotated[float, LX] = 0.0
    bias_per_distance: Annotated[float, NUMBER] = 0.0
    bias_per_light: Annotated[float, NUMBER] = 0.0
    dropout: Annotated[float, SHARE, REQUIRED] = 0.0
    lost_below: Annotated[float, SHARE, REQUIRED] = 0.0
    found_above: Annotated[float, SHARE, REQUIRED] = 0.0
    occlusion_pull: Annotated[float, SHARE, REQUIRED] = 0.0
    light: Annotated[float, LX.not_negative] = 100_000.0

    def __post_init__(self) -> None:
        name = f"camera '{self.name}'"
        super().__post_init__()
        checks.measuring_range(name, self.nearest, self.farthest)
        if self.found_above < self.lost_below:
            raise InputError(
                f"found_above of {name} is {self.found_above}; give lost_below, {self.lost_below}, or more"
            )


load_camera = preset_files.loader("camera", Camera)
"""Read a camera by its name, one of `shipped("camera")`, or from a TOML file by its path."""


def depth_noise(camera: Camera, distance: ArrayLike) -> Array:
    """Return the standard deviation of the error along the line of sight, m, at distances, m, of any shape."""
    law = np.hypot(camera.depth_noise_floor, camera.depth_noise * np.asarray(distance, dtype=float) ** 2)
    return np.asarray(law * np.exp(camera.noise_growth * (camera.light - camera.noise_light)))


def depth_bias(camera: Camera, distance: ArrayLike) -> Array:
    """Return the mean error of the measured distance along the line of sight, m, at true distances, m, of any shape."""
    beyond = np.asarray(distance, dtype=float) - camera.bias_distance
    brighter = camera.light - camera.bias_light
    return np.asarray(camera.bias + camera.bias_per_distance * beyond + camera.bias_per_light * brighter)


def detection_probability(camera: Camera, distance: ArrayLike, visible: ArrayLike = 1.0) -> Array:
    """Return the probability that a fruit inside the image is detected; 0 outside the camera's range of distances.

    Args:
        camera: Error model.
        distance: Distance of the fruit, m. The shapes of the arguments broadcast.
        visible: Visible share of the fruit, 0 to 1.
    """
    distance, visible = np.asarray(distance, dtype=float), checks.numbers("the visible share", visible, lowest=0.0)
    ramp = np.clip((visible - camera.lost_below) / max(camera.found_above - camera.lost_below, 1e-12), 0.0, 1.0)
    probability = np.where(visible >= camera.found_above, 1.0, ramp) * (1.0 - camera.dropout)
    return np.asarray(np.where((distance >= camera.nearest) & (distance <= camera.farthest), probability, 0.0))


def measured_positions(
    camera: Camera,
    positions: ArrayLike,
    viewpoint: ArrayLike,
    draws: ArrayLike,
    *,
    visible: ArrayLike = 1.0,
    diameters: ArrayLike = 0.0,
    visible_side: ArrayLike | None = None,
) -> Array:
    """Return the positions that the camera measures for detected fruit, with bias, noise and shift by occlusion.

    Args:
        camera: Error model.
        positions: True fruit centres, m, shape (..., 3), in any frame with z up.
        viewpoint: Camera positions in that frame, m, shape (..., 3).
        draws: Standard normal random numbers that decide the errors, shape (..., 5).
        visible: Visible share of each fruit, 0 to 1, shape (...).
        diameters: Fruit diameters, m, shape (...). The shift of partly hidden fruit is proportional to them.
        visible_side: Directions from each centre to the visible part, shape (..., 3). For zero vectors the direction is
            random, because leaves may hide any side. None means zero vectors for all fruit.

    Returns:
        Measured positions, m, shape (..., 3).

    Raises:
        InputError: If a number is not finite, a shape is wrong, or a fruit lies at the viewpoint.
    """
    positions, viewpoint = checks.points("fruit positions", positions), checks.points("the viewpoint", viewpoint)
    draws = checks.numbers("the random draws", draws)
    if draws.ndim == 0 or draws.shape[-1] != DRAWS:
        raise InputError(f"a measurement takes {DRAWS} random draws, not shape {draws.shape}")
    sight = positions - viewpoint
    distance = np.sqrt(np.einsum("...i,...i->...", sight, sight))
    if (distance == 0).any():
        raise InputError("a fruit lies at the viewpoint; move the camera away")
    ray = sight / distance[..., None]
    right, up = _across(ray)
    lateral = camera.pixel_noise * distance / camera.focal_length
    along = depth_bias(camera, distance) + depth_noise(camera, distance) * draws[..., 2]
    hidden = 1.0 - np.clip(checks.numbers("the visible share", visible), 0.0, 1.0)
    pull = camera.occlusion_pull * hidden * checks.numbers("fruit diameters", diameters, lowest=0.0) / 2
    chance = pull / np.maximum(np.hypot(draws[..., 3], draws[..., 4]), 1e-300)  # of a random side
    side = checks.points("the visible side", np.zeros(3) if visible_side is None else visible_side)
    length = np.sqrt(np.einsum("...i,...i->...", side, side))
    has_side = length > 1e-9
    sideways = side * np.where(has_side, pull / np.where(has_side, length, 1.0), 0.0)[..., None]
    chance = np.where(has_side, 0.0, chance)
    across = (lateral * draws[..., 0] + chance * draws[..., 3])[..., None] * right
    upwards = (lateral * draws[..., 1] + chance * draws[..., 4])[..., None] * up
    return np.asarray(positions + along[..., None] * ray + across + upwards + sideways)


def in_image(camera: Camera, positions: ArrayLike, viewpoint: ArrayLike, looking: ArrayLike) -> Flags:
    """Return flags (...): whether positions lie inside the image of a level camera.

    Args:
        camera: Error model, which has the image size and the focal length.
        positions: Positions in the orchard frame, m, (..., 3).
        viewpoint: Position of the camera in the orchard frame, m, (..., 3).
        looking: Direction of view in the orchard frame, (..., 3).
    """
    local = camera_frame(positions, viewpoint, looking)
    half = np.array(camera.image) / 2 / camera.focal_length
    return np.asarray((local[..., 2] > 0) & (np.abs(local[..., :2]) <= half * local[..., 2:]).all(axis=-1))


def camera_axes(looking: ArrayLike) -> Array:
    """Return the axes of a level camera as rows: x right, y down, z ahead, shape (..., 3, 3).

    Args:
        looking: Direction of view, (..., 3), in a frame with z up; the axes are given in that frame.
    """
    ahead = checks.directions("the direction in which the camera looks", looking)
    right, up = _across(ahead)
    return np.stack([right, -up, ahead], axis=-2)


def camera_frame(positions: ArrayLike, viewpoint: ArrayLike, looking: ArrayLike) -> Array:
    """Transform positions (..., 3), m, from the orchard frame to the camera's frame: x right, y down, z ahead.

    Args:
        positions: Positions in the orchard frame, m, (..., 3).
        viewpoint: Position of the camera in the orchard frame, m, (..., 3).
        looking: Direction of view of the level camera in the orchard frame, (..., 3).
    """
    offset = checks.points("positions", positions) - checks.points("the viewpoint", viewpoint)
    return np.asarray(np.einsum("...ij,...j->...i", camera_axes(looking), offset))


def orchard_frame(positions: ArrayLike, viewpoint: ArrayLike, looking: ArrayLike) -> Array:
    """Transform positions (..., 3), m, from the camera's frame to the orchard frame; the inverse of `camera_frame`.

    Args:
        positions: Positions in the camera's frame, m, (..., 3).
        viewpoint: Position of the camera in the orchard frame, m, (..., 3).
        looking: Direction of view of the level camera in the orchard frame, (..., 3).
    """
    local, eye = checks.points("positions", positions), checks.points("the viewpoint", viewpoint)
    return np.asarray(np.einsum("...ji,...j->...i", camera_axes(looking), local) + eye)


def _across(ray: Array) -> tuple[Array, Array]:
    """Return two unit vectors perpendicular to each line of sight, (..., 3) each: level to the right, and up.

    ``ray`` has the unit vectors (..., 3) from the camera along the lines of sight, in a frame with z up.
    """
    x, y, z = ray[..., 0], ray[..., 1], ray[..., 2]
    level = np.sqrt(x**2 + y**2)
    upright = level < 1e-9  # looking straight up or down there is no level direction to the right: take the row's
    a, b = (np.where(upright, default, part / np.where(upright, 1.0, level)) for default, part in ((1.0, y), (0.0, -x)))
    return np.stack([a, b, np.zeros_like(z)], axis=-1), np.stack([b * z, -a * z, a * y - b * x], axis=-1)
