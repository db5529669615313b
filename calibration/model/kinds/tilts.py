"""Which way is down, as an inclinometer or accelerometer on the tool tells it: one to three components of gravity.

It sees angles only: no length of the arm, and nothing of a motion about the vertical. Down in the arm's world (how far
the base stands from level) and the sensor's axes on the tool are found together with the arm. SI units.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.error_model import ANGLE_TOLERANCE
from pickenv.calibration.model.kinds.stated import Stated
from pickenv.calibration.model.kinds.surfaces import direction, steady_solution, unit_length
from pickenv.calibration.model.observations import NONE_KNOWN, OneGroup, one_channel, repeated_at, selected
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.model.splits import Rows

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
