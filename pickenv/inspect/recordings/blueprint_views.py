"""Views that several tabs of a blueprint are made of: the workspace in 3D, a colour bar."""

from __future__ import annotations

from typing import Any

from pickenv.inspect.runs.comparison import Comparison
from pickenv.inspect.runs.view import eye_direction, shown_box

BACKGROUND = (72, 72, 80)
"""Explicit, so that 3D views look the same in either theme; a grey from which both ends of Viridis stand out."""
EYE_DISTANCE = 2.2
"""In units of the shown box's radius."""
MOST_ABREAST = 4
"""Views side by side before there is another row of them."""


def space(comparison: Comparison, name: str, contents: list[str], **options: Any) -> Any:
    """The workspace in 3D, always seen by the same eye at first; each view can be orbited on its own."""
    import rerun.blueprint as rrb

    centre, radius = shown_box(comparison)
    eye = centre + EYE_DISTANCE * radius * eye_direction(comparison)
    return rrb.Spatial3DView(
        **{"origin": "/world", **options},
        contents=[*contents, "+ /world/workspace", "+ /world/axes"],
        name=name,
        background=BACKGROUND,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=centre, eye_up=[0.0, 0.0, 1.0]),
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, stroke_width=0.5, color=(255, 255, 255, 30)),
    )


def ghost(comparison: Comparison) -> list[str]:
    """The nominal arm as contents of a view, where there are reaches that it makes."""
    return ["+ /world/arm/nominal"] if len(comparison.fruit) else []


def with_colour_bar(views: list[Any], key: str, meaning: str, name: str) -> Any:
    """A tab: ``views`` side by side, in rows where they are many, and below them the colour bar `/legend/key`."""
    import rerun.blueprint as rrb

    bar = rrb.Spatial2DView(
        origin=f"/legend/{key}",
        contents=[f"+ /legend/{key}/**"],
        name=meaning,
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=[-14.0, 534.0], y_range=[-4.0, 20.0]),
    )
    rows = rrb.Grid(*views, grid_columns=-(-len(views) // -(-len(views) // MOST_ABREAST)))
    return rrb.Vertical(rows, bar, row_shares=[5.2, 1.0], name=name)
