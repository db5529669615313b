"""`simulation.look` for one arm as machine code, which replaces most of a step's work on Python floats."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from operator import add, itemgetter, mul
from typing import Any, cast

import numpy as np

from pickenv.arm import Plant, Scalar, Scalars, arrays_of, chosen, plants_on
from pickenv.arm.kinematics.machine_code import SYMBOLS, WORD, Compiled, Trace
from pickenv.envs.shared.arm_batch import naming_effects
from pickenv.envs.shared.backends import MASK, Executor
from pickenv.envs.shared.simulation import ArmState
from pickenv.envs.shared.task import Compensate, Task, exact_plant

TRACER = Executor(
    name="compiled",
    m=SYMBOLS,
    times=mul,
    plus=add,
    shifted=lambda word, bits: (word & MASK if isinstance(word, int) else word) >> bits,
    unit=lambda word: (word >> 11).as_double() * 2.0**-53,
    word=lambda number: number & MASK,
    spares_constants=True,
)
"""The executor that records the simulation's operations, which are then compiled."""


def with_numbers(plants: Plant, numbers: Iterable[Scalar]) -> Plant:
    """Return ``plants`` (true arms) with each array of shape ``(arms,)`` replaced by the next item of ``numbers``."""
    rows = iter(numbers)
    return plants_on(plants, lambda values: next(rows) if values.ndim == 1 else values)


class LatestCompiled:
    """Cache of the machine code of the compensator that was used last.

    The code corrects ``count`` joint targets at once.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._known: Any = None, None

    def __call__(self, compensate: Compensate) -> Compensate:
        """Return the machine code of a compensator, or the compensator itself if it has none."""
        if self._known[0] is not compensate:
            self._known = compensate, getattr(compensate, "compiled", lambda _: compensate)(self._count)
        return cast(Compensate, self._known[1])


class CompiledLook:
    """Machine code of `simulation.look`, or of a function with the same arguments, for one arm and one period.

    Results equal the function's own results up to rounding.

    Args:
        look: The function to compile.
        task: The task.
    """

    def __init__(self, look: Callable[..., Any], task: Task) -> None:
        self._look, self._task, self.fast = look, task, LatestCompiled(1)
        self._plants = exact_plant(task.plant)
        self._numbers = [values for values in arrays_of(self._plants) if values.ndim == 1]
        self._arms, self._words, self._arm = np.empty((len(self._numbers), 1)), np.empty((2, 1), np.uint64), -1
        self._run: Callable[[], None] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy the function and the task; the copy compiles the code again."""
        return CompiledLook, (self._look, self._task)

    def __call__(self, state: ArmState, command: Scalars, key: int, moment: int, arm: int) -> tuple[ArmState, Any]:
        """Hold a joint command for one period; return the state afterwards, and what the function measures then.

        Args:
            state: The state, with its new joint target.
            command: Joint command, rad or m.
            key: Key of the episode's random streams.
            moment: Number of steps in the episode so far, this one included.
            arm: Index (from 0) of the true arm in the population.
        """
        if self._run is None:
            with naming_effects(self._plants, "compiled"):
                self._run = self._compiled(state, command)
        if arm != self._arm:
            self._arms[:, 0], self._arm = [values[arm] for values in self._numbers], arm
        self._words[0], self._words[1] = key, moment
        self._given[:, 0] = [*state.columns, *command]
        self._run()
        found = tuple(self._found[:, 0].tolist())
        sensed, *parts = [found[cut] for cut in self._cuts]
        memory = len(state.plant)
        return ArmState(*state[:-2], sensed, tuple(parts[:memory])), self._view_of(parts[memory:])

    def _compiled(self, state: ArmState, command: Scalars) -> Callable[[], None]:
        """Compile the function for states and commands as long as ``state`` and ``command``, and return the code."""
        trace, widths = Trace(), [len(part) for part in (*state[:-1], *state.plant)]
        given = trace.inputs("given", sum(widths) + len(command))
        before, now = ArmState.of(given[: sum(widths)], widths), given[sum(widths) :]
        key, moment = trace.inputs("words", 2, WORD)
        plant = with_numbers(self._plants, trace.inputs("arms", len(self._arms)))
        period = self._task.situation.value("period", before.drawn)
        after, view = self._look(TRACER, self._task, plant, before, now, key, moment, period)
        seen = view if hasattr(view, "_fields") else (view,)
        self._view_of = getattr(view, "_make", itemgetter(0))
        numbers: list[Scalar] = []
        self._cuts: list[Any] = []
        for part in (after.sensed, *after.plant, *seen):
            first = len(numbers)
            numbers += part if isinstance(part, tuple) else [chosen(SYMBOLS, part, 1.0, 0.0)]
            self._cuts.append(slice(first, len(numbers)) if isinstance(part, tuple) else first)
        self._given, self._found = np.empty((len(given), 1)), np.empty((len(numbers), 1))
        arrays = {"given": self._given, "words": self._words, "arms": self._arms, "found": self._found}
        return Compiled(trace, trace.outputs("found", numbers), 1).bound(arrays, 1)
