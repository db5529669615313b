"""Show causes of an arm's errors: each effect alone, errors that no joint motion removes, and drift within a day.

Everything here is computed from a comparison, on its field of poses or on its reaches. Units: SI.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import rerun as rr

from pickenv.arm import Array, Geometry, Plant, forward, joint_jacobian, load_plant, noncompensable_error
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.arm.files.urdf import write_urdf
from pickenv.arm.kinematics.forward import split_joints
from pickenv.arm.plant.campaign import alone, causes_of
from pickenv.base import stream
from pickenv.calibration import complete_model, start_filter
from pickenv.calibration.compensation.compensator import aimed, taught
from pickenv.inspect.colours import GREY, STEEL, Rgb, in_words, policy_colours
from pickenv.inspect.recordings.scribe import Scribe, f32
from pickenv.inspect.runs import comparison_summary as summary
from pickenv.inspect.runs.comparison_summary import GAIN
from pickenv.inspect.runs.recorded_episodes import Comparison
from pickenv.inspect.runs.run_folder import cut_away

# What a recording holds besides fields and reaches: effects, attitude, uncertainty, a day, the arms as URDF.


DAY_WORDS = "about_the_day"


def send_details(scribe: Scribe, comparison: Comparison, tabs: Mapping[str, ArrowTab], day: Day) -> None:
    """Send arrow fields, predicted uncertainty, the error curves of a day, and the arms exported as URDF.

    Args:
        scribe: Writer of the recording.
        comparison: The comparison.
        tabs: Fields of arrows by the tab's name, from `arrow_tabs`.
        day: Error curves of a day in the field, from `day_of`.
    """
    for unit, top, fields in tabs.values():
        for entity, (_, arrows, values) in fields.items():
            scribe.arrows(entity, comparison.grid.points, arrows, values, top, unit)
    for unit, top in {unit: top for unit, top, _ in tabs.values()}.items():
        scribe.colour_bar(f"legend/{LEGENDS[unit]}", top, unit)
    if comparison.field_uncertainty is not None:  # beside the last policy's actual errors, on one colour scale
        top, actual = summary.uncertainty_scale_mm(comparison), summary.field_mm(comparison.policies[-1])
        send_voxels(scribe, comparison, "world/uncertainty/predicted", 1e3 * comparison.field_uncertainty, top)
        send_voxels(scribe, comparison, "world/uncertainty/actual", actual, top)
        scribe.colour_bar("legend/uncertainty", top, "mm")
    if day:
        _send_day(scribe, comparison, day)
    if scribe.times:
        commands = comparison.policies[0].ends.joint_command
        _send_urdf(scribe, "urdf_nominal", comparison.nominal, commands, GREY, "majorwireframe")
        _send_urdf(scribe, "urdf_true", comparison.plant.geometry, commands, STEEL, "solid")


def send_voxels(scribe: Scribe, comparison: Comparison, entity: str, values: Array, top: float) -> None:
    """Send a field's values as voxels, without the voxels in the corner that would hide all others (`cut_away`).

    Args:
        scribe: Writer of the recording.
        comparison: The comparison, which has the field's grid.
        entity: Name of the field.
        values: Values at the points of the field ``(F,)``, in any unit.
        top: Upper end of the colour scale, in the same unit.
    """
    visible, grid = ~cut_away(comparison), comparison.grid
    index, means = summary.cell_means(grid.index[visible], values[visible])
    look: Any = {"value_range": [0.0, top], "colormap": "Viridis", "translation": grid.corner}
    cells = np.asarray(index, dtype=np.int32)
    scribe.still(entity, rr.VoxelGridMap(cells, [grid.step] * 3, values=f32(means), **look))


def _send_day(scribe: Scribe, comparison: Comparison, day: Day) -> None:
    """Send the mean and 95th percentile of errors over all fruit at each time of the day, and an explanation."""
    times = [*scribe.times, rr.TimeColumn("hours", duration=3600.0 * day_hours(comparison))]
    hours = Scribe(scribe.stream, times)
    for (key, (label, errors)), colour in zip(day.items(), policy_colours(list(day)), strict=True):
        curves = {"mean": (errors.mean(axis=1), 2.2), "p95": (np.percentile(errors, 95, axis=1), 1.0)}
        for name, (values, width) in curves.items():
            hours.curve(f"day/{name}_mm/{key}", f"{label}, {name}", colour, values, width)
    scribe.document(DAY_WORDS, day_in_words(comparison, day))


def _send_urdf(scribe: Scribe, name: str, geometry: Geometry, joints: Array, colour: Rgb, fill_mode: Any) -> None:
    """Send an arm as URDF, and its motion from reach to reach.

    Args:
        scribe: Writer of the recording, whose times are the reaches.
        name: Name of the arm.
        geometry: Geometry of the arm.
        joints: Joint command of each reach ``(R, n)``, rad or m.
        colour: Colour of the arm, RGB in 0..255.
        fill_mode: Rerun's fill mode, such as "solid".
    """
    with tempfile.TemporaryDirectory() as folder:
        tree = rr.urdf.UrdfTree.from_file_path(
            write_urdf(geometry, Path(folder) / f"{name}.urdf", name),
            entity_path_prefix=name,
            frame_prefix=f"{name}/",
            # Each arm its own: two arms with the default entity would overwrite one another's frames.
            static_transform_entity_path=f"{name}/tf_static",
        )
    tree.log_urdf_to_recording(scribe.stream)
    # Both arms are placed in the frame of the root entity, which rerun calls "tf#/".
    scribe.still(f"{name}/base", rr.Transform3D(parent_frame="tf#/", child_frame=f"{name}/base"))
    for link in dict.fromkeys(joint.parent_link for joint in tree.joints()):
        for entity in tree.get_visual_geometry_paths(link):
            scribe.still(entity, rr.Cylinders3D.from_fields(colors=[colour], fill_mode=fill_mode))
    moving = [joint for joint in tree.joints() if joint.joint_type != "fixed"]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*outside limits.*")  # by rounding; rerun then takes the limit
        for i, joint in enumerate(moving):
            scribe.along(f"{name}/joint{i + 1}", joint.compute_transform_columns(joints[:, i].tolist()))


NO_FIELD = 1e-9
"""Smallest displacement of the settled tool, m. The field of an effect is left out if it is smaller everywhere."""
FLOOR = "floor"
"""Key of the attitude error that no joint motion removes."""


ArrowTab: TypeAlias = tuple[str, float, Mapping[str, tuple[str, Array, Array]]]
"""Fields of arrows, side by side, as three values: the unit of the errors, mm or deg; the upper end of the colour scale
in this unit; and the fields, by entity. A field has a title, the arrows as drawn ``(F, 3)``, m, and the errors that the
arrows show ``(F, 3)``, in the unit."""
LEGENDS = {"mm": "position", "deg": "attitude"}
"""Keys of colour scales, by the scale's unit."""


def arrow_tabs(comparison: Comparison) -> dict[str, ArrowTab]:
    """Return the tabs that show fields of arrows, by the tab's name.

    The first tab has the error field of each policy. With several policies, it also has a difference of fields: the
    field of the last policy but one minus the field of the last policy. A second tab has the field of each effect
    alone. A third tab has the attitude errors, if they are known.
    """
    policies, top = comparison.policies, summary.colour_scale_mm(comparison)
    errors = {f"world/field/{p.key}/vectors": _titled(p.label, p.field_errors, "arrows ") for p in policies}
    if len(policies) > 1:
        removed = policies[-2].field_errors - policies[-1].field_errors
        errors["world/field/removed/vectors"] = _titled("removed by the last model", removed)
    effects = effect_fields(comparison)
    single = {f"world/effect/{name}": _titled(name.replace("_", " "), field) for name, field in effects.items()}
    tabs: dict[str, ArrowTab] = {f"Error fields, arrows ×{GAIN:g}": ("mm", top, errors)}
    if single:
        tabs["Effects, each alone"] = "mm", top, single
    attitude = attitude_fields(comparison)
    return tabs | {"Attitude": _attitude_tab(comparison, attitude)} if attitude else tabs


def _titled(label: str, field: Array, arrows: str = "") -> tuple[str, Array, Array]:
    """Return a field of an `ArrowTab` for position errors ``field`` ``(F, 3)``, m.

    The title has the ``label``, the mean error, and the factor on arrows. The text ``arrows`` precedes the factor.
    """
    mean, *_ = summary.error_spread(np.linalg.norm(1e3 * field, axis=-1))
    return f"{label} | mean {mean:.2f} mm | {arrows}×{GAIN:g}", GAIN * field, 1e3 * field


def _attitude_tab(comparison: Comparison, attitude: Mapping[str, Array]) -> ArrowTab:
    labels = {policy.key: f"{policy.label} attitude" for policy in comparison.policies}
    labels[FLOOR] = "No joint motion removes"
    top = summary.scale_end(np.degrees(np.linalg.norm(next(iter(attitude.values())), axis=-1)))
    length = summary.round_step(comparison.grid.step / top)  # m per degree, so that neighbours rarely overlap
    views = {}
    for key, field in attitude.items():
        mean, *_ = summary.error_spread(np.degrees(np.linalg.norm(field, axis=-1)))
        title, degrees = f"{labels[key]} | mean {mean:.3f}° | {1e3 * length:g} mm per degree", np.degrees(field)
        views[f"world/attitude/{key}"] = title, length * degrees, degrees
    return "deg", top, views


def effect_fields(comparison: Comparison) -> dict[str, Array]:
    """Return the position error field ``(F, 3)``, m, of each cause alone on the nominal arm, by the cause's name.

    Causes are each active effect of the true arm, and its true geometry. The fields are for the steady state: the
    tool is settled, the arm warm and the machine sunk. Effects that vanish in the steady state have no field.
    """
    plant, joints = comparison.plant, comparison.grid.joints
    nominal = forward(comparison.nominal, joints).position
    fields = {name: alone(plant, name).tool_pose(joints).position - nominal for name in causes_of(plant)}
    return {name: field for name, field in fields.items() if np.abs(field).max(initial=0.0) > NO_FIELD}


def attitude_fields(comparison: Comparison) -> dict[str, Array]:
    """Return fields of attitude errors ``(F, 3)``, rotation vectors, rad; an empty dictionary if attitudes are unknown.

    The key of the first policy has this policy's errors, and so has the key of the last policy. The key `FLOOR` has the
    part of the last policy's errors that no joint motion removes.
    """
    first, last = comparison.policies[0], comparison.policies[-1]
    if first.field_attitude is None or last.field_attitude is None:
        return {}
    error = np.concatenate([last.field_errors, last.field_attitude], axis=1)
    floor = noncompensable_error(comparison.plant.geometry, comparison.grid.joints, error)[..., 3:]
    return {first.key: first.field_attitude, last.key: last.field_attitude, FLOOR: floor}


# A day in the field: the arm warms up, the machine tilts and sinks, and the morning's calibration knows of neither.
# Every policy gives the commands that it gave on firm ground. Beside the last one stands what a Kalman filter makes of
# it that looks at the tool once per pick: what a machine has to do that wants to keep its accuracy.


DRIFTS = ("thermal_growth", "base_tilt")
DRIFTING_PLANT = "orchard"
"""Name of the preset plant (simulated true arm) whose drift is used if the comparison's own plant does not drift."""
DAY_HOURS = 8.0
CAMERA_STD = 1e-3
"""Standard deviation of a camera's measurement of the tool position, per axis, m."""
LOOK = MeasurementNoise(float(np.hypot(CAMERA_STD, 0.5e-3)), 0.0)
"""Measurement noise that the Kalman filter assumes: the camera's noise, and 0.5 mm for errors that geometry cannot
explain."""
PRIOR, WALK = 0.2, 0.3
"""Assumptions of the Kalman filter about each parameter of the arm, in units of the parameter's tolerance. The first is
the standard deviation after calibration. The second is the random walk per square root of an hour."""
FILTERED = 10
"""Largest number of machines with a Kalman filter, which takes more time than the other parts of a recording."""
FEWEST_LOOKS = 10
"""Smallest number of reaches with a Kalman filter, which needs measurements at different joint values."""


ADAPTED = "adapted"
"""Key of the error curve of the machines with a Kalman filter."""


Day: TypeAlias = Mapping[str, tuple[str, Array]]
"""Labels and position errors, mm, of the same reaches over a day, while the arm warms up and the machine tilts and
sinks. The key of a policy has the errors of every reach at every time ``(R times, R reaches)``. If there are enough
reaches, the key `ADAPTED` has the errors of the last policy with commands that a filter corrects ``(R times, M
machines)``. Each machine begins with another reach."""


def day_hours(comparison: Comparison) -> Array:
    """Return the time of each reach since the machine was switched on ``(R,)``, h."""
    count = len(comparison.fruit)
    return (np.arange(count) + 1.0) * DAY_HOURS / count


def day_in_words(comparison: Comparison, day: Day) -> str:
    """Return an explanation of the curves of `day_of`, in Markdown, with their mean errors."""
    plant = drifting_plant(comparison.plant)
    assert plant is not None
    rows = [f"| {label} | {errors.mean():.2f} |" for label, errors in day.values()]
    policies = [line for key, line in day.items() if key != ADAPTED]
    (first, first_mm), (last, last_mm) = policies[0], policies[-1]
    before, after = float(first_mm.mean()), float(last_mm.mean())
    parts = [
        f"# {DAY_HOURS:g} hours without a new calibration",
        "The arm was calibrated cold and on firm ground. Then it warms up, and the machine tilts and sinks as in "
        f"{in_words(plant.name)}. Each policy repeats the commands that it gave in the morning, without looking.",
        "\n".join(["| policy | mean of the day (mm) |", "|---|---|", *rows]),
    ]
    if len(policies) > 1:
        worth = "no better than" if after >= before else f"{before - after:.2f} mm better than"
        parts.append(
            f"{last} ends {worth} {first}: the drift was in nobody's data, and it is larger than "
            "the errors that a calibration takes away."
        )
    if ADAPTED in day:
        label, adapted_mm = day[ADAPTED]
        parts.append(
            f"**{label}**: the same commands on {adapted_mm.shape[1]} machines with a Kalman "
            f"filter. It looks at the tool once per pick ({1e3 * CAMERA_STD:g} mm per axis) and corrects the next "
            "pick: in the field a calibration has to go on."
        )
    return "\n\n".join(parts)


def drifting_plant(plant: Plant) -> Plant | None:
    """Return the plant (simulated true arm), with the drift of the preset `orchard` if it has no drift of its own.

    Return None if the plant has no drift and the preset `orchard` is for another arm.
    """
    if any(plant.effect(name) is not None for name in DRIFTS):
        return plant
    preset = load_plant(DRIFTING_PLANT)
    if plant.arm.fingerprint() != preset.arm.fingerprint():
        return None
    drifting = plant.with_effect(*(preset.effect(name) for name in DRIFTS))
    return replace(drifting, name=preset.name, load=plant.load or preset.load)


def day_of(comparison: Comparison) -> Day:
    """Simulate the reaches of a comparison over a day, with the policies' commands, on the plant of `drifting_plant`.

    R machines start together, each at a different one of the R fruit. All machines go through the fruit in the same
    order. At every time, each fruit is thus reached by one machine, and all machines have been equally busy. The result
    has each policy's label and errors ``(R, R)``, mm, by time and fruit, under the policy's key. The key `ADAPTED` has
    the errors of `_adapted`. Without reaches or drift the result is empty.
    """
    plant, count = drifting_plant(comparison.plant), len(comparison.fruit)
    if plant is None or not count:
        return {}
    dt = 3600.0 * DAY_HOURS / count
    lines, machines = {}, np.arange(count)
    for policy in comparison.policies:
        rows, commands = np.empty((count, count)), policy.ends.joint_command
        state = plant.initial_state(np, split_joints(plant.geometry.joints, commands))
        for k in range(count):
            turn = (machines + k) % count
            state, tool = _driven(plant, state, commands[turn], dt)
            rows[k, turn] = 1e3 * np.linalg.norm(tool - comparison.fruit[turn], axis=-1)
        lines[policy.key] = policy.label, rows
    if count >= FEWEST_LOOKS:
        lines[ADAPTED] = f"{comparison.policies[-1].label}, adapted", _adapted(comparison, plant, dt)
    return lines


def _driven(plant: Plant, state: Any, joints: Array, dt: float) -> tuple[Any, Array]:
    """Return the states of M machines after one pick, and their tool positions ``(M, 3)``, m.

    Args:
        plant: The machines' plant (simulated true arm).
        state: States of the machines before the pick.
        joints: Joint commands of the machines ``(M, n)``, rad or m.
        dt: Duration of the pick, s.
    """
    state, frame = plant.advance(np, state, split_joints(plant.geometry.joints, joints), dt)
    return state, np.stack(np.broadcast_arrays(*frame[9:12]), axis=-1)


def _adapted(comparison: Comparison, plant: Plant, dt: float) -> Array:
    """Return the position errors ``(R, M)``, mm, of M machines whose filters correct the last policy's commands.

    Each machine has a Kalman filter of the arm's parameters, which learns after each of R picks. Picks are ``dt``
    seconds apart. The filter treats the true arm and the policy's corrections of commands as one arm. At first the
    filter assumes that this is the nominal arm, as `AdaptiveReach` does behind a compensator. The filter corrects the
    joint values at which the nominal tool is at the fruit. This correction is added to the policy's command.
    """
    nominal, count = comparison.nominal, len(comparison.fruit)
    commands = comparison.policies[-1].ends.joint_command
    intended = joints_at(nominal, commands, comparison.fruit)
    starts = np.unique(np.linspace(0, count, FILTERED, endpoint=False).astype(np.int64))
    filters = [start_filter(complete_model(nominal), nominal, intended, full_pose=False, prior=PRIOR)] * len(starts)
    rng = np.random.default_rng(stream(comparison.seed, "day"))
    state = plant.initial_state(np, split_joints(nominal.joints, commands[starts]))
    errors = np.empty((count, len(starts)))
    for k in range(count):
        turn = (starts + k) % count
        joints = aimed(nominal, filters, intended[turn])
        command = np.clip(commands[turn] + joints - intended[turn], nominal.lower, nominal.upper)
        state, tool = _driven(plant, state, command, dt)
        errors[k] = 1e3 * np.linalg.norm(tool - comparison.fruit[turn], axis=-1)
        looks = tool + CAMERA_STD * rng.standard_normal(tool.shape)
        filters = taught(filters, joints, looks, LOOK, WALK, dt)
    return errors


def joints_at(geometry: Geometry, joints: Array, points: Array) -> Array:
    """Improve joint values by two Newton steps, and return values ``(N, n)`` that bring the tool to ``points``.

    If the tool starts some millimetres from its point, two steps reduce the distance to nanometres.

    Args:
        geometry: Geometry of the arm.
        joints: Joint values to start from ``(N, n)``, rad or m.
        points: Wanted tool positions ``(N, 3)``, m.
    """
    for _ in range(2):
        gap = points - forward(geometry, joints).position
        inverse = np.linalg.pinv(joint_jacobian(geometry, joints)[:, :3])
        joints = joints + np.einsum("nij,nj->ni", inverse, gap)
    return joints
