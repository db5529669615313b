"""Figures of errors: at each pose, by method, distributed, and against what they may depend on.

Each function takes plain arrays and returns a matplotlib figure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.inspect.colours import RED, viridis
from pickenv.inspect.figures import style
from pickenv.inspect.figures.field_figure import QUIVER, colour_bar, field_gain
from pickenv.inspect.figures.style import SOFT, WIDTH, change, new_figure
from pickenv.inspect.runs.comparison_summary import round_step, scale_end

ARROWS: dict[str, Any] = QUIVER | {"scale": 1.0, "width": 0.008, "zorder": 2.0}
BOXES: dict[str, Any] = {
    "medianprops": {"color": style.INK, "linewidth": 1.4},
    "meanprops": {"marker": "D", "markerfacecolor": style.PAPER, "markeredgecolor": style.INK, "markersize": 4.0},
    "flierprops": {"marker": "o", "markersize": 2.5, "markeredgecolor": style.SOFT, "alpha": 0.7},
    "whiskerprops": {"color": style.SOFT},
    "capprops": {"color": style.SOFT},
}
WIDEST = 16
"""Characters of a label beside others, above which what is added by + stands on lines of its own."""


def error_slices(
    points: ArrayLike, errors: Mapping[str, ArrayLike], *, step: float, axis: int | None = None, slices: int = 3
) -> Figure:
    """Quiver plot of position errors over slices of a regular grid: a row per method, one colour scale and one gain.

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
    layers = np.unique(layer)
    if len(layers) > slices:
        layers = layers[np.rint(np.linspace(0, len(layers) - 1, slices + 2)[1:-1]).astype(int)]
    across, up = plane = [i for i in range(3) if i != axis]
    lengths = {label: np.linalg.norm(field, axis=1) * 1e3 for label, field in fields.items()}
    top = scale_end(np.linalg.norm(first, axis=1) * 1e3)
    gain = field_gain(step, top)
    low, high = points.min(axis=0) - step, points.max(axis=0) + step
    height = (WIDTH - 0.9) / len(layers) * (high[up] - low[up]) / (high[across] - low[across])
    with new_figure(WIDTH, 1.4 + len(fields) * (height + 0.1), **{"axes.titlelocation": "center"}) as figure:
        panels: Any = figure.subplots(len(fields), len(layers), squeeze=False, sharex=True, sharey=True)
        for row, (label, field) in enumerate(fields.items()):
            for column, number in enumerate(layers):
                axes, rows = panels[row, column], layer == number
                places, colours = points[rows][:, plane].T, viridis(lengths[label][rows] / top) / 255.0
                axes.plot(*places, ".", color=SOFT, markersize=1.2, zorder=1.0)
                axes.quiver(*places, *(field[rows][:, plane] * gain).T, color=colours, **ARROWS)
                axes.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect="equal")
                if row == 0:
                    axes.set_title(f"{'xyz'[axis]} = {points[rows][0, axis]:.2f} m".replace("-", "−"))
                if row == len(fields) - 1:
                    axes.set_xlabel(f"{'xyz'[across]} (m)")
                if column == 0:
                    axes.set_ylabel(f"{label}\n{'xyz'[up]} (m)")
        colour_bar(figure, panels, top, next(iter(fields)))
        rows = np.isin(layer, layers)
        means = change({label: float(mm[rows].mean()) for label, mm in lengths.items()}, "mm")
        figure.suptitle(f"Mean error in slices: {means}; arrows ×{gain:g}", fontweight="bold", fontsize=9.0)
    return figure


def error_per_pose(errors: Mapping[str, ArrayLike], *, quantity: str = "position error", unit: str = "mm") -> Figure:
    """Error at each test pose on a logarithmic axis, a mark per pose and method: before and after calibration.

    Args:
        errors: For each method, by label, its errors ``(N,)``, in ``unit``.
        quantity: What the errors are.
        unit: Their unit.
    """
    series = style.finite_series(errors)
    with style.new_figure(style.WIDTH, 2.9) as figure:
        axes = figure.add_subplot(xlabel="test pose (number)", ylabel=f"{quantity} ({unit})")
        style.headline(axes, _better(series))
        for label, values, colour in style.coloured(series):
            number = np.arange(1, len(values) + 1)
            name = f"{label}: mean {values.mean():.2f} {unit}, max {values.max():.2f} {unit}"
            axes.plot(number, values, "o", color=colour, label=name, markersize=3.0)
        longest = max(len(values) for values in series.values())
        axes.set(xlim=(0.5, longest + 0.5), yscale="log")
        style.plain_decades(axes.yaxis)
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def error_by_method(
    errors: Mapping[str, ArrayLike],
    *,
    quantity: str = "position error",
    unit: str = "mm",
    logarithmic: bool = False,
    counted: str = "poses",
) -> Figure:
    """Box plot of errors by method: quartiles, whiskers to 1.5 times their distance, outliers and mean.

    Args:
        errors: For each method, by label, its errors ``(N,)`` in ``unit``.
        quantity: What the errors are, for the axis.
        unit: Their unit.
        logarithmic: Logarithmic error axis, for methods that are decades apart.
        counted: What the numbers under the labels count.
    """
    series = style.finite_series(errors)
    with style.new_figure(max(style.COLUMN, 1.2 + 0.9 * len(series)), 2.9) as figure:
        axes = figure.add_subplot(ylabel=f"{quantity} ({unit})", xlabel=f"method (number of {counted})")
        means = style.change({label: float(values.mean()) for label, values in series.items()}, unit)
        style.headline(axes, f"Mean {quantity}{' of reaches' * (counted == 'reaches')}: {means}", pad=16.0)
        boxes = axes.boxplot(list(series.values()), widths=0.55, patch_artist=True, showmeans=True, **BOXES)
        names = []
        for box, (label, values, colour) in zip(boxes["boxes"], style.coloured(series), strict=True):
            box.set(facecolor=(*colour, 0.75), edgecolor=style.SOFT)
            name = label if len(label) <= WIDEST else label.replace("+", "\n+")
            names.append(f"{name}\n({len(values)})")
            axes.annotate(f"{values.mean():.3g}", (len(names) + 0.3, values.mean()), va="center", fontsize=7.5)
        axes.set_xticks(range(1, len(names) + 1), names)
        axes.grid(axis="x", visible=False)
        if logarithmic:
            axes.set_yscale("log")
            style.plain_decades(axes.yaxis)
        else:
            axes.set_ylim(bottom=0.0)
        axes.annotate("◇ mean (number), ─ median", (0.0, 1.02), xycoords="axes fraction", va="bottom", fontsize=7.5)
    return figure


def error_histogram(errors_mm: Mapping[str, ArrayLike]) -> Figure:
    """Histogram of errors, one outline per method over the same bins of round width.

    Args:
        errors_mm: For each method, by label, its errors ``(N,)``, mm.
    """
    series = style.finite_series(errors_mm)
    width = round_step((max(float(values.max()) for values in series.values()) or 1.0) / 40)
    with style.new_figure(style.COLUMN, 2.9) as figure:
        axes = figure.add_subplot(xlabel="position error (mm)", ylabel=f"share of poses in {width:g} mm (%)")
        style.headline(axes, f"Median: {style.change({n: float(np.median(v)) for n, v in series.items()}, 'mm')}")
        for label, values, colour in style.coloured(series):
            edges = width * np.arange(int(values.max() / width) + 2)
            share = np.full(len(values), 100.0 / len(values))
            look: dict[str, Any] = {"color": (*colour, 0.35), "edgecolor": colour, "histtype": "stepfilled"}
            axes.hist(values, edges.tolist(), weights=share, **look)
            axes.plot([], [], color=colour, linewidth=5.0, alpha=0.7, label=label)
        axes.set_xlim(left=0.0)
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def error_cumulative(
    errors: Mapping[str, ArrayLike],
    *,
    quantity: str = "position error",
    unit: str = "mm",
    tolerance: float | None = None,
    counted: str = "poses",
) -> Figure:
    """Empirical distribution function: the share of poses whose error is at most x, on a logarithmic axis.

    Args:
        errors: For each method, by label, its errors ``(N,)`` in ``unit``.
        quantity: What the errors are, for the axis.
        unit: Their unit.
        tolerance: Drawn as a line when given.
        counted: What the shares are of.
    """
    series = style.finite_series(errors)
    with style.new_figure(style.COLUMN, 2.9) as figure:
        axes = figure.add_subplot(xlabel=f"{quantity} ({unit})", ylabel=f"{counted} within it (%)")
        if tolerance is None:
            ends = {name: float(np.percentile(v, 95)) for name, v in series.items()}
            style.headline(axes, f"95 of 100 {counted} within: {style.change(ends, unit)}")
        else:
            shares = {name: 100.0 * float(np.mean(v <= tolerance)) for name, v in series.items()}
            style.headline(axes, f"Within {tolerance:g} {unit}: {style.change(shares, '%')}")
        for label, values, colour in style.coloured(series):
            axes.ecdf(values, color=colour, label=label)
        axes.set_xscale("log")
        axes.set_yticks(np.linspace(0.0, 1.0, 6), ["0", "20", "40", "60", "80", "100"])
        style.plain_decades(axes.xaxis)
        if tolerance is not None:
            label = f"tolerance {tolerance:g} {unit}"
            axes.axvline(tolerance, color=style.rgb([RED])[0], linestyle="--", linewidth=1.2, label=label)
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def error_against(
    cause: ArrayLike,
    errors_mm: Mapping[str, ArrayLike],
    *,
    name: str,
    unit: str,
    groups: int = 8,
) -> Figure:
    """Position error against what it may depend on: extension, payload, temperature; a mark per pose, and their mean.

    Args:
        cause: The quantity at each pose ``(N,)``, in ``unit``.
        errors_mm: For each method, by label, its errors ``(N,)``, mm.
        name: What the quantity is, for the axis.
        unit: Its unit.
        groups: Means are taken over so many groups of equal size, or over each value where there are fewer values.

    Raises:
        InputError: If a series has another length than ``cause``.
    """
    series = style.finite_series(errors_mm)
    (x,) = style.finite_series({name: cause}).values()
    for label, values in series.items():
        if len(values) != len(x):
            raise InputError(f"series '{label}' has {len(values)} errors for {len(x)} values of {name}; give as many")
    parts = _groups(x, groups)
    with style.new_figure(style.COLUMN, 2.9) as figure:
        axes = figure.add_subplot(xlabel=f"{name} ({unit})", ylabel="position error (mm)")
        last, values = list(series.items())[-1]
        ends = [(values[part].mean(), x[part].mean()) for part in (parts[0], parts[-1])]
        text = ", ".join(f"{style.short(mean)} mm at {style.short(place)} {unit}" for mean, place in ends)
        style.headline(axes, f"{last}: {text}", pad=16.0)
        axes.annotate("dots: poses, line: means of groups", (0.0, 1.02), xycoords="axes fraction", fontsize=7.5)
        for label, values, colour in style.coloured(series):
            axes.plot(x, values, ".", color=colour, markersize=3.0, alpha=0.45)
            means = np.array([[x[part].mean(), values[part].mean()] for part in parts])
            axes.plot(*means.T, "o-", color=colour, markersize=4.0, label=label)
        axes.set_ylim(bottom=0.0)
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def _better(series: Mapping[str, Array]) -> str:
    """At how many poses the last method errs less than the first, or a single one's mean."""
    (first, before), (last, after) = next(iter(series.items())), list(series.items())[-1]
    if first == last or len(before) != len(after):
        return f"{last} at {len(after)} poses: largest {style.short(float(after.max()))}"
    return f"{last} errs less than {first} at {int((after < before).sum())} of {len(after)} poses"


def _groups(x: Array, most: int) -> list[NDArray[np.intp]]:
    """Rows that lie together in ``x``: one group per value, or ``most`` of equal size where there are more values."""
    values = np.unique(x)
    if len(values) <= most:
        return [np.flatnonzero(x == value) for value in values]
    return np.array_split(np.argsort(x, kind="stable"), most)
