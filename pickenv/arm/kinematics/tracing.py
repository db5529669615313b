"""Formulas written down once, operation by operation, so that they can be run without the functions that wrote them.

They run on `Traced` numbers as on arrays, with `SYMBOLS` in the place of `numpy`. What comes out is a list of
operations in which nothing is computed twice, each the one that NumPy would do, with the same bits.
`pickenv.arm.kinematics.machine_code` compiles it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

from pickenv.arm.kinematics.forward import Scalar
from pickenv.arm.kinematics.geometry import Array

DOUBLE, SINGLE, WORD, FLAG = "double", "float", "i64", "i1"
"""Kinds of numbers: float64, float32, 64-bit word, truth value."""

CALLED = {"sin": np.sin, "cos": np.cos, "atan2": np.arctan2, "log": np.log, "log10": np.log10, "exp": np.exp}
"""Functions that are left to NumPy, whose last bit no other library has."""

OUTSIDE = "outside"
"""Operations that a function of ours computes, row by row of arrays."""

COMMUTATIVE = frozenset({"add", "mul", "and", "or", "xor"})


class Untraceable(Exception):
    """A formula asked for a number where only its name is known."""


class Operation(NamedTuple):
    """One operation.

    Attributes:
        name: "add", "sin", "input", "constant", ...
        kind: Kind of its result.
        operands: Numbers of the operations that it takes.
        detail: Array and row of an input, value of a constant, function and row of a result of `outside`.
    """

    name: str
    kind: str
    operands: tuple[int, ...]
    detail: Any = None

    @property
    def called(self) -> bool:
        """Whether a function outside computes it, for many numbers at once."""
        return self.name in CALLED or self.name == OUTSIDE

    @property
    def free(self) -> bool:
        """Whether it takes nothing, and need not be kept."""
        return self.name in ("input", "constant")


class Trace:
    """Operations in the order in which they were written down.

    Attributes:
        operations: All of them, each but once.
        exceptions: Truth values; where one is true, the formulas ask for more than operations can give.
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self.exceptions: list[Traced] = []
        self._known: dict[Operation, int] = {}

    def note(self, name: str, kind: str, *operands: int, detail: Any = None) -> Traced:
        """The result of an operation."""
        if name in COMMUTATIVE and operands[0] > operands[1]:
            operands = operands[::-1]
        operation = Operation(name, kind, operands, detail)
        if operation not in self._known:
            self._known[operation] = len(self.operations)
            self.operations.append(operation)
        return Traced(self, self._known[operation], kind)

    def inputs(self, array: str, rows: int, kind: str = DOUBLE) -> list[Traced]:
        """The rows of an array ``(rows, N)``."""
        return [self.note("input", kind, detail=(array, row)) for row in range(rows)]

    def of(self, value: Scalar, kind: str) -> int:
        """Number of the operation that gives ``value``; plain numbers become constants of this kind."""
        if isinstance(value, Traced):
            return value.number
        if not isinstance(value, bool | int | float | np.generic):
            raise Untraceable(f"{type(value).__name__} is no number")
        return self.note("constant", kind, detail=float(value).hex() if kind == DOUBLE else int(value)).number

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

    def __invert__(self) -> Traced:
        return cast(Traced, self ^ True)

    def as_double(self) -> Traced:
        """A word as a float64."""
        return self.trace.note("number", DOUBLE, self.number)

    @property
    def dtype(self) -> Any:
        """What an array of such numbers would have."""
        return np.dtype(np.float64)

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


def _where(condition: Scalar, *values: Scalar) -> Scalar:
    if not isinstance(condition, Traced):
        return values[0] if condition else values[1]
    trace = condition.trace
    if not values:  # which are they? what is done with them cannot be noted
        trace.exceptions.append(condition)
        return (condition,)
    return trace.note("where", DOUBLE, condition.number, *(trace.of(value, DOUBLE) for value in values))


_least, _most = _function("min", np.minimum), _function("max", np.maximum)

SYMBOLS: Any = SimpleNamespace(
    __name__="symbols",
    sqrt=_function("sqrt", np.sqrt),
    round=_function("round", np.round),
    abs=_function("abs", np.abs),
    finfo=np.finfo,
    where=_where,
    clip=lambda value, low, high: _least(_most(value, low), high),
    **{name: _function(name, plain) for name, plain in CALLED.items()},
)
"""What `numpy` is to arrays."""


Fill = Callable[[Array, Array, slice], None]
"""Gets an array ``(k, N)`` and fills one ``(rows, N)``, for these of the poses; a column depends on the same alone."""


def outside(function: Fill, values: Sequence[Scalar], rows: int) -> list[Traced] | None:
    """What a function of whole arrays makes of numbers, or None where they are not `Traced`.

    Args:
        function: The function.
        values: What it is given.
        rows: How many numbers it makes of them.
    """
    trace = next((value.trace for value in values if isinstance(value, Traced)), None)
    if trace is None:
        return None
    given = [trace.of(value, DOUBLE) for value in values]
    return [trace.note(OUTSIDE, DOUBLE, *given, detail=(function, row, rows)) for row in range(rows)]


class Call(NamedTuple):
    """A function that is computed for many numbers at once.

    Attributes:
        function: One of `CALLED`, by name, or one given to `outside`.
        operands: For each of its arguments, the numbers of the operations that give it.
        results: Numbers of the operations that it is.
    """

    function: str | Fill
    operands: tuple[tuple[int, ...], ...]
    results: tuple[int, ...]


class Phase(NamedTuple):
    """Arithmetic, and the functions that need nothing but what was computed up to here.

    Attributes:
        kept: Operations whose results are kept for later phases, or for the functions.
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


def phases(trace: Trace, outputs: Sequence[Outputs]) -> list[Phase]:
    """What is to be computed, one phase after the other; all is written in the last, for inputs are read until then."""
    operations = trace.operations
    goals = [
        (trace.of(value, out.kind), (out.array, i)) for out in outputs for i, value in enumerate(out.rows, out.first)
    ]
    needed: set[int] = set()
    waiting = [number for number, _ in goals]
    while waiting:
        number = waiting.pop()
        if number not in needed:
            needed.add(number)
            waiting += _with_siblings(operations, number)
    ready: dict[int, int] = {}  # by operation, the first phase that can use it
    for number in sorted(needed):
        operation = operations[number]
        ready[number] = max((ready[i] for i in operation.operands), default=0) + operation.called
    last = max(ready[number] for number, _ in goals)
    kept: list[set[int]] = [set() for _ in range(last + 1)]
    called: list[list[int]] = [[] for _ in range(last + 1)]
    for number in sorted(needed):
        operation = operations[number]
        if operation.called:
            called[ready[number] - 1].append(number)
        kept_for = (i for i in operation.operands if operation.called or ready[i] < ready[number])
        for i in kept_for:
            kept[ready[i]].add(i)
    for number, _ in goals:
        if ready[number] < last:
            kept[ready[number]].add(number)
    return [
        Phase(
            kept=tuple(i for i in sorted(kept[phase]) if not (operations[i].free or operations[i].called)),
            written=tuple(goals) if phase == last else (),
            calls=_calls(operations, called[phase]),
        )
        for phase in range(last + 1)
    ]


def _with_siblings(operations: Sequence[Operation], number: int) -> tuple[int, ...]:
    """The operands of an operation, and of a result of `outside` the other results."""
    operation = operations[number]
    if operation.name != OUTSIDE:
        return operation.operands
    _, row, rows = operation.detail  # noted one after the other
    return (*operation.operands, *range(number - row, number - row + rows))


def _calls(operations: Sequence[Operation], numbers: Sequence[int]) -> tuple[Call, ...]:
    """Operations gathered by their functions."""
    gathered: dict[Any, list[int]] = {}
    for number in numbers:
        name, _, operands, detail = operations[number]
        gathered.setdefault((detail[0], operands) if name == OUTSIDE else name, []).append(number)
    return tuple(
        Call(key, tuple(zip(*(operations[i].operands for i in own), strict=True)), tuple(own))
        if isinstance(key, str)
        else Call(key[0], (key[1],), tuple(own))
        for key, own in gathered.items()
    )
