"""The harvester at work in one zone, many machines at once: what Gymnasium's and PettingZoo's environments stand on.

Leading axis: machines. Every machine draws from a generator of its own. Units: m, rad, s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.envs.shared.task import check_number
from pickenv.errors import InputError
from pickenv.harvester.interference import arm_distances
from pickenv.harvester.machine import Machine, load_machine
from pickenv.harvester.pick_point import pick_point
from pickenv.harvester.picking import Picking, in_the_way, load_picking
from pickenv.harvester.true_machine import TrueMachine, load_true_machine
from pickenv.orchard import load_canopy, load_fruit_size

PERIOD = 0.1
"""Control period, s."""
ZONE = (0.7, 0.4, 0.55)
"""Width, depth and height of the zone, m: as in Li's lab."""
SENSOR = 0.015
"""Height within which the position sensor finds a fruit fully in the cup, m."""
REARM = 0.05
"""A cup that tried a fruit tries again only after going this far away from it, m."""
SPAN = 2.0
"""Largest offset that an observation shows, m."""

HANGING, COLLECTED, LOST = 0, 1, 2

Flags = NDArray[np.bool_]
Compensate = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class HarvestTask:
    """What stays the same over episodes.

    Attributes:
        machine: The machine as drawn.
        true: The machine as built.
        model: What becomes of attempts.
        fruit: Fruit in a zone.
    """

    machine: Machine
    true: TrueMachine
    model: Picking
    fruit: int

    @cached_property
    def increment(self) -> Array:
        """Largest increment of each joint in one period."""
        return self.machine.speed * PERIOD

    @cached_property
    def lead(self) -> int:
        """Periods that sensing and cutting take."""
        return int(np.ceil((self.machine.cycle.sense + self.machine.cycle.cut) / PERIOD - 1e-9))

    @property
    def observation_size(self) -> int:
        """Length of an observation."""
        return self.machine.joints + self.machine.arms + 4 * self.fruit


def make_task(
    slaves: int | None = None, spacing_mm: float | None = None, fruit: int = 8, ideal: bool = False
) -> HarvestTask:
    """Check the arguments of an environment and read its files.

    Raises:
        InputError: If one of them is impossible.
    """
    if isinstance(fruit, bool) or not isinstance(fruit, int) or not 1 <= fruit <= 40:
        raise InputError(f"a zone of {fruit} fruit is impossible; give a whole number from 1 to 40")
    if spacing_mm is not None:
        check_number("spacing_mm", spacing_mm, positive=True)
    machine = load_machine(slaves=slaves, spacing=None if spacing_mm is None else spacing_mm * 1e-3)
    true = load_true_machine(machine)
    if ideal:
        true = true.ideal()
    return HarvestTask(machine, true, load_picking(), fruit)


@dataclass(eq=False)
class HarvestState:
    """Many machines in the middle of their zones; leading axis (machines,).

    Attributes:
        joints: Nominal joint targets, (machines, joints).
        fruit: True fruit, (machines, fruit, 3).
        believed: Fruit as the camera saw it.
        reachable: Fruit that some arm reaches from the pick point.
        status: `HANGING`, `COLLECTED` or `LOST`.
        busy: Periods that each arm still senses and cuts, (machines, arms).
        tried: Fruit that each arm tried last and has not left yet, or -1.
        periods: Periods since the start.
        held: Arms that the guard held in the last period.
        closest: Least distance between two arms' centre lines so far, m.
        attempts: Attempts so far.
    """

    joints: Array
    fruit: Array
    believed: Array
    reachable: Flags
    status: NDArray[np.int64]
    busy: NDArray[np.int64]
    tried: NDArray[np.int64]
    periods: NDArray[np.int64]
    held: NDArray[np.int64]
    closest: Array
    attempts: NDArray[np.int64]

    def put(self, rows: NDArray[np.intp], other: HarvestState) -> None:
        """Overwrite some machines."""
        for name in self.__dataclass_fields__:
            getattr(self, name)[rows] = getattr(other, name)


def begin(task: HarvestTask, rngs: Sequence[np.random.Generator]) -> HarvestState:
    """Draw a zone for each generator; the master stands at its pick point, the slaves rest."""
    machine, n = task.machine, len(rngs)
    canopy, wanted = load_canopy("li2016"), task.fruit
    low = canopy.bottom - machine.base_height
    high = canopy.top - machine.base_height - ZONE[2]
    fruit, believed = np.empty((2, n, wanted, 3))
    joints = np.empty((n, machine.joints))
    for i, rng in enumerate(rngs):
        x = rng.uniform(-0.5, 0.5) * (canopy.width - ZONE[0])
        corner = np.array([x - ZONE[0] / 2, -canopy.standoff - canopy.depth, rng.uniform(low, high)])
        fruit[i] = corner + np.array(ZONE) * rng.random((wanted, 3))
        believed[i] = fruit[i] + rng.normal(size=(wanted, 3)) * np.array(task.model.localisation)
        master = pick_point(machine, believed[i]).master
        joints[i] = np.concatenate([master, *[machine.slave_home] * machine.arms])
    return HarvestState(
        joints=joints,
        fruit=fruit,
        believed=believed,
        reachable=np.asarray(machine.reach(joints[:, :3], believed).any(axis=1)),
        status=np.zeros((n, wanted), dtype=np.int64),
        busy=np.zeros((n, machine.arms), dtype=np.int64),
        tried=np.full((n, machine.arms), -1),
        periods=np.zeros(n, dtype=np.int64),
        held=np.zeros(n, dtype=np.int64),
        closest=distances(machine, joints),
        attempts=np.zeros(n, dtype=np.int64),
    )


def distances(machine: Machine, joints: Array) -> Array:
    """Least distance between the centre lines of two arms, (machines,); one arm alone is 2 m clear."""
    if machine.arms < 2:
        return np.full(len(joints), SPAN)
    return np.asarray(arm_distances(machine, joints[:, 3:].reshape(len(joints), machine.arms, 3)).min(axis=-1))


def step(
    task: HarvestTask,
    state: HarvestState,
    actions: Array,
    rngs: Sequence[np.random.Generator],
    compensator: Compensate | None = None,
) -> Array:
    """Let one period pass; changes ``state`` and gives the rewards, (machines,).

    Args:
        task: What stays the same.
        state: Changed in place.
        actions: Joint increments as shares of the largest, (machines, joints).
        rngs: One per machine; a machine draws five numbers for each of its attempts.
        compensator: Maps nominal joints of whole machines to commands.
    """
    machine = task.machine
    before = _work_left(task, state)
    wanted = np.clip(actions, -1.0, 1.0) * task.increment
    arms_free = (state.busy == 0).repeat(3, axis=1)
    wanted[:, 3:] *= arms_free
    wanted[:, :3] *= (state.busy == 0).all(axis=1)[:, None]  # the master stands while a blade cuts
    target = np.clip(state.joints + wanted, machine.lower, machine.upper)
    state.held = _guard(machine, state.joints, target)
    state.joints = target
    state.busy = np.maximum(state.busy - 1, 0)
    state.closest = np.minimum(state.closest, distances(machine, target))
    state.periods = state.periods + 1
    commands = target if compensator is None else compensator(target)
    tips = task.true.tips(commands[:, :3], commands[:, 3:].reshape(len(target), machine.arms, 3))
    collected, lost = _attempts(task, state, tips, rngs)
    progress = before - _work_left(task, state)
    effort = np.abs(np.clip(actions, -1.0, 1.0)).mean(axis=1)
    return np.asarray(collected - lost + progress - 0.05 * state.held - 0.005 - 0.005 * effort)


def _guard(machine: Machine, start: Array, target: Array) -> NDArray[np.int64]:
    """Hold every arm whose move would bring it too near another; changes ``target``, counts held arms."""
    n, arms = len(start), machine.arms
    held = np.zeros((n, arms), dtype=bool)
    if arms < 2:
        return np.asarray(held.sum(axis=1))
    i, j = np.triu_indices(arms, 1)
    old, new = start[:, 3:].reshape(n, arms, 3), target[:, 3:].reshape(n, arms, 3).copy()
    for _ in range(arms):
        near = np.full((n, len(i)), np.inf)
        for share in (0.5, 1.0):
            near = np.minimum(near, arm_distances(machine, old + share * (new - old)))
        bad = near < machine.body.clearance
        if not bad.any():
            break
        for pair, (a, b) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
            held[:, a] |= bad[:, pair]
            held[:, b] |= bad[:, pair]
        new = np.where(held[..., None], old, new)
    target[:, 3:] = new.reshape(n, -1)
    return np.asarray(held.sum(axis=1))


def _attempts(
    task: HarvestTask, state: HarvestState, tips: Array, rngs: Sequence[np.random.Generator]
) -> tuple[Array, Array]:
    """Cups whose sensor finds a fruit close their blade; counts fruit collected and lost by each machine."""
    model = task.model
    offset = state.fruit[:, None] - tips[:, :, None]  # (machines, arms, fruit, 3)
    lateral = np.hypot(offset[..., 0], offset[..., 1])
    last = np.maximum(state.tried, 0)
    away = np.linalg.norm(np.take_along_axis(offset, last[:, :, None, None], axis=2)[:, :, 0], axis=-1)
    state.tried = np.where(away > REARM, -1, state.tried)
    free = (state.busy == 0) & (state.tried < 0)
    inside = (lateral < model.outer) & (np.abs(offset[..., 2]) < SENSOR)
    inside &= (state.status == HANGING)[:, None, :] & free[:, :, None]
    collected, lost = np.zeros((2, len(tips)))
    for machine, arm in np.argwhere(inside.any(axis=-1)).tolist():
        hanging = state.status[machine] == HANGING
        near = np.where(inside[machine, arm] & hanging, lateral[machine, arm], np.inf)
        fruit = int(near.argmin())
        if not np.isfinite(near[fruit]):
            continue  # another arm has just taken it
        draws = rngs[machine].random(5)
        rest = hanging & (np.arange(task.fruit) != fruit)
        diameter = load_fruit_size("li2016").mean
        crowded = in_the_way(model, state.fruit[machine, fruit], diameter, state.fruit[machine, rest]).any()
        clearance = (model.cup.opening - diameter) / 2
        taken = np.clip(1.0 - (near[fruit] - clearance) / model.gather, 0.0, 1.0)
        taken *= model.cluster_success if crowded else 1.0
        state.attempts[machine] += 1
        state.tried[machine, arm] = fruit
        state.busy[machine, arm] = task.lead
        if draws[0] < taken * model.cut_success:
            whole = draws[1] < model.undamaged
            state.status[machine, fruit] = COLLECTED if whole else LOST
            collected[machine] += whole
            lost[machine] += not whole
        turn = 2 * np.pi * draws[2]
        push = model.lasting * model.push * np.exp(model.push_spread * (2 * draws[3] - 1))
        distance = np.linalg.norm(state.fruit[machine] - state.fruit[machine, fruit], axis=-1)
        share = np.exp(-distance / model.branch.coupling) * (state.status[machine] == HANGING)
        shift = push * share[:, None] * np.array([np.cos(turn), np.sin(turn), 0.0])
        state.fruit[machine] = state.fruit[machine] + shift
        state.believed[machine, fruit] = state.fruit[machine, fruit]  # an empty cup looks again
    return collected, lost


def _work_left(task: HarvestTask, state: HarvestState) -> Array:
    """Mean distance from reachable hanging fruit to the nearest believed cup, m; what shaping is made of."""
    tips = task.machine.tips(state.joints[:, :3], state.joints[:, 3:].reshape(len(state.joints), -1, 3))
    distance = np.linalg.norm(state.believed[:, None] - tips[:, :, None], axis=-1).min(axis=1)
    return np.asarray((distance * pickable(state)).mean(axis=-1))


def pickable(state: HarvestState) -> Flags:
    """Fruit that hangs and that an arm reaches from the pick point, (machines, fruit)."""
    return np.asarray((state.status == HANGING) & state.reachable)


def finished(state: HarvestState) -> Flags:
    """Machines with nothing left to pick and no blade at work."""
    return np.asarray(~pickable(state).any(axis=1) & (state.busy == 0).all(axis=1))


def observe(task: HarvestTask, state: HarvestState) -> NDArray[np.float32]:
    """What the controller knows, (machines, observation_size)."""
    machine = task.machine
    scaled = 2 * (state.joints - machine.lower) / (machine.upper - machine.lower) - 1
    heading = state.joints[:, 0]
    away = state.believed - machine.frame3(state.joints[:, :3])[:, None]
    sin, cos = np.sin(heading)[:, None], np.cos(heading)[:, None]
    right = away[..., 0] * sin - away[..., 1] * cos
    ahead = away[..., 0] * cos + away[..., 1] * sin
    shown = pickable(state)[..., None]
    local = np.stack([right, ahead, away[..., 2]], axis=-1) * shown
    parts = [scaled, state.busy / task.lead, np.concatenate([local, shown], axis=-1).reshape(len(scaled), -1)]
    low, high = bounds(task)
    return np.asarray(np.clip(np.concatenate(parts, axis=1), low, high), dtype=np.float32)


def bounds(task: HarvestTask) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smallest and largest observation."""
    joints, arms = task.machine.joints, task.machine.arms
    slot = [SPAN, SPAN, SPAN, 1.0]
    high = np.array([1.0] * joints + [1.0] * arms + slot * task.fruit, dtype=np.float32)
    low = np.array([-1.0] * joints + [0.0] * arms + [-SPAN, -SPAN, -SPAN, 0.0] * task.fruit, dtype=np.float32)
    return low, high


def information(state: HarvestState) -> dict[str, NDArray[np.generic]]:
    """The truth about each machine; the same keys always."""
    collected = (state.status == COLLECTED).sum(axis=1)
    done = (state.status == COLLECTED) | ~state.reachable
    hours = np.maximum(state.periods, 1) * PERIOD / 3600
    return {
        "collected": collected,
        "lost": (state.status == LOST).sum(axis=1),
        "reachable": state.reachable.sum(axis=1),
        "attempts": state.attempts.copy(),
        "held": state.held.copy(),
        "closest_mm": state.closest * 1e3,
        "picks_per_hour": collected / hours,
        "is_success": done.all(axis=1),
    }
