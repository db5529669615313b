"""A tree's clock, one event at a time: pictures, moves, picks, second looks and unloading, added up by hand."""

import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pickenv.harvester import Controller, Grid, Luck, Strategy, Tree, harvest, load_picking
from pickenv.orchard import load_canopy, load_eyes

SURE, EYES = replace(load_picking(), push=0.0), load_eyes("ideal", load_canopy("li2016"))
ONE, TWO = Grid(1, 1, 1e-6), Grid(2, 1, 1e-6)
LOW, HIGH = [-0.6, -1.2, 1.0], [0.6, -1.2, 1.4]
"""One fruit in each half of the tree's side."""


@pytest.fixture
def works(true, monkeypatch):
    """``works(fruit, strategy's changes, cycle's changes, grasps)``: the harvest of a machine that is as drawn.

    ``grasps`` are the draws of the attempts' grasps in turn, below 1 where the fruit is taken; then all are.
    """

    def build(fruit, grid=ONE, cycle=None, grasps=(), cut=0.0, **strategy):
        machine = replace(true.machine, cycle=replace(true.machine.cycle, **(cycle or {})))
        ideal = replace(replace(true, machine=machine).ideal(), repeatability=0.0)
        turn = list(grasps)

        def luck(_, count):
            each = np.array([turn.pop(0) if turn else 0.0 for _ in range(count)])
            none = np.zeros(count)
            return Luck(each, none, none + cut, none, none, none)

        monkeypatch.setattr(sys.modules["pickenv.harvester.harvest_run"], "draw_luck", luck)
        fruit = np.asarray(fruit, dtype=float).reshape(-1, 3)
        tree = Tree(fruit, np.full(len(fruit), 0.06), np.full(len(fruit), 0.1), (-1.25, 1.25, 0.42, 2.42))
        chosen = Strategy("by hand", Controller(machine), **{"assignment": "nearest", "guard": False, **strategy})
        found = harvest(ideal, chosen, SURE, [tree], [np.random.default_rng(0)], grid, EYES)[0]
        assert found.seconds == pytest.approx(sum(found.phases.values()))
        return machine, found

    return build


def ramp(distance, speed, acceleration):
    """Time from rest to rest: a triangle of speeds while the largest is not reached, else a trapezium."""
    distance = abs(distance)
    if distance < speed**2 / acceleration:
        return 2 * (distance / acceleration) ** 0.5
    return distance / speed + speed / acceleration


def way(machine, start, end):
    """The master's joints start together; the slowest says when it has arrived."""
    moves = zip(np.subtract(end, start), machine.master.speed, machine.master_acceleration, strict=True)
    return max(ramp(*move) for move in moves)


def pick(machine, joints):
    """Up to 100 mm below the fruit, or not at all, out, up, 0.2 s to sense, 0.8 s to cut, and back to rest."""
    speed, acceleration, rest = machine.slaves[0].speed, machine.slave_acceleration, machine.slave_home
    low = min(0.1, joints[0] - rest[0])
    below = ramp(joints[0] - low - rest[0], speed[0], acceleration[0])
    rise = ramp(low, speed[0], acceleration[0])
    out = max(ramp(joints[i] - rest[i], speed[i], acceleration[i]) for i in (1, 2))
    return below + out + rise + 0.2 + 0.8 + out


def test_one_fruit_takes_a_picture_two_ways_a_pick_and_an_unloading(works):
    machine, found = works([LOW])
    there = found.rounds[0].master
    assert found.phases["image"] == 1.0 and found.phases["unload"] == 2.0
    assert found.phases["pick"] == pytest.approx(pick(machine, found.rounds[0].aimed[0]))
    assert found.phases["move"] == pytest.approx(2 * way(machine, machine.master_start, there))
    assert found.rounds[0].begin == pytest.approx(1.0 + way(machine, machine.master_start, there))
    assert found.collected.tolist() == [True] and found.repicks == 0 and not found.load.any()
    assert np.array_equal(found.master, machine.master_start)


@pytest.mark.parametrize(("looks", "images"), [(1, 1), (2, 2), (4, 3)])
def test_a_second_look_is_taken_when_a_cup_came_back_empty(works, looks, images):
    """Two misses: the third look takes the fruit, where there is one."""
    machine, found = works([LOW], grasps=[1.0, 1.0], looks=looks)
    taken = looks == 4
    assert found.phases["image"] == images * 1.0 and found.repicks == images - 1
    assert found.phases["pick"] == pytest.approx(images * pick(machine, found.rounds[0].aimed[0]))
    assert found.attempted.all() and found.attached.tolist() == found.collected.tolist() == [taken]
    assert found.phases["unload"] == (2.0 if taken else 0.0)
    assert found.phases["move"] == pytest.approx(
        (2 if taken else 1) * way(machine, machine.master_start, found.rounds[0].master)
    )


def test_a_fruit_in_the_cup_whose_stalk_was_not_cut_is_looked_at_again(works):
    _, found = works([LOW], cut=0.999, looks=3)
    assert found.attached.all() and not found.detached.any() and not found.collected.any()
    assert found.phases["image"] == 3.0 and found.repicks == 2 and len(found.rounds) == 3


@pytest.mark.parametrize(
    ("tube", "full_only", "unloadings"), [(12, False, 2), (12, True, 1), (1, True, 2), (2, True, 1)]
)
def test_tubes_are_emptied_after_each_zone_or_when_one_is_full_and_at_the_end(works, tube, full_only, unloadings):
    machine, found = works([LOW, HIGH], TWO, {"tube_fruit": tube}, unload_full=full_only)
    assert [round_.fruit.tolist() for round_ in found.rounds] == [[0], [1]] and found.collected.all()
    if len(set(found.by_arm.tolist())) == 2 and tube == 2:
        pytest.fail("the two fruit were to be in one tube")
    assert found.phases["image"] == 2.0 and found.phases["unload"] == 2.0 * unloadings
    home, one, other = machine.master_start, *(round_.master for round_ in found.rounds)
    ways = [home, one, home, other, home] if unloadings == 2 else [home, one, other, home]
    assert found.phases["move"] == pytest.approx(sum(way(machine, *leg) for leg in pairwise(ways)))


def test_a_bare_tree_takes_one_picture_a_zone(works):
    _, found = works([], TWO, looks=3)
    assert found.phases == {"move": 0.0, "image": 2.0, "pick": 0.0, "unload": 0.0} and not found.rounds
