"""The error fields of a comparison as one picture: a panel per policy, with the same view, colour scale and gain.

The projection is orthographic and done here, so that arrows are drawn from far to near and stay crisp at any size.
"""

from __future__ import annotations

import itertools
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.inspect.colours import viridis, viridis_map
from pickenv.inspect.figures.style import INK, RULE, SOFT, WIDTH, change, new_figure
from pickenv.inspect.runs.comparison_summary import (
    GAIN,
    SCALE_PERCENTILE,
    colour_scale_mm,
    error_spread,
    field_mm,
    ticks,
)
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedPolicy
from pickenv.inspect.runs.saved import eye_direction, nominal_points, shown_box

PANEL_WIDTH, BESIDE_PANELS = WIDTH / 3.0, 1.5
"""Inches; the latter is the height of the titles and the colour bar."""
MOST_ARROWS = 400
"""More arrows than this would cover each other: only every second, third … cell along each axis is drawn."""


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
    shown, _ = thinned(comparison)
    top = colour_scale_mm(comparison)
    gain = gain or field_gain(comparison.grid.step, top)
    low, high = _extent(comparison, _View(comparison))
    height = min(0.93 * PANEL_WIDTH * (high[1] - low[1]) / (high[0] - low[0]), PANEL_WIDTH)
    width, look = PANEL_WIDTH * max(len(policies), 2), {"axes.grid": False, "axes.titlelocation": "center"}
    with new_figure(width, height + BESIDE_PANELS, **look) as figure:
        panels = figure.subplots(1, len(policies), squeeze=False)[0]
        for axes, policy in zip(panels, policies, strict=True):
            _panel(axes, comparison, policy, shown, gain, top)
            axes.set_title(policy.label, fontsize=12, weight="bold", pad=15.0)
            numbers = error_spread(field_mm(policy))
            text = f"mean {numbers.mean:.2f} mm, max {numbers.largest:.2f} mm"
            axes.text(0.5, 1.01, text, transform=axes.transAxes, ha="center", fontsize=8)
        cast("ConstrainedLayoutEngine", figure.get_layout_engine()).set(h_pad=0.11)
        means = change({p.label: error_spread(field_mm(p)).mean for p in policies}, "mm")
        figure.suptitle(
            f"Mean error across the workspace: {means}; wanted (dot) to true position ×{gain:g}", fontsize=10
        )
        colour_bar(figure, panels, top, policies[0].label)
    return figure


def thinned(comparison: Comparison, most: int = MOST_ARROWS) -> tuple[NDArray[np.intp], float]:
    """Which field points to draw, about ``most`` of them, and how far apart they are, m."""
    for stride in itertools.count(1):
        shown = np.flatnonzero(np.all(comparison.grid.index % stride == (stride - 1) // 2, axis=-1))
        if 0 < len(shown) <= most:
            return shown, stride * comparison.grid.step
        if not len(shown):
            break
    return np.arange(len(comparison.grid.points)), comparison.grid.step


def field_gain(step: float, top_mm: float) -> float:
    """How much longer than true size one field's arrows are drawn, in every figure of it: a round number.

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
    """Orthographic projection along the eye's direction; x to the right, y up, depth towards the eye. Metres."""

    def __init__(self, comparison: Comparison) -> None:
        self.centre, self.radius = shown_box(comparison)
        self.eye = eye_direction(comparison)
        right = np.cross([0.0, 0.0, 1.0], self.eye)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.eye, self.right)

    def flat(self, points: Array) -> Array:
        """Points ``(..., 3)`` in the picture's plane ``(..., 2)``."""
        return np.asarray((points - self.centre) @ np.stack([self.right, self.up], axis=-1))

    def depth(self, points: Array) -> Array:
        """How near the eye points ``(..., 3)`` are ``(...)``."""
        return np.asarray((points - self.centre) @ self.eye)


def _panel(
    axes: Axes, comparison: Comparison, policy: RecordedPolicy, shown: NDArray[np.intp], gain: float, top: float
) -> None:
    view = _View(comparison)
    _box(axes, comparison, view)
    _ghost_arm(axes, comparison, view)
    start, error = comparison.grid.points[shown], policy.field_errors[shown]
    order = np.argsort(view.depth(start))
    start, error = start[order], error[order]
    colours = viridis(np.linalg.norm(error, axis=-1) * 1e3 / top) / 255.0
    tail, tip = view.flat(start), view.flat(start + gain * error)
    width = 0.011 * view.radius
    outlines = list(_arrow_outlines(tail, tip, width))
    axes.scatter(tail[:, 0], tail[:, 1], s=2.2, color=SOFT, linewidths=0.0, zorder=2.0)
    axes.add_collection(
        PolyCollection(outlines, facecolors=colours, edgecolors=SOFT, linewidths=0.3, zorder=3.0, clip_on=False)
    )
    low, high = _extent(comparison, view)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()


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


def _extent(comparison: Comparison, view: _View) -> tuple[Array, Array]:
    """Lower left and upper right corner ``(2,)`` of a panel: the box, and room for the writing along its edges."""
    flat = view.flat(_corners(comparison))
    margin = 0.15 * view.radius
    return flat.min(axis=0) - margin, flat.max(axis=0) + margin * np.array([1.0, 0.2])


def _corners(comparison: Comparison) -> Array:
    """The box's corners ``(8, 3)``, m; bits 4, 2 and 1 of the number say where x, y and z are high."""
    low = comparison.grid.corner
    high = low + comparison.grid.size
    return np.where(np.array(list(itertools.product((False, True), repeat=3))), high, low)


def _box(axes: Axes, comparison: Comparison, view: _View) -> None:
    """Wire box around the field, with the range of each axis written along one of its outer edges."""
    corners = _corners(comparison)
    farthest = int(np.argmin(view.depth(corners)))
    for i, j in itertools.combinations(range(8), 2):
        if (i ^ j).bit_count() == 1:
            hidden = farthest in (i, j)
            flat = view.flat(corners[[i, j]])
            line: dict[str, Any] = {
                "color": SOFT,
                "linewidth": 0.5 if hidden else 0.9,
                "alpha": 0.6 if hidden else 1.0,
            }
            axes.plot(*flat.T, **line, linestyle=":" if hidden else "-", zorder=1.0)
    for axis in range(3):
        _axis_text(axes, corners, view, axis)


def _axis_text(axes: Axes, corners: Array, view: _View, axis: int) -> None:
    """Name, unit and range of one axis, outside the box edge parallel to it that lies lowest (or, for z, leftmost)."""
    bit = 4 >> axis
    flat = view.flat(corners)
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
    for end, value, inward in ((flat[i], corners[i, axis], direction), (flat[j], corners[j, axis], -direction)):
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
