"""Small plots as inline SVG for pages that must stand alone; colours come from the page and follow light and dark.

Each function takes plain arrays and returns a string. Series are coloured by the CSS classes ``before``, ``after`` and
``best`` that the page defines; text uses ``currentColor``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.kinematics.geometry import Array, Geometry
from pickenv.errors import InputError
from pickenv.inspect.colours import viridis

WIDTH, HEIGHT = 460.0, 240.0
LEFT, RIGHT, TOP, BOTTOM = 46.0, 12.0, 10.0, 38.0


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Round numbers between ``low`` and ``high``, about ``count`` of them (Heckbert 1990)."""
    if not high > low:
        return [low]
    rough = (high - low) / max(count, 1)
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * min((m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= rough * 0.999), default=10.0)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(i * step) for i in range(first, last + 1)]


def cumulative(series: Mapping[str, tuple[str, ArrayLike]], xlabel: str) -> str:
    """Share of poses whose error is at most x, one step line per series.

    Args:
        series: For each label, a CSS class and the errors ``(N,)``.
        xlabel: Name and unit of the error.
    """
    values = {label: np.sort(np.asarray(v, dtype=float)) for label, (_, v) in series.items()}
    if not values or any(not v.size or not np.isfinite(v).all() for v in values.values()):
        raise InputError("a cumulative plot needs finite errors; give at least one for each series")
    limit = max(float(v[-1]) for v in values.values()) * 1.03 or 1.0
    parts = [_axes(ticks(0.0, limit), limit, [0, 25, 50, 75, 100], 100.0, xlabel, "poses within it (%)")]
    for label, (css, _) in series.items():
        v = values[label]
        x = _x(np.concatenate([[0.0], np.repeat(v, 2), [limit]]), limit)
        level = np.repeat(np.arange(len(v) + 1), 2) / len(v) * 100.0
        y = _y(level, 100.0)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        parts.append(f'<polyline class="line {css}" points="{points}"/>')
    for i, (label, (css, _)) in enumerate(series.items()):
        y0 = HEIGHT - BOTTOM - 14.0 - 16.0 * (len(series) - 1 - i)
        parts.append(f'<line class="line {css}" x1="{WIDTH - 190}" x2="{WIDTH - 168}" y1="{y0}" y2="{y0}"/>')
        parts.append(f'<text x="{WIDTH - 162}" y="{y0 + 4}">{escape(label)}</text>')
    return _svg(WIDTH, HEIGHT, parts, f"cumulative distribution of {xlabel}")


def strips(labels: Sequence[str], lower: Array, upper: Array, values: Array, ends: Sequence[tuple[str, str]]) -> str:
    """One line per joint from its lower to its upper limit, and a mark for each value ``(N, n)`` on it."""
    row, left, right = 30.0, 190.0, 50.0
    height = row * len(labels) + 8.0
    width = WIDTH
    parts = []
    for i, label in enumerate(labels):
        y = row * (i + 0.5)
        place = left + (width - left - right) * (values[:, i] - lower[i]) / (upper[i] - lower[i])
        place = np.clip(place, left - 6.0, width - right + 6.0)
        parts.append(f'<line class="grid" x1="{left}" x2="{width - right}" y1="{y}" y2="{y}"/>')
        marks = "".join(f"M{x:.1f} {y - 6:.1f}v12" for x in place)
        parts.append(f'<path class="mark" d="{marks}"/>')
        parts.append(f'<text x="{left - 50}" y="{y + 4}" text-anchor="end">{escape(label)}</text>')
        low, high = ends[i]
        parts.append(f'<text class="small" x="{left - 8}" y="{y + 4}" text-anchor="end">{escape(low)}</text>')
        parts.append(f'<text class="small" x="{width - right + 8}" y="{y + 4}">{escape(high)}</text>')
    return _svg(width, height, parts, "joint values of the measured poses within the joint limits")


def joint_strips(geometry: Geometry, joints: Array) -> str:
    """Where poses lie within an arm's joint limits: `strips` with the limits in mm or degrees.

    Args:
        geometry: The arm.
        joints: Joints of the poses ``(N, n)``, rad or m.
    """
    scale = np.where(geometry.prismatic, 1e3, np.degrees(1.0))
    units = ["mm" if slides else "°" for slides in geometry.prismatic]
    limits = zip(geometry.lower * scale, geometry.upper * scale, units, strict=True)
    ends = [(f"{low:.0f}{unit}", f"{high:.0f}{unit}") for low, high, unit in limits]
    return strips(geometry.joint_names, geometry.lower, geometry.upper, joints, ends)


def heat_map(x: Array, y: Array, values: Array, xlabel: str, ylabel: str, unit: str, cells: int = 26) -> str:
    """Mean of ``values`` ``(N,)`` in square cells of a plane, Viridis, with a scale.

    Args:
        x: Abscissae ``(N,)``.
        y: Ordinates ``(N,)``, in the same unit.
        values: What is shown.
        xlabel: Name and unit of x.
        ylabel: Name and unit of y.
        unit: Unit of the values, for the scale.
        cells: Cells along the longer side.
    """
    step = max(float(np.ptp(x)), float(np.ptp(y))) / cells
    columns, rows = ((v - v.min()) // step for v in (x, y))
    shape = (int(rows.max()) + 1, int(columns.max()) + 1)
    place = (rows * shape[1] + columns).astype(int)
    count = np.bincount(place, minlength=shape[0] * shape[1])
    mean = np.bincount(place, values, minlength=shape[0] * shape[1]) / np.maximum(count, 1)
    low, high = float(mean[count > 0].min()), float(mean[count > 0].max())
    size = min((WIDTH - LEFT - 90.0) / shape[1], 250.0 / shape[0])
    plot_height = size * shape[0]
    height = plot_height + TOP + BOTTOM
    parts = []
    for k in np.flatnonzero(count > 0):
        red, green, blue = viridis((mean[k] - low) / max(high - low, 1e-12))
        left, bottom = LEFT + size * (k % shape[1]), TOP + plot_height - size * (k // shape[1] + 1)
        parts.append(
            f'<rect x="{left:.1f}" y="{bottom:.1f}" width="{size + 0.3:.1f}" height="{size + 0.3:.1f}" '
            f'fill="rgb({red},{green},{blue})"/>'
        )
    for value in ticks(float(x.min()), float(x.max()), 4):
        at = LEFT + size * (value - x.min()) / step
        parts.append(
            f'<text class="small" x="{at:.1f}" y="{TOP + plot_height + 14}" text-anchor="middle">{value:g}</text>'
        )
    for value in ticks(float(y.min()), float(y.max()), 4):
        at = TOP + plot_height - size * (value - y.min()) / step
        parts.append(f'<text class="small" x="{LEFT - 5}" y="{at + 4:.1f}" text-anchor="end">{value:g}</text>')
    middle = LEFT + size * shape[1] / 2
    parts.append(f'<text x="{middle:.1f}" y="{TOP + plot_height + 32}" text-anchor="middle">{escape(xlabel)}</text>')
    turned = f'transform="translate(11 {TOP + plot_height / 2:.1f}) rotate(-90)" text-anchor="middle"'
    parts.append(f"<text {turned}>{escape(ylabel)}</text>")
    bar = LEFT + size * shape[1] + 18.0
    for i in range(40):
        red, green, blue = viridis(i / 39)
        y0 = TOP + plot_height * (1 - (i + 1) / 40)
        parts.append(
            f'<rect x="{bar:.1f}" y="{y0:.1f}" width="12" height="{plot_height / 40 + 0.5:.1f}" '
            f'fill="rgb({red},{green},{blue})"/>'
        )
    for value, y0 in ((low, TOP + plot_height), (high, TOP + 8.0)):
        parts.append(f'<text class="small" x="{bar + 16:.1f}" y="{y0:.1f}">{value:.3g} {escape(unit)}</text>')
    return _svg(WIDTH, height, parts, f"map of {unit}")


def bar(value: float, sigma: float, limit: float) -> str:
    """A bar from zero to ``value`` with a whisker of two standard deviations, on a scale of -limit to +limit."""
    width, height, middle = 120.0, 14.0, 60.0
    end = middle + (middle - 4.0) * float(np.clip(value / limit, -1, 1))
    low, high = (middle + (middle - 4.0) * float(np.clip((value + k * sigma) / limit, -1, 1)) for k in (-2.0, 2.0))
    parts = [
        f'<line class="grid" x1="{middle}" x2="{middle}" y1="0" y2="{height}"/>',
        f'<rect class="fill" x="{min(middle, end):.1f}" y="3" width="{abs(end - middle):.1f}" height="8"/>',
        f'<path class="whisker" d="M{low:.1f} 7H{high:.1f}M{low:.1f} 3.5v7M{high:.1f} 3.5v7"/>',
    ]
    return _svg(width, height, parts, f"{value:.3g}", css="inline")


def _x(values: Array, limit: float) -> Array:
    return np.asarray(LEFT + (WIDTH - LEFT - RIGHT) * values / limit)


def _y(values: Array, limit: float) -> Array:
    return np.asarray(HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * values / limit)


def _axes(
    xticks: Sequence[float], xlimit: float, yticks: Sequence[float], ylimit: float, xlabel: str, ylabel: str
) -> str:
    parts = []
    for value in yticks:
        y = float(_y(np.array(value), ylimit))
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text class="small" x="{LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    for value in xticks:
        x = float(_x(np.array(value), xlimit))
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>')
        parts.append(
            f'<text class="small" x="{x:.1f}" y="{HEIGHT - BOTTOM + 14}" text-anchor="middle">{value:g}</text>'
        )
    parts.append(
        f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - 5}" text-anchor="middle">{escape(xlabel)}</text>'
    )
    turned = f'transform="translate(11 {(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)" text-anchor="middle"'
    parts.append(f"<text {turned}>{escape(ylabel)}</text>")
    return "".join(parts)


def _svg(width: float, height: float, parts: Sequence[str], label: str, css: str = "plot") -> str:
    head = f'<svg class="{css}" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(label)}">'
    return head + "".join(parts) + "</svg>"
