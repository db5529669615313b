"""A comparison as one Rerun recording: error fields, reaches, arms, statistics, and the blueprint that lays them out.

The main time line is `reach`, the number of the reach; a day in the field has `hours` as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from pickenv.base import InputError, versions
from pickenv.inspect.colours import FRUIT, GREY, RED, STEEL, WHITE, Rgb, lane, policy_colours, policy_key
from pickenv.inspect.recordings.blueprint import comparison_blueprint
from pickenv.inspect.recordings.details import Details, details_of, send_details
from pickenv.inspect.recordings.scribe import (
    Scribe,
    f32,
    four_digits,
    reading,
    reading_columns,
    send_arm,
    send_arrows,
    send_capture,
    send_colour_bar,
    send_voxels,
    write_recording,
)
from pickenv.inspect.runs import comparison_summary
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedPolicy
from pickenv.inspect.runs.saved import cut_away, drawn_parts, nominal_points, true_points

TIME_LINE = "reach"
FRUIT_RADIUS = 0.008
"""m; smaller than an apple, so that a hundred of them hide nothing."""


def record_comparison(comparison: Comparison, path: str | Path, *, gain: float = 20.0) -> Path:
    """Write ``comparison`` as a Rerun recording (.rrd) with its blueprint inside, whole or not at all.

    Args:
        comparison: What to show.
        path: The file to write, usually `errors.rrd`; missing folders are made.
        gain: How much longer than true size errors are drawn.

    Returns:
        The path written.

    Raises:
        InputError: If there is no policy or a key repeats or cannot be part of an entity path, if the gain is not above
            zero, or if the file cannot be written.
    """
    _check(comparison, gain)
    details = details_of(comparison)
    times = [rr.TimeColumn(TIME_LINE, sequence=np.arange(len(comparison.fruit)))] if len(comparison.fruit) else []
    return write_recording(
        path,
        recording_id(comparison),
        comparison_blueprint(comparison, details, gain),
        lambda stream: _send(Scribe(stream, times), comparison, details, gain),
    )


def recording_id(comparison: Comparison) -> str:
    """Identity of a recording: recordings of one scene and seed are shown as one."""
    return f"{comparison.plant.name}:seed{comparison.seed}"


def _check(comparison: Comparison, gain: float) -> None:
    keys = [policy.key for policy in comparison.policies]
    if not keys:
        raise InputError("the comparison has no policy; give at least one")
    for key in keys:
        if not key or key != policy_key(key):
            raise InputError(
                f"policy key '{key}' cannot name an entity; use lower-case letters, digits and underscores"
            )
        if keys.count(key) > 1:
            raise InputError(f"policy key '{key}' is given twice; give every policy its own key")
    if not gain > 0.0:
        raise InputError(f"the gain is {gain}; give a number above zero")


def _send(scribe: Scribe, comparison: Comparison, details: Details, gain: float) -> None:
    _send_properties(scribe, comparison, gain)
    _send_scene(scribe, comparison, gain)
    for policy in comparison.policies:
        _send_field(scribe, comparison, policy, gain)
        _send_reaches(scribe, comparison, policy, gain)
    _send_tolerance(scribe, comparison, gain)
    _send_histograms(scribe, comparison)
    _send_legend(scribe, comparison, gain)
    send_details(scribe, comparison, details, gain)


def _colours(comparison: Comparison) -> list[Rgb]:
    return policy_colours([policy.key for policy in comparison.policies])


def _send_properties(scribe: Scribe, comparison: Comparison, gain: float) -> None:
    made_with: Any = {f"{name}_version": version for name, version in {**versions(), "rerun": rr.__version__}.items()}
    scribe.stream.send_property(
        "pickenv",
        rr.AnyValues(
            plant=comparison.plant.name,
            arm=comparison.plant.arm.name,
            arm_fingerprint=comparison.plant.arm.fingerprint(),
            seed=comparison.seed,
            policies=[policy.key for policy in comparison.policies],
            gain=gain,
            tolerance_mm=comparison.tolerance_mm,
            colour_scale_mm=comparison_summary.colour_scale_mm(comparison),
            **made_with,
        ),
    )


def _send_scene(scribe: Scribe, comparison: Comparison, gain: float) -> None:
    """The field's bounds with the world's axes, the fruit, and three arms under the first policy's commands."""
    size, corner = comparison.grid.size, comparison.grid.corner
    scribe.still(
        "world/axes",
        rr.Arrows3D(
            origins=[corner] * 3,
            vectors=np.diag(size),
            colors=[WHITE] * 3,
            labels=[f"{axis} {length:.2f} m" for axis, length in zip("xyz", size, strict=True)],
            radii=rr.Radius.ui_points(1.5),
        ),
    )
    scribe.still(
        "world/workspace",
        rr.Boxes3D(
            centers=[corner + size / 2.0],
            half_sizes=[size / 2.0],
            colors=[(*GREY, 110)],
            radii=rr.Radius.ui_points(0.7),
            fill_mode="majorwireframe",
        ),
    )
    if not scribe.times:
        return
    scribe.still("world/fruit", rr.Points3D(comparison.fruit, colors=[FRUIT], radii=FRUIT_RADIUS))
    first = comparison.policies[0].ends
    believed = nominal_points(comparison.nominal, first.joint_command)
    true = true_points(comparison.plant.geometry, first.joint_command, first.tool_position)
    parts = drawn_parts(believed)
    drawn = believed + gain * (true - believed)
    send_arm(scribe, "world/arm/nominal", believed, parts, GREY, "majorwireframe")
    send_arm(scribe, "world/arm/true", true, parts, STEEL, "solid")
    send_arm(scribe, "world/arm/exaggerated", drawn, parts, _colours(comparison)[0], "solid", 0.5)


def _send_field(scribe: Scribe, comparison: Comparison, policy: RecordedPolicy, gain: float) -> None:
    """One policy's error field three times: arrows, voxels, and a tensor for slices."""
    entity, top, magnitude = (
        f"world/field/{policy.key}",
        comparison_summary.colour_scale_mm(comparison),
        comparison_summary.field_mm(policy),
    )
    errors, step = policy.field_errors, comparison.grid.step
    send_arrows(scribe, f"{entity}/vectors", comparison.grid.points, gain * errors, 1e3 * errors, top)
    kept, index = ~cut_away(comparison), comparison.grid.index
    corner = comparison.grid.origin - step / 2.0
    send_voxels(
        scribe, f"{entity}/voxels", *comparison_summary.cell_means(index[kept], magnitude[kept]), top, step, corner
    )
    index, mean = comparison_summary.cell_means(index, magnitude)
    grid = np.full(comparison.grid.shape, np.nan, dtype=np.float32)
    grid[tuple(index.T)] = mean
    scribe.still(
        f"field/{policy.key}/magnitude_mm",
        rr.Tensor(
            np.ascontiguousarray(grid.transpose(2, 1, 0)),
            dim_names=[
                f"{axis} = {start:.3f} m + {step:g} m ×"  # the viewer says a cell's number after it
                for axis, start in zip("zyx", comparison.grid.origin[::-1], strict=True)
            ],
            value_range=[0.0, top],
        ),
    )


def _send_reaches(scribe: Scribe, comparison: Comparison, policy: RecordedPolicy, gain: float) -> None:
    """One policy's reaches along the time line: the miss as an arrow, the errors as numbers, and pick or miss."""
    if not scribe.times:
        return
    colour = dict(zip((p.key for p in comparison.policies), _colours(comparison), strict=True))[policy.key]
    ends = policy.ends
    miss = ends.tool_position - comparison.fruit
    entity = f"world/miss/{policy.key}"
    scribe.still(entity, rr.Arrows3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(2.5)))
    arrows = rr.Arrows3D.columns(origins=f32(comparison.fruit), vectors=f32(gain * miss))
    scribe.along(entity, arrows, reading_columns(1e3 * miss))
    shots = rr.Points3D(f32(miss * 1e3), colors=[colour], radii=rr.Radius.ui_points(3.0))
    scribe.still(f"target/{policy.key}", shots, reading(1e3 * miss))
    for name, values in (("error_mm", ends.position_error_mm), ("attitude_deg", ends.attitude_error_deg)):
        entity = f"metrics/{name}/{lane(policy.key)}"
        scribe.still(entity, rr.SeriesLines(names=[policy.label], colors=[colour], widths=[1.8]))
        scribe.along(entity, rr.Scalars.columns(scalars=four_digits(values)))
    entity = f"outcome/{lane(policy.key)}"
    configuration = rr.StateConfiguration(
        values=["pick", "miss"], labels=["pick", "miss"], colors=[(*colour, 255), (*RED, 255)]
    )
    scribe.still(entity, configuration)
    scribe.along(entity, rr.StateChange.columns(state=["pick" if ok else "miss" for ok in ends.success]))


def _send_tolerance(scribe: Scribe, comparison: Comparison, gain: float) -> None:
    """The gripper's capture region: a line on the error plot and, enlarged like the errors, a ball around the fruit."""
    if not scribe.times:
        return
    line = rr.SeriesLines(names=[f"tolerance {comparison.tolerance_mm:g} mm"], colors=[RED], widths=[1.5])
    scribe.still("metrics/tolerance_mm", line)
    scribe.along("metrics/tolerance_mm", rr.Scalars.columns(scalars=[comparison.tolerance_mm] * len(comparison.fruit)))
    radius = gain * comparison.tolerance_mm * 1e-3
    ball = rr.Ellipsoids3D.from_fields(
        half_sizes=[[radius] * 3], colors=[(*RED, 160)], line_radii=rr.Radius.ui_points(0.6), fill_mode="majorwireframe"
    )
    scribe.still("world/capture", ball)
    send_capture(scribe, comparison.tolerance_mm)
    axes = rr.Arrows3D(
        origins=np.zeros((3, 3)),
        vectors=comparison.tolerance_mm * np.eye(3),
        colors=[WHITE] * 3,
        labels=["x", "y", "z"],
        radii=rr.Radius.ui_points(1.0),
    )
    scribe.still("target/axes", axes)
    scribe.along("world/capture", rr.Ellipsoids3D.columns(centers=f32(comparison.fruit)))


def _send_histograms(scribe: Scribe, comparison: Comparison) -> None:
    """Reach errors in bins that all policies share; within a bin the policies' bars stand side by side."""
    edges, count = comparison_summary.histogram_edges_mm(comparison), len(comparison.policies)
    width = float(edges[1] - edges[0]) * 0.9 / count
    for i, (policy, colour) in enumerate(zip(comparison.policies, _colours(comparison), strict=True)):
        numbers, _ = np.histogram(policy.ends.position_error_mm, edges)
        middle = (edges[:-1] + edges[1:]) / 2.0 + (i - (count - 1) / 2.0) * width
        chart = rr.BarChart(
            numbers, abscissa=f32(middle), widths=f32(np.full(len(numbers), width)), color=(*colour, 255)
        )
        scribe.still(f"hist/{lane(policy.key)}", chart)


def _send_legend(scribe: Scribe, comparison: Comparison, gain: float) -> None:
    """The colour bar with its unit, and the summary."""
    send_colour_bar(scribe, "legend/position", comparison_summary.colour_scale_mm(comparison), "mm")
    scribe.still(
        "summary", rr.TextDocument(comparison_summary.summary_markdown(comparison, gain), media_type="text/markdown")
    )
