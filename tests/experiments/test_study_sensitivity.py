"""Sensitivities: shares that are known in closed form are found, by regression and by Sobol's indices."""

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pytest
from scipy import stats

from pickenv.base import InputError
from pickenv.experiments import sensitivities_of, study_variance


def rows_of(columns, squared_error, arm=None):
    count = len(squared_error)
    return ds.dataset(
        pa.table(
            {
                "setting": pa.array(np.zeros(count), pa.int32()),
                "arm": pa.array(np.arange(count) if arm is None else arm, pa.int64()),
                "status": ["ok"] * count,
                "error_rms_mm": np.sqrt(squared_error),
                **columns,
            }
        )
    )


def even(count, number, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (count, number))


def test_a_quadratic_form_of_independent_deviations():
    """y = 1 + 3 x^2 + u + 2 z^2 with even x, u, z: variances 9 * 4/45, 1/3, 4 * 4/45; means of squares 1 and 2/3."""
    x, u, z = even(40_000, 3).T
    rows = rows_of({"delta_a0_mm": x, "size_backlash_2": u, "delta_alpha1_deg": z}, 1 + 3 * x**2 + u + 2 * z**2)
    variances = {"delta_a0_mm": 9 * 4 / 45, "size_backlash_2": 1 / 3, "delta_alpha1_deg": 4 * 4 / 45}
    found = {row["parameter"]: row for row in sensitivities_of(rows).to_pylist()}
    for name, variance in variances.items():
        expected = variance / sum(variances.values())
        assert found[name]["share"] == pytest.approx(expected, abs=0.01)
        assert found[name]["share_low"] < expected < found[name]["share_high"]
        assert found[name]["r2"] == pytest.approx(1.0)
    assert found["lengths"]["share"] == pytest.approx(found["delta_a0_mm"]["share"])


def test_noise_and_interactions_are_what_r2_leaves():
    x, z = even(40_000, 2).T
    rows = rows_of({"delta_a0_mm": x, "delta_a1_mm": z}, 2 + x * z + x**2)
    (first, *_) = sensitivities_of(rows).to_pylist()
    assert first["r2"] == pytest.approx((4 / 45) / (4 / 45 + 1 / 9), abs=0.01)


def test_memory_holds_sums_not_rows_and_batches_do_not_matter():
    x, z = even(3000, 2).T
    columns, y = {"delta_a0_mm": x, "size_friction_1": 1 + 0.1 * z}, 1 + x**2 + 0.3 * z
    one = sensitivities_of(rows_of(columns, y)).to_pylist()
    order = np.random.default_rng(5).permutation(3000)
    other = sensitivities_of(rows_of({k: v[order] for k, v in columns.items()}, y[order], arm=order)).to_pylist()
    for a, b in zip(one, other, strict=True):
        assert a["parameter"] == b["parameter"]
        numbers = ("share", "share_low", "share_high", "r2")
        assert [a[k] for k in numbers] == pytest.approx([b[k] for k in numbers], rel=1e-9)


def test_failed_arms_and_constant_columns_are_left_out():
    x = even(500, 1)[:, 0]
    table = rows_of({"delta_a0_mm": x, "delta_a1_mm": np.zeros(500)}, 1 + x**2).to_table()
    lost = table.set_column(2, "status", pa.array(["did not converge"] * 100 + ["ok"] * 400))
    found = sensitivities_of(ds.dataset(lost)).to_pylist()
    assert {row["parameter"] for row in found} == {"delta_a0_mm", "lengths"} and found[0]["arms"] == 400


def test_a_column_counts_that_varies_by_more_than_rounding():
    x, z = even(500, 2).T
    found = sensitivities_of(rows_of({"delta_a0_mm": 1e-11 * x, "delta_a1_mm": 1e-13 * z}, 1 + x**2)).to_pylist()
    assert {row["parameter"] for row in found} == {"delta_a0_mm", "lengths"}


def test_too_few_arms_and_nothing_that_varies_are_said():
    x = even(8, 1)[:, 0]
    with pytest.raises(InputError, match=r"setting 0 has 8 arms with a result; its 1 deviations need 15"):
        sensitivities_of(rows_of({"delta_a0_mm": x}, 1 + x**2))
    with pytest.raises(InputError, match="nothing varies between the arms of setting 0"):
        sensitivities_of(rows_of({"delta_a0_mm": np.ones(50)}, np.ones(50)))


@pytest.mark.parametrize("chance", [0.002, 0.02, 0.05])
def test_the_ends_of_a_share_leave_two_and_a_half_percent_on_either_side(chance):
    """Against SciPy's noncentral chi-square and Student's t; symmetric pseudo-values, so that nothing is skewed."""
    share, pseudo = 0.06, np.repeat([0.2, 0.3], 50)
    low, high = study_variance._interval(share, chance, pseudo)
    step = stats.t.ppf(0.975, 99) / stats.norm.ppf(0.975) * pseudo.std(ddof=1) / 10
    scaled, freedom = share / step**2, chance / step**2
    for end, tail in ((low, 0.975), (high, 0.025)):
        assert stats.ncx2.cdf(scaled, freedom, end / step**2) == pytest.approx(tail, abs=2e-3)
    assert 0.0 < low < share - chance < high


def test_a_share_that_chance_alone_may_give_has_an_interval_from_zero():
    pseudo, chance = np.repeat([0.0, 1.0], 50), 0.005
    step = stats.t.ppf(0.975, 99) / stats.norm.ppf(0.975) * pseudo.std(ddof=1) / 10
    for level, begins_at_zero in ((0.5, True), (0.965, True), (0.985, False)):
        share = step**2 * stats.chi2.ppf(level, chance / step**2)
        low, high = study_variance._interval(share, chance, pseudo)
        assert (low <= 0.0) == begins_at_zero and high > 0.0 and low <= share - chance <= high


def test_what_chance_explains_is_taken_off_whole():
    """Of deviations without effect, two terms each: 2 / (arms - 1) of the variance, no more or less."""
    rng, shares = np.random.default_rng(0), []
    for _ in range(60):
        x, z = rng.uniform(-1, 1, (2, 120))
        rows = sensitivities_of(rows_of({"delta_a0_mm": x, "delta_a1_mm": z}, 4.0 + rng.normal(size=120))).to_pylist()
        shares += [row["share"] for row in rows if row["level"] == "parameter"]
    assert abs(np.mean(shares)) < 4.0 * np.std(shares) / np.sqrt(len(shares)) < 1 / 119


def test_r2_is_adjusted_for_its_terms():
    """By its formula, with two deviations and so four terms and a constant."""
    x, z = even(200, 2).T
    rows = rows_of({"delta_a0_mm": x, "delta_a1_mm": z}, 4 + x + np.random.default_rng(1).normal(size=200))
    (first, *_) = sensitivities_of(rows).to_pylist()
    y = rows.to_table()["error_rms_mm"].to_numpy() ** 2
    terms = np.column_stack([np.ones(200), x, z, x**2, z**2])
    rest = y - terms @ np.linalg.lstsq(terms, y)[0]
    assert first["r2"] == pytest.approx(1 - rest.var() / y.var(), abs=1e-6)
    assert first["r2_adjusted"] == pytest.approx(1 - (rest @ rest / 195) / y.var(ddof=1), abs=1e-6)


def test_kinds():
    assert (
        study_variance.tolerance_kind("delta_alpha3_deg") == "angles"
        and study_variance.tolerance_kind("delta_d2_mm") == "lengths"
    )
    assert (
        study_variance.tolerance_kind("size_joint_stiffness_4") == "joint stiffness"
        and study_variance.tolerance_kind("rise_K") == "temperature rise"
    )


def test_a_periodic_error_is_one_parameter_of_sine_and_cosine():
    """Its phase turns freely, so y = 2 + sin has all its variance in the sine's column, whatever else is there."""
    phase, other = np.pi * even(4000, 2).T
    columns = {"sine_transmission_error_1": np.sin(phase), "cosine_transmission_error_1": np.cos(phase)}
    rows = rows_of({**columns, "delta_a0_mm": other}, 2 + np.sin(phase))
    found = {row["parameter"]: row for row in sensitivities_of(rows).to_pylist()}
    assert set(found) == {"size_transmission_error_1", "delta_a0_mm", "transmission error", "lengths"}
    assert found["size_transmission_error_1"]["share"] == pytest.approx(1.0, abs=1e-6)


def ishigami(even, _rows):
    """Ishigami and Homma 1990, a = 7, b = 0.1."""
    x = np.pi * (2 * even - 1)
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_sobol_indices_of_ishigami():
    """First orders 0.3139, 0.4424, 0; totals 0.5576, 0.4424, 0.2437."""
    rows = study_variance.sobol_indices(ishigami, {"x1": [0], "x2": [1], "x3": [2]}, 4096, np.random.default_rng(0))
    np.testing.assert_allclose([row["first_order"] for row in rows], [0.3139, 0.4424, 0.0], atol=0.04)
    np.testing.assert_allclose([row["total"] for row in rows], [0.5576, 0.4424, 0.2437], atol=0.04)


@pytest.mark.parametrize("seed", range(5))
def test_no_total_is_less_than_its_first_order_and_intervals_hold_their_estimates(seed):
    """Additive in three of five inputs, where both estimate one number and chance would put either first."""
    model = lambda u, _: u[:, 0] + 2 * u[:, 1] + u[:, 2] * u[:, 3]  # noqa: E731
    for row in study_variance.sobol_indices(model, {f"x{i}": [i] for i in range(5)}, 256, np.random.default_rng(seed)):
        assert row["first_order"] <= row["total"]
        for key in ("first_order", "total"):
            assert row[f"{key}_low"] <= row[key] <= row[f"{key}_high"]
    assert (row["first_order"], row["total"], row["total_high"]) == (0.0, 0.0, 0.0)  # the fifth changes nothing


def test_sobol_indices_average_over_what_a_row_shares():
    """y = (1 + w) u + v + 3 w with w of the row: w itself makes no variance between arms; E[(1+w)^2] = 2 for u."""
    w = np.random.default_rng(3).choice([-1.0, 1.0], 8192)
    groups, rng = {"u": [0], "v": [1]}, np.random.default_rng(4)
    rows = study_variance.sobol_indices(lambda u, i: (1 + w[i]) * u[:, 0] + u[:, 1] + 3 * w[i], groups, 8192, rng)
    for row, expected in zip(rows, (2 / 3, 1 / 3), strict=True):
        assert row["first_order"] == pytest.approx(expected, abs=0.03)
        assert row["total"] == pytest.approx(expected, abs=0.03)


def test_sobol_indices_of_groups_of_a_linear_model():
    """Shares of independent inputs add up within a group."""
    weights = np.array([3.0, 1.0, 2.0, 1.0])
    groups = {"one": [0, 3], "other": [1, 2]}
    rows = study_variance.sobol_indices(lambda u, _: u @ weights, groups, 1024, np.random.default_rng(1))
    for key in ("first_order", "total"):
        np.testing.assert_allclose([row[key] for row in rows], [10 / 15, 5 / 15], atol=0.02)


def test_sobol_indices_are_reproducible_and_refuse_what_they_cannot_do():
    def run(seed):
        return study_variance.sobol_indices(
            lambda u, _: u.sum(axis=1), {"a": [0], "b": [1]}, 256, np.random.default_rng(seed)
        )

    assert run(3) == run(3) != run(4)
    for samples in (300, 128):
        with pytest.raises(InputError, match="give a power of two from 256"):
            study_variance.sobol_indices(lambda u, _: u[:, 0], {"a": [0]}, samples, np.random.default_rng(0))
    with pytest.raises(InputError, match="no variance to divide"):
        study_variance.sobol_indices(lambda u, _: np.ones(len(u)), {"a": [0]}, 256, np.random.default_rng(0))


def test_components_of_four_causes_drawn_by_hand():
    """Arms 4, fruit 2, poses 1 and an interaction of fruit and poses 1, of 8."""
    rng = np.random.default_rng(2)
    (a, f, p), (a2, f2, p2) = rng.normal(size=(2, 3, 4000, 1))
    value = lambda a, f, p: 2 * a + np.sqrt(2) * f + p + f * p  # noqa: E731
    mixed = np.stack([value(a2, f, p), value(a, f2, p), value(a, f, p2), value(a, f, p)])
    found = study_variance.variance_indices(
        value(a, f, p), value(a2, f2, p2), mixed, ["arms", "fruit", "poses", "tracker"]
    )
    truth = {"arms": (0.5, 0.5), "fruit": (0.25, 0.375), "poses": (0.125, 0.25), "tracker": (0.0, 0.0)}
    for row in found:
        assert (row["first_order"], row["total"]) == pytest.approx(truth[row["group"]], abs=0.05)
