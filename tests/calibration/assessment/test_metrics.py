"""Figures for errors, against numbers worked by hand."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from pickenv.base import mean_interval, ordered_interval
from pickenv.calibration import error_statistics, held_out_r2


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


@pytest.mark.parametrize("block", range(10))
def test_no_interval_of_a_mean_norm_begins_below_zero(block):
    """One block far off: the interval says that the mean may be anything from 0, and not that it may be negative."""
    norms = np.random.default_rng(3).gamma(4.0, 0.5, (10, 6))
    norms[block] *= 100.0
    low, high = error_statistics(norms.ravel(), np.repeat(np.arange(10), 6)).mean_ci95
    assert 0.0 <= low < norms.mean() < high and ordered_interval(norms.mean(axis=1))[0] < 0.0
