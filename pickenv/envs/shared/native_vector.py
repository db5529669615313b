"""The common part of the native vector environments: seeds, masks, the three autoreset modes, infos and pictures."""

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
from pickenv.envs.shared.arm_env import Information, checked_render_mode, drawn
from pickenv.envs.shared.backends import Flags, Rows
from pickenv.envs.shared.spaces import PlainSpec, given_options
from pickenv.envs.shared.task import Compensate, check_choice, check_count
from pickenv.pictures.stage import Stage


class NativeVectorEnv(PlainSpec, VectorEnv[Any, Any, Any]):
    """N environments in one; the i-th is seeded with ``seed + i`` and does not depend on how many there are.

    Attributes:
        task: The task that all environments simulate.
        options: Names of the options that `reset` takes beside a mask.
        max_episode_steps: Steps after which an episode is truncated, or None for never.
        compensator: Turns joint targets into joint commands, or None.
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
        self.compensator: Compensate | None = None
        self._rngs: list[np.random.Generator] = [np.random.default_rng(0)] * self.num_envs
        self._begun = False
        self._over = np.zeros(self.num_envs, dtype=np.bool_)
        self._elapsed = np.zeros(self.num_envs, dtype=np.uint64)

    @property
    def increment(self) -> Array:
        """Largest increment of each joint in one action, rad or m."""
        return np.array(self.task.increment)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, Information]:
        """Begin episodes in all environments, or in those where ``options["reset_mask"]`` is True.

        Args:
            seed: Environment i gets ``seed + i``, or entry i of a sequence; with None it goes on with its own stream
                of random numbers.
            options: See the class.
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
        """Act in all environments; those whose episode is over begin a new one as the autoreset mode says.

        Raises:
            InputError: If actions have another shape or impossible numbers, if `reset` was never called, or if an
                episode that ended was not reset.
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
        """One picture per environment."""
        if self.render_mode is None:
            return None
        return tuple(drawn(self._stage(row) if self._begun else None) for row in range(self.num_envs))

    def _set_spaces(self, observations: Space[Any], actions: Space[Any]) -> None:
        """Set the spaces of one environment, and those of all N made of them."""
        self.single_observation_space, self.single_action_space = observations, actions
        self.observation_space = batch_space(observations, self.num_envs)
        self.action_space = batch_space(actions, self.num_envs)

    def _restart(self, rows: Rows, options: Information | None = None, seeded: Flags | None = None) -> None:
        self._begin(rows, options or {}, np.zeros(self.num_envs, np.bool_) if seeded is None else seeded)
        self._begun = True
        self._elapsed[rows], self._over[rows] = 0, False

    def _masked(self, mask: Flags) -> Information:
        """Infos as a dict of arrays, each with ``mask`` as its ``_key``; values outside the mask are zero."""
        infos, flags = self._information(), self._flags(mask)
        if not mask.all():
            infos = {key: values * flags.reshape(-1, *[1] * (values.ndim - 1)) for key, values in infos.items()}
        return infos | {f"_{key}": flags for key in infos}

    def _flags(self, flags: Flags) -> Any:
        """A copy of truth values in the form in which `step` returns them."""
        return flags.copy()

    def _seed(self, row: int, seed: int | None) -> None:
        """Give environment ``row`` a new stream of random numbers, from ``seed`` or, if it is None, a fresh seed."""
        self._rngs[row] = seeding.np_random(seed)[0]

    @abstractmethod
    def _checked(self, actions: ArrayLike) -> Any:
        """Actions, checked and in the form that `_act` takes."""

    @abstractmethod
    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        """Begin episodes in the environments ``rows``; ``seeded`` flags those of all N that were just given a seed."""

    @abstractmethod
    def _act(self, actions: Any, live: Flags) -> Any:
        """Let time pass in the environments ``live``; the others begin new episodes afterwards.

        Returns:
            The rewards of all environments, zero in those that are not live.
        """

    @abstractmethod
    def _finished(self) -> Flags:
        """Flags of the environments whose episode is over."""

    @abstractmethod
    def _observation(self) -> Any:
        """The observations of all environments."""

    @abstractmethod
    def _information(self) -> Information:
        """The infos of all environments: arrays by name, with a leading axis of environments."""

    @abstractmethod
    def _stage(self, row: int) -> Stage:
        """The scene of environment ``row``, to be drawn."""


def checked_mask(mask: Any, count: int) -> Flags:
    """Flags of those of ``count`` environments that a reset begins anew; all of them if ``mask`` is None.

    Raises:
        InputError: If ``mask`` is not one truth value per environment, at least one of them True.
    """
    flags = np.ones(count, dtype=np.bool_) if mask is None else np.array(mask)
    if flags.dtype != np.bool_ or flags.shape != (count,) or not flags.any():
        raise InputError(
            f"reset_mask has shape {flags.shape} and type {flags.dtype}; give {count} truth values, at least one of "
            "them True"
        )
    return flags


def checked_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """A seed for each of ``count`` environments: ``seed + i`` for the i-th; None lets it go on with its own stream.

    Raises:
        InputError: If another number of seeds is given, or a negative seed.
    """
    if seed is None:
        return [None] * count
    seeds: list[int | None] = list(seed) if isinstance(seed, Sequence) else [int(seed) + i for i in range(count)]
    if len(seeds) != count:
        raise InputError(f"{len(seeds)} seeds were given for {count} environments; give one for each")
    for value in seeds:
        if value is not None and value < 0:
            raise InputError(f"seed {value} is negative; give a whole number not below zero")
    return seeds


def final_rows(observations: Any, rows: Rows, count: int) -> Any:
    """The observations of ``rows`` in an object array of length ``count``, as `SyncVectorEnv` gives them.

    The other entries are None. Tensors are returned as they are.
    """
    parts = list(observations.values()) if isinstance(observations, dict) else [observations]
    if not all(isinstance(part, np.ndarray) for part in parts):
        return observations
    final = np.full(count, None, dtype=object)
    for row in rows:
        copies = [part[row].copy() for part in parts]
        final[row] = dict(zip(observations, copies, strict=True)) if isinstance(observations, dict) else copies[0]
    return final
