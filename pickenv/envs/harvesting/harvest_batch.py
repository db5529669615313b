"""The harvester at work in one zone, many machines at once: what Gymnasium's and PettingZoo's environments stand on.

Leading axis: machines. Every machine draws from a generator of its own. Units: m, rad, s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.arm.plant.tree import leaves
from pickenv.base import InputError
from pickenv.envs.harvesting.harvest_task import HarvestTask, drawn_zone
from pickenv.envs.shared.backends import Flags
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.envs.shared.task import Compensate
from pickenv.harvester import pick_point
from pickenv.harvester.interference import arm_distances, pairs_of
from pickenv.harvester.picking import attempt, draw_luck, pushes
from pickenv.orchard import fruit_masses, swing

HANGING, COLLECTED, LOST = 0, 1, 2

HALF_AND_WHOLE = np.array([0.5, 1.0]).reshape(2, 1, 1, 1)
"""Shares of a move at which arms must be clear of each other."""


@dataclass(eq=False)
class HarvestState:
    """Many machines in the middle of their zones; leading axis (machines,).

    Attributes:
        joints: Nominal joint targets, (machines, joints).
        fruit: True fruit where it hung at first, (machines, fruit, 3).
        shift: How far pushes have moved it for good, m.
        swing: How far it swings from there, m.
        velocity: How fast, m/s.
        diameters: m, (machines, fruit).
        masses: kg.
        believed: Fruit as the camera saw it, (machines, fruit, 3).
        error: How far off that was, m.
        located: Fruit that the camera found.
        reachable: Located fruit that some arm reaches from the pick point.
        status: `HANGING`, `COLLECTED` or `LOST`.
        busy: Periods that each arm still senses and cuts, (machines, arms).
        tried: Fruit that each arm tried last and has not left yet, or -1.
        periods: Periods since the start.
        held: Arms that the guard held in the last period.
        closest: Least distance between two arms' centre lines so far, m.
        attempts: Attempts so far.
        left: `work_left` as it stands, m.
    """

    joints: Array
    fruit: Array
    shift: Array
    swing: Array
    velocity: Array
    diameters: Array
    masses: Array
    believed: Array
    error: Array
    located: Flags
    reachable: Flags
    status: NDArray[np.int64]
    busy: NDArray[np.int64]
    tried: NDArray[np.int64]
    periods: NDArray[np.int64]
    held: NDArray[np.int64]
    closest: Array
    attempts: NDArray[np.int64]
    left: Array

    @property
    def moved(self) -> Array:
        """Displacement of the fruit by pushes, m, (machines, fruit, 3)."""
        return self.shift + self.swing

    def put(self, rows: NDArray[np.intp], other: HarvestState) -> None:
        """Overwrite some machines."""
        for mine, theirs in zip(leaves(self), leaves(other), strict=True):
            mine[rows] = theirs


def begin_zones(
    task: HarvestTask, rngs: Sequence[np.random.Generator], fruit: Array | None = None, joints: Array | None = None
) -> HarvestState:
    """Draw a zone for each generator; the master stands at its pick point, the slaves rest, or as is asked for.

    Args:
        task: What stays the same.
        rngs: One per machine.
        fruit: Positions in place of drawn ones ``(machines, fruit, 3)``, base frame, or None.
        joints: Joints of whole machines to start from ``(machines, joints)``, or None.

    Raises:
        InputError: If the cameras find no fruit in many zones, or arms stand too near each other.
    """
    machine, n = task.machine, len(rngs)
    positions, sightings, zeros = np.zeros((3, n, task.fruit, 3))
    located = np.zeros((n, task.fruit), dtype=bool)
    diameters, start = np.empty((n, task.fruit)), np.empty((n, machine.joints))
    for i, rng in enumerate(rngs):
        positions[i], diameters[i], sight = drawn_zone(task, rng, None if fruit is None else fruit[i])
        sightings[i], located[i] = sight.believed, sight.located
        if joints is not None:
            start[i] = joints[i]
        else:
            master = pick_point(machine, sight.believed[sight.located]).master
            start[i] = np.concatenate([master, *[machine.slave_home] * machine.arms])
    if joints is not None and (distances(task, start) < machine.body.clearance).any():
        raise InputError("option start_joints brings two arms nearer than the guard lets them; move them apart")
    reachable = np.asarray(machine.reach(start[:, :3], sightings).any(axis=1)) & located
    state = HarvestState(
        joints=start,
        fruit=positions,
        shift=zeros,
        swing=zeros.copy(),
        velocity=zeros.copy(),
        diameters=diameters,
        masses=fruit_masses(task.orchard.size, diameters),
        believed=sightings,
        error=sightings - positions,
        located=located,
        reachable=reachable,
        status=np.zeros((n, task.fruit), dtype=np.int64),
        busy=np.zeros((n, machine.arms), dtype=np.int64),
        tried=np.full((n, machine.arms), -1),
        periods=np.zeros(n, dtype=np.int64),
        held=np.zeros(n, dtype=np.int64),
        closest=distances(task, start),
        attempts=np.zeros(n, dtype=np.int64),
        left=np.zeros(n),
    )
    state.left = work_left(task, state)
    return state


def distances(task: HarvestTask, joints: Array) -> Array:
    """Least distance between the centre lines of two arms, (machines,); one arm alone is as clear as can be shown."""
    machine = task.machine
    if machine.arms < 2:
        return np.full(len(joints), task.rules.shown)
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
        rngs: One per machine; a machine draws six numbers for each of its attempts.
        compensator: Maps nominal joints of whole machines to commands.
    """
    machine = task.machine
    before = state.left
    motion = actions * task.increment
    if state.busy.any():
        motion[:, 3:] *= (state.busy == 0).repeat(3, axis=1)
        motion[:, :3] *= (state.busy == 0).all(axis=1)[:, None]  # the master stands while a blade cuts
    target = np.minimum(np.maximum(state.joints + motion, machine.lower), machine.upper)
    state.held, apart = _guard(task, state.joints, target)
    state.joints = target
    state.busy = np.maximum(state.busy - 1, 0)
    state.closest = np.minimum(state.closest, apart)
    state.periods = state.periods + 1
    commands = target if compensator is None else compensator(target)
    tips = task.true.tips(commands[:, :3], commands[:, 3:].reshape(len(target), machine.arms, 3))
    branch, rules = task.model.branch, task.rules
    if state.swing.any() or state.velocity.any():
        state.swing, state.velocity = swing(branch, state.swing, state.velocity, state.masses, CONTROL_PERIOD)
    collected, lost = attempts(task, state, tips, rngs)
    state.left = work_left(task, state)
    progress = before - state.left
    effort = np.abs(actions).mean(axis=1)
    cost = rules.guard_cost * state.held + rules.period_cost + rules.motion_cost * effort
    return np.asarray(collected - lost + progress - cost)


def _guard(task: HarvestTask, start: Array, target: Array) -> tuple[NDArray[np.int64], Array]:
    """Hold every arm whose move would bring it too near another; changes ``target``.

    Returns:
        Arms held, and the least distance between two arms' centre lines afterwards, (machines,) each.
    """
    machine, n = task.machine, len(start)
    arms = machine.arms
    blocked = np.zeros((n, arms), dtype=bool)
    if arms < 2:
        return np.asarray(blocked.sum(axis=1)), distances(task, target)
    i, j = pairs_of(arms)
    old, new = start[:, 3:].reshape(n, arms, 3), target[:, 3:].reshape(n, arms, 3).copy()
    for _ in range(arms + 1):
        between, after = arm_distances(machine, old + HALF_AND_WHOLE * (new - old))
        bad = np.minimum(between, after) < machine.body.clearance
        if bad.any():
            bad &= ~(blocked[:, i] & blocked[:, j])
        if not bad.any():
            break
        for pair, (a, b) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
            blocked[:, a] |= bad[:, pair]
            blocked[:, b] |= bad[:, pair]
        new = np.where(blocked[..., None], old, new)
    target[:, 3:] = new.reshape(n, -1)
    return np.asarray(blocked.sum(axis=1)), np.asarray(after.min(axis=-1))


def attempts(
    task: HarvestTask, state: HarvestState, tips: Array, rngs: Sequence[np.random.Generator]
) -> tuple[Array, Array]:
    """Cups whose sensor finds a fruit close their blade; counts fruit collected and lost by each machine.

    Args:
        task: What stays the same.
        state: Changed in place.
        tips: True cups, (machines, arms, 3).
        rngs: One per machine.
    """
    model, rules = task.model, task.rules
    offset = (state.fruit + state.moved)[:, None] - tips[:, :, None]  # (machines, arms, fruit, 3)
    lateral = np.hypot(offset[..., 0], offset[..., 1])
    if (state.tried >= 0).any():
        last = np.maximum(state.tried, 0)
        away = np.linalg.norm(np.take_along_axis(offset, last[:, :, None, None], axis=2)[:, :, 0], axis=-1)
        state.tried = np.where(away > rules.rearm, -1, state.tried)
    free = (state.busy == 0) & (state.tried < 0)
    inside = (lateral < model.outer) & (np.abs(offset[..., 2]) < rules.sensor)
    collected, lost = np.zeros((2, len(tips)))
    if not inside.any():
        return collected, lost
    inside &= (state.status == HANGING)[:, None, :] & free[:, :, None]
    for machine in np.flatnonzero(inside.any(axis=(1, 2))).tolist():
        arms, some = _nearest(np.where(inside[machine], lateral[machine], np.inf))
        fruit, offsets, diameters = state.fruit[machine], state.moved[machine, some], state.diameters[machine, some]
        others = state.status[machine] == HANGING
        others[some] = False
        luck = draw_luck(rngs[machine], len(some))
        outcome = attempt(model, tips[machine, arms], fruit[some], offsets, diameters, fruit[others], luck)
        became = np.where(outcome.collected, COLLECTED, np.where(outcome.detached, LOST, HANGING))
        state.attempts[machine] += len(some)
        state.tried[machine, arms], state.busy[machine, arms] = some, task.lead
        state.status[machine, some] = became
        collected[machine], lost[machine] = (became == COLLECTED).sum(), (became == LOST).sum()
        push = pushes(model, fruit[some], fruit, luck).sum(axis=0) * (state.status[machine] == HANGING)[:, None]
        state.shift[machine] += model.lasting * push
        state.swing[machine] += (1 - model.lasting) * push
        again = fruit[some] + state.shift[machine, some]  # an empty cup looks again, past the same leaves
        state.believed[machine, some] = again + state.error[machine, some]
    return collected, lost


def _nearest(lateral: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Cups and the fruit that each tries, (picks,): the nearest, but no two the same; (arms, fruit) gives distances."""
    lateral, pairs = lateral.copy(), []
    for arm in range(len(lateral)):
        fruit = int(lateral[arm].argmin())
        if np.isfinite(lateral[arm, fruit]):
            pairs.append((arm, fruit))
            lateral[:, fruit] = np.inf
    arms, some = np.array(pairs, dtype=np.intp).T
    return arms, some


def work_left(task: HarvestTask, state: HarvestState) -> Array:
    """Mean distance from reachable hanging fruit to the nearest believed cup, m; what shaping is made of."""
    tips = task.machine.tips(state.joints[:, :3], state.joints[:, 3:].reshape(len(state.joints), -1, 3))
    away = state.believed[:, None] - tips[:, :, None]
    distance = np.sqrt((away * away).sum(axis=-1)).min(axis=1)
    return np.asarray((distance * pickable(state)).sum(axis=-1) / distance.shape[-1])


def pickable(state: HarvestState) -> Flags:
    """Fruit that hangs and that an arm reaches from the pick point, (machines, fruit)."""
    return np.asarray((state.status == HANGING) & state.reachable)


def finished(state: HarvestState) -> Flags:
    """Machines with nothing left to pick and no blade at work."""
    return np.asarray(~pickable(state).any(axis=1) & (state.busy == 0).all(axis=1))


def observe(task: HarvestTask, state: HarvestState) -> NDArray[np.float32]:
    """Observations of the controllers, (machines, observation_size)."""
    machine = task.machine
    scaled = 2 * (state.joints - machine.lower) / (machine.upper - machine.lower) - 1
    heading = state.joints[:, 0]
    away = state.believed - machine.frame3(state.joints[:, :3])[:, None]
    sin, cos = np.sin(heading)[:, None], np.cos(heading)[:, None]
    right = away[..., 0] * sin - away[..., 1] * cos
    ahead = away[..., 0] * cos + away[..., 1] * sin
    visible = pickable(state)
    fruit = np.empty((*visible.shape, 4))
    fruit[..., 0], fruit[..., 1], fruit[..., 2] = right * visible, ahead * visible, away[..., 2] * visible
    fruit[..., 3] = visible
    parts = [scaled, state.busy / task.lead, fruit.reshape(len(scaled), -1)]
    low, high = task.bounds
    return np.asarray(np.minimum(np.maximum(np.concatenate(parts, axis=1), low), high), dtype=np.float32)


def information(state: HarvestState) -> dict[str, NDArray[np.generic]]:
    """The truth about each machine; the same keys always."""
    collected = (state.status == COLLECTED).sum(axis=1)
    done = (state.status == COLLECTED) | ~state.reachable
    hours = np.maximum(state.periods, 1) * CONTROL_PERIOD / 3600
    return {
        "collected": collected,
        "lost": (state.status == LOST).sum(axis=1),
        "located": state.located.sum(axis=1),
        "reachable": state.reachable.sum(axis=1),
        "attempts": state.attempts.copy(),
        "held": state.held.copy(),
        "closest_mm": state.closest * 1e3,
        "picks_per_hour": collected / hours,
        "is_success": done.all(axis=1),
    }
