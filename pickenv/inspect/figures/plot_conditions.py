"""Figure of how a calibration's error changes with the conditions of work."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pickenv.base import InputError
from pickenv.inspect import colours
from pickenv.inspect.figures.style import LINES, WIDTH, alike, new_figure, plain_decades, rgb, short

METHODS = (colours.BLUE, colours.GREEN, *colours.OTHERS[:2], colours.GREY)
"""Colours of what is not raw, in turn."""
ALIKE = 0.01
"""Methods whose errors differ nowhere by more than this share are drawn once."""


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
                colour = rgb([colours.ORANGE if group[0] == "raw" else METHODS[(i - 1) % len(METHODS)]])[0]
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
