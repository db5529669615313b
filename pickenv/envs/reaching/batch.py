"""Many reach tasks side by side: their state, component by component, and how an episode begins, on any executor.

`numpy_batch` and `torch_batch` say where the numbers live and how a step goes through them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Plant, PlantState, plants_on
from pickenv.arm.plant.plant_batch import arrays_of
from pickenv.arm.plant.tree import leaves, tree_map
from pickenv.envs.shared.backends import Executor, Scalar
from pickenv.envs.shared.simulation import (
    GOAL_NUMBERS,
    ReachState,
    View,
    begin,
    drawn_arm,
    goal_attempt,
    look,
    nominal_frames,
)
from pickenv.envs.shared.situation import drawn_start
from pickenv.envs.shared.streams import GOAL, episode_key, stream_key
from pickenv.envs.shared.task import GOAL_ATTEMPTS, Compensate, Task, bounds_of
from pickenv.errors import InputError

Flags = NDArray[np.bool_]
Words = NDArray[np.uint64]
Rows = NDArray[np.intp]
Columns = list[Scalar]


class Start(NamedTuple):
    """How episodes are to begin, one entry per environment that begins one.

    Attributes:
        seeds: Streams' seeds.
        episodes: Numbers of the episodes.
        start: Joint targets ``(count, n)``, or None for mid-range.
        goal: Joints of wanted poses ``(count, n)``, or None.
        wanted: Frames of wanted poses ``(count, 12)``, or None; without either they are drawn.
        arm: Numbers of true arms ``(count,)``, or None to draw them.
    """

    seeds: Words
    episodes: Words
    start: Array | None = None
    goal: Array | None = None
    wanted: Array | None = None
    arm: NDArray[np.intp] | None = None


class Views(NamedTuple):
    """What many environments show, component by component, one column per environment; see `simulation.View`.

    Attributes:
        observation: One array ``(k, count)`` per part of the observation, float32.
        reward: ``(count,)``.
        success: ``(count,)``.
        numbers: What `simulation.NUMBER_KEYS` names, four rows ``(count,)``.
        vectors: `View.vectors`, ``(12 + n, count)``; nothing without poses.
    """

    observation: tuple[Scalar, ...]
    reward: Scalar
    success: Scalar
    numbers: Scalar
    vectors: Scalar


class Batch(ABC):
    """The state of N reach tasks; where their numbers live is for `numbers` to `copy`: in NumPy, unless overridden.

    Attributes:
        x: The executor.
        block: Environments that begin an episode together.
        task: What all have in common.
        count: N.
        goal_dict: Whether observations are goal dictionaries, and rewards made of them.
        poses: Whether pose errors, commands and positions are given.
        arm: Number of each one's true arm.
        plant: Their true arms.
        population: What true arms are taken from.
    """

    x: Executor
    block: int
    plant: Plant
    population: Plant

    def __init__(self, task: Task, count: int, goal_dict: bool, poses: bool) -> None:
        self.task, self.count, self.goal_dict, self.poses = task, count, goal_dict, poses
        self.arm: NDArray[np.intp] = np.zeros(count, dtype=np.intp)
        self.keys: Scalar = self.words(np.zeros(count, dtype=np.uint64))
        self.columns: Columns = []
        self._widths: list[int] = []
        self._plant_widths: list[int] = []

    def remember(self) -> None:
        """Make room for the state: everything in `ReachState`, one column per number."""
        n, camera = self.task.joints, 3 * self.task.camera
        middle = list(self.numbers(np.array([self.task.middle]).T))
        self._plant_widths = [len(part) for part in self.plant_of(slice(0, 1)).initial_state(self.x.m, middle)]
        self._widths = [n, 12, 3, *self.task.situation.widths(n, n + camera)]
        self.columns = list(self.numbers(np.zeros((sum(self._widths) + sum(self._plant_widths), self.count))))

    @property
    def fixed(self) -> int:
        """Columns up to which nothing changes during an episode, but the joint target."""
        return sum(self._widths[:4])

    @property
    def remembers(self) -> bool:
        """Whether a step that never was would leave a trace."""
        return self.plant.has_state or self.task.situation.late

    def numbers(self, values: Array) -> Scalar:
        """NumPy's numbers where the executor computes, one component ``(count,)`` per row."""
        return np.ascontiguousarray(values)

    def words(self, words: Words) -> Scalar:
        """64-bit words where the executor computes."""
        return words

    def indices(self, rows: Rows) -> Scalar:
        """Numbers of environments, or arms, as the executor indexes with them."""
        return rows

    def flags(self, flags: Flags) -> Scalar:
        """Truth values where the executor computes."""
        return flags

    def host(self, values: Scalar) -> NDArray[Any]:
        """The executor's numbers as a NumPy array."""
        return np.asarray(values)

    def put(self, column: Scalar, where: Any, values: Scalar) -> None:
        """Write into some environments of a column."""
        column[where] = values

    def copy(self, values: Scalar) -> Scalar:
        """An array in memory of its own."""
        return np.copy(values)

    def copied(self, out: Views) -> Views:
        """The same, in memory of its own."""
        return cast(Views, tree_map(self.copy, out))

    @abstractmethod
    def given(self, actions: ArrayLike) -> Scalar:
        """Actions as the executor's array, as they come."""

    @abstractmethod
    def components(self, actions: Scalar) -> tuple[Scalar, float, float]:
        """Actions ``(N, n)`` as components ``(n, N)``, their least and their largest number."""

    @abstractmethod
    def show(self, rows: Rows, compensate: Compensate | None) -> Views:
        """What the environments ``rows`` show at the beginning of their episodes."""

    @abstractmethod
    def advance(self, actions: Scalar, moments: Words, live: Flags | None, compensate: Compensate | None) -> Views:
        """Act in all environments.

        Args:
            actions: Component by component, ``(n, N)``.
            moments: Number of the step in each one's episode.
            live: Where time passes; None: everywhere. Elsewhere an episode has just begun: the action is ignored and
                the reward is zero.
            compensate: Turns joint targets into joint commands, or None.
        """

    @abstractmethod
    def final_observations(self, observations: Any, rows: Rows) -> Any:
        """The last observations of ``rows`` as infos give them."""

    def restart(self, rows: Rows, how: Start, compensate: Compensate | None) -> None:
        """Begin an episode in the environments ``rows``."""
        x, task, n, where = self.x, self.task, self.task.joints, self.indices(rows)
        keys = episode_key(x, self.words(how.seeds), self.words(how.episodes))
        self.keys[where] = keys
        if task.arms != "fixed":
            self._take_arms(rows, how, keys)
        middle = np.broadcast_to(np.array(task.middle), (len(rows), n))
        for a, b in self.blocks(len(rows)):
            some, key = where[a:b], keys[a:b]
            if how.start is None and task.situation.spread:
                start = drawn_start(x, task.situation, key, task.lower, task.upper)
            else:
                start = list(self.numbers((middle if how.start is None else how.start)[a:b].T))
            if how.wanted is None:
                goal = self._draw_goals(key) if how.goal is None else list(self.numbers(how.goal[a:b].T))
                wanted = nominal_frames(x, task, goal)[1]
            else:
                wanted = tuple(self.numbers(how.wanted[a:b].T))
            state = begin(x, task, self.plant_of(some), key, start, wanted, self.commands(compensate, start))
            self.write(self.columns, some, state.columns)

    def scene(self, row: int, compensate: Compensate | None) -> View:
        """Everything that can be seen of one environment, on floats; no time passes."""
        where = self.indices(np.array([row]))
        state = self.state_of([column[where] for column in self.columns])
        command, key = self.commands(compensate, list(state.target)), self.keys[where]
        _, scene = look(self.x, self.task, self.plant_of(where), state, command, key, key * 0, 0.0)
        plain = (tuple(map(self._float, part)) if isinstance(part, tuple) else self._float(part) for part in scene)
        return View(*plain)  # type: ignore[arg-type]

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that the next step depends on."""
        table = np.array([self.host(column) for column in self.columns])
        return {"table": table, "keys": self.host(self.keys).view(np.uint64), "arm": self.arm}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`."""
        self.write(self.columns, slice(None), self.numbers(state["table"]))
        self.keys[:], self.arm[:] = self.words(state["keys"]), state["arm"]
        if self.task.arms != "fixed":
            self._exchange_arms(np.arange(self.count))

    def numbers_of_actions(self, actions: ArrayLike) -> Scalar:
        """Actions component by component ``(n, N)``, checked; on a device their size is not.

        Raises:
            InputError: If they have another shape, or numbers that are not finite, or beyond -1 to 1 where the task
                refuses them.
        """
        values, shape, most = self.given(actions), (self.count, self.task.joints), self.task.most_action
        if tuple(values.shape) != shape:
            raise InputError(f"actions have shape {tuple(values.shape)}; give {shape}, numbers between -1 and 1")
        numbers, low, high = self.components(values)
        if not (high <= most and low >= -most):
            each = self.host(values)
            row = int(np.argmin((np.abs(each) <= most).all(axis=1)))
            raise InputError(
                f"the action of environment {row} is {each[row].tolist()}; give finite numbers{bounds_of(most)}"
            )
        return numbers

    def merged(self, out: Views, rows: Rows, some: Views) -> Views:
        """What all show, with the environments ``rows`` replaced; in memory of its own."""
        out = self.copied(out)
        self.scatter(out, rows, some)
        return out

    def scatter(self, out: Views, rows: Rows, some: Views) -> None:
        """Put what the environments ``rows`` show into what all show."""
        where = self.indices(rows)
        for all_, few in zip(leaves(out), leaves(some), strict=True):
            all_[..., where] = few

    def plant_of(self, where: Any) -> Plant:
        """The true arms of some environments."""
        return plants_on(self.plant, lambda values: values[where])

    def state_of(self, columns: Columns) -> ReachState:
        """The state that columns hold."""
        parts, first = [], 0
        for width in (*self._widths, *self._plant_widths):
            parts.append(tuple(columns[first : first + width]))
            first += width
        target, goal, seen, drawn, sent, sensed, *memory = parts
        return ReachState(target, goal, seen, drawn, sent, sensed, PlantState(*memory))

    def commands(self, compensate: Compensate | None, targets: Columns) -> Columns:
        """What the drives get for joint targets; a compensator works on NumPy."""
        if compensate is None:
            return targets
        given = np.stack([self.host(target) for target in targets], axis=-1, dtype=np.float64, casting="same_kind")
        return list(self.numbers(np.asarray(compensate(given)).T))

    def write(self, columns: Columns, where: Any, values: Sequence[Scalar]) -> None:
        """Write the columns of some environments, the last first: what waits in a queue is moved on before it goes."""
        for column, new in zip(list(columns)[::-1], list(values)[::-1], strict=True):
            self.put(column, where, new)

    def widths(self) -> tuple[int, ...]:
        """Numbers in each part of the observation."""
        n = self.task.joints
        return (n + 3, GOAL_NUMBERS, GOAL_NUMBERS) if self.goal_dict else (n + 12 + 3 * self.task.camera,)

    def blocks(self, count: int) -> Iterator[tuple[int, int]]:
        """First and last environment of each block."""
        return ((a, min(a + self.block, count)) for a in range(0, count, self.block))

    def _draw_goals(self, keys: Scalar) -> Columns:
        """Joints of the first pose of each stream that is wanted."""
        task, streams = self.task, stream_key(self.x, keys, GOAL)
        joints = list(self.numbers(np.zeros((task.joints, len(keys)))))
        open_ = self.indices(np.arange(len(keys)))
        for attempt in range(GOAL_ATTEMPTS):
            tried, fits = goal_attempt(self.x, task, streams[open_], attempt)
            self.write(joints, open_, tried)
            open_ = open_[~(fits & (open_ >= 0))]
            if not len(open_):
                return joints
        raise task.no_goal()

    def _take_arms(self, rows: Rows, how: Start, keys: Scalar) -> None:
        """Give the environments ``rows`` the true arms of their episodes."""
        arms = how.arm
        if arms is None:
            arms = self.host(drawn_arm(self.x, self.task, self.words(how.seeds), keys)).astype(np.intp)
        self.arm[rows] = arms
        self._exchange_arms(rows)

    def _exchange_arms(self, rows: Rows) -> None:
        where, arms = self.indices(rows), self.indices(self.arm[rows])
        for mine, all_ in zip(arrays_of(self.plant), arrays_of(self.population), strict=True):
            mine[where] = all_[arms]

    def _float(self, value: Scalar) -> float:
        return float(np.ravel(self.host(value))[0])
