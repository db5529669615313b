"""Base class of the native vector environments: seeds, masks, the three autoreset modes, infos and pictures."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.envs.shared.arm_env import Information, Options, checked_render_mode, drawn
from pickenv.envs.shared.backends import Flags, Rows
from pickenv.envs.shared.spaces import PlainSpec, given_options
from pickenv.envs.shared.task import Compensators, check_choice, check_count
from pickenv.pictures.stage import Stage

Seeds = int | Sequence[int | None] | None


class NativeVectorEnv(PlainSpec, VectorEnv[Any, Any, Any]):
    """Base class for N environments in one.

    Environment i (from 0) has the seed ``seed + i``, and its numbers do not depend on N.

    Attributes:
        task: The task that all environments simulate.
        options: Names of the options that `reset` takes in addition to "reset_mask".
        max_episode_steps: Steps after which an episode is truncated, or None for never.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    task: Any
    options: tuple[str, ...]

    def __init__(
        self, num_envs: int, max_episode_steps: int | None, autoreset_mode: str | AutoresetMode, render_mode: str | None
    ) -> None:
        check_count("num_envs", num_envs)
        if max_episode_steps is not None:
            check_count("max_episode_steps", max_episode_steps)
        mode = str(getattr(autoreset_mode, "value", autoreset_mode))
        check_choice("autoreset_mode", mode, tuple(mode.value for mode in AutoresetMode))
        self.num_envs, self.max_episode_steps = int(num_envs), max_episode_steps
        self.render_mode = checked_render_mode(render_mode, ("rgb_array",))
        self.autoreset_mode = AutoresetMode(mode)
        self.metadata = type(self).metadata | {"autoreset_mode": self.autoreset_mode}
        self._compensator: Compensators | None = None
        self._rngs: list[np.random.Generator] = [np.random.default_rng(0)] * self.num_envs
        self._begun = False
        self._over = np.zeros(self.num_envs, dtype=np.bool_)
        self._elapsed = np.zeros(self.num_envs, dtype=np.uint64)

    @property
    def compensator(self) -> Compensators | None:
        """Compensator from joint targets to joint commands: one for all environments, a sequence of N, or None."""
        return self._compensator

    @compensator.setter
    def compensator(self, given: Compensators | None) -> None:
        if given is not None and not callable(given) and len(given) != self.num_envs:
            raise InputError(f"{len(given)} compensators for {self.num_envs} environments; give one, or one for each")
        self._compensator = given

    @property
    def increment(self) -> Array:
        """Largest increment of each joint in one action, rad or m."""
        return np.array(self.task.increment)

    def reset(self, *, seed: Seeds = None, options: Options = None) -> tuple[Any, Information]:
        """Begin episodes in all environments, or in the environments for which ``options["reset_mask"]`` is True.

        Args:
            seed: Environment i (from 0) gets ``seed + i``, or entry i of a sequence. With None, an environment
                continues its own stream of random numbers.
            options: Values of options, by the names in the attribute `options` and "reset_mask".

        Returns:
            The observations and the infos.
        """
        options = given_options(options, (*self.options, "reset_mask"))
        mask = checked_mask(options.pop("reset_mask", None), self.num_envs)
        seeds = checked_seeds(seed, self.num_envs)
        super().reset(seed=int(seed) if isinstance(seed, int | np.integer) else None)
        seeded = mask & np.array([value is not None for value in seeds])
        if not self._begun:  # nothing is left alone that was never begun
            mask[:] = seeded[:] = True
        for row in np.flatnonzero(seeded).tolist():
            self._seed(row, seeds[row])
        self._restart(np.flatnonzero(mask), options, seeded)
        return self._observation(), self._masked(mask)

    def step(self, actions: ArrayLike) -> tuple[Any, Any, Any, Any, Information]:
        """Act in all environments. After the end of an episode, the next one begins as the autoreset mode says.

        Raises:
            InputError: If actions have another shape or invalid numbers, if `reset` was never called, or if an ended
                episode was not reset although the autoreset mode requires it.
        """
        values, over, live = self._checked(actions), self._over, np.ones(self.num_envs, dtype=np.bool_)
        if not self._begun:
            raise InputError("step was called before reset; call reset first")
        rested = np.flatnonzero(over)
        if rested.size:
            if self.autoreset_mode is not AutoresetMode.NEXT_STEP:
                raise InputError(f"environment {rested[0]} has ended its episode; call reset with a reset_mask first")
            live = ~over
        self._elapsed += live
        rewards = self._act(values, live)
        if rested.size:
            self._restart(rested)
        most = np.inf if self.max_episode_steps is None else self.max_episode_steps
        terminated, truncated = self._finished() & live, (self._elapsed >= most) & live
        self._over = over = terminated | truncated
        final: Information = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            rows, ended = np.flatnonzero(over), self._flags(over)
            final = {"final_obs": final_rows(self._observation(), rows, self.num_envs), "_final_obs": ended}
            final |= {"final_info": self._masked(over), "_final_info": ended}
            self._restart(rows)
        infos = self._masked(np.ones(self.num_envs, dtype=np.bool_)) | final
        return self._observation(), rewards, self._flags(terminated), self._flags(truncated), infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Draw one picture per environment, as RGB pixels; None without a render mode."""
        if self.render_mode is None:
            return None
        return tuple(drawn(self._stage(row) if self._begun else None) for row in range(self.num_envs))

    def _restart(self, rows: Rows, options: Information | None = None, seeded: Flags | None = None) -> None:
        self._begin(rows, options or {}, np.zeros(self.num_envs, np.bool_) if seeded is None else seeded)
        self._begun = True
        self._elapsed[rows], self._over[rows] = 0, False

    def _masked(self, mask: Flags) -> Information:
        """Return the infos as a dict of arrays by key, with values 0 where ``mask (N,)`` is False.

        For each key there is also an entry "_key", which holds the mask.
        """
        infos, flags = self._information(), self._flags(mask)
        if not mask.all():
            infos = {key: values * flags.reshape(-1, *[1] * (values.ndim - 1)) for key, values in infos.items()}
        return infos | {f"_{key}": flags for key in infos}

    def _flags(self, flags: Flags) -> Any:
        """Copy booleans to the kind of array that `step` returns."""
        return flags.copy()

    def _seed(self, row: int, seed: int | None) -> None:
        """Start a new stream of random numbers for environment ``row`` (from 0); None stands for a fresh seed."""
        self._rngs[row] = seeding.np_random(seed)[0]

    @abstractmethod
    def _checked(self, actions: ArrayLike) -> Any:
        """Check actions, and return them in the form that `_act` takes."""

    @abstractmethod
    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        """Begin episodes in the environments ``rows``; ``seeded (N,)`` marks the environments that just got a seed."""

    @abstractmethod
    def _act(self, actions: Any, live: Flags) -> Any:
        """Simulate one period in the environments marked by ``live (N,)``.

        The environments that are not marked begin new episodes afterwards.

        Returns:
            The rewards of all environments, zero in environments that are not live.
        """

    @abstractmethod
    def _finished(self) -> Flags:
        """Return flags ``(N,)`` of the environments whose episode is over."""

    @abstractmethod
    def _observation(self) -> Any:
        """Return the observations of all environments."""

    @abstractmethod
    def _information(self) -> Information:
        """Return the infos of all environments: arrays ``(N, ...)`` by name."""

    @abstractmethod
    def _stage(self, row: int) -> Stage:
        """Return the contents of the picture of environment ``row`` (from 0)."""


def set_spaces(envs: VectorEnv[Any, Any, Any], observations: Space[Any], actions: Space[Any]) -> None:
    """Set the spaces of a single environment of ``envs``, and the batched spaces of all N."""
    envs.single_observation_space, envs.single_action_space = observations, actions
    envs.observation_space = batch_space(observations, envs.num_envs)
    envs.action_space = batch_space(actions, envs.num_envs)


def checked_mask(mask: Any, count: int) -> Flags:
    """Check a reset mask, and return it as an array of ``count`` booleans, all True if ``mask`` is None.

    Raises:
        InputError: If ``mask`` is not one boolean per environment, or none is True.
    """
    flags = np.ones(count, dtype=np.bool_) if mask is None else np.array(mask)
    if flags.dtype != np.bool_ or flags.shape != (count,) or not flags.any():
        raise InputError(
            f"reset_mask has shape {flags.shape} and type {flags.dtype}; give {count} truth values, at least one of "
            "them True"
        )
    return flags


def checked_seeds(seed: Seeds, count: int) -> list[int | None]:
    """Return a seed for each of ``count`` environments.

    Args:
        seed: A number, from which environment i (from 0) gets ``seed + i``; or a sequence of one seed or None per
            environment; or None.
        count: Number of environments.

    Returns:
        The seeds. None means that an environment continues its own stream of random numbers.

    Raises:
        InputError: If another number of seeds is given, or a negative seed.
    """
    if seed is None:
        return [None] * count
    seeds: list[Any] = np.array(seed, dtype=object).ravel().tolist()
    if isinstance(seed, int | np.integer):
        seeds = [int(seed) + i for i in range(count)]
    if len(seeds) != count:
        raise InputError(f"{len(seeds)} seeds were given for {count} environments; give one for each")
    for value in seeds:
        if value is not None and (not isinstance(value, int | np.integer) or value < 0):
            raise InputError(f"seed is {value!r}; give a whole number not below zero")
    return seeds


def final_rows(observations: Any, rows: Rows, count: int) -> Any:
    """Return an object array of length ``count`` with the observations of some environments, as `SyncVectorEnv` does.

    Args:
        observations: Observations of all ``count`` environments. If they are tensors, they are returned unchanged.
        rows: Indices of the environments; the entries of all other environments are None.
        count: Number of environments.
    """
    parts = list(observations.values()) if isinstance(observations, dict) else [observations]
    if not all(isinstance(part, np.ndarray) for part in parts):
        return observations
    final = np.full(count, None, dtype=object)
    for row in rows:
        copies = [part[row].copy() for part in parts]
        final[row] = dict(zip(observations, copies, strict=True)) if isinstance(observations, dict) else copies[0]
    return final
