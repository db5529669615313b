"""What titles of figures say in numbers, and figures of conditions and aggregates, worked out by hand."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from pickenv.base import InputError
from pickenv.harvester import Measure
from pickenv.inspect import JointCurves, error_by_condition, error_slices
from pickenv.inspect.colours import ORANGE, policy_colours
from pickenv.inspect.figures import plot_harvest, plot_policies
from pickenv.inspect.figures.plot_estimates import METHODS


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
            assert line.get_label() == ("LS = LS again" if name == "LS" else name)
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
    assert [title(axes) for axes in figure.axes] == ["bare: median", "IQM", "leafy: median", "IQM"]
    assert [axes.get_xlabel() != "" for axes in figure.axes] == [False, False, True, True]
    for number, axes in enumerate(figure.axes):
        k = (1.0, 1.1)[number % 2]
        assert axes.get_ylim() == (1.5, -0.5) and axes.get_xscale() == "log"
        assert axes.get_yticks().tolist() == [0, 1]
        drawn = [(to_rgb(line.get_color()), line.get_marker(), *map(np.asarray, line.get_data()))
                 for line in axes.get_lines() if len(np.asarray(line.get_xdata()))]  # fmt: skip
        wanted = [
            (raw, "None", [1.5 * k, 2.5 * k], -0.09), (raw, "|", [2.0 * k], -0.09),
            (ls, "None", [0.5 * k, 0.7 * k], 0.09), (ls, "<", [0.5 * k], 0.09), (ls, "|", [0.5 * k], 0.09),
            (raw, "|", [3.0 * k], 0.91), (ls, "None", [1e-3, 0.2], 1.09), (ls, "|", [1e-3], 1.09),
        ]  # fmt: skip
        assert len(drawn) == len(wanted)
        for (colour, marker, x, y), (its, mark, places, height) in zip(drawn, wanted, strict=True):
            assert colour == pytest.approx(its) and marker == mark
            assert x == pytest.approx(places) and y == pytest.approx([height] * len(places))
    assert title(figure) == (
        "scripted on bare: median raw 2.0, LS 0.50 mm scripted on leafy: median raw 2.0, LS 0.50 mm"
    )
    for nothing in ({}, {"bare": {}}):
        with pytest.raises(InputError, match="nothing to draw"):
            plot_policies.aggregates(nothing)


def test_aggregates_of_one_statistic_stand_in_one_column() -> None:
    line = {"scripted": {"raw": (2.0, (1.5, 2.5)), "LS": (0.5, (0.4, 0.7))}}
    figure = plot_policies.aggregates({"bare": {"median": line}, "leafy": {"median": line}})
    assert [title(axes) for axes in figure.axes] == ["bare: median", "leafy: median"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["raw", "LS"]


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
    curves = JointCurves(t, {"master d2": 0.3 * t - 0.1, "master theta1": 0.5 * t, "left d4": 0.2 * t},
                         ("master theta1",))  # fmt: skip
    slides, turns = plot_harvest.joint_displacements(curves).axes
    assert title(slides) == "Sliding joints: up to 300 mm" and title(turns) == "Turning joints: up to 29 deg"
    _, turns = plot_harvest.joint_displacements(JointCurves(t, {"master d2": t}, ())).axes
    assert title(turns) == "No turning joint"
    (axes,) = plot_harvest.funnel_bars({"a": {"seen": 8, "taken": 2}, "b": {"seen": 0, "taken": 0}}).axes
    assert title(axes) == "Of the fruit seen, taken: a 25, b 0 %"
    places = [[bar.get_x() + bar.get_width() / 2 for bar in group] for group in axes.containers]
    np.testing.assert_allclose(np.mean(places, axis=0), [0, 1], atol=1e-12)  # around their stage's number
    assert places[1][0] > places[0][0]


def test_a_policys_titles_say_where_it_ends_drifts_and_is_worst() -> None:
    curves = {("scripted", "raw"): np.geomspace(300, 2, 60), ("ppo", "LS"): np.full(50, 7.0),
              ("scripted", "LS"): np.geomspace(300, 0.25, 60)}  # fmt: skip
    for said, wanted in (("", "scripted after 3.0 s"), ("field", "scripted on field after 3.0 s")):
        (axes,) = plot_policies.accuracy_against_cycle_time(curves, 0.05, title=said).axes
        assert title(axes) == f"{wanted}: raw 2.0, LS 0.25 mm"
    (axes,) = plot_policies.accuracy_drift([0.0, 1.0, 2.0], {"raw": [1.0, 2.5, 2.0], "LS": [0.5, 0.25, 0.4]}).axes
    assert title(axes) == "Drift of AP at P1: raw 1.5, LS 0.25 mm" and axes.get_ylim()[0] == 0.0
    figure = plot_policies.accuracy_by_pose({"raw": [1.0, 5.0]}, {"raw": [0.25, 0.125]})
    assert [title(axes) for axes in figure.axes] == ["Worst AP: raw 5.0 mm", "Worst RP: raw 0.25 mm"]


def test_slices_title_is_the_mean_of_the_slices_that_are_shown() -> None:
    """Of seven layers along x, one mm longer each, the slices evenly between the first and the last."""
    points = np.stack(np.meshgrid(*[0.1 * np.arange(n) for n in (7, 2, 2)], indexing="ij"), axis=-1).reshape(-1, 3)
    layer = np.rint(points[:, 0] / 0.1)
    error = 1e-3 * np.stack([np.zeros(28), 1.0 + layer, np.zeros(28)], axis=1)
    for slices, shown in ((1, [3]), (2, [2, 4]), (3, [2, 3, 4]), (7, range(7)), (9, range(7))):
        figure = error_slices(points, {"raw": error}, step=0.1, axis=0, slices=slices)
        assert title(figure).startswith(f"Mean error in slices: raw {1.0 + np.mean(shown):.1f} mm; arrows ×")
        names = [float(re.fullmatch(r"x = (\S+) m", axes.get_title())[1]) for axes in figure.axes[:-1]]  # type: ignore[index]
        assert names == pytest.approx([0.1 * each for each in shown])
    with pytest.raises(InputError, match="an error field needs points"):
        error_slices(points, {"raw": error[:-1]}, step=0.1)
