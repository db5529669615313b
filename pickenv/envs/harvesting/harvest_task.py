"""The task of the Harvest environment: its constants, its spaces, and functions for many machines. Units: m, rad, s."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, partial
from typing import Annotated, Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from pickenv import harvester
from pickenv.arm import Array, leaves
from pickenv.base import MM, NUMBER, InputError, is_there, read_toml, shown, toml_table
from pickenv.envs.shared.backends import Flags
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.envs.shared.task import (
    MOST_ACTION,
    Compensate,
    as_numbers,
    check_choice,
    check_flag,
    check_number,
    refuse_idle,
)
from pickenv.harvester.harvest_run import attempt, draw_luck, pushes
from pickenv.harvester.pick_points import AHEAD, PICKING_FILE, lab_zone, tree_leaves
from pickenv.harvester.work import arm_distances, pair_distances, pairs_of
from pickenv.orchard import Eyes, Sight, face, fruit_masses, load_eyes, sample_diameters, see, swing

# The zone that a harvester begins with: fruit and how it is seen, drawn or as it is asked for. Units: m, rad.


OPTIONS = ("fruit", "start_joints")
DRAWS = 100


def given_zones(task: HarvestTask, options: Mapping[str, Any], count: int, rows: Any = slice(None)) -> dict[str, Array]:
    """Check the options "fruit" and "start_joints" of `reset`, and return their values as arrays.

    Args:
        task: The task.
        options: The options. The value of an option is for all machines, or has one entry per machine.
        count: Number of machines.
        rows: Indices (from 0) of the machines whose values are returned, by default all.

    Returns:
        A dict of arguments of `begin_zones`: "fruit", positions ``(machines, fruit, 3)``, and "joints" ``(machines,
        joints)``, each only if it is given.

    Raises:
        InputError: If a shape is wrong, a number is not finite, or joints lie outside their limits.
    """
    machine, zones = task.machine, dict[str, Array]()
    for key, name, shape in (("fruit", "fruit", (task.fruit, 3)), ("joints", "start_joints", (machine.joints,))):
        if options.get(name) is None:
            continue
        values = as_numbers(f"option {name}", options[name])
        if values.shape not in (shape, (count, *shape)):
            raise InputError(f"option {name} has shape {values.shape}; give finite numbers of shape {shape}")
        if not np.isfinite(values).all():
            raise InputError(f"option {name} is {shown(values.tolist())}; give finite numbers of shape {shape}")
        zones[key] = np.broadcast_to(values, (count, *shape))[rows]
    joints = zones.get("joints")
    if joints is not None and not np.all((joints >= machine.lower) & (joints <= machine.upper)):
        limits = f"{np.round(machine.lower, 3).tolist()} to {np.round(machine.upper, 3).tolist()}"
        raise InputError(f"option start_joints lies outside the joint limits; give joints (rad, m) from {limits}")
    return zones


def drawn_zone(
    task: HarvestTask, rng: np.random.Generator, given: Array | None = None
) -> tuple[Array, Array, Sight, Array, Flags]:
    """Draw a zone in which the cameras locate some fruit, and in which an arm reaches some of it.

    Args:
        task: The task.
        rng: Random generator.
        given: Positions of the fruit ``(fruit, 3)``, m, base frame, or None to draw them. The cameras look at the
            middle of given fruit.

    Returns:
        Five values. The first has the positions of the fruit ``(fruit, 3)``, m, the second its diameters, m. The third
        says how the cameras see the fruit. The fourth has the master's joints at the pick point ``(3,)``. The fifth has
        flags of the located fruit that some arm reaches from this point.

    Raises:
        InputError: If the cameras find no fruit in reach in `DRAWS` draws.
    """
    machine, canopy = task.machine, task.orchard.canopy
    zone = lab_zone(canopy)
    low, high = canopy.bottom - machine.base_height, canopy.top - machine.base_height - zone[2]
    for _ in range(DRAWS):
        if given is None:
            x = rng.uniform(-0.5, 0.5) * (canopy.width - zone[0])
            corner = np.array([x - zone[0] / 2, -canopy.standoff - canopy.depth, rng.uniform(low, high)])
            fruit, height = corner + zone * rng.random((task.fruit, 3)), corner[2] + zone[2] / 2
            fruit[:, 1] -= face(canopy, fruit[:, 2] + machine.base_height)  # a canopy may lean
        else:
            fruit, x, height = given, given[:, 0].mean(), given[:, 2].mean()
        diameters = sample_diameters(task.orchard.fruit_size, task.fruit, rng)
        view = np.array([x, 0.0, height]), AHEAD
        sight = see(task.eyes, view, fruit, diameters, rng, leaves=tree_leaves(machine, task.eyes, rng))
        if sight.located.any():
            master = harvester.pick_point(machine, sight.believed[sight.located])
            reachable = sight.located & machine.reach(master, sight.believed).any(axis=0)
            if reachable.any():
                return fruit, diameters, sight, master, reachable
    advice = "give more fruit, or vision='ideal'" if given is None else "move the fruit of the option"
    raise InputError(f"the cameras found no fruit in reach in {DRAWS} zones; {advice}")


@toml_table
class Rules:
    """Rules of the task: when a cup tries a fruit, bounds of observations, and costs; see [task] of picking.toml.

    Attributes:
        sensor: Largest height difference at which the position sensor detects a fruit in the cup, m.
        rearm: Distance from the last tried fruit beyond which a cup may try again, m.
        shown: Bound of a fruit's position in observations, m.
        guard_cost: Cost of each arm that the collision guard stops in a period.
        period_cost: Cost of each period.
        motion_cost: Cost of a period in which all joints move at full speed.
    """

    sensor: Annotated[float, MM.positive]
    rearm: Annotated[float, MM.positive]
    shown: Annotated[float, MM.positive]
    guard_cost: Annotated[float, NUMBER.not_negative]
    period_cost: Annotated[float, NUMBER.not_negative]
    motion_cost: Annotated[float, NUMBER.not_negative]


load_rules = cache(partial(read_toml, Rules, PICKING_FILE, section="task"))


@dataclass(frozen=True, eq=False)
class HarvestTask:
    """Constants of a harvester's episodes.

    Attributes:
        machine: The machine as designed, which is the controller's model.
        true: The machine as built, with its errors.
        model: Model of the outcome of attempts.
        rules: When a cup tries a fruit, bounds of observations, and costs.
        orchard: Canopy and sizes of fruit.
        eyes: Model of how the cameras see fruit.
        fruit: Number of fruit in a zone.
        most_action: Largest magnitude that is accepted for an action's numbers.
        compiled: Whether cups and distances are computed by machine code.
    """

    machine: harvester.Machine
    true: harvester.TrueMachine
    model: harvester.Picking
    rules: Rules
    orchard: harvester.Orchard
    eyes: Eyes
    fruit: int
    most_action: float
    compiled: bool

    @cached_property
    def increment(self) -> Array:
        """Largest increment of each joint in one period, rad or m, (joints,)."""
        return self.machine.speed * CONTROL_PERIOD

    @cached_property
    def lead(self) -> int:
        """Number of periods that sensing and cutting take together."""
        return int(np.ceil((self.machine.cycle.sense + self.machine.cycle.cut) / CONTROL_PERIOD - 1e-9))

    @cached_property
    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Lower and upper bounds of the observation's numbers, (observation_size,) each."""
        box = harvest_spaces(self)[0]
        return box.low, box.high


def make_harvest_task(
    slaves: int | None = None,
    spacing_mm: float | None = None,
    fruit: int = 8,
    ideal: bool = False,
    vision: str = "measured_errors",
    detector: str = "li2016",
    canopy: str | None = None,
    out_of_range: str = "clip",
    executor: str = "auto",
) -> HarvestTask:
    """Check the arguments of `HarvestEnv`, which its class explains, read the files, and return the task.

    Raises:
        InputError: If an argument has a value that is not allowed. The message says which values are.
    """
    check_choice("out_of_range", out_of_range, tuple(MOST_ACTION))
    check_choice("executor", executor, ("auto", "numpy"))
    check_flag("ideal", ideal)
    if isinstance(fruit, bool) or not isinstance(fruit, int | np.integer) or not 1 <= fruit <= 40:
        raise InputError(f"a zone of {fruit} fruit is impossible; give a whole number from 1 to 40")
    if spacing_mm is not None:
        check_number("spacing_mm", spacing_mm, positive=True)
    machine = harvester.load_machine(slaves=slaves, spacing=None if spacing_mm is None else spacing_mm * 1e-3)
    if machine.arms == 1:
        refuse_idle(make_harvest_task, {"spacing_mm": spacing_mm}, "on one slave; leave it out, or give more slaves")
    true = harvester.load_true_machine(machine)
    if ideal:
        true = true.ideal()
    orchard = harvester.load_orchard(canopy=canopy)
    eyes = load_eyes(vision, orchard.canopy, detector)
    if vision == "ideal":
        refuse_idle(make_harvest_task, {"detector": detector}, "with vision='ideal'; leave it out, or give another")
    most = MOST_ACTION[out_of_range]
    compiled = executor == "auto" and is_there("llvmlite")
    return HarvestTask(machine, true, harvester.load_picking(), load_rules(), orchard, eyes, int(fruit), most, compiled)


def harvest_spaces(task: HarvestTask, extra: int = 0) -> tuple[Box[np.float32], Box[np.float32]]:
    """Return the observation space, with ``extra`` numbers from 0 to 1 at its end, and the action space."""
    joints, arms, most = task.machine.joints, task.machine.arms, task.rules.shown
    high = [1.0] * (joints + arms) + [most, most, most, 1.0] * task.fruit + [1.0] * extra
    low = [-1.0] * joints + [0.0] * arms + [-most, -most, -most, 0.0] * task.fruit + [0.0] * extra
    observations = Box(np.array(low, dtype=np.float32), np.array(high, dtype=np.float32), dtype=np.float32)
    return observations, Box(-1.0, 1.0, (joints,), np.float32)


# The harvester at work in one zone, many machines at once: what Gymnasium's and PettingZoo's environments stand on.
# Leading axis: machines. Every machine draws from a generator of its own. Units: m, rad, s.


HANGING, COLLECTED, LOST = 0, 1, 2

HALF_AND_WHOLE = np.array([0.5, 1.0]).reshape(2, 1, 1, 1)


@dataclass(eq=False)
class HarvestState:
    """The state of many machines in their zones; every array has a leading axis (machines,).

    Attributes:
        joints: Nominal joint targets, rad or m, (machines, joints).
        fruit: True positions of the fruit at the start, m, (machines, fruit, 3).
        shift: Lasting displacement of the fruit by pushes, m, (machines, fruit, 3).
        swing: Further displacement of the fruit as it swings, m, (machines, fruit, 3).
        velocity: Velocity of the swinging fruit, m/s, (machines, fruit, 3).
        diameters: Diameters of the fruit, m, (machines, fruit).
        masses: Masses of the fruit, kg, (machines, fruit).
        believed: Positions of the fruit as the camera saw it, m, (machines, fruit, 3).
        error: Error of the camera: seen minus true position at the start, m, (machines, fruit, 3).
        located: Whether the camera found the fruit, (machines, fruit).
        reachable: Whether the fruit is located and some arm reaches it from the pick point, (machines, fruit).
        status: `HANGING`, `COLLECTED` or `LOST`, (machines, fruit).
        busy: Number of further periods for which each arm senses and cuts, (machines, arms).
        tried: Index (from 0) of the fruit that each arm tried last, or -1 once the arm has left it, (machines, arms).
        periods: Number of periods since the start.
        held: Number of arms that the collision guard stopped in the last period.
        closest: Least distance between two arms' centre lines so far, m.
        attempts: Number of attempts so far.
        left: Distance that `work_left` computes, whose decrease is rewarded as progress, m.
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
        """Displacement of the fruit from where it hung at the start, m, (machines, fruit, 3)."""
        return self.shift + self.swing

    def put(self, rows: NDArray[np.intp], other: HarvestState) -> None:
        """Overwrite the states of the machines with the indices ``rows`` (from 0) by the states in ``other``."""
        for mine, theirs in zip(leaves(self), leaves(other), strict=True):
            mine[rows] = theirs


def begin_zones(
    task: HarvestTask, rngs: Sequence[np.random.Generator], fruit: Array | None = None, joints: Array | None = None
) -> HarvestState:
    """Draw a zone for each generator, and return the state of the machines at the start.

    Unless ``joints`` are given, the master is at its pick point and the slaves are at rest.

    Args:
        task: The task.
        rngs: Random generators, one per machine.
        fruit: Positions of the fruit ``(machines, fruit, 3)``, base frame, m, or None to draw them.
        joints: Joints of whole machines to start from ``(machines, joints)``, rad or m, or None.

    Raises:
        InputError: If the cameras find no fruit in reach in `DRAWS` draws, or arms are too near each other at
            ``joints``.
    """
    machine, n = task.machine, len(rngs)
    zones = [drawn_zone(task, rng, None if fruit is None else fruit[i]) for i, rng in enumerate(rngs)]
    places, diameters, sights, masters, reachable = zip(*zones, strict=True)
    positions, sightings = np.array(places), np.array([sight.believed for sight in sights])
    at_rest = np.concatenate([masters, np.tile(machine.slave_home, (n, machine.arms))], axis=1)
    start = at_rest if joints is None else np.array(joints)
    if joints is not None and (distances(task, start) < machine.body.clearance).any():
        raise InputError("option start_joints brings two arms nearer than the guard lets them; move them apart")
    state = HarvestState(
        joints=start,
        fruit=positions,
        shift=np.zeros_like(positions),
        swing=np.zeros_like(positions),
        velocity=np.zeros_like(positions),
        diameters=np.array(diameters),
        masses=fruit_masses(task.orchard.fruit_size, np.array(diameters)),
        believed=sightings,
        error=sightings - positions,
        located=np.array([sight.located for sight in sights]),
        reachable=np.array(reachable),
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
    """Compute the least distance between two slave arms' centre lines, m, (machines,).

    ``joints`` has the joints of whole machines (machines, joints). With a single slave the result is `Rules.shown`.
    """
    machine = task.machine
    if machine.arms < 2:
        return np.full(len(joints), task.rules.shown)
    return np.asarray(arm_distances(machine, machine.parted(joints)[1]).min(axis=-1))


def of_rows(task: HarvestTask, what: str, joints: Array) -> Array:
    """Compute the true positions of cups, or the distances between slave arms, for many machines.

    Args:
        task: The task.
        what: "tips" for the true positions of the cups, or "distances" for the distances between pairs of slave arms.
        joints: Joints, one pose of a machine per row, (poses, joints), rad or m. For "tips" they are joint commands of
            whole machines, for "distances" joints of the slave arms.

    Returns:
        Coordinates of the cups, or distances, m, (poses, k).
    """
    if task.compiled:
        return rows_formula(task, what, len(joints))(joints)
    if what == "distances":
        return arm_distances(task.machine, joints.reshape(len(joints), -1, 3))
    return task.true.tips(*task.machine.parted(joints)).reshape(len(joints), -1)


@lru_cache(maxsize=16)
def rows_formula(task: HarvestTask, what: str, count: int) -> Callable[[Array], Array]:
    """Compile the formula for "tips" or "distances" (see `of_rows`) to machine code, for ``count`` poses at once."""
    from pickenv.arm.kinematics import machine_code

    def formula(m: Any, joints: Sequence[Any]) -> Sequence[Any]:
        parts = [joints[i : i + 3] for i in range(0, len(joints), 3)]
        if what == "distances":
            return pair_distances(m, task.machine, parts)
        return [part for cup in task.true.cups(m, parts[0], parts[1:]) for part in cup]

    return machine_code.on_rows(formula, 3 * (task.machine.arms + (what == "tips")), count)


def step(
    task: HarvestTask,
    state: HarvestState,
    actions: Array,
    rngs: Sequence[np.random.Generator],
    compensator: Compensate | None = None,
) -> Array:
    """Simulate one period: change ``state`` in place, and return the rewards, (machines,).

    Args:
        task: The task.
        state: State of the machines, changed in place.
        actions: Joint increments as shares of the largest increments, (machines, joints).
        rngs: Random generators, one per machine; a machine draws six numbers for each of its attempts.
        compensator: Maps nominal joints of whole machines to joint commands, or None.
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
    tips = of_rows(task, "tips", commands).reshape(len(commands), -1, 3)
    branch, rules = task.model.branch, task.rules
    if state.swing.any() or state.velocity.any():
        state.swing, state.velocity = swing(branch, state.swing, state.velocity, state.masses, CONTROL_PERIOD)
    collected, lost = attempts(task, state, tips, rngs)
    state.left = work_left(task, state)
    cost = rules.guard_cost * state.held + rules.period_cost + rules.motion_cost * np.abs(actions).mean(axis=1)
    return np.asarray(collected - lost + (before - state.left) - cost)


def _guard(task: HarvestTask, start: Array, target: Array) -> tuple[NDArray[np.int64], Array]:
    """Stop every slave arm that would come too near another slave arm; change ``target`` in place.

    Args:
        task: The task.
        start: Joints of whole machines before the move (machines, joints), rad or m.
        target: Joints after the move, of the same shape; the joints of stopped arms are set back to ``start``.

    Returns:
        The number of arms stopped, and the least distance between two arms' centre lines, m, (machines,) each. The
        distance is the smaller of two: half way through the move, and at its end.
    """
    machine, n = task.machine, len(start)
    arms = machine.arms
    blocked = np.zeros((n, arms), dtype=bool)
    if arms < 2:
        return np.asarray(blocked.sum(axis=1)), distances(task, target)
    i, j = pairs_of(arms)
    old, new = machine.parted(start)[1], machine.parted(target)[1].copy()
    for _ in range(arms + 1):
        rows = (old + HALF_AND_WHOLE * (new - old)).reshape(2 * n, -1)
        between, after = of_rows(task, "distances", rows).reshape(2, n, -1)
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
    return np.asarray(blocked.sum(axis=1)), np.asarray(np.minimum(between, after).min(axis=-1))


def attempts(
    task: HarvestTask, state: HarvestState, tips: Array, rngs: Sequence[np.random.Generator]
) -> tuple[Array, Array]:
    """Close the blade of each cup whose sensor detects a fruit, and compute the outcomes of these attempts.

    Args:
        task: The task.
        state: State of the machines, changed in place.
        tips: True positions of the cups, m, (machines, arms, 3).
        rngs: Random generators, one per machine.

    Returns:
        The numbers of fruit collected and of fruit lost in this period, (machines,) each.
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
        _, detached, whole = attempt(model, tips[machine, arms], fruit[some], offsets, diameters, fruit[others], luck)
        became = np.where(whole, COLLECTED, np.where(detached, LOST, HANGING))
        state.attempts[machine] += len(some)
        state.tried[machine, arms], state.busy[machine, arms] = some, task.lead
        state.status[machine, some] = became
        collected[machine], lost[machine] = (became == COLLECTED).sum(), (became == LOST).sum()
        push = pushes(model, fruit[some], fruit, luck).sum(axis=0) * (state.status[machine] == HANGING)[:, None]
        state.shift[machine] += model.lasting * push
        state.swing[machine] += (1 - model.lasting) * push
        # an empty cup looks again, past the same leaves
        state.believed[machine, some] = fruit[some] + state.shift[machine, some] + state.error[machine, some]
    return collected, lost


def _nearest(lateral: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Choose which cups try which fruit: each cup the nearest fruit that no cup with a smaller index tries.

    ``lateral`` (arms, fruit) has the horizontal distance of each fruit from each cup, m. It is infinite if the cup
    cannot try the fruit.

    Returns:
        The indices (from 0) of the cups, and the indices of their fruit, (picks,) each.
    """
    lateral, pairs = lateral.copy(), []
    for arm in range(len(lateral)):
        fruit = int(lateral[arm].argmin())
        if np.isfinite(lateral[arm, fruit]):
            pairs.append((arm, fruit))
            lateral[:, fruit] = np.inf
    arms, some = np.array(pairs, dtype=np.intp).T
    return arms, some


def work_left(task: HarvestTask, state: HarvestState) -> Array:
    """Compute the distance whose decrease is rewarded as progress, m, (machines,).

    The distances from each fruit that hangs in reach, as the camera saw it, to the nearest cup are summed. Cups are
    where the controller believes them to be. The sum is divided by the number of all fruit in the zone.
    """
    away = state.believed[:, None] - task.machine.tips(*task.machine.parted(state.joints))[:, :, None]
    distance = np.sqrt((away * away).sum(axis=-1)).min(axis=1)
    return np.asarray((distance * pickable(state)).sum(axis=-1) / distance.shape[-1])


def pickable(state: HarvestState) -> Flags:
    """Return flags of the fruit that still hangs and that an arm reaches from the pick point, (machines, fruit)."""
    return np.asarray((state.status == HANGING) & state.reachable)


def finished(state: HarvestState) -> Flags:
    """Return flags of the machines with no fruit left to pick and no blade closing, (machines,)."""
    return np.asarray(~pickable(state).any(axis=1) & (state.busy == 0).all(axis=1))


def observe(task: HarvestTask, state: HarvestState) -> NDArray[np.float32]:
    """Return the observations, (machines, observation_size), as `HarvestEnv` lays them out."""
    machine = task.machine
    scaled = 2 * (state.joints - machine.lower) / (machine.upper - machine.lower) - 1
    heading = state.joints[:, 0]
    away = state.believed - machine.frame3(state.joints[:, :3])[:, None]
    sin, cos = np.sin(heading)[:, None], np.cos(heading)[:, None]
    right = away[..., 0] * sin - away[..., 1] * cos
    ahead = away[..., 0] * cos + away[..., 1] * sin
    visible = pickable(state)
    fruit = np.stack([right * visible, ahead * visible, away[..., 2] * visible, visible], axis=-1)
    parts = [scaled, state.busy / task.lead, fruit.reshape(len(scaled), -1)]
    low, high = task.bounds
    return np.asarray(np.minimum(np.maximum(np.concatenate(parts, axis=1), low), high), dtype=np.float32)


def information(state: HarvestState) -> dict[str, NDArray[np.generic]]:
    """Return the infos of all machines: arrays (machines,) by key, always with the same keys."""
    collected = (state.status == COLLECTED).sum(axis=1)
    done = (state.status == COLLECTED) | ~state.reachable
    return {
        "collected": collected,
        "lost": (state.status == LOST).sum(axis=1),
        "located": state.located.sum(axis=1),
        "reachable": state.reachable.sum(axis=1),
        "attempts": state.attempts.copy(),
        "held": state.held.copy(),
        "closest_mm": state.closest * 1e3,
        "picks_per_hour": collected / (np.maximum(state.periods, 1) * CONTROL_PERIOD / 3600),
        "is_success": done.all(axis=1),
    }
