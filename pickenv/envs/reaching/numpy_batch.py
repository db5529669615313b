"""Many reach tasks side by side on NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Plant
from pickenv.envs.reaching.batch import Batch, Views
from pickenv.envs.shared.arm_batch import Flags, NumpyArms, Rows, Words
from pickenv.envs.shared.backends import Scalar
from pickenv.envs.shared.simulation import (
    ReachState,
    act,
    flat_observation,
    goal_observation,
    goal_reward,
    look,
    true_reward,
)
from pickenv.envs.shared.spaces import final_rows
from pickenv.envs.shared.task import Compensate, Task


class NumpyBatch(NumpyArms, Batch):
    """The state of N reach tasks in arrays; arguments as in `pickenv.envs.reaching.batch.Batch`."""

    def __init__(self, task: Task, count: int, goal_dict: bool, poses: bool) -> None:
        super().__init__(task, count, goal_dict, poses)
        self.make_plants()
        self.remember()

    def advance(self, actions: Array, moments: Words, live: Flags | None, compensate: Compensate | None) -> Views:
        """Act in all environments; see `Batch.advance`."""
        out, rested = self._empty(self.count), np.empty(0, dtype=np.intp)
        if live is not None:
            actions = actions * live
            rested = np.flatnonzero(~live) if self.remembers else rested
        before = [column[rested] for column in self.columns] if len(rested) else []
        self.step(out, actions, moments, compensate)
        if len(rested):  # a plant with memory must not live through a step that never was
            self.write(self.columns, rested, before)
            self.scatter(out, rested, self.show(rested, compensate))
        if live is not None:
            out.reward[~live] = 0.0
        return out

    def step(self, out: Views, actions: Array, moments: Words, compensate: Compensate | None) -> None:
        """Act in all environments, and put what they show into ``out``."""
        for block, plant in zip(self._blocks, self._plants, strict=True):
            state = self.state_of([column[block] for column in self.columns])
            state = act(self.x, self.task, state, list(actions[:, block]))
            period = self.task.situation.value("period", state.drawn)
            self._show(out, block, block, state, plant, compensate, moments[block], period)

    def show(self, rows: Rows, compensate: Compensate | None) -> Views:
        """What the environments ``rows`` show at the beginning of their episodes."""
        out = self._empty(len(rows))
        for a, b in self.blocks(len(rows)):
            some, still = rows[a:b], np.zeros(b - a, dtype=np.uint64)
            state = self.state_of([column[some] for column in self.columns])
            self._show(out, slice(a, b), some, state, self.plant_of(some), compensate, still, 0.0)
        return out

    def final_observations(self, observations: Any, rows: Rows) -> NDArray[np.object_]:
        """The observations of ``rows`` in an object array of all, as `SyncVectorEnv` gives them."""
        return final_rows(observations, rows, self.count)

    def _show(
        self,
        out: Views,
        place: slice,
        where: Any,
        state: ReachState,
        plant: Plant,
        compensate: Compensate | None,
        moments: Words,
        dt: Scalar,
    ) -> None:
        """Let ``dt`` pass for the environments ``where``, and put what they show into ``out`` at ``place``."""
        x, task = self.x, self.task
        command = self.commands(compensate, list(state.target))
        state, scene = look(x, task, plant, state, command, self.keys[where], moments, dt)
        parts = goal_observation(scene) if self.goal_dict else (flat_observation(scene),)
        for array, part in zip(out.observation, parts, strict=True):
            self.write(list(array), place, part)
        if self.goal_dict:  # of goals as they are returned
            goals = (part[:, place].astype(np.float64) for part in out.observation[1:])
            out.reward[place] = goal_reward(x, task, *goals)
        else:
            out.reward[place] = true_reward(x, task, scene)
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
