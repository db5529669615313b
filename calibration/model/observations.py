"""What a data set must answer, and its kinds beyond `Measurements`: reflector groups, draw-wire lengths, sockets.

Each kind brings unknowns of its own (where the reflectors sit, the wire is anchored, the sockets are), which are
identified together with the arm. Rows are whitened by their covariance, so any mix may be stacked. SI units.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.error_model import LENGTH_TOLERANCE
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.model.splits import Rows

NONE_KNOWN = Conditions()
"""Neither payload nor temperature nor torques were recorded."""


Kind = TypeVar("Kind", bound="Observations")


class Equations(Protocol):
    """What the least squares asks of a data set of any kind, and of what is expected before measuring."""

    @property
    def joints(self) -> Array:
        """Joints ``(N, n)``, rad or m."""

    @property
    def source(self) -> str:
        """Where the data come from."""

    @property
    def kind(self) -> str:
        """Name of the kind."""

    @property
    def framed(self) -> bool:
        """Whether the instrument has a frame, so that the arm's base pose can be seen at all."""

    def unknowns(self) -> tuple[str, ...]:
        """Names of the kind's own unknowns."""

    def tolerances(self) -> Array:
        """Scale of each one's deviation, in its unit (lengths: m)."""

    def start(self, model: ArmModel) -> Array:
        """Closed-form values of the unknowns for a model."""

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted, whitened, ``(rows,)``."""

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Whitened derivatives by the model ``(rows, 5n + 12 + k)`` and by the unknowns ``(rows, own)``."""


class Observations(Equations, Protocol):
    """A data set of any kind: rows that can be chosen, told apart, and compared with a model in metres."""

    @property
    def conditions(self) -> Conditions:
        """Payload, temperature and torques, where known."""

    @property
    def origins(self) -> Origins | None:
        """File and line of each row; None where they come from no file."""

    @property
    def groups(self) -> Rows:
        """Rows of one number belong together ``(N,)``, and a split takes its share of each (sockets)."""

    @property
    def rows_of_misses(self) -> Rows:
        """The row that each of `misses` belongs to ``(R,)``."""

    def equations(self) -> tuple[Rows, Rows]:
        """Row and channel of each equation of `residual` ``(E,)``; the row is -1 where it belongs to none.

        A channel is what is read in one unit with one uncertainty: of poses positions and attitudes are two.
        """

    def select(self, rows: Rows) -> Self:
        """The data set that holds only the given rows."""

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted positions ``(R, 3)``, or lengths ``(R, 1)``, m."""

    def readings(self) -> Array:
        """What was read in each row ``(N, k)``, m: rows equal in it and in the joints repeat one another."""

    def fingerprint(self) -> str:
        """Hash of the numbers, which a calibration records."""


class OneGroup:
    """Rows that a split may part anywhere, each of which misses once."""

    joints: Array

    def fingerprint(self) -> str:
        """Of joints and readings."""
        return hash_of(self.joints, self.readings())

    def readings(self) -> Array:
        """What was read in each row ``(N, k)``."""
        raise NotImplementedError

    def unknowns(self) -> tuple[str, ...]:
        """None of its own."""
        return ()

    def tolerances(self) -> Array:
        """Of lengths."""
        return np.full(len(self.unknowns()), LENGTH_TOLERANCE)

    @property
    def groups(self) -> Rows:
        """All rows are of one group."""
        return np.zeros(len(self.joints), dtype=np.int64)

    @property
    def rows_of_misses(self) -> Rows:
        """One miss per row."""
        return np.arange(len(self.joints))

    def equations(self) -> tuple[Rows, Rows]:
        """One for each row, all of one channel."""
        return one_channel(np.arange(len(self.joints)))


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

    @property
    def rows_of_misses(self) -> Rows:
        """One miss per reflector seen."""
        return np.nonzero(self.seen)[0]

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
        """Three for each reflector seen."""
        return one_channel(np.repeat(self.rows_of_misses, 3))

    def unknowns(self) -> tuple[str, ...]:
        """Reflector positions in the tool's frame."""
        return tuple(f"reflector{i + 1}_{axis}" for i in range(self.points.shape[1]) for axis in "xyz")

    def start(self, model: ArmModel) -> Array:
        """Mean of the measured points as the nominal tool sees them."""
        tool = model.pose(self.joints, self.conditions)
        local = np.einsum("nij,nki->nkj", tool.rotation, self.points - tool.position[:, None])
        weight = self.seen[..., None] / np.maximum(self.seen.sum(axis=0), 1)[:, None]
        return np.asarray(np.sum(np.where(self.seen[..., None], local, 0.0) * weight, axis=0).ravel())

    def predict(self, model: ArmModel, unknowns: Array) -> Array:
        """Predicted points ``(N, k, 3)``, m."""
        tool = model.pose(self.joints, self.conditions)
        return np.asarray(tool.position[:, None] + np.einsum("nij,kj->nki", tool.rotation, unknowns.reshape(-1, 3)))

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Whitened differences of the reflectors seen."""
        error = self.points - self.predict(model, unknowns)
        return np.asarray(np.einsum("nkij,nkj->nki", self._whitening(), error)[self.seen].ravel())

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Derivatives of the reflectors seen."""
        tool, pose = model.pose(self.joints, self.conditions), model.jacobian(self.joints, self.conditions)
        count = self.points.shape[1]
        lever = np.einsum("nij,kj->nki", tool.rotation, unknowns.reshape(-1, 3))
        by_geometry = point_jacobian(pose[:, None], lever)
        by_unknown = np.einsum("nij,kl->nkilj", tool.rotation, np.eye(count)).reshape(len(self.joints), count, 3, -1)
        whitening = self._whitening()
        stacked = [np.einsum("nkij,nkjp->nkip", whitening, part)[self.seen] for part in (by_geometry, by_unknown)]
        return stacked[0].reshape(-1, pose.shape[-1]), stacked[1].reshape(-1, 3 * count)

    def _whitening(self) -> Array:
        return np.broadcast_to(whitening_of(self.covariance), (*self.points.shape, 3))


@dataclass(frozen=True, eq=False)
class DistanceObservations(OneGroup):
    """Lengths of a wire between the tool's origin and an unknown fixed anchor (draw-wire sensor, ball bar).

    Attributes:
        joints: ``(N, n)``, rad or m.
        length: Measured lengths ``(N,)``, m.
        std: Standard uncertainty of a length, m.
        conditions: Payload, temperature and torques, where known.
        source: Where the data come from.
        origins: File and line of each row; None where they come from no file.
    """

    joints: Array
    length: Array
    std: float
    conditions: Conditions = NONE_KNOWN
    source: str = "wire lengths"
    kind: str = "distance"
    framed: bool = False
    origins: Origins | None = None

    def select(self, rows: Rows) -> Self:
        """The data set that holds only the given rows."""
        return selected(self, rows, "length")

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted lengths."""
        return np.asarray(self.residual(model, unknowns)[:, None] * self.std)

    def readings(self) -> Array:
        """The lengths."""
        return self.length[:, None]

    def unknowns(self) -> tuple[str, ...]:
        """The anchor."""
        return ("anchor_x", "anchor_y", "anchor_z")

    def start(self, model: ArmModel) -> Array:
        """Trilateration: |p|^2 - l^2 = 2 p.A - |A|^2 is linear in the anchor A and |A|^2."""
        p = model.pose(self.joints, self.conditions).position
        right = np.sum(p**2, axis=1) - self.length**2
        solution = np.linalg.lstsq(np.column_stack([2 * p, -np.ones(len(p))]), right, rcond=None)[0]
        return np.asarray(solution[:3])

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted length, in standard uncertainties."""
        away = model.pose(self.joints, self.conditions).position - unknowns
        return np.asarray((self.length - np.linalg.norm(away, axis=1)) / self.std)

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """The pose Jacobian along the wire."""
        away = model.pose(self.joints, self.conditions).position - unknowns
        along = away / np.linalg.norm(away, axis=1, keepdims=True) / self.std
        pose = model.jacobian(self.joints, self.conditions)[:, :3]
        return np.asarray(np.einsum("ni,nip->np", along, pose)), -along


@dataclass(frozen=True, eq=False)
class SocketObservations(OneGroup):
    """A ball on the tool rests in sockets that do not move: no metrology but the known spacing of some sockets.

    Attributes:
        joints: ``(N, n)``, rad or m.
        socket: Number of the socket that each pose rests in ``(N,)``, from 0.
        pairs: Sockets of known spacing ``(M, 2)``; without them the scale of the arm is unobservable.
        spacing: Their spacings ``(M,)``, m.
        std: Standard uncertainty of a ball's rest, m.
        spacing_std: Standard uncertainty of a spacing, m.
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
    conditions: Conditions = NONE_KNOWN
    source: str = "sockets"
    kind: str = "sockets"
    framed: bool = False
    origins: Origins | None = None

    @property
    def groups(self) -> Rows:
        """Each socket's rows are a group, so that each is trained on."""
        return self.socket

    def select(self, rows: Rows) -> Self:
        """The data set that holds only the given rows."""
        return selected(self, rows, "socket")

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Socket minus ball."""
        return np.asarray(self.residual(model, unknowns)[: 3 * len(self.joints)].reshape(-1, 3) * self.std)

    def readings(self) -> Array:
        """The sockets' numbers."""
        return self.socket[:, None].astype(float)

    def equations(self) -> tuple[Rows, Rows]:
        """Three for each row, then the spacings."""
        rows = np.repeat(np.arange(len(self.joints)), 3)
        return one_channel(np.concatenate([rows, np.full(len(self.pairs), -1)]))

    def unknowns(self) -> tuple[str, ...]:
        """Positions of the sockets."""
        return tuple(f"socket{i + 1}_{axis}" for i in range(int(self.socket.max()) + 1) for axis in "xyz")

    def start(self, model: ArmModel) -> Array:
        """Mean of the ball's positions in each socket."""
        ball = model.pose(self.joints, self.conditions).position
        count = np.bincount(self.socket)
        return np.stack([np.bincount(self.socket, ball[:, i]) / count for i in range(3)], -1).ravel()

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Socket minus ball, and measured minus predicted spacings, in standard uncertainties."""
        sockets = unknowns.reshape(-1, 3)
        rest = (sockets[self.socket] - model.pose(self.joints, self.conditions).position) / self.std
        apart = np.linalg.norm(sockets[self.pairs[:, 0]] - sockets[self.pairs[:, 1]], axis=1)
        return np.concatenate([rest.ravel(), (self.spacing - apart) / self.spacing_std])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Derivatives of ball minus socket and of the spacings."""
        sockets = unknowns.reshape(-1, 3)
        pose = model.jacobian(self.joints, self.conditions)[:, :3] / self.std
        by_geometry = np.concatenate([pose.reshape(-1, pose.shape[-1]), np.zeros((len(self.pairs), pose.shape[-1]))])
        chosen = np.eye(len(sockets))[self.socket]
        rest = -np.einsum("ns,ij->nisj", chosen, np.eye(3)).reshape(-1, unknowns.size) / self.std
        difference = sockets[self.pairs[:, 0]] - sockets[self.pairs[:, 1]]
        along = difference / np.linalg.norm(difference, axis=1, keepdims=True) / self.spacing_std
        signs = np.eye(len(sockets))[self.pairs[:, 0]] - np.eye(len(sockets))[self.pairs[:, 1]]
        apart = np.einsum("ms,mj->msj", signs, along).reshape(-1, unknowns.size)
        return by_geometry, np.concatenate([rest, apart])


def hash_of(*parts: Array) -> str:
    """Hash of numbers to 1e-9 m and rad; a trip through a CSV file keeps it."""
    whole = [np.rint(part * 1e9).astype(np.int64) for part in parts]
    return hashlib.sha256(b"".join(part.tobytes() for part in whole)).hexdigest()[:16]


def one_channel(rows: Rows) -> tuple[Rows, Rows]:
    """Equations of these rows, all of one channel."""
    return rows, np.zeros(len(rows), dtype=np.int64)


def selected(data: Kind, rows: ArrayLike, *names: str) -> Kind:
    """Some rows (indices or a mask) of a data set whose arrays of these names, where any, hold one entry per row."""
    rows = np.asarray(rows)
    values: dict[str, Any] = {name: getattr(data, name) for name in ("joints", *names)}
    changed = {name: None if value is None else value[rows] for name, value in values.items()}
    changed |= {"conditions": data.conditions.select(rows), "origins": origins_of(data).select(rows)}
    return replace(data, **changed)  # type: ignore[type-var]


def origins_of(data: Observations) -> Origins:
    """File and line of each row; rows that come from no file are counted from 1."""
    count = len(data.joints)
    return data.origins or Origins((data.source,), np.zeros(count, dtype=np.int64), np.arange(1, count + 1))


def point_jacobian(pose_jacobian: Array, lever: Array) -> Array:
    """Jacobian ``(..., 3, P)`` of a point that lies ``lever`` ``(..., 3)`` (world axes) from the tool's origin."""
    turn = pose_jacobian[..., 3:, :]
    return np.asarray(pose_jacobian[..., :3, :] + np.cross(turn, lever[..., :, None], axis=-2))


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


def nearest_rotation(matrix: Array) -> Array:
    """The rotations nearest to matrices ``(..., 3, 3)`` (orthogonal Procrustes with positive determinant)."""
    u, _, vt = np.linalg.svd(matrix)
    signs = np.ones(matrix.shape[:-1])
    signs[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * signs[..., None, :]) @ vt)
