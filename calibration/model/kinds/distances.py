"""Distances of one tool point from a point, a line or a plane: draw wire, ball bar, sphere, edge, plane, dial gauge.

The reading is (1 + scale) * distance + zero; where something merely touches, every reading is the same. What the point,
line or plane is, and as much of scale, zero and tool point as is not known, are found together with the arm. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE, ArmModel, Conditions
from pickenv.calibration.model.kinds.surfaces import (
    ORIGIN,
    SURFACES,
    TIP,
    Stated,
    Surface,
    SurfaceName,
    Tip,
    direction,
    steady_solution,
    tool_points,
    tool_points_jacobian,
    unit_length,
)
from pickenv.calibration.model.observations import (
    NONE_KNOWN,
    OneGroup,
    Origins,
    Rows,
    one_channel,
    point_jacobian,
    repeated_at,
    selected,
)

SCALE_TOLERANCE = 1e-3
"""Scale of a deviation of a wire's own scale."""


@dataclass(frozen=True, eq=False)
class DistanceObservations(OneGroup):
    """Distances of a point of the tool from a point, line or plane that does not move.

    Each uncertainty is 0 where its number is exact and infinite where it is to be found.

    Attributes:
        joints: ``(N, n)``, rad or m.
        length: Readings ``(N,)``, m.
        std: Standard uncertainty of a reading, m.
        surface: What the distance is measured from: a draw wire's anchor or a sphere's centre ("point"), an edge
            ("line"), or a plane, whose side the sign tells and which has no zero of its own.
        zero: What is read at distance 0, m.
        zero_std: Standard uncertainty of ``zero``, m.
        scale_std: Standard uncertainty of the reading's scale, by which it exceeds 1.
        tip: The point in the tool's frame, m.
        tip_std: Standard uncertainty of a coordinate of ``tip``, m.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        kind: Name of the kind.
        origins: File and line of each row; None where they come from no file.
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

    @property
    def sized(self) -> bool:
        """Whether lengths are read on a known scale, or the distance kept is known."""
        if np.ptp(self.length) > 0.0:
            return bool(np.isfinite(self.scale_std))
        return bool(self.surface != "plane" and np.isfinite(self.zero_std) and self.length[0] != self.zero)

    @property
    def _place(self) -> Surface:
        return SURFACES[self.surface]

    @cached_property
    def _stated(self) -> Stated:
        """The instrument's own numbers: zero, scale and tool point."""
        return Stated(
            ("zero", "scale", *TIP),
            np.array([self.zero, 0.0, *self.tip]),
            np.array([0.0 if self.surface == "plane" else self.zero_std, self.scale_std, *[self.tip_std] * 3]),
            np.array([LENGTH_TOLERANCE, SCALE_TOLERANCE, *[LENGTH_TOLERANCE] * 3]),
        )

    def _parts(self, unknowns: Array) -> tuple[Array, Array, Array]:
        """The surface's numbers, the fitted ones of the instrument, and all of these."""
        own = unknowns[len(self._place.names) :]
        return unknowns[: len(self._place.names)], own, self._stated.whole(own)

    def imagined(self, joints: Array) -> Self:
        """What it would be asked at other joints ``(M, n)``."""
        return repeated_at(self, joints, "length")

    def select(self, rows: Rows) -> Self:
        """The data set that holds only the given rows."""
        return selected(self, rows, "length")

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted readings."""
        values, _, (zero, scale, *tip) = self._parts(unknowns)
        points = tool_points(model, self.joints, self.conditions, np.array(tip))
        return np.asarray(self.length - (1.0 + scale) * self._place.gap(values, points).size - zero)[:, None]

    def readings(self) -> Array:
        """The lengths."""
        return self.length[:, None]

    def equations(self) -> tuple[Rows, Rows]:
        """One for each row, then what is known of the instrument, and what the surface's numbers leave open."""
        extra = len(self._stated.jacobian())
        extra += len(self._place.gauge(np.ones(len(self._place.names)))[0])
        return one_channel(np.concatenate([np.arange(len(self.joints)), np.full(extra, -1)]))

    def unknowns(self) -> tuple[str, ...]:
        """Where the point, line or plane is, and what is not known of the instrument."""
        return (*self._place.names, *self._stated.unknowns())

    def tolerances(self) -> Array:
        """Scale of each one's deviation."""
        return np.concatenate([self._place.tolerances, self._stated.tolerances()])

    def start(self, model: ArmModel) -> Array:
        """Trilateration or a plane through the tool's points, as the model has them."""
        points = tool_points(model, self.joints, self.conditions, np.array(self.tip))
        values, zero = self._place.start(points, self.length, self.zero, bool(np.isinf(self.zero_std)))
        own = self._stated.values.copy()
        own[0] = zero
        return np.concatenate([values, own[self._stated.free]])

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted reading, in standard uncertainties, and the other equations."""
        values, own, _ = self._parts(unknowns)
        read = self.misses(model, unknowns)[:, 0] / self.std
        held = self._place.gauge(values)[0] / self._gauge_std
        return np.concatenate([read, self._stated.residual(own), held])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """The pose Jacobian along the distance."""
        values, _, (_, scale, *tip) = self._parts(unknowns)
        place, count = np.array(tip), len(self.joints)
        gap = self._place.gap(values, tool_points(model, self.joints, self.conditions, place))
        by_model, by_tip = tool_points_jacobian(model, self.joints, self.conditions, place)
        along = gap.by_point * (1.0 + scale) / self.std
        read = np.einsum("ni,nip->np", along, by_model)
        by_own = [
            np.full((count, 1), 1.0 / self.std),
            gap.size[:, None] / self.std,
            np.einsum("ni,nij->nj", along, by_tip),
        ]
        mine = np.hstack([gap.by_values * (1.0 + scale) / self.std, np.hstack(by_own)[:, self._stated.free]])
        known, held = self._stated.jacobian(), self._place.gauge(values)[1] / self._gauge_std
        extra = np.zeros((len(known) + len(held), mine.shape[1]))
        extra[: len(known), gap.by_values.shape[1] :] = known
        extra[len(known) :, : gap.by_values.shape[1]] = held
        return np.concatenate([read, np.zeros((len(extra), read.shape[1]))]), np.concatenate([mine, extra])

    @property
    def _gauge_std(self) -> float:
        """As strong as all readings together: neither they nor it drown the other."""
        return self.std / float(np.sqrt(max(len(self.joints), 1)))


# Reflectors on the tool, several at once: where each is seen, and where it sits, known or found. SI units.


@dataclass(frozen=True, eq=False)
class ReflectorObservations(OneGroup):
    """Positions of k reflectors fixed to the tool, some of them lost in some poses.

    Attributes:
        joints: ``(N, n)``, rad or m.
        points: Measured positions ``(N, k, 3)``, m; values of lost reflectors are ignored.
        seen: Whether each reflector was seen ``(N, k)``.
        covariance: Of one point, m^2: ``(3, 3)``, or ``(N, k, 3, 3)`` for an anisotropic tracker.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        origins: File and line of each row; None where they come from no file.
        places: Where they sit in the tool's frame ``(k, 3)``, m, as far as it is known; None where it is not.
        places_std: Standard uncertainty of a coordinate of these, m; 0 where they are exact.
    """

    joints: Array
    points: Array
    seen: NDArray[np.bool_]
    covariance: Array
    conditions: Conditions = NONE_KNOWN
    source: str = "reflectors"
    kind: str = "reflectors"
    framed: bool = True
    origins: Origins | None = None
    places: Array | None = None
    places_std: float = np.inf

    @property
    def rows_of_misses(self) -> Rows:
        """One miss per reflector seen."""
        return np.nonzero(self.seen)[0]

    def imagined(self, joints: Array) -> Self:
        """What it would be asked at other joints ``(M, n)``, were every reflector seen."""
        each = ["covariance"] if self.covariance.ndim > 2 else []
        return repeated_at(replace(self, seen=np.ones_like(self.seen)), joints, "points", "seen", *each)

    def select(self, rows: Rows) -> Self:
        """The data set that holds only the given rows."""
        return selected(self, rows, "points", "seen", *(["covariance"] if self.covariance.ndim > 2 else []))

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """One per reflector seen."""
        return np.asarray((self.points - self.predict(model, unknowns))[self.seen])

    def readings(self) -> Array:
        """The points seen."""
        return np.where(self.seen[..., None], self.points, 0.0).reshape(len(self.joints), -1)

    def equations(self) -> tuple[Rows, Rows]:
        """Three for each reflector seen, then what is known of their places."""
        known = np.full(len(self._stated.jacobian()), -1)
        return one_channel(np.concatenate([np.repeat(self.rows_of_misses, 3), known]))

    @cached_property
    def _stated(self) -> Stated:
        """Where the reflectors sit, as far as it is known."""
        count = 3 * self.points.shape[1]
        names = tuple(f"reflector{i + 1}_{axis}" for i in range(self.points.shape[1]) for axis in "xyz")
        values = np.zeros(count) if self.places is None else self.places.ravel()
        std = np.full(count, np.inf if self.places is None else self.places_std)
        return Stated(names, values, std, np.full(count, LENGTH_TOLERANCE))

    def unknowns(self) -> tuple[str, ...]:
        """Reflector positions in the tool's frame, unless they are known exactly."""
        return self._stated.unknowns()

    def start(self, model: ArmModel) -> Array:
        """The places stated, or the mean of the measured points as the tool sees them."""
        return self.seen_from(model).ravel() if self.places is None else self._stated.start()

    def seen_from(self, model: ArmModel) -> Array:
        """Mean of the measured points in the frame of a model's tool ``(k, 3)``, m."""
        tool = model.pose(self.joints, self.conditions)
        local = np.einsum("nij,nki->nkj", tool.rotation, self.points - tool.position[:, None])
        weight = self.seen[..., None] / np.maximum(self.seen.sum(axis=0), 1)[:, None]
        return np.asarray(np.sum(np.where(self.seen[..., None], local, 0.0) * weight, axis=0))

    def predict(self, model: ArmModel, unknowns: Array) -> Array:
        """Predicted points ``(N, k, 3)``, m."""
        tool, local = model.pose(self.joints, self.conditions), self._stated.whole(unknowns).reshape(-1, 3)
        return np.asarray(tool.position[:, None] + np.einsum("nij,kj->nki", tool.rotation, local))

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Whitened differences of the reflectors seen, then what is known of their places, likewise."""
        error = self.points - self.predict(model, unknowns)
        white = np.einsum("nkij,nkj->nki", self._whitening(), error)[self.seen]
        return np.concatenate([white.ravel(), self._stated.residual(unknowns)])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Derivatives of the reflectors seen."""
        tool, pose = model.pose(self.joints, self.conditions), model.jacobian(self.joints, self.conditions)
        count = self.points.shape[1]
        lever = np.einsum("nij,kj->nki", tool.rotation, self._stated.whole(unknowns).reshape(-1, 3))
        by_geometry = point_jacobian(pose[:, None], lever)
        by_unknown = np.einsum("nij,kl->nkilj", tool.rotation, np.eye(count)).reshape(len(self.joints), count, 3, -1)
        whitening = self._whitening()
        stacked = [np.einsum("nkij,nkjp->nkip", whitening, part)[self.seen] for part in (by_geometry, by_unknown)]
        by_arm, by_place = stacked[0].reshape(-1, pose.shape[-1]), stacked[1].reshape(-1, 3 * count)
        known = self._stated.jacobian()
        return (
            np.concatenate([by_arm, np.zeros((len(known), pose.shape[-1]))]),
            np.concatenate([by_place[:, self._stated.free], known]),
        )

    def _whitening(self) -> Array:
        return np.broadcast_to(whitening_of(self.covariance), (*self.points.shape, 3))


def whitening_of(covariance: Array) -> Array:
    """W with W C W^T = 1 for covariances C ``(..., 3, 3)``: inverse of the Cholesky factor."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def tracker_covariance(
    points: Array,
    station: Array,
    *,
    adm: tuple[float, float] = (10e-6, 0.3e-6),
    angle: tuple[float, float] = (15e-6, 6e-6),
) -> Array:
    """Anisotropic covariance ``(..., 3, 3)`` of laser-tracker points ``(..., 3)`` seen from ``station`` ``(3,)``.

    Radial and transverse maximum permissible errors grow with distance, a + b L each; half of them is taken as the
    standard uncertainty (Leica AT500: 10 um + 0.3 um/m radial, 15 um + 6 um/m transverse).

    Args:
        points: m.
        station: m.
        adm: (a, b) of the distance meter, m and m/m.
        angle: (a, b) of the angular encoders, m and m/m.
    """
    away = points - station
    distance = np.linalg.norm(away, axis=-1)[..., None, None]
    along = away[..., :, None] * away[..., None, :] / distance**2
    radial, across = ((a + b * distance) / 2 for a, b in (adm, angle))
    return np.asarray(radial**2 * along + across**2 * (np.eye(3) - along))


# Which way is down, as an inclinometer or accelerometer on the tool tells it: one to three components of gravity. It
# sees angles only: no length of the arm, and nothing of a motion about the vertical. Down in the arm's world (how far
# the base stands from level) and the sensor's axes on the tool are found together with the arm. SI units.


DOWN = np.array([0.0, 0.0, -1.0])
"""Down where the arm's base stands level."""


@dataclass(frozen=True, eq=False)
class TiltObservations(OneGroup):
    """Components of the direction of gravity along K axes fixed to the tool.

    Attributes:
        joints: ``(N, n)``, rad or m.
        components: Cosines between down and each axis ``(N, K)``, K from 1 to 3.
        std: Standard uncertainty of each ``(N, K)``, rad.
        axes_std: Of a component of an axis: 0 where the axes are x, y and z of the tool, infinite where they are
            unknown.
        down_std: Of a component of down: 0 where the arm's world is level, infinite where that is unknown.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        origins: File and line of each row; None where they come from no file.
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

    @property
    def framed(self) -> bool:
        """A level world is a frame: the base can be seen to tilt in it."""
        return self.down_std == 0.0

    @property
    def sized(self) -> bool:
        """Angles tell no length."""
        return False

    @property
    def miss_unit(self) -> str:
        """Misses are angles."""
        return "deg"

    @cached_property
    def _stated(self) -> Stated:
        """The axes, then down."""
        count = self.components.shape[1]
        names = [f"axis{i + 1}_{axis}" for i in range(count) for axis in "xyz"]
        return Stated(
            (*names, "down_x", "down_y", "down_z"),
            np.concatenate([np.eye(3)[:count].ravel(), DOWN]),
            np.repeat([self.axes_std, self.down_std], [3 * count, 3]),
            np.full(3 * count + 3, ANGLE_TOLERANCE),
        )

    def imagined(self, joints: Array) -> Self:
        """What it would be asked at other joints ``(M, n)``."""
        return repeated_at(self, joints, "components", "std")

    def select(self, rows: Rows) -> Self:
        """The data set that holds only the given rows."""
        return selected(self, rows, "components", "std")

    def unknowns(self) -> tuple[str, ...]:
        """The axes and down, where they are not known."""
        return self._stated.unknowns()

    def tolerances(self) -> Array:
        """Scales of their deviations."""
        return self._stated.tolerances()

    def readings(self) -> Array:
        """The components."""
        return self.components

    def start(self, model: ArmModel) -> Array:
        """A reading is linear in the products of an axis with down, and a matrix of products has rank one."""
        rotation, count = model.pose(self.joints, self.conditions).rotation, self.components.shape[1]
        values = self._stated.values.copy()
        axes, down = values[:-3].reshape(-1, 3), values[-3:]
        if self.axes_std and self.down_std:
            flat = rotation.reshape(-1, 9)
            products = [steady_solution(flat, reading).reshape(3, 3) for reading in self.components.T]
            left, _, right = np.linalg.svd(np.hstack(products))
            sign = 1.0 if left[2, 0] < 0.0 else -1.0  # the other answer hangs the arm from the ceiling
            down, axes = sign * left[:, 0], sign * right[0].reshape(count, 3)
        elif self.down_std:
            matrix = np.concatenate([rotation @ axis for axis in axes])
            down = steady_solution(matrix, self.components.T.ravel())
        elif self.axes_std:
            local = np.swapaxes(rotation, 1, 2) @ down
            axes = np.array([steady_solution(local, reading) for reading in self.components.T])
        parts = [part / max(float(np.linalg.norm(part)), 1e-12) for part in (*axes, down)]
        return np.concatenate(parts)[self._stated.free]

    def _directions(self, unknowns: Array) -> tuple[list[tuple[Array, Array]], tuple[Array, Array]]:
        """Axes and down at length one, with their derivatives."""
        *axes, down = self._stated.whole(unknowns).reshape(-1, 3)
        return [direction(axis) for axis in axes], direction(down)

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted components, rad: the length of a row of three is the angle between them."""
        axes, (down, _) = self._directions(unknowns)
        local = np.swapaxes(model.pose(self.joints, self.conditions).rotation, 1, 2) @ down
        return np.asarray(self.components - local @ np.array([axis for axis, _ in axes]).T)

    def equations(self) -> tuple[Rows, Rows]:
        """One for each component, then what is known of the directions, and their lengths."""
        extra = len(self._stated.jacobian()) + len(self._lengths(self._stated.start())[0])
        rows = np.repeat(np.arange(len(self.joints)), self.components.shape[1])
        return one_channel(np.concatenate([rows, np.full(extra, -1)]))

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Misses in standard uncertainties, and the other equations."""
        read = self.misses(model, unknowns) / self.std
        return np.concatenate([read.ravel(), self._stated.residual(unknowns), self._lengths(unknowns)[0]])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """By rotations of the tool, and by the directions."""
        axes, (down, by_down) = self._directions(unknowns)
        rotation = model.pose(self.joints, self.conditions).rotation
        turned = model.jacobian(self.joints, self.conditions)[:, 3:]
        local = np.swapaxes(rotation, 1, 2) @ down
        count, width = self.components.shape[1], len(self._stated.names)
        by_model = np.zeros((*self.components.shape, turned.shape[-1]))
        by_own = np.zeros((*self.components.shape, width))
        for k, (axis, by_axis) in enumerate(axes):
            ahead = rotation @ axis
            by_model[:, k] = np.einsum("ni,nip->np", np.cross(ahead, down), turned)
            by_own[:, k, 3 * k : 3 * k + 3] = local @ by_axis
            by_own[:, k, 3 * count :] = ahead @ by_down
        flat = by_model / self.std[..., None], (by_own / self.std[..., None])[..., self._stated.free]
        extra = np.concatenate([self._stated.jacobian(), self._lengths(unknowns)[1]])
        read, mine = (part.reshape(-1, part.shape[-1]) for part in flat)
        return np.concatenate([read, np.zeros((len(extra), read.shape[1]))]), np.concatenate([mine, extra])

    def _lengths(self, unknowns: Array) -> tuple[Array, Array]:
        """That the directions found have length one, as strongly as all readings together."""
        vectors = self._stated.whole(unknowns).reshape(-1, 3)
        fitted = np.flatnonzero(self._stated.std.reshape(-1, 3).all(axis=1))
        strong = np.sqrt(len(self.joints)) / float(np.median(self.std))
        found = [unit_length(vectors[i]) for i in fitted]
        residual = np.concatenate([np.zeros(0), *(short for short, _ in found)]) * strong
        jacobian = np.zeros((len(fitted), len(unknowns)))
        for row, (_, by_vector) in enumerate(found):
            jacobian[row, 3 * row : 3 * row + 3] = by_vector[0] * strong
        return residual, jacobian
