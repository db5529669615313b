"""Steps of environments as entities of a recording: arms, misses and numbers along the time lines of an evaluation.

Time lines: `step` counts the recorded resets and steps of an environment, `sim_time` is the same in seconds, and on
`episode` one sees how each episode ended. Everything comes from `info`; what it does not hold is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from pickenv.arm.kinematics.geometry import Array, Geometry
from pickenv.inspect.colours import FRUIT, GREY, RED, STEEL, policy_colours
from pickenv.inspect.recordings.scribe import Scribe, f32, move_arm, reading_columns, send_arm, send_capture
from pickenv.inspect.runs.links import drawn_parts, nominal_points, true_points

Trigger = Callable[[int], bool]

UNITS = {"mm": "mm", "deg": "°"}
"""Ends of the names of numbers, and their units; numbers with another end are counts, or have the unit 1."""
OTHERS = "other"
FRUIT_RADIUS = 0.02
"""m."""


def capped_cubic(episode: int) -> bool:
    """Whether RecordVideo's schedule takes this episode: 0, 1, 8, 27 … and, from 1000 on, every thousandth."""
    return round(episode ** (1.0 / 3.0)) ** 3 == episode if episode < 1000 else episode % 1000 == 0


class Row(NamedTuple):
    """One recorded step.

    Attributes:
        moment: Number of steps of this environment that were recorded before it.
        episode: Number of the episode.
        reward: Its reward; 0 after a reset.
        info: Its info.
    """

    moment: int
    episode: int
    reward: float
    info: Mapping[str, Any]


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
    _left: float = 0.0

    def begins(self) -> bool:
        """Count an episode; whether its first info is to be noted."""
        self.episode += 1
        if self.length == np.inf:
            self._left = 0.0
        if self.episode_trigger is not None and self.episode_trigger(self.episode):
            self._left = self.length
        return self._wanted()

    def steps(self) -> bool:
        """Count a step; whether its info is to be noted."""
        self._step += 1
        if self.step_trigger is not None and self.step_trigger(self._step):
            self._left = self.length
        return self._wanted()

    def _wanted(self) -> bool:
        if self._left > 0.0:
            self._left -= 1.0
            return True
        return False

    def note(self, info: Mapping[str, Any], reward: float) -> None:
        """Keep the present step."""
        self.rows.append(Row(len(self.rows), self.episode, reward, info))


@dataclass(frozen=True)
class Scene:
    """What all environments of a recording share.

    Attributes:
        nominal: The nominal arm, or None for environments without one.
        period: Time between steps, s.
        tolerance_mm: Radius of the capture region, or None.
        policy: Name of the policy, which gives the colour.
    """

    nominal: Geometry | None
    period: float
    tolerance_mm: float | None
    policy: str

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
    return {"tool_position", "fruit_position"} <= set(info)


def number_groups(info: Mapping[str, Any]) -> dict[str, list[str]]:
    """Names of the numbers in ``info`` by unit, the reward among them; truth values and arrays are no numbers."""
    groups: dict[str, list[str]] = {}
    for name, value in info.items():
        if np.ndim(value) == 0 and isinstance(value, int | float | np.number) and not isinstance(value, bool):
            end = name.rpartition("_")[2]
            groups.setdefault(end if end in UNITS else OTHERS, []).append(name)
    groups.setdefault(OTHERS, []).append("reward")
    return groups


def send_looks(stream: rr.RecordingStream, scene: Scene, key: str, row: Row) -> None:
    """Send what holds for all steps of one environment, given one of its rows."""
    scribe, info = Scribe(stream), row.info
    (colour,) = policy_colours([scene.policy])
    if has_arm(scene, info):
        points = _arms(scene, [row])[0]
        send_arm(scribe, f"world/arm/nominal/{key}", points, scene.parts, GREY, "majorwireframe")
        send_arm(scribe, f"world/arm/true/{key}", points, scene.parts, colour, "solid", 0.5)
    if has_fruit(info):
        scribe.still(f"world/fruit/{key}", rr.Points3D.from_fields(colors=[FRUIT], radii=[FRUIT_RADIUS]))
        arrow = rr.Arrows3D.from_fields(colors=[RED], radii=rr.Radius.ui_points(2.0))
        scribe.still(f"world/miss/{key}", arrow)
        scribe.still(f"target/{key}", rr.Points3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(4.0)))
        if scene.tolerance_mm is not None:
            send_capture(scribe, scene.tolerance_mm)
    for unit, names in number_groups(info).items():
        scribe.still(f"metrics/{unit}/{key}", rr.SeriesLines(names=[name.replace("_", " ") for name in names]))
    if "is_success" in info:
        states = rr.StateConfiguration(
            values=["yes", "no"], labels=["success", "not yet"], colors=[(*colour, 255), (*STEEL, 255)]
        )
        scribe.still(f"outcome/{key}", states)


def send_rows(stream: rr.RecordingStream, scene: Scene, key: str, rows: Sequence[Row]) -> None:
    """Send ``rows`` of one environment as whole columns."""
    moments = np.array([row.moment for row in rows])
    scribe = Scribe(
        stream,
        [
            rr.TimeColumn("step", sequence=moments),
            rr.TimeColumn("episode", sequence=[row.episode for row in rows]),
            rr.TimeColumn("sim_time", duration=scene.period * moments),
        ],
    )
    info = rows[0].info
    if has_arm(scene, info):
        nominal, true = _arms(scene, rows)
        move_arm(scribe, f"world/arm/nominal/{key}", nominal, scene.parts)
        move_arm(scribe, f"world/arm/true/{key}", true, scene.parts)
    if has_fruit(info):
        fruit, tool = _column(rows, "fruit_position"), _column(rows, "tool_position")
        miss = tool - fruit
        scribe.along(f"world/fruit/{key}", rr.Points3D.columns(positions=f32(fruit)))
        arrows = rr.Arrows3D.columns(origins=f32(fruit), vectors=f32(miss))
        scribe.along(f"world/miss/{key}", arrows, reading_columns(1e3 * miss))
        scribe.along(f"target/{key}", rr.Points3D.columns(positions=f32(1e3 * miss)))
    for unit, names in number_groups(info).items():
        values = [[row.reward if name == "reward" else row.info[name] for name in names] for row in rows]
        scalars = rr.Scalars.columns(scalars=np.array(values, dtype=float).ravel())
        scribe.along(f"metrics/{unit}/{key}", scalars.partition([len(names)] * len(rows)))
    if "is_success" in info:
        states = ["yes" if row.info["is_success"] else "no" for row in rows]
        scribe.along(f"outcome/{key}", rr.StateChange.columns(state=states))


def _arms(scene: Scene, rows: Sequence[Row]) -> tuple[Array, Array]:
    """Points along the nominal arm under the drives' commands, and along the true arm, ``(T, K, 3)``, m.

    The true arm is the nominal one brought to where the true tool stood: at true size nobody sees the difference.
    """
    assert scene.nominal is not None
    joints = _column(rows, "joint_command")
    return nominal_points(scene.nominal, joints), true_points(scene.nominal, joints, _column(rows, "tool_position"))


def _column(rows: Sequence[Row], name: str) -> Array:
    return np.array([row.info[name] for row in rows], dtype=float)
