"""The oracle: a policy that knows the true arm. What remains with it, no calibration can remove."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import read_observation
from pickenv.agents.policies.scripted import ScriptedReach
from pickenv.arm import Pose, joint_jacobian, pose_error
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.task_space import truncated_inverse

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
