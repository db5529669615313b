"""The native vector version of `pickenv/Pick-v0`: many arms and canopies in one set of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pickenv import orchard as trees
from pickenv.arm import Array, Plant
from pickenv.base import InputError
from pickenv.envs.picking.pick import draw_pick
from pickenv.envs.picking.pick_arm import act_arm, apart_mm, look_at_arm, reach_of
from pickenv.envs.picking.pick_scene import (
    CLOSE,
    FATES,
    LONGEST,
    MOST_LEFT,
    PICK_OPTIONS,
    STILL,
    Contact,
    PickScene,
    PickSetting,
    PickStart,
    contact,
    draw_starts,
    make_pick,
    pick_reward,
    pick_spaces,
)
from pickenv.envs.shared.arm_batch import NumpyArms
from pickenv.envs.shared.arm_env import Information
from pickenv.envs.shared.backends import Flags, Rows, Scalar, state_of_words, words_of_state
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.native_vector import NativeVectorEnv
from pickenv.envs.shared.simulation import ArmState, begin
from pickenv.envs.shared.task import Compensate, Task
from pickenv.pictures.stage import Stage


class PickVectorEnv(NativeVectorEnv):
    """N environments `pickenv/Pick-v0` in one.

    Environment i is the same, number by number, as a single `pickenv/Pick-v0` with seed ``seed + i``, whatever N is: to
    the bit where that one calculates with `executor="numpy"`.

    `reset(options={"reset_mask": mask})` begins episodes where the mask is True and leaves the others alone; the other
    options are as in `pickenv/Pick-v0`, given once for all environments or once for each: "fruit" as ``(n, 3)`` or
    ``(N, n, 3)``, "start_joints" as ``(6,)`` or ``(N, 6)``, "arm" as a number or ``(N,)``.

    Args:
        num_envs: N.
        difficulty: A rung of the ladder, as in `pickenv/Reach-v0`.
        split: Its arms to learn on, or to be judged on.
        max_episode_steps: Steps after which an episode is truncated, or None for never.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or an `AutoresetMode`.
        render_mode: None or "rgb_array".
        arguments: Those of `pickenv/Pick-v0`.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> envs = gym.make_vec("pickenv/Pick-v0", num_envs=3, autoreset_mode="SameStep")
        >>> observations, infos = envs.reset(seed=1)
        >>> observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
        >>> observations.shape, infos["reachable"].tolist()
        ((3, 23), [5, 9, 2])

    Raises:
        InputError: If an argument is impossible.
    """

    options = PICK_OPTIONS

    def __init__(
        self,
        num_envs: int = 1,
        *,
        difficulty: str | None = None,
        split: str = "train",
        max_episode_steps: int | None = LONGEST,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        super().__init__(num_envs, max_episode_steps, autoreset_mode, render_mode)
        task, self.orchard = make_pick(**on_ladder("Pick", difficulty, split, arguments))
        self.task: Task = task
        self.metadata["render_fps"] = task.situation.frames_per_second
        self._reach = reach_of(task.plant.arm.nominal, self.orchard.station.approach)
        observations, actions = pick_spaces(task)
        self._set_spaces(observations, actions)
        self._bounds = observations.low, observations.high
        self.batch = PickBatch(task, self.orchard, self.num_envs)
        self._armed = np.zeros(self.num_envs, dtype=np.bool_)
        self._ahead: dict[int, tuple[Any, PickStart]] = {}
        """Episodes drawn ahead, and the states of the generators before."""

    @property
    def plant(self) -> Plant:
        """The true arm, or arms."""
        return self.batch.plant

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that the next step depends on, for a checkpoint."""
        states = [
            self._ahead[row][0] if row in self._ahead else rng.bit_generator.state for row, rng in enumerate(self._rngs)
        ]
        arrays: dict[str, NDArray[Any]] = {"elapsed": self._elapsed, "over": self._over, "armed": self._armed}
        arrays["rngs"] = np.array([words_of_state(state) for state in states], dtype=np.uint64)
        return {key: np.array(value) for key, value in (arrays | self.batch.state_arrays()).items()}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`, in an environment made with the same arguments."""
        self._rngs = [np.random.Generator(np.random.PCG64(0)) for _ in range(self.num_envs)]
        for rng, words in zip(self._rngs, state["rngs"], strict=True):
            rng.bit_generator.state = state_of_words(words)
        self._elapsed, self._over, self._armed = (state[key].copy() for key in ("elapsed", "over", "armed"))
        self._ahead, self._begun = {}, True
        self.batch.take_state_arrays(state)

    def _checked(self, actions: ArrayLike) -> Array:
        return np.asarray(np.clip(self.batch.numbers_of_actions(actions), -1.0, 1.0))

    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        joints, numbers = options.get("start_joints"), rows.tolist()
        if joints is not None:
            joints = self.task.given_joints("start_joints", joints, self.num_envs)[rows]
        for row in rows[seeded[rows]].tolist():
            self._ahead.pop(row, None)
        if options.get("fruit") is None and options.get("arm") is None and not seeded[rows].any() and self._armed.all():
            if not self._ahead.keys() >= set(numbers):
                self._draw_ahead()
            starts = [self._ahead.pop(row)[1] for row in numbers]
        else:
            for row in self._ahead.keys() & set(numbers):  # as if they had never been drawn
                self._rngs[row].bit_generator.state = self._ahead.pop(row)[0]
            starts = self._drawn(rows, options, seeded)
        self._armed[rows] = True
        self.batch.restart(rows, starts, joints, self.compensator)

    def _drawn(self, rows: Rows, options: Information, seeded: Flags) -> list[PickStart]:
        count = self.num_envs
        fruit, arms = _each(options, "fruit", count, 3), _each(options, "arm", count, 1)
        settled = self._armed & ~seeded
        numbers = rows.tolist()
        return draw_starts(
            self.task,
            self.orchard,
            self._reach,
            [self._rngs[row] for row in numbers],
            [int(self.batch.arm[row]) if settled[row] else None for row in numbers],
            [fruit[row] for row in numbers],
            [arms[row] for row in numbers],
        )

    def _draw_ahead(self) -> None:
        """Draw the next episodes of all environments that have none waiting, as soon as one needs it.

        Drawing many canopies takes little longer than drawing one, and nothing else draws from their generators.
        """
        rows = np.array([row for row in range(self.num_envs) if row not in self._ahead])
        before = [self._rngs[row].bit_generator.state for row in rows]
        starts = self._drawn(rows, {}, np.zeros(self.num_envs, dtype=np.bool_))
        self._ahead |= zip(rows.tolist(), zip(before, starts, strict=True), strict=True)

    def _act(self, actions: Array, live: Flags) -> NDArray[Any]:
        return self.batch.advance(actions, live, self.compensator)

    def _finished(self) -> Flags:
        return self.batch.finished()

    def _observation(self) -> NDArray[np.float32]:
        low, high = (np.asarray(bound, dtype=np.float32) for bound in self._bounds)
        return self.batch.observations(low, high)

    def _information(self) -> Information:
        return self.batch.information()

    def _stage(self, row: int) -> Stage:
        batch, nominal, n = self.batch, self.task.plant.arm.nominal, self.task.joints
        tool, pose = (tuple(batch.sight[part][:, row].tolist()) for part in (TOOL, BELIEVED))
        command = batch.sight[-n:, row]
        return draw_pick(nominal, command, tool, pose, batch.fruit.scenes[row], int(batch.number[row]), dark=False)


def _each(options: Information, name: str, count: int, rank: int) -> list[Any]:
    """An option for each environment: what was given once for all, or once for each."""
    values = options.get(name)
    if values is None or np.ndim(values) < rank:
        return [values] * count
    if len(values) != count:
        raise InputError(f"option {name} was given {len(values)} times; give it once, or {count} times")
    return list(values) if rank > 1 else [int(value) for value in values]


# Many picking arms before their canopies, side by side on NumPy. Units: m, rad, s.


BELIEVED, TOOL, TURN, TILT, SIGHT = slice(0, 12), slice(12, 24), slice(24, 27), 27, 28
"""Rows of what is seen of the arms; readings and commands follow."""

OWN = ("sight", "number", "still", "moments")


class PickBatch(NumpyArms):
    """The state of N picking arms.

    Attributes:
        fruit: What hangs before them.
        sight: What was seen of the arms last, component by component.
        number: Of the fruit that each is after.
        still: Time since each joint target moved, s.
        moments: Steps of each episode.
    """

    def __init__(self, task: Task, orchard: PickSetting, count: int) -> None:
        super().__init__(task, count, task.joints + 1)
        n = task.joints
        self.make_plants()
        self.make_room(0, 0)
        self.fruit = FruitTable(orchard, count)
        self.sight = np.zeros((SIGHT + 2 * n, count))
        self.number: Rows = np.zeros(count, dtype=np.int64)
        self.still, self.moments = np.full(count, STILL), np.zeros(count, dtype=np.uint64)

    def restart(
        self, rows: Rows, starts: Sequence[PickStart], joints: Array | None, compensate: Compensate | None
    ) -> None:
        """Begin an episode in the environments ``rows``, from joint targets ``(rows, n)`` if they are given."""
        x, task = self.x, self.task
        self.keys[rows] = keys = np.array([start.key for start in starts], dtype=np.uint64)
        if task.arms != "fixed":
            self.take_arms(rows, np.array([start.arm for start in starts], dtype=np.intp))
        self.still[rows], self.moments[rows] = STILL, 0
        for a, b in self.blocks(len(rows)):
            some = rows[a:b]
            targets = self.starts(keys[a:b], None if joints is None else joints[a:b])
            plant = self.plant_of(some)
            state = begin(x, task, plant, keys[a:b], targets, (), self.commands(compensate, targets), gripper=1)
            self._look(some, state, plant, compensate, 0.0)
        for row, start in zip(rows.tolist(), starts, strict=True):
            self.fruit.adopt(row, start.scene)
            self._choose(row)

    def advance(self, actions: Array, going: Flags, compensate: Compensate | None) -> Array:
        """Act in all environments; what happens to the fruit, and rewards, only in those that are ``going``."""
        point, before = self.sight[TOOL][9:], self.sight[TOOL][9:].T.copy()
        gripper, period = np.empty(self.count), np.empty(self.count)
        self.moments += np.uint64(1)
        for block, plant in zip(self._blocks, self._plants, strict=True):
            state = self.state_of([column[block] for column in self.columns])
            state, gripper[block], stirred, dt = act_arm(self.x, self.task, state, list(actions[:, block]))
            period[block] = dt
            self.still[block] = np.where(stirred, 0.0, np.minimum(STILL, self.still[block] + dt))
            self._look(block, state, plant, compensate, dt)
        fruit, tally = self.fruit, self.fruit.tally.copy()
        after, axis = point.T.copy(), self.sight[TOOL][6:9].T.copy()
        fruit.swing(going, period)
        fruit.meet(going, self.number, after, after - before, axis, period)
        self._work_grippers(np.flatnonzero(going & ((fruit.held >= 0) | (gripper > CLOSE))), gripper)
        collected, damaged = (fruit.tally - tally).T
        return np.where(going, pick_reward(collected, damaged), 0.0)

    def _work_grippers(self, rows: Rows, gripper: Array) -> None:
        poses, tool = (self.sight[part][:, rows].T.tolist() for part in (BELIEVED, TOOL))
        for i, row in enumerate(rows.tolist()):
            scene, number = self.fruit.scenes[row], int(self.number[row])
            scene.work_gripper(float(gripper[row]), number, poses[i], tool[i])
            self.fruit.note(row)
            if scene.held is None and not scene.waiting[number]:
                self._choose(row)

    def finished(self) -> Flags:
        """Environments with no fruit left to try and an empty gripper."""
        return (self.fruit.held < 0) & ~self.fruit.waiting().any(axis=1)

    def observations(self, low: NDArray[np.float32], high: NDArray[np.float32]) -> NDArray[np.float32]:
        """Observations of the controllers, ``(N, n + 17)``."""
        n, fruit = self.task.joints, self.fruit
        positions = fruit.seen[np.arange(self.count), self.number]
        out = np.empty((self.count, n + 17))
        out[:, :n] = self.sight[SIGHT : SIGHT + n].T
        out[:, n : n + 3] = tools = self.sight[BELIEVED][9:].T
        out[:, n + 3 : n + 6], out[:, n + 6 : n + 9] = positions, positions - tools
        out[:, n + 9 : n + 12] = self.sight[TURN].T
        out[:, n + 12], out[:, n + 13] = self.still, 1.0 - self.moments / LONGEST
        out[:, n + 14], out[:, n + 15] = (fruit.held >= 0) & ~fruit.off, fruit.off
        out[:, n + 16] = fruit.waiting().sum(axis=1) / MOST_LEFT
        return np.asarray(out.clip(low, high), dtype=np.float32)

    def information(self) -> dict[str, NDArray[Any]]:
        """The truth, as `pickenv/Pick-v0` explains it."""
        n, fruit, rows = self.task.joints, self.fruit, np.arange(self.count)
        tool, funnel = self.sight[TOOL][9:], fruit.funnel()
        positions = fruit.rest[rows, self.number] + fruit.displacement[rows, self.number]
        return {
            **funnel,
            "damaged": fruit.tally[:, 1].copy(),
            "is_success": funnel["collected"] == funnel["reachable"],
            "position_error_mm": apart_mm(self.x, list(positions.T.copy()), list(tool)),
            "grasp_lateral_mm": 1e3 * fruit.miss[:, 0],
            "grasp_axial_mm": 1e3 * fruit.miss[:, 1],
            "tilt_deg": self.sight[TILT].copy(),
            "joint_command": self.sight[SIGHT + n :].T.copy(),
            "tool_position": tool.T.copy(),
            "fruit_position": positions,
            "fruit_number": self.number.copy(),
        }

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that the next step depends on."""
        arrays = {name: getattr(self, name) for name in OWN}
        return super().state_arrays() | arrays | self.fruit.state_arrays()

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`."""
        super().take_state_arrays(state)
        for name in OWN:
            getattr(self, name)[:] = state[name]
        self.fruit.take_state_arrays(state)

    def _choose(self, row: int) -> None:
        """Go after the waiting fruit that comes next, or stay with the last one."""
        number = self.fruit.scenes[row].following(self.sight[BELIEVED][9:, row])
        self.number[row] = self.number[row] if number is None else number

    def _look(self, where: Any, state: ArmState, plant: Plant, compensate: Compensate | None, dt: Scalar) -> None:
        x, task = self.x, self.task
        command = self.commands(compensate, list(state.target))
        state, sight = look_at_arm(x, task, plant, state, command, self.keys[where], self.moments[where], dt)
        self.write(self.columns, where, state.columns)
        columns = [*sight.believed, *sight.tool, *sight.turn, sight.tilt, *sight.readings, *command]
        self.write(list(self.sight), where, columns)


# The fruit of many canopies in one set of arrays, of which each `PickScene` holds its own part. What happens to all
# fruit in every period goes through the arrays at once; what happens to one canopy now and then, a grasp or a push,
# goes through its scene. Both write the same numbers. Units: m, s.


FAR = 1e6
"""Coordinate of fruit that is not there: an array has room for the fullest canopy."""

NUMBERS = {"rest": 3, "seen": 3, "diameters": 0, "masses": 0, "displacement": 3, "velocity": 3}
EMPTY = {"rest": FAR, "masses": 1.0}
LOOSE = ("displacement", "velocity", *FATES)
"""Arrays that change during an episode."""
EACH = (*NUMBERS, "chance", "pull", "twist", "visible", "reachable", *FATES)
STAGES = ("visible", "reachable", "attempted", "attached", "detached")


class FruitTable:
    """The fruit before N arms, leading axes (N, most fruit of a canopy).

    Attributes:
        scenes: The canopies one by one; what changes in them are views of the arrays.
        held: Number of the fruit in each gripper, or -1.
        miss: How far each last grasp was from its fruit, across and along the tool's axis, (N, 2).
        off: Whether the fruit in the gripper is off its stem.
        tally: Fruit collected undamaged, and damaged, (N, 2).
    """

    rest: Array
    seen: Array
    diameters: Array
    masses: Array
    displacement: Array
    velocity: Array
    visible: Flags
    reachable: Flags
    attempted: Flags
    attached: Flags
    detached: Flags
    collected: Flags
    damaged: Flags

    def __init__(self, orchard: PickSetting, count: int) -> None:
        self.orchard, self.count = orchard, count
        self.scenes: list[Any] = [None] * count
        self.present = np.zeros(count, dtype=np.int64)
        self.held = np.full(count, -1)
        self.off = np.zeros(count, dtype=np.bool_)
        self.miss = np.zeros((count, 2))
        self.tally = np.zeros((count, 2), dtype=np.int64)
        self._make_room(1)

    def adopt(self, row: int, scene: PickScene) -> None:
        """Put a canopy into row ``row``."""
        n = len(scene.rest)
        if n > self.rest.shape[1]:
            self._make_room(n)
        for name in (*NUMBERS, "visible", "reachable", *FATES):
            array = getattr(self, name)
            array[row] = EMPTY.get(name, 0)
            array[row, :n] = getattr(scene, name)
        self.scenes[row], self.present[row] = scene, n
        self._lend(row)
        self.note(row)

    def note(self, row: int) -> None:
        """Write down what a grasp, a push or a twist has changed in a scene."""
        scene = self.scenes[row]
        self.held[row] = -1 if scene.held is None else scene.held
        self.off[row], self.miss[row] = scene.holds_detached, scene.miss
        self.tally[row] = scene.tally()

    def waiting(self) -> Flags:
        """Fruit that can still be tried."""
        return self.reachable & ~self.attempted

    def swing(self, going: Flags, dt: Array) -> None:
        """Let fruit swing for ``dt`` seconds, (N,), where it does."""
        moving = going & (self.displacement.any(axis=(1, 2)) | self.velocity.any(axis=(1, 2)))
        rows = np.flatnonzero(moving)
        if rows.size:
            self.displacement[rows], self.velocity[rows] = trees.swing(
                self.orchard.branch, self.displacement[rows], self.velocity[rows], self.masses[rows], dt[rows, None]
            )

    def meet(self, going: Flags, targets: Rows, point: Array, moved: Array, axis: Array, dt: Array) -> None:
        """Let each tool take along what it holds, and push what is in its way; arguments (N, ...)."""
        for row in np.flatnonzero(going & (self.held >= 0) & ~self.off).tolist():
            self.scenes[row].carry(point[row], moved[row])
        contacts = contact(self.orchard.station, self.rest + self.displacement, self.diameters, point, axis)
        for row in np.flatnonzero(going & contacts.touched.any(axis=1)).tolist():
            n = self.present[row]
            across, gap, overlap, touched = contacts
            mine = Contact(across[row, :n], gap[row, :n], overlap[row, :n], touched[row, :n])
            self.scenes[row].meet(mine, int(targets[row]), moved[row], float(dt[row]))
            self.note(row)

    def funnel(self) -> dict[str, NDArray[np.int64]]:
        """Fruit that got through each stage; none has more than the one before."""
        passed = {stage: getattr(self, stage).sum(axis=1) for stage in STAGES}
        return {"present": self.present.copy(), **passed, "collected": self.tally[:, 0].copy()}

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """All canopies, fruit by fruit, and what their grippers do."""
        fruit = [np.column_stack([_part(scene, name) for name in EACH]) for scene in self.scenes]
        grips = [
            [-1.0 if scene.held is None else scene.held, *scene.miss, *scene.grip, scene.detached_at]
            for scene in self.scenes
        ]
        return {"present": self.present, "each": np.concatenate(fruit), "grips": np.array(grips)}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`."""
        ends = np.cumsum(state["present"])[:-1]
        for row, (fruit, grip) in enumerate(zip(np.split(state["each"], ends), state["grips"], strict=True)):
            parts: dict[str, Any] = {}
            first = 0
            for name in EACH:
                width = NUMBERS.get(name, 0) or 1
                parts[name] = fruit[:, first : first + width].copy() if width > 1 else fruit[:, first].copy()
                first += width
            arguments = {name: parts[name] for name in ("rest", "diameters", "masses", "chance", "seen")}
            arguments |= {name: parts[name].astype(np.bool_) for name in ("visible", "reachable")}
            strength = trees.Strength(parts["pull"], parts["twist"])
            scene = PickScene(orchard=self.orchard, strength=strength, **arguments)
            for name in LOOSE:
                getattr(scene, name)[:] = parts[name]
            number, across, along, *others = grip.tolist()
            scene.held, scene.miss = None if number < 0 else int(number), (across, along)
            scene.grip, scene.detached_at = np.array(others[:3]), others[3]
            self.adopt(row, scene)

    def _make_room(self, most: int) -> None:
        for name, width in NUMBERS.items():
            fresh = np.full((self.count, most, width) if width else (self.count, most), EMPTY.get(name, 0.0))
            self._replace(name, fresh)
        for name in ("visible", "reachable", *FATES):
            self._replace(name, np.zeros((self.count, most), dtype=np.bool_))
        for row, scene in enumerate(self.scenes):
            if scene is not None:
                self._lend(row)

    def _replace(self, name: str, fresh: NDArray[Any]) -> None:
        old = getattr(self, name, None)
        if old is not None:
            fresh[:, : old.shape[1]] = old
        setattr(self, name, fresh)

    def _lend(self, row: int) -> None:
        n = self.present[row]
        for name in LOOSE:
            setattr(self.scenes[row], name, getattr(self, name)[row, :n])


def _part(scene: PickScene, name: str) -> Array:
    return np.asarray(getattr(scene.strength if name in ("pull", "twist") else scene, name), dtype=float)
