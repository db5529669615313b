"""What a tool point is held against: a point, a line or a plane; its distance from it, and closed forms to start from.

A draw wire, a ball bar and a ball on a sphere keep a distance from a point, a ball on an edge from a line, a dial gauge
and a probe on a table from a plane. Directions are three numbers, of which only the direction counts; one equation more
keeps their length at one. SI units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, ArmModel, Conditions
from pickenv.calibration.model.observations import NONE_KNOWN, OneGroup, Origins, Rows, Stated, point_jacobian

# The point of the tool that an instrument sees or touches: where a wire is hooked, a ball's centre, a probe's tip. It
# is stated in the tool's frame, exactly, within an uncertainty, or not at all; every instrument has its own. SI
# units.


TIP = ("tip_x", "tip_y", "tip_z")
"""Names of its coordinates."""

Tip = tuple[float, float, float]
ORIGIN: Tip = (0.0, 0.0, 0.0)


def tool_points(model: ArmModel, joints: Array, conditions: Conditions, tip: Array) -> Array:
    """Where a point ``(3,)`` of the tool's frame is at joints ``(N, n)``: ``(N, 3)``, m."""
    pose = model.pose(joints, conditions)
    return np.asarray(pose.position + pose.rotation @ tip)


def tool_points_jacobian(model: ArmModel, joints: Array, conditions: Conditions, tip: Array) -> tuple[Array, Array]:
    """Its derivatives by the model ``(N, 3, P)`` and by the point's place on the tool ``(N, 3, 3)``."""
    rotation = model.pose(joints, conditions).rotation
    return point_jacobian(model.jacobian(joints, conditions), rotation @ tip), rotation


SurfaceName = Literal["point", "line", "plane"]

STEPS = 20
"""Of a solution that gross rows hardly pull."""

FAR = 5.0
"""Rows farther off than so many medians do not say how points lie."""


class Gap(NamedTuple):
    """Distances of N points from a surface, m, with their derivatives.

    Attributes:
        size: ``(N,)``.
        by_point: ``(N, 3)``.
        by_values: By the surface's own numbers ``(N, K)``.
    """

    size: Array
    by_point: Array
    by_values: Array


class Surface(NamedTuple):
    """One kind of surface with K numbers of its own.

    Attributes:
        names: Of the numbers.
        tolerances: Scale of each one's deviation ``(K,)``, m or rad.
        gap: Distances of points ``(N, 3)`` from the surface with these numbers.
        start: The numbers and the zero of the readings, from points ``(N, 3)``, readings ``(N,)``, a zero and whether
            it is unknown.
        gauge: Equations that hold what the distances leave open: residual ``(G,)`` and derivatives ``(G, K)``.
    """

    names: tuple[str, ...]
    tolerances: Array
    gap: Callable[[Array, Array], Gap]
    start: Callable[[Array, Array, float, bool], tuple[Array, float]]
    gauge: Callable[[Array], tuple[Array, Array]]


def direction(vector: Array) -> tuple[Array, Array]:
    """A vector ``(3,)`` at length one, and its derivative ``(3, 3)`` by the vector."""
    size = float(np.linalg.norm(vector))
    ahead = vector / size
    return ahead, (np.eye(3) - np.outer(ahead, ahead)) / size


def unit_length(vector: Array) -> tuple[Array, Array]:
    """How much too short a vector ``(3,)`` is, to first order ``(1,)``, and the derivative ``(1, 3)`` of its length."""
    return np.array([(1.0 - vector @ vector) / 2.0]), vector[None]


def steady_solution(matrix: Array, right: Array) -> Array:
    """The solution of least absolute errors, which a few gross rows hardly pull, by re-weighted least squares."""
    weights: Array = np.ones(len(right))
    found: Array = np.zeros(matrix.shape[1])
    for _ in range(STEPS):
        found = np.asarray(np.linalg.lstsq(matrix * weights[:, None], right * weights, rcond=None)[0], dtype=float)
        left = np.abs(right - matrix @ found)
        weights = 1.0 / np.sqrt(np.maximum(left, 0.1 * float(np.median(left)) + 1e-12))
    return found


def _from_point(values: Array, points: Array) -> Gap:
    away = points - values
    size = np.linalg.norm(away, axis=1)
    along = away / np.maximum(size, 1e-12)[:, None]
    return Gap(size, along, -along)


def _from_line(values: Array, points: Array) -> Gap:
    ahead, by_vector = direction(values[3:])
    away = points - values[:3]
    far = away @ ahead
    across = away - far[:, None] * ahead
    size = np.linalg.norm(across, axis=1)
    out = across / np.maximum(size, 1e-12)[:, None]
    return Gap(size, out, np.concatenate([-out, -far[:, None] * (out @ by_vector)], axis=1))


def _from_plane(values: Array, points: Array) -> Gap:
    normal, by_vector = direction(values[:3])
    by_point = np.broadcast_to(normal, points.shape)
    return Gap(points @ normal - values[3], by_point, np.column_stack([points @ by_vector, -np.ones(len(points))]))


def _centre(points: Array, readings: Array, zero: float, unknown: bool) -> tuple[Array, float]:
    """Centre A ``(d,)`` of points ``(N, d)`` whose distances r from it are read as r + z, and the zero z.

    Differences of squares: |p|^2 - l^2 = 2 p.A - 2 l z + z^2 - |A|^2 is linear in A, z and a constant.
    """
    middle, begin = points.mean(axis=0), float(readings.mean()) if unknown else zero
    p, length = points - middle, readings - begin
    varied = unknown and float(np.ptp(readings)) > 0.0
    columns = [2.0 * p, np.ones((len(p), 1)), *([-2.0 * length[:, None]] if varied else [])]
    found = steady_solution(np.hstack(columns), np.sum(p**2, axis=1) - length**2)
    at, rest = found[: p.shape[1]], float(found[p.shape[1]])
    if varied:
        begin += float(found[-1])
    elif unknown:
        begin -= float(np.sqrt(max(rest + float(at @ at), 0.0)))
    return middle + at, begin


def _principal_axes(points: Array, count: int) -> tuple[Array, NDArray[np.bool_]]:
    """Axes of points ``(N, 3)``, those of most spread first ``(3, 3)``, and which lie near the first ``count``."""
    kept = np.ones(len(points), dtype=bool)
    axes = np.eye(3)
    for _ in range(STEPS):
        middle = points[kept].mean(axis=0)
        axes = np.linalg.svd(points[kept] - middle)[2]
        off = np.linalg.norm((points - middle) @ axes[count:].T, axis=1)
        used, kept = kept, off <= FAR * max(float(np.median(off)), 1e-9)
        if kept.sum() < 4 or np.array_equal(used, kept):
            break
    return axes, kept


def _point_start(points: Array, readings: Array, zero: float, unknown: bool) -> tuple[Array, float]:
    return _centre(points, readings, zero, unknown)


def _line_start(points: Array, readings: Array, zero: float, unknown: bool) -> tuple[Array, float]:
    """The longest axis of the points, and across it the centre of a circle."""
    axes, near = _principal_axes(points, 1)
    across, found = _centre(points[near] @ axes[1:].T, readings[near], zero, unknown)
    return np.concatenate([across @ axes[1:], axes[0]]), found


def _plane_start(points: Array, readings: Array, zero: float, unknown: bool) -> tuple[Array, float]:
    """The shortest axis of the points, or the direction along which the readings grow, whichever explains more."""
    shortest = _principal_axes(points, 2)[0][2]
    matrix = np.column_stack([points - points.mean(axis=0), np.ones(len(points))])
    slope = steady_solution(matrix, readings)[:3]
    candidates = [shortest, *([slope / np.linalg.norm(slope)] if np.linalg.norm(slope) > 1e-9 else [])]

    def left(normal: Array) -> float:
        offsets = points @ normal - readings
        return float(np.median(np.abs(offsets - np.median(offsets))))

    normal = min(candidates, key=left)
    return np.append(normal, np.median(points @ normal - readings)), zero


def _no_gauge(values: Array) -> tuple[Array, Array]:
    return np.zeros(0), np.zeros((0, len(values)))


def _line_gauge(values: Array) -> tuple[Array, Array]:
    """The direction has length one, and the point on the line is the one nearest to the origin."""
    at, ahead = values[:3], values[3:]
    short, by_vector = unit_length(ahead)
    rows = np.vstack([np.concatenate([np.zeros(3), by_vector[0]]), np.concatenate([ahead, at])])
    return np.append(short, -(at @ ahead)), rows


def _plane_gauge(values: Array) -> tuple[Array, Array]:
    short, by_vector = unit_length(values[:3])
    return short, np.append(by_vector, [[0.0]], axis=1)


SURFACES: dict[str, Surface] = {
    "point": Surface(
        ("anchor_x", "anchor_y", "anchor_z"), np.full(3, LENGTH_TOLERANCE), _from_point, _point_start, _no_gauge
    ),
    "line": Surface(
        ("edge_x", "edge_y", "edge_z", "along_x", "along_y", "along_z"),
        np.repeat([LENGTH_TOLERANCE, ANGLE_TOLERANCE], 3),
        _from_line,
        _line_start,
        _line_gauge,
    ),
    "plane": Surface(
        ("normal_x", "normal_y", "normal_z", "plane_offset"),
        np.array([ANGLE_TOLERANCE] * 3 + [LENGTH_TOLERANCE]),
        _from_plane,
        _plane_start,
        _plane_gauge,
    ),
}
"""The surfaces by name."""


# Places that a tool point rests in, again and again: sockets, or one point that is touched in many poses. SI units.


@dataclass(frozen=True, eq=False)
class SocketObservations(OneGroup):
    """The tool point rests in places that do not move: sockets, or one point touched again and again.

    No metrology but the known spacing of some sockets.

    Attributes:
        joints: ``(N, n)``, rad or m.
        socket: Number of the place that each pose rests in ``(N,)``, from 0.
        pairs: Sockets of known spacing ``(M, 2)``; without them the scale of the arm is unobservable.
        spacing: Their spacings ``(M,)``, m.
        std: Standard uncertainty of a ball's rest, m.
        spacing_std: Standard uncertainty of a spacing, m.
        places: Names of the places; numbered sockets when empty.
        tip: The point that rests there in the tool's frame, m.
        tip_std: Standard uncertainty of a coordinate of ``tip``, m: 0 where it is exact, infinite where it is unknown.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        origins: File and line of each row; None where they come from no file.
    """

    joints: Array
    socket: NDArray[np.int64]
    pairs: NDArray[np.int64]
    spacing: Array
    std: float = 1e-4
    spacing_std: float = 1e-5
    places: tuple[str, ...] = ()
    tip: Tip = ORIGIN
    tip_std: float = 0.0
    conditions: Conditions = NONE_KNOWN
    source: str = "sockets"
    kind: str = "sockets"
    framed: bool = False
    origins: Origins | None = None
    per_row = ("socket",)
    width = 3

    @property
    def sized(self) -> bool:  # type: ignore[override]
        """Whether a spacing is known."""
        return len(self.pairs) > 0

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return self.places or tuple(f"socket{i + 1}" for i in range(int(self.socket.max()) + 1))

    @cached_property
    def numbers(self) -> Stated:
        """Where the sockets are, and the tool point."""
        count = 3 * len(self._names)
        return Stated(
            (*(f"{name}_{axis}" for name in self._names for axis in "xyz"), *TIP),
            np.array([*range(count), *self.tip], dtype=float),
            np.array([*[np.inf] * count, *[self.tip_std] * 3]),
            np.full(count + 3, LENGTH_TOLERANCE),
        )

    @property
    def groups(self) -> Rows:
        """Each socket's rows are a group, so that each is trained on."""
        return self.socket

    def missed(self, model: ArmModel, numbers: Array) -> Array:
        """Socket minus ball."""
        sockets, ball = numbers[:-3].reshape(-1, 3), tool_points(model, self.joints, self.conditions, numbers[-3:])
        return np.asarray(sockets[self.socket] - ball)

    def readings(self) -> Array:
        """The sockets' numbers."""
        return self.socket[:, None].astype(float)

    def start(self, model: ArmModel) -> Array:
        """The median of the ball's positions in each socket, which a few gross rows hardly move."""
        ball = tool_points(model, self.joints, self.conditions, np.array(self.tip))
        rests = [ball[self.socket == i] for i in range(len(self._names))]
        sockets = [np.median(rest if len(rest) else ball, axis=0) for rest in rests]
        return np.concatenate([*sockets, self.tip])[self.numbers.free]

    def derivatives(self, model: ArmModel, numbers: Array) -> tuple[Array, Array]:
        """Of ball minus socket."""
        by_model, by_tip = tool_points_jacobian(model, self.joints, self.conditions, numbers[-3:])
        chosen = np.eye(len(self._names))[self.socket]
        rest = -np.einsum("ns,ij->nisj", chosen, np.eye(3)).reshape(*by_tip.shape[:2], -1)
        return by_model / self.std, np.concatenate([rest, by_tip], axis=-1) / self.std

    def bonds(self, numbers: Array) -> tuple[Array, Array]:
        """The spacings that are known."""
        (one, other), sockets = self.pairs.T, numbers[:-3].reshape(-1, 3)
        difference = sockets[one] - sockets[other]
        apart = np.linalg.norm(difference, axis=1)
        along = difference / apart[:, None] / self.spacing_std
        places = np.eye(len(sockets))
        by_sockets = np.einsum("ms,mj->msj", places[one] - places[other], along).reshape(-1, sockets.size)
        return (self.spacing - apart) / self.spacing_std, np.pad(by_sockets, ((0, 0), (0, 3)))
