"""Places that a tool point rests in, again and again: sockets, or one point that is touched in many poses. SI units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.error_model import LENGTH_TOLERANCE
from pickenv.calibration.model.kinds.stated import Stated
from pickenv.calibration.model.kinds.tool_point import ORIGIN, TIP, Tip, tool_points, tool_points_jacobian
from pickenv.calibration.model.observations import NONE_KNOWN, OneGroup, one_channel, repeated_at, selected
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.model.splits import Rows


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

    @property
    def sized(self) -> bool:
        """Whether a spacing is known."""
        return len(self.pairs) > 0

    @cached_property
    def _stated(self) -> Stated:
        """The tool point."""
        return Stated(TIP, np.array(self.tip), np.full(3, self.tip_std), np.full(3, LENGTH_TOLERANCE))

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return self.places or tuple(f"socket{i + 1}" for i in range(int(self.socket.max()) + 1))

    def _parts(self, unknowns: Array) -> tuple[Array, Array]:
        """The sockets ``(S, 3)``, and the fitted numbers of the tool point."""
        count = 3 * len(self._names)
        return unknowns[:count].reshape(-1, 3), unknowns[count:]

    @property
    def groups(self) -> Rows:
        """Each socket's rows are a group, so that each is trained on."""
        return self.socket

    def imagined(self, joints: Array) -> Self:
        """What it would be asked at other joints ``(M, n)``."""
        return repeated_at(self, joints, "socket")

    def select(self, rows: Rows) -> Self:
        """The data set that holds only the given rows."""
        return selected(self, rows, "socket")

    def misses(self, model: ArmModel, unknowns: Array) -> Array:
        """Socket minus ball."""
        sockets, own = self._parts(unknowns)
        return np.asarray(
            sockets[self.socket] - tool_points(model, self.joints, self.conditions, self._stated.whole(own))
        )

    def readings(self) -> Array:
        """The sockets' numbers."""
        return self.socket[:, None].astype(float)

    def equations(self) -> tuple[Rows, Rows]:
        """Three for each row, then the spacings, and what is known of the tool point."""
        rows = np.repeat(np.arange(len(self.joints)), 3)
        extra = len(self.pairs) + len(self._stated.jacobian())
        return one_channel(np.concatenate([rows, np.full(extra, -1)]))

    def unknowns(self) -> tuple[str, ...]:
        """Positions of the sockets, and the tool point where it is not known."""
        return (*(f"{name}_{axis}" for name in self._names for axis in "xyz"), *self._stated.unknowns())

    def start(self, model: ArmModel) -> Array:
        """The median of the ball's positions in each socket, which a few gross rows hardly move."""
        ball = tool_points(model, self.joints, self.conditions, np.array(self.tip))
        rests = [ball[self.socket == i] for i in range(len(self._names))]
        sockets = [np.median(rest if len(rest) else ball, axis=0) for rest in rests]
        return np.concatenate([*sockets, self._stated.start()])

    def residual(self, model: ArmModel, unknowns: Array) -> Array:
        """Socket minus ball, measured minus predicted spacings, and the tool point, in standard uncertainties."""
        sockets, own = self._parts(unknowns)
        rest = self.misses(model, unknowns) / self.std
        apart = np.linalg.norm(sockets[self.pairs[:, 0]] - sockets[self.pairs[:, 1]], axis=1)
        return np.concatenate([rest.ravel(), (self.spacing - apart) / self.spacing_std, self._stated.residual(own)])

    def jacobian(self, model: ArmModel, unknowns: Array) -> tuple[Array, Array]:
        """Derivatives of ball minus socket, of the spacings and of the tool point."""
        sockets, own = self._parts(unknowns)
        by_model, by_tip = tool_points_jacobian(model, self.joints, self.conditions, self._stated.whole(own))
        flat = by_model.reshape(-1, by_model.shape[-1]) / self.std
        chosen = np.eye(len(sockets))[self.socket]
        rest = -np.einsum("ns,ij->nisj", chosen, np.eye(3)).reshape(-1, sockets.size) / self.std
        difference = sockets[self.pairs[:, 0]] - sockets[self.pairs[:, 1]]
        along = difference / np.linalg.norm(difference, axis=1, keepdims=True) / self.spacing_std
        signs = np.eye(len(sockets))[self.pairs[:, 0]] - np.eye(len(sockets))[self.pairs[:, 1]]
        apart = np.einsum("ms,mj->msj", signs, along).reshape(-1, sockets.size)
        known = self._stated.jacobian()
        by_unknown = block_diag(np.concatenate([rest, apart]), known)
        by_unknown[: len(rest), sockets.size :] = by_tip.reshape(-1, 3)[:, self._stated.free] / self.std
        extra = np.zeros((len(apart) + len(known), flat.shape[1]))
        return np.concatenate([flat, extra]), by_unknown
