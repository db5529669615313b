"""A stereo pair of pinhole cameras and the steps by which fruit is read from its pictures.

Camera frame: x right, y down, z ahead, origin at the left camera; the right camera is a base line further along x.
Units: m, px.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.errors import InputError
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array
from pickenv.toml_tables import PX, SHARE, WHOLE, WHOLE_PX, toml_table


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
