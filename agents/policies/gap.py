"""Observations and actions for learning to the last millimetre: the gap by direction and logarithm, actions to match.

A network that reads a gap in metres is blind to millimetres, and its noise hides them. Here the gap to the fruit enters
as a direction of about unit length and the logarithm of its size, and near the fruit an action is a share of what is
left: what a policy learns about decimetres then holds for micrometres. The same lines run on NumPy and on torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pickenv.errors import InputError

SMALLEST = 1e-6
"""Share of the near gap below which the gap shrinks no further: 0.1 um."""


@dataclass(frozen=True)
class Scaling:
    """Where the numbers stand in an observation, and what counts as near.

    Attributes:
        joints: Number of joints n.
        camera: Whether the flat observation ends with the camera's gap.
        goal: Whether it is a goal observation: observation, achieved and desired goal, one after the other.
        actions: Whether actions shrink with the gap; if not, only the observation changes.
        near: Gap below which actions shrink with it, m.
        near_turn: The same for the attitude, rad.
    """

    joints: int
    camera: bool = False
    goal: bool = False
    actions: bool = True
    near: float = 0.1
    near_turn: float = 0.2

    @property
    def inputs(self) -> int:
        """Numbers in the observation."""
        return self.joints + (12 if self.goal or not self.camera else 15)

    @property
    def features(self) -> int:
        """Numbers that the networks see."""
        return self.joints + 7

    def check(self, width: int) -> None:
        """Refuse observations of another length.

        Raises:
            InputError: If ``width`` is not `inputs`.
        """
        if width != self.inputs:
            raise InputError(
                f"the policy was trained on observations of {self.inputs} numbers, but the environment gives {width}; "
                "use the feedback and the arm of its training"
            )

    def gap(self, values: Any) -> tuple[Any, Any]:
        """Gap between tool and fruit (m) and between attitudes (rad), ``(..., 3)`` each."""
        n = self.joints
        if self.goal:
            return values[..., n + 9 : n + 12] - values[..., n + 6 : n + 9], values[..., n + 3 : n + 6]
        return values[..., n + 12 :] if self.camera else values[..., n + 6 : n + 9], values[..., n + 9 : n + 12]

    def size(self, values: Any, xp: Any) -> Any:
        """Size of the gap ``(..., 1)``; 1 is near."""
        gap, turn = self.gap(values)
        far, turned = (
            ((part * part).sum(-1)[..., None]) ** 0.5 / near
            for part, near in ((gap, self.near), (turn, self.near_turn))
        )
        return xp.clip(xp.maximum(far, turned), SMALLEST, None)

    def share(self, values: Any, xp: Any) -> Any:
        """What an action of the network is multiplied by ``(..., 1)``."""
        size = self.size(values, xp)
        return xp.clip(size, None, 1.0) if self.actions else 0.0 * size + 1.0

    def observe(self, values: Any, xp: Any) -> Any:
        """What the networks see ``(..., features)``; ``xp`` is numpy or torch."""
        gap, turn = self.gap(values)
        size = self.size(values, xp)
        parts = (values[..., : self.joints], gap / (self.near * size), turn / (self.near_turn * size))
        return xp.concatenate((*parts, xp.log10(size) / 2.0), -1)


def joined_observation(observation: Any, xp: Any = np) -> Any:
    """A goal observation as one array; a flat one as it is."""
    if not isinstance(observation, dict):
        return observation
    return xp.concatenate([observation[key] for key in ("observation", "achieved_goal", "desired_goal")], -1)
