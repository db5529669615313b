"""Commands about finished runs: `pickenv figures` and `pickenv report`."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol, cast

import typer

if TYPE_CHECKING:
    from pickenv.inspect.figures.run_drawings import Drawings
    from pickenv.inspect.runs.run_folder import Run, TakePicture

MADE_FROM_NUMBERS = (".html", ".svg", ".png", ".pdf")
"""Suffixes of pages and pictures, which may be made again."""

RUN = typer.Argument(help="Run folder.", show_default=False)


class Pages(Protocol):
    """What a kind of run offers to look at."""

    def drawings(self, run: Run) -> Drawings:
        """Every figure, drawable or left out."""

    def page(self, run: Run, picture: TakePicture | None) -> str:
        """The report as HTML, with a picture of the recording where it has one."""


def figures(
    run: Annotated[Path, RUN],
    out: Annotated[Path | None, typer.Option(help="Folder for the figures; RUN/figures if left out.")] = None,
    formats: Annotated[str, typer.Option("--format", help="Formats, joined by commas: svg, png, pdf.")] = "svg,png",
) -> None:
    """Draw every figure that a run's numbers allow, for papers and reports; say which are left out, and why."""
    from pickenv.files import separate
    from pickenv.inspect.figures.run_drawings import NotDrawn, write_drawings
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
    from pickenv.files import separate, write_text
    from pickenv.inspect.runs.run_folder import added_to, read_run

    found = read_run(run)
    path = out or run / "report.html"
    separate({"RUN": _numbers(run)}, {"--out": path})
    with added_to(found):
        print(f"wrote {write_text(path, page_of(found, picture))}")


def _numbers(run: Path) -> list[Path]:
    """Files of a run that figures and pages are made of, and that none of them may replace."""
    return [path for path in run.rglob("*") if path.is_file() and path.suffix not in MADE_FROM_NUMBERS]


def drawings_of(run: Run) -> Drawings:
    """Every figure of a run, drawable or left out."""
    return _pages(run).drawings(run)


def page_of(run: Run, picture: bool) -> str:
    """A run's report as HTML."""
    from pickenv.inspect.recordings.viewer_picture import viewer_picture

    return _pages(run).page(run, viewer_picture if picture else None)


def _pages(run: Run) -> Pages:
    """The module that draws and writes about this kind of run."""
    from pickenv.inspect.runs.run_folder import KINDS

    return cast("Pages", import_module(KINDS[run.kind].pages))
