"""Compile formulas to machine code: record the operations of a formula (a trace), then run them in a loop over poses.

To record a formula, call it with `Traced` numbers instead of arrays, and with `SYMBOLS` instead of `numpy`. The trace
is a list of operations, each recorded once, which LLVM (llvmlite) compiles. Results differ from NumPy's by rounding:
sines and cosines are Taylor series here, and logarithms and arc tangents come from the C library.
"""

from __future__ import annotations

import ctypes
import math
import os
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np
from llvmlite import binding
from numpy.typing import NDArray

from pickenv.arm.kinematics.forward import Scalar, Scalars
from pickenv.arm.kinematics.geometry import Array

DOUBLE, SINGLE, WORD, FLAG = "double", "float", "i64", "i1"
"""Names of the number types: float64, float32, 64-bit integer, Boolean."""

COMMUTATIVE = frozenset({"add", "mul", "and", "or", "xor"})

Fill = Callable[[Array, Array], None]
"""A function of two arguments: an input array ``(k, N)``, and an output array ``(rows, N)`` that it fills."""


Goals = list[tuple[int, str, int]]
"""The outputs of a trace: for each, the index of its operation, and the name of the array and the row to write to."""


class Untraceable(Exception):
    """Raised if a formula needs the value of a `Traced` number, which has none (as in an ``if``)."""


class Operation(NamedTuple):
    """One operation of a trace.

    Attributes:
        name: Name of the operation: "add", "sqrt", "input", "constant", ...
        kind: Type of its result, such as `DOUBLE`.
        operands: Indices in the trace, from 0, of the operations whose results are its operands.
        detail: Array name and row (from 0) of an input; value of a constant.
    """

    name: str
    kind: str
    operands: tuple[int, ...]
    detail: Any = None


Call = tuple[Fill, Scalars, int]
"""Three values: a function of whole arrays, called between two loops; its arguments; and its number of results."""


class Trace:
    """The recorded operations of formulas, in order.

    Attributes:
        operations: All operations, without repetitions.
        exceptions: Conditions of rare cases. For poses at which one is true, the recorded operations are not valid.
        calls: Functions of whole arrays. The results of call i are the rows of the input array "found<i>".
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self.exceptions: list[Traced] = []
        self.calls: list[Call] = []
        self._known: dict[Operation, int] = {}

    def note(self, name: str, kind: str, *operands: int, detail: Any = None) -> Traced:
        """Record an operation, unless the trace has it already, and return its result.

        Args:
            name: Name of the operation: "add", "sqrt", "input", ...
            kind: Type of its result, such as `DOUBLE`.
            operands: Indices in the trace, from 0, of the operations whose results are its operands.
            detail: Array name and row (from 0) of an input, or value of a constant.
        """
        operation = Operation(name, kind, tuple(sorted(operands)) if name in COMMUTATIVE else operands, detail)
        if operation not in self._known:
            self._known[operation] = len(self.operations)
            self.operations.append(operation)
        return Traced(self, self._known[operation], kind)

    def inputs(self, array: str, rows: int, kind: str = DOUBLE) -> list[Traced]:
        """Return the rows of an input array called ``array``, ``(rows, N)``, as traced numbers of type ``kind``."""
        return [self.note("input", kind, detail=(array, row)) for row in range(rows)]

    def outputs(self, array: str, rows: Scalars, kind: str = DOUBLE, first: int = 0) -> Goals:
        """Return the goals (`Goals`) that write numbers to the rows of the output array called ``array``.

        Args:
            array: Name of the output array.
            rows: The traced numbers, one per row.
            kind: Type of the numbers, such as `DOUBLE`.
            first: Row, from 0, of the first number.
        """
        return [(self.of(value, kind), array, row) for row, value in enumerate(rows, first)]

    def of(self, value: Scalar, kind: str) -> int:
        """Return the index, from 0, of the operation whose result is ``value``.

        A plain number becomes a constant of the type ``kind``, such as `DOUBLE`.

        Raises:
            Untraceable: If ``value`` is neither a traced nor a plain number.
        """
        if isinstance(value, Traced):
            return value.number
        if not isinstance(value, bool | int | float | np.generic):
            raise Untraceable(f"{type(value).__name__} is no number")
        return self.note("constant", kind, detail=float(value).hex() if kind == DOUBLE else int(value) % 2**64).number

    def single(self, value: Scalar) -> Traced:
        """Record the rounding of a number to float32."""
        return self.note("single", SINGLE, self.of(value, DOUBLE))

    def double(self, value: Traced) -> Traced:
        """Record the conversion of a float32 to float64."""
        return self.note("double", DOUBLE, value.number)


def _binary(name: str, kind: str | None = None, swapped: bool = False) -> Callable[[Traced, Any], Any]:
    """Return a method of `Traced` for an operator; the method records an operation.

    Args:
        name: Name of the operation, such as "add".
        kind: Type of the result; None for the operands' type.
        swapped: Whether the operands change places, as ``__radd__`` needs.
    """

    def operator(self: Traced, other: Any) -> Any:
        if not isinstance(other, Traced | bool | int | float | np.generic):
            return NotImplemented
        numbers = self.number, self.trace.of(other, self.kind)
        return self.trace.note(name, kind or self.kind, *(numbers[::-1] if swapped else numbers))

    return operator


class Traced:
    """A number without a value, which stands for the result of a recorded operation; operators record new ones."""

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
        """Record the conversion of this 64-bit integer to float64."""
        return self.trace.note("number", DOUBLE, self.number)

    @property
    def dtype(self) -> Any:
        """The NumPy dtype that formulas see: float64."""
        return np.dtype(np.float64)

    def __bool__(self) -> bool:
        raise Untraceable("a formula goes one way or another")

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise Untraceable("a formula needs arrays")


# What `numpy` is to arrays.

PI, PI_RESIDUE = float.fromhex("0x1.921fb544p+1"), float.fromhex("0x1.0b4611a626331p-33")
"""Pi in two parts: its first 33 bits, whose products with integers are exact, and the remainder."""

TERMS = 11
"""Number of terms of each series. At pi/2, the first omitted term is below half a rounding error of the largest one."""

INTRINSICS = {"round": "rint", "abs": "fabs"} | {name: name for name in ("sqrt", "atan2", "log", "log10", "exp")}
"""LLVM's name of each function, by NumPy's name."""


def sine(m: Any, angle: Scalar) -> Scalar:
    """Return the sine of an angle, rad, by its Taylor series; ``m`` is the namespace, ``numpy`` or `SYMBOLS`."""
    sign, residue = _reduced(m, angle)
    return sign * (residue * _summed(residue * residue, 1))


def cosine(m: Any, angle: Scalar) -> Scalar:
    """Return the cosine of an angle, rad, by its Taylor series; ``m`` is the namespace, ``numpy`` or `SYMBOLS`."""
    sign, residue = _reduced(m, angle)
    return sign * _summed(residue * residue, 0)


def _reduced(m: Any, angle: Scalar) -> tuple[Scalar, Scalar]:
    """Return a sign, 1 or -1, and an angle without its whole half turns, rad.

    Sine and cosine of ``angle`` are the sign times the sine and the cosine of the returned angle. ``m`` is the
    namespace, ``numpy`` or `SYMBOLS`.
    """
    halves = m.round(angle * (1.0 / math.pi))
    odd = halves - 2.0 * m.round(0.5 * halves)
    return 1.0 - 2.0 * (odd * odd), (angle - PI * halves) - PI_RESIDUE * halves


def _summed(square: Scalar, first: int) -> Scalar:
    """Return the sum of (-square)^k / (2 k + first)! for k from 0 to `TERMS` - 1.

    With an angle's square it is the cosine for ``first`` = 0, and the sine divided by the angle for ``first`` = 1.
    """
    total = square * (1.0 / math.factorial(2 * TERMS - 2 + first))
    for k in reversed(range(TERMS - 1)):
        total = 1.0 / math.factorial(2 * k + first) - total
        total = total if k == 0 else square * total
    return total


def _function(name: str, plain: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of `Traced` and plain numbers, which records the operation ``name``, such as "sqrt".

    For plain numbers alone it calls NumPy's function ``plain``.
    """

    def function(*values: Scalar) -> Scalar:
        if (trace := _trace_of(values)) is None:
            return float(plain(*values))
        return trace.note(name, DOUBLE, *(trace.of(value, DOUBLE) for value in values))

    return function


def _trace_of(values: Scalars) -> Trace | None:
    return next((value.trace for value in values if isinstance(value, Traced)), None)


def _where(condition: Scalar, yes: Scalar, no: Scalar) -> Scalar:
    if not isinstance(condition, Traced):
        return yes if condition else no
    trace = condition.trace
    return trace.note("where", DOUBLE, condition.number, *(trace.of(value, DOUBLE) for value in (yes, no)))


def _set_aside(condition: Scalar) -> bool:
    if isinstance(condition, Traced):
        condition.trace.exceptions.append(condition)
    return isinstance(condition, Traced)


def _outside(function: Fill, values: Scalars, rows: int) -> list[Traced] | None:
    if (trace := _trace_of(values)) is None:
        return None
    trace.calls.append((function, values, rows))
    return trace.inputs(f"found{len(trace.calls) - 1}", rows)


_least, _most = _function("min", np.minimum), _function("max", np.maximum)

SYMBOLS: Any = SimpleNamespace(
    **{name: _function(name, getattr(np, name)) for name in INTRINSICS},
    __name__="symbols",
    sin=lambda angle: sine(SYMBOLS, angle) if isinstance(angle, Traced) else math.sin(angle),
    cos=lambda angle: cosine(SYMBOLS, angle) if isinstance(angle, Traced) else math.cos(angle),
    acos=lambda cosine: SYMBOLS.atan2(SYMBOLS.sqrt((1.0 - cosine) * (1.0 + cosine)), cosine),
    finfo=np.finfo,
    where=_where,
    minimum=_least,
    maximum=_most,
    clip=lambda value, low, high: _least(_most(value, low), high),
    set_aside=_set_aside,
    outside=_outside,
)
"""The namespace of functions of traced numbers, in place of `numpy`."""


# A trace as machine code.

LANES = 8
"""Number of poses per vector operation; the processor needs two instructions if its vectors are half as wide."""

THOROUGH = 1024
"""Least number of poses for which LLVM optimises: compiling takes four times as long, the code runs a third faster."""

BY_KIND = {
    DOUBLE: {
        **{"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "neg": "fneg", "single": "fptrunc"},
        **{"lt": "fcmp olt", "le": "fcmp ole", "gt": "fcmp ogt", "ge": "fcmp oge"},
    },
    SINGLE: {"double": "fpext"},
    WORD: {"add": "add", "mul": "mul", "xor": "xor", "shift": "lshr", "number": "uitofp"},
    FLAG: {"and": "and", "or": "or", "xor": "xor"},
}
"""LLVM's instruction for each operation, by the type of its operands."""

FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64)


class Compiled:
    """A trace compiled to loops over the poses; the last loop writes the outputs.

    Before each call of a function of whole arrays (`Trace.calls`), a loop computes the function's arguments.

    Args:
        trace: The operations.
        goals: The outputs, from `Trace.outputs`. All are written in the last loop, because earlier loops still read the
            inputs.
        count: Expected number of poses, which decides whether the code is optimised.
    """

    def __init__(self, trace: Trace, goals: Goals, count: int) -> None:
        self._calls = trace.calls
        loops = [*(trace.outputs(f"given{i}", values) for i, (_, values, _) in enumerate(trace.calls)), goals]
        read = (operation.detail[0] for operation in trace.operations if operation.name == "input")
        self._arrays = tuple(dict.fromkeys((*read, *(array for loop in loops for _, array, _ in loop))))
        code = (_loop(trace.operations, f"loop{i}", loop, self._arrays) for i, loop in enumerate(loops))
        names = tuple(f"loop{i}" for i in range(len(loops)))
        self._engine, addresses = machine("\n".join((*DECLARED, *code)), names, count >= THOROUGH)
        self._loops = [FUNCTION(address) for address in addresses]
        self._between: dict[str, Array] = {}

    def bound(self, arrays: Mapping[str, NDArray[Any]], count: int) -> Callable[[], None]:
        """Return a function without arguments; each call of it computes the outputs in ``arrays`` from the inputs.

        Args:
            arrays: Input and output arrays by name, ``(rows, count)``, C-contiguous; the outputs are overwritten.
            count: Number of poses.
        """
        if self._calls and (not self._between or self._between["given0"].shape[1] != count):
            for i, (_, values, rows) in enumerate(self._calls):
                self._between[f"given{i}"] = np.empty((len(values), count))
                self._between[f"found{i}"] = np.empty((rows, count))
        arrays = {**arrays, **self._between}
        addresses = (arrays[name].__array_interface__["data"][0] for name in self._arrays)
        bases = (ctypes.c_void_p * len(self._arrays))(*addresses)
        calls = [(call[0], arrays[f"given{i}"], arrays[f"found{i}"]) for i, call in enumerate(self._calls)]

        def go(held: Any = arrays) -> None:  # the arrays live as long as the function
            for loop, (fill, given, found) in zip(self._loops, calls, strict=False):
                loop(bases, count)
                fill(given, found)
            self._loops[-1](bases, count)

        return go


def on_rows(formula: Callable[[Any, list[Traced]], Scalars], inputs: int, count: int) -> Callable[[Array], Array]:
    """Compile a formula to a function from an array ``(count, inputs)`` to an array ``(count, results)``.

    Args:
        formula: Function of a namespace and a list of components; it returns its results as components.
        inputs: Number of input components.
        count: Expected number of poses, which decides whether the code is optimised.
    """
    trace = Trace()
    results = formula(SYMBOLS, trace.inputs("given", inputs))
    code = Compiled(trace, trace.outputs("found", results), count)

    def run(rows: Array) -> Array:
        found = np.empty((len(results), len(rows)))
        code.bound({"given": np.ascontiguousarray(rows.T), "found": found}, len(rows))()
        return found.T

    return run


def _type(kind: str, lanes: int) -> str:
    return f"<{lanes} x {kind}>" if lanes > 1 else kind


def _mark(lanes: int) -> str:
    return f"v{lanes}f64" if lanes > 1 else "f64"


def _declared(name: str, lanes: int) -> str:
    kind = _type(DOUBLE, lanes)
    return f"declare {kind} @llvm.{name}.{_mark(lanes)}({', '.join([kind] * (1 + (name == 'atan2')))})"


DECLARED = tuple(_declared(name, lanes) for name in INTRINSICS.values() for lanes in (1, LANES))


def _loop(operations: Sequence[Operation], name: str, goals: Goals, arrays: Sequence[str]) -> str:
    """Return LLVM's code of a function with two loops: over groups of `LANES` poses, then over the remaining poses.

    Args:
        operations: The operations in the loops.
        name: Name of the function.
        goals: The outputs that the loops write.
        arrays: Names of all arrays, in the order of the function's pointers to them.
    """
    wide, narrow = ("\n".join(_Body(operations, goals, arrays, lanes).lines) for lanes in (LANES, 1))
    return f"""
define void @{name}(ptr noalias %bases, i64 %count) {{
entry:
  br label %wide_head
wide_head:
  %wide_at = phi i64 [0, %entry], [%wide_next, %wide]
  %wide_next = add i64 %wide_at, {LANES}
  %wide_more = icmp ule i64 %wide_next, %count
  br i1 %wide_more, label %wide, label %narrow_head
wide:
{wide}
  br label %wide_head
narrow_head:
  %narrow_at = phi i64 [%wide_at, %wide_head], [%narrow_next, %narrow]
  %narrow_next = add i64 %narrow_at, 1
  %narrow_more = icmp ule i64 %narrow_next, %count
  br i1 %narrow_more, label %narrow, label %done
narrow:
{narrow}
  br label %narrow_head
done:
  ret void
}}"""


class _Body:
    """The instructions of one loop that works on ``lanes`` poses at once; ``lines`` holds their text."""

    def __init__(self, operations: Sequence[Operation], goals: Goals, arrays: Sequence[str], lanes: int) -> None:
        self.lines: list[str] = []
        self._operations, self._arrays, self._lanes = operations, arrays, lanes
        self._type = partial(_type, lanes=lanes)
        self._turn = "wide" if lanes > 1 else "narrow"
        self._bases: dict[str, str] = {}
        self._values: dict[int, str] = {}
        needed = {number for number, _, _ in goals}
        for number in reversed(range(len(operations))):  # what an operation takes stands before it
            needed.update(operations[number].operands if number in needed else ())
        for number in sorted(needed):
            self._values[number] = self._value(operations[number])
        for number, array, row in goals:
            value, kind = self._values[number], operations[number].kind
            place, memory = self._place(array, row, kind)
            value = self._new(f"zext {self._type(FLAG)} {value} to {memory}") if kind == FLAG else value
            self.lines.append(f"  store {memory} {value}, ptr {place}, align 1")

    def _value(self, operation: Operation) -> str:
        """Return the text that stands for an operation's result: a name, or a constant."""
        name, result = operation.name, operation.kind
        if name == "constant":
            value = operation.detail
            text = f"0x{struct.pack('>d', float.fromhex(value)).hex().upper()}" if result == DOUBLE else str(value)
            return text if self._lanes == 1 else f"<{', '.join([f'{result} {text}'] * self._lanes)}>"
        if name == "input":
            array, row = operation.detail
            place, memory = self._place(array, row, result)
            value = self._new(f"load {memory}, ptr {place}, align 1")
            return value if result != FLAG else self._new(f"trunc {memory} {value} to {self._type(FLAG)}")
        values = [self._values[i] for i in operation.operands]
        kind = self._operations[operation.operands[0]].kind
        taken = self._type(kind)
        if name in INTRINSICS:
            operands = ", ".join(f"{taken} {value}" for value in values)
            return self._new(f"call {taken} @llvm.{INTRINSICS[name]}.{_mark(self._lanes)}({operands})")
        if name in ("min", "max"):  # of equal numbers the second, and a number that is none wins, as in NumPy
            first = self._new(f"fcmp {'olt' if name == 'min' else 'ogt'} {taken} {values[0]}, {values[1]}")
            none = self._new(f"fcmp uno {taken} {values[0]}, {values[0]}")
            values, name = [self._new(f"or {self._type(FLAG)} {first}, {none}"), *values], "where"
        if name == "where":
            flag, taken = self._type(FLAG), self._type(result)
            return self._new(f"select {flag} {values[0]}, {taken} {values[1]}, {taken} {values[2]}")
        instruction = BY_KIND[kind][name]
        if kind != result and name not in ("lt", "le", "gt", "ge"):
            return self._new(f"{instruction} {taken} {values[0]} to {self._type(result)}")
        return self._new(f"{instruction} {taken} {', '.join(values)}")

    def _new(self, instruction: str) -> str:
        name = f"%{self._turn[0]}{len(self.lines)}"
        self.lines.append(f"  {name} = {instruction}")
        return name

    def _place(self, array: str, row: int, kind: str) -> tuple[str, str]:
        """Return the pointer to the entries of an array's row for this pass of the loop, and their type in memory.

        ``row`` counts from 0; ``kind`` is the type of the numbers.
        """
        if array not in self._bases:
            slot = self._new(f"getelementptr ptr, ptr %bases, i64 {self._arrays.index(array)}")
            self._bases[array] = self._new(f"load ptr, ptr {slot}")
        before = self._new(f"mul i64 {row}, %count")
        entry = self._new(f"add i64 {before}, %{self._turn}_at")
        memory = "i8" if kind == FLAG else kind
        return self._new(f"getelementptr {memory}, ptr {self._bases[array]}, i64 {entry}"), self._type(memory)


@lru_cache(maxsize=64)
def machine(code: str, names: tuple[str, ...], thorough: bool) -> tuple[Any, list[int]]:
    """Compile LLVM code; return the engine that keeps it in memory, and the addresses of its functions.

    Args:
        code: LLVM assembly code.
        names: Names of the functions.
        thorough: Whether LLVM optimises the code, which takes four times as long.
    """
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    library = ctypes.CDLL(None if os.name == "posix" else "msvcrt")
    for name in ("atan2", "log", "log10", "exp"):
        binding.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
    features = sorted(binding.get_host_cpu_features().items())
    target = binding.Target.from_default_triple().create_target_machine(
        cpu=binding.get_host_cpu_name(),
        features=",".join(f"{'+' if present else '-'}{feature}" for feature, present in features),
        opt=2 if thorough else 0,
    )
    module = binding.parse_assembly(code)
    module.verify()
    engine = binding.create_mcjit_compiler(module, target)
    engine.finalize_object()
    return engine, [engine.get_function_address(function) for function in names]
