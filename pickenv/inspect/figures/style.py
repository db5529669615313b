"""Style and file output of figures for papers and reports, readable at column width and by colour-blind readers.

It uses no global state of matplotlib, so figures can be made anywhere, also without a screen. Axis labels name their
units.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from textwrap import fill, wrap
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.base import InputError, write_whole
from pickenv.inspect.colours import BLUE, GREEN, RED, Rgb, as_sentence, in_words, policy_colours

PIXELS_PER_INCH = 220
COLUMN, WIDTH = 3.5, 7.2
"""Widths of one column and of both columns of a journal's page, inches."""
LETTER = 0.083
"""Mean width of a letter of a title, inches."""
SMALL_LETTER, KEY = 0.064, 0.42
"""Mean width of a letter in a legend, and room for a mark and the gap beside it, inches."""
LINES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)))
MARKS = "os^Dv"
"""Markers, used in turn. With the line patterns `LINES`, they distinguish curves if colour has another meaning."""

_SHEET: Any = matplotlib.rc_params_from_file(Path(__file__).parent / "pickenv.mplstyle", use_default_template=False)
STYLE: dict[str, Any] = dict(_SHEET)
INK, SOFT, RULE, PAPER = STYLE["text.color"], STYLE["axes.edgecolor"], STYLE["grid.color"], "#ffffff"
"""Colours of text and markers, of axes and secondary parts, of grid lines, and of the background. HTML pages replace
these colours by their own."""

THEME: dict[str, str] = {INK: "ink", SOFT: "soft", RULE: "rule", PAPER: "paper"} | {
    "#{:02x}{:02x}{:02x}".format(*colour): variable
    for colour, variable in ((BLUE, "after"), (GREEN, "best"), (RED, "bad"))
}
"""CSS variable for each colour that an HTML page replaces. Other colours fit light and dark backgrounds."""


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write ``figure`` to ``path`` atomically, in the format of the suffix (.png, .svg, .pdf), and return the path.

    Raises:
        InputError: If the file cannot be written or matplotlib does not know its format.
    """
    path = Path(path)
    check_format(path.suffix.lstrip("."), path)
    undated = {".png": {"Software": None}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    metadata: Any = undated.get(path.suffix.lower())
    with style():
        return write_whole(path, lambda temporary: figure.savefig(temporary, dpi=PIXELS_PER_INCH, metadata=metadata))


def check_format(suffix: str, path: str | Path) -> None:
    """Raise an error if matplotlib does not know a picture format.

    Args:
        suffix: Suffix of the format, without a dot.
        path: The file to write, for the message.

    Raises:
        InputError: If the format is unknown.
    """
    formats = sorted(FigureCanvasBase.get_supported_filetypes())
    if suffix.lower() not in formats:
        raise InputError(f"cannot write {path}: '{suffix}' is no picture format; give one of {', '.join(formats)}")


def style(**more: Any) -> AbstractContextManager[None]:
    """Return a context that applies pickenv's style, and restores matplotlib's settings at its end.

    Args:
        more: Further settings of matplotlib, by name.
    """
    settings: Any = STYLE | more
    return matplotlib.rc_context(settings)


@contextmanager
def new_figure(width: float, height: float, **more: Any) -> Iterator[Figure]:
    """Return a context with an empty figure in pickenv's style, which belongs to no window.

    Args:
        width: Width of the figure, inches.
        height: Height of the figure, inches.
        more: Further settings of matplotlib, by name.
    """
    with style(**more):
        yield Figure(figsize=(width, height), layout="constrained")


@contextmanager
def new_panel(width: float, height: float, x: str, y: str, *, legend: int = 0) -> Iterator[tuple[Figure, Any]]:
    """Return a context with a figure of one panel, and that panel (matplotlib axes).

    Args:
        width: Width of the figure, inches.
        height: Height of the figure, inches.
        x: Label of the panel's x axis.
        y: Label of the panel's y axis.
        legend: Largest number of columns of the legend below the panel; 0 for no legend.
    """
    with new_figure(width, height) as figure:
        axes = figure.add_subplot(xlabel=x, ylabel=y)
        yield figure, axes
        if legend:
            legend_below(figure, axes, legend)


def legend_below(figure: Figure, axes: Any, most: int) -> None:
    """Add a legend of one panel's labels below all panels, in as many columns as fit, but at most ``most``.

    The panel is ``axes`` (matplotlib axes).
    """
    marks, names = axes.get_legend_handles_labels()
    for columns in range(min(most, len(names)), 0, -1):
        widths = (KEY + SMALL_LETTER * max(map(len, column)) for column in np.array_split(names, columns))
        if columns == 1 or sum(widths) < figure.get_figwidth() - 0.05:
            letters = int((figure.get_figwidth() - KEY) / SMALL_LETTER)  # of a whole line
            figure.legend(marks, [fill(name, letters) for name in names], loc="outside lower center", ncols=columns)
            return


def colour_bar(figure: Figure, marks: Any, panels: Any, **look: Any) -> Any:
    """Add a colour bar without a frame beside ``panels``, and return the bar.

    ``marks`` is the artist whose colours the bar explains. ``look`` are further arguments of matplotlib's colour bar.
    """
    bar = figure.colorbar(marks, ax=panels, **look)
    bar.outline.set_visible(False)
    return bar


def finite_series(curves: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Return the curves as float arrays ``(N,)``, by label, after a check that all values are finite.

    Raises:
        InputError: If there is no curve, or one is empty or not finite.
    """
    series = {str(label): np.asarray(values, dtype=float).ravel() for label, values in curves.items()}
    if not series:
        raise InputError("there is nothing to draw; give at least one series")
    for label, values in series.items():
        if not values.size or not np.isfinite(values).all():
            raise InputError(f"series '{label}' is empty or not finite; give finite numbers to draw")
    return series


def headline(axes: Any, message: str, pad: float | None = None, beside: float = 0.0) -> None:
    """Set a panel's title, wrapped to the width of the panel.

    Args:
        axes: The panel.
        message: The title.
        pad: Distance between title and panel, points; None for matplotlib's default.
        beside: Width that a legend beside the panels takes, inches.
    """
    room = (axes.get_figure().get_figwidth() - beside) / axes.get_subplotspec().get_gridspec().ncols
    bound = re.sub(r"(\d) (?=mm|m\b|deg|kg|px|%)", "\\1\u00a0", as_sentence(message))
    axes.set_title("\n".join(wrap(bound, int((room - 0.75) / LETTER))), pad=pad)


def change(series: Mapping[str, float], unit: str) -> str:
    """Return the first and the last of several labelled numbers as text for a title, such as raw 1.9, LS 0.50 mm."""
    ends = list(series.items())
    ends = ends if len(ends) < 3 else [ends[0], ends[-1]]
    return ", ".join(f"{label} {short(value)}" for label, value in ends) + f" {unit}"


def short(value: float) -> str:
    """Return a number as text for a title: with two significant digits, or as a whole number from 10 on."""
    return f"{value:.0f}" if abs(value) >= 10.0 else f"{value:#.2g}" if abs(value) >= 1e-4 else f"{value:.1g}"


def alike(curves: Mapping[str, ArrayLike], nearest: float) -> list[list[str]]:
    """Group similar curves ``(T,)``, given by name, and return the names of the curves in each group.

    A curve is in a group if it differs from the group's first curve by less than ``nearest`` everywhere. ``nearest`` is
    in the curves' unit.
    """
    values = {name: np.asarray(curve, dtype=float) for name, curve in curves.items()}

    def near(first: Array, curve: Array) -> bool:
        return bool(first.shape == curve.shape and np.max(np.abs(first - curve), initial=0.0) < nearest)

    groups: dict[str, list[str]] = {}  # by the name of the group's first curve
    for name, curve in values.items():
        groups.setdefault(next((first for first in groups if near(values[first], curve)), name), []).append(name)
    return list(groups.values())


def spaced(labels: Sequence[str], least: float, room: float) -> list[str]:
    """Return labels for equally spaced marks on an axis, with empty text in place of labels that do not fit.

    Depending on the room, all labels stay, or every second label, or every third label, and so on.

    Args:
        labels: One label for each mark.
        least: Length that a label needs along the axis, inches.
        room: Length of the axis, inches.
    """
    stride = max(1, -(-len(labels) * least // room)) if labels else 1
    return [label if i % int(stride) == 0 else "" for i, label in enumerate(labels)]


def plain_decades(axis: Any) -> None:
    """Write the ticks of a logarithmic axis as plain numbers, such as 0.5 instead of 5 × 10 to the power of −1."""
    low, high = axis.get_view_interval()
    decades = float(np.log10(high / low))
    subs = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0) if decades < 1.0 else (1.0, 2.0, 5.0) if decades < 2.2 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def shades(names: Iterable[str]) -> dict[str, tuple[float, float, float]]:
    """Return the colour of each policy or method, RGB in 0..1, by its key or label."""
    names = list(names)
    return dict(zip(names, rgb(policy_colours(names)), strict=True))


def coloured(series: Mapping[str, Array]) -> list[tuple[str, Array, tuple[float, float, float]]]:
    """Return, for each series, its label for people, its values, and its colour (RGB, 0 to 1).

    Args:
        series: Maps a policy's or method's key, or its label, to its values. The key or label selects the colour.
    """
    return [(label_words(label), series[label], colour) for label, colour in shades(series).items()]


def label_words(name: str) -> str:
    """Return a name with short names spelled out (`in_words`), as a label that every legend shows.

    Matplotlib leaves labels that begin with "_" out of legends. A space is therefore put before such a label.
    """
    words = in_words(name)
    return f" {words}" if words.startswith("_") else words


def whisker(axis: Any, y: float, value: float, ends: Sequence[float | None] | None, colour: Any) -> None:
    """Draw an estimate with its interval as a horizontal line; an open end is drawn as an arrow at the estimate.

    Args:
        axis: The panel.
        y: Height of the line, in the units of the panel's y axis.
        value: The estimate.
        ends: Both ends of the interval, with None for an open end; None if there is no interval.
        colour: Colour of the mark.
    """
    if ends is not None:
        low, high = (value if end is None else end for end in ends)
        axis.plot([low, high], [y, y], color=colour, linewidth=3.0, alpha=0.55)
        for end, arrow in zip(ends, ("<", ">"), strict=True):
            if end is None:
                axis.plot([value], [y], arrow, color=colour, markersize=4)
    axis.plot([value], [y], "|", color=colour, markersize=6, mew=1.6)


def rgb(colours: Sequence[Rgb]) -> list[tuple[float, float, float]]:
    """Convert colours from 0..255 to RGB in 0..1, as matplotlib needs them."""
    return [(red / 255.0, green / 255.0, blue / 255.0) for red, green, blue in colours]
