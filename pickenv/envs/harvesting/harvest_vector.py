"""The native vector version of `pickenv/Harvest-v0`: many zones in one set of arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.plant.plant_batch import tree_map
from pickenv.envs.harvesting import harvest_batch as batch
from pickenv.envs.harvesting.harvest_batch import HarvestState
from pickenv.envs.harvesting.harvest_env import LONGEST
from pickenv.envs.harvesting.harvest_task import OPTIONS, HarvestTask, given_zones, harvest_spaces, make_harvest_task
from pickenv.envs.shared.stream_vector import Flags, Information, Rows, StreamVectorEnv
from pickenv.envs.shared.task import Compensate, checked_action

if TYPE_CHECKING:
    from pickenv.pictures.stage import Stage


class HarvestVectorEnv(StreamVectorEnv):
    """Many harvesters at once; environment i is seeded with ``seed + i`` and does not depend on how many there are.

    Args:
        num_envs: Number of harvesters.
        max_episode_steps: Periods after which an episode is truncated, or None for never.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or an `AutoresetMode`.
        render_mode: None or "rgb_array".
        arguments: As for `pickenv.envs.harvesting.harvest_env.HarvestEnv`.
    """

    options = OPTIONS

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = LONGEST,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """See the class."""
        super().__init__(num_envs, max_episode_steps, autoreset_mode, render_mode)
        self.task: HarvestTask = make_harvest_task(**arguments)
        self.single_observation_space, self.single_action_space = harvest_spaces(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.compensator: Compensate | None = None
        self.state: HarvestState | None = None

    def _checked(self, actions: ArrayLike) -> NDArray[Any]:
        return checked_action(actions, (self.num_envs, self.task.machine.joints), self.task.most_action)

    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        given = given_zones(self.task, options, self.num_envs, rows)
        fresh = batch.begin_zones(self.task, [self._rngs[i] for i in rows], given)
        if self.state is None:
            self.state = fresh
        else:
            self.state.put(rows, fresh)

    def _act(self, actions: NDArray[Any], going: Flags) -> NDArray[Any]:
        rewards, rows = np.zeros(self.num_envs), np.flatnonzero(going)
        if rows.size:
            assert self.state is not None
            some: HarvestState = tree_map(lambda values: values[rows], self.state)
            rewards[rows] = batch.step(self.task, some, actions[rows], [self._rngs[i] for i in rows], self.compensator)
            self.state.put(rows, some)
        return rewards

    def _finished(self) -> Flags:
        assert self.state is not None
        return batch.finished(self.state)

    def _observation(self) -> NDArray[np.float32]:
        assert self.state is not None
        return batch.observe(self.task, self.state)

    def _information(self) -> Information:
        assert self.state is not None
        return dict(batch.information(self.state))

    def _stage(self, row: int) -> Stage:
        from pickenv.envs.harvesting.harvest_drawing import draw_harvest

        assert self.state is not None
        return draw_harvest(self.task, self.state, self.compensator, row=row)
