"""Li's experiment (section 5.2): images of fruit in reach of the pick point, each picked once. Units: m."""

from __future__ import annotations

import numpy as np

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.harvester import (
    Grid,
    Harvest,
    Machine,
    Picking,
    Strategy,
    Tree,
    TrueMachine,
    harvest,
    lab_zone,
    load_lab,
    pick_point,
)
from pickenv.harvester.harvest_run import generators_of
from pickenv.orchard import fruit_masses, load_canopy, load_eyes, load_fruit_size

TRIES = 1000


def sample_image(machine: Machine, rng: np.random.Generator) -> Tree:
    """Draw one image of Li's lab: fruit all in reach from the corrected pick point, and not in clusters.

    Raises:
        InputError: If a thousand draws give none: the machine reaches too little.
    """
    lab = load_lab()
    count, wide, high = lab.fruit, lab.width, lab.height
    canopy, size = load_canopy(lab.canopy), load_fruit_size("li2016")
    low, top = canopy.bottom - machine.base_height, canopy.top - machine.base_height
    for _ in range(TRIES):
        x = rng.uniform(-(canopy.width - wide) / 2, (canopy.width - wide) / 2) / 2
        z = rng.uniform(low, top - high)
        corner = np.array([x - wide / 2, -canopy.standoff - canopy.depth, z])
        fruit = corner + lab_zone(canopy) * rng.random((count, 3))
        if count > 1 and _least_distance(fruit) < lab.apart:
            continue
        master = pick_point(machine, fruit, "corrected")
        if machine.master_within_limits(master) and machine.reach(master, fruit).any(axis=0).all():
            diameters = np.full(count, size.mean)
            side = (float(corner[0]), float(corner[0]) + wide, z, z + high)
            return Tree(fruit, diameters, fruit_masses(size, diameters), side)
    raise InputError(f"the machine reaches no image of {count} fruit; widen its spacing or give more arms")


def _least_distance(points: Array) -> float:
    i, j = np.triu_indices(len(points), 1)
    return float(np.linalg.norm(points[i] - points[j], axis=-1).min())


def work_images(
    true: TrueMachine,
    strategy: Strategy,
    model: Picking,
    *,
    count: int,
    seed: int,
    vision: str = "measured_errors",
) -> list[Harvest]:
    """Li's experiment: ``count`` images of seven fruit in reach of the *paper's* pick point, each picked once."""
    tree_rngs, rngs = generators_of(np.random.SeedSequence(seed).spawn(count))
    images = [sample_image(true.machine, rng) for rng in tree_rngs]
    eyes = load_eyes(vision, load_canopy(load_lab().canopy), strategy.detector)
    return harvest(true, strategy, model, images, rngs, Grid(1, 1, 1e-6), eyes)
