"""Figures of policies and estimates: success against misalignment, accuracy against cycle time, 95 % intervals.

Estimates are drawn as whiskers side by side, or as lines with bands along a variable. Each function returns a
matplotlib figure. Most of them take plain arrays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from pickenv.base import Estimate, InputError
from pickenv.inspect.colours import GREY, METHODS, ORANGE, RED, as_sentence, in_words, policy_colours, policy_label
from pickenv.inspect.figures import style
from pickenv.inspect.runs import comparison_summary as summary
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedEpisodes

Row = Mapping[str, Any]
UNITS = ("mm", "m", "deg", "rad", "s", "h", "kg", "K", "N")
"""Units in which the name of a numeric column may end."""

LINE_INCHES = 0.17
"""Height of a whisker with its margin, inches."""

ALIKE = 0.01
"""Methods whose errors differ by less than this share everywhere are drawn as one line."""


def estimates_figure(
    rows: Sequence[Row],
    label: str,
    by: Sequence[str],
    *,
    x: str | None = None,
    colour: str | None = None,
    panels: str | None = None,
    log: bool = False,
    scale: float = 1.0,
) -> Figure:
    """Draw estimates with their intervals, as whiskers or as lines along a variable.

    An arrow marks an open end of a whisker.

    Args:
        rows: One row per estimate, with the columns of ``by`` and "estimate", as `pickenv.base.intervals.estimate`
            gives.
        label: Label of the estimates' axis, with their unit.
        by: Columns that together identify an estimate.
        x: A numeric column along which lines are drawn; None draws whiskers.
        colour: The column whose values have a colour each; None takes the last column of ``by`` that is neither ``x``
            nor ``panels``.
        panels: A column whose values have a panel each.
        log: Whether the estimates' axis is logarithmic.
        scale: Factor by which the estimates are multiplied.
    """
    free = [name for name in by if name not in (x, panels)]
    colour = colour or (free[-1] if free else "")
    rows = [{**row, "estimate": _scaled(row["estimate"], scale)} for row in rows]
    keys = list(dict.fromkeys(row.get(colour, "") for row in rows))
    colours = dict(zip(keys, style.rgb(policy_colours([str(key) for key in keys])) if colour else [None], strict=True))
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[panels] if panels else "", []).append(row)
    names = [name for name in free if name != colour]
    places = list(dict.fromkeys(tuple(row[name] for name in names) for row in rows))
    labels = [", ".join(in_words(str(name)) for name in place) for place in places]
    height = 3.2 if x else 1.0 + LINE_INCHES * len(places) * len(keys)
    with style.new_figure(style.WIDTH, height) as figure:
        axes: Any = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
        for axis, (title, some) in zip(axes, groups.items(), strict=True):
            axis.set_title(in_words(str(title)))
            if x is not None:
                _lines(axis, some, x, free, colour, colours)
                axis.set(xlabel=_in_words(x), yscale="log" if log else "linear")
            else:
                for row in some:
                    key, number = row.get(colour, ""), row["estimate"]
                    line = places.index(tuple(row[name] for name in names))
                    y = line + 0.8 * ((keys.index(key) + 0.5) / len(keys) - 0.5)
                    style.whisker(axis, y, number.value, number.ci95, colours[key])
                axis.set_yticks(range(len(places)), labels)
                axis.set(ylim=(len(places) - 0.5, -0.5), xscale="log" if log else "linear")
            if log:
                style.plain_decades(axis.xaxis if x is None else axis.yaxis)
        if x is None:
            unit = "".join(re.findall(r"\(.*?\)", label))  # there is room for all words once
            for number, axis in enumerate(axes):
                axis.set_xlabel(label if number == len(axes) // 2 else unit)
        else:
            axes[0].set_ylabel(label)
        for key, shade in colours.items():
            axes[0].plot([], [], color=shade, linewidth=3.0, label=style.label_words(policy_label(str(key))))
        figure.suptitle(_result(rows, x, colour, panels), x=0.01, ha="left", fontsize=9.0, fontweight="bold")
        if len(colours) > 1:
            style.legend_below(figure, axes[0], 4)
    return figure


def _result(rows: Sequence[Row], x: str | None, colour: str, panels: str | None) -> str:
    """Return a figure's title, which states some estimates of the first panel.

    With a column ``x``, the title has the last estimate of each line, or the first and the last estimate of a single
    line. Without ``x``, the title has the first estimate of each value of ``colour``.

    Args:
        rows: The estimates.
        x: Column along the x axis; None for whiskers.
        colour: Column whose values have a colour each.
        panels: Column whose values have a panel each; None for a single panel.
    """
    first = [row for row in rows if panels is None or row[panels] == rows[0][panels]]
    if x is not None and len(first) == len({row[x] for row in first}):
        colour, ends = x, sorted(first, key=lambda row: float(row[x]))
        first = [{**row, x: f"{x} {row[x]}"} for row in (ends[0], ends[-1])]
    elif x is not None:
        last = max(float(row[x]) for row in first)
        first = [row for row in first if float(row[x]) == last]
    values: dict[str, float] = {}
    for row in first:
        values.setdefault(in_words(policy_label(str(row.get(colour, "")))), row["estimate"].value)
    panel = [] if panels is None else [in_words(str(rows[0][panels]))]
    return ": ".join([*panel, style.change(values, "").strip()])


def _in_words(column: str) -> str:
    """Return a column's name for readers, with its unit: time (h) for time_h, pick (number) for pick without unit."""
    name, _, unit = column.rpartition("_")
    return f"{name.replace('_', ' ')} ({unit})" if unit in UNITS and name else f"{column} (number)"


def _scaled(number: Estimate, scale: float) -> Estimate:
    low, high = (None if end is None else scale * end for end in number.ci95 or (None, None))
    return replace(number, value=scale * number.value, ci95=number.ci95 and (low, high))


def _lines(
    axis: Any, rows: Sequence[Row], x: str, names: Sequence[str], colour: str, colours: Mapping[Any, Any]
) -> None:
    """Draw a line with its band for each combination of values in the columns ``names``.

    Args:
        axis: The panel.
        rows: The estimates.
        x: Column along the x axis.
        names: Columns whose values identify a line.
        colour: Column whose values have a colour each.
        colours: Colour of each value in the column ``colour``.
    """
    series: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        series.setdefault(tuple(row[name] for name in names), []).append(row)
    for line in series.values():
        line.sort(key=lambda row: float(row[x]))
        shade, places = colours[line[0].get(colour, "")], [float(row[x]) for row in line]
        numbers: list[Estimate] = [row["estimate"] for row in line]
        axis.plot(places, [number.value for number in numbers], color=shade)
        ends = [[n.value if end is None else end for end in n.ci95 or (None, None)] for n in numbers]
        axis.fill_between(places, *np.transpose(ends), color=shade, alpha=0.2, linewidth=0)


def error_by_condition(sweeps: Mapping[str, Mapping[str, Any]], names: Mapping[str, str]) -> Figure:
    """Draw the mean position error of each method against each condition, with 95 % intervals, a panel per condition.

    Args:
        sweeps: For each condition, by name, a dictionary of two entries. "levels" are the values of the condition.
            "methods" has, for each method, one dictionary per level: "mean_mm", and "ci95_mm" with both ends or None.
        names: Label of the axis of each condition, by the condition's name.

    Raises:
        InputError: If no condition has more than one level.
    """
    sweeps = {name: sweep for name, sweep in sweeps.items() if len(sweep["levels"]) > 1}
    if not sweeps:
        raise InputError("no condition was varied; give a payload, a weather or hours above zero")
    methods = list(next(iter(sweeps.values()))["methods"])
    means = {method: [n["mean_mm"] for s in sweeps.values() for n in s["methods"][method]] for method in methods}
    groups = style.alike({method: np.log(values) for method, values in means.items()}, ALIKE)
    with style.new_figure(style.WIDTH, 3.3) as figure:
        panels: Any = figure.subplots(1, len(sweeps), sharey=True, squeeze=False)[0]
        for axes, (name, sweep) in zip(panels, sweeps.items(), strict=True):
            levels = np.asarray(sweep["levels"], dtype=float)
            for i, group in enumerate(groups):
                numbers, label = sweep["methods"][group[0]], style.label_words(" = ".join(group))
                colour = style.rgb([ORANGE if group[0] == "raw" else METHODS[(i - 1) % len(METHODS)]])[0]
                pattern = style.LINES[i % len(style.LINES)]
                line: dict[str, Any] = {"linestyle": pattern, "marker": "o", "markersize": 3.0}
                axes.plot(levels, [number["mean_mm"] for number in numbers], color=colour, label=label, **line)
                ends = [number["ci95_mm"] for number in numbers]
                if None not in ends:
                    axes.fill_between(levels, *np.transpose(ends), color=colour, alpha=0.15, linewidth=0.0)
            axes.set(xlabel=names.get(name, name))
        panels[0].set_ylabel("mean position error (mm)")
        panels[0].set_yscale("log")
        style.plain_decades(panels[0].yaxis)
        least = min(methods, key=lambda method: max(means[method]))
        span = " to ".join(style.short(end(means[least])) for end in (min, max))
        title = f"{in_words(least)}: {span} mm under conditions that no fit has seen"
        figure.suptitle(title[:1].upper() + title[1:], x=0.01, ha="left", fontweight="bold", fontsize=9.0)
        style.legend_below(figure, panels[0], 3)
    return figure


SMALLEST = 1e-3
"""Smallest error that logarithmic axes show, mm. Errors below it are drawn at this value."""


def distance_over_time(episodes: RecordedEpisodes) -> Figure:
    """Draw the distance between tool and fruit over time in every episode, with the gripper's tolerance.

    The distance axis is logarithmic.
    """
    words = "time in the episode (s)", "distance to the fruit (mm)"
    with style.new_panel(style.WIDTH, 3.2, *words, legend=len(episodes.policies) + 1) as (figure, axes):
        axes.set_yscale("log")
        for policy, colour in zip(episodes.policies, style.rgb(episodes.colours), strict=True):
            for distance, moments in zip(policy.position_error_mm, policy.moments, strict=True):
                distance = np.maximum(distance[:moments], SMALLEST)
                axes.plot(episodes.period * np.arange(moments), distance, color=colour, linewidth=0.7, alpha=0.7)
            axes.plot([], [], color=colour, linewidth=3.0, label=style.label_words(policy.label))
        label = f"{in_words(episodes.gripper)} forgives {episodes.tolerance_mm:g} mm"
        axes.axhline(episodes.tolerance_mm, color=style.rgb([RED])[0], linestyle="--", label=label)
        axes.set_title(as_sentence(summary.outcome_sentence(episodes)))
        style.plain_decades(axes.yaxis)
    return figure


def difference_map(comparison: Comparison) -> Figure:
    """Draw a map of the workspace, coloured by the last policy's position error minus the first policy's, mm.

    Each of three panels shows one layer of the workspace from above, with differences averaged over the layer's height.
    """
    first, last = comparison.policies[0], comparison.policies[-1]
    change, points = summary.field_mm(last) - summary.field_mm(first), comparison.grid.points
    top = float(np.percentile(np.abs(change), summary.SCALE_PERCENTILE)) or 1.0
    worse, better = style.rgb(policy_colours([first.key, last.key]))
    colours = LinearSegmentedColormap.from_list("nearer", [better, (0.82, 0.82, 0.84), worse])
    layers = np.array_split(np.unique(comparison.grid.index[:, 2]), 3)
    rows = [np.isin(comparison.grid.index[:, 2], layer) for layer in layers if len(layer)]
    corner, step = comparison.grid.corner, comparison.grid.step
    width, depth = comparison.grid.shape[:2]
    edges = corner[0] + step * np.arange(width + 1), corner[1] + step * np.arange(depth + 1)
    with style.new_figure(style.WIDTH, 2.4) as figure:
        figure.set_layout_engine("compressed")  # panels of a fixed shape, below one title
        panels: Any = figure.subplots(1, len(rows), squeeze=False, sharex=True, sharey=True)[0]
        for axes, layer in zip(panels, rows, strict=True):
            cells, mean = summary.cell_means(comparison.grid.index[layer] * np.array([1, 1, 0]), change[layer])
            grid = np.full((width, depth), np.nan)
            grid[cells[:, 0], cells[:, 1]] = mean
            marks = axes.pcolormesh(*edges, grid.T, cmap=colours, norm=TwoSlopeNorm(0.0, -top, top))
            low, high = points[layer, 2].min(), points[layer, 2].max()
            axes.set_title(f"z {low:.2f} to {high:.2f} m", weight="normal")
            axes.set(xlabel="x (m)", aspect="equal")
            axes.grid(visible=False)
        panels[0].set_ylabel("y (m)")
        bar = figure.colorbar(marks, ax=list(panels), location="bottom", shrink=0.6, aspect=40)
        bar.set_label(in_words(f"miss of {last.label} minus {first.label}, mean over the layer (mm)"))
        title = f"{last.label} misses less than {first.label} at {int(np.sum(change < 0.0))} of {len(change)} goals"
        figure.suptitle(as_sentence(title), fontsize=9, weight="bold")
    return figure


Estimated = tuple[float, tuple[float | None, float | None] | None]
"""An estimate and the two ends of its 95 % interval: None for an open end, None in place of both for no interval."""


def aggregates(panels: Mapping[str, Mapping[str, Mapping[str, Mapping[str, Estimated]]]]) -> Figure:
    """Draw estimates of errors with 95 % intervals, on a logarithmic axis.

    An arrow marks an end that the data do not bound.

    Args:
        panels: The estimate, mm, for each scene, statistic, policy and compensation, nested in this order. Each
            statistic has a panel, each policy in a scene a line, and each compensation a colour.

    Raises:
        InputError: If there is nothing to draw.
    """
    if not panels or not all(panels.values()):
        raise InputError("there is nothing to draw; give at least one scene with one statistic")
    rows = [
        {"scene": scene, "statistic": statistic, "policy": policy, "compensation": key, "estimate": _drawable(number)}
        for scene, columns in panels.items()
        for statistic, policies in columns.items()
        for policy, line in policies.items()
        for key, number in line.items()
    ]
    by = ("policy", "scene", "compensation")
    return estimates_figure(rows, "final position error (mm)", by, colour="compensation", panels="statistic", log=True)


def _drawable(number: Estimated) -> Estimate:
    """Return an estimate for a logarithmic axis: value and ends of the interval are at least `SMALLEST`."""
    value, ends = number
    low, high = (None if end is None else max(end, SMALLEST) for end in ends or (None, None))
    return Estimate(max(value, SMALLEST), None if ends is None else (low, high))


def success_against_misalignment(
    curves: Mapping[str, tuple[ArrayLike, ArrayLike]], points: Mapping[str, Mapping[str, tuple[float, Estimated]]]
) -> Figure:
    """Draw each gripper's probability of success against lateral misalignment, with a point for each policy.

    The point is at the policy's mean error and its share of successes.

    Args:
        curves: For each gripper, by name, misalignment ``(N,)``, mm, and probability of success ``(N,)``.
        points: For each policy and gripper: the policy's mean error, mm, and its share of successes with 95 % interval.
    """
    colours = style.shades(points)
    with style.new_panel(style.WIDTH, 2.8, "lateral misalignment (mm)", "success (%)", legend=3) as (figure, axes):
        shares = {policy: {g: 100.0 * share for g, (_, (share, _)) in at.items()} for policy, at in points.items()}
        grippers = list(dict.fromkeys(g for at in shares.values() for g in at))
        taken = [f"{g} {style.change({p: at[g] for p, at in shares.items() if g in at}, '%')}" for g in grippers]
        style.headline(axes, f"Taken by {'; by '.join(taken)}")
        marks = dict(zip(curves, style.MARKS * len(curves), strict=False))
        for (gripper, (x, y)), line in zip(curves.items(), style.LINES * len(curves), strict=False):
            axes.plot(x, 100.0 * np.asarray(y), linestyle=line, color=style.SOFT)
            mark: dict[str, Any] = {"marker": marks[gripper], "markersize": 5, "label": style.label_words(gripper)}
            axes.plot([], [], linestyle=line, color=style.SOFT, **mark)
        for policy, colour in colours.items():
            look: dict[str, Any] = {"color": colour, "markersize": 6}
            for gripper, (error, (share, ends)) in points[policy].items():
                if ends is not None:
                    interval = [100.0 * (share if end is None else end) for end in ends]
                    axes.plot([error, error], interval, color=colour, lw=2.0)
                axes.plot([error], [100.0 * share], marks[gripper], markeredgecolor=style.INK, **look)
            axes.plot([], [], "o", label=style.label_words(f"{policy}: mean error, success"), **look)
        farthest = max((error for at in points.values() for error, _ in at.values()), default=0.0)
        # Shown is where the first gripper's success halves, and all policies.
        halved = [x[share <= 0.5 * share[0]][:1] for x, share in (map(np.asarray, curve) for curve in curves.values())]
        half = min((float(end[0]) for end in halved if len(end)), default=0.0)
        axes.set(ylim=(-3.0, 103.0), xlim=(0.0, 1.3 * max(half, farthest, 1.0)))
    return figure


def accuracy_against_cycle_time(
    curves: Mapping[tuple[str, str], ArrayLike], period: float, *, title: str = ""
) -> Figure:
    """Draw the mean position error against cycle time, and the smallest error of all curves up to each time.

    The error after a step is the error of a pick that ends with this step.

    Args:
        curves: Mean error after each step ``(T,)``, mm, by the labels of policy and compensation. The policy gives the
            line's pattern, the compensation its colour.
        period: Duration of a step, s.
        title: Words added to the title, such as the plant's name.

    Raises:
        InputError: If there is no curve, or one is empty or not finite.
    """
    series = style.finite_series({", ".join(labels): error for labels, error in curves.items()})
    errors = [error.clip(SMALLEST) for error in series.values()]
    patterns = dict(zip(dict.fromkeys(policy for policy, _ in curves), style.LINES * len(curves), strict=False))
    colours = style.shades(dict.fromkeys(compensation for _, compensation in curves))
    shortest = min(map(len, errors))
    times = period * np.arange(1, 1 + max(map(len, errors)))
    with style.new_panel(style.WIDTH, 3.2, "cycle time (s)", "mean position error (mm)") as (figure, axes):
        axes.set_yscale("log")
        first = next(iter(patterns))
        ends = {label: float(e[-1]) for (policy, label), e in zip(curves, errors, strict=True) if policy == first}
        for (policy, compensation), error in zip(curves, errors, strict=True):
            axes.plot(times[: len(error)], error, linestyle=patterns[policy], color=colours[compensation])
        front = np.minimum.accumulate(np.min([error[:shortest] for error in errors], axis=0))
        policy = f"{first} on {in_words(title)}" if title else first
        style.headline(axes, f"{policy} after {period * len(errors[0]):.1f} s: {style.change(ends, 'mm')}", beside=1.2)
        axes.plot(times[:shortest], front, color=style.rgb([GREY])[0], linewidth=6, zorder=0, label="best so far")
        for policy, pattern in patterns.items():
            axes.plot([], [], linestyle=pattern, color=style.SOFT, label=style.label_words(policy))
        for name, colour in colours.items():
            axes.plot([], [], color=colour, linewidth=3.0, label=style.label_words(name))
        style.plain_decades(axes.yaxis)
        figure.legend(loc="outside right center")
    return figure


def accuracy_by_pose(accuracy_mm: Mapping[str, ArrayLike], repeatability_mm: Mapping[str, ArrayLike]) -> Figure:
    """Draw pose accuracy AP and repeatability RP of ISO 9283 at each test pose, by controller.

    Args:
        accuracy_mm: For each controller, by name, AP at the test poses P1 to P5 ``(5,)``, mm.
        repeatability_mm: For each controller, by name, RP at the same poses ``(5,)``, mm.
    """
    kinds = {"AP": style.finite_series(accuracy_mm), "RP": style.finite_series(repeatability_mm)}
    with style.new_figure(style.WIDTH, 2.6) as figure:
        for axes, (kind, series) in zip(figure.subplots(1, 2), kinds.items(), strict=True):
            for i, (label, values, colour) in enumerate(style.coloured(series)):
                place = np.arange(1, len(values) + 1) + 0.35 * (i - (len(series) - 1) / 2.0)
                axes.bar(place, values, 0.33, color=colour, label=f"{label}: worst {values.max():.3f} mm")
            axes.set(xlabel="test pose of ISO 9283 (number)", ylabel=f"{kind} (mm)")
            axes.set_xticks(range(1, len(values) + 1), [f"P{k}" for k in range(1, len(values) + 1)])
            worst = style.change({label: float(values.max()) for label, values in series.items()}, "mm")
            style.headline(axes, f"Worst {kind}: {worst}")
            axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.0))
            axes.set_ylim(top=1.35 * max(float(v.max()) for v in series.values()))
            axes.grid(axis="x", visible=False)
    return figure


def accuracy_drift(hours: ArrayLike, accuracy_mm: Mapping[str, ArrayLike]) -> Figure:
    """Draw pose accuracy AP at the ISO 9283 pose P1 over the hours after the cold arm was switched on.

    Args:
        hours: Times since the arm was switched on ``(T,)``, h.
        accuracy_mm: For each controller, by name, AP at the times ``hours`` ``(T,)``, mm.
    """
    series = style.finite_series(accuracy_mm)
    with style.new_panel(style.COLUMN, 2.6, "time since switched on (h)", "AP at P1 (mm)") as (figure, axes):
        drifts = {label: float(np.abs(values - values[0]).max()) for label, values in series.items()}
        style.headline(axes, f"Drift of AP at P1: {style.change(drifts, 'mm')}")
        for label, values, colour in style.coloured(series):
            axes.plot(np.asarray(hours, dtype=float), values, color=colour, label=label)
        axes.set_ylim(0.0, 1.2 * max(float(values.max()) for values in series.values()) or 1.0)
        axes.legend()
    return figure
