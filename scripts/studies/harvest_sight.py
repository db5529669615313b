"""What the harvester's own eyes cost, and what a better detector buys: one crop, bare and leafy, seen in each way.

The paper's way and the best way of `papers.li2016`, with each detector and vision; a row a tree (of one machine;
simulated).
"""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from papers.li2016.comparison import calibrated_controller, strategies
from pickenv.harvester import (
    Controller,
    Strategy,
    TrueMachine,
    funnel,
    load_grid,
    load_machine,
    load_orchard,
    load_picking,
    load_true_machine,
    work_trees,
)


@cache
def machine(seed: int) -> tuple[TrueMachine, dict[str, Strategy]]:
    """The machine as built, and the ways to work it."""
    true = load_true_machine(load_machine())
    known = calibrated_controller(true, np.random.default_rng(seed))
    return true, {way.name: way for way in strategies(Controller(true.machine), known)}


def fits(canopy: str, vision: str, way: str, detector: str) -> bool:
    """Ideal eyes need no detector."""
    return vision != "ideal" or detector == "li2016"


def measure(
    rng: np.random.Generator, canopy: str, vision: str, way: str, detector: str, trees: int, rendered: int, seed: int
) -> list[dict[str, Any]]:
    """Fruit at each stage of each tree, and the time that it took."""
    true, ways = machine(seed)
    count = rendered if vision == "rendered" else trees
    strategy, orchard = replace(ways[way], detector=detector), load_orchard(canopy=canopy)
    done = work_trees(true, strategy, load_picking(), orchard, load_grid(), count=count, seed=seed, vision=vision)
    return [
        {"tree": number, **funnel([tree]), "hours": tree.seconds / 3600.0, "misled": tree.misled}
        for number, tree in enumerate(done)
    ]
