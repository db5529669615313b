"""Networks as machine code: what NumPy makes of them, to single precision, and the same bits in any company."""

import pickle
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("llvmlite")

from pickenv.calibration.residuals.bpnn import CompiledNetwork

SHAPES = [(6, 40, 24, 10, 6), (3, 7, 5, 2), (4, 9, 3), (5, 2), (6, 64, 64, 64, 64, 1)]


def drawn(sizes, seed=0):
    """Layers, and inputs that they are used for."""
    rng = np.random.default_rng(seed)
    layers = [(rng.normal(size=(a, b)) / np.sqrt(a), 0.3 * rng.normal(size=b)) for a, b in pairwise(sizes)]
    return layers, rng.uniform(-2, 2, (800, sizes[0]))


def through(layers, values):
    """What the layers make of inputs, written down plainly."""
    for weights, bias in layers[:-1]:
        values = np.maximum(values @ weights + bias, 0.0)
    return values @ layers[-1][0] + layers[-1][1]


@pytest.mark.parametrize("sizes", SHAPES)
def test_the_code_does_what_is_written_down_plainly(sizes):
    layers, inputs = drawn(sizes)
    np.testing.assert_allclose(CompiledNetwork(layers)(inputs), through(layers, inputs), rtol=0, atol=5e-6)


def test_a_pose_has_the_same_bits_alone_among_others_and_in_a_copy():
    layers, inputs = drawn((6, 256, 128, 64, 32, 6))
    network = CompiledNetwork(layers)
    together = network(inputs)
    for count in (0, 1, 3, 31, 32, 33):
        np.testing.assert_array_equal(network(inputs[5 : 5 + count]), together[5 : 5 + count])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(network))(inputs), together)


def test_a_pose_at_which_no_neuron_fires_gets_the_biases():
    layers, inputs = drawn((2, 8, 8, 3))
    layers[0] = layers[0][0], np.full(8, -100.0)
    layers[1] = layers[1][0], np.full(8, -1.0)
    expected = np.tile(layers[2][1], (len(inputs), 1))
    np.testing.assert_allclose(CompiledNetwork(layers)(inputs), expected, rtol=1e-6)
