"""A trace as machine code: each phase is one loop over the poses, between two calls of NumPy's functions.

Code is generated with LLVM (llvmlite), without any licence to reorder, contract or approximate: results have the bits
of the NumPy operations that the trace stands for.
"""

from __future__ import annotations

import ctypes
import platform
import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import binding
from numpy.typing import NDArray

from pickenv.arm.kinematics.tracing import (
    CALLED,
    DOUBLE,
    FLAG,
    SINGLE,
    WORD,
    Operation,
    Outputs,
    Phase,
    Trace,
    phases,
)

LANES = {False: 4, True: 8}
"""Poses that one instruction works on, without and with AVX-512."""

NUMBERS, LEAST = 2**16, 64
"""Intermediate results that a core's own cache holds, and how many poses at least go through all phases together."""

THOROUGH = 1024
"""From so many poses on, code that takes four times as long to generate and runs a third faster is worth it."""

BYTES = {DOUBLE: 8, SINGLE: 4, WORD: 8, FLAG: 1}
KEPT = "kept"
"""The array of intermediate results."""

BY_KIND = {
    DOUBLE: {
        **{"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "neg": "fneg", "single": "fptrunc"},
        **{"lt": "fcmp olt", "le": "fcmp ole", "gt": "fcmp ogt", "ge": "fcmp oge"},
    },
    SINGLE: {"double": "fpext"},
    WORD: {"add": "add", "mul": "mul", "xor": "xor", "shift": "lshr", "number": "uitofp"},
    FLAG: {"and": "and", "or": "or", "xor": "xor"},
}
"""Instructions, by the kind of what they take."""

INTRINSICS = {"sqrt": "sqrt", "round": "rint", "abs": "fabs"}


class Arrangement(NamedTuple):
    """Where intermediate results lie.

    Attributes:
        stored: Operation and row of what each phase stores.
        home: By operation, a row that holds it, and the first phase that finds it there.
        groups: First rows of the operands and results of calls.
        height: Number of rows.
    """

    stored: list[list[tuple[int, int]]]
    home: dict[int, tuple[int, int]]
    groups: dict[tuple[int, ...], int]
    height: int


def laid_out(plan: Sequence[Phase]) -> Arrangement:
    """Rows for what phases keep; those of a call's operands lie side by side, and so do its results'."""
    stored: list[list[tuple[int, int]]] = []
    home: dict[int, tuple[int, int]] = {}
    groups: dict[tuple[int, ...], int] = {}
    height = 0
    for at, phase in enumerate(plan):
        own = []
        for numbers in (part for call in phase.calls for part in call.operands):
            if numbers not in groups:
                groups[numbers] = height
                own += [(number, height + i) for i, number in enumerate(numbers)]
                height += len(numbers)
        here = dict(own)
        for number in phase.kept:
            if number not in here:
                own.append((number, height))
                here[number] = height
                height += 1
            home[number] = (here[number], at + 1)
        for call in phase.calls:
            groups[call.results] = height
            home |= {number: (height + i, at + 1) for i, number in enumerate(call.results)}
            height += len(call.results)
        stored.append(own)
    return Arrangement(stored, home, groups, height)


Called = tuple[Any, list[NDArray[Any]]]
"""A function, and the arrays that it reads and writes."""


class Compiled:
    """A trace ready to be run.

    Args:
        trace: The operations.
        outputs: What is written.
        count: For how many poses it will be run.
    """

    def __init__(self, trace: Trace, outputs: Sequence[Outputs], count: int) -> None:
        self._plan = phases(trace, outputs)
        self._layout = laid_out(self._plan)
        self._width = max(LEAST, NUMBERS // max(self._layout.height, 1) // LEAST * LEAST)
        read = (operation.detail[0] for operation in trace.operations if operation.name == "input")
        self._arrays = (KEPT, *dict.fromkeys((*read, *(out.array for out in outputs))))
        code = (_loop(trace, self._layout, i, phase, self._arrays) for i, phase in enumerate(self._plan))
        text = "\n".join((*DECLARED, *code))
        names = tuple(f"phase{i}" for i in range(len(self._plan)))
        self._engine, addresses = machine(text, names, count >= THOROUGH)
        self._functions = [FUNCTION(address) for address in addresses]
        self._calls: dict[int, list[tuple[list[Called], list[Called]]]] = {}
        self._kept = np.empty((0, 0))

    def run(self, arrays: Mapping[str, NDArray[Any]], count: int) -> None:
        """Compute outputs from inputs: arrays ``(rows, count)`` by name, whose rows lie one after the other."""
        width = min(count, self._width)
        if self._kept.shape[1] != width:
            self._kept, self._calls = np.zeros((self._layout.height, width)), {}
        used = (self._kept, *(arrays[name] for name in self._arrays[1:]))
        bases = (ctypes.c_void_p * len(used))(*(array.__array_interface__["data"][0] for array in used))
        for first in range(0, count, width):
            here = min(width, count - first)
            if here not in self._calls:
                self._calls[here] = [self._called(phase, here) for phase in self._plan]
            for function, (calls, fills) in zip(self._functions, self._calls[here], strict=True):
                function(bases, width, count, first, here)
                for called, rows in calls:
                    called(*rows)
                for fill, (given, found) in fills:
                    fill(given, found, slice(first, first + here))

    def _called(self, phase: Phase, here: int) -> tuple[list[Called], list[Called]]:
        """NumPy's functions of a phase, and ours, with the rows that they read and write, for a block of so many."""
        numpys: list[Called] = []
        ours: list[Called] = []
        for call in phase.calls:
            parts = ((self._layout.groups[part], len(part)) for part in (*call.operands, call.results))
            rows = [self._kept[first : first + size, :here] for first, size in parts]
            if isinstance(call.function, str):
                numpys.append((CALLED[call.function], rows))
            else:
                ours.append((call.function, rows))
        return numpys, ours


DECLARED = tuple(
    f"declare {kind} @llvm.{name}.{mark}({kind})"
    for name in INTRINSICS.values()
    for kind, mark in (("double", "f64"), *((f"<{lanes} x double>", f"v{lanes}f64") for lanes in LANES.values()))
)


def _loop(trace: Trace, layout: Arrangement, number: int, phase: Phase, arrays: Sequence[str]) -> str:
    """The function of one phase: a loop by lanes, and one for what is left."""
    lanes = LANES[bool(_host()[1].get("avx512f"))]
    wide, narrow = (_Body(trace, layout, number, phase, arrays, count).text for count in (lanes, 1))
    return f"""
define void @phase{number}(ptr noalias %bases, i64 %width, i64 %count, i64 %first, i64 %here) {{
entry:
  br label %wide_head
wide_head:
  %wide_at = phi i64 [0, %entry], [%wide_next, %wide]
  %wide_next = add i64 %wide_at, {lanes}
  %wide_more = icmp ule i64 %wide_next, %here
  br i1 %wide_more, label %wide, label %narrow_head
wide:
{wide}
  br label %wide_head
narrow_head:
  %narrow_at = phi i64 [%wide_at, %wide_head], [%narrow_next, %narrow]
  %narrow_next = add i64 %narrow_at, 1
  %narrow_more = icmp ule i64 %narrow_next, %here
  br i1 %narrow_more, label %narrow, label %done
narrow:
{narrow}
  br label %narrow_head
done:
  ret void
}}"""


class _Body:
    """The instructions of one phase for some poses at once; `text` is they."""

    def __init__(
        self, trace: Trace, layout: Arrangement, number: int, phase: Phase, arrays: Sequence[str], lanes: int
    ) -> None:
        self._lines: list[str] = []
        self._operations, self._layout, self._number = trace.operations, layout, number
        self._arrays, self._lanes = arrays, lanes
        self._loop = "wide" if lanes > 1 else "narrow"
        self._bases: dict[str, str] = {}
        goals = [(value, KEPT, row) for value, row in layout.stored[number]]
        goals += [(value, array, row) for value, (array, row) in phase.written]
        self._all = self._new(f"add i64 %{self._loop}_at, %first")
        self._values: dict[int, str] = {}
        for value in self._needed([value for value, _, _ in goals]):
            self._values[value] = self._value(value)
        for goal in goals:
            self._store(*goal)

    @property
    def text(self) -> str:
        """All lines."""
        return "\n".join(self._lines)

    def _is_kept(self, number: int) -> bool:
        return number in self._layout.home and self._layout.home[number][1] <= self._number

    def _needed(self, waiting: list[int]) -> list[int]:
        """What this phase loads or computes, in order."""
        needed: set[int] = set()
        while waiting:
            number = waiting.pop()
            if number not in needed:
                needed.add(number)
                if not self._is_kept(number):
                    waiting += self._operations[number].operands
        return sorted(needed)

    def _value(self, number: int) -> str:
        """The name of an operation's result, or a constant."""
        operation = self._operations[number]
        if operation.name == "constant":
            return self._constant(operation)
        if operation.name == "input":
            array, row = operation.detail
            return self._load(array, row, operation.kind)
        if self._is_kept(number):
            return self._load(KEPT, self._layout.home[number][0], operation.kind)
        given = [self._values[i] for i in operation.operands]
        kind = self._operations[operation.operands[0]].kind
        return self._computed(operation.name, kind, operation.kind, given)

    def _computed(self, name: str, kind: str, result: str, given: list[str]) -> str:
        taken = self._type(kind)
        if name in INTRINSICS:
            mark = f"v{self._lanes}f64" if self._lanes > 1 else "f64"
            return self._new(f"call {taken} @llvm.{INTRINSICS[name]}.{mark}({taken} {given[0]})")
        if name in ("min", "max"):  # of equal numbers the second, and a number that is none wins, as in NumPy
            first = self._new(f"fcmp {'olt' if name == 'min' else 'ogt'} {taken} {given[0]}, {given[1]}")
            none = self._new(f"fcmp uno {taken} {given[0]}, {given[0]}")
            given, name = [self._new(f"or {self._type(FLAG)} {first}, {none}"), *given], "where"
        if name == "where":
            flag, taken = self._type(FLAG), self._type(result)
            return self._new(f"select {flag} {given[0]}, {taken} {given[1]}, {taken} {given[2]}")
        instruction = BY_KIND[kind][name]
        if kind != result and name not in ("lt", "le", "gt", "ge"):
            return self._new(f"{instruction} {taken} {given[0]} to {self._type(result)}")
        return self._new(f"{instruction} {taken} {', '.join(given)}")

    def _new(self, instruction: str) -> str:
        name = f"%{self._loop[0]}{len(self._lines)}"
        self._lines.append(f"  {name} = {instruction}")
        return name

    def _type(self, kind: str) -> str:
        return f"<{self._lanes} x {kind}>" if self._lanes > 1 else kind

    def _constant(self, operation: Operation) -> str:
        value, kind = operation.detail, operation.kind
        text = f"0x{struct.pack('>d', float.fromhex(value)).hex().upper()}" if kind == DOUBLE else str(value)
        return text if self._lanes == 1 else f"<{', '.join([f'{kind} {text}'] * self._lanes)}>"

    def _place(self, array: str, row: int, kind: str) -> str:
        """Pointer to this turn's entries in a row of an array."""
        if array not in self._bases:
            slot = self._new(f"getelementptr ptr, ptr %bases, i64 {self._arrays.index(array)}")
            self._bases[array] = self._new(f"load ptr, ptr {slot}")
        width, at, size = "%count", self._all, BYTES[kind]
        if array == KEPT:
            width, at, size = "%width", f"%{self._loop}_at", 8
        along = self._new(f"mul i64 {row * size}, {width}")
        within = self._new(f"mul i64 {BYTES[kind]}, {at}")
        along = self._new(f"add i64 {along}, {within}")
        return self._new(f"getelementptr i8, ptr {self._bases[array]}, i64 {along}")

    def _load(self, array: str, row: int, kind: str) -> str:
        place, memory = self._place(array, row, kind), self._type("i8" if kind == FLAG else kind)
        value = self._new(f"load {memory}, ptr {place}, align {BYTES[kind]}")
        return value if kind != FLAG else self._new(f"trunc {memory} {value} to {self._type(FLAG)}")

    def _store(self, number: int, array: str, row: int) -> None:
        kind, value = self._operations[number].kind, self._values[number]
        place, memory = self._place(array, row, kind), self._type("i8" if kind == FLAG else kind)
        if kind == FLAG:
            value = self._new(f"zext {self._type(FLAG)} {value} to {memory}")
        self._lines.append(f"  store {memory} {value}, ptr {place}, align {BYTES[kind]}")


FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_void_p, *[ctypes.c_int64] * 4)


@lru_cache(maxsize=1)
def _host() -> tuple[str, dict[str, bool]]:
    """The name of this processor, and what it can do."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.get_host_cpu_name(), dict(binding.get_host_cpu_features())


def fused(kind: str, result: str, one: str, other: str, more: str) -> str:
    """Instructions for one * other + more of vectors of floats, rounded once where the processor can do that."""
    lanes = kind.strip("<>").split()[0]
    if _host()[1].get("fma") or platform.machine() in ("arm64", "aarch64"):
        return f"  {result} = call {kind} @llvm.fma.v{lanes}f32({kind} {one}, {kind} {other}, {kind} {more})"
    return f"  {result}p = fmul {kind} {one}, {other}\n  {result} = fadd {kind} {result}p, {more}"


def adds_products_of_bytes() -> bool:
    """Whether this processor has instructions that add products of 64 bytes (AVX-512 VNNI)."""
    return bool(_host()[1].get("avx512vnni"))


@lru_cache(maxsize=64)
def machine(code: str, names: tuple[str, ...], thorough: bool) -> tuple[Any, list[int]]:
    """What keeps code in memory, and the addresses of its functions.

    Args:
        code: LLVM's language.
        names: Of the functions.
        thorough: Whether registers are used well, which takes four times as long to generate.
    """
    name, features = _host()
    target = binding.Target.from_default_triple().create_target_machine(
        cpu=name,
        features=",".join(f"{'+' if there else '-'}{feature}" for feature, there in sorted(features.items())),
        opt=2 if thorough else 0,
    )
    module = binding.parse_assembly(code)
    module.verify()
    engine = binding.create_mcjit_compiler(module, target)
    engine.finalize_object()
    return engine, [engine.get_function_address(function) for function in names]
