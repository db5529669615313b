"""The state of many arms side by side, component by component, on any executor: the base of every native batch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Plant, arrays_of, plants_on
from pickenv.base import InputError
from pickenv.envs.shared.backends import NUMPY, Executor, Flags, Rows, Scalar
from pickenv.envs.shared.simulation import ArmState
from pickenv.envs.shared.situation import drawn_start
from pickenv.envs.shared.task import Compensate, Task, as_numbers, bounds_of, exact_plant

Words = NDArray[np.uint64]
Columns = list[Scalar]


@contextmanager
def naming_effects(plant: Plant, executor: str) -> Iterator[None]:
    """A context in which an executor's error becomes a sentence that names the plant's effects from other packages.

    Raises:
        InputError: If anything is raised inside, and the plant has effects from other packages.
    """
    try:
        yield
    except Exception as error:
        names = [effect.name for effect in plant.effects if not type(effect).__module__.startswith("pickenv.")]
        if not names:
            raise
        raise InputError(
            f"the executor {executor!r} cannot compute the plant with the effect {', '.join(names)} "
            f"({type(error).__name__}: {str(error).splitlines()[0] if str(error) else 'no reason given'}); give "
            "executor='numpy', or let the effect keep to the functions of Passage.m"
        ) from error


class ArmBatch:
    """The state of N arms, one per environment.

    The methods from `numbers` to `components` decide where the state's numbers live: in NumPy, unless overridden.

    Attributes:
        x: The executor.
        block: Number of environments that begin an episode together.
        task: The task that all environments have in common.
        count: N.
        actions: Count of numbers in an action.
        arm: Number of each environment's true arm in the population.
        plant: The true arms of the environments.
        population: The population that true arms are taken from.
        keys: Keys of the environments' episodes.
        columns: The state, one column per number.
        remade: Names of the attributes that are neither pickled nor copied, but made anew by `remake`.
    """

    x: Executor
    block: int
    plant: Plant
    population: Plant
    remade: tuple[str, ...] = ()

    def __init__(self, task: Task, count: int, actions: int) -> None:
        self.task, self.count, self.actions = task, count, actions
        self.arm: NDArray[np.intp] = np.zeros(count, dtype=np.intp)
        self.keys: Scalar = self.words(np.zeros(count, dtype=np.uint64))
        self.columns: Columns = []
        self._widths: list[int] = []

    def __getstate__(self) -> dict[str, Any]:
        """All attributes but those in `remade`."""
        return {key: value for key, value in vars(self).items() if key not in self.remade}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the attributes that `__getstate__` returned."""
        vars(self).update(state)
        self.remake()

    def remake(self) -> None:
        """Make the attributes in `remade`."""

    def make_room(self, goal: int, seen: int) -> None:
        """Make room for the arms' states, one column per number, and for the plants' memories.

        Args:
            goal: Count of numbers in a goal.
            seen: Count of numbers in the goal as the camera saw it.
        """
        n, middle = self.task.joints, list(self.numbers(np.array([self.task.middle]).T))
        memory = [len(part) for part in self.plant_of(slice(0, 1)).initial_state(self.x.m, middle)]
        self._widths = [n, goal, seen, *self.task.situation.widths(self.actions, n + 3 * self.task.camera), *memory]
        self.columns = list(self.numbers(np.zeros((sum(self._widths), self.count))))

    @property
    def fixed(self) -> int:
        """Count of the first columns, which stay fixed during an episode except for the joint target."""
        return sum(self._widths[:4])

    def numbers(self, values: Array) -> Scalar:
        """NumPy's numbers in the executor's memory, one component ``(count,)`` per row."""
        return np.ascontiguousarray(values)

    def words(self, words: Words) -> Scalar:
        """64-bit words in the executor's memory."""
        return words

    def indices(self, rows: Rows) -> Scalar:
        """Numbers of environments, or of arms, in the form that the executor indexes with."""
        return rows

    def flags(self, flags: Flags) -> Scalar:
        """A copy of truth values in the executor's memory."""
        return flags.copy()

    def host(self, values: Scalar) -> NDArray[Any]:
        """The executor's numbers as a NumPy array."""
        return np.asarray(values)

    def put(self, column: Scalar, where: Any, values: Scalar) -> None:
        """Write ``values`` into a column, for the environments ``where``."""
        column[where] = values

    def given(self, actions: ArrayLike) -> Scalar:
        """Actions as the executor's array; actions that need no conversion are not copied."""
        ready = isinstance(actions, np.ndarray) and actions.dtype.kind == "f"
        return np.asarray(actions) if ready else as_numbers("actions", actions)

    def components(self, actions: Scalar) -> tuple[Scalar, float, float]:
        """Actions ``(N, n)`` as components ``(n, N)``, with the least and the largest number in them."""
        numbers = actions.T.astype(np.float64, order="C")
        return numbers, float(numbers.min()), float(numbers.max())

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of everything that the arms' next step depends on."""
        table = np.array([self.host(column) for column in self.columns])
        return {"table": table, "keys": self.host(self.keys).view(np.uint64), "arm": self.arm}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Take over the arrays that `state_arrays` returned."""
        self.write(self.columns, slice(None), self.numbers(state["table"]))
        self.keys[:] = self.words(state["keys"])
        if self.task.arms != "fixed":
            self.take_arms(np.arange(self.count), state["arm"])

    def numbers_of_actions(self, actions: ArrayLike) -> Scalar:
        """Actions component by component ``(n, N)``, checked; on a device only their shape is checked.

        Raises:
            InputError: If actions have another shape, or numbers that are not finite, or numbers beyond -1 to 1 that
                the task refuses.
        """
        values, shape, most = self.given(actions), (self.count, self.actions), self.task.most_action
        if tuple(values.shape) != shape:
            raise InputError(f"actions have shape {tuple(values.shape)}; give {shape}, numbers between -1 and 1")
        numbers, low, high = self.components(values)
        if not (high <= most and low >= -most):
            rows = self.host(values)
            row = int(np.argmin((np.abs(rows) <= most).all(axis=1)))
            raise InputError(
                f"the action of environment {row} is {rows[row].tolist()}; give finite numbers{bounds_of(most)}"
            )
        return numbers

    def plant_of(self, where: Any) -> Plant:
        """The true arms of the environments ``where``."""
        return plants_on(self.plant, lambda values: values[where])

    def state_of(self, columns: Columns) -> ArmState:
        """The state that is stored in ``columns``."""
        return ArmState.of(columns, self._widths)

    def starts(self, keys: Scalar, joints: Array | None) -> Columns:
        """Joint targets that episodes start from: ``joints (episodes, n)`` if given, else drawn, else mid-range."""
        task = self.task
        if joints is None and task.situation.spread:
            return drawn_start(self.x, task.situation, keys, *task.box)
        return list(self.numbers((np.repeat([task.middle], len(keys), axis=0) if joints is None else joints).T))

    def commands(self, compensate: Compensate | None, targets: Columns) -> Columns:
        """Joint commands for joint targets; if there is a compensator, it gets and returns NumPy arrays."""
        if compensate is None:
            return targets
        joints = np.stack([self.host(target) for target in targets], axis=-1, dtype=np.float64, casting="same_kind")
        return list(self.numbers(np.asarray(compensate(joints)).T))

    def write(self, columns: Columns, where: Any, values: Sequence[Scalar]) -> None:
        """Write ``values`` into columns, for the environments ``where``.

        The last column is written first, so that entries of a queue are moved on before they are overwritten.
        """
        for column, new in zip(list(columns)[::-1], list(values)[::-1], strict=True):
            self.put(column, where, new)

    def blocks(self, count: int) -> Iterator[tuple[int, int]]:
        """The first environment of each block of ``count`` environments, and the first one after the block."""
        return ((a, min(a + self.block, count)) for a in range(0, count, self.block))

    def take_arms(self, rows: Rows, arms: NDArray[np.intp]) -> None:
        """Give the environments ``rows`` the true arms of their episodes."""
        self.arm[rows] = arms
        places, numbers = self.indices(rows), self.indices(self.arm[rows])
        for mine, all_ in zip(arrays_of(self.plant), arrays_of(self.population), strict=True):
            mine[places] = all_[numbers]


class NumpyArms(ArmBatch):
    """The state of N arms in NumPy's arrays.

    Arms are simulated in blocks that stay in the cache, so that an arm's step does not cost more the more arms there
    are.
    """

    x = NUMPY
    block = 2048
    """Number of arms in a block: a component then has 16 KiB, and a few components fit into a core's first cache."""

    def make_plants(self) -> None:
        """Make the true arms of all environments, and those of each block of environments."""
        self.population = self.plant = self.task.plant
        if self.task.arms != "fixed":
            self.plant = plants_on(self.task.plant, lambda values: values[self.arm])
        self.plant = exact_plant(self.plant)
        self._blocks = [slice(a, b) for a, b in self.blocks(self.count)]
        self._plants = [self.plant_of(block) for block in self._blocks]
