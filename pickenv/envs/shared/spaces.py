"""Observation and action spaces of the reach environments, and what their `reset` takes as options."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from pickenv.base import InputError
from pickenv.envs.shared.given_goals import GOALS
from pickenv.envs.shared.task import Task

# A specification that can be written down: paths among an environment's arguments stand in it as text.


class PlainSpec:
    """An environment, single or vector, whose `spec.to_json()` works whatever files were given as paths."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What it was made by."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        if given is not None and any(isinstance(value, PurePath) for value in given.kwargs.values()):
            given = copy.copy(given)
            given.kwargs = {
                key: str(value) if isinstance(value, PurePath) else value for key, value in given.kwargs.items()
            }
        self._spec = given


OPTIONS = ("start_joints", *GOALS, "arm")


def flat_space(task: Task) -> spaces.Box:
    """Space of the flat observation."""
    reach, camera = task.reach, [2 * task.reach] * 3 if task.camera else []
    return box([1.0] * task.joints + [reach] * 6 + [2 * reach] * 3 + [math.pi] * 3 + camera)


def goal_space(task: Task) -> spaces.Dict:
    """Space of the goal observation."""
    reach = task.reach
    return spaces.Dict(
        {
            "observation": box([1.0] * task.joints + [reach] * 3),
            "achieved_goal": box([3 * reach if task.camera else reach] * 3 + [1.0] * 6),
            "desired_goal": box([reach] * 3 + [1.0] * 6),
        }
    )


def action_space(task: Task) -> spaces.Box:
    """Space of the joint increments."""
    return spaces.Box(-1.0, 1.0, (task.joints,), dtype=np.float32)


def box(high: Sequence[float]) -> spaces.Box:
    """Symmetric float32 box; pi is rounded upwards, so that a half turn stays inside."""
    bound = np.array(high, dtype=np.float32)
    bound = np.where(bound < np.array(high), np.nextafter(bound, np.float32(np.inf)), bound)
    return spaces.Box(-bound, bound, dtype=np.float32)


def given_options(options: Any, allowed: tuple[str, ...] = OPTIONS) -> dict[str, Any]:
    """The options of `reset`, empty where there are none.

    Raises:
        InputError: If they are no mapping of names, or one of them is read by nobody.
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
