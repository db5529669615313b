"""Observation and action spaces of the reach environments, and the options of their `reset`."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import PurePath
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from pickenv.arm import Array, Geometry, Pose, forward, frame_of, inverse, rotation_matrix
from pickenv.arm.kinematics.inverse import halton_joints
from pickenv.base import InputError, shown
from pickenv.envs.shared.task import Task, as_numbers

# A specification that can be written down: paths among an environment's arguments stand in it as text.


class PlainSpec:
    """Base class of environments whose `spec.to_json()` works with path objects among the arguments."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The specification that the environment was made from, with paths as strings."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        paths = {} if spec is None else {key: str(p) for key, p in spec.kwargs.items() if isinstance(p, PurePath)}
        if spec is not None and paths:
            spec = copy.copy(spec)
            spec.kwargs = spec.kwargs | paths
        self._spec = spec


GOALS = ("goal_joints", "goal_position", "goal_pose")
OPTIONS = ("start_joints", *GOALS, "arm")


def flat_space(task: Task) -> spaces.Box:
    """Return the space of the flat observation of `pickenv/Reach-v0`."""
    reach, camera = task.reach, [2 * task.reach] * 3 if task.camera else []
    return box([1.0] * task.joints + [reach] * 6 + [2 * reach] * 3 + [math.pi] * 3 + camera)


def goal_space(task: Task) -> spaces.Dict:
    """Return the space of the goal observation of `pickenv/ReachGoal-v0`."""
    reach = task.reach
    return spaces.Dict(
        {
            "observation": box([1.0] * task.joints + [reach] * 3),
            "achieved_goal": box([3 * reach if task.camera else reach] * 3 + [1.0] * 6),
            "desired_goal": box([reach] * 3 + [1.0] * 6),
        }
    )


def action_space(task: Task) -> spaces.Box:
    """Return the space of actions: increments of the joints or of the tool, then the gripper's command, if any."""
    return spaces.Box(-1.0, 1.0, (task.actions,), dtype=np.float32)


def box(high: Sequence[float]) -> spaces.Box:
    """Return the float32 box from -``high`` to ``high``, rounded outwards, so that the bounds themselves are inside."""
    bound = np.array(high, dtype=np.float32)
    bound = np.where(bound < np.array(high), np.nextafter(bound, np.float32(np.inf)), bound)
    return spaces.Box(-bound, bound, dtype=np.float32)


def given_options(options: Any, allowed: tuple[str, ...] = OPTIONS) -> dict[str, Any]:
    """Check the options of `reset`, and return them as a dict, which is empty if ``options`` is None.

    Raises:
        InputError: If ``options`` is no mapping, or has a name that is not in ``allowed``.
    """
    names = ", ".join(allowed)
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise InputError(f"options is {options!r}; give a dict{f' of {names}' if names else ', an empty one'}")
    unknown = sorted(str(option) for option in set(options) - set(allowed))
    if unknown:
        raise InputError(f"unknown reset option '{unknown[0]}'; {f'give {names}' if names else 'there is none'}")
    return dict(options)


# Goals that `reset` is asked for: by joints, by position, or by pose. Base frame, m and rad.


POOL, NEAREST = 2**14, 16
"""`POOL` is the number of sampled poses. Inverse kinematics starts from the `NEAREST` poses nearest to a position."""


Goals = tuple[Array | None, Array | None]
"""Goals that options of `reset` give: joints of the nominal arm at the goal ``(..., n)``, and frames of the goal
``(..., 12)``, axes and origin. One of the two is None, or both if no goal is given."""


def given_goals(task: Task, options: Mapping[str, Any], count: int | None = None) -> Goals:
    """Return the goals that the options of `reset` give, as `Goals`.

    Args:
        task: The task.
        options: The options; of `GOALS` at most one may be given.
        count: Number of environments, or None for a single one.

    Raises:
        InputError: If more than one option gives a goal, a shape is wrong, or the nominal arm cannot get to a position.
    """
    names = [name for name in GOALS if options.get(name) is not None]
    if len(names) > 1:
        raise InputError(f"options {' and '.join(names)} both say where the goal is; give one of them")
    if not names:
        return None, None
    (name,) = names
    if name == "goal_joints":
        return task.given_joints(name, options[name], count), None
    width, columns = (
        (3, "x, y, z in m") if name == "goal_position" else (6, "x, y, z in m and a rotation vector in rad")
    )
    rows = as_numbers(f"option {name}", options[name])
    shapes = [(width,)] if count is None else [(width,), (count, width)]
    if rows.shape not in shapes:
        raise InputError(f"option {name} has shape {rows.shape}; give {' or '.join(map(str, shapes))}: {columns}")
    if not np.isfinite(rows).all():
        raise InputError(f"option {name} is {shown(rows.tolist())}; give finite numbers: {columns}")
    goals = np.array([_reached(task, row) if width == 3 else _framed(task, row) for row in np.atleast_2d(rows)])
    goals = goals[0] if count is None else np.broadcast_to(goals, (count, goals.shape[1]))
    return (goals, None) if width == 3 else (None, goals)


def _reached(task: Task, position: Array) -> Array:
    """Find joints ``(n,)``, rad or m, that bring the nominal tool to a position ``(3,)``, m.

    The tool's axis is at most the task's largest tilt away from the vertical.
    """
    geometry = task.plant.arm.nominal
    joints, poses = spread_poses(geometry)
    upright = np.flatnonzero(poses.rotation[:, 2, 2] >= task.min_upright)
    away = np.linalg.norm(poses.position[upright] - position, axis=1)
    near = upright[np.argsort(away, kind="stable")[:NEAREST]]
    targets = Pose(np.broadcast_to(position, (len(near), 3)), poses.rotation[near])
    solution = inverse(geometry, targets, joints[near], position_tolerance=1e-9, attitude_tolerance=np.inf, restarts=0)
    fits = solution.reached & (forward(geometry, solution.joints).rotation[:, 2, 2] >= task.min_upright)
    if not fits.any():
        tilt = np.degrees(np.arccos(task.min_upright))
        raise _far("goal_position", task, position, f" with its tool within {tilt:.0f} deg of the vertical")
    return np.asarray(solution.joints[np.argmax(fits)])


def _framed(task: Task, pose: Array) -> Array:
    """Return the frame ``(12,)`` of a pose ``(6,)``: position, m, and rotation vector, rad.

    The nominal arm must reach the position, but not the attitude.
    """
    position, rotation = pose[:3], rotation_matrix(pose[3:])
    solution = inverse(task.plant.arm.nominal, Pose(position, rotation), position_tolerance=1e-6, position_only=True)
    if not solution.reached:
        raise _far("goal_pose", task, position)
    return np.array(frame_of(Pose(position, rotation)))


def _far(name: str, task: Task, position: Array, how: str = "") -> InputError:
    place = np.round(position, 4).tolist()
    return InputError(f"option {name}: arm '{task.plant.arm.name}' does not reach {place} m{how}; move the goal")


@lru_cache(maxsize=4)
def spread_poses(geometry: Geometry) -> tuple[Array, Pose]:
    """Return joints ``(POOL, n)`` from a Halton sequence over their ranges, and the nominal tool's poses there."""
    joints = halton_joints(geometry, POOL)
    return joints, forward(geometry, joints)
