"""One page per calibration, for whoever must decide whether to use it: verdict first, then what it rests on.

One HTML file without outside resources, light or dark as the reader's screen, and fit for print. Lengths in mm, angles
in degrees, each named where it stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.assessment.quality import axis_errors, base_combinations
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.assessment.states import MEASURED
from pickenv.calibration.model.measurements import Measurements, random_joints
from pickenv.calibration.pipeline.result import NOMINAL, Result
from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.inspect.reports.report_page import page
from pickenv.inspect.reports.report_words import parameter_words
from pickenv.inspect.reports.svg_plots import bar, cumulative, heat_map, joint_strips

TONES = {"good": "good", "with care": "care", "do not use": "bad"}
VERDICTS = {
    "good": "Good: the calibration can be used",
    "with care": "With care",
    "do not use": "Do not use this calibration",
}
MAP_POSES = 6000
"""Poses drawn for the map of predicted uncertainty."""


def write_calibration_report(path: str | Path, result: Result, seeds: Mapping[str, Any] | None = None) -> Path:
    """Write the page, whole or not at all."""
    return write_text(path, calibration_page(result, seeds))


def calibration_page(result: Result, seeds: Mapping[str, Any] | None = None) -> str:
    """The page as HTML, of a calibration from poses or positions.

    Args:
        result: The calibration, judged.
        seeds: Seeds and options that reproduce the calibration, by name.

    Raises:
        InputError: If something else than poses or positions was measured.
    """
    if not isinstance(result.train, Measurements) or not isinstance(result.test, Measurements):
        raise InputError(f"the page shows poses and positions; {result.train.source} holds {result.train.kind}")
    train, test = result.train, result.test
    blocks = {block.title: block for block in result.blocks()}
    sections = (
        _head(result, train, test),
        _errors(result, blocks),
        *(_table(blocks[title]) for title in ("Rows left out", "Further terms") if title in blocks),
        _gate(blocks.get("Learnt residual models")),
        _parameters(result, blocks),
        _poses(result, train),
        _table(blocks["Evidence"]),
        _origin(result, train, test, seeds or {}),
    )
    return page(f"Calibration of {result.arm.name}", sections)


def _norms_mm(errors: Array) -> Array:
    return np.asarray(np.linalg.norm(errors[:, :3], axis=1) * 1e3)


def _head(r: Result, train: Measurements, test: Measurements) -> str:
    quality = r.quality
    before, final = r.position[NOMINAL], r.best
    interval = " to ".join(map(figure, final.mean_ci95))
    sentence = (
        f"On {len(test)} measured poses that the fit never saw, the tool stood {figure(final.mean)} mm (mean; 95 % "
        f"interval {interval}) from where the calibrated model says it stands. With the nominal model it is "
        f"{figure(before.mean)} mm."
    )
    attitudes = list(r.attitude.values())
    if attitudes:
        was, now = attitudes[0].mean, attitudes[-1].mean
        sentence += f" The attitude error falls from {figure(was)} to {figure(now)} deg."
    test_of_noise = quality.completeness
    tiles = (
        (f"{figure(before.mean)} → {figure(final.mean)} mm", "mean position error, nominal → calibrated"),
        (f"{figure(final.p95)} mm", "95 of 100 poses are better than this"),
        (_share(quality.states.geometry), "parameters of the geometry measured"),
        (
            f"{np.sqrt(test_of_noise.reduced):.2g} ×" if np.isfinite(test_of_noise.reduced) else "not known",
            f"what remains, in units of the {test_of_noise.noise} (1 is perfect)",
        ),
    )
    findings = "".join(f'<li class="{f.weight}">{escape(_sentence(f.text))}</li>' for f in quality.others)
    return (
        f"<h1>Calibration of {escape(r.arm.name)}</h1>"
        f'<p class="soft">{len(train)} {escape(train.kind)} measurements from {escape(Path(train.source).name)}; '
        f"{len(test)} held out</p>"
        f'<div class="verdict {TONES[quality.grade]}"><strong>{escape(VERDICTS[quality.grade])}</strong>'
        f"<p>{escape(_sentence(quality.reason))}</p><p>{escape(sentence)}</p>"
        f"<p>{escape(_sentence(r.frames_text))}</p><ul>{findings}</ul></div>"
        '<div class="tiles">'
        + "".join(f'<div class="tile"><b>{escape(a)}</b><span>{escape(b)}</span></div>' for a, b in tiles)
        + "</div>"
    )


def _share(states: Mapping[str, str]) -> str:
    return f"{list(states.values()).count(MEASURED)} of {len(states)}"


def _table(block: Block, heading: str = "") -> str:
    """A block as a table, with its note."""
    columns = zip(block.header, *block.rows, strict=True) if block.header else ()
    head = "".join(_cell(cells[1], "th", cells[0]) for cells in columns)
    rows = "".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in block.rows)
    note = f'<p class="explain">{escape(_sentence(block.note))}</p>' if block.note else ""
    return (
        f"<h2>{escape(heading or block.title)}</h2>{note}"
        f'<div class="scroll"><table>{f"<tr>{head}</tr>" if head else ""}{rows}</table></div>'
    )


def _cell(text: str, tag: str = "td", shown: str | None = None) -> str:
    """A cell, to the right where ``text`` is a number."""
    number = text[:1] in "-0123456789" and text != ""
    return f"<{tag}{'' if number else ' class=words'}>{escape(text if shown is None else shown)}</{tag}>"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].replace("chi^2", "χ²").replace("`", "") + ("" if text.endswith(".") else ".")


def _errors(r: Result, blocks: Mapping[str, Block]) -> str:
    stages = list(r.errors.items())
    groups = [(name, axis_errors(values)) for name, values in stages[1:]]
    groups = [groups[0], *groups[-1:]] if len(groups) > 1 else groups
    head = "<tr><th class=words>axis</th><th>nominal RMSE</th>" + "".join(
        f"<th>{escape(label)}: mean</th><th>std</th><th>RMSE</th><th>max</th>" for label, _ in groups
    )
    rows = []
    for i, before in enumerate(r.quality.nominal):
        cells = "".join(
            f"<td>{figure(g[i].mean)}</td><td>{figure(g[i].std)}</td><td>{figure(g[i].rmse)}</td>"
            f"<td>{figure(g[i].max)}</td>"
            for _, g in groups
        )
        rows.append(
            f'<tr><td class="name">{before.axis} ({before.unit})</td><td>{figure(before.rmse)}</td>{cells}</tr>'
        )
    shown = [("nominal", "before", stages[0][1]), ("calibrated geometry", "after", stages[1][1])]
    shown += [("model used", "best", stages[-1][1])] if len(stages) > 2 else []
    series = {label: (tone, _norms_mm(values)) for label, tone, values in shown}
    return (
        _table(blocks["Errors on held-out rows"])
        + '<p class="explain">Measured minus predicted, on poses that took no part in the fit.</p>'
        + f'<div style="max-width:34rem">{cumulative(series, "position error (mm)")}</div>'
        + f'<div class="scroll"><table>{head}</tr>{"".join(rows)}</table></div>'
    )


def _gate(block: Block | None) -> str:
    if block is None:
        return ""
    return _table(block) + (
        '<p class="explain">A model of what geometry leaves is believed only if it lowers the error on whole blocks of '
        "consecutive poses that it never saw; a random hold-out flatters it, because neighbouring poses give the "
        "answer away.</p>"
    )


def _parameters(r: Result, blocks: Mapping[str, Block]) -> str:
    joints, links = r.arm.nominal.joint_names, r.arm.nominal.link_names
    combinations = base_combinations(r.fit.identification.identifiability)
    measured = [row for row in r.parameters() if row["state"] == MEASURED]
    limits: dict[str, float] = {}
    for row in measured:
        if not row["name"].startswith("base_"):
            size = abs(row["change"]) + 2 * np.nan_to_num(row["std"])
            limits[row["unit"]] = max(limits.get(row["unit"], 1e-12), size)
    rows = []
    for row in measured:
        name, unit = row["name"], row["unit"]
        drawn = bar(row["change"], float(np.nan_to_num(row["std"])), limits.get(unit, abs(row["change"]) or 1.0))
        absorbed = combinations[name] if combinations.get(name, name) != name else ""
        words = escape(parameter_words(name, joints, links))
        rows.append(
            f'<tr><td class="name">{escape(name)}</td><td class=words>{words}</td>'
            f"<td>{figure(row['change'])} ± {figure(row['std'])} {unit}</td><td>{drawn}</td>"
            f"<td class=words>{escape(absorbed)}</td></tr>"
        )
    lost = blocks.get("Lost in others")
    return (
        f"<h2>What moved</h2><p>{escape(_sentence(r.quality.states.text()))}</p>"
        '<p class="explain">Calibrated minus nominal, with one standard uncertainty (±); bars show the change and a '
        "whisker of two standard uncertainties. A change within its whisker is not significant. Where the last column "
        "names a sum, only the sum is known.</p>"
        '<div class="scroll wide"><table><tr><th class=words>parameter</th><th class=words>meaning</th>'
        "<th>change ± uncertainty</th><th></th><th class=words>stands for</th></tr>"
        + "".join(rows)
        + f"</table></div>{'' if lost is None else _table(lost, 'Parameters lost in others')}"
    )


def _poses(r: Result, train: Measurements) -> str:
    geometry = r.fit.identification.geometry
    seen, coverage = r.quality.observability, r.quality.coverage
    drawn = joint_strips(geometry, train.joints)
    joints = random_joints(geometry, MAP_POSES, np.random.default_rng(0))
    model, known = r.fit.calibration.model, r.uncertainty
    picture = ""
    if known is not None and np.isfinite(known.covariance).all() and not model.terms:
        uncertainty = replace(known, position_repeat=0.0, attitude_repeat=None)
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
        f"<tr><td class=name>{escape(a)}, {escape(b)}</td><td>{rho:+.3f}</td></tr>" for a, b, rho in r.quality.pairs[:8]
    )
    indices = (
        ("condition number", figure(seen.condition), "how unevenly parameters are seen; near 1 is best"),
        ("O1", figure(seen.o1), "mean sensitivity; D-optimal poses maximise it"),
        ("O2", figure(seen.o2), "inverse condition number"),
        ("O3", figure(seen.o3), "sensitivity to the worst-seen combination"),
        ("O4", figure(seen.o4), "noise amplification"),
        ("O5", figure(seen.o5), "mean parameter variance, inverse"),
    )
    table = "".join(
        f"<tr><td class=words>{a}</td><td>{b}</td><td class=words>{escape(c)}</td></tr>" for a, b, c in indices
    )
    said = escape(_sentence(coverage.advice())) if coverage is not None else ""
    return (
        f"<h2>Were the poses good?</h2><p>{said}</p>"
        f'<div class="pair"><div><p class="explain">Where the {len(train)} fitted poses lie within the joint limits.'
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


def _origin(r: Result, train: Measurements, test: Measurements, seeds: Mapping[str, Any]) -> str:
    record = r.calibration.record
    repeat = "unknown" if r.uncertainty is None else figure(r.uncertainty.position_repeat * 1e3)
    facts = {
        "data": f"{train.source}, fingerprint {record.get('data_fingerprint', 'unknown')}",
        "held out": f"{test.source}, {len(test)} rows, fingerprint {test.fingerprint()}",
        "stated noise" if train.std_stated else "noise assumed": f"{train.position_std * 1e3:.4g} mm"
        + ("" if train.rotation is None else f", {np.degrees(train.attitude_std):.4g} deg")
        + " per coordinate",
        "arm": f"{r.arm.name}, nominal fingerprint {r.calibration.arm_fingerprint}",
        "unit": record.get("unit") or "not named",
        "scatter of one reach": f"{repeat} mm per coordinate, beside the parameters'",
        "reproduce": ", ".join(f"{key} {value}" for key, value in seeds.items()) or "no random choice was made",
        "versions": ", ".join(f"{key} {value}" for key, value in record.get("versions", {}).items()),
    }
    lines = "<br>".join(f"<b>{escape(key)}</b>: {escape(str(value))}" for key, value in facts.items())
    return f"<footer>{lines}</footer>"
