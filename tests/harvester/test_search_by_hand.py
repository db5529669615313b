"""Searches for plans and pick points step by step, what is asked of the solvers, and commands counted."""

import math
import sys
from dataclasses import replace
from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest

from papers.li2016 import cp_sat as referee
from papers.li2016.cp_sat import _ticks, cp_sat
from pickenv.arm import forward
from pickenv.base import InputError
from pickenv.harvester import (
    Controller,
    Work,
    Zone,
    assign,
    load_machine,
    load_true_machine,
    lower_bound,
    optimiser,
    pick_point,
    timetable,
)
from pickenv.harvester.optimiser import local_search
from pickenv.harvester.pick_points import AHEAD, Search, _heights, _point_costs, _search, pick_heading, searched

POINTS = sys.modules[searched.__module__]


def made_up(seed, arms, count, reach=0.8, conflict=0.1):
    """Work by chance, in which each fruit is reached by an arm; lengths are whole tenths, so that some are alike."""
    rng = np.random.default_rng(seed)
    reached = rng.random((arms, count)) < reach
    reached[0] |= ~reached.any(axis=0)
    meet = rng.random((arms, count, arms, count)) < conflict
    meet |= meet.transpose(2, 3, 0, 1)
    joints = np.broadcast_to(rng.uniform(0.0, 1.0, (1, count, 1)), (arms, count, 3)) * [1.0, -1.0, 2.0]
    duration, first, travel = (rng.integers(0, 10, shape) / 10 for shape in ((arms, count), count, (count, count)))
    return Work(joints, reached, np.ones((arms, count)), 1.0 + duration, first, travel, meet, np.zeros(count))


def lengths(work, plan):
    """Makespan, and the first to begin of the arms that end last."""
    found = timetable(work, tuple(map(tuple, plan)))
    last = int(np.argmax(found.end))
    return float(found.end[last]), int(found.arm[last])


def from_below(work):
    """Fruit that fewest arms reach first, each to the arm that is then done first; each arm then works upwards."""
    load, parts = [0.0] * work.arms, [[] for _ in range(work.arms)]
    for j in sorted(range(work.count), key=lambda j: (work.reached[:, j].sum(), j)):
        arm = min((a for a in range(work.arms) if work.reached[a, j]), key=lambda a: load[a] + work.duration[a, j])
        load[arm] += work.duration[arm, j]
        parts[arm].append(j)
    return [sorted(part, key=lambda j: work.joints[0, j, 0]) for part in parts]


def another(work, plan, source, rng):
    """A fruit of an arm in another place, or in exchange with one of another arm."""
    plan = [list(queue) for queue in plan]
    if not plan[source]:
        return None
    place, target = int(rng.integers(len(plan[source]))), int(rng.integers(work.arms))
    fruit = plan[source].pop(place)
    if rng.random() < 0.5 and plan[target]:
        other = int(rng.integers(len(plan[target])))
        partner = plan[target][other]
        plan[target][other] = fruit
        plan[source].insert(place, partner)
        return plan if work.reached[target, fruit] and work.reached[source, partner] else None
    if work.reached[target, fruit]:
        plan[target].insert(int(rng.integers(len(plan[target]) + 1)), fruit)
        return plan
    return None


def step_by_step(work, rng, bound, rounds):
    """Annealing: half of the tries take a fruit of the arm that ended last; heat falls from 3 % of the best to none."""
    starts = [from_below(work), assign(work, "nearest"), assign(work, "hungarian")]
    best = now = min(starts, key=lambda plan: lengths(work, plan)[0])
    least = cost = lengths(work, best)[0]
    last = 0
    for step in range(rounds * work.count if work.count > 1 else 0):
        if least <= 1.01 * bound:
            break
        tried = another(work, now, last if rng.random() < 0.5 else int(rng.integers(work.arms)), rng)
        if tried is None:
            continue
        length, ends = lengths(work, tried)
        loads = [sum(work.duration[arm, queue].tolist()) for arm, queue in enumerate(map(list, tried))]
        new = length + sum(loads) / work.arms / 1000
        worse = new - cost
        if worse < 0 or rng.random() < math.exp(-worse / (0.03 * least * (1 - step / rounds / work.count))):
            now, cost, last = tried, new, ends
            if length < least - 1e-9:
                best, least = tried, length
    return tuple(map(tuple, best))


@pytest.mark.parametrize(
    ("arms", "count", "patience"), [(3, 8, 0.5), (2, 6, 1.0), (3, 3, 1.0), (2, 2, 2.0), (2, 1, 1.0)]
)
def test_the_search_takes_the_steps_that_are_written_out(arms, count, patience):
    """The same plan, from as many draws; some searches end early at their bound."""
    early = 0
    for seed in range(3):
        work, after = made_up(seed, arms, count), []
        bound = lower_bound(work, integral=False)
        for given in (None, 0.0, 0.97 * bound, 1.3 * bound):
            rng, same = np.random.default_rng(seed), np.random.default_rng(seed)
            found = local_search(work, rng, bound=given, patience=patience)
            assert found == step_by_step(work, same, bound if given is None else given, int(60 * patience))
            after.append(rng.random())
            assert after[-1] == same.random()
        early += after[3] != after[1]
    assert count < 4 or early > 0


def test_waves_leave_a_fruit_to_the_arms_that_reach_it():
    for seed in range(20):
        work = made_up(seed, 3, 7, reach=0.3)
        plan = assign(work, "hungarian")
        assert sorted(j for queue in plan for j in queue) == list(range(7))
        assert all(work.reached[arm, j] for arm, queue in enumerate(plan) for j in queue)


def test_the_bound_is_the_solvers_proof_not_its_find(monkeypatch):
    """A pick cannot be shorter than itself; whole fruit counts for a fifth of a second, to half a per cent."""
    work, asked = made_up(0, 2, 4), []
    single = (np.where(work.reached, work.duration, np.inf).min(axis=0)
              + np.minimum(work.first, (work.travel + np.diag([np.inf] * 4)).min(axis=0))).max()  # fmt: skip

    def answering(proof, find):
        def solve(cost, **given):
            asked.append(given["options"])
            return SimpleNamespace(mip_dual_bound=proof, fun=find)

        monkeypatch.setattr(optimiser, "milp", solve)

    answering(30.0, 40.0)
    assert lower_bound(work) == 30.0 and lower_bound(work, integral=False) == 40.0
    answering(0.5 * single, 40.0)
    assert lower_bound(work) == pytest.approx(single)
    answering(None, None)
    assert lower_bound(work) == lower_bound(work, integral=False) == pytest.approx(single)
    assert asked == [{"time_limit": 0.2, "mip_rel_gap": 0.005}] * 5
    none = replace(work, reached=np.zeros_like(work.reached))
    assert lower_bound(none) == 0.0 and len(asked) == 5


def test_the_solver_starts_from_a_patient_search_and_keeps_its_time(monkeypatch):
    cp_model = pytest.importorskip("ortools.sat.python.cp_model")
    work, asked, solvers = made_up(1, 2, 5), [], []
    bound = lower_bound(work)
    start = (tuple(np.flatnonzero(work.reached[0]).tolist()), tuple(np.flatnonzero(~work.reached[0]).tolist()))

    class Noted(cp_model.CpSolver):
        def solve(self, model):
            solvers.append(self.parameters)
            return cp_model.UNKNOWN

    monkeypatch.setattr(cp_model, "CpSolver", Noted)
    monkeypatch.setattr(referee, "local_search", lambda *given, **more: asked.append((given, more)) or start)
    rng = np.random.default_rng(0)
    assert cp_sat(work, rng) == cp_sat(work, rng, seconds=0.125) == start
    assert asked == [((work, rng), {"bound": bound, "patience": 6.0})] * 2
    assert [(each.max_time_in_seconds, each.num_workers) for each in solvers] == [(0.35, 1), (0.125, 1)]


@pytest.mark.parametrize("last", [4.999, 5.001])
def test_the_solver_tells_plans_a_millisecond_apart(last, monkeypatch):
    """Three picks of one arm that take 5 s together, or the last of them by a slow arm."""
    pytest.importorskip("ortools")
    none, free = np.zeros(3), np.zeros((2, 3, 2, 3), dtype=bool)
    duration, every = np.array([[1.0, 2.0, 2.0], [9.0, 9.0, last]]), np.ones((2, 3), dtype=bool)
    work = Work(np.zeros((2, 3, 3)), every, np.ones((2, 3)), duration, none, np.zeros((3, 3)), free, none)
    monkeypatch.setattr(optimiser, "local_search", lambda *given, **more: ((0,), (1, 2)))
    found = cp_sat(work, seconds=5.0)
    assert timetable(work, found).makespan == pytest.approx(min(5.0, last))
    assert [_ticks(seconds) for seconds in (1.0, 0.0011, 0.0)] == [1000, 2, 0]


def test_the_solver_sees_who_must_not_meet_and_that_ways_take_time(monkeypatch):
    """Two arms that always meet must take turns: three picks of 2 s are 6 s, with ways of 1 s to the second fruit."""
    pytest.importorskip("ortools")
    meet = np.ones((2, 3, 2, 3), dtype=bool)
    travel = np.array([[0.0, 1.0, 0.5], [0.25, 0.0, 0.5], [0.75, 1.0, 0.0]])
    reached = np.array([[True, True, True], [False, False, True]])
    duration, first = np.array([[2.0, 2.0, 2.5], [9.0, 9.0, 2.0]]), np.array([0.5, 0.75, 0.25])
    work = Work(np.zeros((2, 3, 3)), reached, np.ones((2, 3)), duration, first, travel, meet, np.zeros(3))
    monkeypatch.setattr(optimiser, "local_search", lambda *given, **more: ((0, 1, 2), ()))
    alone = [(order, ()) for order in permutations(range(3))]
    best = min(timetable(work, plan).makespan for plan in (((0, 1), (2,)), ((1, 0), (2,)), *alone))
    assert timetable(work, cp_sat(work, seconds=5.0)).makespan == pytest.approx(best)


def test_what_is_no_list_of_places_has_no_pick_point(machine):
    for wrong in (np.zeros(3), np.zeros((2, 2, 3)), np.ones((3, 4)), np.zeros((0, 3))):
        with pytest.raises(InputError, match="at least one fruit"):
            pick_point(machine, wrong)


def test_of_one_arm_the_heading_knows_no_side_arms():
    machine = load_machine(slaves=1)
    fruit = np.array([[0.4, -1.4, 1.0], [-0.3, -1.2, 1.3]])
    assert pick_point(machine, fruit, "corrected")[0] == pytest.approx(pick_heading(fruit, 0.0))
    assert pick_heading(fruit, 0.0) != pytest.approx(pick_heading(fruit, 0.1), abs=1e-3)


def test_of_two_arms_the_heading_knows_half_their_distance():
    machine = load_machine(slaves=2)
    fruit = np.array([[0.4, -1.4, 1.0], [-0.3, -1.2, 1.3]])
    half = (machine.offsets[1] - machine.offsets[0]) / 2
    assert pick_point(machine, fruit, "corrected")[0] == pytest.approx(pick_heading(fruit, half))


@pytest.mark.parametrize("slaves", [1, 2, 3])
def test_the_arm_with_fewest_fruit_counts_up_to_an_equal_share(slaves):
    """By loops over arms and fruit; a lone arm that reaches all has its share, and no more."""
    machine, rng = load_machine(slaves=slaves), np.random.default_rng(1)
    low, high, home = machine.slave.lower[1:], machine.slave.upper[1:], machine.slave_home[1:]
    masters = np.array([-1.25, 0.95, 0.55]) + rng.normal(0.0, 0.05, (6, 3))
    tips = machine.tips(masters[0], np.tile([0.0, 0.0, 0.65], (slaves, 1)))
    fruit = tips.mean(axis=0) + rng.normal(0.0, 0.06, (7, 3))
    inside = rng.random((4, len(fruit))) < 0.8
    found, shares = _point_costs(machine, masters, fruit, inside), []
    for i, master in enumerate(masters):
        ways = machine.slave_inverse(master, fruit)[..., 1:]
        for j, height in enumerate(inside):
            cost, load = 0.0, np.zeros(slaves)
            for f in np.flatnonzero(height):
                able = [a for a in range(slaves) if (ways[a, f] >= low).all() and (ways[a, f] <= high).all()]
                if able:
                    motion = min((np.abs(ways[a, f] - home) / (high - low)).sum() for a in able)
                    cost += -1.0 + 0.3 * motion / (1.5 * len(fruit))
                    load[able] += 1
            shares.append(load.min() / (len(fruit) / slaves))
            assert found[i, j] == pytest.approx(cost - 0.3 * min(shares[-1], 1.0))
    assert min(shares) < 1.0 and (max(shares) > 1.0) == (slaves == 2)


def test_fruit_beyond_what_any_arm_could_reach_is_left_out_of_the_middle(machine, monkeypatch):
    """A search of one point: it turns to the middle of the fruit that is near enough, of both where none is."""
    monkeypatch.setattr(POINTS, "_search", lambda: Search(0.0, 0.0, 1, 1.0))
    slave, master = machine.slave, machine.master.nominal
    most = master.upper[2] + machine.a4 + slave.upper[2] + machine.a2 + max(abs(machine.offsets))

    def heading(*fruit):
        middle = np.mean(fruit, axis=0)
        return math.atan2(middle[1], middle[0]) + math.asin(min(machine.a2 / math.hypot(*middle[:2]), 1.0))

    first = [0.2, -1.2, 1.2]
    for size, counts in ((most - 1e-6, True), (most + 1e-6, False)):
        other = [size * math.sin(-0.4), -size * math.cos(-0.4), 1.2]
        found = searched(machine, np.array([first, other]))[0]
        assert found == pytest.approx(heading(first, other) if counts else heading(first))
    far = [[2 * most * math.sin(0.3), -2 * most * math.cos(0.3), 1.2], [-most, -most, 1.2]]
    assert searched(machine, np.array(far))[0] == pytest.approx(heading(*far))
    around = [[0.8, -0.01 * machine.a2, 1.2], [-0.8, -0.01 * machine.a2, 1.2]]  # their middle is inside of a2
    assert machine.a2 > 0.0 and searched(machine, np.array(around))[0] == pytest.approx(
        np.clip(heading(*around), master.lower[0], master.upper[0])
    )


def test_the_search_tries_a_grid_and_once_more_a_finer_one_around_the_best(machine, monkeypatch):
    tried = []

    def noted(machine, masters, fruit, inside):
        tried.append((masters, cost := _point_costs(machine, masters, fruit, inside)))
        return cost

    monkeypatch.setattr(POINTS, "_point_costs", noted)
    fruit = np.array([0.0, -1.35, 1.2]) + np.array([0.5, 0.3, 0.5]) * np.random.default_rng(0).random((5, 3))
    found = searched(machine, fruit)
    (first, cost), (second, finer) = tried
    steps = _search()
    assert (steps.heading, steps.reach, steps.steps, steps.keep_share) == (math.radians(30.0), 0.36, 13, 0.2)
    low, high = machine.master.nominal.lower, machine.master.nominal.upper
    middle = [first[:, 0].min() + steps.heading, 0.0, np.median(first[:, 2])]
    for masters, centre, share in ((first, middle, 1.0), (second, first[cost.min(axis=1).argmin()], 0.2)):
        turns = centre[0] + share * math.radians(30.0) * np.arange(-6, 7) / 6
        reaches = centre[2] + share * 0.36 * np.arange(-6, 7) / 6
        expected = np.clip([[turn, 0.0, reach] for turn in turns for reach in reaches], low, high)
        np.testing.assert_allclose(masters[:, [0, 2]], expected[:, [0, 2]], atol=1e-12)
    np.testing.assert_array_equal(found[[0, 2]], second[finer.min(axis=1).argmin()][[0, 2]])


def test_a_height_reaches_the_fruit_within_the_slide_also_at_its_very_ends(machine, monkeypatch):
    """Of fruit over more than a slide's stroke; heights at which a fruit is at an end of the slide are among them."""
    asked = []

    def noted(machine, masters, fruit, inside):
        asked.append(inside)
        return _point_costs(machine, masters, fruit, inside)

    monkeypatch.setattr(POINTS, "_point_costs", noted)
    low, high = machine.slave.lower[0], machine.slave.upper[0]
    z = np.array([1.0, 1.1, 1.25, 1.2 + high - low, 1.3 + high - low])
    fruit = np.column_stack([np.linspace(-0.2, 0.2, 5), np.full(5, -1.3), z])
    found = pick_point(machine, fruit)
    heights = _heights(machine, fruit)
    slide = z - machine.d1 - heights[:, None]
    expected = (slide > low - 1e-6) & (slide < high + 1e-6)
    assert (np.abs(slide - low) < 1e-9).any() and (np.abs(slide - high) < 1e-9).any() and not expected.all(axis=1).any()
    for inside in asked:
        np.testing.assert_array_equal(inside, expected)
    assert machine.reach(found, fruit).any(axis=0).sum() == 3


def test_fruit_at_the_very_end_of_an_arms_turn_or_stretch_is_reached():
    """To a billionth; a fruit a millionth beyond is not, and costs one."""
    alone, master = load_machine(slaves=1), np.array([-1.5, 1.0, 0.5])
    slave, inside = alone.slave, np.ones((1, 1), dtype=bool)
    for ends in (slave.lower, slave.upper):
        for joint in (1, 2):
            middle = (slave.lower + slave.upper) / 2
            for beyond, cost in ((0.0, -1.0), (1e-6, 0.0)):
                joints = middle.copy()
                joints[joint] = ends[joint] + beyond * np.sign(ends[joint] - middle[joint])
                fruit = alone.tips(master, joints[None])[0]
                found = float(_point_costs(alone, master[None], fruit[None], inside)[0, 0])
                assert round(found + 0.3 * (cost < 0)) == cost


def test_each_arm_is_corrected_three_times_and_by_the_master_once_more(machine, true):
    class Counting:
        def __init__(self, geometry):
            self.geometry, self.calls = geometry, 0

        def predict(self, joints):
            self.calls += 1
            return forward(self.geometry, joints)

    beliefs = [Counting(plant.geometry) for plant in (true.master, *true.slaves)]
    controller = Controller(machine, beliefs[0], tuple(beliefs[1:]))
    low, high = machine.lower, machine.upper
    q = (low + high) / 2 + 0.3 * (high - low) * np.random.default_rng(6).uniform(-1.0, 1.0, (9, 12))
    commands = controller(q)
    assert [belief.calls for belief in beliefs] == [4, 3, 3, 3]
    arm = np.arange(9) % 3
    targets = machine.tips(q[:, :3], q[:, 3:].reshape(9, 3, 3))[np.arange(9), arm]
    found = controller.pick_commands(controller.master_command(q[:, :3]), arm, targets)
    np.testing.assert_allclose(found, commands[:, 3:].reshape(9, 3, 3)[np.arange(9), arm], atol=1e-12)
    half = Controller(machine, beliefs[0])
    np.testing.assert_allclose(half(q)[:, :3], commands[:, :3], atol=1e-12)
    assert np.abs(half(q)[:, 3:] - q[:, 3:]).max() > 1e-4
    plain = Controller(machine).pick_commands(q[:, :3], arm, targets)
    np.testing.assert_allclose(plain, q[:, 3:].reshape(9, 3, 3)[np.arange(9), arm], atol=1e-9)


def test_a_machine_as_drawn_has_no_spread_and_its_own_arms(true):
    ideal = true.ideal()
    assert true.repeatability > 0.0 == ideal.repeatability and len(ideal.slaves) == 3
    for plant, drawn in zip((ideal.master, *ideal.slaves), (true.master, *true.slaves), strict=True):
        assert plant.geometry is drawn.arm.nominal
    assert load_true_machine(true.machine).repeatability == true.repeatability


def test_a_zone_is_looked_at_from_before_its_middle():
    view = Zone("", -0.5, 0.1, 1.0, 1.6).view
    np.testing.assert_allclose(view[0], [-0.2, 0.0, 1.3])
    np.testing.assert_array_equal(view[1], [0.0, -1.0, 0.0])
    np.testing.assert_array_equal(AHEAD, [0.0, -1.0, 0.0])
