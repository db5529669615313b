"""The state of many reach tasks, one array per number of the state, and the start of their episodes.

`Batch` works on any executor. Its subclasses `NumpyBatch` and `pickenv.envs.reaching.torch_batch.TorchBatch` choose the
kind of array and compute the steps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Plant, Scalar, Scalars, leaves
from pickenv.envs.shared import simulation
from pickenv.envs.shared.arm_batch import ArmBatch, Columns, NumpyArms, Words
from pickenv.envs.shared.backends import GOAL, Executor, Rows, episode_key, stream_key
from pickenv.envs.shared.task import GOAL_ATTEMPTS, Compensators, Task


class Views(NamedTuple):
    """All that is measured and true in many environments at one moment, with one column per environment.

    `simulation.View` has the same for a single environment.

    Attributes:
        observation: Parts of the observation, each an array ``(k, count)`` of float32.
        reward: Rewards ``(count,)``.
        success: Whether the fruit is inside the capture region, ``(count,)``.
        numbers: The errors that `simulation.NUMBER_KEYS` names, mm or deg, ``(4, count)``.
        vectors: The vectors of `simulation.View.vectors`, ``(12 + n, count)``. It has no rows, or is None, if
            `Batch.poses` is False.
    """

    observation: tuple[Scalar, ...]
    reward: Scalar
    success: Scalar
    numbers: Scalar
    vectors: Scalar


class Batch(ArmBatch, ABC):
    """The state of N reach tasks: the base class for all executors.

    Attributes:
        goal_dict: Whether observations are goal dictionaries, and rewards are computed from them.
        poses: Whether `Views` hold pose errors, joint commands and positions.
    """

    def __init__(self, task: Task, count: int, goal_dict: bool, poses: bool) -> None:
        super().__init__(task, count)
        self.goal_dict, self.poses = goal_dict, poses

    @abstractmethod
    def show(self, rows: Rows, compensate: Compensators | None) -> Views:
        """Return the `Views` of the environments ``rows`` (indices) at the beginning of their episodes.

        ``compensate`` turns joint targets into joint commands, or is None.
        """

    @abstractmethod
    def advance(self, actions: Scalar, moments: Words, compensate: Compensators | None) -> Views:
        """Act in all environments, and return their `Views` after one period.

        Args:
            actions: Actions component by component, ``(n, N)``.
            moments: Number of steps in each environment's episode, this one included, ``(N,)``.
            compensate: Turns joint targets into joint commands, or None.
        """

    def restart(
        self,
        rows: Rows,
        seeds: Words,
        episodes: Words,
        compensate: Compensators | None,
        start: Array | None = None,
        goal: Array | None = None,
        frames: Array | None = None,
        arm: NDArray[np.intp] | None = None,
    ) -> None:
        """Begin an episode in each of ``count`` environments.

        Args:
            rows: Indices of the environments ``(count,)``, from 0.
            seeds: Seeds of the environments' random streams ``(count,)``.
            episodes: Index of each environment's episode ``(count,)``, from 0.
            compensate: Turns joint targets into joint commands, or None.
            start: Joint targets ``(count, n)``, rad or m. With None they are drawn if the task has a spread of starts,
                else at mid-range.
            goal: Joints of wanted poses ``(count, n)``, or None.
            frames: Frames of wanted poses ``(count, 12)``, m, base frame, or None. Poses are drawn if neither ``goal``
                nor ``frames`` is given.
            arm: Indices (from 0) of true arms in the population ``(count,)``, or None to draw them.
        """
        x, task, places = self.x, self.task, self.indices(rows)
        keys = episode_key(x, self.words(seeds), self.words(episodes))
        self.keys[places] = keys
        if task.arms != "fixed":
            arms = simulation.drawn_arm(x, task, self.words(seeds), keys) if arm is None else arm
            self.take_arms(rows, self.host(arms).astype(np.intp))
        for a, b in self.blocks(len(rows)):
            some, key = places[a:b], keys[a:b]
            target = self.starts(key, None if start is None else start[a:b])
            if frames is None:
                joints = self._draw_goals(key) if goal is None else list(self.numbers(goal[a:b].T))
                wanted = simulation.nominal_frames(x, task, joints)[1]
            else:
                wanted = tuple(self.numbers(frames[a:b].T))
            command = self.commands(compensate, target, some)
            state = simulation.begin(x, task, self.plant_of(some), key, target, wanted, command)
            self.write(self.columns, some, state.columns)

    def scene(self, row: int, compensate: Compensators | None) -> simulation.View:
        """Return all that is measured and true in environment ``row`` (from 0) now, as Python floats; no time passes.

        ``compensate`` turns joint targets into joint commands, or is None.
        """
        place = self.indices(np.array([row]))
        state = self.state_of([column[place] for column in self.columns])
        command, key = self.commands(compensate, list(state.target), place), self.keys[place]
        _, scene = simulation.look(self.x, self.task, self.plant_of(place), state, command, key, key * 0, 0.0)
        plain = (tuple(map(self._float, part)) if isinstance(part, tuple) else self._float(part) for part in scene)
        return simulation.View(*plain)  # type: ignore[arg-type]

    def merged(self, out: Views, rows: Rows, some: Views) -> Views:
        """Return a copy of ``out`` in which ``some`` replaces the columns ``rows``.

        Args:
            out: `Views` of all environments.
            rows: Indices of environments, from 0.
            some: `Views` of these environments.
        """
        out, places = deepcopy(out), self.indices(rows)
        for all_, few in zip(leaves(out), leaves(some), strict=True):
            all_[..., places] = few
        return out

    def widths(self) -> tuple[int, ...]:
        """Return how many numbers each part of the observation has."""
        n, goal = self.task.joints, simulation.GOAL_NUMBERS
        return (n + 3, goal, goal) if self.goal_dict else (n + 12 + 3 * self.task.camera,)

    def parts(self, scene: simulation.View) -> tuple[simulation.Components, ...]:
        """Return the numbers of each part of the observation: observation and goals, or the flat observation alone."""
        return simulation.goal_observation(scene) if self.goal_dict else (simulation.flat_observation(scene),)

    def reward(self, x: Executor, scene: simulation.View, *goals: Scalars) -> Scalar:
        """Compute the reward from the goals, or from the tool's true error in ``scene`` if no goals are given.

        Args:
            x: The executor on which ``scene`` was measured.
            scene: All that is measured and true in the environments.
            goals: The achieved and the desired goal, as observations have them; or nothing.
        """
        return simulation.goal_reward(x, self.task, *goals) if goals else simulation.true_reward(x, self.task, scene)

    def _draw_goals(self, keys: Scalar) -> Columns:
        """Draw joints (n components) of a wanted pose for each of the episodes with the keys ``keys``.

        An episode gets the first pose of its random stream that fits the task.
        """
        task, streams = self.task, stream_key(self.x, keys, GOAL)
        joints = list(self.numbers(np.zeros((task.joints, len(keys)))))
        open_ = self.indices(np.arange(len(keys)))
        for attempt in range(GOAL_ATTEMPTS):
            tried, fits = simulation.goal_attempt(self.x, task, streams[open_], attempt)
            self.write(joints, open_, tried)
            open_ = open_[~(fits & (open_ >= 0))]
            if not len(open_):
                return joints
        raise task.no_goal()

    def _float(self, value: Scalar) -> float:
        return float(np.ravel(self.host(value))[0])


# Many reach tasks side by side on NumPy.


class NumpyBatch(NumpyArms, Batch):
    """The state of N reach tasks in NumPy arrays; arguments as in `pickenv.envs.reaching.batch.Batch`."""

    def __init__(self, task: Task, count: int, goal_dict: bool, poses: bool) -> None:
        super().__init__(task, count, goal_dict, poses)
        self.make_plants()
        self.make_room(12, 3)
        self.remake()

    def advance(self, actions: Array, moments: Words, compensate: Compensators | None) -> Views:
        """Act in all environments; see `Batch.advance`."""
        out = self._empty(self.count)
        for block, plant in zip(self._blocks, self._plants, strict=True):
            state = self.state_of([column[block] for column in self.columns])
            state = simulation.act(self.x, self.task, state, list(actions[:, block]))
            period = self.task.situation.value("period", state.drawn)
            self._show(out, block, block, state, plant, compensate, moments[block], period)
        return out

    def show(self, rows: Rows, compensate: Compensators | None) -> Views:
        """Return the `Views` of the environments ``rows`` at the beginning of their episodes; see `Batch.show`."""
        out = self._empty(len(rows))
        for a, b in self.blocks(len(rows)):
            some, still = rows[a:b], np.zeros(b - a, dtype=np.uint64)
            state = self.state_of([column[some] for column in self.columns])
            self._show(out, slice(a, b), some, state, self.plant_of(some), compensate, still, 0.0)
        return out

    def _show(
        self,
        out: Views,
        place: slice,
        where: Any,
        state: simulation.ArmState,
        plant: Plant,
        compensate: Compensators | None,
        moments: Words,
        dt: Scalar,
    ) -> None:
        """Simulate ``dt`` seconds for some environments, and write what is measured and true then into ``out``.

        Args:
            out: The arrays to write into.
            place: Columns of ``out`` to write.
            where: Indices or slice of the environments; ``state`` and ``plant`` hold their states and true arms.
            state: States of the environments.
            plant: True arms of the environments.
            compensate: Turns joint targets into joint commands, or None.
            moments: Number of steps in each environment's episode, 0 at its start.
            dt: Time, s.
        """
        x, task = self.x, self.task
        command = self.commands(compensate, list(state.target), where)
        state, scene = simulation.look(x, task, plant, state, command, self.keys[where], moments, dt)
        for array, part in zip(out.observation, self.parts(scene), strict=True):
            self.write(list(array), place, part)
        goals = (part[:, place].astype(np.float64) for part in out.observation[1:])
        out.reward[place] = self.reward(x, scene, *goals)
        out.success[place] = scene.success
        self.write(list(out.numbers), place, scene.numbers)
        if self.poses:
            self.write(list(out.vectors), place, scene.vectors)
        self.write(self.columns[: task.joints], where, state.target)
        self.write(self.columns[self.fixed :], where, state.columns[self.fixed :])

    def _empty(self, count: int) -> Views:
        return Views(
            observation=tuple(np.empty((width, count), dtype=np.float32) for width in self.widths()),
            reward=np.empty(count),
            success=np.empty(count, dtype=np.bool_),
            numbers=np.empty((4, count)),
            vectors=np.empty((12 + self.task.joints if self.poses else 0, count)),
        )
