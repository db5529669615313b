"""The trace of a harvester's run, for its figures: trees as they were picked, funnels, throughput, reach. Metres, s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.harvester import Harvest, Measure


@dataclass(frozen=True, eq=False)
class PickedTree:
    """One tree as it was picked: P picks in Z rounds, F fruit.

    Attributes:
        seconds: Time spent on it.
        fruit: Fruit ``(F, 3)``, m.
        collected: Whether each came into a tube ``(F,)``.
        by_arm: Arm that tried each last ``(F,)``; −1 where none did.
        zones: Left, right, bottom and top of each round's zone ``(Z, 4)``, m.
        stands: When the master stands still in each round, from and to ``(Z, 2)``, s.
        arm: Arm of each pick ``(P,)``.
        start: When it leaves for the fruit ``(P,)``, s.
        end: When it is back ``(P,)``, s.
        held: How long it had to wait before ``(P,)``, s.
        got: Whether the cup came back with the fruit ``(P,)``.
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
    """The evidence of a comparison of strategies on the same trees.

    Attributes:
        trees: One tree of each strategy, by name.
        funnels: For each strategy, fruit at each stage over all trees.
        measures: For each strategy, its measures with 95 % intervals over trees.
        throughput: For each density of fruit, picks per hour by number of arms.
        cloud: Cups at joints drawn evenly within the limits ``(N, arms, 3)``, m.
        curves: The motion of joints over one stop of the machine: times ``(T,)``, s, displacements of each joint by
            name ``(T,)``, m or rad, and names of those that turn.
        tree_count: Trees that funnels and measures are of.
    """

    trees: Mapping[str, PickedTree]
    funnels: Mapping[str, Mapping[str, int]]
    measures: Mapping[str, Mapping[str, Measure]]
    throughput: Mapping[str, Mapping[int, Measure]]
    cloud: Array
    curves: tuple[Array, Mapping[str, Array], tuple[str, ...]]
    tree_count: int


def picked_tree(harvest: Harvest) -> PickedTree:
    """A harvest in plain arrays."""
    rounds = harvest.rounds
    return PickedTree(
        seconds=harvest.seconds,
        fruit=harvest.tree.fruit,
        collected=harvest.collected,
        by_arm=harvest.by_arm,
        zones=np.array([[r.zone.left, r.zone.right, r.zone.bottom, r.zone.top] for r in rounds]).reshape(-1, 4),
        stands=np.array([[r.begin, r.begin + r.times.makespan] for r in rounds]).reshape(-1, 2),
        arm=_joined([r.times.arm for r in rounds]).astype(np.int64),
        start=_joined([r.begin + r.times.start for r in rounds]),
        end=_joined([r.begin + r.times.end for r in rounds]),
        held=_joined([r.times.held for r in rounds]),
        got=_joined([r.collected for r in rounds]).astype(bool),
    )


def _joined(parts: Sequence[Array | NDArray[np.int64] | NDArray[np.bool_]]) -> Array:
    return np.concatenate([np.asarray(part, dtype=float) for part in parts]) if parts else np.zeros(0)
