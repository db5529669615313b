"""Numbers beside and inside the pictures, recomputed: summary, bins and scales, labels, group means, tiles."""

import re
from dataclasses import replace

import numpy as np
import pytest

from pickenv.calibration import fit, random_joints, simulated_tracker
from pickenv.calibration.assessment.screen import figure
from pickenv.calibration.pipeline.result import assess
from pickenv.inspect.figures import plot_calibration, plot_errors
from pickenv.inspect.reports.calibration_report import calibration_page
from pickenv.inspect.runs.comparison_summary import (
    attitude_scale_deg,
    cell_means,
    colour_scale_mm,
    error_spread,
    histogram_edges_mm,
    round_step,
    scale_end,
    summary_markdown,
    ticks,
    uncertainty_scale_mm,
)

RNG = np.random.default_rng(11)
ERRORS = {"raw": RNG.gamma(4, 1.5, 48), "LS": RNG.gamma(4, 0.15, 48)}


def numbers(values):
    """Mean, root mean square, 95th percentile (linear between order statistics) and maximum."""
    ordered = np.sort(np.asarray(values))
    place = 0.95 * (len(ordered) - 1)
    below = ordered[int(place)]
    above = ordered[min(int(place) + 1, len(ordered) - 1)]
    p95 = below + (place - int(place)) * (above - below)
    return ordered.sum() / len(ordered), np.sqrt((ordered**2).sum() / len(ordered)), p95, ordered[-1]


def mixed(comparison):
    """The comparison with three policies whose every number differs, and where the middle one wins at some points."""
    rng = np.random.default_rng(3)
    policies = []
    for i, policy in enumerate(comparison.policies):
        count, field = len(policy.position_error_mm), len(policy.field_errors)
        policies.append(
            replace(
                policy,
                position_error_mm=rng.gamma(2.0, 1.0 + i, count),
                attitude_error_deg=rng.gamma(3.0, 0.1 * (i + 1), count),
                success=rng.random(count) < (0.9, 0.35, 0.62)[i],
                field_errors=rng.normal(size=(field, 3)) * (1e-3, 3e-4, 4e-4)[i],
            )
        )
    return replace(comparison, policies=tuple(policies))


def rows_of(markdown):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in markdown.splitlines() if line[:1] == "|"]


def test_every_cell_of_the_summary_is_its_policys(comparison):
    many = mixed(comparison)
    heads, _, *rows = rows_of(summary_markdown(many, 25.0))
    expected_heads = ["policy", "picked", "reach mean", "RMS", "p95", "max", "attitude mean", "field mean", "field RMS"]
    assert heads == expected_heads and len(rows) == 3
    for policy, row in zip(many.policies, rows, strict=True):
        mean, rms, p95, largest = numbers(policy.position_error_mm)
        field = numbers(1e3 * np.sqrt(np.sum(policy.field_errors**2, axis=1)))
        assert row == [
            f"**{policy.label}**",
            f"{100 * policy.success.sum() / len(policy.success):.0f} %",
            f"{mean:.2f} mm",
            f"{rms:.2f}",
            f"{p95:.2f}",
            f"{largest:.2f}",
            f"{numbers(policy.attitude_error_deg)[0]:.3f}°",
            f"{field[0]:.2f} mm",
            f"{field[1]:.2f}",
        ]


def test_the_sentences_below_the_summary_count_and_compare_the_last_two(comparison):
    many = mixed(comparison)
    text = summary_markdown(many, 25.0)
    before, last = (np.linalg.norm(p.field_errors, axis=1) for p in many.policies[1:])
    share = 100 * np.count_nonzero(last < before) / len(last)
    assert 20 < share < 45
    assert f"LS + BPNN errs less than LS at {share:.0f} % of them." in text
    assert f"{len(many.fruit)} reaches; a pick if the fruit is inside the capture region, radius 1 mm" in text
    assert f"{len(many.field_points)} field points, cells of 55 mm." in text
    top = np.percentile(1e3 * np.linalg.norm(many.policies[0].field_errors, axis=1), 99)
    assert f"drawn ×25. **Colour**: its length, 0 to {top:.2f} mm in every field (p99 of raw;" in text
    assert f"qiao2026, seed {many.seed}" in text and "difference drawn ×25; red ball = capture region ×25" in text
    assert colour_scale_mm(many) == pytest.approx(top)
    shown = np.concatenate([1e3 * many.field_uncertainty, 1e3 * np.linalg.norm(many.policies[2].field_errors, axis=1)])
    assert uncertainty_scale_mm(many) == pytest.approx(np.percentile(shown, 99))


def test_a_field_alone_has_its_own_table(without_reaches):
    heads, _, row = rows_of(summary_markdown(without_reaches, 10.0))
    assert heads == ["policy", "field mean", "field RMS", "field p95", "field max"]
    mean, rms, p95, largest = numbers(1e3 * np.linalg.norm(without_reaches.policies[0].field_errors, axis=1))
    assert row == ["**raw**", f"{mean:.2f} mm", f"{rms:.2f}", f"{p95:.2f}", f"{largest:.2f}"]
    text = summary_markdown(without_reaches, 10.0)
    assert "reaches" not in text and "errs less" not in text and "Picking" not in text


def test_spread_of_errors_of_any_shape():
    found = error_spread(ERRORS["raw"].reshape(6, 8))
    assert (found.mean, found.rms, found.p95, found.largest) == pytest.approx(numbers(ERRORS["raw"]))
    assert all(np.isnan(value) for value in vars(error_spread([])).values())


@pytest.mark.parametrize(
    ("at_least", "step"),
    [(1.0, 1.0), (1.01, 2.0), (2.0, 2.0), (2.2, 2.5), (2.6, 5.0), (5.1, 10.0), (0.03, 0.05), (120.0, 200.0)],
)
def test_round_steps_are_1_2_25_and_5(at_least, step):
    assert round_step(at_least) == pytest.approx(step)


def test_ticks_and_bins_are_round_and_hold_everything(comparison):
    assert ticks(1.0) == pytest.approx([0.2 * i for i in range(6)]) and ticks(8.0) == [float(i) for i in range(9)]
    assert ticks(1.0, 2) == pytest.approx([0.0, 0.5, 1.0]) and ticks(0.9, 2) == pytest.approx([0.0, 0.5])
    many = mixed(comparison)
    largest = max(policy.position_error_mm.max() for policy in many.policies)
    edges = histogram_edges_mm(many)
    width = edges[1]
    assert width == round_step(largest / 24) and edges[0] == 0.0
    np.testing.assert_allclose(np.diff(edges), width)
    assert edges[-2] <= largest < edges[-1]
    assert histogram_edges_mm(many, 6)[1] == round_step(largest / 6)
    still = replace(many, policies=tuple(replace(p, position_error_mm=np.zeros(3)) for p in many.policies))
    assert histogram_edges_mm(still)[1] == round_step(1.0 / 24)


def test_scales_end_at_the_99th_percentile_and_at_one_where_there_is_nothing():
    values = np.arange(1.0, 202.0)
    assert scale_end(values) == pytest.approx(199.0)
    assert scale_end(np.empty(0)) == scale_end(np.zeros(4)) == 1.0
    turned = np.radians([[3.0, 4.0, 0.0]] * 3)
    assert attitude_scale_deg({"raw": turned, "LS": 9 * turned}) == pytest.approx(5.0)


def test_cells_hold_the_means_of_their_points():
    cells, means = cell_means(np.array([[1, 0, 0], [0, 0, 2], [1, 0, 0]]), np.array([1.0, 5.0, 4.0]))
    assert cells.tolist() == [[0, 0, 2], [1, 0, 0]] and means.tolist() == [5.0, 2.5]


def legend(figure_):
    return [text.get_text() for text in figure_.legends[0].get_texts()]


def test_the_legend_of_errors_per_pose_states_mean_and_maximum():
    figure_ = plot_errors.error_per_pose(ERRORS)
    assert legend(figure_) == [
        f"{n}: mean {np.sum(v) / 48:.2f} mm, max {np.sort(v)[-1]:.2f} mm" for n, v in ERRORS.items()
    ]
    for line, values in zip(figure_.axes[0].get_lines(), ERRORS.values(), strict=True):
        np.testing.assert_array_equal(line.get_xdata(), np.arange(1, 49))
        np.testing.assert_array_equal(line.get_ydata(), values)
    assert figure_.axes[0].get_xlim() == (0.5, 48.5) and figure_.axes[0].get_ylim()[0] == 0.0


def test_boxes_stand_at_quartiles_and_are_labelled_with_means_and_counts():
    axes = plot_errors.error_by_method(ERRORS).axes[0]
    said = [text for text in axes.texts if re.fullmatch(r"[\d.]+", text.get_text())]
    for i, (text, values) in enumerate(zip(said, ERRORS.values(), strict=True), start=1):
        assert text.get_text() == f"{values.mean():.3g}" and text.xy == (i + 0.3, values.mean())
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["raw\n(48)", "LS\n(48)"]
    for box, values in zip(axes.patches, ERRORS.values(), strict=True):
        heights = box.get_path().vertices[:, 1]
        assert (heights.min(), heights.max()) == pytest.approx(tuple(np.percentile(values, [25, 75])))


def test_a_cumulative_curve_is_the_share_of_errors_below():
    axes = plot_errors.error_cumulative(ERRORS, tolerance=5.0).axes[0]
    *curves, limit = axes.get_lines()
    assert limit.get_xdata()[0] == 5.0 and limit.get_label() == "tolerance 5 mm"
    assert [label.get_text() for label in axes.get_yticklabels()] == ["0", "20", "40", "60", "80", "100"]
    np.testing.assert_allclose(axes.get_yticks(), [0, 0.2, 0.4, 0.6, 0.8, 1.0])
    for line, values in zip(curves, ERRORS.values(), strict=True):
        x, y = (np.asarray(data, dtype=float)[1:] for data in line.get_data())
        np.testing.assert_array_equal(x, np.sort(values))
        np.testing.assert_allclose(y, np.arange(1, 49) / 48)


def test_bars_of_the_histogram_are_percent_of_the_poses_in_bins_of_round_width():
    axes = plot_errors.error_histogram(ERRORS).axes[0]
    width = round_step(max(values.max() for values in ERRORS.values()) / 40)
    assert axes.get_ylabel() == f"share of poses in {width:g} mm (%)"
    for patch, values in zip(axes.patches, ERRORS.values(), strict=True):
        counts = np.bincount((values / width).astype(int))
        outline = patch.get_path().vertices
        heights = {round(100 * count / 48, 6) for count in counts} | {0.0}
        assert {round(float(height), 6) for height in outline[:, 1]} == heights
        assert outline[:, 0].max() == pytest.approx(width * len(counts))
    still = plot_errors.error_histogram({"raw": np.zeros(4)}).axes[0]
    assert still.get_ylabel() == f"share of poses in {round_step(1 / 40):g} mm (%)"


@pytest.mark.parametrize(("values", "groups"), [(48, 8), (48, 5), (3, 8)])
def test_group_means_are_means_of_groups_of_equal_size_or_of_each_value(values, groups):
    x = np.sort(RNG.random(48)) if values == 48 else np.repeat([1.0, 2.0, 4.0], 16)
    axes = plot_errors.error_against(x, ERRORS, name="payload", unit="kg", groups=groups).axes[0]
    lines = [line for line in axes.get_lines() if line.get_linestyle() == "-"]
    parts = np.array_split(np.arange(48), min(groups, values))
    for line, errors in zip(lines, ERRORS.values(), strict=True):
        np.testing.assert_allclose(line.get_xdata(), [sum(x[p]) / len(p) for p in parts])
        np.testing.assert_allclose(line.get_ydata(), [sum(errors[p]) / len(p) for p in parts])


def test_the_spectrum_and_the_convergence_show_what_they_are_given():
    figure_ = plot_calibration.least_squares_convergence([6.8, 0.9, 0.5], [0.3, 0.02, 0.01])
    drawn = [line.get_ydata() for axes in figure_.axes for line in axes.get_lines()]
    for series in ([6.8, 0.9, 0.5], [0.3, 0.02, 0.01]):
        assert any(len(line) == 3 and np.allclose(line, series) for line in drawn)
    loss = plot_calibration.network_convergence([1.0, 0.3, 0.2]).axes[0].get_lines()
    assert any(np.allclose(line.get_ydata(), [1.0, 0.3, 0.2]) for line in loss if len(line.get_ydata()) == 3)


@pytest.fixture(scope="module")
def judged(comparison):
    rng, plant = np.random.default_rng(0), comparison.plant
    train, test = (simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (60, 40))
    return assess(plant.arm, fit(plant.arm, train), train, test)


def test_the_tiles_and_the_verdict_of_a_calibration_are_of_the_calibrated_arm(judged):
    page = calibration_page(judged, {"seed": 0})
    left, nominal = (
        1e3 * np.linalg.norm(judged.test.difference(model)[:, :3], axis=1)
        for model in (judged.fit.calibration.model, judged.fit.calibration.nominal)
    )
    text = " ".join(re.sub(r"<[^>]*>", " ", page).split())
    p95 = figure(numbers(left)[2])
    assert p95 != figure(numbers(nominal)[2])
    tile = re.search(r"([\d.]+) mm 95 of 100 poses are better|95 of 100 poses are better than this ([\d.]+) mm", text)
    assert tile and p95 in tile.groups()
    assert f"{figure(nominal.mean())} → {figure(left.mean())} mm" in text
    states = list(judged.quality.states.geometry.values())
    assert f"{states.count('measured')} of {len(states)}" in text
    ratio = np.sqrt(judged.fit.identification.chi_square / judged.fit.identification.degrees_of_freedom)
    assert f"{ratio:.2g} ×" in text
