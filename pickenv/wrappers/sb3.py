"""The native vector environments for Stable-Baselines3, which has no adapter of its own for Gymnasium's `VectorEnv`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

import pickenv  # noqa: F401  (registers the environments)
from pickenv.errors import InputError
from pickenv.wrappers.compensation import CompensationVectorWrapper, Compensator

NUMBERS = ("position_error_mm", "attitude_error_deg", "noncompensable_deg", "compensable_deg")


def make_sb3_vec(id: str, num_envs: int, *, compensator: Compensator | None = None, **arguments: Any) -> Sb3Vec:
    """A registered environment, N at once, as a Stable-Baselines3 `VecEnv`.

    Args:
        id: For example "pickenv/Reach-v0".
        num_envs: N.
        compensator: Put between policy and arms, if given.
        arguments: Those of the environment.

    Example:
        >>> from pickenv.wrappers.sb3 import make_sb3_vec
        >>> from stable_baselines3 import PPO
        >>> model = PPO("MlpPolicy", make_sb3_vec("pickenv/Reach-v0", 16), n_steps=64, batch_size=256)
    """
    arguments.setdefault("autoreset_mode", AutoresetMode.SAME_STEP)
    envs: VectorEnv[Any, Any, Any] = gym.make_vec(id, num_envs=num_envs, **arguments)
    if compensator is not None:
        envs = CompensationVectorWrapper(envs, compensator)
    return Sb3Vec(envs)


class Sb3Vec(VecEnv):
    """A vector environment that begins episodes in the step that ends them, or when told to, as a `VecEnv`.

    `infos` of an episode's last step hold `terminal_observation`, `TimeLimit.truncated`, `is_success` and the errors in
    mm and degrees; those of other steps hold `TimeLimit.truncated` alone.

    Raises:
        InputError: If the environment's autoreset mode is "NextStep": Stable-Baselines3 would learn from the step that
            never was.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any]) -> None:
        self.envs = envs
        self.mode: AutoresetMode = envs.metadata["autoreset_mode"]
        if self.mode is AutoresetMode.NEXT_STEP:
            raise InputError("Stable-Baselines3 needs autoreset_mode 'SameStep' or 'Disabled', not 'NextStep'")
        self._actions: Any = None
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> Any:
        """Begin episodes in all environments, with the seeds and options that were set."""
        options = [entry for entry in self._options if entry]
        if options and any(entry != options[0] for entry in self._options):
            raise InputError("options differ between environments; give all the same")
        observations, _ = self.envs.reset(seed=self._seeds, options=options[0] if options else None)  # type: ignore[arg-type]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Act in all environments."""
        observations, rewards, terminations, truncations, given = self.envs.step(self._actions)
        dones = terminations | truncations
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        if dones.any():
            last, final = observations, given
            if self.mode is AutoresetMode.DISABLED:
                observations, _ = self.envs.reset(options={"reset_mask": dones})
            else:
                last, final = given["final_obs"], given["final_info"]
            for i in np.flatnonzero(dones):
                if self.mode is AutoresetMode.DISABLED and isinstance(last, dict):
                    terminal = {key: value[i].copy() for key, value in last.items()}
                else:
                    terminal = last[i] if isinstance(last[i], dict) else last[i].copy()
                infos[i] = {key: float(final[key][i]) for key in NUMBERS}
                infos[i]["terminal_observation"] = terminal
                infos[i]["TimeLimit.truncated"] = bool(truncations[i] and not terminations[i])
                infos[i]["is_success"] = bool(final["is_success"][i])
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """The environments' common attribute, once per index."""
        value = self.envs.get_wrapper_attr(attr_name) if hasattr(self.envs, "get_wrapper_attr") else None
        if value is None:
            value = getattr(self.envs.unwrapped, attr_name)
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Set an attribute of all environments.

        Raises:
            InputError: If it is meant for some of them only.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise InputError(f"{attr_name} belongs to all environments at once; set it for all of them")
        setattr(self.envs.unwrapped, attr_name, value)

    def env_method(
        self, method_name: str, *arguments: Any, indices: int | Iterable[int] | None = None, **named: Any
    ) -> list[Any]:
        """Call a method of the environments, once per index."""
        method = getattr(self.envs.unwrapped, method_name)
        return [method(*arguments, **named) for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: int | Iterable[int] | None = None) -> list[bool]:
        """Whether a wrapper is around the environments; single-environment wrappers never are."""
        found, env = False, self.envs
        while hasattr(env, "env"):
            found, env = found or isinstance(env, wrapper_class), env.env
        return [found] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """One picture per environment."""
        pictures: Any = self.envs.render()
        return [None] * self.num_envs if pictures is None else list(pictures)
