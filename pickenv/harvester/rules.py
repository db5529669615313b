"""Rules that say at once who picks what, in which order, and a makespan that no plan beats.

Li's rule and the baselines that the field expects. Every function takes a `Work` and gives a `Plan`; fruit out of every
arm's reach is left out. Units: s.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, linear_sum_assignment, milp

from pickenv.arm import Array
from pickenv.harvester.work import Plan, Work


def li_rule(work: Work) -> Plan:
    """Columns, and the order of Li 2016, section 5.2: middle arms by falling height, side arms by rising height."""
    return _ordered(work, _columns(work), lambda arm, height: -height if arm % 2 else height)


def static_columns(work: Work) -> Plan:
    """Every arm picks the column before it, from below."""
    return _ordered(work, _columns(work), lambda _arm, height: height)


def nearest_neighbour(work: Work) -> Plan:
    """The arm that is free first takes the fruit that it can finish first."""
    left = set(np.flatnonzero(work.reachable).tolist())
    plan: list[list[int]] = [[] for _ in range(work.arms)]
    free = np.zeros(work.arms)
    while left:
        for arm in np.argsort(free, kind="stable").tolist():
            mine = [j for j in left if work.reached[arm, j]]
            if mine:
                way = work.travel[plan[arm][-1]] if plan[arm] else work.first
                fruit = min(mine, key=lambda j: (way[j] + work.duration[arm, j], j))
                free[arm] += way[fruit] + work.duration[arm, fruit]
                plan[arm].append(fruit)
                left.remove(fruit)
                break
    return tuple(tuple(fruit) for fruit in plan)


def hungarian_waves(work: Work) -> Plan:
    """Wave after wave, at most one fruit an arm, at the least sum of times."""
    left = np.flatnonzero(work.reachable).tolist()
    plan: list[list[int]] = [[] for _ in range(work.arms)]
    never = 1e6
    while left:
        cost = np.full((work.arms, len(left)), never)
        for arm in range(work.arms):
            way = work.travel[plan[arm][-1]] if plan[arm] else work.first
            mine = work.reached[arm, left]
            cost[arm, mine] = (way[left] + work.duration[arm, left])[mine]
        rows, columns = linear_sum_assignment(cost)
        taken = [(a, left[c]) for a, c in zip(rows.tolist(), columns.tolist(), strict=True) if cost[a, c] < never]
        for arm, fruit in taken:
            plan[arm].append(fruit)
        gone = {fruit for _, fruit in taken}
        left = [fruit for fruit in left if fruit not in gone]
    return tuple(tuple(fruit) for fruit in plan)


def lower_bound(work: Work, *, integral: bool = True) -> float:
    """A makespan that no plan beats: fruit shared out evenly, each with its least travel, and no conflicts.

    Args:
        work: The zone.
        integral: Whether fruit is whole (a mixed-integer programme, 0.2 s at most) or may be shared in fractions.
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
    above = np.zeros((arms, arms * n + 1))
    equal = np.zeros((n, arms * n + 1))
    for arm in range(arms):
        above[arm, arm * n : (arm + 1) * n] = load[arm]
        equal[np.arange(n), arm * n + np.arange(n)] = 1.0
    above[:, -1] = -1.0
    upper = np.concatenate([reached.ravel().astype(float), [np.inf]])
    cost = np.zeros(arms * n + 1)
    cost[-1] = 1.0
    whole = np.concatenate([np.full(arms * n, float(integral)), [0.0]])
    found = milp(
        cost,
        constraints=[LinearConstraint(above, -np.inf, 0.0), LinearConstraint(equal, 1.0, 1.0)],
        bounds=Bounds(np.zeros(arms * n + 1), upper),
        integrality=whole,
        options={"time_limit": 0.2, "mip_rel_gap": 0.005},
    )
    bound = found.mip_dual_bound if integral else found.fun
    return float(max(bound if bound is not None else 0.0, single))


def _columns(work: Work) -> list[list[int]]:
    """Fruit by the arm that turns least to it, of those that reach it: the parts of the zone before each arm."""
    turn = np.where(work.reached, np.abs(work.joints[..., 1]), np.inf)
    owner = turn.argmin(axis=0)
    some = np.flatnonzero(work.reachable)
    return [some[owner[some] == arm].tolist() for arm in range(work.arms)]


def _ordered(work: Work, parts: list[list[int]], key: Callable[[int, float], float]) -> Plan:
    height: Array = work.joints[0, :, 0]
    return tuple(
        tuple(sorted(part, key=lambda j, arm=arm: (key(arm, float(height[j])), j)))  # type: ignore[misc]
        for arm, part in enumerate(parts)
    )
