"""Scaling of observations and actions, with which a policy learns to reach within a millimetre.

The gap is the fruit's pose minus the tool's pose. A network that reads the gap in metres hardly notices millimetres,
and the noise of its actions hides them. Here the network sees the gap as a direction of about unit length and the
logarithm of its size. Near the fruit, actions are multiplied by the size of the gap. So a behaviour learnt at
decimetres also works at micrometres. The formulas run on NumPy and on torch.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from pickenv.base import InputError
from pickenv.envs.shared.simulation import GOAL_NUMBERS, goal_gap
from pickenv.envs.shared.task import MOST_ACTION, Task, as_numbers

SMALLEST = 1e-6
"""Smallest size of a gap, as a share of `Scaling.near` and `Scaling.near_turn`; smaller gaps count as this size."""

ROUNDING = 1e-3
"""Margin for rounding in the bounds of observed numbers whose magnitude is at most one."""


class Rescaling(ABC):
    """Formulas that turn an environment's observations into a policy's, and a policy's actions into the environment's.

    Attributes:
        inputs: Count of numbers in the environment's observation.
        features: Count of numbers that the policy sees.
        space: Space of the observations that the policy sees.
        answers: Space of the policy's actions; None if it is the environment's action space.
        home: Part of an error message: the things that must be those of the policy's training, such as "the feedback
            and the arm".
    """

    inputs: Any
    features: Any
    space: Any
    answers: Any = None
    home: ClassVar[str]

    def check(self, width: int, scaled: bool = False) -> None:
        """Check the length of observations.

        Args:
            width: Count of numbers in an observation.
            scaled: Whether the observations are results of `observe`, and must have `features` numbers instead of
                `inputs`.

        Raises:
            InputError: If ``width`` differs from `inputs`, or from `features` if ``scaled``.
        """
        trained, home = (self.features, "the environment") if scaled else (self.inputs, self.home)
        if width != trained:
            raise InputError(
                f"the policy was trained on observations of {trained} numbers, but the environment gives {width}; "
                f"use {home} of its training"
            )

    def shown(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return the result of `observe` as a NumPy array of float32, as environments do."""
        return np.asarray(self.observe(values, np), dtype=np.float32)

    @abstractmethod
    def observe(self, values: Any, xp: Any) -> Any:
        """Compute the policy's observations ``(..., features)``.

        Args:
            values: The environment's observations ``(..., inputs)``.
            xp: The module numpy or torch.
        """

    @abstractmethod
    def act(self, values: NDArray[Any], actions: Any, most: float = MOST_ACTION["clip"]) -> NDArray[Any]:
        """Compute the environment's actions from a policy's.

        Invalid actions are passed on, so that the environment raises the error.

        Args:
            values: The environment's observations ``(..., inputs)``.
            actions: The policy's actions.
            most: Largest magnitude of a number that the environment accepts.
        """

    @abstractmethod
    def potential(self, values: NDArray[Any]) -> Any:
        """Compute a potential ``(...)`` for reward shaping, which grows towards the task's goal.

        ``values`` are the environment's observations ``(..., inputs)``.
        """


@dataclass(frozen=True)
class Scaling(Rescaling):
    """The scaling of the gap in a reach task. It holds the layout of observations and the gaps that count as near.

    Attributes:
        joints: Number of joints n.
        camera: Whether the flat observation ends with the position gap that the camera measures.
        goal: Whether observations are joined goal observations, see `joined_observation`.
        actions: Whether actions shrink with the gap; if not, only the observation changes.
        near: Position gap below which actions shrink in proportion to it, m.
        near_turn: Attitude gap below which actions shrink in proportion to it, rad.
        tool: Count of the numbers of an action that moves the tool: 6, or 3 without attitude. It is 0 where actions
            move joints. A network that moves the tool does not see the joints.
    """

    joints: int
    camera: bool = False
    goal: bool = False
    actions: bool = True
    near: float = 0.1
    near_turn: float = 0.2
    tool: int = 0
    home = "the feedback and the arm"

    @property
    def inputs(self) -> int:
        """Count of numbers in the environment's observation."""
        return self.joints + (3 + 2 * GOAL_NUMBERS if self.goal else 15 if self.camera else 12)

    @property
    def features(self) -> int:
        """Count of numbers in a network's observation."""
        return (self.tool or self.joints + 6) + 1

    @property
    def space(self) -> spaces.Box:
        """Space of the observations that the networks see."""
        joints, gaps = ([], self.tool) if self.tool else ([1.0] * self.joints, 6)
        high = [*joints, *[1.0 + ROUNDING] * gaps, -math.log10(SMALLEST) / 2.0]
        return spaces.Box(-np.array(high, np.float32), np.array(high, np.float32), dtype=np.float32)

    @property
    def outputs(self) -> int:
        """Count of numbers in a network's action."""
        return self.tool or self.joints

    def gap(self, values: Any, xp: Any) -> tuple[Any, Any]:
        """Return the position gap (m) and the attitude gap (rotation vector, rad), ``(..., 3)`` each.

        ``values`` are the environment's observations ``(..., inputs)``, and ``xp`` is the module numpy or torch. The
        methods below take the same arguments.
        """
        n = self.joints
        if self.goal:
            numbers = [values[..., i] for i in range(n + 3, self.inputs)]
            gap = goal_gap(xp, numbers[:GOAL_NUMBERS], numbers[GOAL_NUMBERS:])
            return xp.stack(gap[:3], -1), xp.stack(gap[3:], -1)
        return values[..., n + 12 :] if self.camera else values[..., n + 6 : n + 9], values[..., n + 9 : n + 12]

    def size(self, values: Any, xp: Any) -> Any:
        """Compute the size ``(..., 1)`` of the gap in observations ``values``: the larger of two ratios.

        These are the position gap over `near` and the attitude gap over `near_turn`; see `gap` for the arguments.
        """
        gap, turn = self.gap(values, xp)
        far, turned = vector_length(gap) / self.near, vector_length(turn) / self.near_turn
        return xp.clip(far if self.tool == 3 else xp.maximum(far, turned), SMALLEST, None)

    def share(self, values: Any, xp: Any) -> Any:
        """Compute the factor ``(..., 1)``, at most 1, by which a network's actions at observations are multiplied.

        See `gap` for the arguments.
        """
        size = self.size(values, xp)
        return xp.clip(size, None, 1.0) if self.actions else 0.0 * size + 1.0

    def observe(self, values: Any, xp: Any) -> Any:
        """Compute the observations ``(..., features)`` that networks see, with the arguments of `Rescaling.observe`."""
        gap, turn = self.gap(values, xp)
        size = self.size(values, xp)
        parts = (values[..., : self.joints], gap / (self.near * size), turn / (self.near_turn * size))
        if self.tool:
            parts = parts[1 : 1 + self.tool // 3]
        return xp.concatenate((*parts, xp.log10(size) / 2.0), -1)

    def commands(self, values: Any, actions: Any) -> Any:
        """Compute the environment's actions from a network's ``actions`` (-1 to 1) at the observations ``values``."""
        return actions * self.share(values, np)

    def potential(self, values: NDArray[Any]) -> Any:
        """Compute the negative decimal logarithm ``(...)`` of the gap's size from observations, for reward shaping."""
        return -np.log10(self.size(values, np))[..., 0]

    def act(self, values: NDArray[Any], actions: Any, most: float = MOST_ACTION["clip"]) -> NDArray[Any]:
        """Compute the environment's actions from a policy's ``actions`` at the observations ``values``.

        Actions of another shape, and numbers that are larger than ``most`` or not finite, are passed on unchanged, so
        that the environment raises the error.
        """
        numbers = as_numbers("actions", actions)
        if numbers.shape != (*values.shape[:-1], self.outputs):
            return numbers
        scaled = self.commands(values, np.clip(numbers, -1.0, 1.0))
        return np.where(np.abs(numbers) <= most, scaled, numbers).astype(np.float32)


def scaling_of(task: Task, actions: bool = True) -> Scaling:
    """Return the scaling for a task's flat observations (arrays, not goal dictionaries).

    ``actions`` says whether actions shrink with the gap.

    Where actions move the tool, a gap counts as near if one action can close it.
    """
    near = dict(zip(("near", "near_turn"), task.tool[::3], strict=False))
    return Scaling(task.joints, task.camera, actions=actions, tool=len(task.tool), **near)


def vector_length(vector: Any) -> Any:
    """Compute the lengths ``(..., 1)`` of vectors ``(..., k)``."""
    return ((vector * vector).sum(-1)[..., None]) ** 0.5


def joined_observation(observation: Any, xp: Any = np) -> Any:
    """Concatenate the parts of a goal observation: observation, achieved goal, desired goal.

    A flat observation is returned as it is. ``xp`` is the module numpy or torch.
    """
    if not isinstance(observation, dict):
        return observation
    return xp.concatenate([observation[key] for key in ("observation", "achieved_goal", "desired_goal")], -1)
