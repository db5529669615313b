"""Which true arm an environment has: one for all, or one of a population, chosen by the environment's random stream.

A population is one plant whose numbers are arrays (`pickenv.arm.plant.tolerances.draw_plants`). Environments keep
their own rows of these arrays, so that arms can be exchanged one by one without building a new plant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np

from pickenv.arm.kinematics.geometry import LINK_PARAMETERS
from pickenv.arm.plant.plant import EFFECTS, Plant
from pickenv.arm.plant.plant_batch import plant_count
from pickenv.envs.shared.backends import Executor, Scalar
from pickenv.envs.shared.streams import ARM, stream_key, uniform
from pickenv.envs.shared.task import Task

Change = Callable[[Any], Scalar]


def choose_arm(x: Executor, key: Scalar) -> Scalar:
    """Uniform number in [0, 1) whose share of the population's size is the arm's number.

    Args:
        x: The executor.
        key: Key of the episode; with one arm per environment, that of episode 0.
    """
    return uniform(x, stream_key(x, key, ARM), 0)


def population_size(task: Task) -> int:
    """Number of arms that environments choose from."""
    return plant_count(task.plant) or 1


def changed_plant(plant: Plant, change: Change) -> Plant:
    """``plant`` with each of its arrays changed, those of its prepared chain too.

    The chain's sines and cosines are changed, not computed anew, so that an arm has the same numbers to the bit however
    many others stand beside it.
    """
    if plant_count(plant) is None:
        return plant
    links: dict[str, Any] = {name: change(getattr(plant.geometry, name)) for name in LINK_PARAMETERS}
    parts = {name: _changed(getattr(plant, name), change) for name in ("load", *EFFECTS)}
    changed = replace(plant, geometry=replace(plant.geometry, **links), **parts)
    vars(changed)["chain"] = _changed(plant.chain, change)  # where its cached property keeps it
    return changed


def prepare(plant: Plant, m: ModuleType, example: Sequence[Scalar]) -> Plant:
    """Fill the plant's caches by moving it once to joints ``example``: torch.compile cannot fill them."""
    plant.tool_frame(m, example)
    plant.advance(m, plant.initial_state(m, example), example, 0.0)
    return plant


def numbers_of(plant: Plant) -> list[Any]:
    """All arrays of a plant, in a fixed order."""
    found: list[Any] = []

    def note(values: Any) -> Any:
        found.append(values)
        return values

    changed_plant(plant, note)
    return found


def _changed(value: Any, change: Change) -> Any:
    """A tree of tuples and dataclasses with every array in it changed."""
    if isinstance(value, np.ndarray) or type(value).__module__ == "torch":
        return change(value) if value.ndim else value
    if isinstance(value, tuple):
        parts = [_changed(entry, change) for entry in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: _changed(getattr(value, field.name), change) for field in fields(value)})
    return value
