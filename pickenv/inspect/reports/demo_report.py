"""Page of a demonstration: errors removed and remaining, whether the calibration suffices, and the evidence."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, noncompensable_error
from pickenv.base import InputError, command_line, mean_interval, share_interval
from pickenv.calibration import Calibration
from pickenv.calibration.assessment.quality import axis_errors
from pickenv.calibration.assessment.screen import LEAST_ROWS, error_statistics
from pickenv.inspect.colours import TEXTS, between, in_words, named_values, policy_colours, said, viridis
from pickenv.inspect.figures.plot_errors import field_gain, thinned
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, comparison_drawings, norms_mm, trace_drawings
from pickenv.inspect.reports.report_page import HERE, PageTable, PageVerdict, Section, axis_table, html_of
from pickenv.inspect.runs import comparison_summary as summary
from pickenv.inspect.runs.comparison_summary import Change, gripped
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedPolicy
from pickenv.inspect.runs.run_folder import MATTERS_FILE, Run, TakePicture, eye_direction, load_part, load_result
from pickenv.inspect.runs.traces import CalibrationTrace

RECORDING = "errors.rrd"
OF_ONE = "All of it is of this one calibration of one arm: intervals are over fruit, and another calibration differs."

NO_INTERVAL = f"no interval: fewer than {LEAST_ROWS} reaches, or all alike"

REQUIRED_SHARE = 0.95
"""Share of reaches within the tolerance from which a calibration counts as sufficient."""

EYE_DISTANCE = 2.55
"""Distance of the camera from the middle of a scene, in plotly's unit: the scene's size."""

LOOKS: Mapping[str, Any] = tomllib.loads((HERE / "plotly.toml").read_text("utf-8"))
"""Plotly's settings for interactive figures: ``shafts``, ``dots`` and ``colour_bar`` of fields, layout of ``poses``."""


def drawings(run: Run) -> Drawings:
    """Return the figures of a demonstration's run."""
    return [*comparison_drawings(load_part(run, Comparison)), *trace_drawings(load_part(run, CalibrationTrace))]


def page(run: Run, picture: TakePicture | None = None) -> str:
    """Return the page of a demonstration's run as HTML.

    Args:
        run: The run.
        picture: Function that draws the recording for the page; no picture is shown when None.

    Raises:
        InputError: If a file of the run is missing or damaged.
    """
    comparison, trace = load_part(run, Comparison), load_part(run, CalibrationTrace)
    cases = load_result(run, MATTERS_FILE) if (run.folder / MATTERS_FILE).is_file() else {}
    if not len(comparison.fruit):
        raise InputError(f"{run.folder} holds no reaches, and a report is about reaches; `{run.made_by}` makes some")
    calibration = Calibration.load(run.folder / "calibration", comparison.plant.arm)
    every = [*comparison_drawings(comparison), *trace_drawings(trace)]
    by_name = {drawing.name: drawing for drawing in every if drawing.draw is not None}
    recording = run.folder / RECORDING  # without its picture the section is left out: the origin says how to open it
    shown = picture(recording) if picture and recording.is_file() else None
    sections = (
        _reaches(comparison, by_name),
        _cases(cases),
        _field(comparison, by_name),
        _poses(comparison, trace, by_name),
        _fit(trace, calibration, by_name),
        Section("The recording", [shown], TEXTS["explained"]["recording"]),
    )
    return html_of(
        f"Calibration and picking: {in_words(comparison.plant.name)}",
        f"Simulated arm; the same scripted policy reaches for {len(comparison.fruit)} fruit, raw and calibrated; "
        f"seed {comparison.seed}" + "; a quick run, worse than the paper's protocol" * ("quick" in run.command),
        demo_verdict(comparison, cases),
        sections,
        _origin(run, comparison, trace, calibration),
        _tiles(comparison, trace),
        contents=True,
    )


def demo_verdict(comparison: Comparison, cases: Mapping[str, Sequence[Change]] | None = None) -> PageVerdict:
    """Return the verdict: how much smaller the last policy's errors are than the first policy's, and changes of picks.

    Args:
        comparison: The comparison with its reaches.
        cases: Changes of picks by calibration, by the name of the plant (simulated arm). When left out, they are
            computed for the comparison's own plant.
    """
    first, last = comparison.policies[0], comparison.policies[-1]
    first_mm, last_mm = first.ends.position_error_mm, last.ends.position_error_mm
    before, after, gain = error_statistics(first_mm), error_statistics(last_mm), first_mm - last_mm
    ends = mean_interval(gain, LEAST_ROWS)
    picked, total = within(comparison, last), len(last_mm)
    least, most = share_interval(picked, total)
    tolerance = f"a tolerance of {comparison.tolerance_mm:g} mm"
    if least >= REQUIRED_SHARE:
        tone, headline = "good", f"The calibrated arm suffices for {tolerance}"
    elif most >= REQUIRED_SHARE:
        tone, headline = "care", f"The calibrated arm may suffice for {tolerance}: too few reaches to tell"
    else:
        tone, headline = "bad", f"The calibrated arm does not suffice for {tolerance}"
    if (gain.mean() if ends is None else ends[0]) > 0.0:
        interval = NO_INTERVAL if ends is None else f"95 % interval {between(*ends, 2)}"
        removed = (
            f"This one calibration removes {gain.mean():.2f} mm ({interval}) of a mean position error of "
            f"{before.mean:.2f} mm: {100 * gain.mean() / before.mean:.0f} %."
        )
    else:
        interval = NO_INTERVAL if ends is None else f"95 % interval {between(-ends[1], -ends[0], 2, '+')}"
        removed = (
            f"This one calibration does not lower the mean position error of {before.mean:.2f} mm: it changes by "
            f"{-gain.mean():+.2f} mm ({interval})."
        )
    lateral = [lateral_mm for lateral_mm, _ in gripped(comparison).values()]
    changed = cases or {comparison.plant.name: summary.pick_changes(lateral[0], lateral[-1])}
    worth = in_words(" ".join(summary.matters(in_words(name), changes) for name, changes in changed.items()))
    mean = said(after.mean, after.mean_ci95, 2)
    text = (
        f"{removed} {worth}\nWhat remains is {mean} mm in the mean and at most {after.max:.2f} mm. {picked} of "
        f"{total} simulated reaches end within {comparison.tolerance_mm:g} mm of the fruit (95 % interval "
        f"{100 * least:.0f} to {100 * most:.0f} %, required are {100 * REQUIRED_SHARE:.0f} %), "
        f"{within(comparison, first)} without calibration. {OF_ONE}"
    )
    return PageVerdict(tone, headline, text)


def _cases(cases: Mapping[str, Sequence[Change]]) -> Section:
    """Return the section on picks without and with calibration, by plant, gripper and perception error.

    ``cases`` has, for each plant by name, the changes of picks from `pick_changes`.
    """
    rows = [
        (f"{in_words(plant)}, {gripper}", *cells)
        for plant, changes in cases.items()
        for gripper, *cells in map(summary.change_cells, changes)
    ]
    heads = ("arm, gripper", "fruit seen to, per axis (mm)", "taken, raw (%)", "calibrated (%)", "change (points)")
    caption = "Share of fruit that a gripper takes, by how well the fruit is seen (standard deviation)"
    parts = [Section(caption, [PageTable(caption, heads, rows).spelled()])] if rows else ()
    return Section("Does it matter?", parts, TEXTS["explained"]["matters"])


def within(comparison: Comparison, policy: RecordedPolicy) -> int:
    """Return the number of a policy's reaches that end within the gripper's tolerance of the fruit, at any attitude."""
    return int((policy.ends.position_error_mm <= comparison.tolerance_mm).sum())


def _tiles(comparison: Comparison, trace: CalibrationTrace) -> dict[str, str]:
    first, last = (error_statistics(comparison.policies[i].ends.position_error_mm) for i in (0, -1))
    held_out = [error_statistics(values) for values in norms_mm(trace.errors).values()]
    return {
        "mean position error of the reaches, raw → calibrated": f"{first.mean:.2f} → {last.mean:.2f} mm",
        "95 of 100 reaches are better than this": f"{last.p95:.2f} mm",
        "mean error at held-out poses, raw → calibrated": f"{held_out[0].mean:.2f} → {held_out[-1].mean:.2f} mm",
        "parameters could be identified": f"{int(trace.kept.sum())} of {len(trace.kept)}",
    }


def _reaches(comparison: Comparison, drawn: Mapping[str, Drawing]) -> Section:
    chances = {label: success for label, (_, success) in gripped(comparison).items()}
    grippers = list(next(iter(chances.values())))
    heads = ["policy", f"within {comparison.tolerance_mm:g} mm (%)", *(f"taken by {name} (%)" for name in grippers)]
    heads += ["position, mean (mm)", "RMS (mm)", "p95 (mm)", "max (mm)", "attitude, mean (deg)"]
    rows = []
    for policy in comparison.policies:
        ends = policy.ends
        position, attitude = map(error_statistics, (ends.position_error_mm, ends.attitude_error_deg))
        total, taken = len(policy.moments), (float(chances[policy.label][name].sum()) for name in grippers)
        cells = [
            said(count / total, share_interval(count, total), 0, 100.0)
            for count in (within(comparison, policy), *taken)
        ]
        cells.append(said(position.mean, position.mean_ci95, 3))
        cells += [f"{value:.3f}" for value in (position.rms, position.p95, position.max)]
        cells.append(said(attitude.mean, attitude.mean_ci95, 3))
        rows.append([policy.label, *cells])
    some = "in brackets 95 % intervals over fruit" if len(comparison.fruit) >= LEAST_ROWS else NO_INTERVAL
    caption = f"Final errors of the reaches; {some}. {OF_ONE}"
    beside = drawn["position_error_by_policy"], drawn["reach_errors_cumulative"]
    parts = (PageTable(caption, heads, rows, "close").spelled(), beside, drawn["success_against_misalignment"])
    return Section("Reaches, by policy", parts, TEXTS["explained"]["reaches"])


def _field(comparison: Comparison, drawn: Mapping[str, Drawing]) -> Section:
    if "error_fields" not in drawn:
        return Section("Where the tool misses", ())
    fields = replace(drawn["error_fields"], spec=field_spec(comparison), hint=TEXTS["hints"]["error_fields"])
    size = f"{len(comparison.grid.points)} positions {comparison.grid.step * 1e3:g} mm apart, tool upright."
    return Section("Where the tool misses", [fields], size)


def _poses(comparison: Comparison, trace: CalibrationTrace, drawn: Mapping[str, Drawing]) -> Section:
    stages = {label: axis_errors(errors) for label, errors in trace.errors.items()}
    caption = "Errors per degree of freedom at the held-out poses, world axes"
    hint, poses = TEXTS["hints"]["error_per_test_pose"], drawn["error_per_test_pose"]
    parts = (
        axis_table(caption, stages, "{:.3f}".format).spelled(),
        in_words(_floors(comparison, trace)) if all(errors.shape[1] == 6 for errors in trace.errors.values()) else "",
        replace(poses, spec=pose_spec(norms_mm(trace.errors)), hint=hint),
        (drawn["error_histogram"], drawn["error_against_extension"]),
    )
    size = f"{len(trace.sets['test'])} poses from the whole joint ranges that took no part in the calibration."
    return Section("Held-out poses", parts, size)


def _floors(comparison: Comparison, trace: CalibrationTrace) -> str:
    """Return a sentence: the mean attitude error of raw arm and models, and the part that no joint motion removes."""
    geometry, joints = comparison.plant.geometry, trace.sets["test"]

    def degrees(errors: Array) -> float:
        return float(np.degrees(np.linalg.norm(errors[:, 3:], axis=1)).mean())

    parts = "; ".join(
        f"{label} {degrees(errors):.3f}°, of which {degrees(noncompensable_error(geometry, joints, errors)):.3f}°"
        for label, errors in trace.errors.items()
    )
    return f"Mean attitude error, and the part that no motion of {geometry.joints} joints removes on this arm: {parts}."


def _fit(trace: CalibrationTrace, calibration: Calibration, drawn: Mapping[str, Drawing]) -> Section:
    dropped = ", ".join(name for name, identified in zip(trace.names, trace.kept, strict=True) if not identified)
    condition = trace.singular_values[0] / trace.singular_values[-1]
    poses = len(next(iter(trace.sets.values())))
    kind = "" if calibration.learnt is None else f", then {in_words(calibration.learnt.kind)} on what remains"
    text = (
        f"Least squares on {poses} poses{kind}. {int(trace.kept.sum())} of {len(trace.kept)} parameters can "
        f"be told apart (condition number {condition:.1f}). These stay at their nominal values, because others "
        f"absorb them: {dropped or 'none'}."
    )
    names = ("least_squares_convergence", "parameter_spectrum", "network_convergence", "joint_coverage")
    return Section("How the calibration was found", (text, *map(drawn.get, names)))


def _origin(run: Run, comparison: Comparison, trace: CalibrationTrace, calibration: Calibration) -> dict[str, str]:
    plant = comparison.plant
    effects = ", ".join(name.replace("_", " ") for name in plant.names)
    return {
        "Reproduce": run.command,
        "Seed": str(run.seed),
        "Versions": named_values({**run.versions, **calibration.record.get("versions", {})}),
        "Arm": f"{plant.arm.name}, nominal geometry {plant.arm.fingerprint()}. {plant.arm.source}",
        "Simulated true arm": f"{plant.name}: {effects or 'true geometry alone'}",
        "Poses": named_values(trace.fingerprints),
        "Recording": f"{RECORDING}, which `{command_line('pickenv', 'inspect', run.folder.name)}` opens",
        "Calibration": f"calibration.npz, {Path(str(calibration.record['source'])).name}",
        "Kind of numbers": "simulated throughout; nothing here was measured on a machine",
    }


def field_spec(comparison: Comparison) -> dict[str, Any]:
    """Return Plotly's data and layout of the error fields, side by side in 3D.

    Dots are at wanted positions and show numbers on hovering. From each dot a line leads towards the true position,
    drawn longer than true by the factor `field_gain`.
    """
    rows, spacing = thinned(comparison, most=3000)
    top = summary.colour_scale_mm(comparison)
    gain = field_gain(comparison.grid.step, top)
    points = comparison.grid.points[rows]
    scale = {"colorscale": [[i / 16, _css(viridis(i / 16))] for i in range(17)], "cmin": 0.0, "cmax": round(top, 4)}
    eye = _numbers(EYE_DISTANCE * eye_direction(comparison))
    axes = _axes(points, spacing) | {"camera": {"eye": dict(zip("xyz", eye, strict=True))}}
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"annotations": [], "margin": {"l": 0, "r": 0, "t": 28, "b": 80}, "showlegend": False}
    for i, policy in enumerate(comparison.policies, start=1):
        scene = "scene" if i == 1 else f"scene{i}"
        shaft, end = _arrows(points, policy.field_errors[rows], gain, scale)
        end["marker"]["showscale"] = i == 1
        data += [shaft | {"scene": scene}, end | {"scene": scene, "name": in_words(policy.label)}]
        layout[scene] = axes
        mean, *_, largest = summary.error_spread(summary.field_mm(policy))
        title = f"<b>{escape(in_words(policy.label))}</b><br>×{gain:g}: mean {mean:.2f}, max {largest:.2f} mm"
        layout["annotations"].append({"text": title})
    return {"data": data, "layout": layout}


def _arrows(points: Array, errors: Array, gain: float, scale: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return two Plotly traces, coloured by true error, mm: lines of the errors, and dots at wanted positions.

    Args:
        points: Wanted positions ``(N, 3)``, m.
        errors: True minus wanted positions ``(N, 3)``, m.
        gain: Factor by which lines are drawn longer than true.
        scale: Plotly's colour scale.
    """
    tips, length = points + gain * errors, np.linalg.norm(errors, axis=1) * 1e3
    shafts = np.stack([points, tips, np.full_like(tips, np.nan)], axis=1).reshape(-1, 3)
    line = scale | {"color": _numbers(np.repeat(length, 3)), "width": 4}
    marker = scale | {"color": _numbers(length), "size": 2.6, "colorbar": LOOKS["colour_bar"]}
    hover = np.round(np.column_stack([length, errors * 1e3, points]), 4).tolist()
    dots = _coordinates(points) | LOOKS["dots"] | {"marker": marker, "customdata": hover}
    return _coordinates(shafts) | LOOKS["shafts"] | {"line": line}, dots


def _axes(points: Array, spacing: float) -> dict[str, Any]:
    """Return Plotly's axes, m, that all scenes share: the range of points ``(N, 3)``, and ``spacing``, m, around it."""
    low, high = points.min(axis=0) - spacing, points.max(axis=0) + spacing
    small = {"tickfont": {"size": 10}, "dtick": summary.round_step(float((high - low).max()) / 6.0)}
    axes = {
        f"{axis}axis": small | {"title": {"text": f"{axis} (m)", "font": {"size": 11}}, "range": ends}
        for axis, ends in zip("xyz", np.column_stack([low, high]).tolist(), strict=True)
    }
    return axes | {"aspectmode": "data"}


def pose_spec(errors_mm: Mapping[str, Array]) -> dict[str, Any]:
    """Return Plotly's data and layout of the position errors at the test poses, on a logarithmic axis.

    ``errors_mm`` has the errors ``(M,)``, mm, of the raw arm and of each model, by label.
    """
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": in_words(f"{label}: mean {values.mean():.2f} mm"),
            "x": list(range(1, len(values) + 1)),
            "y": _numbers(values),
            "marker": {"size": 5, "color": _css(colour)},
            "hovertemplate": "pose %{x}: <b>%{y:.3f} mm</b><extra>" + escape(in_words(label)) + "</extra>",
        }
        for (label, values), colour in zip(errors_mm.items(), policy_colours(list(errors_mm)), strict=True)
    ]
    return {"data": data, "layout": LOOKS["poses"]}


def _coordinates(points: Array) -> dict[str, Any]:
    return {axis: _numbers(points[:, i]) for i, axis in enumerate("xyz")}


def _numbers(values: Array) -> list[float | None]:
    """Return numbers rounded to four decimals; NaN becomes None, which Plotly draws as a gap."""
    return [None if np.isnan(value) else round(float(value), 4) for value in values]


def _css(colour: Sequence[int] | NDArray[np.uint8]) -> str:
    return "rgb({},{},{})".format(*colour)
