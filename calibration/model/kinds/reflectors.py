"""Reflectors on the tool, several at once: where each is seen, and where it sits, known or found. SI units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.error_model import LENGTH_TOLERANCE
from pickenv.calibration.model.kinds.stated import Stated
from pickenv.calibration.model.observations import (
    NONE_KNOWN,
    OneGroup,
    one_channel,
    point_jacobian,
    repeated_at,
    selected,
)
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.model.splits import Rows


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
