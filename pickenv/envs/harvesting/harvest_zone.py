"""The zone that a harvester begins with: fruit and how it is seen, drawn or as it is asked for. Units: m, rad."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from pickenv.arm import Array
from pickenv.envs.harvesting.harvest_task import HarvestTask
from pickenv.envs.shared.task import as_numbers
from pickenv.errors import InputError
from pickenv.harvester.trees import lab_zone, tree_leaves
from pickenv.harvester.zones import AHEAD
from pickenv.limits import shown
from pickenv.orchard import Sight, Viewpoint, sample_diameters, see

OPTIONS = ("fruit", "start_joints")
DRAWS = 100
"""Draws of a zone until some of its fruit is located."""


class GivenZones(NamedTuple):
    """What is asked for in place of draws, one entry per machine; None where nothing is.

    Attributes:
        fruit: Positions ``(machines, fruit, 3)``, base frame.
        joints: Joints of whole machines to start from ``(machines, joints)``.
    """

    fruit: Array | None = None
    joints: Array | None = None


AS_DRAWN = GivenZones()


def given_zones(task: HarvestTask, options: Mapping[str, Any], count: int, rows: Any = slice(None)) -> GivenZones:
    """The options of `reset` for ``count`` machines, given once or for each; of them those in ``rows``.

    Raises:
        InputError: If a shape is wrong or a number impossible.
    """
    machine, found = task.machine, list[Any]()
    for name, shape in (("fruit", (task.fruit, 3)), ("start_joints", (machine.joints,))):
        if options.get(name) is None:
            found.append(None)
            continue
        given = as_numbers(f"option {name}", options[name])
        if given.shape not in (shape, (count, *shape)):
            raise InputError(f"option {name} has shape {given.shape}; give finite numbers of shape {shape}")
        if not np.isfinite(given).all():
            raise InputError(f"option {name} is {shown(given.tolist())}; give finite numbers of shape {shape}")
        found.append(np.broadcast_to(given, (count, *shape))[rows])
    fruit, joints = found
    if joints is not None and not np.all((joints >= machine.lower) & (joints <= machine.upper)):
        limits = f"{np.round(machine.lower, 3).tolist()} to {np.round(machine.upper, 3).tolist()}"
        raise InputError(f"option start_joints lies outside the joint limits; give joints (rad, m) from {limits}")
    return GivenZones(fruit, joints)


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
