"""Where a picking arm stands before the canopy, how big its tool is, and what it does to fruit. Units: m, s, N."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from pickenv.orchard import checks, presets


@dataclass(frozen=True)
class Station:
    """A section of canopy before an arm's base; the arm comes from below.

    Attributes:
        middle: x of the section's middle in the base frame, m.
        face: y of the canopy's face, m.
        mount: z of its lowest fruit, m.
        width: Size of the section, m.
        height: m.
        depth: m.
        tool_radius: Outer radius of the gripper, m.
        tool_length: Its length below the tool's point, m.
        approach: Straight way from below to a fruit, m.
        blocked: Fruit nearer than this to the axis of that way blocks it, m.
        near: The gripper closes only where its fruit is believed to be nearer than this, m.
        collected_below: A detached fruit is collected once the tool has gone down by this, m.
        bruise_speed: A tool that hits a fruit faster than this bruises it, m/s.
        knock: How far a failed grasp pushes its fruit, m.
        most_push: How far any fruit can be pushed, m.
        twist: Torque of the gripper at full command, N·m.
    """

    middle: float
    face: float
    mount: float
    width: float
    height: float
    depth: float
    tool_radius: float
    tool_length: float
    approach: float
    blocked: float
    near: float
    collected_below: float
    bruise_speed: float
    knock: float
    most_push: float
    twist: float

    def __post_init__(self) -> None:
        for field in fields(self)[3:]:
            checks.positive(f"{field.name} of a station", getattr(self, field.name))


def load_station(name: str | Path) -> Station:
    """Read a station by name (`shipped("station")`) or from a path to a TOML file."""
    units = {"bruise_speed": "m_per_s", "twist": "N_m"}
    keys = [f"{field.name}_{units.get(field.name, 'mm')}" for field in fields(Station)]
    return presets.load("station", name, lambda p: Station(*(p.number(key) for key in keys)))
