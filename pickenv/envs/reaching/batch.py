"""Many reach tasks side by side on NumPy: their state, and what their arms do with an action each.

Rows of one table hold the components, columns the environments. Work goes through it in blocks that stay in the cache,
so that the cost per step does not grow with the number of environments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.dynamics import PlantState
from pickenv.arm.plant.plant import Plant
from pickenv.envs.reaching.reach_goal import goal_reward
from pickenv.envs.shared.arms import changed_plant, choose_arm, numbers_of, population_size
from pickenv.envs.shared.backends import NUMPY, Executor, Scalar
from pickenv.envs.shared.exact import exact_plant
from pickenv.envs.shared.simulation import (
    Components,
    Look,
    ReachState,
    begin,
    flat_observation,
    goal_attempt,
    goal_observation,
    look,
    move,
    nominal_frames,
    true_reward,
)
from pickenv.envs.shared.streams import GOAL, episode_key, stream_key
from pickenv.envs.shared.task import CONTROL_PERIOD, GOAL_ATTEMPTS, MOST_ACTION, Task, as_numbers
from pickenv.errors import InputError

BLOCK = 2048
"""Environments per block: a component of 16 KiB, of which a few fit into a core's first cache."""

Words = NDArray[np.uint64]
Rows = NDArray[np.intp]
Compensate = Callable[[Array], Array]


class Start(NamedTuple):
    """How episodes are to begin, one entry per environment that begins one.

    Attributes:
        seeds: Streams' seeds.
        episodes: Numbers of the episodes.
        start: Joint targets ``(count, n)``, or None for mid-range.
        goal: Joints of wanted poses ``(count, n)``, or None to draw them.
        arm: Numbers of true arms ``(count,)``, or None to draw them.
    """

    seeds: Words
    episodes: Words
    start: Array | None = None
    goal: Array | None = None
    arm: NDArray[np.intp] | None = None


class Outcome(NamedTuple):
    """What many environments show, component by component, one column per environment; see `simulation.Look`.

    Attributes:
        observation: One array ``(k, count)`` per part of the observation, float32.
        reward: ``(count,)``.
        success: ``(count,)``.
        numbers: Distance (mm), angle (deg), its lost and its kept part (deg): ``(4, count)``.
        vectors: Pose error, joint command, true tool and fruit position: ``(12 + n, count)``; nothing without poses.
    """

    observation: tuple[Any, ...]
    reward: Any
    success: Any
    numbers: Any
    vectors: Any


class Batch:
    """The state of N reach tasks.

    Attributes:
        task: What all have in common.
        goal_dict: Whether observations are goal dictionaries, and rewards made of them.
        poses: Whether pose errors, commands and positions are given.
        count: N.
        arm: Number of each one's true arm.
    """

    def __init__(self, task: Task, count: int, goal_dict: bool, poses: bool) -> None:
        self.task, self.count, self.goal_dict, self.poses = task, count, goal_dict, poses
        self.x: Executor = NUMPY
        n = task.joints
        rest = begin(NUMPY, task, changed_plant(task.plant, _first), *_example(task))
        self._memory = [len(part) for part in rest.plant]
        self._table = np.zeros((n + 15 + sum(self._memory), count))
        self._keys = np.zeros(count, dtype=np.uint64)
        self.arm: NDArray[np.intp] = np.zeros(count, dtype=np.intp)
        self.plant: Plant = task.plant
        if task.arms != "fixed":
            self.plant = changed_plant(task.plant, lambda values: values[self.arm])
        self.plant = exact_plant(self.plant)
        self._blocks = [(a, min(a + BLOCK, count)) for a in range(0, count, BLOCK)]
        self._plants = [changed_plant(self.plant, lambda values, a=a, b=b: values[a:b]) for a, b in self._blocks]  # type: ignore[misc]

    def restart(self, rows: Rows, how: Start, compensate: Compensate | None) -> None:
        """Begin an episode in the environments ``rows``."""
        x, task, n = self.x, self.task, self.task.joints
        keys = self._keys[rows] = episode_key(x, how.seeds, how.episodes)
        if task.arms != "fixed":
            self._take_arms(rows, how, keys)
        for a, b in _blocks(len(rows)):
            some, key = rows[a:b], keys[a:b]
            start = _columns(how.start[a:b]) if how.start is not None else [np.full(b - a, v) for v in task.middle]
            joints = _columns(how.goal[a:b]) if how.goal is not None else list(self._draw_goals(key))
            goal = tuple(np.broadcast_to(v, b - a) for v in nominal_frames(x, task, joints)[1])
            plant = self._plant_of(some)
            state = begin(x, task, plant, key, start, goal, _commands(compensate, start))
            self._table[: n + 15, some] = [*state.target, *state.goal, *state.seen]
            self._remember(some, state.plant)

    def advance(
        self, actions: Array, moments: Words, live: NDArray[np.bool_] | None, compensate: Compensate | None
    ) -> Outcome:
        """Act in all environments.

        Args:
            actions: Component by component, ``(n, N)``.
            moments: Number of the step in each one's episode.
            live: Where it is False an episode has just begun: no time passes, and the action is ignored. None: nowhere.
            compensate: Turns joint targets into joint commands, or None.
        """
        out, n = self._empty(self.count), self.task.joints
        rested = np.empty(0, dtype=np.intp)
        if live is not None:
            actions = actions * live
            rested = np.flatnonzero(~live) if self.plant.has_state else rested
        before = self._table[:, rested]
        for (a, b), plant in zip(self._blocks, self._plants, strict=True):
            columns = slice(a, b)
            target = move(self.x, self.task, list(self._table[:n, columns]), list(actions[:, columns]))
            self._table[:n, columns] = target
            self._show(out, columns, columns, plant, compensate, moments[columns], CONTROL_PERIOD)
        if len(rested):  # a plant with memory must not live through a step that never was
            self._table[:, rested] = before
            self._scatter(out, rested, self.show(rested, compensate))
        return out

    def show(self, rows: Rows, compensate: Compensate | None) -> Outcome:
        """What the environments ``rows`` show at the beginning of their episodes."""
        out = self._empty(len(rows))
        for a, b in _blocks(len(rows)):
            some = rows[a:b]
            self._show(out, slice(a, b), some, self._plant_of(some), compensate, np.zeros(b - a, dtype=np.uint64), 0.0)
        return out

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that the next step depends on."""
        return {"table": self._table, "keys": self._keys, "arm": self.arm}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`."""
        self._table[:], self._keys[:], self.arm[:] = state["table"], state["keys"], state["arm"]
        if self.task.arms != "fixed":
            for mine, all_ in zip(numbers_of(self.plant), numbers_of(self.task.plant), strict=True):
                mine[:] = all_[self.arm]

    def scene(self, row: int, compensate: Compensate | None) -> tuple[Array, list[Any]]:
        """Joint target and everything that can be seen of one environment, on floats; no time passes."""
        where, n = np.array([row]), self.task.joints
        table = self._table[:, where]
        command = _commands(compensate, list(table[:n]))
        plant, moment = self._plant_of(where), np.zeros(1, dtype=np.uint64)
        _, scene = look(self.x, self.task, plant, self._state_of(table), command, self._keys[where], moment, 0.0)
        parts = [[float(np.ravel(v)[0]) for v in part] if isinstance(part, tuple) else float(part[0]) for part in scene]
        return table[:n, 0], parts

    def numbers_of_actions(self, actions: ArrayLike) -> Array:
        """Actions component by component ``(n, N)``, checked.

        Raises:
            InputError: If they have another shape, or numbers beyond -1 to 1.
        """
        ready = isinstance(actions, np.ndarray) and actions.dtype.kind == "f"  # nothing to convert, no copy
        values: Any = actions if ready else as_numbers("actions", actions)
        shape = (self.count, self.task.joints)
        if values.shape != shape:
            raise InputError(f"actions have shape {values.shape}; give {shape}, numbers between -1 and 1")
        numbers: Array = values.T.astype(np.float64, order="C")
        if not (numbers.max() <= MOST_ACTION and numbers.min() >= -MOST_ACTION):
            row = int(np.argmin((np.abs(numbers) <= MOST_ACTION).all(axis=0)))
            raise InputError(
                f"the action of environment {row} is {numbers[:, row]}; give finite numbers between -1 and 1"
            )
        return numbers

    @staticmethod
    def on_host(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Truth values as a NumPy array."""
        return flags

    @staticmethod
    def on_device(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Truth values where the executor wants them."""
        return flags

    @staticmethod
    def masked_rewards(rewards: Array, live: NDArray[np.bool_]) -> Array:
        """Rewards, zero where an episode has just begun."""
        return np.where(live, rewards, 0.0)

    @staticmethod
    def copied(out: Outcome) -> Outcome:
        """The same, in memory of its own."""
        return Outcome(tuple(part.copy() for part in out.observation), *(part.copy() for part in out[1:]))

    @classmethod
    def merged(cls, out: Outcome, rows: Rows, some: Outcome) -> Outcome:
        """What all show, with the environments ``rows`` replaced; in memory of its own."""
        out = cls.copied(out)
        cls._scatter(out, rows, some)
        return out

    @staticmethod
    def final_observations(observations: Any, rows: Rows) -> NDArray[np.object_]:
        """The observations of ``rows`` in an object array of all, as `SyncVectorEnv` gives them."""
        count = len(next(iter(observations.values()))) if isinstance(observations, dict) else len(observations)
        final = np.full(count, None, dtype=object)
        for row in rows:
            if isinstance(observations, dict):
                final[row] = {key: value[row].copy() for key, value in observations.items()}
            else:
                final[row] = observations[row].copy()
        return final

    def _show(
        self,
        out: Outcome,
        place: slice,
        where: Any,
        plant: Plant,
        compensate: Compensate | None,
        moments: Words,
        dt: float,
    ) -> None:
        """Let ``dt`` pass for the environments ``where``, and put what they show into ``out`` at ``place``."""
        table = self._table[:, where]
        state = self._state_of(table)
        command = _commands(compensate, state.target)
        memory, scene = look(self.x, self.task, plant, state, command, self._keys[where], moments, dt)
        self._remember(where, memory)
        for array, part in zip(out.observation, self._observation(scene), strict=True):
            for j, component in enumerate(part):
                array[j, place] = component
        if self.goal_dict:
            _, achieved, desired = out.observation
            out.reward[place] = goal_reward(self.task, achieved[:, place].T, desired[:, place].T)
        else:
            out.reward[place] = true_reward(self.x, self.task, scene)
        out.success[place] = scene.success
        numbers = (scene.distance_mm, scene.angle_deg, scene.lost_deg, scene.kept_deg)
        for row, value in zip(out.numbers, numbers, strict=True):
            row[place] = value
        if self.poses:
            for row, value in zip(out.vectors, (*scene.error, *scene.command, *scene.tool, *scene.fruit), strict=True):
                row[place] = value

    def _observation(self, scene: Look) -> tuple[Components, ...]:
        return goal_observation(scene) if self.goal_dict else (flat_observation(scene),)

    def _empty(self, count: int) -> Outcome:
        n = self.task.joints
        widths = (n + 6, 3, 3) if self.goal_dict else (n + 12 + 3 * self.task.camera,)
        return Outcome(
            observation=tuple(np.empty((width, count), dtype=np.float32) for width in widths),
            reward=np.empty(count),
            success=np.empty(count, dtype=np.bool_),
            numbers=np.empty((4, count)),
            vectors=np.empty((12 + n if self.poses else 0, count)),
        )

    @staticmethod
    def _scatter(out: Outcome, rows: Rows, some: Outcome) -> None:
        """Put what the environments ``rows`` show into what all show."""
        for all_, few in zip(out.observation, some.observation, strict=True):
            all_[:, rows] = few
        out.reward[rows], out.success[rows] = some.reward, some.success
        out.numbers[:, rows], out.vectors[:, rows] = some.numbers, some.vectors

    def _draw_goals(self, keys: Words) -> Array:
        """Joints ``(n, count)`` of the first pose of each stream whose tool points upwards."""
        task, streams = self.task, stream_key(self.x, keys, GOAL)
        joints, open_ = np.empty((task.joints, len(keys))), np.arange(len(keys))
        for attempt in range(GOAL_ATTEMPTS):
            tried, upright = goal_attempt(self.x, task, streams[open_], attempt)
            joints[:, open_] = tried
            open_ = open_[~upright]
            if not open_.size:
                return joints
        raise task.no_goal()

    def _take_arms(self, rows: Rows, how: Start, keys: Words) -> None:
        """Give the environments ``rows`` the true arms of their episodes."""
        task, size = self.task, population_size(self.task)
        if how.arm is not None:
            self.arm[rows] = how.arm
        else:
            chosen = episode_key(self.x, how.seeds, np.zeros_like(how.episodes)) if task.arms == "per_env" else keys
            self.arm[rows] = (choose_arm(self.x, chosen) * size).astype(np.intp)
        for mine, all_ in zip(numbers_of(self.plant), numbers_of(task.plant), strict=True):
            mine[rows] = all_[self.arm[rows]]

    def _plant_of(self, rows: Rows) -> Plant:
        return changed_plant(self.plant, lambda values: values[rows])

    def _state_of(self, table: Array) -> ReachState:
        n, parts, first = self.task.joints, [], self.task.joints + 15
        for length in self._memory:
            parts.append(tuple(table[first : first + length]))
            first += length
        target, goal, seen = tuple(table[:n]), tuple(table[n : n + 12]), tuple(table[n + 12 : n + 15])
        return ReachState(target, goal, seen, PlantState(*parts))

    def _remember(self, where: Any, memory: PlantState) -> None:
        rows = [component for part in memory for component in part]
        for row, component in enumerate(rows, start=self.task.joints + 15):
            self._table[row, where] = component


def _blocks(count: int) -> Iterator[tuple[int, int]]:
    return ((a, min(a + BLOCK, count)) for a in range(0, count, BLOCK))


def _columns(rows: Array) -> list[Array]:
    return [np.ascontiguousarray(column) for column in rows.T]


def _commands(compensate: Compensate | None, target: Sequence[Scalar]) -> Sequence[Scalar]:
    """What the drives get for joint targets."""
    return target if compensate is None else _columns(compensate(np.stack(target, axis=-1)))


def _first(values: Array) -> Array:
    return values[:1]


def _example(task: Task) -> tuple[Any, ...]:
    """Arguments of `begin` for one environment at mid-range: what a state consists of."""
    middle = [np.array([value]) for value in task.middle]
    goal = tuple(np.broadcast_to(v, 1) for v in nominal_frames(NUMPY, task, middle)[1])
    return np.zeros(1, dtype=np.uint64), middle, goal, middle
