"""Scripted policies: what a controller with a perfect nominal model would do."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Geometry, Pose, displace_pose, forward, inverse
from pickenv.arm.geometry import Array
from pickenv.errors import InputError


class ScriptedReach:
    """Solve the nominal inverse kinematics for the fruit once per episode, then drive straight to those joints.

    It uses the observation alone: joint readings, and the offset and attitude between believed tool and fruit.
    """

    def __init__(self, env: Any) -> None:
        """Read the arm's nominal geometry and increments from ``env``, a `pickenv/Reach-v0`, wrapped or not."""
        inner = env.unwrapped
        self.geometry: Geometry = inner.plant.arm.nominal
        self.increment = np.array(inner.increment)
        self._wanted: Array | None = None

    def reset(self) -> None:
        """Forget the last episode's fruit."""
        self._wanted = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action.

        Raises:
            InputError: If the fruit cannot be reached by the nominal arm.
        """
        geometry, n = self.geometry, self.geometry.joints
        values = np.asarray(observation, dtype=float)
        joints = geometry.lower + (values[:n] + 1.0) / 2.0 * (geometry.upper - geometry.lower)
        if self._wanted is None:
            wanted = displace_pose(forward(geometry, joints), values[n + 6 : n + 12])
            self._wanted = self._solve(Pose(values[n + 3 : n + 6], wanted.rotation))
        return np.asarray(((self._wanted - joints) / self.increment).clip(-1.0, 1.0), dtype=np.float32)

    def _solve(self, target: Pose) -> Array:
        solution = inverse(self.geometry, target, attitude_tolerance=1e-4)
        if not solution.reached:
            raise InputError(
                f"the fruit at {np.round(target.position * 1e3)} mm cannot be reached: "
                f"{solution.position_error * 1e3:.1f} mm and {np.degrees(solution.attitude_error):.2f} deg remain; "
                "choose a goal inside the joint limits"
            )
        return solution.joints
