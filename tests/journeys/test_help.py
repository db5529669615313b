"""`pickenv COMMAND --help` ends with commands that its own parser takes, and with a page that is there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from pickenv.cli import app

PAGES = Path(__file__).parents[2] / "docs"
COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
EXAMPLES = {name: command.epilog for name, command in COMMANDS.items() if command.epilog}
LINES = [(name, line) for name, text in EXAMPLES.items() for line in re.findall(r"\[bold\](.*)\[/bold\]", text)]


def parsed(line: str) -> None:
    """Raise unless options are known, have values, and no argument is missing or too many."""
    _, name, *words = shlex.split(line)
    command = COMMANDS[name]
    with command.context_class(command, info_name=name) as context:
        left = command.make_parser(context).parse_args(words)[1]
    assert left == [], left


def test_every_command_has_examples_and_a_page() -> None:
    assert set(EXAMPLES) == set(COMMANDS) - {"bench"}  # whose own commands have theirs
    pages = [text.rpartition("/")[2] for text in EXAMPLES.values()]
    assert [page for page in pages if not (PAGES / page).is_file()] == []
    assert {name for name, _ in LINES} == set(EXAMPLES)


def test_every_argument_and_option_is_explained() -> None:
    bench = COMMANDS["bench"].commands
    params = [(name, param) for name, one in {**COMMANDS, **bench}.items() for param in one.params if one.callback]
    assert [f"{name} {param.name}" for name, param in params if not param.help and param.name != "context"] == []
    assert [name for name, param in params if "Args:" in (param.help or "")] == []


@pytest.mark.parametrize(("name", "line"), LINES, ids=[line for _, line in LINES])
def test_an_example_is_what_its_command_takes(name: str, line: str) -> None:
    assert name in {shlex.split(line)[1], "demo"}  # the demonstration is looked at with another command
    parsed(line)


def test_an_example_with_a_wrong_option_would_be_seen() -> None:
    for wrong in ("pickenv verify a.npz b.csv --refitt base", "pickenv report a b", "pickenv demo --out"):
        with pytest.raises(Exception):  # noqa: B017 - typer's copy of click is not public
            parsed(wrong)


@pytest.mark.parametrize("name", ["calibrate", "demo"])
def test_the_help_shows_them_once(name: str) -> None:
    shown = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "120"}).output
    assert all(shown.count(line) == 1 for owner, line in LINES if owner == name)
