"""What `pickenv/Pick-v0` is made with: its arguments, checked, as a task of the arm and a setting of fruit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from pickenv.arm.kinematics.forward import Scalar
from pickenv.envs.picking.pick_scene import PUBLISHED, PickSetting, make_setting
from pickenv.envs.shared.spaces import box
from pickenv.envs.shared.task import Task, check_count, check_number, make_task

LONGEST = 400
"""Steps of the time budget, whatever `max_episode_steps` says: the environment is not told of that."""
STILL = 1.0
"""Time without a command after which the observation says that the arm stands still, s."""
MOST_LEFT = 50
COLLECTED, DAMAGED, STEP = 1.0, -0.25, -0.002


def make_pick(
    plant: str = "orchard",
    without: Sequence[str] = (),
    gripper: str = "li_cup",
    camera: str = "laser_line",
    canopy: str = "li2016",
    fruit_map: str = "li2016_lab",
    fruit_size: str = "li2016",
    fruit: float = 10.0,
    looks: int = 16,
    vision: str = PUBLISHED,
    detector: str = "li2016",
    order: str = "nearest",
    arms: str = "fixed",
    tolerances: str = "medium",
    population: int = 256,
    population_seed: int = 0,
    out_of_range: str = "clip",
    **situation: Any,
) -> tuple[Task, PickSetting]:
    """Check the arguments (`pickenv/Pick-v0` explains them) and read the presets.

    Raises:
        InputError: If an argument is impossible; one sentence says which.
    """
    check_number("fruit", fruit, positive=True)
    check_count("looks", looks)
    drawn: dict[str, Any] = {"tolerances": tolerances, "population": population, "population_seed": population_seed}
    task = make_task(plant, without, arms=arms, out_of_range=out_of_range, **drawn, **situation)
    return task, make_setting(canopy, fruit_map, fruit_size, camera, gripper, fruit, looks, vision, detector, order)


def pick_spaces(task: Task) -> tuple[spaces.Box, spaces.Box]:
    """Observation and action space."""
    bounds = box([1.0] * task.joints + [task.reach] * 6 + [2 * task.reach] * 3 + [math.pi] * 3)
    low = np.concatenate([bounds.low, np.zeros(5, np.float32)])
    high = np.concatenate([bounds.high, np.ones(5, np.float32)])
    return spaces.Box(low, high, dtype=np.float32), spaces.Box(-1.0, 1.0, (task.joints + 1,), np.float32)


def pick_reward(collected: Scalar, damaged: Scalar) -> Scalar:
    """Reward of a step in which so much fruit was collected undamaged, and newly damaged."""
    return COLLECTED * collected + DAMAGED * damaged + STEP
