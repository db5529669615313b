"""Intervals against other programs and their own definitions; how often they hold is in tests/coverage."""

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from pickenv.base import (
    LEAST,
    LEAST_RUNS,
    clustered_share_interval,
    crossed_interval,
    intervals,
    mean_interval,
    norm_interval,
    quantile_interval,
    quantile_levels,
    share_interval,
    statistic_interval,
)

VALUES = arrays(float, st.integers(LEAST, 40), elements=st.floats(-100, 100)).filter(lambda x: np.ptp(x) > 1e-3)


def test_without_skewness_it_is_students() -> None:
    x = np.concatenate([np.arange(1.0, 9.0), -np.arange(1.0, 9.0)]) + 5.0
    t = stats.t.interval(0.95, len(x) - 1, x.mean(), x.std(ddof=1) / np.sqrt(len(x)))
    assert mean_interval(x) == pytest.approx(t, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_halls_transformation_has_students_quantiles_at_the_ends(seed: int) -> None:
    x = np.random.default_rng(seed).gamma(1.5, size=25)
    n, mean, deviation = len(x), x.mean(), x.std(ddof=1)
    g = np.mean((x - mean) ** 3) / deviation**3
    for end, tail in zip(mean_interval(x), (0.975, 0.025), strict=True):
        s = (mean - end) / deviation
        transformed = np.sqrt(n) * (s + g * s**2 / 3 + g**2 * s**3 / 27 + g / (6 * n))
        assert transformed == pytest.approx(stats.t.ppf(tail, n - 1), rel=1e-9)


@given(VALUES, st.floats(-50, 50), st.floats(0.1, 10))
def test_moves_and_grows_with_the_values(x: np.ndarray, shift: float, scale: float) -> None:
    low, high = mean_interval(x)
    moved = mean_interval(shift + scale * x)
    assert moved == pytest.approx((shift + scale * low, shift + scale * high), abs=1e-6)
    mirrored = mean_interval(-x)
    assert mirrored == pytest.approx((-high, -low), abs=1e-6)
    assert low < x.mean() < high


def test_a_skewed_interval_reaches_further_up() -> None:
    x = np.append(np.full(20, 1.0) + np.linspace(0, 0.1, 20), 6.0)
    low, high = mean_interval(x)
    assert high - x.mean() > 2 * (x.mean() - low)


def test_one_value_out_of_all_bounds_does_not_turn_it_round() -> None:
    x = np.append(np.linspace(0, 1e-3, 99), 1e6)  # a skewness of 10, cut at MOST_SKEWNESS
    low, high = mean_interval(x)
    assert low < x.mean() < high


@pytest.mark.parametrize("x", [np.arange(LEAST - 1.0), np.full(50, 0.3), np.zeros(50), 1e-280 * np.arange(50.0), []])
def test_none_where_too_few_or_all_equal(x: np.ndarray) -> None:
    assert mean_interval(x) is None
    assert statistic_interval(np.asarray(x)[:, None], lambda rows: rows.sum() / 3.0) is None


@pytest.mark.parametrize("waves", [1, 3, 6])
@pytest.mark.parametrize("critical", [1.5, 3.0, 8.0])
def test_the_chance_of_independent_values_is_students(waves: int, critical: float) -> None:
    """A mean over the root mean square of as many independent waves is Student's t."""
    chance = intervals._beyond(critical, np.eye(waves + 1))
    assert chance == pytest.approx(2.0 * stats.t.sf(critical, waves), rel=1e-6)


@given(VALUES, st.floats(-100, 100), st.floats(0.1, 10))
def test_an_interval_of_an_order_moves_and_grows_with_the_values(x: np.ndarray, shift: float, scale: float) -> None:
    low, high = intervals.ordered_interval(x)
    moved = intervals.ordered_interval(scale * x + shift)
    assert moved == pytest.approx((scale * low + shift, scale * high + shift), rel=1e-6, abs=1e-6)
    assert intervals.ordered_interval(x[::-1]) == pytest.approx((low, high), rel=1e-6, abs=1e-6)


def test_what_drifts_is_known_less_well_than_what_scatters() -> None:
    """The same values, in their order and shuffled; of fewer than ten there is no interval."""
    drift = np.arange(20.0)
    low, high = intervals.ordered_interval(drift)
    shuffled = intervals.ordered_interval(np.random.default_rng(0).permutation(drift))
    assert high - low > 2.0 * (shuffled[1] - shuffled[0])
    assert intervals.ordered_interval(drift[:9]) is None
    assert statistic_interval(drift, np.mean, ordered=True) == pytest.approx((low, high), abs=1e-9)


def test_one_value_per_arm_is_asked_for() -> None:
    with pytest.raises(ValueError, match="one per arm"):
        mean_interval(np.ones((8, 64)))


@given(VALUES)
def test_pseudo_values_of_a_mean_are_the_values(x: np.ndarray) -> None:
    np.testing.assert_allclose(intervals.pseudo_values(x, np.mean), x, atol=1e-9)
    assert statistic_interval(x, np.mean) == pytest.approx(mean_interval(x), abs=1e-9)


def test_ratio_against_the_delta_method() -> None:
    rng = np.random.default_rng(3)
    rows = np.stack([rng.normal(5.0, 0.5, 400), rng.normal(10.0, 0.5, 400)], axis=1)
    ratio = rows[:, 0].sum() / rows[:, 1].sum()
    error = np.std(rows[:, 0] - ratio * rows[:, 1], ddof=1) / rows[:, 1].mean() / 20.0
    low, high = statistic_interval(rows, lambda r: r[:, 0].sum() / r[:, 1].sum())
    assert (high - low) / 2 == pytest.approx(stats.t.ppf(0.975, 399) * error, rel=0.02)
    assert (low + high) / 2 == pytest.approx(ratio, abs=0.1 * error)


@given(st.integers(0, 300), st.integers(1, 300))
def test_share_is_scipys_wilson(successes: int, trials: int) -> None:
    successes = min(successes, trials)
    referee = stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert share_interval(successes, trials) == pytest.approx(tuple(referee), abs=1e-12)


@pytest.mark.parametrize(("successes", "trials"), [(3, 2), (-1, 5), (0, 0)])
def test_what_is_no_share_is_refused(successes: int, trials: int) -> None:
    with pytest.raises(ValueError, match="make no share"):
        share_interval(successes, trials)


def test_arms_that_all_do_the_same_count_once_each() -> None:
    assert clustered_share_interval(np.full(64, 64), 64) == pytest.approx(share_interval(64, 64), abs=1e-12)
    assert clustered_share_interval(np.zeros(20), 30) == pytest.approx(share_interval(0, 20), abs=1e-12)
    assert clustered_share_interval(np.full(9, 5), 5) is None


def test_arms_that_do_all_or_nothing_count_once_each() -> None:
    taken = np.repeat([0, 64], 32)
    low, high = clustered_share_interval(taken, 64)
    once = share_interval(32, 64)
    assert high - low == pytest.approx(once[1] - once[0], rel=0.03)


def test_trials_that_are_not_alike_count_each() -> None:
    taken = np.random.default_rng(0).binomial(50, 0.3, 2000)
    all_of_them = share_interval(taken.sum(), 50 * 2000)
    low, high = clustered_share_interval(taken, np.full(2000, 50))
    assert high - low == pytest.approx(all_of_them[1] - all_of_them[0], rel=0.1)


def test_few_arms_that_fail_tell_little() -> None:
    """Two of 64 arms with nothing: as if each arm counted once. Forty that miss one of twenty: by the design effect."""
    two, forty = np.full(64, 20), np.full(64, 20)
    two[:2], forty[:40] = 0, 19
    assert clustered_share_interval(two, 20) == pytest.approx(share_interval(62, 64), abs=1e-12)
    share, error = forty.mean() / 20, forty.std(ddof=1) / 20 / 8
    counted = share * (1 - share) / error**2 * (stats.t.ppf(0.975, 64 * 20 - 1) / stats.t.ppf(0.975, 23)) ** 2
    assert counted > 64 * 20  # they are more alike than by chance: each fruit counts, and no more
    assert clustered_share_interval(forty, 20) == pytest.approx(share_interval(forty.sum(), 64 * 20), abs=1e-12)


def test_the_design_effect_by_hand() -> None:
    taken = np.concatenate([np.full(10, 12), np.full(10, 20), np.full(10, 17)])
    share, error = taken.mean() / 20, taken.std(ddof=1) / 20 / np.sqrt(30)
    counted = share * (1 - share) / error**2 * (stats.t.ppf(0.975, 599) / stats.t.ppf(0.975, 19)) ** 2
    assert 30 < counted < 600
    z = stats.norm.ppf(0.975)
    ends = np.roots(
        [1 + z**2 / counted, -2 * share - z**2 / counted, share**2]
    )  # of |share - p| = z sqrt(p (1 - p) / m)
    assert clustered_share_interval(taken, 20) == pytest.approx(tuple(sorted(ends)), abs=1e-9)


def test_crossed_by_hand() -> None:
    rng = np.random.default_rng(1)
    a, b = 12, 6
    x = rng.normal(size=(a, 1)) + 0.5 * rng.normal(size=b) + 0.3 * rng.normal(size=(a, b))
    grand = x.mean()
    ms_a = b * sum((row.mean() - grand) ** 2 for row in x) / (a - 1)
    ms_b = a * sum((column.mean() - grand) ** 2 for column in x.T) / (b - 1)
    rest = sum((x[i, j] - x[i].mean() - x[:, j].mean() + grand) ** 2 for i in range(a) for j in range(b))
    variance = (ms_a + ms_b - rest / ((a - 1) * (b - 1))) / (a * b)
    freedom = (variance * a * b) ** 2 / (ms_a**2 / (a - 1) + ms_b**2 / (b - 1))
    half = stats.t.ppf(0.975, freedom) * np.sqrt(variance)
    assert crossed_interval(x) == pytest.approx((grand - half, grand + half), rel=1e-9)


def test_crossed_never_narrower_than_either_factor_alone() -> None:
    x = np.random.default_rng(4).normal(size=(30, 8))  # nothing but the two together
    low, high = crossed_interval(x)
    for axis, n in ((1, 30), (0, 8)):
        means = x.mean(axis=axis)
        assert high - low > 2 * 1.96 * means.std(ddof=1) / np.sqrt(n) * 0.999


@pytest.mark.parametrize("shape", [(LEAST - 1, 8), (20, LEAST_RUNS - 1)])
def test_crossed_needs_enough_of_both(shape: tuple[int, int]) -> None:
    assert crossed_interval(np.random.default_rng(0).normal(size=shape)) is None
    assert crossed_interval(np.ones((20, 8))) is None


@given(st.integers(1, 150), st.floats(0.02, 0.98))
def test_quantile_levels_by_the_binomial(count: int, probability: float) -> None:
    """Between the whole ranks that are just enough and just too few."""
    below = stats.binom.cdf(np.arange(-1, count + 1), count, probability)  # of fewer than k values below the quantile
    reached = 1.0 - below[1:]  # chance that the (k + 1)-th value lies below it, k from 0

    def between(level: float, tail: float) -> None:
        rank = level * count + 0.5
        assert 1.0 - 1e-9 <= rank <= count + 1e-9
        inner, outer = reached[int(np.floor(rank + 1e-9)) - 1], reached[int(np.ceil(rank - 1e-9)) - 1]
        assert inner >= tail - 1e-7 or rank < 1.0 + 1e-9
        assert outer <= tail + 1e-7 or rank > count - 1e-9

    ends = reached[[0, count - 1]]
    assume(not np.isclose(ends, [0.975, 0.025], rtol=0, atol=1e-12).any())  # where either answer is right
    low, high = quantile_levels(count, probability)
    assert (low is None) == (reached[0] < 0.975)
    assert (high is None) == (reached[count - 1] > 0.025)
    for level, tail in ((low, 0.975), (high, 0.025)):
        if level is not None:
            between(level, tail)


def test_the_ends_of_p95_are_open_below_72_arms() -> None:
    values = np.arange(200.0)
    assert [quantile_interval(values[:n], 0.95)[1] is None for n in (20, 71, 72, 200)] == [True, True, False, False]
    assert quantile_interval(values[:3], 0.05)[0] is None
    assert quantile_interval([], 0.5) == (None, None)
    low, high = quantile_interval(values, 0.5)
    assert low < 99.5 < high and low + high == pytest.approx(199.0)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_norms_lower_end_is_zero_where_hotellings_test_allows_a_mean_of_zero(k: int) -> None:
    """The test by another way: how well the vectors explain a column of ones (T^2 = (n - 1) R^2 / (1 - R^2))."""
    rng, zeros = np.random.default_rng(k), 0
    for size in np.linspace(0.0, 1.0, 60):
        x = rng.normal(size=(12, k)) * np.arange(1, k + 1) + size
        _, rest, *_ = np.linalg.lstsq(x, np.ones(12), rcond=None)
        share = 1.0 - rest[0] / 12.0
        p_value = stats.f.sf(share / (1.0 - share) * (12 - k) / k, k, 12 - k)
        low, high = norm_interval(x)
        assert high > np.linalg.norm(x.mean(axis=0)) and (low == 0.0 or p_value < 0.05)
        assert low > 0.0 or p_value > 0.005  # of a clear mean the lower end is the jackknife's
        zeros += low == 0.0
    assert 5 < zeros < 55


def test_a_norm_of_vectors_of_which_one_coordinate_never_changes_has_an_interval() -> None:
    x = np.random.default_rng(0).normal(size=(30, 3)) * [1.0, 1.0, 0.0] + [9.0, 0.0, 0.5]
    low, high = norm_interval(x)
    assert 8 < low < np.linalg.norm(x.mean(axis=0)) < high < 10
    assert norm_interval(x[: LEAST - 1]) is None and norm_interval(np.tile(x[0], (30, 1))) is None
