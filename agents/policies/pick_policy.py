"""A scripted policy for `pickenv/Pick-v0`: from below, wait until the arm has settled, grasp, twist, retreat.

It uses the observation alone. It trusts the nominal arm, so what it collects shows what the arm's errors cost. It moves
gently enough not to bruise what it meets; `HASTY` does neither and shows what that costs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import ReachController
from pickenv.arm import Pose, displace_pose, forward, inverse, joint_jacobian
from pickenv.arm.kinematics.geometry import Array
from pickenv.envs.shared.situation import CONTROL_PERIOD

ARRIVED = 2e-4
"""A joint within this of its goal is there, m or rad."""

GENTLE = 0.75
"""Share of the speed that bruises fruit at which the tool moves: it leaves room for swing and following error."""

HASTY = {"settle": 0.0, "tool_speed": np.inf}
"""Arguments of `ScriptedPick` for full speed without waiting."""


class ScriptedPick(ReachController):
    """Comes to each fruit from below; `settle` seconds of standing still before it grasps."""

    def __init__(self, env: Any, settle: float = 0.5, approach: float = 0.10, tool_speed: float | None = None) -> None:
        """Read the arm from ``env``, a `pickenv/Pick-v0`, wrapped or not.

        Args:
            env: The environment.
            settle: Time without motion before the grasp, s; at most 1.
            approach: Length of the straight way from below, m.
            tool_speed: Largest speed of the believed tool, m/s, gentle when left out; joint speeds hold in any case.
        """
        super().__init__(env)
        gentle = GENTLE * env.unwrapped.orchard.station.bruise_speed
        self.settle, self.approach = settle, approach
        self.tool_speed = gentle if tool_speed is None else tool_speed
        self.reset()

    def reset(self) -> None:
        """Forget the last canopy."""
        self._fruit: Array | None = None
        self._way: list[Array] = []
        self._exit: Array | None = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action."""
        values = np.asarray(observation, dtype=float)
        n = self.geometry.joints
        span = self.geometry.upper - self.geometry.lower
        joints = self.geometry.lower + (values[:n] + 1.0) / 2.0 * span
        seen, turn, still = values[n + 3 : n + 6], values[n + 9 : n + 12], values[n + 12]
        hanging, off = values[n + 14] > 0.5, values[n + 15] > 0.5
        if hanging:
            return self._step(joints, joints, 1.0)
        if off:
            return self._step(joints, self._below_now(joints), 0.0)
        if self._fruit is None or not np.allclose(seen, self._fruit, atol=1e-6):
            self._plan(joints, seen, turn)
        while len(self._way) > 1 and np.abs(self._way[0] - joints).max() < ARRIVED * 10:
            self._way.pop(0)
        if len(self._way) == 1 and np.abs(self._way[0] - joints).max() < ARRIVED:
            # Standing still is asked of the command: corrections smaller than the encoders' counts would never end.
            return self._step(joints, joints, 1.0 if still >= self.settle - 1e-3 else 0.0)
        return self._step(joints, self._way[0], 0.0)

    def _plan(self, joints: Array, seen: Array, turn: Array) -> None:
        """Waypoints: down from the last fruit, below the next one, and up to it."""
        here = forward(self.geometry, joints)
        upright = displace_pose(here, np.concatenate([np.zeros(3), turn])).rotation
        down = self.approach * np.array([0.0, 0.0, 1.0])
        at = self._solve(seen, upright, joints)
        below = self._solve(seen - down, upright, at)
        self._way = [below, at]
        if self._fruit is not None and self._exit is not None:
            self._way.insert(0, self._exit)
        self._fruit, self._exit = seen.copy(), below

    def _below_now(self, joints: Array) -> Array:
        """Where the tool goes with a fruit in hand: the place below the fruit from which it came."""
        return joints if self._exit is None else self._exit

    def _solve(self, position: Array, rotation: Array, start: Array) -> Array:
        pose = Pose(position, rotation)
        return inverse(self.geometry, pose, start, attitude_tolerance=1e-3, max_iterations=25, restarts=0).joints

    def _step(self, joints: Array, goal: Array, gripper: float) -> NDArray[np.float32]:
        """Joints in step with each other, so that the tool's way is nearly straight."""
        away = goal - joints
        share = away / self.increment
        way = float(np.linalg.norm(joint_jacobian(self.geometry, joints)[:3] @ away))
        share /= max(1.0, float(np.abs(share).max()), way / (self.tool_speed * CONTROL_PERIOD))
        return np.asarray([*share, gripper], dtype=np.float32)
