"""The back-propagation network of Qiao 2026 for errors that geometry does not explain (section 1.4, eqs (17)-(18)).

Its layers are 6-256-128-64-32-6, with batch normalisation, ReLU and dropout after every hidden layer. Training is by
mean square error, Adam 1e-3, L2 1e-5, 500 epochs and batches of 16, with torch. Prediction is a NumPy forward pass,
with batch normalisation folded into the layers.
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
        hidden: Number of neurons of each hidden layer.
        epochs: Passes over the training data.
        batch_size: Poses per step.
        learning_rate: Adam's first learning rate. It falls along a cosine to zero; the paper gives no schedule.
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
"""Matrix ``(in, out)`` of each layer, and a vector: for the last layer its bias, for the others the lower limit of the
matrix product."""

SCALES = ("input_mean", "input_std", "output_mean", "output_std", "loss")
"""Names of a network's arrays other than its layers."""

ROWS = 512
"""Number of poses that go through the network together; they fit into a core's second-level cache."""

SLOW_ROWS = 2000
"""Largest number of training rows; more would take too long."""


def _through(layers: Layers, values: NDArray[Any]) -> NDArray[Any]:
    """Compute the outputs ``(..., out)`` of a network with ReLU between its layers for inputs ``(..., in)``."""
    for weight, threshold in layers[:-1]:
        values = values @ weight
        np.maximum(values, threshold, out=values)
    weight, bias = layers[-1]
    return np.asarray(values @ weight + bias)


@register("residual", "bpnn")
@dataclass(frozen=True, eq=False)
class Bpnn:
    """A trained network in plain arrays, which maps joints to the pose residual (measured minus identified pose).

    Attributes:
        input_mean: Mean of the training joints ``(n,)``, rad or m.
        input_std: Standard deviation of the training joints ``(n,)``, rad or m.
        weights: Matrices of the layers, ``(out, in)``, with batch normalisation folded in.
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
        """Train the paper's network, with the paper's settings for up to 400 poses.

        With more poses, larger batches and fewer epochs give the same accuracy. At most `SLOW_ROWS` rows are used, to
        limit the time.

        Args:
            inputs: Training inputs ``(N, F)``.
            targets: Residuals ``(N, k)``, m and rad.
            rng: Seeds weights, dropout and shuffling.
        """
        rows = equally_spaced(len(inputs), SLOW_ROWS)
        settings = BpnnSettings()
        if len(rows) > 400:
            settings = BpnnSettings(epochs=48_000 // len(rows), batch_size=32, learning_rate=2e-3)
        return train_bpnn(inputs[rows], targets[rows], rng, settings)

    def faster(self) -> Bpnn:
        """Return a copy of the network for control loops, with ``fast`` set."""
        return replace(self, fast=True)

    def predict(self, joints: ArrayLike) -> Array:
        """Predict the residual pose error ``(..., 6)`` (m and rad, world axes) at joints ``(..., n)``.

        Many poses go through the network in blocks of `ROWS`. Machine code gives a pose bitwise the same result alone
        and among other poses.
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
        """The precision of predictions: single if ``fast`` is set, else double."""
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
        weights, biases = map(list, zip(*self._scaled, strict=True))
        for i in range(1, len(weights)):
            biases[i] = biases[i] + biases[i - 1] @ weights[i]
        layers = zip(weights, [*(-bias for bias in biases[:-1]), biases[-1]], strict=True)
        return [(weight.astype(self._dtype, order="C"), limit.astype(self._dtype)) for weight, limit in layers]

    @cached_property
    def _code(self) -> CompiledNetwork | None:
        """The network's machine code; None unless ``fast`` is set and llvmlite is installed."""
        return CompiledNetwork(self._scaled) if self.fast and is_there("llvmlite") else None

    def arrays(self) -> dict[str, Array]:
        """Return all arrays by name, for saving."""
        arrays = {name: getattr(self, name) for name in SCALES}
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays |= {f"weight{i}": weight, f"bias{i}": bias}
        return arrays

    @staticmethod
    def from_arrays(named: Mapping[str, NDArray[Any]]) -> Bpnn:
        """Rebuild the network from the arrays that `arrays` returns."""
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
        residuals: Measured minus identified pose ``(N, 6)``, m and rad (Qiao 2026 eq (17)).
        rng: Seeds weights, dropout and shuffling. Equal generators give equal networks on one machine. With
            ``MKL_CBWR=COMPATIBLE`` in the environment, networks are also equal between AVX2 and AVX-512.
        settings: Training settings; the defaults of `BpnnSettings` if left out.
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
    """Return the untrained torch network for these numbers of inputs and outputs."""
    from torch import nn

    layers: list[nn.Module] = []
    dropout = [nn.Dropout(settings.dropout)] if settings.dropout else []
    for a, b in pairwise((inputs, *settings.hidden)):
        layers += [nn.Linear(a, b), nn.BatchNorm1d(b), nn.ReLU(), *dropout]
    return nn.Sequential(*layers, nn.Linear(settings.hidden[-1], outputs))


def _train(model, x, y, rng, settings, progress) -> Array:  # type: ignore[no-untyped-def]
    """Run the training loop of Qiao 2026 eq (18) and return each epoch's loss.

    A short last batch is filled from the start of the epoch's shuffle.

    Args:
        model: The torch network; its weights are trained in place.
        x: Tensor of standardised inputs ``(N, n)``.
        y: Tensor of standardised targets ``(N, k)``.
        rng: Shuffles the rows of each epoch.
        settings: Training settings.
        progress: See `train_bpnn`.
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
        total = torch.zeros(())
        for rows in torch.as_tensor(np.resize(rng.permutation(len(x)), (steps, settings.batch_size))):
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
    """Return weights ``(out, in)`` and biases of the torch network's linear layers.

    Each batch normalisation is folded into the linear layer that precedes it.
    """
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
# through all layers together and stay in a core's first cache; a pose alone goes through with 32 outputs at a time. A
# pose alone and one among thousands find the same bits.


POSES, TILE = 16, 32
"""Number of poses that go through the network together, and number of outputs whose weights are adjacent in memory."""

SUMS = 8
"""Number of outputs of sixteen poses that are summed in parallel, so that no sum waits for another."""

CUT, UNCUT = "0.0", "0xFFF0000000000000"
"""Lower limit of a layer's outputs, in LLVM's language: zero, or for the last layer minus infinity."""

FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4, ctypes.c_int64)

Layer = tuple[Array, Array]
"""A layer's matrix ``(in, out)`` and bias ``(out,)``."""


class CompiledNetwork:
    """A network compiled to machine code, with ReLU after all layers but the last.

    Args:
        layers: Matrix ``(in, out)`` and bias ``(out,)`` of each layer.
    """

    def __init__(self, layers: Sequence[Layer]) -> None:
        from pickenv.arm.kinematics.machine_code import machine  # late: it needs llvmlite

        self._layers = layers
        self._outputs = len(layers[-1][1])
        sizes = [len(layers[0][0]), *(-(-len(bias) // TILE) * TILE for _, bias in layers)]
        shapes = list(pairwise(sizes))
        parts = [_arranged(layer, *shape) for layer, shape in zip(layers, shapes, strict=True)]
        starts = np.cumsum([0, *map(len, parts)]).tolist()
        self._numbers, self._sizes = np.concatenate(parts), sizes
        code = "".join(_layer(poses) + _network_code(poses, starts, shapes) for poses in (1, POSES))
        self._engine, addresses = machine(code, ("network1", f"network{POSES}"), True)
        self._alone, self._together = map(FUNCTION, addresses)
        self._there = self._numbers.__array_interface__["data"][0]

    def __reduce__(self) -> tuple[type[CompiledNetwork], tuple[Any]]:
        """Pickle and copy only the layers; the code is compiled again when the copy is made."""
        return CompiledNetwork, (self._layers,)

    def __call__(self, rows: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return outputs ``(N, out)`` for inputs ``(N, in)``."""
        count, inputs = rows.shape
        run, poses = (self._alone, 1) if count == 1 else (self._together, POSES)
        width = max(-(-count // poses), 1) * poses
        table = np.zeros((inputs + self._sizes[-1], width), dtype=np.float32)
        table[:inputs, :count] = rows.T
        between = np.empty(2 * max(self._sizes) * poses, dtype=np.float32)
        given, buffers = (array.__array_interface__["data"][0] for array in (table, between))
        run(given, self._there, given + inputs * width * table.itemsize, buffers, width)
        return table[inputs : inputs + self._outputs, :count].T


def _arranged(layer: Layer, inputs: int, outputs: int) -> NDArray[np.float32]:
    """Return a layer's numbers in the order in which the code reads them: weights by tiles, then the bias.

    The layer is padded with zeros to ``inputs`` inputs and ``outputs`` outputs; a tile has `TILE` outputs.
    """
    matrix, bias = layer
    padded = np.zeros((inputs + 1, outputs), dtype=np.float32)
    padded[: len(matrix), : len(bias)], padded[-1, : len(bias)] = matrix, bias
    tiles = padded[:-1].reshape(inputs, -1, TILE).swapaxes(0, 1)
    return np.concatenate([tiles.ravel(), padded[-1]])


def _network_code(poses: int, starts: Sequence[int], shapes: Sequence[tuple[int, int]]) -> str:
    """Return LLVM code that takes several poses at a time through all layers; two buffers hold outputs alternately.

    Args:
        poses: Number of poses at a time.
        starts: Index, from 0, of each layer's first number.
        shapes: Padded numbers of inputs and outputs of each layer.
    """
    half, last, calls = max(max(shape) for shape in shapes) * poses, len(shapes) - 1, list[str]()
    for i, (start, (inputs, outputs)) in enumerate(zip(starts, shapes, strict=False)):
        source, stride = ("%given_here", "%width") if i == 0 else (f"%values{i % 2}", str(poses))
        into, into_stride = ("%found_here", "%width") if i == last else (f"%values{(i + 1) % 2}", str(poses))
        calls.append(f"""
  %numbers{i} = getelementptr float, ptr %numbers, i64 {start}
  call void @layer{poses}(ptr {source}, i64 {stride}, ptr %numbers{i}, ptr {into}, i64 {into_stride}, i64 {inputs},
    i64 {outputs}, float {UNCUT if i == last else CUT})""")
    return f"""
define void @network{poses}(ptr %given, ptr %numbers, ptr %found, ptr %values0, i64 %width) {{
entry:
  %values1 = getelementptr float, ptr %values0, i64 {half}
  br label %head
head:
  %at = phi i64 [0, %entry], [%next, %head]
  %given_here = getelementptr float, ptr %given, i64 %at
  %found_here = getelementptr float, ptr %found, i64 %at{"".join(calls)}
  %next = add i64 %at, {poses}
  %more = icmp ult i64 %next, %width
  br i1 %more, label %head, label %done
done:
  ret void
}}"""


def _layer(poses: int) -> str:
    """Return LLVM code of one layer for ``poses`` poses at a time.

    The code's vectors run over outputs for a single pose, and over poses for several.
    """
    alone = poses == 1
    lanes, sums = (TILE, 1) if alone else (poses, SUMS)
    of_outputs, of_poses = (_row, _repeated) if alone else (_repeated, _row)
    vector, starts, adds, ends = f"<{lanes} x float>", list[str](), list[str](), list[str]()
    for t in range(sums):
        starts.append(f"  %s{t} = phi {vector} [zeroinitializer, %tile], [%n{t}, %sum]")
        adds.append(f"""{of_outputs(f"%w{t}", "%weight", str(t), lanes)}
  %p{t} = fmul contract {vector} %w{t}, %x
  %n{t} = fadd contract {vector} %s{t}, %p{t}""")
        ends.append(f"""  %o{t} = add i64 %out, {t}
{of_outputs(f"%bias{t}", "%biases", f"%o{t}", lanes)}
  %sum{t} = fadd {vector} %n{t}, %bias{t}
  %above{t} = fcmp ogt {vector} %sum{t}, %floor
  %kept{t} = select <{lanes} x i1> %above{t}, {vector} %sum{t}, {vector} %floor
  %to{t} = mul i64 %o{t}, %into_stride
  %place{t} = getelementptr float, ptr %into, i64 %to{t}
  store {vector} %kept{t}, ptr %place{t}, align 4""")
    lines = "\n".join
    return f"""
define internal void @layer{poses}(ptr %given, i64 %stride, ptr %weights, ptr %into, i64 %into_stride, i64 %inputs,
                            i64 %outputs, float %least) {{
entry:
  %size = mul i64 %inputs, %outputs
  %biases = getelementptr float, ptr %weights, i64 %size
  %first = insertelement {vector} poison, float %least, i64 0
  %floor = shufflevector {vector} %first, {vector} poison, <{lanes} x i32> zeroinitializer
  br label %tile
tile:
  %out = phi i64 [0, %entry], [%next_out, %end]
  %lane = and i64 %out, {TILE - 1}
  %before = sub i64 %out, %lane
  %tiles = mul i64 %before, %inputs
  %begin = add i64 %tiles, %lane
  %block = getelementptr float, ptr %weights, i64 %begin
  br label %sum
sum:
  %in = phi i64 [0, %tile], [%next_in, %sum]
{lines(starts)}
  %along = mul i64 %in, %stride
  %within = mul i64 %in, {TILE}
  %weight = getelementptr float, ptr %block, i64 %within
{of_poses("%x", "%given", "%along", lanes)}
{lines(adds)}
  %next_in = add i64 %in, 1
  %more_in = icmp ult i64 %next_in, %inputs
  br i1 %more_in, label %sum, label %end
end:
{lines(ends)}
  %next_out = add i64 %out, {TILE if alone else sums}
  %more_out = icmp ult i64 %next_out, %outputs
  br i1 %more_out, label %tile, label %done
done:
  ret void
}}"""


def _row(name: str, base: str, offset: str, lanes: int) -> str:
    """Return LLVM code that loads ``lanes`` adjacent numbers, from ``base`` + ``offset``, into variable ``name``."""
    return f"""  {name}p = getelementptr float, ptr {base}, i64 {offset}
  {name} = load <{lanes} x float>, ptr {name}p, align 4"""


def _repeated(name: str, base: str, offset: str, lanes: int) -> str:
    """Return LLVM code that loads the number at ``base`` + ``offset`` into all ``lanes`` lanes of variable ``name``."""
    vector = f"<{lanes} x float>"
    return f"""  {name}p = getelementptr float, ptr {base}, i64 {offset}
  {name}l = load float, ptr {name}p, align 4
  {name}i = insertelement {vector} poison, float {name}l, i64 0
  {name} = shufflevector {vector} {name}i, {vector} poison, <{lanes} x i32> zeroinitializer"""
