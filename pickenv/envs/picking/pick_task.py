"""What `pickenv/Pick-v0` is made with: its arguments, checked, as a task of the arm and a setting of fruit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pickenv.envs.picking.pick_scene import PUBLISHED, PickSetting, make_setting
from pickenv.envs.shared.task import Task, check_count, check_number, make_task


def make_pick(
    plant: str = "orchard",
    without: Sequence[str] = (),
    gripper: str = "li_cup",
    camera: str = "laser_line",
    canopy: str = "li2016",
    fruit_map: str = "li2016_lab",
    fruit_size: str = "li2016",
    fruit: float = 10.0,
    looks: int = 16,
    vision: str = PUBLISHED,
    detector: str = "li2016",
    arms: str = "fixed",
    tolerances: str = "medium",
    population: int = 256,
    population_seed: int = 0,
    out_of_range: str = "clip",
    **situation: Any,
) -> tuple[Task, PickSetting]:
    """Check the arguments (`pickenv/Pick-v0` explains them) and read the presets.

    Raises:
        InputError: If an argument is impossible; one sentence says which.
    """
    check_number("fruit", fruit, positive=True)
    check_count("looks", looks)
    drawn: dict[str, Any] = {"tolerances": tolerances, "population": population, "population_seed": population_seed}
    task = make_task(plant, without, arms=arms, out_of_range=out_of_range, **drawn, **situation)
    return task, make_setting(canopy, fruit_map, fruit_size, camera, gripper, fruit, looks, vision, detector)
