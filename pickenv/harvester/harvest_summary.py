"""What a harvest was worth: rates, picks per hour, makespans, idle share and distances, each with a 95 % interval.

Intervals come from resampling whole trees (bootstrap), since fruit of one tree share their machine stops. Units: s, m.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pickenv.arm import Array
from pickenv.bootstrap import interval95, resampled
from pickenv.errors import InputError
from pickenv.harvester.harvest import Harvest, Round
from pickenv.harvester.machine import Machine

STAGES = ("present", "visible", "reachable", "attempted", "attached", "detached", "collected")
ROUND_NUMBERS = ("makespan", "busy", "held", "waits", "parallel", "travel", "picks", "collisions")
RESAMPLES = 1000


@dataclass(frozen=True)
class Measure:
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}]"


def funnel(harvests: Sequence[Harvest]) -> dict[str, int]:
    """Fruit at each stage, over all harvests."""
    names = {"present": None, "visible": "seen"}
    total = {}
    for stage in STAGES:
        name = names.get(stage, stage)
        total[stage] = sum(len(h.tree) if name is None else int(getattr(h, name).sum()) for h in harvests)
    return total


def summary(machine: Machine, harvests: Sequence[Harvest], rng: np.random.Generator) -> dict[str, Measure]:
    """Measures over trees, each with its interval.

    ``recovery`` is collected over reachable fruit, ``harvested`` collected over present; ``collisions`` are rounds
    whose arms came nearer than two radii.

    Raises:
        InputError: If there are no harvests.
    """
    if not harvests:
        raise InputError("there is no harvest to sum up; work at least one tree")
    rounds = [[_round_numbers(machine, r) for r in h.rounds] for h in harvests]
    table = {
        "collected": np.array([float(h.collected.sum()) for h in harvests]),
        "reachable": np.array([float(h.reachable.sum()) for h in harvests]),
        "present": np.array([float(len(h.tree)) for h in harvests]),
        "seconds": np.array([h.seconds for h in harvests]),
        "repicks": np.array([float(h.repicks) for h in harvests]),
        "zones": np.array([float(len(r)) for r in rounds]),
        **{name: np.array([sum(x[name] for x in r) for r in rounds]) for name in ROUND_NUMBERS},
    }
    n, arms = len(harvests), machine.arms
    whole = np.stack(list(table.values()), axis=1)
    sums = resampled(np.arange(n)[None], lambda trees: whole[trees].sum(axis=0), rng, RESAMPLES)
    replicates = dict(zip(table, sums.T, strict=True))

    def measure(make: Callable[[dict[str, Array]], Array]) -> Measure:
        value = float(make({name: column.sum() for name, column in table.items()}))
        low, high = interval95(make(replicates))
        return Measure(value, float(low), float(high))

    found = {
        "recovery": measure(lambda t: _share(t["collected"], t["reachable"])),
        "harvested": measure(lambda t: _share(t["collected"], t["present"])),
        "picks_per_hour": measure(lambda t: 3600 * _share(t["collected"], t["seconds"])),
        "seconds_per_tree": measure(lambda t: t["seconds"] / n),
        "makespan": measure(lambda t: _share(t["makespan"], t["zones"])),
        "idle_share": measure(lambda t: 1 - _share(t["busy"], arms * t["makespan"])),
        "parallel_ratio": measure(lambda t: _share(t["parallel"], t["makespan"])),
        "held_per_pick": measure(lambda t: _share(t["held"], t["picks"])),
        "wait_events": measure(lambda t: _share(t["waits"], t["picks"])),
        "travel_per_pick": measure(lambda t: _share(t["travel"], t["picks"])),
        "repicks_per_tree": measure(lambda t: t["repicks"] / n),
        "collisions": measure(lambda t: t["collisions"] + 0.0),
    }
    closest = [min((r.closest for r in h.rounds), default=np.inf) for h in harvests]
    if np.isfinite(min(closest)):
        found["closest"] = Measure(min(closest), min(closest), max(closest))
    return found


def _share(part: Array, whole: Array) -> Array:
    return np.asarray(part / np.maximum(whole, 1e-12))


def _round_numbers(machine: Machine, r: Round) -> dict[str, float]:
    """Sums of one round."""
    times = r.times
    edges = np.sort(np.concatenate([times.start, times.end]))
    middle, lengths = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    out = ((times.start[:, None] <= middle) & (middle < times.end[:, None])).sum(axis=0)
    reach = np.hypot(*(r.aimed[:, 1] * r.aimed[:, 2], r.aimed[:, 2] - machine.slave_home[2]))
    climbs = 0.0
    for arm in range(machine.arms):
        heights = [float(machine.slave_home[0]), *r.aimed[times.arm == arm, 0].tolist()]
        climbs += float(np.abs(np.diff(heights)).sum())
    return {
        "makespan": times.makespan,
        "busy": float((times.end - times.start).sum()),
        "held": float(times.held.sum()),
        "waits": float((times.held > 1e-6).sum()),
        "parallel": float(lengths[out > 1].sum()),
        "travel": 2 * float(reach.sum()) + climbs,
        "picks": float(len(times.fruit)),
        "collisions": float(r.closest < 2 * machine.body.radius),
    }
