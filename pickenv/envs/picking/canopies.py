"""One or many picking arms and their canopies. One array holds all fruit, and each `PickScene` uses a part of it.

The swing of the fruit in every period is computed on the whole array. A grasp or a push in a single canopy is computed
by its scene, which changes the same array. Units: m, rad, s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured, unstructured_to_structured
from numpy.typing import NDArray

from pickenv import orchard as trees
from pickenv.arm import Array
from pickenv.envs.picking import pick_scene
from pickenv.envs.picking.pick_arm import BELIEVED, SIGHT, TILT, TOOL, TURN
from pickenv.envs.shared.arm_env import GHOST_WORDS, standing, tool_dial
from pickenv.envs.shared.backends import NUMPY, Flags, Rows
from pickenv.envs.shared.simulation import length
from pickenv.envs.shared.task import Task
from pickenv.pictures import shapes
from pickenv.pictures.stage import SIZE, Eye, Mesh, Stage, Words

ABSENT = np.zeros((), pick_scene.FRUIT)
ABSENT["rest"], ABSENT["masses"] = 1e6, 1.0

FUNNEL = ("visible", "reachable", "attempted", "attached", "detached", "collected", "damaged")
REACHABLE, ATTEMPTED, COLLECTED = (FUNNEL.index(stage) for stage in ("reachable", "attempted", "collected"))

OWN = ("sight", "number", "still", "moments")


class Canopies:
    """The fruit in front of N picking arms, and where the arms' tools are.

    A fruit's index counts from 0 in its canopy. M is the number of fruit in the fullest canopy.

    Attributes:
        scenes: The scene of each canopy, which works on its part of `fruit`.
        fruit: All fruit, (N, M). Records of absent fruit, far away, fill it up for canopies with less fruit than the
            fullest one.
        omega: Natural frequencies of the fruit along x, y, z, rad/s, (N, M, 3).
        present: Number of fruit in each canopy.
        held: Index of the fruit in each gripper, or -1.
        off: Whether the fruit in each gripper is detached from its stem.
        felt: Position of the fruit in each gripper as the gripper measures it, fruit minus tool, m, (N, 3).
        miss: Distance of the fruit from the tool at each arm's last grasp, across and along the tool's axis, m, (N, 2).
        counts: Number of fruit of each canopy that reached each stage of `FUNNEL`, (7, N); "collected" counts only
            undamaged fruit.
        sight: The tools' true and believed frames and the joint readings, in the layout of
            `pickenv.envs.picking.pick_arm.BELIEVED` to `SIGHT`, then the joint commands, (numbers, N).
        number: Index of the fruit that each arm is to pick next.
        still: Time since each joint target moved, s.
        moments: Number of steps in each episode so far.
        time: Simulated time of each episode so far, s.
        handling: Time in addition to `time`, which is not simulated, for grasps and for bringing fruit to the bin, s.
    """

    def __init__(self, task: Task, orchard: pick_scene.PickSetting, count: int) -> None:
        self.task, self.orchard, self.count = task, orchard, count
        self.scenes: list[Any] = [None] * count
        self.fruit = np.full((count, 1), ABSENT)
        self.omega = trees.natural_frequencies(orchard.branch, self.fruit["masses"])
        self.present = np.zeros(count, dtype=np.int64)
        self.held = np.full(count, -1)
        self.off = np.zeros(count, dtype=np.bool_)
        self.miss, self.felt = np.zeros((count, 2)), np.zeros((count, 3))
        self.counts = np.zeros((len(FUNNEL), count), dtype=np.int64)
        self.sight = np.zeros((SIGHT + 2 * task.joints, count))
        self.number: Rows = np.zeros(count, dtype=np.int64)
        self.still, self.moments = np.full(count, pick_scene.STILL), np.zeros(count, dtype=np.uint64)
        self.time, self.handling = np.zeros(count), np.zeros(count)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy or a pickle, and let its scenes work on its own array again."""
        vars(self).update(state)
        self._share()

    def _share(self) -> None:
        """Let each scene work on its part of `fruit`."""
        for scene, fruit, present in zip(self.scenes, self.fruit, self.present, strict=True):
            if scene is not None:
                scene.fruit = fruit[:present]

    def adopt(self, row: int, scene: pick_scene.PickScene) -> None:
        """Make ``scene`` the canopy of the arm with index ``row`` (from 0), and copy its fruit into `fruit`."""
        n = len(scene.rest)
        if n > self.fruit.shape[1]:
            before, self.fruit = self.fruit, np.full((self.count, n), ABSENT)
            self.fruit[:, : before.shape[1]] = before
            self.omega = trees.natural_frequencies(self.orchard.branch, self.fruit["masses"])
            self._share()
        self.fruit[row] = ABSENT
        self.fruit[row, :n] = scene.fruit
        self.omega[row] = trees.natural_frequencies(self.orchard.branch, self.fruit[row]["masses"])
        scene.fruit = self.fruit[row, :n]
        self.scenes[row], self.present[row] = scene, n
        self._note(row)

    def choose(self, row: int) -> None:
        """Set the fruit that the arm with index ``row`` (from 0) is to pick: the next one that can still be tried.

        If there is none, the present fruit stays.
        """
        number = self.scenes[row].following(self.sight[BELIEVED][9:, row])
        self.number[row] = self.number[row] if number is None else number

    def meet(self, going: Flags, before: Array, period: Array) -> None:
        """Let the fruit swing, let tools push fruit that they touch, and move held fruit with the grippers.

        Args:
            going: Flags of the arms whose episode continues, (N,).
            before: True tool positions at the beginning of the period, m, (N, 3).
            period: Time that passes, s, (N,).
        """
        fruit = self.fruit
        swinging = fruit["displacement"].any(axis=(1, 2)) | fruit["velocity"].any(axis=(1, 2))
        rows = np.flatnonzero(going & swinging)
        if rows.size:
            some = slice(None) if rows.size == self.count else rows
            apart, speed = fruit["displacement"][some], fruit["velocity"][some]
            fruit["displacement"][some], fruit["velocity"][some] = trees.swung(
                self.orchard.branch, apart, speed, self.omega[some], period[some, None, None]
            )
        point, axis = self.sight[TOOL][9:].T.copy(), self.sight[TOOL][6:9].T.copy()
        moved = point - before
        for row in np.flatnonzero(going & (self.held >= 0) & ~self.off).tolist():
            self.scenes[row].carry(point[row], moved[row])
        places = fruit["rest"] + fruit["displacement"]
        contacts = pick_scene.contact(self.orchard.station, places, fruit["diameters"], point, axis)
        for row in np.flatnonzero(going & contacts[-1].any(axis=1)).tolist():
            across, gap, overlap, touched = (part[row, : self.present[row]] for part in contacts)
            self.scenes[row].meet((across, gap, overlap, touched), int(self.number[row]), moved[row], period[row])
            self._note(row)

    def happen(self, going: Flags, before: Array, gripper: Array, stirred: Flags, period: Array) -> Array:
        """Compute the effects of the arms' moves on the fruit, and operate the grippers.

        Args:
            going: Flags of the arms whose episode continues, (N,); the fruit of all other arms does not change.
            before: True tool positions at the beginning of the period, m, (N, 3).
            gripper: The grippers' commands, -1 to 1, (N,).
            stirred: Whether each arm's joint target moved, (N,).
            period: Time that passes, s, (N,).

        Returns:
            Rewards, (N,).
        """
        so_far = self.counts[COLLECTED:].copy()
        self.still[:] = np.where(stirred, 0.0, np.minimum(pick_scene.STILL, self.still + period))
        self.time[:] = self.moments * period
        self.meet(going, before, period)
        for row in np.flatnonzero(going & ((self.held >= 0) | (gripper > pick_scene.CLOSE))).tolist():
            scene, number = self.scenes[row], int(self.number[row])
            scene.work_gripper(float(gripper[row]), number, *(self.sight[k, row].tolist() for k in (BELIEVED, TOOL)))
            self._note(row)
            if scene.held is None and not scene.waiting[number]:
                self.choose(row)
        collected, damaged = self.counts[COLLECTED:] - so_far
        return np.where(going, pick_scene.pick_reward(collected, damaged), 0.0)

    def finished(self) -> Flags:
        """Return flags (N,) of the arms with no fruit left to try and an empty gripper."""
        return np.asarray((self.held < 0) & (self._waiting() == 0))

    def observations(self, space: Any) -> NDArray[np.float32]:
        """Return the observations of `pickenv/Pick-v0`, clipped to the bounds of its ``space``, a box.

        They are ``(N, n + 17)`` for n joints, or ``(N, n + 20)`` with feedback from the gripper.
        """
        n = self.task.joints
        sight, tools = self.sight, self.sight[BELIEVED][9:]
        positions = self.fruit["seen"][np.arange(self.count), self.number].T
        time_left, untried = 1.0 - self.moments / pick_scene.LONGEST, self._waiting() / pick_scene.MOST_LEFT
        counters = (self.still, time_left, (self.held >= 0) & ~self.off, self.off, untried)
        felt = () if self.orchard.felt is None else (self.felt.T,)
        parts = (sight[SIGHT : SIGHT + n], tools, positions, positions - tools, sight[TURN], counters, *felt)
        return np.concatenate(parts).T.clip(space.low, space.high).astype(np.float32, order="C")

    def information(self) -> dict[str, NDArray[Any]]:
        """Return the infos of all arms, by the keys that `pickenv/Pick-v0` explains."""
        n, tool = self.task.joints, self.sight[TOOL][9:]
        mine = self.fruit[np.arange(self.count), self.number]
        positions = mine["rest"] + mine["displacement"]
        counts = self.counts.copy()
        return {
            "present": self.present.copy(),
            **dict(zip(FUNNEL, counts, strict=True)),
            "is_success": counts[COLLECTED] == counts[REACHABLE],
            "position_error_mm": 1e3 * length(NUMPY, list(positions.T - tool)),
            "duration_s": self.time + self.handling,
            "grasp_lateral_mm": 1e3 * self.miss[:, 0],
            "grasp_axial_mm": 1e3 * self.miss[:, 1],
            "tilt_deg": self.sight[TILT].copy(),
            "joint_command": self.sight[SIGHT + n :].T.copy(),
            "tool_position": tool.T.copy(),
            "fruit_position": positions,
            "fruit_number": self.number.copy(),
        }

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the next step depends on: `sight`, counters, all fruit, and what the grippers hold."""
        hands = zip(self.held, self.scenes, strict=True)
        grips = [[number, *scene.miss, *scene.grip, scene.detached_at] for number, scene in hands]
        each = structured_to_unstructured(np.concatenate([scene.fruit for scene in self.scenes]))
        own = {name: getattr(self, name) for name in OWN}
        return own | {"present": self.present, "each": each, "grips": np.array(grips)}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays that `state_arrays` returned."""
        for name in OWN:
            getattr(self, name)[:] = state[name]
        fruit = np.split(unstructured_to_structured(state["each"], pick_scene.FRUIT), np.cumsum(state["present"])[:-1])
        for row, (some, grip) in enumerate(zip(fruit, state["grips"].tolist(), strict=True)):
            scene = pick_scene.PickScene(self.orchard, some)
            number, across, along, *grips, scene.detached_at = grip
            scene.held, scene.miss = None if number < 0 else int(number), (across, along)
            scene.grip = np.array(grips)
            self.adopt(row, scene)

    def _waiting(self) -> NDArray[np.int64]:
        """Count the fruit of each canopy that can still be tried, (N,)."""
        return np.asarray(self.counts[REACHABLE] - self.counts[ATTEMPTED])

    def _note(self, row: int) -> None:
        """Update the arrays after a grasp, a push or a twist in the scene of the arm with index ``row`` (from 0)."""
        scene = self.scenes[row]
        self.counts[:, row] = [np.count_nonzero(scene.fruit[stage]) for stage in FUNNEL]
        self.handling[row] = self.orchard.station.handling(*self.counts[[ATTEMPTED, COLLECTED], row])
        self.counts[COLLECTED, row] = np.count_nonzero(scene.collected & ~scene.damaged)
        self.held[row] = -1 if scene.held is None else scene.held
        self.off[row], self.miss[row], self.felt[row] = scene.holds_detached, scene.miss, scene.felt


# A canopy and the arm that picks in it as a stage to draw. Units: m; mm in words.


CAMERA = (110, 96, 160)


def draw_pick(canopies: Canopies, row: int = 0, dark: bool = False) -> Stage:
    """Return what to draw for a picking arm: the arm, its ghost (the believed arm), gripper, camera, fruit and trees.

    Args:
        canopies: One or more arms in front of their canopies.
        row: Index of the arm to draw, from 0.
        dark: Whether the background is dark.
    """
    nominal, sight, scene = canopies.task.plant.arm.nominal, canopies.sight[:, row], canopies.scenes[row]
    orchard, number = scene.orchard, canopies.number[row]
    point, axis, command = sight[TOOL][9:], sight[TOOL][6:9], sight[SIGHT + canopies.task.joints :]
    collected, reachable = int(canopies.counts[COLLECTED, row]), int(scene.reachable.sum())
    offset = point - scene.positions[number]
    opening = orchard.station.tool_radius
    if orchard.gripper.kind == "cup":
        gripper = shapes.cup_solids(point, axis, opening)
    else:  # a hand around a usual fruit
        gripper = shapes.hand_solids(point, axis, opening, scene.held is not None)
    solids = shapes.joined_solids(
        shapes.arm_at_work(nominal, command, point, axis, sight[BELIEVED][9:]),
        gripper,
        canopy_fruit(scene),
        shapes.crate(pick_eye(orchard), SIZE, collected, float(np.mean(scene.diameters)), ground_of(orchard)),
        camera_solids(orchard),
    )
    words = (
        Words(f"picked {collected} of {reachable}", "top left", large=True),
        Words(f"missed {int((scene.attempted & ~scene.attached).sum())}", "top left"),
        Words(f"{1e3 * float(np.linalg.norm(offset)):.1f} mm from the fruit", "top right"),
        Words(GHOST_WORDS, "bottom left"),
    )
    still = (*standing(nominal, ground_of(orchard), dark), *trees_of(orchard))
    dial = tool_dial(axis, offset, 1e3 * orchard.gripper.tolerance)
    return Stage(pick_eye(orchard), *solids, still=still, words=words, dial=dial, dark=dark)


def canopy_fruit(scene: pick_scene.PickScene) -> shapes.Solids:
    """Return the solids of the fruit that hangs or is in the gripper.

    Reachable fruit has the colour of ripe fruit, and fruit out of reach is green. Fruit that the gripper closed on but
    did not take has a third colour.
    """
    present = ~scene.collected & ~(scene.damaged & scene.detached)
    if scene.held is not None:
        present[scene.held] = True
    colours = shapes.fruit_colours(len(scene.rest))
    colours[~scene.reachable] = shapes.GREEN
    colours[scene.attempted & ~scene.attached] = shapes.MISSED_FRUIT
    places, sizes = scene.positions[present], scene.diameters[present]
    return shapes.fruit_solids(places, sizes, colours[present], ~scene.detached[present])


def camera_solids(orchard: pick_scene.PickSetting) -> shapes.Solids:
    """Return the solids of the camera that looks at the canopy, and of its field of view."""
    canopy, camera = orchard.canopy, orchard.camera
    middle = (canopy.bottom + canopy.top) / 2
    eye = pick_scene.to_base(orchard, np.array([0.0, -canopy.standoff, middle]))
    ahead = pick_scene.to_base(orchard, np.array([0.0, 0.0, middle])) - eye
    half_angles = [side / 2 / camera.focal_length for side in camera.image]
    far = float(np.linalg.norm(ahead))
    return shapes.frustum_solids(eye, ahead / far, half_angles, 0.3 * far, CAMERA)


def trees_of(orchard: pick_scene.PickSetting) -> tuple[Mesh, ...]:
    """Return the meshes of the trees in the section of canopy that holds the fruit."""
    canopy = orchard.canopy
    ends = np.array([[-canopy.width / 2, 0.0, canopy.bottom], [canopy.width / 2, canopy.depth, canopy.top]])
    corners = pick_scene.to_base(orchard, ends)
    low, high = tuple(corners.min(axis=0).tolist()), tuple(corners.max(axis=0).tolist())
    return shapes.row_of_trees(low, high, canopy.leaf_area_per_volume, ground_of(orchard))


def ground_of(orchard: pick_scene.PickSetting) -> float:
    """Return the height of the ground in the arm's base frame, m."""
    return float(pick_scene.to_base(orchard, np.zeros(3))[2])


def pick_eye(orchard: pick_scene.PickSetting) -> Eye:
    """Return a viewpoint on the arm's side of the trees, which stand at negative y in the base frame.

    It is 1.35 m in x, 2.15 m in y and 0.75 m in z from the point looked at.
    """
    canopy = orchard.canopy
    target = 0.62 * pick_scene.to_base(orchard, np.array([0.0, 0.0, (canopy.bottom + canopy.top) / 2]))
    return Eye(target + np.array([1.35, 2.15, 0.75]), target)
