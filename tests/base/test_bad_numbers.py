"""Every option that takes a number refuses what is none in one sentence that names it, before any file is read."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
import typer
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from pickenv import cli
from pickenv.commands import guard

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


def _refused(words: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch, typed: Callable[..., Any]) -> str:
    """The one sentence of a command that is refused and writes nothing; what it reads does not exist."""
    command: Any = typer.main.get_command(cli.app).commands[words[0]]  # type: ignore[attr-defined]
    missing = [str(folder / "missing.npz") for p in command.params if p.param_type_name == "argument" and p.required]
    arm = ["--arm", "qiao2026"] if any("--arm" in p.opts for p in command.params) else []
    monkeypatch.chdir(folder)
    ended = typed(words[0], *missing, *arm, *words[1:])
    assert ended.returncode == guard.BAD_INPUT
    sentence: str = ended.stderr
    assert sentence.count("error:") == 1
    assert not list(folder.iterdir())
    return sentence


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e308"])
@pytest.mark.parametrize(("name", "option"), _numeric())
def test_no_number_is_refused_by_name(
    name: str,
    option: str,
    value: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: Callable[..., Any],
) -> None:
    assert option in _refused([name, f"{option}={value}"], tmp_path, monkeypatch, typed)


@pytest.mark.parametrize(("name", "option"), _numeric())
@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=st.floats(max_value=-1e-300) | st.floats(5e-324, 1e-300) | st.floats(min_value=1e7))
def test_numbers_without_sense_end_in_one_sentence(
    name: str,
    option: str,
    value: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: Callable[..., Any],
) -> None:
    """Negative, denormal, huge: the sentence is the option's, or the missing file's where the number has a sense."""
    assume((name, option) != ("plan-poses", "--seed") or not (value > 0 and value.is_integer()))  # it would plan
    _refused([name, f"{option}={value!r}"], tmp_path, monkeypatch, typed)


def _written() -> list[tuple[str, str]]:
    """Command and option of every file that is written."""
    pairs = []
    for name in NAMES:
        command: Any = typer.main.get_command(cli.app).commands[name]  # type: ignore[attr-defined]
        options = {option.opts[0] for option in command.params}
        pairs += [(name, option) for option in ("--out", "--json", "--report") if option in options]
    return pairs


@pytest.mark.parametrize("folder", ["/", ".", ".."])
@pytest.mark.parametrize(("name", "option"), _written())
def test_a_folder_is_no_file_to_write(
    name: str,
    option: str,
    folder: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: Callable[..., Any],
) -> None:
    sentence = _refused([name, option, folder], tmp_path, monkeypatch, typed)
    assert f"cannot write {folder}: it is a folder" in sentence
