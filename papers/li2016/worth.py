"""The worth of harvests, with 95 % intervals over trees.

Fruit of one tree share their machine stops, so a tree counts as one. With fewer than ten trees there is no interval,
nor is there one of a count of rare events or of an extreme. Units: m, rad, s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pickenv.arm import Array
from pickenv.base import InputError, clustered_share_interval, ratio_interval
from pickenv.harvester import Harvest, Machine, Measure, Round
from pickenv.harvester.harvest_run import STAGES, at_stage

ROUND_NUMBERS = ("makespan", "busy", "held", "waits", "parallel", "travel", "picks", "collisions")


def funnel_shares(harvests: Sequence[Harvest]) -> dict[str, Measure]:
    """Share of the fruit present that comes to each stage."""
    present = np.array([float(len(h.tree)) for h in harvests])
    return {stage: _share(np.array([float(at_stage(h, stage)) for h in harvests]), present) for stage in STAGES}


def _share(taken: Array, tried: Array) -> Measure:
    """Of fruit, which come in trees."""
    if not tried.sum():
        return Measure(0.0)
    return Measure(float(taken.sum() / tried.sum()), *(clustered_share_interval(taken, tried) or ()))


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
        over, under = table[part], table[of]
        shown = float(over.sum()) / max(float(under.sum()), 1e-12), *(ratio_interval(over, under) or ())
        value, *ends = (1.0 - scale * number if rest else scale * number for number in shown)
        return Measure(value, *sorted(ends))

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


def _tree_numbers(machine: Machine, harvest: Harvest) -> dict[str, float]:
    """Sums of one tree."""
    rounds = [_round_numbers(machine, r) for r in harvest.rounds]
    return {
        **{stage: float(at_stage(harvest, stage)) for stage in ("collected", "reachable", "present")},
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
