"""Plans of a zone by constraint programming: CP-SAT (OR-Tools), the referee of what the other methods leave.

It keeps the no-overlap constraints of `pickenv.harvester.Work.conflict`. Units: s.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pickenv.base import require
from pickenv.harvester import Work, lower_bound, timetable
from pickenv.harvester.optimiser import load_effort, local_search
from pickenv.harvester.work import Plan

TICKS = 1000
"""CP-SAT counts whole milliseconds."""


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
    value = timetable(work, start).makespan
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
        for second, k in intervals:
            if arm < second and j != k and work.conflict[arm, j, second, k]:
                model.add_no_overlap([intervals[arm, j], intervals[second, k]])
    for key, literal in present.items():
        model.add_hint(literal, key[1] in start[key[0]])
    model.minimize(span)
    solver: Any = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = load_effort().seconds if seconds is None else seconds
    solver.parameters.num_workers = 1
    solver.parameters.random_seed = 0
    if solver.solve(model) not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return start
    starts: list[list[tuple[int, int]]] = [[] for _ in range(work.arms)]
    for (arm, j), literal in present.items():
        if solver.value(literal):
            starts[arm].append((solver.value(begin[arm, j]), j))
    plan = tuple(tuple(j for _, j in sorted(fruit)) for fruit in starts)
    return plan if timetable(work, plan).makespan < value else start


def _ticks(seconds: float) -> int:
    return int(np.ceil(seconds * TICKS))
