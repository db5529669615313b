"""Figures of the comparison: aggregates with intervals, success against error, accuracy against cycle time. mm, s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.calibrated import COMPENSATIONS
from agents.grid import Grid
from agents.statistics import interquartile_mean, interval, mean
from pickenv.arm.geometry import Array
from pickenv.inspect.colours import BLUE, GREEN, ORANGE, Rgb
from pickenv.inspect.figures import WIDTH, new_figure, style
from pickenv.orchard.gripper import Gripper, capture_probability

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LABELS = {"raw": "raw", "ls": "LS", "ls_bpnn": "LS+BPNN", "best": "LS+GP"}
PURPLE: Rgb = (204, 121, 167)
COLOURS: dict[str, Rgb] = dict(zip(COMPENSATIONS, (ORANGE, BLUE, GREEN, PURPLE), strict=True))
LINES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)))
SMALLEST_MM = 1e-3
"""Errors below a micrometre are drawn there."""


def colour(compensation: str) -> tuple[float, ...]:
    """A compensation's colour for matplotlib."""
    return tuple(value / 255 for value in COLOURS[compensation])


def aggregate_figure(grid: Grid) -> Figure:
    """Mean, interquartile mean and 95th percentile of every cell with 95 % intervals, one panel row per plant."""
    plants = grid.settings.plants
    columns: Sequence[tuple[str, Any]] = (
        ("mean", mean),
        ("interquartile mean", interquartile_mean),
        ("95th percentile", lambda values: np.percentile(values, 95, axis=-1)),
    )
    names = list(dict.fromkeys((cell.policy, cell.feedback) for cell in grid.cells))
    with style():
        figure = new_figure(WIDTH, 0.6 + len(plants) * (0.5 + 0.42 * len(names)))
        axes: Any = figure.subplots(len(plants), 3, squeeze=False, sharex=True)
        for row, plant in enumerate(plants):
            for column, (title, statistic) in enumerate(columns):
                axis = axes[row, column]
                for cell in grid.cells:
                    if cell.plant != plant:
                        continue
                    order = COMPENSATIONS.index(cell.compensation)
                    y = names.index((cell.policy, cell.feedback)) + 0.18 * (order - 1.5)
                    errors = np.maximum(cell.errors_mm, SMALLEST_MM)
                    low, high = interval(errors, np.random.default_rng(0), statistic)
                    centre = float(statistic(errors.ravel()))
                    axis.plot([low, high], [y, y], color=colour(cell.compensation), linewidth=3.0, alpha=0.5)
                    axis.plot([centre], [y], "|", color=colour(cell.compensation), markersize=7, markeredgewidth=1.6)
                axis.set_xscale("log")
                axis.set_title(f"{plant}: {title}" if column == 0 else title)
                axis.set_yticks(
                    range(len(names)), [f"{p}\n{f}" for p, f in names] if column == 0 else [""] * len(names)
                )
                axis.set_ylim(len(names) - 0.5, -0.5)
                if row == len(plants) - 1:
                    axis.set_xlabel("final position error [mm]")
        handles = [
            axes[0, 0].plot([], [], color=colour(key), linewidth=3.0, label=LABELS[key])[0]
            for key in grid.settings.compensations
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def success_curves(grippers: Mapping[str, Gripper], grid: Grid | None = None) -> Figure:
    """Success against lateral error for each gripper, and where the grid's cells lie on it."""
    lateral = np.linspace(0.0, 40.0, 401)
    with style():
        figure = new_figure(WIDTH, 3.2)
        axis: Any = figure.subplots()
        for line, (name, gripper) in zip(("-", "--", ":", "-."), grippers.items(), strict=False):
            axis.plot(lateral, capture_probability(gripper, lateral * 1e-3, 0.0, 0.0), line, color="0.25", label=name)
        if grid is not None:
            for cell in grid.cells:
                if cell.policy != "scripted":
                    continue
                for mark, gripper in zip(("o", "s", "^"), grid.grippers.values(), strict=False):
                    place = (float(cell.errors_mm.mean()), float(cell.rollout.capture(gripper).mean()))
                    axis.plot(*place, mark, color=colour(cell.compensation), markersize=5)
        axis.set_xlabel("lateral error [mm]; marks: mean error and success of the scripted policy")
        axis.set_ylabel("success")
        axis.set_ylim(-0.02, 1.02)
        axis.legend()
    return figure


def cycle_figure(grid: Grid, period: float, plant: str) -> Figure:
    """Accuracy against cycle time: mean error if the pick were made after each step, and the Pareto front of all.

    Policies with a camera are shown on raw arms only.
    """
    curves: list[Array] = []
    with style():
        figure = new_figure(WIDTH, 3.6)
        axis: Any = figure.subplots()
        lines = dict(zip(dict.fromkeys(cell.policy for cell in grid.cells), LINES * 4, strict=False))
        for cell in grid.cells:
            watched = cell.feedback == "camera" and cell.compensation != "raw"  # then all compensations look alike
            if cell.plant != plant or cell.policy == "random" or watched:
                continue
            error = np.maximum(cell.rollout.error_mm.mean(axis=1), SMALLEST_MM)
            curves.append(error)
            label = f"{cell.policy}, {LABELS[cell.compensation]}"
            seconds = period * np.arange(1, len(error) + 1)
            axis.plot(
                seconds, error, linestyle=lines[cell.policy], color=colour(cell.compensation), label=label, alpha=0.9
            )
        front = np.minimum.accumulate(np.min(curves, axis=0))
        axis.plot(period * np.arange(1, len(front) + 1), front, color="0.8", linewidth=6, zorder=0, label="best so far")
        axis.set_yscale("log")
        axis.set_xlabel("cycle time [s]")
        axis.set_ylabel("mean position error [mm]")
        axis.legend(fontsize=6, ncols=2)
    return figure
