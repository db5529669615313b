"""A real arm's error in somebody else's environment: success is judged where the true tool is, not where it seems.

Reaching tasks on MuJoCo end where their perfect arm believes to be. Here the environment's own arm is that belief; the
true tool differs from it by what a plant says at the same joints, and the policy never sees it. Metres, radians.
"""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from pickenv.arm import Array, Geometry, Plant, forward, joints_in_mujoco, pose_error
from pickenv.base import InputError
from pickenv.wrappers.compensation import Compensate

FAR = 1e-3
"""Largest distance allowed between the achieved goal and the nominal arm's tool, m."""


class Miscalibrate(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Give the arm of another package's reaching environment on MuJoCo the errors of a real arm.

    The wrapper works on environments with Gymnasium-Robotics' goal interface (`achieved_goal`, `desired_goal`,
    `compute_reward`) whose goal is a position of the tool, commanded by joint or by tool targets. The observation stays
    what the controller believes; reward and `info["is_success"]` judge the true tool. `info` gets `tool_error_mm`, how
    far the true tool is from the believed one, and `true_distance_mm`, how far it is from the goal.

    Example:
        >>> import gymnasium as gym
        >>> from pickenv.wrappers import Miscalibrate
        >>> def with_error(env: gym.Env, plant) -> gym.Env:
        ...     return Miscalibrate(env, plant.arm.nominal, plant)

    Change log:
     * v0.2.0 - Added.
    """

    def __init__(
        self, env: gym.Env[Any, Any], nominal: Geometry, true: Plant | Geometry, compensator: Compensate | None = None
    ) -> None:
        """Wrap ``env``.

        Args:
            env: The environment.
            nominal: The environment's arm as its model has it (`geometry_in_mujoco`), with the model's joint names.
            true: The true arm: a plant without memory, or a geometry.
            compensator: Turns joint targets into commands for the true arm, as a calibration does; None to send targets
                as they are.

        Raises:
            InputError: If ``env`` is no goal environment on MuJoCo, or the arms differ in their number of joints, or
                the plant has effects with a memory.
        """
        RecordConstructorArgs.__init__(self, nominal=nominal, true=true, compensator=compensator)
        gym.Wrapper.__init__(self, env)
        inner: Any = env.unwrapped
        if not hasattr(inner, "compute_reward") or "achieved_goal" not in getattr(env.observation_space, "spaces", {}):
            raise InputError(f"{type(inner).__name__} has no achieved_goal and compute_reward; wrap a goal environment")
        if not (hasattr(inner, "model") and hasattr(inner, "data")):
            raise InputError(f"{type(inner).__name__} has no MuJoCo model and data; wrap an environment on MuJoCo")
        truth = true.geometry if isinstance(true, Plant) else true
        if truth.joints != nominal.joints:
            raise InputError(f"the true arm has {truth.joints} joints, the nominal one {nominal.joints}; give one arm")
        if isinstance(true, Plant) and true.has_state:
            raise InputError(f"plant '{true.name}' has effects with a memory; switch them off (without=…)")
        self._nominal, self._true, self._compensator = nominal, true, compensator

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; `info` gets the entries that the class names."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, self._judged(observation, info)

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment; reward and success judge the true tool."""
        observation, _, terminated, truncated, info = self.env.step(action)
        info = self._judged(observation, info)
        inner: Any = self.env.unwrapped
        reward = inner.compute_reward(self._achieved, observation["desired_goal"], info)
        return observation, float(reward), terminated, truncated, info

    def tool_error(self) -> Array:
        """True minus believed tool position ``(3,)`` at the present joints, m, in the model's world frame."""
        inner: Any = self.env.unwrapped
        joints = joints_in_mujoco(inner.model, inner.data, self._nominal)
        pose = forward(self._nominal, joints)
        command = joints if self._compensator is None else np.asarray(self._compensator(joints), dtype=float)
        true = self._true.tool_pose(command) if isinstance(self._true, Plant) else forward(self._true, command)
        self._believed = pose.position
        return np.asarray(pose_error(pose, true)[:3])

    def _judged(self, observation: Any, info: dict[str, Any]) -> dict[str, Any]:
        error = self.tool_error()
        achieved, desired = (np.asarray(observation[key], dtype=float) for key in ("achieved_goal", "desired_goal"))
        if achieved.shape != (3,) or np.linalg.norm(achieved - self._believed) > FAR:
            wrong = "achieved_goal is not the position of the nominal arm's tool"
            raise InputError(f"{wrong}; wrap a reaching task, and name the site that its goal is of")
        self._achieved = achieved + error
        inner: Any = self.env.unwrapped
        distance = float(np.linalg.norm(self._achieved - desired))
        info = dict(info) | {"tool_error_mm": float(np.linalg.norm(error)) * 1e3, "true_distance_mm": distance * 1e3}
        if hasattr(inner, "_is_success"):
            info["is_success"] = inner._is_success(self._achieved, desired)
        elif "is_success" in info:
            raise InputError(f"{type(inner).__name__} does not say how it judges success (_is_success); add it")
        return info
