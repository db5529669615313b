"""Figures of a calibration for papers and reports: each function takes plain arrays and returns a matplotlib figure.

No global state of matplotlib is used, so figures can be made anywhere, also without a screen. Axes name their units.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.geometry import Array, Geometry
from pickenv.errors import InputError
from pickenv.files import write_whole
from pickenv.inspect.colours import OTHERS, RED, Rgb, policy_colours

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PIXELS_PER_INCH = 200
WIDTH = 8.0
"""Inches: 1600 pixels."""

STYLE: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
}
DARK = "0.25"


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write ``figure`` to ``path`` (the suffix gives the format, usually .png), whole or not at all.

    Raises:
        InputError: If the file cannot be written or matplotlib does not know its format.
    """
    path = Path(path)
    known = sorted(figure.canvas.get_supported_filetypes())
    if path.suffix.lstrip(".").lower() not in known:
        raise InputError(f"cannot write {path}: give a file name that ends in one of {', '.join(known)}")
    undated = {".png": {"Software": None}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    metadata: Any = undated.get(path.suffix.lower())
    return write_whole(path, lambda temporary: figure.savefig(temporary, dpi=PIXELS_PER_INCH, metadata=metadata))


@contextmanager
def style(**more: Any) -> Iterator[None]:
    """Draw in the house's style, and leave matplotlib's settings as they were."""
    import matplotlib

    settings: Any = {**STYLE, **more}
    with matplotlib.rc_context(settings):
        yield


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """An empty figure of ``width`` by ``height`` inches that belongs to no window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", **options)


def error_per_pose(errors_mm: Mapping[str, ArrayLike], *, tolerance_mm: float | None = None) -> Figure:
    """Position error at each test pose, one curve per method: before and after calibration.

    Args:
        errors_mm: For each method, by label, its errors ``(N,)``, mm.
        tolerance_mm: Drawn as a line when given.
    """
    series = _series(errors_mm)
    with style():
        figure = new_figure(WIDTH, 3.2)
        axes = figure.add_subplot(xlabel="test pose (number)", ylabel="position error (mm)")
        axes.set_title("Position error at each test pose")
        for (label, values), colour in zip(series.items(), _rgb(policy_colours(list(series))), strict=True):
            number = np.arange(1, len(values) + 1)
            name = f"{label}: mean {values.mean():.2f} mm, max {values.max():.2f} mm"
            axes.plot(number, values, "o-", color=colour, label=name, markersize=3.0, linewidth=1.1)
        if tolerance_mm is not None:
            name = f"tolerance {tolerance_mm:g} mm"
            axes.axhline(tolerance_mm, color=_rgb([RED])[0], linestyle="--", linewidth=1.2, label=name)
        longest = max(len(values) for values in series.values())
        axes.set(xlim=(0.5, longest + 0.5), ylim=(0.0, None))
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def error_by_method(
    errors: Mapping[str, ArrayLike], *, quantity: str = "position error", unit: str = "mm", logarithmic: bool = False
) -> Figure:
    """Box plot of errors by method: quartiles, whiskers to 1.5 times their distance, outliers and mean.

    Args:
        errors: For each method, by label, its errors ``(N,)`` in ``unit``.
        quantity: What the errors are, for the axis.
        unit: Their unit.
        logarithmic: Logarithmic error axis, for methods that are decades apart.
    """
    series = _series(errors)
    colours = _rgb(policy_colours(list(series)))
    with style():
        figure = new_figure(1.9 + 1.4 * len(series), 3.8)
        axes = figure.add_subplot(ylabel=f"{quantity} ({unit})", xlabel="method (number of poses)")
        axes.set_title(f"{quantity[:1].upper()}{quantity[1:]} by method")
        boxes = axes.boxplot(
            list(series.values()),
            widths=0.55,
            patch_artist=True,
            showmeans=True,
            medianprops={"color": "black", "linewidth": 1.4},
            meanprops={"marker": "D", "markerfacecolor": "white", "markeredgecolor": "black", "markersize": 4.5},
            flierprops={"marker": "o", "markersize": 3.0, "markeredgecolor": DARK, "alpha": 0.6},
            whiskerprops={"color": DARK},
            capprops={"color": DARK},
        )
        for box, colour in zip(boxes["boxes"], colours, strict=True):
            box.set(facecolor=(*colour, 0.75), edgecolor=DARK)
        for i, values in enumerate(series.values(), start=1):
            text = f"{values.mean():.3g}"
            axes.annotate(text, (i + 0.3, values.mean()), va="center", fontsize=8)
        axes.set_xticks(range(1, len(series) + 1), [f"{label}\n({len(values)})" for label, values in series.items()])
        axes.grid(axis="x", visible=False)
        if logarithmic:
            axes.set_yscale("log")
            _plain_decades(axes.yaxis)
        else:
            axes.set_ylim(bottom=0.0)
        axes.annotate("◇ mean (numbers), ─ median", (1.0, 1.0), xycoords="axes fraction", ha="right", fontsize=8)
    return figure


def least_squares_convergence(residual_rms_mm: ArrayLike, attitude_rms_deg: ArrayLike | None = None) -> Figure:
    """Residual after each iteration of the least squares, starting with the nominal arm, on a logarithmic axis.

    Args:
        residual_rms_mm: Position residual RMS ``(I + 1,)``, mm.
        attitude_rms_deg: Attitude residual RMS ``(I + 1,)``, degrees, in a panel of its own.
    """
    from matplotlib.ticker import MaxNLocator

    curves = {"position residual, RMS (mm)": residual_rms_mm}
    if attitude_rms_deg is not None:
        curves["attitude residual, RMS (deg)"] = attitude_rms_deg
    series, (blue,) = _series(curves), _rgb(policy_colours(["ls"]))
    with style():
        figure = new_figure(WIDTH * (0.6 if len(series) == 1 else 1.0), 3.2)
        panels: Any = figure.subplots(1, len(series), squeeze=False)[0]
        for axes, (label, values) in zip(panels, series.items(), strict=True):
            axes.semilogy(values, "o-", color=blue, markersize=4.0)
            for i in sorted({0, len(values) - 1}):
                text = f"{values[i]:.3g}"
                axes.annotate(
                    text, (i, values[i]), (5, 6), textcoords="offset points", ha="left" if i == 0 else "right"
                )
            axes.set(xlabel="iteration (number)", ylabel=label)
            axes.margins(y=0.12)
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
            _plain_decades(axes.yaxis)
        panels[0].set_title("Convergence of least squares")
    return figure


def network_convergence(
    training_loss: ArrayLike, validation_loss: ArrayLike | None = None, *, best_epoch: int | None = None
) -> Figure:
    """Loss of a residual network per epoch, on a logarithmic axis.

    Args:
        training_loss: Mean squared error ``(E,)`` on normalised targets, without unit.
        validation_loss: The same on held-out poses.
        best_epoch: Epoch (from 0) whose weights were kept; marked when given.
    """
    losses = {"training": training_loss} | ({} if validation_loss is None else {"validation": validation_loss})
    series, colours = _series(losses), _rgb([*policy_colours(["ls_bpnn"]), OTHERS[0]])
    with style():
        figure = new_figure(WIDTH * 0.6, 3.2)
        axes = figure.add_subplot(xlabel="epoch (number)", ylabel="loss, MSE of normalised targets (–)")
        axes.set_title("Convergence of the residual network")
        for (label, values), colour in zip(series.items(), colours, strict=False):
            axes.semilogy(values, color=colour, label=label)
        if best_epoch is not None:
            axes.axvline(best_epoch, color=DARK, linestyle=":", linewidth=1.2, label=f"kept: epoch {best_epoch}")
        _plain_decades(axes.yaxis)
        axes.legend()
    return figure


def parameter_spectrum(
    magnitudes: ArrayLike,
    kept: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    threshold: float | None = None,
    quantity: str | None = None,
) -> Figure:
    """What the poses can tell about each parameter: the diagonal of R of a pivoted QR, or singular values.

    Args:
        magnitudes: |R_ii| of a pivoted QR, or singular values ``(P,)``, all in one (scaled) unit.
        kept: Whether each one was kept ``(P,)``.
        names: Parameter names in the same order, for a diagonal of R; none for singular values.
        threshold: Value below which one is dropped; drawn when given.
        quantity: Name and unit for the axis; chosen by whether there are names when left out.
    """
    values, kept = _series({"magnitudes": magnitudes})["magnitudes"], np.asarray(kept, dtype=bool)
    if kept.shape != values.shape or (names is not None and len(names) != len(values)):
        raise InputError(f"there are {len(values)} magnitudes; give as many kept flags and names")
    floor = max(float(values.max()), 1e-300) * 1e-18
    drawn, place = np.maximum(values, floor), np.arange(len(values))
    blue, red = _rgb([*policy_colours(["ls"]), RED])
    diagonal = names is not None
    with style():
        figure = new_figure(WIDTH, 3.5)
        axes = figure.add_subplot(ylabel=quantity or f"{'|R$_{ii}$|' if diagonal else 'singular value'} (scaled, –)")
        axes.set_xlabel("parameter" if diagonal else "singular value (number)")
        axes.set_title(
            f"Identifiability: {int(kept.sum())} of {len(values)} {'parameters' if diagonal else 'values'} kept"
        )
        for chosen, colour, marker, label in ((kept, blue, "o", "kept"), (~kept, red, "x", "dropped")):
            axes.vlines(place[chosen], drawn.min() / 3.0, drawn[chosen], color=colour, linewidth=1.0, alpha=0.5)
            axes.plot(
                place[chosen], drawn[chosen], marker, color=colour, label=f"{label} ({int(chosen.sum())})", markersize=5
            )
        if threshold is not None:
            axes.axhline(threshold, color=DARK, linestyle="--", linewidth=1.2, label=f"threshold {threshold:.2g}")
        axes.set(yscale="log", xlim=(-0.7, len(values) - 0.3), ylim=(drawn.min() / 3.0, drawn.max() * 3.0))
        axes.grid(axis="x", visible=False)
        if names is not None:
            axes.set_xticks(place, list(names), rotation=90, fontsize=8)
            for tick, chosen in zip(axes.get_xticklabels(), kept, strict=True):
                tick.set_color("black" if chosen else red)
        else:
            axes.set_xticks(place, [str(i + 1) for i in place], fontsize=8)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=3, borderaxespad=0.2)
    return figure


def joint_coverage(geometry: Geometry, sets: Mapping[str, ArrayLike]) -> Figure:
    """How pose sets fill the joint ranges: each joint's distribution, and each pair of joints.

    Args:
        geometry: Gives the joints' names, kinds and limits, which frame the plots.
        sets: For each set, by label (identification, training, test), its joints ``(N, n)``, rad or m.
    """
    from matplotlib.lines import Line2D

    n = geometry.joints
    scale = np.where(geometry.prismatic, 1e3, 180.0 / np.pi)
    units = ["mm" if slides else "deg" for slides in geometry.prismatic]
    shown = {label: np.asarray(q, dtype=float).reshape(-1, n) * scale for label, q in sets.items()}
    lower, upper = geometry.lower * scale, geometry.upper * scale
    colours = _rgb([OTHERS[0], OTHERS[1], (70, 70, 78), *OTHERS[2:]])  # sets are not policies
    with style(**{"font.size": 7.5, "axes.grid": False}):
        figure = new_figure(WIDTH, WIDTH * 0.95)
        grid: Any = figure.subplots(n, n, squeeze=False)
        for row, column in np.ndindex(n, n):
            axes = grid[row, column]
            if column > row:
                axes.set_axis_off()
                continue
            axes.set_xlim(lower[column], upper[column])
            for q, colour in zip(shown.values(), colours, strict=False):
                if row == column:
                    bins = np.linspace(lower[row], upper[row], 13)
                    axes.hist(q[:, row], bins, density=True, histtype="step", color=colour, linewidth=1.2)
                else:
                    axes.scatter(q[:, column], q[:, row], s=3.0, color=colour, alpha=0.6, linewidths=0.0)
            if row == column:
                axes.set_yticks([])
                axes.spines["left"].set_visible(False)
                axes.set_title(geometry.joint_names[row], fontsize=7.5, loc="center")
            else:
                axes.set_ylim(lower[row], upper[row])
            axes.tick_params(length=2.0, labelbottom=row == n - 1, labelleft=column == 0 and row > 0)
            if row == n - 1:
                axes.set_xlabel(f"q{column + 1} ({units[column]})")
            if column == 0 and row > 0:
                axes.set_ylabel(f"q{row + 1} ({units[row]})")
        grid[0, 0].set_ylabel("density (relative)")
        figure.align_ylabels(grid[:, 0])
        figure.suptitle("Joint configurations within the joint limits", fontweight="bold")
        handles = [
            Line2D([], [], color=colour, marker="o", markersize=4, label=f"{label} ({len(q)})")
            for (label, q), colour in zip(shown.items(), colours, strict=False)
        ]
        figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.97, 0.93), fontsize=9.5)
    return figure


def _series(curves: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """The curves as finite arrays ``(N,)``; an empty or a non-finite one is refused by name."""
    series = {str(label): np.asarray(values, dtype=float).ravel() for label, values in curves.items()}
    if not series:
        raise InputError("there is nothing to draw; give at least one series")
    for label, values in series.items():
        if not values.size or not np.isfinite(values).all():
            raise InputError(f"series '{label}' is empty or not finite; give finite numbers to draw")
    return series


def _plain_decades(axis: Any) -> None:
    """Write a logarithmic axis's ticks as plain numbers: 0.5 instead of 5 × 10 to the power of −1."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    within_a_decade = high < 10.0 * low
    axis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0) if within_a_decade else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _rgb(colours: Sequence[Rgb]) -> list[tuple[float, float, float]]:
    return [(red / 255.0, green / 255.0, blue / 255.0) for red, green, blue in colours]
