"""Harvest of whole trees, zone by zone: picture, pick point, plan, picks, further pictures, unloading, and the clock.

Many trees advance together, so that the true arms are computed for all of them at once. Each tree has a random
generator of its own, so its result does not depend on the other trees. `work_trees` draws the same trees from one seed
for every strategy and any number of workers.

An attempt's outcome depends on Li's cup, position sensor and blade. A cup that enters the foliage pushes it. Fruit
nearby then swings on its branch, a spring-pendulum, and part of the push remains. Units: m, rad, kg, s.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.base import MM, NUMBER, SHARE, InputError, Key, Then, Unit, fault, read_toml, toml_table
from pickenv.harvester.machine import Flags, Machine, master_time
from pickenv.harvester.optimiser import assign
from pickenv.harvester.pick_points import (
    PICKING_FILE,
    Grid,
    Orchard,
    Tree,
    Zone,
    cut,
    pick_point,
    sample_tree,
    tree_leaves,
)
from pickenv.harvester.true_machine import Controller, TrueMachine
from pickenv.harvester.work import Timetable, Work, closest_approach, timetable, ultrasonic_hold, zone_work
from pickenv.orchard import (
    Branch,
    Cup,
    Eyes,
    coupling,
    draw_chances,
    load_branch,
    load_eyes,
    load_gripper,
    next_picture,
    see,
    swing,
)


def _cup(name: str, _context: Any) -> Cup:
    cup = load_gripper(name)
    if not isinstance(cup, Cup):
        raise fault("a cup: the harvester's end-effector closes around fruit from below")
    return cup


@toml_table
class Picking:
    """Parameters of the picking model; see picking.toml.

    Attributes:
        cup: Li's cup.
        branch: Branch that fruit hangs from.
        gather: Reach of the cup's gatherer, m. No fruit is taken if its misalignment across the cup's axis exceeds the
            cup's clearance around the fruit by this reach or more.
        outer: Outer radius of the cup, m.
        cluster_success: Probability that an attempt succeeds although another fruit is in the cup's way.
        cut_success: Probability that the blade meets the stalk.
        undamaged: Probability that picked fruit stays whole.
        push: Median shift of the foliage by a cup that enters it, m.
        push_spread: Standard deviation of the natural logarithm of the shift ``push``.
        lasting: Share of a push that remains after the swing.
    """

    cup: Annotated[Cup, Key("gripper"), Then(_cup, str)]
    branch: Annotated[Branch, Then(lambda name, _: load_branch(name), str)]
    gather: Annotated[float, MM.positive]
    outer: Annotated[float, Key("cup_outer_mm"), Unit("mm", 0.5e-3, most=MM.most).positive]
    cluster_success: Annotated[float, SHARE]
    cut_success: Annotated[float, SHARE]
    undamaged: Annotated[float, SHARE]
    push: Annotated[float, MM.not_negative]
    push_spread: Annotated[float, NUMBER.not_negative]
    lasting: Annotated[float, SHARE]


def load_picking(path: str | Path = PICKING_FILE) -> Picking:
    """Read the picking model from a picking file.

    Raises:
        InputError: If a number is outside its limits or the gripper is not a cup.
    """
    return read_toml(Picking, path, section="pick")


class Luck(NamedTuple):
    """Random numbers that decide the outcomes of attempts, (picks,) each.

    Attributes:
        grasp: Uniform from 0 to 1; decides whether the cup takes the fruit.
        cluster: Uniform from 0 to 1; decides whether the cup takes a fruit although another one is in its way.
        cut: Uniform from 0 to 1; decides whether the blade meets the stalk.
        whole: Uniform from 0 to 1; decides whether the fruit stays whole.
        push: Standard normal; scales the push on the foliage.
        heading: Direction of the push in plan, from x towards y, rad; uniform from 0 to 2 pi.
    """

    grasp: Array
    cluster: Array
    cut: Array
    whole: Array
    push: Array
    heading: Array


def draw_luck(rng: np.random.Generator, count: int) -> Luck:
    """Draw the random numbers of ``count`` attempts, six for each."""
    grasp, cluster, cut, whole = rng.random((count, 4)).T
    return Luck(grasp, cluster, cut, whole, rng.normal(size=count), rng.uniform(0.0, 2 * np.pi, count))


def attempt(
    model: Picking, tips: Array, fruit: Array, moved: Array, diameters: Array, others: Array, luck: Luck
) -> tuple[Flags, Flags, Flags]:
    """Compute the outcomes of picking attempts that are made one after another.

    Args:
        model: The picking model.
        tips: True cup positions when the cups have risen to the fruit, m, (picks, 3), in the order of the attempts.
        fruit: True fruit centres at rest, m, (picks, 3).
        moved: Displacement of each fruit by earlier pushes at the time its own cup arrives, m, (picks, 3).
        diameters: Diameters of the fruit, m, (picks,).
        others: Centres of the hanging fruit to which none of these attempts goes, m, (m, 3).
        luck: Random numbers that decide the outcomes.

    Returns:
        Three arrays of flags, (picks,) each: whether the fruit was in the cup, whether its stalk was cut, and whether
        the fruit came into the tube undamaged.
    """
    n = len(tips)
    offset = fruit + moved - tips
    lateral = np.hypot(offset[:, 0], offset[:, 1])
    clearance = (model.cup.opening - diameters) / 2
    taken = np.clip(1.0 - (lateral - clearance) / model.gather, 0.0, 1.0) * (np.abs(offset[:, 2]) <= model.cup.axial)
    alone = luck.grasp < np.where(clearance < 0, 0.0, taken)
    cut = luck.cut < model.cut_success
    attached = np.zeros(n, dtype=bool)
    hanging = np.ones(n, dtype=bool)
    for i in range(n):  # in order: what an earlier cup has taken is out of the way of a later one
        near = np.concatenate([fruit[hanging & (np.arange(n) != i)], others])
        crowded = in_the_way(model, fruit[i], float(diameters[i]), near).any()
        attached[i] = alone[i] and (not crowded or luck.cluster[i] < model.cluster_success)
        hanging[i] = not (attached[i] and cut[i])
    detached = attached & cut
    return attached, detached, detached & (luck.whole < model.undamaged)


def in_the_way(model: Picking, fruit: Array, diameter: float, near: Array) -> Flags:
    """Return flags (m,): whether the cup's wall would meet each fruit in ``near`` before the cup is at its own fruit.

    Only fruit beside or just below the fruit to take is in the way.

    Args:
        model: The picking model.
        fruit: Centre of the fruit to take, m, (3,).
        diameter: Diameter of the fruit to take, m.
        near: Centres of the other fruit, m, (m, 3).
    """
    away = near - fruit
    level = np.hypot(away[:, 0], away[:, 1])
    return np.asarray((level < model.outer + diameter / 2) & (away[:, 2] < diameter) & (away[:, 2] > -3 * diameter))


def pushes(model: Picking, fruit: Array, others: Array, luck: Luck) -> Array:
    """Compute the initial displacements of fruit by cups that enter the foliage, m, (picks, m, 3).

    Displacements decrease with the distance from the fruit that a cup goes to. Later, the share `Picking.lasting` of
    a displacement remains, and its other part swings with the branch and decays.

    Args:
        model: The picking model.
        fruit: Fruit centres that the cups go to, m, (picks, 3).
        others: Centres of the fruit that is pushed, m, (m, 3).
        luck: Random numbers of the picks; they give strength and direction of each push.
    """
    push = model.push * np.exp(model.push_spread * luck.push)
    distance = np.linalg.norm(fruit[:, None] - others[None], axis=-1)
    way = np.stack([np.cos(luck.heading), np.sin(luck.heading), np.zeros(len(fruit))], axis=-1)
    return np.asarray((coupling(model.branch, distance) * push[:, None])[..., None] * way[:, None])


def displacements(model: Picking, fruit: Array, masses: Array, entry: Array, luck: Luck) -> Array:
    """Compute the displacement of each pick's fruit by the cups of all earlier picks, m, (picks, 3).

    The displacement is given for the time at which the fruit's own cup enters the foliage.

    Args:
        model: The picking model.
        fruit: True fruit centres at rest, m, (picks, 3).
        masses: Masses of the fruit, kg, (picks,).
        entry: Times at which the cups enter the foliage, ascending, s, (picks,).
        luck: Random numbers of the picks; they give strength and direction of each push.
    """
    wait = entry[None, :] - entry[:, None]  # from push i to cup j
    start = pushes(model, fruit, fruit, luck) * (wait > 0)[..., None]
    swung, _ = swing(
        model.branch, start, np.zeros_like(start), np.broadcast_to(masses, wait.shape), np.maximum(wait, 0.0)
    )
    return np.asarray((model.lasting * start + (1 - model.lasting) * swung).sum(axis=0))


@dataclass(frozen=True, eq=False)
class Strategy:
    """Choices by which a machine harvests a tree.

    Attributes:
        name: Name for reports.
        controller: Controller that converts nominal joints to commands by models of the true arms (its beliefs).
        pick_point: Name of the method of `pickenv.harvester.pick_point`, which says where the master stands for a zone.
        assignment: Name of the method of `pickenv.harvester.assign`, which says which arm picks which fruit.
        guard: Whether a side arm (even index, from 0 on the left) waits while its ultrasonic ranger measures that a
            middle arm (odd index) is too near.
        looks: Largest number of pictures of a zone. After each picture and its picks, another picture is taken only if
            some of these picks detached no fruit.
        unload_full: If true, the tubes are emptied only when one is full, and at the end. Otherwise they are emptied
            after each zone.
        detector: Detector that finds fruit in the pictures: "li2016" or "circles" (`pickenv.orchard.DETECTORS`).
    """

    name: str
    controller: Controller
    pick_point: str = "corrected"
    assignment: str = "li"
    guard: bool = True
    looks: int = 1
    unload_full: bool = False
    detector: str = "li2016"


@dataclass(eq=False)
class Round:
    """One picture of a zone and the picks that follow from it.

    A detection is either true (a fruit of the tree) or false.

    Attributes:
        zone: The zone.
        begin: Time on the tree's clock at which picking starts, s.
        master: Nominal joints of the master while its slaves pick, rad and m, (3,).
        numbers: Index in the tree, from 0, of the fruit of each detection, -1 for a false detection, (n,).
        believed: Position of each detection as measured in the picture, base frame, m, (n, 3).
        work: The scheduling problem; its fruit are the detections.
        times: Timetable of the picks.
        closest: Least distance between the centre lines of two arms during the picks, m; infinite for one arm.
        collected: Whether each pick brought an undamaged fruit into a tube, (picks,); set once the picks are done.
    """

    zone: Zone
    begin: float
    master: Array
    numbers: NDArray[np.int64]
    believed: Array
    work: Work
    times: Timetable
    closest: float
    collected: Flags = field(init=False)

    @property
    def fruit(self) -> NDArray[np.int64]:
        """Index in the tree, from 0, of each pick's fruit, -1 for a false detection, (picks,), in timetable order."""
        return self.numbers[self.times.fruit]

    @property
    def aimed(self) -> Array:
        """Nominal slave joints at each pick's fruit, m and rad, (picks, 3), in timetable order."""
        return self.work.joints[self.times.arm, self.times.fruit]


class Harvest:
    """State of a tree during its harvest, and the record of what was done.

    Flags of fruit, and `by_arm`, have shape (n,), n being the number of fruit of the tree.

    Attributes:
        tree: The tree.
        rng: Random generator for the outcomes of picks.
        looking: Random generator for the pictures.
        leaves: Leaves of the tree, or None unless pictures are rendered.
        seen: Whether at least a part of each fruit was visible in some picture.
        located: Whether the position of each fruit was measured in some picture.
        reachable: Whether some arm could reach each fruit from a pick point.
        attempted: Whether a cup was sent to each fruit.
        attached: Whether each fruit was in a cup at some attempt.
        detached: Whether the stalk of each fruit was cut.
        collected: Whether each fruit came into a tube undamaged.
        by_arm: Index, from 0 on the left, of the arm of the last attempt at each fruit, or -1.
        load: Number of fruit in the tube of each arm, (arms,).
        master: Present nominal joints of the master, rad and m, (3,).
        rounds: Rounds so far (pictures with the picks that followed), in order.
        seconds: Time on the tree's clock, s.
        phases: Time spent in each phase ("move", "image", "pick", "unload"), s.
        repicks: Number of attempts at fruit that an earlier attempt had missed.
        misled: Number of attempts at false detections.
        chances: Random numbers of the present zone's first picture, (n, 5), see `pickenv.orchard.draw_chances`; None
            unless the vision is "measured_errors".
    """

    def __init__(self, machine: Machine, eyes: Eyes, tree: Tree, rng: np.random.Generator) -> None:
        self.tree, self.rng = tree, rng
        self.looking = rng.spawn(1)[0]  # so that the same luck befalls a tree however it is seen
        self.leaves = tree_leaves(machine, eyes, self.looking)
        self.seen, self.located, self.reachable, self.attempted = np.zeros((4, len(tree)), dtype=bool)
        self.attached, self.detached, self.collected = np.zeros((3, len(tree)), dtype=bool)
        self.by_arm, self.load = np.full(len(tree), -1), np.zeros(machine.arms, dtype=np.int64)
        self.master = machine.master_start.copy()
        self.rounds: list[Round] = []
        self.phases = dict.fromkeys(("move", "image", "pick", "unload"), 0.0)
        self.seconds, self.repicks, self.misled = 0.0, 0, 0
        self.chances: Array | None = None

    def spend(self, phase: str, seconds: float) -> None:
        """Advance the clock by ``seconds``, and add them to a phase's time: "move", "image", "pick" or "unload"."""
        self.seconds += seconds
        self.phases[phase] += seconds


def harvest(
    true: TrueMachine,
    strategy: Strategy,
    model: Picking,
    trees: Sequence[Tree],
    rngs: Sequence[np.random.Generator],
    grid: Grid,
    eyes: Eyes,
) -> list[Harvest]:
    """Simulate the harvest of trees, from the first zone to the last.

    Args:
        true: The machine as built. The strategy's controller does not read it.
        strategy: Choice of pick points, plans, pictures and unloading.
        model: Model of the outcomes of picking attempts.
        trees: The trees.
        rngs: One generator per tree.
        grid: Division of each tree's side into zones.
        eyes: Model of how cameras see fruit.

    Returns:
        The record of each tree.

    Raises:
        InputError: If the numbers of trees and generators differ.
    """
    if len(trees) != len(rngs):
        raise InputError(f"{len(trees)} trees came with {len(rngs)} generators; give one each")
    machine = true.machine
    states = [Harvest(machine, eyes, tree, rng) for tree, rng in zip(trees, rngs, strict=True)]
    sides = [cut(grid, *tree.side) for tree in trees]
    for number in range(grid.columns * grid.rows):
        waiting = list(range(len(states)))
        for look in range(strategy.looks):
            plans = ((i, _plan(machine, strategy, eyes, states[i], sides[i][number], look)) for i in waiting)
            waiting = _execute(true, strategy, model, states, {i: plan for i, plan in plans if plan is not None})
        for state in states:
            if not strategy.unload_full or number == grid.columns * grid.rows - 1:
                _unload(machine, state)
    return states


def _plan(machine: Machine, strategy: Strategy, eyes: Eyes, state: Harvest, zone: Zone, look: int) -> Round | None:
    """Take a picture of a zone and plan the picks; return None if the picture shows no fruit that an arm reaches.

    Args:
        machine: The machine as designed.
        strategy: Choice of pick point, plan and waiting.
        eyes: Model of how cameras see fruit.
        state: The tree's record, changed in place.
        zone: The zone.
        look: Index of the picture among the zone's pictures, from 0.
    """
    state.spend("image", machine.cycle.image)
    numbers, places = _seen_in(eyes, state, zone, look)
    if not numbers.size:
        return None
    low, high = machine.master.nominal.lower, machine.master.nominal.upper
    master = np.clip(pick_point(machine, places, strategy.pick_point), low, high)
    work = zone_work(machine, master, places)
    state.reachable[numbers[work.reachable & (numbers >= 0)]] = True
    if not work.reachable.any():
        return None
    state.spend("move", float(master_time(machine, state.master, master)))
    state.master = master
    plan = assign(work, strategy.assignment, state.rng)
    times = timetable(work, plan, hold=ultrasonic_hold(machine, work, state.rng) if strategy.guard else None)
    return Round(zone, state.seconds, master, numbers, places, work, times, closest_approach(machine, work, times))


def _seen_in(eyes: Eyes, state: Harvest, zone: Zone, look: int) -> tuple[NDArray[np.int64], Array]:
    """Take a zone's picture, note in the tree's record which fruit it shows, and return its detections.

    Args:
        eyes: Model of how cameras see fruit.
        state: The tree's record, changed in place.
        zone: The zone.
        look: Index of the picture among the zone's pictures, from 0.

    Returns:
        Two arrays. The first is the index of each detection's fruit in the tree, from 0, -1 for a false detection,
        (m,). The second is the measured position of each detection in the base frame, m, (m, 3).
    """
    tree, rng = state.tree, state.looking
    hanging = np.flatnonzero(~state.detached)
    chances = None
    if eyes.errors is not None:
        if look == 0 or state.chances is None:
            chances = state.chances = draw_chances(rng, len(tree))
        else:
            chances = next_picture(eyes.errors, state.chances, rng)
        chances = chances[hanging]
    fruit, diameters = tree.fruit[hanging], tree.diameters[hanging]
    sighting = see(eyes, zone.view, fruit, diameters, rng, leaves=state.leaves, chances=chances)
    in_zone = sighting.located & zone.holds(sighting.believed)
    state.seen[hanging[sighting.in_sight & (zone.holds(fruit) | in_zone)]] = True
    state.located[hanging[in_zone]] = True
    phantoms = sighting.false[zone.holds(sighting.false)]
    numbers = np.concatenate([hanging[in_zone], np.full(len(phantoms), -1)]).astype(np.int64)
    return numbers, np.concatenate([sighting.believed[in_zone], phantoms])


def _execute(
    true: TrueMachine, strategy: Strategy, model: Picking, states: list[Harvest], rounds: dict[int, Round]
) -> list[int]:
    """Simulate the planned picks of all trees with the true machine.

    Args:
        true: The machine as built.
        strategy: Strategy whose controller makes the commands.
        model: Model of the outcomes of picking attempts.
        states: All trees.
        rounds: The planned round of each tree that has one, by the tree's index in ``states``.

    Returns:
        Indices in ``states`` (from 0) of the trees in which some pick detached no fruit.
    """
    if not rounds:
        return []
    plans = list(rounds.values())
    counts = [len(plan.times.fruit) for plan in plans]
    arm = np.concatenate([plan.times.arm for plan in plans])
    target = np.concatenate([plan.believed[plan.times.fruit] for plan in plans])
    master = np.repeat(strategy.controller.master_command(np.array([plan.master for plan in plans])), counts, axis=0)
    commands = strategy.controller.pick_commands(master, arm, target)
    done = zip(rounds.items(), np.split(true.picking_tips(master, arm, commands), np.cumsum(counts[:-1])), strict=True)
    return [i for (i, plan), tips in done if _record(true, strategy, model, states[i], plan, tips)]


def _record(true: TrueMachine, strategy: Strategy, model: Picking, state: Harvest, plan: Round, tips: Array) -> bool:
    """Enter the outcomes and the time of a round into a tree's record.

    Args:
        true: The machine as built.
        strategy: Strategy that says when tubes are emptied.
        model: Model of the outcomes of picking attempts.
        state: The tree's record, changed in place.
        plan: The round, with its planned picks.
        tips: True cup positions, base frame, m, (picks, 3), when the cups have risen to the fruit. They leave out the
            random error of each stop.

    Returns:
        Whether some pick detached no fruit.
    """
    rng, times, numbers = state.rng, plan.times, plan.fruit
    arm = times.arm
    tips = tips + rng.normal(size=(len(arm), 2, 3)).sum(axis=1) * true.repeatability
    attached, detached, collected = _outcome(model, state, numbers, tips, times.start + plan.work.out[arm, times.fruit])
    hung = numbers >= 0
    fruit = numbers[hung]
    state.repicks += int(state.attempted[fruit].sum())
    state.misled += int((~hung).sum())
    state.attempted[fruit] = True
    state.attached[fruit] |= attached[hung]
    state.detached[fruit] = detached[hung]  # only what hangs is picked
    state.collected[fruit] = collected[hung]
    state.by_arm[fruit] = arm[hung]
    np.add.at(state.load, arm[collected], 1)
    plan.collected = collected
    state.rounds.append(plan)
    state.spend("pick", times.makespan)
    if strategy.unload_full and state.load.max() >= true.machine.cycle.tube_fruit:
        _unload(true.machine, state)
    return bool((~detached).any())


def _outcome(model: Picking, state: Harvest, numbers: NDArray[np.int64], tips: Array, entry: Array) -> Flags:
    """Return flags of a round's picks: attached, detached and collected, (3, picks), in the order of the picks.

    A cup that is sent to a false detection returns empty, but it pushes the foliage like any other cup.

    Args:
        model: Model of the outcomes of picking attempts.
        state: The tree's record.
        numbers: Index in the tree, from 0, of the fruit of each pick, -1 for a false detection, (picks,).
        tips: True cup positions, base frame, m, (picks, 3), when the cups have risen to the fruit.
        entry: Times at which the cups reach the fruit, s, (picks,); a cup also pushes the fruit of later picks.
    """
    tree, luck = state.tree, draw_luck(state.rng, len(numbers))
    order = np.argsort(entry, kind="stable")
    hung = numbers >= 0
    places = np.where(hung[:, None], tree.fruit[numbers], tips) if len(tree) else tips
    masses = np.where(hung, tree.masses[numbers], tree.masses.mean()) if len(tree) else np.ones(len(numbers))
    shifts = displacements(model, places[order], masses[order], entry[order], luck)
    real = np.flatnonzero(hung[order])
    mine = order[real]
    hanging = ~state.detached
    hanging[numbers[mine]] = False
    real_luck = Luck(*(values[real] for values in luck))
    diameters = tree.diameters[numbers[mine]]
    done = attempt(model, tips[mine], places[mine], shifts[real], diameters, tree.fruit[hanging], real_luck)
    flags = np.zeros((3, len(numbers)), dtype=bool)
    flags[:, mine] = done
    return flags


def _unload(machine: Machine, state: Harvest) -> None:
    """Move the master to its start pose and empty the tubes there; do nothing if all tubes are empty.

    ``state`` is the tree's record, changed in place.
    """
    if not state.load.any():
        return
    state.spend("move", float(master_time(machine, state.master, machine.master_start)))
    state.spend("unload", machine.cycle.unload)
    state.master = machine.master_start.copy()
    state.load[:] = 0


def generators_of(
    seeds: Sequence[np.random.SeedSequence],
) -> tuple[list[np.random.Generator], list[np.random.Generator]]:
    """Return two lists with one random generator per seed: generators for drawing trees, and for harvesting them."""
    pairs = [np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key).spawn(2) for seed in seeds]
    return [np.random.default_rng(a) for a, _ in pairs], [np.random.default_rng(b) for _, b in pairs]


def work_trees(
    true: TrueMachine,
    strategy: Strategy,
    model: Picking,
    orchard: Orchard,
    grid: Grid,
    *,
    count: int,
    seed: int,
    workers: int = 1,
    vision: str = "measured_errors",
) -> list[Harvest]:
    """Draw ``count`` trees from ``seed`` and simulate their harvest.

    Equal seeds give equal trees for every strategy and every vision.

    Args:
        true: The machine as built.
        strategy: Choice of pick points, plans, pictures and unloading.
        model: Model of the outcomes of picking attempts.
        orchard: Model from which trees are drawn.
        grid: Division of each tree's side into zones.
        count: Number of trees.
        seed: Seed of the trees and of their harvest.
        workers: Number of processes.
        vision: Model of what the cameras show: "rendered", "measured_errors" or "ideal" (`pickenv.orchard.load_eyes`).

    Returns:
        The record of each tree.

    Raises:
        InputError: If the count or the number of workers is not above zero.
    """
    if count < 1 or workers < 1:
        raise InputError(f"{count} trees on {workers} workers are impossible; give 1 or more of each")
    tree_rngs, rngs = generators_of(np.random.SeedSequence(seed).spawn(count))
    trees = [sample_tree(true.machine, orchard, rng) for rng in tree_rngs]
    eyes = load_eyes(vision, orchard.canopy, strategy.detector)
    job = partial(harvest, true, strategy, model, grid=grid, eyes=eyes)
    if workers == 1 or count < 2 * workers:
        return job(trees, rngs)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        done = list(pool.map(job, *([some[i::workers] for i in range(workers)] for some in (trees, rngs))))
    return [done[i % workers][i // workers] for i in range(count)]


STAGES = ("present", "visible", "located", "reachable", "attempted", "attached", "detached", "collected")


@dataclass(frozen=True)
class Measure:
    """A number with its 95 % interval.

    Attributes:
        value: The number.
        low: Lower end, or None without an interval.
        high: Upper end, or None without an interval.
    """

    value: float
    low: float | None = None
    high: float | None = None

    def __str__(self) -> str:
        text = f"{self.value:.4g}"
        return text if self.low is None else f"{text} [{self.low:.4g}, {self.high:.4g}]"


def funnel(harvests: Sequence[Harvest]) -> dict[str, int]:
    """Return the number of fruit that reached each stage of `STAGES`, from "present" to "collected", over all trees."""
    return {stage: int(sum(at_stage(h, stage) for h in harvests)) for stage in STAGES}


def at_stage(harvest: Harvest, stage: str) -> int:
    """Return the number of fruit of one tree that reached a stage, such as "visible" or "collected" (`STAGES`)."""
    if stage == "present":
        return len(harvest.tree)
    return int(getattr(harvest, "seen" if stage == "visible" else stage).sum())
