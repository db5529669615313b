"""The worth of a harvest: rates, picks per hour, makespans, idle share, distances; 95 % intervals are over trees.

Fruit of one tree share their machine stops, so a tree counts as one. With fewer than ten trees there is no interval,
nor is there one of a count of rare events or of an extreme. Units: s, m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pickenv.arm import Array
from pickenv.base import Ends, InputError, clustered_share_interval, statistic_interval
from pickenv.harvester.harvest_run import Harvest, Round
from pickenv.harvester.machine import Machine

STAGES = ("present", "visible", "located", "reachable", "attempted", "attached", "detached", "collected")
ROUND_NUMBERS = ("makespan", "busy", "held", "waits", "parallel", "travel", "picks", "collisions")


@dataclass(frozen=True)
class Measure:
    """A number and its 95 % interval; both ends None where it has none."""

    value: float
    low: float | None = None
    high: float | None = None

    def __str__(self) -> str:
        text = f"{self.value:.4g}"
        return text if self.low is None or self.high is None else f"{text} [{self.low:.4g}, {self.high:.4g}]"


def funnel(harvests: Sequence[Harvest]) -> dict[str, int]:
    """Fruit at each stage, over all harvests."""
    return {stage: int(sum(_at_stage(h, stage) for h in harvests)) for stage in STAGES}


def funnel_shares(harvests: Sequence[Harvest]) -> dict[str, Measure]:
    """Share of the fruit present that comes to each stage."""
    present = np.array([float(len(h.tree)) for h in harvests])
    return {stage: _share(np.array([float(_at_stage(h, stage)) for h in harvests]), present) for stage in STAGES}


def _at_stage(harvest: Harvest, stage: str) -> int:
    if stage == "present":
        return len(harvest.tree)
    return int(getattr(harvest, "seen" if stage == "visible" else stage).sum())


def _share(taken: Array, tried: Array) -> Measure:
    """Of fruit, which come in trees."""
    if not tried.sum():
        return Measure(0.0)
    return _measure(float(taken.sum() / tried.sum()), clustered_share_interval(taken, tried))


def summary(machine: Machine, harvests: Sequence[Harvest]) -> dict[str, Measure]:
    """Measures over trees, with intervals where there are ten trees or more.

    ``recovery`` is collected over reachable fruit, ``harvested`` collected over present; ``collisions`` are rounds
    whose arms came nearer than two radii, ``closest`` the nearest that any came; both stand alone.

    Raises:
        InputError: If there are no harvests.
    """
    if not harvests:
        raise InputError("there is no harvest to sum up; work at least one tree")
    rows = [_tree_numbers(machine, h) for h in harvests]
    names, sums = list(rows[0]), np.array([list(row.values()) for row in rows])
    table = dict(zip(names, sums.T, strict=True))

    def ratio(part: str, of: str, scale: float = 1.0, *, rest: bool = False) -> Measure:
        """A ratio of sums over trees, or one minus it."""
        over, under = names.index(part), names.index(of)

        def make(rows: Array) -> float:
            value = scale * float(rows[:, over].sum()) / max(float(rows[:, under].sum()), 1e-12)
            return 1.0 - value if rest else value

        return _measure(make(sums), statistic_interval(sums, make))

    measures = {
        "recovery": _share(table["collected"], table["reachable"]),
        "harvested": _share(table["collected"], table["present"]),
        "picks_per_hour": ratio("collected", "seconds", 3600.0),
        "seconds_per_tree": ratio("seconds", "trees"),
        "makespan": ratio("makespan", "zones"),
        "idle_share": ratio("busy", "makespan", 1.0 / machine.arms, rest=True),
        "parallel_ratio": ratio("parallel", "makespan"),
        "held_per_pick": ratio("held", "picks"),
        "wait_events": ratio("waits", "picks"),
        "travel_per_pick": ratio("travel", "picks"),
        "repicks_per_tree": ratio("repicks", "trees"),
        "misled_per_tree": ratio("misled", "trees"),
        "collisions": Measure(float(table["collisions"].sum())),
    }
    closest = [min((r.closest for r in h.rounds), default=np.inf) for h in harvests]
    if np.isfinite(min(closest)):
        measures["closest"] = Measure(min(closest))
    return measures


def _measure(value: float, interval: Ends | None) -> Measure:
    return Measure(value, *(interval or (None, None)))


def _tree_numbers(machine: Machine, harvest: Harvest) -> dict[str, float]:
    """Sums of one tree."""
    rounds = [_round_numbers(machine, r) for r in harvest.rounds]
    return {
        **{stage: float(_at_stage(harvest, stage)) for stage in ("collected", "reachable", "present")},
        "seconds": harvest.seconds,
        "repicks": float(harvest.repicks),
        "misled": float(harvest.misled),
        "trees": 1.0,
        "zones": float(len(rounds)),
        **{name: float(sum(numbers[name] for numbers in rounds)) for name in ROUND_NUMBERS},
    }


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
