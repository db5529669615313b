"""What findings depend on: constants that nobody measured, half as large and half as large again. Simulated."""

from pathlib import Path
from typing import Any

import numpy as np
from findings import judged, settings_of

from pickenv.arm import TRACKER, Plant, draw_plants, forward, load_plant, load_tolerances, plant_at, pose_of
from pickenv.arm.plant.plant_file import plant_times
from pickenv.base import InputError
from pickenv.calibration import random_joints
from pickenv.experiments.methods import kept_calibration
from pickenv.experiments.policies import population_seed

AS_SHIPPED = "as shipped"
REST = 6.0
"""s; as long as an arm has for a reach."""


def fits(plant: str, constant: str, times: float, **_: Any) -> bool:
    """Constants that the plant has; as shipped once."""
    if constant == AS_SHIPPED:
        return times == 1.0
    return times != 1.0 and any(group.name == constant for group in load_plant(plant).unmeasured)


def changed(plant: Plant, constant: str, times: float) -> Plant:
    """The plant with a group of its constants multiplied; as shipped, none."""
    return plant if constant == AS_SHIPPED else plant_times(plant, {constant: times})


def measure(
    rng: np.random.Generator, plant: str, constant: str, times: float, arms: int, episodes: int, folder: str, seed: int
) -> dict[str, np.ndarray]:
    """A row for each arm: what it leaves raw and with LS, what an instrument in time changes, what Li's cup takes."""
    draws = np.random.default_rng(population_seed(seed))
    plants = draw_plants(changed(load_plant(plant), constant, times), load_tolerances("coarse"), arms, draws)
    nominal = plants.arm.nominal
    goals = random_joints(nominal, episodes * arms, rng).reshape(episodes, arms, -1)
    targets = forward(nominal, goals)
    home = np.broadcast_to((nominal.lower + nominal.upper) / 2, goals.shape)

    def ended(by: Any) -> tuple[np.ndarray, np.ndarray]:
        """Mean error, mm, and share taken ``(arms,)``, of reaches from home that a calibration corrects."""
        q = goals if by is None else np.stack([correct(goals[:, i]) for i, correct in enumerate(by)], axis=1)
        state = plants.initial_state(np, list(np.moveaxis(home, -1, 0)))
        pose = pose_of(plants.advance(np, state, list(np.moveaxis(q, -1, 0)), REST)[1])
        error, taken = judged(pose, targets)
        return error.mean(axis=0), taken.mean(axis=0)

    def calibrated(instrument: str) -> list[Any]:
        """Corrections by least squares, in this order; an arm whose rows are refused stays as it is."""
        plan, corrections = settings_of(arms, 1, 1, seed, instrument=instrument).plan, []
        for number in range(arms):
            try:
                kept = kept_calibration(Path(folder) / "calibrations", plant_at(plants, number), "ls", plan, number)
                corrections.append(kept.compensator())
            except InputError:
                corrections.append(np.asarray)
        return corrections

    in_time, ideal = calibrated(TRACKER), calibrated("ideal")
    (raw, raw_taken), (ls, ls_taken), (at_rest, _) = ended(None), ended(in_time), ended(ideal)
    refused = np.array([np.asarray in pair for pair in zip(in_time, ideal, strict=True)], dtype=float)
    numbers = {"raw_mm": raw, "ls_mm": ls, "instrument_mm": ls - at_rest, "more_taken": ls_taken - raw_taken}
    return numbers | {"refused": refused, "arm": np.arange(arms)}
