"""What commands show: progress bars on standard error, so that standard output stays clean, and tables."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager

WIDTH = 150
"""Characters of a table that goes elsewhere than to a terminal."""


@contextmanager
def progress_bars(unit: str = "") -> Iterator[Callable[[str, int, int], None]]:
    """One progress bar per stage; what it yields is told the stage, how many are done, and how many there are.

    Args:
        unit: What is counted, where the rate is to be shown.
    """
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description:<20}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("{task.fields[rate]}"),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True)) as bars:
        begun: dict[str, tuple[progress.TaskID, int]] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in begun:  # what an earlier run has done says nothing about this one's speed
                begun[stage] = bars.add_task(stage, total=total, completed=done, rate=""), done
            task, before = begun[stage]
            elapsed = bars.tasks[task].elapsed or 0.0
            rate = f"{(done - before) / elapsed:.0f} {unit}/s" if unit and done > before and elapsed else ""
            bars.update(task, completed=done, rate=rate)

        yield report


def print_table(
    title: str,
    heads: Iterable[str],
    rows: Iterable[Iterable[str]],
    *,
    words: Collection[str],
    caption: str = "",
    width: int = WIDTH,
) -> None:
    """Print a table with lines around it.

    Args:
        title: Above it.
        heads: Names of the columns, with units.
        rows: Cells.
        words: Names of the columns that hold words; the others are set to the right.
        caption: Below it.
        width: Characters of a line, where they go elsewhere than to a terminal.
    """
    from rich.console import Console
    from rich.markup import escape  # else a unit in brackets is taken for a style, and swallowed
    from rich.table import Table

    table = Table(title=escape(title), caption=escape(caption) or None)
    for head in heads:
        table.add_column(escape(head), justify="left" if head in words else "right")
    for row in rows:
        table.add_row(*map(escape, row))
    Console(width=None if sys.stdout.isatty() else width).print(table)
