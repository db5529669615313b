"""Figures of numbers with their 95 % intervals: whiskers side by side, or lines with bands along a number.

Among these are a calibration's errors along the conditions of work.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pickenv.base import Estimate, InputError
from pickenv.inspect.colours import BLUE, GREEN, GREY, ORANGE, OTHERS, policy_colours, policy_label
from pickenv.inspect.figures.style import LINES, WIDTH, alike, change, new_figure, plain_decades, rgb, short, whisker

Row = Mapping[str, Any]
UNITS = ("mm", "m", "deg", "rad", "s", "h", "kg", "K", "N")
"""What the name of a column of numbers may end in."""

LINE_INCHES = 0.17
"""Height of a whisker with the room around it."""

METHODS = (BLUE, GREEN, *OTHERS[:2], GREY)
"""Colours of what is not raw, in turn."""
ALIKE = 0.01
"""Methods whose errors differ nowhere by more than this share are drawn once."""


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
    """Numbers with their intervals; an open end of a whisker is an arrow.

    Args:
        rows: Each with the columns of ``by`` and "estimate", as from `pickenv.base.intervals.estimate`.
        label: What the numbers are, with their unit.
        by: Columns that name a number.
        x: A column of numbers, which lines are drawn along; whiskers are drawn when None.
        colour: The column that colours tell apart; the first that is none of the others when None.
        panels: A column whose levels have a panel each.
        log: Whether the numbers' axis is logarithmic.
        scale: Factor on the numbers.
    """
    free = [name for name in by if name not in (x, panels)]
    colour = colour or (free[-1] if free else None)
    keys = [] if colour is None else list(dict.fromkeys(row[colour] for row in rows))
    colours = dict(zip(keys, rgb(policy_colours([str(key) for key in keys])), strict=True))
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[panels] if panels else "", []).append(row)
    places = list(dict.fromkeys(tuple(row[name] for name in free if name != colour) for row in rows))
    height = 3.2 if x else 1.0 + LINE_INCHES * len(places) * max(len(keys), 1)
    with new_figure(WIDTH, height) as figure:
        axes: Any = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
        for axis, (title, some) in zip(axes, groups.items(), strict=True):
            axis.set_title(str(title))
            if x is not None:
                _lines(axis, some, x, free, colours, colour, scale)
                axis.set(xlabel=_in_words(x), yscale="log" if log else "linear")
            else:
                _whiskers(axis, some, places, [name for name in free if name != colour], colours, colour, scale)
                axis.set_xscale("log" if log else "linear")
            for one in (axis.xaxis, axis.yaxis):
                if one.get_scale() == "log":
                    plain_decades(one)
        if x is None:
            unit = "".join(re.findall(r"\(.*?\)", label))  # there is room for all words once
            for number, axis in enumerate(axes):
                axis.set_xlabel(label if number == len(axes) // 2 else unit)
        else:
            axes[0].set_ylabel(label)
        for key, shade in colours.items():
            axes[0].plot([], [], color=shade, linewidth=3.0, label=policy_label(str(key)))
        figure.suptitle(_result(rows, x, colour, panels, scale), x=0.01, ha="left", fontsize=9.0, fontweight="bold")
        if len(colours) > 1:
            figure.legend(loc="outside lower center", ncols=min(len(colours), 4))
    return figure


def _result(rows: Sequence[Row], x: str | None, colour: str | None, panels: str | None, scale: float) -> str:
    """What the first line of numbers says, or what the lines of the first panel end at."""
    first = [row for row in rows if panels is None or row[panels] == rows[0][panels]]
    if x is not None:
        last = max(float(row[x]) for row in first)
        first = [row for row in first if float(row[x]) == last]
    values: dict[str, float] = {}
    for row in first:
        values.setdefault(policy_label(str(row[colour])) if colour else "", scale * row["estimate"].value)
    where = [] if panels is None else [str(rows[0][panels])]
    return ": ".join([*where, change(values, "").strip()])


def _in_words(column: str) -> str:
    """A column's name with the unit that it ends in: time (h) of time_h; of a column without one, pick (number)."""
    name, _, unit = column.rpartition("_")
    return f"{name.replace('_', ' ')} ({unit})" if unit in UNITS and name else f"{column} (number)"


def _ends(found: Estimate, scale: float) -> tuple[float, float]:
    low, high = found.ci95 or (None, None)
    return scale * (found.value if low is None else low), scale * (found.value if high is None else high)


def _lines(
    axis: Any,
    rows: Sequence[Row],
    x: str,
    free: Sequence[str],
    colours: Mapping[Any, Any],
    colour: str | None,
    scale: float,
) -> None:
    series: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        series.setdefault(tuple(row[name] for name in free), []).append(row)
    for some in series.values():
        some = sorted(some, key=lambda row: float(row[x]))
        shade = colours[some[0][colour]] if colour else None
        places = [float(row[x]) for row in some]
        axis.plot(places, [scale * row["estimate"].value for row in some], color=shade)
        low, high = np.transpose([_ends(row["estimate"], scale) for row in some])
        axis.fill_between(places, low, high, color=shade, alpha=0.2, linewidth=0)


def _whiskers(
    axis: Any,
    rows: Sequence[Row],
    places: Sequence[tuple[Any, ...]],
    names: Sequence[str],
    colours: Mapping[Any, Any],
    colour: str | None,
    scale: float,
) -> None:
    keys = list(colours)
    for row in rows:
        key = row[colour] if colour else None
        beside = 0.0 if key is None else (keys.index(key) + 0.5) / len(keys) - 0.5
        y = places.index(tuple(row[name] for name in names)) + 0.8 * beside
        shade = colours.get(key)
        number: Estimate = row["estimate"]
        ends = None if number.ci95 is None else [None if end is None else scale * end for end in number.ci95]
        whisker(axis, y, scale * number.value, ends, shade)
    axis.set_yticks(range(len(places)), [", ".join(map(str, place)) for place in places])
    axis.set_ylim(len(places) - 0.5, -0.5)


def error_by_condition(sweeps: Mapping[str, Mapping[str, Any]], names: Mapping[str, str]) -> Figure:
    """Mean position error against each condition, a panel each, a line per method with its 95 % interval.

    Args:
        sweeps: For each condition, its levels and for each method a mean and an interval (or None) at every level, mm.
        names: What each axis is called.
    """
    shown = {name: sweep for name, sweep in sweeps.items() if len(sweep["levels"]) > 1}
    if not shown:
        raise InputError("no condition was varied; give a payload, a weather or hours above zero")
    names_of = list(next(iter(shown.values()))["methods"])
    groups = alike({name: np.log(_means(shown, name)) for name in names_of}, ALIKE)
    with new_figure(WIDTH, 3.3) as figure:
        panels: Any = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
        for axes, (name, sweep) in zip(panels, shown.items(), strict=True):
            levels = np.asarray(sweep["levels"], dtype=float)
            for i, group in enumerate(groups):
                by_level, pattern, method = sweep["methods"][group[0]], LINES[i % len(LINES)], " = ".join(group)
                colour = rgb([ORANGE if group[0] == "raw" else METHODS[(i - 1) % len(METHODS)]])[0]
                means = [number["mean_mm"] for number in by_level]
                axes.plot(levels, means, color=colour, linestyle=pattern, marker="o", markersize=3.0, label=method)
                ends = [number["ci95_mm"] for number in by_level]
                if None not in ends:
                    axes.fill_between(levels, *np.transpose(ends), color=colour, alpha=0.15, linewidth=0.0)
            axes.set(xlabel=names.get(name, name))
        panels[0].set_ylabel("mean position error (mm)")
        panels[0].set_yscale("log")
        plain_decades(panels[0].yaxis)
        least = min(names_of, key=lambda name: max(_means(shown, name)))
        span = " to ".join(short(end(_means(shown, least))) for end in (min, max))
        said = f"{least}: {span} mm under conditions that no fit has seen"
        figure.suptitle(said[:1].upper() + said[1:], x=0.01, ha="left", fontweight="bold", fontsize=9.0)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _means(sweeps: Mapping[str, Mapping[str, Any]], method: str) -> list[float]:
    """The mean errors of a method at every level of every condition, mm."""
    return [float(number["mean_mm"]) for sweep in sweeps.values() for number in sweep["methods"][method]]
