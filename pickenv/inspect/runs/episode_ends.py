"""How episodes of reaching for a fruit ended: the numbers that evaluations, pages and recordings start from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import noncompensable_error
from pickenv.arm.kinematics.geometry import Array, Geometry


@dataclass(frozen=True, eq=False)
class Reaches:
    """The ends of R episodes.

    Attributes:
        seeds: Seed of each episode.
        pose_error: True tool against fruit ``(R, 6)``, m and rad.
        noncompensable: The part of it that no joint motion removes ``(R, 6)``.
        success: Whether the fruit was inside the capture region.
        joint_command: What the drives got at the end ``(R, n)``.
        tool_position: True tool positions ``(R, 3)``, m.
        fruit_position: Fruit ``(R, 3)``, m.
    """

    seeds: tuple[int, ...]
    pose_error: Array
    noncompensable: Array
    success: NDArray[np.bool_]
    joint_command: Array
    tool_position: Array
    fruit_position: Array

    @property
    def position_error_mm(self) -> Array:
        """Final distances ``(R,)``."""
        return np.asarray(np.linalg.norm(self.pose_error[:, :3], axis=1) * 1e3)

    @property
    def attitude_error_deg(self) -> Array:
        """Final attitude errors ``(R,)``."""
        return np.asarray(np.degrees(np.linalg.norm(self.pose_error[:, 3:], axis=1)))

    @property
    def noncompensable_deg(self) -> Array:
        """Their part that no joint motion removes ``(R,)``."""
        return np.asarray(np.degrees(np.linalg.norm(self.noncompensable[:, 3:], axis=1)))


def reaches_of(geometry: Geometry, seeds: Sequence[int], infos: Mapping[str, Any]) -> Reaches:
    """The ends of episodes, given the arm's true geometry and the `info` of their last steps, stacked."""
    names = ("pose_error", "joint_command", "tool_position", "fruit_position")
    found = {name: np.array(infos[name], order="C") for name in names}
    return Reaches(
        seeds=tuple(seeds),
        noncompensable=noncompensable_error(geometry, found["joint_command"], found["pose_error"]),
        success=np.array(infos["is_success"]),
        **found,
    )
