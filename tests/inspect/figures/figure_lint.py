"""What is wrong with a figure before anyone sees it: writing that collides, series that hide one another, and the like.

`figure_faults` judges one figure as it will be drawn. Inside `linting` every figure that is saved or set into a page is
judged on its way out.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from unittest import mock

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection
from matplotlib.colors import to_hex, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from pickenv.arm import Array
from pickenv.inspect.colours import BY_KEY, policy_key
from pickenv.inspect.figures.style import INK, PAPER, SOFT, THEME, style

DARK: dict[str, str] = dict(
    zip(THEME, ("#e8eaed", "#a4adb8", "#343a41", "#14171a", "#56b4e9", "#35c99b", "#ff7b7f"), strict=True)
)
"""Colours that a dark page puts in place of those of a figure."""
LEAST_TEXT, LEAST_SERIES = 4.5, 2.0
"""Contrast with the paper, light and dark: of writing (WCAG 2, level AA), and of what a legend names. Okabe and Ito's
orange and sky blue have 2.2 and 2.3 on white; patterns, marks or labels beside them say the same once more."""
SLACK = 0.5
"""Boxes of writing may overlap by so much, px; letters do not fill their boxes."""
ALIKE = 1.0
"""Curves that are nowhere farther apart than this, px, cannot be told apart."""
BACKDROP = 2.5
"""A line so many times as wide as the one before it can still be seen behind it."""


@contextmanager
def linting() -> Iterator[list[str]]:
    """Judge every figure that is written or set into a page inside; the list has what is wrong, by the title."""
    faults: list[str] = []
    save = Figure.savefig

    def judged(figure: Figure, *args: Any, **options: Any) -> None:
        faults.extend(f"{heading_of(figure)}: {fault}" for fault in figure_faults(figure))
        save(figure, *args, **options)

    with mock.patch.object(Figure, "savefig", judged):
        yield faults


def figure_faults(figure: Figure) -> list[str]:
    """What is wrong with one figure, a sentence each; empty where nothing is."""
    canvas: Any = FigureCanvasAgg(figure)
    with style():
        figure.draw_without_rendering()
        texts = [text for text in _texts(figure) if text.get_text().strip()]
        boxes = [_corners(text, canvas.get_renderer()) for text in texts]
        return [
            *_untitled(figure),
            *_colliding(texts, boxes),
            *_cut_off(figure, texts, boxes),
            *_hidden(figure),
            *_empty_entries(figure),
            *_without_units(figure),
            *_foreign_colours(figure),
            *_faint(figure, texts),
        ]


def heading_of(figure: Figure) -> str:
    """The title of a figure: that above all panels, or the first panel's."""
    titles = (axes.get_title(where) for axes in figure.axes for where in ("left", "center", "right"))
    return str(figure.get_suptitle() or next((title for title in titles if title), ""))


def _untitled(figure: Figure) -> Iterator[str]:
    heading = heading_of(figure)
    if not re.search(r"\d", heading):
        yield f"its title says no result, for it has no number: '{heading}'"


def _texts(figure: Figure) -> list[Text]:
    """Every text that is drawn."""
    found = [text for text in figure.texts if text.get_visible()]
    for legend in _legends(figure):
        found += [*legend.get_texts(), legend.get_title()]
    for axes in figure.axes:
        if not axes.get_visible():
            continue
        found += [child for child in axes.get_children() if isinstance(child, Text) and child.get_visible()]
        for axis in (axes.xaxis, axes.yaxis) if axes.axison else ():
            found += [label for label in (axis.label, axis.offsetText) if label.get_visible()]
            found += _tick_labels(axis)
    return found


def _tick_labels(axis: Any) -> list[Text]:
    """Labels of the ticks that lie in view."""
    low, high = sorted(axis.get_view_interval())
    room = 1e-9 * (high - low)
    found = []
    for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
        if tick.get_visible() and low - room <= tick.get_loc() <= high + room:
            found += [label for label in (tick.label1, tick.label2) if label.get_visible() and label.get_text()]
    return found


def _corners(text: Text, renderer: Any) -> Array:
    """Corners ``(4, 2)`` of a text's box, px, turned as the text is."""
    box, angle = text.get_window_extent(renderer), float(text.get_rotation())
    middle, size = np.array([box.x0 + box.x1, box.y0 + box.y1]) / 2.0, np.array([box.width, box.height])
    if angle % 90.0:
        text.set_rotation(0.0)
        level = text.get_window_extent(renderer)
        text.set_rotation(angle)
        size = np.array([level.width, level.height])
    else:
        angle = 0.0
    half = np.maximum(size / 2.0 - SLACK, 0.0)
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.asarray(middle + (signs * half) @ np.array([[cos, sin], [-sin, cos]]))


def _colliding(texts: Sequence[Text], boxes: Sequence[Array]) -> Iterator[str]:
    corners = np.array(boxes).reshape(-1, 4, 2)
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = ((low[:, None] < high) & (low < high[:, None])).all(axis=2)
    for i, j in zip(*np.nonzero(np.triu(near, 1)), strict=True):
        if not _apart(boxes[i], boxes[j]):
            yield f"'{_short(texts[i])}' and '{_short(texts[j])}' overlap"


def _apart(first: Array, second: Array) -> bool:
    """Whether two boxes ``(4, 2)`` have a straight line between them: along a side of one of them."""
    for box in (first, second):
        for side in (box[1] - box[0], box[3] - box[0]):
            one, other = first @ side, second @ side
            if one.max() <= other.min() or other.max() <= one.min():
                return True
    return False


def _cut_off(figure: Figure, texts: Sequence[Text], boxes: Sequence[Array]) -> Iterator[str]:
    size = np.array([figure.bbox.width, figure.bbox.height])
    for text, box in zip(texts, boxes, strict=True):
        if (box < -1.0).any() or (box > size + 1.0).any():
            yield f"'{_short(text)}' reaches beyond the picture"


def _series(axes: Axes) -> list[Artist]:
    """What is drawn of data, and in view: lines, patches and collections that are not empty."""
    low, high = np.sort(axes.viewLim.get_points(), axis=0)
    found: list[Artist] = []
    for line in axes.get_lines():
        points = np.asarray(line.get_xydata(), dtype=float).reshape(-1, 2)
        data = line.get_transform().contains_branch(axes.transData)
        seen = points if not data else points[((points >= low) & (points <= high)).all(axis=1)]
        if line.get_visible() and len(points) and (len(seen) or len(points) > 1):
            found.append(line)
    for patch in axes.patches:
        if patch.get_visible() and np.ptp(patch.get_path().vertices, axis=0).any():
            found.append(patch)
    for collection in axes.collections:
        if collection.get_visible() and (np.size(collection.get_offsets()) or len(collection.get_paths())):
            found.append(collection)
    return found


def _hidden(figure: Figure) -> Iterator[str]:
    """Curves that lie on one another from end to end."""
    for axes in figure.axes:
        lines = [a for a in _series(axes) if isinstance(a, Line2D) and a.get_linestyle() != "None"]
        drawn = [(line, line.get_transform().transform(np.asarray(line.get_xydata(), float))) for line in lines]
        for (one, here), (other, there) in itertools.combinations(drawn, 2):
            widths = sorted((one.get_linewidth(), other.get_linewidth()))
            if len(here) < 2 or here.shape != there.shape or widths[1] >= BACKDROP * widths[0]:
                continue
            if np.nanmax(np.abs(here - there), initial=0.0) < ALIKE:
                yield f"the lines '{one.get_label()}' and '{other.get_label()}' lie on one another"


def _empty_entries(figure: Figure) -> Iterator[str]:
    """Entries of legends for which nothing is drawn."""
    seen = [artist for axes in figure.axes for artist in _series(axes)]
    colours = {colour for artist in seen for colour in _colours(artist)}
    lines = [artist for artist in seen if isinstance(artist, Line2D)]
    patterns = {(line.get_linestyle()) for line in lines} | {line.get_marker() for line in lines}
    for legend in _legends(figure):
        told = set()
        for text, handle in _entries(legend):
            own = _colours(handle)
            look = (tuple(sorted(own)), *_look(handle))
            if look in told:
                yield f"two entries of the legend look alike, one is '{_short(text)}'"
            told.add(look)
            if own <= {to_hex(SOFT), to_hex(INK)} and isinstance(handle, Line2D):
                if not {handle.get_linestyle(), handle.get_marker()} & (patterns - {"None", "none", ""}):
                    yield f"the legend names '{_short(text)}', and no series is drawn like it"
            elif own and not own & colours:
                yield f"the legend names '{_short(text)}', and no series has its colour"


def _look(handle: Artist) -> tuple[Any, ...]:
    """What tells two entries of one colour apart."""
    if isinstance(handle, Line2D):
        pattern = vars(handle).get("_dash_pattern", handle.get_linestyle())  # of own dashes matplotlib says "--" only
        return str(pattern), handle.get_marker(), handle.get_linewidth() > BACKDROP
    if isinstance(handle, Collection):
        return (type(handle).__name__, sum(np.size(path.vertices) for path in handle.get_paths()[:1]))
    return (type(handle).__name__, getattr(handle, "get_hatch", lambda: None)())


def _colours(artist: Artist) -> set[str]:
    """The colours of an artist, as hex; of marks without a line those of the marks."""
    if isinstance(artist, Line2D):
        bare = artist.get_linestyle() == "None"
        return {to_hex(artist.get_markerfacecolor() if bare else artist.get_color())}
    if isinstance(artist, Patch):
        face = to_rgba(artist.get_facecolor())
        return {to_hex(face if face[3] > 0.0 else artist.get_edgecolor())}
    if isinstance(artist, Collection):
        faces = np.asarray(artist.get_facecolor()).reshape(-1, 4)
        return {to_hex(tuple(c)) for c in (faces if len(faces) else np.asarray(artist.get_edgecolor()).reshape(-1, 4))}
    return set()


def _without_units(figure: Figure) -> Iterator[str]:
    """Axes of numbers whose label has no unit in brackets; a label of another panel counts for axes it is shared by."""
    for number, axes in enumerate(figure.axes, start=1):
        if not axes.get_visible() or not axes.axison:
            continue
        shared = {"x": axes.get_shared_x_axes(), "y": axes.get_shared_y_axes()}
        for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
            if not any(_is_number(label.get_text()) for label in _tick_labels(axis)):
                continue
            group = shared[name].get_siblings(axes)
            said = [getattr(each, f"{name}axis").label.get_text() for each in group]
            if not any(re.search(r"\(.+\)", label) for label in said):
                yield f"the {name} axis of panel {number} has numbers and no unit: '{axis.label.get_text()}'"


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[−+-]?\d[\d.]*([eE][−+-]?\d+)?", text.strip()) is not None


def _foreign_colours(figure: Figure) -> Iterator[str]:
    """Policies that are drawn in another colour than theirs."""
    for legend in _legends(figure):
        for text, handle in _entries(legend):
            wanted = BY_KEY.get(policy_key(re.split(r"[:,(\n]", text.get_text())[0]))
            own = _colours(handle) - {to_hex(SOFT), to_hex(INK)}
            if wanted is not None and own and own != {"#{:02x}{:02x}{:02x}".format(*wanted)}:
                yield f"'{_short(text)}' has the colour {own.pop()}, not its own"


def _faint(figure: Figure, texts: Sequence[Text]) -> Iterator[str]:
    """Writing and series that light or dark paper swallows."""
    shown = {(to_hex(text.get_color()), LEAST_TEXT, "writing") for text in texts}
    for legend in _legends(figure):
        for _, handle in _entries(legend):
            shown |= {(colour, LEAST_SERIES, "a series of the legend") for colour in _colours(handle)}
    for (colour, least, what), paper in itertools.product(sorted(shown), ("light", "dark")):
        themed, ground = (DARK.get(c, c) if paper == "dark" else c for c in (colour, PAPER))
        if (contrast := contrast_of(themed, ground)) < least:
            yield f"{what} in {colour} has a contrast of {contrast:.2f} on {paper} paper, below {least}"


def contrast_of(first: str, second: str) -> float:
    """Contrast of two colours by WCAG 2: 1 to 21."""

    def luminance(colour: str) -> float:
        c = np.array(to_rgb(colour))
        linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    dark, light = sorted(map(luminance, (first, second)))
    return (light + 0.05) / (dark + 0.05)


def _legends(figure: Figure) -> list[Legend]:
    inside = (axes.get_legend() for axes in figure.axes)
    return [legend for legend in (*figure.legends, *inside) if legend is not None and legend.get_visible()]


def _entries(legend: Legend) -> list[tuple[Text, Artist]]:
    return [(t, h) for t, h in zip(legend.get_texts(), legend.legend_handles, strict=True) if h is not None]


def _short(text: Text) -> str:
    said = " ".join(text.get_text().split())
    return said if len(said) <= 40 else f"{said[:38]} …"
