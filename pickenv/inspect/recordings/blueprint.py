"""The default layout of a recording: fields side by side on top, reaches and numbers below.

All 3D views start with the same eye, and all fields share one colour scale and one gain, which their titles state.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun.blueprint as rrb
from rerun.blueprint.components import ComponentColumnSelector
from rerun.components import Colormap
from rerun.encodings import TensorDimensionIndexSelection

from pickenv.arm import Array
from pickenv.inspect.colours import lane
from pickenv.inspect.recordings.details import DAY_WORDS, FLOOR, Details, attitude_length
from pickenv.inspect.recordings.field_day import Day
from pickenv.inspect.runs import comparison_summary
from pickenv.inspect.runs.comparison_summary import colour_scale_mm, error_spread, field_mm
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedPolicy
from pickenv.inspect.runs.saved import eye_direction, shown_box

# Views that several tabs of a blueprint are made of: the workspace in 3D, a colour bar.


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


REACHES_PER_SECOND = 2.0


def comparison_blueprint(comparison: Comparison, details: Details, gain: float) -> rrb.Blueprint:
    """The layout for ``comparison``, whose errors are drawn ``gain`` times too long.

    Args:
        comparison: At least one policy.
        details: From `details_of`.
        gain: As given to `record_comparison`.
    """
    policies = comparison.policies
    top = colour_scale_mm(comparison)
    has_reaches = len(comparison.fruit) > 0
    arm = ghost(comparison)
    fields = [
        space(comparison, _field_title(policy, gain), [f"+ /world/field/{policy.key}/vectors", *arm])
        for policy in policies
    ]
    voxels = [
        space(
            comparison,
            f"{policy.label} | error magnitude, mm, corner cut away",
            [f"+ /world/field/{policy.key}/voxels"],
        )
        for policy in policies
    ]
    slices = [_slice(comparison, policy) for policy in policies]
    if details.removed is not None:
        fields.append(_removed(comparison, details.removed, gain))
    meaning = f"Colour: position error, 0 to {top:.2f} mm"
    tabs: list[Any] = [
        with_colour_bar(fields, "position", meaning, f"Error fields, arrows ×{gain:g}"),
        with_colour_bar(voxels, "position", meaning, "Voxels"),
        with_colour_bar(slices, "position", meaning, "Slices"),
    ]
    below: list[Any] = [
        rrb.TextDocumentView(origin="/summary", contents=["+ /summary"], name="Summary"),
    ]
    tabs += detail_tabs(comparison, details, gain)
    if has_reaches:
        tabs.insert(1, _picking(comparison, gain))
        tabs.append(_table(policies))
        below = [_reaches(comparison), _histogram(), *below]
    content = rrb.Vertical(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.Horizontal(*below, column_shares=[3.0, 2.0, 3.0][-len(below) :]),
        row_shares=[5.6, 4.4],
    )
    return layout(content, "reach" if has_reaches else None, fps=REACHES_PER_SECOND)


def _removed(comparison: Comparison, removed: Array, gain: float) -> Any:
    """What the last policy takes away from the error that the one before it leaves; beside the fields themselves."""
    before, last = comparison.policies[-2:]
    mean = error_spread(np.linalg.norm(1e3 * removed, axis=-1)).mean
    title = f"{before.label} minus {last.label} | mean {mean:.2f} mm | ×{gain:g}"
    return space(comparison, title, ["+ /world/field/removed/vectors", *ghost(comparison)])


def _field_title(policy: RecordedPolicy, gain: float) -> str:
    return f"{policy.label} | mean {error_spread(field_mm(policy)).mean:.2f} mm | arrows ×{gain:g}"


def _picking(comparison: Comparison, gain: float) -> Any:
    arms = ["+ /world/arm/nominal", "+ /world/arm/exaggerated", "+ /world/arm/true"]
    scene = space(
        comparison,
        f"Believed arm (wire), {comparison.policies[0].label} arm and misses ×{gain:g}, capture region (red)",
        [*arms, "+ /world/fruit", "+ /world/capture", "+ /world/miss/**"],
        overrides={"/world/arm/true": rrb.EntityBehavior(visible=False)},
    )
    largest = max(float(policy.ends.position_error_mm.max()) for policy in comparison.policies)
    distance = 1.7 * max(largest, comparison.tolerance_mm)
    aim = 500.0 * (comparison.policies[0].ends.tool_position - comparison.fruit).mean(axis=0)
    shots = seen_from(
        aim + distance * eye_direction(comparison),
        aim,
        "/target",
        ["+ /target/**"],
        f"All misses seen from the fruit, true size; capture region, {comparison.tolerance_mm:g} mm (red)",
        ground=False,
    )
    return rrb.Horizontal(scene, shots, column_shares=[3.0, 2.0], name="Picking")


def _slice(comparison: Comparison, policy: RecordedPolicy) -> Any:
    middle = comparison.grid.shape[2] // 2
    entity = f"/field/{policy.key}/magnitude_mm"
    return rrb.TensorView(
        origin=entity,
        contents=[f"+ {entity}"],
        name=f"{policy.label} | error magnitude, mm, at height z (slider)",
        view_fit="FillKeepAspectRatio",
        slice_selection=rrb.TensorSliceSelection(
            width=2, height=1, indices=[TensorDimensionIndexSelection(dimension=0, index=middle)], slider=[0]
        ),
        scalar_mapping=rrb.TensorScalarMapping(colormap=Colormap.Viridis),
    )


def _reaches(comparison: Comparison) -> Any:
    largest = max(float(policy.ends.position_error_mm.max()) for policy in comparison.policies)
    errors = rrb.TimeSeriesView(
        origin="/metrics",
        contents=["+ /metrics/error_mm/**", "+ /metrics/tolerance_mm"],
        name="Final position error of each reach, mm",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.4 * max(largest, comparison.tolerance_mm)), zoom_lock=True),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=True),
    )
    outcome = rrb.StateTimelineView(origin="/outcome", contents=["+ /outcome/**"], name="Picked or missed (red)")
    return rrb.Vertical(errors, outcome, row_shares=[1.0, 1.0])


def _histogram() -> Any:
    return rrb.BarChartView(origin="/hist", contents=["+ /hist/**"], name="Reaches by final position error, mm")


def _table(policies: tuple[RecordedPolicy, ...]) -> Any:
    sources = (
        ("metrics/error_mm", "Scalars:scalars"),
        ("metrics/attitude_deg", "Scalars:scalars"),
        ("outcome", "StateChange:state"),
    )
    entities = [(f"/{folder}/{lane(policy.key)}", component) for folder, component in sources for policy in policies]
    columns = [ComponentColumnSelector(entity_path=entity, component=component) for entity, component in entities]
    return rrb.DataframeView(
        origin="/metrics",
        contents=[f"+ {entity}" for entity, _ in entities],
        name="Reaches as a table",
        query=rrb.archetypes.DataframeQuery(
            timeline="reach",
            apply_latest_at=True,
            select=["reach", *columns],
            entity_order=[entity for entity, _ in entities],
        ),
    )


# Tabs for the reasons behind the errors: arms, effects, attitude, uncertainty, a day in the field.


def detail_tabs(comparison: Comparison, details: Details, gain: float) -> list[Any]:
    """One tab for each part of ``details`` that there is."""
    tabs = [_effects(comparison, details, gain)]
    if details.attitude:
        tabs.append(_attitude(comparison, details))
    if comparison.field_uncertainty is not None:
        tabs.append(_uncertainty(comparison))
    if details.day is not None:
        tabs.append(_day(details.day))
    if len(comparison.fruit):
        tabs.insert(0, _arms(comparison, gain))
    return tabs


def _arms(comparison: Comparison, gain: float) -> Any:
    first = comparison.policies[0].label
    exaggerated = ["+ /world/arm/nominal", "+ /world/arm/exaggerated", "+ /world/fruit", "+ /world/miss/**"]
    urdf = ["+ /urdf_nominal/**", "+ /urdf_true/**"]
    return rrb.Horizontal(
        space(comparison, f"Nominal arm (wire) and true arm under the {first} command, ×{gain:g}", exaggerated),
        space(comparison, "Nominal and true arm as exported (URDF), true size", urdf, origin="/"),
        name=f"True arm ×{gain:g}",
    )


def _effects(comparison: Comparison, details: Details, gain: float) -> Any:
    views = []
    for name, field in details.effects.items():
        mean = comparison_summary.error_spread(1e3 * np.linalg.norm(field, axis=-1)).mean
        title = f"{name.replace('_', ' ')} | mean {mean:.2f} mm | ×{gain:g}"
        views.append(space(comparison, title, [f"+ /world/effect/{name}", *ghost(comparison)]))
    meaning = f"Colour: position error, 0 to {comparison_summary.colour_scale_mm(comparison):.2f} mm"
    return with_colour_bar(views, "position", meaning, "Effects, each alone")


def _attitude(comparison: Comparison, details: Details) -> Any:
    labels = {policy.key: f"{policy.label} attitude" for policy in comparison.policies}
    labels[FLOOR] = "No joint motion removes"
    top, length = comparison_summary.attitude_scale_deg(details.attitude), attitude_length(comparison, details.attitude)
    views = []
    for key, field in details.attitude.items():
        mean = comparison_summary.error_spread(np.degrees(np.linalg.norm(field, axis=-1))).mean
        title = f"{labels[key]} | mean {mean:.3f}° | {1e3 * length:g} mm per degree"
        views.append(space(comparison, title, [f"+ /world/attitude/{key}", *ghost(comparison)]))
    meaning = f"Colour: attitude error, 0 to {top:.3f}°; arrows point along its axis"
    return with_colour_bar(views, "attitude", meaning, "Attitude")


def _uncertainty(comparison: Comparison) -> Any:
    assert comparison.field_uncertainty is not None
    last, predicted = comparison.policies[-1], 1e3 * comparison.field_uncertainty
    actual, inside = (
        comparison_summary.field_mm(last),
        100.0 * float(np.mean(comparison_summary.field_mm(last) < 2.0 * predicted)),
    )
    least, most = float(predicted.min()), float(predicted.max())
    titles = {
        "predicted": f"Predicted standard uncertainty u | mean {predicted.mean():.2f} mm, {least:.2f} to {most:.2f} mm",
        "actual": f"Actual error, {last.label} | mean {actual.mean():.2f} mm | below 2u at {inside:.0f} %",
    }
    views = [space(comparison, title, [f"+ /world/uncertainty/{key}"]) for key, title in titles.items()]
    meaning = f"Colour: uncertainty and error, 0 to {comparison_summary.uncertainty_scale_mm(comparison):.2f} mm"
    return with_colour_bar(views, "uncertainty", meaning, "Predicted uncertainty")


def _day(day: Day) -> Any:
    largest = max(float(np.percentile(errors, 95, axis=1).max()) for errors in day.errors_mm.values())
    plot = rrb.TimeSeriesView(
        origin="/day",
        contents=["+ /day/**"],
        name=f"Position error over {day.hours[-1]:g} h of warming up, tilting and sinking as in '{day.plant}', mm | "
        f"commands as on firm ground | across: reaches, {60.0 * day.hours[0]:.0f} min apart; or choose 'hours'",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.15 * largest), zoom_lock=True),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightBottom, visible=True),
    )
    words = rrb.TextDocumentView(origin=f"/{DAY_WORDS}", contents=[f"+ /{DAY_WORDS}"], name="Why")
    return rrb.Horizontal(plot, words, column_shares=[3, 1], name="A day in the field")
