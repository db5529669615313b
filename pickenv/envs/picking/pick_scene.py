"""The fruit at a picking arm: its true and seen positions, and how it is pushed, taken, twisted off and collected.

Everything is in the arm's base frame (m, s, N). This frame is the orchard frame shifted and turned by half a turn about
z, so that trees stand at -y. The tool is a cylinder that opens upwards and approaches from below; its position is the
position of its upper end. All random numbers are drawn at the start of an episode, so that two policies meet the same
fruit and outcomes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from pickenv import orchard as trees
from pickenv.arm import Array, Frame, Scalar
from pickenv.base import InputError, check_known, shown
from pickenv.envs.picking.pick_arm import UP, Reach
from pickenv.envs.shared.backends import Flags
from pickenv.envs.shared.situation import MOST_HOURS
from pickenv.envs.shared.spaces import action_space, box
from pickenv.envs.shared.task import Task, as_numbers, check_choice, check_count, check_number, make_task, refuse_idle
from pickenv.orchard import DRAWS

FATES = ("attempted", "attached", "detached", "collected", "damaged")
CLOSE, OPEN = 0.5, -0.5

ATTEMPTS, GIVEN_ATTEMPTS = 200, 10


@dataclass(frozen=True, eq=False)
class PickSetting:
    """The orchard in front of the arm, the camera that sees its fruit, and the gripper that takes it.

    Attributes:
        canopy: The foliage in front of the arm.
        fruit_map: Distribution of the number of fruit along the row of trees.
        size: Diameter and density of fruit.
        camera: Errors of the camera that sees the fruit, unless `eyes` is given.
        gripper: Tolerances of the gripper.
        branch: The branch that fruit hangs from.
        detachment: Distribution of the loads that detach fruit.
        station: Where the canopy stands in the arm's base frame, and constants of the approach from below.
        looks: Number of images that the camera averages.
        eyes: The stereo pair that sees fruit instead of `camera`, or None.
        order: Order in which fruit is picked, a key of `ORDERS`.
        felt: Standard deviation per axis with which the gripper measures a held fruit's position, m; None if it
            measures nothing.
    """

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
    felt: float | None


ORDERS: dict[str, tuple[float, float, float] | None] = {
    "nearest": None,
    "lowest": (0.0, 0.0, 1.0),
    "highest": (0.0, 0.0, -1.0),
    "foremost": (0.0, -1.0, 0.0),
}

PUBLISHED = "published"
"""Value of the argument `vision` for a camera's published errors; `pickenv.orchard.VISIONS` has all other values."""


def to_base(orchard: PickSetting, positions: Array) -> Array:
    """Convert positions (..., 3), m, from the orchard frame to the base frame."""
    return _origin(orchard) + positions * [-1.0, -1.0, 1.0]


def to_orchard(orchard: PickSetting, positions: Array) -> Array:
    """Convert positions (..., 3), m, from the base frame to the orchard frame."""
    return np.asarray((positions - _origin(orchard)) * [-1.0, -1.0, 1.0])


def _origin(orchard: PickSetting) -> Array:
    station = orchard.station
    return np.array([station.middle, station.face, station.mount - orchard.canopy.bottom])


Contact = tuple[Array, Array, Array, Flags]


def contact(station: trees.Station, positions: Array, diameters: Array, point: Array, axis: Array) -> Contact:
    """Compute the contacts of fruit with a tool.

    The result for a fruit has the same bits whatever else is in the arrays.

    Args:
        station: The station, which has the tool's radius and length.
        positions: Positions of the fruit, m, shape (..., n, 3).
        diameters: Diameters of the fruit, m, shape (..., n).
        point: Position of the tool's upper end, m, shape (..., 3).
        axis: Unit vector in which the tool points, shape (..., 3).

    Returns:
        Four arrays. The first has the vector from the tool's axis to each fruit, m, (..., n, 3). The others have the
        shape (..., n). The second has the length of this vector, m. The third says how far the tool is inside the
        fruit, m. The fourth says whether the tool touches the fruit.
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
        *((name, float, 3) for name in ("rest", "seen", "noise")),
        *((name, float) for name in ("diameters", "masses")),
        *((name, float, 3) for name in ("displacement", "velocity")),
        *((name, float) for name in ("chance", "pull_limit", "twist_limit")),
        *((name, bool) for name in ("visible", "reachable", *FATES)),
    ]
)
"""Type of one fruit's record, with all its numbers and flags; `PickScene` explains them."""

Fruit = NDArray[np.void]  # of type `FRUIT`


class PickScene:
    """All fruit of one episode, with the present state of each. Arrays have one entry per fruit, in one order.

    Attributes:
        orchard: The orchard, the camera and the gripper.
        fruit: Records of all fruit (n,), which the scene changes in place: an array of its own, or a part of an array
            of many canopies. The attributes from `rest` to `damaged` are fields of it.
        rest: Where each fruit hangs at rest, m, shape (n, 3).
        seen: Where the camera saw the fruit, m, shape (n, 3).
        noise: Error of the gripper when it measures the fruit's position, m, shape (n, 3).
        diameters: Diameters of the fruit, m.
        masses: Masses of the fruit, kg.
        displacement: Present position of the fruit minus `rest`, m, shape (n, 3).
        velocity: Velocity of the fruit, m/s, shape (n, 3).
        chance: Uniform random numbers from 0 to 1. A grasp succeeds if its probability of success is above the fruit's
            number.
        pull_limit: Pull that takes the fruit off its stem, N.
        twist_limit: Torque about the stem that takes the fruit off, N m.
        visible: Whether the camera found the fruit.
        reachable: Whether the camera found the fruit, the arm reaches it there, and the way from below is free.
        attempted: Whether the gripper has closed on the fruit.
        attached: Whether the gripper took the fruit.
        detached: Whether the fruit came off its stem.
        collected: Whether the fruit is collected.
        damaged: Whether the fruit is damaged.
        held: Index (from 0) of the fruit in the gripper, or None.
        miss: Distance of the fruit from the tool at the last grasp, across and along the tool's axis, m.
        grip: The held fruit's `displacement` minus the tool's position, m, shape (3,); constant while it is held.
        detached_at: Height of the believed tool when the fruit in the gripper came off its stem, m.
    """

    def __init__(self, orchard: PickSetting, fruit: Fruit) -> None:
        self.orchard = orchard
        self.held: int | None = None
        self.miss, self.grip, self.detached_at = (0.0, 0.0), np.zeros(3), 0.0
        self.fruit = fruit

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Return the field ``name`` of `fruit`."""
        if name not in (FRUIT.names or ()):
            raise AttributeError(name)
        return self.fruit[name]

    @property
    def positions(self) -> Array:
        """Present positions of the fruit, m, (n, 3)."""
        return np.asarray(self.rest + self.displacement)

    @property
    def waiting(self) -> Flags:
        """Flags of the fruit that can still be tried."""
        return np.asarray(self.reachable & ~self.attempted)

    @property
    def holds_detached(self) -> bool:
        """Whether the gripper holds a fruit that is off its stem."""
        return self.held is not None and bool(self.detached[self.held])

    @property
    def felt(self) -> Array:
        """Position of the held fruit as the gripper measures it, fruit minus tool, m, (3,); zeros without a fruit."""
        return np.zeros(3) if self.held is None else self.rest[self.held] + self.grip + self.noise[self.held]

    def following(self, tool: ArrayLike) -> int | None:
        """Return the index (from 0) of the fruit to pick next, or None if no fruit can still be tried.

        ``tool`` is the position of the believed tool (3,), m. `ORDERS` gives a vector or None for the setting's order.
        With a vector (base frame), the fruit with the smallest coordinate along this vector is next. With None, the
        fruit nearest to the believed tool is next.
        """
        waiting = np.flatnonzero(self.waiting)
        if not waiting.size:
            return None
        away, along = self.seen[waiting] - np.asarray(tool), ORDERS[self.orchard.order]
        rank = np.einsum("ij,ij->i", away, away) if along is None else away @ along
        return int(waiting[np.argmin(rank)])

    def carry(self, point: Array, moved: Array) -> None:
        """Move the held fruit and its branch with the tool, whose upper end moved by ``moved`` to ``point`` (3,), m."""
        assert self.held is not None
        self._push(self.rest[self.held], moved)
        self.displacement[self.held] = self.grip + point
        self.velocity[self.held] = 0.0

    def meet(self, found: Contact, target: int, moved: Array, dt: float) -> None:
        """Push the fruit that the tool touches, except fruit off its stem and the fruit in the gripper.

        Args:
            found: Contacts of all fruit with the tool, from `contact`.
            target: Index (from 0) of the fruit to pick, which is not pushed if it is above the tool's opening.
            moved: Motion of the tool in the period (3,), m.
            dt: Length of the period, s.
        """
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
        """Operate the gripper: close it on fruit ``number``, twist, open it, or collect a fruit.

        Args:
            share: The command, -1 to 1: above `CLOSE` the gripper closes, below `OPEN` it opens.
            number: Index of the fruit to pick, from 0.
            believed: Frame of the believed tool, by which the controller decides what the gripper does.
            tool: The tool's true frame, which decides the outcome.
        """
        if self.held is None:
            near = math.dist(self.seen[number].tolist(), believed[9:]) <= self.orchard.station.near
            if share > CLOSE and near and self.waiting[number]:
                self.grasp(number, tool)
        elif share < OPEN:
            self.let_go()
        elif self.holds_detached:
            if believed[11] <= self.detached_at - self.orchard.station.collected_below:
                self.collected[self.held] = True
                self.held = None
        else:
            self.twist(share)
            self.detached_at = believed[11]

    def grasp(self, i: int, tool: Frame) -> None:
        """Close the gripper on the fruit with index ``i`` (from 0), which then cannot be tried again.

        ``tool`` is the tool's true frame.
        """
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
        """Twist the held fruit with ``share`` (0 to 1) of the largest torque; negative shares count as 0.

        The fruit comes off its stem if the torque or the branch's pull reaches the fruit's limit.
        """
        i, branch = self.held, self.orchard.branch
        assert i is not None
        spring = np.array([branch.stiffness_sideways] * 2 + [branch.stiffness_upright])
        pull = float(np.linalg.norm(spring * self.displacement[i]))
        torque = self.orchard.station.twist * max(share, 0.0)
        turned, torn = torque >= float(self.twist_limit[i]), pull >= float(self.pull_limit[i])
        self.detached[i] = turned or torn
        self.damaged[i] |= torn and not turned

    def let_go(self) -> None:
        """Open the gripper; a fruit on its stem swings back, a detached fruit falls and is damaged."""
        if self.held is not None:
            self.damaged[self.held] |= self.detached[self.held]
            self.held = None

    def _push(self, contact: Array, push: Array) -> None:
        """Displace the fruit around the point ``contact`` by ``push``, (3,) each, m.

        No fruit's displacement from rest exceeds the `most_push` of the orchard's `station`.
        """
        displacement = self.displacement + trees.pushed(self.orchard.branch, self.rest, contact, push)
        far = np.linalg.norm(displacement, axis=1, keepdims=True)
        self.displacement[:] = displacement * np.minimum(1.0, self.orchard.station.most_push / np.maximum(far, 1e-9))


def draw_scenes(
    orchard: PickSetting, reach: Reach, rngs: Sequence[np.random.Generator], given: Sequence[Any]
) -> list[PickScene]:
    """Draw the fruit of several episodes, each with at least one fruit in reach.

    Args:
        orchard: The orchard, the camera and the gripper.
        reach: Test of what the arm reaches, called for the fruit of all episodes at once.
        rngs: Random generator of each episode.
        given: For each episode fruit positions (n, 3) in the base frame, m, or None to draw them.

    Raises:
        InputError: If no draw of an episode has a fruit that is both seen and in reach. There are `ATTEMPTS` draws, or
            `GIVEN_ATTEMPTS` if positions are given, which stay the same in each draw.
    """
    centres = [None if positions is None else _given_fruit(positions) for positions in given]
    scenes: dict[int, PickScene] = {}
    for attempt in range(ATTEMPTS):
        open_ = [i for i, at in enumerate(centres) if i not in scenes and (at is None or attempt < GIVEN_ATTEMPTS)]
        drawn_scenes = ((i, _seen_scene(orchard, rngs[i], centres[i])) for i in open_)
        fresh = {i: scene for i, scene in drawn_scenes if scene is not None}
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
    """Make a scene of fruit, drawn or given, as the camera sees it; return None if no fruit was drawn.

    The flags `reachable` of this scene mark the fruit that is seen and has a free path from below, whether or not the
    arm reaches it.

    Args:
        orchard: The orchard, the camera and the gripper.
        rng: Random generator.
        given: Positions of the fruit (n, 3), m, base frame, or None to draw fruit.
    """
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
    if orchard.felt is not None:
        fruit["noise"] = orchard.felt * rng.normal(size=(len(positions), 3))
    return PickScene(orchard, fruit)


def looked_at(
    orchard: PickSetting, rng: np.random.Generator, positions: Array, diameters: Array
) -> tuple[Array, Flags]:
    """Simulate how the camera sees fruit.

    Args:
        orchard: The orchard, the camera and the gripper.
        rng: Random generator.
        positions: True positions (n, 3), orchard frame, m.
        diameters: Diameters (n,), m.

    Returns:
        The positions that the camera measures (n, 3), orchard frame, m, and flags (n,) of the fruit that it finds.
    """
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
        camera, positions, viewpoint, draws, visible=visible, diameters=diameters, visible_side=visible_side
    )
    return sightings, (rng.random(count) < probability) & trees.in_image(camera, positions, viewpoint, ahead)


# What `pickenv/Pick-v0` is made with: its arguments, checked, as a task of the arm and a setting of fruit.


LONGEST = 400
"""Number of steps by which the observed time budget is divided. The environment cannot know `max_episode_steps`."""
STILL = 1.0
"""Upper bound, in observations, of the time since the joint target last moved, s."""
MOST_LEFT = 50
COLLECTED, DAMAGED, STEP = 1.0, -0.25, -0.002

MOST_FELT = 0.1


OF_THE_ARM = ("without", "arms", "tolerances", "population", "population_seed", "out_of_range")


def make_pick(
    plant: str = "orchard",
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
    feedback: str = "encoders",
    grip_noise_mm: float = 1.0,
    **arguments: Any,
) -> tuple[Task, PickSetting]:
    """Check the arguments of a picking environment, which `pickenv/Pick-v0` explains.

    It also takes the arguments of `pickenv.envs.make_task` that `OF_THE_ARM` names.

    Returns:
        The arm's task, and the setting of fruit, camera and gripper.

    Raises:
        InputError: If an argument has a value that is not allowed. The message names the argument.
    """
    check_number("fruit", fruit, positive=True)
    check_count("looks", looks)
    check_choice("feedback", feedback, ("encoders", "gripper"))
    check_number("grip_noise_mm", grip_noise_mm)
    if idle := [name for name in signature(make_task).parameters if name in arguments and name not in OF_THE_ARM]:
        raise InputError(f"`{idle[0]}` has no effect on picking; leave it out")
    task = make_task(plant, **arguments)
    check_choice("order", order, tuple(ORDERS))
    check_known("vision", vision, (PUBLISHED, *trees.VISIONS))
    check_known("detector", detector, trees.DETECTORS)
    if feedback == "encoders":
        refuse_idle(make_pick, {"grip_noise_mm": grip_noise_mm}, "without feedback='gripper'; give that with it")
    of_sight: dict[str, Any] = {"detector": detector} if vision in (PUBLISHED, "ideal") else {}
    of_sight |= {} if vision == PUBLISHED else {"camera": camera}
    of_sight |= {"looks": looks} if vision == "ideal" else {}
    refuse_idle(make_pick, of_sight, f"with vision='{vision}'; leave it out, or give another vision")
    row, crop = trees.load_canopy(canopy), trees.load_fruit_map(fruit_map)
    station = trees.load_station("qiao2026")
    section = replace(
        row,
        width=min(station.width, row.width),
        depth=min(station.depth, row.depth),
        top=min(row.bottom + station.height, row.top),
    )
    return replace(task, gripper=1), PickSetting(
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
        felt=grip_noise_mm * 1e-3 if feedback == "gripper" else None,
    )


def pick_spaces(task: Task, orchard: PickSetting) -> tuple[spaces.Box, spaces.Box]:
    """Return the observation space and the action space.

    `MOST_FELT` bounds the observed position of a fruit in the gripper. The gripper takes no fruit that is farther off.
    """
    bounds = box([1.0] * task.joints + [task.reach] * 6 + [2 * task.reach] * 3 + [math.pi] * 3)
    felt = np.full(0 if orchard.felt is None else 3, MOST_FELT, np.float32)
    low = np.concatenate([bounds.low, np.zeros(5, np.float32), -felt])
    high = np.concatenate([bounds.high, np.ones(5, np.float32), felt])
    return spaces.Box(low, high, dtype=np.float32), action_space(task)


def pick_reward(collected: Scalar, damaged: Scalar) -> Scalar:
    """Compute the reward of a step from the numbers of fruit collected undamaged and of fruit newly damaged."""
    return COLLECTED * collected + DAMAGED * damaged + STEP


# How an episode of `pickenv/Pick-v0` begins: everything that is drawn for it, from the environment's own generator.


PICK_OPTIONS = ("fruit", "start_joints", "arm", "hours")


def given_hours(hours: Any, count: int | None = None) -> Array:
    """Check the hours that a reset option gives, and return them as an array.

    Args:
        hours: A number, or ``(count,)`` if ``count`` is given, h.
        count: Number of environments, or None for a single one.

    Returns:
        The hours, ``()``, or ``(count,)`` if ``count`` is given.

    Raises:
        InputError: If the shape is wrong, or a number is not from 0 to `MOST_HOURS`.
    """
    values = as_numbers("option hours", hours)
    shapes = ((), () if count is None else (count,))
    if values.shape not in shapes or not np.all((values >= 0) & (values <= MOST_HOURS)):
        each = "" if count is None else f", or {count} of them"
        raise InputError(f"option hours is {shown(hours)}; give a number from 0 to {MOST_HOURS:g}{each}")
    return values if count is None else np.broadcast_to(values, (count,))


PickStart = tuple[PickScene, int | None, int]


def draw_starts(task: Task, orchard: PickSetting, reach: Reach, episodes: Sequence[tuple[Any, ...]]) -> list[PickStart]:
    """Draw the starts of episodes, each from its own generator.

    Args:
        task: The arm's task.
        orchard: The orchard, the camera and the gripper.
        reach: Test of what the arm reaches.
        episodes: For each episode four values. The first is its random generator. The second is the index (from 0) of
            the true arm in the environment's last episode, or None. The third is fruit positions (n, 3), base frame, m,
            or None to draw fruit. The fourth is the index of the true arm that the user wants, or None. With
            `arms="per_env"` the arm of the last episode stays if there was one.

    Returns:
        Three values for each episode. The first is the fruit. The second is the index (from 0) of the true arm, or None
        if there is only one arm. The third is the key of the random streams of the situation (delays and noise).

    Raises:
        InputError: If no fruit is within reach, or the population has no arm with a given index.
    """
    rngs, before, fruit, arms = zip(*episodes, strict=True)
    starts = []
    for scene, rng, arm, number in zip(draw_scenes(orchard, reach, rngs, fruit), rngs, before, arms, strict=True):
        if (task.arms != "fixed" or number is not None) and (arm is None or task.arms == "per_episode"):
            arm = int(rng.integers(task.population))
        if number is not None:
            arm = task.given_arm(number)
        starts.append((scene, arm, 0 if task.situation.plain else int(rng.integers(2**63))))
    return starts
