"""The fruit before a picking arm: where it hangs and is seen, how it is pushed, taken, twisted off and collected.

Everything is in the arm's base frame (m, s, N): the orchard frame turned by half a turn about z, so that trees stand at
-y. The tool is a cylinder below its point that opens upwards, and comes from below. Every random number is drawn at
the start, so that two policies meet the same fruit, the same camera and the same luck.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from pickenv import orchard as trees
from pickenv.arm import Array, Frame
from pickenv.arm.kinematics.forward import Scalar
from pickenv.base import InputError
from pickenv.envs.picking.pick_arm import UP, Reach
from pickenv.envs.shared.backends import Flags
from pickenv.envs.shared.spaces import box
from pickenv.envs.shared.task import Task, as_numbers, check_choice, check_count, check_number, make_task
from pickenv.orchard import DRAWS

FATES = ("attempted", "attached", "detached", "collected", "damaged")
CLOSE, OPEN = 0.5, -0.5
"""Commands beyond which the gripper closes and opens."""

ATTEMPTS, GIVEN_ATTEMPTS = 200, 10
"""Draws until a fruit is in reach; of given fruit only what the camera makes of it is drawn again."""


@dataclass(frozen=True, eq=False)
class PickSetting:
    """The kind of fruit before the arm, the camera that sees it and the gripper that takes it."""

    canopy: trees.Canopy
    fruit_map: trees.FruitMap
    size: trees.FruitSize
    camera: trees.Camera
    gripper: trees.Gripper
    branch: trees.Branch
    detachment: trees.Detachment
    station: trees.Station
    looks: int
    eyes: trees.Eyes | None
    order: str


ORDERS: dict[str, tuple[float, float, float] | None] = {
    "nearest": None,
    "lowest": (0.0, 0.0, 1.0),
    "highest": (0.0, 0.0, -1.0),
    "foremost": (0.0, -1.0, 0.0),
}
"""Orders of the fruit: the nearest to the believed tool, or the first along a direction of the base frame."""

PUBLISHED = "published"
"""The vision that goes by what is published of a camera; the others are those of `pickenv.orchard.VISIONS`."""


def to_base(orchard: PickSetting, positions: Array) -> Array:
    """Positions (..., 3) of the orchard frame in the base frame."""
    return _origin(orchard) + positions * [-1.0, -1.0, 1.0]


def to_orchard(orchard: PickSetting, positions: Array) -> Array:
    """Positions (..., 3) of the base frame in the orchard frame."""
    return np.asarray((positions - _origin(orchard)) * [-1.0, -1.0, 1.0])


def _origin(orchard: PickSetting) -> Array:
    station = orchard.station
    return np.array([station.middle, station.face, station.mount - orchard.canopy.bottom])


Contact = tuple[Array, Array, Array, Flags]
"""Fruit as it stands to a tool: the way from the tool's axis to each, m (..., n, 3), and its length (..., n); how far
the tool is inside the fruit, m, and whether it touches it (..., n)."""


def contact(station: trees.Station, positions: Array, diameters: Array, point: Array, axis: Array) -> Contact:
    """Contacts of fruit with a tool; every canopy gives each fruit the same bits, whatever else is in the arrays.

    Args:
        station: The tool.
        positions: Of the fruit, m, shape (..., n, 3).
        diameters: m, shape (..., n).
        point: The tool's point, m, shape (..., 3).
        axis: Its axis, shape (..., 3).
    """
    away = positions - point[..., None, :]
    along = _dot(away, axis[..., None, :])
    across = away - along[..., None] * axis[..., None, :]
    gap = np.sqrt(_dot(across, across))
    radius, high = diameters / 2, np.maximum(along, 0.0)
    wide = station.tool_radius + np.sqrt(np.maximum(radius * radius - high * high, 0.0))
    return across, gap, wide - gap, (gap < wide) & (along > -station.tool_length) & (along < radius)


def _dot(one: Array, other: Array) -> Array:
    return np.asarray(one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1] + one[..., 2] * other[..., 2])


FRUIT = np.dtype(
    [
        *((name, float, 3) for name in ("rest", "seen")),
        *((name, float) for name in ("diameters", "masses")),
        *((name, float, 3) for name in ("displacement", "velocity")),
        *((name, float) for name in ("chance", "pull_limit", "twist_limit")),
        *((name, bool) for name in ("visible", "reachable", *FATES)),
    ]
)
"""All that is known of one fruit; see `PickScene`."""

Fruit = NDArray[np.void]
"""Fruit, each of type `FRUIT`."""


class PickScene:
    """All fruit of an episode, and what has become of it; arrays with one entry per fruit.

    Attributes:
        orchard: What kind it is.
        fruit: All its numbers (n,); the others are parts of it.
        rest: Where it hangs, m, shape (n, 3).
        seen: Where the camera saw it, m, shape (n, 3).
        diameters: m.
        masses: kg.
        displacement: How far it hangs from its rest, m, shape (n, 3).
        velocity: m/s, shape (n, 3).
        chance: Uniform numbers that decide grasps.
        pull_limit: Pull that takes it off, N.
        twist_limit: Twist about its stem that does, N m.
        visible: Whether the camera found it.
        reachable: Whether it was found where the arm can get at it, with a free way from below.
        attempted: Whether the gripper has closed on it; likewise attached, detached, collected and damaged.
        held: Number of the fruit in the gripper, or None.
        miss: How far the last grasp was from its fruit, across and along the tool's axis, m.
        grip: Displacement of the fruit in the gripper less the tool's position, m.
        detached_at: Height of the believed tool when the fruit in it came off, m.
    """

    def __init__(self, orchard: PickSetting, fruit: Fruit) -> None:
        self.orchard = orchard
        self.held: int | None = None
        self.miss, self.grip, self.detached_at = (0.0, 0.0), np.zeros(3), 0.0
        self.fruit = fruit
        """Its own, or a part of an array of many canopies: what becomes of it is written there."""

    def __getattr__(self, name: str) -> NDArray[Any]:
        """The parts of `fruit`."""
        if name not in (FRUIT.names or ()):
            raise AttributeError(name)
        return self.fruit[name]

    @property
    def positions(self) -> Array:
        """Present positions of the fruit, m, (n, 3)."""
        return np.asarray(self.rest + self.displacement)

    @property
    def waiting(self) -> Flags:
        """Fruit that can still be tried."""
        return np.asarray(self.reachable & ~self.attempted)

    @property
    def holds_detached(self) -> bool:
        """Whether the gripper holds a fruit that is off its stem."""
        return self.held is not None and bool(self.detached[self.held])

    def following(self, tool: ArrayLike) -> int | None:
        """Number of the waiting fruit that comes next, as it was seen and from where the tool is, or None."""
        waiting = np.flatnonzero(self.waiting)
        if not waiting.size:
            return None
        away, along = self.seen[waiting] - np.asarray(tool), ORDERS[self.orchard.order]
        rank = np.einsum("ij,ij->i", away, away) if along is None else away @ along
        return int(waiting[np.argmin(rank)])

    def carry(self, point: Array, moved: Array) -> None:
        """Take the fruit in the gripper along, and its branch."""
        assert self.held is not None
        self._push(self.rest[self.held], moved)
        self.displacement[self.held] = self.grip + point
        self.velocity[self.held] = 0.0

    def meet(self, found: Contact, target: int, moved: Array, dt: float) -> None:
        """Push what the tool touches: neither what is off its stem nor what it holds."""
        across, gap, overlap, touched = found
        touched = touched & ~self.detached
        if self.held is not None:
            touched[self.held] = False
        touched[target] &= gap[target] > self.orchard.station.tool_radius  # what stands above the opening goes in
        speed = np.linalg.norm(moved) / dt if dt else 0.0
        for i in np.flatnonzero(touched):
            self._push(self.positions[i], across[i] / max(gap[i], 1e-9) * overlap[i])
            self.damaged[i] |= speed > self.orchard.station.bruise_speed

    def work_gripper(self, share: float, number: int, believed: Frame, tool: Frame) -> None:
        """Close the gripper on fruit ``number``, twist, open or empty it.

        Args:
            share: The command, -1 to 1.
            number: The fruit that the arm is after.
            believed: Frame of the believed tool: what the controller goes by.
            tool: Frame of the true one: what counts.
        """
        if self.held is None:
            near = math.dist(self.seen[number].tolist(), believed[9:]) <= self.orchard.station.near
            if share > CLOSE and near and self.waiting[number]:
                self.grasp(number, tool)
        elif share < OPEN:
            self.let_go()
        elif self.holds_detached:
            if believed[11] <= self.detached_at - self.orchard.station.collected_below:
                self.collect()
        else:
            self.twist(share)
            self.detached_at = believed[11]

    def grasp(self, i: int, tool: Frame) -> None:
        """Close the gripper on fruit ``i``: its one attempt."""
        point, axis = np.array(tool[9:]), np.array(tool[6:9])
        lateral, axial, angle = trees.misalignment(self.positions[i] - point, axis, UP)
        probability = trees.capture_probability(self.orchard.gripper, lateral, axial, angle, self.diameters[i])
        self.attempted[i] = True
        self.miss = float(lateral), float(axial)
        if self.chance[i] < float(probability):
            self.attached[i] = True
            self.held, self.grip = i, self.displacement[i] - point
            return
        away = self.positions[i] - point
        self._push(self.positions[i], self.orchard.station.knock * away / max(float(np.linalg.norm(away)), 1e-9))

    def twist(self, share: float) -> None:
        """Twist the fruit by a share of the gripper's largest torque; what is pulled or twisted enough comes off."""
        i, branch = self.held, self.orchard.branch
        assert i is not None
        spring = np.array([branch.stiffness_sideways] * 2 + [branch.stiffness_upright])
        pull = float(np.linalg.norm(spring * self.displacement[i]))
        torque = self.orchard.station.twist * max(share, 0.0)
        turned, torn = torque >= float(self.twist_limit[i]), pull >= float(self.pull_limit[i])
        self.detached[i] = turned or torn
        self.damaged[i] |= torn and not turned

    def let_go(self) -> None:
        """Open the gripper: a fruit on its stem swings back, a detached one falls."""
        if self.held is not None:
            self.damaged[self.held] |= self.detached[self.held]
            self.held = None

    def collect(self) -> None:
        """Take the detached fruit out of the gripper."""
        assert self.held is not None
        self.collected[self.held] = True
        self.held = None

    def _push(self, contact: Array, push: Array) -> None:
        """Displace the fruit around ``contact``; fruit in or past the gripper stays."""
        displacement = self.displacement + trees.pushed(self.orchard.branch, self.rest, contact, push)
        far = np.linalg.norm(displacement, axis=1, keepdims=True)
        self.displacement[:] = displacement * np.minimum(1.0, self.orchard.station.most_push / np.maximum(far, 1e-9))


def draw_scenes(
    orchard: PickSetting, reach: Reach, rngs: Sequence[np.random.Generator], given: Sequence[Any]
) -> list[PickScene]:
    """Draw the fruit of several episodes, each with at least one fruit in reach; ``reach`` is asked about all at once.

    Args:
        orchard: What kind of fruit.
        reach: Where the arm gets.
        rngs: For each episode the source of every random draw.
        given: For each episode fruit positions (n, 3) in the base frame, m, in place of drawn ones, or None.

    Raises:
        InputError: If none of the given fruit is found within reach, or none in many draws.
    """
    centres = [None if positions is None else _given_fruit(positions) for positions in given]
    scenes: dict[int, PickScene] = {}
    for attempt in range(ATTEMPTS):
        fresh: dict[int, PickScene] = {}
        for i, rng in enumerate(rngs):
            if i in scenes or (centres[i] is not None and attempt >= GIVEN_ATTEMPTS):
                continue
            scene = _seen_scene(orchard, rng, centres[i])
            if scene is not None:
                fresh[i] = scene
        if fresh:
            reached = reach(np.concatenate([scene.seen[scene.reachable] for scene in fresh.values()]))
            ends = np.cumsum([scene.reachable.sum() for scene in fresh.values()])[:-1]
            for (i, scene), inside in zip(fresh.items(), np.split(reached, ends), strict=True):
                scene.reachable[scene.reachable] = inside
                if inside.any():
                    scenes[i] = scene
        if len(scenes) == len(rngs):
            return [scenes[i] for i in range(len(rngs))]
    missing = next(i for i in range(len(rngs)) if i not in scenes)
    fruit = "none of the fruit given" if given[missing] is not None else f"no fruit in {ATTEMPTS} draws of the orchard"
    raise InputError(f"{fruit} is both seen and within the arm's reach from below; move the fruit or add some")


def _given_fruit(given: Any) -> Array:
    centres = np.atleast_2d(as_numbers("option fruit", given))
    if centres.ndim != 2 or centres.shape[-1] != 3 or not centres.size or not np.isfinite(centres).all():
        raise InputError(f"option fruit has shape {centres.shape}; give at least one finite position (n, 3) in m")
    return centres


def _seen_scene(orchard: PickSetting, rng: np.random.Generator, given: Array | None) -> PickScene | None:
    """Fruit drawn or given, and looked at; reachable is what is seen with a free way from below. None without fruit."""
    if given is None:
        positions, diameters = trees.sample_fruit(orchard.fruit_map, orchard.size, orchard.canopy, rng)
        if not len(positions):
            return None
    else:
        positions, diameters = to_orchard(orchard, given), trees.sample_diameters(orchard.size, len(given), rng)
    sightings, visible = looked_at(orchard, rng, positions, diameters)
    clear = trees.approach_clear(positions, diameters, UP, orchard.station.blocked, orchard.station.approach)
    fruit = np.zeros(len(positions), FRUIT)
    fruit["rest"], fruit["seen"] = to_base(orchard, positions), to_base(orchard, sightings)
    fruit["diameters"], fruit["masses"] = diameters, trees.fruit_masses(orchard.size, diameters)
    fruit["pull_limit"], fruit["twist_limit"] = trees.sample_strength(orchard.detachment, len(positions), rng)
    fruit["chance"] = rng.random(len(positions))
    fruit["visible"], fruit["reachable"] = visible, visible & clear
    return PickScene(orchard, fruit)


def looked_at(
    orchard: PickSetting, rng: np.random.Generator, positions: Array, diameters: Array
) -> tuple[Array, Flags]:
    """Positions of fruit as the camera sees it (n, 3), orchard frame, m, and flags of the fruit that it finds."""
    canopy, camera, count = orchard.canopy, orchard.camera, len(positions)
    viewpoint, ahead = np.array([0.0, -canopy.standoff, (canopy.bottom + canopy.top) / 2]), np.array([0.0, 1.0, 0.0])
    if orchard.eyes is not None:
        leaves = trees.foliage(orchard.eyes, rng)
        view, looks = (viewpoint, ahead), orchard.looks
        sight = trees.see(orchard.eyes, view, positions, diameters, rng, leaves=leaves, looks=looks)
        return sight.believed, sight.located
    visible, visible_side = trees.occlusion(canopy, positions, diameters, viewpoint)
    probability = trees.detection_probability(camera, np.linalg.norm(positions - viewpoint, axis=1), visible)
    draws = rng.normal(size=(count, DRAWS))
    draws[:, :3] /= np.sqrt(orchard.looks)  # averaging removes noise, but neither bias nor the pull of occlusion
    sightings = trees.measured_positions(
        camera,
        positions,
        viewpoint,
        draws,
        visible=visible,
        diameters=diameters,
        visible_side=visible_side,
    )
    return sightings, (rng.random(count) < probability) & trees.in_image(camera, positions, viewpoint, ahead)


# What `pickenv/Pick-v0` is made with: its arguments, checked, as a task of the arm and a setting of fruit.


LONGEST = 400
"""Steps of the time budget, whatever `max_episode_steps` says: the environment is not told of that."""
STILL = 1.0
"""Time without a command after which the observation says that the arm stands still, s."""
MOST_LEFT = 50
COLLECTED, DAMAGED, STEP = 1.0, -0.25, -0.002


def make_pick(
    plant: str = "orchard",
    without: Sequence[str] = (),
    gripper: str = "li_cup",
    camera: str = "laser_line",
    canopy: str = "li2016",
    fruit_map: str = "li2016_lab",
    fruit_size: str = "li2016",
    fruit: float = 10.0,
    looks: int = 16,
    vision: str = PUBLISHED,
    detector: str = "li2016",
    order: str = "nearest",
    arms: str = "fixed",
    tolerances: str = "medium",
    population: int = 256,
    population_seed: int = 0,
    out_of_range: str = "clip",
    **situation: Any,
) -> tuple[Task, PickSetting]:
    """Check the arguments (`pickenv/Pick-v0` explains them) and read the presets.

    Raises:
        InputError: If an argument is impossible; one sentence says which.
    """
    check_number("fruit", fruit, positive=True)
    check_count("looks", looks)
    arguments: dict[str, Any] = {"tolerances": tolerances, "population": population, "population_seed": population_seed}
    task = make_task(plant, without, arms=arms, out_of_range=out_of_range, **arguments, **situation)
    check_choice("order", order, tuple(ORDERS))
    if vision not in (PUBLISHED, *trees.VISIONS):
        raise InputError(f"unknown vision '{vision}'; give one of {', '.join((PUBLISHED, *trees.VISIONS))}")
    row, crop = trees.load_canopy(canopy), trees.load_fruit_map(fruit_map)
    station = trees.load_station("qiao2026")
    section = replace(
        row,
        width=min(station.width, row.width),
        depth=min(station.depth, row.depth),
        top=min(row.bottom + station.height, row.top),
    )
    return task, PickSetting(
        canopy=section,
        fruit_map=crop.scaled(fruit / section.width),
        size=trees.load_fruit_size(fruit_size),
        camera=trees.load_camera(camera),
        gripper=trees.load_gripper(gripper),
        branch=trees.load_branch("apple"),
        detachment=trees.load_detachment("apple"),
        station=station,
        looks=looks,
        eyes=None if vision == PUBLISHED else trees.load_eyes(vision, section, detector),
        order=order,
    )


def pick_spaces(task: Task) -> tuple[spaces.Box, spaces.Box]:
    """Observation and action space."""
    bounds = box([1.0] * task.joints + [task.reach] * 6 + [2 * task.reach] * 3 + [math.pi] * 3)
    low = np.concatenate([bounds.low, np.zeros(5, np.float32)])
    high = np.concatenate([bounds.high, np.ones(5, np.float32)])
    return spaces.Box(low, high, dtype=np.float32), spaces.Box(-1.0, 1.0, (task.joints + 1,), np.float32)


def pick_reward(collected: Scalar, damaged: Scalar) -> Scalar:
    """Reward of a step in which so much fruit was collected undamaged, and newly damaged."""
    return COLLECTED * collected + DAMAGED * damaged + STEP


# How an episode of `pickenv/Pick-v0` begins: everything that is drawn for it, from the environment's own generator.


PICK_OPTIONS = ("fruit", "start_joints", "arm")
"""Options of `reset`."""


PickStart = tuple[PickScene, int | None, int]
"""The draws of an episode: the fruit, the number of the true arm, None where there is but one, and the key of the
streams from which the situation is looked up."""


def draw_starts(
    task: Task,
    orchard: PickSetting,
    reach: Reach,
    rngs: Sequence[np.random.Generator],
    before: Sequence[int | None],
    fruit: Sequence[Any],
    arms: Sequence[int | None],
) -> list[PickStart]:
    """Draw the starts of episodes, each from its own generator; every sequence has one entry per episode.

    Args:
        task: The arm's task.
        orchard: What kind of fruit.
        reach: Where the arm gets.
        rngs: Sources of every random draw.
        before: Numbers of the true arms so far; with arms "per_env", one is drawn where it is None.
        fruit: Positions in place of drawn ones, as `reset` takes them, or None.
        arms: Numbers of arms in place of drawn ones, or None.

    Raises:
        InputError: If none of the fruit is within reach, or there is no such arm.
    """
    starts = []
    for scene, rng, arm, number in zip(draw_scenes(orchard, reach, rngs, fruit), rngs, before, arms, strict=True):
        if (task.arms != "fixed" or number is not None) and (arm is None or task.arms == "per_episode"):
            arm = int(rng.integers(task.population))
        if number is not None:
            arm = task.given_arm(number)
        starts.append((scene, arm, 0 if task.situation.plain else int(rng.integers(2**63))))
    return starts
