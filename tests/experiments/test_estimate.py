"""Numbers of rows with their intervals: what counts once, what is paired, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.base import clustered_share_interval, crossed_interval, mean_interval, unseen_share
from pickenv.experiments import Rows, estimate

ARMS, FRUIT = 12, 5


def errors(seed=0, trainings=1):
    """Errors of arms, each with an own mean, and half as large behind a calibration."""
    rng = np.random.default_rng(seed)
    own = rng.lognormal(1.0, 0.5, (ARMS, trainings, 1))
    raw = own * rng.lognormal(0.0, 0.1, (ARMS, trainings, FRUIT))
    arm, training, fruit = np.indices(raw.shape)
    columns = {"arm": arm, "training": training, "fruit": fruit}
    parts = [
        {"method": np.full(raw.size, name)}
        | {key: values.ravel() for key, values in columns.items()}
        | {"error_mm": (factor * raw).ravel(), "taken": (factor * raw < 2.0).ravel()}
        for name, factor in (("raw", 1.0), ("ls", 0.5))
    ]
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}, raw


@given(seed=st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_an_arm_counts_once_however_many_fruit_it_reached_for(seed):
    columns, raw = errors(seed)
    (first, _) = estimate(columns, "error_mm", by=("method",))
    assert first["method"] == "raw"
    assert first["estimate"].ci95 == pytest.approx(mean_interval(raw.mean(axis=(1, 2))))


@given(order=st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_the_order_of_rows_changes_nothing(order):
    columns, _ = errors()
    mixed = np.random.default_rng(order).permutation(len(columns["arm"]))
    shuffled = {key: values[mixed] for key, values in columns.items()}
    one, other = (
        {row["method"]: row["estimate"] for row in estimate(some, "error_mm", by=("method",))}
        for some in (columns, shuffled)
    )
    for name in one:
        assert one[name].value == pytest.approx(other[name].value, rel=1e-12)


def test_trainings_and_arms_are_two_crossed_factors():
    columns, raw = errors(trainings=6)
    (first, _) = estimate(columns, "error_mm", by=("method",), over=("arm", "training"))
    assert first["estimate"].ci95 == pytest.approx(crossed_interval(raw.mean(axis=2)))


@pytest.mark.parametrize(
    ("value", "of"),
    [
        (("error_mm", "half_mm"), "removed"),
        (("taken", "tried"), "share"),
        ("error_mm", lambda means: means.mean()),
    ],
)
def test_no_interval_over_arms_alone_is_given_where_trainings_were_asked_for_too(value, of):
    columns, _ = errors(trainings=6)
    columns |= {"half_mm": columns["error_mm"] / 2 + 0.1 * columns["training"], "tried": np.ones(len(columns["arm"]))}
    for row in estimate(columns, value, by=("method",), over=("arm", "training"), of=of):
        assert row["estimate"].ci95 is None and "counts trainings" in row["estimate"].missing
    (row, _) = estimate(columns, value, by=("method",), of=of)
    assert row["estimate"].ci95 is not None


def test_a_ratio_to_equal_times_is_the_mean_over_arms_and_trainings():
    """Where hours vary less than what was picked, both count."""
    columns, _ = errors(trainings=6)
    columns |= {"hours": np.full(len(columns["arm"]), 2.0)}
    asked = {"by": ("method",), "over": ("arm", "training")}
    rates = estimate(columns, ("error_mm", "hours"), of="ratio", **asked)
    for rate, mean in zip(rates, estimate(columns, "error_mm", **asked), strict=True):
        assert rate["estimate"].value == pytest.approx(mean["estimate"].value / 2.0)
        assert rate["estimate"].ci95 == pytest.approx(np.divide(mean["estimate"].ci95, 2.0))
    columns, _ = errors(trainings=3)
    (few, _) = estimate(columns | {"hours": columns["error_mm"] + 1.0}, ("error_mm", "hours"), of="ratio", **asked)
    assert few["estimate"].missing == "needs 5 trainings"


@pytest.mark.parametrize("of", ["ratio", "removed"])
def test_a_statistic_of_two_columns_has_no_interval_for_arms_that_are_equal_not_for_trainings(of):
    columns = {"arm": np.arange(12), "before": np.full(12, 4.0), "after": np.full(12, 2.0)}
    (row,) = estimate(columns, ("before", "after"), of=of)
    assert row["estimate"].ci95 is None and row["estimate"].missing == "all arms are equal"


@pytest.mark.parametrize(("arms", "least", "missing"), [(12, 13, "needs 13 arms"), (12, 12, ""), (6, 5, "")])
def test_the_fewest_arms_are_those_asked_for_beside_trainings_too(arms, least, missing):
    columns, _ = errors(trainings=6)
    some = {name: values[columns["arm"] < arms] for name, values in columns.items()}
    for row in estimate(some, "error_mm", by=("method",), over=("arm", "training"), least=least):
        assert row["estimate"].missing == missing and (row["estimate"].ci95 is None) == bool(missing)


def test_differences_are_paired_by_arm():
    columns, raw = errors()
    (change,) = estimate(columns, "error_mm", by=("method",), against={"method": "raw"})
    assert change["method"] == "ls"
    assert change["estimate"].value == pytest.approx(-0.5 * raw.mean())
    assert change["estimate"].ci95 == pytest.approx(mean_interval(-0.5 * raw.mean(axis=(1, 2))))
    assert change["estimate"].significant


def test_a_function_of_several_columns_takes_one_row_per_arm():
    columns, _ = errors()
    columns["before"] = columns["error_mm"] * 2.0
    (first, _) = estimate(
        columns, ("error_mm", "before"), by=("method",), of=lambda table: 1.0 - table[:, 0].sum() / table[:, 1].sum()
    )
    assert first["estimate"].value == pytest.approx(0.5)


def test_shares_and_ratios_of_two_columns_weigh_units_by_what_they_tried():
    rng = np.random.default_rng(0)
    tried = rng.integers(5, 40, 14)
    columns = {"arm": np.arange(14), "taken": rng.binomial(tried, 0.7), "tried": tried}
    (share,) = estimate(columns, ("taken", "tried"), of="share")
    (ratio,) = estimate(columns, ("taken", "tried"), of="ratio")
    assert share["estimate"].value == ratio["estimate"].value == columns["taken"].sum() / tried.sum()
    assert share["estimate"].ci95 == clustered_share_interval(columns["taken"], tried)
    low, high = ratio["estimate"].ci95
    assert low < ratio["estimate"].value < high


def test_shares_and_quantiles_stay_within_what_can_be():
    columns, _ = errors()
    for row in estimate(columns, "taken", by=("method",), of="share"):
        low, high = row["estimate"].ci95
        assert 0.0 <= low <= row["estimate"].value <= high <= 1.0
    for row in estimate(columns, "error_mm", by=("method",), of=0.5):
        low, high = row["estimate"].ci95
        assert low <= row["estimate"].value <= high


def test_arms_that_were_not_measured_alike_are_refused():
    columns, _ = errors()
    lacking = {key: values[1:] for key, values in columns.items()}
    with pytest.raises(ValueError, match="not every combination of arm"):
        estimate(lacking, "error_mm", by=("method",))
    with pytest.raises(ValueError, match="over one or two columns"):
        estimate(columns, "error_mm", over=())


def test_what_would_be_mispaired_or_is_no_number_is_refused():
    columns, _ = errors()
    others = columns | {"arm": columns["arm"] + np.where(columns["method"] == "ls", ARMS, 0)}
    with pytest.raises(ValueError, match="not measured on the same arm"):
        estimate(others, "error_mm", by=("method",), against={"method": "raw"})
    some = columns | {"error_mm": np.where(columns["arm"] == 3, np.nan, columns["error_mm"])}
    with pytest.raises(ValueError, match=f"{2 * FRUIT} of {2 * ARMS * FRUIT} values of error_mm are no numbers"):
        estimate(some, "error_mm", by=("method",))


@pytest.mark.parametrize(
    ("value", "of", "against", "said"),
    [
        (("error_mm", "taken"), "mean", None, "'mean' is of one column"),
        (("error_mm", "taken"), 0.5, None, "'0.5' is of one column"),
        ("error_mm", "ratio", None, "'ratio' is of two columns"),
        ("error_mm", "removed", None, "'removed' wants against"),
        ("error_mm", "mean", {"methods": "raw"}, "against names methods"),
        (("error_mm", "taken"), "ratio", {"method": "raw"}, "a ratio of two columns has no paired differences"),
    ],
)
def test_arguments_that_do_not_go_together_are_refused(value, of, against, said):
    with pytest.raises(ValueError, match=said):
        estimate(errors()[0], value, by=("method",), of=of, against=against)


def test_a_share_is_of_all_that_was_tried_of_a_unit_in_however_many_rows():
    rng = np.random.default_rng(0)
    tried = rng.integers(1, 9, (14, 3))
    taken = rng.binomial(tried, 0.7)
    columns = {"arm": np.arange(14).repeat(3), "taken": taken.ravel(), "tried": tried.ravel()}
    (share,) = estimate(columns, ("taken", "tried"), of="share")
    assert share["estimate"].ci95 == clustered_share_interval(taken.sum(axis=1), tried.sum(axis=1))


def test_rows_of_an_experiment_are_columns():
    columns, _ = errors()
    (one,), (other,) = (estimate(some, "error_mm") for some in (Rows(columns).columns, columns))
    assert one["estimate"] == other["estimate"]
    assert one["units"].mean() == pytest.approx(one["estimate"].value)
    assert len(Rows.of({"error_mm": 1.5, "method": "raw"})) == 1


def test_what_is_lost_stands_beside_the_mean_of_the_rest():
    columns = {
        "arm": np.repeat(np.arange(12), 4),
        "error_mm": np.tile([1.0, 2.0, 3.0, 90.0], 12) + np.repeat(np.arange(12), 4),
    }
    (row,) = estimate(columns, "error_mm", lost=50.0)
    assert row["estimate"].value == pytest.approx(2.0 + 5.5) and row["lost"].value == 0.25
    assert row["lost"].ci95[0] < 0.25 < row["lost"].ci95[1]
    (all_lost,) = estimate(columns, "error_mm", lost=0.5)
    assert all_lost["lost"].value == 1.0 and all_lost["estimate"].missing == "all are lost"
    with pytest.raises(ValueError, match="of one column"):
        estimate(columns, "error_mm", of="share", lost=50.0)


def test_runs_are_told_one_by_one_and_few_hide_a_failure():
    """Of five trainings the worst stands beside the mean, and five without a failure rule out few."""
    rng = np.random.default_rng(4)
    arm, training = (axis.ravel() for axis in np.meshgrid(np.arange(12), np.arange(5), indexing="ij"))
    columns = {
        "arm": arm,
        "training": training,
        "error_mm": np.where(training == 3, 5.0, 1.0) + 0.1 * rng.normal(size=60),
    }
    (row,) = estimate(columns, "error_mm", over=("arm", "training"))
    assert row["runs"].argmax() == 3 and np.median(row["runs"]) == pytest.approx(1.0, abs=0.1)
    assert unseen_share(5) == pytest.approx(0.451, abs=1e-3) and (1.0 - unseen_share(5)) ** 5 == pytest.approx(0.05)


def test_what_is_removed_is_the_same_of_two_columns_as_against_a_level():
    rng = np.random.default_rng(5)
    before, after = rng.lognormal(1.0, 0.3, 12), rng.lognormal(0.0, 0.3, 12)
    (one,) = estimate({"arm": np.arange(12), "before": before, "after": after}, ["before", "after"], of="removed")
    columns = {"arm": np.tile(np.arange(12), 2), "way": np.repeat(["raw", "ls"], 12), "mm": np.r_[before, after]}
    (other,) = estimate(columns, "mm", ["way"], of="removed", against={"way": "raw"})
    assert one["estimate"] == other["estimate"]
