"""Figures for errors, against numbers worked by hand."""

import tomllib

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from pickenv.base import mean_interval, ordered_interval
from pickenv.calibration import error_statistics, held_out_r2, paper_eta

# Qiao 2026, Tables 1 and 2, as printed; nan: removed as redundant.
TABLES = tomllib.loads("""
[true]
alpha_deg = [90.011, 0.029, 90.040, -89.983, 90.023, -0.006]
a_mm      = [122.520, 138.380, 0.230, 0.780, 0.560, 0.450]
d_mm      = [0.500, 300.000, 100.600, 166.682, 103.620, 126.830]
theta_deg = [90.017, 0.029, 0.017, 90.046, 0.040, 0.034]
[identified_24]
alpha_deg = [90.011, 0.049, 89.010, -87.983, 90.023, -0.004]
a_mm      = [122.520, 138.464, 0.164, 0.464, 0.505, 0.505]
d_mm      = [0.300, 300.100, 100.407, 166.970, 103.470, 126.980]
theta_deg = [90.020, 0.025, 0.027, 90.036, 0.037, 0.037]
[identified_17]
alpha_deg = [90.032, 0.028, 90.024, -89.984, 90.020, -0.005]
a_mm      = [123.017, 139.269, nan, nan, 0.885, nan]
d_mm      = [0.308, 300.005, nan, nan, 103.721, nan]
theta_deg = [89.988, nan, 0.015, 90.049, 0.055, 0.031]
""")


def test_statistics_of_four_errors():
    errors = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0], [2.0, 1.0, 2.0], [0.0, 0.0, 0.0]])  # norms 5, 1, 3, 0
    found = error_statistics(errors)
    assert found.mean == pytest.approx(9 / 4)
    assert found.rms == pytest.approx(np.sqrt(35 / 4))
    assert found.std == pytest.approx(np.sqrt(35 / 4 - 81 / 16))
    assert found.max == 5.0
    assert found.p95 == pytest.approx(3 + 0.85 * 2)
    assert found.axis_rms == pytest.approx((np.sqrt(13 / 4), np.sqrt(17 / 4), np.sqrt(5 / 4)))
    assert found.count == 4
    assert set(found.as_dict()) == {"mean", "mean_ci95", "rms", "rms_ci95", "std", "p95", "max", "axis_rms", "count"}
    norms = error_statistics([5.0, 1.0, -3.0, 0.0])
    assert norms.axis_rms == () and (norms.mean, norms.rms) == (found.mean, found.rms)


@given(arrays(float, array_shapes(min_dims=1, max_dims=2, max_side=25), elements=st.floats(-1e6, 1e6)))
def test_the_rms_of_the_norm_is_never_below_the_mean(errors):
    """A "RMSE" below its mean (Tables 3 and 4) is some other figure."""
    found = error_statistics(errors)
    slack = 1e-9 * (1 + found.max)
    assert found.mean <= found.rms + slack <= found.max + 2 * slack
    assert found.rms**2 == pytest.approx(found.mean**2 + found.std**2, abs=slack * (1 + found.max))
    if found.axis_rms:
        assert found.rms == pytest.approx(np.linalg.norm(found.axis_rms), abs=slack)
    assert (found.mean_ci95 is None) or found.mean_ci95[0] <= found.mean <= found.mean_ci95[1]


@pytest.mark.parametrize("errors", [[], np.zeros((0, 3)), [1.0, np.nan], [[1.0, np.inf, 0.0]]])
def test_no_errors_and_no_numbers_are_refused(errors):
    with pytest.raises(ValueError, match="at least one error, all finite"):
        error_statistics(errors)


def test_few_errors_have_no_interval_and_equal_data_equal_ones():
    values = np.random.default_rng(1).gamma(4.0, 0.5, 100)
    assert error_statistics(values[:19]).mean_ci95 is None and error_statistics(np.ones(50)).mean_ci95 is None
    assert error_statistics(values).mean_ci95 == error_statistics(values.copy()).mean_ci95 == mean_interval(values)
    assert error_statistics(values[:20]).mean_ci95 is not None and error_statistics(values).rms_ci95 is None


def test_between_blocks_of_equal_size_the_interval_is_that_of_their_means():
    values = np.random.default_rng(1).gamma(4.0, 0.5, (12, 30))
    blocks = np.repeat(np.arange(12), 30)
    low, high = error_statistics(values.ravel(), blocks).mean_ci95
    assert (low, high) == pytest.approx(ordered_interval(values.mean(axis=1)))
    order = np.random.default_rng(2).permutation(360)
    assert error_statistics(values.ravel()[order], blocks[order]).mean_ci95 == pytest.approx((low, high))
    assert error_statistics(values[:9].ravel(), blocks[:270]).mean_ci95 is None
    squares = np.log(np.mean(values**2, axis=1))
    low, high = error_statistics(values.ravel(), blocks).rms_ci95
    assert low < np.sqrt(np.mean(values**2)) < high
    assert np.log(high / low) == pytest.approx(np.ptp(ordered_interval(squares)) / 2, rel=0.1)


@pytest.mark.parametrize(("apart", "bounded"), [(0.39, True), (0.41, False)])
def test_blocks_too_far_apart_bound_no_root_mean_square(apart, bounded):
    sizes = np.linspace(-1.0, 1.0, 10)
    norms = np.repeat(np.exp(sizes * apart / sizes.std(ddof=1)), 20)
    found = error_statistics(norms, np.repeat(np.arange(10), 20))
    assert (found.rms_ci95 is not None) == bounded and found.mean_ci95 is not None


def test_alike_errors_of_a_block_widen_the_interval():
    """Ten blocks of a hundred equal errors are ten values, not a thousand."""
    values = np.repeat(np.linspace(1.0, 2.0, 10), 100)
    low, high = error_statistics(values, np.repeat(np.arange(10), 100)).mean_ci95
    assert high - low > 5 * np.ptp(error_statistics(values).mean_ci95)


def column(name):
    return np.concatenate([TABLES[name][key] for key in ("alpha_deg", "a_mm", "d_mm", "theta_deg")])


def test_the_papers_eta_from_its_own_table():
    """89.65 and 86.4, where the paper prints 89.985 and 86.348."""
    assert paper_eta(column("identified_17"), column("true")) == pytest.approx(89.65, abs=0.01)
    assert paper_eta(column("identified_24"), column("true")) == pytest.approx(86.4, abs=0.05)


def test_eta_is_dominated_by_parameters_near_zero():
    true = np.array([90.0, 300.0, 0.006])
    assert paper_eta(true, true) == 100.0
    assert paper_eta(np.add(true, [0.009, 0.0, 0.0]), true) > 99.99
    assert paper_eta(np.add(true, [0.0, 0.0, 0.006]), true) == pytest.approx(100 * 2 / 3)
    assert paper_eta([1.0, 5.0, np.nan], [1.0, 0.0, 3.0]) == 100.0  # zero has no relative error, nan was not identified


def test_r2_per_axis():
    truth = np.array([[1.0, 0.0], [2.0, 2.0], [3.0, 4.0]])
    assert held_out_r2(truth, truth).tolist() == [1.0, 1.0]
    assert held_out_r2(truth, np.broadcast_to(truth.mean(axis=0), (3, 2))).tolist() == [0.0, 0.0]
    np.testing.assert_allclose(held_out_r2(truth, np.add(truth, [0.0, 1.0])), [1.0, 1 - 3 / 8])
    assert held_out_r2(truth, -truth)[0] < 0


def test_a_block_without_any_error_has_no_logarithm_and_so_the_rms_no_interval():
    values, blocks = 1.0 + np.random.default_rng(0).random(40), np.repeat(np.arange(10), 4)
    low, high = error_statistics(values, blocks).rms_ci95
    assert low < np.sqrt(np.mean(values**2)) < high
    values[4:8] = 0.0
    without = error_statistics(values, blocks)
    assert without.rms_ci95 is None and without.mean_ci95 is not None
