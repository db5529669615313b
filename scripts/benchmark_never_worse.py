"""Is a calibration by the default command ever worse than the drawing? Judged where the true arm is known.

Each case calibrates by `pickenv.calibrate` as a user does, without options, and looks at the arm with the eyes of who
knows its truth: a maker's factory calibration, a generator's own parameters, rows that were never fitted. What a case
may leave at most stands beside what it left.

The case `kinhec` needs `pip install kinhec`. Tables are printed as Markdown.

Run: python scripts/benchmark_never_worse.py [--only CASE] [--json FILE] [--data DIR] [--sequences 8] [--arms 30]
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from never_worse.cases import CASES, Row, Settings
from rich.box import MARKDOWN
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from pickenv.errors import InputError
from pickenv.files import write_text

ROOT = Path(__file__).parents[1]

FIGURES = ("nominal", "least squares", "calibrated", "at most")
WORDS = ("unit", "in its 95 %", "verdict", "meets")


def said(value: float | None) -> str:
    """A figure, to three digits."""
    return "" if value is None else f"{value:#.3g}".rstrip(".")


def cells(row: Row) -> list[str]:
    """A row as it is printed."""
    share = "" if row.within95 is None else f"{100 * row.within95:.0f} %"
    meets = {None: "", True: "yes", False: "NO"}[row.meets]
    figures = [said(value) for value in (row.nominal, row.plain, row.calibrated, row.at_most)]
    return [row.subject, row.where, *figures, row.unit, share, row.grade or "", meets]


def table_of(rows: list[Row]) -> Table:
    """The rows of a case, as Markdown."""
    table = Table(box=MARKDOWN)
    for head in ("fitted", "judged", *FIGURES, *WORDS):
        table.add_column(head, justify="right" if head in FIGURES else "left", no_wrap=True)
    for row in rows:
        table.add_row(*cells(row))
    return table


def main(
    only: Annotated[list[str] | None, typer.Option(help=f"A case, of {', '.join(CASES)}; all by default.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Also write the figures to this file.")] = None,
    data: Annotated[Path, typer.Option(envvar="PICKENV_DATA", help="Folder of the measured data sets.")] = ROOT
    / "../shared/data",
    folder: Annotated[Path, typer.Option(help="Where generated sequences are kept.")] = ROOT / "runs/never_worse",
    seed: Annotated[int, typer.Option(help="Seed of everything that is drawn.")] = 0,
    sequences: Annotated[int, typer.Option(help="KinHEC sequences of each arm.", min=1)] = 8,
    arms: Annotated[int, typer.Option(help="Printed SO-101 that are drawn.", min=1)] = 30,
) -> None:
    """Run the cases and print a table of each, as Markdown."""
    console, log = Console(width=200), Console(stderr=True)
    names = only or list(CASES)
    for name in names:
        if name not in CASES:
            log.print(f"there is no case '{name}'; give {', '.join(CASES)}", markup=False, highlight=False)
            raise typer.Exit(2)
    figures: dict[str, Any] = {}
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=log) as bars:
        cases = bars.add_task("cases", total=len(names))
        for name in names:
            fits = bars.add_task(name, total=None)

            def step(what: str, task: Any = fits, case: str = name) -> None:
                bars.update(task, advance=1, description=f"{case}: {what}")

            begin = time.perf_counter()
            try:
                rows = CASES[name](Settings(data.resolve(), folder, seed, sequences, arms, step))
            except InputError as error:
                log.print(f"{name}: {error}", markup=False, highlight=False, soft_wrap=True)
                raise typer.Exit(2) from None
            seconds = time.perf_counter() - begin
            bars.remove_task(fits)
            bars.advance(cases)
            figures[name] = {"seconds": seconds, "rows": [row.as_dict() for row in rows]}
            console.print(f"{name}, {seconds:.1f} s", table_of(rows), highlight=False)
    if json_file is not None:
        write_text(json_file, json.dumps({"seed": seed, "cases": figures}, indent=2) + "\n")


if __name__ == "__main__":
    typer.run(main)
