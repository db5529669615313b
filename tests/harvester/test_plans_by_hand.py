"""Rules, bounds and searches against plans enumerated one by one, and pick points against the equations written out."""

import math
from dataclasses import replace
from functools import partial
from itertools import permutations, product

import numpy as np
import pytest
from scipy.optimize import milp

from papers.li2016.cp_sat import cp_sat
from pickenv.base import InputError
from pickenv.harvester import Grid, Work, assign, cut, lower_bound, optimiser, pick_point, timetable
from pickenv.harvester.optimiser import local_search
from pickenv.harvester.pick_points import _heights, _point_costs, border_indices, pick_heading


def made_up(rng, arms, count, reach=0.8, conflict=0.0):
    """Work with ways that differ there and back; a fruit that no arm reaches is reached by the first."""
    reached = rng.random((arms, count)) < reach
    reached[0] |= ~reached.any(axis=0)
    meet = rng.random((arms, count, arms, count)) < conflict
    meet |= meet.transpose(2, 3, 0, 1)
    joints = rng.uniform(-1.0, 1.0, (arms, count, 3))
    joints[:, :, 0] = rng.uniform(0.0, 1.0, count)  # all arms reach a fruit at one height
    return Work(
        joints=joints,
        reached=reached,
        out=np.ones((arms, count)),
        duration=rng.uniform(1.0, 2.0, (arms, count)),
        first=rng.uniform(0.0, 1.0, count),
        travel=rng.uniform(0.0, 1.0, (count, count)),
        conflict=meet,
        approach=np.zeros(count),
    )


def every_plan(work):
    """All assignments of all fruit to arms that reach it, in all orders."""
    for order in permutations(range(work.count)):
        for owner in product(range(work.arms), repeat=work.count):
            if all(work.reached[arm, fruit] for fruit, arm in zip(order, owner, strict=True)):
                yield tuple(tuple(j for j, a in zip(order, owner, strict=True) if a == arm) for arm in range(work.arms))


def least_makespan(work):
    return min(timetable(work, plan).makespan for plan in every_plan(work))


def time_of(work, arm, queue, fruit):
    """Of a pick after those in the arm's queue: the way there, and the excursion."""
    return (work.travel[queue[-1], fruit] if queue else work.first[fruit]) + work.duration[arm, fruit]


def heights_of(work, queue):
    return work.joints[0, list(queue), 0].tolist()


@pytest.mark.parametrize("arms", [1, 2, 3, 4])
def test_columns_belong_to_the_arm_that_turns_least_and_are_picked_by_height(arms):
    """Li: odd arms from above, even arms from below; the static rule: all from below."""
    for seed in range(5):
        work = made_up(np.random.default_rng(seed), arms, 9)
        turn = np.abs(work.joints[:, :, 1])
        owner = [min((a for a in range(arms) if work.reached[a, j]), key=lambda a, j=j: turn[a, j]) for j in range(9)]
        for method in ("li", "columns"):
            for arm, queue in enumerate(assign(work, method)):
                assert sorted(queue) == [j for j in range(9) if owner[j] == arm]
                falls = method == "li" and arm % 2 == 1
                assert heights_of(work, queue) == sorted(heights_of(work, queue), reverse=falls)


def test_the_nearest_rule_gives_the_arm_that_is_free_first_what_it_ends_first():
    for seed in range(10):
        work = made_up(np.random.default_rng(seed), 3, 8)
        plan, left, free = [[], [], []], set(range(8)), [0.0, 0.0, 0.0]
        while left:
            arm = min((a for a in range(3) if any(work.reached[a, j] for j in left)), key=lambda a: (free[a], a))
            fruit = min((j for j in left if work.reached[arm, j]), key=partial(time_of, work, arm, plan[arm]))
            free[arm] += time_of(work, arm, plan[arm], fruit)
            plan[arm].append(fruit)
            left.remove(fruit)
        assert assign(work, "nearest") == tuple(map(tuple, plan))


def test_each_wave_of_the_hungarian_rule_takes_as_many_fruit_as_it_can_in_the_least_sum_of_times():
    for seed in range(10):
        work = made_up(np.random.default_rng(seed), 3, 7, reach=0.9)
        found = assign(work, "hungarian")
        plan, left = [[], [], []], set(range(7))
        while left:
            waves = [
                [(a, j) for a, j in zip(range(3), chosen, strict=True) if j is not None]
                for chosen in product([None, *left], repeat=3)
                if len({j for j in chosen if j is not None}) == sum(j is not None for j in chosen)
            ]
            waves = [wave for wave in waves if all(work.reached[pick] for pick in wave)]
            most = max(map(len, waves))
            sums = {sum(time_of(work, a, plan[a], j) for a, j in w): w for w in waves if len(w) == most}
            for arm, fruit in sums[min(sums)]:
                plan[arm].append(fruit)
                left.remove(fruit)
        assert found == tuple(map(tuple, plan))


@pytest.mark.parametrize("arms", [1, 2, 3])
def test_the_bound_is_the_most_even_share_of_picks_with_their_least_ways(arms, monkeypatch):
    """Every assignment tried; in fractions it is at least the sum shared out evenly, and at most the whole one.

    With all the time that the solver asks for: cut off early, its bound is only lower.
    """
    monkeypatch.setattr("pickenv.harvester.optimiser.milp", lambda *given, options, **more: milp(*given, **more))
    for seed in range(8):
        work = made_up(np.random.default_rng(seed), arms, 5)
        ways = [min(work.first[j], *(work.travel[i, j] for i in range(5) if i != j)) for j in range(5)]
        load = work.duration + ways
        best = np.inf
        for owner in product(range(arms), repeat=5):
            if all(work.reached[a, j] for j, a in enumerate(owner)):
                best = min(best, max(sum(load[a, j] for j in range(5) if owner[j] == a) for a in range(arms)))
        least = np.where(work.reached, load, np.inf).min(axis=0)
        assert lower_bound(work) == pytest.approx(max(best, least.max()), rel=1e-6)
        shared = lower_bound(work, integral=False)
        assert max(least.sum() / arms, least.max()) - 1e-9 <= shared <= best + 1e-9


def test_two_arms_that_reach_everything_share_one_long_and_two_short_picks_by_hand():
    """Durations 4, 1, 1 on both arms, no ways: whole, 4 and 2; in fractions 3 each, but a pick of 4 is one pick."""
    free = np.zeros((2, 3, 2, 3), dtype=bool)
    work = made_up(np.random.default_rng(0), 2, 3, reach=1.0)
    work = Work(work.joints, np.ones((2, 3), bool), work.out, np.tile([4.0, 1.0, 1.0], (2, 1)), np.zeros(3),
                np.zeros((3, 3)), free, np.zeros(3))  # fmt: skip
    assert lower_bound(work) == pytest.approx(4.0) and lower_bound(work, integral=False) == pytest.approx(4.0)
    longer = Work(work.joints, work.reached, work.out, np.full((2, 3), 1.0), np.zeros(3), np.zeros((3, 3)), free,
                  np.zeros(3))  # fmt: skip
    assert lower_bound(longer) == pytest.approx(2.0) and lower_bound(longer, integral=False) == pytest.approx(1.5)


def test_the_search_finds_the_best_of_all_plans_or_next_to_it_where_arms_never_meet():
    """Of twelve small zones none is more than 6 % above the best, and most are the best; none below, of course."""
    ratios = []
    for seed in range(12):
        work = made_up(np.random.default_rng(seed), 2, 5)
        found = timetable(work, local_search(work, np.random.default_rng(0))).makespan
        ratios.append(found / least_makespan(work))
    assert min(ratios) >= 1.0 - 1e-12 and max(ratios) < 1.06 and np.median(ratios) < 1.0 + 1e-9


def test_the_search_is_never_worse_than_the_rules_and_better_by_a_tenth_on_the_whole():
    sums = np.zeros(3)
    for seed in range(12):
        work = made_up(np.random.default_rng(seed), 3, 8, conflict=0.2)
        plans = (local_search(work, np.random.default_rng(0)), assign(work, "nearest"), assign(work, "hungarian"))
        times = np.array([timetable(work, plan).makespan for plan in plans])
        assert times[0] <= times[1:].min() + 1e-12
        sums += times
    assert sums[0] < 0.9 * sums[1:].min()


@pytest.mark.parametrize("conflict", [0.0, 0.4])
def test_the_solver_finds_the_best_of_all_plans(conflict):
    pytest.importorskip("ortools")
    for seed in range(4):
        work = made_up(np.random.default_rng(100 + seed), 2, 4, conflict=conflict)
        found = timetable(work, cp_sat(work, np.random.default_rng(0), seconds=5.0)).makespan
        assert found == pytest.approx(least_makespan(work), rel=1.1e-2)


def test_the_solver_needs_no_good_start(monkeypatch):
    """Here one arm would pick all that it reaches, and the other the rest."""
    pytest.importorskip("ortools")
    work = made_up(np.random.default_rng(104), 2, 5)
    first = np.flatnonzero(work.reached[0]).tolist()
    start = (tuple(first), tuple(j for j in range(5) if j not in first))
    monkeypatch.setattr(optimiser, "local_search", lambda *_, **__: start)
    plans = {timetable(work, plan).makespan: plan for plan in every_plan(work)}
    best = min(plans)
    assert timetable(work, start).makespan > 1.2 * best
    assert timetable(work, cp_sat(work, seconds=5.0)).makespan == pytest.approx(best, rel=1.1e-2)
    near = min(value for value in plans if value > 1.03 * best)
    start = plans[near]  # better, but not as good as the bound allows
    assert 1.05 * lower_bound(work) < near < 1.5 * lower_bound(work)
    assert timetable(work, cp_sat(work, seconds=5.0)).makespan == pytest.approx(best, rel=1.1e-2)


def test_one_fruit_or_none_needs_no_search():
    for count in (0, 1):
        work = made_up(np.random.default_rng(0), 2, count)
        plan = local_search(work)
        assert sorted(j for queue in plan for j in queue) == list(range(count))
        if count:
            assert timetable(work, plan).makespan == pytest.approx(
                min(work.first[0] + work.duration[a, 0] for a in range(2) if work.reached[a, 0])
            )


FRUIT = np.array([[0.4, -1.4, 1.0], [0.1, -1.2, 1.3], [-0.5, -1.3, 1.5]])
"""Seen from the base, looking along -y, x grows to the left: the first is the left-most, the last the right-most."""


def heading_by_hand(left, right, spacing):
    """Eqs (10) and (11): half of beta less gamma, less an eighth of a turn."""
    beta = math.atan(right[0] / abs(right[1])) + math.asin(spacing / math.hypot(right[0], right[1]))
    gamma = math.atan2(abs(left[1]), left[0]) + math.asin(spacing / math.hypot(left[0], left[1]))
    return (beta - gamma) / 2 - math.pi / 4


def test_the_corrected_pick_point_is_equations_7_to_11_with_theta2_as_heading(machine):
    """Reach: the nearest fruit less a4 and a slave at rest; height: half a slide's stroke above the lowest."""
    assert border_indices(FRUIT) == (0, 2)
    heading = heading_by_hand(FRUIT[0], FRUIT[2], 0.35)
    assert pick_heading(FRUIT, 0.35) == pytest.approx(heading)
    reach = math.hypot(0.1, 1.2) - machine.a4 - machine.slave_home[2]
    stroke = machine.slave.upper[0] - machine.slave.lower[0]
    found = pick_point(machine, FRUIT, "corrected")
    assert found == pytest.approx([heading, 1.0 + stroke / 2 - machine.d1, reach])


@pytest.mark.parametrize("method", ["equations", "as_printed"])
def test_equation_12_puts_frame_3_at_the_polar_angle_theta2(machine, method):
    sides = (0, 2) if method == "equations" else (2, 0)
    assert border_indices(FRUIT, printed=method == "as_printed") == sides
    left, right = FRUIT[sides[0]], FRUIT[sides[1]]
    if method == "as_printed":  # arctan of |Y|/X, which is negative where X is
        beta = math.atan(right[0] / abs(right[1])) + math.asin(0.35 / math.hypot(right[0], right[1]))
        gamma = math.atan(abs(left[1]) / left[0]) + math.asin(0.35 / math.hypot(left[0], left[1]))
        heading = (beta - gamma) / 2 - math.pi / 4
    else:
        heading = heading_by_hand(left, right, 0.35)
    reach = math.hypot(0.1, 1.2) - machine.a4 - machine.slave_home[2]
    stroke = machine.slave.upper[0] - machine.slave.lower[0]
    point = machine.frame3(pick_point(machine, FRUIT, method))
    assert point == pytest.approx([reach * math.cos(heading), reach * math.sin(heading), 1.0 + stroke / 2])


def test_a_border_fruit_nearer_than_the_arms_are_apart_has_no_heading():
    near = np.array([[0.35, -0.05, 1.0], [0.0, -1.2, 1.0]])
    assert np.isfinite(pick_heading(near, 0.35))
    with pytest.raises(InputError, match="nearer to the axis"):
        pick_heading(near, 0.36)
    with pytest.raises(InputError, match="nearer to the axis"):
        pick_heading(near, math.hypot(0.35, 0.05))


def test_the_search_reaches_as_much_as_a_fine_grid_of_all_points(machine):
    """Headings of 2 degrees, reaches and heights of 40 mm, over every pose of the master."""
    rng = np.random.default_rng(3)
    low, high = machine.master.nominal.lower, machine.master.nominal.upper
    for _ in range(3):
        corner = np.array([rng.uniform(-0.6, 0.6) - 0.35, -1.4, rng.uniform(0.5, 1.7)])
        fruit = corner + np.array([0.7, 0.4, 0.55]) * rng.random((6, 3))
        middle = math.atan2(fruit[:, 1].mean(), fruit[:, 0].mean())
        grid = np.stack(np.meshgrid(
            middle + np.arange(-0.6, 0.6, 0.035), np.arange(low[1], high[1], 0.04), np.arange(low[2], high[2], 0.04)
        ), axis=-1).reshape(-1, 3)  # fmt: skip
        best = max(int(machine.reach(part, np.broadcast_to(fruit, (len(part), 6, 3))).any(axis=1).sum(axis=1).max())
                   for part in np.array_split(grid.clip(low, high), 20))  # fmt: skip
        assert machine.reach(pick_point(machine, fruit), fruit).any(axis=0).sum() >= max(best - (best == 6), 5)


def test_a_side_is_cut_into_columns_that_run_up_and_down():
    zones = cut(Grid(2, 3, 0.1), -1.0, 1.0, 0.0, 1.5)
    assert [zone.name for zone in zones] == [
        f"row {row}, column {column}" for column, rows in ((1, (1, 2, 3)), (2, (3, 2, 1))) for row in rows
    ]
    edges = [(zone.left, zone.right, zone.bottom, zone.top) for zone in zones]
    assert edges[0] == pytest.approx((-1.05, 0.05, -0.05, 0.55)) and edges[1] == pytest.approx(
        (-1.05, 0.05, 0.45, 1.05)
    )
    assert edges[3] == pytest.approx((-0.05, 1.05, 0.95, 1.55)) and edges[5] == pytest.approx(
        (-0.05, 1.05, -0.05, 0.55)
    )
    for x, z, held in ((-1.05, 0.0, True), (-1.051, 0.0, False), (0.05, 0.55, True), (0.051, 0.0, False),
                       (0.0, 0.56, False), (0.0, -0.05, True), (0.0, -0.051, False)):  # fmt: skip
        assert zones[0].holds([x, 7.0, z]) == held


@pytest.mark.parametrize(
    ("grid", "side", "fits"),
    [
        (Grid(2, 1, 0.49), (0, 1, 0, 1), True),
        (Grid(2, 1, 0.5), (0, 1, 0, 1), False),
        (Grid(1, 2, 0.5), (0, 9, 0, 1), False),
        (Grid(1, 1, 0.1), (0, 0, 0, 1), False),
        (Grid(1, 1, 0.1), (0, 1, 1, 1), False),
    ],
)
def test_zones_are_wider_than_their_overlap_and_sides_not_empty(grid, side, fits):
    if fits:
        assert len(cut(grid, *side)) == grid.columns * grid.rows
    else:
        with pytest.raises(InputError, match=r"overlap|empty"):
            cut(grid, *side)


def test_a_search_is_drawn_from_the_generator_it_is_given():
    """Which need not find the same plan, and is left where it stopped."""
    work = made_up(np.random.default_rng(3), 3, 12)
    rng, same, untouched = (np.random.default_rng(1) for _ in range(3))
    assert local_search(work, rng) == local_search(work, same)
    assert rng.random() == same.random() != untouched.random()
    assert local_search(work) == local_search(work)


def test_heights_worth_trying_put_the_fruits_middle_or_one_fruit_at_the_slides_middle_or_ends(machine):
    rng = np.random.default_rng(0)
    low, high = machine.slave.lower[0], machine.slave.upper[0]
    for _ in range(20):
        fruit = np.column_stack([rng.uniform(-0.4, 0.4, 5), np.full(5, -1.2), rng.uniform(0.5, 2.2, 5)])
        z = np.sort(fruit[:, 2])
        wanted = [(z[0] + z[-1]) / 2 - (low + high) / 2, *(z - low), *(z - high)]
        expected = np.clip(np.array(wanted) - machine.d1, *(end[1] for end in limits_of(machine)))
        np.testing.assert_allclose(np.sort(_heights(machine, fruit)), np.sort(expected))


def test_a_point_costs_the_fruit_it_misses_then_motion_and_idle_arms(machine):
    """Each fruit counts one; motion of the arm that moves least, and the arm with least work, up to 0.3 each."""
    rng = np.random.default_rng(4)
    fruit = np.array([-0.5, -1.4, 1.2]) + np.array([1.0, 0.4, 0.9]) * rng.random((5, 3))
    masters = np.column_stack([rng.uniform(-1.9, -1.2, 12), np.zeros(12), rng.uniform(0.3, 0.7, 12)])
    heights = np.array([0.5, 0.8, 1.1])
    slide = (machine.slave.lower[0], machine.slave.upper[0])
    d4 = fruit[:, 2] - machine.d1 - heights[:, None]
    inside = (d4 >= slide[0]) & (d4 <= slide[1])
    low, high = machine.slave.lower[1:], machine.slave.upper[1:]
    found = _point_costs(machine, masters, fruit, inside)
    counts = set()
    for m, k in product(range(12), range(3)):
        joints = machine.slave_inverse(masters[m] + [0.0, heights[k], 0.0], fruit)
        reached = machine.within_limits(joints)
        moves = (np.abs(joints[..., 1:] - machine.slave_home[1:]) / (high - low)).sum(axis=-1)
        taken = [j for j in range(5) if reached[:, j].any()]
        motion = sum(min(moves[i, j] for i in range(machine.arms) if reached[i, j]) for j in taken)
        idle = min(reached.sum(axis=1).min() / (5 / 3), 1.0)
        assert found[m, k] == pytest.approx(-len(taken) + 0.3 * motion / (1.5 * 5) - 0.3 * idle)
        counts.add((len(taken), idle > 0))
    assert len(counts) >= 4


def test_slides_that_end_elsewhere_move_the_pick_point_by_as_much(machine):
    """A slide from 0.05 to 0.65 m in place of -0.3 to 0.3 m: the master stands 0.35 m lower, all else is the same."""
    shift = np.array([0.35, 0.0, 0.0])
    slaves = tuple(
        replace(arm, nominal=replace(arm.nominal, lower=arm.nominal.lower + shift, upper=arm.nominal.upper + shift))
        for arm in machine.slaves
    )
    shifted = replace(machine, slaves=slaves, slave_home=machine.slave_home + shift)
    rng = np.random.default_rng(8)
    for _ in range(4):
        fruit = [rng.uniform(-0.3, 0.3), -1.3, 1.5] + np.array([0.6, 0.3, 0.8]) * rng.random((7, 3))
        usual, moved = pick_point(machine, fruit), pick_point(shifted, fruit)
        np.testing.assert_allclose(moved, usual - [0.0, 0.35, 0.0], atol=1e-9)
        np.testing.assert_array_equal(shifted.reach(moved, fruit), machine.reach(usual, fruit))


def limits_of(machine):
    return machine.master.nominal.lower, machine.master.nominal.upper
