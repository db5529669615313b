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

from pickenv.arm.kinematics.geometry import Array
from pickenv.inspect.colours import lane
from pickenv.inspect.recordings.blueprint_views import ghost, layout, seen_from, space, with_colour_bar
from pickenv.inspect.recordings.detail_tabs import detail_tabs
from pickenv.inspect.recordings.details import Details
from pickenv.inspect.runs.comparison import Comparison, PolicyErrors
from pickenv.inspect.runs.comparison_summary import colour_scale_mm, error_spread, field_mm
from pickenv.inspect.runs.view import eye_direction

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


def _field_title(policy: PolicyErrors, gain: float) -> str:
    return f"{policy.label} | mean {error_spread(field_mm(policy)).mean:.2f} mm | arrows ×{gain:g}"


def _picking(comparison: Comparison, gain: float) -> Any:
    arms = ["+ /world/arm/nominal", "+ /world/arm/exaggerated", "+ /world/arm/true"]
    scene = space(
        comparison,
        f"Believed arm (wire), {comparison.policies[0].label} arm and misses ×{gain:g}, capture region (red)",
        [*arms, "+ /world/fruit", "+ /world/capture", "+ /world/miss/**"],
        overrides={"/world/arm/true": rrb.EntityBehavior(visible=False)},
    )
    largest = max(float(policy.position_error_mm.max()) for policy in comparison.policies)
    distance = 1.7 * max(largest, comparison.tolerance_mm)
    aim = 500.0 * (comparison.policies[0].reach_positions - comparison.fruit).mean(axis=0)
    shots = seen_from(
        aim + distance * eye_direction(comparison),
        aim,
        "/target",
        ["+ /target/**"],
        f"All misses seen from the fruit, true size; capture region, {comparison.tolerance_mm:g} mm (red)",
        ground=False,
    )
    return rrb.Horizontal(scene, shots, column_shares=[3.0, 2.0], name="Picking")


def _slice(comparison: Comparison, policy: PolicyErrors) -> Any:
    middle = comparison.grid_shape[2] // 2
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
    largest = max(float(policy.position_error_mm.max()) for policy in comparison.policies)
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


def _table(policies: tuple[PolicyErrors, ...]) -> Any:
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
