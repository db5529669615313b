"""The interface of a policy, and the parts of the flat observation of `pickenv/Reach-v0`. SI units.

Policies take one observation ``(k,)`` or a batch ``(N, k)`` and answer in kind, so that the same policy drives a single
environment and a native vector environment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Geometry, Pose, displace_pose, forward, pose_error
from pickenv.base import InputError
from pickenv.envs import FEEDBACK


class Policy(Protocol):
    """The interface that the evaluation asks of a policy."""

    def reset(self) -> None:
        """Called at the start of every episode."""

    def act(self, observation: NDArray[np.float32], /) -> NDArray[np.float32]:
        """The next action, or actions."""


Maker = TypeVar("Maker", bound=Callable[..., Policy])


def with_traits(
    feedback: tuple[str, ...] = FEEDBACK, *, sequential: bool = False, raw_only: bool = False
) -> Callable[[Maker], Maker]:
    """Say of a function ``(env, seed)`` that makes a policy what comparisons must know; a class has the attributes.

    Args:
        feedback: What the policy can use: "encoders", "camera".
        sequential: Whether it learns from episode to episode; the function then takes the keywords ``camera_noise_mm``,
            per axis, and ``compensation``, what it stands behind, too.
        raw_only: Whether a compensator would only stand in its way.
    """

    def keep(maker: Maker) -> Maker:
        vars(maker).update(feedback=feedback, sequential=sequential, raw_only=raw_only)
        return maker

    return keep


@dataclass(frozen=True, eq=False)
class ObservationParts:
    """A flat observation by its parts.

    Attributes:
        joints: Joint readings ``(..., n)``, rad or m.
        believed: Believed tool position ``(..., 3)``, m.
        seen: Fruit position as the camera saw it ``(..., 3)``, m.
        offset: Fruit minus believed tool ``(..., 3)``, m.
        turn: Rotation vector from believed to wanted attitude ``(..., 3)``, rad.
        camera: Fruit minus true tool as the camera measures it ``(..., 3)``, m, or None without camera feedback.
    """

    joints: Array
    believed: Array
    seen: Array
    offset: Array
    turn: Array
    camera: Array | None


def read_observation(geometry: Geometry, observation: ArrayLike) -> ObservationParts:
    """The parts of an observation ``(..., k)`` of an arm that its controller believes to be ``geometry``.

    Raises:
        InputError: If it has another length than `pickenv/Reach-v0` gives for such an arm.
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
    """The flat observation ``(..., k)`` of parts, in the order of `read_observation`."""
    scaled = 2.0 * (parts.joints - geometry.lower) / (geometry.upper - geometry.lower) - 1.0
    gaps = [parts.offset, parts.turn, *([] if parts.camera is None else [parts.camera])]
    return np.concatenate([scaled, parts.believed, parts.seen, *gaps], axis=-1)


def attitude_after(pose: Pose, turn: Array) -> Array:
    """Attitudes ``(..., 3, 3)`` of poses after rotation vectors ``turn (..., 3)``, rad, in the base frame."""
    return displace_pose(pose, np.concatenate([np.zeros_like(turn), turn], axis=-1)).rotation


def camera_of(reading: ObservationParts, policy: str) -> Array:
    """The camera's offset.

    Raises:
        InputError: If the environment gives none.
    """
    if reading.camera is None:
        raise InputError(f"the {policy} policy needs a camera; make the environment with feedback='camera'")
    return reading.camera


class ReachController:
    """The common part of policies that know the nominal arm: its geometry, and joint steps turned into actions.

    Where readings or actions are delayed, a reading shows the past, and a policy that commands the whole gap from it
    makes the arm swing. The controller then takes the joints to be where it has sent them: at the first reading plus
    its own increments since. It reads again when the arm has stood still for longer than the delays. What is seen is
    moved along, as in the predictor of Smith (1957).
    """

    def __init__(self, env: Any) -> None:
        """Read the nominal geometry and the increments from ``env``, a `pickenv/Reach-v0`, single or native vector."""
        inner = env.unwrapped
        self.geometry: Geometry = inner.plant.arm.nominal
        self.increment = np.array(inner.increment)
        situation = inner.task.situation
        self.lag = int(situation.latency.high + situation.delay.high)
        self.tolerance = COUNTS + 4.0 * situation.joint_noise.high
        self.forget()

    def forget(self) -> None:
        """Begin again with the next reading."""
        self._sent: Array | None = None
        self._still: Any = 0

    def commanded(self, readings: Array) -> Array:
        """Joints that the arm has been sent to ``(..., n)``, rad or m; the readings where nothing is delayed."""
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
        """An observation's parts as they will be where the arm has been sent; as observed where nothing is delayed.

        Raises:
            InputError: As `read_observation` does.
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
        """Whether the present reading was taken after the arm had stopped ``(...)``; True where nothing is delayed."""
        return self._still > self.lag if self.lag else True

    def action(self, step: Array) -> NDArray[np.float32]:
        """Actions for wanted joint steps ``(..., n)``, rad or m."""
        shares = np.asarray((step / self.increment).clip(-1.0, 1.0), dtype=np.float32)
        self.sent(shares)
        return shares

    def sent(self, shares: NDArray[Any]) -> None:
        """Take note of shares of the increments ``(..., n)`` that are about to be sent."""
        if self._sent is not None:
            moved = self._sent + shares * self.increment
            self._sent = np.clip(moved, self.geometry.lower, self.geometry.upper)
            self._still = np.where((np.abs(shares) > STANDING).any(axis=-1), 0, self._still + 1)


COUNTS = 2e-5
"""Half an encoder count, rad or m: a settled arm whose reading is farther from its command is elsewhere."""

STANDING = 1e-3
"""Share of an increment below which a joint step counts as standing still."""
