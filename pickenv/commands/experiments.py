"""Commands that measure many arms: `pickenv bench`, `pickenv experiment` and `pickenv study`."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any, Literal

import typer
from typer import Option

import pickenv
from pickenv.base import InputError, count_of, locked, require, screen_width, separate, unseen_share
from pickenv.commands import showing

bench = typer.Typer(
    name="bench", help="Benchmarks: calibrations on measured robots, policies on simulated ones.", no_args_is_help=True
)


@bench.command(cls=showing.CommandOfNames)
def calibration(
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path = Path("runs/bench"),
    only: list[str] | None = None,
    quick: Annotated[bool, Option("--quick")] = False,
    data: Annotated[Path, Option(envvar="PICKENV_DATA")] = Path("../shared/data"),
    draws: Annotated[int | None, Option(min=1)] = None,
    seed: Annotated[int, Option(min=0)] = 0,
    workers: Annotated[int, Option(min=1)] = 1,
) -> None:
    """Calibrate measured robots, and compare errors on held-out rows with predictions by twins of the fitted rows.

    Args:
        json_file: Write the rows to this file.
        out: Folder for tables and finished work; an interrupted run continues.
        only: Compute only these rows; an unknown name prints all names.
        quick: The UR5 alone, on few rows: a minute.
        data: Folder of the measured data sets.
        draws: Number of arms drawn from each twin; 2 if left out.
        seed: Seed of all random numbers.
        workers: Number of processes; it does not change the results.
    """
    from datetime import date

    from pickenv.experiments import robot_tables as tables
    from pickenv.experiments.robots import QUICK, ROWS, BenchSettings, run_bench
    from pickenv.inspect.runs.run_folder import listed_files

    blocked = out / tables.BLOCKED_FILE
    shown = [out / name for name in (tables.GAINS_FILE, tables.ROBOTS_FILE)]
    separate({}, {"--out": [blocked, *shown], "--json": json_file})
    require("torch", "pyarrow", *(["joblib"] if workers > 1 else []))
    settings = BenchSettings.quick() if quick else BenchSettings()
    settings = replace(settings, draws=draws or settings.draws, seed=seed)
    names = list(dict.fromkeys(only or (QUICK if quick else ROWS)))

    def show() -> None:
        if gains:
            cells, words = tables.gain_cells(gains, settings.folds), tables.GAIN_HEADS[:3]
            showing.print_table("Gains predicted and measured", tables.GAIN_HEADS, cells, words=words)
            print(tables.agreement_words(gains, settings))
        if len(models):
            cells, heads = tables.spread_cells(models), tables.SPREAD_HEADS
            showing.print_table("Geometry and the best model", heads, cells, words=heads, caption=tables.NOTE)
        for name, reason in skipped.items():
            print(f"not made: {name}: {reason}")

    with locked(out), listed_files(out):
        with showing.progress_bars() as report:
            gains, models, skipped = run_bench(names, settings, data, out, workers=workers, progress=report)
        measured_gains = tables.blocked_json(gains, settings.folds, date.today().isoformat())
        files = [(out / name, text) for name, text in tables.csv_files(gains, models, settings.folds).items()]
        content = tables.bench_json(settings, gains, models, skipped)
        showing.deliver([*files, (blocked, measured_gains), (json_file, content)], show)


@bench.command(cls=showing.CommandOfNames)
def policies(
    policy: list[str] | None = None,
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path = Path("runs/policies"),
    plant: list[str] | None = None,
    rung: list[str] | None = None,
    arms: Annotated[int | None, Option(min=1)] = None,
    episodes: Annotated[int | None, Option(min=1)] = None,
    canopies: Annotated[int | None, Option(min=0)] = None,
    split: Literal["test", "train"] | None = None,
    seed: Annotated[int, Option(min=0)] = 0,
    seeds: int = 5,
    trainings: Annotated[int | None, Option(min=0)] = None,
    learned: list[str] | None = None,
    quick: Annotated[bool, Option("--quick")] = False,
    executor: Literal["serial", "joblib"] = "serial",
    workers: Annotated[int | None, Option(min=1)] = None,
) -> None:
    """Compare policies, raw and calibrated, at fixed difficulties (rungs), with other arms per seed; count picks too.

    Args:
        policy: Further policy: a file of `pickenv train` (.npz), or of SB3 (.zip) or Python, whose code is executed.
        json_file: Write the rows to this file.
        out: Folder for the table and finished work; an interrupted run continues.
        plant: Plant preset in place of the rungs; may be repeated.
        rung: Rung (difficulty) with its own arms for judging; all if left out; may be repeated.
        arms: Number of arms drawn for each seed.
        episodes: Number of fruit per arm.
        canopies: Number of canopies for each arm of the picking task; 0 leaves the task out.
        split: A rung's arms to judge on: test, or train for tuning and for checking these results; test if left out.
        seed: The first seed.
        seeds: Number of seeds; at least 5.
        trainings: Number of trainings of each learned policy, made first; 5 if left out. Their seeds begin at --seed.
        learned: Learned policy of the leaderboard to train, and to compare with the oracle alone; may be repeated.
        quick: Three policies on one arm per seed: a minute.
        executor: serial: in this process; joblib: in several processes, with the same results.
        workers: Number of processes; one per core if left out.
    """
    from pickenv.experiments import policy_tables
    from pickenv.inspect.colours import policy_label
    from pickenv.inspect.runs.run_folder import listed_files

    showing.check_workers(workers, executor != "serial", "joblib")
    page = out / "leaderboard.md"
    separate({"--policy": policy}, {"--out": [page], "--json": json_file})
    require("torch", "pyarrow", *(["joblib"] if executor == "joblib" else []))
    plants = (*(plant or ()), *policy_tables.rungs(rung or ()))
    usual = policy_tables.QUICK if quick else policy_tables.LEADERBOARD
    settings = replace(
        usual,
        policies=(*(("oracle",) if learned else usual.policies), *dict.fromkeys(policy or [])),
        plants=plants or usual.plants,
        seeds=tuple(range(seed, seed + seeds)),
        split=split,
        arms=arms or usual.arms,
        episodes=episodes or usual.episodes,
        canopies=usual.canopies if canopies is None else canopies,
    )

    def show() -> None:
        heads, cells = policy_tables.leaderboard_summary(board)
        behind = policy_label(settings.compensations[-1])
        showing.print_table(f"Mean error (mm), raw / behind {behind}", heads, cells, words=heads[:2])

    with locked(out), listed_files(out):
        with showing.progress_bars() as report:
            backend = "loky" if executor == "joblib" else executor
            count = (0 if quick else 5) if trainings is None else trainings
            how: dict[str, Any] = {"backend": backend, "workers": workers, "progress": report}
            board = policy_tables.run_leaderboard(settings, out, count, learned or (), **how)
        own = "put a policy of yours beside them: the same command with --policy FILE"
        showing.deliver([(page, policy_tables.leaderboard_page(board)), (json_file, board)], show, own)


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
    definition = load_experiment(file, quick=quick, seed=seed, changes=dict(map(_change, change or [])))
    if figures is not None and not (definition.figures or any(number.figure for number in definition.numbers)):
        raise InputError(f"{file} has no figures to write; leave --figures out, or name some in the file")
    with showing.progress_bars() as bars:
        rows = pickenv.experiments.run(definition.experiment, folder, backend=executor, workers=workers, progress=bars)
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
        from pickenv.inspect.figures.plot_policies import estimates_figure

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
        how: dict[str, Any] = {"executor": executor, "workers": workers, "device": device}
        with showing.progress_bars("arms") as bars:
            summary = pickenv.experiments.run_study(settings, out, **how, progress=partial(bars, "arms"))

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
    from pickenv.inspect.colours import between

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
        f"{count_of(summary['arms'], 'simulated arm')} of plant {summary['plant']}, {summary['fruit']} fruit each, "
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
    from pickenv.inspect.colours import said

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
