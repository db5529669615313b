"""What a data set of any kind must answer; the kinds beyond `Measurements` stand in `pickenv.calibration.model.kinds`.

Each kind brings unknowns of its own (where the reflectors sit, the wire is anchored, the sockets are), which are
identified together with the arm. Rows are whitened by their covariance, so any mix may be stacked. SI units.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Any, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.error_model import LENGTH_TOLERANCE
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.model.splits import Rows

MISS_UNITS = {"mm": 1e3, "deg": float(np.degrees(1.0))}
"""What misses are shown in, and the factor from SI."""

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

    @property
    def sized(self) -> bool:
        """Whether a known length takes part, without which nobody can say how large the arm is."""

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


@runtime_checkable
class Imaginable(Equations, Protocol):
    """Equations that can be asked at other poses before anything is measured there."""

    def imagined(self, joints: Array) -> Equations:
        """What such an instrument would be asked at other joints ``(M, n)``; only kind and uncertainties are real."""


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

    @property
    def miss_unit(self) -> str:
        """What screens show `misses` in: "mm" of metres, "deg" of radians."""

    def equations(self) -> tuple[Rows, Rows]:
        """Row and channel of each equation of `residual` ``(E,)``; the row is -1 where it belongs to none.

        A channel is what is read in one unit with one uncertainty: of poses positions and attitudes are two.
        """

    def select(self, rows: Rows) -> Self:
        """The data set that holds only the given rows."""

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Measured minus predicted positions ``(R, 3)``, or lengths ``(R, 1)``, m; of directions ``(R, k)``, rad."""

    def readings(self) -> Array:
        """What was read in each row ``(N, k)``, m: rows equal in it and in the joints repeat one another."""

    def fingerprint(self) -> str:
        """Hash of the numbers, which a calibration records."""


class OneGroup:
    """Rows that a split may part anywhere, each of which misses once."""

    joints: Array

    @property
    def miss_unit(self) -> str:
        """Misses are lengths."""
        return "mm"

    @property
    def sized(self) -> bool:
        """Lengths are measured."""
        return True

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


def repeated_at(data: Kind, joints: Array, *names: str) -> Kind:
    """A data set at other joints ``(M, n)``, whose readings of these names are those it has, over and over."""
    rows = np.resize(np.arange(len(data.joints)), len(joints))
    changed: dict[str, Any] = {name: getattr(data, name)[rows] for name in names}
    return replace(data, joints=joints, conditions=Conditions(), origins=None, **changed)  # type: ignore[type-var]


def origins_of(data: Observations) -> Origins:
    """File and line of each row; rows that come from no file are counted from 1."""
    count = len(data.joints)
    return data.origins or Origins((data.source,), np.zeros(count, dtype=np.int64), np.arange(1, count + 1))


def point_jacobian(pose_jacobian: Array, lever: Array) -> Array:
    """Jacobian ``(..., 3, P)`` of a point that lies ``lever`` ``(..., 3)`` (world axes) from the tool's origin."""
    turn = pose_jacobian[..., 3:, :]
    return np.asarray(pose_jacobian[..., :3, :] + np.cross(turn, lever[..., :, None], axis=-2))


def nearest_rotation(matrix: Array) -> Array:
    """The rotations nearest to matrices ``(..., 3, 3)`` (orthogonal Procrustes with positive determinant)."""
    u, _, vt = np.linalg.svd(matrix)
    signs = np.ones(matrix.shape[:-1])
    signs[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * signs[..., None, :]) @ vt)
