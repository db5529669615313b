"""Figures of errors as arrows: across the workspace, a panel per policy, and on pictures of a board.

Fields are projected orthographically here, so that arrows are drawn from far to near and stay crisp at any size. On
pictures an arrow starts where a corner is predicted and points to where it was found. Arrows are longer than true by
the factor that a figure states; their colour is their true length. Units: m, mm, px.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.quiver import Quiver
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.inspect.colours import viridis, viridis_map
from pickenv.inspect.figures.style import INK, RULE, SOFT, WIDTH, change, new_figure
from pickenv.inspect.runs.calibration_trace import ViewErrors
from pickenv.inspect.runs.comparison_summary import (
    GAIN,
    SCALE_PERCENTILE,
    colour_scale_mm,
    error_spread,
    field_mm,
    ticks,
)
from pickenv.inspect.runs.recorded_episodes import Comparison
from pickenv.inspect.runs.saved import eye_direction, nominal_points, shown_box

PANEL_WIDTH, BESIDE_PANELS = WIDTH / 3.0, 1.5
"""Inches; the latter is the height of the titles and the colour bar."""
MOST_ARROWS = 400
"""More arrows than this would cover each other: only every second, third … cell along each axis is drawn."""

QUIVER: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "headwidth": 3.5, "minlength": 0.0}
"""Arrows that are vectors in the units of the axes."""

LONGEST = 0.1
"""Length of the longest arrow, as a share of the picture's width."""

MOST_VIEWS, BESIDE = 9, 3
"""Views drawn at most, the worst first, and how many stand beside each other."""

PICTURE_WIDTH, FAINT = 320, 0.4
"""Pictures behind arrows: their width, px, and opacity."""


def error_fields(comparison: Comparison, *, gain: float | None = None) -> Figure:
    """Error fields side by side: arrows from the wanted to the true tool position, coloured by their true length.

    Args:
        comparison: What to show.
        gain: How much longer than true size errors are drawn; `field_gain` when left out.

    Raises:
        InputError: If there is no policy or no field point, or if the gain is not above zero.
    """
    policies = comparison.policies
    if not policies or not len(comparison.grid.points):
        raise InputError("there is no error field to draw; give at least one policy and one field point")
    if gain is not None and not gain > 0.0:
        raise InputError(f"the gain is {gain}; give a number above zero")
    rows, _ = thinned(comparison)
    top = colour_scale_mm(comparison)
    gain = gain or field_gain(comparison.grid.step, top)
    view = _View(comparison)
    width, height = view.high - view.low
    height = min(0.93 * PANEL_WIDTH * height / width, PANEL_WIDTH)
    look = {"axes.grid": False, "axes.titlelocation": "center"}
    with new_figure(PANEL_WIDTH * max(len(policies), 2), height + BESIDE_PANELS, **look) as figure:
        panels = figure.subplots(1, len(policies), squeeze=False)[0]
        means = {}
        for axes, policy in zip(panels, policies, strict=True):
            _box(axes, view)
            _ghost_arm(axes, comparison, view)
            _arrows(axes, view, comparison.grid.points[rows], policy.field_errors[rows], gain, top)
            axes.set(xlim=(view.low[0], view.high[0]), ylim=(view.low[1], view.high[1]), aspect="equal")
            axes.set_axis_off()
            axes.set_title(policy.label, fontsize=12, weight="bold", pad=15.0)
            numbers = error_spread(field_mm(policy))
            means[policy.label] = numbers.mean
            text = f"mean {numbers.mean:.2f} mm, max {numbers.largest:.2f} mm"
            axes.text(0.5, 1.01, text, transform=axes.transAxes, ha="center", fontsize=8)
        cast("ConstrainedLayoutEngine", figure.get_layout_engine()).set(h_pad=0.11)
        title = f"Mean error across the workspace: {change(means, 'mm')}; wanted (dot) to true position ×{gain:g}"
        figure.suptitle(title, fontsize=10)
        colour_bar(figure, panels, top, policies[0].label)
    return figure


def thinned(comparison: Comparison, most: int = MOST_ARROWS) -> tuple[NDArray[np.intp], float]:
    """The numbers of field points to draw, about ``most`` of them, and how far apart they are, m."""
    for stride in itertools.count(1):
        rows = np.flatnonzero(np.all(comparison.grid.index % stride == (stride - 1) // 2, axis=-1))
        if 0 < len(rows) <= most:
            return rows, stride * comparison.grid.step
        if not len(rows):
            break
    return np.arange(len(comparison.grid.points)), comparison.grid.step


def field_gain(step: float, top_mm: float) -> float:
    """Factor by which one field's arrows are longer than true, in every figure of it: a round number.

    That of recordings where the longest arrow then takes a quarter of a cell or more and no more than one and a half;
    elsewhere so that arrows nearly touch.

    Args:
        step: Cell size of the field, m.
        top_mm: Upper end of the colour scale, mm.
    """
    cells = GAIN * top_mm * 1e-3 / step
    return GAIN if 0.25 <= cells <= 1.5 else round_down(1.1 * step / (top_mm * 1e-3))


def round_down(value: float) -> float:
    """The largest of 1, 2, 3, 4, 5 and 8 times a power of ten that is not above ``value``: for gains."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(m for m in (1.0, 2.0, 3.0, 4.0, 5.0, 8.0) if m * power <= value * (1.0 + 1e-9)))


class _View:
    """Orthographic projection along the eye's direction; x to the right, y up, depth towards the eye. Metres.

    `corners` ``(8, 3)`` are those of the field's box; bits 4, 2 and 1 of their numbers say where x, y and z are high.
    `low` and `high` ``(2,)`` bound a panel: the box, and room for the writing along its edges.
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
        """Points ``(..., 3)`` in the picture's plane ``(..., 2)``."""
        return np.asarray((points - self.centre) @ self.plane)

    def depth(self, points: Array) -> Array:
        """Nearness to the eye ``(...)`` of points ``(..., 3)``."""
        return np.asarray((points - self.centre) @ self.eye)


def _arrows(axes: Axes, view: _View, start: Array, error: Array, gain: float, top: float) -> None:
    """Errors ``(N, 3)`` at points ``(N, 3)``, m, from far to near; `top` is the end of the colour scale, mm."""
    order = np.argsort(view.depth(start))
    start, error = start[order], error[order]
    colours = viridis(np.linalg.norm(error, axis=-1) * 1e3 / top) / 255.0
    tail, tip = view.flat(start), view.flat(start + gain * error)
    outlines = list(_arrow_outlines(tail, tip, 0.011 * view.radius))
    axes.scatter(tail[:, 0], tail[:, 1], s=2.2, color=SOFT, linewidths=0.0, zorder=2.0)
    look: dict[str, Any] = {"edgecolors": SOFT, "linewidths": 0.3, "zorder": 3.0, "clip_on": False}
    axes.add_collection(PolyCollection(outlines, facecolors=colours, **look))


def _arrow_outlines(tail: Array, tip: Array, width: float) -> Array:
    """Outlines ``(N, 7, 2)`` of flat arrows with a filled head; a short arrow is a small arrow of the same shape."""
    along = tip - tail
    length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
    along = along / length
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    half = np.minimum(width / 2.0, 0.16 * length) + 0.1 * width
    head = np.minimum(3.4 * half * 2.0, 0.6 * length)
    neck = tip - head * along
    side, wing = half * across, 2.6 * half * across
    return np.stack([tail - side, neck - side, neck - wing, tip, neck + wing, neck + side, tail + side], axis=1)


def _box(axes: Axes, view: _View) -> None:
    """Wire box around the field, with the range of each axis written along one of its outer edges."""
    farthest = int(np.argmin(view.depth(view.corners)))
    near: dict[str, Any] = {"linewidth": 0.9, "linestyle": "-", "alpha": 1.0}
    hidden: dict[str, Any] = {"linewidth": 0.5, "linestyle": ":", "alpha": 0.6}
    for edge in itertools.combinations(range(8), 2):
        if (edge[0] ^ edge[1]).bit_count() == 1:
            look = hidden if farthest in edge else near
            axes.plot(*view.flat(view.corners[list(edge)]).T, color=SOFT, zorder=1.0, **look)
    for axis in range(3):
        _axis_text(axes, view, axis)


def _axis_text(axes: Axes, view: _View, axis: int) -> None:
    """Name, unit and range of one axis, outside the box edge parallel to it that lies lowest (or, for z, leftmost)."""
    bit = 4 >> axis
    flat, values = view.flat(view.corners), view.corners[:, axis]
    edges = [(i, i | bit) for i in range(8) if not i & bit]
    score = [flat[list(edge)].mean(axis=0)[0 if axis == 2 else 1] for edge in edges]
    i, j = edges[int(np.argmin(score))]
    middle = (flat[i] + flat[j]) / 2.0
    length = float(np.linalg.norm(flat[j] - flat[i]))
    direction = (flat[j] - flat[i]) / length
    outward = np.array([-direction[1], direction[0]])
    outward *= np.sign(outward @ middle) or 1.0
    angle = np.degrees(np.arctan2(direction[1], direction[0]))
    angle = 90.0 - (90.0 - angle) % 180.0
    options: dict[str, Any] = {"ha": "center", "va": "center", "rotation": angle, "fontsize": 7.5, "zorder": 4.0}
    off = 0.09 * view.radius * outward
    short = length < 0.8 * view.radius  # then there is room for its ends only, and they stand farther apart
    x, y = middle + off * (2.1 if short else 1.0)
    axes.text(x, y, f"{'xyz'[axis]} (m)", **options)
    for end, value, inward in ((flat[i], values[i], direction), (flat[j], values[j], -direction)):
        x, y = end + off + (0.04 if short else 0.11) * view.radius * inward
        axes.text(x, y, f"{value:.2f}".replace("-", "−"), **options)


def _ghost_arm(axes: Axes, comparison: Comparison, view: _View) -> None:
    """The nominal arm at the reach whose fruit is nearest to the middle, for orientation."""
    if not len(comparison.fruit):
        return
    nearest = int(np.argmin(np.linalg.norm(comparison.fruit - view.centre, axis=-1)))
    points = nominal_points(comparison.nominal, comparison.policies[0].ends.joint_command[nearest])
    flat = view.flat(points)
    for i, (a, b) in enumerate(itertools.pairwise(flat)):
        thickness = 6.0 - 3.5 * i / (len(flat) - 1)
        axes.plot(*np.stack([a, b]).T, color=RULE, linewidth=thickness, solid_capstyle="round", zorder=1.5)


def colour_bar(figure: Figure, panels: Any, top: float, first: str) -> None:
    """The one scale of all panels, Viridis from 0 to ``top`` mm, below them; ``first`` is whose errors set its end."""
    scale = ScalarMappable(Normalize(0.0, top), viridis_map())
    bar = figure.colorbar(
        scale, ax=list(np.ravel(panels)), location="bottom", aspect=60, shrink=0.8, pad=0.02, extend="max"
    )
    bar.set_ticks(ticks(top))
    end = f"the colour saturates above {top:.3g} mm, the {SCALE_PERCENTILE:g}th percentile of {first}"
    bar.set_label(f"position error (mm); {end}", color=INK)
    bar.outline.set_visible(False)


def corner_errors(views: Sequence[ViewErrors]) -> Figure:
    """The errors of all views in one plane: what a lens leaves shows as a pattern.

    Raises:
        InputError: If there is no corner to draw.
    """
    size = _size(views)
    places, errors = np.concatenate([v.found for v in views]), np.concatenate([v.errors for v in views])
    together, (gain, top) = ViewErrors("all", places, errors, size), _scale(views)
    with new_figure(WIDTH, WIDTH * 0.72 * size[1] / size[0] + 0.6) as figure:
        axes = figure.add_subplot(xlabel="u (px)", ylabel="v (px)")
        arrows = _draw(axes, together, gain, top)
        corners = f"{len(errors)} corners of {len(views)} views"
        axes.set_title(f"{together.rms:.3g} px RMS over {corners}, errors drawn ×{gain:g}")
        figure.colorbar(arrows, ax=axes, label="error (px)").outline.set_visible(False)
    return figure


def view_errors(views: Sequence[ViewErrors]) -> Figure:
    """The errors of each view on its picture, the worst first, nine at most; without a picture the corners alone.

    Raises:
        InputError: If there is no corner to draw.
    """
    gain, top = _scale(views)
    worst = sorted(views, key=lambda view: -view.rms)[:MOST_VIEWS]
    lines, width, height = -(-len(worst) // BESIDE), *_size(views)
    panel = 0.9 * WIDTH / BESIDE * height / width + 0.2
    with new_figure(WIDTH, lines * panel + 1.1, **{"axes.grid": False}) as figure:
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
        bar = figure.colorbar(arrows, ax=panels, label="error (px)", location="bottom", shrink=0.5, aspect=40.0)
        bar.outline.set_visible(False)
    return figure


def faint_picture(path: str | Path) -> Array | None:
    """Grey values of a picture, made small ``(h, w)``; None where it cannot be read."""
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
    """Factor by which the arrows are longer than true, and the longest error, px."""
    width, _ = _size(views)
    top = max(float(np.linalg.norm(view.errors, axis=1).max(initial=0.0)) for view in views)
    return round_down(LONGEST * width / max(top, 1e-9)), max(top, 1e-9)


def _draw(axes: Axes, view: ViewErrors, gain: float, top: float, thickness: float = 1.0) -> Quiver:
    width, height = view.size
    lengths = np.linalg.norm(view.errors, axis=1)
    look = QUIVER | {"scale": 1.0 / gain, "width": 0.004 * thickness, "cmap": viridis_map(), "clim": (0.0, top)}
    arrows = axes.quiver(*(view.found - view.errors).T, *view.errors.T, lengths, **look)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    return arrows
