"""Figures of an identification: convergence, identifiability from the poses, and coverage of the joint ranges.

Each function returns a matplotlib figure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from pickenv.arm import Geometry
from pickenv.base import InputError, count_of
from pickenv.inspect.colours import OTHERS, RED, policy_colours
from pickenv.inspect.figures import style

NAME_ROOM = 0.15
"""Width that a vertical name of a parameter takes along the axis, inches."""
NUMBER_ROOM = 0.22
"""Width that a number of up to three digits takes along the axis, inches."""


def least_squares_convergence(residual_rms_mm: ArrayLike, attitude_rms_deg: ArrayLike | None = None) -> Figure:
    """Draw the residual RMS before least squares and after each iteration, on a logarithmic axis.

    Args:
        residual_rms_mm: Position residual RMS ``(I + 1,)``, mm, for I iterations.
        attitude_rms_deg: Attitude residual RMS ``(I + 1,)``, degrees, for a panel of its own; None for no such panel.
    """
    curves = {"position residual, RMS (mm)": residual_rms_mm}
    if attitude_rms_deg is not None:
        curves["attitude residual, RMS (deg)"] = attitude_rms_deg
    series, (blue,) = style.finite_series(curves), style.rgb(policy_colours(["ls"]))
    rms = next(iter(series.values()))
    with style.new_figure(style.COLUMN if len(series) == 1 else style.WIDTH, 2.6) as figure:
        panels: Any = figure.subplots(1, len(series), squeeze=False)[0]
        for axes, (label, values) in zip(panels, series.items(), strict=True):
            axes.semilogy(values, "o-", color=blue, markersize=4.0)
            for i in sorted({0, len(values) - 1}):
                side = "left" if i == 0 else "right"
                axes.annotate(f"{values[i]:.3g}", (i, values[i]), (5, 6), textcoords="offset points", ha=side)
            axes.set(xlabel="iteration (number)", ylabel=label)
            axes.margins(y=0.12)
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
            style.plain_decades(axes.yaxis)
        first, last = (style.short(float(rms[i])) for i in (0, -1))
        style.headline(panels[0], f"Least squares: {first} to {last} mm in {count_of(len(rms) - 1, 'iteration')}")
    return figure


def network_convergence(loss: ArrayLike) -> Figure:
    """Draw the training loss of a residual network per epoch, on a logarithmic axis.

    Args:
        loss: Mean squared error ``(E,)`` on normalised targets, without unit.
    """
    (values,) = style.finite_series({"training": loss}).values()
    with style.new_panel(style.COLUMN, 2.9, "epoch (number)", "loss, MSE of normalised targets (–)") as (figure, axes):
        ends = " to ".join(style.short(float(values[i])) for i in (0, -1))
        style.headline(axes, f"Training loss: {ends} in {len(values)} epochs")
        axes.semilogy(values, color=style.rgb(policy_colours(["ls_bpnn"]))[0], label="training")
        style.plain_decades(axes.yaxis)
        axes.legend()
    return figure


def parameter_spectrum(
    magnitudes: ArrayLike, kept: ArrayLike, *, names: Sequence[str] | None = None, threshold: float | None = None
) -> Figure:
    """Draw how well the poses identify P parameters: the diagonal of R of a pivoted QR, or singular values.

    Args:
        magnitudes: |R_ii| of a pivoted QR, or singular values ``(P,)``, all in one (scaled) unit.
        kept: Whether each parameter (or singular value) was kept ``(P,)``.
        names: Parameter names in the same order, for a diagonal of R; None for singular values.
        threshold: Magnitude below which a parameter is dropped, drawn as a line; None for no line.
    """
    values, kept = style.finite_series({"magnitudes": magnitudes})["magnitudes"], np.asarray(kept, dtype=bool)
    if kept.shape != values.shape or (names is not None and len(names) != len(values)):
        raise InputError(f"there are {len(values)} magnitudes; give as many kept flags and names")
    floor = max(float(values.max()), 1e-300) * 1e-18
    heights, place = np.maximum(values, floor), np.arange(len(values))
    bottom = heights.min() / 3.0
    blue, red = style.rgb([*policy_colours(["ls"]), RED])
    diagonal = names is not None
    room = style.WIDTH - 0.9
    labels = style.spaced(names or [str(i + 1) for i in place], NAME_ROOM if diagonal else NUMBER_ROOM, room)
    x, y = ("parameter", "|R_ii|") if diagonal else ("singular value (number)", "singular value")
    height = 2.6 + 0.065 * max(map(len, ("8 points", *labels)))
    with style.new_panel(style.WIDTH, height, x, f"{y} (scaled, –)", legend=3) as (figure, axes):
        condition = float(values[kept].max() / values[kept].min()) if kept.any() else np.inf
        count = f"{int(kept.sum())} of {len(values)} parameters kept"
        style.headline(axes, f"Identifiability: {count if diagonal else f'condition number {condition:.3g}'}")
        for rows, colour, marker, label in ((kept, blue, "o", "kept"), (~kept, red, "x", "dropped")):
            if rows.any():
                axes.vlines(place[rows], bottom, heights[rows], color=colour, linewidth=1.0, alpha=0.5)
                label = f"{label} ({int(rows.sum())})"
                axes.plot(place[rows], heights[rows], marker, color=colour, label=label, markersize=5)
        if threshold is not None:
            axes.axhline(threshold, color=style.SOFT, linestyle="--", linewidth=1.2, label=f"threshold {threshold:.2g}")
        axes.set(yscale="log", xlim=(-0.7, len(values) - 0.3), ylim=(bottom, heights.max() * 3.0))
        axes.grid(axis="x", visible=False)
        axes.set_xticks(place, labels, rotation=90 if diagonal else 0, fontsize=8)
        if diagonal:
            if "" in labels:
                axes.set_xlabel(f"parameter ({len(labels) - labels.count('')} of {len(labels)} are named)")
            for tick, keep in zip(axes.get_xticklabels(), kept, strict=True):
                tick.set_color(style.INK if keep else red)
        style.plain_decades(axes.yaxis)
    return figure


def uncertainty_map(distance_mm: ArrayLike, height_mm: ArrayLike, uncertainty_mm: ArrayLike) -> Figure:
    """Draw a map of the mean uncertainty in square cells, 26 along the longer side.

    The axes are the distance from the base and the height.

    Args:
        distance_mm: Horizontal distance of the tool from the base at each pose ``(N,)``, mm.
        height_mm: Height of the tool above the base at each pose ``(N,)``, mm.
        uncertainty_mm: Standard uncertainty of the predicted tool position at each pose ``(N,)``, mm.
    """
    series = {"distance": distance_mm, "height": height_mm, "uncertainty": uncertainty_mm}
    x, y, values = style.finite_series(series).values()
    step = max(float(np.ptp(x)), float(np.ptp(y)), 1e-9) / 26
    edges = [v.min() + step * np.arange(int(np.ptp(v) // step) + 2) for v in (x, y)]
    count, total = (np.histogram2d(x, y, edges, weights=weights)[0].T for weights in (None, values))
    mean = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
    with style.new_panel(style.COLUMN, 3.0, "distance from base (mm)", "height (mm)") as (figure, axes):
        axes.grid(visible=False)
        middle, most = (style.short(float(v)) for v in (np.median(values), values.max()))
        style.headline(axes, f"Median {middle}, largest {most} mm")
        extent = (edges[0][0], edges[0][-1], edges[1][0], edges[1][-1])
        picture = axes.imshow(mean, origin="lower", extent=extent, cmap="viridis", interpolation="none")
        style.colour_bar(figure, picture, axes, label="standard uncertainty (mm)")
    return figure


def joint_coverage(geometry: Geometry, sets: Mapping[str, ArrayLike]) -> Figure:
    """Draw how pose sets cover the joint ranges: the distribution of each joint's values, and of each pair of joints.

    Args:
        geometry: Geometry with the joints' names, kinds and limits. The title says what share of these ranges the poses
            span.
        sets: Joint values ``(N, n)``, rad or m, of each pose set, by label (identification, training, test).
    """
    n, scale = geometry.joints, np.where(geometry.prismatic, 1e3, np.degrees(1.0))
    least, most = geometry.lower * scale, geometry.upper * scale
    units = ["mm" if slides else "deg" for slides in geometry.prismatic]
    poses = {label: np.asarray(q, dtype=float).reshape(-1, n) * scale for label, q in sets.items()}
    every = np.concatenate([*poses.values(), np.full((1, n), np.nan)])
    lower, upper = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    shares = 100.0 * (upper - lower) / (most - least)
    rim = np.where(upper > lower, 0.05 * (upper - lower), 0.01 * (most - least))
    lower, upper = lower - rim, upper + rim
    colours = style.rgb([OTHERS[0], OTHERS[1], OTHERS[3]])  # sets are not policies
    with style.new_figure(style.WIDTH, style.WIDTH * 0.95, **{"font.size": 7.5, "axes.grid": False}) as figure:
        grid: Any = figure.subplots(n, n, squeeze=False)
        for row, column in np.ndindex(n, n):
            axes = grid[row, column]
            if column > row:
                axes.set_axis_off()
                continue
            axes.set_xlim(lower[column], upper[column])
            for q, colour in zip(poses.values(), colours, strict=False):
                if row == column:
                    bins = np.linspace(lower[row], upper[row], 13)
                    axes.hist(q[:, row], bins, density=True, histtype="step", color=colour, linewidth=1.2)
                else:
                    dots: dict[str, Any] = {"s": 3.0, "alpha": 0.6, "linewidths": 0.0, "rasterized": True}
                    axes.scatter(q[:, column], q[:, row], color=colour, **dots)
            if row == column:
                axes.set_yticks([])
                axes.spines["left"].set_visible(False)
                axes.set_title(geometry.joint_names[row], fontsize=7.5, loc="center")
            else:
                axes.set_ylim(lower[row], upper[row])
            axes.tick_params(length=2.0, labelbottom=row == n - 1, labelleft=column == 0 and row > 0)
            if row == n - 1:
                axes.set_xlabel(f"q{column + 1} ({units[column]})")
            if column == 0:
                axes.set_ylabel(f"q{row + 1}\n({units[row]})")
        grid[0, 0].set_ylabel("density\n(relative)")
        figure.align_ylabels(grid[:, 0])
        ends = " to ".join(dict.fromkeys(f"{end:.0f}" for end in (shares.min(), shares.max())))
        figure.suptitle(f"Poses span {ends} % of the joint ranges; shown is what they span", fontweight="bold")
        handles = [
            Line2D([], [], color=colour, marker="o", markersize=4, label=f"{label} ({len(q)})")
            for (label, q), colour in zip(poses.items(), colours, strict=False)
        ]
        figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.97, 0.93), fontsize=9.5)
    return figure
