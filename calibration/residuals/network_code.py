"""A network as machine code, with its inner layers in eight bits: each pose by itself, in one fixed order of sums.

Sixteen poses go through all layers together and stay in a core's first cache. What comes out of a hidden layer is
rounded to 255 steps of each pose's own largest value, and meets the whole-number weights of `rounded_layers`. Sums of
their products are exact in any order: processors that multiply bytes and those that take single precision for it find
the same bits, and so do a pose alone and one among thousands.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.machine_code import _machine as machine
def adds_products_of_bytes(): return True
def fused(kind, result, one, other, more):
    lanes = kind.strip("<>").split()[0]
    return f"  {result} = call {kind} @llvm.fma.v{lanes}f32({kind} {one}, {kind} {other}, {kind} {more})"


STEPS, MOST = 255, 127
"""Steps from zero to a pose's largest value, and the largest weight."""

DAMPING = 1e-3
"""Added to the inputs' covariance, as a share of its mean diagonal, so that it can be inverted."""

POSES, TILE, PACKED = 16, 4, 4
"""Poses that go through together, outputs that are summed side by side, bytes in a word."""

LEAST = 1e-30
"""What the largest value of a pose counts at least."""

SHIFT = 2.0**23
"""Added to a number of single precision it leaves whole numbers, which then stand in its last bits."""

SHIFTS = int(np.float32(SHIFT).view(np.uint32)) * 0x01010101 % 2**32
"""The other bits, of four bytes in a word."""

REAL, WHOLE = f"<{POSES} x float>", f"<{POSES} x i32>"
BYTE_PRODUCTS = f"{WHOLE} @llvm.x86.avx512.vpdpbusd.512"
FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4, ctypes.c_int64)


class Layer(NamedTuple):
    """One layer.

    Attributes:
        weights: Matrix ``(in, out)``; whole numbers up to `MOST` where there is a scale.
        bias: What is added to its product ``(out,)``.
        scale: What the product is multiplied by before ``(out,)``, or None.
    """

    weights: Array
    bias: Array
    scale: Array | None = None


def rounded_layers(layers: Sequence[Layer], sample: Array) -> list[Layer]:
    """The layers, all but the first and the last with whole-number weights, rounded one after the other.

    What rounding a weight adds to the outputs is taken back by the weights that are rounded after it, as far as their
    inputs vary together (Frantar et al. 2023, GPTQ, algorithm 1): half the error of rounding each for itself.

    Args:
        layers: In double precision; negative outputs of all but the last are cut off.
        sample: Inputs ``(N, in)`` like those to come.
    """
    found, values = [layers[0]], sample
    for before, layer in pairwise(layers[:-1]):
        values = _stepped(np.maximum(values @ before.weights + before.bias, 0.0))
        found.append(_rounded_layer(layer, values))
    return [*found, *layers[1:][-1:]]


def _stepped(values: Array) -> Array:
    """Values ``(N, in)``, none negative, as whole steps of each row's largest."""
    step = np.maximum(values.max(axis=1, keepdims=True), np.finfo(np.float32).tiny) / STEPS
    return np.asarray(np.round(values / step) * step)


def _rounded_layer(layer: Layer, values: Array) -> Layer:
    """A layer rounded for inputs like ``values`` ``(N, in)``."""
    mean, count = values.mean(axis=0), len(layer.weights)
    covariance = np.cov(values, rowvar=False, bias=True).reshape(count, count)
    covariance += DAMPING * (covariance.diagonal().mean() or 1.0) * np.eye(count)
    order = np.argsort(-covariance.diagonal(), kind="stable")
    upper = np.linalg.cholesky(np.linalg.inv(covariance[np.ix_(order, order)])).T
    scale = np.maximum(np.abs(layer.weights).max(axis=0), np.finfo(np.float32).tiny) / MOST
    left, whole = layer.weights[order] / scale, np.empty_like(layer.weights)
    for i, row in enumerate(order):
        whole[row] = np.clip(np.round(left[i]), -MOST, MOST)
        left[i + 1 :] -= np.outer(upper[i, i + 1 :] / upper[i, i], left[i] - whole[row])
    return Layer(whole, layer.bias + mean @ (layer.weights - whole * scale), scale)


class CompiledNetwork:
    """Layers ready to be run.

    Args:
        layers: From `rounded_layers`.
    """

    def __init__(self, layers: Sequence[Layer]) -> None:
        self._layers = layers
        self._outputs = len(layers[-1].bias)
        in_bytes = adds_products_of_bytes()
        numbers, calls, at = list[NDArray[np.uint8]](), list[str](), 0
        sizes = [len(layers[0].weights), *(-(-len(layer.bias) // TILE) * TILE for layer in layers)]
        for i, layer in enumerate(layers):
            packed = PACKED if in_bytes and layer.scale is not None else 1
            numbers.append(_arranged(layer, sizes[i], sizes[i + 1], packed))
            calls.append(_call(layer, i, i + 1 == len(layers), at, packed, sizes[i], sizes[i + 1]))
            at += len(numbers[-1])
        self._numbers, self._sizes = np.concatenate(numbers), sizes
        self._numbers_at = self._numbers.ctypes.data
        self._engine, (address,) = machine(_code(calls, in_bytes, max(sizes)), ("network",), True)
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
        given, values = (array.__array_interface__["data"][0] for array in (table, between))
        self._run(given, self._numbers_at, given + table.strides[0] * inputs, values, width)
        return table[inputs : inputs + self._outputs, :count].T


def _arranged(layer: Layer, inputs: int, outputs: int, packed: int) -> NDArray[np.uint8]:
    """A layer's numbers in the order in which they are read: weights by tiles, then biases and scales."""
    padded = np.zeros((inputs, outputs), dtype=np.float32 if packed == 1 else np.int8)
    padded[: layer.weights.shape[0], : layer.weights.shape[1]] = layer.weights
    tiles = padded.reshape(inputs // packed, packed, -1, TILE).transpose(2, 0, 3, 1)
    ends = np.zeros((2, outputs), dtype=np.float32)
    for end, values in zip(ends, (layer.bias, layer.scale), strict=True):
        end[: len(layer.bias)] = 1.0 if values is None else values
    return np.concatenate([np.ascontiguousarray(part).view(np.uint8).ravel() for part in (tiles, ends)])


def _call(layer: Layer, i: int, last: bool, at: int, packed: int, inputs: int, outputs: int) -> str:
    """Instructions that take sixteen poses through layer ``i``, whose numbers start at byte ``at``."""
    source, stride = ("%given_here", "%width") if i == 0 else ("%values", str(POSES))
    into, into_stride = ("%found_here", "%width") if last else ("%values", str(POSES))
    name, step, rounding = "real", _constant(1), ""
    if layer.scale is not None:
        name, source, step = "whole", "%steps", f"%step{i}"
        rounding = f"""  {step} = fdiv {REAL} %top{i - 1}, {_constant(STEPS)}
  call void @rounded(ptr %values, {REAL} {step}, ptr %steps, i64 {inputs})
"""
    return f"""
{rounding}  %numbers{i} = getelementptr i8, ptr %numbers, i64 {at}
  %top{i} = call {REAL} @{name}(ptr {source}, i64 {stride}, ptr %numbers{i}, {REAL} {step}, ptr {into},
    i64 {into_stride}, i64 {inputs // packed}, i64 {outputs}, {REAL} {_constant(-np.inf if last else 0)})"""


def _code(calls: Sequence[str], in_bytes: bool, height: int) -> str:
    """The network."""
    return f"""
declare {BYTE_PRODUCTS}({WHOLE}, {WHOLE}, {WHOLE})
declare {REAL} @llvm.fma.v{POSES}f32({REAL}, {REAL}, {REAL})
{_layer("real", False)}
{_layer("whole", in_bytes)}
{_rounded(in_bytes)}
define void @network(ptr %given, ptr %numbers, ptr %found, ptr %values, i64 %width) {{
entry:
  %steps = getelementptr float, ptr %values, i64 {height * POSES}
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


def _layer(name: str, in_bytes: bool) -> str:
    """One layer for sixteen poses, sums of `TILE` outputs side by side; it returns each pose's largest output."""
    kind, one = (WHOLE, "i32") if in_bytes else (REAL, "float")
    start = "\n".join(f"  %s{t} = phi {kind} [zeroinitializer, %tile], [%n{t}, %sum]" for t in range(TILE))
    adds, ends, top = list[str](), list[str](), "%top"
    for t in range(TILE):
        adds.append(_spread(f"%b{t}", "%weight", str(t), one))
        if in_bytes:
            adds.append(f"  %n{t} = call {BYTE_PRODUCTS}({WHOLE} %s{t}, {WHOLE} %x, {WHOLE} %b{t})")
            ends.append(f"  %real{t} = sitofp {WHOLE} %n{t} to {REAL}")
        else:
            adds.append(fused(kind, f"%n{t}", f"%b{t}", "%x", f"%s{t}"))
        ends.append(f"""  %o{t} = add i64 %out, {t}
{_spread(f"%bias{t}", "%biases", f"%o{t}", "float")}
{_spread(f"%scale{t}", "%scales", f"%o{t}", "float")}
  %by{t} = fmul {REAL} %scale{t}, %step
{fused(REAL, f"%whole{t}", f"%real{t}" if in_bytes else f"%n{t}", f"%by{t}", f"%bias{t}")}
{_larger(f"%kept{t}", f"%whole{t}", "%least")}
{_larger(f"%top{t}", f"%kept{t}", top)}
  %to{t} = mul i64 %o{t}, %into_stride
  %p{t} = getelementptr float, ptr %into, i64 %to{t}
  store {REAL} %kept{t}, ptr %p{t}, align 4""")
        top = f"%top{t}"
    return f"""
define internal {REAL} @{name}(ptr %given, i64 %stride, ptr %weights, {REAL} %step, ptr %into, i64 %into_stride,
                               i64 %inputs, i64 %outputs, {REAL} %least) {{
entry:
  %size = mul i64 %inputs, %outputs
  %biases = getelementptr i32, ptr %weights, i64 %size
  %scales = getelementptr float, ptr %biases, i64 %outputs
  br label %tile
tile:
  %out = phi i64 [0, %entry], [%next_out, %end]
  %top = phi {REAL} [{_constant(LEAST)}, %entry], [{top}, %end]
  %before = mul i64 %out, %inputs
  %block = getelementptr i32, ptr %weights, i64 %before
  br label %sum
sum:
  %in = phi i64 [0, %tile], [%next_in, %sum]
{start}
  %along = mul i64 %in, %stride
  %within = mul i64 %in, {TILE}
  %weight = getelementptr i32, ptr %block, i64 %within
{_load("%x", kind, "%given", "%along")}
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
  ret {REAL} {top}
}}"""


def _rounded(in_bytes: bool) -> str:
    """Values of sixteen poses in whole steps, four to a word or each a number of single precision."""
    packed, lines = PACKED if in_bytes else 1, list[str]()
    for b in range(packed):
        lines.append(f"""  %place{b} = add i64 %source, {b * POSES}
{_load(f"%v{b}", REAL, "%values", f"%place{b}")}
{fused(REAL, f"%shifted{b}", f"%v{b}", "%inverse", _constant(SHIFT))}""")
        if in_bytes:
            lines.append(f"""  %bits{b} = bitcast {REAL} %shifted{b} to {WHOLE}
  %byte{b} = shl {WHOLE} %bits{b}, {_constant(8 * b, "i32")}
  %sum{b} = add {WHOLE} %byte{b}, {f"%sum{b - 1}" if b else _constant(-SHIFTS, "i32")}""")
    if not in_bytes:
        lines.append(f"  %plain = fsub {REAL} %shifted0, {_constant(SHIFT)}")
    return f"""
define internal void @rounded(ptr %values, {REAL} %step, ptr %steps, i64 %rows) {{
entry:
  %inverse = fdiv {REAL} {_constant(1)}, %step
  br label %round
round:
  %row = phi i64 [0, %entry], [%next_row, %round]
  %source = mul i64 %row, {POSES}
  %target = udiv i64 %source, {packed}
{chr(10).join(lines)}
  %to = getelementptr i32, ptr %steps, i64 %target
  store {f"{WHOLE} %sum{PACKED - 1}" if in_bytes else f"{REAL} %plain"}, ptr %to, align 4
  %next_row = add i64 %row, {packed}
  %more_rows = icmp ult i64 %next_row, %rows
  br i1 %more_rows, label %round, label %done
done:
  ret void
}}"""


def _larger(name: str, one: str, other: str) -> str:
    """The larger of two numbers of each pose."""
    return f"""  {name}c = fcmp ogt {REAL} {one}, {other}
  {name} = select <{POSES} x i1> {name}c, {REAL} {one}, {REAL} {other}"""


def _load(name: str, kind: str, base: str, offset: str) -> str:
    """Load numbers of four bytes that lie one after the other."""
    return f"  {name}p = getelementptr i32, ptr {base}, i64 {offset}\n  {name} = load {kind}, ptr {name}p, align 4"


def _spread(name: str, base: str, offset: str, one: str) -> str:
    """Load a number for all poses."""
    kind = f"<{POSES} x {one}>"
    return f"""{_load(f"{name}l", one, base, offset)}
  {name}i = insertelement {kind} poison, {one} {name}l, i64 0
  {name} = shufflevector {kind} {name}i, {kind} poison, {WHOLE} zeroinitializer"""


def _constant(value: float, one: str = "float") -> str:
    """The same number for all poses."""
    text = str(value) if one == "i32" else f"0x{np.float64(np.float32(value)).view(np.uint64):016X}"
    return f"<{', '.join([f'{one} {text}'] * POSES)}>"
