"""What native vector environments have in common whose environments each draw from a generator of their own."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike, NDArray

from pickenv.base import InputError
from pickenv.envs.shared.arm_env import checked_render_mode, drawn
from pickenv.envs.shared.spaces import PlainSpec, final_rows, given_mask, given_options, given_seeds
from pickenv.envs.shared.task import check_choice, check_count

if TYPE_CHECKING:
    from pickenv.pictures.stage import Stage

Information = dict[str, Any]
Flags = NDArray[np.bool_]
Rows = NDArray[np.intp]


class StreamVectorEnv(PlainSpec, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """N environments; the i-th is seeded with ``seed + i`` and does not depend on how many there are.

    Attributes:
        max_episode_steps: Steps after which an episode is truncated, or None for never.
    """

    options: tuple[str, ...] = ()
    """What `reset` takes beside a mask."""

    def __init__(
        self,
        num_envs: int,
        max_episode_steps: int | None,
        autoreset_mode: str | AutoresetMode,
        render_mode: str | None,
    ) -> None:
        check_count("num_envs", num_envs)
        if max_episode_steps is not None:
            check_count("max_episode_steps", max_episode_steps)
        mode = str(getattr(autoreset_mode, "value", autoreset_mode))
        check_choice("autoreset_mode", mode, tuple(each.value for each in AutoresetMode))
        self.autoreset_mode = AutoresetMode(mode)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 10, "autoreset_mode": self.autoreset_mode}
        self.num_envs, self.max_episode_steps = int(num_envs), max_episode_steps
        self.render_mode = checked_render_mode(render_mode, ("rgb_array",))
        self._rngs: list[np.random.Generator] = []
        self._over, self._begun = np.zeros(self.num_envs, dtype=np.bool_), False
        self._elapsed = np.zeros(self.num_envs, dtype=np.int64)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Information]:
        """Start all episodes anew, or those in ``options["reset_mask"]``; other options are given once, or for each."""
        options = given_options(options, (*self.options, "reset_mask"))
        mask = given_mask(options.pop("reset_mask", None), self.num_envs)
        if not self._begun:
            mask[:] = True
        seeds = given_seeds(seed, self.num_envs)
        seeded = mask & np.array([value is not None for value in seeds])
        if not self._rngs:
            self._rngs = [seeding.np_random(value)[0] for value in seeds]
        for row in np.flatnonzero(seeded):
            self._rngs[row] = seeding.np_random(seeds[row])[0]
        self._restart(np.flatnonzero(mask), options, seeded)
        return self._observation(), self._masked(mask)

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], Information]:
        """One period of every environment; those that are over start anew as the autoreset mode says.

        Raises:
            InputError: If actions are not finite or have another shape, or before the first reset.
        """
        checked = self._checked(actions)
        if not self._begun:
            raise InputError("step was called before reset; call reset first")
        again = self._over.copy()
        if again.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise InputError("an episode is over; reset it with options={'reset_mask': ...} before the next step")
        rewards = self._act(checked, ~again)
        self._elapsed += ~again
        if again.any():
            self._restart(np.flatnonzero(again))
        terminated = self._finished() & ~again
        truncated = np.zeros(self.num_envs, dtype=np.bool_)
        if self.max_episode_steps is not None:
            truncated = (self._elapsed >= self.max_episode_steps) & ~again
        self._over = terminated | truncated
        extra: Information = {}
        if self._over.any() and self.autoreset_mode is AutoresetMode.SAME_STEP:
            over = self._over.copy()
            last = final_rows(self._observation(), np.flatnonzero(over), self.num_envs)
            extra = {
                "final_obs": last,
                "_final_obs": over,
                "final_info": self._masked(over),
                "_final_info": over.copy(),
            }
            self._restart(np.flatnonzero(over))
        everywhere = np.ones(self.num_envs, dtype=np.bool_)
        return self._observation(), rewards, terminated, truncated, self._masked(everywhere) | extra

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One picture per environment."""
        if self.render_mode is None:
            return None
        if not self._begun:
            raise InputError("render was called before reset; call reset first")
        return tuple(drawn(self._stage(row)) for row in range(self.num_envs))

    def _restart(self, rows: Rows, options: Information | None = None, seeded: Flags | None = None) -> None:
        self._begin(rows, options or {}, np.zeros(self.num_envs, np.bool_) if seeded is None else seeded)
        self._over[rows], self._elapsed[rows], self._begun = False, 0, True

    def _masked(self, mask: Flags) -> Information:
        """Infos as a dict of arrays with masks; what is outside the mask is zero."""
        found = self._information()
        if not mask.all():
            for key, values in found.items():
                found[key] = values * mask.reshape(-1, *[1] * (values.ndim - 1))
        return found | {f"_{key}": mask.copy() for key in found}

    @abstractmethod
    def _checked(self, actions: ArrayLike) -> Any:
        """Actions as `_act` wants them."""

    @abstractmethod
    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        """Begin episodes in the environments ``rows``; ``seeded`` says which of all were just given a seed."""

    @abstractmethod
    def _act(self, actions: Any, going: Flags) -> NDArray[Any]:
        """Let time pass in the environments ``going``; rewards of all, zero elsewhere."""

    @abstractmethod
    def _finished(self) -> Flags:
        """Where the episode is over."""

    @abstractmethod
    def _observation(self) -> NDArray[np.float32]:
        """What all show."""

    @abstractmethod
    def _information(self) -> Information:
        """The truth about all, arrays with a leading axis of environments."""

    @abstractmethod
    def _stage(self, row: int) -> Stage:
        """What there is to see of one."""
