"""Outcomes of attempts: Li's cup, position sensor and blade, and fruit that a neighbour's cup has pushed away.

A cup that goes in pushes the foliage; fruit nearby swings on its branch (spring-pendulum) and part of the push stays.
Units: m, kg, s.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.base import MM, NUMBER, SHARE, Key, Then, Unit, fault, read_toml, toml_table
from pickenv.harvester.trees import SHIPPED
from pickenv.orchard import Branch, Cup, coupling, load_branch, load_gripper, swing

Flags = NDArray[np.bool_]


def _branch(name: str, _context: Any) -> Branch:
    return load_branch(name)


def _cup(name: str, _context: Any) -> Cup:
    cup = load_gripper(name)
    if not isinstance(cup, Cup):
        raise fault("a cup: the harvester's end-effector closes around fruit from below")
    return cup


@toml_table
class Picking:
    """The picking model; see picking.toml.

    Attributes:
        cup: Li's cup.
        branch: What fruit hangs from.
        gather: Lateral misalignment beyond the cup's clearance at which the gatherer takes no fruit any more, m.
        outer: Outer radius of the cup, m.
        cluster_success: Probability that an attempt succeeds although another fruit is in the cup's way.
        cut_success: Probability that the blade meets the stalk.
        undamaged: Probability that picked fruit stays whole.
        push: Median shift of foliage by a cup that goes in, m.
        push_spread: Standard deviation of its logarithm.
        lasting: Share of a push that stays.
    """

    cup: Annotated[Cup, Key("gripper"), Then(_cup, str)]
    branch: Annotated[Branch, Then(_branch, str)]
    gather: Annotated[float, MM.positive]
    outer: Annotated[float, Key("cup_outer_mm"), Unit("mm", 0.5e-3, most=MM.most).positive]
    cluster_success: Annotated[float, SHARE]
    cut_success: Annotated[float, SHARE]
    undamaged: Annotated[float, SHARE]
    push: Annotated[float, MM.not_negative]
    push_spread: Annotated[float, NUMBER.not_negative]
    lasting: Annotated[float, SHARE]


@lru_cache(maxsize=4)
def load_picking(path: str | Path = SHIPPED) -> Picking:
    """Read the picking model.

    Raises:
        InputError: If a number is impossible or the gripper is not a cup.
    """
    return read_toml(Picking, path, section="pick")


class Luck(NamedTuple):
    """Draws that decide about attempts; each (picks,).

    Attributes:
        grasp: Uniform: whether the cup takes the fruit.
        cluster: Uniform: whether it does although another fruit is in its way.
        cut: Uniform: whether the blade meets the stalk.
        whole: Uniform: whether the fruit stays whole.
        push: Standard normal: how hard the cup pushes the foliage.
        heading: Which way, rad.
    """

    grasp: Array
    cluster: Array
    cut: Array
    whole: Array
    push: Array
    heading: Array


def draw_luck(rng: np.random.Generator, count: int) -> Luck:
    """Six numbers for each of ``count`` attempts."""
    grasp, cluster, cut, whole = rng.random((count, 4)).T
    return Luck(grasp, cluster, cut, whole, rng.normal(size=count), rng.uniform(0.0, 2 * np.pi, count))


def attempt(
    model: Picking, tips: Array, fruit: Array, moved: Array, diameters: Array, others: Array, luck: Luck
) -> tuple[Flags, Flags, Flags]:
    """Let cups go to fruit, one after another.

    Args:
        model: The picking model.
        tips: True cups at the end of their rise, (picks, 3).
        fruit: True fruit at rest, (picks, 3).
        moved: How far pushes have moved each when its cup comes, (picks, 3).
        diameters: (picks,).
        others: Fruit that hangs and is not attempted here, (m, 3).
        luck: What chance decides.

    Returns:
        Whether each fruit was in the cup, whether its stalk was cut, and whether it came into the tube undamaged;
        (picks,) each.
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
    """Flags of fruit that the cup's wall meets when it takes ``fruit`` (3,): beside it or just below; (m,)."""
    away = near - fruit
    level = np.hypot(away[:, 0], away[:, 1])
    return np.asarray((level < model.outer + diameter / 2) & (away[:, 2] < diameter) & (away[:, 2] > -3 * diameter))


def pushes(model: Picking, fruit: Array, others: Array, luck: Luck) -> Array:
    """Displacements of ``others`` (m, 3) at once, by each cup that goes to ``fruit`` (picks, 3): (picks, m, 3), m.

    It falls off with distance. The share `lasting` stays; the rest swings as the branch does, and dies away.
    """
    push = model.push * np.exp(model.push_spread * luck.push)
    distance = np.linalg.norm(fruit[:, None] - others[None], axis=-1)
    way = np.stack([np.cos(luck.heading), np.sin(luck.heading), np.zeros(len(fruit))], axis=-1)
    return np.asarray((coupling(model.branch, distance) * push[:, None])[..., None] * way[:, None])


def displacements(model: Picking, fruit: Array, masses: Array, entry: Array, luck: Luck) -> Array:
    """Displacement of each fruit by earlier cups when its own cup comes, (picks, 3), m.

    Args:
        model: The picking model.
        fruit: True fruit at rest, (picks, 3).
        masses: kg, (picks,).
        entry: Times at which the cups go in, ascending, (picks,), s.
        luck: What chance decides.
    """
    n = len(fruit)
    if n < 2:
        return np.zeros((n, 3))
    wait = entry[None, :] - entry[:, None]  # from push i to cup j
    start = pushes(model, fruit, fruit, luck) * (wait > 0)[..., None]
    swung, _ = swing(model.branch, start, np.zeros_like(start), np.broadcast_to(masses, (n, n)), np.maximum(wait, 0.0))
    return np.asarray((model.lasting * start + (1 - model.lasting) * swung).sum(axis=0))
