"""The report of a demonstration: what the calibration removed, what remains, whether it suffices; then the evidence."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from pickenv.arm import noncompensable_error
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.plant import EFFECTS
from pickenv.calibration.assessment.metrics import ErrorStatistics, bootstrap_interval, error_statistics
from pickenv.calibration.assessment.quality import axis_errors
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, comparison_drawings, norms_mm, trace_drawings
from pickenv.inspect.reports import report_page as page
from pickenv.inspect.reports.report_interactive import field_spec, interactive, library, pose_spec
from pickenv.inspect.reports.report_page import Verdict
from pickenv.inspect.reports.svg_plots import joint_strips
from pickenv.inspect.runs.calibration_trace import CalibrationTrace
from pickenv.inspect.runs.comparison import Comparison, PolicyErrors
from pickenv.inspect.runs.gripping import gripped
from pickenv.inspect.runs.run_folder import Run, load_comparison, load_trace

RECORDING = "errors.rrd"
REQUIRED_SHARE = 0.95
"""Share of reaches within the tolerance for which a calibration counts as sufficient."""


@dataclass(frozen=True)
class Share:
    """A share with its 95 % interval (Wilson 1927).

    Attributes:
        count: Successes.
        total: Trials.
    """

    count: int
    total: int

    @property
    def interval(self) -> tuple[float, float]:
        """Low and high end of the 95 % interval."""
        found = binomtest(self.count, self.total).proportion_ci(0.95, method="wilson")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{100 * self.count / self.total:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def demo_report(run: Run, look: Callable[[Path], bytes | None] | None = None) -> str:
    """The page of a demonstration's run folder.

    Args:
        run: The run.
        look: Gives the recording as its viewer draws it, WebP, such as `viewer_picture`; where it is left out or gives
            None, a sentence says so.

    Raises:
        InputError: If a file of the run is missing or damaged.
    """
    comparison, trace = load_comparison(run.folder), load_trace(run)
    if not len(comparison.fruit):
        raise InputError(f"{run.folder} holds no reaches, and a report is about reaches; `{run.made_by}` makes some")
    calibration = Calibration.load(run.folder / "calibration", comparison.plant.arm)
    drawings = {d.name: d for d in _drawable([*comparison_drawings(comparison), *trace_drawings(trace)])}
    recording = run.folder / RECORDING
    title = f"Calibration and picking: {comparison.plant.name}"
    sections = {
        "reaches": "Reaches, by policy",
        "field": "Where the tool misses",
        "poses": "Held-out poses",
        "fit": "How the calibration was found",
        "recording": "The recording",
        "origin": "Origin",
    }
    content = (
        f"<h1>{escape(title)}</h1>"
        f'<p class="soft">Simulated arm; the same scripted policy reaches for {len(comparison.fruit)} fruit, '
        f"raw and calibrated; seed {comparison.seed}</p>",
        page.verdict_box(verdict(comparison)),
        _tiles(comparison, trace),
        page.contents(sections),
        _reaches(comparison, drawings),
        _field(comparison, drawings),
        _poses(comparison, trace, drawings),
        _fit(trace, calibration, drawings),
        _recording(look(recording) if look is not None and recording.is_file() else None),
        _origin(run, comparison, trace, calibration),
    )
    return page.page(title, content, library())


def verdict(comparison: Comparison) -> Verdict:
    """What the last policy's calibration is worth against the first."""
    first, last = comparison.policies[0], comparison.policies[-1]
    before, after = error_statistics(first.position_error_mm), error_statistics(last.position_error_mm)
    gain = first.position_error_mm - last.position_error_mm
    low, high = bootstrap_interval(gain)
    share, was = _share(last), _share(first)
    least, most = share.interval
    tolerance = f"a tolerance of {comparison.tolerance_mm:g} mm"
    if least >= REQUIRED_SHARE:
        tone, headline = "good", f"The calibrated arm suffices for {tolerance}"
    elif most >= REQUIRED_SHARE:
        tone, headline = "care", f"The calibrated arm may suffice for {tolerance}: too few reaches to tell"
    else:
        tone, headline = "bad", f"The calibrated arm does not suffice for {tolerance}"
    if low > 0.0:
        removed = (
            f"The calibration removes {gain.mean():.2f} mm (95 % interval {low:.2f} to {high:.2f}) of a mean position "
            f"error of {before.mean:.2f} mm: {100 * gain.mean() / before.mean:.0f} %."
        )
    else:
        removed = (
            f"The calibration does not lower the mean position error of {before.mean:.2f} mm: it changes by "
            f"{-gain.mean():+.2f} mm (95 % interval {-high:+.2f} to {-low:+.2f})."
        )
    held = gripped(comparison)
    grippers = "; ".join(
        f"{name} {100 * held[first.label].success[name].mean():.0f} % {first.label}, {100 * p.mean():.0f} % calibrated"
        for name, p in held[last.label].success.items()
    )
    return Verdict(
        tone,
        headline,
        f"{removed} What remains is {_mean(after)} mm in the mean and at most {after.max:.2f} mm. {share.count} of "
        f"{share.total} simulated reaches end within {comparison.tolerance_mm:g} mm of the fruit (95 % interval "
        f"{100 * least:.0f} to {100 * most:.0f} %, required are {100 * REQUIRED_SHARE:.0f} %), {was.count} without "
        f"calibration. Fruit that each gripper would take: {grippers}.",
    )


def _share(policy: PolicyErrors) -> Share:
    return Share(int(policy.success.sum()), len(policy.success))


def _mean(statistics: ErrorStatistics, digits: int = 2) -> str:
    low, high = statistics.mean_ci95
    return f"{statistics.mean:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def _drawable(drawings: Drawings) -> list[Drawing]:
    return [drawing for drawing in drawings if isinstance(drawing, Drawing)]


def _tiles(comparison: Comparison, trace: CalibrationTrace) -> str:
    first, last = (error_statistics(p.position_error_mm) for p in (comparison.policies[0], comparison.policies[-1]))
    held_out = [error_statistics(values) for values in norms_mm(trace.errors).values()]
    return page.tiles(
        {
            "mean position error of the reaches, raw → calibrated": f"{first.mean:.2f} → {last.mean:.2f} mm",
            "95 of 100 reaches are better than this": f"{last.p95:.2f} mm",
            "mean error at held-out poses, raw → calibrated": f"{held_out[0].mean:.2f} → {held_out[-1].mean:.2f} mm",
            "parameters could be identified": f"{int(trace.kept.sum())} of {len(trace.kept)}",
        }
    )


def _reaches(comparison: Comparison, drawings: Mapping[str, Drawing]) -> str:
    held = gripped(comparison)
    grippers = list(next(iter(held.values())).success)
    heads = ["policy", "position, mean (mm)", "RMS (mm)", "p95 (mm)", "max (mm)", "attitude, mean (deg)"]
    heads += [f"within {comparison.tolerance_mm:g} mm", *(f"taken by {name}" for name in grippers)]
    rows = []
    for policy in comparison.policies:
        position, attitude = error_statistics(policy.position_error_mm), error_statistics(policy.attitude_error_deg)
        cells = [_mean(position), *(f"{value:.2f}" for value in (position.rms, position.p95, position.max))]
        cells += [_mean(attitude, 3), str(_share(policy))]
        cells += [f"{100 * float(held[policy.label].success[name].mean()):.0f} %" for name in grippers]
        rows.append([policy.label, *cells])
    return page.section(
        "Reaches, by policy",
        "reaches",
        page.table(
            "Final errors of the reaches; in brackets 95 % intervals (bootstrap for means, Wilson for shares)",
            heads,
            rows,
        ),
        page.pair(page.drawn(drawings["position_error_by_policy"]), page.drawn(drawings["reach_errors_cumulative"])),
        page.drawn(drawings["success_against_misalignment"]),
        explain="Distance of the true tool from the fruit at the end of each reach. Accuracy must not be oversold: a "
        "compliant hand forgives centimetres, a rigid cup millimetres.",
    )


def _field(comparison: Comparison, drawings: Mapping[str, Drawing]) -> str:
    if "error_fields" not in drawings:
        return ""
    hint = "Drag to turn all scenes together, hover over the end of an arrow to read its millimetres."
    return page.section(
        "Where the tool misses",
        "field",
        interactive(drawings["error_fields"], field_spec(comparison), hint),
        explain=f"{len(comparison.field_points)} positions {comparison.grid_step * 1e3:g} mm apart, tool upright.",
    )


def _poses(comparison: Comparison, trace: CalibrationTrace, drawings: Mapping[str, Drawing]) -> str:
    mm = norms_mm(trace.errors)
    stages = {label: axis_errors(errors) for label, errors in trace.errors.items()}
    heads = ["axis", *(f"{label} {what}" for label in stages for what in ("mean", "std", "RMSE", "max"))]
    rows = [
        [
            f"{axes[0].axis} ({axes[0].unit})",
            *(cell for a in axes for cell in (f"{a.mean:+.3f}", f"{a.std:.3f}", f"{a.rmse:.3f}", f"{a.max:.3f}")),
        ]
        for axes in zip(*stages.values(), strict=True)
    ]
    floors = ""
    if all(errors.shape[1] == 6 for errors in trace.errors.values()):
        floors = _floors(comparison, trace)
    return page.section(
        "Held-out poses",
        "poses",
        page.table("Errors per degree of freedom at the held-out poses, world axes", heads, rows),
        floors,
        interactive(drawings["error_per_test_pose"], pose_spec(mm), "Hover to read a pose's millimetres."),
        page.pair(page.drawn(drawings["error_histogram"]), page.drawn(drawings["error_against_extension"])),
        explain=f"{len(trace.sets['test'])} poses from the whole joint ranges that took no part in the calibration.",
    )


def _floors(comparison: Comparison, trace: CalibrationTrace) -> str:
    """The attitude error that no joint motion removes, beside the whole."""
    geometry, joints = comparison.plant.geometry, trace.sets["test"]

    def degrees(errors: Array) -> float:
        return float(np.degrees(np.linalg.norm(errors[:, 3:], axis=1)).mean())

    said = "; ".join(
        f"{label} {degrees(errors):.3f}°, of which {degrees(noncompensable_error(geometry, joints, errors)):.3f}°"
        for label, errors in trace.errors.items()
    )
    return (
        f"<p>Mean attitude error, and the part that no motion of {geometry.joints} joints removes on this arm: "
        f"{escape(said)}.</p>"
    )


def _fit(trace: CalibrationTrace, calibration: Calibration, drawings: Mapping[str, Drawing]) -> str:
    dropped = ", ".join(name for name, kept in zip(trace.names, trace.kept, strict=True) if not kept)
    condition = trace.singular_values[0] / trace.singular_values[-1]
    name, joints = next(iter(trace.sets.items()))
    marks = joint_strips(trace.nominal, joints)
    kind = "" if calibration.learnt is None else f", then {calibration.record['residual']['kind']} on what remains"
    return page.section(
        "How the calibration was found",
        "fit",
        f"<p>Least squares on {len(joints)} poses{escape(kind)}. {int(trace.kept.sum())} of {len(trace.kept)} "
        f"parameters can be told apart (condition number {condition:.1f}). These stay at their nominal values, because "
        f"others absorb them: {escape(dropped or 'none')}.</p>",
        page.drawn(drawings["least_squares_convergence"]),
        page.drawn(drawings["parameter_spectrum"]),
        page.pair(
            page.drawn(drawings["network_convergence"]) if "network_convergence" in drawings else "",
            f"<figure>{marks}<figcaption>Where the {len(joints)} poses of the set “{escape(name)}” lie within the "
            "joint limits.</figcaption></figure>",
        ),
    )


def _recording(screenshot: bytes | None) -> str:
    if screenshot is None:
        said = (
            "No picture of the recording in its viewer: none was asked for, or this computer has no graphics adapter "
            "for it. The error field above shows the same arrows; errors.rrd in the run folder opens with rerun."
        )
        return page.section("The recording", "recording", f"<p>{said}</p>")
    picture = base64.b64encode(screenshot).decode()
    caption = "The recording errors.rrd in its default layout: error fields, reaches, histogram, table."
    return page.section(
        "The recording",
        "recording",
        f'<figure><img alt="{caption}" src="data:image/webp;base64,{picture}">',
        f"<figcaption>{caption}</figcaption></figure>",
    )


def _origin(run: Run, comparison: Comparison, trace: CalibrationTrace, calibration: Calibration) -> str:
    plant = comparison.plant
    effects = ", ".join(name.replace("_", " ") for name in EFFECTS if getattr(plant, name) is not None)
    versions = {**run.versions, **calibration.record.get("versions", {})}
    prints = ", ".join(f"{name} {value}" for name, value in trace.fingerprints.items())
    return page.section(
        "Origin",
        "origin",
        page.facts(
            {
                "Reproduce": run.command,
                "Seed": str(run.seed),
                "Versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
                "Arm": f"{plant.arm.name}, nominal geometry {plant.arm.fingerprint()}. {plant.arm.source}",
                "Simulated true arm": f"{plant.name}: {effects or 'true geometry alone'}",
                "Poses": prints,
                "Calibration": f"calibration.npz, {Path(str(calibration.record['source'])).name}",
                "Kind of numbers": "simulated throughout; nothing here was measured on a machine",
            }
        ),
    )
