"""The paper's network (Qiao 2026, section 1.4): as printed, reproducible, and the same in NumPy as in torch."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
import torch

from pickenv.base import InputError, is_there
from pickenv.calibration import Bpnn, BpnnSettings, train_bpnn
from pickenv.calibration.residuals.bpnn import CompiledNetwork, _folded, _network

SHORT, BRIEF = BpnnSettings(epochs=40), BpnnSettings(epochs=6)


def smooth(count=64, seed=0):
    """Joints, and residuals that a network can learn."""
    q = np.random.default_rng(seed).uniform(-1, 1, (count, 6))
    return q, np.stack([np.sin(2 * q[:, i]) * np.cos(q[:, (i + 1) % 6]) for i in range(6)], -1) * 1e-3


def trained(seed=0, settings=SHORT, **more):
    return train_bpnn(*smooth(), np.random.default_rng(seed), settings, **more)


def same(one, other):
    mine, theirs = one.arrays(), other.arrays()
    return mine.keys() == theirs.keys() and all(np.array_equal(mine[key], theirs[key]) for key in mine)


def test_the_settings_are_the_papers():
    settings = BpnnSettings()
    assert settings.hidden == (256, 128, 64, 32)
    assert (settings.epochs, settings.batch_size) == (500, 16)
    assert (settings.learning_rate, settings.weight_decay) == (1e-3, 1e-5)


def test_the_layers_are_the_papers():
    layers = list(_network(6, 6, BpnnSettings()))
    kinds = [type(layer).__name__ for layer in layers]
    assert kinds == ["Linear", "BatchNorm1d", "ReLU", "Dropout"] * 4 + ["Linear"]
    sizes = [(layer.in_features, layer.out_features) for layer in layers if isinstance(layer, torch.nn.Linear)]
    assert sizes == [(6, 256), (256, 128), (128, 64), (64, 32), (32, 6)]
    network = trained(settings=BpnnSettings(epochs=1))
    assert [weight.shape for weight in network.weights] == [(256, 6), (128, 256), (64, 128), (32, 64), (6, 32)]
    assert [bias.shape for bias in network.biases] == [(256,), (128,), (64,), (32,), (6,)]


def test_the_folded_network_is_the_evaluated_one():
    torch.manual_seed(0)
    model = _network(6, 6, BpnnSettings()).double()
    for _ in range(20):  # moves the running means and variances away from 0 and 1
        model(3.0 + 2.0 * torch.randn(32, 6, dtype=torch.float64))
    x = torch.randn(50, 6, dtype=torch.float64)
    weights, biases = _folded(model)
    rng = np.random.default_rng(0)
    scales = {name: rng.uniform(0.5, 2.0, 6) for name in ("input_mean", "input_std", "output_mean", "output_std")}
    network = Bpnn(weights=weights, biases=biases, loss=np.zeros(1), **scales)
    with torch.no_grad():
        expected = model.eval()(x).numpy() * scales["output_std"] + scales["output_mean"]
    joints = x.numpy() * scales["input_std"] + scales["input_mean"]
    np.testing.assert_allclose(network.predict(joints), expected, atol=1e-12)


def test_equal_generators_give_equal_networks_to_the_bit():
    assert same(trained(3, BRIEF), trained(3, BRIEF))
    assert not same(trained(3, BRIEF), trained(4, BRIEF))


def test_torchs_own_state_plays_no_part_and_is_left_alone():
    torch.manual_seed(1)
    before, threads = torch.get_rng_state(), torch.get_num_threads()
    one = trained(3, BRIEF)
    assert torch.equal(torch.get_rng_state(), before) and torch.get_num_threads() == threads
    torch.manual_seed(2)
    assert same(one, trained(3, BRIEF))


@pytest.mark.slow
def test_the_loss_falls_and_the_residual_is_learnt():
    network = trained(settings=BpnnSettings(epochs=200))
    assert len(network.loss) == 200
    assert network.loss[0] > 0.7  # in units of the residual's variance
    assert network.loss[-5:].mean() < 0.2
    q, residual = smooth()
    assert np.mean((network.predict(q) - residual) ** 2) < 0.1 * residual.var()


def test_predictions_keep_leading_dimensions():
    network, q = trained(settings=BRIEF), smooth()[0]
    batch = network.predict(q.reshape(4, 16, 6))
    assert batch.shape == (4, 16, 6)
    np.testing.assert_allclose(batch[2, 3], network.predict(q[35]), atol=1e-15)


def test_a_joint_that_never_moved_and_an_axis_without_residual_are_no_obstacle():
    q, residual = smooth()
    q[:, 2], residual[:, 4] = 0.3, 0.0
    network = train_bpnn(q, residual, np.random.default_rng(0), BRIEF)
    assert np.isfinite(network.predict(q)).all()
    np.testing.assert_allclose(network.predict(q)[:, 4], 0.0, atol=1.0)


def test_progress_counts_epochs():
    seen = []
    trained(settings=BRIEF, progress=lambda done, of: seen.append((done, of)))
    assert seen == [(i, 6) for i in range(1, 7)]


@pytest.mark.parametrize("count", [0, 1, 31])
def test_fewer_than_two_batches_are_refused(count):
    q, residual = smooth(64)
    with pytest.raises(InputError, match=rf"{count} poses are too few .* at least 32"):
        train_bpnn(q[:count], residual[:count], np.random.default_rng(0), SHORT)


@pytest.mark.parametrize("count", [32, 33, 47])
def test_a_last_batch_that_is_short_is_filled(count):
    q, residual = smooth(64)
    settings = BpnnSettings(epochs=2)
    assert np.isfinite(train_bpnn(q[:count], residual[:count], np.random.default_rng(0), settings).loss).all()


# As machine code: what NumPy makes of them, to single precision, and the same bits in any company.

COMPILED = pytest.mark.skipif(not is_there("llvmlite"), reason="llvmlite is not installed")
SHAPES = [(6, 40, 24, 10, 6), (3, 7, 5, 2), (4, 9, 3), (5, 2), (6, 64, 64, 64, 64, 1)]


def drawn_layers(sizes, seed=0):
    """Layers, and inputs that they are used for."""
    rng = np.random.default_rng(seed)
    layers = [(rng.normal(size=(a, b)) / np.sqrt(a), 0.3 * rng.normal(size=b)) for a, b in pairwise(sizes)]
    return layers, rng.uniform(-2, 2, (800, sizes[0]))


def through(layers, values):
    """What the layers make of inputs, written down plainly."""
    for weights, bias in layers[:-1]:
        values = np.maximum(values @ weights + bias, 0.0)
    return values @ layers[-1][0] + layers[-1][1]


@COMPILED
@pytest.mark.parametrize("sizes", SHAPES)
def test_the_code_does_what_is_written_down_plainly(sizes):
    layers, inputs = drawn_layers(sizes)
    np.testing.assert_allclose(CompiledNetwork(layers)(inputs), through(layers, inputs), rtol=0, atol=5e-6)


@COMPILED
def test_a_pose_has_the_same_bits_alone_among_others_and_in_a_copy():
    layers, inputs = drawn_layers((6, 256, 128, 64, 32, 6))
    network = CompiledNetwork(layers)
    together = network(inputs)
    for count in (0, 1, 3, 31, 32, 33):
        np.testing.assert_array_equal(network(inputs[5 : 5 + count]), together[5 : 5 + count])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(network))(inputs), together)


@COMPILED
def test_a_pose_at_which_no_neuron_fires_gets_the_biases():
    layers, inputs = drawn_layers((2, 8, 8, 3))
    layers[0] = layers[0][0], np.full(8, -100.0)
    layers[1] = layers[1][0], np.full(8, -1.0)
    expected = np.tile(layers[2][1], (len(inputs), 1))
    np.testing.assert_allclose(CompiledNetwork(layers)(inputs), expected, rtol=1e-6)
