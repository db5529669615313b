"""Scripted policies: what a controller with a perfect nominal model would do, and one that knows nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import ObservationParts, ReachController, read_observation
from pickenv.arm import Pose, displace_pose, forward, inverse
from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError


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
        believed = forward(self.geometry, reading.joints)
        lag = np.concatenate([np.zeros_like(reading.turn), reading.turn], axis=-1)
        return Pose(reading.seen, displace_pose(believed, lag).rotation)

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
