"""The native vector version of `pickenv/Harvest-v0`: many zones in one set of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.plant.tree import tree_map
from pickenv.envs.harvesting import harvest_batch as batch
from pickenv.envs.harvesting.harvest_batch import HarvestState
from pickenv.envs.harvesting.harvest_env import LONGEST
from pickenv.envs.harvesting.harvest_task import HarvestTask, harvest_spaces, make_harvest_task
from pickenv.envs.harvesting.harvest_zone import AS_DRAWN, OPTIONS, GivenZones, given_zones
from pickenv.envs.shared.drawn_env import checked_render_mode, drawn
from pickenv.envs.shared.plain_spec import PlainSpec
from pickenv.envs.shared.spaces import final_rows, given_mask, given_options, given_seeds
from pickenv.envs.shared.task import Compensate, checked_action
from pickenv.errors import InputError

Information = dict[str, Any]
Rows = NDArray[np.intp]


class HarvestVectorEnv(PlainSpec, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many harvesters at once; environment i is seeded with ``seed + i`` and does not depend on how many there are.

    Args:
        num_envs: Number of harvesters.
        max_episode_steps: Periods after which an episode is truncated.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or an `AutoresetMode`.
        render_mode: None or "rgb_array".
        arguments: As for `pickenv.envs.harvesting.harvest_env.HarvestEnv`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int = LONGEST,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """See the class."""
        if num_envs < 1:
            raise InputError(f"{num_envs} environments are impossible; give 1 or more")
        self.task: HarvestTask = make_harvest_task(**arguments)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 10, "autoreset_mode": self.autoreset_mode}
        self.num_envs, self.max_episode_steps = num_envs, max_episode_steps
        self.render_mode = checked_render_mode(render_mode, ("rgb_array",))
        self.single_observation_space, self.single_action_space = harvest_spaces(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.compensator: Compensate | None = None
        self.state: HarvestState | None = None
        self._rngs: list[np.random.Generator] = []
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Information]:
        """Start all episodes anew, or those in ``options["reset_mask"]``; other options are given once, or for each."""
        options = given_options(options, (*OPTIONS, "reset_mask"))
        mask = given_mask(options.get("reset_mask"), self.num_envs)
        self._seed(seed)
        rows = np.arange(self.num_envs) if self.state is None else np.flatnonzero(mask)
        self._restart(rows, given_zones(self.task, options, self.num_envs, rows))
        return self._observation(), self._information()

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], Information]:
        """One period of every harvester; those that are over start anew as the autoreset mode says.

        Raises:
            InputError: If actions are not finite or have another shape, or before the first reset.
        """
        values = checked_action(actions, (self.num_envs, self.task.machine.joints), self.task.most_action)
        if self.state is None:
            raise InputError("step was called before reset; call reset first")
        again = self._over.copy()
        if again.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise InputError("an episode is over; reset it with options={'reset_mask': ...} before the next step")
        rewards = np.zeros(self.num_envs)
        going = np.flatnonzero(~again)
        if going.size:
            some: HarvestState = tree_map(lambda values: values[going], self.state)
            rngs = [self._rngs[i] for i in going]
            rewards[going] = batch.step(self.task, some, values[going], rngs, self.compensator)
            self.state.put(going, some)
        if again.any():
            self._restart(np.flatnonzero(again))
        terminated = batch.finished(self.state) & ~again
        truncated = (self.state.periods >= self.max_episode_steps) & ~again
        self._over = terminated | truncated
        extra: Information = {}
        if self._over.any() and self.autoreset_mode is AutoresetMode.SAME_STEP:
            extra = self._last_words()
            self._restart(np.flatnonzero(self._over))
        return self._observation(), rewards, terminated, truncated, self._information() | extra

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One picture per harvester."""
        if self.render_mode is None:
            return None
        from pickenv.envs.harvesting.harvest_drawing import draw_harvest

        if self.state is None:
            raise InputError("render was called before reset; call reset first")
        stages = (draw_harvest(self.task, self.state, self.compensator, row=row) for row in range(self.num_envs))
        return tuple(map(drawn, stages))

    def _seed(self, seed: int | Sequence[int | None] | None) -> None:
        if seed is None and self._rngs:
            return
        given, old = given_seeds(seed, self.num_envs), self._rngs
        self._rngs = [old[i] if old and value is None else seeding.np_random(value)[0] for i, value in enumerate(given)]

    def _restart(self, rows: Rows, given: GivenZones = AS_DRAWN) -> None:
        fresh = batch.begin_zones(self.task, [self._rngs[i] for i in rows], given)
        if self.state is None:
            self.state = fresh
        else:
            self.state.put(rows, fresh)
        self._over[rows] = False

    def _observation(self) -> NDArray[np.float32]:
        assert self.state is not None
        return batch.observe(self.task, self.state)

    def _information(self) -> Information:
        assert self.state is not None
        found: Information = dict(batch.information(self.state))
        return found | {f"_{key}": np.ones(self.num_envs, dtype=bool) for key in found}

    def _last_words(self) -> Information:
        """Observations and information of the episodes that have just ended."""
        assert self.state is not None
        over = self._over.copy()
        observations = final_rows(self._observation(), np.flatnonzero(over), self.num_envs)
        known: Information = {k: np.where(over, v, 0) for k, v in batch.information(self.state).items()}
        known |= {f"_{key}": over.copy() for key in known}
        return {"final_obs": observations, "_final_obs": over, "final_info": known, "_final_info": over.copy()}
