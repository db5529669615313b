"""Tasks whose actions are increments of the tool instead of the joints, near a pose far from singularities.

Units: m, rad; millimetres and degrees only where a name says so.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from pickenv.arm import Array, Geometry, forward, joint_jacobian
from pickenv.arm.kinematics.inverse import halton_joints
from pickenv.arm.kinematics.task_space import DIRECTION_TOLERANCE
from pickenv.base import InputError
from pickenv.envs.shared.task import Task, check_choice, check_number, make_task

ACTIONS = {"pose": 6, "position": 3}
"""Count of the numbers in an action, for each value of the argument `actions`."""

PLACES = 2**10
"""Number of sampled poses, from which the middle of the box of starts and goals is chosen."""


def make_tool_task(
    actions: str = "pose",
    tool_step_mm: float = 25.0,
    tool_turn_deg: float = 10.0,
    goal_spread: float = 0.25,
    **arguments: Any,
) -> Task:
    """Check the arguments of an environment, which `pickenv/ReachTool-v0` explains, and return its task.

    Raises:
        InputError: If an argument has a value that is not allowed, or the arm has fewer joints than an action has
            numbers.
    """
    check_choice("actions", actions, tuple(ACTIONS))
    for name, size in (("tool_step_mm", tool_step_mm), ("tool_turn_deg", tool_turn_deg), ("goal_spread", goal_spread)):
        check_number(name, size, positive=True)
    if goal_spread > 1:
        raise InputError(f"goal_spread is {goal_spread}; give a share of the joints' ranges, above 0 and at most 1")
    task, count = make_task(**arguments), ACTIONS[actions]
    if task.joints < count:
        other = "; give actions='position'" if 3 <= task.joints < count else ""
        raise InputError(
            f"arm '{task.plant.arm.name}' has {task.joints} joints, too few for the {count} increments of "
            f"its tool that actions='{actions}' are{other}"
        )
    tool = (*[tool_step_mm * 1e-3] * 3, *[math.radians(tool_turn_deg)] * 3)[:count]
    low, high = free_box(task.plant.arm.nominal, np.array(task.increment), tool, task.min_upright, goal_spread)
    return replace(task, tool=tool, box=(tuple(low.tolist()), tuple(high.tolist())))


def free_box(
    geometry: Geometry, increment: Array, tool: tuple[float, ...], min_upright: float, spread: float
) -> tuple[Array, Array]:
    """Find a box of joints around a pose from which the tool moves well in every direction.

    The middle of the box is one of `PLACES` upright poses from a Halton sequence. It is the pose where the smallest
    singular value of the scaled Jacobian is largest. Directions in which the arm cannot move anywhere do not count. The
    box lies inside the joint limits and inside a whole turn of each joint.

    Args:
        geometry: The arm.
        increment: Largest increments of the joints, rad or m.
        tool: Largest increments of the tool, m and rad.
        min_upright: Smallest z component of the tool's axis.
        spread: Edges of the box, as shares of the joints' ranges. A range of more than a whole turn counts as one.

    Returns:
        The lower and the upper bounds of the box ``(n,)``, rad or m.
    """
    middle, span = (geometry.lower + geometry.upper) / 2.0, geometry.upper - geometry.lower
    span = np.where(geometry.prismatic, span, np.minimum(span, math.tau))
    shares = (halton_joints(geometry, PLACES) - geometry.lower) / (geometry.upper - geometry.lower)
    places = middle + span * (1.0 - spread) * (shares - 0.5)
    upright = forward(geometry, places).rotation[:, 2, 2] >= min_upright
    places = places[upright] if upright.any() else places
    jacobian = joint_jacobian(geometry, places)[:, : len(tool)] * increment / np.array(tool)[:, None]
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    rank = int((sizes > DIRECTION_TOLERANCE * sizes[:, :1]).sum(axis=1).max())
    best = places[np.argmax(sizes[:, rank - 1])]
    return best - span * spread / 2.0, best + span * spread / 2.0
