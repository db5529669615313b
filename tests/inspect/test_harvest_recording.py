"""A harvested zone read back: machine, fruit and lanes are those of the harvest."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.harvester import (
    Controller,
    Harvest,
    Round,
    Strategy,
    TrueMachine,
    arm_distances,
    load_grid,
    load_machine,
    load_orchard,
    load_picking,
    load_true_machine,
    profile,
    slave_joints_at,
    travel_time,
    work_trees,
)
from pickenv.inspect import inspect_harvest, picked_tree
from pickenv.inspect.colours import FRUIT, GREEN, GREY, RED, STEEL
from pickenv.inspect.recordings.harvest_recording import FATES

COLOURS = ((0, 114, 178), (230, 159, 0), (0, 158, 115))
"""Of the arms."""


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
    picked = {int(n): bool(ok) for n, ok in zip(shown.fruit, shown.collected, strict=True)}
    fate = {True: "collected", False: "missed", None: "hanging"}
    for i, number in enumerate(numbers.tolist()):
        assert tuple(rgb[0, i]) == FATES["hanging"]
        assert tuple(rgb[-1, i]) == FATES[fate[picked.get(number)]]


def test_fruit_that_an_earlier_round_took_hangs_no_more(
    true: TrueMachine, reader: Callable[[Path], Any], tmp_path: Path
) -> None:
    """Of the second tree's busiest zone, a neighbouring zone's round has taken one fruit of their overlap."""
    strategy = Strategy("li", Controller(true.machine))
    _, found = work_trees(true, strategy, load_picking(), load_orchard(), load_grid(), count=2, seed=1)
    shown = max(found.rounds, key=lambda item: len(item.fruit))
    taken = np.concatenate([r.fruit[r.collected] for r in found.rounds[: found.rounds.index(shown)]])
    zone = np.flatnonzero(shown.zone.holds(found.tree.fruit))
    hanging = np.setdiff1d(zone, taken)
    assert len(hanging) == len(zone) - 1
    places = reader(inspect_harvest(true.machine, found, tmp_path / "zone.rrd")).values(
        "/world/fruit", "Points3D:positions"
    )
    np.testing.assert_allclose(places, found.tree.fruit[hanging], atol=1e-6)


def test_every_pick_is_in_its_arms_lane(reading: Any, harvest: Harvest, true: TrueMachine) -> None:
    shown = max(harvest.rounds, key=lambda item: len(item.fruit))
    ends = []
    for arm in range(true.machine.arms):
        states = reading.values(f"/arms/slave_{arm + 1}", "StateChange:state").tolist()
        mine = shown.collected[shown.times.arm == arm]
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


def moving(true: TrueMachine, harvest: Harvest) -> tuple[Round, float, Array, Array, Array]:
    """The round shown, when its master arrives, all times, and the joints of master and slaves then."""
    machine, shown = true.machine, max(harvest.rounds, key=lambda item: len(item.fruit))
    way = shown.master - machine.master_start
    arrival = float(travel_time(way, machine.master.speed, machine.master_acceleration).max())
    last = arrival + shown.times.makespan + 1.0
    at = 0.05 * np.arange(int(np.ceil(last / 0.05)))
    gone = profile(at[:, None], way, machine.master.speed, machine.master_acceleration)
    return (
        shown,
        arrival,
        at,
        machine.master_start + gone,
        slave_joints_at(machine, shown.work, shown.times, at - arrival),
    )


def test_the_machine_is_drawn_where_its_joints_put_it(reading: Any, harvest: Harvest, true: TrueMachine) -> None:
    machine = true.machine
    _, _, at, masters, slaves = moving(true, harvest)
    pillar = [[0.0, 0.0, 0.0], [0.0, 0.0, machine.d1 + machine.upper[1]]]
    reading.holds("/world/master/column", strips=pillar, colors=[STEEL], radii=[0.03])
    frame, tips = machine.frame3(masters), machine.tips(masters, slaves)
    straight = np.stack([slaves[..., 0], 0.0 * slaves[..., 0], 0.0 * slaves[..., 0]], axis=-1)
    pivots = machine.tips(masters, straight)
    boom = np.stack([frame, frame, pivots[:, 0], pivots[:, -1]], axis=1)
    boom[:, 0, :2] = 0.0
    boom[..., 2] = frame[:, 2:]
    reading.holds("/world/master/boom", strips=boom, colors=[STEEL], radii=[0.02])
    for arm, colour in enumerate(COLOURS):
        ends = np.stack([pivots[:, arm], tips[:, arm]], axis=1)
        reading.holds(f"/world/slave_{arm + 1}", strips=ends, colors=[colour], radii=[machine.body.radius / 2])
    times = reading.times("/world/master/boom", "sim_time")
    np.testing.assert_allclose(times, 1e9 * at, atol=2.0)
    near = 1e3 * arm_distances(machine, slaves)
    for pair, colour, distance in zip(("1_2", "1_3", "2_3"), COLOURS, near.T, strict=True):
        names = [f"slaves {pair[0]} and {pair[2]}"]
        reading.holds(f"/distance/{pair}", scalars=distance, names=names, colors=[colour])
    limit = np.full(len(at), 1e3 * (2 * machine.body.radius + machine.body.margin))
    reading.holds("/distance/limit", scalars=limit, names=["least allowed"], colors=[RED])


def test_lanes_and_fruit_change_when_a_pick_does(reading: Any, harvest: Harvest, true: TrueMachine) -> None:
    shown, arrival, *_ = moving(true, harvest)
    for arm in range(3):
        picks = sorted(np.flatnonzero(shown.times.arm == arm), key=lambda pick: shown.times.start[pick])
        moments = [0.0, arrival, *(arrival + t[pick] for pick in picks for t in (shown.times.start, shown.times.end))]
        outs = ["collected" if shown.collected[pick] else "missed" for pick in picks]
        reading.holds(
            f"/arms/slave_{arm + 1}",
            state=["carried", "travel", *(state for out in outs for state in (out, "travel"))],
            values=["carried", "travel", "collected", "missed"],
            labels=["carried", "travel", "out, collected", "out, missed"],
            colors=[GREY, STEEL, GREEN, RED],
        )
        np.testing.assert_allclose(reading.times(f"/arms/slave_{arm + 1}", "sim_time"), 1e9 * np.array(moments), atol=2)
    numbers = np.flatnonzero(shown.zone.holds(harvest.tree.fruit))
    ends = np.concatenate([[-np.inf], np.sort(shown.times.end)])
    colours = [[FRUIT] * len(numbers) for _ in ends]
    for pick, number in enumerate(shown.fruit):
        for row, end in zip(colours, ends, strict=True):
            if end >= shown.times.end[pick] and number in numbers:
                row[numbers.tolist().index(number)] = GREEN if shown.collected[pick] else RED
    reading.holds(
        "/world/fruit",
        positions=harvest.tree.fruit[numbers],
        radii=[0.03] * len(numbers),
        colors=[colour for row in colours for colour in row],
    )
    times = reading.times("/world/fruit", "sim_time")
    np.testing.assert_allclose(times[times >= 0], 1e9 * np.array([0.0, *(arrival + ends[1:])]), atol=2)


def test_the_eye_stands_behind_and_beside_all_that_is_shown(reading: Any, harvest: Harvest, true: TrueMachine) -> None:
    machine, (shown, *_) = true.machine, moving(true, harvest)
    home = machine.slave_home[None].repeat(3, axis=0)
    tips = [machine.tips(master, home) for master in (machine.master_start, shown.master)]
    points = np.concatenate([harvest.tree.fruit[shown.zone.holds(harvest.tree.fruit)], *tips])
    low, high = points.min(axis=0), points.max(axis=0)
    heading = np.arctan2(*machine.frame3(shown.master)[1::-1])
    beside, ahead = (np.array([np.cos(turn), np.sin(turn), 0.0]) for turn in (heading - np.pi / 2, heading))
    away = 0.9 * np.linalg.norm(high - low) * (0.8 * beside - 0.6 * ahead + np.array([0.0, 0.0, 0.5]))
    found = {}
    for chunk in reading.blueprint.stream():
        batch = chunk.to_record_batch()
        found |= {name: batch.column(name).to_pylist()[-1] for name in batch.schema.names if ":" in name}
        name = (found.pop("ViewBlueprint:display_name", None) or [None])[0]
        if name:
            found[name] = (found.pop("ViewBlueprint:class_identifier")[0], found.pop("ViewBlueprint:space_origin")[0])
    np.testing.assert_allclose(found["EyeControls3D:look_target"][0], (low + high) / 2, rtol=1e-6)
    np.testing.assert_allclose(found["EyeControls3D:position"][0], (low + high) / 2 + away, rtol=1e-6)
    assert found["LineGrid3D:visible"] == [False] and found["TimePanelBlueprint:timeline"] == ["sim_time"]
    np.testing.assert_allclose(found["ContainerBlueprint:row_shares"], [4.0, 1.4, 2.0], rtol=1e-6)
    assert found["Master, slaves and fruit, m"] == ("3D", "/world")
    assert found["Slaves: travel, out and collected, out and missed (red)"] == ("StateTimeline", "/arms")
    assert found["Distance between slaves, mm"] == ("TimeSeries", "/distance")
    assert sorted(reading.rules()) == ["/arms/**", "/distance/**", "/world/**"]


@pytest.mark.parametrize("arms", [1, 2])
def test_fewer_arms_have_fewer_distances(arms: int, reader: Callable[[Path], Any], tmp_path: Path) -> None:
    few = load_true_machine(load_machine(slaves=arms))
    strategy = Strategy("li", Controller(few.machine))
    (found,) = work_trees(few, strategy, load_picking(), load_orchard(), load_grid(), count=1, seed=1)
    reading = reader(inspect_harvest(few.machine, found, tmp_path / "zone.rrd"))
    distances = {entity for entity in reading.entities() if entity.startswith("/distance")}
    assert distances == ({"/distance/1_2", "/distance/limit"} if arms == 2 else set())
    assert ("/distance/**" in reading.rules()) == (arms == 2) and reading.unmatched_rules() == []


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
                one.collected[i],
            ]
            pick += 1
    assert pick == len(kept.arm) == len(kept.got) > 5 and 0 < kept.got.sum() < pick
    idle = copy(harvest)
    idle.rounds = []
    none = picked_tree(idle)
    assert (none.zones.shape, none.stands.shape, none.arm.shape) == ((0, 4), (0, 2), (0,))


def test_a_harvest_of_nothing_is_refused(true: TrueMachine, harvest: Harvest, tmp_path: Path) -> None:
    idle = copy(harvest)
    idle.rounds = []
    with pytest.raises(InputError, match="no round"):
        inspect_harvest(true.machine, idle, tmp_path / "zone.rrd")
