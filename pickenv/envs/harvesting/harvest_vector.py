"""The native vector version of `pickenv/Harvest-v0`: many zones in one set of arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.plant.tree import tree_map
from pickenv.envs.harvesting import harvest_batch as batch
from pickenv.envs.harvesting.harvest_batch import HarvestState
from pickenv.envs.harvesting.harvest_env import LONGEST
from pickenv.envs.harvesting.harvest_task import OPTIONS, HarvestTask, given_zones, harvest_spaces, make_harvest_task
from pickenv.envs.shared.arm_env import Information
from pickenv.envs.shared.native_vector import Flags, NativeVectorEnv, Rows
from pickenv.envs.shared.task import checked_action

if TYPE_CHECKING:
    from pickenv.pictures.stage import Stage


class HarvestVectorEnv(NativeVectorEnv):
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
        self._set_spaces(*harvest_spaces(self.task))
        self.state: HarvestState

    def _checked(self, actions: ArrayLike) -> NDArray[Any]:
        return checked_action(actions, (self.num_envs, self.task.machine.joints), self.task.most_action)

    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        given = given_zones(self.task, options, self.num_envs, rows)
        fresh = batch.begin_zones(self.task, [self._rngs[i] for i in rows], given)
        if self._begun:
            self.state.put(rows, fresh)
        else:
            self.state = fresh

    def _act(self, actions: NDArray[Any], live: Flags) -> NDArray[Any]:
        rewards, rows = np.zeros(self.num_envs), np.flatnonzero(live)
        if rows.size:
            some: HarvestState = tree_map(lambda values: values[rows], self.state)
            rewards[rows] = batch.step(self.task, some, actions[rows], [self._rngs[i] for i in rows], self.compensator)
            self.state.put(rows, some)
        return rewards

    def _finished(self) -> Flags:
        return batch.finished(self.state)

    def _observation(self) -> NDArray[np.float32]:
        return batch.observe(self.task, self.state)

    def _information(self) -> Information:
        return dict(batch.information(self.state))

    def _stage(self, row: int) -> Stage:
        from pickenv.envs.harvesting.harvest_drawing import draw_harvest

        return draw_harvest(self.task, self.state, self.compensator, row=row)
