"""A step written down once, operation by operation, so that it can be run without the functions that wrote it.

The task's formulas run on `Traced` numbers as on arrays. What comes out is a list of operations in which nothing is
computed twice, each the one that NumPy would do, with the same bits. `pickenv.envs.shared.machine_code` compiles it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

from pickenv.arm.kinematics.forward import Scalar
from pickenv.envs.shared.backends import MASK, Executor

DOUBLE, SINGLE, WORD, FLAG = "double", "float", "i64", "i1"
"""Kinds of numbers: float64, float32, 64-bit word, truth value."""

CALLED = {"sin": np.sin, "cos": np.cos, "atan2": np.arctan2, "log": np.log, "log10": np.log10, "exp": np.exp}
"""Functions that are left to NumPy, whose last bit no other library has."""

FREE = ("input", "constant")
"""Operations that take none, and need not be kept."""

COMMUTATIVE = frozenset({"add", "mul", "and", "or", "xor"})


class Untraceable(Exception):
    """A formula asked for a number where only its name is known."""


class Operation(NamedTuple):
    """One operation.

    Attributes:
        name: "add", "sin", ...; "input" and "constant" have no operands.
        kind: Kind of its result.
        operands: Numbers of the operations that it takes; of an input its array and its row, of a constant its value.
    """

    name: str
    kind: str
    operands: tuple[Any, ...]


class Trace:
    """Operations in the order in which they were written down.

    Attributes:
        operations: All of them, each but once.
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._known: dict[Operation, int] = {}

    def note(self, name: str, kind: str, *operands: Any) -> Traced:
        """The result of an operation on numbers of operations, or of a new input or constant."""
        if name in COMMUTATIVE and operands[0] > operands[1]:
            operands = operands[::-1]
        operation = Operation(name, kind, operands)
        if operation not in self._known:
            self._known[operation] = len(self.operations)
            self.operations.append(operation)
        return Traced(self, self._known[operation], kind)

    def inputs(self, array: str, rows: int, kind: str = DOUBLE) -> list[Traced]:
        """The rows of an array ``(rows, N)``."""
        return [self.note("input", kind, array, row) for row in range(rows)]

    def of(self, value: Scalar, kind: str) -> int:
        """Number of the operation that gives ``value``; plain numbers become constants of this kind."""
        if isinstance(value, Traced):
            return value.number
        if not isinstance(value, bool | int | float | np.generic):
            raise Untraceable(f"{type(value).__name__} is no number")
        plain = float(value).hex() if kind == DOUBLE else int(value)
        return self.note("constant", kind, plain).number

    def single(self, value: Scalar) -> Traced:
        """A number rounded to float32."""
        return self.note("single", SINGLE, self.of(value, DOUBLE))

    def double(self, value: Traced) -> Traced:
        """A float32 as a float64."""
        return self.note("double", DOUBLE, value.number)


def _binary(name: str, kind: str | None = None, swapped: bool = False) -> Callable[[Traced, Any], Any]:
    """An operator of `Traced`; ``kind`` is that of its result where it is not that of its operands."""

    def operator(self: Traced, other: Any) -> Any:
        if not isinstance(other, Traced | bool | int | float | np.generic):
            return NotImplemented
        numbers = self.number, self.trace.of(other, self.kind)
        return self.trace.note(name, kind or self.kind, *(numbers[::-1] if swapped else numbers))

    return operator


class Traced:
    """A number of which only is known by which operation it comes about."""

    __slots__ = ("kind", "number", "trace")
    __array_ufunc__ = None  # NumPy's numbers leave the arithmetic to this class

    def __init__(self, trace: Trace, number: int, kind: str) -> None:
        self.trace, self.number, self.kind = trace, number, kind

    __add__, __radd__ = _binary("add"), _binary("add", swapped=True)
    __sub__, __rsub__ = _binary("sub"), _binary("sub", swapped=True)
    __mul__, __rmul__ = _binary("mul"), _binary("mul", swapped=True)
    __truediv__, __rtruediv__ = _binary("div"), _binary("div", swapped=True)
    __lt__, __le__ = _binary("lt", FLAG), _binary("le", FLAG)
    __gt__, __ge__ = _binary("gt", FLAG), _binary("ge", FLAG)
    __and__, __rand__ = _binary("and"), _binary("and", swapped=True)
    __or__, __ror__ = _binary("or"), _binary("or", swapped=True)
    __xor__, __rshift__ = _binary("xor"), _binary("shift")

    def __neg__(self) -> Traced:
        return self.trace.note("neg", self.kind, self.number)

    def __bool__(self) -> bool:
        raise Untraceable("a formula goes one way or another")

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise Untraceable("a formula needs arrays")


def _function(name: str, plain: Callable[..., Any]) -> Callable[..., Any]:
    """A function of `Traced` and plain numbers; of plain numbers alone it is NumPy's."""

    def function(*values: Scalar) -> Scalar:
        trace = next((value.trace for value in values if isinstance(value, Traced)), None)
        if trace is None:
            return float(plain(*values))
        return trace.note(name, DOUBLE, *(trace.of(value, DOUBLE) for value in values))

    return function


def _where(condition: Scalar, yes: Scalar, no: Scalar) -> Scalar:
    if not isinstance(condition, Traced):
        return yes if condition else no
    trace = condition.trace
    return trace.note("where", DOUBLE, condition.number, trace.of(yes, DOUBLE), trace.of(no, DOUBLE))


_least, _most = _function("min", np.minimum), _function("max", np.maximum)

SYMBOLS: Any = SimpleNamespace(
    __name__="symbols",
    sqrt=_function("sqrt", np.sqrt),
    round=_function("round", np.round),
    where=_where,
    clip=lambda value, low, high: _least(_most(value, low), high),
    **{name: _function(name, plain) for name, plain in CALLED.items()},
)
"""What `numpy` is to arrays."""


def _product(word: Scalar, constant: int) -> Scalar:
    return word * constant if isinstance(word, Traced) else (word * constant) & MASK


def _total(word: Scalar, other: Scalar) -> Scalar:
    return word + other if isinstance(word, Traced) or isinstance(other, Traced) else (word + other) & MASK


def _unit(word: Traced) -> Traced:
    shifted = word >> 11
    return cast(Traced, word.trace.note("number", DOUBLE, shifted.number) * 2.0**-53)


TRACER = Executor(
    name="tracer",
    m=cast(ModuleType, SYMBOLS),
    times=_product,
    plus=_total,
    shifted=lambda word, bits: word >> bits,
    unit=_unit,
    word=lambda number: number & MASK,
    spares_constants=True,
)
"""Writes the simulation down instead of running it, as `pickenv.envs.shared.backends.NUMPY` would run it."""


class Call(NamedTuple):
    """A function that NumPy computes, for several numbers at once.

    Attributes:
        name: One of `CALLED`.
        operands: For each of its arguments, the numbers of the operations that give it.
        results: Numbers of the operations that it is.
    """

    name: str
    operands: tuple[tuple[int, ...], ...]
    results: tuple[int, ...]


class Stage(NamedTuple):
    """Arithmetic, and the functions that need nothing but what was computed up to here.

    Attributes:
        kept: Operations whose results are kept for later stages, or for the functions.
        written: Operation and place (array, row) of each result that goes out.
        calls: The functions.
    """

    kept: tuple[int, ...]
    written: tuple[tuple[int, tuple[str, int]], ...]
    calls: tuple[Call, ...]


class Outputs(NamedTuple):
    """What is written into an array ``(rows, N)``.

    Attributes:
        array: Its name.
        rows: What goes into its rows.
        kind: Their kind.
        first: Number of the first of these rows.
    """

    array: str
    rows: Sequence[Scalar]
    kind: str = DOUBLE
    first: int = 0


def stages(trace: Trace, outputs: Sequence[Outputs]) -> list[Stage]:
    """What is to be computed, one stage after the other; all is written in the last, for inputs are read until then."""
    operations = trace.operations
    goals = [(trace.of(value, out.kind), (out.array, i)) for out in outputs for i, value in enumerate(out.rows, out.first)]
    needed, waiting = set(), [number for number, _ in goals]
    while waiting:
        number = waiting.pop()
        if number not in needed:
            needed.add(number)
            waiting += operands_of(operations[number])
    ready: dict[int, int] = {}  # by operation, the first stage that can use it
    for number in sorted(needed):
        operation = operations[number]
        ready[number] = max((ready[i] for i in operands_of(operation)), default=0) + (operation.name in CALLED)
    last = max(ready[number] for number, _ in goals)
    kept: list[set[int]] = [set() for _ in range(last + 1)]
    calls: list[dict[str, list[int]]] = [{} for _ in range(last + 1)]
    for number in sorted(needed):
        operation, called = operations[number], operations[number].name in CALLED
        if called:
            calls[ready[number] - 1].setdefault(operation.name, []).append(number)
        for i in operands_of(operation):
            if operations[i].name not in (*CALLED, *FREE) and (called or ready[i] < ready[number]):
                kept[ready[i]].add(i)
    for number, _ in goals:
        if operations[number].name not in (*CALLED, *FREE) and ready[number] < last:
            kept[ready[number]].add(number)
    return [
        Stage(
            kept=tuple(sorted(kept[stage])),
            written=tuple(goals) if stage == last else (),
            calls=tuple(
                Call(name, tuple(zip(*(operations[i].operands for i in own), strict=True)), tuple(own))
                for name, own in calls[stage].items()
            ),
        )
        for stage in range(last + 1)
    ]


def operands_of(operation: Operation) -> tuple[int, ...]:
    """Numbers of the operations that an operation takes."""
    return () if operation.name in FREE else operation.operands
