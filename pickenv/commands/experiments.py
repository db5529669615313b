"""`pickenv experiment` measures units at combinations of factors; `pickenv study` estimates the yields of a design."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any, Literal

from typer import Option

import pickenv
from pickenv.base import InputError, locked, require, screen_width, separate, unseen_share
from pickenv.commands import showing

SAMPLES = 2048
"""Default number of rows of a Sobol sample."""

TERMINAL = 80
"""Number of characters in a line of the usual terminal."""


def experiment(
    file: Path,
    quick: Annotated[bool, Option("--quick")] = False,
    seed: Annotated[int | None, Option(min=0)] = None,
    change: Annotated[list[str] | None, Option("--set")] = None,
    executor: Literal["serial", "loky"] = "loky",
    workers: Annotated[int | None, Option(min=1)] = None,
    out: Path | None = None,
    json_file: Annotated[Path | None, Option("--json")] = None,
    table: Path | None = None,
    figures: Path | None = None,
) -> None:
    """Measure units at every combination of factors, and print the numbers that the file asks for.

    Args:
        file: Experiment (.toml); the Python code that it names is executed.
        quick: The file's own small sizes: minutes.
        seed: Seed of all random numbers; the file's if left out.
        change: Replace a unit, factor or setting: arm=20, method=["raw"]; may be repeated.
        executor: serial: in this process; loky: in several processes, with the same results.
        workers: Number of processes; one per core if left out.
        out: Folder for finished work; an interrupted run continues. runs/NAME if left out.
        json_file: Write the numbers to this file.
        table: Write the rows as .csv or .parquet.
        figures: Folder for the file's figures.

    Examples:
        pickenv experiment noise_cost.toml --quick --json noise_cost.json

    More: experiments.md
    """
    showing.check_workers(workers, executor != "serial", "loky")
    from pickenv.experiments.engine import RECORD, write_rows
    from pickenv.experiments.experiment_file import load_experiment, number_table, plain_estimates

    folder = out or Path("runs") / file.stem
    separate({"FILE": file}, {"--out": folder / RECORD, "--json": json_file, "--table": table})
    changes = dict(map(_change, change or []))
    definition = load_experiment(file, quick=quick, seed=seed, changes=changes)
    if figures is not None and not (definition.figures or any(number.figure for number in definition.numbers)):
        raise InputError(f"{file} has no figures to write; leave --figures out, or name some in the file")
    with showing.progress_bars() as report:
        rows = pickenv.experiments.run(
            definition.experiment, folder, backend=executor, workers=workers, progress=report
        )
    tables = definition.estimates(rows)
    content = {
        "title": definition.title,
        "experiment": file.stem,
        "seed": definition.experiment.seed,
        "quick": quick,
        "rows": len(rows),
        "tables": plain_estimates(tables),
    }

    def show() -> None:
        print(definition.title)
        for number, estimates in zip(definition.numbers, tables, strict=True):
            if number.x is not None:  # lines are for the figure
                continue
            if not estimates["rows"]:
                print(f"{estimates['title']}: no rows to make it of")
                continue
            heads, cells = number_table(number, estimates["rows"])
            showing.print_table(estimates["title"], heads, cells, words=number.by)
            runs = max(0 if row["runs"] is None else len(row["runs"]) for row in estimates["rows"])
            if runs > 1:
                hidden = f"a failure of fewer than {100.0 * unseen_share(runs):.0f} % of them may be unseen"
                print(f"runs: the least, the median and the largest of {runs}; {hidden}")

    def draw(place: Path) -> list[Path]:
        from pickenv.inspect.figures.plot_estimates import estimates_figure

        drawings = {name: function(rows) for name, function in definition.figures.items()}
        for number, estimates in zip(definition.numbers, tables, strict=True):
            if number.figure is not None and estimates["rows"]:
                axes: Any = {"x": number.x, "colour": None if number.x else number.across, "panels": number.panels}
                drawings[number.figure] = estimates_figure(
                    estimates["rows"], number.title, number.by, **axes, log=number.log, scale=number.scale
                )
        return [pickenv.inspect.save_figure(figure, place / f"{name}.png") for name, figure in drawings.items()]

    showing.deliver([(json_file, content), (table, partial(write_rows, rows=rows)), (figures, draw)], show)


def _change(text: str) -> tuple[str, Any]:
    """Return the name and the value in a text NAME=VALUE; the value is read as TOML, but text needs no quotes."""
    import tomllib

    name, mark, value = text.partition("=")
    if not mark or not name:
        raise InputError(f"--set is '{text}'; give NAME=VALUE, such as arm=20")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name, value


def study(
    config: Path,
    quick: Annotated[bool, Option("--quick")] = False,
    seed: Annotated[int | None, Option(min=0)] = None,
    executor: Literal["serial", "joblib", "batched"] = "joblib",
    workers: Annotated[int | None, Option(min=1)] = None,
    device: Literal["cpu", "cuda"] = "cpu",
    out: Path = Path("runs/study"),
    json_file: Annotated[Path | None, Option("--json")] = None,
    report: Annotated[bool, Option("--report/--no-report")] = True,
    sobol: Annotated[bool, Option("--sobol")] = False,
    samples: Annotated[int, Option(min=0, callback=showing.limited("samples"))] = SAMPLES,
    details: Annotated[bool, Option("--details")] = False,
) -> None:
    """Estimate the share of arms within specification: draw a population, calibrate every arm, and send it to fruit.

    Args:
        config: Study (.toml); scripts/tolerance_study.toml shows every key.
        quick: 40 arms and 20 fruit at most.
        seed: Seed of all random numbers; the study's own if left out.
        executor: How the arms are computed: one by one in this process or in several, or many at once (batched).
        workers: Number of processes; if left out one per core, or a single one for the batched executor.
        device: Device of the batched executor.
        out: Results folder; a study that it contains already is continued.
        json_file: Write the summary to this file.
        report: Write figures, report.html and arms.rrd into the results folder.
        sobol: Compute Sobol indices of the tolerances, which need further arms.
        samples: Rows of the Sobol sample, a power of two; each needs an arm per group of tolerances, and two more.
        details: Print every setting, and the causes of the differences between arms.

    Examples:
        pickenv study scripts/tolerance_study.toml --quick --out runs/study

    More: tolerance-studies.md
    """
    require("pyarrow", "joblib")
    if sobol and not report:
        raise InputError("--sobol is of the report; leave --no-report out")
    if workers is not None and workers > 1 and device != "cpu":
        raise InputError(f"--device {device} computes in one process; leave --workers out")
    if samples != SAMPLES and not sobol:
        raise InputError("--samples is of the Sobol indices; give --sobol with it")
    showing.check_workers(workers, executor != "serial", "joblib")
    full_study = pickenv.experiments.load_study(config)
    separate(
        {"CONFIG": [config, full_study.plant, *full_study.tolerances]},
        {"--out": [out / name for name in ("summary.json", "report.html", "arms.rrd")], "--json": json_file},
    )
    settings, sobol_samples = full_study.quick() if quick else full_study, samples if sobol else 0
    settings = settings if seed is None else replace(settings, seed=seed)
    with locked(out):
        with showing.progress_bars("arms") as bars:
            count = partial(bars, "arms")
            summary = pickenv.experiments.run_study(
                settings, out, executor=executor, workers=workers, device=device, progress=count
            )

        def written(folder: Path) -> list[Path]:  # the summary was written by the study, as its last file
            drawn = pickenv.experiments.write_outputs(folder, sobol_samples=sobol_samples) if report else []
            return [folder / "summary.json", *drawn]

        saves: list[showing.Save] = [(json_file, summary), (out, written)]
        next_step = f"look at it: {out / 'report.html'}" if report else ""
        more = "" if details else "every setting, and where the differences between arms come from"
        showing.deliver(saves, lambda: _print(settings, summary, details), next_step, more)


def _print(config: pickenv.experiments.StudyConfig, summary: dict[str, Any], details: bool) -> None:
    """Print the verdict of a study and the yields, the highest first.

    With ``details`` print all numbers of its ``summary``, and the causes of the differences between arms.
    """
    from pickenv.experiments.study_findings import study_verdict
    from pickenv.inspect.runs.number_words import between

    verdict = study_verdict(config, summary["yield"])
    showing.print_verdict(f"{verdict.headline}.", TERMINAL)
    print(fill(verdict.text, screen_width(TERMINAL)))
    rows = summary["yield"] if details else sorted(summary["yield"], key=lambda row: -row["yield"])
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
    words, most = ("class", "method"), None if details else showing.MOST
    showing.print_table(title, heads, lines, words=words, caption=caption, width=TERMINAL, most=most)
    if details:
        _print_components(summary)
        print(f"{summary['executor']}: {summary['seconds']:.1f} s; table {summary['table_sha256']}")


def _print_components(summary: dict[str, Any]) -> None:
    """Print a table of the causes of the differences between arms; its lines name the method and the number of arms.

    ``summary`` is the study's summary, as it is written to its JSON file.
    """
    from pickenv.inspect.runs.number_words import said

    def cell(row: dict[str, Any], key: str) -> str:
        return said(row[key], (row[f"{key}_low"], row[f"{key}_high"]), 0, 100.0)

    divided = [setting for setting in summary["components"] if setting["shares"]]
    lines = [
        (setting["method"], f"{row['arms']}", row["group"], cell(row, "first_order"), cell(row, "total"))
        for setting in divided
        for row in setting["shares"]
    ]
    if lines:
        grades = sorted({f"{setting['tolerances']}, IT{setting['it_grade']}" for setting in divided})
        showing.print_table(
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
