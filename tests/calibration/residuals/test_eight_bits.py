"""Networks with inner layers in eight bits: whole numbers, nearly the same outputs, the same bits everywhere."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("llvmlite")

from pickenv.calibration.residuals import network_code
from pickenv.calibration.residuals.network_code import MOST, CompiledNetwork, Layer, rounded_layers

SHAPES = [(6, 40, 24, 10, 6), (3, 7, 5, 2), (4, 9, 3), (5, 2), (6, 64, 64, 64, 64, 1)]


def drawn(sizes, seed=0):
    """Layers, and inputs that they are used for."""
    rng = np.random.default_rng(seed)
    layers = [Layer(rng.normal(size=(a, b)) / np.sqrt(a), 0.3 * rng.normal(size=b)) for a, b in pairwise(sizes)]
    return layers, rng.uniform(-2, 2, (800, sizes[0]))


def through(layers, values, steps=None):
    """What the layers make of inputs, written down plainly; with ``steps`` as the machine does it."""
    for i, (weights, bias, scale) in enumerate(layers):
        if scale is not None:
            step = np.maximum(values.max(axis=1, keepdims=True), 1e-30) / (steps or 255)
            values = np.round(values / step) if steps else values / step
            values = values @ weights * (step * scale) + bias
        else:
            values = values @ weights + bias
        values = values if i + 1 == len(layers) else np.maximum(values, 0.0)
    return values


@pytest.mark.parametrize("sizes", SHAPES)
def test_only_inner_layers_are_rounded_and_to_whole_numbers(sizes):
    layers, sample = drawn(sizes)
    found = rounded_layers(layers, sample)
    assert len(found) == len(layers) and found[0] is layers[0] and found[-1] is layers[-1]
    for layer, before in zip(found[1:-1], layers[1:-1], strict=True):
        assert np.array_equal(layer.weights, np.round(layer.weights)) and np.abs(layer.weights).max() == MOST
        assert np.abs(layer.weights * layer.scale - before.weights).max() < 4 * layer.scale.max()


def test_weights_rounded_one_after_the_other_leave_less_than_each_for_itself():
    layers, inputs = drawn((6, 128, 64, 6))
    exact = through(layers, inputs)
    plain = list(layers)
    for i in (1, 2):
        scale = np.abs(layers[i].weights).max(axis=0) / MOST
        plain[i] = Layer(np.round(layers[i].weights / scale), layers[i].bias, scale)
    others = drawn((6, 1), seed=1)[1]
    errors = [
        np.abs(through(found, others) - through(layers, others)).mean() / exact.std()
        for found in (rounded_layers(layers, inputs), plain)
    ]
    assert errors[0] < 0.6 * errors[1]


@pytest.mark.parametrize("sizes", SHAPES)
def test_the_code_does_what_is_written_down_plainly(sizes):
    layers, inputs = drawn(sizes)
    expected = through(rounded_layers(layers, inputs), inputs, 255)
    found = CompiledNetwork(rounded_layers(layers, inputs))(inputs)
    apart = np.abs(found - expected).max(axis=1)
    assert np.median(apart) < 3e-6 and apart.max() < 3e-2  # a rounding to the other side is a step
    exact = through(layers, inputs)
    assert np.abs(found - exact).mean() < 0.02 * exact.std()


def test_processors_that_cannot_multiply_bytes_find_the_same_bits(monkeypatch):
    layers, inputs = drawn((6, 256, 128, 64, 32, 6))
    found = []
    for able in dict.fromkeys((network_code.adds_products_of_bytes(), False)):
        monkeypatch.setattr(network_code, "adds_products_of_bytes", lambda able=able: able)
        found.append(CompiledNetwork(rounded_layers(layers, inputs))(inputs))
    np.testing.assert_array_equal(found[0], found[-1])


def test_a_pose_at_which_no_neuron_fires_gets_the_biases():
    layers, inputs = drawn((2, 8, 8, 3))
    layers[0] = Layer(layers[0].weights, np.full(8, -100.0))
    layers[1] = Layer(layers[1].weights, np.full(8, -1.0))
    found = CompiledNetwork(rounded_layers(layers, inputs))(inputs)
    np.testing.assert_allclose(found, np.tile(layers[2].bias, (len(inputs), 1)), rtol=1e-6)
