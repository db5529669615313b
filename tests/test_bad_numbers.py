"""Every option that takes a number refuses what is none in one sentence that names it, before any file is read."""

from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
import typer

from pickenv import cli
from pickenv.commands.guard import BAD_INPUT, guarded

NAMES = ("calibrate", "apply", "verify", "plan-poses", "twin")


def _numeric() -> list[tuple[str, str]]:
    """Command and option of every number, as the commands themselves declare them."""
    pairs = []
    for name in NAMES:
        command: Any = typer.main.get_command(cli.app).commands[name]  # type: ignore[attr-defined]
        hints = get_type_hints(command.callback)
        for option in command.params:
            if {int, float} & {hints[option.name], *get_args(hints[option.name])}:
                pairs.append((name, option.opts[0]))
    return pairs


def test_options_are_found() -> None:
    assert {name for name, _ in _numeric()} == set(NAMES)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e308"])
@pytest.mark.parametrize(("name", "option"), _numeric())
def test_no_number_is_refused_by_name(
    name: str,
    option: str,
    value: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    command: Any = typer.main.get_command(cli.app).commands[name]  # type: ignore[attr-defined]
    missing = [str(tmp_path / "missing.npz") for p in command.params if p.param_type_name == "argument" and p.required]
    arm = ["--arm", "qiao2026"] if any("--arm" in p.opts for p in command.params) else []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["pickenv", name, *missing, *arm, f"{option}={value}"])
    assert guarded(cli._run) == BAD_INPUT
    said = capsys.readouterr().err
    assert said.count("error:") == 1 and option in said
    assert not list(tmp_path.iterdir())
