"""`pickenv study`: a tolerance study from its configuration to its results folder."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from pickenv.base import check_limit, locked, require, separate, write_json
from pickenv.commands.handing_over import deliver
from pickenv.commands.showing import print_table, progress_bars, with_options

if TYPE_CHECKING:
    from pickenv.experiments import StudyConfig

TERMINAL = 80
"""Characters of a line of the usual terminal."""


def study(
    config: Annotated[Path, typer.Argument(help="Study (.toml); scripts/tolerance_study.toml shows every key.")],
    quick: Annotated[bool, typer.Option("--quick", help="40 arms and 20 fruit at most.")] = False,
    executor: Annotated[
        Literal["serial", "joblib", "ray", "batched"], typer.Option(help="What computes the arms.")
    ] = "joblib",
    workers: Annotated[int | None, typer.Option(help="Processes; one per core if left out.", min=1)] = None,
    device: Annotated[Literal["cpu", "cuda"], typer.Option(help="Where batched computes.")] = "cpu",
    out: Annotated[Path, typer.Option(help="Results folder; a study that it holds already goes on.")] = Path(
        "runs/study"
    ),
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the summary to this file.")] = None,
    report: Annotated[
        bool, typer.Option("--report/--no-report", help="Figures, report.html and arms.rrd in the results folder.")
    ] = True,
    sobol: Annotated[
        bool, typer.Option("--sobol", help="Sobol indices of the tolerances, which need further arms.")
    ] = False,
    samples: Annotated[
        int, typer.Option(help="Rows of the Sobol sample: a power of two. Each takes an arm per group, and two.", min=0)
    ] = 2048,
) -> None:
    """What share of arms is good enough: draw a population, calibrate every arm, send it to fruit, count."""
    require("pyarrow", "joblib")
    from pickenv.experiments import load_study, run_study

    check_limit("--samples", samples, "samples")
    chosen = load_study(config)
    separate(
        {"CONFIG": [config, chosen.plant, *chosen.tolerances]},
        {"--out": [out / name for name in ("summary.json", "report.html", "arms.rrd")], "--json": json_file},
    )
    asked = chosen.quick() if quick else chosen
    with locked(out):
        with progress_bars("arms") as report_progress:
            summary = run_study(
                asked,
                out,
                executor=executor,
                workers=workers,
                device=device,
                progress=partial(report_progress, "arms"),
                warn=lambda text: print(f"warning: {with_options(text)}", file=sys.stderr),
            )
        saves = [
            (out / "summary.json", lambda path: path),  # written by the study, as its last file
            (json_file, lambda path: write_json(path, summary)),
            (out if report else None, lambda folder: _write_outputs(folder, samples if sobol else 0)),
        ]
        deliver(saves, lambda: _print(asked, summary))


def _write_outputs(folder: Path, sobol: int) -> list[Path]:
    from pickenv.experiments import write_outputs

    return write_outputs(folder, sobol)


def _print(config: StudyConfig, summary: dict[str, Any]) -> None:
    """The yields, what their differences come from, and where the rest stands; 80 characters wide."""
    from pickenv.experiments.study_findings import study_verdict
    from pickenv.inspect.reports.report_words import between

    rows = summary["yield"]
    errors = {
        (row["setting"], row["probability"]): row["value"]
        for row in summary["quantiles_mm"]
        if row["quantity"] == "error_mean_mm"
    }
    cells: dict[str, list[str]] = {
        "class": [row["tolerances"] for row in rows],
        "IT": [f"{row['it_grade']}" for row in rows],
        "method": [row["method"] for row in rows],
        "poses": [f"{row['poses'] or '-'}" for row in rows],
        "noise\n(mm)": [f"{row['noise_mm']:g}" if row["poses"] else "-" for row in rows],
        "load\n(kg)": [f"{row['payload_kg']:g}" for row in rows],
        "yield\n(%)": [f"{100 * row['yield']:.1f}" for row in rows],
        "95 %\ninterval": [between(100 * row["yield_low"], 100 * row["yield_high"], 1) for row in rows],
        "median\n(mm)": [_millimetres(errors[row["setting"], 0.5]) for row in rows],
        "95 %\n(mm)": [_millimetres(errors[row["setting"], 0.95]) for row in rows],
        "not\njudged": [f"{row['failed']}" for row in rows],
    }
    alike = [name for name in ("class", "IT", "method") if len(rows) > 1 and len(set(cells[name])) == 1]
    constant = ", ".join(f"{name} {cells[name][0]}" for name in alike)
    hidden = {*alike, *(["not\njudged"] if not any(row["failed"] for row in rows) else [])}
    heads = [name for name in cells if name not in hidden]
    title = (
        f"{summary['arms']} simulated arms of plant {summary['plant']}, {summary['fruit']} fruit each, "
        f"seed {summary['seed']}" + (f"; all {constant}" if constant else "")
    )
    caption = (
        f"yield: arms with at least {100 * summary['share']:g} % of their own fruit within {summary['radius_mm']:g} mm,"
        " over the design's workspace, with Wilson 95 % interval; errors: mean over an arm's fruit, of the median arm "
        "and what 95 % of arms stay below"
    )
    lines = zip(*(cells[name] for name in heads), strict=True)
    print_table(title, heads, lines, words=("class", "method"), caption=caption, width=TERMINAL)
    _print_components(summary)
    verdict = study_verdict(config, rows)
    print(fill(f"{verdict.headline}.", TERMINAL), fill(verdict.text, TERMINAL), sep="\n")
    print(f"{summary['executor']}: {summary['seconds']:.1f} s; table {summary['table_sha256']}")


def _print_components(summary: dict[str, Any]) -> None:
    """What the differences between arms come from, in a table for each setting."""
    from pickenv.inspect.reports.report_words import estimated

    def cell(row: dict[str, Any], key: str) -> str:
        low, high = (None if row[end] is None else 100 * row[end] for end in (f"{key}_low", f"{key}_high"))
        return estimated(100 * row[key], low, high, 0)

    found = [setting for setting in summary["components"] if setting["shares"]]
    lines = [
        (setting["method"], f"{row['arms']}", row["group"], cell(row, "first_order"), cell(row, "total"))
        for setting in found
        for row in setting["shares"]
    ]
    if lines:
        grades = sorted({f"{setting['tolerances']}, IT{setting['it_grade']}" for setting in found})
        print_table(
            f"Where the differences between arms come from ({'; '.join(grades)})",
            ("method", "arms", "drawn anew", "alone (%)", "with interactions (%)"),
            lines,
            words=("method", "drawn anew"),
            caption="share of the variance of the log of the radius that holds the required share of an arm's fruit",
            width=TERMINAL,
        )
    for setting in summary["components"]:
        if setting["missing"]:
            print(fill(f"components of variance, {setting['method']}: {setting['missing']}", TERMINAL))


def _millimetres(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
