"""Constants of the harvester's episodes: machine, orchard, eyes, rules and spaces. Units: m, rad, s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.base import MM, NUMBER, InputError, read_toml, toml_table
from pickenv.base.limits import shown
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.envs.shared.task import MOST_ACTION, as_numbers, check_choice, check_number
from pickenv.harvester import (
    Machine,
    Orchard,
    Picking,
    TrueMachine,
    load_machine,
    load_orchard,
    load_picking,
    load_true_machine,
)
from pickenv.harvester.trees import SHIPPED, lab_zone, tree_leaves
from pickenv.harvester.zones import AHEAD
from pickenv.orchard import Eyes, Sight, Viewpoint, load_eyes, sample_diameters, see

# The zone that a harvester begins with: fruit and how it is seen, drawn or as it is asked for. Units: m, rad.


OPTIONS = ("fruit", "start_joints")
DRAWS = 100
"""Draws of a zone until some of its fruit is located."""


def given_zones(task: HarvestTask, options: Mapping[str, Any], count: int, rows: Any = slice(None)) -> dict[str, Array]:
    """Fruit ``(machines, fruit, 3)`` and joints to start from ``(machines, joints)`` that options of `reset` ask for.

    Args:
        task: The task.
        options: The options; each is given once, or for each of the machines.
        count: Number of machines.
        rows: Of them those that are asked for.

    Returns:
        "fruit" and "joints", as far as they are given, as `begin_zones` takes them.

    Raises:
        InputError: If a shape is wrong or a number impossible.
    """
    machine, zones = task.machine, dict[str, Array]()
    for key, name, shape in (("fruit", "fruit", (task.fruit, 3)), ("joints", "start_joints", (machine.joints,))):
        if options.get(name) is None:
            continue
        values = as_numbers(f"option {name}", options[name])
        if values.shape not in (shape, (count, *shape)):
            raise InputError(f"option {name} has shape {values.shape}; give finite numbers of shape {shape}")
        if not np.isfinite(values).all():
            raise InputError(f"option {name} is {shown(values.tolist())}; give finite numbers of shape {shape}")
        zones[key] = np.broadcast_to(values, (count, *shape))[rows]
    joints = zones.get("joints")
    if joints is not None and not np.all((joints >= machine.lower) & (joints <= machine.upper)):
        limits = f"{np.round(machine.lower, 3).tolist()} to {np.round(machine.upper, 3).tolist()}"
        raise InputError(f"option start_joints lies outside the joint limits; give joints (rad, m) from {limits}")
    return zones


def drawn_zone(task: HarvestTask, rng: np.random.Generator, given: Array | None = None) -> tuple[Array, Array, Sight]:
    """Fruit ``(fruit, 3)`` and diameters of a zone in which some of it is located, and how it is seen.

    Args:
        task: The task.
        rng: Source of every draw.
        given: Positions of the fruit in place of drawn ones, or None; the cameras look at their middle.

    Raises:
        InputError: If the cameras find no fruit in many zones.
    """
    machine, canopy = task.machine, task.orchard.canopy
    zone = lab_zone(canopy)
    low, high = canopy.bottom - machine.base_height, canopy.top - machine.base_height - zone[2]
    for _ in range(DRAWS):
        if given is None:
            x = rng.uniform(-0.5, 0.5) * (canopy.width - zone[0])
            corner = np.array([x - zone[0] / 2, -canopy.standoff - canopy.depth, rng.uniform(low, high)])
            fruit, height = corner + zone * rng.random((task.fruit, 3)), corner[2] + zone[2] / 2
        else:
            fruit, x, height = given, given[:, 0].mean(), given[:, 2].mean()
        diameters = sample_diameters(task.orchard.size, task.fruit, rng)
        view = Viewpoint(np.array([x, 0.0, height]), AHEAD)
        sight = see(task.eyes, view, fruit, diameters, rng, leaves=tree_leaves(machine, task.eyes, rng))
        if sight.located.any():
            return fruit, diameters, sight
    advice = "give more fruit, or vision='ideal'" if given is None else "move the fruit of the option"
    raise InputError(f"the cameras found no fruit in {DRAWS} zones; {advice}")


@toml_table
class Rules:
    """When a cup tries a fruit, what is shown, and what costs; see [task] of picking.toml.

    Attributes:
        sensor: Height within which the position sensor finds a fruit in the cup, m.
        rearm: A cup that tried a fruit tries again only after going this far away from it, m.
        shown: Largest offset that an observation shows, m.
        guard_cost: Reward lost for each arm that the guard holds.
        period_cost: Reward lost in each period.
        motion_cost: Reward lost in a period in which all joints move as fast as they can.
    """

    sensor: Annotated[float, MM.positive]
    rearm: Annotated[float, MM.positive]
    shown: Annotated[float, MM.positive]
    guard_cost: Annotated[float, NUMBER.not_negative]
    period_cost: Annotated[float, NUMBER.not_negative]
    motion_cost: Annotated[float, NUMBER.not_negative]


@lru_cache(maxsize=1)
def load_rules() -> Rules:
    """Read the rules of the task."""
    return read_toml(Rules, SHIPPED, section="task")


@dataclass(frozen=True, eq=False)
class HarvestTask:
    """Constants of a harvester's episodes.

    Attributes:
        machine: The machine as drawn.
        true: The machine as built.
        model: What becomes of attempts.
        rules: When a cup tries a fruit, what is shown, and what costs.
        orchard: Where fruit hangs and how big it is.
        eyes: How it is seen.
        fruit: Fruit in a zone.
        most_action: Largest size of an action's numbers that is taken.
    """

    machine: Machine
    true: TrueMachine
    model: Picking
    rules: Rules
    orchard: Orchard
    eyes: Eyes
    fruit: int
    most_action: float

    @cached_property
    def increment(self) -> Array:
        """Largest increment of each joint in one period."""
        return self.machine.speed * CONTROL_PERIOD

    @cached_property
    def lead(self) -> int:
        """Periods that sensing and cutting take."""
        return int(np.ceil((self.machine.cycle.sense + self.machine.cycle.cut) / CONTROL_PERIOD - 1e-9))

    @cached_property
    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Smallest and largest observation."""
        box = harvest_spaces(self)[0]
        return box.low, box.high


def make_harvest_task(
    slaves: int | None = None,
    spacing_mm: float | None = None,
    fruit: int = 8,
    ideal: bool = False,
    vision: str = "measured_errors",
    detector: str = "li2016",
    canopy: str | None = None,
    out_of_range: str = "clip",
) -> HarvestTask:
    """Check the arguments of an environment and read its files.

    Raises:
        InputError: If one of them is impossible.
    """
    check_choice("out_of_range", out_of_range, tuple(MOST_ACTION))
    if isinstance(fruit, bool) or not isinstance(fruit, int) or not 1 <= fruit <= 40:
        raise InputError(f"a zone of {fruit} fruit is impossible; give a whole number from 1 to 40")
    if spacing_mm is not None:
        check_number("spacing_mm", spacing_mm, positive=True)
    machine = load_machine(slaves=slaves, spacing=None if spacing_mm is None else spacing_mm * 1e-3)
    true = load_true_machine(machine)
    if ideal:
        true = true.ideal()
    orchard = load_orchard(canopy=canopy)
    eyes = load_eyes(vision, orchard.canopy, detector)
    most = MOST_ACTION[out_of_range]
    return HarvestTask(machine, true, load_picking(), load_rules(), orchard, eyes, fruit, most)


def harvest_spaces(task: HarvestTask, extra: int = 0) -> tuple[Box[np.float32], Box[np.float32]]:
    """Observation space, with room for some numbers from 0 to 1 at its end, and action space."""
    joints, arms, most = task.machine.joints, task.machine.arms, task.rules.shown
    high = [1.0] * (joints + arms) + [most, most, most, 1.0] * task.fruit + [1.0] * extra
    low = [-1.0] * joints + [0.0] * arms + [-most, -most, -most, 0.0] * task.fruit + [0.0] * extra
    observations = Box(np.array(low, dtype=np.float32), np.array(high, dtype=np.float32), dtype=np.float32)
    return observations, Box(-1.0, 1.0, (joints,), np.float32)
