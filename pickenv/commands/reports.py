"""Commands about finished runs: `pickenv figures` and `pickenv report`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from pickenv.inspect.figures.run_drawings import Drawings
    from pickenv.inspect.runs.run_folder import Run

MADE_FROM_NUMBERS = (".html", ".svg", ".png", ".pdf")
"""Suffixes of pages and pictures, which may be made again."""

RUN = typer.Argument(help="Run folder.", show_default=False)


def figures(
    run: Annotated[Path, RUN],
    out: Annotated[Path | None, typer.Option(help="Folder for the figures; RUN/figures if left out.")] = None,
    formats: Annotated[str, typer.Option("--format", help="Formats, joined by commas: svg, png, pdf.")] = "svg,png",
) -> None:
    """Draw every figure that a run's numbers allow, for papers and reports; say which are left out, and why."""
    from pickenv.files import separate
    from pickenv.inspect.figures.run_drawings import LeftOut, write_drawings
    from pickenv.inspect.runs.run_folder import added_to, read_run

    found, folder = read_run(run), out or run / "figures"
    drawings, suffixes = drawings_of(found), formats.split(",")
    separate(
        {"RUN": _numbers(run)}, {"--out": [folder / f"{d.name}.{suffix}" for d in drawings for suffix in suffixes]}
    )
    with added_to(found):
        written = write_drawings(drawings, folder, suffixes)
    for path in written:
        print(f"wrote {path}")
    for drawing in drawings:
        if isinstance(drawing, LeftOut):
            print(f"left out {drawing.name}: {drawing.reason}")


def report(
    run: Annotated[Path, RUN],
    out: Annotated[Path | None, typer.Option(help="File to write (.html); RUN/report.html if left out.")] = None,
    picture: Annotated[
        bool, typer.Option("--picture/--no-picture", help="Show the recording as its viewer draws it.")
    ] = True,
) -> None:
    """Write a run's report: one HTML file that needs no network, verdict first, then the evidence."""
    from pickenv.files import separate, write_text
    from pickenv.inspect.runs.run_folder import added_to, read_run

    found = read_run(run)
    path = out or run / "report.html"
    separate({"RUN": _numbers(run)}, {"--out": path})
    if found.kind == "study":
        from pickenv.study.analysis.study_report import study_report

        print(f"wrote {study_report(run, path)}")
        return
    with added_to(found):
        print(f"wrote {write_text(path, page_of(found, picture))}")


def _numbers(run: Path) -> list[Path]:
    """Files of a run that figures and pages are made of, and that none of them may replace."""
    return [path for path in run.rglob("*") if path.is_file() and path.suffix not in MADE_FROM_NUMBERS]


def drawings_of(run: Run) -> Drawings:
    """Every figure of a run, drawable or left out."""
    from pickenv.inspect.figures import run_drawings as drawings
    from pickenv.inspect.runs import run_folder

    if run.kind == "evaluation":
        from pickenv.agents.evaluation.grid_figures import grid_drawings
        from pickenv.agents.evaluation.grid_tables import read_grid

        return grid_drawings(read_grid(run))
    if run.kind == "study":
        from pickenv.study.analysis.study_drawings import gather, study_drawings

        return study_drawings(gather(run.folder))
    if run.kind == "harvest":
        return drawings.harvest_drawings(run_folder.load_harvest(run))
    if run.kind == "iso9283":
        return drawings.iso9283_drawings(run_folder.load_iso9283(run))
    traced = drawings.trace_drawings(run_folder.load_trace(run))
    if run.kind == "calibration":
        return traced
    return [*drawings.comparison_drawings(run_folder.load_comparison(run.folder)), *traced]


def page_of(run: Run, picture: bool) -> str:
    """A run's report as HTML."""
    from pickenv.inspect.recordings.viewer_picture import viewer_picture
    from pickenv.inspect.reports.demo_report import demo_report
    from pickenv.inspect.reports.plain_report import harvest_report, iso9283_report
    from pickenv.inspect.runs import run_folder

    if run.kind == "evaluation":
        from pickenv.agents.evaluation.grid_report import grid_report
        from pickenv.agents.evaluation.grid_tables import read_grid

        return grid_report(run, read_grid(run))
    if run.kind == "harvest":
        return harvest_report(run, run_folder.load_harvest(run))
    if run.kind == "iso9283":
        return iso9283_report(run, run_folder.load_iso9283(run))
    if run.kind == "calibration":
        return run_folder.written_report(run)
    return demo_report(run, viewer_picture if picture else None)
