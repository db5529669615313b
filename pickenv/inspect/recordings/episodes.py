"""Which steps of environments are recorded, and what is kept of them.

Everything comes from `info`; what it does not hold is left out. `pickenv.inspect.recordings.episode_entities` sends it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pickenv.arm import Array, Geometry
from pickenv.inspect.runs.recorded_episodes import POSITIONS
from pickenv.inspect.runs.saved import drawn_parts, nominal_points

Trigger = Callable[[int], bool]

UNITS = {"mm": "mm", "deg": "°"}
"""Ends of the names of numbers, and their units; numbers with another end are counts, or have the unit 1."""
OTHERS = "other"


def capped_cubic(episode: int) -> bool:
    """Whether RecordVideo's schedule takes this episode: 0, 1, 8, 27 … and, from 1000 on, every thousandth."""
    return round(episode ** (1.0 / 3.0)) ** 3 == episode if episode < 1000 else episode % 1000 == 0


class Row(NamedTuple):
    """One recorded step.

    Attributes:
        moment: Number of steps of this environment that were recorded before it.
        episode: Number of the episode.
        within: Steps since the episode's reset.
        order: Number of episodes of which steps were recorded before this one.
        reward: Its reward; 0 after a reset.
        info: Its info.
        target: Joints at which the controller believes the arm to be; None where the environment does not tell.
    """

    moment: int
    episode: int
    within: int
    order: int
    reward: float
    info: Mapping[str, Any]
    target: Array | None = None


@dataclass
class EpisodeLog:
    """The recorded steps of one environment, and the choice which steps those are.

    Attributes:
        key: Name in entity paths: the policy, and the environment's number where there are several.
        episode_trigger: Whether to record from the start of an episode, given its number.
        step_trigger: Whether to record from a step, given its number.
        length: Steps of one recording; infinite for whole episodes.
        rows: What was recorded.
        episode: Number of the present episode.
    """

    key: str
    episode_trigger: Trigger | None
    step_trigger: Trigger | None
    length: float
    rows: list[Row] = field(default_factory=list)
    episode: int = -1
    _step: int = -1
    _within: int = 0
    _left: float = 0.0

    def begins(self) -> bool:
        """Count an episode; whether its first info is to be noted."""
        self.episode += 1
        self._within = 0
        if self.length == np.inf:
            self._left = 0.0
        if self.episode_trigger is not None and self.episode_trigger(self.episode):
            self._left = self.length
        return self._wanted()

    def steps(self) -> bool:
        """Count a step; whether its info is to be noted."""
        self._step += 1
        self._within += 1
        if self.step_trigger is not None and self.step_trigger(self._step):
            self._left = self.length
        return self._wanted()

    def _wanted(self) -> bool:
        if self._left > 0.0:
            self._left -= 1.0
            return True
        return False

    def note(self, info: Mapping[str, Any], reward: float, target: Array | None = None) -> None:
        """Keep the present step."""
        last = self.rows[-1] if self.rows else None
        order = 0 if last is None else last.order + (last.episode != self.episode)
        self.rows.append(Row(len(self.rows), self.episode, self._within, order, reward, info, target))


@dataclass(frozen=True)
class Scene:
    """What all environments of a recording share.

    Attributes:
        nominal: The nominal arm, or None for environments without one.
        period: Time between steps, s.
        tolerance_mm: Radius of the capture region, or None.
        policy: Key of the policy, which gives the colour.
        label: Its name for people.
    """

    nominal: Geometry | None
    period: float
    tolerance_mm: float | None
    policy: str
    label: str

    @cached_property
    def parts(self) -> list[int]:
        """Link parts that are drawn."""
        assert self.nominal is not None
        lower, upper = self.nominal.lower, self.nominal.upper
        return drawn_parts(nominal_points(self.nominal, np.stack([lower, (lower + upper) / 2.0, upper])))


def info_of(infos: Mapping[str, Any], index: int) -> dict[str, Any]:
    """One environment's info, copied out of a vector environment's infos, in which it may be overwritten."""
    info = {}
    for name, values in infos.items():
        if not name.startswith(("_", "final_")) and not isinstance(values, Mapping):
            value = values[index]
            value = np.array(value.cpu() if hasattr(value, "cpu") else value)
            info[name] = value if value.ndim else value.item()
    return info


def has_arm(scene: Scene, info: Mapping[str, Any]) -> bool:
    """Whether the arms can be drawn."""
    return scene.nominal is not None and {"joint_command", "tool_position"} <= set(info)


def has_fruit(info: Mapping[str, Any]) -> bool:
    """Whether misses can be drawn."""
    return set(POSITIONS) <= set(info)


def distances_mm(rows: Sequence[Row]) -> Array | None:
    """Distance between tool and fruit ``(T,)``; None where `info` tells neither positions nor the distance."""
    if has_fruit(rows[0].info):
        return np.asarray(1e3 * np.linalg.norm(column(rows, "tool_position") - column(rows, "fruit_position"), axis=1))
    return column(rows, "position_error_mm") if "position_error_mm" in rows[0].info else None


def last_rows(rows: Sequence[Row]) -> list[Row]:
    """The last recorded row of each episode."""
    return list({row.order: row for row in rows}.values())


def number_groups(info: Mapping[str, Any]) -> dict[str, list[str]]:
    """Names of the numbers in ``info`` by unit, the reward among them; truth values and arrays are no numbers."""
    groups: dict[str, list[str]] = {}
    for name, value in info.items():
        if np.ndim(value) == 0 and isinstance(value, int | float | np.number) and not isinstance(value, bool):
            end = name.rpartition("_")[2]
            groups.setdefault(end if end in UNITS else OTHERS, []).append(name)
    groups.setdefault(OTHERS, []).append("reward")
    return groups


def column(rows: Sequence[Row], name: str) -> Array:
    """One entry of `info` along the rows ``(T, ...)``."""
    return np.array([row.info[name] for row in rows], dtype=float)
