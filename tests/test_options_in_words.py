"""The library names its parameters in backticks; a command prints its own options in their place."""

import warnings
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from pickenv.base import InputError
from pickenv.cli import app as pickenv
from pickenv.commands import showing

SENTENCES = {
    "give `refit` with it": "give --refit with it",
    "give `refit_rows=6`": "give --refit-rows 6",
    "give `test='blocked rows.csv'`": "give --test 'blocked rows.csv'",
    "give `allow=['x', 'y']`": "give --allow x --allow y",
    "name it, `columns=NAME`": "name it, --columns NAME",
    "give `quick=True` or `robust=False`": "give --quick or --no-robust",
    "give `kind`, `labels` and `json_file`": "give --as, --label and --json",
    "`progress` and `arm='ur5e'` are no options": "progress and arm='ur5e' are no options",
    "run `pickenv figures RUN`": "run `pickenv figures RUN`",
}


def printed(act) -> tuple[str, BaseException | None]:
    """All that a command prints that has such options and does this, and how it fails."""
    app = typer.Typer()

    @app.command(cls=showing.CommandOfNames)
    def command(
        arm: str,
        refit: str | None = None,
        refit_rows: int = 6,
        test: str | None = None,
        allow: list[str] | None = None,
        columns: str | None = None,
        quick: Annotated[bool, typer.Option("--quick")] = False,
        robust: bool = True,
        kind: Annotated[str | None, typer.Option("--as")] = None,
        label: str | None = None,
        json_file: Annotated[str | None, typer.Option("--json")] = None,
    ) -> None:
        act()

    result = CliRunner().invoke(app, ["ur5e"])
    return result.output, result.exception


@pytest.mark.parametrize(("sentence", "words"), SENTENCES.items())
def test_parameters_in_an_error_a_warning_and_a_report_become_options(sentence: str, words: str) -> None:
    def refuse() -> None:
        raise InputError(sentence)

    def warn() -> None:
        warnings.simplefilter("always")
        warnings.warn(sentence, stacklevel=1)

    assert str(printed(refuse)[1]) == words
    assert printed(warn)[0] == f"warning: {words}\n"
    assert printed(lambda: print(showing.with_options(sentence)))[0] == f"{words}\n"


def test_without_a_command_a_parameter_loses_its_backticks_alone() -> None:
    printed(lambda: None)
    assert showing.with_options("give `refit` or `test='blocked'`") == "give refit or test='blocked'"


def test_every_command_speaks_so() -> None:
    def commands(group):
        for command in group.commands.values():
            yield from commands(command) if hasattr(command, "commands") else [command]

    assert all(isinstance(command, showing.CommandOfNames) for command in commands(typer.main.get_command(pickenv)))


def test_a_command_is_said_as_it_is_typed_less_what_it_writes() -> None:
    def judge(
        files: Annotated[list[str], typer.Argument()],
        pool: Annotated[str | None, typer.Option("--from")] = None,
        allow: Annotated[list[str] | None, typer.Option(help="Names.")] = None,
        quick: Annotated[bool, typer.Option("--quick")] = False,
        robust: Annotated[bool, typer.Option("--robust/--no-robust")] = True,
        test_rows: Annotated[int | None, typer.Option()] = None,
        held: Annotated[tuple[float, float] | None, typer.Option()] = None,
        out: Annotated[str, typer.Option()] = "out",
    ) -> None: ...

    values = {"files": ["a b.csv", "c.csv"], "pool": "p.csv", "allow": ["x", "y"], "quick": True, "robust": False}
    line = showing.command_of(judge, values | {"test_rows": None, "held": (2.5, 60.0), "out": "there"})
    assert line == "pickenv judge 'a b.csv' c.csv --from p.csv --allow x --allow y --quick --no-robust --held 2.5 60.0"
    plain = values | {"pool": None, "allow": None, "quick": False, "robust": True, "held": None}
    assert (
        showing.command_of(judge, plain | {"test_rows": 5, "out": ""}) == "pickenv judge 'a b.csv' c.csv --test-rows 5"
    )
