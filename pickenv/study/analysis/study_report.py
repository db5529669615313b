"""A study's report: one HTML file that needs no network; verdict first, then yields, errors, what matters, origin."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from pickenv.files import write_text
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, write_drawings
from pickenv.inspect.reports.report_page import Page, PageTable, Pair, Part, Section, html_of
from pickenv.inspect.reports.report_words import between, estimated, named_values, percent
from pickenv.inspect.runs.run_folder import Run, TakePicture
from pickenv.study.analysis.single_arms import Placement
from pickenv.study.analysis.sobol import read_sobol, write_sobol
from pickenv.study.analysis.study_drawings import Findings, gather, study_drawings
from pickenv.study.analysis.study_figures import setting_label
from pickenv.study.analysis.study_verdict import specified, study_verdict
from pickenv.study.design.config import LS, RAW, StudyConfig
from pickenv.study.results.row_table import OK, Row
from pickenv.study.results.study_folder import read_rows, read_summary

COUNTS = ("within", "arms", "failed")
MOST_REASONS = 10
YIELD_OF = (
    "Every arm is calibrated at poses of its own, spread over the joint ranges, and reaches for fruit of its own, "
    "wherever its tool can be upright. A yield is that of the design over this region, and its interval (Wilson, 95 %) "
    "is over all that was drawn. Settings share all three, so that their differences are known better than the yields."
)
COMPONENTS = (
    "One thing is drawn again while the others are held: shares of the variance of the logarithm of the radius that "
    "holds the required share of an arm's fruit. Alone: what it explains by itself; with interactions: what would be "
    "lost without it."
)
SHARES = (
    "The squared error of each arm over its own fruit is regressed on what was drawn for the arm and on the squares of "
    "that; what chance alone would explain is taken off, so that a tolerance without effect has a share of zero on "
    "average. The mean square error is what a tolerance adds to it; what R² leaves is interaction, the arm's own fruit "
    "and poses, and tracker noise."
)
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
    read_rows(run.folder)  # what is not there is said before anything is computed
    read_summary(run.folder)
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
            YIELD_OF,
        ),
        Section("Errors", (Pair(figures("error_")), _error_table(found), *_placements(found, figures("placement_")))),
        Section("Where the differences come from", _component_tables(summary), COMPONENTS),
        Section(
            "Which tolerance matters",
            (*figures("sensitivity_"), *_sensitivity_tables(found), *_sobol_tables(folder, found)),
            SHARES,
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


def _percents(row: Row, key: str) -> tuple[str, str]:
    """A share and its interval, percent, in two cells."""
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
    return PageTable(
        "Errors of an arm over its fruit: quantiles over arms, 95 % intervals, open where few arms set no bound",
        heads,
        rows,
    )


def _component_tables(summary: Row) -> list[Part]:
    heads = ("drawn anew", "alone (%)", "95 % interval", "with interactions (%)", "95 % interval")
    parts: list[Part] = []
    for setting in summary["components"]:
        label = setting_label(setting)
        if setting["missing"] is not None:
            parts.append(f"{label}: {setting['missing']}.")
            continue
        rows = [(row["group"], *_percents(row, "first_order"), *_percents(row, "total")) for row in setting["shares"]]
        parts.append(PageTable(f"{label}: {setting['shares'][0]['arms']} further arms", heads, rows))
    return parts


def _placements(found: Findings, drawn: Sequence[Drawing]) -> tuple[Part, ...]:
    rows = [
        (setting_label(found.row(setting)), f"{p.error_mm:.2f}", percent(p.percentile, *p.interval), f"{p.arms}")
        for setting, p in found.placements.items()
        if isinstance(p, Placement)
    ]
    heads = ("setting", "its mean error (mm)", "arms with a smaller error", "arms")
    caption = (
        f"The true arm of {found.protocol.design.name} itself, compared with each arm at that arm's own fruit and poses"
    )
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
