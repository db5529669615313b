"""Show the output of commands on the screen: help, progress bars, verdicts, tables and the list of files written.

A command's docstring is its help (`CommandOfNames`). Messages of the library name parameters in backticks; commands
print the names of options in their place (`with_options`). Results are saved first and then printed, so that an error
in printing loses nothing (`deliver`). Progress goes to standard error, so that standard output has results alone. The
output of a command has at most 25 lines of 100 characters: the verdict, the one table that matters, what was written,
and what to do next. `--details` prints the rest.
"""

from __future__ import annotations

import ast
import math
import re
import shlex
import sys
import time
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from inspect import signature
from pathlib import Path
from typing import Any, TypeAlias, get_type_hints

from typer import CallbackParam
from typer.core import TyperArgument, TyperCommand, TyperOption
from typer.models import ArgumentInfo, OptionInfo

from pickenv.base import (
    InputError,
    check_limit,
    command_line,
    folded,
    screen_width,
    side_by_side,
    write_json,
    write_text,
)
from pickenv.base.registry import names


@cache
def pages_address() -> str:
    """Return the address of the documentation pages that the package names, or the folder of a checkout."""
    try:
        addresses = metadata.metadata("pickenv").get_all("Project-URL") or []
    except metadata.PackageNotFoundError:
        addresses = []
    return next((text.partition(", ")[2] for text in addresses if text.startswith("Documentation, ")), "docs")


WIDTH = 150
"""Number of characters in a table's line if the output is not a terminal."""


MOST = 8
"""Largest number of rows of a table that are printed without `--details`."""


class CommandOfNames(TyperCommand):
    """A command whose help is its docstring: "Args:" explains the options, "Examples:" and "More:" are at the end.

    A kind in braces in the docstring, such as ``{residual}``, is replaced by all names registered of this kind.
    """

    def __init__(self, *args: Any, help: str | None, params: list[Any], **more: Any) -> None:
        """Take the docstring apart into help, options and epilog."""
        text, _, end = (help or "").partition("\n\nExamples:\n")
        text, _, options = text.partition("\n\nArgs:\n")
        helps = dict(re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", options, re.MULTILINE))
        for param in params:
            param.help = " ".join(helps.get(param.name, "").split()) or param.help
        if end:
            lines, _, page = end.partition("\n\nMore: ")
            typed = [f"[bold]{line.strip()}[/bold]" for line in lines.split("\n")]
            more["epilog"] = "\n\n".join(["Examples:", *typed, f"More: {pages_address()}/{page}"])
        super().__init__(*args, help=text, params=params, **more)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Replace each kind in braces by all names registered of this kind, and write the help to ``formatter``."""
        for param in self.params:
            if isinstance(param, TyperOption | TyperArgument) and param.help:
                param.help = re.sub(r"\{(\w+)\}", lambda match: ", ".join(names(match[1])), param.help)
        super().format_help(ctx, formatter)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; messages printed meanwhile name its options in place of the library's parameters."""
        before = dict(_options)
        _options.clear()
        siblings = {} if ctx.parent is None else getattr(ctx.parent.command, "commands", {})
        for command in (siblings.get("calibrate", self), self):  # what to calibrate with is said by other commands too
            _options.update({str(param.name): param for param in command.params if isinstance(param, TyperOption)})
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _print_warning
                return super().invoke(ctx)
        except InputError as error:
            error.args = (with_options(str(error)),)
            raise
        finally:
            _options.clear()
            _options.update(before)


_options: dict[str, TyperOption] = {}
"""Options of the running command, by the names of their parameters."""

PARAMETERS = {
    "algorithm": "algo",
    "camera_noise_mm": "camera_noise",
    "compensations": "compensation",
    "env_id": "env",
    "folder": "out",
    "fruit_noise_mm": "fruit_noise",
    "grippers": "gripper",
    "labels": "label",
    "plants": "plant",
    "policies": "policy",
}
"""Names of parameters in commands, by their names in the library, if the two differ."""


def with_options(text: str) -> str:
    """Return the message ``text`` with parameters of the library (in backticks) replaced by options of the command.

    ``give `terms` or `test='b.csv'`` `` becomes "give --terms or --test b.csv". A list becomes one option per value. If
    neither the running command nor `pickenv calibrate` has such an option, the name stays, without backticks.
    """
    return re.sub(r"`([A-Za-z_]\w*)(?:=([^`]*))?`", _option, text)


def _option(match: re.Match[str]) -> str:
    name, value = match.groups()
    option = _options.get(PARAMETERS.get(name, name), _options.get(name))
    if option is None:
        return match[0].strip("`")
    if value is None:
        return option.opts[0]
    try:
        content = ast.literal_eval(value)
    except (SyntaxError, ValueError):  # a word that stands for a value: NAME
        return f"{option.opts[0]} {value}"
    if isinstance(content, bool):
        return option.opts[0] if content else next(iter(option.secondary_opts), f"no {option.opts[0]}")
    values = content if isinstance(content, list | tuple) else [content]
    return " ".join(f"{option.opts[0]} {shlex.quote(str(item))}" for item in values)


def check_workers(workers: int | None, several: bool, executor: str) -> None:
    """Raise an error if several processes are wanted from an executor that works in one.

    Args:
        workers: Number of processes, or None.
        several: Whether the executor that the user chose works in several processes.
        executor: Name of another executor, which works in several processes and which the message recommends.

    Raises:
        InputError: If ``workers`` is above 1 and the executor works in one process.
    """
    if not several and (workers or 1) > 1:
        raise InputError(
            f"--workers {workers} is of several processes; give --executor {executor} with it, or leave it out"
        )


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {with_options(str(message))}", file=sys.stderr)


WRITTEN = ("json_file", "lens_out", "out", "report", "run")
"""Parameters of commands that name files or folders to write."""


def command_of(command: Callable[..., None], values: Mapping[str, Any]) -> str:
    """Return the command line of a command for a shell, without the options in `WRITTEN`.

    Args:
        command: The function of the command; its annotations give the names of the options.
        values: Values by the name of the parameter.
    """
    words, options = ["pickenv", command.__name__.replace("_", "-")], dict[str, Any]()
    parameters = signature(command).parameters
    for name, hint in get_type_hints(command, include_extras=True).items():
        if name in WRITTEN or name == "return":
            continue
        declared, value = next(iter(getattr(hint, "__metadata__", ())), None), values[name]
        required = parameters[name].default is parameters[name].empty
        if isinstance(declared, ArgumentInfo) or (required and not isinstance(declared, OptionInfo)):
            words += value if isinstance(value, list) else [value]
            continue
        given = getattr(declared, "default", None)
        option, _, opposite = (given if isinstance(given, str) else name).partition("/")
        several = [value] if isinstance(value, tuple) else value  # words of one option
        options |= {opposite.strip("-"): not value} if opposite else {option.strip("-"): several}
    return command_line(*words, **options)


def arguments_for(taker: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a command's parameters that are arguments of a function or class, by the argument's name.

    Values that are None or an empty list are left out.

    Args:
        taker: The function or class.
        values: Values of the command's parameters, by the name of the parameter.
    """
    typed = {name: values.get(PARAMETERS.get(name, name)) for name in signature(taker).parameters}
    return {name: value for name, value in typed.items() if value not in (None, [])}


def refuse_stray(command: Callable[..., None], values: Mapping[str, Any], stray: Collection[str], goes: str) -> None:
    """Raise an error if an option that has no effect has another value than its default.

    Args:
        command: The function of the command.
        values: Values of the command's parameters, by the name of the parameter.
        stray: Names of the parameters that have no effect.
        goes: What such a parameter goes with, and what to do, for the message.
    """
    for name, parameter in signature(command).parameters.items():
        if name in stray and values[name] not in (parameter.default, []):
            raise InputError(f"`{name}` goes with {goes}")


def limited(quantity: str) -> Callable[[CallbackParam, Any], Any]:
    """Return an option's callback that refuses numbers outside the limits of ``quantity`` in `pickenv.base.LIMITS`."""

    def checked(param: CallbackParam, value: Any) -> Any:
        if value is not None:
            check_limit(param.opts[0], value, quantity)
        return value

    return checked


Save: TypeAlias = tuple[Path | None, Callable[[Path], Path | Iterable[Path]] | str | Mapping[str, Any] | list[Any]]
"""A file or folder to write (None to write nothing), and what to write: a text, content for JSON, or a function that
writes the file."""


def deliver(saves: Iterable[Save], show: Callable[[], object] | str, next_step: str = "", more: str = "") -> None:
    """Save results, then print them; if saving fails, print the results before the error is raised.

    Args:
        saves: The files to write, each with its content, or with a function that writes the file and returns the paths
            written.
        show: A text to print, whose first line is the verdict, or a function that prints the results. The paths of the
            written files are printed after it.
        next_step: What the reader can do next, with a command to copy; empty to print nothing.
        more: What `--details` would print; empty if it is printed already.
    """
    lines: list[str] = []
    try:
        for path, content in saves:
            if path is None:
                continue
            if callable(content):
                paths = content(path)
            else:
                paths = write_text(path, content) if isinstance(content, str) else write_json(path, content)
            lines += _lines_of_files(path, [paths] if isinstance(paths, Path) else list(paths))
    finally:
        if isinstance(show, str):
            _print_result(show)
        else:
            show()
        for line in lines:
            print(line)
    if next_step:
        print(f"next: {next_step}")
    if more:
        print(f"more: --details prints {more}")


def _print_result(text: str) -> None:
    """Print a text whose first sentence is the verdict; a verdict folded over several lines is joined again."""
    lines = text.split("\n")
    count = next((i for i, line in enumerate(lines) if i > 0 and not line.startswith("    ")), len(lines))
    if verdict := " ".join(map(str.strip, lines[:count])):
        print_verdict(verdict)
    if rest := "\n".join(lines[count:]):
        print(with_options(rest))


FILES_OF_A_LINE = 4
"""Largest number of files written to one place that have a line each. If there are more, one line names the folder and
the first of these files."""


def _lines_of_files(place: Path, paths: Sequence[Path]) -> Iterator[str]:
    """Yield lines that name the files ``paths``: a line per file, or a single line for many files in ``place``.

    The single line begins with the files nearest to ``place``, and with pages (.html) before other files.
    """
    if len(paths) <= FILES_OF_A_LINE or not all(path.is_relative_to(place) for path in paths):
        yield from (f"wrote {path}" for path in paths)
        return
    names = [path.relative_to(place) for path in paths]
    names.sort(key=lambda name: (len(name.parts), name.suffix != ".html"))
    first, rest = names[:FILES_OF_A_LINE], len(names) - FILES_OF_A_LINE
    yield f"wrote {place}: {', '.join(map(str, first))} and {rest} more"


BORDER = 4
"""Number of characters that a panel's edges take from a line."""


def print_verdict(text: str, width: int | None = None) -> None:
    """Print the verdict of a command, a sentence per line: in a panel on a terminal, else as plain text.

    Args:
        text: The verdict.
        width: Number of characters in a line if the output is not a terminal.
    """
    from rich.console import Console
    from rich.panel import Panel
    from rich.text import Text

    console = Console(width=screen_width() if width is None else screen_width(width))
    room = console.width - BORDER * console.is_terminal
    sentences = with_options(text).split("\n")
    words = Text("\n".join(line for sentence in sentences for line in folded(sentence, room)), style="bold")
    console.print(Panel.fit(words) if console.is_terminal else words)


@contextmanager
def progress_bars(unit: str = "") -> Iterator[Callable[[str, int, int], None]]:
    """Show one progress bar per stage; yield a function that is called with (stage, done, total).

    Args:
        unit: Name of what is counted, such as "arms", to show the number per second; empty to show no rate.
    """
    from rich import progress
    from rich.console import Console

    if not sys.stderr.isatty():
        yield progress_lines()
        return
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


LINE_SECONDS, QUICK = 10.0, 2.0
"""Time between two printed lines about a stage if standard error is no terminal, and time at the beginning of a command
in which nothing is printed, s."""


def progress_lines() -> Callable[[str, int, int], None]:
    """Return a function of (stage, done, total) that prints lines of progress to standard error, for log files.

    A line is printed as a stage begins, every `LINE_SECONDS`, and as it ends, but none in the first `QUICK` seconds.
    """
    printed: dict[str, float] = {}
    start = time.monotonic()

    def report(stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if now - start < QUICK:
            return
        if stage not in printed or done >= total or now - printed[stage] >= LINE_SECONDS:
            if printed.get(stage) != math.inf:
                print(f"{stage}: {done}/{total}", file=sys.stderr, flush=True)
            printed[stage] = math.inf if done >= total else now

    return report


def print_table(
    title: str,
    heads: Iterable[str],
    rows: Iterable[Iterable[str]],
    *,
    words: Collection[str],
    caption: str = "",
    width: int = WIDTH,
    most: int | None = None,
) -> None:
    """Print a table; a table wider than the terminal (or COLUMNS) is printed in parts, one below another.

    Args:
        title: Text above the table.
        heads: Names of the columns, with units.
        rows: Cells, row by row.
        words: Names of the columns that contain words; the other columns are aligned to the right.
        caption: Text below the table.
        width: Number of characters in a line if the output is not a terminal.
        most: Largest number of rows printed, after which the number of further rows is printed; None prints all.
    """
    from rich import box
    from rich.console import Console
    from rich.markup import escape  # else a unit in brackets is taken for a style, and swallowed
    from rich.table import Table

    names, lines, room = list(heads), [list(row) for row in rows], screen_width(width)
    left_out, lines = lines[len(lines) if most is None else most :], lines[:most]
    columns = [(name, [row[i] for row in lines]) for i, name in enumerate(names)]
    widest = [max(map(len, (*name.split("\n"), *cells))) for name, cells in columns]
    least = [  # heads and words may be broken at spaces, numbers may not
        max(
            map(len, (*name.split(), *(part for cell in cells for part in (cell.split() if name in words else [cell]))))
        )
        for name, cells in columns
    ]
    sizes = [size + 3 for size in (widest if sum(widest) + 3 * len(widest) + 1 <= room else least)]
    leading = next((i for i, name in enumerate(names) if name not in words), len(names))
    parts = side_by_side(sizes, leading, room - 1)
    console = Console(width=room)
    console.print(escape(title), style="italic", highlight=False)
    for part in parts:
        table = Table(box=box.SIMPLE_HEAD, show_edge=False)
        spare = room - 1 - sum(least[i] + 3 for i in part)
        for i in part:
            size = least[i] + max(0, min(spare, widest[i] - least[i]))
            spare -= size - least[i]
            table.add_column(escape(names[i]), justify="left" if names[i] in words else "right", width=size)
        for row in lines:
            table.add_row(*(escape(row[i]) for i in part))
        console.print(table)
    if left_out:
        console.print(f" … and {len(left_out)} rows more: --details", style="italic", highlight=False)
    if caption:
        console.print(escape(caption), style="italic", highlight=False)
