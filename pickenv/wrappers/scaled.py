"""What wrappers have in common that show a policy an observation, and take from it an action, in another scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray


class Rescaling(Protocol):
    """Formulas on observations ``(..., inputs)`` as the environment gives them."""

    @property
    def inputs(self) -> int:
        """Numbers in the environment's observation."""
        ...

    def shown(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """What the policy sees."""
        ...

    def act(self, values: NDArray[Any], actions: Any, most: float) -> NDArray[Any]:
        """What the environment gets for a policy's actions; what it refuses stays as it is."""
        ...

    def potential(self, values: NDArray[Any]) -> Any:
        """How near an observation is to the goal of the task, for shaping."""
        ...


class ScaledEnv(gym.Wrapper[Any, Any, Any, Any]):
    """An environment in another scale.

    Args:
        env: The environment.
        scaling: The formulas.
        space: What the policy sees.
        actions: What it answers, where that differs from the environment's.
        most: Largest size of an action's numbers that the environment takes.
        shaping: Discount of the learner, to whose rewards differences of the potential are added, or None.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        scaling: Rescaling,
        space: spaces.Box,
        most: float,
        actions: spaces.Box | None = None,
        shaping: float | None = None,
    ) -> None:
        gym.Wrapper.__init__(self, env)
        self.scaling, self._most, self._shaping = scaling, most, shaping
        self.observation_space = space
        if actions is not None:
            self.action_space = actions
        self.raw: Any = np.zeros(scaling.inputs, dtype=np.float32)
        """The observation as the environment gave it."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self.raw, info = self.env.reset(seed=seed, options=options)
        return self.scaling.shown(self.raw), info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Act in the policy's scale."""
        before = self.raw
        self.raw, reward, terminated, truncated, info = self.env.step(self.scaling.act(before, action, self._most))
        if self._shaping is not None:
            after = 0.0 if terminated else float(self.scaling.potential(self.raw))
            reward = float(reward) + self._shaping * after - float(self.scaling.potential(before))
        return self.scaling.shown(self.raw), reward, terminated, truncated, info


class ScaledVector(VectorWrapper[Any, Any, Any, Any, Any]):
    """Native vector environments in another scale; arguments as for `ScaledEnv`."""

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        scaling: Rescaling,
        space: spaces.Box,
        most: float,
        actions: spaces.Box | None = None,
        shaping: float | None = None,
    ) -> None:
        VectorWrapper.__init__(self, env)
        self.scaling, self._most, self._shaping = scaling, most, shaping
        self.single_observation_space = space
        self.observation_space = batch_space(space, self.num_envs)
        if actions is not None:
            self.single_action_space = actions
            self.action_space = batch_space(actions, self.num_envs)
        self.raw: Any = np.zeros((self.num_envs, scaling.inputs), dtype=np.float32)
        """The observations as the environments gave them."""
        self._idle = np.zeros(self.num_envs, dtype=np.bool_)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """The environments' mode, which torchrl asks the outermost wrapper for."""
        mode: AutoresetMode = self.metadata["autoreset_mode"]
        return mode

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes."""
        self.raw, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._idle[:] = False
        return self.scaling.shown(self.raw), infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Act in the policy's scale."""
        before = self.raw
        given = self.scaling.act(before, actions, self._most)
        self.raw, rewards, terminations, truncations, infos = self.env.step(given)
        last = self.raw
        if "final_obs" in infos:
            final, last = infos["final_obs"].copy(), np.array(self.raw)
            for i in np.flatnonzero(infos["_final_obs"]):
                last[i] = final[i]
                final[i] = self.scaling.shown(final[i])
            infos = infos | {"final_obs": final}
        if self._shaping is not None:
            after = np.where(terminations, 0.0, self.scaling.potential(last))
            gained = self._shaping * after - self.scaling.potential(before)
            rewards = rewards + np.where(self._idle, 0.0, gained)
            if self.env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
                self._idle = terminations | truncations  # the next step begins an episode
        return self.scaling.shown(self.raw), rewards, terminations, truncations, infos
