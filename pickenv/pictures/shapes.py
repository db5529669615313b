"""Solids of pictures: meshes of triangles, a drawn arm, and what grows and stands around it. Units: m.

An arm has links, joints, telescopes, a gripper, the camera's field of view, and a ghost. The ghost is a transparent arm
that shows where the controller believes the arm to be. The tool's deviation is distributed evenly along the links, so
pictures do not show where along the arm it arises.

Around the arm are fruit on stems, leaves and branches of a row of trees along x, ground and a crate. Leaves are as
dense as in a canopy's preset. Other leaves, which environments draw at random in every episode, hide fruit from a
camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Geometry
from pickenv.arm.kinematics.forward import drawn_parts, nominal_points, true_points
from pickenv.arm.kinematics.inverse import halton_joints
from pickenv.orchard import load_look, sample_leaves
from pickenv.pictures.stage import Eye, Mesh, Rgb, Rods, rgba, spheres


def mesh_triangles(surface: Mesh) -> Mesh:
    """Return the mesh with a normal at each corner: the area-weighted mean normal of the triangles that share it."""
    a, b, c = (surface.corners[surface.triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(surface.corners, dtype=float)
    for k in range(3):
        np.add.at(normals, surface.triangles[:, k], face)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    return replace(surface, normals=normals)


def all_triangles(parts: Sequence[Mesh]) -> Mesh:
    """Join several meshes into one."""
    if not parts:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.intp), np.empty((0, 4), np.uint8))
    first = np.cumsum([0, *(len(part.corners) for part in parts[:-1])])
    triangles = [part.triangles + shift for part, shift in zip(parts, first, strict=True)]
    corners, colour, normals = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("corners", "colour", "normals")
    )
    return Mesh(corners, np.concatenate(triangles), colour.astype(np.uint8), normals)


def ring_around(axis: Array, count: int) -> Array:
    """Return unit vectors ``(count, 3)`` perpendicular to the unit vector ``axis (3,)``, at equal angles around it."""
    x = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    x = x / np.linalg.norm(x)
    turn = 2.0 * np.pi * np.arange(count)[:, None] / count
    return np.asarray(np.cos(turn) * x + np.sin(turn) * np.cross(axis, x))


def turned(profile: ArrayLike, point: Array, axis: Array, colour: Rgb, around: int = 24) -> Mesh:
    """Make a surface of revolution.

    Args:
        profile: Radius and height of points along its outline ``(P, 2)``, m. A point that is listed twice makes a sharp
            edge.
        point: Point on the axis where the height is zero ``(3,)``, m.
        axis: Unit vector along the axis, in which height grows ``(3,)``.
        colour: Red, green, blue.
        around: Number of corners around the axis.
    """
    outline, ring = np.asarray(profile, dtype=float), ring_around(axis, around)
    corners = point + outline[:, None, :1] * ring + outline[:, None, 1:] * axis
    i = np.arange(around)
    j, faces = (i + 1) % around, []
    for k in range(len(outline) - 1):
        if np.allclose(outline[k], outline[k + 1]):
            continue
        low, high = k * around, (k + 1) * around
        faces += [np.stack([low + i, low + j, high + j], -1), np.stack([low + i, high + j, high + i], -1)]
    corners = corners.reshape(-1, 3)
    return Mesh(corners, np.concatenate(faces), rgba(colour, len(corners)))


def chequered(low: ArrayLike, high: ArrayLike, height: float, square: float, colours: tuple[Rgb, Rgb]) -> Mesh:
    """Make horizontal ground of squares in two colours.

    Args:
        low: Corner with the least x and y ``(2,)``, m; it is rounded down to whole squares.
        high: Opposite corner ``(2,)``, m, which the ground reaches at least.
        height: Height of the ground, m.
        square: Side of a square, m.
        colours: The two colours.
    """
    low = np.floor(np.asarray(low, dtype=float) / square) * square
    nx, ny = np.maximum(np.ceil((np.asarray(high, dtype=float) - low) / square - 1e-9).astype(int), 1)
    ix, iy = (grid.ravel() for grid in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    place = low + square * np.stack([ix, iy], -1)
    around = square * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    flat = (place[:, None] + around).reshape(-1, 2)
    corners = np.column_stack([flat, np.full(len(flat), height)])
    shade = np.stack([rgba(colour, 1)[0] for colour in colours])[(ix + iy) % 2]
    return Mesh(corners, _fans(len(place)), np.repeat(shade, 4, axis=0))


def leaf_mesh(places: Array, length: float, width: float, colour: ArrayLike, rng: np.random.Generator) -> Mesh:
    """Make leaves with random attitudes and shades, each a bent rhombus of two triangles.

    Args:
        places: Centres of the leaves ``(N, 3)``, m.
        length: Length of a leaf, m.
        width: Width of a leaf, m.
        colour: Red, green, blue of a leaf of medium shade.
        rng: Random generator for attitudes and shades.
    """
    count = len(places)
    basis, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    long, across, normal = basis[:, 0] * length / 2, basis[:, 1] * width / 2, basis[:, 2] * width / 5
    corners = np.stack([places - long, places - across + normal, places + long, places + across + normal], axis=1)
    shade = np.clip(np.asarray(colour) * (0.75 + 0.5 * rng.random((count, 1))), 0, 255)
    colours = np.column_stack([shade, np.full(count, 255.0)]).astype(np.uint8)
    return Mesh(corners.reshape(-1, 3), _fans(count), np.repeat(colours, 4, axis=0))


def _fans(count: int) -> NDArray[np.intp]:
    """Return the corner indices of two triangles for each of ``count`` quadrilaterals ``(2 count, 3)``.

    Quadrilateral i (from 0) has the corners 4 i to 4 i + 3.
    """
    return (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)


RIPE, GREEN, MISSED_FRUIT = (205, 42, 46), (170, 188, 92), (226, 120, 40)
BARK, STEM = (122, 92, 66), (104, 84, 52)
GROUND = {False: ((226, 230, 220), (214, 220, 208)), True: ((52, 58, 64), (46, 52, 58))}
CRATE = (0.28, 0.8)
SQUARE, SPREAD = 0.5, 6.0
TWIG = 0.09
BRIGHTER = 1.35


def fruit_solids(places: Array, diameters: ArrayLike, colours: Array, hanging: ArrayLike = True) -> Solids:
    """Return the solids of fruit; hanging fruit has a stem.

    Args:
        places: Positions of the fruit (N, 3), m.
        diameters: Diameter of all fruit, or of each (N,), m.
        colours: Red, green, blue of each fruit (N, 3), 0 to 255.
        hanging: Whether fruit hangs, and so has a stem: for all fruit, or for each (N,).
    """
    radius = np.broadcast_to(np.asarray(diameters, dtype=float) / 2, len(places))
    shades = np.column_stack([colours, np.full(len(places), 255)]).astype(np.uint8).reshape(-1, 4)
    balls = spheres(places, radius, shades)
    top = (places + radius[:, None] * [0.0, 0.0, 0.9])[np.broadcast_to(hanging, len(places))]
    twigs = Rods(top, top + np.array([0.012, 0.0, TWIG]), np.full(len(top), 0.004), rgba(STEM, len(top)))
    return (twigs,), (balls,), ()


def sprig(place: Array, diameter: float) -> Solids:
    """Return the solids of a few leaves and a piece of branch above a single fruit.

    The fruit's centre is ``place (3,)``, m, world frame, and ``diameter`` is in m.
    """
    top = place + np.array([0.012, 0.0, 0.9 * diameter / 2 + TWIG])
    ends = top + np.array([[-0.16, -0.05, -0.01], [0.14, 0.04, 0.03]])
    branch = Rods(ends[:1], ends[1:], np.array([0.009]), rgba(BARK, 1))
    rng = np.random.default_rng(0)
    return (branch,), (), (_leaves(top + rng.normal(0.0, 1.0, (9, 3)) * [0.09, 0.05, 0.025], rng),)


def _leaves(places: Array, rng: np.random.Generator) -> Mesh:
    """Return the mesh of apple leaves, brighter by the factor `BRIGHTER` than in the images of a simulated camera."""
    look = load_look("red_apples")
    return leaf_mesh(places, look.leaf_length, look.leaf_width, BRIGHTER * np.array(look.leaf), rng)


@lru_cache(maxsize=8)
def row_of_trees(
    low: tuple[float, ...], high: tuple[float, ...], leaf_area_per_volume: float, ground: float
) -> tuple[Mesh, ...]:
    """Return the meshes of trunks, horizontal branches and leaves in a box. Equal arguments give the same objects.

    Args:
        low: Lowest corner of the box (3,), m, world frame.
        high: Highest corner of the box (3,), m, world frame.
        leaf_area_per_volume: Area of leaves per volume of the box, m^2/m^3.
        ground: Height of the ground, from which trunks start, m.
    """
    rng = np.random.default_rng(0)
    bottom, top = np.array(low), np.array(high)
    middle = (bottom[1] + top[1]) / 2
    trunks = np.linspace(bottom[0], top[0], max(round((top[0] - bottom[0]) / 0.9), 1) + 1)
    levels = np.arange(bottom[2] + 0.12, top[2] + 0.1, 0.24)
    wood = [_branch([x, middle, ground], [x + 0.03, middle, top[2] + 0.12], 0.024) for x in trunks]
    wood += [_branch([bottom[0] - 0.1, middle, z], [top[0] + 0.1, middle, z + 0.02], 0.011) for z in levels]
    places = sample_leaves(bottom, top, leaf_area_per_volume, load_look("red_apples"), rng)
    return (*wood, _leaves(places, rng)) if len(places) else tuple(wood)


def _branch(start: ArrayLike, end: ArrayLike, radius: float) -> Mesh:
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    outline = [[0.0, 0.0], [radius, 0.0], [radius, 0.0], [radius, length], [radius, length], [0.0, length]]
    return turned(outline, np.asarray(start), along / length, BARK)


@lru_cache(maxsize=8)
def ground_around(x: float, y: float, height: float, dark: bool) -> Mesh:
    """Return the mesh of level ground around a point in the world frame. Equal arguments give the same object.

    Args:
        x: x of the point, m.
        y: y of the point, m.
        height: Height of the ground, m.
        dark: Whether the background is dark; it selects the colours of the ground's squares in `GROUND`.
    """
    return chequered((x - SPREAD / 2, y - SPREAD / 2), (x + SPREAD / 2, y + SPREAD / 2), height, SQUARE, GROUND[dark])


@lru_cache(maxsize=8)
def pedestal(geometry: Geometry, ground: float) -> Mesh:
    """Return the mesh of the column under an arm's base, from height ``ground``, m. Equal arguments give one object."""
    x, y, top = geometry.base.position.tolist()
    across, high = arm_look(geometry).radius[0] * np.array([2.2, 2.2, 2.2, 1.5, 1.5, 1.5, 0.0]), top - ground
    outline = np.column_stack([across, [0.0, 0.03, 0.03, 0.06, high, high, high]])
    return turned(outline, np.array([x, y, ground]), np.array([0.0, 0.0, 1.0]), JOINT)


def crate(eye: Eye, size: tuple[int, int], count: int, diameter: float, ground: float) -> Solids:
    """Return the solids of a crate on legs with picked fruit, in the lower left of the picture.

    `CRATE` is the position of the crate's corner on the picture, as shares of the picture's width and height.

    Args:
        eye: The viewpoint.
        size: Width and height of the picture, px.
        count: Number of fruit in the crate.
        diameter: Diameter of the fruit, m.
        ground: Height of the ground, m.
    """
    distance = float(np.linalg.norm(eye.target - eye.position))
    corner = eye.point_at((CRATE[0] * size[0], CRATE[1] * size[1]), distance, size)
    wide, along = 5, diameter * 1.05
    number = np.arange(count)
    place = np.stack([number % wide, (number // wide) % wide, number // wide**2], axis=-1) + 0.5
    _, balls, _ = fruit_solids(corner + along * place, diameter, fruit_colours(count))
    side = along * wide
    edge = np.array([[0, 0, 0], [side, 0, 0], [side, side, 0], [0, side, 0]], dtype=float)
    start = np.concatenate([corner + edge + [0.0, 0.0, z] for z in (0.0, 0.6 * along)])
    end = np.concatenate([corner + np.roll(edge, -1, axis=0) + [0.0, 0.0, z] for z in (0.0, 0.6 * along)])
    feet = (corner + edge) * [1.0, 1.0, 0.0] + [0.0, 0.0, ground]
    start, end = np.concatenate([start, feet]), np.concatenate([end, corner + edge])
    return (Rods(start, end, np.full(12, 0.008), rgba((196, 160, 110), 12)),), balls, ()


def fruit_colours(count: int) -> Array:
    """Return the colours of ``count`` ripe fruit (count, 3), an array that the caller may change."""
    return np.tile(np.array(RIPE), (count, 1))


GAIN = 20
LINK, JOINT, METAL, GRIPPER = (236, 239, 243), (58, 68, 82), (168, 176, 188), (70, 78, 90)
GHOST: Rgb = (52, 110, 200)
FAINT = 0.42
"""Opacity of the ghost, from 0 to 1."""
THICKNESS, WALL = 0.028, 0.0035
CUP_RADIUS = 0.0375
"""Default radius of a cup, m, for a fruit of 60 mm."""
FOOT = 1.9
TAPER, TELESCOPE, CAP = 0.5, 0.55, 1.28


Solids = tuple[tuple[Rods, ...], tuple[Rods, ...], tuple[Mesh, ...]]
"""Groups of rods, of balls and of meshes, in the order in which a `pickenv.pictures.stage.Stage` takes them."""


@dataclass(frozen=True, eq=False)
class ArmLook:
    """The look of one arm: P segments of the arm's polyline are drawn.

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
    """Compute the look of an arm from sampled poses: the segments to draw, their thickness, and the space they fill.

    The radius of the first link is the share `THICKNESS` of the arm's length; the last link has `TAPER` times this
    radius.
    """
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

    The foot is `FOOT` radii of a cup away from the fruit in the cup.

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
    return (inner, tubes), (spheres(start, CAP * look.radius, rgba(JOINT, len(start))),), ()


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
    """Return the solids of a cup that holds the lower half of a fruit; its wall has the thickness `WALL`, m.

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
