"""Yields: every arm counts, failed ones as not within; Wilson's interval; any number of chunks."""

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pytest

from pickenv.base import share_interval
from pickenv.experiments import study, yields_of

REQUIRED = 0.95


@pytest.mark.parametrize("failed", [0.0, 0.2])
def test_yields_are_counted_over_all_arms_and_chunks(written, failed):
    rows = written(4, 50, failed=failed)
    table, raw = yields_of(rows, REQUIRED).to_pylist(), rows.to_table().to_pandas()
    assert [row["setting"] for row in table] == [0, 1, 2]
    for row in table:
        arms = raw[raw.setting == row["setting"]]
        good = (arms.share_within >= REQUIRED) & (arms.status == "ok")
        assert (row["arms"], row["within"], row["failed"]) == (200, good.sum(), (arms.status != "ok").sum())
        assert row["yield"] == good.sum() / 200
        assert row["it_grade"] == arms.it_grade.iloc[0]
    assert set(study.SETTING) < set(table[0])


def test_the_required_share_itself_is_enough_and_an_arm_without_a_result_is_not(written):
    table = written(1, 3).to_table().slice(0, 3)
    shares = pa.array([REQUIRED, np.nextafter(REQUIRED, 0.0), np.nan])
    rows = ds.dataset(table.set_column(table.schema.get_field_index("share_within"), "share_within", shares))
    assert yields_of(rows, REQUIRED)["within"].to_pylist() == [1]


def test_a_coarser_grade_has_the_lower_yield(written):
    values = yields_of(written(2, 100), REQUIRED)["yield"].to_pylist()
    assert values == sorted(values, reverse=True) and values[0] > values[-1]


def test_wilsons_interval_is_his():
    """Wilson 1927, by the formula; at no and at full success it stays inside 0 to 1 and is not empty."""
    z = 1.959963984540054
    for k, n in ((0, 20), (20, 20), (37, 50), (999, 1000)):
        p = k / n
        centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
        half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
        low, high = share_interval(k, n)
        assert (low, high) == pytest.approx((centre - half, centre + half), abs=1e-12)
        assert 0.0 <= low < high <= 1.0


def test_the_interval_covers_the_true_yield_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    covered = [low <= 0.9 <= high for low, high in (share_interval(k, 60) for k in rng.binomial(60, 0.9, 1000))]
    assert 0.92 < np.mean(covered) < 0.985
