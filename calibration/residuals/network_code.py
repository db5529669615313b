"""A network as machine code, in single precision: each pose by itself, in one fixed order of sums.

Thirty-two poses go through all layers together and stay in a core's first cache. A pose alone and one among thousands
find the same bits.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.arm.kinematics.machine_code import machine

POSES, TILE = 32, 4
"""Poses that go through together, and outputs that are summed side by side."""

MANY = f"<{POSES} x float>"
FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4, ctypes.c_int64)

Layer = tuple[Array, Array]
"""A matrix ``(in, out)``, and what is added to its product ``(out,)``."""


class CompiledNetwork:
    """Layers ready to be run; negative outputs of all but the last are cut off.

    Args:
        layers: The layers.
    """

    def __init__(self, layers: Sequence[Layer]) -> None:
        self._layers = layers
        self._outputs = len(layers[-1][1])
        sizes = [len(layers[0][0]), *(-(-len(bias) // TILE) * TILE for _, bias in layers)]
        shapes = list(pairwise(sizes))
        parts = [_arranged(layer, *shape) for layer, shape in zip(layers, shapes, strict=True)]
        starts = np.cumsum([0, *map(len, parts)]).tolist()
        calls = [_call(i, len(layers), starts[i], *shape) for i, shape in enumerate(shapes)]
        self._numbers, self._sizes = np.concatenate(parts), sizes
        self._engine, (address,) = machine(_code(calls, max(sizes) * POSES), ("network",), True)
        self._run = FUNCTION(address)

    def __reduce__(self) -> tuple[type[CompiledNetwork], tuple[Any]]:
        """Pickled and copied by its layers: code is made anew."""
        return CompiledNetwork, (self._layers,)

    def __call__(self, rows: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Outputs ``(N, out)`` for inputs ``(N, in)``."""
        count, inputs = len(rows), rows.shape[1]
        width = max(-(-count // POSES), 1) * POSES
        table = np.empty((inputs + self._sizes[-1], width), dtype=np.float32)
        table[:inputs, :count], table[:inputs, count:] = rows.T, 0.0
        between = np.empty(2 * max(self._sizes) * POSES, dtype=np.float32)
        arrays = (table, self._numbers, table[inputs:], between)
        self._run(*(array.__array_interface__["data"][0] for array in arrays), width)
        return table[inputs : inputs + self._outputs, :count].T


def _arranged(layer: Layer, inputs: int, outputs: int) -> NDArray[np.float32]:
    """A layer's numbers in the order in which they are read: weights by tiles, then what is added."""
    matrix, bias = layer
    padded = np.zeros((inputs + 1, outputs), dtype=np.float32)
    padded[: len(matrix), : len(bias)], padded[-1, : len(bias)] = matrix, bias
    tiles = padded[:-1].reshape(inputs, -1, TILE).swapaxes(0, 1)
    return np.concatenate([tiles.ravel(), padded[-1]])


def _call(i: int, count: int, start: int, inputs: int, outputs: int) -> str:
    """Instructions that take poses through layer ``i`` of ``count``, whose numbers begin at ``start``."""
    source, stride = ("%given_here", "%width") if i == 0 else (f"%values{i % 2}", str(POSES))
    into, into_stride = ("%found_here", "%width") if i + 1 == count else (f"%values{(i + 1) % 2}", str(POSES))
    least = "0xFFF0000000000000" if i + 1 == count else "0.0"
    return f"""
  %numbers{i} = getelementptr float, ptr %numbers, i64 {start}
  call void @layer(ptr {source}, i64 {stride}, ptr %numbers{i}, ptr {into}, i64 {into_stride}, i64 {inputs},
    i64 {outputs}, float {least})"""


def _code(calls: Sequence[str], half: int) -> str:
    """The network; ``half`` numbers hold what comes out of a layer."""
    return f"""
{_layer()}
define void @network(ptr %given, ptr %numbers, ptr %found, ptr %values0, i64 %width) {{
entry:
  %values1 = getelementptr float, ptr %values0, i64 {half}
  br label %head
head:
  %at = phi i64 [0, %entry], [%next, %head]
  %given_here = getelementptr float, ptr %given, i64 %at
  %found_here = getelementptr float, ptr %found, i64 %at{"".join(calls)}
  %next = add i64 %at, {POSES}
  %more = icmp ult i64 %next, %width
  br i1 %more, label %head, label %done
done:
  ret void
}}"""


def _layer() -> str:
    """One layer for all poses at once, sums of `TILE` outputs side by side."""
    start, adds, ends = list[str](), list[str](), list[str]()
    for t in range(TILE):
        start.append(f"  %s{t} = phi {MANY} [zeroinitializer, %tile], [%n{t}, %sum]")
        adds.append(f"""{_spread(f"%b{t}", "%weight", str(t))}
  %p{t} = fmul contract {MANY} %b{t}, %x
  %n{t} = fadd contract {MANY} %s{t}, %p{t}""")
        ends.append(f"""  %o{t} = add i64 %out, {t}
{_spread(f"%bias{t}", "%biases", f"%o{t}")}
  %sum{t} = fadd {MANY} %n{t}, %bias{t}
  %above{t} = fcmp ogt {MANY} %sum{t}, %floor
  %kept{t} = select <{POSES} x i1> %above{t}, {MANY} %sum{t}, {MANY} %floor
  %to{t} = mul i64 %o{t}, %into_stride
  %place{t} = getelementptr float, ptr %into, i64 %to{t}
  store {MANY} %kept{t}, ptr %place{t}, align 4""")
    lines = "\n".join
    return f"""
define internal void @layer(ptr %given, i64 %stride, ptr %weights, ptr %into, i64 %into_stride, i64 %inputs,
                            i64 %outputs, float %least) {{
entry:
  %size = mul i64 %inputs, %outputs
  %biases = getelementptr float, ptr %weights, i64 %size
  %first = insertelement {MANY} poison, float %least, i64 0
  %floor = shufflevector {MANY} %first, {MANY} poison, <{POSES} x i32> zeroinitializer
  br label %tile
tile:
  %out = phi i64 [0, %entry], [%next_out, %end]
  %before = mul i64 %out, %inputs
  %block = getelementptr float, ptr %weights, i64 %before
  br label %sum
sum:
  %in = phi i64 [0, %tile], [%next_in, %sum]
{lines(start)}
  %along = mul i64 %in, %stride
  %within = mul i64 %in, {TILE}
  %weight = getelementptr float, ptr %block, i64 %within
  %here = getelementptr float, ptr %given, i64 %along
  %x = load {MANY}, ptr %here, align 4
{lines(adds)}
  %next_in = add i64 %in, 1
  %more_in = icmp ult i64 %next_in, %inputs
  br i1 %more_in, label %sum, label %end
end:
{lines(ends)}
  %next_out = add i64 %out, {TILE}
  %more_out = icmp ult i64 %next_out, %outputs
  br i1 %more_out, label %tile, label %done
done:
  ret void
}}"""


def _spread(name: str, base: str, offset: str) -> str:
    """Load a number for all poses."""
    return f"""  {name}p = getelementptr float, ptr {base}, i64 {offset}
  {name}l = load float, ptr {name}p, align 4
  {name}i = insertelement {MANY} poison, float {name}l, i64 0
  {name} = shufflevector {MANY} {name}i, {MANY} poison, <{POSES} x i32> zeroinitializer"""
