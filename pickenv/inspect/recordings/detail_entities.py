"""What a recording holds besides fields and reaches: effects, attitude, uncertainty, a day, the arms as URDF."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from pickenv.arm.files.urdf_text import write_urdf
from pickenv.arm.kinematics.geometry import Array, Geometry
from pickenv.inspect.colours import GREY, STEEL, Rgb, policy_colours
from pickenv.inspect.recordings.details import Details, attitude_length
from pickenv.inspect.recordings.field_day import Day
from pickenv.inspect.recordings.scribe import Scribe, send_arrows, send_colour_bar, send_voxels
from pickenv.inspect.runs import comparison_summary
from pickenv.inspect.runs.comparison import Comparison
from pickenv.inspect.runs.view import cut_away

DAY_TIME_LINE = "hours"
DAY_WORDS = "about_the_day"
WORLD = "tf#/"
"""Rerun's name for the frame of the root entity, in which both URDF arms stand."""


def send_details(scribe: Scribe, comparison: Comparison, details: Details, gain: float) -> None:
    """Send ``details`` of ``comparison``, whose errors are drawn ``gain`` times too long."""
    points, top = comparison.field_points, comparison_summary.colour_scale_mm(comparison)
    if details.removed is not None:
        send_arrows(scribe, "world/field/removed/vectors", points, gain * details.removed, 1e3 * details.removed, top)
    for name, field in details.effects.items():
        send_arrows(scribe, f"world/effect/{name}", points, gain * field, 1e3 * field, top)
    if details.attitude:
        top, length = (
            comparison_summary.attitude_scale_deg(details.attitude),
            attitude_length(comparison, details.attitude),
        )
        for key, field in details.attitude.items():
            degrees = np.degrees(field)
            send_arrows(scribe, f"world/attitude/{key}", points, length * degrees, degrees, top, "deg")
        send_colour_bar(scribe, "legend/attitude", top, "deg")
    if comparison.field_uncertainty is not None:
        _send_uncertainty(scribe, comparison, comparison.field_uncertainty)
    if details.day is not None:
        _send_day(scribe, comparison, details.day)
    if scribe.times:
        commands = comparison.policies[0].reach_joints
        _send_urdf(scribe, "urdf_nominal", comparison.nominal, commands, GREY, "majorwireframe")
        _send_urdf(scribe, "urdf_true", comparison.plant.geometry, commands, STEEL, "solid")


def _send_uncertainty(scribe: Scribe, comparison: Comparison, uncertainty: Array) -> None:
    """Predicted uncertainty and what the last policy really misses by, on one scale."""
    top, kept = comparison_summary.uncertainty_scale_mm(comparison), ~cut_away(comparison)
    corner = comparison.grid_origin - comparison.grid_step / 2.0
    for name, values in (
        ("predicted", 1e3 * uncertainty),
        ("actual", comparison_summary.field_mm(comparison.policies[-1])),
    ):
        cells = comparison_summary.cell_means(comparison.field_index[kept], values[kept])
        send_voxels(scribe, f"world/uncertainty/{name}", *cells, top, comparison.grid_step, corner)
    send_colour_bar(scribe, "legend/uncertainty", top, "mm")


def _send_day(scribe: Scribe, comparison: Comparison, day: Day) -> None:
    """Mean and 95th percentile over all fruit at every time of the day, and why they are so."""
    times = [*scribe.times, rr.TimeColumn(DAY_TIME_LINE, duration=3600.0 * day.hours)]
    hours = Scribe(scribe.stream, times)
    lines = day.lines({policy.key: policy.label for policy in comparison.policies})
    for (key, (label, errors)), colour in zip(lines.items(), policy_colours(list(lines)), strict=True):
        for name, values, width in (
            ("mean", errors.mean(axis=1), 2.2),
            ("p95", np.percentile(errors, 95, axis=1), 1.0),
        ):
            entity = f"day/{name}_mm/{key}"
            scribe.still(entity, rr.SeriesLines(names=[f"{label}, {name}"], colors=[colour], widths=[width]))
            hours.along(entity, rr.Scalars.columns(scalars=values))
    words = day.explanation({policy.key: policy.label for policy in comparison.policies})
    scribe.still(DAY_WORDS, rr.TextDocument(words, media_type="text/markdown"))


def _send_urdf(scribe: Scribe, name: str, geometry: Geometry, joints: Array, colour: Rgb, fill_mode: Any) -> None:
    """An arm as it is exported, moved along the reaches by the joint commands ``(R, n)``."""
    with tempfile.TemporaryDirectory() as folder:
        tree = rr.urdf.UrdfTree.from_file_path(
            write_urdf(geometry, Path(folder) / f"{name}.urdf", name),
            entity_path_prefix=name,
            frame_prefix=f"{name}/",
            # Each arm its own: two arms with the default entity would overwrite one another's frames.
            static_transform_entity_path=f"{name}/tf_static",
        )
    tree.log_urdf_to_recording(scribe.stream)
    scribe.still(f"{name}/base", rr.Transform3D(parent_frame=WORLD, child_frame=f"{name}/base"))
    for link in dict.fromkeys(joint.parent_link for joint in tree.joints()):
        for entity in tree.get_visual_geometry_paths(link):
            scribe.still(entity, rr.Cylinders3D.from_fields(colors=[colour], fill_mode=fill_mode))
    moving = [joint for joint in tree.joints() if joint.joint_type != "fixed"]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*outside limits.*")  # by rounding; rerun then takes the limit
        for i, joint in enumerate(moving):
            scribe.along(f"{name}/joint{i + 1}", joint.compute_transform_columns(joints[:, i].tolist()))
