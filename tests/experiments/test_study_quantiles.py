"""Quantiles: exact, with bands that hold."""

import numpy as np
import pyarrow.dataset as ds
import pytest

from pickenv.base import quantile_interval
from pickenv.experiments import quantiles_of, study, study_rows


def test_quantiles_are_exact_and_leave_failed_arms_out(written):
    rows = written(3, 70, failed=0.1)
    raw = rows.to_table().to_pandas()
    table = quantiles_of(rows).to_pylist()
    assert len(table) == 3 * len(study.FIGURES) * len(study_rows.PROBABILITIES)
    for row in table:
        values = raw[(raw.setting == row["setting"]) & (raw.status == "ok")][row["quantity"]]
        assert row["arms"] == len(values)
        assert row["value"] == pytest.approx(np.quantile(values, row["probability"], method="hazen"), rel=1e-12)
        assert (row["low"], row["high"]) == pytest.approx(quantile_interval(values, row["probability"]), rel=1e-12)
        assert (row["low"] or 0.0) <= row["value"] <= (row["high"] or np.inf)


def test_chunks_do_not_matter_to_exact_quantiles(written):
    rows = written(6, 20)
    one = quantiles_of(rows).to_pylist()
    whole = rows.to_table().sort_by([("error_mean_mm", "descending")])
    assert quantiles_of(ds.dataset(whole)).to_pylist() == one


def test_a_setting_without_any_result_has_no_quantile(written):
    """Null and not NaN: JSON has no NaN."""
    for row in quantiles_of(written(1, 10, failed=1.1), ["error_mean_mm"], [0.5]).to_pylist():
        assert (row["arms"], row["value"], row["low"], row["high"]) == (0, None, None, None)


@pytest.mark.parametrize(("arms", "bounded"), [(71, False), (72, True)])
def test_an_end_that_so_few_arms_cannot_bound_is_open(written, arms, bounded):
    """0.95^n is the chance that no arm lies beyond: it falls below 2.5 % from 72 arms."""
    assert (0.95**arms < 0.025) == bounded
    for row in quantiles_of(written(1, arms), ["error_mean_mm"]).to_pylist():
        assert (row["high"] is not None) == (bounded or row["probability"] != 0.95)
        assert (row["low"] is not None) == (bounded or row["probability"] != 0.05)
