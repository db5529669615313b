"""The default layout of logged episodes: the arms beside how far the tool is from the fruit, and what `info` says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from pickenv.arm import Array, forward
from pickenv.inspect.recordings.blueprint import layout, seen_from
from pickenv.inspect.recordings.episode_entities import GAIN
from pickenv.inspect.recordings.episodes import (
    UNITS,
    Row,
    Scene,
    column,
    distances_mm,
    has_arm,
    has_fruit,
    last_rows,
    number_groups,
)

EYE = np.array([0.75, -1.0, 0.55])
"""From the middle of the scene to the eye, in units of the arm's reach at mid-range."""
SHOWN_TOLERANCES = 5.0
"""The view from the fruit shows errors up to this many tolerances, or those at the ends of episodes if larger."""
DECADES = "log10 of mm (-1: 0.1 mm, 0: 1 mm, 1: 10 mm)"
"""What the axis of distances says; the viewer has no logarithmic axes of its own."""


def episode_blueprint(scene: Scene, rows: Sequence[Row]) -> rrb.Blueprint:
    """The layout for environments whose infos are like those of ``rows``."""
    info = rows[0].info
    plots: list[Any] = [distance_plot("Distance to the fruit")] if distances_mm(rows[:1]) is not None else []
    numbers = number_plots(info)
    plots.append(rrb.Tabs(*numbers, active_tab=len(numbers) - 1) if plots else rrb.Vertical(*numbers))
    if "is_success" in info:
        plots.append(rrb.StateTimelineView(origin="/outcome", contents=["+ /outcome/**"], name="Success"))
    views = _space_views(scene, rows)
    columns = [rrb.Vertical(*views)] if views else []
    return at_the_end(rrb.Horizontal(*columns, rrb.Vertical(*plots)))


def at_the_end(content: Any) -> rrb.Blueprint:
    """A layout on `episode_time`, whose cursor stands at the end of the episodes."""
    return layout(content, "episode_time", play_state="following", loop_mode="off")


def number_plots(info: Mapping[str, Any]) -> list[Any]:
    """One plot for each unit of the numbers in `info`, and one for reward and counts."""
    return [
        rrb.TimeSeriesView(
            origin=f"/metrics/{unit}",
            contents=[f"+ /metrics/{unit}/**"],
            name=f"Numbers in {UNITS[unit]}" if unit in UNITS else "Reward and counts",
        )
        for unit in number_groups(info)
    ]


def distance_plot(name: str) -> Any:
    """How far the tool is from the fruit, on a logarithmic axis that leaves nothing out."""
    return rrb.TimeSeriesView(
        origin="/distance",
        contents=["+ /distance/**"],
        name=f"{name}, {DECADES}; legend: mean at the end",
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftBottom, visible=True),
    )


def _space_views(scene: Scene, rows: Sequence[Row]) -> list[Any]:
    views: list[Any] = []
    info = rows[0].info
    if has_arm(scene, info):
        assert scene.nominal is not None
        base = scene.nominal.base.position
        tool = forward(scene.nominal, (scene.nominal.lower + scene.nominal.upper) / 2.0).position
        middle = (base + tool) / 2.0
        eye = middle + 1.3 * float(np.linalg.norm(tool - base)) * EYE
        arms = ["+ /world/arm/nominal/**", "+ /world/arm/exaggerated/**"]
        fruit = ["+ /world/fruit/**", "+ /world/miss/**"] if has_fruit(info) else []
        name = f"Believed arm (wire), true arm with its deviation ×{GAIN:g}; miss (red)"
        views.append(seen_from(eye, middle, "/world", [*arms, *fruit], name))
    elif has_fruit(info):
        middle, radius = _ball_around(rows)
        name = "Tool, fruit, and between them the miss (red)"
        views.append(seen_from(middle + 2.0 * radius * EYE, middle, "/world", ["+ /world/**"], name))
    if has_fruit(info):
        ends = distances_mm(last_rows(rows))
        assert ends is not None
        views.append(target_view(float(ends.max()), scene.tolerance_mm))
    return views


def target_view(largest_mm: float, tolerance_mm: float | None) -> Any:
    """The true tool seen from the fruit, mm, wide enough for the ``largest_mm`` distance at the end of an episode."""
    span = max(SHOWN_TOLERANCES * (tolerance_mm or 0.0), 1.2 * largest_mm)
    region = "" if tolerance_mm is None else f"; capture region, {tolerance_mm:g} mm (red)"
    name = f"True tool seen from the fruit, mm{region}"
    return seen_from(span * EYE, np.zeros(3), "/target", ["+ /target/**"], name, ground=False)


def _ball_around(rows: Sequence[Row]) -> tuple[Array, float]:
    """Centre ``(3,)`` and radius, m, of a ball that holds all tools and fruit."""
    points = np.concatenate([column(rows, "tool_position"), column(rows, "fruit_position")])
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2.0, max(float(np.linalg.norm(high - low)) / 2.0, 1e-3)
