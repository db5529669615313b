"""Solids of a drawn arm: links, joints, telescopes, a gripper, its ghost, and the camera's field of view.

The ghost is a transparent arm that shows where the controller believes the arm to be. The tool's deviation is
distributed evenly along the links, so pictures do not show where along the arm it arises. Units: m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry
from pickenv.arm.kinematics.forward import drawn_parts, nominal_points, true_points
from pickenv.arm.kinematics.inverse import halton_joints
from pickenv.pictures.solids import ring_around, turned
from pickenv.pictures.stage import Mesh, Rgb, Rods, rgba, spheres

GAIN = 20
"""Factor by which the ghost exaggerates the distance between the true arm and the believed arm."""
LINK, JOINT, METAL, GRIPPER = (236, 239, 243), (58, 68, 82), (168, 176, 188), (70, 78, 90)
GHOST: Rgb = (52, 110, 200)
FAINT = 0.42
"""Opacity of the ghost, from 0 to 1."""
THICKNESS = 0.028
"""Radius of the first link, as a share of the arm's length; the last link has `TAPER` times this radius."""
WALL = 0.0035
"""Thickness of a drawn cup's wall, m."""
CUP_RADIUS = 0.0375
"""Default radius of a cup, m, for a fruit of 60 mm."""
FOOT = 1.9
"""Distance from the fruit in a cup to the end of the arm, as a multiple of the cup's radius."""
TAPER, TELESCOPE, CAP = 0.5, 0.55, 1.28


Solids = tuple[tuple[Rods, ...], tuple[Rods, ...], tuple[Mesh, ...]]
"""Groups of rods, of balls and of meshes, in the order in which a `pickenv.pictures.stage.Stage` takes them."""


@dataclass(frozen=True, eq=False)
class ArmLook:
    """The look of one arm, of whose polyline P segments are drawn.

    Attributes:
        parts: Index of the first point of each segment in the polyline, from 0.
        radius: Radius of each segment ``(P,)``, m.
        slides: Whether each segment changes its length ``(P,)``.
        sleeve: Length of the outer tube of each segment that changes its length ``(P,)``, m.
        low: Least x, y and z of the arm's points over sampled poses, without the lowest 3 % ``(3,)``, m.
        high: Largest x, y and z of the arm's points over sampled poses, without the highest 3 % ``(3,)``, m.
    """

    parts: list[int]
    radius: Array
    slides: NDArray[np.bool_]
    sleeve: Array
    low: Array
    high: Array


@lru_cache(maxsize=8)
def arm_look(geometry: Geometry) -> ArmLook:
    """Compute the look of an arm from sampled poses: the segments to draw, their thickness, and the space they fill."""
    points = nominal_points(geometry, halton_joints(geometry, 256))
    parts = drawn_parts(points)
    lengths = np.linalg.norm(np.diff(points, axis=-2), axis=-1)[:, parts]
    thick = THICKNESS * float(lengths.mean(axis=0).sum())
    radius = thick * np.linspace(1.0, TAPER, len(parts))
    slides = np.ptp(lengths, axis=0) > 1e-6
    low, high = (np.quantile(points.reshape(-1, 3), q, axis=0) for q in (0.03, 0.97))
    return ArmLook(parts, radius, slides, TELESCOPE * lengths.max(axis=0), low, high)


def arm_solids(look: ArmLook, points: Array, axis: Array, accent: Rgb | None = None) -> Solids:
    """Return the solids of links, joints and telescopes along a polyline, up to the foot of a gripper.

    Args:
        look: The look of the arm.
        points: The polyline ``(K, 3)``, m; its last point is the tool, inside the gripper.
        axis: Direction in which the tool points ``(3,)``.
        accent: Colour of the links instead of white.
    """
    points = np.concatenate([points[:-1], points[-1:] - FOOT * CUP_RADIUS * axis])
    start, end = points[look.parts], points[[i + 1 for i in look.parts]]
    along = end - start
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    colour = np.where(look.slides[:, None], rgba(METAL, 1), rgba(accent or LINK, 1)).astype(np.uint8)
    inner = Rods(start, end, look.radius * np.where(look.slides, 0.62, 1.0), colour)
    outer = look.slides & (length > look.radius)
    reach = np.minimum(1.0, look.sleeve / length)[:, None]
    sleeve = (start + along * reach)[outer]
    tubes = Rods(start[outer], sleeve, look.radius[outer], rgba(accent or LINK, len(sleeve)))
    joints = spheres(start, CAP * look.radius, rgba(JOINT, len(start)))
    return (inner, tubes), (joints,), ()


def arm_at_work(
    geometry: Geometry, command: Array, tool: Array, axis: Array, believed: Array, accent: Rgb | None = None
) -> Solids:
    """Return the solids of the true arm, and of the ghost (the believed arm) at `GAIN` times its true distance.

    Args:
        geometry: The nominal arm.
        command: Joint command that the drives got ``(n,)``, rad or m.
        tool: The tool's true position ``(3,)``, m.
        axis: Direction in which the tool points ``(3,)``.
        believed: The tool's position as the controller believes it to be ``(3,)``, m.
        accent: Colour of the true arm's links instead of white.
    """
    look = arm_look(geometry)
    true = arm_solids(look, true_points(geometry, command, tool), axis, accent)
    points = true_points(geometry, command, tool + GAIN * (believed - tool))
    start, end = points[look.parts], points[[i + 1 for i in look.parts]]
    ghost = Rods(start, end, 0.8 * look.radius, rgba(GHOST, len(start), FAINT))
    tip = spheres(points[-1:], 0.95 * look.radius[-1:], rgba(GHOST, 1, FAINT))
    return joined_solids(true, ((ghost,), (tip,), ()))


def cup_solids(tool: Array, axis: Array, radius: float) -> Solids:
    """Return the solids of a cup that holds the lower half of a fruit.

    Args:
        tool: Position of the fruit ``(3,)``, m.
        axis: Unit vector ``(3,)`` in which the cup opens.
        radius: Outer radius of the cup, m.
    """
    deep = 1.15 * radius
    inner = radius - WALL
    across = [0.4 * radius, 0.7 * radius, radius, radius, radius, inner, inner, inner, 0.6 * radius, 0.0]
    heights = deep * np.array([-1.35, -1.0, -0.55, 0.0, 0.0, 0.0, 0.0, -0.5, -0.9, -1.0])
    return (), (), (turned(np.column_stack([across, heights]), tool, axis, GRIPPER),)


def hand_solids(tool: Array, axis: Array, radius: float, closed: bool) -> Solids:
    """Return the solids of a hand with three fingers around a fruit.

    Args:
        tool: Position of the fruit ``(3,)``, m.
        axis: Direction from the palm to the fruit, a unit vector ``(3,)``.
        radius: Radius of the hand's opening, m.
        closed: Whether the fingers are closed.
    """
    out = ring_around(axis, 3)
    palm = tool - 1.6 * radius * axis
    knuckle, tip = palm + 0.7 * radius * out, tool + (0.75 if closed else 1.25) * radius * out + 0.5 * radius * axis
    middle = tool + (1.1 if closed else 1.4) * radius * out - 0.7 * radius * axis
    start, end = np.concatenate([knuckle, middle]), np.concatenate([middle, tip])
    fingers = Rods(start, end, np.full(6, 0.2 * radius), rgba(GRIPPER, 6))
    return (fingers,), (spheres(palm[None], np.array([0.75 * radius]), rgba(JOINT, 1)),), ()


def frustum_solids(eye: Array, ahead: Array, half_angles: Sequence[float], length: float, colour: Rgb) -> Solids:
    """Return the solids of a camera and of the edges of its field of view.

    Args:
        eye: Position of the camera ``(3,)``, m.
        ahead: Horizontal unit vector along which the camera looks ``(3,)``.
        half_angles: Tangents of half the camera's angles of view, horizontal and vertical.
        length: Distance from the camera to which the edges are drawn, m.
        colour: Colour of the edges.
    """
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(ahead, up)
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = np.array([sx * half_angles[0] * side + sz * half_angles[1] * up for sx, sz in signs])
    far = eye + length * (ahead + corners)
    start, end = np.concatenate([np.broadcast_to(eye, (4, 3)), far]), np.concatenate([far, np.roll(far, -1, axis=0)])
    edges = Rods(start, end, np.full(8, 0.003), rgba(colour, 8))
    body = Rods((eye - 0.05 * ahead)[None], eye[None], np.array([0.028]), rgba(JOINT, 1))
    return (edges, body), (), ()


def joined_solids(*parts: Solids) -> Solids:
    """Join the solids of several parts of a picture."""
    rods, balls, meshes = zip(*parts, strict=True)
    return tuple(chain(*rods)), tuple(chain(*balls)), tuple(chain(*meshes))
