"""Commands about finished runs: `pickenv figures` and `pickenv report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pickenv.base import separate, write_text

MADE_FROM_NUMBERS = (".html", ".svg", ".png", ".pdf")
"""Suffixes of pages and pictures, which may be made again."""

RUN = typer.Argument(help="Run folder.", show_default=False)


def figures(
    run: Annotated[Path, RUN],
    out: Annotated[Path | None, typer.Option(help="Folder for the figures; RUN/figures if left out.")] = None,
    formats: Annotated[str, typer.Option("--format", help="Formats, joined by commas: svg, png, pdf.")] = "svg,png",
) -> None:
    """Draw every figure that a run's numbers allow, for papers and reports; say what is left out."""
    from pickenv.inspect import drawings_of, read_run, write_drawings
    from pickenv.inspect.figures.run_drawings import NotDrawn
    from pickenv.inspect.runs.run_folder import added_to

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
        if isinstance(drawing, NotDrawn):
            print(f"left out {drawing.name}: {drawing.reason}")


def report(
    run: Annotated[Path, RUN],
    out: Annotated[Path | None, typer.Option(help="File to write (.html); RUN/report.html if left out.")] = None,
    picture: Annotated[
        bool, typer.Option("--picture/--no-picture", help="Show the recording as its viewer draws it.")
    ] = True,
) -> None:
    """Write a run's report: one HTML file that needs no network, verdict first, then the evidence."""
    from pickenv.inspect import page_of, read_run
    from pickenv.inspect.recordings.open_recording import viewer_picture
    from pickenv.inspect.runs.run_folder import added_to

    found = read_run(run)
    path = out or run / "report.html"
    separate({"RUN": _numbers(run)}, {"--out": path})
    with added_to(found):
        print(f"wrote {write_text(path, page_of(found, viewer_picture if picture else None))}")


def _numbers(run: Path) -> list[Path]:
    """Files of a run that figures and pages are made of, and that none of them may replace."""
    return [path for path in run.rglob("*") if path.is_file() and path.suffix not in MADE_FROM_NUMBERS]
