"""Goals that `reset` is asked for: by joints, by position, or by pose. Base frame, m and rad."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from pickenv.arm import Array, Geometry, Pose, forward, inverse, rotation_matrix
from pickenv.arm.kinematics.forward import frame_of
from pickenv.base import InputError
from pickenv.base.limits import shown
from pickenv.envs.shared.task import Task, as_numbers

GOALS = ("goal_joints", "goal_position", "goal_pose")

POOL, NEAREST = 2**14, 16
"""Poses among which one near a position is sought, and how many of them are tried."""


class GivenGoals(NamedTuple):
    """Wanted poses, one row per environment; one of the two is None, or both where none is given.

    Attributes:
        joints: Joints of the nominal arm that stand there ``(..., n)``.
        frames: Frames ``(..., 12)``, axes and origin.
    """

    joints: Array | None = None
    frames: Array | None = None


def given_goals(task: Task, options: Mapping[str, Any], count: int | None = None) -> GivenGoals:
    """The goals that options ask for: of one environment, or of ``count``.

    Raises:
        InputError: If more than one way is used, a shape is wrong, or the nominal arm cannot get to a position.
    """
    asked = [name for name in GOALS if options.get(name) is not None]
    if len(asked) > 1:
        raise InputError(f"options {' and '.join(asked)} both say where the goal is; give one of them")
    if not asked:
        return GivenGoals()
    name, given = asked[0], options[asked[0]]
    if name == "goal_joints":
        return GivenGoals(joints=task.given_joints(name, given, count))
    width, what = (3, "x, y, z in m") if name == "goal_position" else (6, "x, y, z in m and a rotation vector in rad")
    rows = as_numbers(f"option {name}", given)
    shapes = [(width,)] if count is None else [(width,), (count, width)]
    if rows.shape not in shapes:
        raise InputError(f"option {name} has shape {rows.shape}; give {' or '.join(map(str, shapes))}: {what}")
    if not np.isfinite(rows).all():
        raise InputError(f"option {name} is {shown(rows.tolist())}; give finite numbers: {what}")
    goals = np.array([_reached(task, row) if width == 3 else _framed(task, row) for row in np.atleast_2d(rows)])
    goals = goals[0] if count is None else np.broadcast_to(goals, (count, goals.shape[1]))
    return GivenGoals(joints=goals) if width == 3 else GivenGoals(frames=goals)


def _reached(task: Task, position: Array) -> Array:
    """Joints ``(n,)`` whose nominal tool is at a position ``(3,)`` and points upwards within the largest tilt."""
    geometry = task.plant.arm.nominal
    joints, poses = _spread(geometry)
    upright = np.flatnonzero(poses.rotation[:, 2, 2] >= task.min_upright)
    away = np.linalg.norm(poses.position[upright] - position, axis=1)
    near = upright[np.argsort(away, kind="stable")[:NEAREST]]
    targets = Pose(np.broadcast_to(position, (len(near), 3)), poses.rotation[near])
    found = inverse(geometry, targets, joints[near], position_tolerance=1e-9, attitude_tolerance=np.inf, restarts=0)
    fits = found.reached & (forward(geometry, found.joints).rotation[:, 2, 2] >= task.min_upright)
    if not fits.any():
        tilt = np.degrees(np.arccos(task.min_upright))
        raise _far("goal_position", task, position, f" with its tool within {tilt:.0f} deg of the vertical")
    return np.asarray(found.joints[np.argmax(fits)])


def _framed(task: Task, pose: Array) -> Array:
    """Frame ``(12,)`` of a pose ``(6,)``; its attitude is asked for, whether or not the arm has it."""
    position, rotation = pose[:3], rotation_matrix(pose[3:])
    found = inverse(task.plant.arm.nominal, Pose(position, rotation), position_tolerance=1e-6, position_only=True)
    if not found.reached:
        raise _far("goal_pose", task, position)
    return np.array(frame_of(Pose(position, rotation)))


def _far(name: str, task: Task, position: Array, how: str = "") -> InputError:
    where = np.round(position, 4).tolist()
    return InputError(f"option {name}: arm '{task.plant.arm.name}' does not reach {where} m{how}; move the goal")


@lru_cache(maxsize=4)
def _spread(geometry: Geometry) -> tuple[Array, Pose]:
    """Joints spread evenly over their ranges, and the nominal tool there."""
    shares = qmc.Halton(geometry.joints, scramble=False).random(POOL)
    joints = geometry.lower + (geometry.upper - geometry.lower) * shares
    return joints, forward(geometry, joints)
