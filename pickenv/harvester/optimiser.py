"""Plans of a zone by several methods, and a lower bound of their makespan (the time at which the last pick ends).

A plan says which arm picks which fruit in which order. Li's rule and the usual baselines of the field need no search.
The local search takes milliseconds. An excursion is an arm's way out to a fruit and back. Some excursions must not
overlap (`Work.conflict`), and the local search takes the waiting time for this into account. Plans leave out fruit
that no arm reaches. Units: s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Annotated

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import Bounds, LinearConstraint, linear_sum_assignment, milp

from pickenv.arm import Array
from pickenv.base import NUMBER, check_known, read_toml, toml_table
from pickenv.harvester.pick_points import STRATEGY_FILE
from pickenv.harvester.work import Plan, Work, last_arm


def columns(work: Work, *, falling: bool) -> Plan:
    """Assign each fruit to the arm that swings least to reach it.

    Each arm picks its fruit from the lowest up. With ``falling``, middle arms (odd indices, counted from 0 on the left)
    pick from the highest fruit down, as in Li 2016, section 5.2. ``work`` is the scheduling problem of the zone.
    """
    owner = np.where(work.reached, np.abs(work.joints[..., 1]), np.inf).argmin(axis=0)
    height, plan = work.joints[0, :, 0], []
    for arm in range(work.arms):
        mine = np.flatnonzero(work.reachable & (owner == arm))
        rank = -height if falling and arm % 2 else height
        plan.append(tuple(mine[np.argsort(rank[mine], kind="stable")].tolist()))
    return tuple(plan)


def nearest_neighbour(work: Work) -> Plan:
    """Plan greedily: whichever arm becomes free earliest takes the remaining fruit that it can finish earliest.

    The plan ignores that excursions (ways out to a fruit and back) of two arms may conflict.
    """
    waiting: list[int] = np.flatnonzero(work.reachable).tolist()
    plan: list[list[int]] = [[] for _ in range(work.arms)]
    free = np.zeros(work.arms)
    while waiting:
        times = _next_times(work, plan, waiting)
        arm = int(np.where(np.isfinite(times).any(axis=1), free, np.inf).argmin())
        at = int(times[arm].argmin())
        free[arm] += times[arm, at]
        plan[arm].append(waiting.pop(at))
    return tuple(map(tuple, plan))


def hungarian_waves(work: Work) -> Plan:
    """Plan in waves: every arm takes at most one fruit per wave, with the least sum of pick times.

    The time of a pick is the arm's travel to the fruit's height plus its excursion (out to the fruit and back). The
    plan ignores that excursions of two arms may conflict.
    """
    waiting: list[int] = np.flatnonzero(work.reachable).tolist()
    plan: list[list[int]] = [[] for _ in range(work.arms)]
    never = 1e6
    while waiting:
        times = np.minimum(_next_times(work, plan, waiting), never)
        arms, places = linear_sum_assignment(times)
        for arm, at in zip(arms.tolist(), places.tolist(), strict=True):
            if times[arm, at] < never:
                plan[arm].append(waiting[at])
        waiting = np.delete(waiting, places[times[arms, places] < never]).tolist()
    return tuple(map(tuple, plan))


def _next_times(work: Work, plan: list[list[int]], waiting: list[int]) -> Array:
    """Return the time that each arm needs for each waiting fruit, s, (arms, waiting); infinite out of its reach.

    The time is the travel to the fruit's height plus the excursion (out to the fruit and back). The travel begins at
    the last fruit that ``plan`` has for the arm, or at the home position.

    Args:
        work: Scheduling problem of the zone.
        plan: For each arm, the indices of its fruit so far, from 0, in picking order.
        waiting: Indices of the fruit without an arm, from 0.
    """
    way = np.array([work.travel[fruit[-1]] if fruit else work.first for fruit in plan])
    return np.where(work.reached, way + work.duration, np.inf)[:, waiting]


def lower_bound(work: Work, *, integral: bool = True) -> float:
    """Compute a lower bound of the makespan of any plan, s.

    The makespan is the time at which the last pick ends. The bound balances the load of the arms, with the least
    possible travel to each fruit. It ignores that excursions (ways out to a fruit and back) of two arms may conflict.

    Args:
        work: Scheduling problem of the zone.
        integral: If true, each fruit belongs to one arm (a mixed-integer programme, solved in at most 0.2 s). If false,
            arms may share a fruit.
    """
    some = np.flatnonzero(work.reachable)
    if not some.size:
        return 0.0
    n, arms = some.size, work.arms
    travel = work.travel[np.ix_(some, some)].copy()
    np.fill_diagonal(travel, np.inf)
    least = np.minimum(work.first[some], travel.min(axis=0))
    reached = work.reached[:, some]
    load = np.where(reached, work.duration[:, some] + least, 0.0)
    single = (np.where(reached, work.duration[:, some], np.inf).min(axis=0) + least).max()
    # Variables: share of each fruit on each arm, and the makespan. Loads at most the makespan, shares add up to one.
    above = np.hstack([block_diag(*load), np.full((arms, 1), -1.0)])
    equal = np.hstack([np.tile(np.eye(n), arms), np.zeros((n, 1))])
    solution = milp(
        np.append(np.zeros(arms * n), 1.0),
        constraints=[LinearConstraint(above, -np.inf, 0.0), LinearConstraint(equal, 1.0, 1.0)],
        bounds=Bounds(np.zeros(arms * n + 1), np.append(reached.ravel().astype(float), np.inf)),
        integrality=np.append(np.full(arms * n, float(integral)), 0.0),
        options={"time_limit": 0.2, "mip_rel_gap": 0.005},
    )
    bound = solution.mip_dual_bound if integral else solution.fun
    return float(max(bound if bound is not None else 0.0, single))


def local_search(
    work: Work, rng: np.random.Generator | None = None, *, bound: float | None = None, patience: float = 1.0
) -> Plan:
    """Plan by simulated annealing, which starts from the best of three greedy plans.

    Each step moves a fruit to another arm or another position in an arm's list, or exchanges two fruit. Half of the
    steps take a fruit of the arm that finishes last in the current plan.

    Args:
        work: Scheduling problem of the zone.
        rng: Random generator of the steps; a fixed seed by default.
        bound: Makespan at which the search may stop, s: it stops once its plan is within 1 % of the bound. By default,
            `lower_bound` with fruit that arms may share.
        patience: Factor by which the number of steps in the strategy file (`Effort.rounds`) is multiplied.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    starts = [_by_height(work), nearest_neighbour(work), hungarian_waves(work)]
    best: Sequence[Sequence[int]] = min(starts, key=lambda plan: last_arm(work, plan)[0])
    value, count = last_arm(work, best)[0], int(work.reachable.sum())
    limit = lower_bound(work, integral=False) if bound is None else bound
    reached, duration = work.reached.tolist(), work.lists[0]
    current, current_cost = best, value
    rounds = int(load_effort().rounds * patience) * count if count > 1 else 0
    last = 0
    for step in range(rounds):
        if value <= limit * 1.01:
            break
        tried = _changed(current, reached, rng, last if rng.random() < 0.5 else int(rng.integers(work.arms)))
        if tried is None:
            continue
        length, arm = last_arm(work, tried)
        loads = [sum(duration[a][j] for j in fruit) for a, fruit in enumerate(tried)]
        cost = length + 1e-3 * sum(loads) / len(tried)
        heat = 0.03 * value * (1 - step / rounds)
        if cost < current_cost or rng.random() < np.exp(-(cost - current_cost) / max(heat, 1e-9)):
            current, current_cost, last = tried, cost, arm
            if length < value - 1e-9:
                best, value = tried, length
    return tuple(map(tuple, best))


def _by_height(work: Work) -> Plan:
    """Plan with balanced loads of the arms; each arm picks from its lowest fruit up.

    Such a plan is a good start for dense fruit.
    """
    load = np.zeros(work.arms)
    parts: list[list[int]] = [[] for _ in range(work.arms)]
    for j in sorted(np.flatnonzero(work.reachable).tolist(), key=lambda j: (int(work.reached[:, j].sum()), j)):
        arm = int(np.where(work.reached[:, j], load + work.duration[:, j], np.inf).argmin())
        load[arm] += work.duration[arm, j]
        parts[arm].append(j)
    return tuple(tuple(sorted(part, key=lambda j: (work.joints[0, j, 0], j))) for part in parts)


def _changed(
    plan: Sequence[Sequence[int]], reached: list[list[bool]], rng: np.random.Generator, source: int
) -> list[list[int]] | None:
    """Return the plan with one random fruit of arm ``source`` moved or exchanged; None if that is impossible.

    ``reached[i][j]`` says whether arm i reaches fruit j. Arms and fruit count from 0.
    """
    new = [list(fruit) for fruit in plan]
    if not new[source]:
        return None
    place, target = int(rng.integers(len(new[source]))), int(rng.integers(len(new)))
    fruit = new[source].pop(place)
    if rng.random() < 0.5 and new[target]:
        position = int(rng.integers(len(new[target])))
        swapped, new[target][position] = new[target][position], fruit
        new[source].insert(place, swapped)
        return new if reached[target][fruit] and reached[source][swapped] else None
    if not reached[target][fruit]:
        return None
    new[target].insert(int(rng.integers(len(new[target]) + 1)), fruit)
    return new


@toml_table
class Effort:
    """Table [optimiser] of a strategy file.

    Attributes:
        rounds: Number of steps of the local search per fruit.
        seconds: Time limit of the constraint solver CP-SAT, s.
    """

    rounds: Annotated[float, NUMBER.positive]
    seconds: Annotated[float, NUMBER.positive]


@cache
def load_effort() -> Effort:
    """Return the table [optimiser] of the strategy file; the file is read only once."""
    return read_toml(Effort, STRATEGY_FILE, section="optimiser")


def assign(work: Work, method: str, rng: np.random.Generator | None = None) -> Plan:
    """Plan the picks of a zone by a named method.

    Args:
        work: Scheduling problem of the zone.
        method: "li" (Li's rule) is `columns` whose middle arms pick from the highest fruit down. "columns" is `columns`
            whose arms all pick from the lowest fruit up. "nearest" is `nearest_neighbour`, "hungarian" is
            `hungarian_waves`, and "search" is `local_search`.
        rng: Random generator of the local search; a fixed seed by default.

    Raises:
        InputError: If the method is unknown.
    """
    methods: dict[str, Callable[[Work], Plan]] = {
        "li": partial(columns, falling=True),
        "nearest": nearest_neighbour,
        "columns": partial(columns, falling=False),
        "hungarian": hungarian_waves,
        "search": lambda work: local_search(work, rng),
    }
    check_known("assignment", method, methods)
    return methods[method](work)
