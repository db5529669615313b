"""The native vector version of `pickenv/Pick-v0`: many arms and canopies in one set of arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Plant
from pickenv.envs.picking.pick_batch import BELIEVED, TOOL, PickBatch
from pickenv.envs.picking.pick_reach import reach_of
from pickenv.envs.picking.pick_start import PICK_OPTIONS, draw_start
from pickenv.envs.picking.pick_task import LONGEST, make_pick, pick_spaces
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.stream_vector import Flags, Information, Rows, StreamVectorEnv
from pickenv.envs.shared.task import Compensate, Task
from pickenv.errors import InputError

if TYPE_CHECKING:
    from pickenv.pictures.stage import Stage


class PickVectorEnv(StreamVectorEnv):
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
        self.single_observation_space, self.single_action_space = pick_spaces(task)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.compensator: Compensate | None = None
        self.batch = PickBatch(task, self.orchard, self.num_envs)
        self._armed = np.zeros(self.num_envs, dtype=np.bool_)

    @property
    def plant(self) -> Plant:
        """The true arm, or arms."""
        return self.batch.plant

    @property
    def increment(self) -> Array:
        """Largest increment of each joint in one action, rad or m."""
        return np.array(self.task.increment)

    def _checked(self, actions: ArrayLike) -> Array:
        return np.clip(self.batch.numbers_of_actions(actions), -1.0, 1.0)

    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        task, count, joints = self.task, self.num_envs, options.get("start_joints")
        if joints is not None:
            joints = task.given_joints("start_joints", joints, count)[rows]
        fruit, arms = (_each(options, name, count, rank) for name, rank in (("fruit", 3), ("arm", 1)))
        starts = []
        for row in rows.tolist():
            arm = int(self.batch.arm[row]) if self._armed[row] else None
            given: dict[str, Any] = {"fruit": fruit[row], "asked": arms[row], "again": bool(seeded[row])}
            starts.append(draw_start(task, self.orchard, self._reach, self._rngs[row], arm, **given))
        self._armed[rows] = True
        self.batch.restart(rows, starts, joints, self.compensator)

    def _act(self, actions: Array, going: Flags) -> NDArray[Any]:
        return self.batch.advance(actions, going, self.compensator)

    def _finished(self) -> Flags:
        return self.batch.finished()

    def _observation(self) -> NDArray[np.float32]:
        space = self.single_observation_space
        return self.batch.observations(space.low, space.high)

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
