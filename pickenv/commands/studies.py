"""`pickenv study`: a tolerance study from its configuration to its results folder."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer


def study(
    config: Annotated[Path, typer.Argument(help="Study (.toml); scripts/tolerance_study.toml shows every key.")],
    quick: Annotated[bool, typer.Option("--quick", help="40 arms and 20 fruit at most.")] = False,
    executor: Annotated[
        Literal["serial", "joblib", "ray", "batched"], typer.Option(help="What computes the arms.")
    ] = "joblib",
    workers: Annotated[int | None, typer.Option(help="Processes; one per core if left out.", min=1)] = None,
    address: Annotated[
        str | None, typer.Option(help="Ray cluster, host:port or ray://host:port; a local one if left out.")
    ] = None,
    device: Annotated[Literal["cpu", "cuda"], typer.Option(help="Where batched computes.")] = "cpu",
    out: Annotated[Path, typer.Option(help="Results folder; a study that it holds already goes on.")] = Path(
        "runs/study"
    ),
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the summary to this file.")] = None,
    report: Annotated[
        bool, typer.Option("--report/--no-report", help="Figures, report.html and arms.rrd in the results folder.")
    ] = True,
    sobol: Annotated[
        int, typer.Option(help="Sobol indices from this power of two; 0 for none: they need further arms.", min=0)
    ] = 0,
) -> None:
    """What share of arms is good enough: draw a population, calibrate every arm, send it to fruit, count."""
    from pickenv.commands.handing_over import deliver
    from pickenv.files import separate, write_text
    from pickenv.limits import check_limit
    from pickenv.locks import locked
    from pickenv.study.design.config import load_study
    from pickenv.study.running.run_study import run_study
    from pickenv.study.running.runners import Crew

    check_limit("--sobol", sobol, "samples")
    chosen = load_study(config)
    separate(
        {"CONFIG": [config, chosen.plant, *chosen.tolerances]},
        {"--out": [out / name for name in ("summary.json", "report.html", "arms.rrd")], "--json": json_file},
    )
    with locked(out):
        with _progress() as (progress, warn):
            summary = run_study(
                chosen.quick() if quick else chosen,
                out,
                executor=executor,
                crew=Crew(workers, address),
                device=device,
                progress=progress,
                warn=warn,
            )
        files: list[Callable[[], Path | Iterable[Path]]] = [lambda: out / "summary.json"]
        if json_file is not None:
            files.append(partial(write_text, json_file, json.dumps(summary, indent=2) + "\n"))
        if report:
            from pickenv.study.analysis.study_report import write_outputs

            files.append(partial(write_outputs, out, sobol))
        deliver(files, lambda: _print(summary))


@contextmanager
def _progress() -> Iterator[tuple[Callable[[int, int], None], Callable[[str], None]]]:
    """A bar with the rate and the time left, and a place for warnings; both on standard error."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    columns = (
        TextColumn("arms"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bars:
        begun: list[Any] = []

        def report(done: int, total: int) -> None:
            if not begun:  # what an earlier run has done says nothing about this one's speed
                begun.extend((bars.add_task("arms", total=total, completed=done, rate=""), done))
            task, before = begun
            elapsed = bars.tasks[task].elapsed or 0.0
            rate = f"{(done - before) / elapsed:.0f} arms/s" if done > before and elapsed else ""
            bars.update(task, completed=done, rate=rate)

        yield report, lambda text: console.print(f"warning: {text}", highlight=False, soft_wrap=True)


def _print(summary: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    specified = f"at least {100 * summary['share']:g} % of their fruit within {summary['radius_mm']:g} mm"
    table = Table(
        title=f"{summary['arms']} simulated arms of plant {summary['plant']}, {summary['fruit']} fruit each, "
        f"seed {summary['seed']}",
        caption=f"yield: arms with {specified}, with Wilson 95 % interval; error: mean over an arm's fruit",
    )
    heads = ("class", "IT", "method", "poses", "noise [mm]", "payload [kg]")
    errors = ("median arm [mm]", "95 % of arms below [mm]")
    for head in (*heads, "yield [%]", "95 % interval", *errors, "not judged"):
        table.add_column(head, justify="left" if head in ("class", "method") else "right")
    means = {
        (row["setting"], row["probability"]): row["value"]
        for row in summary["quantiles_mm"]
        if row["quantity"] == "error_mean_mm"
    }
    for row in summary["yield"]:
        number = row["setting"]
        quantiles = [means[number, probability] for probability in (0.5, 0.95)]
        table.add_row(
            row["tolerances"],
            f"{row['it_grade']}",
            row["method"],
            f"{row['poses'] or '-'}",
            f"{row['noise_mm']:g}" if row["poses"] else "-",
            f"{row['payload_kg']:g}",
            f"{100 * row['yield']:.1f}",
            f"{100 * row['yield_low']:.1f} to {100 * row['yield_high']:.1f}",
            *("-" if value is None else f"{value:.3f}" for value in quantiles),
            f"{row['failed']}",
        )
    console = Console(width=None if sys.stdout.isatty() else 130)
    console.print(table)
    console.print(f"{summary['executor']}: {summary['seconds']:.1f} s; table {summary['table_sha256']}", soft_wrap=True)
