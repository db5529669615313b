"""Where a picking arm stands before the canopy, how big its tool is, and what it does to fruit. Units: m, s, N."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM
from pickenv.toml_tables import Unit, toml_table


@toml_table
class Station(checks.Preset):
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
        source: Where its numbers come from.
    """

    middle: Annotated[float, MM]
    face: Annotated[float, MM]
    mount: Annotated[float, MM]
    width: Annotated[float, MM.positive]
    height: Annotated[float, MM.positive]
    depth: Annotated[float, MM.positive]
    tool_radius: Annotated[float, MM.positive]
    tool_length: Annotated[float, MM.positive]
    approach: Annotated[float, MM.positive]
    blocked: Annotated[float, MM.positive]
    near: Annotated[float, MM.positive]
    collected_below: Annotated[float, MM.positive]
    bruise_speed: Annotated[float, Unit("m_per_s").positive]
    knock: Annotated[float, MM.positive]
    most_push: Annotated[float, MM.positive]
    twist: Annotated[float, Unit("N_m").positive]
    source: str = ""


def load_station(name: str | Path) -> Station:
    """Read a station by name (`shipped("station")`) or from a path to a TOML file."""
    return preset_files.load("station", name, Station)
