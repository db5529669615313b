"""The page of a calibration, for readers who decide whether to use it: first the verdict, then the evidence.

Lengths are in mm and angles in degrees, with the unit beside each number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.base import InputError, write_text
from pickenv.calibration import Measurements, Observations, Result, random_joints
from pickenv.calibration.assessment.quality import axis_errors
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.pipeline.fitting import GEOMETRIC, NOMINAL
from pickenv.calibration.pipeline.result import SIGMAS, has_moved
from pickenv.inspect.colours import TEXTS, in_words, named_values, parameter_words
from pickenv.inspect.figures.plot_calibration import joint_coverage, uncertainty_map
from pickenv.inspect.figures.plot_errors import error_cumulative
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, captioned, norms_mm, trace_drawings, view_drawings
from pickenv.inspect.reports.report_page import Bar, PageTable, PageVerdict, Section, axis_table, html_of
from pickenv.inspect.runs.comparison_summary import matters, pick_changes
from pickenv.inspect.runs.run_folder import REPORT, Run, TakePicture, load_part, unedited
from pickenv.inspect.runs.traces import CalibrationTrace, views_of

TONES = {"good": "good", "with care": "care", "do not use": "bad"}
FURTHER = ("set_ups", "pictures", "uncertainty", "left_out", "terms", "stiffnesses", "harmonics", "residual_models")
"""Keys of the tables that get sections of their own, in the order of the page."""
OF_MODELS = ("errors", "terms", "residual_models")
"""Keys of the tables whose cells name models; cells of all other tables may name files and joints."""


def drawings(run: Run) -> Drawings:
    """Return the figures of a calibration's run."""
    return trace_drawings(load_part(run, CalibrationTrace))


def page(run: Run, picture: TakePicture | None = None) -> str:
    """Return the page that was written with the run, as HTML; ``picture`` is not used.

    The page cannot be made again from the folder, because it needs more data than the folder has.

    Raises:
        InputError: If the folder has no page, or the page was edited.
    """
    path = run.folder / REPORT
    if not path.is_file():
        raise InputError(f"{path} does not exist: measurements of this kind have no report page; see `pickenv figures`")
    return unedited(run, REPORT).read_text(encoding="utf-8")


def write_calibration_report(path: str | Path, result: Result, seeds: Mapping[str, Any] | None = None) -> Path:
    """Write the page of a calibration to ``path`` atomically, and return the path.

    Args:
        path: The file (.html).
        result: The calibration and its judgement.
        seeds: Seeds and options that reproduce the calibration, by name.
    """
    return write_text(path, calibration_page(result, seeds))


def calibration_page(result: Result, seeds: Mapping[str, Any] | None = None) -> str:
    """Return the page of a calibration as HTML.

    Args:
        result: The calibration and its judgement.
        seeds: Seeds and options that reproduce the calibration, by name.
    """
    train, test = result.train, result.test
    blocks = {block.key: block for block in result.blocks()}
    sections = (
        _errors(result, blocks),
        Section("Reprojection errors", view_drawings(views_of(result)), TEXTS["explained"]["reprojection"]),
        *[Section(blocks[key].title, [_table(blocks[key])]) for key in FURTHER if key in blocks],
        _parameters(result),
        _poses(result, train),
        Section("Evidence", [{row[0]: row[1] for row in blocks["evidence"].rows}]),
    )
    rows = "views of a board" if train.kind == "pixels" else f"{train.kind} measurements"
    held_out = f"{len(test.joints)} held out"
    if result.held_out.blocks is not None:
        held_out = f"each judged without its block of the {result.held_out.rows}"
    return html_of(
        f"Calibration of {result.arm.name}",
        f"{len(train.joints)} {rows} from {Path(train.source).name}; {held_out}",
        _verdict(result, test),
        sections,
        _origin(result, train, test, seeds or {}),
        _tiles(result),
    )


def _verdict(r: Result, test: Observations) -> PageVerdict:
    quality, final, blocks = r.quality, r.best, r.held_out.blocks
    interval = r.held_out.no_interval
    if final.mean_ci95 is not None:
        between = "" if blocks is None else " between blocks"
        interval = f"95 % interval{between} {' to '.join(map(figure, final.mean_ci95))}"
    which = "that the fit never saw" if blocks is None else "of which no fit saw the block that it is judged on"
    tracked = test.poses is not None
    rows, stood = ("measured poses", "the tool stood") if tracked else (r.held_out.rows, "what was read lay")
    sentence = (
        f"On {len(test.joints)} {rows} {which}, {stood} {figure(final.mean)} {r.miss_unit} (mean; {interval}) from "
        f"where the calibrated model says{' it stands' * tracked}."
    )
    if r.has_nominal:
        sentence += f" With the nominal model it is {figure(r.position[NOMINAL].mean)} {r.miss_unit}."
    attitudes = list(r.attitude.values())
    if attitudes and r.has_nominal:
        was, now = attitudes[0].mean, attitudes[-1].mean
        sentence += f" The attitude error falls from {figure(was)} to {figure(now)} deg."
    text = "\n".join((_sentence(quality.reason) + _worth(r), sentence, _sentence(r.frames_text)))
    findings = [(weight, _sentence(text)) for weight, text in quality.others]
    return PageVerdict(TONES[quality.grade], TEXTS["verdicts"][quality.grade], text, findings)


def _worth(r: Result) -> str:
    """Return sentences that say whether the calibration changes picks; empty if this is not known.

    All errors are taken to be across the tool's axis.
    """
    if r.miss_unit != "mm" or not r.has_nominal or r.pixels is not None:
        return ""
    mm = norms_mm(r.errors)
    picks = matters("an arm with these errors ({})", pick_changes(mm[NOMINAL], list(mm.values())[-1]))
    return " " + in_words(picks).format(r.arm.name)


def _tiles(r: Result) -> dict[str, str]:
    mean = f"{figure(r.best.mean)} {r.miss_unit}"
    head = f"mean {'position' if r.miss_unit == 'mm' else 'angular'} error"
    if r.has_nominal:
        mean, head = f"{figure(r.position[NOMINAL].mean)} → {mean}", f"{head}, nominal → calibrated"
    noise, identification = r.quality.completeness, r.geometric.identification
    remains = f"{np.sqrt(noise.reduced):.2g} ×" if np.isfinite(noise.reduced) else "not known"
    return {
        head: mean,
        "95 of 100 poses are better than this": f"{figure(r.best.p95)} {r.miss_unit}",
        "parameters that the rows tell": f"{identification.spent:.1f} of {len(identification.identifiability.names)}",
        f"what remains, in units of the {noise.noise} (1 is perfect)": remains,
    }


def _sentence(text: str) -> str:
    if not text:
        return ""
    return text[:1].upper() + text[1:].replace("chi^2", "χ²").replace("`", "") + ("" if text.endswith(".") else ".")


def _table(block: Block, look: str = "") -> PageTable:
    """Return a table of the terminal's output (`Block`) as a table of the page, with the block's note as caption.

    ``look`` is the CSS class, as for `PageTable`.
    """
    table = PageTable(_sentence(block.note), block.header, block.rows, look)
    return table.spelled() if block.key in OF_MODELS else table


def _errors(r: Result, blocks: Mapping[str, Block]) -> Section:
    block = blocks["errors"]
    last = list(r.errors)[-1]
    stages = {"nominal": NOMINAL} if r.has_nominal else {}
    stages |= {"calibrated geometry": GEOMETRIC} | ({"model used": last} if last != GEOMETRIC else {})
    mm = norms_mm({label: r.errors[name] for label, name in stages.items()})
    axes = {label: axis_errors(r.errors[name], r.miss_unit) for label, name in stages.items()}
    caption = "Errors per degree of freedom: measured minus predicted, on poses that took no part in the fit."
    drawing = captioned("error_cumulative", error_cumulative, mm) if r.miss_unit == "mm" else None
    return Section(block.title, (_table(block), drawing, axis_table(caption, axes, figure)))


def _parameters(r: Result) -> Section:
    joints, links = r.arm.nominal.joint_names, r.arm.nominal.link_names
    every, unknowns = r.plain_parameters(), r.fit.identification.unknowns
    limits: dict[str, float] = {}
    for row in every:
        if not row["name"].startswith("base_") and row["name"] not in unknowns:
            size = abs(row["change"]) + 2 * np.nan_to_num(row["std"])
            limits[row["unit"]] = max(limits.get(row["unit"], 1e-12), size)

    def cells(row: Mapping[str, Any]) -> tuple[str | Bar, ...]:
        name, unit, change = row["name"], row["unit"], row["change"]
        limit = limits.get(unit, abs(change) or 1.0)
        bar = "" if name in unknowns else (change, float(np.nan_to_num(row["std"])), limit)
        narrowed = "" if row["narrowed"] is None else f"{100 * row['narrowed']:.0f} %"
        words = f"{figure(change)} ± {figure(row['std'])} {unit}"
        return name, parameter_words(name, joints, links), words, bar, narrowed

    def table(caption: str, rows: Sequence[Mapping[str, Any]]) -> PageTable:
        return PageTable(caption, heads, [cells(row) for row in rows], "wide code")

    significant, others = ([row for row in every if has_moved(row) is yes] for yes in (True, False))
    heads = ("parameter", "meaning", "change ± uncertainty", "drawn", "told by the rows")
    moved = f"{len(significant)} of {len(every)} parameters moved by more than {SIGMAS:g} sigma"
    folded = f"{len(others)} within {SIGMAS:g} sigma of the nominal value"
    parts = (
        _sentence(r.prior_text),
        table(moved, significant) if significant else "",
        Section(folded, [table(folded, others)]) if others else None,
    )
    return Section("What moved", parts, TEXTS["explained"]["parameters"])


def _poses(r: Result, train: Observations) -> Section:
    geometry, observability, over = r.fit.identification.geometry, r.quality.observability, r.quality.workspace
    caption = f"How the {len(train.joints)} fitted poses fill the joint ranges."
    indices = [
        (name, figure(observability[name.partition(" ")[0].lower()]), words)
        for name, words in TEXTS["observability"].items()
    ]
    coverage = Drawing("joint_coverage", caption, lambda: joint_coverage(geometry, {"fitted": train.joints}))
    maps = (coverage, _uncertainty(r)) if r.has_nominal else ()
    workspace = _table(over.block()) if over is not None else ""
    table = PageTable("Observability of the parameters", (), indices)
    return Section("Were the poses good?", (workspace, *maps, table))


def _uncertainty(r: Result) -> Drawing | None:
    """Return a map of the uncertainty of predicted positions at 6000 random poses.

    It is None if the uncertainty is unknown or the calibration has terms.
    """
    model, uncertainty, geometry = r.fit.calibration.model, r.uncertainty, r.fit.identification.geometry
    if not np.isfinite(uncertainty.covariance).all() or model.terms:
        return None
    joints = random_joints(geometry, 6000, np.random.default_rng(0))
    spread = uncertainty.from_parameters(model, joints)
    x, y, height = ((model.pose(joints).position - geometry.base.position) * 1e3).T
    return captioned("uncertainty_map", uncertainty_map, np.hypot(x, y), height, spread * 1e3)


def _origin(r: Result, train: Observations, test: Observations, seeds: Mapping[str, Any]) -> dict[str, str]:
    record = r.calibration.record
    how = r.held_out.text(len(test.joints), len(train.joints))
    repeat = figure(r.uncertainty.position_repeat * 1e3)
    noise = {"Noise": "as the description states it, or its kind's default"}
    if isinstance(train, Measurements):
        angular = "" if train.rotation is None else f", {np.degrees(train.attitude_std):.4g} deg"
        title = "Stated noise" if train.std_stated else "Noise assumed"
        noise = {title: f"{train.position_std * 1e3:.4g} mm{angular} per coordinate"}
    return {
        "Data": f"{train.source}, fingerprint {record.get('data_fingerprint', 'unknown')}",
        "Held out": f"{how}; {test.source}, fingerprint {test.fingerprint()}",
        **noise,
        "Arm": f"{r.arm.name}, nominal fingerprint {r.calibration.arm_fingerprint}",
        "Unit": str(record.get("unit") or "not named"),
        "Scatter of one reach": f"{repeat} mm per coordinate, beside the parameters'",
        "Reproduce": named_values(seeds) or "no random choice was made",
        "Versions": named_values(record.get("versions", {})),
    }
