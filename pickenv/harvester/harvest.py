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
from pickenv.arm.plant.tree import tree_map
from pickenv.errors import InputError
from pickenv.harvester.assignment import assign
from pickenv.harvester.interference import arm_distances
from pickenv.harvester.joint_motion import master_time, profile, travel_time
from pickenv.harvester.machine import Machine
from pickenv.harvester.pick_point import pick_point
from pickenv.harvester.picking import Outcome, Picking, attempt, displacements, draw_luck
from pickenv.harvester.trees import Tree
from pickenv.harvester.true_machine import Controller, TrueMachine
from pickenv.harvester.work import Timetable, Work, timetable, zone_work
from pickenv.harvester.zones import Grid, Zone, cut

Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Strategy:
    """How a machine works a tree.

    Attributes:
        name: As reports print it.
        controller: What is known of the true machine.
        pick_point: Method of `pick_point.pick_point`.
        assignment: Method of `assignment.assign`.
        guard: Whether side arms hold by Li's ultrasonic rule.
        looks: Images a zone may have: after the first, one more each time a cup came back empty.
        unload_full: Whether tubes are emptied only when one is full and at the end, rather than after each zone.
    """

    name: str
    controller: Controller
    pick_point: str = "corrected"
    assignment: str = "li"
    guard: bool = True
    looks: int = 1
    unload_full: bool = False


@dataclass(frozen=True, eq=False)
class Round:
    """One image and the picks it led to.

    Attributes:
        zone: The zone.
        begin: Start of the picking on the tree's clock, s.
        master: Master joints while picking, (3,).
        fruit: Tree numbers of the fruit attempted, in the order of the timetable.
        work: The scheduling problem.
        times: When each pick happened.
        aimed: Slave joints of each pick, nominal, (picks, 3).
        outcome: What became of each.
        closest: Least distance between the centre lines of two arms, m; infinite for one arm.
        skipped: Tree numbers of fruit seen but out of every arm's reach.
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
class Harvest:
    """A tree being worked, and in the end what was done; stages are per fruit, (n,).

    Attributes:
        tree: The tree.
        seen: Fruit that an image showed.
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
    """

    tree: Tree
    rng: np.random.Generator
    seen: Flags
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
) -> list[Harvest]:
    """Work trees from the first zone to the last.

    Args:
        true: The machine as built; the controller knows only what the strategy says.
        strategy: How.
        model: What becomes of attempts.
        trees: The trees.
        rngs: One generator per tree.
        grid: How each side is cut into zones.

    Raises:
        InputError: If the numbers of trees and generators differ.
    """
    if len(trees) != len(rngs):
        raise InputError(f"{len(trees)} trees came with {len(rngs)} generators; give one each")
    machine = true.machine
    states = [_begin(machine, tree, rng) for tree, rng in zip(trees, rngs, strict=True)]
    sides = [cut(grid, *tree.side) for tree in trees]
    for number in range(grid.columns * grid.rows):
        waiting = list(range(len(states)))
        for look in range(strategy.looks):
            tasks = [(i, _plan(machine, strategy, model, states[i], sides[i][number], look)) for i in waiting]
            done = [(i, task) for i, task in tasks if task is not None]
            waiting = [i for i, empty in _execute(true, strategy, model, states, done) if empty]
        if not strategy.unload_full:
            for state in states:
                _unload(machine, state)
    for state in states:
        _unload(machine, state)
    return states


def _begin(machine: Machine, tree: Tree, rng: np.random.Generator) -> Harvest:
    stages = ("seen", "reachable", "attempted", "attached", "detached", "collected")
    none: dict[str, Any] = {stage: np.zeros(len(tree), dtype=bool) for stage in stages}
    load, start = np.zeros(machine.arms, dtype=np.int64), machine.master_start.copy()
    return Harvest(tree, rng, **none, by_arm=np.full(len(tree), -1), load=load, master=start)


def _plan(machine: Machine, strategy: Strategy, model: Picking, state: Harvest, zone: Zone, look: int) -> _Task | None:
    """Image, pick point and plan of a zone; None where the image shows nothing to pick."""
    tree, rng = state.tree, state.rng
    n = len(tree)
    found, blur = rng.random(n) < model.visibility, rng.normal(size=(n, 3)) * np.array(model.localisation)
    inside = zone.holds(tree.fruit) & ~state.detached
    if not inside.any():
        if look == 0:
            state.spend("image", machine.cycle.image)
        return None
    state.spend("image", machine.cycle.image)
    visible = np.flatnonzero(inside & found)
    state.seen[visible] = True
    if not visible.size:
        return None
    believed = tree.fruit[visible] + blur[visible]
    point = pick_point(machine, believed, strategy.pick_point)
    master = np.clip(point.master, machine.master.nominal.lower, machine.master.nominal.upper)
    work = zone_work(machine, master, believed)
    can = work.reachable
    state.reachable[visible[can]] = True
    skipped = tuple(visible[~can].tolist())
    if not can.any():
        return None
    state.spend("move", float(master_time(machine, state.master, master)))
    state.master = master
    times = timetable(work, assign(work, strategy.assignment, rng), guard=strategy.guard)
    return _Task(zone, master, visible, believed, work, times, skipped)


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
    """Outcomes of one tree's round, its time, and the arms' least distance."""
    machine, tree, rng = true.machine, state.tree, state.rng
    arm, local = task.times.arm, task.times.fruit
    numbers = task.numbers[local]
    tips = tips + rng.normal(size=(len(arm), 2, 3)).sum(axis=1) * true.repeatability
    entry = task.times.start + task.work.out[arm, local]
    order = np.argsort(entry, kind="stable")
    hanging = ~state.detached
    hanging[numbers] = False
    fruit, diameters, masses = tree.fruit[numbers], tree.diameters[numbers], tree.masses[numbers]
    luck = draw_luck(rng, len(order))
    moved = displacements(model, fruit[order], masses[order], entry[order], luck)
    done = attempt(model, tips[order], fruit[order], moved, diameters[order], tree.fruit[hanging], luck)
    back = np.argsort(order)
    outcome: Outcome = tree_map(lambda values: values[back], done)
    aimed = task.work.joints[arm, local]
    state.repicks += int(state.attempted[numbers].sum())
    state.attempted[numbers] = True
    state.attached[numbers] |= outcome.attached
    state.detached[numbers] |= outcome.detached
    state.collected[numbers] |= outcome.collected
    state.by_arm[numbers] = arm
    np.add.at(state.load, arm[outcome.collected], 1)
    closest = closest_approach(machine, task.work, task.times)
    state.rounds.append(
        Round(
            task.zone, state.seconds, task.master, numbers, task.work, task.times, aimed, outcome, closest, task.skipped
        )
    )
    state.spend("pick", task.times.makespan)
    if strategy.unload_full and state.load.max() >= machine.cycle.tube_fruit:
        _unload(machine, state)
    return bool((~outcome.detached).any())


def _unload(machine: Machine, state: Harvest) -> None:
    """Take the fruit to the start pose and open the lids, if there is any."""
    if not state.load.any():
        return
    state.spend("move", float(master_time(machine, state.master, machine.master_start)))
    state.spend("unload", machine.cycle.unload)
    state.master = machine.master_start.copy()
    state.load[:] = 0


def slave_joints_at(machine: Machine, work: Work, times: Timetable, at: Array) -> Array:
    """Nominal slave joints (times, arms, 3) at times ``at`` of a timetable: trapezoidal moves, phase by phase."""
    joints = np.broadcast_to(machine.slave_home, (len(at), machine.arms, 3)).copy()
    speed, acceleration = machine.slaves[0].speed, machine.slave_acceleration
    fixed = machine.cycle.sense + machine.cycle.cut
    for a in range(machine.arms):
        mine = np.flatnonzero(times.arm == a)
        height, free = float(machine.slave_home[0]), 0.0
        for pick in mine[np.argsort(times.start[mine], kind="stable")].tolist():
            goal = work.joints[a, times.fruit[pick]]
            below = float(goal[0] - work.approach[times.fruit[pick]])
            on = at >= free
            joints[on, a, 0] = height + profile(at[on] - free, below - height, speed[0], acceleration[0])
            moves = goal[1:] - machine.slave_home[1:]
            stretch = float(travel_time(moves, speed[1:], acceleration[1:]).max())
            begin, end = float(times.start[pick]), float(times.end[pick])
            on = at >= begin
            share = _share(at[on] - begin, moves, speed[1:], acceleration[1:], stretch)
            joints[on, a, 1:] = machine.slave_home[1:] + share[:, None] * moves
            on = at >= begin + stretch
            joints[on, a, 0] = below + profile(at[on] - begin - stretch, goal[0] - below, speed[0], acceleration[0])
            back = end - stretch
            assert back >= begin + stretch + fixed - 1e-9
            on = at >= back
            share = _share(at[on] - back, moves, speed[1:], acceleration[1:], stretch)
            joints[on, a, 1:] = machine.slave_home[1:] + (1 - share[:, None]) * moves
            height, free = float(goal[0]), end
    return joints


def _share(time: Array, moves: Array, speed: Array, acceleration: Array, total: float) -> Array:
    """Share of a joint move done after ``time``: the joint that takes longest leads, the other keeps step."""
    if total <= 0:
        return np.ones_like(time)
    lead = int(np.argmax(travel_time(moves, speed, acceleration)))
    return np.asarray(profile(time, 1.0, speed[lead] / abs(moves[lead]), acceleration[lead] / abs(moves[lead])))


def closest_approach(machine: Machine, work: Work, times: Timetable, step: float = 0.1) -> float:
    """Least distance between the centre lines of two arms over a timetable, sampled every ``step`` seconds, m."""
    if machine.arms < 2 or not len(times.arm):
        return float("inf")
    at = np.arange(0.0, times.makespan + step, step)
    return float(arm_distances(machine, slave_joints_at(machine, work, times, at)).min())
