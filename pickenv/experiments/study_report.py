"""Outputs in a study's folder: a report in one HTML file that needs no network, figures, and a recording for Rerun.

The page has the verdict first, then yields, errors, the tolerances that matter, and the origin of the numbers. The
recording shows a setting's worst, median and best arm side by side. Each arm is calibrated at its own poses. For
comparison, all three reach for the fruit of the worst arm.
"""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc

from pickenv.arm import forward, plant_at, pose_error
from pickenv.base import InputError, command_line, count_of, write_text
from pickenv.experiments import study_findings
from pickenv.experiments.study import LS, OK, RAW, StudyConfig, arm_commands, carrying, prepared_study
from pickenv.experiments.study_findings import Findings, gather, ranked, setting_label, study_drawings
from pickenv.experiments.study_rows import Row, read_rows, read_sobol, read_summary, study_of, write_sobol
from pickenv.inspect import Comparison, RecordedPolicy, Run, write_drawings
from pickenv.inspect.colours import TEXTS, between, estimated, in_words, named_values
from pickenv.inspect.figures.run_drawings import Drawing, Drawings
from pickenv.inspect.reports.report_page import PageTable, Part, Section, html_of
from pickenv.inspect.runs.recorded_episodes import ended, field_grid, reaches_of
from pickenv.inspect.runs.run_folder import TakePicture

COUNTS = ("within", "arms", "failed")
MOST_REASONS = 10
MATTERS = 8
"""Number of parameters in the table of each setting; the figure shows more."""


def write_outputs(folder: str | Path, sobol_samples: int = 0) -> list[Path]:
    """Write a finished study's figures, report and recording into its folder, and return the paths written.

    Args:
        folder: The study's folder.
        sobol_samples: Size of the sample for Sobol indices, a power of two; 0 computes no indices.
    """
    folder, written = Path(folder), []
    findings = gather(folder)
    if sobol_samples:
        settings = [number for number in findings.sensitivities if findings.yields[number]["method"] in (RAW, LS)]
        written.append(write_sobol(folder, settings, sobol_samples))
    written += write_drawings(study_drawings(findings), folder / "figures")
    written.append(write_text(folder / "report.html", study_page(folder, findings)))
    best = max(findings.yields, key=lambda row: row["yield_low"])
    if best["failed"] < best["arms"]:
        written.append(record_study(folder, best["setting"], folder / "arms.rrd"))
    return written


def drawings(run: Run) -> Drawings:
    """Return the figures of a study's folder."""
    return study_drawings(gather(run.folder))


def page(run: Run, picture: TakePicture | None = None) -> str:
    """Return the report of a study's folder as HTML.

    Args:
        run: The study's folder, read as a run.
        picture: Not used; a study's report has no picture of its recording.

    Raises:
        InputError: If the folder holds no finished study.
    """
    read_summary(run.folder)  # what is not there is said before anything is computed
    return study_page(run.folder, gather(run.folder))


def study_page(folder: str | Path, findings: Findings) -> str:
    """Return a study's report as HTML.

    Args:
        folder: The study's folder.
        findings: The findings of the study, from `pickenv.experiments.gather`.

    Raises:
        InputError: If the study is not finished.
    """
    summary, config = read_summary(folder), findings.protocol.config
    drawings = [d for d in study_drawings(findings) if d.draw is not None]

    def figures(start: str) -> tuple[Drawing, ...]:
        return tuple(drawing for drawing in drawings if drawing.name.startswith(start))

    yields = (figures("yield_"), _yield_table(findings), _failures(findings))
    errors = (figures("error_"), _error_table(findings))
    shares = (*figures("sensitivity_"), *_sensitivity_tables(findings), *_sobol_tables(folder, findings))
    explained, verdict = TEXTS["explained"], study_findings.study_verdict(config, findings.yields)
    sections = (
        Section("Yields", yields, explained["yields"]),
        Section("Errors", errors),
        Section("Where the differences come from", _component_tables(summary), explained["components"]),
        Section("Which tolerance matters", shares, explained["sensitivities"]),
    )
    return html_of(
        f"Tolerance study of {findings.protocol.design.name}",
        f"{count_of(config.arms, 'simulated arm')} in each of {count_of(len(findings.yields), 'setting')}, "
        f"{config.fruit} fruit each, seed {config.seed}; nothing here was measured",
        replace(verdict, headline=in_words(verdict.headline), text=in_words(verdict.text)),
        sections,
        _origin(Path(folder), config, summary),
        _tiles(config, summary),
        contents=True,
    )


def _percents(row: Row, key: str) -> tuple[str, str]:
    """Return a share and its interval as texts for two table cells, percent, from the column ``key`` of a row."""
    low, high = (None if row[end] is None else 100 * row[end] for end in (f"{key}_low", f"{key}_high"))
    return f"{100 * row[key]:.1f}", between(low, high, 1)


def _tiles(config: StudyConfig, summary: Row) -> dict[str, str]:
    reaches = config.arms * config.fruit * len(config.settings())
    return {
        "specification of an arm": f"{100 * config.share:g} % within {config.radius_mm:g} mm",
        "arms, each in every setting": f"{config.arms}",
        "simulated reaches": f"{reaches:,}".replace(",", "\u202f"),
        f"by the executor {summary['executor']}": f"{summary['seconds']:.0f} s",
    }


def _yield_table(findings: Findings) -> PageTable:
    rows = [
        (setting_label(row), *_percents(row, "yield"), *(f"{row[key]}" for key in COUNTS)) for row in findings.yields
    ]
    heads = ("setting", "yield (%)", "95 % interval", "arms within", "arms", "without a result")
    return PageTable(f"Arms that pick {study_findings.specified(findings.protocol.config)}", heads, rows).spelled()


def _failures(findings: Findings) -> str | PageTable:
    """Return a table of the reasons why arms have no result, or a sentence if every arm has one."""
    reasons: Counter[str] = Counter()
    for batch in findings.rows.to_batches(columns=["status"], filter=pc.field("status") != OK, use_threads=False):
        reasons.update(batch["status"].to_pylist())
    if not reasons:
        return "Every arm has a result in every setting."
    rows = [(reason, f"{count}") for reason, count in reasons.most_common(MOST_REASONS)]
    return PageTable("Why arms have no result; they count as not within specification", ("reason", "rows"), rows)


def _error_table(findings: Findings) -> PageTable:
    values = {(r["setting"], r["quantity"], r["probability"]): r for r in findings.quantiles}
    columns = {  # with digits
        "mean error, median arm (mm)": ("error_mean_mm", 0.5, 2),
        "mean error, 95 % of arms below (mm)": ("error_mean_mm", 0.95, 2),
        "attitude error, median arm (deg)": ("attitude_mean_deg", 0.5, 3),
    }

    def cell(row: Row, digits: int) -> str:
        return estimated(row["value"], row["low"], row["high"], digits) if row["arms"] else "-"

    rows = [
        (setting_label(row), *(cell(values[row["setting"], *key], digits) for *key, digits in columns.values()))
        for row in findings.yields
    ]
    caption = "Errors of an arm over its fruit: quantiles over arms, 95 % intervals, open where few arms set no bound"
    return PageTable(caption, ("setting", *columns), rows).spelled()


def _component_tables(summary: Row) -> list[Part]:
    heads = ("drawn anew", "alone (%)", "95 % interval", "with interactions (%)", "95 % interval")
    return [
        _index_table(f"{setting_label(row)}: {row['shares'][0]['arms']} further arms", heads, row["shares"])
        if row["missing"] is None
        else in_words(f"{setting_label(row)}: {row['missing']}.")
        for row in summary["components"]
    ]


def _index_table(caption: str, heads: Sequence[str], rows: Sequence[Row]) -> PageTable:
    cells = [(row["group"], *_percents(row, "first_order"), *_percents(row, "total")) for row in rows]
    return PageTable(caption, heads, cells).spelled()


def _sensitivity_tables(findings: Findings) -> list[Part]:
    parts: list[Part] = []
    heads = ("tolerance", "share of variance (%)", "95 % interval")
    for setting, shares in findings.sensitivities.items():
        label = findings.label(setting)
        if isinstance(shares, str):
            parts.append(in_words(f"{label}: {shares}."))
            continue
        kinds = [(f"all {row['parameter']}", row) for row in shares if row["level"] == "kind"]
        parameters = [(row["parameter"], row) for row in shares if row["level"] == "parameter"][:MATTERS]
        rows = [(name, *_percents(row, "share")) for name, row in kinds + parameters]
        first = shares[0]
        caption = f"{label}: {first['arms']} arms, R² {first['r2']:.2f} (adjusted {first['r2_adjusted']:.2f})"
        parts.append(PageTable(caption, heads, rows).spelled())
    return parts


def _sobol_tables(folder: str | Path, findings: Findings) -> list[PageTable]:
    heads = ("tolerances", "first order (%)", "95 % interval", "total (%)", "95 % interval")
    caption, indices = "Sobol indices, {}, perfect tracker: {} further arms", read_sobol(folder).items()
    return [_index_table(caption.format(findings.label(n), rows[0]["arms"]), heads, rows) for n, rows in indices]


def _origin(folder: Path, config: StudyConfig, summary: Row) -> dict[str, str]:
    packages = {name: version(name) for name in ("numpy", "scipy", "pyarrow", "torch")}
    config_file = f"{folder.name}/study.toml"
    return {
        "Made by": command_line("pickenv", "study", config_file, executor=summary["executor"], out="DIR"),
        "Plant": config.plant,
        "Seed": f"{config.seed}",
        "pickenv": str(summary["pickenv"]),
        "Reported with": named_values({"Python": platform.python_version(), **packages}),
        "Configuration, SHA-256": str(summary["config_sha256"]),
        "Rows, SHA-256": str(summary["table_sha256"]),
    }


# The recording.

GRID_STEP = 0.1
"""Cell size of the error fields, m."""


def record_study(folder: str | Path, setting: int, path: str | Path) -> Path:
    """Write a recording (.rrd) of a setting's worst, median and best arm, completely or not at all.

    Args:
        folder: The study's folder.
        setting: Number of the setting (one combination of what the study varied), from 0.
        path: The file to write, usually `arms.rrd`.

    Raises:
        InputError: If there is no such setting, or no arm of it has a result.
    """
    from pickenv.inspect import record_comparison

    return record_comparison(arms_compared(folder, setting), path)


def arms_compared(folder: str | Path, setting: int) -> Comparison:
    """Return the episodes of a setting's worst, median and best arm as a comparison, in which each arm is a policy.

    `record_study` makes its recording from this comparison.

    Args:
        folder: Folder of the study.
        setting: Number of the setting, from 0.
    """
    protocol = prepared_study(study_of(folder))
    config, nominal = protocol.config, protocol.nominal
    if not 0 <= setting < len(protocol.settings):
        raise InputError(f"there is no setting {setting}; give a number from 0 to {len(protocol.settings) - 1}")
    cell, grid = protocol.settings[setting], field_grid(nominal, GRID_STEP, config.seed)
    places = ranked(read_rows(folder), setting)
    arms = {name: plant_at(protocol.draw(cell, range(arm, arm + 1)), 0) for name, (arm, _) in places.items()}
    fruit = protocol.circumstances(places["worst"][0]).fruit

    def errors_of(name: str, number: int) -> RecordedPolicy:
        """Return the errors of an arm, calibrated as the setting says, over the field and at the fruit.

        ``name`` is "worst", "median" or "best", and ``number`` the arm's number, from 0.
        """
        arm, around = arms[name], protocol.circumstances(number)
        loaded = carrying(arm, cell.payload_kg)

        def reached(targets: Any) -> tuple[Any, Any, Any]:
            joints, *_ = arm_commands(protocol, cell, arm, replace(around, fruit=targets))
            pose = loaded.tool_pose(joints)
            return joints, pose.position, pose_error(forward(nominal, targets), pose)

        _, _, field = reached(grid.joints)
        joints, positions, errors = reached(fruit)
        success = 1e3 * np.linalg.norm(errors[:, :3], axis=1) <= config.radius_mm
        infos = {"pose_error": errors, "joint_command": joints, "tool_position": positions, "is_success": success}
        infos["fruit_position"] = forward(nominal, fruit).position
        reaches = reaches_of(arm.geometry, range(len(fruit)), infos)
        return ended(f"{name} arm (number {number})", reaches, name).with_field(field)

    return Comparison(
        plant=arms["worst"],
        grid=grid,
        policies=tuple(errors_of(name, arm) for name, (arm, _) in places.items()),
        seed=config.seed,
        tolerance_mm=config.radius_mm,
    )
