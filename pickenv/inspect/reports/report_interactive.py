"""Interactive figures of a report: an error field to be turned, errors to be read by hovering; plotly, in the page.

Plotly's library is packed into the page and unpacked by the reader's browser, so the page needs no network and stays
small enough to send. Each interactive figure has a still twin for print and for browsers that cannot draw it.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.inspect.colours import policy_colours, viridis
from pickenv.inspect.figures.field_figure import field_gain, thinned
from pickenv.inspect.runs.comparison_summary import colour_scale_mm, error_spread, field_mm, round_step
from pickenv.inspect.runs.recorded_episodes import Comparison
from pickenv.inspect.runs.saved import eye_direction

MOST_ARROWS = 3000
EYE_DISTANCE = 2.55
"""In units of the scene's size, as plotly counts."""

COLOUR_BAR: Mapping[str, Any] = {
    "title": {"text": "position error (mm)", "side": "bottom", "font": {"size": 13}},
    "orientation": "h",
    "x": 0.5,
    "xanchor": "center",
    "y": -0.02,
    "yanchor": "top",
    "len": 0.7,
    "thickness": 12,
}


@cache
def library() -> str:
    """Plotly's library, packed, for pages with interactive figures."""
    plotly = (files("plotly") / "package_data" / "plotly.min.js").read_bytes()
    return base64.b64encode(gzip.compress(plotly, 9, mtime=0)).decode()


def field_spec(comparison: Comparison) -> dict[str, Any]:
    """The error fields side by side in 3-D: a dot per wanted position, to hover over, and a line to the true one."""
    rows, spacing = thinned(comparison, MOST_ARROWS)
    top = colour_scale_mm(comparison)
    gain = field_gain(comparison.grid.step, top)
    points = comparison.grid.points[rows]
    scale = {"colorscale": [[i / 16, _css(viridis(i / 16))] for i in range(17)], "cmin": 0.0, "cmax": round(top, 4)}
    axes = _axes(points, spacing) | {"camera": {"eye": _xyz(EYE_DISTANCE * eye_direction(comparison))}}
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"annotations": [], "margin": {"l": 0, "r": 0, "t": 10, "b": 80}, "showlegend": False}
    for i, policy in enumerate(comparison.policies, start=1):
        scene = "scene" if i == 1 else f"scene{i}"
        shaft, end = _arrows(points, policy.field_errors[rows], gain, scale)
        end["marker"]["showscale"] = i == 1
        data += [shaft | {"scene": scene}, end | {"scene": scene, "name": policy.label}]
        layout[scene] = axes
        numbers = error_spread(field_mm(policy))
        title = f"<b>{escape(policy.label)}</b>, ×{gain:g}: mean {numbers.mean:.2f}, max {numbers.largest:.2f} mm"
        layout["annotations"].append({"text": title})
    return {"data": data, "layout": layout}


def _arrows(points: Array, errors: Array, gain: float, scale: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Traces of lines to the true and of dots at the wanted positions, coloured by the errors' true lengths in mm."""
    tips, length = points + gain * errors, np.linalg.norm(errors, axis=1) * 1e3
    shafts = np.stack([points, tips, np.full_like(tips, np.nan)], axis=1).reshape(-1, 3)
    shaft = _coordinates(shafts) | {
        "type": "scatter3d",
        "mode": "lines",
        "hoverinfo": "skip",
        "line": scale | {"color": _numbers(np.repeat(length, 3)), "width": 4},
    }
    end = _coordinates(points) | {
        "type": "scatter3d",
        "mode": "markers",
        "marker": scale | {"color": _numbers(length), "size": 2.6, "colorbar": COLOUR_BAR},
        "customdata": np.round(np.column_stack([length, errors * 1e3, points]), 4).tolist(),
        "hovertemplate": "<b>%{customdata[0]:.3f} mm</b><br>x %{customdata[1]:+.3f}, y %{customdata[2]:+.3f}, "
        "z %{customdata[3]:+.3f} mm<br>at x %{customdata[4]:.3f}, y %{customdata[5]:.3f}, z %{customdata[6]:.3f} m"
        "<extra>%{fullData.name}</extra>",
    }
    return shaft, end


def _axes(points: Array, spacing: float) -> dict[str, Any]:
    """The same axes for every scene, m."""
    low, high = points.min(axis=0) - spacing, points.max(axis=0) + spacing
    small = {"tickfont": {"size": 10}, "dtick": round_step(float((high - low).max()) / 6.0)}
    axes = {
        f"{axis}axis": small | {"title": {"text": f"{axis} (m)", "font": {"size": 11}}, "range": ends}
        for axis, ends in zip("xyz", np.column_stack([low, high]).tolist(), strict=True)
    }
    return axes | {"aspectmode": "data"}


def pose_spec(errors_mm: Mapping[str, Array]) -> dict[str, Any]:
    """Position error at each test pose, marks for each stage, on a logarithmic axis."""
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": f"{label}: mean {values.mean():.2f} mm",
            "x": list(range(1, len(values) + 1)),
            "y": _numbers(values),
            "marker": {"size": 5, "color": _css(colour)},
            "hovertemplate": "pose %{x}: <b>%{y:.3f} mm</b><extra>" + escape(label) + "</extra>",
        }
        for (label, values), colour in zip(errors_mm.items(), policy_colours(list(errors_mm)), strict=True)
    ]
    layout = {
        "xaxis": {"title": {"text": "test pose (number)"}},
        "yaxis": {"title": {"text": "position error (mm)"}, "type": "log"},
        "legend": {"orientation": "h", "yanchor": "bottom", "y": 1.02},
        "margin": {"l": 55, "r": 10, "t": 70, "b": 45},
        "height": 380,
        "hovermode": "closest",
    }
    return {"data": data, "layout": layout}


def _coordinates(points: Array) -> dict[str, Any]:
    return {axis: _numbers(points[:, i]) for i, axis in enumerate("xyz")}


def _xyz(vector: Array) -> dict[str, Any]:
    return dict(zip("xyz", _numbers(vector), strict=True))


def _numbers(values: Array) -> list[float | None]:
    """Numbers to four decimals, and gaps where they are NaN."""
    return [None if np.isnan(value) else round(float(value), 4) for value in values]


def _css(colour: Sequence[int] | NDArray[np.uint8]) -> str:
    return "rgb({},{},{})".format(*colour)
