"""All of the figures of harvests, pictures, policies, conditions and fields: sizes, axes, words, places."""

from __future__ import annotations

from dataclasses import replace
from textwrap import wrap
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from PIL import Image

from pickenv.base import InputError
from pickenv.harvester import Measure
from pickenv.inspect import (
    Comparison,
    PickedTree,
    error_by_condition,
    error_fields,
    error_slices,
)
from pickenv.inspect.colours import BLUE, GREEN, GREY, ORANGE, OTHERS, Rgb, in_words, viridis
from pickenv.inspect.figures import plot_errors, plot_harvest, plot_policies
from pickenv.inspect.figures.plot_errors import field_gain
from pickenv.inspect.figures.style import INK
from pickenv.inspect.runs.run_folder import eye_direction, shown_box
from pickenv.inspect.runs.traces import ViewErrors

RNG = np.random.default_rng(29)


def share(colour: Rgb) -> Any:
    return pytest.approx([c / 255 for c in colour])


def sized(figure: Figure) -> list[float]:
    return [float(inches) for inches in figure.get_size_inches()]


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def gridded(axes: Any) -> tuple[bool, bool]:
    """Whether upright and level grid lines are drawn."""
    return tuple(bool(axis.get_gridlines()[0].get_visible()) for axis in (axes.xaxis, axes.yaxis))


def xy(artist: Any) -> np.ndarray:
    return np.asarray(artist.get_xydata())


TREE = PickedTree(
    seconds=20.4,
    fruit=RNG.uniform(-1.0, 1.0, size=(6, 3)),
    collected=np.array([True, False, True, True, False, True]),
    by_arm=np.array([0, 0, 1, 1, -1, 0]),
    zones=np.array([[-1.0, 1.0, 0.5, 1.5], [-0.5, 0.5, 1.0, 2.0]]),
    stands=np.array([[2.0, 8.0], [10.0, 18.0]]),
    arm=np.array([0, 1, 0]),
    start=np.array([2.5, 3.0, 10.0]),
    end=np.array([5.0, 6.5, 12.0]),
    held=np.array([0.0, 0.5, 0.0]),
    got=np.array([True, False, True]),
)


def test_gantt() -> None:
    figure = plot_harvest.gantt({"raw": TREE, "best": TREE}, 2)
    assert sized(figure) == pytest.approx([7.2, 0.6 + 2 * (0.55 + 0.22 * 3)])
    for axes in figure.axes:
        assert axes.get_title("left").replace("\u00a0", " ") in (f"{n}: 4 of 6 fruit in 20 s" for n in ("raw", "best"))
        found = sorted(
            (bar.get_x(), bar.get_width(), bar.get_y() + bar.get_height() / 2, bar.get_height()) for bar in axes.patches
        )
        wanted = [(2.0, 6.0, 2, 0.7), (2.5, 0.5, 1, 0.18), (2.5, 2.5, 0, 0.7), (3.0, 3.5, 1, 0.7), (10.0, 2.0, 0, 0.7),
                  (10.0, 8.0, 2, 0.7)]  # fmt: skip
        np.testing.assert_allclose(found, wanted)
        assert gridded(axes) == (True, False) and axes.get_yticks().tolist() == [0, 1, 2]
        (hollow,) = [bar for bar in axes.patches if bar.get_facecolor()[3] == 0.0]
        assert hollow.get_x() == 3.0 and to_rgb(hollow.get_edgecolor()) == share(ORANGE)
    top, bottom = figure.axes
    said = "time on one tree (s); hollow: the cup came back empty, red: held back by a neighbour"
    assert (top.get_xlabel(), bottom.get_xlabel()) == ("", said) and bottom.get_xlim()[0] == 0.0
    with pytest.raises(InputError, match="nothing to draw"):
        plot_harvest.gantt({}, 2)


def test_pick_map() -> None:
    bare = replace(TREE, by_arm=np.full(6, -1), collected=np.zeros(6, dtype=bool))
    figure = plot_harvest.pick_map({"raw": TREE, "none": bare})
    assert sized(figure) == pytest.approx([7.2, 3.2])
    first, second = figure.axes
    assert (first.get_ylabel(), second.get_ylabel()) == ("z above the base (m)", "")
    for axes in (first, second):
        assert axes.get_xlabel() == "x along the row (m)" and axes.xaxis_inverted() and gridded(axes) == (False, False)
        for line, (left, right, low, high) in zip(axes.get_lines(), TREE.zones, strict=True):
            assert xy(line).tolist() == [[left, low], [right, low], [right, high], [left, high], [left, low]]
    one, other, missed = (np.asarray(cloud.get_offsets()) for cloud in first.collections[:3])
    np.testing.assert_allclose(one, TREE.fruit[[0, 5]][:, [0, 2]])
    np.testing.assert_allclose(other, TREE.fruit[[2, 3]][:, [0, 2]])
    np.testing.assert_allclose(missed, TREE.fruit[[1, 4]][:, [0, 2]])
    assert legend(figure) == ["arm 1", "arm 2", "not collected"]
    assert legend(plot_harvest.pick_map({"none": bare})) == ["not collected"]


@pytest.mark.parametrize("count", [1, 3])
def test_funnel(count: int) -> None:
    stages = {"seen": 40, "reachable": 30, "taken": 21}
    given = {f"s{i}": {stage: n - 3 * i for stage, n in stages.items()} for i in range(count)}
    figure = plot_harvest.funnel_bars(given)
    (axes,) = figure.axes
    assert sized(figure) == pytest.approx([7.2, 3.0]) and axes.get_ylim() == (0.0, 101.0)
    assert axes.get_ylabel() == "share of fruit present (%)" and gridded(axes) == (False, True)
    assert axes.get_xticks().tolist() == [0, 1, 2]
    ends = [100 * line["taken"] / line["seen"] for line in given.values()]
    assert legend(figure) == [f"s{i}: {end:.1f} %" for i, end in enumerate(ends)]
    said = ", ".join(f"s{i} {ends[i]:.0f}" for i in dict.fromkeys((0, count - 1)))
    assert axes.get_title("left").replace("\u00a0", " ") == f"Of the fruit seen, taken: {said} %"
    wide = 0.84 / count
    for i, group in enumerate(axes.containers):
        for k, bar in enumerate(group):
            n = list(given[f"s{i}"].values())
            assert bar.get_height() == pytest.approx(100 * n[k] / n[0])
            assert bar.get_width() == pytest.approx(0.92 * wide)
            assert bar.get_x() + bar.get_width() / 2 == pytest.approx(k + wide * (i - (count - 1) / 2))
    lone = plot_harvest.funnel_bars({"a": {"seen": 1, "taken": 1}, "b": {"seen": 0, "taken": 0}}).axes[0]
    assert [bar.get_height() for group in lone.containers for bar in group] == [100, 100, 0, 0]


def test_throughput() -> None:
    given = {"thin": {1: Measure(500, 450, 540), 3: Measure(900, 870, 990)}, "dense": {1: Measure(600, 590, 640)}}
    figure = plot_harvest.throughput_by_arms(given)
    (axes,) = figure.axes
    assert sized(figure) == pytest.approx([3.5, 2.9]) and axes.get_ylim()[0] == 0.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("arms (number)", "picks per hour (1/h)")
    assert legend(figure) == ["thin", "dense"]
    for k, bars in enumerate(axes.containers):
        line, caps, _ = bars.lines
        assert to_rgb(line.get_color()) == share((BLUE, ORANGE)[k]) and line.get_marker() == "o"
        assert len(caps) == 2


def test_workspace() -> None:
    cloud = RNG.normal(size=(50, 2, 3))
    figure = plot_harvest.workspace_cloud(cloud, [[[0.0, 1.0], [0.2, 0.4], [0.5, 0.7]]])
    assert sized(figure) == pytest.approx([7.2, 3.4]) and len(figure.axes) == 2
    assert legend(figure) == ["arm 1", "arm 2", "dense region of the paper"]
    assert legend(plot_harvest.workspace_cloud(cloud)) == ["arm 1", "arm 2"]
    above, side = figure.axes
    assert (above.get_xlabel(), above.get_ylabel(), side.get_ylabel()) == ("x (m)", "y (m)", "z (m)")
    assert side.get_xlabel() == "x (m)"
    wide, deep, high = np.ptp(cloud, axis=(0, 1))
    assert above.get_title("left").replace("\u00a0", " ") == f"From above: {wide:.2f} by {deep:.2f} m"
    assert side.get_title("left").replace("\u00a0", " ") == f"From the side: {wide:.2f} by {high:.2f} m"
    for wrong in (np.zeros((0, 2, 3)), np.zeros((4, 3))):
        with pytest.raises(InputError, match="needs points"):
            plot_harvest.workspace_cloud(wrong)


def test_joint_curves() -> None:
    t = np.linspace(0, 1, 5)
    moved = {"master d2": t, "master theta1": t**2, "left d4": 2 * t, "left theta5": -t, "right d4": 0.5 * t}
    figure = plot_harvest.joint_displacements(t, moved, ("master theta1", "left theta5"))
    assert sized(figure) == pytest.approx([7.2, 3.2]) and sorted(legend(figure)) == sorted(moved)
    slides, turns = figure.axes
    for axes, unit in ((slides, "mm"), (turns, "deg")):
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("time (s)", f"displacement ({unit})")
    lines = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    looks = {name: (to_rgb(line.get_color()), line.get_linestyle()) for name, line in lines.items()}
    assert looks == {
        "master d2": (to_rgb(INK), "-"), "master theta1": (to_rgb(INK), "--"), "left d4": (share(BLUE), "-"),
        "left theta5": (share(BLUE), "--"), "right d4": (share(ORANGE), "-"),
    }  # fmt: skip
    for name, line in lines.items():
        scale = 180 / np.pi if "theta" in str(name) else 1e3
        np.testing.assert_allclose(xy(line), np.stack([t, scale * moved[str(name)]], axis=1))


def views(count: int, picture: Any = None, size: tuple[int, int] = (640, 480)) -> list[ViewErrors]:
    rng = np.random.default_rng(3)
    made = [ViewErrors(f"v{i}", rng.uniform(50, 400, (8, 2)), rng.normal(scale=0.3 + 0.05 * i, size=(8, 2)), size)
            for i in range(count)]  # fmt: skip
    return [replace(view, picture=picture) for view in made]


def assert_arrows(axes: Any, view: ViewErrors, gain: float, top: float, thickness: float) -> None:
    (arrows,) = [c for c in axes.collections if isinstance(c, Quiver)]
    np.testing.assert_allclose(arrows.get_offsets(), view.found - view.errors)
    np.testing.assert_allclose(np.stack([arrows.U, arrows.V], axis=1), view.errors)
    np.testing.assert_allclose(arrows.get_array(), np.hypot(*view.errors.T))
    assert (arrows.scale, arrows.width) == (pytest.approx(1 / gain), pytest.approx(0.004 * thickness))
    assert (arrows.angles, arrows.scale_units, arrows.minlength) == ("xy", "xy", 0.0)
    assert arrows.get_clim() == (0.0, pytest.approx(top, rel=1e-12))
    np.testing.assert_allclose(arrows.get_cmap()([0.0, 1.0])[:, :3], viridis([0.0, 1.0]) / 255, atol=4e-3)


def test_corner_errors() -> None:
    shown = views(3)
    figure = plot_errors.corner_errors(shown)
    axes, bar = figure.axes
    assert sized(figure) == pytest.approx([7.2, 7.2 * 0.72 * 0.75 + 0.6])
    assert (axes.get_xlabel(), axes.get_ylabel(), bar.get_ylabel()) == ("u (px)", "v (px)", "error (px)")
    errors = np.concatenate([view.errors for view in shown])
    top = np.hypot(*errors.T).max()
    gain = max(m * 10.0**p for p in range(4) for m in (1, 2, 3, 4, 5, 8) if m * 10.0**p <= 64.0 / top)
    rms = np.sqrt(np.mean(np.sum(errors**2, axis=1)))
    assert axes.get_title("left") == f"{rms:.3g} px RMS over 24 corners of 3 views, errors drawn ×{gain:g}"
    whole = ViewErrors("all", np.concatenate([view.found for view in shown]), errors, (640, 480))
    assert_arrows(axes, whole, gain, top, 1.0)
    assert not bar.spines["outline"].get_visible()
    none = [replace(view, errors=np.full_like(view.errors, 0.0)) for view in shown]
    (arrows,) = [c for c in plot_errors.corner_errors(none).axes[0].collections if isinstance(c, Quiver)]
    assert 1 / arrows.scale == pytest.approx(5e10) and arrows.get_clim() == (0.0, 1e-9)
    for nothing in ([], [replace(shown[0], found=np.zeros((0, 2)), errors=np.zeros((0, 2)))]):
        with pytest.raises(InputError, match="no corner to draw"):
            plot_errors.corner_errors(nothing)


@pytest.mark.parametrize("count", [1, 4, 11])
def test_view_errors(count: int, tmp_path: Any) -> None:
    Image.fromarray(np.arange(640 * 480, dtype=np.uint32).reshape(480, 640).astype(np.uint8)).save(tmp_path / "p.png")
    shown = views(count, tmp_path / "p.png")
    figure = plot_errors.view_errors(shown)
    worst = sorted(shown, key=lambda view: np.sum(view.errors**2), reverse=True)[:9]
    rows = (len(worst) + 2) // 3
    assert sized(figure) == pytest.approx([7.2, rows * (0.9 * 2.4 * 0.75 + 0.2) + 1.1])
    *panels, bar = figure.axes
    top = max(np.hypot(*view.errors.T).max() for view in shown)
    gain = max(m * 10.0**p for p in range(4) for m in (1, 2, 3, 4, 5, 8) if m * 10.0**p <= 64.0 / top)
    assert len(panels) == 3 * rows and [axes.axison for axes in panels] == [i < len(worst) for i in range(3 * rows)]
    for i, (axes, view) in enumerate(zip(panels, worst, strict=False)):
        assert axes.get_title("left") == f"{view.name}: {view.rms:.3g} px" and gridded(axes) == (False, False)
        assert_arrows(axes, view, gain, top, 2.0)
        assert axes.get_ylabel() == ("v (px)" if i % 3 == 0 else "")
        assert axes.get_xlabel() == ("u (px)" if i + 3 >= len(worst) else "")
        assert axes.xaxis.get_tick_params()["labelbottom"] == (i + 3 >= len(worst))
        (picture,) = axes.get_images()
        assert picture.get_extent() == [-0.5, 639.5, 479.5, -0.5] or tuple(picture.get_extent()) == (
            -0.5, 639.5, 479.5, -0.5,
        )  # fmt: skip
        assert (picture.get_clim(), picture.get_alpha(), picture.get_cmap().name) == ((0, 255), 0.4, "gray")
        assert picture.get_interpolation() == "none" and np.shape(picture.get_array()) == (240, 320)
    ends = " to ".join(dict.fromkeys(f"{view.rms:.3g}" for view in (worst[0], worst[-1])))
    assert figure.get_suptitle() == f"The worst views: {ends} px RMS; errors drawn ×{gain:g}"
    assert bar.get_xlabel() == "error (px)" and not bar.spines["outline"].get_visible()
    assert all(not axes.get_images() for axes in plot_errors.view_errors(views(count)).axes[:-1])


@pytest.mark.parametrize("scenes", [1, 2])
def test_aggregates(scenes: int) -> None:
    line = {"raw": (2.0, (1.5, None)), "LS": (0.5, None), "mine": (0.7, (0.6, 0.9))}
    given: Any = {f"s{i}": {"median": {"scripted": line, "ppo": {"LS": (1.0, (0.9, 1.1))}}} for i in range(scenes)}
    figure = plot_policies.aggregates(given)
    assert sized(figure) == pytest.approx([7.2, 1.0 + 0.17 * 3 * 2 * scenes])
    assert legend(figure) == ["raw", "least squares", "mine"]
    assert figure._suptitle.get_position()[0] == 0.01 and figure._suptitle.get_ha() == "left"
    for handle, colour in zip(figure.legends[0].legend_handles, (ORANGE, BLUE), strict=False):
        assert to_rgb(handle.get_color()) == share(colour)
    (axes,) = figure.axes
    assert axes.get_xlabel() == "final position error (mm)"
    places = [f"{policy}, s{i}" for i in range(scenes) for policy in ("scripted", "ppo")]
    assert [tick.get_text() for tick in axes.get_yticklabels()] == places
    marks = [(xy(drawn)[0].tolist(), drawn.get_marker()) for drawn in axes.get_lines() if len(xy(drawn)) == 1]
    third = 0.8 / 3
    wanted = [(2.0, -third, ">"), (2.0, -third, "|"), (0.5, 0.0, "|"), (0.7, third, "|"), (1.0, 1.0, "|")]
    for number, ((x, y), mark) in enumerate(marks):
        place, height, sign = wanted[number % 5]
        assert (x, y) == pytest.approx((place, height + 2 * (number // 5))) and mark == sign
    spans = [xy(drawn)[:, 0].tolist() for drawn in axes.get_lines() if len(xy(drawn)) == 2]
    assert spans == [[1.5, 2.0], [0.6, 0.9], [0.9, 1.1]] * scenes


def test_success_against_misalignment() -> None:
    x = np.linspace(0.0, 20.0, 5)
    curves: Any = {"cup": (x, [1.0, 0.8, 0.4, 0.1, 0.0]), "hand": (x, [0.9] * 5)}
    points: Any = {
        "raw": {"cup": (3.0, (0.7, (0.6, 0.8))), "hand": (2.0, (0.9, None))},
        "LS": {"cup": (1.0, (0.95, (0.9, None)))},
    }
    figure = plot_policies.success_against_misalignment(curves, points)
    (axes,) = figure.axes
    assert sized(figure) == pytest.approx([7.2, 2.8])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("lateral misalignment (mm)", "success (%)")
    assert axes.get_title("left").replace("\u00a0", " ").replace("\n", " ") == (
        "Taken by cup raw 70, least squares 95 %; by hand raw 90 %"
    )
    assert axes.get_ylim() == (-3.0, 103.0) and axes.get_xlim() == pytest.approx((0.0, 13.0))
    assert legend(figure) == ["cup", "hand", "raw: mean error, success", "least squares: mean error, success"]
    drawn = [(np.round(xy(line), 9).tolist(), line.get_marker(), line.get_linestyle()) for line in axes.get_lines()]
    for (x_, y), pattern in zip(curves.values(), ("-", "--"), strict=True):
        assert (np.stack([x_, 100 * np.asarray(y)], axis=1).round(9).tolist(), "None", pattern) in drawn
    for points_, mark in (
        ([[3.0, 60.0], [3.0, 80.0]], "None"), ([[3.0, 70.0]], "o"), ([[2.0, 90.0]], "s"),
        ([[1.0, 90.0], [1.0, 95.0]], "None"), ([[1.0, 95.0]], "o"),
    ):  # fmt: skip
        assert [(p, m) for p, m, _ in drawn].count((points_, mark)) == 1
    assert sum(len(p) == 2 for p, _, _ in drawn) == 2


def test_cycle_time() -> None:
    curves = {
        ("ppo", "raw"): np.geomspace(300, 2, 60), ("scripted", "LS"): np.geomspace(200, 1e-5, 50),
        ("ppo", "LS"): np.geomspace(100, 0.5, 60),
    }  # fmt: skip
    figure = plot_policies.accuracy_against_cycle_time(curves, 0.05, title="field")
    (axes,) = figure.axes
    assert sized(figure) == pytest.approx([7.2, 3.2]) and axes.get_yscale() == "log"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("cycle time (s)", "mean position error (mm)")
    said = "ppo on field (rough arm) after 3.0 s: raw 2.0, least squares 0.50\u00a0mm"
    assert axes.get_title("left").split("\n") == wrap(said, int((7.2 - 1.2 - 0.75) / 0.083))
    assert legend(figure) == ["best so far", "ppo", "scripted", "raw", "least squares"]
    for line, error, pattern, colour in zip(
        axes.get_lines(), curves.values(), ("-", "--", "-"), (ORANGE, BLUE, BLUE), strict=False
    ):
        count = len(error)
        wanted = np.stack([0.05 * np.arange(1, count + 1), np.maximum(error, 1e-3)], axis=1)
        np.testing.assert_allclose(xy(line), wanted)
        assert (line.get_linestyle(), to_rgb(line.get_color())) == (pattern, share(colour))
    front = axes.get_lines()[3]
    least = np.min([np.maximum(error[:50], 1e-3) for error in curves.values()], axis=0)
    best = [least[: k + 1].min() for k in range(50)]
    np.testing.assert_allclose(xy(front), np.stack([0.05 * np.arange(1, 51), best], axis=1))
    assert (to_rgb(front.get_color()), front.get_linewidth(), front.get_zorder()) == (share(GREY), 6, 0)
    with pytest.raises(InputError, match="nothing to draw"):
        plot_policies.accuracy_against_cycle_time({}, 0.1)
    long = "a policy with a rather long name that"
    ends = {(long, name): curves["ppo", name] for name in ("raw", "LS")}
    (axes,) = plot_policies.accuracy_against_cycle_time(ends, 0.05).axes
    words = f"{long} after 3.0 s: raw 2.0, least squares 0.50\u00a0mm"
    assert axes.get_title("left").split("\n") == wrap(words, 63)


@pytest.mark.parametrize("count", [1, 2])
def test_accuracy_by_pose_and_its_drift(count: int) -> None:
    names = ["raw", "LS"][:count]
    ap, rp = ({name: RNG.gamma(2, 1 / (i + 1), 5) for i, name in enumerate(names)} for _ in range(2))
    figure = plot_policies.accuracy_by_pose(ap, rp)
    assert sized(figure) == pytest.approx([7.2, 2.6]) and len(figure.axes) == 2
    for axes, kind, series in zip(figure.axes, ("AP", "RP"), (ap, rp), strict=True):
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("test pose of ISO 9283 (number)", f"{kind} (mm)")
        assert axes.get_xticks().tolist() == [1, 2, 3, 4, 5] and gridded(axes) == (False, True)
        assert [tick.get_text() for tick in axes.get_xticklabels()] == ["P1", "P2", "P3", "P4", "P5"]
        assert axes.get_ylim()[1] == pytest.approx(1.35 * max(v.max() for v in series.values()))
        said = [text.get_text() for text in axes.get_legend().get_texts()]
        assert said == [f"{in_words(name)}: worst {values.max():.3f} mm" for name, values in series.items()]
        for i, (group, values) in enumerate(zip(axes.containers, series.values(), strict=True)):
            for k, bar in enumerate(group):
                centre = k + 1 + 0.35 * (i - (count - 1) / 2)
                assert (bar.get_x() + bar.get_width() / 2, bar.get_width()) == pytest.approx((centre, 0.33))
                assert bar.get_height() == values[k] and to_rgb(bar.get_facecolor()) == share((ORANGE, BLUE)[i])
    figure = plot_policies.accuracy_drift([0, 4, 8], {name: ap[name][:3] for name in names})
    (axes,) = figure.axes
    assert sized(figure) == pytest.approx([3.5, 2.6])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time since switched on (h)", "AP at P1 (mm)")
    assert axes.get_ylim() == pytest.approx((0.0, 1.2 * max(ap[name][:3].max() for name in names)))
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [in_words(name) for name in names]
    for line, name in zip(axes.get_lines(), names, strict=True):
        np.testing.assert_allclose(xy(line), np.stack([[0, 4, 8], ap[name][:3]], axis=1))
    assert plot_policies.accuracy_drift([0, 1], {"raw": [0.0, 0.0]}).axes[0].get_ylim() == (0.0, 1.0)


def test_conditions() -> None:
    def at(*values: float, ends: bool = True) -> list[dict[str, Any]]:
        return [{"mean_mm": v, "ci95_mm": [0.9 * v, 1.2 * v] if ends else None} for v in values]

    methods = {"raw": at(3.0, 4.0), "LS": at(1.0, 1.1, ends=False), "twin": at(1.0, 1.105), "best": at(0.2, 0.25),
               **{f"m{i}": at(10.0 + i, 20.0) for i in range(5)}}  # fmt: skip
    one = {"levels": [7], "methods": {name: found[:1] for name, found in methods.items()}}
    sweeps = {
        "payload": {"levels": [0, 2], "methods": methods},
        "hours": one,
        "heat": {"levels": [5, 9], "methods": methods},
    }
    figure = error_by_condition(sweeps, {"payload": "payload (kg)"})
    assert sized(figure) == pytest.approx([7.2, 3.3]) and len(figure.axes) == 2
    assert [axes.get_xlabel() for axes in figure.axes] == ["payload (kg)", "heat"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["mean position error (mm)", ""]
    assert figure.axes[0].get_yscale() == "log" and legend(figure)[:3] == ["raw", "least squares = twin", "best"]
    assert figure.get_suptitle() == "Best: 0.20 to 0.25 mm under conditions that no fit has seen"
    assert figure._suptitle.get_position()[0] == 0.01 and figure._suptitle.get_ha() == "left"
    wanted = [ORANGE, BLUE, GREEN, OTHERS[0], OTHERS[1], GREY, BLUE, GREEN]
    for axes, levels in zip(figure.axes, ([0, 2], [5, 9]), strict=True):
        assert [to_rgb(line.get_color()) for line in axes.get_lines()] == [share(colour) for colour in wanted]
        lines = [name for name in methods if name != "twin"]
        for line, name in zip(axes.get_lines(), lines, strict=True):
            np.testing.assert_allclose(
                xy(line), [[x, e["mean_mm"]] for x, e in zip(levels, methods[name], strict=True)]
            )
        assert axes.get_lines()[0].get_linestyle() == "-" and axes.get_lines()[6].get_linestyle() == "-"
        bands = [c for c in axes.collections if isinstance(c, PolyCollection)]
        assert len(bands) == len(lines) - 1  # LS has no intervals
        corners = {tuple(v) for v in np.round(bands[0].get_paths()[0].vertices, 9).tolist()}
        assert {(levels[0], 2.7), (levels[0], 3.6), (levels[1], 3.6), (levels[1], 4.8)} <= corners
    with pytest.raises(InputError, match="no condition was varied"):
        error_by_condition({"hours": one}, {})


def test_slices() -> None:
    points = np.stack(np.meshgrid(*[0.1 * np.arange(n) for n in (6, 5, 4)], indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.add(points, [0.5, -0.3, 0.2])
    fields = {
        "raw": RNG.normal(scale=(1e-3, 1e-3, 1e-4), size=points.shape),
        "LS": RNG.normal(scale=1e-4, size=points.shape),
    }
    figure = error_slices(points, fields, step=0.1)
    panels = figure.axes[:-1]
    assert len(panels) == 2 * 3
    assert figure._suptitle.get_fontweight() == "bold"
    top = np.percentile(1e3 * np.linalg.norm(fields["raw"], axis=1), 99)
    gain = field_gain(0.1, top)
    tall = (7.2 - 0.9) / 3 * (0.4 + 0.2) / (0.5 + 0.2)
    assert sized(figure) == pytest.approx([7.2, 1.4 + 2 * (tall + 0.1)])
    numbers = [float(axes.get_title().split()[2]) for axes in panels[:3]]
    assert set(np.round(numbers, 6)) <= {0.2, 0.3, 0.4, 0.5}
    for i, axes in enumerate(panels):
        row, height = i // 3, numbers[i % 3]
        assert axes.get_title() == (f"z = {height:.2f} m" if row == 0 else "")
        assert axes.get_xlabel() == ("x (m)" if row == 1 else "")
        assert axes.get_ylabel() == (f"{in_words(list(fields)[row])}\ny (m)" if i % 3 == 0 else "")
        assert axes.get_xlim() == pytest.approx((0.4, 1.1)) and axes.get_ylim() == pytest.approx((-0.4, 0.2))
        here = np.isclose(points[:, 2], height)
        (arrows,) = [c for c in axes.collections if isinstance(c, Quiver)]
        wanted = gain * list(fields.values())[row][here][:, :2]
        np.testing.assert_allclose(np.stack([arrows.U, arrows.V], axis=1), wanted)
        assert (arrows.angles, arrows.scale_units, arrows.scale, arrows.width, arrows.minlength) == (
            "xy", "xy", 1.0, 0.008, 0.0,
        )  # fmt: skip
        lengths = 1e3 * np.linalg.norm(list(fields.values())[row][here], axis=1)
        np.testing.assert_allclose(arrows.get_facecolor()[:, :3], viridis(lengths / top) / 255)
        np.testing.assert_allclose(xy(axes.get_lines()[0]), points[here][:, :2])
    for wrong in ({}, {"raw": fields["raw"][:-1]}):
        with pytest.raises(InputError, match="an error field needs points"):
            error_slices(points, wrong, step=0.1)
    with pytest.raises(InputError, match="an error field needs points"):
        error_slices(np.zeros((0, 3)), {"raw": np.zeros((0, 3))}, step=0.1)


def test_the_field_figure(comparison: Comparison) -> None:
    """Its size, its frame, where its words stand, how thick arrows and arm are, and the scale below."""
    figure = error_fields(comparison)
    eye, (centre, radius) = eye_direction(comparison), shown_box(comparison)
    right = np.array([-eye[1], eye[0], 0.0]) / np.hypot(eye[0], eye[1])
    plane = np.stack([right, np.cross(eye, right)], axis=-1)
    low = comparison.grid.corner
    ends = np.stack([low, low + 10 * comparison.grid.step])
    corners = np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    flat = (corners - centre) @ plane
    rim = 0.15 * radius
    left, bottom = flat.min(axis=0) - rim
    far, high = flat.max(axis=0) + np.array([rim, 0.2 * rim])
    assert sized(figure) == pytest.approx([7.2, min(0.93 * 2.4 * (high - bottom) / (far - left), 2.4) + 1.85])
    *panels, bar = figure.axes
    means = [1e3 * np.linalg.norm(p.field_errors, axis=1).mean() for p in comparison.policies]
    said = f"raw {means[0]:#.2g}, least squares + neural network {means[-1]:#.2g} mm"
    assert figure.get_suptitle() == (f"Mean error across the workspace: {said}\nwanted (dot) to true position ×20")
    for axes in panels:
        assert axes.get_xlim() == pytest.approx((left, far)) and axes.get_ylim() == pytest.approx((bottom, high))
        assert not axes.axison and axes.get_aspect() == 1.0
        (words,) = [text for text in axes.texts if text.get_text().startswith("mean ")]
        assert words.get_position() == (0.5, 1.01) and words.get_ha() == "center"
        (arrows,) = [c for c in axes.collections if isinstance(c, Quiver)]
        assert arrows.scale == 1.0 and arrows.angles == arrows.scale_units == "xy"  # as long as their vectors
        dots = [c for c in axes.collections if not isinstance(c, Quiver)]
        np.testing.assert_allclose(dots[0].get_offsets(), arrows.get_offsets(), atol=1e-9)
        looks = {(line.get_linestyle(), line.get_linewidth(), line.get_alpha()) for line in axes.lines[:12]}
        assert looks == {(":", 0.5, 0.6), ("-", 0.9, 1.0)}
        hidden = int(np.argmin((corners - centre) @ eye))
        for line in axes.lines[:12]:
            behind = np.isclose(xy(line), flat[hidden], atol=1e-9).all(axis=1).any()
            assert behind == (line.get_linestyle() == ":")
        rods = [line.get_linewidth() for line in axes.lines[12:]]
        np.testing.assert_allclose(rods, 6.0 - 3.5 * np.arange(len(rods)) / len(rods))
    top = np.percentile(1e3 * np.linalg.norm(comparison.policies[0].field_errors, axis=1), 99)
    assert bar.get_xlim() == pytest.approx((0.0, top)) and not bar.spines["outline"].get_visible()
    assert bar.get_xlabel() == (
        f"position error (mm); the colour saturates above {top:.3g} mm, the 99th percentile of raw"
    )
    steps = np.diff([tick for tick in bar.get_xticks() if tick <= top])
    np.testing.assert_allclose(steps, steps[0])
    for wrong, match in ((replace(comparison, policies=()), "no error field"),):
        with pytest.raises(InputError, match=match):
            error_fields(wrong)
    with pytest.raises(InputError, match="no error field"):
        error_fields(replace(comparison, grid=replace(comparison.grid, points=np.zeros((0, 3)))))
    one = error_fields(replace(comparison, policies=comparison.policies[:1]))
    assert sized(one)[0] == pytest.approx(7.2) and len(one.axes) == 2
