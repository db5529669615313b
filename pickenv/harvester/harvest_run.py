"""Whole trees: zone after zone, image, pick point, plan, picks, second looks, collective unloading, and the clock.

Many trees go on in step, so that the true arms of a zone are computed for all of them at once. Each tree draws from a
generator of its own, so results do not depend on which trees go together. Units: m, rad, s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.arm.plant.plant_batch import leaves
from pickenv.base import InputError
from pickenv.harvester.arm_paths import closest_approach, ultrasonic_hold
from pickenv.harvester.joint_motion import master_time
from pickenv.harvester.machine import Machine
from pickenv.harvester.optimiser import assign
from pickenv.harvester.pick_points import pick_point
from pickenv.harvester.picking import Luck, Outcome, Picking, attempt, displacements, draw_luck
from pickenv.harvester.trees import Tree, tree_leaves
from pickenv.harvester.true_machine import Controller, TrueMachine
from pickenv.harvester.work import Timetable, Work, timetable, zone_work
from pickenv.harvester.zones import Grid, Zone, cut
from pickenv.orchard import Chances, Eyes, Leaves, draw_chances, next_picture, see

Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Strategy:
    """How a machine works a tree.

    Attributes:
        name: As reports print it.
        controller: What is known of the true machine.
        pick_point: Method of `pick_point.pick_point`.
        assignment: Method of `assignment.assign`.
        guard: Whether side arms hold while their ultrasonic ranger hears the middle arm too near.
        looks: Images a zone may have: after the first, one more each time a cup came back empty.
        unload_full: Whether tubes are emptied only when one is full and at the end, rather than after each zone.
        detector: What reads the pictures, of `pickenv.orchard.DETECTORS`.
    """

    name: str
    controller: Controller
    pick_point: str = "corrected"
    assignment: str = "li"
    guard: bool = True
    looks: int = 1
    unload_full: bool = False
    detector: str = "li2016"


@dataclass(frozen=True, eq=False)
class Round:
    """One image and the picks it led to.

    Attributes:
        zone: The zone.
        begin: Start of the picking on the tree's clock, s.
        master: Master joints while picking, (3,).
        fruit: Tree numbers of the fruit attempted, in the order of the timetable; -1 where none hung.
        work: The scheduling problem.
        times: When each pick happened.
        aimed: Slave joints of each pick, nominal, (picks, 3).
        outcome: What became of each.
        closest: Least distance between the centre lines of two arms, m; infinite for one arm.
        skipped: Tree numbers of fruit located but out of every arm's reach.
    """

    zone: Zone
    begin: float
    master: Array
    fruit: NDArray[np.int64]
    work: Work
    times: Timetable
    aimed: Array
    outcome: Outcome
    closest: float
    skipped: tuple[int, ...]


@dataclass(eq=False)
class _TreeSight:
    """What lasts from picture to picture of a tree: its leaves, or what chance decides; draws of its own."""

    rng: np.random.Generator
    leaves: Leaves | None
    chances: Chances | None = None


@dataclass(eq=False)
class Harvest:
    """A tree being worked, and in the end what was done; stages are per fruit, (n,).

    Attributes:
        tree: The tree.
        seen: Fruit of which an image showed anything.
        located: Fruit whose place was found in one.
        reachable: Fruit that an arm could reach from a pick point.
        attempted: Fruit that a cup went to.
        attached: Fruit that was in a cup.
        detached: Fruit whose stalk was cut.
        collected: Fruit in a tube, undamaged.
        by_arm: Arm of the last attempt, or -1.
        rounds: What was done.
        seconds: Clock of the tree.
        phases: Seconds by phase: move, image, pick, unload.
        repicks: Attempts at fruit that was missed before.
        misled: Attempts where no fruit hung.
    """

    tree: Tree
    rng: np.random.Generator
    sight: _TreeSight
    seen: Flags
    located: Flags
    reachable: Flags
    attempted: Flags
    attached: Flags
    detached: Flags
    collected: Flags
    by_arm: NDArray[np.int64]
    load: NDArray[np.int64]
    master: Array
    rounds: list[Round] = field(default_factory=list)
    seconds: float = 0.0
    phases: dict[str, float] = field(default_factory=lambda: dict.fromkeys(("move", "image", "pick", "unload"), 0.0))
    repicks: int = 0
    misled: int = 0

    def spend(self, phase: str, seconds: float) -> None:
        """Let the clock run."""
        self.seconds += seconds
        self.phases[phase] += seconds


@dataclass(frozen=True, eq=False)
class _Task:
    """Picks planned for one tree's round."""

    zone: Zone
    master: Array
    numbers: NDArray[np.int64]
    believed: Array
    work: Work
    times: Timetable
    skipped: tuple[int, ...]


def harvest(
    true: TrueMachine,
    strategy: Strategy,
    model: Picking,
    trees: Sequence[Tree],
    rngs: Sequence[np.random.Generator],
    grid: Grid,
    eyes: Eyes,
) -> list[Harvest]:
    """Work trees from the first zone to the last.

    Args:
        true: The machine as built; the controller knows only what the strategy says.
        strategy: How.
        model: What becomes of attempts.
        trees: The trees.
        rngs: One generator per tree.
        grid: How each side is cut into zones.
        eyes: How fruit is seen.

    Raises:
        InputError: If the numbers of trees and generators differ.
    """
    if len(trees) != len(rngs):
        raise InputError(f"{len(trees)} trees came with {len(rngs)} generators; give one each")
    machine = true.machine
    states = [_begin(machine, eyes, tree, rng) for tree, rng in zip(trees, rngs, strict=True)]
    sides = [cut(grid, *tree.side) for tree in trees]
    for number in range(grid.columns * grid.rows):
        waiting = list(range(len(states)))
        for look in range(strategy.looks):
            tasks = [(i, _plan(machine, strategy, eyes, states[i], sides[i][number], look)) for i in waiting]
            done = [(i, task) for i, task in tasks if task is not None]
            waiting = [i for i, empty in _execute(true, strategy, model, states, done) if empty]
        if not strategy.unload_full:
            for state in states:
                _unload(machine, state)
    for state in states:
        _unload(machine, state)
    return states


def _begin(machine: Machine, eyes: Eyes, tree: Tree, rng: np.random.Generator) -> Harvest:
    stages = ("seen", "located", "reachable", "attempted", "attached", "detached", "collected")
    none: dict[str, Any] = {stage: np.zeros(len(tree), dtype=bool) for stage in stages}
    load, start = np.zeros(machine.arms, dtype=np.int64), machine.master_start.copy()
    looking = rng.spawn(1)[0]  # so that the same luck befalls a tree however it is seen
    sight = _TreeSight(looking, tree_leaves(machine, eyes, looking))
    return Harvest(tree, rng, sight, **none, by_arm=np.full(len(tree), -1), load=load, master=start)


def _plan(machine: Machine, strategy: Strategy, eyes: Eyes, state: Harvest, zone: Zone, look: int) -> _Task | None:
    """Image, pick point and plan of a zone; None where the image shows nothing to pick."""
    state.spend("image", machine.cycle.image)
    numbers, believed = _seen_in(eyes, state, zone, look)
    if not numbers.size:
        return None
    point = pick_point(machine, believed, strategy.pick_point)
    master = np.clip(point.master, machine.master.nominal.lower, machine.master.nominal.upper)
    work = zone_work(machine, master, believed)
    can, fruit = work.reachable, numbers >= 0
    state.reachable[numbers[can & fruit]] = True
    skipped = tuple(numbers[~can & fruit].tolist())
    if not can.any():
        return None
    state.spend("move", float(master_time(machine, state.master, master)))
    state.master = master
    plan = assign(work, strategy.assignment, state.rng)
    times = timetable(work, plan, hold=ultrasonic_hold(machine, work, state.rng) if strategy.guard else None)
    return _Task(zone, master, numbers, believed, work, times, skipped)


def _seen_in(eyes: Eyes, state: Harvest, zone: Zone, look: int) -> tuple[NDArray[np.int64], Array]:
    """Tree numbers (m,) of what an image finds in a zone, -1 where no fruit is, and where it is believed, (m, 3)."""
    tree, sight = state.tree, state.sight
    hanging = np.flatnonzero(~state.detached)
    chances = None
    if eyes.errors is not None:
        if look == 0 or sight.chances is None:
            chances = sight.chances = draw_chances(sight.rng, len(tree))
        else:
            chances = next_picture(eyes.errors, sight.chances, sight.rng)
        chances = Chances(chances.place[hanging], chances.normal[hanging])
    fruit, diameters = tree.fruit[hanging], tree.diameters[hanging]
    seen = see(eyes, zone.view, fruit, diameters, sight.rng, leaves=sight.leaves, chances=chances)
    wanted = seen.located & zone.holds(seen.believed)
    state.seen[hanging[seen.in_sight & (zone.holds(fruit) | wanted)]] = True
    state.located[hanging[wanted]] = True
    phantoms = seen.false[zone.holds(seen.false)]
    numbers = np.concatenate([hanging[wanted], np.full(len(phantoms), -1)]).astype(np.int64)
    return numbers, np.concatenate([seen.believed[wanted], phantoms])


def _execute(
    true: TrueMachine, strategy: Strategy, model: Picking, states: list[Harvest], tasks: list[tuple[int, _Task]]
) -> list[tuple[int, bool]]:
    """Let the true machine do the planned picks of all trees; says of each whether a cup came back empty."""
    if not tasks:
        return []
    counts = [len(task.times.fruit) for _, task in tasks]
    arm = np.concatenate([task.times.arm for _, task in tasks])
    target = np.concatenate([task.believed[task.times.fruit] for _, task in tasks])
    master = np.repeat(strategy.controller.master_command(np.array([task.master for _, task in tasks])), counts, axis=0)
    commands = strategy.controller.pick_commands(master, arm, target)
    tips = true.picking_tips(master, arm, commands)
    parts = np.split(tips, np.cumsum(counts[:-1]))
    return [
        (i, _record(true, strategy, model, states[i], task, part)) for (i, task), part in zip(tasks, parts, strict=True)
    ]


def _record(true: TrueMachine, strategy: Strategy, model: Picking, state: Harvest, task: _Task, tips: Array) -> bool:
    """Outcomes of one tree's round, its time, and the arms' least distance; whether a cup came back empty."""
    machine, rng = true.machine, state.rng
    arm, local = task.times.arm, task.times.fruit
    numbers = task.numbers[local]
    tips = tips + rng.normal(size=(len(arm), 2, 3)).sum(axis=1) * true.repeatability
    outcome = _outcome(model, state, numbers, tips, task.times.start + task.work.out[arm, local])
    there = numbers >= 0
    fruit = numbers[there]
    state.repicks += int(state.attempted[fruit].sum())
    state.misled += int((~there).sum())
    state.attempted[fruit] = True
    state.attached[fruit] |= outcome.attached[there]
    state.detached[fruit] = outcome.detached[there]  # only what hangs is picked
    state.collected[fruit] = outcome.collected[there]
    state.by_arm[fruit] = arm[there]
    np.add.at(state.load, arm[outcome.collected], 1)
    closest, aimed = closest_approach(machine, task.work, task.times), task.work.joints[arm, local]
    done = task.zone, state.seconds, task.master, numbers, task.work, task.times, aimed, outcome, closest, task.skipped
    state.rounds.append(Round(*done))
    state.spend("pick", task.times.makespan)
    if strategy.unload_full and state.load.max() >= machine.cycle.tube_fruit:
        _unload(machine, state)
    return bool((~outcome.detached).any())


def _outcome(model: Picking, state: Harvest, numbers: NDArray[np.int64], tips: Array, entry: Array) -> Outcome:
    """What becomes of cups that go to ``tips`` (picks, 3) at times ``entry``, in the order given.

    A cup that was sent where no fruit is comes back empty, but pushes the foliage all the same.
    """
    tree, luck = state.tree, draw_luck(state.rng, len(numbers))
    order = np.argsort(entry, kind="stable")
    there = numbers >= 0
    places = np.where(there[:, None], tree.fruit[numbers], tips) if len(tree) else tips
    masses = np.where(there, tree.masses[numbers], tree.masses.mean()) if len(tree) else np.ones(len(numbers))
    moved = displacements(model, places[order], masses[order], entry[order], luck)
    real = np.flatnonzero(there[order])
    mine = order[real]
    hanging = ~state.detached
    hanging[numbers[mine]] = False
    chosen = Luck(*(values[real] for values in luck))
    diameters = tree.diameters[numbers[mine]]
    done = attempt(model, tips[mine], places[mine], moved[real], diameters, tree.fruit[hanging], chosen)
    empty = Outcome(
        lateral=np.full(len(numbers), np.inf),
        displaced=np.linalg.norm(moved, axis=-1)[np.argsort(order)],
        **{name: np.zeros(len(numbers), dtype=bool) for name in ("attached", "detached", "collected", "crowded")},
    )
    for mine_too, values in zip(leaves(empty), leaves(done), strict=True):
        mine_too[mine] = values
    return empty


def _unload(machine: Machine, state: Harvest) -> None:
    """Take the fruit to the start pose and open the lids, if there is any."""
    if not state.load.any():
        return
    state.spend("move", float(master_time(machine, state.master, machine.master_start)))
    state.spend("unload", machine.cycle.unload)
    state.master = machine.master_start.copy()
    state.load[:] = 0
