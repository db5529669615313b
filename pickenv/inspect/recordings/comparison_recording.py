"""Write a comparison as one Rerun recording: error fields, reaches, arms, statistics, and their layout (blueprint).

The main time line is `reach`, the index of the reach. Curves of errors over a day in the field have a second time line,
`hours`. The errors of a calibration or an evaluation are first made into a comparison.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import ComponentColumnSelector
from rerun.components import Colormap
from rerun.encodings import TensorDimensionIndexSelection

from pickenv.arm import Arm, Array, Plant, drawn_parts, forward, nominal_points, pose_error, true_points
from pickenv.base import InputError
from pickenv.calibration import Calibration, Compensator, Measurements
from pickenv.calibration.pipeline.calibration import uncertainty_from
from pickenv.inspect.colours import FRUIT, GREY, RED, STEEL, Rgb, check_key, in_words, lane
from pickenv.inspect.recordings import details
from pickenv.inspect.recordings.episode_entities import target_view
from pickenv.inspect.recordings.scribe import (
    Scribe,
    f32,
    layout,
    reading,
    reading_columns,
    seen_from,
    view_of,
    with_colour_bar,
    write_recording,
)
from pickenv.inspect.runs import comparison_summary as summary
from pickenv.inspect.runs.comparison_summary import GAIN, round_step, stage_label
from pickenv.inspect.runs.recorded_episodes import Comparison, FieldGrid, Reaches, RecordedPolicy, ended, field_grid
from pickenv.inspect.runs.run_folder import eye_direction, shown_box

FRUIT_RADIUS = 0.008
"""Radius of a drawn fruit, m; smaller than an apple, so that a hundred fruit hide nothing."""


def record_comparison(comparison: Comparison, path: str | Path) -> Path:
    """Write ``comparison`` as a Rerun recording (.rrd) that includes its layout (blueprint), atomically.

    Args:
        comparison: The comparison to show.
        path: The file to write, usually `errors.rrd`. Missing folders are made.

    Returns:
        The path written.

    Raises:
        InputError: If there is no policy, a policy's key is given twice or cannot be part of an entity path, or the
            file cannot be written.
    """
    _check(comparison)
    arrows, day = details.arrow_tabs(comparison), details.day_of(comparison)
    times = [rr.TimeColumn("reach", sequence=np.arange(len(comparison.fruit)))] if len(comparison.fruit) else []
    return write_recording(
        path,
        f"{comparison.plant.name}:seed{comparison.seed}",
        comparison_blueprint(comparison, arrows, day),
        lambda stream: _send(Scribe(stream, times), comparison, arrows, day),
    )


def _check(comparison: Comparison) -> None:
    keys = [policy.key for policy in comparison.policies]
    if not keys:
        raise InputError("the comparison has no policy; give at least one")
    for key in keys:
        check_key(key, "policy key")
        if keys.count(key) > 1:
            raise InputError(f"policy key '{key}' is given twice; give every policy its own key")


def _send(scribe: Scribe, comparison: Comparison, arrows: Mapping[str, details.ArrowTab], day: details.Day) -> None:
    plant = comparison.plant
    scribe.properties(
        plant=plant.name,
        arm=plant.arm.name,
        arm_fingerprint=plant.arm.fingerprint(),
        seed=comparison.seed,
        policies=[policy.key for policy in comparison.policies],
        gain=GAIN,
        tolerance_mm=comparison.tolerance_mm,
        colour_scale_mm=summary.colour_scale_mm(comparison),
    )
    _send_scene(scribe, comparison)
    for policy, colour in zip(comparison.policies, comparison.colours, strict=True):
        _send_field(scribe, comparison, policy)
        if scribe.times:
            _send_reaches(scribe, comparison, policy, colour)
    if scribe.times:
        _send_tolerance(scribe, comparison)
    _send_histograms(scribe, comparison)
    scribe.document("summary", summary.summary_markdown(comparison))
    details.send_details(scribe, comparison, arrows, day)


def _send_scene(scribe: Scribe, comparison: Comparison) -> None:
    """Send the field's bounds with axes, the fruit, and the nominal, the true and an exaggerated arm.

    The arms move by the first policy's commands. The deviation of the exaggerated arm from the nominal arm is `GAIN`
    times the deviation of the true arm.
    """
    size, corner = comparison.grid.size, comparison.grid.corner
    labels = [f"{axis} {length:.2f} m" for axis, length in zip("xyz", size, strict=True)]
    scribe.axes("world/axes", corner, size, labels, 1.5)
    look: Any = {"colors": [(*GREY, 110)], "radii": rr.Radius.ui_points(0.7), "fill_mode": "majorwireframe"}
    scribe.still("world/workspace", rr.Boxes3D(centers=[corner + size / 2.0], half_sizes=[size / 2.0], **look))
    if not scribe.times:
        return
    scribe.still("world/fruit", rr.Points3D(comparison.fruit, colors=[FRUIT], radii=FRUIT_RADIUS))
    first = comparison.policies[0].ends
    nominal = nominal_points(comparison.nominal, first.joint_command)
    true = true_points(comparison.plant.geometry, first.joint_command, first.tool_position)
    parts = drawn_parts(nominal)
    exaggerated = nominal + GAIN * (true - nominal)
    scribe.arm("world/arm/nominal", nominal, parts, GREY, "majorwireframe")
    scribe.arm("world/arm/true", true, parts, STEEL, "solid")
    scribe.arm("world/arm/exaggerated", exaggerated, parts, comparison.colours[0], "solid", 0.5)


def _send_field(scribe: Scribe, comparison: Comparison, policy: RecordedPolicy) -> None:
    """Send one policy's error field as voxels, and as a tensor for slices."""
    magnitude, top = summary.field_mm(policy), summary.colour_scale_mm(comparison)
    details.send_voxels(scribe, comparison, f"world/field/{policy.key}/voxels", magnitude, top)
    index, mean = summary.cell_means(comparison.grid.index, magnitude)
    grid = np.full(comparison.grid.shape, np.nan, dtype=np.float32)
    grid[tuple(index.T)] = mean
    starts = zip("zyx", comparison.grid.origin[::-1], strict=True)
    # The viewer says a cell's number after its name.
    names = [f"{axis} = {start:.3f} m + {comparison.grid.step:g} m ×" for axis, start in starts]
    tensor = rr.Tensor(np.ascontiguousarray(grid.transpose(2, 1, 0)), dim_names=names, value_range=[0.0, top])
    scribe.still(f"field/{policy.key}/magnitude_mm", tensor)


def _send_reaches(scribe: Scribe, comparison: Comparison, policy: RecordedPolicy, colour: Rgb) -> None:
    """Send one policy's reaches along the time line: tool errors as arrows and as numbers, and outcomes."""
    ends = policy.ends
    miss = ends.tool_position - comparison.fruit
    entity = f"world/miss/{policy.key}"
    scribe.still(entity, rr.Arrows3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(2.5)))
    arrows = rr.Arrows3D.columns(origins=f32(comparison.fruit), vectors=f32(GAIN * miss))
    scribe.along(entity, arrows, reading_columns(1e3 * miss))
    shots = rr.Points3D(f32(miss * 1e3), colors=[colour], radii=rr.Radius.ui_points(3.0))
    scribe.still(f"target/{policy.key}", shots, reading(1e3 * miss))
    for name, values in (("error_mm", ends.position_error_mm), ("attitude_deg", ends.attitude_error_deg)):
        entity = f"metrics/{name}/{lane(policy.key)}"
        short = [float(f"{value:.4g}") for value in values]  # the viewer's tables print all digits
        scribe.curve(entity, policy.label, colour, short, 1.8)
    states = ["pick" if success else "miss" for success in ends.success]
    scribe.lane(f"outcome/{lane(policy.key)}", {"pick": ("pick", colour), "miss": ("miss", RED)}, states)


def _send_tolerance(scribe: Scribe, comparison: Comparison) -> None:
    """Send the gripper's capture region: a line on the error plot, and an enlarged ball around the fruit."""
    level = [comparison.tolerance_mm] * len(comparison.fruit)
    scribe.curve("metrics/tolerance_mm", f"tolerance {comparison.tolerance_mm:g} mm", RED, level, 1.5)
    scribe.capture("world/capture", GAIN * comparison.tolerance_mm * 1e-3, 160, 0.6)
    scribe.capture("target/capture", comparison.tolerance_mm)
    scribe.axes("target/axes", np.zeros(3), [comparison.tolerance_mm] * 3, list("xyz"), 1.0)
    scribe.along("world/capture", rr.Ellipsoids3D.columns(centers=f32(comparison.fruit)))


def _send_histograms(scribe: Scribe, comparison: Comparison) -> None:
    """Send histograms of reach errors; all policies share the bins, and their bars stand side by side in each bin."""
    edges, count = summary.histogram_edges_mm(comparison), len(comparison.policies)
    width = float(edges[1] - edges[0]) * 0.9 / count
    for i, (policy, colour) in enumerate(zip(comparison.policies, comparison.colours, strict=True)):
        numbers, _ = np.histogram(policy.ends.position_error_mm, edges)
        middle = f32((edges[:-1] + edges[1:]) / 2.0 + (i - (count - 1) / 2.0) * width)
        look: Any = {"abscissa": middle, "widths": f32(np.full(len(numbers), width)), "color": (*colour, 255)}
        scribe.still(f"hist/{lane(policy.key)}", rr.BarChart(numbers, **look))


# The default layout: fields side by side on top, reaches and numbers below. All 3D views start with the same eye, and
# all fields share one colour scale and one gain, which their titles state.


EYE_DISTANCE = 2.2
"""Distance from the camera to the middle of the shown box, in units of the box's radius."""


def space(comparison: Comparison, name: str, contents: list[str], origin: str = "/world", **more: Any) -> Any:
    """Return a view in 3D of some entities, with a box around the field of poses and the world's axes.

    All such views start with the same camera, and each can be orbited on its own.

    Args:
        comparison: The comparison.
        name: Title of the view.
        contents: Rerun's query expressions for the entities to show, such as "+ /world/fruit".
        origin: The view's root entity.
        more: Further arguments of the view.
    """
    centre, radius = shown_box(comparison)
    eye = centre + EYE_DISTANCE * radius * eye_direction(comparison)
    return seen_from(eye, centre, origin, [*contents, "+ /world/workspace", "+ /world/axes"], name, **more)


def comparison_blueprint(
    comparison: Comparison, arrows: Mapping[str, details.ArrowTab], day: details.Day
) -> rrb.Blueprint:
    """Return the layout (blueprint) for a comparison. Position errors are drawn `GAIN` times longer than true.

    Args:
        comparison: The comparison, with at least one policy.
        arrows: Fields of arrows, from `details.arrow_tabs`.
        day: Error curves of a day in the field, from `details.day_of`.
    """
    policies, has_reaches = comparison.policies, len(comparison.fruit) > 0
    title = "{} | error magnitude, mm, corner cut away"
    voxels = [space(comparison, title.format(p.label), [f"+ /world/field/{p.key}/voxels"]) for p in policies]
    errors, *reasons = (_arrows(comparison, name, *tab) for name, tab in arrows.items())
    meaning = _meaning("mm", summary.colour_scale_mm(comparison))
    fields = {"Voxels": voxels, "Slices": [_slice(comparison, policy) for policy in policies]}
    tabs: list[Any] = [errors, *(with_colour_bar(views, "position", meaning, name) for name, views in fields.items())]
    below = [rrb.TextDocumentView(origin="/summary", contents=["+ /summary"], name="Summary")]
    if has_reaches:
        tabs.insert(1, _picking(comparison))
        reasons.insert(0, _arms(comparison))
        below = [_reaches(comparison), view_of(rrb.BarChartView, "hist", "Reaches by final position error, mm"), *below]
    if comparison.field_uncertainty is not None:
        reasons.append(_uncertainty(comparison, 1e3 * comparison.field_uncertainty))
    if day:
        reasons.append(_day(comparison, day))
    if has_reaches:
        reasons.append(_table(policies))
    content = rrb.Vertical(
        rrb.Tabs(*tabs, *reasons, active_tab=0),
        rrb.Horizontal(*below, column_shares=[2.7, 1.8, 3.5][-len(below) :]),
        row_shares=[5.6, 4.4],
    )
    return layout(content, "reach" if has_reaches else None, fps=2.0)  # reaches per second


def _meaning(unit: str, top: float) -> str:
    """Return the caption of a colour scale from 0 to ``top`` in ``unit`` (mm or deg), which explains the colours."""
    if unit == "mm":
        return f"Colour: position error, 0 to {top:.2f} mm"
    return f"Colour: attitude error, 0 to {top:.3f}°; arrows point along its axis"


def _arrows(
    comparison: Comparison, name: str, unit: str, top: float, fields: Mapping[str, tuple[str, Array, Array]]
) -> Any:
    nominal = ["+ /world/arm/nominal"] if len(comparison.fruit) else []
    views = [space(comparison, title, [f"+ /{entity}", *nominal]) for entity, (title, *_) in fields.items()]
    return with_colour_bar(views, details.LEGENDS[unit], _meaning(unit, top), name)


def _picking(comparison: Comparison) -> Any:
    parts = ("arm/nominal", "arm/exaggerated", "arm/true", "fruit", "capture", "miss/**")
    contents, hidden = [f"+ /world/{part}" for part in parts], {"/world/arm/true": rrb.EntityBehavior(visible=False)}
    name = f"Believed arm (wire), {comparison.policies[0].label} arm and misses ×{GAIN:g}, capture region (red)"
    scene = space(comparison, name, contents, overrides=hidden)
    shots = target_view(comparison.largest_mm, comparison.tolerance_mm)
    return rrb.Horizontal(scene, shots, column_shares=[3.0, 2.0], name="Picking")


def _slice(comparison: Comparison, policy: RecordedPolicy) -> Any:
    entity = f"/field/{policy.key}/magnitude_mm"
    middle = TensorDimensionIndexSelection(dimension=0, index=comparison.grid.shape[2] // 2)
    return rrb.TensorView(
        origin=entity,
        contents=[f"+ {entity}"],
        name=f"{in_words(policy.label)} | error magnitude, mm, at height z (slider)",
        view_fit="FillKeepAspectRatio",
        slice_selection=rrb.TensorSliceSelection(width=2, height=1, indices=[middle], slider=[0]),
        scalar_mapping=rrb.TensorScalarMapping(colormap=Colormap.Viridis),
    )


def _reaches(comparison: Comparison) -> Any:
    errors = rrb.TimeSeriesView(
        origin="/metrics",
        contents=["+ /metrics/error_mm/**", "+ /metrics/tolerance_mm"],
        name="Final position error of each reach, mm",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.4 * max(comparison.largest_mm, comparison.tolerance_mm)), zoom_lock=True),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=True),
    )
    outcome = view_of(rrb.StateTimelineView, "outcome", "Picked or missed (red)")
    return rrb.Vertical(errors, outcome, row_shares=[1.0, 1.0])


def _table(policies: tuple[RecordedPolicy, ...]) -> Any:
    number, outcome = "Scalars:scalars", "StateChange:state"
    sources = {"metrics/error_mm": number, "metrics/attitude_deg": number, "outcome": outcome}
    parts = {f"/{folder}/{lane(p.key)}": component for folder, component in sources.items() for p in policies}
    columns = [ComponentColumnSelector(entity_path=entity, component=component) for entity, component in parts.items()]
    look: dict[str, Any] = {"select": ["reach", *columns], "entity_order": list(parts)}
    query = rrb.archetypes.DataframeQuery(timeline="reach", apply_latest_at=True, **look)
    contents = [f"+ {entity}" for entity in parts]
    return rrb.DataframeView(origin="/metrics", contents=contents, name="Reaches as a table", query=query)


def _arms(comparison: Comparison) -> Any:
    first = comparison.policies[0].label
    exaggerated = ["+ /world/arm/nominal", "+ /world/arm/exaggerated", "+ /world/fruit", "+ /world/miss/**"]
    urdf = ["+ /urdf_nominal/**", "+ /urdf_true/**"]
    return rrb.Horizontal(
        space(comparison, f"Nominal arm (wire) and true arm under the {first} command, ×{GAIN:g}", exaggerated),
        space(comparison, "Nominal and true arm as exported (URDF), true size", urdf, origin="/"),
        name=f"True arm ×{GAIN:g}",
    )


def _uncertainty(comparison: Comparison, predicted: Array) -> Any:
    """Return the tab of the standard uncertainty ``predicted`` ``(F,)``, mm, beside the last policy's actual errors."""
    last = comparison.policies[-1]
    actual = summary.field_mm(last)
    inside = 100.0 * float(np.mean(actual < 2.0 * predicted))
    least, most = float(predicted.min()), float(predicted.max())
    titles = {
        "predicted": f"Predicted standard uncertainty u | mean {predicted.mean():.2f} mm, {least:.2f} to {most:.2f} mm",
        "actual": f"Actual error, {last.label} | mean {actual.mean():.2f} mm | below 2u at {inside:.0f} %",
    }
    views = [space(comparison, title, [f"+ /world/uncertainty/{key}"]) for key, title in titles.items()]
    meaning = f"Colour: uncertainty and error, 0 to {summary.uncertainty_scale_mm(comparison):.2f} mm"
    return with_colour_bar(views, "uncertainty", meaning, "Predicted uncertainty")


def _day(comparison: Comparison, day: details.Day) -> Any:
    errors = [errors for key, (_, errors) in day.items() if key != details.ADAPTED]
    hours, plant = details.day_hours(comparison), details.drifting_plant(comparison.plant)
    assert plant is not None
    largest = max(float(np.percentile(line, 95, axis=1).max()) for line in errors)
    plot = view_of(
        rrb.TimeSeriesView,
        "day",
        f"Position error over {hours[-1]:g} h of warming up, tilting and sinking as in {in_words(plant.name)}, mm | "
        f"commands as on firm ground | across: reaches, {60.0 * hours[0]:.0f} min apart; or choose 'hours'",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.15 * largest), zoom_lock=True),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightBottom, visible=True),
    )
    words = rrb.TextDocumentView(origin=f"/{details.DAY_WORDS}", contents=[f"+ /{details.DAY_WORDS}"], name="Why")
    return rrb.Horizontal(plot, words, column_shares=[3, 1], name="A day in the field")


def inspect_calibration(
    calibration: Calibration, evidence: Plant | Measurements, path: str | Path, *, grid_step: float = 0.1, seed: int = 0
) -> Path:
    """Write a recording of the errors before and after calibration, simulated over the workspace or at measured poses.

    Args:
        calibration: The calibration.
        evidence: A plant or measured poses. A plant (simulated true arm) is driven over its workspace, raw and
            compensated. From measured poses, which should be held out, the models' predictions are subtracted.
        path: The file to write (.rrd).
        grid_step: Distance between neighbouring poses of the grid at which the simulated arm's errors are computed, m.
        seed: Seed of the random joint values from which the workspace's extent is estimated.

    Returns:
        The path written.

    Raises:
        InputError: If the calibration is for another arm, there are too few poses, or the file cannot be written.
    """
    if isinstance(evidence, Plant):
        return record_comparison(_simulated(calibration, evidence, grid_step, seed), path)
    return record_comparison(_measured(calibration, evidence, seed), path)


def inspect_evaluation(
    runs: Mapping[str, Reaches], plant: Plant, path: str | Path, *, tolerance_mm: float = 5.0, seed: int = 0
) -> Path:
    """Write a recording of the final errors of several policies at the same fruit.

    Args:
        runs: The final states of each policy's episodes, by the policy's label. The first policy has no
            calibration (raw). All policies have the same fruit.
        plant: The simulated true arm, or the plant that a population of arms was drawn from.
        path: The file to write (.rrd).
        tolerance_mm: Radius of the gripper's capture region, mm.
        seed: Seed of the episodes, which is part of the recording's identity.

    Returns:
        The path written.

    Raises:
        InputError: If there are no runs, their fruit differ, or the file cannot be written.
    """
    if not runs:
        raise InputError("there are no episodes to show; give the ends of at least one policy's episodes")
    label, first = next(iter(runs.items()))
    for name, ends in runs.items():
        if not np.array_equal(ends.fruit_position, first.fruit_position):
            raise InputError(f"'{name}' did not reach for the same fruit as '{label}'; evaluate both with equal seeds")
    errors = {
        name: np.concatenate([ends.tool_position - ends.fruit_position, ends.pose_error[:, 3:]], axis=1)
        for name, ends in runs.items()
    }
    comparison = Comparison(
        policies=tuple(ended(name, ends).with_field(errors[name]) for name, ends in runs.items()),
        plant=plant,
        tolerance_mm=tolerance_mm,
        seed=seed,
        seeds=first.seeds,
        grid=_grid_around(first.fruit_position, first.joint_command),  # the field's points are the fruit
    )
    return record_comparison(comparison, path)


def _simulated(calibration: Calibration, plant: Plant, grid_step: float, seed: int) -> Comparison:
    """Return a comparison of raw, LS and, if learnt, LS with residual, each driving the plant over its workspace.

    ``grid_step`` and ``seed`` are as for `inspect_calibration`.
    """
    if calibration.arm_fingerprint != plant.arm.fingerprint():
        raise InputError(
            f"the calibration is of arm '{calibration.arm_name}', not of '{plant.arm.name}' with this geometry; "
            "fit one for this arm"
        )
    grid = field_grid(calibration.nominal, grid_step, seed)
    target = forward(calibration.nominal, grid.joints)
    stages: dict[str, Compensator | None] = {"raw": None, "LS": calibration.compensator(with_residual=False)}
    if calibration.learnt is not None:
        stages[stage_label(calibration)] = calibration.compensator()
    errors = {
        label: pose_error(target, plant.tool_pose(grid.joints if send is None else send(grid.joints)))
        for label, send in stages.items()
    }
    return _without_reaches(calibration, plant, errors, grid, seed)


def _measured(calibration: Calibration, data: Measurements, seed: int) -> Comparison:
    """Return a comparison of raw, LS and, if learnt, LS with residual, as predictions of measured poses.

    The true arm of the comparison is the identified arm.
    """
    if len(data) < 2:
        raise InputError(f"{data.source}: {len(data)} poses are too few to show; give at least two")
    errors = {"raw": data.difference(calibration.nominal), "LS": data.difference(calibration.model)}
    if calibration.learnt is not None:
        errors[stage_label(calibration)] = calibration.errors(data)
    unknown = np.ones(calibration.nominal.joints)  # the joints' speeds, which no recording shows
    arm = Arm(calibration.arm_name, data.source, calibration.nominal, None, unknown)
    plant = Plant(f"{calibration.arm_name}, measured", arm, calibration.identified)
    points = forward(calibration.nominal, data.joints).position
    return _without_reaches(calibration, plant, errors, _grid_around(points, data.joints), seed)


def _without_reaches(
    calibration: Calibration, plant: Plant, errors: Mapping[str, Array], grid: FieldGrid, seed: int
) -> Comparison:
    uncertainty, points, poses = uncertainty_from(calibration.record), np.empty((0, 3)), np.empty((0, 6))
    none = Reaches((), poses, poses, np.empty(0, dtype=np.bool_), grid.joints[:0], points, points)
    return Comparison(
        policies=tuple(ended(label, none).with_field(error) for label, error in errors.items()),
        plant=plant,
        tolerance_mm=0.0,
        seed=seed,
        grid=grid,
        field_uncertainty=None if uncertainty is None else uncertainty.standard(calibration.model, grid.joints)[0],
    )


def _grid_around(points: Array, joints: Array) -> FieldGrid:
    """Return a grid around irregular points ``(F, 3)``, m, at which the arm has ``joints`` ``(F, n)``.

    Cells are cubes of a round size, with about ten cells along the longest side.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    step = round_step(max(float((high - low).max()), 1e-3) / 10)
    shape = np.maximum(np.ceil((high - low) / step).astype(int), 1)
    corner = (low + high - shape * step) / 2.0
    index = np.clip(((points - corner) / step).astype(np.int64), 0, shape - 1)
    return FieldGrid(tuple(shape.tolist()), corner + step / 2.0, step, index, points, joints)
