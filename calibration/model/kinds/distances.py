"""Distances of one tool point from a point, a line or a plane: draw wire, ball bar, sphere, edge, plane, dial gauge.

The reading is (1 + scale) * distance + zero; where something merely touches, every reading is the same. What the point,
line or plane is, and as much of scale, zero and tool point as is not known, are found together with the arm. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.error_model import LENGTH_TOLERANCE
from pickenv.calibration.model.kinds.stated import Stated
from pickenv.calibration.model.kinds.surfaces import SURFACES, Surface, SurfaceName
from pickenv.calibration.model.kinds.tool_point import ORIGIN, TIP, Tip, tool_points, tool_points_jacobian
from pickenv.calibration.model.observations import NONE_KNOWN, OneGroup, one_channel, repeated_at, selected
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.model.splits import Rows

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
