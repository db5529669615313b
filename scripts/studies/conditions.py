"""What payload, weather and hour of day cost: the measure of the study behind docs/conditions.md."""

from __future__ import annotations

from functools import partial

import numpy as np
from findings import world

from pickenv.arm import draw_plants, load_plant, load_tolerances
from pickenv.experiments import Rows, joined
from pickenv.experiments.conditions_study import (
    HELD_OUT,
    LEVELS,
    ConditionsSettings,
    judged_arm,
    warming,
)

STATES = {
    ("payload", 0): "at the reference",
    ("payload", LEVELS - 1): "0.5 kg",
    ("temperature", LEVELS - 1): "10 K warmer",
    ("hour", LEVELS - 1): "after 8 h",
    (HELD_OUT, 0): "held-out sessions",
}
"""Sweeps and levels that the page shows."""


def judged_states(rng: np.random.Generator, plant: str, draw: int, arms: int, seed: int) -> Rows:
    """Mean error of every arm, calibrated in every way, in five states: a row for each."""
    name, arms, seed = world(plant, draw, arms, seed)
    settings = ConditionsSettings(arms=arms, seed=seed)
    plants = draw_plants(warming(load_plant(name)), load_tolerances(settings.tolerances), arms, rng)
    judged = partial(judged_arm, rng, plants=plants, settings=settings, calibration=None)
    return joined([by_state(arm, judged(arm)) for arm in range(arms)])


def by_state(arm: int, poses: Rows) -> Rows:
    """The means over poses of one arm."""
    levels = [key for key in poses.levels("sweep", "level", "method") if key[:2] in STATES]
    means = [poses.where(sweep=s, level=k, method=m)["error_mm"].mean() for s, k, m in levels]
    return Rows(
        {
            "arm": np.full(len(levels), arm),
            "calibration": np.array([method for _, _, method in levels]),
            "state": np.array([STATES[sweep, level] for sweep, level, _ in levels]),
            "error_mm": np.array(means),
        }
    )
