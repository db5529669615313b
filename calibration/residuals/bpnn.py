"""The paper's back-propagation network for what geometry does not explain (Qiao 2026, section 1.4, eqs (17)-(18)).

6-256-128-64-32-6 with batch normalisation, ReLU and dropout after every hidden layer, mean square error, Adam 1e-3,
L2 1e-5, 500 epochs, batches of 16. Trained with torch; run afterwards as a NumPy forward pass, batch norm folded in.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.base import InputError, is_there, register, require, torch_on_one_thread
from pickenv.calibration.model.observations import equally_spaced
from pickenv.calibration.residuals.gaussian_process import column_std


@dataclass(frozen=True)
class BpnnSettings:
    """Training settings; the defaults are the paper's, except for the dropout rate, which the paper does not give.

    Attributes:
        hidden: Neurons of the hidden layers.
        epochs: Passes over the training data.
        batch_size: Poses per step.
        learning_rate: Adam's first learning rate; it falls along a cosine to zero, which the paper leaves open.
        weight_decay: L2 coefficient.
        dropout: Dropout rate after each hidden layer.
    """

    hidden: tuple[int, ...] = (256, 128, 64, 32)
    epochs: int = 500
    batch_size: int = 16
    learning_rate: float = 1e-3
    weight_decay: float = 1e-5
    dropout: float = 0.05


Layers = list[tuple[NDArray[Any], NDArray[Any]]]
"""Each layer's matrix ``(in, out)`` and the threshold below which its product is cut off, or the last layer's bias."""

SCALES = ("input_mean", "input_std", "output_mean", "output_std", "loss")
"""Names of a network's arrays other than its layers."""

ROWS = 512
"""Number of poses that go through the network together; so many fit into a core's second cache."""

SLOW_ROWS = 2000
"""Largest number of training rows; with more, training takes too long."""


def _through(layers: Layers, values: NDArray[Any]) -> NDArray[Any]:
    """Values ``(..., in)`` through a network with ReLU between its layers."""
    for weight, threshold in layers[:-1]:
        values = values @ weight
        np.maximum(values, threshold, out=values)
    weight, bias = layers[-1]
    return np.asarray(values @ weight + bias)


@register("residual", "bpnn")
@dataclass(frozen=True, eq=False)
class Bpnn:
    """A trained network in plain arrays, which maps joints to the pose residual.

    Attributes:
        input_mean: Mean of the training joints ``(n,)``, rad or m.
        input_std: Standard deviation of the training joints ``(n,)``, rad or m.
        weights: Matrices of the layers, ``(out, in)``, normalisation folded in.
        biases: Biases of the layers.
        output_mean: Mean of the training residuals ``(6,)``, m and rad.
        output_std: Standard deviation of the training residuals ``(6,)``, m and rad.
        loss: Mean training loss of each epoch, in units of the residual's standard deviation squared.
        fast: Whether the network runs in single precision, in which it was trained, and as machine code if llvmlite is
            installed.
    """

    input_mean: Array
    input_std: Array
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    output_mean: Array
    output_std: Array
    loss: Array
    fast: bool = False
    needs: ClassVar[tuple[str, ...]] = ("torch",)

    @staticmethod
    def fit(inputs: Array, targets: Array, rng: np.random.Generator) -> Bpnn:
        """Train the paper's network, with the printed settings for up to 400 poses.

        With more poses, larger batches and fewer epochs do as well. At most `SLOW_ROWS` rows are used, for time.
        """
        rows = equally_spaced(len(inputs), SLOW_ROWS)
        settings = BpnnSettings()
        if len(rows) > 400:
            settings = BpnnSettings(epochs=48_000 // len(rows), batch_size=32, learning_rate=2e-3)
        return train_bpnn(inputs[rows], targets[rows], rng, settings)

    def faster(self) -> Bpnn:
        """A copy of the network for control loops, with ``fast`` set."""
        return replace(self, fast=True)

    def predict(self, joints: ArrayLike) -> Array:
        """Residual pose error ``(..., 6)`` (m and rad, world axes) at joints ``(..., n)``.

        Many poses go through the network in blocks that are cut at fixed places. Machine code gives bitwise the same
        result for a pose alone and among many.
        """
        if self._code is not None:
            inputs = np.asarray(joints, dtype=float)
            outputs = self._code(inputs.reshape(-1, inputs.shape[-1]))
            return outputs.reshape(*inputs.shape[:-1], len(self.output_std)).astype(float)
        values = np.asarray(joints, dtype=self._dtype)
        if values.ndim == 1:
            return np.asarray(_through(self._layers, values), dtype=float)
        rows = values.reshape(-1, values.shape[-1])
        parts = [_through(self._layers, rows[a : a + ROWS]) for a in range(0, max(len(rows), 1), ROWS)]
        return np.concatenate(parts).reshape(*values.shape[:-1], len(self.output_std)).astype(float, copy=False)

    @property
    def _dtype(self) -> type[np.floating[Any]]:
        return np.float32 if self.fast else np.float64

    @cached_property
    def _scaled(self) -> list[tuple[Array, Array]]:
        """Matrices ``(in, out)`` and biases of the layers, with the scaling of inputs and outputs folded in."""
        weights = [weight.T for weight in self.weights]
        weights[0] = weights[0] / self.input_std[:, None]
        biases = [self.biases[0] - self.input_mean @ weights[0], *self.biases[1:]]
        weights[-1], biases[-1] = weights[-1] * self.output_std, biases[-1] * self.output_std + self.output_mean
        return list(zip(weights, biases, strict=True))

    @cached_property
    def _layers(self) -> Layers:
        """The layers with biases folded in: max(0, x + b) = max(-b, x) + b.

        The bias added after a cut-off goes into the next layer's bias, so that each layer passes over its numbers once.
        """
        weights, biases = [weight for weight, _ in self._scaled], [bias for _, bias in self._scaled]
        for i in range(1, len(weights)):
            biases[i] = biases[i] + biases[i - 1] @ weights[i]
        layers = zip(weights, [*(-bias for bias in biases[:-1]), biases[-1]], strict=True)
        return [(weight.astype(self._dtype, order="C"), limit.astype(self._dtype)) for weight, limit in layers]

    @cached_property
    def _code(self) -> CompiledNetwork | None:
        """The network's machine code; None unless ``fast`` is set and llvmlite is installed."""
        if not (self.fast and is_there("llvmlite")):
            return None
        return CompiledNetwork(self._scaled)

    def arrays(self) -> dict[str, Array]:
        """All numbers by name, for saving."""
        arrays = {name: getattr(self, name) for name in SCALES}
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays |= {f"weight{i}": weight, f"bias{i}": bias}
        return arrays

    @staticmethod
    def from_arrays(named: Mapping[str, NDArray[Any]]) -> Bpnn:
        """The inverse of `arrays`."""
        count = sum(key.startswith("weight") for key in named)
        weights, biases = (tuple(named[f"{kind}{i}"] for i in range(count)) for kind in ("weight", "bias"))
        scales: dict[str, Any] = {name: named[name] for name in SCALES}
        return Bpnn(weights=weights, biases=biases, **scales)


def train_bpnn(
    joints: Array,
    residuals: Array,
    rng: np.random.Generator,
    settings: BpnnSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Bpnn:
    """Train the network in torch's default precision.

    Args:
        joints: Training joints ``(N, n)``, rad or m.
        residuals: Measured minus identified pose ``(N, 6)``, m and rad (eq (17)).
        rng: Seeds weights, dropout and shuffling; equal generators give equal networks on one
            machine; with ``MKL_CBWR=COMPATIBLE`` in the environment also with AVX2 as with AVX-512.
        settings: Training settings; the paper's when left out.
        progress: Called after each epoch with (epochs done, epochs in all).

    Raises:
        InputError: If there are fewer than two batches of poses.
    """
    require("torch")
    import torch

    settings = settings or BpnnSettings()
    size = settings.batch_size
    if len(joints) < 2 * size:
        raise InputError(
            f"{len(joints)} poses are too few to train a network in batches of {size}; measure at least {2 * size}"
        )
    input_mean, input_std = joints.mean(axis=0), column_std(joints, 1.0)
    output_mean, output_std = residuals.mean(axis=0), column_std(residuals, 1e-12)
    x = torch.as_tensor((joints - input_mean) / input_std, dtype=torch.get_default_dtype())
    y = torch.as_tensor((residuals - output_mean) / output_std, dtype=torch.get_default_dtype())
    with torch_on_one_thread(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**63)))
        model = _network(x.shape[1], y.shape[1], settings)
        loss = _train(model, x, y, rng, settings, progress)
    weights, biases = _folded(model)
    return Bpnn(input_mean, input_std, weights, biases, output_mean, output_std, loss)


def _network(inputs: int, outputs: int, settings: BpnnSettings):  # type: ignore[no-untyped-def]
    from torch import nn

    layers: list[nn.Module] = []
    for a, b in pairwise((inputs, *settings.hidden)):
        layers += [nn.Linear(a, b), nn.BatchNorm1d(b), nn.ReLU()]
        if settings.dropout:
            layers.append(nn.Dropout(settings.dropout))
    return nn.Sequential(*layers, nn.Linear(settings.hidden[-1], outputs))


def _train(model, x, y, rng, settings, progress) -> Array:  # type: ignore[no-untyped-def]
    """Run the training loop of eq (18) and return each epoch's loss.

    A short last batch is filled from the start of the epoch's shuffle.
    """
    import torch

    optimiser = torch.optim.Adam(
        model.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    steps = -(-len(x) // settings.batch_size)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.epochs)
    losses = np.zeros(settings.epochs)
    model.train()
    for epoch in range(settings.epochs):
        order = rng.permutation(len(x))
        order = torch.as_tensor(np.resize(order, steps * settings.batch_size)).reshape(steps, -1)
        total = torch.zeros(())
        for rows in order:
            optimiser.zero_grad(set_to_none=True)
            loss = torch.nn.functional.mse_loss(model(x[rows]), y[rows])
            loss.backward()
            optimiser.step()
            total += loss.detach()
        schedule.step()
        losses[epoch] = float(total) / steps
        if progress is not None:
            progress(epoch + 1, settings.epochs)
    return losses


def _folded(model) -> tuple[tuple[Array, ...], tuple[Array, ...]]:  # type: ignore[no-untyped-def]
    """Weights and biases with each batch normalisation folded into the linear layer before it."""
    from torch import nn

    weights, biases = [], []
    for layer in model.eval():
        if isinstance(layer, nn.Linear):
            weights.append(layer.weight.detach().double().numpy().copy())
            biases.append(layer.bias.detach().double().numpy().copy())
        elif isinstance(layer, nn.BatchNorm1d):
            mean, variance = layer.running_mean, layer.running_var
            assert mean is not None and variance is not None  # they are kept unless a layer is told not to
            gain = (layer.weight / (variance + layer.eps).sqrt()).detach().double().numpy()
            weights[-1] *= gain[:, None]
            biases[-1] = (biases[-1] - mean.double().numpy()) * gain + layer.bias.detach().double().numpy()
    return tuple(weights), tuple(biases)


# A network as machine code, in single precision: each pose by itself, in one fixed order of sums. Sixteen poses go
# through all layers together and stay in a core's first cache; a pose alone goes through with eight outputs at a time.
# A pose alone and one among thousands find the same bits.


POSES, TILE = 16, 8
"""Number of poses that go through the network together, and of outputs that are summed side by side."""

MANY, SIDE = f"<{POSES} x float>", f"<{TILE} x float>"
FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4, ctypes.c_int64)
ALONE = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)

Layer = tuple[Array, Array]
"""A layer's matrix ``(in, out)`` and bias ``(out,)``."""


class CompiledNetwork:
    """A network compiled to machine code; negative outputs of all layers but the last are cut off.

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
        from pickenv.arm.kinematics.machine_code import machine  # late: it needs llvmlite

        code = _code(calls, max(sizes) * POSES) + _code_alone(starts[:-1], shapes)
        self._engine, (network, alone) = machine(code, ("network", "alone"), True)
        self._run, self._run_alone = FUNCTION(network), ALONE(alone)
        self._there = self._numbers.__array_interface__["data"][0]

    def __reduce__(self) -> tuple[type[CompiledNetwork], tuple[Any]]:
        """Pickle and copy only the layers; the code is compiled anew."""
        return CompiledNetwork, (self._layers,)

    def __call__(self, rows: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Outputs ``(N, out)`` for inputs ``(N, in)``."""
        count, inputs = len(rows), rows.shape[1]
        if count == 1:
            given, found = np.array(rows, dtype=np.float32), np.empty((1, sum(self._sizes[1:])), dtype=np.float32)
            places = (array.__array_interface__["data"][0] for array in (given, found))
            self._run_alone(*places, self._there)
            return found[:, -self._sizes[-1] :][:, : self._outputs]
        width = max(-(-count // POSES), 1) * POSES
        table = np.empty((inputs + self._sizes[-1], width), dtype=np.float32)
        table[:inputs, :count], table[:inputs, count:] = rows.T, 0.0
        between = np.empty(2 * max(self._sizes) * POSES, dtype=np.float32)
        arrays = (table, self._numbers, table[inputs:], between)
        self._run(*(array.__array_interface__["data"][0] for array in arrays), width)
        return table[inputs : inputs + self._outputs, :count].T


def _arranged(layer: Layer, inputs: int, outputs: int) -> NDArray[np.float32]:
    """A layer's numbers in the order in which they are read: weights by tiles, then the bias."""
    matrix, bias = layer
    padded = np.zeros((inputs + 1, outputs), dtype=np.float32)
    padded[: len(matrix), : len(bias)], padded[-1, : len(bias)] = matrix, bias
    tiles = padded[:-1].reshape(inputs, -1, TILE).swapaxes(0, 1)
    return np.concatenate([tiles.ravel(), padded[-1]])


def _call(i: int, count: int, start: int, inputs: int, outputs: int) -> str:
    """Code that takes poses through layer ``i`` of ``count``, whose numbers begin at ``start``."""
    source, stride = ("%given_here", "%width") if i == 0 else (f"%values{i % 2}", str(POSES))
    into, into_stride = ("%found_here", "%width") if i + 1 == count else (f"%values{(i + 1) % 2}", str(POSES))
    least = "0xFFF0000000000000" if i + 1 == count else "0.0"
    return f"""
  %numbers{i} = getelementptr float, ptr %numbers, i64 {start}
  call void @layer(ptr {source}, i64 {stride}, ptr %numbers{i}, ptr {into}, i64 {into_stride}, i64 {inputs},
    i64 {outputs}, float {least})"""


def _code(calls: Sequence[str], half: int) -> str:
    """Code of the whole network; each buffer of ``half`` numbers holds the outputs of one layer."""
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


def _code_alone(starts: Sequence[int], shapes: Sequence[tuple[int, int]]) -> str:
    """Code that takes one pose through the network, and writes all layers' outputs one after the other."""
    parts, source, into = list[str](), "%given", 0
    for i, (start, (inputs, outputs)) in enumerate(zip(starts, shapes, strict=True)):
        least = "0xFFF0000000000000" if i + 1 == len(shapes) else "0.0"
        beside = next(count for count in (4, 2, 1) if outputs // TILE % count == 0)
        parts.append(_layer_alone(i, source, into, start, inputs, outputs, beside, least))
        source, into = f"%out{i}", into + outputs
    return f"""
define void @alone(ptr %given, ptr %found, ptr %numbers) {{
entry:
  br label %begin0{"".join(parts)}
begin{len(shapes)}:
  ret void
}}"""


def _layer_alone(i: int, source: str, into: int, start: int, inputs: int, outputs: int, beside: int, least: str) -> str:
    """Code of layer ``i`` for one pose, ``beside`` tiles at a time, so that none waits for another's sum."""
    sums, adds, ends = list[str](), list[str](), list[str]()
    for t in range(beside):
        name = f"{i}_{t}"
        sums.append(f"  %s{name} = phi {SIDE} [zeroinitializer, %tile{i}], [%n{name}, %sum{i}]")
        adds.append(f"""  %a{name} = add i64 %at{i}, {t * inputs * TILE}
  %q{name} = getelementptr float, ptr %numbers, i64 %a{name}
  %w{name} = load {SIDE}, ptr %q{name}, align 4
  %p{name} = fmul contract {SIDE} %w{name}, %x{i}
  %n{name} = fadd contract {SIDE} %s{name}, %p{name}""")
        ends.append(f"""  %o{name} = add i64 %tile_out{i}, {t * TILE}
  %c{name} = add i64 %o{name}, {start + inputs * outputs}
  %d{name} = getelementptr float, ptr %numbers, i64 %c{name}
  %b{name} = load {SIDE}, ptr %d{name}, align 4
  %r{name} = fadd {SIDE} %n{name}, %b{name}
  %above{name} = fcmp ogt {SIDE} %r{name}, %floor{i}
  %k{name} = select <{TILE} x i1> %above{name}, {SIDE} %r{name}, {SIDE} %floor{i}
  %e{name} = getelementptr float, ptr %out{i}, i64 %o{name}
  store {SIDE} %k{name}, ptr %e{name}, align 4""")
    lines = "\n".join
    return f"""
begin{i}:
  %out{i} = getelementptr float, ptr %found, i64 {into}
  %first{i} = insertelement {SIDE} poison, float {least}, i64 0
  %floor{i} = shufflevector {SIDE} %first{i}, {SIDE} poison, <{TILE} x i32> zeroinitializer
  br label %tile{i}
tile{i}:
  %tile_out{i} = phi i64 [0, %begin{i}], [%next_out{i}, %end{i}]
  %block{i} = mul i64 %tile_out{i}, {inputs}
  %from{i} = add i64 %block{i}, {start}
  br label %sum{i}
sum{i}:
  %in{i} = phi i64 [0, %tile{i}], [%next_in{i}, %sum{i}]
{lines(sums)}
  %within{i} = mul i64 %in{i}, {TILE}
  %at{i} = add i64 %from{i}, %within{i}
  %here{i} = getelementptr float, ptr {source}, i64 %in{i}
  %one{i} = load float, ptr %here{i}, align 4
  %lane{i} = insertelement {SIDE} poison, float %one{i}, i64 0
  %x{i} = shufflevector {SIDE} %lane{i}, {SIDE} poison, <{TILE} x i32> zeroinitializer
{lines(adds)}
  %next_in{i} = add i64 %in{i}, 1
  %more_in{i} = icmp ult i64 %next_in{i}, {inputs}
  br i1 %more_in{i}, label %sum{i}, label %end{i}
end{i}:
{lines(ends)}
  %next_out{i} = add i64 %tile_out{i}, {beside * TILE}
  %more_out{i} = icmp ult i64 %next_out{i}, {outputs}
  br i1 %more_out{i}, label %tile{i}, label %begin{i + 1}"""


def _layer() -> str:
    """Code of one layer for `POSES` poses at once, which sums `TILE` outputs side by side."""
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
    """Code that loads a number and repeats it for all poses."""
    return f"""  {name}p = getelementptr float, ptr {base}, i64 {offset}
  {name}l = load float, ptr {name}p, align 4
  {name}i = insertelement {MANY} poison, float {name}l, i64 0
  {name} = shufflevector {MANY} {name}i, {MANY} poison, <{POSES} x i32> zeroinitializer"""
