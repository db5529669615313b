"""The native vector environments as stable-baselines3 sees them, with the scaling of `agents.scaling` in between."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from agents.scaling import Scaling
from pickenv.envs.vector import ReachVectorEnv


class NativeVecEnv(VecEnv):
    """A native vector environment with ``autoreset_mode="SameStep"`` for stable-baselines3.

    Args:
        env: The environment.
        scaling: Where given, observations and actions of a flat environment are scaled; goal observations never are,
            as hindsight needs them as they were measured (`agents.sac_policy` scales inside the networks).
    """

    def __init__(self, env: ReachVectorEnv, scaling: Scaling | None = None) -> None:
        self.env, self.scaling = env, scaling
        space = env.single_observation_space
        if scaling is not None:
            space = spaces.Box(-np.inf, np.inf, (scaling.features,), dtype=np.float32)
        super().__init__(env.num_envs, space, env.single_action_space)
        self.render_mode = None
        self._raw: Any = None
        self._actions: NDArray[np.float32] = np.zeros((env.num_envs, env.task.joints), dtype=np.float32)
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)

    def reset(self) -> Any:
        """Begin episodes in all environments, with the seeds given to `seed` if there are any."""
        seeds = [None if seed is None else int(seed) for seed in self._seeds]
        self._raw, _ = self.env.reset(seed=None if seeds.count(None) else seeds)
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        return self._shown(self._raw)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Remember the actions."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Take the step."""
        actions = self._actions
        if self.scaling is not None:
            actions = np.clip(actions, -1.0, 1.0) * self.scaling.share(self._raw, np)
        self._raw, rewards, terminations, truncations, given = self.env.step(actions)
        self._returns += rewards
        self._lengths += 1
        dones = terminations | truncations
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if dones.any():
            last = given["final_info"]
            for i in np.flatnonzero(dones):
                infos[i] = {
                    "terminal_observation": self._shown(given["final_obs"][i]),
                    "TimeLimit.truncated": bool(truncations[i] and not terminations[i]),
                    "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i]), "t": 0.0},
                    "is_success": bool(last["is_success"][i]),
                    "position_error_mm": float(last["position_error_mm"][i]),
                }
            self._returns[dones], self._lengths[dones] = 0.0, 0
        return self._shown(self._raw), np.asarray(rewards, dtype=np.float32), dones, infos

    def state(self) -> dict[str, Any]:
        """Everything that the next step depends on, as arrays."""
        raw = self._raw if isinstance(self._raw, dict) else {"flat": self._raw}
        own = {"returns": self._returns, "lengths": self._lengths} | {f"raw/{k}": v for k, v in raw.items()}
        return {k: np.array(v) for k, v in own.items()} | {f"env/{k}": v for k, v in self.env.state_arrays().items()}

    def take_state(self, state: dict[str, Any]) -> None:
        """The inverse of `state`."""
        self._returns, self._lengths = np.array(state["returns"]), np.array(state["lengths"])
        raw = {key.partition("/")[2]: np.array(value) for key, value in state.items() if key.startswith("raw/")}
        self._raw = raw.get("flat", raw)
        self.env.take_state_arrays({key[4:]: value for key, value in state.items() if key.startswith("env/")})

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The environment's attribute, once per index."""
        return [getattr(self.env, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all environments at once."""
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **named: Any) -> list[Any]:
        """Call a method of the environment, once: all are one."""
        return [getattr(self.env, method_name)(*arguments, **named)] * len(self._rows(indices))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False] * len(self._rows(indices))

    def _rows(self, indices: Any) -> Sequence[int]:
        return list(self._get_indices(indices))

    def _shown(self, observation: Any) -> Any:
        if self.scaling is not None:
            return np.asarray(self.scaling.observe(observation, np), dtype=np.float32)
        return (
            {key: value.copy() for key, value in observation.items()} if isinstance(observation, dict) else observation
        )
