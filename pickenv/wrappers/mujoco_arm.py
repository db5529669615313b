"""The arm inside a MuJoCo model: its nominal geometry, its present joints, and a wrapper that gives it an error."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from pickenv.arm import Array, Geometry, Plant, Pose, forward, geometry_from_axes, pose_error
from pickenv.base import InputError
from pickenv.wrappers.compensation import Compensate

SLIDE, HINGE = 2, 3
"""MuJoCo's numbers for sliding and hinged joints, the types that an arm may have."""


def geometry_in_mujoco(model: Any, site: str, joints: Sequence[str] | None = None, data: Any = None) -> Geometry:
    """The nominal geometry of the arm that moves a site, in the model's world frame.

    Args:
        model: `mujoco.MjModel`.
        site: Name of the site at the tool.
        joints: The arm's joints from base to tool; all that move the site when left out.
        data: `mujoco.MjData` with the positions of all other joints; the model's own positions when left out.

    Raises:
        InputError: If MuJoCo, the site or a joint is missing, a joint does not move the site, or is a ball.
    """
    try:
        mujoco: Any = import_module("mujoco")
    except ImportError as error:
        raise InputError("MuJoCo is not installed, and the environment is one of it; pip install mujoco") from error
    if (number := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)) < 0:
        raise InputError(f"the model has no site '{site}'; name the one at the arm's tool")
    chain: list[int] = []
    body = int(model.site_bodyid[number])
    while body > 0:
        first = int(model.body_jntadr[body])
        chain += reversed(range(first, first + int(model.body_jntnum[body])))
        body = int(model.body_parentid[body])
    chain.reverse()
    names = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or f"joint{joint}": joint for joint in chain}
    selection = tuple(joints) if joints is not None else tuple(names)
    if lost := [name for name in selection if name not in names]:
        raise InputError(f"joint '{lost[0]}' does not move site '{site}'; its joints are {', '.join(names)}")
    numbers = [joint for name, joint in names.items() if name in selection]
    kinds = [int(model.jnt_type[joint]) for joint in numbers]
    if not numbers or not set(kinds) <= {SLIDE, HINGE}:
        raise InputError(f"the joints before site '{site}' are not all slides and hinges; name those of the arm")
    still = mujoco.MjData(model)
    if data is not None:
        still.qpos[:] = data.qpos
        still.mocap_pos[:], still.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    still.qpos[model.jnt_qposadr[numbers]] = 0.0
    mujoco.mj_kinematics(model, still)
    ranges = np.array(model.jnt_range[numbers], dtype=float)
    ranges[~((model.jnt_limited[numbers] != 0) & (np.ptp(ranges, axis=1) > 0.0))] = -np.pi, np.pi
    tool = Pose(still.site_xpos[number].copy(), still.site_xmat[number].reshape(3, 3).copy())
    titles, slides = tuple(name for name in names if name in selection), tuple(kind == SLIDE for kind in kinds)
    return geometry_from_axes(titles, slides, still.xanchor[numbers], still.xaxis[numbers], tool, *ranges.T)


def joints_in_mujoco(model: Any, data: Any, geometry: Geometry) -> Array:
    """Present joint displacements ``(n,)``, rad or m, of an arm whose ``geometry`` came from `geometry_in_mujoco`."""
    return np.array([data.qpos[model.joint(name).qposadr[0]] for name in geometry.joint_names])


# A real arm's error in somebody else's environment: success is judged where the true tool is, not where it seems.
# Reaching tasks on MuJoCo end where their perfect arm believes to be. Here the environment's own arm is that belief;
# the true tool differs from it by what a plant says at the same joints, and the policy never sees it. Metres,
# radians.


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
        >>> from pickenv.wrappers import Miscalibrate, geometry_in_mujoco
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
