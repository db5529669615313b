"""Plans of small makespan: a local search in milliseconds, and CP-SAT (OR-Tools) where the last share matters.

Both keep the no-overlap constraints of `Work.conflict`. Units: s.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from pickenv.base import NUMBER, InputError, read_toml, require, toml_table
from pickenv.harvester.rules import hungarian_waves, li_rule, lower_bound, nearest_neighbour, static_columns
from pickenv.harvester.work import Lists, Plan, Work, last_arm, makespan_of, plain_lists
from pickenv.harvester.zones import SHIPPED

TICKS = 1000
"""CP-SAT counts whole milliseconds."""


def local_search(
    work: Work, rng: np.random.Generator | None = None, *, bound: float | None = None, patience: float = 1.0
) -> Plan:
    """Improve the best of the greedy plans by moving and exchanging fruit, mostly of the arm that ends last.

    Args:
        work: The zone.
        rng: Chooses what is tried; a fixed seed when left out.
        bound: Stop here; `lower_bound` when left out.
        patience: Rounds, as a multiple of the strategy file's.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    lists = plain_lists(work)
    starts = [_by_height(work), nearest_neighbour(work), hungarian_waves(work)]
    values = [makespan_of(lists, plan) for plan in starts]
    best = [list(fruit) for fruit in starts[int(np.argmin(values))]]
    value, count = min(values), sum(len(fruit) for fruit in best)
    if count < 2:
        return tuple(tuple(fruit) for fruit in best)
    limit = lower_bound(work, integral=False) if bound is None else bound
    reached = work.reached.tolist()
    current, here = [list(fruit) for fruit in best], value
    rounds = int(_effort().rounds * patience) * count
    last = 0
    for step in range(rounds):
        if value <= limit * 1.01:
            break
        tried = _changed(current, reached, rng, last if rng.random() < 0.5 else int(rng.integers(work.arms)))
        if tried is None:
            continue
        length, arm = last_arm(lists, tried)
        cost = length + 1e-3 * sum(_loads(lists, tried)) / len(tried)
        heat = 0.03 * value * (1 - step / rounds)
        if cost < here or rng.random() < np.exp(-(cost - here) / max(heat, 1e-9)):
            current, here, last = tried, cost, arm
            if length < value - 1e-9:
                best, value = [list(fruit) for fruit in tried], length
    return tuple(tuple(fruit) for fruit in best)


def _by_height(work: Work) -> Plan:
    """Fruit of each arm from below, shared so that the loads are even: a good start where fruit hangs dense."""
    load = np.zeros(work.arms)
    parts: list[list[int]] = [[] for _ in range(work.arms)]
    some = sorted(np.flatnonzero(work.reachable).tolist(), key=lambda j: (int(work.reached[:, j].sum()), j))
    for j in some:
        arm = int(np.where(work.reached[:, j], load + work.duration[:, j], np.inf).argmin())
        load[arm] += work.duration[arm, j]
        parts[arm].append(j)
    return tuple(tuple(sorted(part, key=lambda j: (work.joints[0, j, 0], j))) for part in parts)


def _loads(lists: Lists, plan: list[list[int]]) -> list[float]:
    return [sum(lists.duration[arm][j] for j in fruit) for arm, fruit in enumerate(plan)]


def _changed(
    plan: list[list[int]], reached: list[list[bool]], rng: np.random.Generator, source: int
) -> list[list[int]] | None:
    """The plan with a fruit of arm ``source`` moved or exchanged; None where the draw is impossible."""
    new = [list(fruit) for fruit in plan]
    if not new[source]:
        return None
    place = int(rng.integers(len(new[source])))
    target = int(rng.integers(len(new)))
    fruit = new[source].pop(place)
    if rng.random() < 0.5 and new[target]:
        other = int(rng.integers(len(new[target])))
        swapped = new[target][other]
        if not (reached[target][fruit] and reached[source][swapped]):
            return None
        new[target][other] = fruit
        new[source].insert(place, swapped)
        return new
    if not reached[target][fruit]:
        return None
    new[target].insert(int(rng.integers(len(new[target]) + 1)), fruit)
    return new


def cp_sat(work: Work, rng: np.random.Generator | None = None, *, seconds: float | None = None) -> Plan:
    """Least makespan by constraint programming, started from `local_search`.

    Fruit is an optional interval on each arm that reaches it; a circuit per arm orders them with their travel, and
    conflicting excursions of two arms do not overlap.

    Args:
        work: The zone.
        rng: For the local search.
        seconds: Time limit of the solver.

    Raises:
        InputError: If OR-Tools is not installed.
    """
    limit = lower_bound(work)
    start = local_search(work, rng, bound=limit, patience=6.0)
    lists = plain_lists(work)
    value = makespan_of(lists, start)
    if sum(len(fruit) for fruit in start) < 2 or value <= limit * 1.01:
        return start
    require("ortools")
    from ortools.sat.python import cp_model

    model: Any = cp_model.CpModel()
    horizon = int(np.ceil(value * TICKS)) + 1
    span = model.new_int_var(int(limit * TICKS), horizon, "makespan")
    begin: dict[tuple[int, int], Any] = {}
    present: dict[tuple[int, int], Any] = {}
    intervals: dict[tuple[int, int], Any] = {}
    for arm in range(work.arms):
        arcs = [(0, 0, model.new_bool_var(f"idle {arm}"))]
        mine = np.flatnonzero(work.reached[arm]).tolist()
        for j in mine:
            length = _ticks(work.duration[arm, j])
            begin[arm, j] = model.new_int_var(_ticks(work.first[j]), horizon, f"start {arm} {j}")
            present[arm, j] = model.new_bool_var(f"pick {arm} {j}")
            intervals[arm, j] = model.new_optional_fixed_size_interval_var(
                begin[arm, j], length, present[arm, j], f"excursion {arm} {j}"
            )
            model.add(begin[arm, j] + length <= span).only_enforce_if(present[arm, j])
            arcs += [
                (0, j + 1, model.new_bool_var(f"first {arm} {j}")),
                (j + 1, 0, model.new_bool_var(f"last {arm} {j}")),
                (j + 1, j + 1, ~present[arm, j]),
            ]
        for j in mine:
            for k in mine:
                if j != k:
                    follows = model.new_bool_var(f"{arm}: {k} after {j}")
                    arcs.append((j + 1, k + 1, follows))
                    after = begin[arm, j] + _ticks(work.duration[arm, j]) + _ticks(work.travel[j, k])
                    model.add(begin[arm, k] >= after).only_enforce_if(follows)
        model.add_circuit(arcs)
        if mine:
            model.add_no_overlap([intervals[arm, j] for j in mine])
    for j in np.flatnonzero(work.reachable).tolist():
        model.add_exactly_one(present[arm, j] for arm in range(work.arms) if work.reached[arm, j])
    for arm, j in intervals:
        for other, k in intervals:
            if arm < other and j != k and work.conflict[arm, j, other, k]:
                model.add_no_overlap([intervals[arm, j], intervals[other, k]])
    for key, literal in present.items():
        model.add_hint(literal, key[1] in start[key[0]])
    model.minimize(span)
    solver: Any = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = _effort().seconds if seconds is None else seconds
    solver.parameters.num_workers = 1
    solver.parameters.random_seed = 0
    if solver.solve(model) not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return start
    chosen: list[list[tuple[int, int]]] = [[] for _ in range(work.arms)]
    for (arm, j), literal in present.items():
        if solver.value(literal):
            chosen[arm].append((solver.value(begin[arm, j]), j))
    found = tuple(tuple(j for _, j in sorted(fruit)) for fruit in chosen)
    return found if makespan_of(lists, found) < value else start


def _ticks(seconds: float) -> int:
    return int(np.ceil(seconds * TICKS))


@toml_table
class Effort:
    """[optimiser] of a strategy file: rounds of the local search per fruit, and seconds of CP-SAT."""

    rounds: Annotated[float, NUMBER.positive]
    seconds: Annotated[float, NUMBER.positive]


@lru_cache(maxsize=1)
def _effort() -> Effort:
    return read_toml(Effort, SHIPPED, section="optimiser")


# A plan for a zone by the name of the method that makes it.


def assign(work: Work, method: str, rng: np.random.Generator | None = None) -> Plan:
    """A plan by the name of its method.

    Raises:
        InputError: If the method is unknown.
    """
    methods: dict[str, Callable[[Work], Plan]] = {
        "li": li_rule,
        "nearest": nearest_neighbour,
        "columns": static_columns,
        "hungarian": hungarian_waves,
        "search": lambda work: local_search(work, rng),
        "cp-sat": lambda work: cp_sat(work, rng),
    }
    if method not in methods:
        raise InputError(f"unknown assignment '{method}'; give one of {', '.join(methods)}")
    return methods[method](work)
