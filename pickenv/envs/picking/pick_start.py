"""How an episode of `pickenv/Pick-v0` begins: everything that is drawn for it, from the environment's own generator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pickenv.envs.picking.pick_reach import Reach
from pickenv.envs.picking.pick_scene import PickScene, PickSetting, draw_scenes
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


@dataclass(frozen=True, eq=False)
class Asked:
    """What is asked of an episode, and what there was before.

    Attributes:
        arm: The environment's arm so far, or None.
        again: Whether a new seed was given: then arms "per_env" are drawn anew, too.
        fruit: Positions in place of drawn ones, as `reset` takes them, or None.
        wanted: Number of the arm that was asked for, or None.
    """

    arm: int | None
    again: bool = False
    fruit: Any = None
    wanted: int | None = None


def draw_starts(
    task: Task, orchard: PickSetting, reach: Reach, rngs: Sequence[np.random.Generator], asked: Sequence[Asked]
) -> list[PickStart]:
    """Draw episodes, each from a generator of its own.

    Args:
        task: The arm's task.
        orchard: What kind of fruit.
        reach: Where the arm gets.
        rngs: Source of every random draw of each.
        asked: What is asked of each.

    Raises:
        InputError: If none of the fruit is within reach, or there is no such arm.
    """
    scenes = draw_scenes(orchard, reach, rngs, [each.fruit for each in asked])
    starts = []
    for scene, rng, each in zip(scenes, rngs, asked, strict=True):
        arm = each.arm
        if task.arms != "fixed" or each.wanted is not None:
            if each.again or arm is None or task.arms == "per_episode":
                arm = int(rng.integers(task.population))
            if each.wanted is not None:
                arm = task.given_arm(each.wanted)
        starts.append(PickStart(scene, arm, 0 if task.situation.plain else int(rng.integers(2**63))))
    return starts
