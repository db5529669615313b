"""The contents of a picture: rods, balls, surfaces, words and an eye, which environments fill and both drawers draw.

Nothing here knows of an environment or of a drawing library. World frame, z up. Units: m; px only on the picture.
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
"""Factor by which an eye stands farther away than needed, so that nothing touches the picture's edge."""
CORNERS = ("top left", "top right", "bottom left", "bottom right")


@dataclass(frozen=True, eq=False)
class Rods:
    """Cylinders with round ends.

    Attributes:
        start: Centres of the first ends ``(N, 3)``, m.
        end: Centres of the other ends ``(N, 3)``, m.
        radius: Radius of each ``(N,)``, m.
        colour: Red, green, blue and opacity ``(N, 4)``, 0 to 255.
    """

    start: Array
    end: Array
    radius: Array
    colour: Colours


def spheres(centre: Array, radius: Array, colour: Colours) -> Rods:
    """Balls: rods of no length, with centres ``(N, 3)``, m."""
    return Rods(centre, centre, radius, colour)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A set of triangles; corners that triangles share are shaded smoothly.

    Attributes:
        corners: Places of the corners ``(V, 3)``, m.
        triangles: Numbers of each triangle's corners ``(T, 3)``.
        colour: Red, green, blue and opacity of each corner ``(V, 4)``, 0 to 255.
        normals: Normal at each corner ``(V, 3)``; empty ``(0, 3)`` until normals are worked out.
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
        place: One of `CORNERS`, where lines stand below one another, or a point ``(3,)`` of the world, m.
        colour: Colour of the text; None for the `ink` that suits the background.
        large: Whether the text is large, as for a picture's subject.
    """

    text: str
    place: str | Array = "top left"
    colour: Rgb | None = None
    large: bool = False


@dataclass(frozen=True, eq=False)
class Dial:
    """Misses as seen along the tool: a ring around the fruit as wide as the gripper forgives, and marks of the tool.

    Attributes:
        marks_mm: Misses across the tool, to the right and up on the picture ``(K, 2)``, mm, the present one last.
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
    """A camera without distortion that keeps z upright.

    Attributes:
        position: Where the eye stands ``(3,)``, m.
        target: The point that it looks at ``(3,)``, m.
        angle_deg: Angle of view from the lower to the upper edge, degrees.
    """

    position: Array
    target: Array
    angle_deg: float = 30.0

    def axes(self) -> Array:
        """The eye's axes as rows ``(3, 3)``: to the right, up, and towards the target."""
        ahead = self.target - self.position
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, ahead), ahead])

    def project(self, points: ArrayLike, size: tuple[int, int]) -> Array:
        """Project points ``(..., 3)``, m, to column and row (px, from the upper left corner) and depth (m)."""
        width, height = size
        right, up, depth = np.moveaxis((np.asarray(points, dtype=float) - self.position) @ self.axes().T, -1, 0)
        scale = self.pixels_per_metre(depth, size)
        return np.stack([width / 2 + scale * right, height / 2 - scale * up, depth], axis=-1)

    def point_at(self, pixel: tuple[float, float], depth: float, size: tuple[int, int]) -> Array:
        """The point ``(3,)``, m, at a given depth, m, that is seen at a given column and row, px."""
        scale = self.pixels_per_metre(depth, size)
        away = np.array([(pixel[0] - size[0] / 2) / scale, (size[1] / 2 - pixel[1]) / scale, depth])
        return np.asarray(self.position + away @ self.axes())

    def pixels_per_metre(self, depth: ArrayLike, size: tuple[int, int]) -> Array:
        """The size of a metre on the picture at depths ``(...)``, m: px per m."""
        focal_length = size[1] / 2 / np.tan(np.radians(self.angle_deg) / 2)
        return np.asarray(focal_length / np.maximum(np.asarray(depth), 1e-3))


def fitted_eye(points: Array, direction: Array, size: tuple[int, int], angle_deg: float = 30.0) -> Eye:
    """The nearest eye that sees all points ``(N, 3)``, looking at their middle from a direction ``(3,)``."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    eye = Eye(middle + direction, middle, angle_deg)
    right, up, ahead = ((points - middle) @ eye.axes().T).T
    tangent = np.tan(np.radians(angle_deg) / 2)
    away = np.maximum(np.abs(right) / (tangent * size[0] / size[1]), np.abs(up) / tangent) - ahead
    return Eye(middle + direction / np.linalg.norm(direction) * FIT * float(away.max()), middle, angle_deg)


@dataclass(frozen=True, eq=False)
class Stage:
    """Everything that one picture shows.

    Attributes:
        eye: The eye that sees it.
        rods: Groups of rods.
        balls: Groups of balls, as made by `spheres`.
        meshes: Meshes that may change between pictures.
        still: Meshes that do not change: a drawer may keep them, as every picture gets the same objects.
        words: Lines of text, in the order in which they are read.
        dial: The miss, drawn into the lower right corner, or None.
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
    """One colour with its opacity, repeated for ``count`` things: ``(count, 4)``."""
    return np.broadcast_to(np.array([*colour, round(255 * opacity)], dtype=np.uint8), (count, 4))


def backdrop(dark: bool) -> tuple[Rgb, Rgb]:
    """Colours of a light or dark background at the picture's upper and lower edges."""
    return ((38, 44, 54), (24, 27, 33)) if dark else ((214, 229, 243), (248, 250, 252))


def ink(dark: bool) -> Rgb:
    """Colour of words on a light or dark background."""
    return (236, 239, 244) if dark else (28, 36, 46)
