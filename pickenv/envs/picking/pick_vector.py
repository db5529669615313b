"""The native vector version of `pickenv/Pick-v0`: many arms and canopies in one set of arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Plant
from pickenv.base import InputError
from pickenv.envs.picking.pick_arm import reach_of
from pickenv.envs.picking.pick_batch import BELIEVED, TOOL, PickBatch
from pickenv.envs.picking.pick_scene import LONGEST, PICK_OPTIONS, Asked, PickStart, draw_starts, make_pick, pick_spaces
from pickenv.envs.shared.arm_env import Information
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.native_vector import Flags, NativeVectorEnv, Rows
from pickenv.envs.shared.streams import state_of_words, words_of_state
from pickenv.envs.shared.task import Task

if TYPE_CHECKING:
    from pickenv.pictures.stage import Stage


class PickVectorEnv(NativeVectorEnv):
    """N environments `pickenv/Pick-v0` in one.

    Environment i is the same, number by number, as a single `pickenv/Pick-v0` with seed ``seed + i``, whatever N is: to
    the bit where that one calculates with `executor="numpy"`.

    `reset(options={"reset_mask": mask})` begins episodes where the mask is True and leaves the others alone; the other
    options are as in `pickenv/Pick-v0`, given once for all environments or once for each: "fruit" as ``(n, 3)`` or
    ``(N, n, 3)``, "start_joints" as ``(6,)`` or ``(N, 6)``, "arm" as a number or ``(N,)``.

    Args:
        num_envs: N.
        difficulty: A rung of the ladder, as in `pickenv/Reach-v0`.
        split: Its arms to learn on, or to be judged on.
        max_episode_steps: Steps after which an episode is truncated, or None for never.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or an `AutoresetMode`.
        render_mode: None or "rgb_array".
        arguments: Those of `pickenv/Pick-v0`.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> envs = gym.make_vec("pickenv/Pick-v0", num_envs=3, autoreset_mode="SameStep")
        >>> observations, infos = envs.reset(seed=1)
        >>> observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
        >>> observations.shape, infos["reachable"].tolist()
        ((3, 23), [5, 9, 2])

    Raises:
        InputError: If an argument is impossible.
    """

    options = PICK_OPTIONS

    def __init__(
        self,
        num_envs: int = 1,
        *,
        difficulty: str | None = None,
        split: str = "train",
        max_episode_steps: int | None = LONGEST,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        super().__init__(num_envs, max_episode_steps, autoreset_mode, render_mode)
        task, self.orchard = make_pick(**on_ladder("Pick", difficulty, split, arguments))
        self.task: Task = task
        self.metadata["render_fps"] = task.situation.frames_per_second
        self._reach = reach_of(task.plant.arm.nominal, self.orchard.station.approach)
        observations, actions = pick_spaces(task)
        self._set_spaces(observations, actions)
        self._bounds = observations.low, observations.high
        self.batch = PickBatch(task, self.orchard, self.num_envs)
        self._armed = np.zeros(self.num_envs, dtype=np.bool_)
        self._next: list[tuple[Any, PickStart] | None] = [None] * self.num_envs

    @property
    def plant(self) -> Plant:
        """The true arm, or arms."""
        return self.batch.plant

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that the next step depends on, for a checkpoint."""
        ahead = {row: each[0] for row, each in enumerate(self._next) if each is not None}
        states = [ahead.get(row, rng.bit_generator.state) for row, rng in enumerate(self._rngs)]
        own: dict[str, NDArray[Any]] = {"rngs": np.array([words_of_state(state) for state in states], dtype=np.uint64)}
        own |= {"elapsed": self._elapsed, "over": self._over, "armed": self._armed}
        return {key: np.array(value) for key, value in (own | self.batch.state_arrays()).items()}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`, in an environment made with the same arguments."""
        self._rngs = [np.random.Generator(np.random.PCG64(0)) for _ in range(self.num_envs)]
        for rng, words in zip(self._rngs, state["rngs"], strict=True):
            rng.bit_generator.state = state_of_words(words)
        self._elapsed, self._over, self._armed = (state[key].copy() for key in ("elapsed", "over", "armed"))
        self._next, self._begun = [None] * self.num_envs, True
        self.batch.take_state_arrays(state)

    def _checked(self, actions: ArrayLike) -> Array:
        return np.asarray(np.clip(self.batch.numbers_of_actions(actions), -1.0, 1.0))

    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        for row in rows[seeded[rows]].tolist():
            self._next[row] = None
        joints = options.get("start_joints")
        if joints is not None:
            joints = self.task.given_joints("start_joints", joints, self.num_envs)[rows]
        if options.get("fruit") is None and options.get("arm") is None and not seeded[rows].any() and self._armed.all():
            self._draw_ahead(rows)
            starts = [self._taken(row) for row in rows.tolist()]
        else:
            self._draw_back(rows)
            starts = self._drawn(rows, options, seeded)
        self._armed[rows] = True
        self.batch.restart(rows, starts, joints, self.compensator)

    def _drawn(self, rows: Rows, options: Information, seeded: Flags) -> list[PickStart]:
        count = self.num_envs
        fruit, arms = _each(options, "fruit", count, 3), _each(options, "arm", count, 1)
        asked = [
            Asked(int(self.batch.arm[row]) if self._armed[row] else None, bool(seeded[row]), fruit[row], arms[row])
            for row in rows.tolist()
        ]
        return draw_starts(self.task, self.orchard, self._reach, [self._rngs[row] for row in rows], asked)

    def _draw_ahead(self, rows: Rows) -> None:
        """Draw the next episodes of all environments that have none waiting, as soon as one needs it.

        Drawing many canopies takes little longer than drawing one, and nothing else draws from their generators.
        """
        if all(self._next[row] is not None for row in rows.tolist()):
            return
        without = np.array([row for row, each in enumerate(self._next) if each is None])
        before = [self._rngs[row].bit_generator.state for row in without]
        starts = self._drawn(without, {}, np.zeros(self.num_envs, dtype=np.bool_))
        for row, state, start in zip(without.tolist(), before, starts, strict=True):
            self._next[row] = state, start

    def _taken(self, row: int) -> PickStart:
        waiting = self._next[row]
        assert waiting is not None
        self._next[row] = None
        return waiting[1]

    def _draw_back(self, rows: Rows) -> None:
        """Forget episodes that were drawn ahead, as if they had never been drawn."""
        for row in rows.tolist():
            waiting = self._next[row]
            if waiting is not None:
                self._rngs[row].bit_generator.state = waiting[0]
                self._next[row] = None

    def _act(self, actions: Array, live: Flags) -> NDArray[Any]:
        return self.batch.advance(actions, live, self.compensator)

    def _finished(self) -> Flags:
        return self.batch.finished()

    def _observation(self) -> NDArray[np.float32]:
        low, high = (np.asarray(bound, dtype=np.float32) for bound in self._bounds)
        return self.batch.observations(low, high)

    def _information(self) -> Information:
        return self.batch.information()

    def _stage(self, row: int) -> Stage:
        from pickenv.envs.picking.pick_drawing import draw_pick

        batch, nominal, n = self.batch, self.task.plant.arm.nominal, self.task.joints
        tool, believed = (tuple(batch.sight[part][:, row].tolist()) for part in (TOOL, BELIEVED))
        command = batch.sight[-n:, row]
        return draw_pick(nominal, command, tool, believed, batch.fruit.scenes[row], int(batch.number[row]), dark=False)


def _each(options: Information, name: str, count: int, rank: int) -> list[Any]:
    """An option for each environment: what was given once for all, or once for each."""
    given = options.get(name)
    if given is None or np.ndim(given) < rank:
        return [given] * count
    if len(given) != count:
        raise InputError(f"option {name} was given {len(given)} times; give it once, or {count} times")
    return list(given) if rank > 1 else [int(value) for value in given]
