"""A study's report: one HTML file that needs no network; verdict first, then yields, errors, what matters, origin."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from pickenv.files import write_text
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, write_drawings
from pickenv.inspect.reports.report_page import Page, PageTable, PageVerdict, Pair, Part, Section, html_of
from pickenv.inspect.reports.report_words import between, estimated, named_values, percent
from pickenv.inspect.runs.run_folder import Run, TakePicture
from pickenv.study.analysis.single_arms import Placement
from pickenv.study.analysis.sobol import read_sobol, write_sobol
from pickenv.study.analysis.study_drawings import Findings, gather, specified, study_drawings
from pickenv.study.analysis.study_figures import Row, method_label, setting_label
from pickenv.study.design.config import LS, RAW, StudyConfig
from pickenv.study.results.row_table import OK
from pickenv.study.results.study_folder import read_summary

REQUIRED_YIELD = 0.95
"""Share of arms for which a way of making and calibrating arms counts as sufficient."""
CHOICES = ("tolerances", "it_grade", "method", "poses", "noise_mm", "noise_deg")
"""What a maker chooses; the payload is what the arms then meet."""
COUNTS = ("within", "arms", "failed")
MOST_REASONS = 10
MATTERS = 8
"""Parameters listed for each setting; the figure shows more."""


def write_outputs(folder: str | Path, sobol_samples: int = 0) -> list[Path]:
    """Write a finished study's figures, report and recording into its folder; returns what was written.

    Args:
        folder: The study's results.
        sobol_samples: A power of two, for Sobol indices of the shown settings; none for 0.
    """
    from pickenv.study.analysis.study_recording import record_study

    folder = Path(folder)
    found, written = gather(folder), []
    if sobol_samples:
        shown = [number for number in found.sensitivities if found.row(number)["method"] in (RAW, LS)]
        written.append(write_sobol(folder, shown, sobol_samples))
    written += write_drawings(study_drawings(found), folder / "figures")
    written.append(write_text(folder / "report.html", study_page(folder, found)))
    best = max(found.yields.to_pylist(), key=lambda row: row["yield_low"])
    if best["failed"] < best["arms"]:
        written.append(record_study(folder, best["setting"], folder / "arms.rrd"))
    return written


def drawings(run: Run) -> Drawings:
    """The figures of a study's folder."""
    return study_drawings(gather(run.folder))


def page(run: Run, picture: TakePicture | None = None) -> str:
    """The report of a study's folder as HTML.

    Raises:
        InputError: If the folder holds no finished study.
    """
    return study_page(run.folder, gather(run.folder))


def study_page(folder: str | Path, found: Findings) -> str:
    """The report as HTML.

    Raises:
        InputError: If the study is not finished.
    """
    summary, config = read_summary(folder), found.config
    drawn = [d for d in study_drawings(found) if isinstance(d, Drawing)]

    def figures(start: str) -> list[Drawing]:
        return [drawing for drawing in drawn if drawing.name.startswith(start)]

    sections = (
        Section(
            "Yields",
            (Pair(figures("yield_")), _yield_table(found), _failures(found)),
            "All arms are calibrated at the same poses, spread over the joint ranges, and reach for the same fruit; "
            "both follow from the study's seed, and the intervals are over arms alone.",
        ),
        Section("Errors", (Pair(figures("error_")), _error_table(found), *_placements(found, figures("placement_")))),
        Section(
            "Which tolerance matters",
            (*figures("sensitivity_"), *_sensitivity_tables(found), *_sobol_tables(folder, found)),
            "The squared error of each arm is regressed on what was drawn for it and on the squares of that. The mean "
            "square error is what a tolerance adds to it; what R² leaves is interaction, tracker noise and what has no "
            "column.",
        ),
    )
    return html_of(
        Page(
            f"Tolerance study of {found.protocol.design.name}",
            f"{config.arms} simulated arms in each of {len(found.yields)} settings, {config.fruit} fruit each, seed "
            f"{config.seed}; nothing here was measured",
            study_verdict(config, found.yields.to_pylist()),
            sections,
            _origin(Path(folder), config, summary),
            _tiles(config, summary),
            contents=True,
        )
    )


def study_verdict(config: StudyConfig, rows: Sequence[Row]) -> PageVerdict:
    """Whether some way of making and calibrating arms suffices at every payload, and which is the least demanding."""
    ways: dict[tuple[Any, ...], Row] = {}
    for row in rows:
        key = tuple(row[name] for name in CHOICES)
        if key not in ways or row["yield"] < ways[key]["yield"]:
            ways[key] = row  # the payload at which this way yields least
    enough = [row for row in ways.values() if row["yield_low"] >= REQUIRED_YIELD]
    perhaps = [row for row in ways.values() if row["yield_high"] >= REQUIRED_YIELD]
    percent = f"{100 * REQUIRED_YIELD:g} %"
    if enough:
        tone, chosen = "good", max(enough, key=_ease)
        headline = f"{_way(chosen)} is enough for a yield of {percent}"
    elif perhaps:
        tone, chosen = "care", max(perhaps, key=lambda row: row["yield"])
        headline = f"{_way(chosen)} may be enough for a yield of {percent}: too few arms to tell"
    else:
        tone, chosen = "bad", max(ways.values(), key=lambda row: row["yield"])
        headline = f"Nothing that was tried gives a yield of {percent}"
    said = [f"With {_way(chosen)}, {_share(chosen)} of arms pick {specified(config)}{_load(chosen)}."]
    others = [r for r in rows if all(r[k] == chosen[k] for k in CHOICES) and r["setting"] != chosen["setting"]]
    said += [f"{_capital(_load(row)) or 'Without payload'} it is {_share(row)}." for row in others]
    uncalibrated = [
        row for row in rows
        if row["method"] == RAW and all(row[k] == chosen[k] for k in ("tolerances", "it_grade", "payload_kg"))
    ]  # fmt: skip
    if chosen["method"] != RAW and uncalibrated:
        said.append(f"Of the same arms without calibration it is {_share(uncalibrated[0])}.")
    return PageVerdict(tone, headline[:1].upper() + headline[1:], " ".join(said))


def _ease(row: Row) -> tuple[Any, ...]:
    """Larger for what asks less of a maker: coarse grades first, then few poses, then a noisy tracker."""
    return row["it_grade"], -row["poses"], row["noise_mm"], row["method"] == RAW


def _way(row: Row) -> str:
    how = (
        "no calibration" if row["method"] == RAW
        else f"{row['poses']} poses by a tracker of {row['noise_mm']:g} mm noise, {method_label(row['method'])}"
    )  # fmt: skip
    return f"IT{row['it_grade']} ({row['tolerances']}) and {how}"


def _load(row: Row) -> str:
    return f", carrying {row['payload_kg']:g} kg" if row["payload_kg"] else ""


def _capital(text: str) -> str:
    text = text.removeprefix(", ")
    return text[:1].upper() + text[1:]


def _share(row: Row) -> str:
    """Yield with its interval, percent."""
    return percent(row["yield"], row["yield_low"], row["yield_high"], 1)


def _percents(row: Row, key: str) -> tuple[str, str]:
    """A share and its interval, percent, in two cells."""
    return f"{100 * row[key]:.1f}", between(100 * row[f"{key}_low"], 100 * row[f"{key}_high"], 1)


def _tiles(config: StudyConfig, summary: Row) -> dict[str, str]:
    reaches = config.arms * config.fruit * len(config.settings())
    return {
        "specification of an arm": f"{100 * config.share:g} % within {config.radius_mm:g} mm",
        "arms, each in every setting": f"{config.arms}",
        "simulated reaches": f"{reaches:,}".replace(",", "\u202f"),
        f"by the executor {summary['executor']}": f"{summary['seconds']:.0f} s",
    }


def _yield_table(found: Findings) -> PageTable:
    rows = [
        (setting_label(row), *_percents(row, "yield"), *(f"{row[key]}" for key in COUNTS))
        for row in found.yields.to_pylist()
    ]
    heads = ("setting", "yield (%)", "95 % interval", "arms within", "arms", "without a result")
    return PageTable(f"Arms that pick {specified(found.config)}", heads, rows)


def _failures(found: Findings) -> str | PageTable:
    """Why arms have no result."""
    reasons: Counter[str] = Counter()
    for batch in found.rows.to_batches(columns=["status"], filter=pc.field("status") != OK, use_threads=False):
        reasons.update({entry["values"]: entry["counts"] for entry in batch["status"].value_counts().to_pylist()})
    if not reasons:
        return "Every arm has a result in every setting."
    rows = [(reason, f"{count}") for reason, count in reasons.most_common(MOST_REASONS)]
    return PageTable("Why arms have no result; they count as not within specification", ("reason", "rows"), rows)


def _error_table(found: Findings) -> PageTable:
    values = {(r["setting"], r["quantity"], r["probability"]): r for r in found.quantiles.to_pylist()}
    wanted = {("error_mean_mm", 0.5): 2, ("error_mean_mm", 0.95): 2, ("attitude_mean_deg", 0.5): 3}  # with digits

    def cell(row: Row, digits: int) -> str:
        return estimated(row["value"], row["low"], row["high"], digits) if row["arms"] else "-"

    rows = [
        (setting_label(row), *(cell(values[row["setting"], *key], digits) for key, digits in wanted.items()))
        for row in found.yields.to_pylist()
    ]
    heads = (
        "setting",
        "mean error, median arm (mm)",
        "mean error, 95 % of arms below (mm)",
        "attitude error, median arm (deg)",
    )
    return PageTable("Errors of an arm over its fruit, quantiles over arms with 95 % bands", heads, rows)


def _placements(found: Findings, drawn: Sequence[Drawing]) -> tuple[Part, ...]:
    rows = [
        (setting_label(found.row(setting)), f"{p.error_mm:.2f}", percent(p.percentile, *p.interval), f"{p.arms}")
        for setting, p in found.placements.items()
        if isinstance(p, Placement)
    ]
    heads = ("setting", "its mean error (mm)", "arms with a smaller error", "arms")
    caption = f"The true arm of {found.protocol.design.name} itself, calibrated and judged like the population"
    return (Pair(drawn), PageTable(caption, heads, rows)) if rows else ()


def _sensitivity_tables(found: Findings) -> list[Part]:
    parts: list[Part] = []
    heads = ("tolerance", "share of variance (%)", "95 % interval", "mean square error (mm²)", "95 % interval")
    for setting, table in found.sensitivities.items():
        label = setting_label(found.row(setting))
        if not isinstance(table, pa.Table):
            parts.append(f"{label}: {table}.")
            continue
        every = table.to_pylist()
        chosen = [row for row in every if row["level"] == "kind"]
        chosen += [row for row in every if row["level"] == "parameter"][:MATTERS]
        rows = [
            (
                f"all {row['parameter']}" if row["level"] == "kind" else row["parameter"],
                *_percents(row, "share"),
                f"{row['mean_square_mm2']:.4f}",
                between(row["mean_square_low_mm2"], row["mean_square_high_mm2"], 4),
            )
            for row in chosen
        ]
        first = every[0]
        caption = f"{label}: {first['arms']} arms, R² {first['r2']:.2f} (adjusted {first['r2_adjusted']:.2f})"
        parts.append(PageTable(caption, heads, rows))
    return parts


def _sobol_tables(folder: str | Path, found: Findings) -> list[PageTable]:
    heads = ("tolerances", "first order (%)", "95 % interval", "total (%)", "95 % interval")
    return [
        PageTable(
            f"Sobol indices, {setting_label(found.row(number))}, perfect tracker: {rows[0]['arms']} further arms",
            heads,
            [(row["group"], *_percents(row, "first_order"), *_percents(row, "total")) for row in rows],
        )
        for number, rows in read_sobol(folder).items()
    ]


def _origin(folder: Path, config: StudyConfig, summary: Row) -> dict[str, str]:
    packages = {name: version(name) for name in ("numpy", "scipy", "pyarrow", "torch")}
    return {
        "Made by": f"pickenv study {folder.name}/study.toml --executor {summary['executor']} --out DIR",
        "Plant": config.plant,
        "Seed": f"{config.seed}",
        "pickenv": str(summary["pickenv"]),
        "Reported with": named_values({"Python": platform.python_version(), **packages}),
        "Configuration, SHA-256": str(summary["config_sha256"]),
        "Rows, SHA-256": str(summary["table_sha256"]),
    }
