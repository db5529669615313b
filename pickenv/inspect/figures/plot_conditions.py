"""Figure of how a calibration's error changes with the conditions of work."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pickenv.errors import InputError
from pickenv.inspect import colours
from pickenv.inspect.figures.style import LINES, WIDTH, new_figure, plain_decades, rgb


def error_by_condition(sweeps: Mapping[str, Mapping[str, Any]], names: Mapping[str, str]) -> Figure:
    """Mean position error against each condition, a panel each, a line per method with its 95 % interval.

    Args:
        sweeps: For each condition, its levels and for each method a mean and an interval (or None) at every level, mm.
        names: What each axis is called.
    """
    shown = {name: sweep for name, sweep in sweeps.items() if len(sweep["levels"]) > 1}
    if not shown:
        raise InputError("no condition was varied; give a payload, a weather or hours above zero")
    with new_figure(WIDTH, 3.3) as figure:
        panels: Any = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
        for axes, (name, sweep) in zip(panels, shown.items(), strict=True):
            levels = np.asarray(sweep["levels"], dtype=float)
            for i, (method, found) in enumerate(sweep["methods"].items()):
                (colour,), pattern = rgb([colours.arm_colour(i)]), LINES[i % len(LINES)]
                means = [each["mean_mm"] for each in found]
                axes.plot(levels, means, color=colour, linestyle=pattern, marker="o", markersize=3.0, label=method)
                ends = [each["ci95_mm"] for each in found]
                if None not in ends:
                    axes.fill_between(levels, *np.transpose(ends), color=colour, alpha=0.15, linewidth=0.0)
            axes.set(xlabel=names.get(name, name))
        panels[0].set_ylabel("mean position error (mm)")
        panels[0].set_yscale("log")
        plain_decades(panels[0].yaxis)
        figure.suptitle(
            "Error under conditions that no fit has seen", x=0.01, ha="left", fontweight="bold", fontsize=9.0
        )
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure
