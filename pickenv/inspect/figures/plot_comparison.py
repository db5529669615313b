"""Figures of a comparison of policies: distance over time, fruit by fruit, and where which of two misses less."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pickenv.inspect.colours import RED, policy_colours
from pickenv.inspect.figures import style
from pickenv.inspect.runs.comparison import Comparison
from pickenv.inspect.runs.comparison_summary import SCALE_PERCENTILE, cell_means, field_mm
from pickenv.inspect.runs.episode_summary import episode_misses, outcome_sentence
from pickenv.inspect.runs.recorded_episodes import RecordedEpisodes

SMALLEST = 1e-3
"""Distances below are drawn here, mm."""
HEIGHTS = 3
"""Layers of the workspace that a map of differences shows."""


def distance_over_time(episodes: RecordedEpisodes) -> Figure:
    """Distance between tool and fruit in every episode, on a logarithmic axis, with what the gripper forgives."""
    keys = [policy.key for policy in episodes.policies]
    with style.new_figure(style.WIDTH, 3.2) as figure:
        axes = figure.add_subplot(xlabel="time in the episode (s)", ylabel="distance to the fruit (mm)", yscale="log")
        for policy, colour in zip(episodes.policies, style.rgb(policy_colours(keys)), strict=True):
            for distance, moments in zip(policy.position_error_mm, policy.moments, strict=True):
                shown = np.maximum(distance[:moments], SMALLEST)
                axes.plot(episodes.period * np.arange(moments), shown, color=colour, linewidth=0.7, alpha=0.7)
            axes.plot([], [], color=colour, linewidth=3.0, label=policy.label)
        _forgiven(axes, episodes)
        axes.set_title(outcome_sentence(episodes))
        style.plain_decades(axes.yaxis)
        figure.legend(loc="outside lower center", ncols=len(keys) + 1)
    return figure


def _forgiven(axes: Any, episodes: RecordedEpisodes) -> None:
    """What the gripper forgives, as a line."""
    name = f"{episodes.gripper} forgives {episodes.tolerance_mm:g} mm"
    axes.axhline(episodes.tolerance_mm, color=style.rgb([RED])[0], linestyle="--", label=name)


def misses_by_fruit(episodes: RecordedEpisodes) -> Figure:
    """The miss at each fruit with every policy, fruit in the order of the first policy's miss."""
    first, last = episodes.policies[0], episodes.policies[-1]
    order = np.argsort(episode_misses(first))
    keys = [policy.key for policy in episodes.policies]
    with style.new_figure(style.WIDTH, 2.8) as figure:
        axes = figure.add_subplot(
            xlabel=f"fruit, by the miss of {first.label} (number)", ylabel="miss (mm)", yscale="log"
        )
        for policy, colour in zip(episodes.policies, style.rgb(policy_colours(keys)), strict=True):
            misses = np.maximum(episode_misses(policy)[order], SMALLEST)
            axes.plot(np.arange(1, len(order) + 1), misses, "o", color=colour, markersize=4, label=policy.label)
        _forgiven(axes, episodes)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        nearer = int(np.sum(episode_misses(last) < episode_misses(first)))
        axes.set_title(f"{last.label} misses less than {first.label} at {nearer} of {len(order)} fruit")
        style.plain_decades(axes.yaxis)
        figure.legend(loc="outside lower center", ncols=len(keys) + 1)
    return figure


def difference_map(comparison: Comparison) -> Figure:
    """Where the last policy misses less than the first: layers of the workspace seen from above."""
    first, last = comparison.policies[0], comparison.policies[-1]
    change, points = field_mm(last) - field_mm(first), comparison.field_points
    top = float(np.percentile(np.abs(change), SCALE_PERCENTILE)) or 1.0
    better, worse = style.rgb(policy_colours([first.key, last.key]))[::-1]
    shades = LinearSegmentedColormap.from_list("nearer", [better, (0.82, 0.82, 0.84), worse])
    layers = np.array_split(np.unique(comparison.field_index[:, 2]), HEIGHTS)
    shown = [np.isin(comparison.field_index[:, 2], layer) for layer in layers if len(layer)]
    corner, step = comparison.grid_origin - comparison.grid_step / 2.0, comparison.grid_step
    width, depth = comparison.grid_shape[:2]
    edges = corner[0] + step * np.arange(width + 1), corner[1] + step * np.arange(depth + 1)
    with style.new_figure(style.WIDTH, 2.4) as figure:
        panels: Any = figure.subplots(1, len(shown), squeeze=False, sharex=True, sharey=True)[0]
        marks: Any = None
        for axes, layer in zip(panels, shown, strict=True):
            cells, mean = cell_means(comparison.field_index[layer] * np.array([1, 1, 0]), change[layer])
            grid = np.full((width, depth), np.nan)
            grid[cells[:, 0], cells[:, 1]] = mean
            marks = axes.pcolormesh(*edges, grid.T, cmap=shades, norm=TwoSlopeNorm(0.0, -top, top))
            low, high = points[layer, 2].min(), points[layer, 2].max()
            axes.set_title(f"z {low:.2f} to {high:.2f} m", weight="normal")
            axes.set(xlabel="x (m)", aspect="equal")
            axes.grid(visible=False)
        panels[0].set_ylabel("y (m)")
        bar = figure.colorbar(marks, ax=list(panels), location="bottom", shrink=0.6, aspect=40)
        bar.set_label(f"miss of {last.label} minus {first.label}, mean over the layer (mm)")
        count = int(np.sum(change < 0.0))
        figure.suptitle(
            f"{last.label} misses less than {first.label} at {count} of {len(change)} goals", fontsize=9, weight="bold"
        )
    return figure
