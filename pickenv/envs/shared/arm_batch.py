"""The state of many arms, one array per number of the state, on any executor: the base class of every batch."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Plant, Scalar, Scalars, arrays_of, plants_on
from pickenv.base import InputError
from pickenv.envs.shared.backends import NUMPY, Executor, Flags, Rows
from pickenv.envs.shared.simulation import ArmState
from pickenv.envs.shared.situation import drawn_start
from pickenv.envs.shared.task import Compensators, Task, as_numbers, bounds_of, commanded, exact_plant

Words = NDArray[np.uint64]
Columns = list[Scalar]


@contextmanager
def naming_effects(plant: Plant, executor: str) -> Iterator[None]:
    """Turn an error inside the context into one that names the effects of ``plant`` (the true arm) from other packages.

    ``executor`` is the name of the executor that computes the plant, for the message.

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

    The methods from `numbers` to `components` decide in which kind of array the state is stored. Here the arrays are
    NumPy's; subclasses may override these methods.

    Attributes:
        x: The executor.
        block: Number of environments whose episodes are begun in one computation.
        task: The task that all environments have in common.
        count: N.
        arm: Index (from 0) of each environment's true arm in the population.
        plant: The true arms of the environments.
        population: The population that true arms are taken from.
        keys: Keys of the environments' episodes, ``(N,)``.
        columns: The state, one array ``(N,)`` (a column) per number.
        remade: Names of the attributes that `remake` makes again, since they are neither pickled nor copied.
    """

    x: Executor
    block: int
    plant: Plant
    population: Plant
    remade: tuple[str, ...] = ()

    def __init__(self, task: Task, count: int) -> None:
        self.task, self.count = task, count
        self.arm: NDArray[np.intp] = np.zeros(count, dtype=np.intp)
        self.keys: Scalar = self.words(np.zeros(count, dtype=np.uint64))
        self.columns: Columns = []
        self._widths: list[int] = []

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes except the attributes that `remade` names."""
        return {key: value for key, value in vars(self).items() if key not in self.remade}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the attributes that `__getstate__` returned, and make the attributes that `remade` names."""
        vars(self).update(state)
        self.remake()

    def remake(self) -> None:
        """Make the attributes that `remade` names."""

    def make_room(self, goal: int, seen: int) -> None:
        """Allocate the columns for the arms' states, and for what the true arms remember, such as their backlash.

        Args:
            goal: Count of numbers in a goal.
            seen: Count of numbers in the goal position as the camera saw it.
        """
        task, middle = self.task, list(self.numbers(np.array([self.task.middle]).T))
        memory = [len(part) for part in self.plant_of(slice(0, 1)).initial_state(self.x.m, middle)]
        late = task.situation.widths(task.actions, task.joints + 3 * task.camera)
        self._widths = [task.joints, goal, seen, *late, *memory]
        self.columns = list(self.numbers(np.zeros((sum(self._widths), self.count))))

    @property
    def fixed(self) -> int:
        """Count of the columns at the front: the joint target, and the numbers that are constant in an episode."""
        return sum(self._widths[:4])

    def numbers(self, values: Array) -> Scalar:
        """Convert a NumPy array, one component ``(count,)`` per row, to the executor's kind of array."""
        return np.ascontiguousarray(values)

    def words(self, words: Words) -> Scalar:
        """Convert 64-bit words to the executor's kind of array."""
        return words

    def indices(self, rows: Rows) -> Scalar:
        """Convert indices of environments, or of arms, to the kind of array that the executor indexes with."""
        return rows

    def flags(self, flags: Flags) -> Scalar:
        """Copy booleans to the executor's kind of array."""
        return flags.copy()

    def host(self, values: Scalar) -> NDArray[Any]:
        """Convert the executor's numbers to a NumPy array."""
        return np.asarray(values)

    def put(self, column: Scalar, where: Any, values: Scalar) -> None:
        """Write ``values`` into a column, for the environments ``where``, indices or a slice."""
        column[where] = values

    def given(self, actions: ArrayLike) -> Scalar:
        """Convert actions to the executor's kind of array, without a copy if none is needed."""
        ready = isinstance(actions, np.ndarray) and actions.dtype.kind == "f"
        return np.asarray(actions) if ready else as_numbers("actions", actions)

    def components(self, actions: Scalar) -> tuple[Scalar, float, float]:
        """Return actions ``(N, n)`` as components ``(n, N)``, and the smallest and the largest number in them."""
        numbers = actions.T.astype(np.float64, order="C")
        return numbers, float(numbers.min()), float(numbers.max())

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the arms' next step depends on, for a checkpoint."""
        table = np.array([self.host(column) for column in self.columns])
        return {"table": table, "keys": self.host(self.keys).view(np.uint64), "arm": self.arm}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays that `state_arrays` returned."""
        self.write(self.columns, slice(None), self.numbers(state["table"]))
        self.keys[:] = self.words(state["keys"])
        if self.task.arms != "fixed":
            self.take_arms(np.arange(self.count), state["arm"])

    def numbers_of_actions(self, actions: ArrayLike) -> Scalar:
        """Check actions ``(N, n)``, and return their components ``(n, N)``.

        On a device such as a GPU only the shape is checked.

        Raises:
            InputError: If actions have another shape or numbers that are not finite, or if the task refuses numbers
                beyond -1 to 1.
        """
        values, shape, most = self.given(actions), (self.count, self.task.actions), self.task.most_action
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
        """Return the true arms of the environments ``where``, an index or a slice."""
        return plants_on(self.plant, lambda values: values[where])

    def state_of(self, columns: Columns) -> ArmState:
        """Return the state that is stored in ``columns``."""
        return ArmState.of(columns, self._widths)

    def starts(self, keys: Scalar, joints: Array | None) -> Columns:
        """Return the joint targets from which episodes start, as n components with one entry per episode.

        Args:
            keys: Keys of the episodes' random streams ``(episodes,)``.
            joints: Joint targets ``(episodes, n)``, rad or m. If None, the targets are drawn, or they are the middle of
                the joints' ranges if the task has no spread of starts.
        """
        task = self.task
        if joints is None and task.situation.spread:
            return drawn_start(self.x, task.situation, keys, *task.box)
        return list(self.numbers((np.repeat([task.middle], len(keys), axis=0) if joints is None else joints).T))

    def commands(self, compensate: Compensators | None, targets: Columns, where: Any = slice(None)) -> Columns:
        """Compute joint commands from joint targets, both n components.

        Args:
            compensate: Function from joint targets to joint commands, NumPy arrays ``(..., n)``, or one such function
                per environment. With None, commands equal targets.
            targets: The joint targets of the environments ``where``, rad or m.
            where: Indices (from 0) or slice of the environments.
        """
        if compensate is None:
            return targets
        joints = np.stack([self.host(target) for target in targets], axis=-1, dtype=np.float64, casting="same_kind")
        rows = where if isinstance(where, slice) else self.host(where)
        return list(self.numbers(commanded(compensate, joints, rows).T))

    def write(self, columns: Columns, where: Any, values: Scalars) -> None:
        """Write ``values`` into columns, for the environments ``where``, indices or a slice.

        The last column is written first. So a delayed action or reading moves on to later columns before the columns
        that hold it are overwritten.
        """
        for column, new in zip(list(columns)[::-1], list(values)[::-1], strict=True):
            self.put(column, where, new)

    def blocks(self, count: int) -> Iterator[tuple[int, int]]:
        """Split ``count`` environments into blocks; yield the first index of each block and the index after its end."""
        return ((a, min(a + self.block, count)) for a in range(0, count, self.block))

    def take_arms(self, rows: Rows, arms: NDArray[np.intp]) -> None:
        """Give the environments ``rows`` the true arms with the indices ``arms`` (from 0) in the population."""
        self.arm[rows] = arms
        places, numbers = self.indices(rows), self.indices(self.arm[rows])
        for mine, all_ in zip(arrays_of(self.plant), arrays_of(self.population), strict=True):
            mine[places] = all_[numbers]


class NumpyArms(ArmBatch):
    """The state of N arms in NumPy's arrays.

    Arms are simulated in blocks that fit into the processor's cache, so that the time per arm does not grow with the
    number of arms.

    Attributes:
        block: Number of arms in a block. A component then takes 16 KiB; a core's first-level cache holds a few of them.
    """

    x = NUMPY
    block = 2048
    remade: tuple[str, ...] = ("_plants",)

    def make_plants(self) -> None:
        """Set the true arms of all environments, and the blocks of environments that are simulated together."""
        self.population = self.plant = self.task.plant
        if self.task.arms != "fixed":
            self.plant = plants_on(self.task.plant, lambda values: values[self.arm])
        self.plant = exact_plant(self.plant)
        self._blocks = [slice(a, b) for a, b in self.blocks(self.count)]

    def remake(self) -> None:
        """Make the true arms of each block of environments, as parts of `plant` that share its arrays."""
        self._plants = [self.plant_of(block) for block in self._blocks]
