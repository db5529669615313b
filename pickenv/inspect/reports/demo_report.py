"""The report of a demonstration: what the calibration removed, what remains, whether it suffices; then the evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pickenv.arm import Array, noncompensable_error
from pickenv.base import InputError, mean_interval, share_interval
from pickenv.calibration import Calibration
from pickenv.calibration.assessment.metrics import LEAST_ROWS, ErrorStatistics, error_statistics
from pickenv.calibration.assessment.quality import axis_errors
from pickenv.inspect.figures.plot_calibration import joint_ranges
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, comparison_drawings, norms_mm, trace_drawings
from pickenv.inspect.reports import report_page
from pickenv.inspect.reports.report_interactive import field_spec, pose_spec
from pickenv.inspect.reports.report_words import between, estimated, named_values, percent
from pickenv.inspect.runs.calibration_trace import CalibrationTrace
from pickenv.inspect.runs.matters import PickChange, change_cells, gripped, matters, pick_changes
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedPolicy
from pickenv.inspect.runs.run_folder import Run, TakePicture, load_cases, load_part

RECORDING = "errors.rrd"
OF_ONE = "All of it is of this one calibration of one arm: intervals are over fruit, and another calibration differs."

NO_INTERVAL = f"no interval: fewer than {LEAST_ROWS} reaches, or all alike"

REQUIRED_SHARE = 0.95
"""Share of reaches within the tolerance for which a calibration counts as sufficient."""


def drawings(run: Run) -> Drawings:
    """The figures of a demonstration's run folder."""
    return [*comparison_drawings(load_part(run, Comparison)), *trace_drawings(load_part(run, CalibrationTrace))]


def page(run: Run, picture: TakePicture | None = None) -> str:
    """The page of a demonstration's run folder.

    Args:
        run: The run.
        picture: Takes a picture of the recording, which is then shown.

    Raises:
        InputError: If a file of the run is missing or damaged.
    """
    comparison, trace = load_part(run, Comparison), load_part(run, CalibrationTrace)
    cases = {name: [PickChange(**change) for change in case] for name, case in load_cases(run).items()}
    if not len(comparison.fruit):
        raise InputError(f"{run.folder} holds no reaches, and a report is about reaches; `{run.made_by}` makes some")
    calibration = Calibration.load(run.folder / "calibration", comparison.plant.arm)
    every = [*comparison_drawings(comparison), *trace_drawings(trace)]
    by_name = {drawing.name: drawing for drawing in every if isinstance(drawing, Drawing)}
    recording = run.folder / RECORDING
    sections = (
        _reaches(comparison, by_name),
        _cases(cases),
        _field(comparison, by_name),
        _poses(comparison, trace, by_name),
        _fit(trace, calibration, by_name),
        _recording(picture(recording) if picture and recording.is_file() else None),
    )
    return report_page.html_of(
        report_page.Page(
            f"Calibration and picking: {comparison.plant.name}",
            f"Simulated arm; the same scripted policy reaches for {len(comparison.fruit)} fruit, raw and calibrated; "
            f"seed {comparison.seed}" + "; a quick run, worse than the paper's protocol" * ("quick" in run.command),
            demo_verdict(comparison, cases),
            sections,
            _origin(run, comparison, trace, calibration),
            _tiles(comparison, trace),
            contents=True,
        )
    )


def demo_verdict(
    comparison: Comparison, cases: Mapping[str, Sequence[PickChange]] | None = None
) -> report_page.PageVerdict:
    """The worth of the last policy's calibration against the first, and whether that changes picks.

    Args:
        comparison: The reaches.
        cases: What calibration does to picks on each plant; on the comparison's own where left out.
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
    lateral = [grip.lateral_mm for grip in gripped(comparison).values()]
    changed = cases or {comparison.plant.name: pick_changes(lateral[0], lateral[-1])}
    worth = " ".join(matters(name, changes) for name, changes in changed.items())
    return report_page.PageVerdict(
        tone,
        headline,
        f"{removed} {worth}\nWhat remains is {_mean(after)} mm in the mean and at most {after.max:.2f} mm. {picked} of "
        f"{total} simulated reaches end within {comparison.tolerance_mm:g} mm of the fruit (95 % interval "
        f"{100 * least:.0f} to {100 * most:.0f} %, required are {100 * REQUIRED_SHARE:.0f} %), "
        f"{within(comparison, first)} without calibration. {OF_ONE}",
    )


def _cases(cases: Mapping[str, Sequence[PickChange]]) -> report_page.Section:
    """Picks without and with calibration, by plant, gripper and perception error."""
    rows = [
        (f"{plant}, {cells[0]}", *cells[1:]) for plant, changes in cases.items() for cells in map(change_cells, changes)
    ]
    heads = ("arm, gripper", "fruit seen to, per axis (mm)", "taken, raw (%)", "calibrated (%)", "change (points)")
    caption = "Share of fruit that a gripper takes, by how well the fruit is seen (standard deviation)"
    return report_page.Section(
        "Does it matter?",
        [report_page.Folded(caption, [report_page.PageTable(caption, heads, rows)])] if rows else (),
        "Each arm's own error across the tool, with an error of perception beside it; the gripper's curve says what is "
        "taken.",
    )


def within(comparison: Comparison, policy: RecordedPolicy) -> int:
    """Number of reaches that end within the tolerance of the fruit, whatever their attitude."""
    return int((policy.ends.position_error_mm <= comparison.tolerance_mm).sum())


def _share(comparison: Comparison, policy: RecordedPolicy) -> str:
    picked, total = within(comparison, policy), len(policy.moments)
    return percent(picked / total, *share_interval(picked, total))


def _expected(chances: Array) -> str:
    """The share of fruit ``(R,)`` that a gripper takes, each with its chance."""
    return percent(float(chances.mean()), *share_interval(float(chances.sum()), len(chances)))


def _mean(statistics: ErrorStatistics, digits: int = 2) -> str:
    low, high = statistics.mean_ci95 or (None, None)
    return estimated(statistics.mean, low, high, digits)


def _tiles(comparison: Comparison, trace: CalibrationTrace) -> dict[str, str]:
    first, last = (
        error_statistics(p.ends.position_error_mm) for p in (comparison.policies[0], comparison.policies[-1])
    )
    held_out = [error_statistics(values) for values in norms_mm(trace.errors).values()]
    return {
        "mean position error of the reaches, raw → calibrated": f"{first.mean:.2f} → {last.mean:.2f} mm",
        "95 of 100 reaches are better than this": f"{last.p95:.2f} mm",
        "mean error at held-out poses, raw → calibrated": f"{held_out[0].mean:.2f} → {held_out[-1].mean:.2f} mm",
        "parameters could be identified": f"{int(trace.kept.sum())} of {len(trace.kept)}",
    }


def _reaches(comparison: Comparison, drawn: Mapping[str, Drawing]) -> report_page.Section:
    grips = gripped(comparison)
    grippers = list(next(iter(grips.values())).success)
    heads = ["policy", f"within {comparison.tolerance_mm:g} mm (%)", *(f"taken by {name} (%)" for name in grippers)]
    heads += ["position, mean (mm)", "RMS (mm)", "p95 (mm)", "max (mm)", "attitude, mean (deg)"]
    rows = []
    for policy in comparison.policies:
        position, attitude = (
            error_statistics(policy.ends.position_error_mm),
            error_statistics(policy.ends.attitude_error_deg),
        )
        shares = [_share(comparison, policy), *(_expected(grips[policy.label].success[name]) for name in grippers)]
        cells = [share.replace(" %", "") for share in shares]
        cells += [_mean(position, 3), *(f"{value:.3f}" for value in (position.rms, position.p95, position.max))]
        cells += [_mean(attitude, 3)]
        rows.append([policy.label, *cells])
    some = "in brackets 95 % intervals over fruit" if len(comparison.fruit) >= LEAST_ROWS else NO_INTERVAL
    caption = f"Final errors of the reaches; {some}. {OF_ONE}"
    return report_page.Section(
        "Reaches, by policy",
        (
            report_page.PageTable(caption, heads, rows),
            report_page.Pair((drawn["position_error_by_policy"], drawn["reach_errors_cumulative"])),
            drawn["success_against_misalignment"],
        ),
        "Distance of the true tool from the fruit at the end of each reach. Accuracy must not be oversold: a "
        "compliant hand forgives centimetres, a rigid cup millimetres.",
    )


def _field(comparison: Comparison, drawn: Mapping[str, Drawing]) -> report_page.Section:
    if "error_fields" not in drawn:
        return report_page.Section("Where the tool misses", ())
    hint = "Drag to turn all scenes together, hover over the end of an arrow to read its millimetres."
    return report_page.Section(
        "Where the tool misses",
        [report_page.Interactive(drawn["error_fields"], field_spec(comparison), hint)],
        f"{len(comparison.grid.points)} positions {comparison.grid.step * 1e3:g} mm apart, tool upright.",
    )


def _poses(comparison: Comparison, trace: CalibrationTrace, drawn: Mapping[str, Drawing]) -> report_page.Section:
    stages = {label: axis_errors(errors) for label, errors in trace.errors.items()}
    caption = "Errors per degree of freedom at the held-out poses, world axes"
    hint = "Hover to read a pose's millimetres."
    return report_page.Section(
        "Held-out poses",
        (
            report_page.axis_table(caption, stages, "{:.3f}".format),
            _floors(comparison, trace) if all(errors.shape[1] == 6 for errors in trace.errors.values()) else "",
            report_page.Interactive(drawn["error_per_test_pose"], pose_spec(norms_mm(trace.errors)), hint),
            report_page.Pair((drawn["error_histogram"], drawn["error_against_extension"])),
        ),
        f"{len(trace.sets['test'])} poses from the whole joint ranges that took no part in the calibration.",
    )


def _floors(comparison: Comparison, trace: CalibrationTrace) -> str:
    """The attitude error that no joint motion removes, beside the whole."""
    geometry, joints = comparison.plant.geometry, trace.sets["test"]

    def degrees(errors: Array) -> float:
        return float(np.degrees(np.linalg.norm(errors[:, 3:], axis=1)).mean())

    parts = "; ".join(
        f"{label} {degrees(errors):.3f}°, of which {degrees(noncompensable_error(geometry, joints, errors)):.3f}°"
        for label, errors in trace.errors.items()
    )
    return f"Mean attitude error, and the part that no motion of {geometry.joints} joints removes on this arm: {parts}."


def _fit(trace: CalibrationTrace, calibration: Calibration, drawn: Mapping[str, Drawing]) -> report_page.Section:
    dropped = ", ".join(name for name, identified in zip(trace.names, trace.kept, strict=True) if not identified)
    condition = trace.singular_values[0] / trace.singular_values[-1]
    name, joints = next(iter(trace.sets.items()))
    kind = "" if calibration.learnt is None else f", then {calibration.record['residual']['kind']} on what remains"
    caption = f"Where the {len(joints)} poses of the set “{name}” lie within the joint limits."
    ranges = Drawing("joint_ranges", caption, lambda: joint_ranges(trace.nominal, joints))
    return report_page.Section(
        "How the calibration was found",
        (
            f"Least squares on {len(joints)} poses{kind}. {int(trace.kept.sum())} of {len(trace.kept)} parameters can "
            f"be told apart (condition number {condition:.1f}). These stay at their nominal values, because others "
            f"absorb them: {dropped or 'none'}.",
            drawn["least_squares_convergence"],
            drawn["parameter_spectrum"],
            report_page.Pair((drawn.get("network_convergence"), ranges)),
        ),
    )


def _recording(screenshot: bytes | None) -> report_page.Section:
    """The picture of the recording; nothing where there is none, for the origin names the file and what opens it."""
    caption = "The recording errors.rrd in its default layout: error fields, reaches, histogram, table."
    parts = [] if screenshot is None else [report_page.Picture(screenshot, caption)]
    return report_page.Section("The recording", parts)


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
        "Recording": f"{RECORDING}, which `pickenv inspect {run.folder.name}` opens",
        "Calibration": f"calibration.npz, {Path(str(calibration.record['source'])).name}",
        "Kind of numbers": "simulated throughout; nothing here was measured on a machine",
    }
