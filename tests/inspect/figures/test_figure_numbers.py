"""What figures draw and say, read back from the drawing and computed anew from the arrays they were given.

Which curve has which name is checked by its colour, since a swapped legend is the worst fault that a figure can have.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from pickenv.arm import nominal_points
from pickenv.harvester import Measure
from pickenv.inspect import (
    Comparison,
    PickedTree,
    comparison_drawings,
    error_fields,
    error_slices,
)
from pickenv.inspect.colours import arm_colour, in_words, policy_colours, viridis
from pickenv.inspect.figures import plot_calibration, plot_errors, plot_harvest, plot_policies
from pickenv.inspect.figures.plot_errors import field_gain, round_down, thinned
from pickenv.inspect.figures.style import WIDTH
from pickenv.inspect.runs.run_folder import eye_direction, shown_box

RNG = np.random.default_rng(17)
ERRORS = {"raw": RNG.gamma(4, 1.5, 37), "LS": RNG.gamma(4, 0.15, 50), "LS + BPNN": RNG.gamma(2, 0.1, 44)}
COLOURS = dict(zip(ERRORS, [tuple(c / 255 for c in rgb) for rgb in policy_colours(list(ERRORS))], strict=True))


def colour_of(artist: Any) -> tuple[float, ...]:
    return tuple(round(float(c), 6) for c in to_rgb(artist.get_color()))


def same(first: Iterable[float], second: Iterable[float]) -> bool:
    return np.allclose(list(first), list(second), atol=1e-6)


def legend(figure: Figure, axes: Axes | None = None) -> dict[str, Any]:
    """The handles of a figure's legend by their text."""
    (shown,) = figure.legends if axes is None else [axes.get_legend()]
    return {text.get_text(): handle for text, handle in zip(shown.get_texts(), shown.legend_handles, strict=True)}


def line_in(axes: Axes, colour: Iterable[float], points: int) -> np.ndarray:
    """The one line of a colour with so many points ``(N, 2)``."""
    (found,) = [
        line
        for line in axes.get_lines()
        if same(colour_of(line), colour) and len(np.asarray(line.get_xdata())) == points
    ]
    return np.asarray(found.get_xydata())


def test_error_per_pose() -> None:
    figure = plot_errors.error_per_pose(ERRORS)
    (axes,) = figure.axes
    texts = legend(figure)
    for label, values in ERRORS.items():
        drawn = line_in(axes, COLOURS[label], len(values))
        np.testing.assert_allclose(drawn, np.stack([np.arange(1, len(values) + 1), values], axis=1))
        (text,) = [text for text in texts if text.startswith(f"{in_words(label)}: ")]
        assert text == f"{in_words(label)}: mean {sum(values) / len(values):.2f} mm, max {max(values):.2f} mm"
        assert same(colour_of(texts[text]), COLOURS[label])
    assert axes.get_xlim()[1] == 50.5 and axes.get_yscale() == "log"


@pytest.mark.parametrize("logarithmic", [False, True])
def test_error_by_method(logarithmic: bool) -> None:
    figure = plot_errors.error_by_method(ERRORS, logarithmic=logarithmic, counted="reaches")
    (axes,) = figure.axes
    assert axes.get_yscale() == ("log" if logarithmic else "linear")
    assert axes.get_xlabel() == "method (number of reaches)"
    labels = [label.get_text() for label in axes.get_xticklabels()]
    names = ("raw", "least squares", "least squares\n+ neural network")
    assert labels == [f"{name}\n({len(values)})" for name, values in zip(names, ERRORS.values(), strict=True)]
    medians = [
        line.get_ydata() for line in axes.get_lines() if line.get_linewidth() == 1.4 and len(line.get_ydata()) == 2
    ]
    np.testing.assert_allclose(np.mean(medians, axis=1), [np.median(values) for values in ERRORS.values()])
    means = [float(line.get_ydata()[0]) for line in axes.get_lines() if line.get_marker() == "D"]
    np.testing.assert_allclose(means, [np.mean(values) for values in ERRORS.values()])
    written = [text for text in axes.texts if re.fullmatch(r"[\d.e-]+", text.get_text())]
    assert [text.get_text() for text in written] == [f"{np.mean(values):.3g}" for values in ERRORS.values()]
    np.testing.assert_allclose([text.xy[1] for text in written], means)  # type: ignore[attr-defined]
    for box, label in zip(axes.patches, ERRORS, strict=True):
        assert same(to_rgb(box.get_facecolor()), COLOURS[label])
        low, high = np.percentile(ERRORS[label], [25, 75])
        ends = box.get_path().vertices[:, 1]  # type: ignore[attr-defined]
        np.testing.assert_allclose([ends.min(), ends.max()], [low, high])


def test_error_histogram() -> None:
    figure = plot_errors.error_histogram(ERRORS)
    (axes,) = figure.axes
    width = float(re.search(r"share of poses in ([\d.]+) mm", axes.get_ylabel())[1])  # type: ignore[index]
    for label, values in ERRORS.items():
        (outline,) = [p for p in axes.patches if same(to_rgb(p.get_facecolor()), COLOURS[label])]
        corners = np.asarray(outline.get_path().vertices)
        for k in range(int(values.max() / width) + 1):
            wanted = 100.0 * np.mean((values >= k * width) & (values < (k + 1) * width))
            here = corners[np.isclose(corners[:, 0], k * width)][:, 1]
            assert np.isclose(here, wanted).any()
        assert same(colour_of(legend(figure)[in_words(label)]), COLOURS[label])


def test_error_cumulative() -> None:
    figure = plot_errors.error_cumulative(ERRORS, tolerance=0.7, unit="deg", counted="reaches")
    (axes,) = figure.axes
    for label, values in ERRORS.items():
        drawn = line_in(axes, COLOURS[label], len(values) + 1)
        for x, share in drawn[1:]:
            assert share == pytest.approx(np.mean(values <= x + 1e-12))
        assert same(colour_of(legend(figure)[in_words(label)]), COLOURS[label])
    (line,) = [line for line in axes.get_lines() if line.get_linestyle() == "--"]
    assert list(line.get_xdata()) == [0.7, 0.7] and line.get_label() == "tolerance 0.7 deg"
    assert [float(t.get_text()) for t in axes.get_yticklabels()] == pytest.approx(100 * axes.get_yticks())
    assert "reaches" in axes.get_ylabel()


@pytest.mark.parametrize("values", [np.repeat([0.0, 0.25, 0.5], 8), RNG.uniform(0, 2, 24)])
def test_error_against(values: np.ndarray) -> None:
    errors = {"raw": RNG.gamma(4, 1.0, 24), "LS": RNG.gamma(4, 0.1, 24)}
    figure = plot_errors.error_against(values, errors, name="payload", unit="kg")
    (axes,) = figure.axes
    known = np.unique(values)
    order = np.argsort(values, kind="stable")
    parts = [values == v for v in known] if len(known) <= 8 else np.split(order, 8)
    for label, error in errors.items():
        means = np.array([[np.mean(values[part]), np.mean(error[part])] for part in parts])
        np.testing.assert_allclose(line_in(axes, COLOURS[label], len(parts)), means)
        np.testing.assert_allclose(line_in(axes, COLOURS[label], 24), np.stack([values, error], axis=1))


def test_least_squares_convergence() -> None:
    rms, attitude = [6.8, 0.9, 0.512], [0.31, 0.02, 0.0213]
    figure = plot_calibration.least_squares_convergence(rms, attitude)
    for axes, values, unit in zip(figure.axes, (rms, attitude), ("(mm)", "(deg)"), strict=True):
        np.testing.assert_allclose(axes.get_lines()[0].get_xydata(), np.stack([range(3), values], axis=1))
        assert [t.get_text() for t in axes.texts] == [f"{values[0]:.3g}", f"{values[-1]:.3g}"]
        assert unit in axes.get_ylabel()


def test_iterations_are_counted_in_whole_numbers() -> None:
    for count in (2, 3, 5):
        for axes in plot_calibration.least_squares_convergence(np.geomspace(2.0, 0.02, count)).axes:
            ticks = axes.get_xticks()
            assert np.array_equal(ticks, np.round(ticks))


def test_uncertainty_map() -> None:
    """Square cells from the nearest and lowest pose, each with the mean of its own, at its own place."""
    rng = np.random.default_rng(3)
    x, y, values = rng.uniform(200, 1400, 60), rng.uniform(-300, 500, 60), rng.gamma(2, 0.1, 60)
    figure = plot_calibration.uncertainty_map(x, y, values)
    (image,) = figure.axes[0].get_images()
    step = np.ptp(x) / 26
    left, right, bottom, top = image.get_extent()
    shown = np.ma.getdata(image.get_array())
    assert (left, bottom) == pytest.approx((x.min(), y.min()))
    assert (right - left, top - bottom) == pytest.approx((step * shown.shape[1], step * shown.shape[0]))
    assert right >= x.max() and right - x.max() <= step * (1 + 1e-9) and 0 < top - y.max() <= step
    cell = [np.minimum((v - v.min()) // step, n - 1) for v, n in ((y, shown.shape[0]), (x, shown.shape[1]))]
    for row, column in {(int(a), int(b)) for a, b in zip(*cell, strict=True)}:
        mine = (cell[0] == row) & (cell[1] == column)
        assert shown[row, column] == pytest.approx(values[mine].mean())
    assert np.isfinite(shown).sum() == len({(a, b) for a, b in zip(*cell, strict=True)})
    assert "uncertainty" in figure.axes[1].get_ylabel() and "(mm)" in figure.axes[1].get_ylabel()


def test_network_convergence() -> None:
    loss = [1.0, 0.5, 0.31]
    (axes,) = plot_calibration.network_convergence(loss).axes
    np.testing.assert_allclose(axes.get_lines()[0].get_ydata(), loss)
    assert axes.get_yscale() == "log"


def test_parameter_spectrum() -> None:
    magnitudes, kept = np.array([5.0, 2.0, 0.4, 1e-5, 0.0]), np.array([True, True, True, False, False])
    names = ["a", "b", "c", "d", "e"]
    figure = plot_calibration.parameter_spectrum(magnitudes, kept, names=names, threshold=1e-3)
    (axes,) = figure.axes
    assert axes.get_title("left") == "Identifiability: 3 of 5 parameters kept"
    marks = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.get_lines()}
    np.testing.assert_allclose(marks["kept (3)"], np.stack([[0, 1, 2], magnitudes[:3]], axis=1))
    np.testing.assert_allclose(marks["dropped (2)"][0], [3, 1e-5])
    np.testing.assert_allclose(marks["threshold 0.001"][:, 1], 1e-3)
    (axes,) = plot_calibration.parameter_spectrum(magnitudes, kept).axes
    assert axes.get_title("left") == "Identifiability: condition number 12.5"


def test_joint_coverage(comparison: Comparison) -> None:
    geometry = comparison.nominal
    sets = {
        name: RNG.uniform(geometry.lower, geometry.upper, (n, geometry.joints)) for name, n in (("a", 40), ("b", 9))
    }
    figure = plot_calibration.joint_coverage(geometry, sets)
    scale = [1e3 if slides else 180 / np.pi for slides in geometry.prismatic]
    grid = np.array(figure.axes).reshape(geometry.joints, geometry.joints)
    for row in range(geometry.joints):
        for column in range(row):
            clouds = grid[row, column].collections
            for cloud, joints in zip(clouds, sets.values(), strict=True):
                wanted = np.stack([joints[:, column] * scale[column], joints[:, row] * scale[row]], axis=1)
                np.testing.assert_allclose(cloud.get_offsets(), wanted)
    assert list(legend(figure)) == ["a (40)", "b (9)"]


POINTS = np.stack(np.meshgrid(*[0.1 * np.arange(5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
FIELDS = {"raw": RNG.normal(scale=(1e-3, 1e-5, 1e-3), size=(125, 3)), "LS": RNG.normal(scale=2e-4, size=(125, 3))}


def test_error_slices() -> None:
    figure = error_slices(POINTS, FIELDS, step=0.1)
    gain = float(re.search(r"×([\d.]+)", figure.get_suptitle())[1])  # type: ignore[index]
    *panels, bar = figure.axes
    assert "(mm)" in bar.get_xlabel()
    top = np.percentile(1e3 * np.linalg.norm(FIELDS["raw"], axis=1), 99)
    assert bar.get_xlim() == pytest.approx((0.0, top))
    for i, axes in enumerate(panels):
        label, layer = list(FIELDS)[i // 3], (1, 2, 3)[i % 3]
        if i < 3:
            assert axes.get_title() == f"y = {0.1 * layer:.2f} m"  # across y, where raw errs least
        if i % 3 == 0:
            assert axes.get_ylabel() == f"{in_words(label)}\nz (m)"
        here = np.isclose(POINTS[:, 1], 0.1 * layer)
        (arrows,) = [c for c in axes.collections if isinstance(c, Quiver)]
        np.testing.assert_allclose(np.stack([arrows.U, arrows.V], axis=1), gain * FIELDS[label][here][:, [0, 2]])
        np.testing.assert_allclose(arrows.XY, POINTS[here][:, [0, 2]])
        lengths = 1e3 * np.linalg.norm(FIELDS[label][here], axis=1)
        np.testing.assert_allclose(arrows.get_facecolor()[:, :3], viridis(lengths / top) / 255.0)


def test_error_fields(comparison: Comparison) -> None:
    figure = error_fields(comparison)
    *panels, bar = figure.axes
    assert figure.get_figwidth() == pytest.approx(WIDTH)  # three panels beside each other fill a page
    top = np.percentile(1e3 * np.linalg.norm(comparison.policies[0].field_errors, axis=1), 99)
    assert bar.get_xlim() == pytest.approx((0.0, top))
    titles = ["raw", "least squares", "least squares\n+ neural network"]
    assert [axes.get_title() for axes in panels] == titles
    for axes, policy in zip(panels, comparison.policies, strict=True):
        mm = [1e3 * np.sqrt(x * x + y * y + z * z) for x, y, z in policy.field_errors]
        assert f"mean {sum(mm) / len(mm):.2f} mm, max {max(mm):.2f} mm" in [t.get_text() for t in axes.texts]
        (arrows,) = [c for c in axes.collections if isinstance(c, Quiver)]
        lengths = 1e3 * np.linalg.norm(policy.field_errors, axis=1)
        known = {tuple(c) for c in np.asarray(viridis(lengths / top) / 255.0)}
        assert {tuple(c[:3]) for c in arrows.get_facecolor()} <= known
    assert f"×{field_gain(comparison.grid.step, top):g}" in figure.get_suptitle()


def test_error_fields_are_seen_from_the_eye_the_farthest_arrows_first(comparison: Comparison) -> None:
    """Tail, tip and colour of each arrow, the box with its ranges, and the arm, by an orthographic view of our own."""
    eye, (centre, radius) = eye_direction(comparison), shown_box(comparison)
    right = np.array([-eye[1], eye[0], 0.0]) / np.hypot(eye[0], eye[1])
    plane = np.stack([right, np.cross(eye, right)], axis=-1)
    figure = error_fields(comparison)
    top = np.percentile(1e3 * np.linalg.norm(comparison.policies[0].field_errors, axis=1), 99)
    gain = field_gain(comparison.grid.step, top)
    shown, _ = thinned(comparison)
    shown = shown[np.argsort((comparison.grid.points[shown] - centre) @ eye)]
    low = comparison.grid.corner
    ends = np.stack([low, low + comparison.grid.size])
    corners = {(x, y, z): (ends[[x, y, z], [0, 1, 2]] - centre) @ plane for x in (0, 1) for y in (0, 1) for z in (0, 1)}
    for axes, policy in zip(figure.axes, comparison.policies, strict=False):
        (arrows,) = [c for c in axes.collections if isinstance(c, Quiver)]
        start, error = comparison.grid.points[shown], policy.field_errors[shown]
        np.testing.assert_allclose(arrows.get_offsets(), (start - centre) @ plane, atol=1e-9)
        np.testing.assert_allclose(np.stack([arrows.U, arrows.V], axis=-1), gain * error @ plane, atol=1e-9)
        colours = viridis(1e3 * np.linalg.norm(error, axis=1) / top) / 255.0
        np.testing.assert_allclose(arrows.get_facecolor()[:, :3], colours)
        drawn = {tuple(np.round(line.get_xydata().ravel(), 9)) for line in axes.lines[:12]}
        edges = [(a, b) for a in corners for b in corners if sum(abs(i - j) for i, j in zip(a, b, strict=True)) == 1]
        assert drawn <= {tuple(np.round(np.r_[corners[a], corners[b]], 9)) for a, b in edges} and len(drawn) == 12
        assert sum(line.get_linestyle() == ":" for line in axes.lines[:12]) == 3
        said = [text.get_text() for text in axes.texts]
        ranges = [f"{low:.2f} to {high:.2f}".replace("-", "−") for low, high in ends.T]
        for axis, name in enumerate("xyz"):  # beside the middle of one of its edges
            assert f"{name} (m): {ranges[axis]}" in said
            (place,) = [text.get_position() for text in axes.texts if text.get_text().startswith(f"{name} (m)")]
            middles = [(corners[a] + corners[b]) / 2 for a, b in edges if a[axis] != b[axis]]
            assert min(np.linalg.norm(place - middle) for middle in middles) < 0.2 * radius
        nearest = np.argmin(np.linalg.norm(comparison.fruit - centre, axis=1))
        points = nominal_points(comparison.nominal, comparison.policies[0].ends.joint_command[nearest])
        arm = [line.get_xydata()[0] for line in axes.lines[12:]] + [axes.lines[-1].get_xydata()[1]]
        np.testing.assert_allclose(arm, (points - centre) @ plane, atol=1e-9)


def test_a_gain_is_a_round_number_that_lets_arrows_nearly_touch() -> None:
    steps = np.array([m * 10.0**power for power in range(-7, 8) for m in (1, 2, 3, 4, 5, 8)])
    for value in [*np.exp(np.random.default_rng(0).uniform(-12, 12, 60)), 1.0, 3.0, 80.0, 0.2]:
        assert round_down(value) == pytest.approx(steps[steps <= value * (1 + 1e-9)].max(), rel=1e-12)
    for step, top, gain in (
        *((0.08, 1.0, 20.0), (0.04, 3.0, 20.0)),  # 20 times the longest is 0.25 and 1.5 cells
        *((0.08, 0.99, 80.0), (0.04, 3.01, 10.0)),  # beyond that, so that 1.1 cells hold it
    ):
        assert field_gain(step, top) == gain


@pytest.mark.parametrize(("most", "stride"), [(400, 1), (60, 2), (20, 3)])
def test_every_second_or_third_cell_is_drawn_where_there_are_too_many(
    comparison: Comparison, most: int, stride: int
) -> None:
    index = np.argwhere(np.ones((6, 6, 8), dtype=bool)) if stride > 1 else np.argwhere(np.ones((5, 8, 10), dtype=bool))
    made = replace(comparison, grid=replace(comparison.grid, index=index, points=0.1 * index, step=0.1))
    shown, apart = thinned(made, most)
    assert apart == pytest.approx(0.1 * stride)
    expected = np.flatnonzero(np.all(index % stride == {1: 0, 2: 0, 3: 1}[stride], axis=1))
    np.testing.assert_array_equal(shown, expected)


def test_success_points_are_the_policies_own(comparison: Comparison) -> None:
    """On the figure of a run: each policy's colour stands at its own mean error and share of fruit held."""
    from pickenv.inspect import gripped

    (draw,) = [d.draw for d in comparison_drawings(comparison) if d.name == "success_against_misalignment"]  # type: ignore[union-attr]
    figure = draw()
    (axes,) = figure.axes
    labels = [policy.label for policy in comparison.policies]
    colours = dict(zip(labels, [np.array(c) / 255 for c in policy_colours(labels)], strict=True))
    texts = legend(figure)
    for label, (lateral_mm, success) in gripped(comparison).items():
        assert same(colour_of(texts[in_words(f"{label}: mean error, success")]), colours[label])
        points = [
            np.asarray(line.get_xydata())[0]
            for line in axes.get_lines()
            if same(colour_of(line), colours[label]) and len(np.asarray(line.get_xdata())) == 1
        ]
        wanted = [(np.mean(lateral_mm), 100 * np.mean(p)) for p in success.values()]
        np.testing.assert_allclose(points, wanted)


def test_cycle_time() -> None:
    curves = {
        ("scripted", "raw"): np.geomspace(300, 2, 60),
        ("ppo", "LS"): np.geomspace(200, 0.5, 50),
        ("scripted", "LS"): np.geomspace(300, 1e-5, 60),
    }
    figure = plot_policies.accuracy_against_cycle_time(curves, 0.05)
    (axes,) = figure.axes
    colours = dict(zip(("raw", "LS"), [np.array(c) / 255 for c in policy_colours(["raw", "LS"])], strict=True))
    lines = [line for line in axes.get_lines() if len(np.asarray(line.get_xdata()))]
    for ((_, compensation), error), line in zip(curves.items(), lines, strict=False):
        assert same(colour_of(line), colours[compensation])
        np.testing.assert_allclose(line.get_xdata(), 0.05 * np.arange(1, len(error) + 1))
        np.testing.assert_allclose(line.get_ydata(), np.maximum(error, 1e-3))
    assert lines[0].get_linestyle() == lines[2].get_linestyle() != lines[1].get_linestyle()
    best = [min(max(error[k], 1e-3) for error in curves.values()) for k in range(50)]
    (front,) = [line for line in lines if line.get_label() == "best so far"]
    np.testing.assert_allclose(front.get_ydata(), [min(best[: k + 1]) for k in range(50)])


def test_iso9283_bars_and_drift() -> None:
    accuracy = {"raw": [1.0, 2.0, 3.0, 4.0, 5.25], "LS": [0.1, 0.2, 0.1, 0.2, 0.1]}
    repeated = {"raw": [0.05, 0.06, 0.07, 0.08, 0.09], "LS": [0.01, 0.02, 0.03, 0.01, 0.02]}
    figure = plot_policies.accuracy_by_pose(accuracy, repeated)
    for axes, kind, given in zip(figure.axes, ("AP", "RP"), (accuracy, repeated), strict=True):
        assert axes.get_ylabel() == f"{kind} (mm)"
        bars = [c for c in axes.containers if isinstance(c, BarContainer)]
        for label, group in zip(given, bars, strict=True):
            assert [bar.get_height() for bar in group] == given[label]
            assert same(to_rgb(group[0].get_facecolor()), COLOURS[label])
            assert group.get_label() == f"{in_words(label)}: worst {max(given[label]):.3f} mm"
        ends = np.array([[(bar.get_x(), bar.get_x() + bar.get_width()) for bar in group] for group in bars])
        np.testing.assert_allclose(ends.mean(axis=(0, 2)), np.arange(1, 6))  # around their pose's number
        assert (ends[0, :, 1] <= ends[1, :, 0]).all() and (ends[1, :-1, 1] < ends[0, 1:, 0]).all()  # side by side
        assert [t.get_text() for t in axes.get_xticklabels()] == ["P1", "P2", "P3", "P4", "P5"]
        assert axes.get_xticks().tolist() == [1, 2, 3, 4, 5]
    hours, drift = [0.0, 1.0, 2.5], {"raw": [1.0, 2.0, 2.5], "LS": [0.1, 0.4, 0.3]}
    (axes,) = plot_policies.accuracy_drift(hours, drift).axes
    for label, values in drift.items():
        np.testing.assert_allclose(line_in(axes, COLOURS[label], 3), np.stack([hours, values], axis=1))
    assert axes.get_ylim()[1] > 2.5


def picked_tree() -> PickedTree:
    return PickedTree(
        seconds=20.4,
        fruit=RNG.uniform((-0.8, -1.4, 0.5), (0.8, -1.0, 2.5), size=(6, 3)),
        collected=np.array([True, True, False, True, False, True]),
        by_arm=np.array([0, 1, 1, 0, -1, 2]),
        zones=np.array([[-0.8, 0.0, 0.5, 1.5], [0.0, 0.8, 1.5, 2.5]]),
        stands=np.array([[2.0, 8.0], [10.0, 18.0]]),
        arm=np.array([0, 1, 2]),
        start=np.array([2.0, 3.0, 11.0]),
        end=np.array([5.0, 7.0, 15.0]),
        held=np.array([0.0, 0.5, 0.0]),
        got=np.array([True, False, True]),
    )


def arm(i: int) -> tuple[float, ...]:
    return tuple(c / 255 for c in arm_colour(i))


def test_gantt() -> None:
    tree = picked_tree()
    (axes,) = plot_harvest.gantt({"raw": tree}, 3).axes
    assert axes.get_title("left") == "raw: 4 of 6 fruit in 20 s"
    bars = {
        (round(b.get_x(), 6), round(b.get_width(), 6), round(b.get_y() + b.get_height() / 2, 6)): b
        for b in axes.patches
    }
    for k, (start, end, number, got) in enumerate(zip(tree.start, tree.end, tree.arm, tree.got, strict=True)):
        bar = bars[start, end - start, number]
        assert same(to_rgb(bar.get_edgecolor()), arm(int(number))), k
        assert (bar.get_facecolor()[3] > 0) == bool(got)
    assert (2.0, 6.0, 3.0) in bars and (10.0, 8.0, 3.0) in bars  # the master's stands, in the lane above the arms
    assert (2.5, 0.5, 1.0) in bars  # what arm 2 was held back, before it started
    assert [label.get_text() for label in axes.get_yticklabels()] == ["arm 1", "arm 2", "arm 3", "master stands"]


def test_pick_map_and_funnel() -> None:
    tree = picked_tree()
    few = replace(tree, by_arm=np.array([0, 0, 0, 0, -1, 0]))
    figure = plot_harvest.pick_map({"raw": tree, "few": few})
    axes, other = figure.axes
    collected = int(np.sum(tree.collected))
    for panel, name in ((axes, "raw"), (other, "few")):
        assert panel.get_title("left") == f"{name}: {collected} of 6 collected"
    np.testing.assert_allclose(other.collections[0].get_offsets(), few.fruit[few.collected][:, [0, 2]])
    assert list(legend(figure)) == ["arm 1", "arm 2", "arm 3", "not collected"]
    for number in range(3):
        wanted = tree.fruit[tree.collected & (tree.by_arm == number)][:, [0, 2]]
        (cloud, *_) = [
            c for c in axes.collections if len(c.get_facecolor()) and same(to_rgb(c.get_facecolor()[0]), arm(number))
        ]
        np.testing.assert_allclose(cloud.get_offsets(), wanted)
    funnels = {
        "raw": {"present": 40, "reachable": 30, "collected": 21},
        "best": {"present": 50, "reachable": 45, "collected": 44},
    }
    figure = plot_harvest.funnel_bars(funnels)
    (axes,) = figure.axes
    for i, (group, (name, counts)) in enumerate(zip(axes.containers, funnels.items(), strict=True)):
        heights = [bar.get_height() for bar in group]  # type: ignore[attr-defined]
        assert heights == pytest.approx([100 * n / counts["present"] for n in counts.values()])
        assert group.get_label() == f"{name}: {100 * counts['collected'] / counts['present']:.1f} %"
        wanted = tuple(c / 255 for c in policy_colours(list(funnels))[i])
        assert same(to_rgb(group[0].get_facecolor()), wanted)  # type: ignore[index]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["present", "reachable", "collected"]


def test_throughput_by_arms() -> None:
    given = {"thin": {1: Measure(500, 450, 540), 3: Measure(900, 870, 990)}, "dense": {1: Measure(600, 590, 640)}}
    (axes,) = plot_harvest.throughput_by_arms(given).axes
    bars = [c for c in axes.containers if isinstance(c, ErrorbarContainer)]
    for found, (label, measures) in zip(bars, given.items(), strict=True):
        line, _, (ends,) = found.lines
        assert found.get_label() == label
        np.testing.assert_allclose(line.get_xydata(), [[n, m.value] for n, m in measures.items()])
        for segment, m in zip(ends.get_segments(), measures.values(), strict=True):
            np.testing.assert_allclose(segment[:, 1], [m.low, m.high])


def test_workspace_and_joint_curves() -> None:
    cloud = RNG.normal(size=(50, 3, 3))
    figure = plot_harvest.workspace_cloud(cloud)
    for axes, (a, b) in zip(figure.axes, ((0, 1), (0, 2)), strict=True):
        for number, points in enumerate(axes.collections[:3]):
            np.testing.assert_allclose(points.get_offsets(), cloud[:, number, [a, b]])
            assert same(to_rgb(points.get_facecolor()[0]), arm(number))
        assert axes.get_xlabel() == f"{'xyz'[a]} (m)" and axes.get_ylabel() == f"{'xyz'[b]} (m)"
    t = np.linspace(0, 1, 9)
    curves = (t, {"master d2": t, "master theta1": t**2, "left d4": 2 * t}, ("master theta1",))
    slides, turns = plot_harvest.joint_displacements(*curves).axes
    drawn = {line.get_label(): np.asarray(line.get_ydata()) for axes in (slides, turns) for line in axes.get_lines()}
    np.testing.assert_allclose(drawn["master d2"], 1e3 * t)
    np.testing.assert_allclose(drawn["left d4"], 2e3 * t)
    np.testing.assert_allclose(drawn["master theta1"], 180 / np.pi * t**2)
    assert [line.get_label() for line in turns.get_lines()] == ["master theta1"]


def test_the_figures_of_a_run_are_of_its_own_policies(comparison: Comparison) -> None:
    """Errors of one policy changed: its box moves, and no other's."""
    last = comparison.policies[-1]
    worse = replace(
        last, position_error_mm=3.0 * last.position_error_mm, attitude_error_deg=5.0 * last.attitude_error_deg
    )
    changed = replace(comparison, policies=(*comparison.policies[:-1], worse))

    def means(which: Comparison, name: str) -> np.ndarray:
        (draw,) = [d.draw for d in comparison_drawings(which) if d.name == name]  # type: ignore[union-attr]
        (axes,) = draw().axes
        return np.array([float(line.get_ydata()[0]) for line in axes.get_lines() if line.get_marker() == "D"])

    for name, field, factor in (
        ("position_error_by_policy", "position_error_mm", 3.0),
        ("attitude_error_by_policy", "attitude_error_deg", 5.0),
    ):
        before = [np.mean(getattr(policy, field)) for policy in comparison.policies]
        np.testing.assert_allclose(means(comparison, name), before)
        np.testing.assert_allclose(means(changed, name), [*before[:-1], factor * before[-1]])
