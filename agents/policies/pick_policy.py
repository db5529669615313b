"""A scripted policy for `pickenv/Pick-v0`: from below, wait until the arm has settled, grasp, twist, retreat.

It uses the observation alone. It trusts the nominal arm, so what it collects shows what the arm's errors cost. It moves
gently enough not to bruise what it meets; `HASTY` does neither and shows what that costs. How it does each is an
argument, so that it can be learnt (`pickenv.agents.training.policy_search`). Units: m, rad, s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.agents.policies.policy import ReachController
from pickenv.arm import Array, Pose, displace_pose, forward, inverse, joint_jacobian
from pickenv.envs import CONTROL_PERIOD

ARRIVED = 2e-4
"""A joint within this of its goal is there, m or rad."""

PASSED = 10.0
"""Places on the way count as reached within so many times that."""

GENTLE = 0.75
"""Share of the speed that bruises fruit at which the tool moves: it leaves room for swing and following error."""

HASTY: dict[str, Any] = {"settle": 0.0, "tool_speed": np.inf}
"""Arguments of `ScriptedPick` for full speed without waiting."""

OUT, BELOW, AT = range(3)
"""Places on the way to a fruit: below the last one, below this one, and there."""


class ScriptedPick(ReachController):
    """Comes to each fruit from below; `settle` seconds of standing still before it grasps.

    Arguments are numbers, or one for each environment of a vector.
    """

    def __init__(
        self,
        env: Any,
        settle: ArrayLike = 0.5,
        approach: ArrayLike = 0.10,
        tool_speed: ArrayLike | None = None,
        *,
        gain: ArrayLike = 1.0,
        arrived: ArrayLike = ARRIVED,
        aim: ArrayLike = (0.0, 0.0, 0.0),
        patience: ArrayLike = np.inf,
        iterations: int = 25,
    ) -> None:
        """Read the arm from ``env``, a `pickenv/Pick-v0`, single or native vector, wrapped or not.

        Args:
            env: The environment.
            settle: Time without motion before the grasp, s; at most 1.
            approach: Length of the straight way from below, m.
            tool_speed: Largest speed of the believed tool, m/s, gentle when left out; joint speeds hold in any case.
            gain: Share of what is left of a way that one action commands; less than 1 where readings are late.
            arrived: A joint within this of its goal is there, m or rad.
            aim: How far beside the fruit as seen the tool goes ``(..., 3)``, base frame, m.
            patience: Time for one fruit after which the gripper closes as soon as it can, s.
            iterations: Steps of the inverse; fewer leave joints less near to mid-range, and are sooner done.
        """
        super().__init__(env)
        gentle = GENTLE * env.unwrapped.orchard.station.bruise_speed
        self.settle, self.approach, self.aim = (np.asarray(value, dtype=float) for value in (settle, approach, aim))
        self.tool_speed = np.asarray(gentle if tool_speed is None else tool_speed, dtype=float)
        self.gain, self.arrived, self.patience = (np.asarray(value, dtype=float) for value in (gain, arrived, patience))
        self.iterations = iterations
        self.reset()

    def reset(self) -> None:
        """Forget the last canopy."""
        self._begin(0)

    def _begin(self, count: int) -> None:
        n = self.geometry.joints
        self._fruit, self._way = np.full((count, 3), np.nan), np.full((count, AT + 1, n), np.nan)
        self._place, self._spent = np.full(count, BELOW), np.zeros(count)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action ``(n + 1,)``, or actions ``(N, n + 1)`` for observations of as many environments."""
        values = np.asarray(observation, dtype=float)
        single, values = values.ndim == 1, np.atleast_2d(values)
        if len(self._fruit) != len(values):
            self._begin(len(values))
        n, rows = self.geometry.joints, np.arange(len(values))
        joints = self.geometry.lower + (values[:, :n] + 1.0) / 2.0 * (self.geometry.upper - self.geometry.lower)
        fruit, turn, still = values[:, n + 3 : n + 6], values[:, n + 9 : n + 12], values[:, n + 12]
        hanging, off = values[:, n + 14] > 0.5, values[:, n + 15] > 0.5
        seeking = ~(hanging | off)
        new = np.flatnonzero(seeking & ~np.isclose(fruit, self._fruit, atol=1e-6).all(axis=-1))
        if single and new.size:
            self._plan(0, joints[0], fruit[0], turn[0])
        elif new.size:
            self._plan(new, joints[new], fruit[new], turn[new])
        for _ in (OUT, BELOW):
            near = self._away(joints, self._way[rows, self._place]) < self.arrived * PASSED
            self._place += seeking & (self._place < AT) & near
        goals = self._way[rows, np.where(off, BELOW, self._place)]
        # Standing still is asked of the command: corrections smaller than the encoders' counts would never end.
        arrived = seeking & (self._place == AT) & (self._away(joints, goals) < self.arrived)
        stays = hanging | arrived | np.isnan(goals[:, 0])
        late = seeking & (self._spent * CONTROL_PERIOD >= self.patience)
        closes = hanging | late | (arrived & (still >= self.settle - 1e-3))
        self._spent += 1.0
        away = np.where(stays[:, None], 0.0, goals - joints)
        if single:
            return np.asarray([*self._shares(joints[0], away[0]), float(closes[0])], dtype=np.float32)
        return np.concatenate([self._shares(joints, away), closes[:, None]], axis=-1, dtype=np.float32)

    def _plan(self, rows: Any, joints: Array, seen: Array, turn: Array) -> None:
        """Waypoints: down from the last fruit, below the next one, and up to it."""
        believed_pose = forward(self.geometry, joints)
        upright = displace_pose(believed_pose, np.concatenate([np.zeros_like(turn), turn], axis=-1)).rotation
        aim = np.broadcast_to(self.aim, self._fruit.shape)[rows]
        down = np.broadcast_to(self.approach, len(self._fruit))[rows][..., None] * np.array([0.0, 0.0, 1.0])
        at = self._solve(seen + aim, upright, joints)
        last, below = self._way[rows, BELOW], self._solve(seen + aim - down, upright, at)
        self._place[rows] = np.where(np.isnan(last[..., 0]), BELOW, OUT)
        self._way[rows, OUT], self._way[rows, BELOW], self._way[rows, AT] = last, below, at
        self._fruit[rows], self._spent[rows] = seen, 0.0

    def _solve(self, position: Array, rotation: Array, start: Array) -> Array:
        pose = Pose(position, rotation)
        most = self.iterations
        return inverse(self.geometry, pose, start, attitude_tolerance=1e-3, max_iterations=most, restarts=0).joints

    @staticmethod
    def _away(joints: Array, goals: Array) -> Array:
        return np.asarray(np.abs(goals - joints).max(axis=-1))

    def _shares(self, joints: Array, away: Array) -> Array:
        """Shares of the joints' increments, in step with each other, so that the tool's way is nearly straight."""
        step = self.gain[..., None] * away
        share = step / self.increment
        way = np.linalg.norm((joint_jacobian(self.geometry, joints)[..., :3, :] @ step[..., None])[..., 0], axis=-1)
        most = np.maximum(np.abs(share).max(axis=-1), way / (self.tool_speed * CONTROL_PERIOD))
        return np.asarray(share / np.maximum(1.0, most)[..., None])
