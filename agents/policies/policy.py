"""Interface of a policy, and the parts of the flat observation of `pickenv/Reach-v0`. SI units.

Policies take one observation ``(k,)`` or a batch ``(N, k)``, and return one action or a batch of actions. The same
policy therefore drives a single environment or a native vector environment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Geometry, Pose, displace_pose, forward, pose_error
from pickenv.base import InputError


class Policy(Protocol):
    """Interface that evaluations need from a policy."""

    def reset(self) -> None:
        """Prepare for a new episode; called at the start of every episode."""

    def act(self, observation: NDArray[np.float32], /) -> NDArray[np.float32]:
        """Return the next action for one observation, or one action for each observation of a batch."""


@dataclass(frozen=True, eq=False)
class ObservationParts:
    """Parts of a flat observation of `pickenv/Reach-v0`. Positions and vectors are in the base frame.

    Attributes:
        joints: Joint readings ``(..., n)``, rad or m.
        believed: Believed tool position ``(..., 3)``, m.
        seen: Fruit position as the camera measured it ``(..., 3)``, m.
        offset: Vector from the believed tool position to the fruit ``(..., 3)``, m.
        turn: Rotation vector from the believed to the wanted tool attitude ``(..., 3)``, rad.
        camera: Vector from the tool's true position to the fruit as the camera measures it ``(..., 3)``, m; None
            without camera feedback.
    """

    joints: Array
    believed: Array
    seen: Array
    offset: Array
    turn: Array
    camera: Array | None


def read_observation(geometry: Geometry, observation: ArrayLike) -> ObservationParts:
    """Split a flat observation of `pickenv/Reach-v0` into its parts.

    Args:
        geometry: Nominal geometry of the arm.
        observation: Observation ``(..., k)``.

    Raises:
        InputError: If the observation has another length than `pickenv/Reach-v0` gives for such an arm.
    """
    values, n = np.asarray(observation, dtype=float), geometry.joints
    if values.shape[-1] not in (n + 12, n + 15):
        raise InputError(
            f"the observation has {values.shape[-1]} numbers; a policy for {n} joints reads {n + 12}, or {n + 15} with "
            "feedback='camera'"
        )
    return ObservationParts(
        joints=geometry.lower + (values[..., :n] + 1.0) / 2.0 * (geometry.upper - geometry.lower),
        believed=values[..., n : n + 3],
        seen=values[..., n + 3 : n + 6],
        offset=values[..., n + 6 : n + 9],
        turn=values[..., n + 9 : n + 12],
        camera=values[..., n + 12 :] if values.shape[-1] == n + 15 else None,
    )


def joined_parts(geometry: Geometry, parts: ObservationParts) -> Array:
    """Join parts into a flat observation ``(..., k)``; the inverse of `read_observation`."""
    scaled = 2.0 * (parts.joints - geometry.lower) / (geometry.upper - geometry.lower) - 1.0
    gaps = [parts.offset, parts.turn, *([] if parts.camera is None else [parts.camera])]
    return np.concatenate([scaled, parts.believed, parts.seen, *gaps], axis=-1)


def attitude_after(pose: Pose, turn: Array) -> Array:
    """Return the attitudes ``(..., 3, 3)`` of ``pose`` rotated by vectors ``turn (..., 3)``, rad, base frame."""
    return displace_pose(pose, np.concatenate([np.zeros_like(turn), turn], axis=-1)).rotation


def camera_of(reading: ObservationParts, policy: str) -> Array:
    """Return the vector from the tool's true position to the fruit, as the camera measured it ``(..., 3)``, m.

    Args:
        reading: Parts of an observation.
        policy: Name of the policy in the error message.

    Raises:
        InputError: If the environment gives no camera measurement.
    """
    if reading.camera is None:
        raise InputError(f"the {policy} policy needs a camera; make the environment with feedback='camera'")
    return reading.camera


class ReachController:
    """Base class of policies that know the nominal arm and turn joint steps into actions.

    If readings or actions are delayed, a reading shows past joints. A policy that commands the whole remaining step
    from such a reading makes the arm oscillate. The controller therefore predicts the joints as the first reading plus
    all increments sent since. Once the arm has stood still for longer than the delays, a reading that differs from the
    prediction replaces it. Measured gaps are shifted to the predicted joints, as in the predictor of Smith (1957).

    Attributes:
        COUNTS: Half an encoder count, rad or m. If a reading at rest differs more from the command, the arm did not
            reach the command.
        STANDING: Share of an increment below which a joint step counts as standing still.
    """

    COUNTS, STANDING = 2e-5, 1e-3

    def __init__(self, env: Any) -> None:
        """Read the nominal geometry and the increments from ``env``, a `pickenv/Reach-v0`, single or native vector."""
        self.env = env.unwrapped
        self.geometry: Geometry = self.env.plant.arm.nominal
        self.increment = np.array(self.env.increment)
        situation = self.env.task.situation
        self.lag = int(situation.latency.high + situation.delay.high)
        self.tolerance = self.COUNTS + 4.0 * situation.joint_noise.high
        self.reset()

    def reset(self) -> None:
        """Forget the last episode; the prediction of joints starts again from the next reading."""
        self._sent: Array | None = None
        self._still: Any = 0

    def commanded(self, readings: Array) -> Array:
        """Return the joints ``(..., n)``, rad or m, to which the arm has been sent.

        If nothing is delayed, the readings are returned.
        """
        if not self.lag:
            return readings
        if self._sent is None or self._sent.shape != readings.shape:
            self._sent, self._still = readings.copy(), np.zeros(readings.shape[:-1], dtype=int)
        apart = np.abs(readings - self._sent)
        elsewhere = (apart > (self.lag + 1) * self.increment).any(axis=-1)  # another episode has begun
        settled = (self._still > self.lag) & (apart > self.tolerance).any(axis=-1)
        self._sent = np.where((elsewhere | settled)[..., None], readings, self._sent)
        return self._sent

    def present(self, observation: ArrayLike) -> ObservationParts:
        """Split an observation into its parts, as they are once the arm has done all commands sent (`commanded`).

        If readings or actions are delayed, the joints and what depends on them are computed for that moment. Without
        delays, the parts are as observed.

        Raises:
            InputError: If the observation has another length than `pickenv/Reach-v0` gives for such an arm.
        """
        late = read_observation(self.geometry, observation)
        if not self.lag:
            return late
        joints = self.commanded(late.joints)
        before, now = forward(self.geometry, late.joints), forward(self.geometry, joints)
        moved = now.position - before.position
        turn = pose_error(now, Pose(now.position, attitude_after(before, late.turn)))[..., 3:]
        camera = None if late.camera is None else late.camera - moved
        return ObservationParts(joints, late.believed + moved, late.seen, late.offset - moved, turn, camera)

    @property
    def settled(self) -> Any:
        """Mask ``(...)`` of the observations whose latest reading was taken after the arm had stopped.

        If nothing is delayed, it is the value True.
        """
        return self._still > self.lag if self.lag else True

    def action(self, step: Array) -> NDArray[np.float32]:
        """Return the actions ``(..., n)`` that move the joints by ``step (..., n)``, rad or m, and record them as sent.

        Actions are shares of the largest increments, clipped to -1 to 1.
        """
        shares = np.asarray((step / self.increment).clip(-1.0, 1.0), dtype=np.float32)
        self.sent(shares)
        return shares

    def sent(self, shares: NDArray[Any]) -> None:
        """Record actions ``(..., n)`` that are about to be sent, each as a share of the joint's increment."""
        if self._sent is not None:
            self._sent = np.clip(self._sent + shares * self.increment, self.geometry.lower, self.geometry.upper)
            self._still = np.where((np.abs(shares) > self.STANDING).any(axis=-1), 0, self._still + 1)
