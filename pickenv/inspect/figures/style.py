"""How figures look, and how they are written: for papers and reports, readable at column width, by anyone's eyes.

No global state of matplotlib is used, so figures can be made anywhere, also without a screen. Axes name their units.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError
from pickenv.files import write_whole
from pickenv.inspect.colours import Rgb, policy_colours

PIXELS_PER_INCH = 220
COLUMN, WIDTH = 3.5, 7.2
"""Inches: one column of a journal's page, and both."""
LINES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)))
MARKS = "os^Dv"
"""Patterns and marks in turn, where colour has another meaning."""

INK, SOFT, RULE, PAPER = "#1c2024", "#5b6470", "#dde1e6", "#ffffff"
"""Text and marks; axes and what stands back; grid lines; behind it all. Pages put their own in place of these."""

STYLE: dict[str, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "text.color": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.parse_math": False,  # names of joints and arms are shown as they are, with every $ in them
    "svg.hashsalt": "pickenv",  # the same figure gives the same file
}


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write ``figure`` to ``path`` (the suffix gives the format: .png, .svg, .pdf), whole or not at all.

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
    """Refuse a picture format that matplotlib does not know; ``path`` is what could not be written."""
    known = sorted(FigureCanvasBase.get_supported_filetypes())
    if suffix.lower() not in known:
        raise InputError(f"cannot write {path}: '{suffix}' is no picture format; give one of {', '.join(known)}")


@contextmanager
def style(**more: Any) -> Iterator[None]:
    """Draw in the house's style, and leave matplotlib's settings as they were."""
    settings: Any = {**STYLE, **more}
    with matplotlib.rc_context(settings):
        yield


@contextmanager
def new_figure(width: float, height: float, **more: Any) -> Iterator[Figure]:
    """An empty figure of ``width`` by ``height`` inches that belongs to no window, to be drawn in the house's style."""
    with style(**more):
        yield Figure(figsize=(width, height), layout="constrained")


def finite_series(curves: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """The curves as finite arrays ``(N,)``; an empty or a non-finite one is refused by name."""
    series = {str(label): np.asarray(values, dtype=float).ravel() for label, values in curves.items()}
    if not series:
        raise InputError("there is nothing to draw; give at least one series")
    for label, values in series.items():
        if not values.size or not np.isfinite(values).all():
            raise InputError(f"series '{label}' is empty or not finite; give finite numbers to draw")
    return series


def plain_decades(axis: Any) -> None:
    """Write a logarithmic axis's ticks as plain numbers: 0.5 instead of 5 × 10 to the power of −1."""
    low, high = axis.get_view_interval()
    decades = float(np.log10(high / low))
    subs = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0) if decades < 1.0 else (1.0, 2.0, 5.0) if decades < 2.2 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def coloured(series: Mapping[str, Array]) -> list[tuple[str, Array, tuple[float, float, float]]]:
    """Label, values and colour of each series, by the policy or method that it belongs to."""
    colours = rgb(policy_colours(list(series)))
    return [(label, values, colour) for (label, values), colour in zip(series.items(), colours, strict=True)]


def rgb(colours: Sequence[Rgb]) -> list[tuple[float, float, float]]:
    """Colours for matplotlib."""
    return [(red / 255.0, green / 255.0, blue / 255.0) for red, green, blue in colours]
