"""The contents of a picture (rods, balls, meshes, words and a viewpoint), which environments fill and drawers draw.

This module depends on no environment and on no drawing library. World frame, z up. Units: m; px only on the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array

Rgb = tuple[int, int, int]
Colours = NDArray[np.uint8]
Pixels = NDArray[np.uint8]

SIZE = (480, 360)
"""Default width and height of a picture, px."""
FIT = 1.06
CORNERS = ("top left", "top right", "bottom left", "bottom right")


@dataclass(frozen=True, eq=False)
class Rods:
    """Cylinders with round ends.

    Attributes:
        start: Centres of the first ends ``(N, 3)``, m.
        end: Centres of the second ends ``(N, 3)``, m.
        radius: Radius of each rod ``(N,)``, m.
        colour: Red, green, blue and opacity ``(N, 4)``, 0 to 255.
    """

    start: Array
    end: Array
    radius: Array
    colour: Colours


def spheres(centre: Array, radius: Array, colour: Colours) -> Rods:
    """Make balls, which are rods of zero length, with centres ``(N, 3)``, m, and radii ``(N,)``, m."""
    return Rods(centre, centre, radius, colour)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A set of triangles; corners that triangles share are shaded smoothly.

    Attributes:
        corners: Positions of the corners ``(V, 3)``, m.
        triangles: Indices (from 0) of each triangle's three entries in `corners` ``(T, 3)``.
        colour: Red, green, blue and opacity of each corner ``(V, 4)``, 0 to 255.
        normals: Normal at each corner ``(V, 3)``; empty ``(0, 3)`` until normals are computed.
    """

    corners: Array
    triangles: NDArray[np.intp]
    colour: Colours
    normals: Array = field(default_factory=lambda: np.empty((0, 3)))


@dataclass(frozen=True, eq=False)
class Words:
    """A line of text.

    Attributes:
        text: The words.
        place: Where the text stands: one of `CORNERS` of the picture, or a point ``(3,)`` in the world frame, m.
            Several lines in one corner are set below one another.
        colour: Colour of the text; None for the `ink` of the background.
        large: Whether the text is large, as for the subject of a picture.
    """

    text: str
    place: str | Array = "top left"
    colour: Rgb | None = None
    large: bool = False


@dataclass(frozen=True, eq=False)
class Dial:
    """A dial of the tool's misses, seen along the tool: marks of the tool, and a ring for the gripper's tolerance.

    Attributes:
        marks_mm: Misses across the tool, to the right and up on the dial ``(K, 2)``, mm, the present one last.
        tolerance_mm: Radius of the ring, mm.
        colour: Colour of the marks.
        label: Words above the dial.
    """

    marks_mm: Array
    tolerance_mm: float
    colour: Rgb
    label: str = ""


@dataclass(frozen=True, eq=False)
class Eye:
    """The viewpoint of a picture: a camera without distortion, whose image has z upwards.

    Attributes:
        position: Position of the camera ``(3,)``, m.
        target: Point that the camera looks at ``(3,)``, m.
        angle_deg: Vertical angle of view, degrees.
    """

    position: Array
    target: Array
    angle_deg: float = 30.0

    def axes(self) -> Array:
        """Return the camera's axes as rows ``(3, 3)``: to the right, up, and towards the target."""
        ahead = self.target - self.position
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, ahead), ahead])

    def project(self, points: ArrayLike, size: tuple[int, int]) -> Array:
        """Project points to the picture.

        Args:
            points: Points in the world frame ``(..., 3)``, m.
            size: Width and height of the picture, px.

        Returns:
            Column and row, px, from the upper left corner, and depth, m: ``(..., 3)``.
        """
        width, height = size
        right, up, depth = np.moveaxis((np.asarray(points, dtype=float) - self.position) @ self.axes().T, -1, 0)
        scale = self.pixels_per_metre(depth, size)
        return np.stack([width / 2 + scale * right, height / 2 - scale * up, depth], axis=-1)

    def point_at(self, pixel: tuple[float, float], depth: float, size: tuple[int, int]) -> Array:
        """Return the point ``(3,)``, m, that appears at a pixel of a picture.

        Args:
            pixel: Column and row, px, from the upper left corner.
            depth: Distance of the point from the camera along the direction in which the camera looks, m.
            size: Width and height of the picture, px.
        """
        scale = self.pixels_per_metre(depth, size)
        away = np.array([(pixel[0] - size[0] / 2) / scale, (size[1] / 2 - pixel[1]) / scale, depth])
        return np.asarray(self.position + away @ self.axes())

    def pixels_per_metre(self, depth: ArrayLike, size: tuple[int, int]) -> Array:
        """Compute the scale, px per m, at depths ``(...)``, m, of a picture with width and height ``size``, px."""
        focal_length = size[1] / 2 / np.tan(np.radians(self.angle_deg) / 2)
        return np.asarray(focal_length / np.maximum(np.asarray(depth), 1e-3))


def fitted_eye(points: Array, direction: Array, size: tuple[int, int], angle_deg: float = 30.0) -> Eye:
    """Return a viewpoint whose picture shows all points.

    It is farther away than necessary by the factor `FIT`, so that nothing touches the picture's edge.

    Args:
        points: The points ``(N, 3)``, m.
        direction: Direction ``(3,)`` from the middle of the points to the viewpoint, which looks at this middle.
        size: Width and height of the picture, px.
        angle_deg: Vertical angle of view, degrees.
    """
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    eye = Eye(middle + direction, middle, angle_deg)
    right, up, ahead = ((points - middle) @ eye.axes().T).T
    tangent = np.tan(np.radians(angle_deg) / 2)
    away = np.maximum(np.abs(right) / (tangent * size[0] / size[1]), np.abs(up) / tangent) - ahead
    return Eye(middle + direction / np.linalg.norm(direction) * FIT * float(away.max()), middle, angle_deg)


def seen_along(axis: Array, offset: Array, ahead: Array) -> Array:
    """Return an offset's components ``(2,)`` across the tool's axis: to a camera's right, and away from the camera.

    Args:
        axis: Direction of the tool ``(3,)``.
        offset: The offset ``(3,)``, m.
        ahead: Direction in which the camera looks ``(3,)``.
    """
    right = np.cross(ahead, axis)
    right /= max(float(np.linalg.norm(right)), 1e-9)
    return np.array([offset @ right, offset @ np.cross(axis, right)])


@dataclass(frozen=True, eq=False)
class Stage:
    """Everything that one picture shows.

    Attributes:
        eye: The viewpoint.
        rods: Groups of rods.
        balls: Groups of balls, as made by `spheres`.
        meshes: Meshes that may change between pictures.
        still: Meshes that are the same objects in every picture, so that a drawer may cache them.
        words: Lines of text, in the order in which they are read.
        dial: The dial of the tool's misses, drawn into the lower right corner, or None.
        size: Width and height, px.
        dark: Whether the background is dark.
    """

    eye: Eye
    rods: tuple[Rods, ...] = ()
    balls: tuple[Rods, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    still: tuple[Mesh, ...] = ()
    words: tuple[Words, ...] = ()
    dial: Dial | None = None
    size: tuple[int, int] = field(default=SIZE)
    dark: bool = False


def rgba(colour: Rgb, count: int, opacity: float = 1.0) -> Colours:
    """Repeat a colour with its opacity (0 to 1) for ``count`` shapes: ``(count, 4)``, 0 to 255."""
    return np.broadcast_to(np.array([*colour, round(255 * opacity)], dtype=np.uint8), (count, 4))


def backdrop(dark: bool) -> tuple[Rgb, Rgb]:
    """Return the colours of a light or dark background at the picture's upper and lower edges."""
    return ((38, 44, 54), (24, 27, 33)) if dark else ((214, 229, 243), (248, 250, 252))


def ink(dark: bool) -> Rgb:
    """Return the colour of words on a light or dark background."""
    return (236, 239, 244) if dark else (28, 36, 46)
