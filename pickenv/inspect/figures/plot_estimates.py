"""Figures of estimates with 95 % intervals: whiskers side by side, or lines with bands along a variable.

`error_by_condition` shows a calibration's errors along the conditions of work, such as payload.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pickenv.base import Estimate, InputError
from pickenv.inspect.colours import BLUE, GREEN, GREY, ORANGE, OTHERS, in_words, policy_colours, policy_label
from pickenv.inspect.figures import style

Row = Mapping[str, Any]
UNITS = ("mm", "m", "deg", "rad", "s", "h", "kg", "K", "N")
"""Units in which the name of a numeric column may end."""

LINE_INCHES = 0.17
"""Height of a whisker with its margin, inches."""

METHODS = (BLUE, GREEN, *OTHERS[:2], GREY)
"""Colours of methods other than raw, used in turn."""
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
                axis.set_ylim(len(places) - 0.5, -0.5)
                axis.set_xscale("log" if log else "linear")
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
    """Return a figure's title, which states estimates of the first panel by the column ``colour``.

    With ``x``, the estimates are those at the end of the lines. For a single line, they are its first and its last
    estimate. Without ``x``, each value of ``colour`` has its first estimate. ``panels`` is the column of the panels.
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

    ``x`` is the column along the x axis. ``colours`` has the line's colour for each value in the column ``colour``.
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
