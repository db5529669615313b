"""What commands show: progress bars on standard error, so that standard output stays clean, tables, names in help."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperOption

from pickenv.base import screen_width, side_by_side
from pickenv.base.registry import names

WIDTH = 150
"""Characters of a table that goes elsewhere than to a terminal."""


class CommandOfNames(TyperCommand):
    """A command whose help says ``{residual}`` where the names of all registered residual models belong."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Put the names in, which are looked for only now."""
        for param in self.params:
            if isinstance(param, TyperOption | TyperArgument) and param.help:
                param.help = re.sub(r"\{(\w+)\}", lambda match: ", ".join(names(match[1])), param.help)
        super().format_help(ctx, formatter)


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
    """Print a table with lines around it; one wider than the terminal (or COLUMNS) in several, one below another.

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

    names, lines, room = list(heads), [list(row) for row in rows], screen_width(width)
    columns = [(name, [row[i] for row in lines]) for i, name in enumerate(names)]
    whole = [max(map(len, (*name.split("\n"), *cells))) for name, cells in columns]
    least = [  # heads and words may be broken at spaces, numbers may not
        max(
            map(len, (*name.split(), *(part for cell in cells for part in (cell.split() if name in words else [cell]))))
        )
        for name, cells in columns
    ]
    sizes = [size + 3 for size in (whole if sum(whole) + 3 * len(whole) + 1 <= room else least)]
    leading = next((i for i, name in enumerate(names) if name not in words), len(names))
    parts = side_by_side(sizes, leading, room - 1)
    console = Console(width=room)
    for number, part in enumerate(parts):
        table = Table(title=escape(title) if number == 0 else None)
        spare = room - 1 - sum(least[i] + 3 for i in part)
        for i in part:
            size = least[i] + max(0, min(spare, whole[i] - least[i]))
            spare -= size - least[i]
            table.add_column(escape(names[i]), justify="left" if names[i] in words else "right", width=size)
        for row in lines:
            table.add_row(*(escape(row[i]) for i in part))
        console.print(table)
    if caption:
        console.print(escape(caption), style="italic", highlight=False)
