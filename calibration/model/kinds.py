"""Kinds of measurement beyond poses and positions: sockets, distances, reflectors, tilts.

A distance is measured from a point (draw wire, ball bar, ball on a sphere) or from a plane (dial gauge, probe on a
table). A direction is fitted as a vector of three numbers, with one more equation that keeps its length at one. SI
units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.base import register
from pickenv.calibration.model import observations
from pickenv.calibration.model.arm_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, ArmModel, Conditions
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import NONE_KNOWN, Observations, Origins, Rows, Stated, worked_out

# The point of the tool that an instrument sees or touches: where a wire is hooked, a ball's centre, a probe's tip. It
# is stated in the tool's frame, exactly, within an uncertainty, or not at all; every instrument has its own. SI
# units.


TIP = ("tip_x", "tip_y", "tip_z")
"""Names of the tool point's coordinates."""

Tip = tuple[float, float, float]
ORIGIN: Tip = (0.0, 0.0, 0.0)


def tool_points(model: ArmModel, joints: Array, conditions: Conditions, tip: Array) -> Array:
    """Return the world positions ``(N, 3)``, m, of a point of the tool.

    Args:
        model: The arm.
        joints: Joints ``(N, n)``, rad or m.
        conditions: Payload, temperature and torques, where known.
        tip: The point in the tool's frame ``(3,)``, m.
    """
    pose = model.pose(joints, conditions)
    return np.asarray(pose.position + pose.rotation @ tip)


def tool_points_jacobian(model: ArmModel, joints: Array, conditions: Conditions, tip: Array) -> tuple[Array, Array]:
    """Return derivatives of `tool_points` with respect to arm parameters ``(N, 3, P)`` and ``tip`` ``(N, 3, 3)``."""
    rotation = model.pose(joints, conditions).rotation
    return observations.point_jacobian(model.jacobian(joints, conditions), rotation @ tip), rotation


SurfaceName = Literal["point", "plane"]

STEPS = 20
"""Number of iterations of the fits that are robust against gross errors."""

FAR = 5.0
"""A plane is fitted without points whose distance from it exceeds this many median distances."""


def direction(vector: Array) -> tuple[Array, Array]:
    """Return the unit vector ``(3,)`` along a vector, and its derivative ``(3, 3)`` with respect to that vector."""
    size = float(np.linalg.norm(vector))
    ahead = vector / size
    return ahead, (np.eye(3) - np.outer(ahead, ahead)) / size


def unit_length(vector: Array) -> tuple[Array, Array]:
    """Return 1 minus a vector's length, to first order ``(1,)``, and the derivative of the length ``(1, 3)``."""
    return np.array([(1.0 - vector @ vector) / 2.0]), vector[None]


def steady_solution(matrix: Array, right: Array) -> Array:
    """Return the solution ``(k,)`` of least absolute errors of linear equations; a few gross errors hardly change it.

    The method is iteratively re-weighted least squares.

    Args:
        matrix: Matrix of the equations ``(R, k)``.
        right: Right-hand side ``(R,)``.
    """
    weights: Array = np.ones(len(right))
    solution: Array = np.zeros(matrix.shape[1])
    for _ in range(STEPS):
        solution = np.asarray(np.linalg.lstsq(matrix * weights[:, None], right * weights, rcond=None)[0], dtype=float)
        errors = np.abs(right - matrix @ solution)
        weights = 1.0 / np.sqrt(np.maximum(errors, 0.1 * float(np.median(errors)) + 1e-12))
    return solution


def _normal(points: Array) -> Array:
    """Return the normal ``(3,)`` of the plane nearest to points ``(N, 3)``; points far off the plane are left out."""
    near, axes = np.ones(len(points), dtype=bool), np.eye(3)
    for _ in range(STEPS):
        middle = points[near].mean(axis=0)
        axes = np.linalg.svd(points[near] - middle)[2]
        off = np.abs((points - middle) @ axes[2])
        before, near = near, off <= FAR * max(float(np.median(off)), 1e-9)
        if near.sum() < 4 or np.array_equal(before, near):
            break
    return np.asarray(axes[2])


class _Point:
    """A fixed point that distances are measured from; the base class of all surfaces.

    Every surface is described by K numbers ``values``; for a point they are its coordinates. ``names`` are the numbers'
    names, and ``tolerances`` the numbers' typical deviations ``(K,)``, m or rad. ``gap`` gives the distances ``(N,)``,
    m, of points ``(N, 3)`` from the surface, with derivatives by the points ``(N, 3)`` and by the numbers ``(N, K)``.
    ``start`` gives first values of the numbers and of the zero of the readings. ``gauge`` gives G equations for
    numbers that distances do not determine, such as the length of a plane's normal: residual ``(G,)`` and derivatives
    ``(G, K)``.
    """

    names: tuple[str, ...] = ("anchor_x", "anchor_y", "anchor_z")
    tolerances: Array = np.full(3, LENGTH_TOLERANCE)

    @staticmethod
    def gap(values: Array, points: Array) -> tuple[Array, Array, Array]:
        away = points - values
        size = np.linalg.norm(away, axis=1)
        along = away / np.maximum(size, 1e-12)[:, None]
        return size, along, -along

    @staticmethod
    def start(points: Array, readings: Array, zero: float, unknown: bool) -> tuple[Array, float]:
        """Return first values of the centre A ``(3,)`` and of the readings' zero z, m.

        A point p at the distance r from A has the reading l = r + z. Thus |p|^2 - l^2 = 2 p.A - 2 l z + z^2 - |A|^2,
        which is linear in A, z and the constant z^2 - |A|^2.

        Args:
            points: The points p ``(N, 3)``, m.
            readings: Their readings l ``(N,)``, m.
            zero: The stated zero, m, which is z unless z is unknown.
            unknown: Whether z is unknown.
        """
        middle, begin = points.mean(axis=0), float(readings.mean()) if unknown else zero
        p, length = points - middle, readings - begin
        varied = unknown and float(np.ptp(readings)) > 0.0
        columns = [2.0 * p, np.ones((len(p), 1)), *([-2.0 * length[:, None]] if varied else [])]
        solution = steady_solution(np.hstack(columns), np.sum(p**2, axis=1) - length**2)
        at, constant = solution[: p.shape[1]], float(solution[p.shape[1]])
        if varied:
            begin += float(solution[-1])
        elif unknown:
            begin -= float(np.sqrt(max(constant + float(at @ at), 0.0)))
        return middle + at, begin

    @staticmethod
    def gauge(values: Array) -> tuple[Array, Array]:
        return np.zeros(0), np.zeros((0, len(values)))


class _Plane(_Point):
    """A plane, described by a normal of length one and the plane's distance from the origin."""

    names = ("normal_x", "normal_y", "normal_z", "plane_offset")
    tolerances = np.array([ANGLE_TOLERANCE] * 3 + [LENGTH_TOLERANCE])

    @staticmethod
    def gap(values: Array, points: Array) -> tuple[Array, Array, Array]:
        normal, by_vector = direction(values[:3])
        by_point = np.broadcast_to(normal, points.shape)
        return points @ normal - values[3], by_point, np.column_stack([points @ by_vector, -np.ones(len(points))])

    @staticmethod
    def start(points: Array, readings: Array, zero: float, unknown: bool) -> tuple[Array, float]:
        """Return an estimate of the plane, from which a fit starts, and ``zero`` as it was given, m.

        Of two directions, the plane's normal is the one that explains the readings better. The first direction is the
        shortest axis of the points. The second is the direction along which the readings grow.

        Args:
            points: The points ``(N, 3)``, m.
            readings: Their readings ``(N,)``, m.
            zero: The stated zero, m.
            unknown: Without effect for a plane.
        """
        shortest = _normal(points)
        matrix = np.column_stack([points - points.mean(axis=0), np.ones(len(points))])
        slope = steady_solution(matrix, readings)[:3]
        candidates = [shortest, *([slope / np.linalg.norm(slope)] if np.linalg.norm(slope) > 1e-9 else [])]

        def spread(normal: Array) -> float:
            offsets = points @ normal - readings
            return float(np.median(np.abs(offsets - np.median(offsets))))

        normal = min(candidates, key=spread)
        return np.append(normal, np.median(points @ normal - readings)), zero

    @staticmethod
    def gauge(values: Array) -> tuple[Array, Array]:
        short, by_vector = unit_length(values[:3])
        return short, np.append(by_vector, [[0.0]], axis=1)


SURFACES: dict[SurfaceName, type[_Point]] = {"point": _Point, "plane": _Plane}
"""Classes of surfaces by name."""


# Places that a tool point rests in, again and again: sockets, or one point that is touched in many poses. SI units.


@register("observation", "sockets")
@dataclass(frozen=True, eq=False)
class SocketObservations(Observations):
    """Poses in which a point of the tool rests in fixed places: sockets, or one point that is touched repeatedly.

    The places are unknown. Known spacings of some pairs of sockets add equations.

    Attributes:
        joints: Joints ``(N, n)``, rad or m.
        socket: Number of the place in which the tool point rests in each pose ``(N,)``, from 0.
        pairs: Numbers, from 0, of the sockets of each pair of known spacing ``(M, 2)``; without a pair the scale of
            the arm is unobservable.
        spacing: Spacing of each pair ``(M,)``, m.
        std: Standard uncertainty of a coordinate of the tool point in its place, m.
        spacing_std: Standard uncertainty of a spacing, m.
        places: Names of the places; if empty they are named socket1, socket2 and so on.
        tip: The point of the tool that rests in the sockets, in the tool's frame, m.
        tip_std: Standard uncertainty of a coordinate of ``tip``, m: 0 if it is exact, infinite if it is unknown.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        origins: File and line of each row; None if the rows come from no file.
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

    @worked_out
    def sized(self) -> bool:
        """Whether the spacing of any sockets is known."""
        return len(self.pairs) > 0

    @cached_property
    def _names(self) -> tuple[str, ...]:
        last = max(self.socket.max(initial=-1), self.pairs.max(initial=-1))  # a pair may be of a socket without rows
        return self.places or tuple(f"socket{i + 1}" for i in range(int(last) + 1))

    @cached_property
    def numbers(self) -> Stated:
        """Coordinates of the sockets, which are unknown, and then of the tool point ``tip``."""
        count = 3 * len(self._names)
        return Stated(
            (*(f"{name}_{axis}" for name in self._names for axis in "xyz"), *TIP),
            np.array([*range(count), *self.tip], dtype=float),
            np.array([*[np.inf] * count, *[self.tip_std] * 3]),
            np.full(count + 3, LENGTH_TOLERANCE),
        )

    @property
    def groups(self) -> Rows:
        """Number, from 0, of each row's socket ``(N,)``; splits by these groups train on rows of every socket."""
        return self.socket

    def span(self, tool: Array) -> float:
        """Return the largest distance of the tool positions ``tool`` ``(N, 3)`` from their mean, m."""
        return float(np.linalg.norm(tool - tool.mean(axis=0), axis=1).max())

    def missed(self, model: ArmModel, numbers: Array) -> Array:
        """Return socket minus predicted tool point ``(N, 3)``, m."""
        sockets, ball = numbers[:-3].reshape(-1, 3), tool_points(model, self.joints, self.conditions, numbers[-3:])
        return np.asarray(sockets[self.socket] - ball)

    def readings(self) -> Array:
        """Return the number, from 0, of each row's socket ``(N, 1)``."""
        return self.socket[:, None].astype(float)

    def start(self, model: ArmModel) -> Array:
        """Return starting values of the unknowns: each socket at the median of the tool point's predicted positions.

        The median is robust against gross errors. The tool point starts at ``tip``.
        """
        ball = tool_points(model, self.joints, self.conditions, np.array(self.tip))
        rests = [ball[self.socket == i] for i in range(len(self._names))]
        sockets = [np.median(points if len(points) else ball, axis=0) for points in rests]
        return np.concatenate([*sockets, self.tip])[self.numbers.free]

    def derivatives(self, model: ArmModel, numbers: Array) -> tuple[Array, Array]:
        """Return whitened derivatives of tool point minus socket.

        Returns:
            Derivatives with respect to the arm's P parameters ``(N, 3, P)`` and the instrument's numbers ``(N, 3, K)``.
        """
        by_model, by_tip = tool_points_jacobian(model, self.joints, self.conditions, numbers[-3:])
        places = np.eye(len(self._names))[self.socket]
        by_socket = -np.einsum("ns,ij->nisj", places, np.eye(3)).reshape(*by_tip.shape[:2], -1)
        return by_model / self.std, np.concatenate([by_socket, by_tip], axis=-1) / self.std

    def bonds(self, numbers: Array) -> tuple[Array, Array]:
        """Return whitened equations of the known spacings: residual ``(M,)`` and derivatives ``(M, K)``."""
        (first, second), sockets = self.pairs.T, numbers[:-3].reshape(-1, 3)
        difference = sockets[first] - sockets[second]
        apart = np.linalg.norm(difference, axis=1)
        along = difference / apart[:, None] / self.spacing_std
        places = np.eye(len(sockets))
        by_sockets = np.einsum("ms,mj->msj", places[first] - places[second], along).reshape(-1, sockets.size)
        return (self.spacing - apart) / self.spacing_std, np.pad(by_sockets, ((0, 0), (0, 3)))


# Distances of one tool point from a point or a plane: draw wire, ball bar, sphere, plane, dial gauge.
# The reading is (1 + scale) * distance + zero; where something merely touches, every reading is the same. What the
# point or plane is, and as much of scale, zero and tool point as is not known, are found together with the arm.
# SI units.


SCALE_TOLERANCE = 1e-3
"""Typical deviation from 1 of the factor on a distance reading."""


@register("observation", "distances")
@dataclass(frozen=True, eq=False)
class DistanceObservations(Observations):
    """Distances of a point of the tool from a point or plane that does not move.

    An uncertainty is 0 if the number is exact, and infinite if the number is unknown.

    Attributes:
        joints: Joints ``(N, n)``, rad or m.
        length: Readings ``(N,)``, m.
        std: Standard uncertainty of a reading, m.
        surface: What the distance is measured from: a draw wire's anchor or a sphere's centre ("point"), or a plane
            ("plane"). A distance from a plane is signed; its ``zero`` is not fitted, because the plane's offset absorbs
            it.
        zero: The reading at distance 0, m.
        zero_std: Standard uncertainty of ``zero``, m.
        scale_std: Standard uncertainty of the reading's scale factor, which is expected at 1.
        tip: The point of the tool, in the tool's frame, m.
        tip_std: Standard uncertainty of a coordinate of ``tip``, m.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        kind: Name of the kind.
        origins: File and line of each row; None if the rows come from no file.
    """

    joints: Array
    length: Array
    std: float
    surface: SurfaceName = "point"
    zero: float = 0.0
    zero_std: float = 0.0
    scale_std: float = 0.0
    tip: Tip = ORIGIN
    tip_std: float = 0.0
    conditions: Conditions = NONE_KNOWN
    source: str = "wire lengths"
    kind: str = "distance"
    framed: bool = False
    origins: Origins | None = None
    per_row = ("length",)

    @worked_out
    def sized(self) -> bool:
        """Whether the readings' scale is known or, if all readings are equal, whether the distance itself is known."""
        if np.ptp(self.length) > 0.0:
            return bool(np.isfinite(self.scale_std))
        return bool(self.surface != "plane" and np.isfinite(self.zero_std) and self.length[0] != self.zero)

    @cached_property
    def numbers(self) -> Stated:
        """Numbers of the point or plane, then the instrument's zero, scale and tool point."""
        surface, zero_std = SURFACES[self.surface], 0.0 if self.surface == "plane" else self.zero_std
        return Stated(
            (*surface.names, "zero", "scale", *TIP),
            np.array([*np.ones(len(surface.names)), self.zero, 0.0, *self.tip]),
            np.array([*[np.inf] * len(surface.names), zero_std, self.scale_std, *[self.tip_std] * 3]),
            np.array([*surface.tolerances, LENGTH_TOLERANCE, SCALE_TOLERANCE, *[LENGTH_TOLERANCE] * 3]),
        )

    def missed(self, model: ArmModel, numbers: Array) -> Array:
        """Return measured minus predicted readings ``(N, 1)``, m."""
        *values, zero, scale = numbers[:-3]
        points = tool_points(model, self.joints, self.conditions, numbers[-3:])
        distance = SURFACES[self.surface].gap(np.array(values), points)[0]
        return np.asarray(self.length - (1.0 + scale) * distance - zero)[:, None]

    def readings(self) -> Array:
        """Return the measured lengths ``(N, 1)``, m."""
        return self.length[:, None]

    def start(self, model: ArmModel) -> Array:
        """Return starting values of the unknowns; the point or plane is fitted to the predicted tool points."""
        points = tool_points(model, self.joints, self.conditions, np.array(self.tip))
        place, zero = SURFACES[self.surface].start(points, self.length, self.zero, bool(np.isinf(self.zero_std)))
        return np.concatenate([place, [zero, 0.0], self.tip])[self.numbers.free]

    def derivatives(self, model: ArmModel, numbers: Array) -> tuple[Array, Array]:
        """Return whitened derivatives of the predicted readings.

        Returns:
            Derivatives with respect to the arm's parameters ``(N, P)`` and to the instrument's numbers ``(N, K)``.
        """
        values, scale, tip = numbers[:-5], numbers[-4], numbers[-3:]
        points = tool_points(model, self.joints, self.conditions, tip)
        distance, by_point, by_place = SURFACES[self.surface].gap(values, points)
        by_model, by_tip = tool_points_jacobian(model, self.joints, self.conditions, tip)
        along = by_point * (1.0 + scale) / self.std
        by_own = np.column_stack([by_place * (1.0 + scale), np.ones(len(distance)), distance]) / self.std
        return np.einsum("ni,nip->np", along, by_model), np.hstack([by_own, np.einsum("ni,nij->nj", along, by_tip)])

    def bonds(self, numbers: Array) -> tuple[Array, Array]:
        """Return the G equations of the surface's numbers.

        A plane has one equation: its normal has length one. A point has none. The equation is weighted as strongly as
        all readings together.

        Args:
            numbers: All of the instrument's numbers ``(K,)``.

        Returns:
            Whitened residual ``(G,)`` and derivatives ``(G, K)``.
        """
        std = self.std / float(np.sqrt(max(len(self.joints), 1)))
        residual, by_values = SURFACES[self.surface].gauge(numbers[:-5])
        return residual / std, np.pad(by_values, ((0, 0), (0, 5))) / std


# Reflectors on the tool, several at once: where each is seen, and where it sits, known or found. SI units.


@register("observation", "reflectors")
@dataclass(frozen=True, eq=False)
class ReflectorObservations(Observations):
    """Measured positions of k reflectors that are fixed to the tool; in some poses only some of them are seen.

    Attributes:
        joints: Joints ``(N, n)``, rad or m.
        points: Measured positions ``(N, k, 3)``, m, in the instrument's frame; values of reflectors not seen are
            ignored.
        seen: Whether each reflector was seen ``(N, k)``.
        std: Standard uncertainty of a coordinate of a point, m.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        origins: File and line of each row; None if the rows come from no file.
        places: Stated positions of the reflectors in the tool's frame ``(k, 3)``, m; None if they are unknown.
        places_std: Standard uncertainty of a coordinate of ``places``, m; 0 if they are exact.
    """

    joints: Array
    points: Array
    seen: NDArray[np.bool_]
    std: float
    conditions: Conditions = NONE_KNOWN
    source: str = "reflectors"
    kind: str = "reflectors"
    framed: bool = True
    origins: Origins | None = None
    places: Array | None = None
    places_std: float = np.inf
    per_row = ("points", "seen")
    width = 3

    @property
    def rows_of_misses(self) -> Rows:
        """Index, from 0, of each miss's row ``(R,)``; there is one miss per reflector seen."""
        return np.nonzero(self.seen)[0]

    def imagined(self, joints: Array) -> Self:
        """Return a data set of the same instrument at other joints ``(M, n)``, as if every reflector were seen."""
        return Observations.imagined(replace(self, seen=np.ones_like(self.seen)), joints)

    def readings(self) -> Array:
        """Return the measured points ``(N, 3 k)``, m, with zeros for reflectors that were not seen."""
        return np.where(self.seen[..., None], self.points, 0.0).reshape(len(self.joints), -1)

    @cached_property
    def numbers(self) -> Stated:
        """Coordinates of the reflectors in the tool's frame, with their stated values and uncertainties."""
        count = 3 * self.points.shape[1]
        names = tuple(f"reflector{i + 1}_{axis}" for i in range(self.points.shape[1]) for axis in "xyz")
        values = np.zeros(count) if self.places is None else self.places.ravel()
        std = np.full(count, np.inf if self.places is None else self.places_std)
        return Stated(names, values, std, np.full(count, LENGTH_TOLERANCE))

    def start(self, model: ArmModel) -> Array:
        """Return starting values of the reflectors' places: the stated ones, or measured ones (`seen_from`)."""
        return self.seen_from(model).ravel() if self.places is None else self.numbers.start()

    @property
    def clearest(self) -> int:
        """Index, from 0, of the reflector that is seen most often."""
        return int(np.argmax(self.seen.sum(axis=0)))

    def rough_poses(self, prismatic: tuple[bool, ...]) -> Measurements:
        """Return the positions of the reflector that is seen most often, as `Measurements`; they start the fit."""
        rows = self.seen[:, self.clearest]
        seen = self.joints[rows], self.points[rows, self.clearest], None, prismatic
        return Measurements(*seen, source=self.source, conditions=self.conditions.select(rows))

    def seen_from(self, model: ArmModel) -> Array:
        """Return each reflector's mean position in the tool's frame ``(k, 3)``, m, by the measured points.

        Args:
            model: The arm, which predicts the tool's pose in each row.
        """
        tool = model.pose(self.joints, self.conditions)
        local = np.einsum("nij,nki->nkj", tool.rotation, self.points - tool.position[:, None])
        weight = self.seen[..., None] / np.maximum(self.seen.sum(axis=0), 1)[:, None]
        return np.asarray(np.sum(np.where(self.seen[..., None], local, 0.0) * weight, axis=0))

    def missed(self, model: ArmModel, numbers: Array) -> Array:
        """Return measured minus predicted positions of the reflectors seen ``(R, 3)``, m."""
        tool = model.pose(self.joints, self.conditions)
        predicted = tool.position[:, None] + np.einsum("nij,kj->nki", tool.rotation, numbers.reshape(-1, 3))
        return np.asarray((self.points - predicted)[self.seen])

    def derivatives(self, model: ArmModel, numbers: Array) -> tuple[Array, Array]:
        """Return whitened derivatives of the R predicted positions.

        Returns:
            Derivatives with respect to the arm's P parameters ``(R, 3, P)`` and to the reflectors' coordinates
            ``(R, 3, 3 k)``.
        """
        tool, pose = model.pose(self.joints, self.conditions), model.jacobian(self.joints, self.conditions)
        count = self.points.shape[1]
        lever = np.einsum("nij,kj->nki", tool.rotation, numbers.reshape(-1, 3))
        by_arm = observations.point_jacobian(pose[:, None], lever)[self.seen]
        by_place = np.einsum("nij,kl->nkilj", tool.rotation, np.eye(count)).reshape(len(self.joints), count, 3, -1)
        return by_arm / self.std, by_place[self.seen] / self.std


# Which way is down, as an inclinometer or accelerometer on the tool tells it: one to three components of gravity. It
# sees angles only: no length of the arm, and nothing of a motion about the vertical. Down in the arm's world (how far
# the base stands from level) and the sensor's axes on the tool are found together with the arm. SI units.


DOWN = np.array([0.0, 0.0, -1.0])
"""Unit vector that points down in the world of an arm whose base is level."""


@register("observation", "tilt")
@dataclass(frozen=True, eq=False)
class TiltObservations(Observations):
    """Components of the direction of gravity along K axes fixed to the tool.

    Attributes:
        joints: Joints ``(N, n)``, rad or m.
        components: Cosine of the angle between down and each axis ``(N, K)``, K from 1 to 3.
        std: Standard uncertainty of each component ``(N, K)``, rad.
        axes_std: Standard uncertainty of each component of an axis's unit vector. It is 0 if the axes are x, y and z
            of the tool, and infinite if the axes are unknown.
        down_std: Standard uncertainty of each component of the unit vector that points down. It is 0 if the arm's world
            is level, and infinite if the direction is unknown.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        origins: File and line of each row; None if the rows come from no file.
    """

    joints: Array
    components: Array
    std: Array
    axes_std: float = np.inf
    down_std: float = np.inf
    conditions: Conditions = NONE_KNOWN
    source: str = "inclinometer"
    kind: str = "tilt"
    origins: Origins | None = None
    per_row = ("components", "std")
    miss_unit = "deg"
    rounding = 1e-5
    sized = False

    @worked_out
    def framed(self) -> bool:
        """Whether the world is known to be level; only then do the readings show how the base is tilted."""
        return self.down_std == 0.0

    @worked_out
    def width(self) -> int:
        """Number of equations per row: one for each of the K components."""
        return int(self.components.shape[1])

    @cached_property
    def numbers(self) -> Stated:
        """Components of the axes, then of the down direction."""
        count = self.components.shape[1]
        return Stated(
            (*[f"axis{i + 1}_{axis}" for i in range(count) for axis in "xyz"], "down_x", "down_y", "down_z"),
            np.concatenate([np.eye(3)[:count].ravel(), DOWN]),
            np.repeat([self.axes_std, self.down_std], [3 * count, 3]),
            np.full(3 * count + 3, ANGLE_TOLERANCE),
        )

    def readings(self) -> Array:
        """Return the measured components ``(N, K)``."""
        return self.components

    def start(self, model: ArmModel) -> Array:
        """Return starting values of the unknown axes and down direction, each of length one.

        A reading is linear in the products of an axis' components with the components of down. The matrix of these
        products has rank one.
        """
        rotation, count = model.pose(self.joints, self.conditions).rotation, self.components.shape[1]
        values = self.numbers.values.copy()
        axes, down = values[:-3].reshape(-1, 3), values[-3:]
        if self.axes_std and self.down_std:
            flat = rotation.reshape(-1, 9)
            products = [steady_solution(flat, reading).reshape(3, 3) for reading in self.components.T]
            u, _, vt = np.linalg.svd(np.hstack(products))
            sign = 1.0 if u[2, 0] < 0.0 else -1.0  # the other answer hangs the arm from the ceiling
            down, axes = sign * u[:, 0], sign * vt[0].reshape(count, 3)
        elif self.down_std:
            down = steady_solution(np.concatenate([rotation @ axis for axis in axes]), self.components.T.ravel())
        elif self.axes_std:
            local = np.swapaxes(rotation, 1, 2) @ down
            axes = np.array([steady_solution(local, reading) for reading in self.components.T])
        parts = [part / max(float(np.linalg.norm(part)), 1e-12) for part in (*axes, down)]
        return np.concatenate(parts)[self.numbers.free]

    def missed(self, model: ArmModel, numbers: Array) -> Array:
        """Return measured minus predicted components ``(N, K)``, rad.

        With three axes, the norm of a row is the angle between the measured and the predicted direction.
        """
        *axes, down = (direction(vector)[0] for vector in numbers.reshape(-1, 3))
        local = np.swapaxes(model.pose(self.joints, self.conditions).rotation, 1, 2) @ down
        return np.asarray(self.components - local @ np.array(axes).T)

    def derivatives(self, model: ArmModel, numbers: Array) -> tuple[Array, Array]:
        """Return whitened derivatives of the predicted components.

        Returns:
            Derivatives with respect to the arm's parameters ``(N, K, P)``, and to the components of axes and down
            direction ``(N, K, 3 K + 3)``.
        """
        *axes, (down, by_down) = (direction(vector) for vector in numbers.reshape(-1, 3))
        rotation = model.pose(self.joints, self.conditions).rotation
        turned = model.jacobian(self.joints, self.conditions)[:, 3:]
        local = np.swapaxes(rotation, 1, 2) @ down
        by_model = np.zeros((*self.components.shape, turned.shape[-1]))
        by_own = np.zeros((*self.components.shape, len(numbers)))
        for k, (axis, by_axis) in enumerate(axes):
            ahead = rotation @ axis
            by_model[:, k] = np.einsum("ni,nip->np", np.cross(ahead, down), turned)
            by_own[:, k, 3 * k : 3 * k + 3] = local @ by_axis
            by_own[:, k, -3:] = ahead @ by_down
        return by_model / self.std[..., None], by_own / self.std[..., None]

    def bonds(self, numbers: Array) -> tuple[Array, Array]:
        """Return G equations that keep fitted directions at length one, weighted as strongly as all readings together.

        Returns:
            Residual ``(G,)`` and derivatives ``(G, 3 K + 3)`` with respect to axes and down direction.
        """
        fitted = np.flatnonzero(self.numbers.std.reshape(-1, 3).all(axis=1))
        strong = np.sqrt(len(self.joints)) / float(np.median(self.std))
        residual, jacobian = np.zeros(len(fitted)), np.zeros((len(fitted), len(numbers)))
        for row, i in enumerate(fitted):
            (residual[row],), jacobian[row, 3 * i : 3 * i + 3] = unit_length(numbers[3 * i : 3 * i + 3])
        return residual * strong, jacobian * strong
