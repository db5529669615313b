"""Many reach tasks side by side on torch: the same formulas as `batch`, compiled into few kernels.

Tensors in and out, on any device; the step does not wait for the device. Episodes begin eagerly, in the environments
that begin one. float64 agrees with NumPy within 1e-9; float32 keeps positions within 1 um.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.dynamics import PlantState
from pickenv.arm.plant.plant import Plant
from pickenv.envs.reaching.batch import Compensate, Outcome, Rows, Start
from pickenv.envs.shared.arms import changed_plant, choose_arm, numbers_of, population_size, prepare
from pickenv.envs.shared.backends import Executor, torch_executor
from pickenv.envs.shared.simulation import (
    ReachState,
    begin,
    flat_observation,
    goal_attempt,
    goal_observation,
    look,
    move,
    nominal_frames,
    true_reward,
)
from pickenv.envs.shared.streams import GOAL, episode_key, stream_key
from pickenv.envs.shared.task import CONTROL_PERIOD, GOAL_ATTEMPTS, MOST_ACTION, Task, as_numbers, check_choice
from pickenv.errors import InputError

DTYPES = {"float64": torch.float64, "float32": torch.float32}
BLOCK = 32768
"""Environments that begin an episode together when run eagerly on a processor: what its cache holds."""

MOST_FUSED = 4096
"""Operations that may share one loop; torch's own limit of 64 cuts the step into pieces that wait for the memory."""

Tensor = torch.Tensor
Columns = list[Tensor]


class TorchBatch:
    """The state of N reach tasks in tensors; see `pickenv.envs.reaching.batch.Batch`, whose methods it has.

    Args:
        task: What all have in common.
        count: N.
        goal_dict: Whether observations are goal dictionaries, and rewards made of them.
        poses: Whether pose errors, commands and positions are given.
        device: "cpu", "cuda", ...
        dtype: "float64" or "float32".
        compiled: Whether the step is compiled.

    Raises:
        InputError: If there is no such device or number type.
    """

    def __init__(
        self, task: Task, count: int, goal_dict: bool, poses: bool, device: str, dtype: str, compiled: bool
    ) -> None:
        check_choice("dtype", dtype, tuple(DTYPES))
        try:
            self.device = torch.empty(0, device=device).device
        except (RuntimeError, AssertionError) as error:
            raise InputError(f"device {device!r} cannot be used ({str(error).splitlines()[0]}); give cpu") from error
        self.task, self.count, self.goal_dict, self.dtype = task, count, goal_dict, DTYPES[dtype]
        self.poses = poses
        self.x: Executor = torch_executor()
        self.arm = np.zeros(count, dtype=np.intp)
        self._population = changed_plant(task.plant, self._tensor)
        self.plant: Plant = self._population
        if task.arms != "fixed":
            self.plant = changed_plant(task.plant, lambda values: self._tensor(values[self.arm]))
        middle = [self._full(count, value) for value in task.middle]
        prepare(self.plant, torch, middle)
        memory = self.plant.initial_state(torch, middle)
        self._memory = [len(part) for part in memory]
        self._targets = [self._full(count, 0.0) for _ in range(task.joints)]
        self._goals = [self._full(count, 0.0) for _ in range(15)]
        self._memories = [self._full(count, 0.0) for _ in range(sum(self._memory))]
        self._keys = torch.zeros(count, device=self.device, dtype=torch.int64)
        self._compiled = compiled
        self._make_step()

    def _make_step(self) -> None:
        self._step, self._see = self._fused(self._act), self._fused(self._shown)
        self._pack = self._fused(_packed)

    def _fused(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function`` compiled; on a processor into one loop, whose intermediate results never reach the memory."""
        if not self._compiled:
            return function
        options: Any = {"max_fusion_size": MOST_FUSED} if self.device.type == "cpu" else {}
        return torch.compile(function, fullgraph=True, dynamic=False, options=options)

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the compiled step, which is compiled anew."""
        return {key: value for key, value in vars(self).items() if key not in ("_step", "_see", "_pack", "x")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """The inverse of `__getstate__`."""
        vars(self).update(state)
        self.x = torch_executor()
        self._make_step()

    def restart(self, rows: Rows, how: Start, compensate: Compensate | None) -> None:
        """Begin an episode in the environments ``rows``."""
        x, task = self.x, self.task
        where = torch.as_tensor(rows, device=self.device)
        keys = episode_key(x, self._words(how.seeds), self._words(how.episodes))
        self._keys[where] = keys
        if task.arms != "fixed":
            self._take_arms(rows, where, how, keys)
        block = BLOCK if self.device.type == "cpu" else len(rows)
        for a in range(0, len(rows), block):
            some, key = where[a : a + block], keys[a : a + block]
            size = len(some)
            start = [self._full(size, value) for value in task.middle]
            if how.start is not None:
                start = list(self._tensor(how.start[a : a + block].T))
            joints = self._draw_goals(key) if how.goal is None else self._tensor(how.goal[a : a + block].T)
            goal = tuple(v + self._full(size, 0.0) for v in nominal_frames(x, task, list(joints))[1])
            plant = self._plant_of(some)
            state = begin(x, task, plant, key, start, goal, self._commands(compensate, start))
            memory = [component for part in state.plant for component in part]
            mine = (*self._targets, *self._goals, *self._memories)
            for values, new in zip(mine, (*state.target, *state.goal, *state.seen, *memory), strict=True):
                values[some] = new if isinstance(new, float) else new.to(self.dtype)

    def advance(
        self, actions: Tensor, moments: NDArray[Any], live: NDArray[np.bool_] | None, compensate: Any
    ) -> Outcome:
        """Act in all environments; see `pickenv.envs.reaching.batch.Batch.advance`."""
        dt: Any = CONTROL_PERIOD
        if live is not None:
            alive = torch.as_tensor(live, device=self.device).to(self.dtype)
            actions = actions * alive
        if self.plant.has_state:  # where an episode has just begun no time passes
            dt = self._full(self.count, CONTROL_PERIOD) if live is None else dt * alive
        when = self._words(moments) if self.task.camera_noise else self._keys
        rest = (self._goals, self._memories, self._keys, when, dt)
        if compensate is None:
            out = self._step(self._targets, list(actions), *rest)
        else:
            moved = list(move(self.x, self.task, self._targets, list(actions)))
            out = [*moved, *self._see(moved, self._commands(compensate, moved), *rest)]
        n, m = self.task.joints, len(self._memories)
        self._targets, self._memories = list(out[:n]), list(out[n : n + m])
        return self._outcome(out[n + m :], self._goals)

    def show(self, rows: Rows, compensate: Compensate | None) -> Outcome:
        """What the environments ``rows`` show at the beginning of their episodes."""
        where = torch.as_tensor(rows, device=self.device)
        targets, goals, memories = ([v[where] for v in part] for part in (self._targets, self._goals, self._memories))
        commands, still = self._commands(compensate, targets), torch.zeros_like(self._keys[where])
        out = self._shown(targets, commands, goals, memories, self._keys[where], still, 0.0, self._plant_of(where))
        for values, new in zip(self._memories, out, strict=False):
            values[where] = new
        return self._outcome(out[len(memories) :], goals)

    def _act(self, targets: Columns, actions: Columns, *rest: Any) -> Columns:
        """One step of all environments, without a compensator: new targets, then what `_shown` gives."""
        moved = list(move(self.x, self.task, targets, actions))
        return [*moved, *self._shown(moved, moved, *rest)]

    def _shown(
        self,
        targets: Columns,
        commands: Columns,
        goals: Columns,
        memories: Columns,
        keys: Tensor,
        when: Tensor,
        dt: Any,
        plant: Plant | None = None,
    ) -> Columns:
        """Memories, observation, reward, numbers and vectors, all in one number type and side by side.

        That is what a processor's compiled loop is fast with: stacking, float32 and truth values come afterwards.
        """
        x, plant = self.x, plant or self.plant
        state = ReachState(tuple(targets), tuple(goals[:12]), tuple(goals[12:]), self._memory_of(memories))
        memory, scene = look(x, self.task, plant, state, commands, keys, when, dt)
        new = [component for part in memory for component in part]
        parts = goal_observation(scene) if self.goal_dict else (flat_observation(scene),)
        reward = [] if self.goal_dict else [true_reward(x, self.task, scene)]
        numbers = (scene.distance_mm, scene.angle_deg, scene.lost_deg, scene.kept_deg)
        seen = [component for part in parts for component in part]
        vectors = (*scene.error, *scene.command, *scene.tool) if self.poses else ()
        return [*new, *seen, *reward, *numbers, *vectors]

    def _outcome(self, out: Columns, goals: Columns) -> Outcome:
        """Columns of `_shown` as an `Outcome`."""
        task, n = self.task, self.task.joints
        widths = (n + 6, 3, 3) if self.goal_dict else (n + 12 + 3 * task.camera,)
        parts, first = [], 0
        for width in widths:
            parts.append(self._pack(out[first : first + width], torch.float32))
            first += width
        if self.goal_dict:
            reward = goal_reward_of(task, parts[1].to(self.dtype), parts[2].to(self.dtype))
        else:
            reward, first = out[first], first + 1
        numbers = out[first : first + 4]
        success = (numbers[0] <= task.tolerance_mm) & (numbers[1] <= task.angle_tolerance_deg)
        vectors = [*out[first + 4 :], *goals[9:12]] if self.poses else []
        return Outcome(tuple(parts), reward, success, numbers, self._pack(vectors, self.dtype) if vectors else None)

    def scene(self, row: int, compensate: Compensate | None) -> tuple[Array, list[Any]]:
        """Joint target and everything that can be seen of one environment, on floats; no time passes."""
        where = torch.tensor([row], device=self.device)
        targets, goals, memories = ([v[where] for v in part] for part in (self._targets, self._goals, self._memories))
        state = ReachState(tuple(targets), tuple(goals[:12]), tuple(goals[12:]), self._memory_of(memories))
        plant, commands, key = self._plant_of(where), self._commands(compensate, targets), self._keys[where]
        _, scene = look(self.x, self.task, plant, state, commands, key, torch.zeros_like(key), 0.0)
        parts = [[float(v) for v in part] if isinstance(part, tuple) else float(part) for part in scene]
        return np.array([float(value) for value in targets]), parts

    def numbers_of_actions(self, actions: ArrayLike | Tensor) -> Tensor:
        """Actions component by component ``(n, N)``; on a processor their size is checked.

        Raises:
            InputError: If they have another shape, or numbers beyond -1 to 1.
        """
        given = actions if isinstance(actions, Tensor) else as_numbers("actions", actions)
        values = torch.as_tensor(given, device=self.device)
        shape = (self.count, self.task.joints)
        if tuple(values.shape) != shape:
            raise InputError(f"actions have shape {tuple(values.shape)}; give {shape}, numbers between -1 and 1")
        if self.device.type == "cpu":
            low, high = torch.aminmax(values)
            if not (high <= MOST_ACTION and low >= -MOST_ACTION):
                row = int(torch.argmin((values.abs() <= MOST_ACTION).all(dim=1).int()))
                raise InputError(
                    f"the action of environment {row} is {values[row].tolist()}; give finite numbers between -1 and 1"
                )
        return values.T.to(self.dtype).contiguous()

    @staticmethod
    def on_host(flags: Tensor) -> NDArray[np.bool_]:
        """Truth values as a NumPy array."""
        return np.asarray(flags.cpu().numpy())

    def on_device(self, flags: NDArray[np.bool_]) -> Tensor:
        """Truth values where the executor wants them."""
        return torch.tensor(flags, device=self.device)

    def masked_rewards(self, rewards: Tensor, live: NDArray[np.bool_]) -> Tensor:
        """Rewards, zero where an episode has just begun."""
        return rewards * self.on_device(live)

    @staticmethod
    def copied(out: Outcome) -> Outcome:
        """The same, in memory of its own."""
        observation, numbers = tuple(part.clone() for part in out.observation), [row.clone() for row in out.numbers]
        vectors = None if out.vectors is None else out.vectors.clone()
        return Outcome(observation, out.reward.clone(), out.success.clone(), numbers, vectors)

    def merged(self, out: Outcome, rows: Rows, some: Outcome) -> Outcome:
        """What all show, with the environments ``rows`` replaced; in memory of its own."""
        out, where = self.copied(out), torch.as_tensor(rows, device=self.device)
        for all_, few in zip(_tensors(out), _tensors(some), strict=True):
            all_[..., where] = few
        return out

    @staticmethod
    def final_observations(observations: Any, rows: Rows) -> Any:
        """The observations as they are: a batch, of which `_final_obs` marks the rows that count."""
        return observations

    def _draw_goals(self, keys: Tensor) -> Tensor:
        """Joints ``(n, count)`` of the first pose of each stream whose tool points upwards."""
        task, streams = self.task, stream_key(self.x, keys, GOAL)
        joints = torch.empty((task.joints, len(keys)), device=self.device, dtype=torch.float64)
        open_ = torch.arange(len(keys), device=self.device)
        for attempt in range(GOAL_ATTEMPTS):
            tried, upright = goal_attempt(self.x, task, streams[open_], attempt)
            joints[:, open_] = torch.stack(tried)
            open_ = open_[~upright]
            if not len(open_):
                return joints.to(self.dtype)
        raise task.no_goal()

    def _take_arms(self, rows: Rows, where: Tensor, how: Start, keys: Tensor) -> None:
        """Give the environments ``rows`` the true arms of their episodes."""
        task, size = self.task, population_size(self.task)
        if how.arm is not None:
            self.arm[rows] = how.arm
        else:
            chosen = keys
            if task.arms == "per_env":
                chosen = episode_key(self.x, self._words(how.seeds), torch.zeros_like(keys))
            self.arm[rows] = (choose_arm(self.x, chosen) * size).long().cpu().numpy()
        arms = torch.as_tensor(self.arm[rows], device=self.device)
        for mine, all_ in zip(numbers_of(self.plant), numbers_of(self._population), strict=True):
            mine[where] = all_[arms]

    def _plant_of(self, where: Tensor) -> Plant:
        return changed_plant(self.plant, lambda values: values[where])

    def _memory_of(self, memories: Columns) -> PlantState:
        parts, first = [], 0
        for length in self._memory:
            parts.append(tuple(memories[first : first + length]))
            first += length
        return PlantState(*parts)

    def _commands(self, compensate: Compensate | None, targets: Columns) -> Columns:
        """What the drives get for joint targets; a compensator works on NumPy."""
        if compensate is None:
            return targets
        commands = compensate(torch.stack(targets, dim=-1).double().cpu().numpy())
        return list(self._tensor(np.asarray(commands).T))

    def _words(self, words: NDArray[np.uint64]) -> Tensor:
        return torch.as_tensor(words.view(np.int64), device=self.device)

    def _tensor(self, values: Array) -> Tensor:
        return torch.as_tensor(np.array(values), device=self.device, dtype=self.dtype)

    def _full(self, count: int, value: float) -> Tensor:
        return torch.full((count,), value, device=self.device, dtype=self.dtype)


def _tensors(out: Outcome) -> list[Tensor]:
    vectors = [] if out.vectors is None else [out.vectors]
    return [*out.observation, out.reward, out.success, *out.numbers, *vectors]


def _packed(columns: Columns, dtype: torch.dtype) -> Tensor:
    return torch.stack([column.to(dtype) for column in columns])


def goal_reward_of(task: Task, achieved: Tensor, desired: Tensor) -> Tensor:
    """`pickenv.envs.reaching.reach_goal.goal_reward` on tensors ``(3, N)``."""
    step = achieved - desired
    distance_mm = 1e3 * torch.sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
    if task.sparse:
        return torch.where(distance_mm <= task.tolerance_mm, 0.0, distance_mm * 0.0 - 1.0)
    return -torch.log10(1.0 + distance_mm)
