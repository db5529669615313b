"""Adapter from Gymnasium's `VectorEnv` to Stable-Baselines3, which has no such adapter of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

import pickenv  # noqa: F401  (registers the environments)
from pickenv.base import InputError, seed_words, stream
from pickenv.base.container import named_part, part_of
from pickenv.envs.shared.native_vector import final_rows
from pickenv.wrappers.compensation import Compensate, CompensationVectorWrapper
from pickenv.wrappers.gap import ScaledVector


def make_sb3_vec(id: str, num_envs: int, *, compensator: Compensate | None = None, **arguments: Any) -> Sb3Vec:
    """Make N copies of a registered environment as one Stable-Baselines3 `VecEnv`.

    Args:
        id: Name of the environment, for example "pickenv/Reach-v0".
        num_envs: Number N of copies.
        compensator: A calibration's compensator, to correct joint targets for the drives, or None.
        arguments: Arguments of the environment.

    Example:
        >>> from pickenv.wrappers.sb3 import make_sb3_vec
        >>> from stable_baselines3 import PPO
        >>> model = PPO("MlpPolicy", make_sb3_vec("pickenv/ReachScaled-v0", 64), n_steps=60, batch_size=960, gamma=0.9)
    """
    mode = {"autoreset_mode": arguments.pop("autoreset_mode", AutoresetMode.SAME_STEP)}
    native = gym.spec(id).vector_entry_point is not None
    arguments |= mode if native else {"vectorization_mode": "sync", "vector_kwargs": mode}
    envs: VectorEnv[Any, Any, Any] = gym.make_vec(id, num_envs=num_envs, **arguments)
    if compensator is not None:
        envs = CompensationVectorWrapper(envs, compensator)
    return Sb3Vec(envs)


class Sb3Vec(VecEnv):
    """A Stable-Baselines3 `VecEnv` around a vector environment with the autoreset mode "SameStep" or "Disabled".

    The `infos` of an episode's last step hold `terminal_observation`, `TimeLimit.truncated` and all numbers of the last
    `info`, such as `is_success`, errors in mm and degrees, or counts of fruit. They also hold `episode` with the sum of
    rewards "r" and the length "l", so that no monitor is needed. The `infos` of other steps are empty.

    Args:
        envs: The environments.

    Attributes:
        seen: The latest observations.

    Raises:
        InputError: If the environment's autoreset mode is "NextStep": Stable-Baselines3 would learn from steps in which
            the environment ignores the action and only resets.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any]) -> None:
        self.envs = envs
        self.mode: AutoresetMode = envs.metadata["autoreset_mode"]
        if self.mode is AutoresetMode.NEXT_STEP:
            raise InputError("Stable-Baselines3 needs autoreset_mode 'SameStep' or 'Disabled', not 'NextStep'")
        self.seen: Any = None
        self._actions: Any = None
        self._returns = np.zeros(envs.num_envs)
        self._lengths = np.zeros(envs.num_envs, dtype=np.int64)
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> Any:
        """Begin episodes in all environments, with the seeds and options that were set before."""
        options = [entry for entry in self._options if entry]
        if options and any(entry != options[0] for entry in self._options):
            raise InputError("options differ between environments; give all the same")
        self.seen, _ = self.envs.reset(seed=self._seeds, options=options[0] if options else None)  # type: ignore[arg-type]
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return self.seen

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Set a different seed for each environment at the next reset, all derived from ``seed``, and return them."""
        sequence = np.random.SeedSequence(seed) if seed is None else stream(seed, "training")
        self._seeds = list(seed_words(sequence, self.num_envs))
        return self._seeds

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Act in all environments with the actions that `step_async` stored.

        Returns:
            Observations, rewards, flags of the episodes that ended, and infos as the class describes them.
        """
        self.seen, rewards, terminations, truncations, batch = self.envs.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        dones = terminations | truncations
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if dones.any():
            rows = np.flatnonzero(dones)
            if self.mode is AutoresetMode.DISABLED:
                last, final = final_rows(self.seen, rows, self.num_envs), batch
                self.seen, _ = self.envs.reset(options={"reset_mask": dones})
            else:
                last, final = batch["final_obs"], batch["final_info"]
            for i, ending in zip(rows, self._endings(rows, last, final, truncations & ~terminations), strict=True):
                infos[i] = ending
            self._returns[rows], self._lengths[rows] = 0.0, 0
        return self.seen, rewards.astype(np.float32), dones, infos

    def _endings(
        self, rows: NDArray[np.intp], last: Any, final: dict[str, Any], cut: NDArray[np.bool_]
    ) -> list[dict[str, Any]]:
        """Return one info for each episode that ended.

        Args:
            rows: Indices (from 0) of the environments whose episodes ended.
            last: The last observation of each environment.
            final: The infos of the last step: arrays by key, with one entry per environment.
            cut: For each environment, whether the time limit cut the episode off.
        """
        columns: dict[str, Any] = {"terminal_observation": [last[i].copy() for i in rows]}
        columns["TimeLimit.truncated"] = cut[rows].tolist()
        numbers = {key: values for key, values in final.items() if key[0] != "_" and np.ndim(values) == 1}
        columns |= {key: np.asarray(values)[rows].tolist() for key, values in numbers.items()}
        sums = zip(self._returns[rows].tolist(), self._lengths[rows].tolist(), strict=True)
        columns["episode"] = [{"r": reward, "l": length, "t": 0.0} for reward, length in sums]
        return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]

    def state(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the next step depends on, for a checkpoint of native environments on NumPy."""
        scaled = self._scaled()
        observations = self.seen if scaled is None else scaled.raw
        observations = observations if isinstance(observations, dict) else {"flat": observations}
        arrays = {"returns": self._returns, "lengths": self._lengths}
        arrays |= named_part("raw/", observations) | named_part("env/", self._remembering().state_arrays())
        return {key: np.array(value) for key, value in arrays.items()}

    def take_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays that `state` of environments with the same arguments returned."""
        self._returns, self._lengths = state["returns"].copy(), state["lengths"].copy()
        observations = {key: value.copy() for key, value in part_of(state, "raw/").items()}
        self.seen = observations.get("flat", observations)
        if (scaled := self._scaled()) is not None:
            scaled.raw, self.seen = self.seen, scaled.scaling.shown(self.seen)
        self._remembering().take_state_arrays(part_of(state, "env/"))

    def _layers(self) -> Iterator[Any]:
        """Yield the wrappers from the outermost to the innermost, and then the wrapped environments."""
        env: Any = self.envs
        while isinstance(env, VectorWrapper):
            yield env
            env = env.env
        yield env

    def _remembering(self) -> Any:
        """Return the outermost wrapper, or the environments, with a method `state_arrays`.

        The method includes the state of all wrappers inside that wrapper.
        """
        return next(env for env in self._layers() if hasattr(env, "state_arrays"))

    def _scaled(self) -> ScaledVector | None:
        """Return the wrapper that scales the environments, or None."""
        return next((env for env in self._layers() if isinstance(env, ScaledVector)), None)

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute of the vector environment, repeated for each of ``indices`` (from 0; None for all)."""
        return [getattr(self.envs.unwrapped, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Set an attribute of the vector environment, and so of all environments.

        Raises:
            InputError: If ``indices`` names only some of the environments.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise InputError(f"{attr_name} belongs to all environments at once; set it for all of them")
        setattr(self.envs.unwrapped, attr_name, value)

    def env_method(
        self, method_name: str, *arguments: Any, indices: int | Iterable[int] | None = None, **named: Any
    ) -> list[Any]:
        """Call a method of the vector environment once for each of ``indices``, and return the results.

        Indices count from 0; None stands for all environments. The method gets ``arguments`` and ``named``.
        """
        return [getattr(self.envs.unwrapped, method_name)(*arguments, **named) for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: int | Iterable[int] | None = None) -> list[bool]:
        """Return whether a vector wrapper of this class is around the environments, repeated once per index.

        ``indices`` count from 0; None stands for all environments.
        """
        return [any(isinstance(env, wrapper_class) for env in self._layers())] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Draw one picture per environment; without a render mode, return one None per environment."""
        pictures: Any = self.envs.render()
        return [None] * self.num_envs if pictures is None else list(pictures)
