"""Visual servoing on the camera's view of the gap between tool and fruit (Chaumette and Hutchinson 2006).

The camera says where the fruit is as seen from the true tool; what that differs from the believed gap by is the arm's
error here. It is filtered with a gain and added to the target: with gain 1 every picture is believed at once, with a
smaller one the noise of many is averaged. A picture's delay then only makes the correction late, not unstable. m, rad.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import camera_of, read_observation
from pickenv.agents.policies.scripted import ScriptedReach
from pickenv.arm import joint_jacobian
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.task_space import truncated_inverse
from pickenv.errors import InputError


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
            picture, known = self._pictures[0], self._correction
            self._correction = picture if known is None else known + self.gain * (picture - known)
        wanted = self._wanted
        if self._correction is not None:
            wanted = wanted + np.einsum("...ij,...j->...i", self._back, self._correction)
        wanted = wanted.clip(self.geometry.lower, self.geometry.upper)
        return self.action(wanted - reading.joints)
