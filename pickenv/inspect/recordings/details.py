"""Why the arm errs where it does: what each effect alone does, what no joint removes, what drifts within a day.

Everything here is computed from a comparison, on its field of poses or on its reaches. SI units.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from pickenv.arm import Array, Geometry, forward, noncompensable_error
from pickenv.arm.files.urdf import write_urdf
from pickenv.arm.plant.campaign import alone, causes_of
from pickenv.inspect.colours import GREY, STEEL, Rgb, policy_colours
from pickenv.inspect.recordings.field_day import Day, day_of
from pickenv.inspect.recordings.scribe import Scribe, send_arrows, send_colour_bar, send_voxels
from pickenv.inspect.runs import comparison_summary
from pickenv.inspect.runs.comparison_summary import attitude_scale_deg, round_step
from pickenv.inspect.runs.recorded_episodes import Comparison
from pickenv.inspect.runs.saved import cut_away

# What a recording holds besides fields and reaches: effects, attitude, uncertainty, a day, the arms as URDF.


DAY_TIME_LINE = "hours"
DAY_WORDS = "about_the_day"
WORLD = "tf#/"
"""Rerun's name for the frame of the root entity, in which both URDF arms stand."""


def send_details(scribe: Scribe, comparison: Comparison, details: Details, gain: float) -> None:
    """Send ``details`` of ``comparison``, whose errors are drawn ``gain`` times too long."""
    points, top = comparison.grid.points, comparison_summary.colour_scale_mm(comparison)
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
        commands = comparison.policies[0].ends.joint_command
        _send_urdf(scribe, "urdf_nominal", comparison.nominal, commands, GREY, "majorwireframe")
        _send_urdf(scribe, "urdf_true", comparison.plant.geometry, commands, STEEL, "solid")


def _send_uncertainty(scribe: Scribe, comparison: Comparison, uncertainty: Array) -> None:
    """Predicted uncertainty and what the last policy really misses by, on one scale."""
    top, kept = comparison_summary.uncertainty_scale_mm(comparison), ~cut_away(comparison)
    corner = comparison.grid.corner
    for name, values in (
        ("predicted", 1e3 * uncertainty),
        ("actual", comparison_summary.field_mm(comparison.policies[-1])),
    ):
        cells = comparison_summary.cell_means(comparison.grid.index[kept], values[kept])
        send_voxels(scribe, f"world/uncertainty/{name}", *cells, top, comparison.grid.step, corner)
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


NO_FIELD = 1e-9
"""m; an effect that moves the settled tool by less than this everywhere has no field to show."""
FLOOR = "floor"
"""Key of the attitude error that no joint motion removes."""


@dataclass(frozen=True, eq=False)
class Details:
    """What a comparison's further views show.

    Attributes:
        removed: What the last policy removes of the error that the one before it leaves ``(F, 3)``, m; None where there
            is one policy.
        effects: The error field that each effect has alone ``(F, 3)``, m; `geometry` is the true against the nominal
            geometry.
        attitude: Attitude errors over the field ``(F, 3)``, rotation vectors, rad: of the first policy, of the last,
            and the part that no joint motion removes (key `FLOOR`); empty where attitudes are unknown.
        day: A day in the field; None without reaches, or for an arm of which no drift is known.
    """

    removed: Array | None
    effects: Mapping[str, Array]
    attitude: Mapping[str, Array]
    day: Day | None


def details_of(comparison: Comparison) -> Details:
    """Compute all of it."""
    policies = comparison.policies
    removed = policies[-2].field_errors - policies[-1].field_errors if len(policies) > 1 else None
    return Details(removed, effect_fields(comparison), attitude_fields(comparison), day_of(comparison))


def effect_fields(comparison: Comparison) -> dict[str, Array]:
    """The error field ``(F, 3)``, m, of each effect that is on, alone on the nominal geometry, and of the geometry.

    The tool is settled, the arm warm and the machine sunk. Effects that show only on the way there have no field.
    """
    plant, joints = comparison.plant, comparison.grid.joints
    believed = forward(comparison.nominal, joints).position
    fields = {}
    for name in causes_of(plant):
        field = alone(plant, name).tool_pose(joints).position - believed
        if np.abs(field).max(initial=0.0) > NO_FIELD:
            fields[name] = field
    return fields


def attitude_fields(comparison: Comparison) -> dict[str, Array]:
    """Attitude errors of the first and the last policy, and the floor under the last one; see `Details`."""
    first, last = comparison.policies[0], comparison.policies[-1]
    if first.field_attitude is None or last.field_attitude is None:
        return {}
    error = np.concatenate([last.field_errors, last.field_attitude], axis=1)
    floor = noncompensable_error(comparison.plant.geometry, comparison.grid.joints, error)[..., 3:]
    return {first.key: first.field_attitude, last.key: last.field_attitude, FLOOR: floor}


def attitude_length(comparison: Comparison, fields: Mapping[str, Array]) -> float:
    """How long an attitude error of 1 deg is drawn, m: round, and such that neighbouring arrows rarely overlap."""
    return round_step(comparison.grid.step / attitude_scale_deg(fields))
