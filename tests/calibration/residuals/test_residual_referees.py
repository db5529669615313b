"""Residual models against other people's programs: torch, scikit-learn and formulas written out."""

import pickle
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch
from sklearn.cluster import KMeans

from pickenv.base import is_there
from pickenv.base.registry import get
from pickenv.calibration import Bpnn, BpnnSettings, fit_residual, train_bpnn
from pickenv.calibration.residuals import bpnn, gaussian_process
from pickenv.calibration.residuals.gaussian_process import (
    GaussianProcess,
    Rbf,
    column_std,
    k_means,
)
from pickenv.calibration.residuals.residual_models import joint_inputs

TINY = BpnnSettings(hidden=(12, 8), epochs=4, batch_size=8, dropout=0.25)


@pytest.fixture
def double_precision():
    """Torch in double precision: in single, Adam takes a gradient that is zero but for rounding for a direction."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(before)


def drawn(count=45, inputs=3, outputs=2, seed=0):
    """Inputs and smooth targets of other means and sizes, with noise."""
    rng = np.random.default_rng(seed)
    x = 2.0 + rng.normal(size=(count, inputs)) * [0.3, 1.0, 3.0][:inputs]
    y = np.stack([np.sin(x[:, 0]) + 0.1 * x[:, 1], 1e-3 * np.cos(x[:, -1])], -1)[:, :outputs]
    return x, y + rng.normal(size=y.shape) * [0.02, 2e-5][:outputs]


def referee_network(x, y, rng, settings):
    """The paper's training as torch has it: Adam with L2 along a cosine, mean square error, standardised."""
    (mx, sx), (my, sy) = ((part.mean(axis=0), part.std(axis=0)) for part in (x, y))
    a, b = torch.tensor((x - mx) / sx), torch.tensor((y - my) / sy)
    torch.manual_seed(int(rng.integers(2**63)))
    sizes = [x.shape[1], *settings.hidden]
    layers = []
    for i, o in pairwise(sizes):
        layers += [torch.nn.Linear(i, o), torch.nn.BatchNorm1d(o), torch.nn.ReLU()]
        layers += [torch.nn.Dropout(settings.dropout)] if settings.dropout else []
    model = torch.nn.Sequential(*layers, torch.nn.Linear(sizes[-1], y.shape[1]))
    adam = torch.optim.Adam(model.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
    losses = []
    for epoch in range(settings.epochs):
        for group in adam.param_groups:
            group["lr"] = settings.learning_rate * (1 + np.cos(np.pi * epoch / settings.epochs)) / 2
        order = rng.permutation(len(x))
        full = [*order, *order, *order][: -(-len(x) // settings.batch_size) * settings.batch_size]
        batches = [full[k : k + settings.batch_size] for k in range(0, len(full), settings.batch_size)]
        seen = []
        for rows in batches:
            adam.zero_grad()
            error = ((model(a[rows]) - b[rows]) ** 2).mean()
            error.backward()
            adam.step()
            seen.append(error.item())
        losses.append(np.mean(seen))
    model.eval()

    def predict(later):
        with torch.no_grad():
            return model(torch.tensor((later - mx) / sx)).numpy() * sy + my

    return predict, losses


@pytest.mark.parametrize(
    "settings",
    [TINY, replace(TINY, dropout=0.0, learning_rate=0.02, weight_decay=0.1), replace(TINY, batch_size=5, epochs=3)],
    ids=["dropout", "strong decay", "other batches"],
)
def test_the_network_is_trained_as_torch_trains_it(settings, double_precision):
    x, y = drawn()
    with torch.random.fork_rng():
        predict, losses = referee_network(x, y, np.random.default_rng(3), settings)
    ours = train_bpnn(x, y, np.random.default_rng(3), settings)
    np.testing.assert_allclose(ours.loss, losses, rtol=1e-10)
    later = drawn(20, seed=9)[0]
    np.testing.assert_allclose(ours.predict(later) / y.std(axis=0), predict(later) / y.std(axis=0), atol=1e-10)


def test_a_constant_joint_or_residual_keeps_its_place_in_the_network():
    x, y = drawn()
    x[:, 1], y[:, 1] = 4.0, 7e-4
    ours = train_bpnn(x, y, np.random.default_rng(3), TINY)
    np.testing.assert_array_equal(ours.input_std[1], 1.0)
    np.testing.assert_allclose(ours.predict(x)[:, 1], 7e-4, atol=1e-10)


def test_many_poses_go_through_in_blocks_and_come_out_the_same(monkeypatch):
    x, y = drawn()
    network = train_bpnn(x, y, np.random.default_rng(3), TINY)
    whole = network.predict(x)
    monkeypatch.setattr(bpnn, "ROWS", 7)
    np.testing.assert_allclose(network.predict(x), whole, rtol=1e-12)
    np.testing.assert_allclose(network.predict(x[4]), whole[4], rtol=1e-12)
    fast = replace(network, fast=True)
    assert fast.predict(x).dtype == float and fast.predict(x[0]).dtype == float
    if is_there("llvmlite"):  # then a pose has the same bits alone, among others and in a copy
        for count in (1, 3, 16, 17):
            np.testing.assert_array_equal(fast.predict(x[5 : 5 + count]), fast.predict(x)[5 : 5 + count])
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(fast)).predict(x[4]), fast.predict(x)[4])
        assert fast.predict(x[:0]).shape == (0, y.shape[1])
    again = Bpnn.from_arrays(network.arrays())
    np.testing.assert_array_equal(again.predict(x), network.predict(x))
    np.testing.assert_array_equal(again.loss, network.loss)


def generalised_cross_validation(phi, targets, ridge):
    """Golub, Heath and Wahba (1979), with the hat matrix written out: its score and the weights."""
    rows = len(phi)
    inverse = np.linalg.inv(phi.T @ phi + ridge * np.eye(phi.shape[1]))
    hat = phi @ inverse @ phi.T
    left = targets - hat @ targets
    return np.sum(left**2) / (1 - np.trace(hat) / rows) ** 2, inverse @ phi.T @ targets


@pytest.mark.parametrize("noise", [1e-3, 0.3])
def test_the_rbf_network_has_the_width_and_ridge_of_the_least_cross_validated_error(monkeypatch, noise):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(60, 2))
    y = np.stack([np.sin(2 * x[:, 0]), 1e-3 * x[:, 1] ** 2], -1) + noise * rng.normal(size=(60, 2)) * [1.0, 1e-3]
    widths, ridges = (0.25, 0.5, 1.0, 2.0), (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
    monkeypatch.setattr(gaussian_process, "CENTRES", 15)
    monkeypatch.setattr(gaussian_process, "RIDGES", ridges)
    found = Rbf.fit(x, y, np.random.default_rng(1))
    centres = k_means(x, 15, np.random.default_rng(1), 20)
    np.testing.assert_allclose(found.centres, centres)
    distances = np.linalg.norm(x[:, None] - centres, axis=2)
    unit = np.sqrt(np.median(distances**2))
    tried = []
    for width in unit * np.array(widths):
        phi = np.exp(-(distances**2) / (2 * width**2))
        largest = np.linalg.norm(phi, 2) ** 2
        for ridge in ridges:
            score, weights = generalised_cross_validation(phi, (y - y.mean(axis=0)) / y.std(axis=0), ridge * largest)
            tried.append((score, width, weights * y.std(axis=0)))
    _, width, weights = min(tried, key=lambda each: each[0])
    assert found.width == pytest.approx(width)
    later = rng.normal(size=(30, 2))
    gaussians = np.exp(-np.sum((later[:, None] - centres) ** 2, axis=2) / (2 * width**2))
    np.testing.assert_allclose(found.predict(later), gaussians @ weights + y.mean(axis=0), rtol=1e-4, atol=1e-6)


def test_the_rbf_network_takes_a_third_of_the_rows_and_200_at_most(monkeypatch):
    x, y = drawn(48)
    assert len(Rbf.fit(x, y, np.random.default_rng(0)).centres) == 16
    assert len(Rbf.fit(*drawn(10), np.random.default_rng(0)).centres) == 3
    monkeypatch.setattr(gaussian_process, "WIDTHS", (1.0,))
    monkeypatch.setattr(gaussian_process, "ROUNDS", 1)
    assert len(Rbf.fit(*drawn(660), np.random.default_rng(0)).centres) == 200
    monkeypatch.setattr(gaussian_process, "CENTRES", 9)
    assert len(Rbf.fit(x, y, np.random.default_rng(0)).centres) == 9


def test_the_defaults_of_the_rbf_network_span_what_their_docstring_says():
    """Weights shrink and widths grow within wide bounds: noise alone is all but ignored, clean data followed."""
    rng = np.random.default_rng(4)
    x = rng.normal(size=(90, 2))
    noise = Rbf.fit(x, rng.normal(size=(90, 1)), rng)
    assert np.std(noise.predict(x)) < 0.6
    clean = Rbf.fit(x, np.sin(x[:, :1]), rng)
    assert np.std(clean.predict(x) - np.sin(x[:, :1])) < 1e-2


@pytest.mark.parametrize("rounds", [1, 3, 20])
def test_k_means_is_lloyds(rounds):
    points = np.random.default_rng(0).normal(size=(200, 2)) + np.repeat([[0, 0], [4, 0]], 100, axis=0)
    ours = k_means(points, 6, np.random.default_rng(5), rounds)
    first = points[np.random.default_rng(5).choice(200, 6, replace=False)]
    theirs = KMeans(6, init=first, n_init=1, max_iter=rounds, tol=0.0, algorithm="lloyd").fit(points)
    np.testing.assert_allclose(ours, theirs.cluster_centers_, atol=1e-9)


def test_a_cluster_that_empties_keeps_its_centre():
    points = np.array([[0.0], [0.0], [0.0], [1.0]])
    centres = k_means(points, 4, np.random.default_rng(0), 5)
    assert np.isfinite(centres).all() and set(centres.ravel()) == {0.0, 1.0}


def test_distances_that_round_below_zero_are_none():
    one = Rbf(np.array([[1e8, 1e8 + 1]]), 1.0, np.array([[2.0]]), np.array([0.5]))
    assert one.predict([1e8, 1e8 + 1]) == pytest.approx(2.5)


@pytest.mark.parametrize("fitter", [partial(train_bpnn, settings=TINY), Rbf.fit, GaussianProcess.fit])
def test_no_rows_in_are_no_rows_out(fitter):
    x, y = drawn(40)
    assert fitter(x, y, np.random.default_rng(0)).predict(x[:0]).shape == (0, 2)


def test_a_column_is_constant_below_a_billionth_of_its_largest_value():
    values = np.array(
        [[1.0, 5.0, 0.0, 1e-5], [1.0 + 1e-6, 5.0 + 4e-9, 0.0, 1e-5 + 1e-10], [1.0 + 2e-6, 5.0, 0.0, 1e-5]]
    )
    np.testing.assert_allclose(column_std(values, 7.0), [values[:, 0].std(), 7.0, 7.0, values[:, 3].std()])
    edge = np.array([[1.0], [1.0 + 3e-9]])  # spread of 1.5 billionths
    assert column_std(edge, 7.0)[0] == pytest.approx(1.5e-9, rel=1e-3)
    assert column_std(np.array([[-1.0], [-1.0 - 1e-9]]), 7.0)[0] == 7.0


SPANS = {"below": (1.5 * np.pi - 1e-6, False), "at": (1.5 * np.pi, False), "above": (1.5 * np.pi + 1e-6, True)}


@pytest.mark.parametrize(("span", "periodic"), SPANS.values(), ids=SPANS)
def test_joints_that_span_more_than_270_degrees_enter_by_sine_and_cosine(span, periodic):
    joints = np.stack([np.linspace(0.0, span, 30), np.linspace(0.0, 9.0, 30)], -1)
    inputs = joint_inputs(joints, (False, True))
    np.testing.assert_array_equal(inputs.periodic, [periodic, False])
    raw = np.stack([joints[:, 1], *((np.sin(joints[:, 0]), np.cos(joints[:, 0])) if periodic else ())], -1)
    if not periodic:
        raw = joints
    load = np.linspace(1.0, 2.0, 30)[:, None]
    raw = np.hstack([raw, load])
    given = joint_inputs(joints, (False, True), load)
    np.testing.assert_allclose(given(joints, load), (raw - raw.mean(axis=0)) / raw.std(axis=0), atol=1e-12)
    assert given.conditions == 1 and inputs.conditions == 0
    np.testing.assert_allclose(given(joints[3], load[3]), given(joints, load)[3], atol=1e-12)
    never = joint_inputs(joints, (False, True), periodic_span=np.inf)
    assert not never.periodic.any()


def test_a_learnt_residual_fits_its_inputs_by_the_fitter_it_names(monkeypatch):
    x, y = drawn(30)
    seen = []

    def fitter(inputs, targets, rng):
        seen.append((inputs, targets, rng))
        return get("residual", "rbf").fit(inputs, targets, rng)

    rng = np.random.default_rng(0)
    fit_residual("gp", x, y, (True,) * 3, rng, fitter=fitter)
    ((inputs, targets, generator),) = seen
    np.testing.assert_allclose(inputs, (x - x.mean(axis=0)) / x.std(axis=0))
    assert targets is y and generator is rng


@pytest.mark.parametrize(
    ("rows", "epochs", "batch", "rate"),
    [(400, 500, 16, 1e-3), (401, 119, 32, 2e-3), (600, 80, 32, 2e-3), (2000, 24, 32, 2e-3), (4000, 24, 32, 2e-3)],
)
def test_with_more_than_400_poses_batches_double_and_epochs_fall(monkeypatch, rows, epochs, batch, rate):
    """48 000 poses seen in all; of more than 2000 it learns from 2000, taken evenly."""
    asked = []
    monkeypatch.setattr(bpnn, "train_bpnn", lambda *given: asked.append(given))
    x = np.arange(rows, dtype=float)[:, None] * np.ones(2)
    get("residual", "bpnn").fit(x, -x, np.random.default_rng(0))
    ((inputs, targets, _, settings),) = asked
    assert (settings.epochs, settings.batch_size, settings.learning_rate) == (epochs, batch, rate)
    assert settings.hidden == BpnnSettings().hidden and settings.weight_decay == BpnnSettings().weight_decay
    np.testing.assert_array_equal(targets, -inputs)
    chosen = inputs[:, 0]
    assert len(chosen) == min(rows, 2000) and chosen[0] == 0 and chosen[-1] == rows - 1
    assert (np.diff(chosen) >= 1).all()


def test_the_process_keeps_no_more_rows_than_allowed_and_predicts_in_chunks(monkeypatch):
    """Weights are the textbooks' on the rows that are kept: K^-1 y with the noise on the diagonal."""
    x, y = drawn(60)
    process = GaussianProcess.fit(x, y, np.random.default_rng(0), rows=40, likelihood_rows=30, starts=2)
    kept = np.sort(np.random.default_rng(0).permutation(60)[:40])
    np.testing.assert_array_equal(process.rows, x[kept])
    np.testing.assert_allclose(process.output_mean, y.mean(axis=0))
    np.testing.assert_allclose(process.output_std, y.std(axis=0))
    later = drawn(25, seed=2)[0]
    expected = np.empty((25, 2))
    for j in range(2):
        a, b = (part / process.length_scales[j] for part in (x[kept], later))
        kernel = [process.amplitude[j] ** 2 * np.exp(-((p[:, None] - a) ** 2).sum(-1) / 2) for p in (a, b)]
        weights = np.linalg.solve(
            kernel[0] + process.noise[j] ** 2 * np.eye(40), (y[kept, j] - y[:, j].mean()) / y[:, j].std()
        )
        expected[:, j] = kernel[1] @ weights * y[:, j].std() + y[:, j].mean()
    np.testing.assert_allclose(process.predict(later), expected, rtol=1e-5, atol=1e-8)
    monkeypatch.setattr(gaussian_process, "CHUNK", 7)
    np.testing.assert_allclose(process.predict(later), expected, rtol=1e-5, atol=1e-8)
    assert process.predict(later.reshape(5, 5, 3)).shape == (5, 5, 2)


def searches(monkeypatch, rows):
    """Each search of one output: its start, how many rows it sees, its precision; the fourth start is told the best."""
    told, seen = [], []

    def standing(start, inputs, target, precision):
        told.append((np.exp(start), len(inputs), precision))
        seen.append(inputs)
        assert len(inputs) == len(target)
        value = {3: -5.0, 7: -4.0}.get(len(told) - 1, 1.0) if precision == gaussian_process.COARSE else -len(told)
        return start, value

    monkeypatch.setattr(gaussian_process, "_search", standing)
    x = np.random.default_rng(0).normal(size=(rows, 2))
    process = GaussianProcess.fit(x, x[:, :1] ** 2, np.random.default_rng(0))
    chosen = np.sort(np.random.default_rng(0).permutation(rows)[:600])
    some = chosen[np.linspace(0, len(chosen) - 1, min(200, len(chosen))).astype(int)]
    np.testing.assert_array_equal(seen[0], x[some])
    np.testing.assert_array_equal(seen[-1], x[chosen])
    return told, process


def test_the_process_is_searched_from_ten_starts_on_200_rows_and_the_best_two_go_on_with_600(monkeypatch):
    """And one plain start with them, since some rows may show noise alone; what the last search says is taken."""
    told, process = searches(monkeypatch, 2003)
    assert len(process.rows) == 2000
    assert [rows for _, rows, _ in told] == [200] * 10 + [600] * 3
    assert [precision for _, _, precision in told] == [1e-5] * 10 + [1e-7] * 3
    np.testing.assert_allclose(told[0][0], [1.0, 1.0, 1.0, 0.5])
    np.testing.assert_allclose(told[1][0], [1.0, 2.0, 2.0, 0.05])
    drawn = np.array([start for start, _, _ in told[2:10]])
    np.testing.assert_allclose(drawn[:, 0], 1.0)
    assert ((drawn[:, 1:3] >= 0.7) & (drawn[:, 1:3] <= 5.0)).all() and len(np.unique(drawn[:, 1:3])) == 16
    assert ((drawn[:, 3] >= 0.1) & (drawn[:, 3] <= 0.7)).all() and drawn[:, 3].std() > 0.05
    np.testing.assert_allclose(told[12][0], [1.0, 1.0, 1.0, 0.5])
    for final, start in zip(told[10:12], (told[3], told[7]), strict=True):
        np.testing.assert_array_equal(final[0], start[0])
    assert (process.amplitude, process.noise) == (pytest.approx(1.0), pytest.approx(0.5))
    np.testing.assert_allclose(process.length_scales, [[1.0, 1.0]])


def test_where_every_start_sees_all_rows_the_best_two_alone_go_on(monkeypatch):
    told, process = searches(monkeypatch, 150)
    assert [rows for _, rows, _ in told] == [150] * 12 and len(process.rows) == 150
    np.testing.assert_allclose(process.length_scales[0], told[7][0][1:3])
    assert process.noise[0] == pytest.approx(told[7][0][3])


def test_a_search_stays_within_its_bounds_and_ends_by_its_precision(monkeypatch):
    import scipy.optimize

    asked = []

    def climb(function, start, args, bounds, factr, maxiter):
        asked.append((bounds, factr, maxiter))
        return start, 1.5, {}

    monkeypatch.setattr(scipy.optimize, "fmin_l_bfgs_b", climb)
    start = np.zeros(4)
    found, value = gaussian_process._search(start, np.zeros((5, 2)), np.zeros(5), 1e-5)
    ((bounds, factr, iterations),) = asked
    np.testing.assert_allclose(np.exp(bounds), [[0.03, 30.0], [0.1, 1e3], [0.1, 1e3], [1e-3, 2.0]])
    assert factr * np.finfo(float).eps == pytest.approx(1e-5) and iterations == 100
    assert found is start and value == 1.5
