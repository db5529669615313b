"""Figures of errors: arrows across the workspace or on pictures of a board, errors by pose and method, distributions.

This module itself projects fields orthographically, so that arrows are drawn from far to near and stay crisp at any
size. On pictures of a board, an arrow points from the predicted to the detected position of a corner. Arrows are drawn
longer than true by a factor, which each figure states. Their colour shows the true length. Units: m, mm, px.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.quiver import Quiver
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from pickenv.arm import Array, nominal_points
from pickenv.base import InputError
from pickenv.inspect.colours import RED, in_words, viridis
from pickenv.inspect.figures import style
from pickenv.inspect.runs import comparison_summary as summary
from pickenv.inspect.runs.recorded_episodes import Comparison
from pickenv.inspect.runs.run_folder import eye_direction, shown_box
from pickenv.inspect.runs.traces import ViewErrors

PANEL_WIDTH, BESIDE_PANELS = style.WIDTH / 3.0, 1.85
"""Width of one panel, and height of the titles and the colour bar together, inches."""

QUIVER: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "headwidth": 3.5, "minlength": 0.0}
"""Matplotlib's settings for arrows whose vectors are in the units of the axes."""

SLICES = 3
"""Largest number of slices of a field that are drawn, equally spaced among the layers of its grid."""

LONGEST = 0.1
"""Length of the longest arrow, as a share of the picture's width."""

MOST_VIEWS, BESIDE = 9, 3
"""Largest number of views drawn, the worst first, and number of views in a row."""

PICTURE_WIDTH, FAINT = 320, 0.4
"""Width, px, and opacity of the pictures behind arrows."""
ARROWS: dict[str, Any] = QUIVER | {"scale": 1.0, "width": 0.008, "zorder": 2.0}
CENTRED = {"axes.titlelocation": "center"}
GROUPS = 8
"""Largest number of groups of poses whose mean errors are drawn against a possible cause."""
WIDEST = 16
"""Largest number of characters of a label on one line; longer labels break before each +."""


def error_fields(comparison: Comparison) -> Figure:
    """Draw the error field of each policy, side by side.

    Arrows point from the wanted to the true tool position. Their colour shows the true length of the error.

    Raises:
        InputError: If there is no policy or no field point.
    """
    policies = comparison.policies
    if not policies or not len(comparison.grid.points):
        raise InputError("there is no error field to draw; give at least one policy and one field point")
    rows, _ = thinned(comparison)
    top = summary.colour_scale_mm(comparison)
    gain = field_gain(comparison.grid.step, top)
    view = _View(comparison)
    width, height = view.high - view.low
    height = min(0.93 * PANEL_WIDTH * height / width, PANEL_WIDTH)
    with style.new_figure(PANEL_WIDTH * max(len(policies), 3), height + BESIDE_PANELS, **CENTRED) as figure:
        panels = figure.subplots(1, len(policies), squeeze=False)[0]
        means = {}
        for axes, policy in zip(panels, policies, strict=True):
            _box(axes, view)
            _ghost_arm(axes, comparison, view)
            _arrows(axes, view, comparison.grid.points[rows], policy.field_errors[rows], gain, top)
            axes.set(xlim=(view.low[0], view.high[0]), ylim=(view.low[1], view.high[1]), aspect="equal")
            axes.set_axis_off()
            axes.set_title(in_words(policy.label).replace(" + ", "\n+ "), fontsize=12, weight="bold", pad=15.0)
            means[policy.label], *_, largest = summary.error_spread(summary.field_mm(policy))
            text = f"mean {means[policy.label]:.2f} mm, max {largest:.2f} mm"
            axes.text(0.5, 1.01, text, transform=axes.transAxes, ha="center", fontsize=8)
        cast("ConstrainedLayoutEngine", figure.get_layout_engine()).set(h_pad=0.11)
        title = in_words(f"Mean error across the workspace: {style.change(means, 'mm')}")
        figure.suptitle(f"{title}\nwanted (dot) to true position ×{gain:g}", fontsize=10)
        field_colour_bar(figure, panels, top, policies[0].label)
    return figure


def thinned(comparison: Comparison, most: int = 400) -> tuple[NDArray[np.intp], float]:
    """Choose evenly spaced points of a field to draw, at most ``most``: every second, third … cell along each axis.

    More arrows would cover each other. All points are chosen if every even spacing leaves too many points or none.

    Returns:
        Indices of the points, from 0 in the field, and the distance between neighbouring points, m.
    """
    for stride in itertools.count(1):
        rows = np.flatnonzero(np.all(comparison.grid.index % stride == (stride - 1) // 2, axis=-1))
        if 0 < len(rows) <= most:
            return rows, stride * comparison.grid.step
        if not len(rows):
            break
    return np.arange(len(comparison.grid.points)), comparison.grid.step


def field_gain(step: float, top_mm: float) -> float:
    """Return the factor, a round number, by which all figures of a field draw arrows longer than true.

    The factor is `comparison_summary.GAIN`, as in recordings, if the longest arrow is then 0.25 to 1.5 cells long.
    Otherwise the factor makes the longest arrow about one cell long, so that neighbouring arrows nearly touch.

    Args:
        step: Cell size of the field, m.
        top_mm: Upper end of the colour scale, mm.
    """
    cells = summary.GAIN * top_mm * 1e-3 / step
    return summary.GAIN if 0.25 <= cells <= 1.5 else round_down(1.1 * step / (top_mm * 1e-3))


def round_down(value: float) -> float:
    """Round a factor down to 1, 2, 3, 4, 5 or 8 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(m for m in (1.0, 2.0, 3.0, 4.0, 5.0, 8.0) if m * power <= value * (1.0 + 1e-9)))


class _View:
    """Orthographic projection along the eye's direction; x to the right, y up, depth towards the eye. Units: m.

    `corners` ``(8, 3)`` are the corners of the field's box. Bits 4, 2 and 1 of a corner's index say whether its x, y
    and z are at their maximum. `low` and `high` ``(2,)`` bound a panel: the box, and room for the text along its edges.
    """

    def __init__(self, comparison: Comparison) -> None:
        self.centre, self.radius = shown_box(comparison)
        self.eye = eye_direction(comparison)
        right = np.cross([0.0, 0.0, 1.0], self.eye)
        right /= np.linalg.norm(right)
        self.plane = np.stack([right, np.cross(self.eye, right)], axis=-1)
        low = comparison.grid.corner
        high = low + comparison.grid.size
        self.corners = np.where(np.array(list(itertools.product((False, True), repeat=3))), high, low)
        flat, margin = self.flat(self.corners), 0.15 * self.radius
        self.low, self.high = flat.min(axis=0) - margin, flat.max(axis=0) + margin * np.array([1.0, 0.2])

    def flat(self, points: Array) -> Array:
        """Project points ``(..., 3)`` onto the picture's plane ``(..., 2)``."""
        return np.asarray((points - self.centre) @ self.plane)

    def depth(self, points: Array) -> Array:
        """Return the nearness ``(...)`` of points ``(..., 3)`` to the eye, m: larger is nearer."""
        return np.asarray((points - self.centre) @ self.eye)


def _arrows(axes: Axes, view: _View, start: Array, error: Array, gain: float, top: float) -> None:
    """Draw errors as arrows, from far to near.

    Args:
        axes: The panel.
        view: The projection.
        start: Points at which the arrows start ``(N, 3)``, m.
        error: The errors ``(N, 3)``, m.
        gain: Factor by which arrows are drawn longer than the errors.
        top: Upper end of the colour scale, mm.
    """
    order = np.argsort(view.depth(start))
    start, error = start[order], error[order]
    colours = viridis(np.linalg.norm(error, axis=-1) * 1e3 / top) / 255.0
    tail, tip = view.flat(start), view.flat(start + gain * error)
    axes.scatter(tail[:, 0], tail[:, 1], s=2.2, color=style.SOFT, linewidths=0.0, zorder=2.0)
    look: dict[str, Any] = {"facecolors": colours, "edgecolors": style.SOFT, "linewidths": 0.3, "zorder": 3.0}
    look |= {"units": "xy", "width": 0.013 * view.radius, "headlength": 3.5, "headaxislength": 3.5}
    axes.quiver(*tail.T, *(tip - tail).T, **ARROWS | look)


def _box(axes: Axes, view: _View) -> None:
    """Draw a wire box around the field, with each axis's range written along one of its edges."""
    farthest = int(np.argmin(view.depth(view.corners)))
    for edge in itertools.combinations(range(8), 2):
        if (edge[0] ^ edge[1]).bit_count() == 1:
            width, line, alpha = (0.5, ":", 0.6) if farthest in edge else (0.9, "-", 1.0)
            ends = view.flat(view.corners[list(edge)])
            axes.plot(*ends.T, color=style.SOFT, zorder=1.0, linewidth=width, linestyle=line, alpha=alpha)
    for axis in range(3):
        _axis_text(axes, view, axis)


def _axis_text(axes: Axes, view: _View, axis: int) -> None:
    """Write an axis's name, unit and range outside the lowest edge of the box that is parallel to the axis.

    The ``axis`` is 0 for x, 1 for y and 2 for z. For z the leftmost edge is taken in place of the lowest.
    """
    bit = 4 >> axis
    flat, values = view.flat(view.corners), view.corners[:, axis]
    edges = [(i, i | bit) for i in range(8) if not i & bit]
    low, high = min(edges, key=lambda edge: float(flat[list(edge), 0 if axis == 2 else 1].mean()))
    middle, along = (flat[low] + flat[high]) / 2.0, flat[high] - flat[low]
    outward = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    outward *= np.sign(outward @ middle) or 1.0
    angle = 90.0 - (90.0 - np.degrees(np.arctan2(along[1], along[0]))) % 180.0
    words = f"{'xyz'[axis]} (m): {values[low]:.2f} to {values[high]:.2f}".replace("-", "−")
    look: dict[str, Any] = {"ha": "center", "va": "center", "rotation": angle, "fontsize": 7.5, "zorder": 4.0}
    x, y = middle + 0.1 * view.radius * outward
    axes.text(x, y, words, **look)


def _ghost_arm(axes: Axes, comparison: Comparison, view: _View) -> None:
    """Draw the nominal arm, for orientation, at the end of the reach whose fruit is nearest to the field's middle."""
    if not len(comparison.fruit):
        return
    nearest = int(np.argmin(np.linalg.norm(comparison.fruit - view.centre, axis=-1)))
    flat = view.flat(nominal_points(comparison.nominal, comparison.policies[0].ends.joint_command[nearest]))
    for i in range(len(flat) - 1):
        thickness = 6.0 - 3.5 * i / (len(flat) - 1)
        axes.plot(*flat[i : i + 2].T, color=style.RULE, linewidth=thickness, solid_capstyle="round", zorder=1.5)


def field_colour_bar(figure: Figure, panels: Any, top: float, first: str) -> None:
    """Draw one colour bar for all panels, Viridis from 0 to ``top``.

    Args:
        figure: The figure.
        panels: The panels.
        top: Upper end of the scale, mm.
        first: Label of the policy whose errors determine the upper end.
    """
    scale = ScalarMappable(Normalize(0.0, top), "viridis")
    look: dict[str, Any] = {"location": "bottom", "aspect": 60, "shrink": 0.8, "pad": 0.02, "extend": "max"}
    end = f"the colour saturates above {top:.3g} mm, the {summary.SCALE_PERCENTILE:g}th percentile of {first}"
    look |= {"ticks": summary.ticks(top), "label": f"position error (mm); {end}"}
    style.colour_bar(figure, scale, list(np.ravel(panels)), **look)


def error_slices(points: ArrayLike, errors: Mapping[str, ArrayLike], *, step: float) -> Figure:
    """Draw position errors in slices of a regular grid as quiver plots, in one row of panels per method.

    All panels share one colour scale and one gain, the factor by which arrows are longer than true. Arrows show the two
    components of the error within the slice. Their colour shows the length of the whole error. Slices are taken across
    the axis along which the first method's errors are smallest, so that the arrows show most of the errors.

    Args:
        points: Wanted tool positions on the grid ``(F, 3)``, m.
        errors: True minus wanted position ``(F, 3)``, m, for each method, by label.
        step: Distance of neighbouring grid points, m.

    Raises:
        InputError: If there is nothing to draw or a shape does not fit.
    """
    points = np.asarray(points, dtype=float)
    fields = {label: np.asarray(values, dtype=float) for label, values in errors.items()}
    if not len(points) or not fields or any(field.shape != points.shape for field in fields.values()):
        raise InputError("an error field needs points (F, 3) and errors (F, 3) for each method; give at least one")
    first = next(iter(fields.values()))
    axis = int(np.argmin(np.mean(first**2, axis=0)))
    layer = np.rint((points[:, axis] - points[:, axis].min()) / step).astype(int)
    layers = np.unique(layer)
    if len(layers) > SLICES:
        layers = layers[np.rint(np.linspace(0, len(layers) - 1, SLICES + 2)[1:-1]).astype(int)]
    across, up = plane = [i for i in range(3) if i != axis]
    lengths = {label: np.linalg.norm(field, axis=1) * 1e3 for label, field in fields.items()}
    top = summary.scale_end(np.linalg.norm(first, axis=1) * 1e3)
    gain = field_gain(step, top)
    low, high = points.min(axis=0) - step, points.max(axis=0) + step
    height = (style.WIDTH - 0.9) / len(layers) * (high[up] - low[up]) / (high[across] - low[across])
    with style.new_figure(style.WIDTH, 1.4 + len(fields) * (height + 0.1), **CENTRED) as figure:
        panels: Any = figure.subplots(len(fields), len(layers), squeeze=False, sharex=True, sharey=True)
        for row, (label, field) in enumerate(fields.items()):
            for column, number in enumerate(layers):
                axes, rows = panels[row, column], layer == number
                places, colours = points[rows][:, plane].T, viridis(lengths[label][rows] / top) / 255.0
                axes.plot(*places, ".", color=style.SOFT, markersize=1.2, zorder=1.0)
                axes.quiver(*places, *(field[rows][:, plane] * gain).T, color=colours, **ARROWS)
                axes.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect="equal")
                if row == 0:
                    axes.set_title(f"{'xyz'[axis]} = {points[rows][0, axis]:.2f} m".replace("-", "−"))
                if row == len(fields) - 1:
                    axes.set_xlabel(f"{'xyz'[across]} (m)")
                if column == 0:
                    axes.set_ylabel(f"{in_words(label)}\n{'xyz'[up]} (m)")
        field_colour_bar(figure, panels, top, next(iter(fields)))
        rows = np.isin(layer, layers)
        means = style.change({label: float(mm[rows].mean()) for label, mm in lengths.items()}, "mm")
        figure.suptitle(in_words(f"Mean error in slices: {means}; arrows ×{gain:g}"), fontweight="bold", fontsize=9.0)
    return figure


def error_per_pose(errors: Mapping[str, ArrayLike], *, quantity: str = "position error", unit: str = "mm") -> Figure:
    """Draw the error of each method, such as before and after calibration, at each test pose, on a logarithmic axis.

    Args:
        errors: For each method, by label, its errors ``(N,)``, in ``unit``.
        quantity: Name of the error, for the axis label.
        unit: Unit of the errors.
    """
    series = style.finite_series(errors)
    with style.new_panel(style.WIDTH, 2.9, "test pose (number)", f"{quantity} ({unit})", legend=2) as (figure, axes):
        style.headline(axes, _better(series))
        for label, values, colour in style.coloured(series):
            name = f"{label}: mean {values.mean():.2f} {unit}, max {values.max():.2f} {unit}"
            axes.plot(np.arange(1, len(values) + 1), values, "o", color=colour, label=name, markersize=3.0)
        axes.set(xlim=(0.5, max(map(len, series.values())) + 0.5), yscale="log")
        style.plain_decades(axes.yaxis)
    return figure


def error_by_method(
    errors: Mapping[str, ArrayLike],
    *,
    quantity: str = "position error",
    unit: str = "mm",
    logarithmic: bool = False,
    counted: str = "poses",
) -> Figure:
    """Draw box plots of errors by method: quartiles, whiskers to 1.5 interquartile ranges, outliers and mean.

    Args:
        errors: For each method, by label, its errors ``(N,)`` in ``unit``.
        quantity: Name of the error, for the axis label.
        unit: Unit of the errors.
        logarithmic: Whether the error axis is logarithmic, for methods whose errors differ by powers of ten.
        counted: What each error belongs to, such as poses, for the axis label.
    """
    series = style.finite_series(errors)
    width = max(style.COLUMN, 1.2 + 0.9 * len(series))
    with style.new_panel(width, 2.9, f"method (number of {counted})", f"{quantity} ({unit})") as (figure, axes):
        means = style.change({label: float(values.mean()) for label, values in series.items()}, unit)
        style.headline(axes, f"Mean {quantity}{' of reaches' * (counted == 'reaches')}: {means}", pad=16.0)
        boxes = axes.boxplot(list(series.values()), widths=0.55, flierprops={"alpha": 0.7})
        names = []
        for box, (label, values, colour) in zip(boxes["boxes"], style.coloured(series), strict=True):
            box.set(facecolor=(*colour, 0.75), edgecolor=style.SOFT)
            name = label if len(label) <= WIDEST else label.replace(" + ", "\n+ ")
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
    """Draw a histogram of errors, with one outline per method over the same bins of round width.

    Args:
        errors_mm: For each method, by label, its errors ``(N,)``, mm.
    """
    series = style.finite_series(errors_mm)
    width = summary.round_step((max(float(values.max()) for values in series.values()) or 1.0) / 40)
    share = f"share of poses in {width:g} mm (%)"
    with style.new_panel(style.COLUMN, 2.9, "position error (mm)", share, legend=2) as (figure, axes):
        style.headline(axes, f"Median: {style.change({n: float(np.median(v)) for n, v in series.items()}, 'mm')}")
        for label, values, colour in style.coloured(series):
            edges = width * np.arange(int(values.max() / width) + 2)
            weights = np.full(len(values), 100.0 / len(values))
            look: dict[str, Any] = {"color": (*colour, 0.35), "edgecolor": colour, "histtype": "stepfilled"}
            axes.hist(values, edges.tolist(), weights=weights, **look)
            axes.plot([], [], color=colour, linewidth=5.0, alpha=0.7, label=label)
        axes.set_xlim(left=0.0)
    return figure


def error_cumulative(
    errors: Mapping[str, ArrayLike],
    *,
    quantity: str = "position error",
    unit: str = "mm",
    tolerance: float | None = None,
    counted: str = "poses",
) -> Figure:
    """Draw the empirical distribution function of errors: the share of poses with an error of at most x.

    The error axis is logarithmic.

    Args:
        errors: For each method, by label, its errors ``(N,)`` in ``unit``.
        quantity: Name of the error, for the axis label.
        unit: Unit of the errors.
        tolerance: Tolerance in ``unit``, drawn as a line; None for no line.
        counted: What each error belongs to, such as poses, for the axis label.
    """
    series = style.finite_series(errors)
    words = f"{quantity} ({unit})", f"{counted} within it (%)"
    with style.new_panel(style.COLUMN, 2.9, *words, legend=2) as (figure, axes):
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
    return figure


def error_against(cause: ArrayLike, errors_mm: Mapping[str, ArrayLike], *, name: str, unit: str) -> Figure:
    """Draw the position error at each pose against a possible cause, with the means of groups of poses.

    Causes are, for example, extension, payload and temperature.

    Args:
        cause: Values of the cause at each pose ``(N,)``, in ``unit``.
        errors_mm: For each method, by label, its errors ``(N,)``, mm.
        name: Name of the cause, for the axis label.
        unit: Unit of the cause.

    Raises:
        InputError: If a series has another length than ``cause``.
    """
    series = style.finite_series(errors_mm)
    (x,) = style.finite_series({name: cause}).values()
    for label, values in series.items():
        if len(values) != len(x):
            raise InputError(f"series '{label}' has {len(values)} errors for {len(x)} values of {name}; give as many")
    parts = _groups(x)
    with style.new_panel(style.COLUMN, 2.9, f"{name} ({unit})", "position error (mm)", legend=2) as (figure, axes):
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
    return figure


def _better(series: Mapping[str, Array]) -> str:
    """Return a title that says at how many poses the last method errs less than the first.

    The ``series`` are errors by the method's label. With only one method, the title is this method's largest error.
    """
    (first, before), (last, after) = next(iter(series.items())), list(series.items())[-1]
    if first == last or len(before) != len(after):
        return f"{last} at {len(after)} poses: largest {style.short(float(after.max()))}"
    return f"{last} errs less than {first} at {int((after < before).sum())} of {len(after)} poses"


def _groups(x: Array) -> list[NDArray[np.intp]]:
    """Group rows by their values ``x``, and return the row indices of each group.

    Indices are from 0. Each distinct value has a group. If there are more than `GROUPS` distinct values, the rows are
    divided into `GROUPS` equal groups instead.
    """
    values = np.unique(x)
    if len(values) <= GROUPS:
        return [np.flatnonzero(x == value) for value in values]
    return np.array_split(np.argsort(x, kind="stable"), GROUPS)


def corner_errors(views: Sequence[ViewErrors]) -> Figure:
    """Draw the reprojection errors of all views (pictures of a board) in one image plane.

    Lens distortion that the camera model does not describe shows as a pattern.

    Raises:
        InputError: If there is no corner to draw.
    """
    size = _size(views)
    places, errors = np.concatenate([v.found for v in views]), np.concatenate([v.errors for v in views])
    together, (gain, top) = ViewErrors("all", places, errors, size), _scale(views)
    height = style.WIDTH * 0.72 * size[1] / size[0] + 0.6
    with style.new_panel(style.WIDTH, height, "u (px)", "v (px)") as (figure, axes):
        corners = f"{len(errors)} corners of {len(views)} views"
        axes.set_title(f"{together.rms:.3g} px RMS over {corners}, errors drawn ×{gain:g}")
        style.colour_bar(figure, _draw(axes, together, gain, top), axes, label="error (px)")
    return figure


def view_errors(views: Sequence[ViewErrors]) -> Figure:
    """Draw the reprojection errors of the nine worst views (pictures of a board), each on its picture, the worst first.

    If the file of a picture is unknown or cannot be read, only the arrows are drawn.

    Raises:
        InputError: If there is no corner to draw.
    """
    gain, top = _scale(views)
    worst = sorted(views, key=lambda view: -view.rms)[:MOST_VIEWS]
    lines, width, height = -(-len(worst) // BESIDE), *_size(views)
    panel = 0.9 * style.WIDTH / BESIDE * height / width + 0.2
    with style.new_figure(style.WIDTH, lines * panel + 1.1, **{"axes.grid": False}) as figure:
        panels = figure.subplots(lines, BESIDE, squeeze=False, sharex=True, sharey=True)
        for axes, view in zip(panels.flat, worst, strict=False):
            if view.picture is not None and (grey := faint_picture(view.picture)) is not None:
                extent = (-0.5, width - 0.5, height - 0.5, -0.5)
                axes.imshow(grey, extent=extent, cmap="gray", vmin=0, vmax=255, alpha=FAINT, interpolation="none")
            arrows = _draw(axes, view, gain, top, 2.0)
            axes.set_title(f"{view.name}: {view.rms:.3g} px", fontsize=8.0)
        for axes in panels.flat[len(worst) :]:
            axes.set_axis_off()
        for axes in panels[:, 0]:
            axes.set_ylabel("v (px)")
        for k in range(min(BESIDE, len(worst))):
            last = panels.flat[max(range(k, len(worst), BESIDE))]
            last.set_xlabel("u (px)")
            last.tick_params(labelbottom=True)
        ends = " to ".join(dict.fromkeys(f"{view.rms:.3g}" for view in (worst[0], worst[-1])))
        figure.suptitle(f"The worst views: {ends} px RMS; errors drawn ×{gain:g}", fontsize=9.0)
        style.colour_bar(figure, arrows, panels, label="error (px)", location="bottom", shrink=0.5, aspect=40.0)
    return figure


def faint_picture(path: str | Path) -> Array | None:
    """Return the grey values ``(h, w)`` of a picture scaled to the width `PICTURE_WIDTH`; None if it cannot be read."""
    try:
        with Image.open(path) as opened:
            opened.draft("L", (PICTURE_WIDTH, PICTURE_WIDTH))
            grey = ImageOps.exif_transpose(opened).convert("L")
            return np.asarray(grey.resize((PICTURE_WIDTH, round(PICTURE_WIDTH * grey.height / grey.width))))
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
        return None


def _size(views: Sequence[ViewErrors]) -> tuple[int, int]:
    if not views or not sum(len(view.errors) for view in views):
        raise InputError("there is no corner to draw; give views with errors")
    return views[0].size


def _scale(views: Sequence[ViewErrors]) -> tuple[float, float]:
    """Return the factor by which arrows on views are longer than true, and the longest error, px."""
    width, _ = _size(views)
    top = max(float(np.linalg.norm(view.errors, axis=1).max(initial=0.0)) for view in views)
    return round_down(LONGEST * width / max(top, 1e-9)), max(top, 1e-9)


def _draw(axes: Axes, view: ViewErrors, gain: float, top: float, thickness: float = 1.0) -> Quiver:
    width, height = view.size
    look = QUIVER | {"scale": 1.0 / gain, "width": 0.004 * thickness, "cmap": "viridis", "clim": (0.0, top)}
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    return axes.quiver(*(view.found - view.errors).T, *view.errors.T, np.linalg.norm(view.errors, axis=1), **look)
