"""All of a figure: its size, axes, words and where they stand, recomputed from the arrays that it was given."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from pickenv.base import InputError
from pickenv.inspect import Comparison
from pickenv.inspect.colours import OTHERS, RED, in_words, viridis
from pickenv.inspect.figures import plot_calibration, plot_errors
from pickenv.inspect.figures.style import INK, SOFT

RNG = np.random.default_rng(23)
ERRORS = {"raw": RNG.gamma(4, 1.5, 40), "LS": RNG.gamma(4, 0.15, 40), "LS + BPNN": RNG.gamma(2, 0.1, 40)}
ORANGE, BLUE, GREEN = ([c / 255 for c in colour] for colour in ((230, 159, 0), (0, 114, 178), (0, 158, 115)))


def words(artist: Any) -> str:
    """A title without its breaks."""
    text = artist.get_suptitle() if isinstance(artist, Figure) else artist.get_title("left")
    return " ".join(text.replace("\u00a0", " ").split())


def is_seen(axis: Any) -> bool:
    """Whether an axis has grid lines."""
    return bool(axis.get_gridlines()[0].get_visible())


def two(value: float) -> str:
    """Two significant digits, or all before the point."""
    return f"{value:.0f}" if value >= 10 else f"{value:#.2g}"


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_error_per_pose() -> None:
    figure = plot_errors.error_per_pose(ERRORS, quantity="attitude error", unit="deg")
    (axes,) = figure.axes
    assert figure.get_size_inches() == pytest.approx([7.2, 2.9])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("test pose (number)", "attitude error (deg)")
    better = int((ERRORS["LS + BPNN"] < ERRORS["raw"]).sum())
    assert words(axes) == f"Least squares + neural network errs less than raw at {better} of 40 poses"
    for line, (label, values) in zip(axes.get_lines(), ERRORS.items(), strict=True):
        assert line.get_label() == f"{in_words(label)}: mean {values.mean():.2f} deg, max {values.max():.2f} deg"
        np.testing.assert_allclose(line.get_xydata(), np.stack([range(1, 41), values], axis=1))
        assert (line.get_marker(), line.get_linestyle()) == ("o", "None")
    assert axes.get_xlim() == (0.5, 40.5) and axes.get_yscale() == "log"
    (axes,) = plot_errors.error_per_pose({"raw": ERRORS["raw"], "LS": ERRORS["LS"][:30]}).axes
    assert words(axes) == f"Least squares at 30 poses: largest {two(ERRORS['LS'][:30].max())}"
    (axes,) = plot_errors.error_per_pose({"raw": ERRORS["raw"]}).axes
    assert words(axes) == f"raw at 40 poses: largest {two(ERRORS['raw'].max())}"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_error_by_method(count: int) -> None:
    shown = dict(list(ERRORS.items())[:count])
    figure = plot_errors.error_by_method(shown, quantity="attitude error", unit="deg")
    (axes,) = figure.axes
    assert figure.get_size_inches() == pytest.approx([(3.5, 3.5, 3.9)[count - 1], 2.9])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("method (number of poses)", "attitude error (deg)")
    means = [values.mean() for values in shown.values()]
    ends = [f"{in_words(label)} {two(values.mean())}" for label, values in shown.items()]
    assert words(axes) == f"Mean attitude error: {', '.join(ends if count < 3 else [ends[0], ends[-1]])} deg"
    assert axes.get_yscale() == "linear" and axes.get_ylim()[0] == 0.0
    assert axes.get_xticks().tolist() == list(range(1, count + 1))
    assert not is_seen(axes.xaxis) and is_seen(axes.yaxis)
    *numbers, told = axes.texts
    np.testing.assert_allclose([text.xy for text in numbers], [(i + 1.3, mean) for i, mean in enumerate(means)])
    assert told.get_text() == "◇ mean (number), ─ median"
    assert (told.xy, told.xycoords) == ((0.0, 1.02), "axes fraction")
    for i, box in enumerate(axes.patches, start=1):
        across = box.get_path().vertices[:, 0]
        assert (across.min(), across.max()) == pytest.approx((i - 0.275, i + 0.275))
    medians = [line for line in axes.get_lines() if line.get_linewidth() == 1.4 and line.get_color() == INK]
    assert len(medians) == count
    diamonds = [line for line in axes.get_lines() if line.get_marker() == "D"]
    assert [line.get_markersize() for line in diamonds] == [4.0] * count
    fliers = [line for line in axes.get_lines() if line.get_marker() == "o"]
    assert {(line.get_markersize(), line.get_markeredgecolor(), line.get_alpha()) for line in fliers} == {
        (2.5, SOFT, 0.7)
    }
    assert sum(line.get_color() == SOFT for line in axes.get_lines()) == 4 * count  # two whiskers, two caps
    for line, values in zip(fliers, shown.values(), strict=True):
        low, high = np.percentile(values, [25, 75])
        far = values[(values < low - 1.5 * (high - low)) | (values > high + 1.5 * (high - low))]
        np.testing.assert_allclose(sorted(line.get_ydata()), sorted(far))


def test_error_histogram() -> None:
    figure = plot_errors.error_histogram(ERRORS)
    (axes,) = figure.axes
    width = next(s for s in (0.1, 0.2, 0.25, 0.5, 1.0) if s >= ERRORS["raw"].max() / 40)
    assert figure.get_size_inches() == pytest.approx([3.5, 2.9])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("position error (mm)", f"share of poses in {width:g} mm (%)")
    medians = [two(np.median(ERRORS[label])) for label in ("raw", "LS + BPNN")]
    assert words(axes) == f"Median: raw {medians[0]}, least squares + neural network {medians[1]} mm"
    assert legend(figure) == [in_words(label) for label in ERRORS] and axes.get_xlim()[0] == 0.0
    for outline, values in zip(axes.patches, ERRORS.values(), strict=True):
        corners = np.asarray(outline.get_path().vertices)
        assert corners[:, 0].max() == pytest.approx(width * (int(values.max() / width) + 1))
        cells = np.bincount((values / width).astype(int))
        assert corners[:, 1].max() == pytest.approx(100 * cells.max() / len(values))
        assert outline.get_facecolor()[3] == 0.35 and outline.get_edgecolor()[3] == 1.0
    for nearer, step in ((39.9, "1"), (40.5, "2"), (0.0, "0.025")):
        assert f"in {step} mm" in plot_errors.error_histogram({"raw": [nearer, 0.0]}).axes[0].get_ylabel()


def test_error_cumulative() -> None:
    figure = plot_errors.error_cumulative(ERRORS)
    (axes,) = figure.axes
    assert figure.get_size_inches() == pytest.approx([3.5, 2.9])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("position error (mm)", "poses within it (%)")
    ends = [two(np.percentile(ERRORS[label], 95)) for label in ("raw", "LS + BPNN")]
    assert words(axes) == f"95 of 100 poses within: raw {ends[0]}, least squares + neural network {ends[1]} mm"
    assert legend(figure) == [in_words(label) for label in ERRORS] and len(axes.get_lines()) == 3
    np.testing.assert_allclose(axes.get_yticks(), [0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    figure = plot_errors.error_cumulative({"raw": [1.0, 2.0, 2.0, 5.0], "LS": [1.0] * 4}, tolerance=2.0)
    assert words(figure.axes[0]) == "Within 2 mm: raw 75, least squares 100 %"
    assert legend(figure) == ["raw", "least squares", "tolerance 2 mm"]
    assert figure.axes[0].get_lines()[-1].get_color() == pytest.approx([c / 255 for c in RED])


@pytest.mark.parametrize("kind", ["continuous", "ties", "eight"])
def test_error_against(kind: str) -> None:
    cause = {
        "continuous": RNG.uniform(1.0, 3.0, 200),
        "ties": np.round(RNG.uniform(1.0, 3.0, 200), 1),
        "eight": np.repeat(np.arange(8.0), 25)[RNG.permutation(200)],
    }[kind]
    cause[0] = cause.max()
    errors = {label: RNG.gamma(4, scale, 200) for label, scale in (("raw", 1.0), ("LS", 0.5), ("LS + BPNN", 0.1))}
    figure = plot_errors.error_against(cause, errors, name="extension", unit="m")
    (axes,) = figure.axes
    assert figure.get_size_inches() == pytest.approx([3.5, 2.9])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("extension (m)", "position error (mm)")
    order = sorted(range(200), key=lambda i: cause[i])  # keeps the order of equals
    parts = [order[i : i + 25] for i in range(0, 200, 25)]
    if kind == "eight":
        parts = [[i for i in order if cause[i] == value] for value in range(8)]
    means = {label: [(np.mean(cause[p]), np.mean(e[p])) for p in parts] for label, e in errors.items()}
    for k, label in enumerate(errors):
        dots, line = axes.get_lines()[2 * k : 2 * k + 2]
        np.testing.assert_allclose(dots.get_xydata(), np.stack([cause, errors[label]], axis=1))
        np.testing.assert_allclose(line.get_xydata(), means[label])
    last = means["LS + BPNN"]
    said = ", ".join(f"{two(error)} mm at {two(place) if place else '0'} m" for place, error in (last[0], last[-1]))
    assert words(axes) == f"Least squares + neural network: {said}"
    (told,) = axes.texts
    assert told.get_text() == "dots: poses, line: means of groups"
    assert (told.xy, told.xycoords) == ((0.0, 1.02), "axes fraction")
    assert axes.get_ylim()[0] == 0.0 and legend(figure) == [in_words(label) for label in errors]
    with pytest.raises(InputError, match="has 199 errors for 200 values of extension"):
        plot_errors.error_against(cause, {"raw": errors["raw"][1:]}, name="extension", unit="m")


def test_least_squares_convergence() -> None:
    for attitude, width in ((None, 3.5), ([0.3, 0.04, 0.02], 7.2)):
        figure = plot_calibration.least_squares_convergence([6.8, 0.9, 0.512], attitude)
        assert figure.get_size_inches() == pytest.approx([width, 2.6])
        assert words(figure.axes[0]) == "Least squares: 6.8 to 0.51 mm in 2 iterations"
        labels = ["position residual, RMS (mm)", "attitude residual, RMS (deg)"][: len(figure.axes)]
        assert [axes.get_ylabel() for axes in figure.axes] == labels and len(figure.axes) == 1 + (attitude is not None)
        for axes, values in zip(figure.axes, ([6.8, 0.9, 0.512], attitude), strict=False):
            assert axes.get_xlabel() == "iteration (number)"
            assert [(t.xy, t.xyann, t.get_ha()) for t in axes.texts] == [
                ((0, values[0]), (5, 6), "left"),
                ((2, values[2]), (5, 6), "right"),
            ]
            low, high = np.log10([min(values), max(values)])
            rim = 0.12 * (high - low)
            assert np.log10(axes.get_ylim()) == pytest.approx([low - rim, high + rim])
    for values, said in (([2.0, 0.5], "2.0 to 0.50 mm in 1 iteration"), ([2.0], "2.0 to 2.0 mm in 0 iterations")):
        (axes,) = plot_calibration.least_squares_convergence(values).axes
        assert words(axes) == f"Least squares: {said}" and len(axes.texts) == len(values)


def test_network_convergence() -> None:
    figure = plot_calibration.network_convergence([1.0, 0.5, 0.31])
    (axes,) = figure.axes
    assert figure.get_size_inches() == pytest.approx([3.5, 2.9])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("epoch (number)", "loss, MSE of normalised targets (–)")
    assert words(axes) == "Training loss: 1.0 to 0.31 in 3 epochs"
    assert axes.get_lines()[0].get_color() == pytest.approx(GREEN)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["training"]


@pytest.mark.parametrize("count", [5, 42, 43])
def test_parameters_are_named_as_far_as_names_fit(count: int) -> None:
    magnitudes = 1e-3 * np.geomspace(5.0, 0.5, count)
    magnitudes[-1] = 0.0
    kept, names = [1] * (count - 2) + [0, 0], [f"parameter{i}" for i in range(count)]
    figure = plot_calibration.parameter_spectrum(magnitudes, kept, names=names)
    (axes,) = figure.axes
    assert figure.get_size_inches() == pytest.approx([7.2, 2.6 + 0.065 * max(map(len, names))])
    drawn = np.maximum(magnitudes, 5e-21)
    for lines, marks, rows in zip(axes.collections, axes.get_lines(), (slice(-2), slice(-2, None)), strict=True):
        place = np.arange(count)[rows]
        np.testing.assert_allclose(marks.get_xydata(), np.stack([place, drawn[rows]], axis=1))
        tops = np.array(lines.get_segments())
        np.testing.assert_allclose(tops[:, 0], np.stack([place, np.full(len(place), 5e-21 / 3)], axis=1))
        np.testing.assert_allclose(tops[:, 1], marks.get_xydata())
    assert legend(figure) == [f"kept ({count - 2})", "dropped (2)"]
    labels, stride = [tick.get_text() for tick in axes.get_xticklabels()], 1 + (count > 42)
    assert labels == [name if i % stride == 0 else "" for i, name in enumerate(names)]
    assert axes.get_xlabel() == ("parameter (22 of 43 are named)" if stride == 2 else "parameter")
    assert axes.get_ylabel() == "|R_ii| (scaled, –)" and axes.get_yscale() == "log"
    red = pytest.approx([c / 255 for c in RED])
    inks = [to_rgb(tick.get_color()) for tick in axes.get_xticklabels()]
    assert inks[:-2] == [to_rgb(INK)] * (count - 2) and inks[-2:] == [red, red]
    assert not is_seen(axes.xaxis) and is_seen(axes.yaxis)


@pytest.mark.parametrize("count", [28, 29])
def test_singular_values_are_numbered_from_one(count: int) -> None:
    values = np.geomspace(8.0, 0.02, count)
    figure = plot_calibration.parameter_spectrum(values, np.ones(count, dtype=bool))
    (axes,) = figure.axes
    assert figure.get_size_inches() == pytest.approx([7.2, 2.6 + 0.065 * 8])
    assert axes.get_xlabel() == "singular value (number)" and axes.get_ylabel() == "singular value (scaled, –)"
    labels = [str(i + 1) if count == 28 or i % 2 == 0 else "" for i in range(count)]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == labels
    assert words(axes) == "Identifiability: condition number 400" and legend(figure) == [f"kept ({count})"]
    figure = plot_calibration.parameter_spectrum(values, np.zeros(count, dtype=bool), threshold=0.0123)
    assert words(figure.axes[0]) == "Identifiability: condition number inf"
    assert legend(figure) == [f"dropped ({count})", "threshold 0.012"]
    for kept, names in ((np.ones(count - 1), None), (np.ones(count), ["a"]), (np.ones(count - 1), ["a"] * count)):
        with pytest.raises(InputError, match="give as many kept flags and names"):
            plot_calibration.parameter_spectrum(values, kept, names=names)
    (axes,) = plot_calibration.parameter_spectrum(np.zeros(2), [False, False]).axes
    assert np.array_equal(axes.get_lines()[0].get_ydata(), [1e-318, 1e-318])


def test_uncertainty_map() -> None:
    x, y, values = RNG.uniform(0.0, 0.49, 80), RNG.uniform(0.0, 0.2, 80), RNG.gamma(2, 0.1, 80)
    x[0], x[1] = 0.0, 0.49
    figure = plot_calibration.uncertainty_map(x, y, values)
    axes, bar = figure.axes
    assert figure.get_size_inches() == pytest.approx([3.5, 3.0])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("distance from base (mm)", "height (mm)")
    assert bar.get_ylabel() == "standard uncertainty (mm)"
    assert words(axes) == f"Median {two(np.median(values))}, largest {two(values.max())} mm"
    (image,) = axes.get_images()
    left, right, bottom, top = image.get_extent()
    step, shape = 0.49 / 26, np.ma.getdata(image.get_array()).shape
    assert right - left == pytest.approx(step * shape[1]) and top - bottom == pytest.approx(step * shape[0])
    assert shape == tuple(int(np.ptp(v) // step) + 1 for v in (y, x))
    assert image.get_interpolation() == "none" and image.origin == "lower"
    np.testing.assert_allclose(image.get_cmap()([0.0, 1.0])[:, :3], viridis([0.0, 1.0]) / 255.0, atol=4e-3)
    assert not is_seen(axes.xaxis) and not bar.spines["outline"].get_visible()
    (image,) = plot_calibration.uncertainty_map([3.0, 3.0], [5.0, 5.0], [0.1, 0.3]).axes[0].get_images()
    assert np.diff(image.get_extent())[[0, 2]] == pytest.approx([1e-9 / 26] * 2, rel=1e-4)


def test_joint_coverage(comparison: Comparison) -> None:
    geometry = replace(comparison.nominal)
    sets = {
        name: RNG.uniform(0.6 * geometry.lower, 0.7 * geometry.upper, (n, 6))
        for name, n in (("fitted", 40), ("network", 30), ("test", 9))
    }
    for joints in sets.values():
        joints[:, 3] = 0.2
    figure = plot_calibration.joint_coverage(geometry, sets)
    assert figure.get_size_inches() == pytest.approx([7.2, 7.2 * 0.95])
    scale = np.where(geometry.prismatic, 1e3, 180 / np.pi)
    units = ["mm" if slides else "deg" for slides in geometry.prismatic]
    shown = [joints * scale for joints in sets.values()]
    low, high = (end(np.concatenate(shown), axis=0) for end in (np.min, np.max))
    whole = (geometry.upper - geometry.lower) * scale
    spans = 100 * (high - low) / whole
    title = figure.get_suptitle()
    assert title == f"Poses span {spans.min():.0f} to {spans.max():.0f} % of the joint ranges; shown is what they span"
    assert figure._suptitle.get_fontweight() == "bold"
    rim = np.where(np.arange(6) == 3, 0.01 * whole, 0.05 * (high - low))
    colours = [[c / 255 for c in OTHERS[i]] for i in (0, 1, 3)]
    grid = np.array(figure.axes).reshape(6, 6)
    for row, column in np.ndindex(6, 6):
        axes = grid[row, column]
        assert axes.axison == (column <= row)
        if column > row:
            continue
        ends = low - rim, high + rim
        assert axes.get_xlim() == pytest.approx((ends[0][column], ends[1][column]))
        assert not is_seen(axes.xaxis)
        assert axes.get_xlabel() == (f"q{column + 1} ({units[column]})" if row == 5 else "")
        ylabel = f"q{row + 1}\n({units[row]})" if column == 0 else ""
        assert axes.get_ylabel() == ("density\n(relative)" if row == 0 else ylabel)
        assert axes.xaxis.label.get_size() == 7.5
        ticks = axes.xaxis.get_tick_params()["labelbottom"], axes.yaxis.get_tick_params()["labelleft"]
        assert ticks == (row == 5, column == 0 and row > 0)
        if row != column:
            assert axes.get_ylim() == pytest.approx((ends[0][row], ends[1][row])) and len(axes.collections) == 3
            for cloud, colour in zip(axes.collections, colours, strict=True):
                assert to_rgb(cloud.get_facecolor()[0]) == pytest.approx(colour)
            continue
        assert axes.get_title() == geometry.joint_names[row] and axes.get_yticks().size == 0
        assert not axes.spines["left"].get_visible()
        for outline, joints, colour in zip(axes.patches[::-1], shown[::-1], colours[::-1], strict=True):
            share, edges = np.histogram(joints[:, row], 12, (ends[0][row], ends[1][row]))
            corners = np.asarray(outline.get_path().vertices)
            assert corners[:, 1].max() == pytest.approx(share.max() / len(joints) / (edges[1] - edges[0]))
            np.testing.assert_allclose(np.unique(np.round(corners[:, 0], 9)), np.round(edges, 9), rtol=1e-6, atol=1e-8)
            assert to_rgb(outline.get_edgecolor()) == pytest.approx(colour) and not outline.get_fill()
    assert legend(figure) == ["fitted (40)", "network (30)", "test (9)"]
    for handle, colour in zip(figure.legends[0].legend_handles, colours, strict=True):
        assert (handle.get_color(), handle.get_marker()) == (pytest.approx(colour), "o")
