"""The native vector version of `pickenv/Pick-v0`: many arms and canopies in one set of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Plant, Scalar
from pickenv.base import InputError
from pickenv.envs.picking import pick_scene
from pickenv.envs.picking.canopies import Canopies, draw_pick
from pickenv.envs.picking.pick_arm import TOOL, act_arm, look_at_arm, reach_of
from pickenv.envs.shared.arm_batch import NumpyArms
from pickenv.envs.shared.arm_env import Information
from pickenv.envs.shared.backends import Flags, Rows, state_of_words, words_of_state
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.native_vector import NativeVectorEnv, set_spaces
from pickenv.envs.shared.simulation import ArmState, begin
from pickenv.envs.shared.task import OF_TASKS, Compensators, Task, check_choice, refuse_unknown
from pickenv.pictures.stage import Stage


class PickVectorEnv(NativeVectorEnv):
    """N `pickenv/Pick-v0` in one vector environment.

    Environment i (from 0) returns the same numbers as a single `pickenv/Pick-v0` with the seed ``seed + i``, whatever N
    is. They are equal to the bit if the single environment has `executor="numpy"`.

    `reset(options={"reset_mask": mask})` begins episodes where the mask is True; the other environments continue. The
    other options are the options of `pickenv/Pick-v0`. Each has one value for all environments, or one value for each:
    "fruit" as ``(n, 3)`` or ``(N, n, 3)``, "start_joints" as ``(6,)`` or ``(N, 6)``, "arm" and "hours" as a number or
    ``(N,)``.

    Args:
        num_envs: N.
        max_episode_steps: Steps after which an episode is truncated, or None for never.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or an `AutoresetMode`.
        executor: "auto" or "numpy", which are the same here.
        render_mode: None or "rgb_array".
        arguments: Other arguments of `pickenv/Pick-v0`.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> envs = gym.make_vec("pickenv/Pick-v0", num_envs=3, autoreset_mode="SameStep")
        >>> observations, infos = envs.reset(seed=1)
        >>> observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
        >>> observations.shape, infos["reachable"].tolist()
        ((3, 23), [5, 9, 2])

    Raises:
        InputError: If an argument has a value that is not allowed. The message names the argument.
    """

    options = pick_scene.PICK_OPTIONS

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = pick_scene.LONGEST,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        executor: str = "auto",
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        super().__init__(num_envs, max_episode_steps, autoreset_mode, render_mode)
        check_choice("executor", executor, ("auto", "numpy"))
        refuse_unknown(self, arguments, on_ladder, pick_scene.make_pick, *OF_TASKS)
        task, self.orchard = pick_scene.make_pick(**on_ladder("Pick", **arguments))
        self.task: Task = task
        self.metadata["render_fps"] = task.situation.frames_per_second
        self._reach = reach_of(task.plant.arm.nominal, self.orchard.station.approach)
        set_spaces(self, *pick_scene.pick_spaces(task, self.orchard))
        self.batch = PickBatch(task, self.orchard, self.num_envs)
        self._armed = np.zeros(self.num_envs, dtype=np.bool_)
        # Starts of next episodes that are drawn already, by index of the environment (from 0). Each is a pair: the
        # state of the environment's random generator before the draw, and the start.
        self._ahead: dict[int, tuple[Any, pick_scene.PickStart]] = {}

    @property
    def plant(self) -> Plant:
        """The true arm that all environments share, or the true arms of a population, one per environment."""
        return self.batch.plant

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the next step depends on, for a checkpoint."""
        ahead, rngs = self._ahead, enumerate(self._rngs)
        states = [ahead[row][0] if row in ahead else rng.bit_generator.state for row, rng in rngs]
        words = np.array([words_of_state(state) for state in states], dtype=np.uint64)
        arrays = {"elapsed": self._elapsed, "over": self._over, "armed": self._armed, "rngs": words}
        return {key: np.array(value) for key, value in (arrays | self.batch.state_arrays()).items()}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore a state that `state_arrays` returned, of an environment that was made with the same arguments."""
        self._rngs = [np.random.Generator(np.random.PCG64(0)) for _ in range(self.num_envs)]
        for rng, words in zip(self._rngs, state["rngs"], strict=True):
            rng.bit_generator.state = state_of_words(words)
        self._elapsed, self._over, self._armed = (state[key].copy() for key in ("elapsed", "over", "armed"))
        self._ahead, self._begun = {}, True
        self.batch.take_state_arrays(state)

    def _checked(self, actions: ArrayLike) -> Array:
        return np.asarray(np.clip(self.batch.numbers_of_actions(actions), -1.0, 1.0))

    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        joints, hours, numbers = options.get("start_joints"), options.get("hours"), rows.tolist()
        if hours is not None:
            hours = pick_scene.given_hours(hours, self.num_envs)[rows]
        if joints is not None:
            joints = self.task.given_joints("start_joints", joints, self.num_envs)[rows]
        for row in rows[seeded[rows]].tolist():
            self._ahead.pop(row, None)
        if options.get("fruit") is None and options.get("arm") is None and not seeded[rows].any() and self._armed.all():
            if not self._ahead.keys() >= set(numbers):
                self._draw_ahead()
            starts = [self._ahead.pop(row)[1] for row in numbers]
        else:
            for row in self._ahead.keys() & set(numbers):  # as if they had never been drawn
                self._rngs[row].bit_generator.state = self._ahead.pop(row)[0]
            starts = self._drawn(rows, options, seeded)
        self._armed[rows] = True
        self.batch.restart(rows, starts, joints, self.compensator, hours)

    def _drawn(self, rows: Rows, options: Information, seeded: Flags) -> list[pick_scene.PickStart]:
        count = self.num_envs
        fruit, arms = _each(options, "fruit", count, 3), _each(options, "arm", count, 1)
        settled = self._armed & ~seeded
        episodes = [
            (self._rngs[row], int(self.batch.arm[row]) if settled[row] else None, fruit[row], arms[row])
            for row in rows.tolist()
        ]
        return pick_scene.draw_starts(self.task, self.orchard, self._reach, episodes)

    def _draw_ahead(self) -> None:
        """Draw the start of the next episode for all environments that have none drawn yet.

        Drawing many canopies takes little longer than drawing one. No other function draws from these generators.
        """
        rows = np.array([row for row in range(self.num_envs) if row not in self._ahead])
        before = [self._rngs[row].bit_generator.state for row in rows]
        starts = self._drawn(rows, {}, np.zeros(self.num_envs, dtype=np.bool_))
        self._ahead |= zip(rows.tolist(), zip(before, starts, strict=True), strict=True)

    def _act(self, actions: Array, live: Flags) -> NDArray[Any]:
        return self.batch.advance(actions, live, self.compensator)

    def _finished(self) -> Flags:
        return self.batch.canopies.finished()

    def _observation(self) -> NDArray[np.float32]:
        return self.batch.canopies.observations(self.single_observation_space)

    def _information(self) -> Information:
        return self.batch.canopies.information()

    def _stage(self, row: int) -> Stage:
        return draw_pick(self.batch.canopies, row)


def _each(options: Information, name: str, count: int, rank: int) -> list[Any]:
    """Return the values of option ``name``, one for each of ``count`` environments.

    If the option's value has fewer than ``rank`` axes, all environments get this value. Otherwise the value has one
    entry per environment.
    """
    values = options.get(name)
    if values is None or np.ndim(values) < rank:
        return [values] * count
    if len(values) != count:
        raise InputError(f"option {name} was given {len(values)} times; give it once, or {count} times")
    return list(values) if rank > 1 else np.asarray(values).tolist()


# Many picking arms before their canopies, side by side on NumPy. Units: m, rad, s.


class PickBatch(NumpyArms):
    """The state of N picking arms.

    Attributes:
        canopies: The fruit in front of the arms, and where the arms' tools are.
    """

    def __init__(self, task: Task, orchard: pick_scene.PickSetting, count: int) -> None:
        super().__init__(task, count)
        self.make_plants()
        self.make_room(0, 0)
        self.remake()
        self.canopies = Canopies(task, orchard, count)

    def restart(
        self,
        rows: Rows,
        starts: Sequence[pick_scene.PickStart],
        joints: Array | None,
        compensate: Compensators | None,
        hours: Array | None,
    ) -> None:
        """Begin an episode in the environments ``rows``.

        Args:
            rows: Indices of the environments, from 0.
            starts: What was drawn for each environment: its fruit, true arm, and key of its random streams.
            joints: Joint targets to start from ``(len(rows), n)``, rad or m. None draws them or starts at mid-range, as
                the task says.
            compensate: Turns joint targets into joint commands, or None.
            hours: Time for which each arm has been switched on ``(len(rows),)``, h, or None for the time of the
                task's situation.
        """
        x, task, canopies = self.x, self.task, self.canopies
        scenes, arms, words = zip(*starts, strict=True)
        self.keys[rows] = keys = np.array(words, dtype=np.uint64)
        if task.arms != "fixed":
            self.take_arms(rows, np.array(arms, dtype=np.intp))
        canopies.still[rows], canopies.moments[rows], canopies.time[rows] = pick_scene.STILL, 0, 0.0
        for a, b in self.blocks(len(rows)):
            some = rows[a:b]
            targets = self.starts(keys[a:b], None if joints is None else joints[a:b])
            plant = self.plant_of(some)
            command, on = self.commands(compensate, targets, some), None if hours is None else hours[a:b]
            state = begin(x, task, plant, keys[a:b], targets, (), command, on)
            self._look(some, state, plant, compensate, 0.0)
        for row, scene in zip(rows.tolist(), scenes, strict=True):
            canopies.adopt(row, scene)
            canopies.choose(row)

    def advance(self, actions: Array, going: Flags, compensate: Compensators | None) -> Array:
        """Act in all environments, and return the rewards.

        Args:
            actions: Actions component by component, ``(n + 1, N)``; the last component is the gripper's.
            going: Flags ``(N,)`` of the environments in which fruit may change; all other environments get reward 0.
            compensate: Turns joint targets into joint commands, or None.
        """
        before = self.canopies.sight[TOOL][9:].T.copy()
        gripper, period, stirred = np.empty(self.count), np.empty(self.count), np.empty(self.count, dtype=np.bool_)
        self.canopies.moments += np.uint64(1)
        for block, plant in zip(self._blocks, self._plants, strict=True):
            state = self.state_of([column[block] for column in self.columns])
            state, gripper[block], stirred[block], dt = act_arm(self.x, self.task, state, list(actions[:, block]))
            period[block] = dt
            self._look(block, state, plant, compensate, dt)
        return self.canopies.happen(going, before, gripper, stirred, period)

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the next step depends on."""
        return super().state_arrays() | self.canopies.state_arrays()

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays that `state_arrays` returned."""
        super().take_state_arrays(state)
        self.canopies.take_state_arrays(state)

    def _look(self, where: Any, state: ArmState, plant: Plant, compensate: Compensators | None, dt: Scalar) -> None:
        command, moments = self.commands(compensate, list(state.target), where), self.canopies.moments[where]
        state, sight = look_at_arm(self.x, self.task, plant, state, command, self.keys[where], moments, dt)
        self.write(self.columns, where, state.columns)
        self.write(list(self.canopies.sight), where, [*sight, *command])
