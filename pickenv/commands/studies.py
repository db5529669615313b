"""`pickenv study`: a tolerance study from its configuration to its results folder."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from pickenv.commands.handing_over import deliver
from pickenv.commands.showing import print_table, progress_bars
from pickenv.files import separate, write_json
from pickenv.limits import check_limit
from pickenv.locks import locked


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
        with progress_bars("arms") as report_progress:
            summary = run_study(
                chosen.quick() if quick else chosen,
                out,
                executor=executor,
                crew=Crew(workers, address),
                device=device,
                progress=partial(report_progress, "arms"),
                warn=lambda text: print(f"warning: {text}", file=sys.stderr),
            )
        saves = [
            (out / "summary.json", lambda path: path),  # written by the study, as its last file
            (json_file, lambda path: write_json(path, summary)),
            (out if report else None, lambda folder: _write_outputs(folder, sobol)),
        ]
        deliver(saves, lambda: _print(summary))


def _write_outputs(folder: Path, sobol: int) -> list[Path]:
    from pickenv.study.analysis.study_report import write_outputs

    return write_outputs(folder, sobol)


def _print(summary: dict[str, Any]) -> None:

    specified = f"at least {100 * summary['share']:g} % of their fruit within {summary['radius_mm']:g} mm"
    title = (
        f"{summary['arms']} simulated arms of plant {summary['plant']}, {summary['fruit']} fruit each, "
        f"seed {summary['seed']}"
    )
    caption = f"yield: arms with {specified}, with Wilson 95 % interval; error: mean over an arm's fruit"
    heads: tuple[str, ...] = ("class", "IT", "method", "poses", "noise [mm]", "payload [kg]")
    errors = ("median arm [mm]", "95 % of arms below [mm]")
    means = {
        (row["setting"], row["probability"]): row["value"]
        for row in summary["quantiles_mm"]
        if row["quantity"] == "error_mean_mm"
    }
    rows = []
    for row in summary["yield"]:
        number = row["setting"]
        quantiles = [means[number, probability] for probability in (0.5, 0.95)]
        rows.append(
            (
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
        )
    heads = (*heads, "yield [%]", "95 % interval", *errors, "not judged")
    print_table(title, heads, rows, words=("class", "method"), caption=caption)
    print(f"{summary['executor']}: {summary['seconds']:.1f} s; table {summary['table_sha256']}")
