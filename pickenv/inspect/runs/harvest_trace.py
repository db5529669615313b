"""The trace of a harvester's run, that is the data behind its figures. Units: m, s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.harvester import Harvest, Measure


@dataclass(frozen=True, eq=False)
class PickedTree:
    """The record of how one tree with F fruit was picked: P picks in Z rounds. Times count from the start of the tree.

    Attributes:
        seconds: Time spent on the tree, s.
        fruit: Positions of the fruit ``(F, 3)``, m, in the frame of the machine's base.
        collected: Whether each fruit was collected, that is put into a tube ``(F,)``.
        by_arm: Index, from 0, of the arm that last tried each fruit ``(F,)``; −1 where no arm did.
        zones: Left and right (x), bottom and top (z) of the zone pictured in each round ``(Z, 4)``, m.
        stands: Start and end of the time in each round when the master arm stands still ``(Z, 2)``, s.
        arm: Index, from 0, of the arm of each pick ``(P,)``.
        start: Time at which the arm leaves for the fruit, for each pick ``(P,)``, s.
        end: Time at which the arm is back, for each pick ``(P,)``, s.
        held: Time that the arm had to wait for a neighbour before each pick ``(P,)``, s.
        got: Whether the cup came back with the fruit, for each pick ``(P,)``.
    """

    seconds: float
    fruit: Array
    collected: NDArray[np.bool_]
    by_arm: NDArray[np.int64]
    zones: Array
    stands: Array
    arm: NDArray[np.int64]
    start: Array
    end: Array
    held: Array
    got: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class HarvestTrace:
    """Picks, measures and workspace from a comparison of picking strategies on the same trees.

    Attributes:
        trees: One tree of each strategy, by the strategy's name.
        funnels: For each strategy, number of fruit at each stage over all trees.
        measures: For each strategy, its measures with 95 % intervals over trees.
        throughput: For each density of fruit, picks per hour by number of arms.
        cloud: Positions of the suction cups ``(N, arms, 3)``, m, for joint values drawn uniformly within the limits.
        curves: The motion of joints over one stop of the machine: times ``(T,)``, s, displacements of each joint by
            name ``(T,)``, m or rad, and names of the joints that turn.
        tree_count: Number of trees behind funnels and measures.
    """

    trees: Mapping[str, PickedTree]
    funnels: Mapping[str, Mapping[str, int]]
    measures: Mapping[str, Mapping[str, Measure]]
    throughput: Mapping[str, Mapping[int, Measure]]
    cloud: Array
    curves: tuple[Array, Mapping[str, Array], tuple[str, ...]]
    tree_count: int


def picked_tree(harvest: Harvest) -> PickedTree:
    """Return the picks of a harvested tree as plain arrays."""
    rounds, nothing = harvest.rounds, np.zeros(0)
    return PickedTree(
        seconds=harvest.seconds,
        fruit=harvest.tree.fruit,
        collected=harvest.collected,
        by_arm=harvest.by_arm,
        zones=np.array([[r.zone.left, r.zone.right, r.zone.bottom, r.zone.top] for r in rounds]).reshape(-1, 4),
        stands=np.array([[r.begin, r.begin + r.times.makespan] for r in rounds]).reshape(-1, 2),
        arm=np.concatenate([nothing, *(r.times.arm for r in rounds)]).astype(np.int64),
        start=np.concatenate([nothing, *(r.begin + r.times.start for r in rounds)]),
        end=np.concatenate([nothing, *(r.begin + r.times.end for r in rounds)]),
        held=np.concatenate([nothing, *(r.times.held for r in rounds)]),
        got=np.concatenate([nothing, *(r.collected for r in rounds)]).astype(bool),
    )
