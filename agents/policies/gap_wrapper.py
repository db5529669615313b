"""The scaling of `gap` as a Gymnasium wrapper, for single environments and for RL Zoo's `env_wrapper`."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from pickenv.agents.policies.gap import Scaling
from pickenv.errors import InputError


class GapScaling(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """See the gap to the fruit by direction and logarithm, and act in shares of it.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.agents.policies.gap_wrapper import GapScaling
        >>> env = GapScaling(gym.make("pickenv/Reach-v0"))
        >>> env.reset(seed=0)[0].shape
        (13,)

    Change log:
     * v0.1.0 - Added.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        """Wrap a `pickenv/Reach-v0`.

        Raises:
            InputError: If its observations are not flat.
        """
        RecordConstructorArgs.__init__(self)
        gym.Wrapper.__init__(self, env)
        task = getattr(env.unwrapped, "task", None)
        if task is None or not isinstance(env.observation_space, spaces.Box):
            raise InputError("GapScaling reads flat observations; wrap a pickenv/Reach-v0 environment")
        self.scaling = Scaling(task.joints, task.camera)
        self.observation_space = spaces.Box(-np.inf, np.inf, (self.scaling.features,), dtype=np.float32)
        self._raw: NDArray[np.float32] = np.zeros(self.scaling.inputs, dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._raw, info = self.env.reset(seed=seed, options=options)
        return self._seen(), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Act in shares of the gap."""
        scaled = np.clip(action, -1.0, 1.0) * self.scaling.share(self._raw, np)
        self._raw, reward, terminated, truncated, info = self.env.step(scaled.astype(np.float32))
        return self._seen(), reward, terminated, truncated, info

    def _seen(self) -> NDArray[np.float32]:
        return np.asarray(self.scaling.observe(self._raw, np), dtype=np.float32)
