"""How an episode of `pickenv/Pick-v0` begins: everything that is drawn for it, from the environment's own generator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pickenv.envs.picking.pick_reach import Reach
from pickenv.envs.picking.pick_scene import PickScene, PickSetting, draw_scene
from pickenv.envs.shared.task import Task

PICK_OPTIONS = ("fruit", "start_joints", "arm")
"""What `reset` takes."""


@dataclass(frozen=True, eq=False)
class PickStart:
    """What is drawn for an episode.

    Attributes:
        scene: The fruit.
        arm: Number of the true arm, or None where there is but one.
        key: Of the streams from which the situation is looked up.
    """

    scene: PickScene
    arm: int | None
    key: int


def draw_start(
    task: Task,
    orchard: PickSetting,
    reach: Reach,
    rng: np.random.Generator,
    arm: int | None,
    *,
    again: bool,
    fruit: Any = None,
    asked: int | None = None,
) -> PickStart:
    """Draw an episode.

    Args:
        task: The arm's task.
        orchard: What kind of fruit.
        reach: Where the arm gets.
        rng: Source of every random draw.
        arm: The environment's arm so far, or None.
        again: Whether a new seed was given: then arms "per_env" are drawn anew, too.
        fruit: Positions in place of drawn ones, as `reset` takes them.
        asked: Number of the arm that was asked for, or None.

    Raises:
        InputError: If none of the fruit is within reach, or there is no such arm.
    """
    scene = draw_scene(orchard, reach, rng, fruit)
    if task.arms != "fixed" or asked is not None:
        if again or arm is None or task.arms == "per_episode":
            arm = int(rng.integers(task.population))
        if asked is not None:
            arm = task.given_arm(asked)
    return PickStart(scene, arm, 0 if task.situation.plain else int(rng.integers(2**63)))
