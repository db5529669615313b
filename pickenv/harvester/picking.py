"""Outcomes of picking attempts with Li's cup, position sensor and blade, and displacements of fruit by other cups.

A cup that enters the foliage pushes it. Fruit nearby then swings on its branch, a spring-pendulum, and part of the push
remains. Units: m, kg, s.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from pickenv.arm import Array
from pickenv.base import MM, NUMBER, SHARE, Key, Then, Unit, fault, read_toml, toml_table
from pickenv.harvester.machine import Flags
from pickenv.harvester.trees import SHIPPED
from pickenv.orchard import Branch, Cup, coupling, load_branch, load_gripper, swing


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
        gather: Misalignment across the cup's axis, beyond the cup's clearance around the fruit, above which the
            cup's gatherer takes no fruit, m.
        outer: Outer radius of the cup, m.
        cluster_success: Probability that an attempt succeeds although another fruit is in the cup's way.
        cut_success: Probability that the blade meets the stalk.
        undamaged: Probability that picked fruit stays whole.
        push: Median shift of the foliage by a cup that enters it, m.
        push_spread: Standard deviation of the natural logarithm of that shift.
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


def load_picking(path: str | Path = SHIPPED) -> Picking:
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
        Three flags of each pick, (picks,) each: the fruit was in the cup, its stalk was cut, it came into the tube
        undamaged.
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
    """Return flags (m,): whether the cup's wall would meet each fruit in ``near`` on its way to the fruit to take.

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

    It is that at the time at which the fruit's own cup enters the foliage.

    Args:
        model: The picking model.
        fruit: True fruit centres at rest, m, (picks, 3).
        masses: Masses of the fruit, kg, (picks,).
        entry: Times at which the cups enter the foliage, ascending, s, (picks,).
        luck: Random numbers of the picks; they give strength and direction of each push.
    """
    n = len(fruit)
    if n < 2:
        return np.zeros((n, 3))
    wait = entry[None, :] - entry[:, None]  # from push i to cup j
    start = pushes(model, fruit, fruit, luck) * (wait > 0)[..., None]
    swung, _ = swing(model.branch, start, np.zeros_like(start), np.broadcast_to(masses, (n, n)), np.maximum(wait, 0.0))
    return np.asarray((model.lasting * start + (1 - model.lasting) * swung).sum(axis=0))
