"""Quantiles: exact on a moderate table, close and flat in memory on a large one, with bands that hold."""

import numpy as np
import pyarrow.dataset as ds
import pytest

from pickenv.study.results.quantiles import PROBABILITIES, band_levels, quantiles_of
from pickenv.study.results.row_table import FIGURES


def test_quantiles_are_exact_and_leave_failed_arms_out(written):
    rows = written(3, 70, failed=0.1)
    raw = rows.to_table().to_pandas()
    table = quantiles_of(rows).to_pylist()
    assert len(table) == 3 * len(FIGURES) * len(PROBABILITIES)
    for row in table:
        values = raw[(raw.setting == row["setting"]) & (raw.status == "ok")][row["quantity"]]
        assert row["arms"] == len(values)
        assert row["value"] == pytest.approx(np.quantile(values, row["probability"], method="hazen"), rel=1e-12)
        assert row["low"] <= row["value"] <= row["high"]


def test_digests_agree_with_the_exact_quantiles(written):
    rows = written(5, 2000)
    exact = quantiles_of(rows, ["error_mean_mm"]).to_pandas()
    streamed = quantiles_of(rows, ["error_mean_mm"], exact_rows=0).to_pandas()
    for column in ("value", "low", "high"):
        np.testing.assert_allclose(streamed[column], exact[column], rtol=2e-3)
    assert streamed[["setting", "arms", "probability"]].equals(exact[["setting", "arms", "probability"]])


def test_chunks_do_not_matter_to_exact_quantiles(written):
    rows = written(6, 20)
    one = quantiles_of(rows).to_pylist()
    whole = rows.to_table().sort_by([("error_mean_mm", "descending")])
    assert quantiles_of(ds.dataset(whole)).to_pylist() == one


@pytest.mark.parametrize("exact_rows", [100, 0])
def test_a_setting_without_any_result_has_no_quantile(written, exact_rows):
    """Null and not NaN: JSON has no NaN."""
    for row in quantiles_of(written(1, 10, failed=1.1), ["error_mean_mm"], [0.5], exact_rows).to_pylist():
        assert (row["arms"], row["value"], row["low"], row["high"]) == (0, None, None, None)


@pytest.mark.parametrize("probability", [0.05, 0.5, 0.95])
def test_bands_cover_the_true_quantile_at_least_as_often_as_they_say(probability):
    """Even numbers on 0 to 1 have the quantile p at p."""
    count = 400
    low, middle, high = band_levels(count, [probability])[:, 0]
    assert middle == probability
    draws = np.random.default_rng(2).random((2000, count))
    ends = np.quantile(draws, [low, high], axis=1, method="hazen")
    covered = np.mean((ends[0] <= probability) & (probability <= ends[1]))
    assert 0.94 < covered < 0.985


def test_a_band_of_few_arms_ends_at_the_smallest_and_the_largest():
    low, _, high = band_levels(5, [0.5])[:, 0]
    assert low <= 0.1 and high >= 0.9


@pytest.mark.parametrize(("count", "ranks"), [(20, (6, 15)), (50, (18, 33)), (100, (40, 61))])
def test_the_band_of_a_median_ends_at_the_order_statistics_of_the_tables(count, ranks):
    """The usual tables of confidence limits of a median, 95 %."""
    low, _, high = band_levels(count, [0.5])[:, 0]
    assert (low * count + 0.5, high * count + 0.5) == pytest.approx(ranks)
