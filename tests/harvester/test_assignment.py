"""Plans: complete, free of conflicts, never below the lower bound, and good where they claim to be."""

from collections import Counter
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest

from papers.li2016.cp_sat import cp_sat
from pickenv.base import InputError
from pickenv.harvester import (
    Work,
    assign,
    load_machine,
    lower_bound,
    pick_point,
    timetable,
    travel_time,
    ultrasonic_hold,
    zone_work,
)
from pickenv.harvester.optimiser import _changed


def hold_of(machine, work):
    return ultrasonic_hold(machine, work, np.random.default_rng(0))


METHODS = ("li", "nearest", "columns", "hungarian", "search")


def zone_fruit(rng, count):
    """Fruit of one zone of Li's lab, somewhere on the tree's side."""
    corner = np.array([rng.uniform(-0.9, 0.9) - 0.35, -1.4, rng.uniform(0.42, 1.87)])
    return corner + np.array([0.7, 0.4, 0.55]) * rng.random((count, 3))


def zone(machine, rng, count):
    fruit = zone_fruit(rng, count)
    return zone_work(machine, pick_point(machine, fruit), fruit)


def conflicts(work, times):
    """Pairs of excursions that overlap in time although they would meet."""
    found = []
    for i in range(len(times.arm)):
        for j in range(i):
            together = times.start[i] < times.end[j] - 1e-9 and times.start[j] < times.end[i] - 1e-9
            if together and work.conflict[times.arm[i], times.fruit[i], times.arm[j], times.fruit[j]]:
                found.append((i, j))
    return found


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("arms", [1, 3, 6])
def test_every_reachable_fruit_is_picked_once_by_an_arm_that_reaches_it(method, arms):
    machine, rng = load_machine(slaves=arms), np.random.default_rng(arms)
    for count in (1, 5, 12):
        work = zone(machine, rng, count)
        plan = assign(work, method)
        picked = [fruit for queue in plan for fruit in queue]
        assert sorted(picked) == np.flatnonzero(work.reachable).tolist()
        assert all(work.reached[arm, fruit] for arm, queue in enumerate(plan) for fruit in queue)
        times = timetable(work, plan, hold=hold_of(machine, work) if method == "li" else None)
        assert conflicts(work, times) == []
        assert times.makespan >= lower_bound(work) - 1e-6
        assert lower_bound(work) >= lower_bound(work, integral=False) - 1e-6


def test_one_arm_at_a_time_does_one_pick_at_a_time(machine):
    work = zone(machine, np.random.default_rng(0), 15)
    times = timetable(work, assign(work, "nearest"))
    for arm in range(3):
        mine = np.sort(np.stack([times.start[times.arm == arm], times.end[times.arm == arm]]), axis=1)
        assert (mine[0, 1:] >= mine[1, :-1]).all()


def test_li_picks_by_falling_height_in_the_middle_and_rising_height_beside(machine):
    work = zone(machine, np.random.default_rng(3), 15)
    for arm, queue in enumerate(assign(work, "li")):
        rising = np.diff(work.joints[0, list(queue), 0])
        assert (rising <= 0).all() if arm == 1 else (rising >= 0).all()


def test_an_optimised_plan_for_20_fruit_is_within_a_tenth_of_the_bound(machine):
    pytest.importorskip("ortools")
    rng = np.random.default_rng(20)
    shares = []
    for _ in range(2):
        work = zone(machine, rng, 20)
        shares.append(timetable(work, cp_sat(work)).makespan / lower_bound(work))
    assert max(shares) <= 1.10


def test_search_beats_the_greedy_baselines_on_average(machine):
    rng, total = np.random.default_rng(7), dict.fromkeys(METHODS, 0.0)
    for _ in range(15):
        work = zone(machine, rng, 9)
        for method in METHODS:
            total[method] += timetable(work, assign(work, method)).makespan
    assert total["search"] == min(total.values())
    assert total["li"] > 1.3 * total["search"]


def test_cp_sat_is_never_worse_than_the_search(machine):
    pytest.importorskip("ortools")
    rng = np.random.default_rng(8)
    for _ in range(4):
        work = zone(machine, rng, 7)
        best = timetable(work, cp_sat(work, np.random.default_rng(0))).makespan
        assert best <= timetable(work, assign(work, "search", np.random.default_rng(0))).makespan + 1e-6


def test_an_empty_zone_is_no_work(machine):
    work = zone_work(machine, machine.master_start, np.zeros((0, 3)))
    for method in METHODS:
        assert timetable(work, assign(work, method)).makespan == 0.0
    assert lower_bound(work) == 0.0


def test_fruit_out_of_every_arms_reach_is_left_out(machine):
    rng = np.random.default_rng(2)
    fruit = zone_fruit(rng, 6)
    master = pick_point(machine, fruit)
    work = zone_work(machine, master, np.concatenate([fruit, [[0.0, 3.0, 1.0]]]))
    assert not work.reachable[-1]
    for method in METHODS:
        assert 6 not in {j for queue in assign(work, method) for j in queue}


def test_an_unknown_method_is_refused(machine):
    with pytest.raises(InputError, match="unknown assignment"):
        assign(zone(machine, np.random.default_rng(0), 3), "luck")


def made_up(rng, arms, count):
    """Work with ways that differ there and back, as they do between fruit of different heights, and no conflicts."""
    free = np.zeros((arms, count, arms, count), dtype=bool)
    return Work(
        joints=np.zeros((arms, count, 3)),
        reached=np.ones((arms, count), dtype=bool),
        out=np.ones((arms, count)),
        duration=rng.uniform(0.1, 1.0, (arms, count)),
        first=rng.uniform(0.0, 5.0, count),
        travel=rng.uniform(0.0, 5.0, (count, count)),
        conflict=free,
        approach=np.zeros(count),
    )


@pytest.mark.parametrize("arms", [1, 2])
def test_no_plan_of_all_that_there_are_is_below_the_lower_bound(arms):
    rng = np.random.default_rng(arms)
    for _ in range(40):
        work = made_up(rng, arms, 4)
        plans = [
            tuple(tuple(j for j, arm in zip(order, owner, strict=True) if arm == a) for a in range(arms))
            for order in permutations(range(4))
            for owner in product(range(arms), repeat=4)
        ]
        best = min(timetable(work, plan).makespan for plan in plans)
        assert 0 < lower_bound(work) <= best + 1e-6


def test_a_hold_keeps_its_arm_back_and_a_middle_arm_goes_first():
    """All three are ready at once; who holds is asked again until it lets go."""
    work = replace(made_up(np.random.default_rng(0), 3, 3), duration=np.ones((3, 3)), first=np.zeros(3))
    asked = []

    def hold(arm, fruit, start, begun):
        asked.append((arm, fruit))
        return start if arm == 1 else max(start, begun.end[begun.arm == 1].max(initial=0.0))

    times = timetable(work, ((0,), (1,), (2,)), hold=hold)
    assert dict(zip(times.arm.tolist(), times.start.tolist(), strict=True)) == {1: 0.0, 0: 1.0, 2: 1.0}
    assert times.held[times.arm != 1] == pytest.approx(1.0) and set(asked) == {(0, 0), (1, 1), (2, 2)}
    assert (timetable(work, ((0,), (1,), (2,))).start == 0.0).all()


def test_an_arm_travels_from_the_height_of_its_last_fruit_to_below_the_next(machine):
    work = zone(machine, np.random.default_rng(5), 6)
    speed, acceleration = machine.slaves[0].speed[0], machine.slave_acceleration[0]
    height = np.clip(work.joints[0, :, 0], machine.slave.lower[0], machine.slave.upper[0])
    assert (work.approach > 0).all()
    for i in range(6):
        for j in range(6):
            way = height[i] - (height[j] - work.approach[j])
            assert work.travel[i, j] == pytest.approx(float(travel_time(way, speed, acceleration)))


def changes_of(plan, reached, source):
    """Every plan that one fruit of arm ``source``, moved or exchanged, leads to, and how probable each is."""
    found = Counter()
    for place, target in product(range(len(plan[source])), range(len(plan))):
        rest = [list(queue) for queue in plan]
        fruit = rest[source].pop(place)
        share = 1.0 / len(plan[source]) / len(plan)
        for other in range(len(rest[target])):
            swapped = [list(queue) for queue in rest]
            taken, swapped[target][other] = swapped[target][other], fruit
            swapped[source].insert(place, taken)
            possible = reached[target][fruit] and reached[source][taken]
            found[tuple(map(tuple, swapped)) if possible else None] += 0.5 * share / len(rest[target])
        for other in range(len(rest[target]) + 1):
            moved = [list(queue) for queue in rest]
            moved[target].insert(other, fruit)
            often = (0.5 if rest[target] else 1.0) * share / len(moved[target])
            found[tuple(map(tuple, moved)) if reached[target][fruit] else None] += often
    return found


@pytest.mark.parametrize("plan", [[[0, 1, 2], [3, 4], []], [[0], [1, 2], [3, 4]]])
def test_a_fruit_is_moved_anywhere_or_exchanged_with_any_as_often_and_nothing_else_changes(plan):
    """Fruit 1 and arm 1, and fruit 3 and arm 0, do not go together; the plan that is given stays as it is."""
    reached = [[j != {0: 3, 1: 1}.get(arm) or j in plan[arm] for j in range(5)] for arm in range(3)]
    rng, before = np.random.default_rng(0), [list(queue) for queue in plan]
    made = [_changed(plan, reached, rng, 0) for _ in range(6000)]
    often = Counter(None if each is None else tuple(map(tuple, each)) for each in made)
    expected = changes_of(plan, reached, 0)
    assert plan == before and set(often) == set(expected) and sum(expected.values()) == pytest.approx(1.0)
    for each, share in expected.items():
        assert abs(often[each] / 6000 - share) < 4.5 * np.sqrt(share * (1 - share) / 6000), each
    assert _changed([[], [0, 1]], [[True] * 2] * 2, rng, 0) is None
