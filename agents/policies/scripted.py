"""Scripted policies: what a controller with a perfect nominal model would do, and one that knows nothing."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.harvest_policy import ScriptedHarvest
from pickenv.agents.policies.pick_policy import ScriptedPick
from pickenv.agents.policies.policy import (
    ObservationParts,
    Policy,
    ReachController,
    camera_of,
    read_observation,
    with_traits,
)
from pickenv.arm import Array, Pose, displace_pose, forward, inverse, joint_jacobian, pose_error
from pickenv.arm.kinematics.task_space import truncated_inverse
from pickenv.base import InputError, register


class ScriptedReach(ReachController):
    """Solve the nominal inverse kinematics for the fruit once per episode, then drive straight to those joints.

    It uses the observation alone: joint readings, and the offset and attitude between believed tool and fruit.
    """

    def __init__(self, env: Any) -> None:
        """Read the arm's nominal geometry and increments from ``env``, a `pickenv/Reach-v0`, wrapped or not."""
        super().__init__(env)
        self._wanted: Array | None = None

    def reset(self) -> None:
        """Forget the last episode's fruit."""
        self._wanted = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action.

        Raises:
            InputError: If the fruit cannot be reached by the nominal arm.
        """
        reading = read_observation(self.geometry, observation)
        if self._wanted is None:
            self._wanted = self.wanted_joints(reading)
        return self.action(self._wanted - reading.joints)

    def wanted_pose(self, reading: ObservationParts) -> Pose:
        """The pose that the tool shall have: the fruit with its attitude."""
        pose = forward(self.geometry, reading.joints)
        lag = np.concatenate([np.zeros_like(reading.turn), reading.turn], axis=-1)
        return Pose(reading.seen, displace_pose(pose, lag).rotation)

    def wanted_joints(self, reading: ObservationParts) -> Array:
        """Joints that bring the nominal arm's tool to the fruit."""
        target = self.wanted_pose(reading)
        solution = inverse(self.geometry, target, attitude_tolerance=1e-4)
        # A camera's error may put the fruit out of reach by as much; the closest joints are the answer then.
        lost = ~solution.reached & (solution.position_error > 0.1)
        if np.any(lost):
            first = (np.argmax(lost),) if lost.ndim else ()
            raise InputError(
                f"the fruit at {np.round(target.position[first] * 1e3)} mm cannot be reached: "
                f"{solution.position_error[first] * 1e3:.1f} mm and "
                f"{np.degrees(solution.attitude_error[first]):.2f} deg remain; choose a goal inside the joint limits"
            )
        return solution.joints


class RandomReach:
    """Even random actions: what knowing nothing comes to."""

    def __init__(self, env: Any, rng: np.random.Generator) -> None:
        """``env``, single or vector, gives the actions' bounds, ``rng`` every draw."""
        self.space = getattr(env, "single_action_space", env.action_space)
        self.rng = rng

    def reset(self) -> None:
        """Nothing to forget."""

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action."""
        low, high = np.float64(self.space.low), np.float64(self.space.high)
        return np.asarray(self.rng.uniform(low, high, (*np.shape(observation)[:-1], *low.shape)), dtype=np.float32)


# The oracle: a policy that knows the true arm. What remains with it, no calibration can remove.


ITERATIONS = 6
"""Newton steps from the nominal solution; millimetres shrink to nothing in three."""


class OracleReach(ScriptedReach):
    """Solve the inverse kinematics of the true arm at rest, effects included, then drive there.

    It knows neither how gaps lie nor how warm the arm is: effects with a state keep their share of the error.
    """

    def __init__(self, env: Any) -> None:
        """``env`` holds the true arm; its plant is read anew in every episode, for populations of arms."""
        super().__init__(env)
        self._env = env.unwrapped

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action."""
        reading = read_observation(self.geometry, observation)
        if self._wanted is None:
            self._wanted = self._true_joints(self.wanted_joints(reading), self.wanted_pose(reading))
        return self.action(self._wanted - reading.joints)

    def _true_joints(self, joints: Array, wanted: Pose) -> Array:
        plant = self._env.plant
        for _ in range(ITERATIONS):
            error = pose_error(plant.tool_pose(joints), wanted)
            back = truncated_inverse(joint_jacobian(plant.geometry, joints))
            joints = joints + np.einsum("...ij,...j->...i", back, error)
            joints = joints.clip(self.geometry.lower, self.geometry.upper)
        return np.asarray(joints)


# Visual servoing on the camera's view of the gap between tool and fruit (Chaumette and Hutchinson 2006). The camera
# says where the fruit is as seen from the true tool; what that differs from the believed gap by is the arm's error
# here. It is filtered with a gain and added to the target: with gain 1 every picture is believed at once, with a
# smaller one the noise of many is averaged. A picture's delay then only makes the correction late, not unstable. m,
# rad.


class ServoReach(ScriptedReach):
    """Drive to the fruit as it was first seen, and correct by the camera through the nominal Jacobian.

    The Jacobian is truncated to the task's rank, and taken at the nominal solution, where the arm arrives.

    Attributes:
        gain: Share of the newest picture in the correction, above 0 and at most 1.
        delay: Steps by which pictures are late.
    """

    def __init__(self, env: Any, *, gain: float = 0.1, delay: int = 0) -> None:
        """``env`` gives the nominal geometry and the increments.

        Raises:
            InputError: If a setting is impossible.
        """
        super().__init__(env)
        if not 0 < gain <= 1:
            raise InputError(f"gain is {gain}; give a number above 0 and at most 1")
        if delay < 0:
            raise InputError(f"delay is {delay}; give a number of steps not below zero")
        self.gain, self.delay = gain, int(delay)
        self.reset()

    def reset(self) -> None:
        """Forget the last episode's pictures."""
        super().reset()
        self._pictures: deque[Array] = deque(maxlen=self.delay + 1)
        self._correction: Array | None = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action.

        Raises:
            InputError: If the observation holds no camera, or the fruit cannot be reached by the nominal arm.
        """
        reading = read_observation(self.geometry, observation)
        self._pictures.append(camera_of(reading, "servo") - reading.offset)
        if self._wanted is None:
            self._wanted = self.wanted_joints(reading)
            self._back: Array = truncated_inverse(joint_jacobian(self.geometry, self._wanted))[..., :3]
        if len(self._pictures) > self.delay:
            picture, before = self._pictures[0], self._correction
            self._correction = picture if before is None else before + self.gain * (picture - before)
        target = self._wanted
        if self._correction is not None:
            target = target + np.einsum("...ij,...j->...i", self._back, self._correction)
        target = target.clip(self.geometry.lower, self.geometry.upper)
        return self.action(target - reading.joints)


# The same by name, for comparisons: how each is made for an environment.


@register("policy", "random")
@with_traits(("encoders",))
def random(env: Any, seed: int) -> Policy:
    """Even random actions."""
    return RandomReach(env, np.random.default_rng(seed))


@register("policy", "scripted")
@with_traits(("encoders",))
def scripted(env: Any, seed: int = 0) -> Policy:
    """The scripted policy of an environment, which draws nothing.

    Raises:
        InputError: If the environment is none of pickenv's.
    """
    inner = env.unwrapped
    if hasattr(inner, "orchard"):
        return ScriptedPick(env)
    if hasattr(getattr(inner, "task", None), "machine"):
        return ScriptedHarvest(env)
    if not hasattr(inner, "task"):
        raise InputError(f"there is no scripted policy for {type(inner).__name__}; give a policy of your own")
    return ScriptedReach(env)


@register("policy", "oracle")
@with_traits(("encoders",), raw_only=True)
def oracle(env: Any, seed: int) -> Policy:
    """The policy that knows the true arm."""
    return OracleReach(env)


@register("policy", "servo")
@with_traits(("camera",))
def servo(env: Any, seed: int) -> Policy:
    """Visual servoing with its usual gain."""
    return ServoReach(env)
