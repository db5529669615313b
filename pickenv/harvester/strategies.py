"""The same trees under different strategies: drawn from one seed, tree by tree, whatever the number of workers."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np

from pickenv.base import InputError
from pickenv.harvester.harvest_run import Harvest, Strategy, harvest
from pickenv.harvester.picking import Picking
from pickenv.harvester.trees import Orchard, Tree, load_lab, sample_image, sample_tree
from pickenv.harvester.true_machine import TrueMachine
from pickenv.harvester.zones import Grid
from pickenv.orchard import load_canopy, load_eyes


def _generators(seeds: Sequence[np.random.SeedSequence]) -> tuple[list[np.random.Generator], list[np.random.Generator]]:
    """For each seed a generator of the tree and one of what happens to it."""
    pairs = [np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key).spawn(2) for seed in seeds]
    return [np.random.default_rng(a) for a, _ in pairs], [np.random.default_rng(b) for _, b in pairs]


def _some_trees(
    true: TrueMachine,
    strategy: Strategy,
    model: Picking,
    orchard: Orchard,
    grid: Grid,
    vision: str,
    seeds: Sequence[np.random.SeedSequence],
) -> list[Harvest]:
    drawn, happening = _generators(seeds)
    trees = [sample_tree(true.machine, orchard, rng) for rng in drawn]
    return harvest(true, strategy, model, trees, happening, grid, load_eyes(vision, orchard.canopy, strategy.detector))


def work_trees(
    true: TrueMachine,
    strategy: Strategy,
    model: Picking,
    orchard: Orchard,
    grid: Grid,
    *,
    count: int,
    seed: int,
    workers: int = 1,
    vision: str = "measured_errors",
) -> list[Harvest]:
    """Draw ``count`` trees from ``seed`` and work them; equal seeds give equal trees for every strategy and vision.

    Args:
        true: The machine as built.
        strategy: How it works.
        model: What becomes of attempts.
        orchard: What trees are drawn from.
        grid: How each side is cut into zones.
        count: Number of trees.
        seed: Of trees and luck.
        workers: Processes.
        vision: What the cameras show, of `pickenv.orchard.VISIONS`.

    Raises:
        InputError: If the count or the number of workers is not above zero.
    """
    if count < 1 or workers < 1:
        raise InputError(f"{count} trees on {workers} workers are impossible; give 1 or more of each")
    seeds = np.random.SeedSequence(seed).spawn(count)
    job = partial(_some_trees, true, strategy, model, orchard, grid, vision)
    if workers == 1 or count < 2 * workers:
        return job(seeds)
    parts = [seeds[i::workers] for i in range(workers)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        done = list(pool.map(job, parts))
    return [done[i % workers][i // workers] for i in range(count)]


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
    drawn, happening = _generators(np.random.SeedSequence(seed).spawn(count))
    images: list[Tree] = [sample_image(true.machine, rng) for rng in drawn]
    eyes = load_eyes(vision, load_canopy(load_lab().canopy), strategy.detector)
    return harvest(true, strategy, model, images, happening, Grid(1, 1, 1e-6), eyes)
