"""Many reach tasks on torch tensors: the same formulas as on NumPy, compiled into few kernels.

A step takes and returns tensors on any device, and does not wait for the device. Episodes begin eagerly, only in the
environments concerned. float64 agrees with NumPy within 1e-9; float32 keeps positions within 1 um.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Plant, Scalar, plants_on
from pickenv.base import InputError
from pickenv.envs.reaching.batch import Batch, Views
from pickenv.envs.shared import simulation
from pickenv.envs.shared.arm_batch import Columns, Words, naming_effects
from pickenv.envs.shared.backends import Flags, Rows, torch_executor
from pickenv.envs.shared.task import Compensators, Task, as_numbers, check_choice

DTYPES = {"float64": torch.float64, "float32": torch.float32}
Tensor = torch.Tensor


class TorchBatch(Batch):
    """The state of N reach tasks in tensors; `pickenv.envs.reaching.batch.Batch` explains the methods.

    Args:
        task: The task that all environments have in common.
        count: N.
        goal_dict: Whether observations are goal dictionaries, from which rewards are computed.
        poses: Whether `Views` hold pose errors, joint commands and positions.
        device: "cpu", "cuda", ...
        dtype: "float64" or "float32".
        compiled: Whether the step is compiled by `torch.compile`; if not, it runs eagerly.

    Attributes:
        BLOCK: Number of environments that begin an episode together on a CPU: as many as fit its cache.
        MOST_FUSED: Largest number of operations in one loop. torch's own limit of 64 would split the step into loops
            that wait for memory.

    Raises:
        InputError: If the device cannot be used, or the number type is unknown.
    """

    remade = ("_step", "_see", "_pack")
    BLOCK, MOST_FUSED = 32768, 4096

    def __init__(
        self, task: Task, count: int, goal_dict: bool, poses: bool, device: str, dtype: str, compiled: bool
    ) -> None:
        check_choice("dtype", dtype, tuple(DTYPES))
        try:
            self.device = torch.empty(0, device=device).device
        except (RuntimeError, AssertionError) as error:
            raise InputError(f"device {device!r} cannot be used ({str(error).splitlines()[0]}); give cpu") from error
        self.dtype = DTYPES[dtype]
        self.x = torch_executor()
        self.block = self.BLOCK if self.device.type == "cpu" else count
        super().__init__(task, count, goal_dict, poses)
        self.population: Plant = plants_on(task.plant, self.numbers)
        self.plant: Plant = self.population
        if task.arms != "fixed":
            self.plant = plants_on(task.plant, lambda values: self.numbers(values[self.arm]))
        middle = list(self.numbers(np.repeat([task.middle], count, axis=0).T))
        with naming_effects(self.plant, "torch"):  # fills the plant's caches, which torch.compile cannot
            self.plant.tool_frame(torch, middle)
            state = self.plant.initial_state(torch, middle)
            self.plant.advance(torch, state, middle, 0.0)
            self.plant.readings(torch, state, middle)
        self.make_room(12, 3)
        self.columns = [column.clone() for column in self.columns]
        self._compiled = compiled
        self.remake()

    def remake(self) -> None:
        """Prepare the step for compilation, if the argument ``compiled`` was True."""
        self._step, self._see = self._fused(self._act), self._fused(self._shown)
        self._pack = self._fused(_packed)

    def _fused(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Compile ``function`` if steps are compiled; on a CPU, into one loop that stores no intermediate results."""
        if not self._compiled:
            return function
        options: Any = {"max_fusion_size": self.MOST_FUSED} if self.device.type == "cpu" else {}
        return torch.compile(function, fullgraph=True, dynamic=False, options=options)

    def numbers(self, values: Array) -> Tensor:
        """Copy a NumPy array to the device, in the batch's number type."""
        return torch.as_tensor(np.array(values), device=self.device, dtype=self.dtype)

    def words(self, words: Words) -> Tensor:
        """Copy 64-bit words to the device, as int64 with the same bits."""
        return torch.as_tensor(words.view(np.int64), device=self.device)

    def indices(self, rows: Rows) -> Tensor:
        """Copy indices of environments, or of arms, to the device."""
        return torch.as_tensor(rows, device=self.device)

    def flags(self, flags: Flags) -> Tensor:
        """Copy booleans to the device."""
        return torch.tensor(flags, device=self.device)

    def host(self, values: Scalar) -> NDArray[Any]:
        """Convert a tensor to a NumPy array; this waits for the device."""
        return np.asarray(values.cpu().numpy() if isinstance(values, Tensor) else values)

    def put(self, column: Tensor, where: Any, values: Scalar) -> None:
        """Write ``values`` into a column, for the environments ``where``, indices or a slice."""
        column[where] = values.to(column.dtype)

    def given(self, actions: ArrayLike | Tensor) -> Tensor:
        """Convert actions to a tensor on the device."""
        values = actions if isinstance(actions, Tensor) else as_numbers("actions", actions)
        return torch.as_tensor(values, device=self.device)

    def components(self, actions: Tensor) -> tuple[Tensor, float, float]:
        """Return actions ``(N, n)`` as components ``(n, N)``, and the smallest and the largest number in them.

        On a device other than the CPU both numbers are returned as zero, so that the step need not wait for them.
        """
        low, high = torch.aminmax(actions) if self.device.type == "cpu" else (0.0, 0.0)
        return actions.T.to(self.dtype, copy=True).contiguous(), float(low), float(high)

    def advance(self, actions: Tensor, moments: Words, compensate: Compensators | None) -> Views:
        """Act in all environments; see `Batch.advance`."""
        n, fixed, situation = self.task.joints, self.fixed, self.task.situation
        dt: Scalar = situation.period.low
        if self.plant.has_state:
            dt = situation.value("period", self.state_of(self.columns).drawn)
            dt = dt if situation.period.varies else self.numbers(np.full(self.count, dt))
        noisy = self.task.camera_noise or situation.joint_noise.high
        common = (self.keys, self.words(moments) if noisy else self.keys, dt)
        if compensate is None:
            out = self._step(self.columns, list(actions), *common)
        else:
            state = simulation.act(self.x, self.task, self.state_of(self.columns), list(actions))
            columns = state.columns
            out = [*state.target, *self._see(columns, self.commands(compensate, columns[:n]), *common)]
        memory = len(self.columns) - fixed
        self.columns = [*out[:n], *self.columns[n:fixed], *out[n : n + memory]]
        return self._outcome(out[n + memory :], self.columns[n + 9 : n + 12])

    def show(self, rows: Rows, compensate: Compensators | None) -> Views:
        """Return the `Views` of the environments ``rows`` at the beginning of their episodes; see `Batch.show`."""
        n, places = self.task.joints, self.indices(rows)
        columns, keys = [column[places] for column in self.columns], self.keys[places]
        commands, still = self.commands(compensate, columns[:n], places), torch.zeros_like(keys)
        out = self._shown(columns, commands, keys, still, 0.0, self.plant_of(places))
        memory = len(columns) - self.fixed
        self.write(self.columns[self.fixed :], places, out[:memory])
        return self._outcome(out[memory:], columns[n + 9 : n + 12])

    def _act(self, columns: Columns, actions: Columns, *rest: Any) -> Columns:
        """Act without a compensator; return the new joint targets, then the columns that `_shown` returns.

        ``rest`` has the arguments of `_shown` after ``commands``.
        """
        state = simulation.act(self.x, self.task, self.state_of(columns), actions)
        return [*state.target, *self._shown(state.columns, list(state.target), *rest)]

    def _shown(
        self, columns: Columns, commands: Columns, keys: Tensor, when: Tensor, dt: Scalar, plant: Plant | None = None
    ) -> Columns:
        """Simulate the time ``dt`` at joint commands; return the results as columns of one number type.

        First come the numbers of the state that change in an episode, then observation, reward, `numbers` and
        `vectors` as in `Views`. The reward is left out with goal dictionaries, and the fruit's position is left out of
        `vectors`. A compiled loop on a CPU is fast with such columns. `_outcome` stacks and converts them.

        Args:
            columns: The state, with the new joint targets.
            commands: Joint commands, n components, rad or m.
            keys: Keys of the episodes.
            when: Number of steps in each episode so far; used only for noise.
            dt: Time to simulate, s.
            plant: The true arms; None for the true arms of all environments.
        """
        x, plant = self.x, plant or self.plant
        state, scene = simulation.look(x, self.task, plant, self.state_of(columns), commands, keys, when, dt)
        reward = [] if self.goal_dict else [simulation.true_reward(x, self.task, scene)]
        vectors = scene.vectors[:-3] if self.poses else ()
        memory = [value.to(self.dtype) for value in state.columns[self.fixed :]]
        return [*memory, *chain.from_iterable(self.parts(scene)), *reward, *scene.numbers, *vectors]

    def _outcome(self, out: Columns, fruit: Columns) -> Views:
        """Make `Views` from the fruit's position and the columns of `_shown`, without the columns of the state."""
        parts = []
        for width in self.widths():
            parts.append(self._pack(out[:width], torch.float32))
            out = out[width:]
        if self.goal_dict:  # of goals as they are returned
            reward = simulation.goal_reward(self.x, self.task, *(part.to(self.dtype) for part in parts[1:]))
        else:
            reward, *out = out
        success = simulation.in_capture_region(self.task, out[0], out[1])
        vectors = self._pack([*out[4:], *fruit], self.dtype) if self.poses else None
        return Views(tuple(parts), reward, success, tuple(out[:4]), vectors)


def _packed(columns: Columns, dtype: torch.dtype) -> Tensor:
    return torch.stack([column.to(dtype) for column in columns])
