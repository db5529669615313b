"""A harvested zone read back: machine, fruit and lanes are those of the harvest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.errors import InputError
from pickenv.harvester.harvest import Harvest, Strategy
from pickenv.harvester.interference import arm_distances
from pickenv.harvester.machine import load_machine
from pickenv.harvester.picking import load_picking
from pickenv.harvester.strategies import work_trees
from pickenv.harvester.trees import load_orchard
from pickenv.harvester.true_machine import Controller, TrueMachine, load_true_machine
from pickenv.harvester.zones import load_grid
from pickenv.inspect.recordings.harvest_recording import FATES, inspect_harvest
from pickenv.inspect.runs.harvest_trace import picked_tree


@pytest.fixture(scope="module")
def true() -> TrueMachine:
    return load_true_machine(load_machine())


@pytest.fixture(scope="module")
def harvest(true: TrueMachine) -> Harvest:
    strategy = Strategy("li", Controller(true.machine))
    (found,) = work_trees(true, strategy, load_picking(), load_orchard(), load_grid(), count=1, seed=1)
    return found


@pytest.fixture(scope="module")
def reading(
    true: TrueMachine, harvest: Harvest, reader: Callable[[Path], Any], tmp_path_factory: pytest.TempPathFactory
) -> Any:
    return reader(inspect_harvest(true.machine, harvest, tmp_path_factory.mktemp("zone") / "zone.rrd"))


def test_every_include_rule_matches_and_every_part_is_there(reading: Any, true: TrueMachine) -> None:
    assert reading.unmatched_rules() == []
    arms = range(1, true.machine.arms + 1)
    wanted = {"/world/master/column", "/world/master/boom", "/world/fruit", "/distance/limit"}
    wanted |= {f"/{room}/slave_{i}" for room in ("world", "arms") for i in arms}
    assert wanted <= reading.entities()


def test_fruit_end_as_the_harvest_says(reading: Any, harvest: Harvest) -> None:
    shown = max(harvest.rounds, key=lambda item: len(item.fruit))
    numbers = np.flatnonzero(shown.zone.holds(harvest.tree.fruit))
    places = reading.values("/world/fruit", "Points3D:positions")
    np.testing.assert_allclose(places, harvest.tree.fruit[numbers], atol=1e-6)
    packed = reading.values("/world/fruit", "Points3D:colors").reshape(-1, len(numbers))
    rgb = np.stack([packed >> shift & 0xFF for shift in (24, 16, 8)], axis=-1)
    picked = {int(n): bool(ok) for n, ok in zip(shown.fruit, shown.outcome.collected, strict=True)}
    fate = {True: "collected", False: "missed", None: "hanging"}
    for i, number in enumerate(numbers.tolist()):
        assert tuple(rgb[0, i]) == FATES["hanging"]
        assert tuple(rgb[-1, i]) == FATES[fate[picked.get(number)]]


def test_every_pick_is_in_its_arms_lane(reading: Any, harvest: Harvest, true: TrueMachine) -> None:
    shown = max(harvest.rounds, key=lambda item: len(item.fruit))
    ends = []
    for arm in range(true.machine.arms):
        states = reading.values(f"/arms/slave_{arm + 1}", "StateChange:state").tolist()
        mine = shown.outcome.collected[shown.times.arm == arm]
        assert states.count("collected") == int(mine.sum())
        assert states.count("missed") == int((~mine).sum())
        ends.append(reading.times(f"/arms/slave_{arm + 1}", "sim_time").max())
    assert max(ends) == pytest.approx(reading.times("/world/fruit", "sim_time").max())


def test_cups_reach_their_fruit_and_distances_are_theirs(reading: Any, harvest: Harvest, true: TrueMachine) -> None:
    shown = max(harvest.rounds, key=lambda item: len(item.fruit))
    times = reading.times("/world/slave_1", "sim_time") / 1e9
    start = times[-1] - 1.0 - shown.times.makespan  # a second is shown after the last pick
    for pick in range(len(shown.fruit)):
        arm = int(shown.times.arm[pick])
        strips = reading.component(f"/world/slave_{arm + 1}", "LineStrips3D:strips").to_pylist()
        tips = np.array([row[0][-1] for row in strips])
        during = (times >= start + shown.times.start[pick]) & (times <= start + shown.times.end[pick] + 0.1)
        wanted = true.machine.tips(shown.master, np.repeat(shown.aimed[pick][None], true.machine.arms, axis=0))[arm]
        assert np.linalg.norm(tips[during] - wanted, axis=1).min() < 5e-3
    least = min(reading.values(f"/distance/{pair}", "Scalars:scalars").min() for pair in ("1_2", "1_3", "2_3"))
    assert least > 1e3 * true.machine.body.clearance
    home = np.broadcast_to(true.machine.slave_home, (1, true.machine.arms, 3))
    first = [reading.values(f"/distance/{pair}", "Scalars:scalars")[0] for pair in ("1_2", "1_3", "2_3")]
    np.testing.assert_allclose(first, 1e3 * arm_distances(true.machine, home)[0])


def test_what_a_run_keeps_of_a_tree_is_its_rounds_one_after_another(harvest: Harvest) -> None:
    kept, pick = picked_tree(harvest), 0
    assert (kept.seconds, len(kept.zones)) == (harvest.seconds, len(harvest.rounds))
    for name in ("collected", "by_arm"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(harvest, name))
    np.testing.assert_array_equal(kept.fruit, harvest.tree.fruit)
    for k, one in enumerate(harvest.rounds):
        zone = one.zone
        assert kept.zones[k].tolist() == [zone.left, zone.right, zone.bottom, zone.top]
        assert kept.stands[k].tolist() == [one.begin, one.begin + one.times.makespan]
        for i in range(len(one.fruit)):
            told = [getattr(kept, name)[pick] for name in ("arm", "start", "end", "held", "got")]
            times = one.times
            assert told == [
                times.arm[i],
                one.begin + times.start[i],
                one.begin + times.end[i],
                times.held[i],
                one.outcome.collected[i],
            ]
            pick += 1
    assert pick == len(kept.arm) == len(kept.got) > 5 and 0 < kept.got.sum() < pick
    none = picked_tree(replace(harvest, rounds=[]))
    assert (none.zones.shape, none.stands.shape, none.arm.shape) == ((0, 4), (0, 2), (0,))


def test_a_harvest_of_nothing_is_refused(true: TrueMachine, harvest: Harvest, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no round"):
        inspect_harvest(true.machine, replace(harvest, rounds=[]), tmp_path / "zone.rrd")
