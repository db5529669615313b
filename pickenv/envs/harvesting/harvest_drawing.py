"""A harvester before its zone as a stage to draw: column, boom, slave arms with cups, fruit, trees, cameras.

What moves is the machine as built; the ghosts of its slaves show where the controller believes their cups to be.
Units: m; mm in words.
"""

from __future__ import annotations

import numpy as np

from pickenv.arm import Array
from pickenv.arm.plant.plant_batch import tree_map
from pickenv.envs.harvesting.harvest_batch import COLLECTED, HANGING, HarvestState
from pickenv.envs.harvesting.harvest_task import HarvestTask
from pickenv.envs.shared.arm_env import GHOST_WORDS, staged
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.envs.shared.task import Compensate
from pickenv.harvester import Machine
from pickenv.pictures.arm_shapes import (
    CUP_RADIUS,
    FAINT,
    GAIN,
    GHOST,
    JOINT,
    LINK,
    METAL,
    Solids,
    cup_solids,
    frustum_solids,
    joined_solids,
)
from pickenv.pictures.stage import SIZE, Balls, Eye, Mesh, Rods, Stage, Words, rgba
from pickenv.pictures.tree_shapes import (
    GREEN,
    MISSED_FRUIT,
    crate,
    fruit_colours,
    fruit_solids,
    ground_around,
    row_of_trees,
)

UP = np.array([0.0, 0.0, 1.0])


def draw_harvest(
    task: HarvestTask, states: HarvestState, compensate: Compensate | None, row: int = 0, dark: bool = False
) -> Stage:
    """One machine before its zone.

    Args:
        task: What stays the same.
        states: One machine or more.
        compensate: Maps nominal joints of whole machines to commands.
        row: The machine's number.
        dark: Whether the background is dark.
    """
    state: HarvestState = tree_map(lambda values: values[row : row + 1], states)
    machine, target = task.machine, state.joints
    command = target if compensate is None else compensate(target)
    believed = machine.tips(target[:, :3], _slaves(target, machine))[0]
    tips = task.true.tips(command[:, :3], _slaves(command, machine))[0]
    drawn_in = _slaves(command, machine).copy()
    drawn_in[..., 1:] = 0.0
    pivots = machine.tips(command[:, :3], drawn_in)[0]
    picked = int((state.status[0] == COLLECTED).sum())
    solids = joined_solids(
        _master(machine, command[0], pivots),
        slave_solids(pivots, tips, machine.body.radius / 2),
        _ghosts(pivots, tips + GAIN * (believed - tips), machine.body.radius / 2),
        *(cup_solids(tip, UP, CUP_RADIUS) for tip in tips),
        zone_fruit(state),
        crate(_eye(state), SIZE, picked, float(state.diameters[0].mean()), -machine.base_height),
        _cameras(task, command[0]),
    )
    seconds = float(state.periods[0]) * CONTROL_PERIOD
    words = (
        Words(f"picked {picked} of {int(state.reachable[0].sum())}", large=True),
        Words(f"missed {int(state.attempts[0]) - picked}"),
        Words(f"{seconds:.1f} s", "top right"),
        Words(GHOST_WORDS, "bottom left"),
    )
    return staged(solids, _surroundings(task, state, dark), _eye(state), words, None, dark)


def _slaves(joints: Array, machine: Machine) -> Array:
    return joints[:, 3:].reshape(len(joints), machine.arms, 3)


def _master(machine: Machine, joints: Array, pivots: Array) -> Solids:
    """Column, boom and the rail that the slaves hang on."""
    frame, foot = machine.frame3(joints[:3]), -machine.base_height
    axis, shoulder = np.array([0.0, 0.0, foot]), np.array([0.0, 0.0, frame[2]])
    ends = pivots[[0, -1]].copy()
    ends[:, 2] = frame[2]
    top = np.array([0.0, 0.0, float(machine.upper[1]) + machine.d1])
    start = np.stack([axis, shoulder, ends[0], *(np.array([*pivot[:2], frame[2]]) for pivot in pivots)])
    end = np.stack([top, frame, ends[1], *pivots])
    radius = np.array([0.05, 0.035, 0.03, *[0.022] * len(pivots)])
    colour = np.concatenate([rgba(METAL, 1), rgba(LINK, 2), rgba(METAL, len(pivots))])
    joints_at = np.stack([shoulder, frame])
    return Solids((Rods(start, end, radius, colour),), (Balls(joints_at, np.array([0.075, 0.05]), rgba(JOINT, 2)),))


def slave_solids(pivots: Array, tips: Array, radius: float) -> Solids:
    """Slave arms from their pivots to below their cups, each a tube with a rod in it."""
    ends = tips - 0.06 * UP
    half = pivots + 0.5 * (ends - pivots)
    count = len(tips)
    tubes = Rods(pivots, half, np.full(count, radius), rgba(LINK, count))
    rods = Rods(half, ends, np.full(count, 0.6 * radius), rgba(METAL, count))
    return Solids((tubes, rods), (Balls(pivots, np.full(count, 1.3 * radius), rgba(JOINT, count)),))


def _ghosts(pivots: Array, tips: Array, radius: float) -> Solids:
    count = len(tips)
    rods = Rods(pivots, tips - 0.06 * UP, np.full(count, 0.8 * radius), rgba(GHOST, count, FAINT))
    return Solids((rods,), (Balls(tips - 0.03 * UP, np.full(count, 0.035), rgba(GHOST, count, FAINT)),))


def zone_fruit(state: HarvestState) -> Solids:
    """Fruit that hangs: ripe where it is in reach; lost fruit in another colour where it hung."""
    there = state.status[0] != COLLECTED
    colours = fruit_colours(state.fruit.shape[1])
    colours[~state.reachable[0]] = GREEN
    colours[(state.status[0] != HANGING) & (state.status[0] != COLLECTED)] = MISSED_FRUIT
    places = state.fruit[0] + state.moved[0]
    return fruit_solids(places[there], state.diameters[0][there], colours[there])


def _cameras(task: HarvestTask, joints: Array) -> Solids:
    """The stereo pair that looked at the zone from the aisle, before the machine came."""
    frame = task.machine.frame3(joints[:3])
    eye = np.array([frame[0], 0.0, frame[2]])
    return frustum_solids(eye, np.array([0.0, -1.0, 0.0]), (0.6, 0.45), 0.3, (110, 96, 160))


def _surroundings(task: HarvestTask, state: HarvestState, dark: bool) -> tuple[Mesh, ...]:
    """Ground, and the trees of the zone."""
    canopy, height = task.orchard.canopy, -task.machine.base_height
    middle = np.round(state.fruit[0].mean(axis=0), 1)
    low = (float(middle[0]) - 0.6, -canopy.standoff - canopy.depth, max(float(middle[2]) - 0.5, height + 0.3))
    high = (float(middle[0]) + 0.6, -canopy.standoff, float(middle[2]) + 0.6)
    trees = row_of_trees(low, high, canopy.leaf_area_per_volume, height)
    return (ground_around(0.0, -0.5, height, dark), *trees)


def _eye(state: HarvestState) -> Eye:
    """From behind the machine, to its side and above it; it stays where it is during a zone."""
    fruit = state.fruit[0].mean(axis=0)
    target = np.array([0.45 * fruit[0], 0.62 * fruit[1], 0.95 * fruit[2]])
    return Eye(target + np.array([1.75, 1.9, 0.75]), target, 34.0)
