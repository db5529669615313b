from __future__ import annotations

import html
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.harvester import Measure
from pickenv.inspect import (
    Comparison,
    JointCurves,
    PickedTree,
    error_fields,
    error_slices,
    gripper_curves,
    save_figure,
)
from pickenv.inspect.colours import policy_colours, viridis
from pickenv.inspect.figures import plot_calibration, plot_errors, plot_harvest, plot_policies
from pickenv.inspect.figures.style import INK, PIXELS_PER_INCH, WIDTH, style
from tests.inspect.figures.figure_lint import figure_faults

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RNG = np.random.default_rng(5)
ERRORS = {"raw": RNG.gamma(4, 1.5, 50), "LS": RNG.gamma(4, 0.15, 50), "LS + BPNN": RNG.gamma(4, 0.1, 50)}
NAMES = [f"theta{i}" for i in range(12)]
MAGNITUDES = np.geomspace(1.0, 1e-4, 12)
KEPT = np.arange(12) < 10

X = np.linspace(0.6, 1.6, 50)
GRID = np.stack(np.meshgrid(*[0.1 * np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
FIELDS = {"raw": RNG.normal(scale=(1e-3, 1e-5, 1e-3), size=(64, 3)), "LS": RNG.normal(scale=1e-4, size=(64, 3))}
TREE = PickedTree(
    seconds=20.0,
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
CURVES = JointCurves(X, {"master d2": X, "master theta1": X, "left d4": 0.5 * X}, ("master theta1",))
AGGREGATES = {"plant": {"mean": {"scripted": {"raw": (2.0, (1.0, None)), "LS": (0.5, (0.4, 0.6)), "GP": (0.1, None)}}}}
CYCLES = {("scripted", "raw"): np.geomspace(300, 2, 60), ("ppo", "LS"): np.geomspace(300, 0.5, 50)}

PLOTS: dict[str, tuple[Callable[[], Figure], tuple[str, ...]]] = {
    "per pose": (lambda: plot_errors.error_per_pose(ERRORS), ("(number)", "(mm)")),
    "box": (lambda: plot_errors.error_by_method(ERRORS), ("(mm)",)),
    "box, attitude": (
        lambda: plot_errors.error_by_method(ERRORS, quantity="attitude error", unit="deg", logarithmic=True),
        ("(deg)",),
    ),
    "histogram": (lambda: plot_errors.error_histogram(ERRORS), ("(mm)", "(%)")),
    "cumulative": (lambda: plot_errors.error_cumulative(ERRORS, tolerance=5.0), ("(mm)", "(%)")),
    "against": (lambda: plot_errors.error_against(X, ERRORS, name="extension", unit="m"), ("extension (m)", "(mm)")),
    "least squares": (
        lambda: plot_calibration.least_squares_convergence([6.8, 0.9, 0.5], [0.3, 0.02, 0.02]),
        ("(number)", "(mm)", "(deg)"),
    ),
    "network": (
        lambda: plot_calibration.network_convergence([1.0, 0.3]),
        ("(number)", "(–)"),
    ),
    "diagonal of R": (
        lambda: plot_calibration.parameter_spectrum(MAGNITUDES, KEPT, names=NAMES, threshold=2e-4),
        ("(scaled, –)",),
    ),
    "singular values": (
        lambda: plot_calibration.parameter_spectrum(np.append(MAGNITUDES[:-1], 0.0), KEPT),
        ("(scaled, –)",),
    ),
    "uncertainty": (lambda: plot_calibration.uncertainty_map(1e3 * X, 900 * X**2, X), ("(mm)",)),
    "slices": (lambda: error_slices(GRID, FIELDS, step=0.1), ("x (m)", "z (m)", "(mm)")),
    "gantt": (lambda: plot_harvest.gantt({"raw": TREE, "best": TREE}, 3), ("(s)",)),
    "pick map": (lambda: plot_harvest.pick_map({"raw": TREE}), ("(m)",)),
    "funnel": (lambda: plot_harvest.funnel_bars({"fixed": {"present": 10, "collected": 7}}), ("(%)",)),
    "throughput": (
        lambda: plot_harvest.throughput_by_arms({"thin": {1: Measure(500, 450, 540), 2: Measure(900, 800, 990)}}),
        ("(number)", "(1/h)"),
    ),
    "workspace": (lambda: plot_harvest.workspace_cloud(GRID[:, None], [((0, 1), (0, 1), (0, 1))]), ("x (m)", "z (m)")),
    "joint curves": (lambda: plot_harvest.joint_displacements(CURVES), ("(s)", "(mm)", "(deg)")),
    "aggregates": (lambda: plot_policies.aggregates(AGGREGATES), ("(mm)",)),
    "success": (
        lambda: plot_policies.success_against_misalignment(gripper_curves(), {"raw": {"li_cup": (2.0, (1.0, None))}}),
        ("(mm)", "(%)"),
    ),
    "cycle time": (lambda: plot_policies.accuracy_against_cycle_time(CYCLES, 0.05), ("(s)", "(mm)")),
    "ISO 9283": (lambda: plot_policies.accuracy_by_pose({"raw": [1, 2, 3, 4, 5]}, {"raw": [1, 1, 1, 1, 1]}), ("(mm)",)),
    "drift": (lambda: plot_policies.accuracy_drift([0, 1, 2], {"raw": [1.0, 2.0, 2.5]}), ("(h)", "(mm)")),
}


def texts(figure: Figure) -> str:
    labels = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel(), axes.get_title("left"))]
    labels += [t.get_text() for axes in figure.axes for t in [*axes.texts, *axes.get_xticklabels(), axes.title]]
    return "\n".join([*labels, figure.get_suptitle()])


@pytest.mark.parametrize("name", PLOTS)
def test_axes_name_their_units_the_file_is_written_and_nothing_is_at_fault(name: str, tmp_path: Path) -> None:
    make, units = PLOTS[name]
    figure = make()
    for unit in units:
        assert unit in texts(figure)
    labels = {label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel())} - {"", "parameter"}
    assert labels
    assert [label for label in labels if "(" not in label] == []
    path = save_figure(figure, tmp_path / "figure.png")
    assert path.read_bytes()[:4] == b"\x89PNG"
    if name != "box, attitude":
        assert figure_faults(figure) == []


def test_dropped_parameters_are_named_in_red() -> None:
    figure = plot_calibration.parameter_spectrum(MAGNITUDES, KEPT, names=NAMES)
    labels = figure.axes[0].get_xticklabels()
    assert [label.get_text() for label in labels] == NAMES
    assert [label.get_color() == INK for label in labels] == list(KEPT)


def test_each_method_keeps_its_colour() -> None:
    expected = policy_colours(["raw", "ls", "ls_bpnn"])
    assert policy_colours(list(ERRORS)) == expected
    lines = plot_errors.error_per_pose(ERRORS).axes[0].get_lines()
    drawn = [tuple(round(255 * float(c)) for c in line.get_color()) for line in lines]  # type: ignore[arg-type]
    assert drawn == expected
    assert len(set(policy_colours(["raw", "servo", "rl", "ls"]))) == 4


def test_joint_coverage_is_framed_by_what_was_measured_in_degrees_and_millimetres(
    comparison: Comparison, tmp_path: Path
) -> None:
    geometry = comparison.nominal
    low, span = geometry.lower, geometry.upper - geometry.lower
    q = low + span * np.concatenate([[np.full(geometry.joints, 0.4)], RNG.uniform(0.4, 0.5, (38, 6)), [[0.5] * 6]])
    figure = plot_calibration.joint_coverage(geometry, {"identification": q, "training": q[:20], "test": q[:10]})
    bottom = figure.axes[-geometry.joints :]
    units = ["mm" if slides else "deg" for slides in geometry.prismatic]
    assert [axes.get_xlabel() for axes in bottom] == [f"q{i + 1} ({unit})" for i, unit in enumerate(units)]
    assert "10 % of the joint ranges" in figure.get_suptitle()
    rim = np.array([0.395, 0.505])  # a twentieth of what is spanned, on either side
    np.testing.assert_allclose(bottom[0].get_xlim(), np.degrees(low[0] + span[0] * rim))
    np.testing.assert_allclose(bottom[1].get_xlim(), 1e3 * (low[1] + span[1] * rim))
    assert save_figure(figure, tmp_path / "coverage.png").stat().st_size > 0


def test_marks_stand_where_the_joints_do_within_their_limits(comparison: Comparison) -> None:
    geometry = comparison.nominal
    share = np.linspace(0.0, 1.0, 5)[:, None] * np.ones(geometry.joints)
    q = geometry.lower + share * (geometry.upper - geometry.lower)
    (axes,) = plot_calibration.joint_ranges(geometry, q).axes
    marks = [np.asarray(line.get_xydata()) for line in axes.get_lines()[1::2]]
    for row, places in enumerate(marks):
        np.testing.assert_allclose(places[::3, 0], [0.0, 25.0, 50.0, 75.0, 100.0], atol=0.06)
        assert np.isnan(places[2::3, 1]).all()
        np.testing.assert_allclose((places[0::3, 1] + places[1::3, 1]) / 2.0, row)
    named = [label.get_text() for label in axes.get_yticklabels()]
    assert [name.split("  ")[0] for name in named] == list(geometry.joint_names)
    assert [name.split()[-1] for name in named] == ["mm" if slides else "deg" for slides in geometry.prismatic]


def test_poses_beyond_their_limits_stay_on_the_paper(comparison: Comparison) -> None:
    geometry = comparison.nominal
    q = np.stack([2.0 * geometry.lower - geometry.upper, 2.0 * geometry.upper - geometry.lower])
    (axes,) = plot_calibration.joint_ranges(geometry, q).axes
    low, high = axes.get_xlim()
    for line in axes.get_lines():
        assert ((low <= line.get_xdata()) & (line.get_xdata() <= high)).all()


def test_a_cell_of_the_uncertainty_map_is_the_mean_of_its_poses() -> None:
    x, y = RNG.uniform(0.0, 1000.0, 400), RNG.uniform(-200.0, 300.0, 400)
    values = RNG.uniform(0.1, 0.2, 400)
    image = plot_calibration.uncertainty_map(x, y, values, cells=10).axes[0].images[0]
    mean, (left, right, bottom, top) = np.ma.filled(image.get_array(), np.nan), image.get_extent()
    assert left == x.min() and bottom == y.min() and right >= x.max() and top >= y.max()
    width, height = (right - left) / mean.shape[1], (top - bottom) / mean.shape[0]
    assert width == pytest.approx(height)
    for row, column in np.ndindex(*mean.shape):
        here = ((x - left) // width == column) & ((y - bottom) // height == row)
        np.testing.assert_allclose(mean[row, column], values[here].mean() if here.any() else np.nan)


def test_wide_decades_are_written_as_plain_numbers() -> None:
    figure = plot_calibration.parameter_spectrum([1.0, 1e-14], [True, False], names=["a", "b"])
    with style():
        figure.draw_without_rendering()
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert all(float(label) > 0.0 for label in labels if label)


def test_error_fields_share_view_scale_and_gain(comparison: Comparison, tmp_path: Path) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.image import imread

    figure = error_fields(comparison, gain=30.0)
    *panels, bar = figure.axes
    assert len(panels) == 3
    assert {panel.get_xlim() for panel in panels} == {panels[0].get_xlim()}
    assert {panel.get_ylim() for panel in panels} == {panels[0].get_ylim()}
    assert "(mm)" in bar.get_xlabel()
    assert "×30" in figure.get_suptitle()
    for unit in ("x (m)", "y (m)", "z (m)"):
        assert all(unit in [text.get_text() for text in panel.texts] for panel in panels)
    arrows = [next(c for c in panel.collections if isinstance(c, PolyCollection)) for panel in panels]
    lengths = [np.mean([np.ptp(path.vertices, axis=0).max() for path in arrow.get_paths()]) for arrow in arrows]
    raw, ls, bpnn = (1e3 * np.linalg.norm(policy.field_errors, axis=-1).mean() for policy in comparison.policies)
    assert lengths[0] > lengths[1] > lengths[2]
    assert raw > ls > bpnn
    pixels = imread(save_figure(figure, tmp_path / "fields.png"))
    assert pixels.shape[1] == round(WIDTH * PIXELS_PER_INCH)


def test_error_fields_of_one_policy_and_a_gappy_grid(without_reaches: Comparison, tmp_path: Path) -> None:
    figure = error_fields(without_reaches)
    assert save_figure(figure, tmp_path / "fields.png").stat().st_size > 0


def test_viridis_is_the_one_that_matplotlib_has() -> None:
    import matplotlib

    t = np.linspace(0.0, 1.0, 101)
    theirs = matplotlib.colormaps["viridis"](t)[:, :3] * 255
    assert np.abs(viridis(t).astype(float) - theirs).max() < 6
    np.testing.assert_array_equal(viridis([-1.0, 2.0]), viridis([0.0, 1.0]))


def test_drawing_leaves_the_settings_of_matplotlib_alone() -> None:
    import matplotlib

    before = dict(matplotlib.rcParams)
    plot_errors.error_per_pose(ERRORS)
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("values", [[], [1.0, np.nan]])
def test_a_series_that_cannot_be_drawn_is_named(values: list[float]) -> None:
    with pytest.raises(InputError, match="'LS'"):
        plot_errors.error_per_pose({"raw": [1.0], "LS": values})


def test_an_unknown_format_and_a_folder_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    figure = plot_errors.error_per_pose(ERRORS)
    with pytest.raises(InputError, match="png"):
        save_figure(figure, tmp_path / "figure.docx")
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InputError, match="cannot write"):
        save_figure(figure, tmp_path / "file" / "figure.png")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


ODD_NAMES = [r"$\foo{$", "$J_1$", "$", "50 $", r"a_b^c \alpha {", "$$"]


def test_names_are_drawn_as_they_are_whatever_formulae_they_look_like(tmp_path):
    curves = {name: np.array([0.1, 1.0, 10.0]) for name in (*ODD_NAMES, "raw")}
    for draw in (plot_errors.error_by_method, plot_errors.error_cumulative):
        for suffix in ("svg", "png", "pdf"):
            save_figure(draw(curves, counted="reaches"), tmp_path / f"figure.{suffix}")
        with style(**{"svg.fonttype": "none"}):
            draw(curves, counted="reaches").savefig(tmp_path / "text.svg")
        words = html.unescape((tmp_path / "text.svg").read_text(encoding="utf-8"))
        assert all(name in words for name in ODD_NAMES) and "mathdefault" not in words
