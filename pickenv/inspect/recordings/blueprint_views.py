"""Views that several tabs of a blueprint are made of: the workspace in 3D, a colour bar."""

from __future__ import annotations

from typing import Any

import rerun.blueprint as rrb

from pickenv.arm.kinematics.geometry import Array
from pickenv.inspect.runs.comparison import Comparison
from pickenv.inspect.runs.view import eye_direction, shown_box

BACKGROUND = (72, 72, 80)
"""Explicit, so that 3D views look the same in either theme; a grey from which both ends of Viridis stand out."""
EYE_DISTANCE = 2.2
"""In units of the shown box's radius."""
MOST_ABREAST = 4
"""Views side by side before there is another row of them."""


def layout(content: Any, time_line: str | None, **time: Any) -> rrb.Blueprint:
    """A blueprint without panels but the time line, which stands still at first and then loops, if not told else."""
    return rrb.Blueprint(
        content,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=time_line, **{"loop_mode": "all", "play_state": "paused"} | time),
        auto_views=False,
    )


def seen_from(
    eye: Array, look: Array, origin: str, contents: list[str], name: str, *, ground: bool = True, **more: Any
) -> Any:
    """A view in 3D from ``eye`` to ``look`` ``(3,)``, above a grid on the ground or not."""
    grid = {"visible": True, "spacing": 0.5, "stroke_width": 0.5, "color": (255, 255, 255, 30)}
    return rrb.Spatial3DView(
        origin=origin,
        contents=contents,
        name=name,
        background=BACKGROUND,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=look, eye_up=[0.0, 0.0, 1.0]),
        line_grid=rrb.LineGrid3D(**(grid if ground else {"visible": False})),
        **more,
    )


def space(comparison: Comparison, name: str, contents: list[str], origin: str = "/world", **more: Any) -> Any:
    """The workspace in 3D, always seen by the same eye at first; each view can be orbited on its own."""
    centre, radius = shown_box(comparison)
    eye = centre + EYE_DISTANCE * radius * eye_direction(comparison)
    return seen_from(eye, centre, origin, [*contents, "+ /world/workspace", "+ /world/axes"], name, **more)


def ghost(comparison: Comparison) -> list[str]:
    """The nominal arm as contents of a view, where there are reaches that it makes."""
    return ["+ /world/arm/nominal"] if len(comparison.fruit) else []


def with_colour_bar(views: list[Any], key: str, meaning: str, name: str) -> Any:
    """A tab: ``views`` side by side, in rows where they are many, and below them the colour bar `/legend/key`."""
    bar = rrb.Spatial2DView(
        origin=f"/legend/{key}",
        contents=[f"+ /legend/{key}/**"],
        name=meaning,
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=[-14.0, 534.0], y_range=[-4.0, 20.0]),
    )
    rows = rrb.Grid(*views, grid_columns=-(-len(views) // -(-len(views) // MOST_ABREAST)))
    return rrb.Vertical(rows, bar, row_shares=[5.2, 1.0], name=name)
