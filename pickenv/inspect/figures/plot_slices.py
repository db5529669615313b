"""Error arrows over slices of the workspace: a row per method, a column per slice, one colour scale and one gain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError
from pickenv.inspect.colours import viridis
from pickenv.inspect.figures.field_figure import colour_bar, field_gain
from pickenv.inspect.figures.style import SOFT, WIDTH, change, new_figure
from pickenv.inspect.runs.comparison_summary import scale_end


def error_slices(
    points: ArrayLike, errors: Mapping[str, ArrayLike], *, step: float, axis: int | None = None, slices: int = 3
) -> Figure:
    """Quiver plot of position errors over slices of a regular grid of tool positions.

    Arrows show the two components within the slice; their colour is the whole length of the error.

    Args:
        points: Wanted tool positions on the grid ``(F, 3)``, m.
        errors: For each method, by label, true minus wanted position ``(F, 3)``, m.
        step: Distance of neighbouring grid points, m.
        axis: The slices are taken across this axis: 0 for x, 1 for y, 2 for z; when left out, across the one along
            which the first method's errors are smallest, so that the arrows show most of them.
        slices: Slices at most, evenly taken from those of the grid.

    Raises:
        InputError: If there is nothing to draw or a shape does not fit.
    """
    points = np.asarray(points, dtype=float)
    fields = {label: np.asarray(values, dtype=float) for label, values in errors.items()}
    if not len(points) or not fields or any(field.shape != points.shape for field in fields.values()):
        raise InputError("an error field needs points (F, 3) and errors (F, 3) for each method; give at least one")
    first = next(iter(fields.values()))
    axis = int(np.argmin(np.mean(first**2, axis=0))) if axis is None else axis
    layer = np.rint((points[:, axis] - points[:, axis].min()) / step).astype(int)
    known = np.unique(layer)
    inner = np.rint(np.linspace(0, len(known) - 1, slices + 2)[1:-1]).astype(int)
    chosen = known if len(known) <= slices else known[inner]
    across, up = [i for i in range(3) if i != axis]
    lengths = {label: np.linalg.norm(field, axis=1) * 1e3 for label, field in fields.items()}
    top = scale_end(np.linalg.norm(first, axis=1) * 1e3)
    gain = field_gain(step, top)
    low, high = points.min(axis=0) - step, points.max(axis=0) + step
    height = (WIDTH - 0.9) / len(chosen) * (high[up] - low[up]) / (high[across] - low[across])
    with new_figure(WIDTH, 1.4 + len(fields) * (height + 0.1), **{"axes.titlelocation": "center"}) as figure:
        panels: Any = figure.subplots(len(fields), len(chosen), squeeze=False, sharex=True, sharey=True)
        for row, (label, field) in enumerate(fields.items()):
            for column, number in enumerate(chosen):
                axes, here = panels[row, column], layer == number
                _arrows(
                    axes, points[here][:, (across, up)], field[here][:, (across, up)] * gain, lengths[label][here], top
                )
                axes.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect="equal")
                if row == 0:
                    axes.set_title(f"{'xyz'[axis]} = {points[here][0, axis]:.2f} m".replace("-", "−"))
                if row == len(fields) - 1:
                    axes.set_xlabel(f"{'xyz'[across]} (m)")
                if column == 0:
                    axes.set_ylabel(f"{label}\n{'xyz'[up]} (m)")
        colour_bar(figure, panels, top, next(iter(fields)))
        shown = np.isin(layer, chosen)
        means = change({label: float(mm[shown].mean()) for label, mm in lengths.items()}, "mm")
        figure.suptitle(f"Mean error in slices: {means}; arrows ×{gain:g}", fontweight="bold", fontsize=9.0)
    return figure


def _arrows(axes: Any, points: Array, arrows: Array, lengths: Array, top: float) -> None:
    axes.plot(*points.T, ".", color=SOFT, markersize=1.2, zorder=1.0)
    axes.quiver(
        *points.T,
        *arrows.T,
        color=viridis(lengths / top) / 255.0,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.008,
        headwidth=3.5,
        minlength=0.0,
        zorder=2.0,
    )
