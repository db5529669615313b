"""`pickenv/Harvest-v0` for PettingZoo, in which the master and each slave arm are agents (extra ``harvest``).

The simulator is the same as in the Gymnasium environment. Each agent moves its three joints. It observes the whole
machine, followed by a one-hot vector that says which agent it is. All agents get the same reward.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pettingzoo  # type: ignore[import-untyped,import-not-found,unused-ignore]
from numpy.typing import ArrayLike, NDArray

from pickenv.envs.harvesting.harvest_env import LONGEST, HarvestEnv
from pickenv.envs.harvesting.harvest_task import HarvestTask, harvest_spaces
from pickenv.envs.shared.arm_env import Information, Options, begun, checked_render_mode
from pickenv.envs.shared.task import Compensate, check_choice, check_count, checked_action

Observations = dict[str, NDArray[np.float32]]


class HarvestParallelEnv(pettingzoo.ParallelEnv[str, NDArray[np.float32], NDArray[np.float32]]):  # type: ignore[misc]
    """`pickenv/Harvest-v0` with several agents: ``master``, and at most six slaves, ``slave_0`` to ``slave_5``.

    Slaves are counted from left to right, as seen by someone who looks from the machine at the trees.

    Each agent's action space is a `Box(-1, 1, (3,))` of joint increments.

    Args:
        max_cycles: Periods after which an episode is truncated.
        render_mode: None or "rgb_array".
        arguments: Arguments of `pickenv.envs.harvesting.harvest_env.HarvestEnv`.
    """

    metadata = {"name": "harvest_v0", "render_modes": ["rgb_array"], "is_parallelizable": True}  # noqa: RUF012

    def __init__(self, *, max_cycles: int = LONGEST, render_mode: str | None = None, **arguments: Any) -> None:
        """See the class."""
        check_count("max_cycles", max_cycles)
        self._env = HarvestEnv(render_mode=checked_render_mode(render_mode, ("rgb_array",)), **arguments)
        self.task: HarvestTask = self._env.task
        self.max_cycles, self.render_mode = max_cycles, render_mode
        self.possible_agents = ["master", *(f"slave_{i}" for i in range(self.task.machine.arms))]
        self.agents: list[str] = []
        self.compensator: Compensate | None = None
        observations = harvest_spaces(self.task, extra=len(self.possible_agents))[0]
        self._observations = {name: deepcopy(observations) for name in self.possible_agents}
        self._actions = {name: gym.spaces.Box(-1.0, 1.0, (3,), np.float32) for name in self.possible_agents}
        self._shared: NDArray[np.float32] | None = None

    def observation_space(self, agent: str) -> gym.spaces.Box:
        """Return the observation space of an agent, always the same object."""
        return self._observations[agent]

    def action_space(self, agent: str) -> gym.spaces.Box:
        """Return the action space of an agent, always the same object."""
        return self._actions[agent]

    def reset(self, seed: int | None = None, options: Options = None) -> tuple[Observations, dict[str, Information]]:
        """Start an episode in a new zone; `HarvestEnv` explains the options.

        An option named "options", which PettingZoo's own tests give to every environment, is ignored.
        """
        of_zone = {name: value for name, value in (options or {}).items() if name != "options"}
        self._shared, info = self._env.reset(seed=seed, options=of_zone)
        self.agents = list(self.possible_agents)
        return self._seen(), self._told(info)

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], dict[str, Information]]:
        """Move all agents' joints for one period; agents without an action do not move.

        Raises:
            InputError: If an action is not three finite numbers, an action is for an unknown agent, or `reset` was not
                called before.
        """
        state = begun(self._env.state, "step")
        if not self.agents:
            return {}, {}, {}, {}, {}
        for name in actions:
            check_choice("the agent of an action", name, tuple(self.possible_agents))
        still: ArrayLike = np.zeros(3)
        parts = [checked_action(actions.get(name, still), (3,), self.task.most_action) for name in self.possible_agents]
        self._env.compensator = self.compensator
        self._shared, reward, over, _, info = self._env.step(np.concatenate(parts))
        late, names = bool(state.periods[0] >= self.max_cycles), self.agents
        if over or late:
            self.agents = []
        ends = (dict.fromkeys(names, over), dict.fromkeys(names, late))
        return self._seen(), dict.fromkeys(names, reward), *ends, self._told(info)

    def state(self) -> NDArray[np.float32]:
        """Return the part of the observation that all agents share, for centralised training.

        Raises:
            InputError: If `reset` was not called before.
        """
        return begun(self._shared, "state").copy()

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of the whole machine ``(height, width, 3)`` as in `pickenv/Harvest-v0`.

        Without a render mode return None.
        """
        self._env.compensator = self.compensator
        return None if self.render_mode is None else cast(NDArray[np.uint8], self._env.render())

    def _seen(self) -> Observations:
        shared = self.state()
        mine = np.eye(len(self.possible_agents), dtype=np.float32)
        return {name: np.append(shared, mine[i]).astype(np.float32) for i, name in enumerate(self.possible_agents)}

    def _told(self, info: Information) -> dict[str, Information]:
        return {name: dict(info) for name in self.possible_agents}


pettingzoo.register("parallel", "pickenv/Harvest-v0", entry_point=HarvestParallelEnv, max_cycles=LONGEST)
