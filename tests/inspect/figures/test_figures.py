from __future__ import annotations

import html
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from pickenv.base import InputError
from pickenv.harvester import Measure
from pickenv.inspect import (
    Comparison,
    PickedTree,
    error_by_condition,
    error_fields,
    error_slices,
    gripper_curves,
    save_figure,
)
from pickenv.inspect.colours import ORANGE, policy_colours, viridis
from pickenv.inspect.figures import plot_calibration, plot_errors, plot_harvest, plot_policies
from pickenv.inspect.figures.plot_policies import METHODS
from pickenv.inspect.figures.style import INK, PIXELS_PER_INCH, WIDTH, change, style
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
CURVES = (X, {"master d2": X, "master theta1": X, "left d4": 0.5 * X}, ("master theta1",))
AGGREGATES = {"plant": {"mean": {"scripted": {"raw": (2.0, (1.0, None)), "LS": (0.5, (0.4, 0.6)), "GP": (0.1, None)}}}}
CYCLES = {("scripted", "raw"): np.geomspace(300, 2, 60), ("ppo", "LS"): np.geomspace(300, 0.5, 50)}


def compared() -> Any:
    """What a map of differences reads of two policies on a grid that is twice as wide as deep."""
    index = np.stack(np.meshgrid(range(9), range(5), range(6), indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.array([0.14, -1.02, 0.08])
    grid = SimpleNamespace(points=corner + 0.1 * (index + 0.5), index=index, corner=corner, step=0.1, shape=(9, 5, 6))
    policies = [
        SimpleNamespace(key=name, label=name, field_errors=miss * np.ones((len(index), 3)))
        for name, miss in (("raw", 2e-3), ("servo, raw", 1e-3))
    ]
    return SimpleNamespace(policies=policies, grid=grid)


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
    "joint curves": (lambda: plot_harvest.joint_displacements(*CURVES), ("(s)", "(mm)", "(deg)")),
    "aggregates": (lambda: plot_policies.aggregates(AGGREGATES), ("(mm)",)),
    "success": (
        lambda: plot_policies.success_against_misalignment(gripper_curves(), {"raw": {"li_cup": (2.0, (1.0, None))}}),
        ("(mm)", "(%)"),
    ),
    "cycle time": (lambda: plot_policies.accuracy_against_cycle_time(CYCLES, 0.05), ("(s)", "(mm)")),
    "ISO 9283": (lambda: plot_policies.accuracy_by_pose({"raw": [1, 2, 3, 4, 5]}, {"raw": [1, 1, 1, 1, 1]}), ("(mm)",)),
    "difference map": (lambda: plot_policies.difference_map(compared()), ("x (m)", "y (m)", "(mm)")),
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
    if name != "box, attitude":
        assert figure_faults(figure) == []  # as it is drawn first, which is how files and pages have it
    path = save_figure(figure, tmp_path / "figure.png")
    assert path.read_bytes()[:4] == b"\x89PNG"


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


def test_a_cell_of_the_uncertainty_map_is_the_mean_of_its_poses() -> None:
    x, y = RNG.uniform(0.0, 1000.0, 400), RNG.uniform(-200.0, 300.0, 400)
    values = RNG.uniform(0.1, 0.2, 400)
    image = plot_calibration.uncertainty_map(x, y, values).axes[0].images[0]
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
    from matplotlib.image import imread

    figure = error_fields(comparison)
    *panels, bar = figure.axes
    assert len(panels) == 3
    assert {panel.get_xlim() for panel in panels} == {panels[0].get_xlim()}
    assert {panel.get_ylim() for panel in panels} == {panels[0].get_ylim()}
    assert "(mm)" in bar.get_xlabel()
    for unit in ("x (m)", "y (m)", "z (m)"):
        assert all(unit in " ".join(text.get_text() for text in panel.texts) for panel in panels)
    arrows = [next(c for c in panel.collections if isinstance(c, Quiver)) for panel in panels]
    lengths = [np.hypot(arrow.U, arrow.V).mean() for arrow in arrows]
    raw, ls, bpnn = (1e3 * np.linalg.norm(policy.field_errors, axis=-1).mean() for policy in comparison.policies)
    assert lengths[0] > lengths[1] > lengths[2]
    assert raw > ls > bpnn
    pixels = imread(save_figure(figure, tmp_path / "fields.png"))
    assert pixels.shape[1] == round(WIDTH * PIXELS_PER_INCH)


def test_arrows_of_a_policy_that_misses_by_far_end_at_its_panel(comparison: Comparison) -> None:
    first, second, third = comparison.policies
    wild = replace(third, field_errors=300.0 * third.field_errors)
    figure = error_fields(replace(comparison, policies=(first, second, wild)))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[::-1, :, :3]
    yellow = (picture == viridis([2.0])[0]).all(axis=-1)
    (left, low), (right, high) = np.rint(figure.axes[2].get_window_extent().get_points()).astype(int)
    within, beside, above = yellow[low:high, left:right], yellow[low:high, :left], yellow[high:]
    assert within.sum() > 20 * beside.sum() and not above.any()


def test_error_fields_of_one_policy_and_a_gappy_grid(without_reaches: Comparison, tmp_path: Path) -> None:
    figure = error_fields(without_reaches)
    assert save_figure(figure, tmp_path / "fields.png").stat().st_size > 0


def test_viridis_saturates_at_its_ends() -> None:
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


HIDDEN = {"_mine": np.array([0.1, 1.0, 5.0, 9.0, 10.0]), "raw": np.array([1.0, 2.0, 3.0, 4.0, 5.0])}
HIDING: dict[str, Callable[[], Figure]] = {
    "per pose": lambda: plot_errors.error_per_pose(HIDDEN),
    "histogram": lambda: plot_errors.error_histogram(HIDDEN),
    "cumulative": lambda: plot_errors.error_cumulative(HIDDEN),
    "against": lambda: plot_errors.error_against(np.arange(5.0), HIDDEN, name="extension", unit="m"),
    "funnel": lambda: plot_harvest.funnel_bars({name: {"present": 10, "collected": 7} for name in HIDDEN}),
    "ISO 9283": lambda: plot_policies.accuracy_by_pose(HIDDEN, HIDDEN),
    "drift": lambda: plot_policies.accuracy_drift(np.arange(5.0), HIDDEN),
    "cycle time": lambda: plot_policies.accuracy_against_cycle_time({("_mine", "raw"): HIDDEN["raw"]}, 0.05),
    "success": lambda: plot_policies.success_against_misalignment(
        gripper_curves(), {"_mine": {"li_cup": (2.0, (1.0, None))}}
    ),
}


@pytest.mark.parametrize("name", HIDING)
def test_legends_have_names_that_matplotlib_would_hide(name: str) -> None:
    figure = HIDING[name]()
    legends = [legend for axes in figure.axes if (legend := axes.get_legend()) is not None] + figure.legends
    assert any(text.get_text().strip().startswith("_mine") for legend in legends for text in legend.get_texts())


# What titles of figures say in numbers, and figures of conditions and aggregates, worked out by hand.
def title(of: Axes | Figure) -> str:
    """Its words, without the breaks of lines and of numbers from their units."""
    words = of.get_suptitle() if isinstance(of, Figure) else of.get_title("left") or of.get_title()
    return " ".join(words.replace("\u00a0", " ").split())


def at(means: list[float], share: float | None = 0.1) -> list[dict[str, Any]]:
    return [
        {"mean_mm": mean, "ci95_mm": None if share is None else (mean * (1 - share), mean * (1 + share))}
        for mean in means
    ]


SWEEPS = {
    "payload": {"levels": [0.0, 1.0, 2.0], "methods": {
        "raw": at([3.0, 4.0, 5.0]), "LS": at([0.5, 0.9, 1.3]), "LS again": at([0.504, 0.9, 1.3]),
        "told": at([0.4, 0.45, 0.52], None),
    }},
    "hours": {"levels": [0.0, 8.0], "methods": {
        "raw": at([3.0, 6.0]), "LS": at([0.3, 0.7]), "LS again": at([0.3, 0.7]), "told": at([0.42, 0.61], None),
    }},
    "weather": {"levels": [20.0], "methods": {}},
}  # fmt: skip


def band_of(axes: Axes, colour: tuple[float, ...]) -> np.ndarray:
    """Corners of the one band of a colour."""
    (found,) = [
        c for c in axes.collections if isinstance(c, PolyCollection) and np.allclose(c.get_facecolor()[0, :3], colour)
    ]
    return np.asarray(found.get_paths()[0].vertices)


def test_conditions_have_a_panel_each_a_line_per_method_and_a_band_where_there_are_intervals() -> None:
    figure = error_by_condition(SWEEPS, {"payload": "payload (kg)"})
    assert [axes.get_xlabel() for axes in figure.axes] == ["payload (kg)", "hours"]
    colours = dict(zip(("raw", "LS", "told"), (ORANGE, *METHODS[:2]), strict=True))
    for axes, sweep in zip(figure.axes, (SWEEPS["payload"], SWEEPS["hours"]), strict=True):
        assert axes.get_yscale() == "log" and len(axes.get_lines()) == 3 and len(axes.collections) == 2
        patterns = set()
        for line, name in zip(axes.get_lines(), colours, strict=True):
            assert line.get_label() == ("least squares = least squares again" if name == "LS" else name)
            assert to_rgb(line.get_color()) == pytest.approx([part / 255 for part in colours[name]])
            means = [each["mean_mm"] for each in sweep["methods"][name]]
            np.testing.assert_array_equal(line.get_xydata(), np.transpose([sweep["levels"], means]))
            patterns.add(str(line.get_linestyle()))
        assert len(patterns) == 3
        for name in ("raw", "LS"):
            corners = band_of(axes, tuple(part / 255 for part in colours[name]))
            ends = [(x, end) for x, each in zip(sweep["levels"], sweep["methods"][name], strict=True)
                    for end in each["ci95_mm"]]  # fmt: skip
            assert all(np.isclose(corners, end).all(axis=1).any() for end in ends)
            assert {y for _, y in corners.tolist()} <= {end for _, end in ends}
    assert title(figure) == "Told: 0.40 to 0.61 mm under conditions that no fit has seen"  # LS is at its worst at 1.3
    apart = {"methods": {**SWEEPS["hours"]["methods"], "LS again": at([0.3, 0.708])}}
    changed = error_by_condition({**SWEEPS, "hours": SWEEPS["hours"] | apart}, {})
    assert len(changed.axes[0].get_lines()) == 4  # more than a hundredth apart somewhere
    assert to_rgb(changed.axes[0].get_lines()[3].get_color()) == pytest.approx([part / 255 for part in METHODS[2]])
    with pytest.raises(InputError, match="no condition was varied"):
        error_by_condition({"weather": SWEEPS["weather"]}, {})


def test_aggregates_are_numbers_with_their_intervals_and_arrows_where_an_end_is_open() -> None:
    given = {
        scene: {
            statistic: {
                "scripted": {"raw": (2.0 * k, (1.5 * k, 2.5 * k)), "LS": (0.5 * k, (None, 0.7 * k))},
                "ppo": {"raw": (3.0 * k, None), "LS": (1e-5, (1e-6, 0.2))},
            }
            for statistic, k in (("median", 1.0), ("IQM", 1.1))
        }
        for scene in ("bare", "leafy")
    }
    figure = plot_policies.aggregates(given)
    raw, ls = ([part / 255 for part in colour] for colour in policy_colours(["raw", "LS"]))
    assert [title(axes) for axes in figure.axes] == ["median", "IQM"]
    assert [axes.get_xlabel() for axes in figure.axes] == ["(mm)", "final position error (mm)"]
    for axes, k in zip(figure.axes, (1.0, 1.1), strict=True):
        assert axes.get_ylim() == (3.5, -0.5) and axes.get_xscale() == "log"
        drawn = [(to_rgb(line.get_color()), line.get_marker(), *map(np.asarray, line.get_data()))
                 for line in axes.get_lines() if len(np.asarray(line.get_xdata()))]  # fmt: skip
        wanted = [
            mark
            for y in (0, 2)
            for mark in (
                (raw, "None", [1.5 * k, 2.5 * k], y - 0.2), (raw, "|", [2.0 * k], y - 0.2),
                (ls, "None", [0.5 * k, 0.7 * k], y + 0.2), (ls, "<", [0.5 * k], y + 0.2), (ls, "|", [0.5 * k], y + 0.2),
                (raw, "|", [3.0 * k], y + 0.8), (ls, "None", [1e-3, 0.2], y + 1.2), (ls, "|", [1e-3], y + 1.2),
            )
        ]  # fmt: skip
        assert len(drawn) == len(wanted)
        for (colour, marker, x, y), (its, mark, places, height) in zip(drawn, wanted, strict=True):
            assert colour == pytest.approx(its) and marker == mark
            assert x == pytest.approx(places) and y == pytest.approx([height] * len(places))
    places = ["scripted, bare", "ppo, bare", "scripted, leafy", "ppo, leafy"]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == places
    assert title(figure) == "median: raw 2.0, least squares 0.50"
    for nothing in ({}, {"bare": {}}):
        with pytest.raises(InputError, match="nothing to draw"):
            plot_policies.aggregates(nothing)


def test_aggregates_of_one_statistic_stand_in_one_panel() -> None:
    line = {"scripted": {"raw": (2.0, (1.5, 2.5)), "LS": (0.5, (0.4, 0.7))}}
    figure = plot_policies.aggregates({"bare": {"median": line}, "leafy": {"median": line}})
    assert [title(axes) for axes in figure.axes] == ["median"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["raw", "least squares"]


def test_a_harvesters_titles_say_how_wide_how_far_and_how_many() -> None:
    throughput = {"dense": {1: Measure(600, 590, 640)}, "thin": {1: Measure(500, 450, 540), 3: Measure(904, 870, 990)}}
    (axes,) = plot_harvest.throughput_by_arms(throughput).axes
    assert title(axes) == "thin: 500/h with 1, 904/h with 3 arms"
    (axes,) = plot_harvest.throughput_by_arms({"dense": throughput["dense"]}).axes
    assert title(axes) == "dense: 600/h with 1 arm"
    cloud = np.array([[[0.0, 0.0, 0.2], [1.25, 0.5, 0.3]], [[0.5, 2.0, 1.0], [0.1, 0.1, 0.1]]])
    above, side = plot_harvest.workspace_cloud(cloud).axes
    assert title(above) == "From above: 1.25 by 2.00 m" and title(side) == "From the side: 1.25 by 0.90 m"
    boxed = plot_harvest.workspace_cloud(cloud, [[[0.0, 1.0], [0.2, 0.4], [0.5, 0.7]]])
    for axes, heights in zip(boxed.axes, ([0.2, 0.4], [0.5, 0.7]), strict=True):
        box = next(np.asarray(line.get_xydata()) for line in axes.get_lines() if len(line.get_xdata()) == 5)
        assert {tuple(corner) for corner in box.tolist()} == {(x, y) for x in (0.0, 1.0) for y in heights}
    t = np.linspace(0.0, 1.0, 5)
    curves = (t, {"master d2": 0.3 * t - 0.1, "master theta1": 0.5 * t, "left d4": 0.2 * t},
                         ("master theta1",))  # fmt: skip
    slides, turns = plot_harvest.joint_displacements(*curves).axes
    assert title(slides) == "Sliding joints: up to 300 mm" and title(turns) == "Turning joints: up to 29 deg"
    _, turns = plot_harvest.joint_displacements(t, {"master d2": t}).axes
    assert title(turns) == "No turning joint"
    (axes,) = plot_harvest.funnel_bars({"a": {"seen": 8, "taken": 2}, "b": {"seen": 0, "taken": 0}}).axes
    assert title(axes) == "Of the fruit seen, taken: a 25, b 0 %"
    places = [[bar.get_x() + bar.get_width() / 2 for bar in group] for group in axes.containers]
    np.testing.assert_allclose(np.mean(places, axis=0), [0, 1], atol=1e-12)  # around their stage's number
    assert places[1][0] > places[0][0]


def test_a_policys_titles_say_where_it_ends_drifts_and_is_worst() -> None:
    curves = {("scripted", "raw"): np.geomspace(300, 2, 60), ("ppo", "LS"): np.full(50, 7.0),
              ("scripted", "LS"): np.geomspace(300, 0.25, 60)}  # fmt: skip
    for said, wanted in (("", "scripted after 3.0 s"), ("field", "scripted on field (rough arm) after 3.0 s")):
        (axes,) = plot_policies.accuracy_against_cycle_time(curves, 0.05, title=said).axes
        assert title(axes) == f"{wanted}: raw 2.0, least squares 0.25 mm"
    (axes,) = plot_policies.accuracy_drift([0.0, 1.0, 2.0], {"raw": [1.0, 2.5, 2.0], "LS": [0.5, 0.25, 0.4]}).axes
    assert title(axes) == "Drift of AP at P1: raw 1.5, least squares 0.25 mm" and axes.get_ylim()[0] == 0.0
    figure = plot_policies.accuracy_by_pose({"raw": [1.0, 5.0]}, {"raw": [0.25, 0.125]})
    assert [title(axes) for axes in figure.axes] == ["Worst AP: raw 5.0 mm", "Worst RP: raw 0.25 mm"]


def test_slices_title_is_the_mean_of_the_slices_that_are_shown() -> None:
    """Of layers along x, one mm longer each, three evenly between the first and the last."""
    for layers, shown in ((1, [0]), (3, [0, 1, 2]), (5, [1, 2, 3]), (7, [2, 3, 4]), (9, [2, 4, 6])):
        parts = [0.1 * np.arange(n) for n in (layers, 2, 2)]
        points = np.stack(np.meshgrid(*parts, indexing="ij"), axis=-1).reshape(-1, 3)
        layer = np.rint(points[:, 0] / 0.1)
        error = 1e-3 * np.stack([np.zeros(len(layer)), 1.0 + layer, np.zeros(len(layer))], axis=1)
        figure = error_slices(points, {"raw": error}, step=0.1)
        assert title(figure).startswith(f"Mean error in slices: raw {1.0 + np.mean(shown):.1f} mm; arrows ×")
        names = [float(re.fullmatch(r"x = (\S+) m", axes.get_title())[1]) for axes in figure.axes[:-1]]  # type: ignore[index]
        assert names == pytest.approx([0.1 * each for each in shown])
    with pytest.raises(InputError, match="an error field needs points"):
        error_slices(points, {"raw": error[:-1]}, step=0.1)


def test_a_title_names_both_of_two_figures_and_the_ends_of_more() -> None:
    assert change({"raw": 1.92, "LS": 0.5}, "mm") == "raw 1.9, LS 0.50 mm"
    assert change({"raw": 1.92, "LS": 0.5, "best": 0.04}, "mm") == "raw 1.9, best 0.040 mm"
