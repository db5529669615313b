"""What every test may ask for."""

import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer.main
import typer.testing
from hypothesis import HealthCheck, settings

from pickenv import cli
from pickenv.commands.guard import guarded

# A busy machine is slow, and nothing that a test says is about time.
settings.register_profile("pickenv", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("pickenv")

# A terminal so wide that sentences and tables stand on one line; what narrow ones do is asked where it matters.
os.environ["COLUMNS"] = "400"

# MKL sums in another order on another processor, and a network's training then ends elsewhere.
os.environ["MKL_CBWR"] = "COMPATIBLE"

# The check of international addresses, of which no schema of ours has any, builds 39 grammars when it is loaded.
sys.modules.setdefault("rfc3987_syntax", None)  # type: ignore[arg-type]

ROOT = Path(__file__).parents[1]

build = typer.main.get_command


def options_of(command: Any) -> Iterator[Any]:
    """All options and arguments of a command and of those below it."""
    yield from command.params
    for name in getattr(command, "commands", {}):
        yield from options_of(command.commands[name])


@cache
def built(app: typer.Typer, commands: tuple[object, ...]) -> tuple[Any, list[tuple[Any, str | None]]]:
    """A program's commands, and every option with its help."""
    program = build(app)
    return program, [(option, getattr(option, "help", None)) for option in options_of(program)]


def built_once(app: typer.Typer) -> Any:
    """A program's commands, built once, which takes a tenth of a second; help names what is registered when shown."""
    program, helps = built(app, (app.registered_callback, *app.registered_commands, *app.registered_groups))
    for option, text in helps:
        option.help = text
    return program


typer.main.get_command = typer.testing._get_command = built_once


class Ended(NamedTuple):
    """How a command ended, in the words of `subprocess`."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of measured data sets: PICKENV_DATA, or ../shared/data beside the checkout."""
    folder = Path(os.environ.get("PICKENV_DATA") or ROOT / "../shared/data").resolve()
    if not folder.is_dir():
        pytest.skip(f"no measured data in {folder}; set PICKENV_DATA to the folder that holds the data sets")
    return folder


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Runs a command as if it had been typed, in this process: its exit code and what it said."""

    def run(*words: object) -> Ended:
        monkeypatch.setattr("sys.argv", ["pickenv", *map(str, words)])
        try:
            code = guarded(cli._run)
        except SystemExit as error:
            code = int(error.code or 0)
        return Ended(code, *capsys.readouterr())

    return run


@contextmanager
def unwritten_figures() -> Iterator[None]:
    """A context in which figures are drawn, and pages have empty pictures in their places."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pickenv.inspect.reports.report_page.inline_svg", lambda figure, name: ("", 1.0, 1.0))
        yield


@pytest.fixture(scope="session")
def unwritten() -> Callable[[], AbstractContextManager[None]]:
    """`unwritten_figures` itself, for tests that ask about a page's words alone."""
    return unwritten_figures


def pytest_collection_finish() -> None:
    """What is loaded now stays: no collection need look through it again, and few objects come in rings."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
