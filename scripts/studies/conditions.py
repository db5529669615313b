"""What payload, weather and hour of day cost: the measure of the study behind docs/conditions.md."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from findings import world

from pickenv.arm import draw_plants, load_plant, load_tolerances
from pickenv.experiments import Rows
from pickenv.experiments.conditions_study import HELD_OUT, LEVELS, ConditionsSettings, judged_arm, warming

STATES = {
    ("payload", 0): "at the reference",
    ("payload", LEVELS - 1): "0.5 kg",
    ("temperature", LEVELS - 1): "10 K warmer",
    ("hour", LEVELS - 1): "after 8 h",
    (HELD_OUT, 0): "held-out sessions",
}
"""Sweeps and levels that the page shows."""


def judged_states(rng: np.random.Generator, plant: str, draw: int, arms: int, seed: int) -> list[dict[str, Any]]:
    """Mean error of every arm, calibrated in every way, in five states: a row for each."""
    name, arms, seed = world(plant, draw, arms, seed)
    settings = ConditionsSettings(arms=arms, seed=seed)
    plants = draw_plants(warming(load_plant(name)), load_tolerances(settings.tolerances), arms, rng)
    judged = partial(judged_arm, rng, plants=plants, settings=settings, calibration=None)
    return [{"arm": arm} | row for arm in range(arms) for row in by_state(judged(arm))]


def by_state(poses: Rows) -> Iterator[dict[str, Any]]:
    """The means over poses of one arm."""
    for sweep, level, method in poses.levels("sweep", "level", "method"):
        if (sweep, level) in STATES:
            mean = poses.where(sweep=sweep, level=level, method=method)["error_mm"].mean()
            yield {"calibration": method, "state": STATES[sweep, level], "error_mm": mean}
