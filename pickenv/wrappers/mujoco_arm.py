"""A real arm's errors in another package's MuJoCo environment, whose success then depends on the tool's true pose.

In such environments the arm has no error. Here the environment's arm is the nominal arm, in which the controller
believes. A plant (the true arm with its errors) or a geometry gives the tool's true pose at the same joints. The policy
never sees this pose. Units: m, rad.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from scipy.spatial.transform import Rotation

from pickenv.arm import Array, Geometry, Plant, Pose, behind, forward, inverse_pose, joints_in_mujoco, pose_error
from pickenv.base import InputError
from pickenv.wrappers.compensation import Compensate

FAR = 1e-3
"""Largest accepted error of the nominal arm's tool: its distance from the achieved goal, m, or the norm of its pose
error relative to the tool's site, m and rad."""


def _physics(env: gym.Env[Any, Any]) -> tuple[Any, Any]:
    """Return the environment's `mujoco.MjModel` and `mujoco.MjData`, which may be inside its `sim`, as in robosuite.

    Raises:
        InputError: If the environment has no such model and data.
    """
    inner: Any = env.unwrapped
    for holder in (inner, getattr(inner, "sim", None)):
        model, data = (getattr(holder, name, None) for name in ("model", "data"))
        model, data = getattr(model, "_model", model), getattr(data, "_data", data)
        if hasattr(model, "jnt_qposadr") and hasattr(data, "qpos"):
            return model, data
    raise InputError(f"{type(inner).__name__} has no MuJoCo model and data; wrap an environment on MuJoCo")


class _Hung:
    """The parts of a model that are fixed to the tool, with a method that shifts them to where the true tool has them.

    The bodies from the last joint to the tool's site keep their frames and inertias, because the site's readings and
    welds to mocap bodies depend on these. With shifted frames, a task that starts each move from the welded body's pose
    would drift. So only the geoms and cameras of these bodies are shifted, and all bodies attached to them, such as
    fingers.
    """

    def __init__(self, model: Any, data: Any, nominal: Geometry) -> None:
        """Find the parts that are fixed to the tool, at the present joints.

        Args:
            model: `mujoco.MjModel`.
            data: `mujoco.MjData` of the model; it does not change.
            nominal: Geometry of the model's arm.

        Raises:
            InputError: If no site that is fixed to the last link is at the nominal arm's tool.
        """
        mujoco: Any = import_module("mujoco")
        still = mujoco.MjData(model)  # the environment's own data stay as they are
        still.qpos[:], still.mocap_pos[:], still.mocap_quat[:] = data.qpos, data.mocap_pos, data.mocap_quat
        mujoco.mj_kinematics(model, still)
        link = model.joint(nominal.joint_names[-1]).bodyid[0]
        nominal_tool = forward(nominal, joints_in_mujoco(model, data, nominal))
        off = pose_error(nominal_tool, Pose(still.site_xpos, still.site_xmat.reshape(-1, 3, 3)))
        near = (np.linalg.norm(off, axis=-1) < FAR) & (model.body_weldid[model.site_bodyid] == link)
        if not near.any():
            raise InputError("no site of the last link is the nominal arm's tool; read the arm with geometry_in_mujoco")
        path = [model.site_bodyid[np.argmax(near)]]
        while path[-1] != link:
            path.append(model.body_parentid[path[-1]])
        parents = np.where(np.isin(np.arange(model.nbody), path), -1, model.body_parentid)
        self._parts = []
        for place, turn, carriers in (
            (model.body_pos, model.body_quat, parents),
            (model.geom_pos, model.geom_quat, model.geom_bodyid),
            (model.cam_pos, model.cam_quat, model.cam_bodyid),
        ):
            if len(rows := np.flatnonzero(np.isin(carriers, path))):
                bodies = Pose(still.xpos[carriers[rows]], still.xmat[carriers[rows]].reshape(-1, 3, 3))
                tool = behind(inverse_pose(bodies), nominal_tool)
                self._parts.append((place, turn, rows, place[rows], turn[rows], tool))
        geoms = np.isin(model.geom_bodyid, path)
        boxes = [box for p in path for box in range(model.body_bvhadr[p], model.body_bvhadr[p] + model.body_bvhnum[p])]
        self._hints = (
            (model.geom_sameframe, geoms, model.geom_sameframe[geoms], 0),  # else some stand where their bodies are
            (model.bvh_aabb[:, 3:], boxes, model.bvh_aabb[boxes, 3:], 1e3),  # else contacts outside are not looked for
        )

    def put(self, shift: Pose | None) -> None:
        """Shift the parts by the pose of the true tool in the believed tool's frame; None undoes all shifts."""
        for hint, numbers, usual, safe in self._hints:
            hint[numbers] = usual if shift is None else safe
        for place, turn, rows, home, aim, tool in self._parts:
            place[rows], turn[rows] = home, aim
            if shift is not None:
                change = behind(behind(tool, shift), inverse_pose(tool))
                place[rows] = behind(change, Pose(home, np.eye(3))).position
                attitudes = Rotation.from_matrix(change.rotation) * Rotation.from_quat(aim[:, [1, 2, 3, 0]])
                turn[rows] = attitudes.as_quat()[:, [3, 0, 1, 2]]


class Miscalibrate(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Give the arm of another package's MuJoCo environment the errors of a real arm.

    Observations do not change; they show the nominal arm. `info` gets `tool_error_mm`, the distance between the true
    and the believed position of the tool.

    Without ``contact``, the task must be a reaching task with Gymnasium-Robotics' goal interface (`achieved_goal`,
    `desired_goal`, `compute_reward`). Its goal is a position of the tool, and actions are joint or tool targets. Reward
    and `info["is_success"]` are then computed from the tool's true position. `info` gets `true_distance_mm`, the
    distance of that position from the goal.

    ``contact`` is for all other tasks. It shifts the fingers, and all other parts fixed to the tool, to where the true
    arm has them. Reward and success are the environment's own. Links before the last joint are not shifted. Parts are
    shifted once per step, without velocity, so a held object slips by as much as the error changes during a move.

    Example:
        >>> import gymnasium as gym
        >>> from pickenv.wrappers import Miscalibrate
        >>> def with_error(env: gym.Env, plant) -> gym.Env:
        ...     return Miscalibrate(env, plant.arm.nominal, plant)

    Change log:
     * v0.2.0 - Added.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        nominal: Geometry,
        true: Plant | Geometry,
        compensator: Compensate | None = None,
        *,
        contact: bool = False,
    ) -> None:
        """Wrap ``env``.

        Args:
            env: The environment.
            nominal: Geometry of the arm in the environment's model (`geometry_in_mujoco`), with the model's joint
                names.
            true: The true arm: a geometry, or a plant (an arm with its errors) without memory, which means that no
                effect depends on earlier commands.
            compensator: Function from joint targets to joint commands of the true arm, such as a calibration's; None to
                send targets unchanged.
            contact: Whether the parts fixed to the tool are shifted to where the true arm has them; see the class.

        Raises:
            InputError: If ``env`` has no MuJoCo model, the arms differ in their number of joints, or the plant has
                effects with memory. Without ``contact`` also if ``env`` has no goal interface.
        """
        RecordConstructorArgs.__init__(self, nominal=nominal, true=true, compensator=compensator, contact=contact)
        gym.Wrapper.__init__(self, env)
        self._inner: Any = env.unwrapped
        parts = getattr(env.observation_space, "spaces", {})
        if not (contact or (hasattr(self._inner, "compute_reward") and "achieved_goal" in parts)):
            lacks = f"{type(self._inner).__name__} has no achieved_goal and compute_reward"
            raise InputError(f"{lacks}; wrap a goal environment, or give contact=True")
        _physics(env)
        truth = true.geometry if isinstance(true, Plant) else true
        if truth.joints != nominal.joints:
            raise InputError(f"the true arm has {truth.joints} joints, the nominal one {nominal.joints}; give one arm")
        if isinstance(true, Plant) and true.has_state:
            raise InputError(f"plant '{true.name}' has effects with a memory; switch them off (without=…)")
        self._nominal, self._true, self._compensator, self._contact = nominal, true, compensator, contact

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; `info` gets the entries that the class describes."""
        self._put_back()
        observation, info = self.env.reset(seed=seed, options=options)
        if self._contact:
            self._inner.hung_on_tool = _Hung(*_physics(self.env), self._nominal)  # where the next wrapper finds it
        return observation, self._judged(observation, info)

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment; without ``contact``, compute reward and success from the tool's true position."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        info = self._judged(observation, info)
        if not self._contact:
            reward = float(self._inner.compute_reward(self._achieved, observation["desired_goal"], info))
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Put the shifted parts back and close the environment."""
        self._put_back()
        super().close()

    def tool_error(self) -> Array:
        """Compute true minus believed tool position ``(3,)`` at the present joints, m, in the model's world frame."""
        return np.asarray(pose_error(*self._tools())[:3])

    def _tools(self) -> tuple[Pose, Pose]:
        """Compute the poses of the believed tool and of the true tool, in the model's world frame."""
        joints = joints_in_mujoco(*_physics(self.env), self._nominal)
        command = joints if self._compensator is None else np.asarray(self._compensator(joints), dtype=float)
        true = self._true.tool_pose(command) if isinstance(self._true, Plant) else forward(self._true, command)
        return forward(self._nominal, joints), true

    def _put_back(self) -> None:
        if (hung := getattr(self._inner, "hung_on_tool", None)) is not None:
            hung.put(None)

    def _judged(self, observation: Any, info: dict[str, Any]) -> dict[str, Any]:
        nominal, true = self._tools()
        error = pose_error(nominal, true)[:3]
        info = dict(info) | {"tool_error_mm": float(np.linalg.norm(error)) * 1e3}
        if self._contact:
            same = all(map(np.array_equal, nominal, true))
            self._inner.hung_on_tool.put(None if same else behind(inverse_pose(nominal), true))
            return info
        achieved, desired = (np.asarray(observation[key], dtype=float) for key in ("achieved_goal", "desired_goal"))
        if achieved.shape != (3,) or np.linalg.norm(achieved - nominal.position) > FAR:
            wrong = "achieved_goal is not the position of the nominal arm's tool"
            raise InputError(f"{wrong}; name the site that the goal is of, or give contact=True where it is of no tool")
        self._achieved = achieved + error
        info["true_distance_mm"] = float(np.linalg.norm(self._achieved - desired)) * 1e3
        if hasattr(self._inner, "_is_success"):
            info["is_success"] = self._inner._is_success(self._achieved, desired)
        elif "is_success" in info:
            raise InputError(f"{type(self._inner).__name__} does not say how it judges success (_is_success); add it")
        return info
