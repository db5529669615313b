"""Policy search for picking: the script's own numbers are learnt, so that learning starts where the script is.

The cross-entropy method (Rubinstein 1999; for policies Mannor, Rubinstein and Gat 2003): candidates are drawn about a
mean, in pairs that lie opposite each other; all pick the same few canopies; mean and spread move to those that did
best. What is learnt is nine numbers that can be read. Units: m, rad, s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from pickenv.agents import ScriptedPick, pick_canopies
from pickenv.arm import Array
from pickenv.base import seed_words, stream
from pickenv.envs import PickVectorEnv


@dataclass(frozen=True)
class Knob:
    """A number of the script that is learnt.

    Attributes:
        start: The script's.
        spread: Standard deviation of the first candidates; of the logarithm where it is a factor.
        low: Least value.
        high: Largest value.
        factor: Whether it is multiplied rather than added to.
    """

    start: float
    spread: float
    low: float
    high: float
    factor: bool = False


KNOBS: Mapping[str, Knob] = {
    "settle": Knob(0.5, 0.2, 0.0, 1.0),
    "approach": Knob(0.10, 0.2, 0.03, 0.15, factor=True),
    "tool_speed": Knob(0.3, 0.3, 0.05, 2.0, factor=True),
    "gain": Knob(1.0, 0.3, 0.1, 1.0),
    "arrived": Knob(2e-4, 0.7, 5e-5, 5e-3, factor=True),
    "aim_x": Knob(0.0, 2e-3, -0.02, 0.02),
    "aim_y": Knob(0.0, 2e-3, -0.02, 0.02),
    "aim_z": Knob(0.0, 2e-3, -0.02, 0.02),
    "patience": Knob(40.0, 1.0, 2.0, 40.0, factor=True),
}
"""Arguments of `pickenv.agents.policies.scripted.ScriptedPick`; 40 s are all the time there is."""

BEST = 0.25
"""Share of the candidates to which mean and spread move."""

KEPT = 0.5
"""Share of the old mean and variance that stays."""

LEAST_SPREAD = 0.2
"""Share of the first spread below which the search does not narrow, so that it goes on comparing."""

QUICK = 8
"""Steps of the inverse while learning: as much fruit as with all of them, in half the time."""


def arguments_of(units: Array) -> dict[str, Array]:
    """The script's arguments for points ``(..., 9)`` of the search, in spreads from where it starts."""
    values: dict[str, Array] = {}
    for at, (name, knob) in zip(np.moveaxis(units, -1, 0), KNOBS.items(), strict=True):
        change = knob.spread * at
        values[name] = np.clip(knob.start * np.exp(change) if knob.factor else knob.start + change, knob.low, knob.high)
    aim = np.stack([values.pop(f"aim_{axis}") for axis in "xyz"], axis=-1)
    return values | {"aim": aim}


@dataclass(frozen=True, eq=False)
class Searches:
    """The course of searches from several seeds; they run side by side and share nothing.

    Attributes:
        steps: Environment steps before each generation and at the end ``(generations + 1, seeds)``.
        means: Middle of the candidates then ``(generations + 1, seeds, 9)``, in spreads from the script.
    """

    steps: Array
    means: Array

    @property
    def learnt(self) -> Array:
        """The end of each search ``(seeds, 9)``: the mean over its second half, for single generations are noisy."""
        return np.asarray(self.means[(len(self.means) + 1) // 2 :].mean(axis=0))


def search(
    arguments: Mapping[str, Any], seeds: Sequence[int], generations: int, candidates: int = 32, canopies: int = 2
) -> Searches:
    """Search with every seed; the script itself comes first.

    Args:
        arguments: Of `PickVectorEnv`.
        seeds: Of canopies and candidates.
        generations: How often candidates are drawn.
        candidates: Of each generation, an even number, at least 8.
        canopies: That each of them picks; the same for all, others in each generation.
    """
    size = (len(seeds), candidates, canopies)
    envs = PickVectorEnv(int(np.prod(size)), **arguments)
    draws = [np.random.default_rng(stream(seed, "policy")) for seed in seeds]
    mean, spread = np.zeros((len(seeds), len(KNOBS))), np.ones((len(seeds), len(KNOBS)))
    means, steps = [mean], [np.zeros(len(seeds))]
    for number in range(generations):
        half = np.array([rng.normal(size=(candidates // 2, len(KNOBS))) for rng in draws])
        points = mean[:, None] + spread[:, None] * np.concatenate([half, -half], axis=1)
        policy = ScriptedPick(
            envs, iterations=QUICK, **arguments_of(np.repeat(points, canopies, axis=1).reshape(-1, len(KNOBS)))
        )
        words = (seed_words(stream(seed, "training", number), canopies) * candidates for seed in seeds)
        picks = pick_canopies(policy, envs, list(chain(*words)))
        outcome = {name: values.reshape(size) for name, values in picks.items()}
        order = np.argsort(-outcome["reward"].mean(axis=2), axis=1, kind="stable")[:, : round(BEST * candidates), None]
        best = np.take_along_axis(points, order, axis=1)
        spread = np.sqrt(KEPT * spread**2 + (1.0 - KEPT) * np.mean((best - mean[:, None]) ** 2, axis=1))
        spread = np.maximum(spread, LEAST_SPREAD)
        mean = KEPT * mean + (1.0 - KEPT) * best.mean(axis=1)
        means.append(mean)
        steps.append(steps[-1] + outcome["steps"].sum(axis=(1, 2)))
    envs.close()
    return Searches(np.array(steps), np.array(means))
