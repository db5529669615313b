"""A network of cut-off layers as machine code, in single precision: each pose by itself, in one fixed order of sums.

So a pose has the same bits alone and among thousands, which a matrix product of a library does not give. Sixteen poses
go through all layers together and stay in a core's first cache.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.machine_code import fused, machine

LANES, POSES, TILE = 8, 16, 6
"""Poses of one instruction, poses that go through together, outputs that are summed side by side."""

Single = NDArray[np.float32]
FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4, ctypes.c_int64)


class CompiledNetwork:
    """Layers ready to be run.

    Args:
        layers: Matrices ``(in, out)``, and what each product is cut off below or, in the last layer, what is added.
    """

    def __init__(self, layers: Sequence[tuple[Single, Single]]) -> None:
        self._layers = layers
        self._outputs = len(layers[-1][1])
        sizes = [len(layers[0][0]), *(-(-len(limit) // TILE) * TILE for _, limit in layers)]
        numbers = []
        for (weight, limit), inputs, outputs in zip(layers, sizes[:-1], sizes[1:], strict=True):
            padded = np.zeros((inputs, outputs), dtype=np.float32)
            padded[: weight.shape[0], : weight.shape[1]] = weight
            numbers += [padded.reshape(inputs, -1, TILE).swapaxes(0, 1).ravel(), np.resize(limit, outputs)]
        self._numbers = np.concatenate(numbers).astype(np.float32)
        self._engine, (address,) = machine(_code(tuple(sizes)), ("network",), True)
        self._run = FUNCTION(address)
        self._height = max(sizes)

    def __reduce__(self) -> tuple[type[CompiledNetwork], tuple[Any]]:
        """Pickled and copied by its layers: code is made anew."""
        return CompiledNetwork, (self._layers,)

    def __call__(self, rows: NDArray[np.floating[Any]]) -> Single:
        """Outputs ``(N, out)`` for inputs ``(N, in)``."""
        count = len(rows)
        width = max(-(-count // POSES), 1) * POSES
        given = np.zeros((rows.shape[1], width), dtype=np.float32)
        given[:, :count] = rows.T
        found = np.empty((-(-self._outputs // TILE) * TILE, width), dtype=np.float32)
        between = np.empty((2, self._height, POSES), dtype=np.float32)
        self._run(*(array.ctypes.data for array in (given, self._numbers, found, between)), width)
        return found[: self._outputs, :count].T


def _code(sizes: tuple[int, ...]) -> str:
    """The network of layers of these sizes."""
    last, first, offset, lines = len(sizes) - 2, "%given_here", 0, []
    for i, (inputs, outputs) in enumerate(pairwise(sizes)):
        weights, limits = 4 * offset, 4 * (offset + inputs * outputs)
        offset += (inputs + 1) * outputs
        into = "%found_here" if i == last else f"%between{i % 2}"
        strides = ("%width" if i == 0 else POSES), ("%width" if i == last else POSES)
        lines.append(f"""
  %w{i} = getelementptr i8, ptr %numbers, i64 {weights}
  %l{i} = getelementptr i8, ptr %numbers, i64 {limits}
  call void @layer(ptr {first}, i64 {strides[0]}, ptr %w{i}, ptr %l{i}, ptr {into}, i64 {strides[1]}, i64 {inputs},
                   i64 {outputs}, i1 {int(i == last)})""")
        first = into
    return f"""{_layer()}
define void @network(ptr %given, ptr %numbers, ptr %found, ptr %between0, i64 %width) {{
entry:
  %between1 = getelementptr float, ptr %between0, i64 {max(sizes) * POSES}
  br label %head
head:
  %at = phi i64 [0, %entry], [%next, %head]
  %given_here = getelementptr float, ptr %given, i64 %at
  %found_here = getelementptr float, ptr %found, i64 %at{"".join(lines)}
  %next = add i64 %at, {POSES}
  %more = icmp ult i64 %next, %width
  br i1 %more, label %head, label %done
done:
  ret void
}}"""


def _layer() -> str:
    """One layer for sixteen poses: sums of `TILE` outputs side by side, input after input."""
    kind, halves = f"<{LANES} x float>", POSES // LANES
    sums = [(t, h) for t in range(TILE) for h in range(halves)]
    start = "\n".join(f"  %s{t}_{h} = phi {kind} [zeroinitializer, %tile], [%n{t}_{h}, %sum]" for t, h in sums)
    loads = "\n".join(
        f"  %p{h} = getelementptr float, ptr %row, i64 {h * LANES}\n  %x{h} = load {kind}, ptr %p{h}, align 4"
        for h in range(halves)
    )
    adds, ends = [], []
    for t in range(TILE):
        adds.append(f"""  %q{t} = getelementptr float, ptr %weight, i64 {t}
  %f{t} = load float, ptr %q{t}, align 4
  %i{t} = insertelement {kind} poison, float %f{t}, i64 0
  %b{t} = shufflevector {kind} %i{t}, {kind} poison, <{LANES} x i32> zeroinitializer""")
        ends.append(f"""  %o{t} = add i64 %out, {t}
  %ql{t} = getelementptr float, ptr %limits, i64 %o{t}
  %fl{t} = load float, ptr %ql{t}, align 4
  %il{t} = insertelement {kind} poison, float %fl{t}, i64 0
  %bl{t} = shufflevector {kind} %il{t}, {kind} poison, <{LANES} x i32> zeroinitializer
  %or{t} = mul i64 %o{t}, %into_stride
  %to{t} = getelementptr float, ptr %into, i64 %or{t}""")
        for h in range(halves):
            adds.append(fused(kind, f"%n{t}_{h}", f"%b{t}", f"%x{h}", f"%s{t}_{h}"))
            ends.append(f"""  %more{t}_{h} = fadd {kind} %n{t}_{h}, %bl{t}
  %above{t}_{h} = fcmp ogt {kind} %n{t}_{h}, %bl{t}
  %cut{t}_{h} = select <{LANES} x i1> %above{t}_{h}, {kind} %n{t}_{h}, {kind} %bl{t}
  %r{t}_{h} = select i1 %last, {kind} %more{t}_{h}, {kind} %cut{t}_{h}
  %to{t}_{h} = getelementptr float, ptr %to{t}, i64 {h * LANES}
  store {kind} %r{t}_{h}, ptr %to{t}_{h}, align 4""")
    return f"""declare {kind} @llvm.fma.v{LANES}f32({kind}, {kind}, {kind})
define internal void @layer(ptr %x, i64 %x_stride, ptr %weights, ptr %limits, ptr %into, i64 %into_stride, i64 %inputs,
                            i64 %outputs, i1 %last) {{
entry:
  br label %tile
tile:
  %out = phi i64 [0, %entry], [%next_out, %end]
  %before = mul i64 %out, %inputs
  %block = getelementptr float, ptr %weights, i64 %before
  br label %sum
sum:
  %in = phi i64 [0, %tile], [%next_in, %sum]
{start}
  %along = mul i64 %in, %x_stride
  %row = getelementptr float, ptr %x, i64 %along
  %within = mul i64 %in, {TILE}
  %weight = getelementptr float, ptr %block, i64 %within
{loads}
{chr(10).join(adds)}
  %next_in = add i64 %in, 1
  %more_in = icmp ult i64 %next_in, %inputs
  br i1 %more_in, label %sum, label %end
end:
{chr(10).join(ends)}
  %next_out = add i64 %out, {TILE}
  %more_out = icmp ult i64 %next_out, %outputs
  br i1 %more_out, label %tile, label %done
done:
  ret void
}}
"""
