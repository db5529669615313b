"""One page per calibration, for whoever must decide whether to use it: verdict first, then what it rests on.

One HTML file without outside resources, light or dark as the reader's screen, and fit for print. Lengths in mm, angles
in degrees, each named where it stands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from calibration.coverage import pose_coverage
from calibration.error_model import complete_model, link_model
from calibration.fitting import Fit
from calibration.least_squares import describe_absorption
from calibration.measurements import Measurements, random_joints
from calibration.metrics import ErrorStatistics, error_statistics
from calibration.observations import PoseObservations
from calibration.quality import AxisErrors, Quality, axis_errors, base_combinations, judge_quality
from calibration.uncertainty import PoseUncertainty, held_out_errors, pose_uncertainty
from pickenv.arm import Arm
from pickenv.arm.geometry import Array
from pickenv.files import write_text
from pickenv.inspect.report_page import page
from pickenv.inspect.report_words import parameter_words, unit_of
from pickenv.inspect.svg_plots import bar, cumulative, heat_map, joint_strips

TONES = {"good": "good", "usable with care": "care", "do not use": "bad"}
VERDICTS = {
    "good": "Good: the calibration can be used",
    "usable with care": "Usable with care",
    "do not use": "Do not use this calibration",
}
MAP_POSES = 6000
"""Poses drawn for the map of predicted uncertainty."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the page shows, computed once.

    Attributes:
        arm: The arm.
        fit: The calibration and its identification.
        train: Rows of the fit.
        test: Held-out rows.
        before: Held-out errors of the nominal arm, base and tool fitted ``(M, 6)`` or ``(M, 3)``, m and rad.
        after: Of the calibrated arm without a learnt residual.
        best: With the learnt residual; None where there is none.
        quality: The verdict.
        uncertainty: Of predicted poses.
        gate: As `calibration.gate.GateReport.as_dict` gives it, or None.
    """

    arm: Arm
    fit: Fit
    train: Measurements
    test: Measurements
    before: Array
    after: Array
    best: Array | None
    quality: Quality
    uncertainty: PoseUncertainty
    gate: Mapping[str, Any] | None

    @property
    def final(self) -> Array:
        """Held-out errors of what will be used."""
        return self.after if self.best is None else self.best


def gather(
    arm: Arm, fit: Fit, train: Measurements, test: Measurements, gate: Mapping[str, Any] | None = None
) -> Evidence:
    """Compute everything that the page shows.

    Args:
        arm: The arm.
        fit: What `calibration.fit` found on ``train``.
        train: Rows of the fit.
        test: Held-out rows.
        gate: The residual models' judgement, where they were judged.
    """
    calibration, found = fit.calibration, fit.identification
    before = PoseObservations(test).difference(calibration.model.of(calibration.nominal))
    after = PoseObservations(test).difference(calibration.model)
    trained = PoseObservations(train).difference(calibration.model)
    best = None if calibration.learnt is None else held_out_errors(calibration, test)
    parameters = link_model if fit.aligned is None else complete_model
    coverage = pose_coverage(parameters(calibration.nominal), calibration.nominal, train)
    return Evidence(
        arm=arm,
        fit=fit,
        train=train,
        test=test,
        before=before,
        after=after,
        best=best,
        quality=judge_quality(found, trained, before, after, coverage),
        uncertainty=pose_uncertainty(found, after if best is None else best),
        gate=gate,
    )


def write_calibration_report(path: str | Path, evidence: Evidence, seeds: Mapping[str, Any] | None = None) -> Path:
    """Write the page, whole or not at all."""
    return write_text(path, calibration_page(evidence, seeds))


def calibration_page(evidence: Evidence, seeds: Mapping[str, Any] | None = None) -> str:
    """The page as HTML.

    Args:
        evidence: From `gather`.
        seeds: Seeds and options that reproduce the calibration, by name.
    """
    sections = (
        _head(evidence),
        _errors(evidence),
        _gate(evidence.gate),
        _parameters(evidence),
        _poses(evidence),
        _origin(evidence, seeds or {}),
    )
    return page(f"Calibration of {evidence.arm.name}", sections)


def _norms_mm(errors: Array) -> Array:
    return np.asarray(np.linalg.norm(errors[:, :3], axis=1) * 1e3)


def _head(e: Evidence) -> str:
    quality, found = e.quality, e.fit.identification
    before, final = error_statistics(_norms_mm(e.before)), error_statistics(_norms_mm(e.final))
    low, high = final.mean_ci95
    sentence = (
        f"On {len(e.test)} measured poses that the fit never saw, the tool stood {final.mean:.3f} mm (mean; 95 % "
        f"interval {low:.3f} to {high:.3f}) from where the calibrated model says it stands. With the nominal model it "
        f"is {before.mean:.3f} mm."
    )
    attitude = ""
    if e.final.shape[1] == 6:
        was, now = (np.degrees(np.linalg.norm(v[:, 3:], axis=1)).mean() for v in (e.before, e.final))
        attitude = f" The attitude error falls from {was:.4f} to {now:.4f} deg."
    test = quality.completeness
    tiles = (
        (f"{before.mean:.3f} → {final.mean:.3f} mm", "mean position error, nominal → calibrated"),
        (f"{final.p95:.3f} mm", "95 of 100 poses are better than this"),
        (f"{found.identifiability.rank} of {len(found.identifiability.names)}", "parameters could be identified"),
        (
            f"{np.sqrt(test.reduced):.2g} ×" if np.isfinite(test.reduced) else "not known",
            "what remains, in units of the stated measurement noise (1 is perfect)",
        ),
    )
    findings = "".join(f'<li class="{f.weight}">{escape(_sentence(f.text))}</li>' for f in quality.findings)
    return (
        f"<h1>Calibration of {escape(e.arm.name)}</h1>"
        f'<p class="soft">{len(e.train)} {escape(found.kind)} measurements from {escape(Path(e.train.source).name)}; '
        f"{len(e.test)} held out</p>"
        f'<div class="verdict {TONES[quality.grade]}"><strong>{escape(VERDICTS[quality.grade])}</strong>'
        f"<p>{escape(sentence + attitude)}</p><ul>{findings}</ul></div>"
        '<div class="tiles">'
        + "".join(f'<div class="tile"><b>{escape(a)}</b><span>{escape(b)}</span></div>' for a, b in tiles)
        + "</div>"
    )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].replace("chi^2", "χ²") + ("" if text.endswith(".") else ".")


def _errors(e: Evidence) -> str:
    groups: list[tuple[str, Sequence[AxisErrors]]] = [("calibrated", e.quality.calibrated)]
    if e.best is not None:
        groups.append(("with learnt residual", axis_errors(e.best)))
    head = "<tr><th class=words>axis</th><th>nominal RMSE</th>" + "".join(
        f"<th>{label}: mean</th><th>std</th><th>RMSE</th><th>max</th>" for label, _ in groups
    )
    rows = []
    for i, before in enumerate(e.quality.nominal):
        cells = "".join(
            f"<td>{g[i].mean:+.4f}</td><td>{g[i].std:.4f}</td><td>{g[i].rmse:.4f}</td><td>{g[i].max:.4f}</td>"
            for _, g in groups
        )
        rows.append(f'<tr><td class="name">{before.axis} ({before.unit})</td><td>{before.rmse:.4f}</td>{cells}</tr>')
    series: dict[str, tuple[str, Array]] = {
        "nominal": ("before", _norms_mm(e.before)),
        "calibrated": ("after", _norms_mm(e.after)),
    }
    if e.best is not None:
        series["with residual"] = ("best", _norms_mm(e.best))
    norms = _norm_rows({label: error_statistics(values) for label, (_, values) in series.items()})
    return (
        "<h2>Errors on held-out poses</h2>"
        '<p class="explain">Measured minus predicted, on poses that took no part in the fit. “Nominal” is the arm as '
        "its data sheet has it, after base and tool were fitted, so it is not blamed for where the instrument stood."
        "</p>"
        f'<div class="pair"><div>{norms}</div><div>{cumulative(series, "position error (mm)")}</div></div>'
        f'<div class="scroll"><table>{head}</tr>{"".join(rows)}</table></div>'
    )


def _norm_rows(statistics: Mapping[str, ErrorStatistics]) -> str:
    rows = "".join(
        f"<tr><td class=words>{escape(label)}</td><td>{s.mean:.3f}</td>"
        f"<td>{s.mean_ci95[0]:.3f}–{s.mean_ci95[1]:.3f}</td>"
        f"<td>{s.rms:.3f}</td><td>{s.p95:.3f}</td><td>{s.max:.3f}</td></tr>"
        for label, s in statistics.items()
    )
    return (
        '<div class="scroll" style="margin-top:12px"><table><tr><th class=words>distance (mm)</th><th>mean</th>'
        f"<th>95 % interval</th><th>RMS</th><th>p95</th><th>max</th></tr>{rows}</table></div>"
    )


def _gate(gate: Mapping[str, Any] | None) -> str:
    if not gate:
        return ""
    rows = []
    for name, verdict in gate.get("models", {}).items():
        rows.append(
            f"<tr><td class=words>{escape(str(name))}</td><td>{_or_dash(verdict.get('random_rms_mm'))}</td>"
            f"<td>{_or_dash(verdict.get('blocked_rms_mm'))}</td>"
            f"<td>{_or_dash(verdict.get('geometric_blocked_rms_mm'))}</td>"
            f"<td class=words>{'accepted' if verdict.get('accepted') else 'left off'}: "
            f"{escape(str(verdict.get('reason', '')))}</td></tr>"
        )
    chosen = gate.get("selected")
    said = f"The residual model “{chosen}” is used." if chosen else "No residual model is used."
    return (
        f"<h2>Learnt residual models</h2><p>{escape(said)}</p>"
        '<p class="explain">A model of what geometry leaves is believed only if it lowers the error on whole blocks of '
        "consecutive poses that it never saw; a random hold-out flatters it, because neighbouring poses give the "
        "answer away.</p>"
        '<div class="scroll"><table><tr><th class=words>model</th><th>random hold-out, RMS (mm)</th>'
        "<th>blocked hold-out, RMS (mm)</th><th>blocked without it (mm)</th><th class=words>verdict</th></tr>"
        + "".join(rows)
        + "</table></div>"
    )


def _or_dash(value: Any) -> str:
    return f"{value:.4f}" if isinstance(value, int | float) else "–"


def _parameters(e: Evidence) -> str:
    found = e.fit.identification
    seen = found.identifiability
    geometry = found.geometry
    joints, links, geometric = geometry.joint_names, geometry.link_names, geometry.parameter_names
    std = found.standard_deviation
    units = [unit_of(name, geometric) for name in seen.names]
    limits: dict[str, float] = {}
    for k in seen.kept:
        unit, scale = units[k]
        size = (abs(found.delta[k]) + 2 * np.nan_to_num(std[k])) * scale
        if not seen.names[k].startswith("base_"):
            limits[unit] = max(limits.get(unit, 1e-12), float(size))
    combinations = base_combinations(seen)
    rows = []
    for k in seen.kept:
        name, (unit, scale) = seen.names[k], units[k]
        change, sigma = float(found.delta[k] * scale), float(std[k] * scale)
        drawn = bar(change, 0.0 if np.isnan(sigma) else sigma, limits.get(unit, abs(change) or 1.0))
        absorbed = combinations[name] if combinations[name] != name else ""
        words = escape(parameter_words(name, joints, links))
        rows.append(
            f'<tr><td class="name">{escape(name)}</td><td class=words>{words}</td>'
            f"<td>{_figure(change)} ± {_figure(sigma)} {unit}</td><td>{drawn}</td>"
            f"<td class=words>{escape(absorbed)}</td></tr>"
        )
    dropped = "".join(
        f"<li><b>{escape(item.name)}</b> ({escape(parameter_words(item.name, joints, links))}): "
        f"{escape(describe_absorption(_main_parts(item.absorbed_by)))}</li>"
        for item in seen.dropped
    )
    left_out = (
        '<h2>Parameters left at their nominal value</h2><p class="explain">Their effect cannot be told from that of '
        "others; what absorbs it is named (m, rad). Nothing is lost in the predicted pose.</p>"
        f'<ul class="columns">{dropped}</ul>'
        if dropped
        else ""
    )
    return (
        "<h2>What moved</h2>"
        '<p class="explain">Calibrated minus nominal, with one standard uncertainty (±); bars show the change and a '
        "whisker of two standard uncertainties. A change within its whisker is not significant. Where the last column "
        "names a sum, only the sum is known.</p>"
        '<div class="scroll wide"><table><tr><th class=words>parameter</th><th class=words>meaning</th>'
        "<th>change ± uncertainty</th><th></th><th class=words>stands for</th></tr>"
        + "".join(rows)
        + f"</table></div>{left_out}"
    )


def _main_parts(absorbed: Mapping[str, float]) -> dict[str, float]:
    """What absorbs a parameter, without shares below a hundredth of the largest."""
    largest = max((abs(share) for share in absorbed.values()), default=0.0)
    return {name: share for name, share in absorbed.items() if abs(share) >= 0.01 * largest}


def _figure(value: float) -> str:
    if np.isnan(value):
        return "unknown"
    return f"{value:.4f}" if 1e-3 <= abs(value) < 1e5 or value == 0 else f"{value:.3g}"


def _poses(e: Evidence) -> str:
    geometry = e.fit.identification.geometry
    seen, coverage = e.quality.observability, e.quality.coverage
    drawn = joint_strips(geometry, e.train.joints)
    joints = random_joints(geometry, MAP_POSES, np.random.default_rng(0))
    model = e.fit.calibration.model
    uncertainty = PoseUncertainty(e.uncertainty.names, e.uncertainty.covariance, 0.0, None)
    picture = ""
    if np.isfinite(uncertainty.covariance).all() and not model.terms:
        spread, _ = uncertainty.standard(model, joints)
        place = model.pose(joints).position
        out = np.hypot(*(place - geometry.base.position)[:, :2].T)
        height = place[:, 2] - geometry.base.position[2]
        picture = (
            "<div><p class=explain>Standard uncertainty of the predicted position from the parameters alone, by "
            "distance from the base and height, averaged over poses drawn from the joint ranges.</p>"
            + heat_map(out * 1e3, height * 1e3, spread * 1e3, "distance from base (mm)", "height (mm)", "mm")
            + "</div>"
        )
    pairs = "".join(
        f"<tr><td class=name>{escape(a)}, {escape(b)}</td><td>{rho:+.3f}</td></tr>" for a, b, rho in e.quality.pairs[:8]
    )
    indices = (
        ("condition number", f"{seen.condition:.1f}", "how unevenly parameters are seen; near 1 is best"),
        ("O1", f"{seen.o1:.3g}", "mean sensitivity; D-optimal poses maximise it"),
        ("O2", f"{seen.o2:.3g}", "inverse condition number"),
        ("O3", f"{seen.o3:.3g}", "sensitivity to the worst-seen combination"),
        ("O4", f"{seen.o4:.3g}", "noise amplification"),
        ("O5", f"{seen.o5:.3g}", "mean parameter variance, inverse"),
    )
    table = "".join(
        f"<tr><td class=words>{a}</td><td>{b}</td><td class=words>{escape(c)}</td></tr>" for a, b, c in indices
    )
    said = escape(_sentence(coverage.advice())) if coverage is not None else ""
    return (
        f"<h2>Were the poses good?</h2><p>{said}</p>"
        f'<div class="pair"><div><p class="explain">Where the {len(e.train)} fitted poses lie within the joint limits.'
        f"</p>{drawn}</div>{picture}</div>"
        f'<div class="pair"><div class="scroll"><table>{table}</table></div>'
        + (
            '<div class="scroll"><table><tr><th class=words>parameters hard to tell apart</th><th>correlation</th></tr>'
            f"{pairs}</table></div>"
            if pairs
            else ""
        )
        + "</div>"
    )


def _origin(e: Evidence, seeds: Mapping[str, Any]) -> str:
    record = e.fit.calibration.record
    facts = {
        "data": f"{e.train.source}, fingerprint {record.get('data_fingerprint', 'unknown')}",
        "held out": f"{e.test.source}, {len(e.test)} rows, fingerprint {e.test.fingerprint()}",
        "stated noise": f"{e.train.position_std * 1e3:.4g} mm"
        + ("" if e.train.rotation is None else f", {np.degrees(e.train.attitude_std):.4g} deg")
        + " per coordinate",
        "arm": f"{e.arm.name}, nominal fingerprint {e.fit.calibration.arm_fingerprint}",
        "scatter of one reach": f"{e.uncertainty.position_repeat * 1e3:.4g} mm per coordinate, beside the parameters'",
        "reproduce": ", ".join(f"{key} {value}" for key, value in seeds.items()) or "no random choice was made",
        "versions": ", ".join(f"{key} {value}" for key, value in record.get("versions", {}).items()),
    }
    lines = "<br>".join(f"<b>{escape(key)}</b>: {escape(str(value))}" for key, value in facts.items())
    return f"<footer>{lines}</footer>"
