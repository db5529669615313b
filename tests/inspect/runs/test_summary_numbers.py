"""Numbers beside the pictures, recomputed: the summary, bins and scales, the tiles of a calibration."""

import re
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from pickenv.arm import forward
from pickenv.calibration import assess, fit, random_joints, simulated_tracker
from pickenv.calibration.assessment.screen import figure
from pickenv.inspect import RecordedEpisodes, RecordedPolicy, calibration_page, gripped, gripper_curves
from pickenv.inspect.colours import policy_key
from pickenv.inspect.runs.comparison_summary import (
    cell_means,
    colour_scale_mm,
    comparison_markdown,
    error_spread,
    explanation,
    histogram_edges_mm,
    outcome_sentence,
    round_step,
    scale_end,
    summary_markdown,
    ticks,
    uncertainty_scale_mm,
)
from pickenv.orchard import capture_probability, load_gripper


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
        count, field = len(policy.ends.position_error_mm), len(policy.field_errors)
        policies.append(
            replace(
                policy,
                position_error_mm=rng.gamma(2.0, 1.0 + i, (count, 1)),
                attitude_error_deg=rng.gamma(3.0, 0.1 * (i + 1), (count, 1)),
                success=rng.random((count, 1)) < (0.9, 0.35, 0.62)[i],
                field_errors=rng.normal(size=(field, 3)) * (1e-3, 3e-4, 4e-4)[i],
            )
        )
    return replace(comparison, policies=tuple(policies))


def rows_of(markdown):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in markdown.splitlines() if line[:1] == "|"]


def test_every_cell_of_the_summary_is_its_policys(comparison):
    many = mixed(comparison)
    heads, _, *rows = rows_of(summary_markdown(many))
    expected_heads = ["policy", "picked", "reach mean", "RMS", "p95", "max", "attitude mean", "field mean", "field RMS"]
    assert heads == expected_heads and len(rows) == 3
    for policy, row in zip(many.policies, rows, strict=True):
        mean, rms, p95, largest = numbers(policy.ends.position_error_mm)
        field = numbers(1e3 * np.sqrt(np.sum(policy.field_errors**2, axis=1)))
        assert row == [
            f"**{policy.label}**",
            f"{100 * policy.ends.success.sum() / len(policy.ends.success):.0f} %",
            f"{mean:.2f} mm",
            f"{rms:.2f}",
            f"{p95:.2f}",
            f"{largest:.2f}",
            f"{numbers(policy.ends.attitude_error_deg)[0]:.3f}°",
            f"{field[0]:.2f} mm",
            f"{field[1]:.2f}",
        ]


def test_the_sentences_below_the_summary_count_and_compare_the_last_two(comparison):
    many = mixed(comparison)
    text = summary_markdown(many)
    before, last = (np.linalg.norm(p.field_errors, axis=1) for p in many.policies[1:])
    share = 100 * np.count_nonzero(last < before) / len(last)
    assert 20 < share < 45
    assert f"LS + BPNN errs less than LS at {share:.0f} % of them." in text
    assert f"{len(many.fruit)} reaches, of this one calibration; a pick if the fruit is inside the capture" in text
    assert "capture region, radius 1 mm" in text
    assert f"{len(many.grid.points)} field points, cells of 55 mm." in text
    top = np.percentile(1e3 * np.linalg.norm(many.policies[0].field_errors, axis=1), 99)
    assert f"drawn ×20. **Colour**: its length, 0 to {top:.2f} mm in every field (p99 of raw;" in text
    assert (
        f"qiao2026 (smooth arm), seed {many.seed}" in text
        and "difference drawn ×20; red ball = capture region ×20" in text
    )
    assert colour_scale_mm(many) == pytest.approx(top)
    shown = np.concatenate([1e3 * many.field_uncertainty, 1e3 * np.linalg.norm(many.policies[2].field_errors, axis=1)])
    assert uncertainty_scale_mm(many) == pytest.approx(np.percentile(shown, 99))


def test_a_field_alone_has_its_own_table(without_reaches):
    heads, _, row = rows_of(summary_markdown(without_reaches))
    assert heads == ["policy", "field mean", "field RMS", "field p95", "field max"]
    mean, rms, p95, largest = numbers(1e3 * np.linalg.norm(without_reaches.policies[0].field_errors, axis=1))
    assert row == ["**raw**", f"{mean:.2f} mm", f"{rms:.2f}", f"{p95:.2f}", f"{largest:.2f}"]
    text = summary_markdown(without_reaches)
    assert "reaches" not in text and "errs less" not in text and "Picking" not in text


def test_spread_of_errors_of_any_shape():
    errors = np.random.default_rng(11).gamma(4, 1.5, 48)
    assert error_spread(errors.reshape(6, 8)) == pytest.approx(numbers(errors))
    assert all(np.isnan(value) for value in error_spread([]))


@pytest.mark.parametrize(
    ("at_least", "step"),
    [(1.0, 1.0), (1.01, 2.0), (2.0, 2.0), (2.2, 2.5), (2.6, 5.0), (5.1, 10.0), (0.03, 0.05), (120.0, 200.0)],
)
def test_round_steps_are_1_2_25_and_5(at_least, step):
    assert round_step(at_least) == pytest.approx(step)


def test_ticks_and_bins_are_round_and_hold_everything(comparison):
    assert ticks(1.0) == pytest.approx([0.2 * i for i in range(6)]) and ticks(8.0) == [float(i) for i in range(9)]
    assert ticks(0.9) == pytest.approx([0.2 * i for i in range(5)])  # 0.9 lies between two
    many = mixed(comparison)
    largest = max(policy.ends.position_error_mm.max() for policy in many.policies)
    edges = histogram_edges_mm(many)
    width = edges[1]
    assert width == round_step(largest / 24) and edges[0] == 0.0
    np.testing.assert_allclose(np.diff(edges), width)
    assert edges[-2] <= largest < edges[-1]
    still = replace(
        many, policies=tuple(replace(p, position_error_mm=np.zeros_like(p.position_error_mm)) for p in many.policies)
    )
    assert histogram_edges_mm(still)[1] == round_step(1.0 / 24)


def test_scales_end_at_the_99th_percentile_and_at_one_where_there_is_nothing():
    values = np.arange(1.0, 202.0)
    assert scale_end(values) == pytest.approx(199.0)
    assert scale_end(np.empty(0)) == scale_end(np.zeros(4)) == 1.0


def test_cells_hold_the_means_of_their_points():
    cells, means = cell_means(np.array([[1, 0, 0], [0, 0, 2], [1, 0, 0]]), np.array([1.0, 5.0, 4.0]))
    assert cells.tolist() == [[0, 0, 2], [1, 0, 0]] and means.tolist() == [5.0, 2.5]


def test_how_a_fruit_lies_in_the_true_tool_and_whether_grippers_take_it(comparison):
    """Across and along the tool's axis, and its angle to the nominal arm's at the first policy's command."""
    found = gripped(comparison)
    assert list(found) == [policy.label for policy in comparison.policies]
    for policy in comparison.policies:
        tool = comparison.plant.tool_pose(policy.ends.joint_command)
        wanted = forward(comparison.nominal, comparison.policies[0].ends.joint_command)
        for i, fruit in enumerate(comparison.fruit):
            x, y, along = tool.rotation[i].T @ (fruit - policy.ends.tool_position[i])
            lateral_mm, success = found[policy.label]
            assert lateral_mm[i] == pytest.approx(1e3 * np.hypot(x, y), rel=1e-9)
            angle = np.arccos(min(1.0, tool.rotation[i, :, 2] @ wanted.rotation[i, :, 2]))
            for name in ("li_cup", "compliant_hand"):
                taken = capture_probability(load_gripper(name), np.hypot(x, y), along, angle)
                assert success[name][i] == pytest.approx(taken, abs=1e-6)
    for name, (lateral, curve) in gripper_curves().items():
        assert (lateral[0], lateral[-1], len(lateral)) == (0.0, 40.0, 401)
        np.testing.assert_allclose(curve, capture_probability(load_gripper(name), 1e-3 * lateral, 0.0, 0.0))


@pytest.fixture(scope="module")
def judged(comparison):
    rng, plant = np.random.default_rng(0), comparison.plant
    train, test = (simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (60, 40))
    return assess(plant.arm, fit(plant.arm, train), train, test)


def test_the_tiles_and_the_verdict_of_a_calibration_are_of_the_calibrated_arm(judged, unwritten):
    with unwritten():
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
    found = judged.geometric.identification
    assert f"{found.spent:.1f} of {len(found.identifiability.names)}" in text
    ratio = np.sqrt(judged.fit.identification.chi_square / judged.fit.identification.degrees_of_freedom)
    assert f"{ratio:.2g} ×" in text


def ended(label, misses):
    """A policy of one step an episode, which misses by ``misses`` (mm), NaN where it did not close the gripper."""
    misses = np.asarray(misses, dtype=float)
    n, still = len(misses), np.zeros((len(misses), 1, 3))
    return RecordedPolicy(
        label, policy_key(label), np.ones(n, dtype=int), np.zeros((n, 1, 0)), np.zeros((n, 1, 0)), still,
        np.full((n, 1, 3, 3), np.nan), still, np.nan_to_num(misses)[:, None], np.full((n, 1), np.nan),
        np.zeros((n, 1), dtype=bool), np.zeros((n, 1), dtype=int), misses[:, None], np.zeros((n, 1)),
    )  # fmt: skip


def compared(*policies):
    n = len(policies[0].moments)
    how = {"plant": None, "tolerance_mm": 5.0, "seed": 0, "env_id": "E", "gripper": "g", "period": 0.1}
    return RecordedEpisodes(policies=policies, seeds=tuple(range(n)), **how)


def test_the_verdict_asks_the_same_fruit():
    rng = np.random.default_rng(0)
    easy = rng.uniform(1.8, 2.2, 20)
    bold = ended("bold", np.r_[easy - rng.uniform(0.5, 1.5, 20), rng.uniform(9.0, 11.0, 20)])
    found = compared(ended("careful", np.r_[easy, np.full(20, np.nan)]), bold)
    assert "bold ends nearer to the same fruit" in outcome_sentence(found)
    assert "mm more than bold" in explanation(found)


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_the_verdict_asks_every_policy_in_whatever_order_they_stand(order):
    rng = np.random.default_rng(0)
    one = rng.uniform(0.9, 1.1, 20)
    misses = {"one": one, "two": one + rng.normal(0.0, 0.05, 20), "far": one + rng.uniform(4.0, 6.0, 20)}
    found = outcome_sentence(compared(*(ended(*list(misses.items())[i]) for i in order)))
    assert re.search("^(one ends nearest .* not told apart from two|two ends .* not told apart from one)$", found)


@pytest.mark.parametrize("count", [3, 40])
def test_a_tie_is_said_to_be_one(count):
    misses = np.random.default_rng(0).uniform(0.5, 1.5, count)
    level = compared(ended("one", misses), ended("two", misses + 1e-9))
    assert outcome_sentence(level) == f"one and two end equally near to the fruit: {misses.mean():.3f} mm"
    assert explanation(level).startswith(f"one misses by as much as two for the same {count} fruit.")
    third = compared(*level.policies, ended("far", misses + np.linspace(0.9, 1.1, count)))
    assert outcome_sentence(third).startswith(
        "one and two end nearest in these few" if count < 4 else "one ends nearest"
    )
    if count > 4:  # the same mean, of misses that differ
        even = compared(ended("one", misses), ended("two", misses[::-1]))
        assert outcome_sentence(even).startswith("No policy is told apart from ")


def test_labels_with_marks_stay_in_their_cell_of_the_table(comparison):
    many = mixed(comparison)
    policies = [replace(policy, label=f"a|b*{i}") for i, policy in enumerate(many.policies)]
    text = summary_markdown(replace(many, policies=tuple(policies)))
    heads = next(line for line in text.splitlines() if line.startswith("| policy"))
    lines = [line for line in text.splitlines() if line.startswith(r"| **a\|b\*")]
    assert len(lines) == len(policies)
    assert all(line.replace(r"\|", "").count("|") == heads.count("|") for line in lines)
    assert "a|b" not in text and "b*" not in text


def test_counts_of_one_are_singular():
    misses = ended("one", [np.nan])
    assert explanation(compared(misses)) == "In 1 episode no policy closed the gripper."
    assert "\n\n1 episode of E, simulated" in comparison_markdown(compared(misses))
    assert explanation(compared(ended("one", [np.nan] * 2))) == "In 2 episodes no policy closed the gripper."
